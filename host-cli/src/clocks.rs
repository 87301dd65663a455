//! The clocks of a network's devices: read all at once, and judged together.
//!
//! - **Walk:** a map → [`Session::read_clocks`] → [`Clocks`] → [`Clocks::unsettled`], the gate that a machine waits at before it starts.
//! - **Invariants:** who does not answer is in it too, with the reason. What the host measures itself comes with its own doubt: half the
//!   round trip of the question.
//! - **Context:** the caller's thread. **Clauses:** `[DSC-07]`, `[TIM-06]`, `[TIM-09]`, `[TIM-12]`.
//!
//! ```
//! use fixed_math::time::Span;
//! use osap::scan::ScanOptions;
//! use osap::session::Session;
//!
//! let mut session = Session::open(&["sim:line:2".parse()?], &Default::default())?;
//! let map = session.scan(&ScanOptions::default(), &mut |_| {})?.map;
//! session.network().pause(Span::from_us(1_000_000))?;
//! let clocks = session.read_clocks(&map)?;
//! assert!(clocks.unsettled(Span::from_us(1_000)).is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::error::{AskError, NetworkError};
use crate::map::{Device, NetworkMap};
use crate::session::{Answer, Session};
use fixed_math::time::{LocalTicks, NetTime, Span};
use osap_protocol::DropCause;
use osap_protocol::discovery::{
    CounterPage, GatewayKind, Query, TIER_FREE_RUNNING, TimeControl, TimeLink, TimeStatus, UniqueId,
};
use osap_runtime::sequenced::Destination;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// The clocks of all devices of a map, as of one time.
#[derive(Debug)]
pub struct Clocks {
    /// When they were asked, by the host's clock.
    pub at: LocalTicks,
    /// One for each device of the map, in its order: the host first.
    pub devices: Vec<Result<DeviceClock, AskError>>,
}

/// What one device says about its clock, and what the host makes of it.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceClock {
    /// What it follows.
    pub status: TimeStatus,
    /// How well.
    pub control: TimeControl,
    /// What it knows of the clock at each open link's other end.
    pub links: Vec<LinkClock>,
    /// Replies about time that it refused.
    pub refused: TimeDrops,
    /// Its system time against the host's; `None` for the host itself, and where the two do not follow one root.
    pub measured: Option<Measured>,
}

/// What a device knows of the clock at a gateway's other end.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LinkClock {
    /// Which gateway.
    pub gateway: u8,
    /// What it knows.
    #[serde(flatten)]
    pub link: TimeLink,
}

/// Replies about time that were dropped, by what was wrong with them, `[TIM-06]`, `[TIM-08]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TimeDrops {
    /// Nobody had asked for them.
    pub unasked: u32,
    /// Their stamps ran backwards.
    pub order: u32,
    /// They were too far off.
    pub absurd: u32,
    /// They contradicted themselves.
    pub tier: u32,
}

impl TimeDrops {
    /// Of all kinds.
    #[must_use]
    pub const fn total(self) -> u32 {
        self.unasked.saturating_add(self.order).saturating_add(self.absurd).saturating_add(self.tier)
    }
}

/// A device's system time less the host's, by one question and its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Measured {
    /// Taken at the middle of the round trip, 1/256 µs.
    pub offset_steps: i64,
    /// Half the round trip: the truth is no further from it than that, 1/256 µs.
    pub within_steps: u64,
}

/// Why a device's time is not to be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsettled {
    /// It did not answer.
    Silent,
    /// It follows nobody.
    NoRoot,
    /// It follows another root than most.
    OtherRoot {
        /// Whom.
        root: UniqueId,
    },
    /// Too few exchanges yet.
    NotSettled,
    /// It publishes no bound.
    NoBound,
    /// Its bound is wider than was asked for.
    Wide {
        /// How wide.
        bound: Span,
    },
}

impl fmt::Display for Unsettled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => f.write_str("no answer"),
            Self::NoRoot => f.write_str("follows no root"),
            Self::OtherRoot { root } => write!(f, "follows another root, {root}"),
            Self::NotSettled => f.write_str("not settled"),
            Self::NoBound => f.write_str("no bound can be given"),
            Self::Wide { bound } => write!(f, "bound too wide, {}", micros(steps_of(*bound))),
        }
    }
}

