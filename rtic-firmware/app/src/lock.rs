//! A node that tasks share, as a [`Mailbox`] for the task of user functions.
//!
//! - **Walk:** [`Services::serve_next`](crate::Services::serve_next) → *here*, one call at a time → the node.
//! - **Invariants:** the lock is held for one call of the mailbox and released before a service goes on, so that routing waits for no
//!   service. After a call that may have made output, the routing task is told.
//! - **Context:** the serving task. **Clause:** `[NOD-06]`.

use fixed_math::clock::SlewedMap;
use fixed_math::time::{LocalTicks, NetTime};
use osap_protocol::halt::{Action, Halt};
use osap_protocol::{DropCause, PortIndex};
use osap_runtime::clock::SystemTime;
use osap_runtime::{Delivery, Mailbox, Outbound, SendError};

/// How an image shares its node.
pub trait NodeLock {
    /// The node.
    type Node: Mailbox;

    /// Runs `work` with the node, while nobody else has it.
    fn lock<R>(&mut self, work: impl FnOnce(&mut Self::Node) -> R) -> R;

    /// Has the routing task run as soon as nothing of a higher priority does.
    fn wake_routing(&mut self);
}

/// A mailbox over a shared node.
#[derive(Debug)]
pub struct SharedMailbox<L>(pub L);

impl<L: NodeLock> Mailbox for SharedMailbox<L> {
    fn take(&mut self, port: PortIndex, now: LocalTicks) -> Option<Delivery> {
        self.0.lock(|node| node.take(port, now))
    }

    fn waiting(&mut self, port: PortIndex) -> usize {
        self.0.lock(|node| node.waiting(port))
    }

    fn with_payload<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R {
        self.0.lock(|node| node.with_payload(delivery, read))
    }

    fn with_taken_steps<R>(&mut self, delivery: &Delivery, read: impl FnOnce(&[u8]) -> R) -> R {
        self.0.lock(|node| node.with_taken_steps(delivery, read))
    }

    fn reply(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        let result = self.0.lock(|node| node.reply(delivery, parts, now));
        self.0.wake_routing();
        result
    }

    fn refuse(&mut self, delivery: Delivery, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        let result = self.0.lock(|node| node.refuse(delivery, parts, now));
        self.0.wake_routing();
        result
    }

    fn release(&mut self, delivery: Delivery, cause: Option<DropCause>, now: LocalTicks) {
        self.0.lock(|node| node.release(delivery, cause, now));
    }

    fn count_drop(&mut self, cause: DropCause, now: LocalTicks) {
        self.0.lock(|node| node.count_drop(cause, now));
    }

    fn send(&mut self, port: PortIndex, to: Outbound<'_>, parts: &[&[u8]], now: LocalTicks) -> Result<(), SendError> {
        let result = self.0.lock(|node| node.send(port, to, parts, now));
        self.0.wake_routing();
        result
    }

    fn system_time(&mut self, now: LocalTicks) -> (SystemTime, SlewedMap) {
        self.0.lock(|node| Mailbox::system_time(node, now))
    }

    fn set_live(&mut self, live: bool) {
        self.0.lock(|node| node.set_live(live));
    }

    fn halt(&mut self) -> Option<Halt> {
        self.0.lock(Mailbox::halt)
    }

    fn raise_halt(&mut self, action: Action, epoch: NetTime, now: LocalTicks) -> Halt {
        let halt = self.0.lock(|node| node.raise_halt(action, epoch, now));
        self.0.wake_routing();
        halt
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Services, kind};
    use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
    use osap_protocol::framing::Check;
    use osap_protocol::header::{Arrival, Terminal, emit};
    use osap_protocol::transport::{Sequence, SequencedHeader, SequencedKind, Transport};
    use osap_protocol::{GatewayIndex, RouteBuf, Step};
    use osap_runtime::{GatewayConfig, Identity, Node, Stamps};

    type TestNode = Node<4, 128, 1, 5>;

    /// Counts how often the node is locked and the routing task woken, and fails where a lock is taken within a lock.
    struct Counting {
        node: TestNode,
        held: bool,
        locks: usize,
        wakes: usize,
    }

    impl NodeLock for &mut Counting {
        type Node = TestNode;

        fn lock<R>(&mut self, work: impl FnOnce(&mut TestNode) -> R) -> R {
            assert!(!core::mem::replace(&mut self.held, true), "locked twice");
            self.locks += 1;
            let result = work(&mut self.node);
            self.held = false;
            result
        }

        fn wake_routing(&mut self) {
            assert!(!self.held, "woken while the node is locked");
            self.wakes += 1;
        }
    }

    /// `[APP-10]`, `[APP-11]`: a request is answered in several short locks, and the routing task is told of the answer.
    #[test]
    fn a_service_holds_the_node_for_single_calls() {
        let identity = Identity {
            type_name: "t",
            unique_id: UniqueId([1; 12]),
            boot_epoch: 1,
            version: [0; 3],
            build: BuildKind::Host,
        };
        let mut node = TestNode::new(identity, "t");
        let gateway = GatewayConfig {
            type_name: "t",
            kind: GatewayKind::Link,
            mtu_bytes: 128,
            bit_rate: 0,
            bits_a_byte: 8,
            check: Check::None,
            packet_hold_max: 4,
            stamps: Stamps::SOFTWARE,
        };
        let link = node.add_gateway(gateway).unwrap();
        for entry in kind::MOTOR.ports {
            node.add_port(entry.config()).unwrap();
        }
        let now = LocalTicks::ZERO;
        node.set_open(link, true, now);
        assert!(node.transmit(link, now, &mut [0; 128]).is_some(), "it announces itself");
        give(&mut node, link, 3, &1000u32.to_le_bytes());
        give(&mut node, link, 3, &crate::spin::SPIN_MAX.wrapping_add(1).to_le_bytes());

        let mut counting = Counting { node, held: false, locks: 0, wakes: 0 };
        let mut services = Services::<128, 256>::new(&kind::MOTOR);
        while services.serve_next(&mut SharedMailbox(&mut counting), now) {}
        assert_eq!(counting.wakes, 2);
        assert!(counting.locks >= 6, "take, read and answer twice, got {}", counting.locks);

        let mut out = [0; 128];
        let mut last_bytes = |counting: &mut Counting| {
            let len = counting.node.transmit(link, now, &mut out).unwrap().len;
            <[u8; 4]>::try_from(&out[len - 4..len]).unwrap()
        };
        assert_eq!(last_bytes(&mut counting), 1000u32.to_le_bytes());
        assert_eq!(last_bytes(&mut counting).last(), Some(&1), "the reason of the refusal");
    }

    fn give(node: &mut TestNode, link: GatewayIndex, port: u16, payload: &[u8]) {
        let mut packet = [0; 128];
        let mut route = RouteBuf::new();
        route.push(Step::Link(link)).unwrap();
        let terminal = Terminal::Port {
            source: PortIndex::new(1).unwrap(),
            destination: PortIndex::new(port).unwrap(),
            transport: Transport::Sequenced.key(),
        };
        let mut at = emit(&mut packet, 50_000, 128, route.as_route(), terminal).unwrap();
        let header = SequencedHeader { kind: SequencedKind::Request, sequence: Sequence::default() };
        packet[at..at + SequencedHeader::LEN].copy_from_slice(&header.encode());
        at += SequencedHeader::LEN;
        packet[at..at + payload.len()].copy_from_slice(payload);
        let now = LocalTicks::ZERO;
        node.receive(Arrival::Link(link), &mut packet[..at + payload.len()], now, now).unwrap();
    }
}
