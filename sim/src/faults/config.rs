//! What a fault layer shall do, and its text for command lines: `loss=0.01,dup=0.001,delay=200us,seed=7`.
//!
//! - **Walk:** `--faults TEXT` → [`FaultConfig`] → [`FaultLayer::new`](super::FaultLayer::new).
//! - **Invariant:** what is shown parses back to the same configuration.
//! - **Clause:** `[LNK-07]`.
//!
//! ```
//! use osap_sim::faults::FaultConfig;
//!
//! let config: FaultConfig = "loss=0.01,delay=200us,bandwidth=3M".parse()?;
//! assert_eq!(config.to_string(), "loss=0.01,delay=200us,bandwidth=3M");
//! let error = "loss=2".parse::<FaultConfig>().unwrap_err();
//! assert_eq!(error.to_string(), "loss=2: allowed is a probability from 0 to 1");
//! # Ok::<(), osap_sim::faults::FaultConfigError>(())
//! ```

use fixed_math::time::{FRACTION_BITS, Span};
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// The faults of one direction of a link. The default has none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaultConfig {
    /// Probability that a frame is lost.
    pub loss: f64,
    /// Probability that a frame comes twice.
    pub duplication: f64,
    /// Probability that a frame is held back until others went past.
    pub reorder: f64,
    /// Time added to every frame.
    pub delay: Span,
    /// Most that is added to the delay; uniform.
    pub jitter: Span,
    /// Probability that a bit flips.
    pub bit_error_rate: f64,
    /// Bits a second; `None` for no limit.
    pub bandwidth_bits_s: Option<u64>,
    /// Seed of all draws.
    pub seed: u64,
}

impl FaultConfig {
    /// The same faults with draws of their own, for one of several directions that share a seed.
    #[must_use]
    pub const fn for_stream(self, stream: u64) -> Self {
        // The step of SplitMix64: distinct streams of one seed have distinct seeds, since the factor is odd.
        let seed = self.seed ^ stream.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        Self { seed, ..self }
    }
}

/// Why a text is not a [`FaultConfig`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultConfigError {
    /// None of the keys there are.
    #[error("{key}: no such fault; there are {KEYS}")]
    UnknownKey {
        /// As given.
        key: String,
    },
    /// No `=`.
    #[error("{part}: a fault is written as key=value, such as loss=0.01")]
    NoValue {
        /// As given.
        part: String,
    },
    /// A value that its key does not allow.
    #[error("{key}={value}: allowed is {allowed}")]
    Value {
        /// As given.
        key: String,
        /// As given.
        value: String,
        /// What would do.
        allowed: &'static str,
    },
    /// Given before in the same text.
    #[error("{key} is given twice")]
    Twice {
        /// Which.
        key: String,
    },
}

const KEYS: &str = "loss, dup, reorder, delay, jitter, ber, bandwidth and seed";
const PROBABILITY: &str = "a probability from 0 to 1";
const TIME: &str = "a time from 0 to 1h with its unit: us, ms or s, such as 200us";
const BANDWIDTH: &str = "bits a second from 1, with k, M or G where wanted, such as 3M";
const SEED: &str = "a whole number below 2^64";

/// Longest delay and jitter, an hour: text that says more is a slip.
const TIME_US_MAX: f64 = 3.6e9;
/// Steps of a [`Span`] in a microsecond.
const STEPS_A_US: f64 = (1_u32 << FRACTION_BITS) as f64;

impl FromStr for FaultConfig {
    type Err = FaultConfigError;

    /// Parts are separated by commas; `none`, or nothing, is no fault at all.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut config = Self::default();
        if matches!(text.trim(), "" | "none") {
            return Ok(config);
        }
        let mut seen = Vec::new();
        for part in text.split(',').map(str::trim) {
            let Some((key, value)) = part.split_once('=') else {
                return Err(FaultConfigError::NoValue { part: part.to_owned() });
            };
            if seen.contains(&key) {
                return Err(FaultConfigError::Twice { key: key.to_owned() });
            }
            seen.push(key);
            config.set(key, value)?;
        }
        Ok(config)
    }
}

impl FaultConfig {
    fn set(&mut self, key: &str, value: &str) -> Result<(), FaultConfigError> {
        let unless = |allowed| FaultConfigError::Value { key: key.to_owned(), value: value.to_owned(), allowed };
        match key {
            "loss" => self.loss = probability(value).ok_or_else(|| unless(PROBABILITY))?,
            "dup" => self.duplication = probability(value).ok_or_else(|| unless(PROBABILITY))?,
            "reorder" => self.reorder = probability(value).ok_or_else(|| unless(PROBABILITY))?,
            "ber" => self.bit_error_rate = probability(value).ok_or_else(|| unless(PROBABILITY))?,
            "delay" => self.delay = time(value).ok_or_else(|| unless(TIME))?,
            "jitter" => self.jitter = time(value).ok_or_else(|| unless(TIME))?,
            "bandwidth" => self.bandwidth_bits_s = Some(bandwidth(value).ok_or_else(|| unless(BANDWIDTH))?),
            "seed" => self.seed = value.parse().map_err(|_| unless(SEED))?,
            _ => return Err(FaultConfigError::UnknownKey { key: key.to_owned() }),
        }
        Ok(())
    }
}

fn probability(value: &str) -> Option<f64> {
    value.parse().ok().filter(|p| (0.0..=1.0).contains(p))
}