impl DeviceClock {
    /// Its greatest possible error, `[TIM-09]`; `None` where there is none.
    #[must_use]
    pub fn bound(&self) -> Option<Span> {
        u64::try_from(self.control.bound_steps).ok().map(Span::from_steps)
    }

    /// What keeps it from being relied on to `within`, in a network whose root is `root`.
    fn unsettled(&self, root: Option<UniqueId>, within: Span) -> Option<Unsettled> {
        if self.status.tier == TIER_FREE_RUNNING {
            return Some(Unsettled::NoRoot);
        }
        if Some(self.status.root) != root {
            return Some(Unsettled::OtherRoot { root: self.status.root });
        }
        if !self.status.is_settled {
            return Some(Unsettled::NotSettled);
        }
        match self.bound() {
            None => Some(Unsettled::NoBound),
            Some(bound) if bound > within => Some(Unsettled::Wide { bound }),
            Some(_) => None,
        }
    }
}

impl Clocks {
    /// The root that most devices follow, among equals the one of the lowest id.
    #[must_use]
    pub fn root(&self) -> Option<UniqueId> {
        let mut votes = BTreeMap::<UniqueId, usize>::new();
        let following = self.devices.iter().flatten().filter(|clock| clock.status.tier != TIER_FREE_RUNNING);
        for clock in following {
            *votes.entry(clock.status.root).or_default() += 1;
        }
        // the last of equals wins here, so the lowest id has to come last
        votes.into_iter().rev().max_by_key(|(_, votes)| *votes).map(|(root, _)| root)
    }

    /// Devices, by their numbers in the map, that do not follow the common root with a bound of at most `within`, and why.
    #[must_use]
    pub fn unsettled(&self, within: Span) -> Vec<(usize, Unsettled)> {
        let root = self.root();
        let why = |clock: &Result<DeviceClock, AskError>| match clock {
            Ok(clock) => clock.unsettled(root, within),
            Err(_) => Some(Unsettled::Silent),
        };
        self.devices.iter().enumerate().filter_map(|(number, clock)| Some((number, why(clock)?))).collect()
    }

    /// The widest bound, and whose it is; `None` where any has none.
    #[must_use]
    pub fn widest(&self) -> Option<(usize, Span)> {
        let bounds = self.devices.iter().map(|clock| clock.as_ref().ok().and_then(DeviceClock::bound));
        let all: Option<Vec<Span>> = bounds.collect();
        all?.into_iter().enumerate().max_by_key(|(_, bound)| *bound)
    }
}

impl Session {
    /// Asks all devices of `map` for their clocks.
    ///
    /// # Errors
    /// [`NetworkError`]; who does not answer stands in his place.
    pub fn read_clocks(&mut self, map: &NetworkMap) -> Result<Clocks, NetworkError> {
        let at = self.network().now();
        let to: Vec<Destination> = map.devices.iter().map(|device| self.destination_of(device)).collect();
        let of_all = |body| to.iter().map(|to| (to.clone(), body)).collect::<Vec<_>>();
        let controls: Vec<Result<Answer<TimeControl>, AskError>> =
            self.ask_many(Query::TimeControl, &of_all_unit(&to))?;
        let statuses: Vec<Result<Answer<TimeStatus>, AskError>> =
            self.ask_many(Query::TimeStatus, &of_all_unit(&to))?;
        let first = u8::try_from(DropCause::TimeUnasked.index()).unwrap_or(u8::MAX);
        let counters: Vec<Result<Answer<CounterPage>, AskError>> = self.ask_many(Query::Counters, &of_all(first))?;
        let mut links = self.read_link_clocks(map, &to)?;

        let mut devices = Vec::new();
        for (number, ((control, status), counters)) in controls.into_iter().zip(statuses).zip(counters).enumerate() {
            let links = links.remove(&number).unwrap_or(Ok(Vec::new()));
            devices.push((|| {
                let (control, status, links) = (control?, status?.value, links?);
                let instant = Instant { arrived: control.arrived, round_trip: control.round_trip };
                let clock = DeviceClock {
                    status,
                    control: control.value,
                    links,
                    refused: drops_of(&counters?.value),
                    measured: None,
                };
                Ok((clock, instant))
            })());
        }
        let devices = self.measure(devices)?;
        Ok(Clocks { at, devices })
    }

