//! Where a packet goes next: a pure function of its instruction and of what the node has.
//!
//! - **Walk:** ingress, senders and replies → *this decision* → stack.
//! - **Context:** any; O(1). **Clauses:** `[PKT-08]`, `[PKT-12]`, `[NOD-10]`.

use crate::pool::Taker;
use osap_protocol::discovery::GatewayKind;
use osap_protocol::{DropCause, GatewayIndex, Instruction};

/// What routing needs to know of a gateway.
#[derive(Clone, Copy, Debug)]
pub struct Exit {
    /// Link or bus.
    pub kind: GatewayKind,
    /// Whether it can carry packets.
    pub open: bool,
    /// Largest packet, bytes.
    pub mtu_bytes: u16,
}

/// Who takes a packet of `len` bytes whose pointer is on `instruction`, in a node with `ports` ports and the gateways that `exit_of`
/// tells of.
///
/// # Errors
/// The cause to drop it for.
pub fn decide(
    instruction: Instruction,
    len: usize,
    ports: usize,
    exit_of: impl FnOnce(GatewayIndex) -> Option<Exit>,
) -> Result<Taker, DropCause> {
    let (gateway, on_bus) = match instruction {
        Instruction::Port { destination, .. } if destination.at() < ports => return Ok(Taker::Port(destination)),
        Instruction::Port { .. } => return Err(DropCause::NoSuchPort),
        Instruction::System(_) => return Err(DropCause::UnknownSystemKey),
        Instruction::Link(gateway) => (gateway, false),
        Instruction::Bus { gateway, .. } => (gateway, true),
    };
    let exit = exit_of(gateway).ok_or(DropCause::NoSuchGateway)?;
    if on_bus != matches!(exit.kind, GatewayKind::Bus { .. }) {
        return Err(DropCause::WrongGatewayKind);
    }
    if !exit.open {
        return Err(DropCause::GatewayClosed);
    }
    if len > usize::from(exit.mtu_bytes) {
        return Err(DropCause::OverMtu);
    }
    Ok(Taker::Gateway(gateway))
}

#[cfg(test)]
mod tests {
    use super::*;
    use osap_protocol::{BusDrop, PortIndex};

    fn table(gateway: GatewayIndex) -> Option<Exit> {
        let link = Exit { kind: GatewayKind::Link, open: true, mtu_bytes: 64 };
        match gateway.get() {
            0 => Some(link),
            1 => Some(Exit { open: false, ..link }),
            2 => Some(Exit { kind: GatewayKind::Bus { drop: 9 }, ..link }),
            _ => None,
        }
    }

    /// `[PKT-08]`, `[PKT-12]`, `[NOD-10]`: each way to fail, and each way not to.
    #[test]
    fn every_outcome() {
        let gateway = |n| GatewayIndex::new(n).unwrap();
        let link = |n| Instruction::Link(gateway(n));
        let bus = |n| Instruction::Bus { gateway: gateway(n), drop: BusDrop(1) };
        let port = |n| Instruction::Port { source: PortIndex::NETRESPONDER, destination: PortIndex::new(n).unwrap() };
        for (instruction, len, expected) in [
            (link(0), 64, Ok(Taker::Gateway(gateway(0)))),
            (link(0), 65, Err(DropCause::OverMtu)),
            (link(1), 64, Err(DropCause::GatewayClosed)),
            (link(2), 64, Err(DropCause::WrongGatewayKind)),
            (link(3), 64, Err(DropCause::NoSuchGateway)),
            (bus(2), 64, Ok(Taker::Gateway(gateway(2)))),
            (bus(0), 64, Err(DropCause::WrongGatewayKind)),
            (port(1), 999, Ok(Taker::Port(PortIndex::new(1).unwrap()))),
            (port(2), 9, Err(DropCause::NoSuchPort)),
            (Instruction::System(5), 9, Err(DropCause::UnknownSystemKey)),
        ] {
            assert_eq!(decide(instruction, len, 2, table), expected, "{instruction:?}");
        }
    }
}
