//! Times and fractions as people give them: `5us`, `50ms`, `500ppm`, `0.25`.
//!
//! - **Invariant:** what is read is within its range, and a number without its unit is never guessed at, but where seconds are all that
//!   makes sense.

use fixed_math::time::Span;

/// Longest time that may be given, µs: a day.
const US_MAX: f64 = 86_400.0 * 1e6;

/// A time with its unit: ns, us or µs, ms, s.
pub(super) fn parse_span(text: &str) -> Result<Span, String> {
    let us = microseconds(text)?.ok_or_else(|| format!("expected a time with its unit, such as 5us, not {text:?}"))?;
    if (0.0..=US_MAX).contains(&us) { Ok(span(us)) } else { Err("expected a time of 0 to a day".to_owned()) }
}

/// The same, where a bare number is seconds.
pub(super) fn parse_seconds(text: &str) -> Result<Span, String> {
    if text.parse::<f64>().is_ok() { parse_span(&format!("{text}s")) } else { parse_span(text) }
}

/// The same, and it may be negative: 1/256 µs.
pub(super) fn parse_signed_steps(text: &str) -> Result<i32, String> {
    let us = microseconds(text)?.ok_or_else(|| format!("expected a time with its unit, such as 12us, not {text:?}"))?;
    whole(us * 256.0).ok_or_else(|| "expected a time of at most ±8 s".to_owned())
}

/// A rate: ppm or ppb, as parts per 10⁹.
pub(super) fn parse_ppb(text: &str) -> Result<i32, String> {
    let units = [("ppm", 1e3), ("ppb", 1.0)];
    let value = scaled(text, &units)?.ok_or_else(|| format!("expected ppm or ppb, such as 500ppm, not {text:?}"))?;
    whole(value).ok_or_else(|| "expected a rate of at most ±2 parts".to_owned())
}

/// A factor, as 1/65,536.
pub(super) fn parse_q16(text: &str) -> Result<i32, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number, such as 0.25, not {text:?}"))?;
    whole(value * 65_536.0).ok_or_else(|| "expected a number of at most ±32767".to_owned())
}

fn microseconds(text: &str) -> Result<Option<f64>, String> {
    scaled(text, &[("ns", 1e-3), ("us", 1.0), ("µs", 1.0), ("μs", 1.0), ("ms", 1e3), ("s", 1e6)])
}

/// The number before the first of these units that `text` ends in, times what the unit is; `None` without a unit.
fn scaled(text: &str, units: &[(&str, f64)]) -> Result<Option<f64>, String> {
    let Some((number, factor)) = units.iter().find_map(|(unit, factor)| Some((text.strip_suffix(unit)?, factor)))
    else {
        return Ok(None);
    };
    let value: f64 = number.trim().parse().map_err(|_| format!("{:?} is no number", number.trim()))?;
    Ok(Some(value * factor))
}

/// The nearest of 32 bits, if it is one.
fn whole(value: f64) -> Option<i32> {
    let rounded = value.round();
    let fits = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&rounded);
    #[expect(clippy::cast_possible_truncation, reason = "it is whole and within 32 bits")]
    fits.then_some(rounded as i32)
}

fn span(us: f64) -> Span {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is not negative and below a day")]
    Span::from_steps((us * 256.0).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_their_units() {
        for (text, us) in [("5us", 5), ("5µs", 5), ("5 us", 5), ("0.5ms", 500), ("10s", 10_000_000), ("3000ns", 3)] {
            assert_eq!(parse_span(text), Ok(Span::from_us(us)), "{text}");
        }
        for wrong in ["5", "", "us", "-1us", "NaNs", "infs", "1e9s", "5m"] {
            assert!(parse_span(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_seconds("2.5"), Ok(Span::from_us(2_500_000)));
        assert_eq!(parse_seconds("20ms"), Ok(Span::from_us(20_000)));
        assert_eq!(parse_signed_steps("-12us"), Ok(-12 * 256));
        assert!(parse_signed_steps("9s").is_err());
    }

    #[test]
    fn rates_and_factors_are_rounded_to_what_goes_over_the_wire() {
        assert_eq!((parse_ppb("500ppm"), parse_ppb("7ppb")), (Ok(500_000), Ok(7)));
        assert!(parse_ppb("500").is_err());
        assert_eq!((parse_q16("0.25"), parse_q16("1")), (Ok(16_384), Ok(65_536)));
        assert!(parse_q16("1e9").is_err() && parse_q16("a").is_err());
    }
}