    /// What the devices know of their neighbours, by their numbers.
    fn read_link_clocks(
        &mut self,
        map: &NetworkMap,
        to: &[Destination],
    ) -> Result<BTreeMap<usize, Result<Vec<LinkClock>, AskError>>, NetworkError> {
        let open = |device: &Device| {
            let links = device.gateways.iter().filter(|it| it.open && it.kind == GatewayKind::Link);
            links.map(|gateway| gateway.index).collect::<Vec<u8>>()
        };
        let gateways = map
            .devices
            .iter()
            .enumerate()
            .flat_map(|(number, device)| open(device).into_iter().map(move |gateway| (number, gateway)));
        let gateways: Vec<(usize, u8)> = gateways.collect();
        let questions: Vec<_> = gateways.iter().map(|(number, gateway)| (to[*number].clone(), *gateway)).collect();
        let answers: Vec<Result<Answer<TimeLink>, AskError>> = self.ask_many(Query::TimeLink, &questions)?;
        let mut links = BTreeMap::new();
        for ((number, gateway), answer) in gateways.into_iter().zip(answers) {
            let of_device = links.entry(number).or_insert_with(|| Ok(Vec::new()));
            match (&mut *of_device, answer) {
                (Ok(known), Ok(answer)) => known.push(LinkClock { gateway, link: answer.value }),
                (Ok(_), Err(error)) => *of_device = Err(error),
                (Err(_), _) => {}
            }
        }
        Ok(links)
    }

    /// Compares each device's system time with the host's at the middle of the question's round trip.
    fn measure(
        &mut self,
        devices: Vec<Result<(DeviceClock, Instant), AskError>>,
    ) -> Result<Vec<Result<DeviceClock, AskError>>, NetworkError> {
        let followed = |clock: &DeviceClock| Some(clock.status.root).filter(|_| clock.status.tier != TIER_FREE_RUNNING);
        let root = devices.first().and_then(|host| followed(&host.as_ref().ok()?.0));
        let mut measured = Vec::new();
        for (number, device) in devices.into_iter().enumerate() {
            measured.push(match device {
                Ok((mut clock, Instant { arrived, round_trip })) => {
                    if number > 0 && root.is_some() && followed(&clock) == root {
                        let half = Span::from_steps(round_trip.steps() / 2);
                        let middle = LocalTicks::from_steps(arrived.steps().saturating_sub(half.steps()));
                        let ours = self.network().system_time(middle)?.at;
                        let theirs = NetTime::from_steps(clock.control.system_time_steps);
                        let within_steps = round_trip.steps().div_ceil(2);
                        clock.measured = Some(Measured { offset_steps: theirs.steps_after(ours), within_steps });
                    }
                    Ok(clock)
                }
                Err(error) => Err(error),
            });
        }
        Ok(measured)
    }
}

/// When an answer came, and how long it took.
#[derive(Clone, Copy, Debug)]
struct Instant {
    arrived: LocalTicks,
    round_trip: Span,
}

fn of_all_unit(to: &[Destination]) -> Vec<(Destination, ())> {
    to.iter().map(|to| (to.clone(), ())).collect()
}

/// The four counters that stand one behind the other, from [`DropCause::TimeUnasked`] on.
fn drops_of(page: &CounterPage) -> TimeDrops {
    let count = |cause: DropCause| {
        let at = cause.index().checked_sub(usize::from(page.first));
        at.and_then(|at| page.values.get(at)).copied().unwrap_or(0)
    };
    TimeDrops {
        unasked: count(DropCause::TimeUnasked),
        order: count(DropCause::TimeOrder),
        absurd: count(DropCause::TimeAbsurd),
        tier: count(DropCause::TimeTier),
    }
}

