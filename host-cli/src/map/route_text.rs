//! A route as people write it: `/0/3`, `/b1:17`, and `/` for the host itself.
//!
//! Each step stands behind a slash: a link by its gateway's index, a bus by `b`, the gateway's index, a colon and the drop
//! (`*` for all of them).
//!
//! - **Walk:** shown in maps and errors; read from command lines.
//! - **Invariant:** what is shown parses back to the same; a text that parses is a route that fits a header, `[PKT-06]`.
//!
//! ```
//! use osap::map::RouteText;
//!
//! let route: RouteText = "/0/b1:17".parse()?;
//! assert_eq!(route.as_route().bytes(), [0b01_000000, 0b10_000001, 17]);
//! assert_eq!(route.to_string(), "/0/b1:17");
//! # Ok::<(), osap::map::RouteTextError>(())
//! ```

use osap_protocol::{BusDrop, GatewayIndex, Route, RouteBuf, Step};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::cmp::Ordering;
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// A route with a text. Shorter ones come first in order; of one length, the one with the smaller steps.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
// boxed, since a route has room for 250 bytes and most have five; errors and findings carry one
pub struct RouteText(Box<RouteBuf>);

/// Why a text is no route.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RouteTextError {
    /// No slash at the start.
    #[error("{text}: a route begins with a slash, such as /0/3, and / is the host itself")]
    NoSlash {
        /// As given.
        text: String,
    },
    /// A step that cannot be.
    #[error("{text}: {step} is no step; a link is its index, 0 to 63, and a bus is b1:17 with a drop of 0 to 254")]
    Step {
        /// As given.
        text: String,
        /// The part that is wrong.
        step: String,
    },
    /// More steps than a header holds.
    #[error("the route has more steps than the 250 bytes of a header hold")]
    TooLong,
}

impl RouteText {
    /// The route of the host itself.
    #[must_use]
    pub fn host() -> Self {
        Self::default()
    }

    /// The steps.
    #[must_use]
    pub fn as_route(&self) -> Route<'_> {
        self.0.as_route()
    }

    /// The same as a route of its own.
    #[must_use]
    pub fn to_buf(&self) -> RouteBuf {
        (*self.0).clone()
    }

    /// How many steps it has.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.as_route().steps().count()
    }
}

impl From<RouteBuf> for RouteText {
    fn from(route: RouteBuf) -> Self {
        Self(Box::new(route))
    }
}

impl Ord for RouteText {
    fn cmp(&self, other: &Self) -> Ordering {
        self.steps().cmp(&other.steps()).then_with(|| self.as_route().steps().cmp(other.as_route().steps()))
    }
}

impl PartialOrd for RouteText {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Display for RouteText {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if self.as_route().bytes().is_empty() {
            return f.pad("/");
        }
        let mut text = String::new();
        for step in self.as_route().steps() {
            text += &step_text(step);
        }
        f.pad(&text)
    }
}

/// One step with its slash.
pub(crate) fn step_text(step: Step) -> String {
    match step {
        Step::Link(gateway) => format!("/{}", gateway.get()),
        Step::Bus { gateway, drop: BusDrop::BROADCAST } => format!("/b{}:*", gateway.get()),
        Step::Bus { gateway, drop } => format!("/b{}:{}", gateway.get(), drop.0),
    }
}

impl FromStr for RouteText {
    type Err = RouteTextError;

    fn from_str(text: &str) -> Result<Self, RouteTextError> {
        let steps = text.strip_prefix('/').ok_or_else(|| RouteTextError::NoSlash { text: text.to_owned() })?;
        let mut route = RouteBuf::new();
        if steps.is_empty() {
            return Ok(route.into());
        }
        for part in steps.split('/') {
            let wrong = || RouteTextError::Step { text: text.to_owned(), step: part.to_owned() };
            route.push(step(part).ok_or_else(wrong)?).map_err(|_| RouteTextError::TooLong)?;
        }
        Ok(route.into())
    }
}

fn step(part: &str) -> Option<Step> {
    // `parse` alone would take a sign and leading zeros, which are not shown back
    let number = |digits: &str| digits.parse::<u8>().ok().filter(|n| n.to_string() == digits);
    let gateway = |digits: &str| GatewayIndex::new(number(digits)?);
    match part.strip_prefix('b') {
        None => Some(Step::Link(gateway(part)?)),
        Some(bus) => {
            let (index, drop) = bus.split_once(':')?;
            let drop = match drop {
                "*" => BusDrop::BROADCAST,
                digits => Some(BusDrop(number(digits)?)).filter(|drop| *drop != BusDrop::BROADCAST)?,
            };
            Some(Step::Bus { gateway: gateway(index)?, drop })
        }
    }
}

impl Serialize for RouteText {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for RouteText {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_no_route_is_refused_with_the_part_that_is_wrong() {
        for (text, part) in
            [("/64", "64"), ("/0/", ""), ("/b1", "b1"), ("/b1:255", "b1:255"), ("/+1", "+1"), ("/01", "01")]
        {
            let error = text.parse::<RouteText>().unwrap_err();
            assert_eq!(error, RouteTextError::Step { text: text.into(), step: part.into() });
        }
        assert_eq!("0/1".parse::<RouteText>(), Err(RouteTextError::NoSlash { text: "0/1".into() }));
        assert_eq!("/0".repeat(251).parse::<RouteText>(), Err(RouteTextError::TooLong));
        assert_eq!("/".parse(), Ok(RouteText::host()));
    }

    /// A bus step has two bytes and is one step all the same.
    #[test]
    fn order_is_by_steps_not_by_bytes() {
        let sorted = ["/", "/1", "/b0:3", "/b0:200", "/0/5", "/b0:1/5"];
        let mut routes: Vec<RouteText> = sorted.iter().rev().map(|text| text.parse().unwrap()).collect();
        routes.sort();
        assert_eq!(routes.iter().map(ToString::to_string).collect::<Vec<_>>(), sorted);
    }

    proptest! {
        #[test]
        fn what_is_shown_parses_back(steps in proptest::collection::vec((0u8..64, any::<Option<u8>>()), 0..80)) {
            let mut route = RouteBuf::new();
            for (gateway, drop) in steps {
                let gateway = GatewayIndex::new(gateway).unwrap();
                route.push(drop.map_or(Step::Link(gateway), |drop| Step::Bus { gateway, drop: BusDrop(drop) })).unwrap();
            }
            let route = RouteText::from(route);
            prop_assert_eq!(route.to_string().parse(), Ok(route));
        }

        #[test]
        fn no_text_panics_and_each_has_one_meaning(text in "(/(b?[0-9]{1,3}(:[0-9*]{1,3})?)?){0,5}") {
            if let Ok(route) = text.parse::<RouteText>() {
                prop_assert_eq!(route.to_string(), text);
            }
        }
    }
}
