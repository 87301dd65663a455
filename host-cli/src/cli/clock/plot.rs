//! The plot of `osap clock watch` in the terminal: for each device its offset and its bound over time, both on a logarithmic scale.
//!
//! - **Invariants:** the history is bounded: where it is full, every other sample is left out. Widths are given, not asked of a terminal.

use crate::cli::output::{GOOD, HINT};
use crate::clocks::Clocks;
use anstyle::Style;
use osap_protocol::discovery::TIER_FREE_RUNNING;
use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::Color;
use ratatui_core::symbols::Marker;
use ratatui_core::widgets::Widget as _;
use ratatui_widgets::chart::{Axis, Chart, Dataset, GraphType};
use std::fmt::Write as _;

/// Samples kept of each device.
const SAMPLES_MAX: usize = 4_096;
/// All of the plot, columns.
const WIDTH: u16 = 100;
/// Of one device's plot, lines: its name, the curves, the axis, the times.
const HEIGHT: u16 = 10;
/// What is smaller stands at the foot, µs: about three steps.
const LEAST_US: f64 = 0.01;

/// One device at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    /// Since the watch began.
    pub(super) at_s: f64,
    /// To the neighbour it has its time from; `None` for a root.
    pub(super) offset_us: Option<f64>,
    /// `None` where there is none.
    pub(super) bound_us: Option<f64>,
    /// Of system time against its own counter.
    pub(super) skew_ppm: f64,
}

/// What was seen so far.
#[derive(Debug)]
pub(super) struct History {
    /// A row for each device.
    pub(super) devices: Vec<Vec<Sample>>,
    /// Of so many looks one is kept.
    every: usize,
    looks: usize,
}

impl History {
    pub(super) fn of(devices: usize) -> Self {
        Self { devices: vec![Vec::new(); devices], every: 1, looks: 0 }
    }

    /// Takes one look in, `at_s` seconds after the first.
    pub(super) fn push(&mut self, at_s: f64, clocks: &Clocks) {
        let look = self.looks;
        self.looks += 1;
        if !look.is_multiple_of(self.every) {
            return;
        }
        for (row, clock) in self.devices.iter_mut().zip(&clocks.devices) {
            let Ok(clock) = clock else { continue };
            let has_source = clock.status.tier != 0 && clock.status.tier != TIER_FREE_RUNNING;
            let us = |steps: i32| f64::from(steps) / 256.0;
            row.push(Sample {
                at_s,
                offset_us: has_source.then(|| us(clock.control.offset_steps)),
                bound_us: (clock.control.bound_steps >= 0).then(|| us(clock.control.bound_steps)),
                skew_ppm: f64::from(clock.control.skew_ppb) / 1e3,
            });
        }
        if self.devices.iter().any(|row| row.len() >= SAMPLES_MAX) {
            self.every *= 2;
            for row in &mut self.devices {
                let mut number = 0;
                row.retain(|_| {
                    number += 1;
                    number % 2 == 1
                });
            }
        }
    }

    /// From the first to the last sample of all devices, s.
    pub(super) fn end_s(&self) -> f64 {
        self.devices.iter().flatten().map(|sample| sample.at_s).fold(0.0, f64::max)
    }

    /// The whole decades that all offsets and bounds lie in, as logarithms of µs.
    pub(super) fn decades(&self) -> (f64, f64) {
        let values = self.devices.iter().flatten().flat_map(|it| [it.offset_us, it.bound_us]).flatten();
        let logs: Vec<f64> = values.map(log).collect();
        let low = logs.iter().copied().fold(f64::INFINITY, f64::min).floor();
        let high = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max).ceil();
        if low < high { (low, high) } else { (-1.0, 1.0) }
    }
}

/// The logarithm of a size in µs.
pub(super) fn log(us: f64) -> f64 {
    us.abs().max(LEAST_US).log10()
}

/// A power of ten of µs, for an axis.
pub(super) fn decade(log: f64) -> String {
    let us = 10f64.powf(log);
    match log {
        _ if log >= 6.0 => format!("{} s", us / 1e6),
        _ if log >= 3.0 => format!("{} ms", us / 1e3),
        _ => format!("{us} µs"),
    }
}

/// One plot for each device that has something to show, side by side.
pub(super) fn draw(labels: &[String], history: &History) -> String {
    let shown: Vec<(&String, &Vec<Sample>)> =
        labels.iter().zip(&history.devices).filter(|(_, row)| row.iter().any(|it| it.offset_us.is_some())).collect();
    let columns = match shown.len() {
        0 => return String::new(),
        1 => 1,
        2..=4 => 2,
        _ => 3,
    };
    let (low, high) = history.decades();
    let frame = Frame { end_s: history.end_s().max(1e-3), low, high };
    let mut text = format!("{HINT}•{HINT:#} offset to the neighbour it follows, {GOOD}⠒{GOOD:#} bound, over time\n");
    for row in shown.chunks(usize::from(columns)) {
        let mut buffer = Buffer::empty(Rect::new(0, 0, WIDTH, HEIGHT));
        for (column, (label, samples)) in (0u16..).zip(row) {
            let width = WIDTH / columns;
            frame.draw(label, samples, Rect::new(column * width, 0, width - 1, HEIGHT), &mut buffer);
        }
        text.push_str(&lines(&buffer));
    }
    text
}