/// Steps of a span, for showing.
#[must_use]
pub fn steps_of(span: Span) -> i64 {
    i64::try_from(span.steps()).unwrap_or(i64::MAX)
}

/// 1/256 µs for people: µs to two digits, from 10 ms on in ms, from 10 s on in s.
#[must_use]
pub fn micros(steps: i64) -> String {
    const US: u128 = 256;
    let size = u128::from(steps.unsigned_abs());
    let (unit, name) = match size {
        _ if size < 10_000 * US => (US, "µs"),
        _ if size < 10_000_000 * US => (1_000 * US, "ms"),
        _ => (1_000_000 * US, "s"),
    };
    let hundredths = (size * 100 + unit / 2) / unit;
    let sign = if steps < 0 && hundredths > 0 { "-" } else { "" };
    format!("{sign}{}.{:02} {name}", hundredths / 100, hundredths % 100)
}

#[cfg(test)]
impl DeviceClock {
    /// A root that is settled, for tests.
    pub(crate) fn example() -> Self {
        let settings = osap_runtime::clock::DEFAULT_SETTINGS;
        let status = TimeStatus {
            settings,
            tier: 0,
            root_priority: settings.priority,
            root: UniqueId([1; 12]),
            is_settled: true,
            is_live: false,
            sources: 0,
            error_steps: 0,
            drift_ppb: 0,
            behind_steps: 0,
            age_us: 0,
            unix_offset_us: None,
            steps: 0,
            root_changes: 0,
        };
        let control = TimeControl::default();
        Self { status, control, links: Vec::new(), refused: TimeDrops::default(), measured: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock(root: u8, tier: u8, bound_steps: i32, is_settled: bool) -> DeviceClock {
        let mut clock = DeviceClock::example();
        clock.status = TimeStatus { tier, root: UniqueId([root; 12]), is_settled, ..clock.status };
        clock.control = TimeControl { bound_steps, tier, ..clock.control };
        clock
    }

    fn clocks(devices: Vec<DeviceClock>) -> Clocks {
        Clocks { at: LocalTicks::ZERO, devices: devices.into_iter().map(Ok).collect() }
    }

    /// The gate opens for one root, settled, with a bound; each reason that it does not is told apart.
    #[test]
    fn each_reason_to_wait_has_its_name() {
        let all = clocks(vec![
            clock(1, 0, 0, true),
            clock(1, 1, 1_280, true),
            clock(1, 1, 1_281, true),
            clock(2, 0, 0, true),
            clock(1, 2, 0, false),
            clock(1, 2, -1, true),
            clock(9, 255, -1, false),
        ]);
        assert_eq!(all.root(), Some(UniqueId([1; 12])));
        let found = all.unsettled(Span::from_us(5));
        let wide = Unsettled::Wide { bound: Span::from_steps(1_281) };
        let other = Unsettled::OtherRoot { root: UniqueId([2; 12]) };
        assert_eq!(
            found,
            [(2, wide), (3, other), (4, Unsettled::NotSettled), (5, Unsettled::NoBound), (6, Unsettled::NoRoot)]
        );
        assert_eq!(all.widest(), None);
        assert!(clocks(vec![clock(1, 0, 0, true), clock(1, 1, 1_280, true)]).unsettled(Span::from_us(5)).is_empty());
    }

    /// Among roots with as many followers the lowest id is the common one, so that two halves are not both right.
    #[test]
    fn equal_votes_go_to_the_lowest_id() {
        let two = clocks(vec![clock(7, 0, 0, true), clock(3, 0, 0, true)]);
        assert_eq!(two.root(), Some(UniqueId([3; 12])));
        assert_eq!(two.unsettled(Span::MAX).len(), 1);
    }

    #[test]
    fn times_are_rounded_and_change_their_unit() {
        for (steps, text) in [
            (0, "0.00 µs"),
            (256, "1.00 µs"),
            (-384, "-1.50 µs"),
            (-1, "0.00 µs"),
            (256 * 12_345, "12.35 ms"),
            (256 * 12_345_678, "12.35 s"),
        ] {
            assert_eq!(micros(steps), text);
        }
    }
}
