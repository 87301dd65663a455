//! Every slot comes home, whatever comes in: the property that a device which never reboots depends on.

mod common;

use common::{BYTES, FAST, SLOTS, TestNode, UART, USER, gateway, link, node, port, route, us};
use osap_protocol::discovery::GatewayKind;
use osap_protocol::framing::{Check, Deframer};
use osap_protocol::header::{Arrival, Terminal, emit};
use osap_protocol::transport::Transport;
use osap_protocol::{BusDrop, DropCause};
use osap_runtime::{Delivery, GatewayConfig, Mailbox, Outbound};
use proptest::prelude::*;

/// Something that may happen to a node, at random.
#[derive(Clone, Debug)]
enum Act {
    /// Raw bytes on a link's wire, as a fault or an attacker would have them.
    Wire(Vec<u8>),
    /// A packet with a good header and any rest.
    Packet {
        steps: Vec<u8>,
        destination: u16,
        transport: u8,
        ttl_us: u16,
        payload: Vec<u8>,
    },
    /// The same on the bus.
    Bus(Vec<u8>),
    Send {
        steps: u8,
        destination: u16,
        ttl_us: u16,
        len: usize,
    },
    Transmit(u8),
    Take(u16),
    Reply(usize),
    Refuse,
    Release,
    Open(u8, bool),
    Run,
    Wait(u32),
}

fn any_act() -> impl Strategy<Value = Act> {
    let bytes = || proptest::collection::vec(any::<u8>(), 0..80);
    prop_oneof![
        bytes().prop_map(Act::Wire),
        (bytes(), 0u16..4, 0u8..4, any::<u16>(), bytes()).prop_map(
            |(mut steps, destination, transport, ttl_us, payload)| {
                steps.truncate(4);
                for step in &mut steps {
                    *step = 0x40 | (*step & 3);
                }
                Act::Packet { steps, destination, transport, ttl_us, payload }
            }
        ),
        bytes().prop_map(Act::Bus),
        (0u8..3, 0u16..4, any::<u16>(), 0usize..300).prop_map(|(steps, destination, ttl_us, len)| Act::Send {
            steps,
            destination,
            ttl_us,
            len
        }),
        (0u8..3).prop_map(Act::Transmit),
        (0u16..3).prop_map(Act::Take),
        (0usize..300).prop_map(Act::Reply),
        Just(Act::Refuse),
        Just(Act::Release),
        (0u8..3, any::<bool>()).prop_map(|(index, open)| Act::Open(index, open)),
        Just(Act::Run),
        (0u32..40_000).prop_map(Act::Wait),
    ]
}

/// A node under test and what the test holds of it.
struct Bench {
    node: TestNode,
    deframer: Deframer<{ BYTES + 4 }>,
    held: Vec<Delivery>,
    now: u64,
}

impl Bench {
    fn new() -> Self {
        let bus = GatewayConfig { kind: GatewayKind::Bus { drop: 3 }, ..FAST };
        Self { node: node(1, &[UART, FAST, bus]), deframer: Deframer::new(Check::Crc16), held: Vec::new(), now: 1_000 }
    }

