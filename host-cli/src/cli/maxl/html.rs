//! Pages of `osap maxl --html`: one file with its plots in it, which needs neither a network nor scripts.

use super::chart::{Axis, Chart};
use crate::cli::{CliError, Output};
use plotters::prelude::{
    BLACK, ChartBuilder, Color as _, IntoDrawingArea as _, LineSeries, Palette as _, Palette99, PathElement,
    SVGBackend, SeriesLabelPosition, WHITE,
};
use std::fmt::Write as _;
use std::path::Path;

/// Of a plot, in the page's units.
const SIZE: (u32, u32) = (960, 420);
/// Room for the numbers at the axes.
const MARGIN: u32 = 70;

const STYLE: &str =
    "body{font:16px/1.4 sans-serif;margin:2em;max-width:62em}pre{overflow:auto}svg{max-width:100%;height:auto}";

/// Writes a page of charts and tables, and says where it is.
pub(super) fn write(
    file: &Path,
    title: &str,
    charts: &[Chart],
    tables: &[(&str, String)],
    output: &mut Output<'_>,
) -> Result<(), CliError> {
    let page = page(title, charts, tables)
        .map_err(|error| CliError::file(file, "draw the page", &std::io::Error::other(error.to_string())))?;
    std::fs::write(file, page).map_err(|error| CliError::file(file, "write the page", &error))?;
    output.say(format!("The page is {}", file.display()));
    Ok(())
}

fn page(title: &str, charts: &[Chart], tables: &[(&str, String)]) -> Result<String, Box<dyn std::error::Error>> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{0}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<h1>{0}</h1>\n",
        escaped(title)
    );
    for chart in charts {
        // writing to a string cannot fail
        let _ = writeln!(page, "<h2>{}</h2>\n{}", escaped(&chart.heading), svg(chart)?);
    }
    for (heading, text) in tables {
        let _ = writeln!(page, "<h2>{}</h2>\n<pre>{}</pre>", escaped(heading), escaped(text));
    }
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

fn svg(chart: &Chart) -> Result<String, Box<dyn std::error::Error>> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let range = |axis: &Axis| axis.low..axis.high;
        let mut plot = ChartBuilder::on(&area)
            .margin(10)
            .x_label_area_size(MARGIN)
            .y_label_area_size(MARGIN)
            .build_cartesian_2d(range(&chart.x), range(&chart.y))?;
        plot.configure_mesh()
            .x_desc(&chart.x.name)
            .y_desc(&chart.y.name)
            .x_label_formatter(&|at| chart.x.label(*at))
            .y_label_formatter(&|at| chart.y.label(*at))
            .draw()?;
        for (number, series) in chart.series.iter().enumerate() {
            let colour = Palette99::pick(number).to_rgba();
            plot.draw_series(LineSeries::new(series.points.iter().copied(), colour.stroke_width(2)))?
                .label(&series.name)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        plot.configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}

/// Text as a page takes it: names come from files.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::maxl::chart::{Scale, Series};

    #[test]
    fn a_page_stands_alone_and_names_are_only_text() {
        let series = Series::new("<b>x</b>", &[(8.0, -3.0), (14.0, 0.0)]);
        let axes = (("µs", Scale::PowersOfTwo), ("units", Scale::Decades));
        let chart = Chart::of("<script>", axes.0, axes.1, vec![series]);
        let page = page("<i>", &[chart], &[("Table", "a < b".to_owned())]).unwrap();
        assert_eq!(page.matches("<svg").count(), 1);
        for wrong in ["<script", "<b>", "<i>", "src=", "href="] {
            assert!(!page.contains(wrong), "{wrong}");
        }
        assert!(page.contains("a &lt; b") && page.contains("16384") && page.contains("1e-2"));
    }
}
