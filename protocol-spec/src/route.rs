//! The forwarding part of a source route: steps over links and buses, as they stand in a packet.
//!
//! - **Walk:** a scanner builds routes step by step; a sender writes one into a header.
//! - **Invariant:** a [`Route`] holds whole link and bus instructions and nothing else.
//! - **Clauses:** `[PKT-04]` steps then a terminal, `[PKT-06]` longest route, `[PKT-09]` the way back.
//!
//! ```
//! use osap_protocol::{GatewayIndex, RouteBuf, Step};
//!
//! let mut route = RouteBuf::new();
//! route.push(Step::Link(GatewayIndex::new(1).unwrap()))?;
//! route.push(Step::Link(GatewayIndex::new(4).unwrap()))?;
//! assert_eq!(route.as_route().bytes(), [0b01_000001, 0b01_000100]);
//! # Ok::<(), osap_protocol::route::RouteTooLong>(())
//! ```

use crate::address::{BusDrop, GatewayIndex};
use crate::header::Instruction;

/// Most bytes of forwarding instructions, so that the terminal one begins at offset 255, `[PKT-06]`.
pub const ROUTE_BYTES_MAX: usize = 250;

/// One forwarding step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Step {
    /// Over a point-to-point link.
    Link(GatewayIndex),
    /// Over a bus to one drop, or to all.
    Bus {
        /// The bus gateway.
        gateway: GatewayIndex,
        /// Who shall receive it.
        drop: BusDrop,
    },
}

impl Step {
    /// The gateway the step leaves by.
    #[must_use]
    pub const fn gateway(self) -> GatewayIndex {
        match self {
            Self::Link(gateway) | Self::Bus { gateway, .. } => gateway,
        }
    }

    /// The instruction that takes this step.
    #[must_use]
    pub const fn instruction(self) -> Instruction {
        match self {
            Self::Link(gateway) => Instruction::Link(gateway),
            Self::Bus { gateway, drop } => Instruction::Bus { gateway, drop },
        }
    }
}

/// The route would be longer than a pointer can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RouteTooLong {
    /// Bytes the route would have.
    pub bytes: usize,
}

impl core::fmt::Display for RouteTooLong {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "a route of {} bytes; a header holds {ROUTE_BYTES_MAX}", self.bytes)
    }
}

impl core::error::Error for RouteTooLong {}

/// Bytes that are not whole forwarding instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotARoute {
    /// Offset of the first byte that does not fit.
    pub at: usize,
}

/// Borrowed forwarding steps, checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route<'a>(&'a [u8]);

impl<'a> Route<'a> {
    /// No steps: delivery within the same node, `[PKT-14]`.
    pub const LOCAL: Route<'static> = Route(&[]);

    /// Checks that `bytes` are whole link and bus instructions.
    ///
    /// # Errors
    /// [`NotARoute`] with the offset of the first byte that is not.
    pub fn check(bytes: &'a [u8]) -> Result<Self, NotARoute> {
        let mut at = 0;
        while at < bytes.len() {
            let width = match Instruction::decode(&bytes[at..]) {
                Some(Instruction::Link(_) | Instruction::Bus { .. }) if at < ROUTE_BYTES_MAX => {
                    Instruction::width(bytes[at])
                }
                _ => return Err(NotARoute { at }),
            };
            at += width;
        }
        if at > ROUTE_BYTES_MAX { Err(NotARoute { at }) } else { Ok(Self(bytes)) }
    }

    /// The instructions as they stand in a packet.
    #[must_use]
    pub const fn bytes(self) -> &'a [u8] {
        self.0
    }

    /// The steps in order.
    pub fn steps(self) -> impl Iterator<Item = Step> + 'a {
        let mut rest = self.0;
        core::iter::from_fn(move || {
            let instruction = Instruction::decode(rest)?;
            rest = rest.get(Instruction::width(*rest.first()?)..)?;
            match instruction {
                Instruction::Link(gateway) => Some(Step::Link(gateway)),
                Instruction::Bus { gateway, drop } => Some(Step::Bus { gateway, drop }),
                Instruction::System(_) | Instruction::Port { .. } => None,
            }
        })
    }
}

