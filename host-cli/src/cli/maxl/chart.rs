//! What `osap maxl` draws: curves over a scale each way, drawn by `plot` in a terminal and by `html` in a page.
//!
//! - **Invariant:** a curve has at most [`POINTS_MAX`] points; where there were more, the lowest and the highest of each stretch are kept, so
//!   that no peak is lost.

use super::figure;

/// Most points of a curve.
pub(super) const POINTS_MAX: usize = 4_000;

/// How values lie along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    /// Points are given as logarithms of two.
    PowersOfTwo,
    /// Points are given as logarithms of ten.
    Decades,
}

/// One axis of a chart.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) scale: Scale,
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Axis {
    /// What stands at the axis where the curve's own number is `at`; nothing between whole powers.
    pub(super) fn label(&self, at: f64) -> String {
        let is_whole = (at - at.round()).abs() < 1e-9;
        match self.scale {
            Scale::Linear => self.linear_label(at),
            Scale::PowersOfTwo if is_whole => format!("{}", at.round().exp2()),
            // 1e-3 is shorter than 0.001, and decades are read by their power
            Scale::Decades if is_whole => format!("1e{}", at.round()),
            Scale::PowersOfTwo | Scale::Decades => String::new(),
        }
    }

    /// With as many digits as tell a hundredth of the axis apart.
    fn linear_label(&self, at: f64) -> String {
        let span = self.high - self.low;
        if !(1e-6..1e7).contains(&span.max(at.abs())) {
            return figure(at);
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "-7 at least, by what it is compared with or by being an f64"
        )]
        let digits = usize::try_from(2 - span.log10().floor() as i32).unwrap_or(0).min(9);
        format!("{at:.digits$}")
    }

    /// An axis that all of `values` lie on; to whole powers where it is one of powers.
    pub(super) fn over(name: &str, scale: Scale, values: impl Iterator<Item = f64>) -> Self {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), it| (low.min(it), high.max(it)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        let (low, high) = if scale == Scale::Linear { (low, high) } else { (low.floor(), high.ceil()) };
        let (low, high) = if low < high { (low, high) } else { (low - 1.0, high + 1.0) };
        Self { name: name.to_owned(), scale, low, high }
    }
}

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Series {
    pub(super) name: String,
    pub(super) points: Vec<(f64, f64)>,
}

impl Series {
    /// A curve of these points, thinned out where they are too many.
    pub(super) fn new(name: impl Into<String>, points: &[(f64, f64)]) -> Self {
        Self { name: name.into(), points: thinned(points, POINTS_MAX) }
    }
}

/// Curves over the same axes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Chart {
    pub(super) heading: String,
    pub(super) x: Axis,
    pub(super) y: Axis,
    pub(super) series: Vec<Series>,
}

impl Chart {
    /// A chart that has room for all of `series`.
    pub(super) fn of(heading: &str, x: (&str, Scale), y: (&str, Scale), series: Vec<Series>) -> Self {
        let of = |value: fn(&(f64, f64)) -> f64| series.iter().flat_map(|it| &it.points).map(value);
        let (x, y) = (Axis::over(x.0, x.1, of(|point| point.0)), Axis::over(y.0, y.1, of(|point| point.1)));
        Self { heading: heading.to_owned(), x, y, series }
    }
}

fn thinned(points: &[(f64, f64)], most: usize) -> Vec<(f64, f64)> {
    if points.len() <= most {
        return points.to_vec();
    }
    let stretch = points.len().div_ceil(most / 2);
    let extremes = |points: &[(f64, f64)]| {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let mut pair: Vec<(f64, f64)> =
            [points.iter().min_by(by_value), points.iter().max_by(by_value)].into_iter().flatten().copied().collect();
        pair.sort_by(|a, b| a.0.total_cmp(&b.0));
        pair
    };
    points.chunks(stretch).flat_map(extremes).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_the_peaks() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|at| (f64::from(at), 1.0)).collect();
        (points[31_337].1, points[77_777].1) = (9.0, -9.0);
        let thin = Series::new("x", &points).points;
        assert!(thin.len() <= POINTS_MAX && thin.contains(&(31_337.0, 9.0)) && thin.contains(&(77_777.0, -9.0)));
        assert!(thin.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }

    #[test]
    fn axes_have_room_and_powers_are_whole() {
        let axis = Axis::over("", Scale::Decades, [-2.5, 0.2].into_iter());
        assert_eq!((axis.low, axis.high), (-3.0, 1.0));
        assert_eq!((axis.label(-3.0), axis.label(-2.5)), ("1e-3".to_owned(), String::new()));
        assert_eq!(Axis::over("", Scale::PowersOfTwo, [8.0, 14.0].into_iter()).label(11.0), "2048");
        let late = Axis::over("", Scale::Linear, [100.0, 100.5].into_iter());
        assert_eq!((late.label(100.25), late.label(100.0)), ("100.250".to_owned(), "100.000".to_owned()));
        let large = Axis::over("", Scale::Linear, [-1e9, 1e9].into_iter());
        assert_eq!(large.label(1e9), "1.00e9");
        let flat = Axis::over("", Scale::Linear, [5.0].into_iter());
        assert_eq!((flat.low, flat.high), (4.0, 6.0));
        let none = Axis::over("", Scale::Linear, std::iter::empty());
        assert_eq!((none.low, none.high), (0.0, 1.0));
    }
}
