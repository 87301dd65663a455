//! Charts of `osap maxl` in the terminal.
//!
//! - **Invariants:** widths are given, not asked of a terminal, so that a transcript is the same everywhere.

use super::chart::{Axis, Chart, Scale};
use crate::cli::output::{BAD, GOOD, HINT, STRONG, printable};
use anstyle::Style;
use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::Color;
use ratatui_core::symbols::Marker;
use ratatui_core::widgets::Widget as _;
use ratatui_widgets::chart::{self, Dataset, GraphType};
use std::fmt::Write as _;

/// Of a plot, columns.
const WIDTH: u16 = 100;
/// Of a plot, lines.
const HEIGHT: u16 = 18;
/// Most labels at an axis, both ends counted.
const LABELS_MAX: usize = 8;

/// Colours of curves, over and over.
const COLOURS: [(Color, Style); 4] =
    [(Color::Cyan, HINT), (Color::Green, GOOD), (Color::White, STRONG), (Color::Red, BAD)];

/// A heading with a legend, then the curves.
pub(super) fn draw(chart: &Chart) -> String {
    let mut text = format!("{STRONG}{}{STRONG:#}", printable(&chart.heading));
    for (series, (_, style)) in chart.series.iter().zip(COLOURS.iter().cycle()) {
        // writing to a string cannot fail
        let _ = write!(text, "  {style}⠒ {}{style:#}", printable(&series.name));
    }
    text.push('\n');
    let dataset = |(series, (colour, _)): (_, &(Color, Style))| {
        let series: &super::chart::Series = series;
        Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).data(&series.points).style(*colour)
    };
    let datasets = chart.series.iter().zip(COLOURS.iter().cycle()).map(dataset).collect();
    let mut buffer = Buffer::empty(Rect::new(0, 0, WIDTH, HEIGHT));
    chart::Chart::new(datasets)
        .x_axis(axis(&chart.x))
        .y_axis(axis(&chart.y))
        .legend_position(None)
        .render(buffer.area, &mut buffer);
    text.push_str(&lines(&buffer));
    let _ = writeln!(text, "{} over {}", printable(&chart.y.name), printable(&chart.x.name));
    text
}

/// An axis with a label at each whole power, or at both ends and in the middle.
fn axis(axis: &Axis) -> chart::Axis<'static> {
    let powers = (axis.scale != Scale::Linear).then(|| {
        #[expect(clippy::cast_possible_truncation, reason = "powers of an f64 are below 2^11")]
        let (low, high) = (axis.low as i32, axis.high as i32);
        let step = usize::try_from(high - low).map_or(1, |span| span.div_ceil(LABELS_MAX).max(1));
        let even = usize::try_from(high - low).is_ok_and(|span| span.is_multiple_of(step));
        let step = if even { step } else { 1 };
        (low..=high).step_by(step).map(f64::from).collect::<Vec<f64>>()
    });
    let at = powers.unwrap_or_else(|| vec![axis.low, f64::midpoint(axis.low, axis.high), axis.high]);
    let labels: Vec<String> = at.into_iter().map(|at| axis.label(at)).collect();
    chart::Axis::default().bounds([axis.low, axis.high]).labels(labels)
}

/// A drawn picture as lines of text, in colour, without blanks at their ends.
fn lines(buffer: &Buffer) -> String {
    let mut text = String::new();
    for row in buffer.content().chunks(usize::from(buffer.area.width.max(1))) {
        let end = row.iter().rposition(|cell| cell.symbol() != " ").map_or(0, |last| last + 1);
        let mut style = Style::new();
        for cell in &row[..end] {
            let wanted =
                COLOURS.iter().find(|(colour, _)| *colour == cell.fg).map_or(Style::new(), |(_, style)| *style);
            if wanted != style {
                // writing to a string cannot fail
                let _ = write!(text, "{style:#}{wanted}");
                style = wanted;
            }
            text.push_str(cell.symbol());
        }
        let _ = writeln!(text, "{style:#}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::maxl::chart::Series;

    #[test]
    fn a_plot_has_its_labels_and_its_curves() {
        let series = Series::new("bound", &[(8.0, -4.0), (14.0, -0.3)]);
        let y = ("units", Scale::Decades);
        let chart = Chart::of("deviation", ("µs", Scale::PowersOfTwo), y, vec![series]);
        let text = anstream::adapter::strip_str(&draw(&chart)).to_string();
        for part in ["deviation", "bound", "256", "2048", "16384", "1e-4", "1e-2", "1e0", "units over µs"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(text.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "no line: {text}");
        assert!(text.lines().all(|line| line.chars().count() <= usize::from(WIDTH) && !line.ends_with(' ')));
    }
}