/// An owned route of up to [`ROUTE_BYTES_MAX`] bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RouteBuf(heapless::Vec<u8, ROUTE_BYTES_MAX>);

impl RouteBuf {
    /// No steps.
    #[must_use]
    pub const fn new() -> Self {
        Self(heapless::Vec::new())
    }

    /// Adds a step at the far end.
    ///
    /// # Errors
    /// [`RouteTooLong`], and the route stays as it was.
    pub fn push(&mut self, step: Step) -> Result<(), RouteTooLong> {
        let mut bytes = [0; 3];
        let instruction = step.instruction();
        let width = instruction.encode(&mut bytes);
        let too_long = RouteTooLong { bytes: self.0.len() + width };
        self.0.extend_from_slice(&bytes[..width]).map_err(|_| too_long)
    }

    /// The route with one more step.
    ///
    /// # Errors
    /// [`RouteTooLong`].
    pub fn with(&self, step: Step) -> Result<Self, RouteTooLong> {
        let mut longer = self.clone();
        longer.push(step)?;
        Ok(longer)
    }

    /// Borrows the steps.
    #[must_use]
    pub fn as_route(&self) -> Route<'_> {
        Route(&self.0)
    }
}

impl From<Route<'_>> for RouteBuf {
    fn from(route: Route<'_>) -> Self {
        let mut buf = Self::new();
        for step in route.steps() {
            // a checked route fits by its invariant
            if buf.push(step).is_err() {
                break;
            }
        }
        buf
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn link(index: u8) -> Step {
        Step::Link(GatewayIndex::new(index).unwrap())
    }

    /// `[PKT-06]`: 250 bytes fit, one more does not, and the refusal leaves the route alone.
    #[test]
    fn a_route_ends_where_the_pointer_does() {
        let mut route = RouteBuf::new();
        for _ in 0..ROUTE_BYTES_MAX {
            route.push(link(63)).unwrap();
        }
        assert_eq!(route.push(link(0)), Err(RouteTooLong { bytes: 251 }));
        assert_eq!(route.as_route().steps().count(), 250);
        assert!(Route::check(&[0x41; 250]).is_ok());
        assert_eq!(Route::check(&[0x41; 251]), Err(NotARoute { at: 250 }));
    }

    /// `[PKT-04]`: a terminal instruction is no forwarding step.
    #[test]
    fn only_forwarding_steps_make_a_route() {
        assert_eq!(Route::check(&[0x41, 0xc0, 0, 0]), Err(NotARoute { at: 1 }));
        assert_eq!(Route::check(&[0x02]), Err(NotARoute { at: 0 }));
        assert_eq!(Route::check(&[0x41, 0x82]), Err(NotARoute { at: 1 }));
    }

    proptest! {
        #[test]
        fn steps_come_back_as_they_were_pushed(steps in proptest::collection::vec((0u8..64, any::<Option<u8>>()), 0..80)) {
            let steps: std::vec::Vec<Step> = steps
                .into_iter()
                .map(|(gateway, drop)| {
                    let gateway = GatewayIndex::new(gateway).unwrap();
                    drop.map_or(Step::Link(gateway), |drop| Step::Bus { gateway, drop: BusDrop(drop) })
                })
                .collect();
            let mut route = RouteBuf::new();
            for step in &steps {
                route.push(*step).unwrap();
            }
            prop_assert!(Route::check(route.as_route().bytes()).is_ok());
            prop_assert!(route.as_route().steps().eq(steps.iter().copied()));
            prop_assert_eq!(RouteBuf::from(route.as_route()), route);
        }
    }
    extern crate std;
}