/// The scale that all plots share.
struct Frame {
    end_s: f64,
    low: f64,
    high: f64,
}

impl Frame {
    fn draw(&self, label: &str, samples: &[Sample], area: Rect, buffer: &mut Buffer) {
        let of = |value: fn(&Sample) -> Option<f64>| {
            let points = samples.iter().filter_map(move |it| Some((it.at_s, log(value(it)?))));
            points.collect::<Vec<(f64, f64)>>()
        };
        let (bounds, offsets) = (of(|it| it.bound_us), of(|it| it.offset_us));
        let bound = Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).data(&bounds);
        let offset = Dataset::default().marker(Marker::Dot).graph_type(GraphType::Scatter).data(&offsets);
        let datasets = vec![bound.style(Color::Green), offset.style(Color::Cyan)];
        let middle = f64::midpoint(self.low, self.high);
        let chart = Chart::new(datasets)
            .x_axis(
                Axis::default().bounds([0.0, self.end_s]).labels(["0 s".to_owned(), format!("{:.1} s", self.end_s)]),
            )
            .y_axis(Axis::default().bounds([self.low, self.high]).labels([
                decade(self.low),
                if middle.fract() == 0.0 { decade(middle) } else { String::new() },
                decade(self.high),
            ]))
            .legend_position(None);
        let [name, curves] = [Rect { height: 1, ..area }, Rect { y: area.y + 1, height: area.height - 1, ..area }];
        chart.render(curves, buffer);
        buffer.set_stringn(name.x, name.y, label, usize::from(name.width), Color::Reset);
    }
}

/// A drawn picture as lines of text, in colour, without blanks at their ends.
fn lines(buffer: &Buffer) -> String {
    let mut text = String::new();
    for row in buffer.content().chunks(usize::from(buffer.area.width.max(1))) {
        let end = row.iter().rposition(|cell| cell.symbol() != " ").map_or(0, |last| last + 1);
        let mut style = Style::new();
        for cell in &row[..end] {
            let wanted = match cell.fg {
                Color::Green => GOOD,
                Color::Cyan => HINT,
                _ => Style::new(),
            };
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

    fn history(values: &[(f64, f64)]) -> History {
        let sample = |(number, (offset, bound)): (u32, &(f64, f64))| Sample {
            at_s: f64::from(number),
            offset_us: Some(*offset),
            bound_us: Some(*bound),
            skew_ppm: 0.0,
        };
        History { devices: vec![(0u32..).zip(values).map(sample).collect()], every: 1, looks: 0 }
    }

    #[test]
    fn a_plot_has_its_name_its_decades_and_both_curves() {
        let seen = history(&[(-80.0, 200.0), (9.0, 30.0), (0.4, 3.0)]);
        assert_eq!(seen.decades(), (-1.0, 3.0));
        let text = anstream::adapter::strip_str(&draw(&["A Motor".to_owned()], &seen)).to_string();
        for part in ["A Motor", "0.1 µs", "10 µs", "1 ms", "2.0 s", "•"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(text.chars().any(|c| ('\u{2801}'..='\u{28ff}').contains(&c)), "no line: {text}");
        assert!(text.lines().all(|line| line.chars().count() <= usize::from(WIDTH) && !line.ends_with(' ')));
    }

    #[test]
    fn who_follows_nobody_has_no_plot() {
        let mut seen = history(&[(0.0, 0.0)]);
        seen.devices[0][0].offset_us = None;
        assert_eq!(draw(&["host".to_owned()], &seen), "");
    }

    #[test]
    fn a_long_watch_keeps_every_other_sample() {
        let mut seen = History::of(1);
        let clocks =
            Clocks { at: fixed_math::time::LocalTicks::ZERO, devices: vec![Ok(crate::clocks::DeviceClock::example())] };
        for number in 0..3 * SAMPLES_MAX {
            #[expect(clippy::cast_precision_loss, reason = "a few thousand")]
            seen.push(number as f64, &clocks);
        }
        assert!(seen.devices[0].len() < SAMPLES_MAX && seen.devices[0].len() > SAMPLES_MAX / 4);
        assert!(seen.devices[0].windows(2).all(|pair| pair[0].at_s < pair[1].at_s));
    }
}
