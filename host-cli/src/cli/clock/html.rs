//! The page of `osap clock watch --html`: one file with its plots in it, which needs neither a network nor scripts.

use super::plot::{History, Sample, decade, log};
use crate::cli::table::Table;
use plotters::prelude::{
    BLACK, ChartBuilder, Color as _, IntoDrawingArea as _, LineSeries, Palette as _, Palette99, PathElement,
    SVGBackend, SeriesLabelPosition, WHITE,
};
use std::fmt::Write as _;

/// Of a plot, in the page's units.
const SIZE: (u32, u32) = (960, 420);
/// Room for the numbers at the axes.
const MARGIN: u32 = 70;

const STYLE: &str =
    "body{font:16px/1.4 sans-serif;margin:2em;max-width:62em}pre{overflow:auto}svg{max-width:100%;height:auto}";

/// What one curve shows of a sample.
type Value = fn(&Sample) -> Option<f64>;

/// The lowest and the highest decade of an axis.
type Decades = (f64, f64);

/// The page: plots of all devices together, then the tables as they were last.
pub(super) fn page(
    title: &str,
    labels: &[String],
    history: &History,
    tables: &[(&str, Table)],
) -> Result<String, String> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{0}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<h1>{0}</h1>\n",
        escaped(title)
    );
    let decades = history.decades();
    let plots: [(&str, Value, Option<Decades>); 3] = [
        ("Published bound", |it| it.bound_us, Some(decades)),
        ("Offset to the neighbour it follows, without its sign", |it| it.offset_us, Some(decades)),
        ("Skew of system time against the own counter, ppm", |it| Some(it.skew_ppm), None),
    ];
    for (heading, value, log_range) in plots {
        let curves: Vec<Vec<(f64, f64)>> = history
            .devices
            .iter()
            .map(|row| {
                let shown = row.iter().filter_map(|it| Some((it.at_s, value(it)?)));
                shown.map(|(at, value)| (at, if log_range.is_some() { log(value) } else { value })).collect()
            })
            .collect();
        let svg = plot(labels, &curves, history.end_s(), log_range).map_err(|error| error.to_string())?;
        // writing to a string cannot fail
        let _ = writeln!(page, "<h2>{heading}</h2>\n{svg}");
    }
    for (heading, table) in tables {
        let _ = writeln!(page, "<h2>{heading}</h2>\n<pre>{}</pre>", escaped(&table.plain()));
    }
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

/// Curves over time with a legend, as SVG; on decades of µs where `log_range` tells them.
fn plot(
    labels: &[String],
    curves: &[Vec<(f64, f64)>],
    end_s: f64,
    log_range: Option<Decades>,
) -> Result<String, Box<dyn std::error::Error>> {
    let values = || curves.iter().flatten().map(|(_, value)| *value);
    let (low, high) = log_range.unwrap_or_else(|| {
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        if low <= high { (low - 1.0, high + 1.0) } else { (-1.0, 1.0) }
    });
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(10)
            .x_label_area_size(MARGIN / 2)
            .y_label_area_size(MARGIN)
            .build_cartesian_2d(0.0..end_s.max(1e-3), low..high)?;
        let number = |value: &f64| if log_range.is_some() { nice_decade(*value) } else { format!("{value:.1}") };
        chart.configure_mesh().x_desc("seconds").y_label_formatter(&number).draw()?;
        for (number, (label, curve)) in
            labels.iter().zip(curves).enumerate().filter(|(_, (_, curve))| !curve.is_empty())
        {
            let colour = Palette99::pick(number).to_rgba();
            chart
                .draw_series(LineSeries::new(curve.iter().copied(), colour.stroke_width(2)))?
                .label(label)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}

/// Whole decades by their names, what lies between by none.
fn nice_decade(log: f64) -> String {
    if (log - log.round()).abs() < 1e-9 { decade(log.round()) } else { String::new() }
}

/// Text as a page takes it: names come from devices.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::table::Align;

    #[test]
    fn a_page_stands_alone_and_a_devices_name_is_only_text() {
        let mut history = History::of(1);
        let at = |at_s: f64| Sample { at_s, offset_us: Some(-3.0), bound_us: Some(9.0), skew_ppm: 40.0 };
        history.devices[0] = vec![at(0.0), at(1.0)];
        let mut table = Table::new([("device", Align::Left)]);
        table.row(["<script>alert(1)</script>"]);
        let page = page("clocks", &["<b>hub</b>".to_owned()], &history, &[("Last", table)]).unwrap();
        assert_eq!(page.matches("<svg").count(), 3);
        assert!(
            !page.contains("<script") && !page.contains("<b>") && !page.contains("src=") && !page.contains("href=")
        );
        // the one address in it is the name of SVG itself
        assert_eq!(page.matches("http").count(), page.matches("http://www.w3.org/2000/svg").count());
        assert!(page.contains("10 µs"));
    }
}