/// To the nearest 1/256 µs.
fn time(value: &str) -> Option<Span> {
    let units = [("us", 1.0), ("ms", 1e3), ("s", 1e6)];
    let (number, us) = units.iter().find_map(|(unit, us)| Some((value.strip_suffix(unit)?, us)))?;
    let us = number.parse::<f64>().ok()? * us;
    if !(0.0..=TIME_US_MAX).contains(&us) {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 3.6e9 × 256")]
    Some(Span::from_steps((us * STEPS_A_US).round() as u64))
}

/// Whole numbers only, so that what is shown is what was set.
fn bandwidth(value: &str) -> Option<u64> {
    let (number, factor) = MULTIPLES
        .iter()
        .find_map(|(letter, factor)| Some((value.strip_suffix(*letter)?, *factor)))
        .unwrap_or((value, 1));
    number.parse::<u64>().ok()?.checked_mul(factor).filter(|bits_s| *bits_s > 0)
}

/// Largest first, for the shortest text.
const MULTIPLES: [(char, u64); 3] = [('G', 1_000_000_000), ('M', 1_000_000), ('k', 1_000)];

impl Display for FaultConfig {
    /// Only what differs from no fault at all; `none` where nothing does.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        for (key, p) in [("loss", self.loss), ("dup", self.duplication), ("reorder", self.reorder)] {
            parts.extend((p != 0.0).then(|| format!("{key}={p}")));
        }
        for (key, span) in [("delay", self.delay), ("jitter", self.jitter)] {
            #[expect(clippy::cast_precision_loss, reason = "exact below 2^53 steps, over a thousand years")]
            let us = span.steps() as f64 / STEPS_A_US;
            parts.extend((span > Span::ZERO).then(|| format!("{key}={us}us")));
        }
        parts.extend((self.bit_error_rate != 0.0).then(|| format!("ber={}", self.bit_error_rate)));
        parts.extend(self.bandwidth_bits_s.map(|bits_s| format!("bandwidth={}", shown_bandwidth(bits_s))));
        parts.extend((self.seed != 0).then(|| format!("seed={}", self.seed)));
        f.write_str(if parts.is_empty() { "none" } else { "" })?;
        f.write_str(&parts.join(","))
    }
}

fn shown_bandwidth(bits_s: u64) -> String {
    let exact = |(_, factor): &&(char, u64)| bits_s >= *factor && bits_s.is_multiple_of(*factor);
    match MULTIPLES.iter().find(exact) {
        Some((letter, factor)) => format!("{}{letter}", bits_s / factor),
        None => bits_s.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_key_sets_its_field() {
        let text = "loss=0.01,dup=0.001,reorder=0.02,delay=200us,jitter=1.5ms,ber=1e-6,bandwidth=115200,seed=7";
        let want = FaultConfig {
            loss: 0.01,
            duplication: 0.001,
            reorder: 0.02,
            delay: Span::from_us(200),
            jitter: Span::from_us(1_500),
            bit_error_rate: 1e-6,
            bandwidth_bits_s: Some(115_200),
            seed: 7,
        };
        assert_eq!(text.parse(), Ok(want));
        assert_eq!("none".parse(), Ok(FaultConfig::default()));
        assert_eq!(FaultConfig::default().to_string(), "none");
    }

    /// Each names the key, the value and what is allowed.
    #[test]
    fn errors_say_what_would_do() {
        let said = |text: &str| text.parse::<FaultConfig>().unwrap_err().to_string();
        assert_eq!(said("loss=nan"), "loss=nan: allowed is a probability from 0 to 1");
        assert_eq!(said("delay=5"), format!("delay=5: allowed is {TIME}"));
        assert_eq!(said("delay=-1us"), format!("delay=-1us: allowed is {TIME}"));
        assert_eq!(said("bandwidth=0"), format!("bandwidth=0: allowed is {BANDWIDTH}"));
        assert_eq!(said("seed=-1"), format!("seed=-1: allowed is {SEED}"));
        assert_eq!(said("lose=0.1"), format!("lose: no such fault; there are {KEYS}"));
        assert_eq!(said("loss"), "loss: a fault is written as key=value, such as loss=0.01");
        assert_eq!(said("loss=0,loss=1"), "loss is given twice");
    }

    #[test]
    fn streams_of_one_seed_differ() {
        let config = FaultConfig { seed: 5, ..FaultConfig::default() };
        let mut seeds: Vec<u64> = (0..128).map(|stream| config.for_stream(stream).seed).collect();
        seeds.push(config.seed);
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!(seeds.len(), 129);
    }

    proptest! {
        #[test]
        fn what_is_shown_parses_back(
            p in proptest::array::uniform4(0.0..=1.0),
            delay in 0u64..1 << 39,
            jitter in 0u64..1 << 39,
            bandwidth_bits_s in proptest::option::of(1u64..),
            seed: u64,
        ) {
            let config = FaultConfig {
                loss: p[0],
                duplication: p[1],
                reorder: p[2],
                delay: Span::from_steps(delay),
                jitter: Span::from_steps(jitter),
                bit_error_rate: p[3],
                bandwidth_bits_s,
                seed,
            };
            prop_assert_eq!(config.to_string().parse(), Ok(config));
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,40}") {
            let _ = text.parse::<FaultConfig>();
        }
    }
}
