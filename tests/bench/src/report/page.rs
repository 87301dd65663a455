//! The page of the report: errors over time with their bounds around them, and how they settle; one file without scripts.

use super::Curve;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::{
    BLUE, ChartBuilder, Color as _, IntoDrawingArea as _, LineSeries, Palette as _, Palette99, PathElement, RED,
    SVGBackend, SeriesLabelPosition, WHITE,
};
use std::fmt::Write as _;

/// Of a plot, in the page's units.
const SIZE: (u32, u32) = (960, 360);
/// Parts of a plot in time, of each of which the extremes are drawn.
const BINS: usize = 480;
/// How much of the beginning is shown on the logarithmic plot, s.
const SETTLING_S: f64 = 2.0;
/// The least error on it, µs; and the most.
const SMALLEST_US: f64 = 0.01;
const LARGEST_US: f64 = 1e5;
/// Errors outside this many times the largest bound of the later half are cut off on the linear plot.
const CUT: f64 = 1.5;

const STYLE: &str = "body{font:16px/1.4 sans-serif;margin:2em;max-width:70em}pre{overflow:auto;font-size:12px}svg{max-width:100%;height:auto}";

type Point = (f64, f64);
type Points = Vec<Point>;

/// The table, then for each row its farthest node's error with its bound, and how all its nodes settle.
pub(super) fn page(table: &str, curves: &[Curve]) -> Result<String, String> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>Clocks</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<h1>Clocks against the truth</h1>\n<pre>{}</pre>\n",
        escaped(table)
    );
    let mut names: Vec<&str> = Vec::new();
    for curve in curves.iter().filter(|curve| !curve.points.is_empty()) {
        if !names.contains(&curve.name.as_str()) {
            names.push(&curve.name);
        }
    }
    for name in names {
        let of: Vec<&Curve> = curves.iter().filter(|curve| curve.name == name && !curve.points.is_empty()).collect();
        let Some(farthest) = of.iter().max_by_key(|curve| curve.hops) else { continue };
        let error = error_and_bound(farthest).map_err(|error| error.to_string())?;
        let settling = settling(&of).map_err(|error| error.to_string())?;
        // writing to a string cannot fail
        let _ = writeln!(page, "<h2>{}</h2>\n{error}\n{settling}", escaped(name));
    }
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

/// The extremes of each part of the time, in order.
fn thinned(points: impl Iterator<Item = Point> + Clone) -> Points {
    let end = points.clone().map(|(at, _)| at).fold(0.0, f64::max);
    let mut bins: Vec<Option<(Point, Point)>> = vec![None; BINS];
    for (at, value) in points {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
        let place = if end > 0.0 { ((at / end * BINS as f64) as usize).min(BINS - 1) } else { 0 };
        let (low, high) = bins[place].get_or_insert(((at, value), (at, value)));
        if value < low.1 {
            *low = (at, value);
        }
        if value > high.1 {
            *high = (at, value);
        }
    }
    let both = bins.into_iter().flatten();
    both.flat_map(|(low, high)| if low.0 <= high.0 { [low, high] } else { [high, low] }).collect()
}

fn error_and_bound(curve: &Curve) -> Result<String, Box<dyn std::error::Error>> {
    let end = curve.points.iter().map(|(at, ..)| *at).fold(1e-3, f64::max);
    let error = thinned(curve.points.iter().map(|(at, error, _)| (*at, *error)));
    let bound = thinned(curve.points.iter().filter_map(|(at, _, bound)| Some((*at, (*bound)?))));
    let later = |points: &Points| {
        points.iter().filter(|(at, _)| *at > end / 2.0).map(|(_, value)| value.abs()).fold(0.0, f64::max)
    };
    let most = later(&bound).max(later(&error)).max(0.1) * CUT;
    let cut = |points: &Points, sign: f64| -> Points {
        points.iter().map(|(at, value)| (*at, (sign * value).clamp(-most, most))).collect()
    };
    let series = [
        ("bound", cut(&bound, 1.0), RED.mix(0.6)),
        ("", cut(&bound, -1.0), RED.mix(0.6)),
        ("error", cut(&error, 1.0), BLUE.to_rgba()),
    ];
    let caption = format!("error and bound, {} from the root, µs", steps(curve.hops));
    draw(&caption, 0.0..end, -most..most, &series)
}

fn settling(of: &[&Curve]) -> Result<String, Box<dyn std::error::Error>> {
    use plotters::prelude::IntoLogRange as _;
    let early = |curve: &Curve| {
        let points = curve.points.iter().filter(|(at, ..)| *at <= SETTLING_S);
        thinned(
            points
                .map(|(at, error, _)| (*at, error.abs().clamp(SMALLEST_US, LARGEST_US)))
                .collect::<Points>()
                .into_iter(),
        )
    };
    let series: Vec<(String, Points, _)> = of
        .iter()
        .enumerate()
        .map(|(number, curve)| (steps(curve.hops), early(curve), Palette99::pick(number).to_rgba()))
        .collect();
    let series: Vec<(&str, Points, _)> =
        series.iter().map(|(label, points, colour)| (label.as_str(), points.clone(), *colour)).collect();
    draw("settling: size of the error, µs", 0.0..SETTLING_S, (SMALLEST_US..LARGEST_US).log_scale(), &series)
}

fn steps(hops: u64) -> String {
    if hops == 1 { "1 hop".to_owned() } else { format!("{hops} hops") }
}

/// Lines over seconds, as SVG.
fn draw<Y>(
    caption: &str,
    seconds: std::ops::Range<f64>,
    values: Y,
    series: &[(&str, Points, plotters::style::RGBAColor)],
) -> Result<String, Box<dyn std::error::Error>>
where
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(caption, ("sans-serif", 16))
            .margin(10)
            .x_label_area_size(35)
            .y_label_area_size(60)
            .build_cartesian_2d(seconds, values)?;
        chart.configure_mesh().x_desc("seconds since joining").draw()?;
        for (label, points, colour) in series {
            let style = colour.stroke_width(1);
            let drawn = chart.draw_series(LineSeries::new(points.iter().copied(), style))?;
            if !label.is_empty() {
                drawn.label(*label).legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], style));
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}

/// Text as a page takes it.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However many points there are, what is drawn is no more than two a bin, and no peak is lost.
    #[test]
    fn thinning_keeps_the_extremes() {
        let points = (0..100_000).map(|n| (f64::from(n) * 1e-3, if n == 77_777 { 9.0 } else { f64::from(n % 2) }));
        let thin = thinned(points);
        assert!(thin.len() <= 2 * BINS);
        assert!(thin.contains(&(77.777, 9.0)) && thin.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }

    #[test]
    fn a_page_stands_alone() {
        let points = vec![(0.0, 40.0, None), (0.5, 1.0, Some(3.0)), (3.0, 0.2, Some(2.0))];
        let curve = Curve { name: "a < b".to_owned(), hops: 2, points };
        let page = page("rms < 1", &[curve]).unwrap();
        assert_eq!(page.matches("<svg").count(), 2);
        assert!(page.contains("a &lt; b") && !page.contains("<script") && !page.contains("src="));
        assert_eq!(page.matches("http").count(), page.matches("http://www.w3.org/2000/svg").count());
    }
}