    fn act(&mut self, act: &Act) {
        let now = us(self.now);
        let link_in = Arrival::Link(gateway(0));
        match act {
            Act::Wire(bytes) => {
                for byte in bytes.iter().chain(&[0]) {
                    match self.deframer.push(*byte, now) {
                        Some(Ok(frame)) => {
                            let _counted = self.node.receive(link_in, frame.packet, frame.started, now);
                        }
                        Some(Err(error)) => self.node.count(error.into(), Some(gateway(0)), now),
                        None => {}
                    }
                }
            }
            Act::Packet { steps, destination, transport, ttl_us, payload } => {
                let mut packet = [0; 400];
                let mut all = route(&[link(0)]);
                for step in steps {
                    all.push(link(step & 3)).expect("short");
                }
                let terminal =
                    Terminal::Port { source: port(5), destination: port(*destination), transport: *transport };
                let at = emit(&mut packet, *ttl_us, 256, all.as_route(), terminal).expect("fits");
                packet[at..at + payload.len()].copy_from_slice(payload);
                let _counted = self.node.receive(link_in, &mut packet[..at + payload.len()], now, now);
            }
            Act::Bus(bytes) => {
                let arrival = Arrival::Bus { gateway: gateway(2), from: BusDrop(9) };
                let _counted = self.node.receive(arrival, &mut bytes.clone(), now, now);
            }
            Act::Send { steps, destination, ttl_us, len } => {
                let steps = route(&vec![link(*steps); usize::from(*steps)]);
                let to = Outbound {
                    route: steps.as_route(),
                    mtu_bytes: 256,
                    ttl_us: *ttl_us,
                    destination: port(*destination),
                    transport: Transport::Datagram,
                };
                let _counted = self.node.send(port(USER), to, &[&vec![0; *len]], now);
            }
            Act::Transmit(index) => {
                let _sent = self.node.transmit(gateway(*index), now, &mut [0; BYTES]);
            }
            Act::Take(index) => self.held.extend(self.node.take(port(*index), now)),
            Act::Reply(len) => {
                if let Some(delivery) = self.held.pop() {
                    let _counted = self.node.reply(delivery, &[&vec![1; *len]], now);
                }
            }
            Act::Refuse => {
                if let Some(delivery) = self.held.pop() {
                    let _counted = self.node.refuse(delivery, &[&[1]], now);
                }
            }
            Act::Release => {
                if let Some(delivery) = self.held.pop() {
                    self.node.release(delivery, Some(DropCause::PortRefused), now);
                }
            }
            Act::Open(index, open) => self.node.set_open(gateway(*index), *open, now),
            Act::Run => self.node.run(now),
            Act::Wait(us) => self.now += u64::from(*us),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    /// `[NOD-02]`, `[NOD-01]`: at every moment each slot is free, stacked or held by the test; once everything has expired and been
    /// released, all are free.
    #[test]
    fn every_slot_comes_home(acts in proptest::collection::vec(any_act(), 0..120)) {
        let mut bench = Bench::new();
        for act in &acts {
            bench.act(act);
            let Bench { node, held, .. } = &bench;
            prop_assert_eq!(node.free_slots() + node.stacked() + held.len(), SLOTS, "after {:?}", act);
        }
        let end = us(bench.now + 70_000);
        for delivery in bench.held.drain(..) {
            bench.node.release(delivery, None, end);
        }
        bench.node.run(end);
        prop_assert_eq!(bench.node.free_slots(), SLOTS);
        prop_assert_eq!(bench.node.stacked(), 0);
        // the holds came home too: every owner can fill its own again
        let node = &mut bench.node;
        for (index, opcode) in [(0, 0x40), (1, 0x40), (2, 0x80)] {
            node.set_open(gateway(index), true, end);
            let on_bus = Arrival::Bus { gateway: gateway(2), from: BusDrop(9) };
            let arrival = if index == 2 { on_bus } else { Arrival::Link(gateway(index)) };
            for _ in 0..4 {
                prop_assert!(node.clear_to_receive(gateway(index)), "gateway {}", index);
                let mut packet = vec![5, 0xff, 0xff, 64, 0, opcode, 0xc0, 0x28, 1, 0];
                if index == 2 {
                    packet.insert(6, 3);
                }
                prop_assert_eq!(node.receive(arrival, &mut packet, end, end), Ok(()));
            }
            prop_assert!(!node.clear_to_receive(gateway(index)), "gateway {}", index);
            while let Some(delivery) = node.take(port(USER), end) {
                node.release(delivery, None, end);
            }
        }
        let nowhere = route(&[]);
        for n in 0..5 {
            let to = Outbound { route: nowhere.as_route(), mtu_bytes: 256, ttl_us: 9, destination: port(USER), transport: Transport::Datagram };
            prop_assert_eq!(node.send(port(USER), to, &[&[n]], end).is_ok(), n < 4, "the user port");
        }
    }
}
