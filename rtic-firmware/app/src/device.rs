//! A device: a node, its kind, and the services behind its ports.
//!
//! - **Walk:** link → [`Device::receive`] → [`Device::route`] (queries, expiries) → [`Device::serve`] (ports) → [`Device::transmit`] → link.
//! - **Invariants:** ports from 1 on are those of the kind's table, in its order. `route` runs no port's service, so that a service that
//!   takes its time delays no packet of others.
//! - **Context:** `route` in the routing task, `serve` in a task below it; both bounded by the packets that wait.
//! - **Clauses:** `[APP-01]`, `[DSC-05]`.
//!
//! ```
//! use firmware_app::{Device, kind};
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::discovery::{BuildKind, UniqueId};
//!
//! // 16 slots of 256 bytes, 1 gateway, 4 ports, messages of up to 1024 bytes
//! let mut motor =
//!     Device::<16, 256, 1, 4, 1024>::new(&kind::MOTOR, UniqueId([1; 12]), 1, BuildKind::Firmware, "a").unwrap();
//! motor.run(LocalTicks::ZERO);
//! assert_eq!(motor.node().identity().type_name, "motor");
//! assert_eq!(motor.next_wake(), None); // no gateway is open and no packet waits
//! ```

use crate::echo::Echo;
use crate::kind::{Kind, Service};
use crate::stream::Stream;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{BuildKind, UniqueId};
use osap_protocol::header::Arrival;
use osap_protocol::{DropCause, GatewayIndex, PortIndex};
use osap_runtime::{Identity, Mailbox, Node, Outgoing};

/// A device whose node has `SLOTS` packets of `BYTES` bytes, up to `GATEWAYS` gateways and `PORTS` ports, and which takes messages of
/// up to `MESSAGE_BYTES` bytes.
#[derive(Debug)]
pub struct Device<
    const SLOTS: usize,
    const BYTES: usize,
    const GATEWAYS: usize,
    const PORTS: usize,
    const MESSAGE_BYTES: usize,
> {
    node: Node<SLOTS, BYTES, GATEWAYS, PORTS>,
    kind: &'static Kind,
    echo: Echo<MESSAGE_BYTES>,
    stream: Stream,
    /// Payload of the packet in work.
    scratch: [u8; BYTES],
}

/// A kind's ports do not fit a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyPorts {
    /// Ports the kind needs, the netresponder included.
    pub need: usize,
    /// Ports the node can have.
    pub have: usize,
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize, const MESSAGE_BYTES: usize>
    Device<SLOTS, BYTES, GATEWAYS, PORTS, MESSAGE_BYTES>
{
    /// A device of `kind` with its ports and no gateways yet.
    ///
    /// # Errors
    /// [`TooManyPorts`] where the kind has more than `PORTS` less one.
    pub fn new(
        kind: &'static Kind,
        unique_id: UniqueId,
        boot_epoch: u32,
        build: BuildKind,
        name: &str,
    ) -> Result<Self, TooManyPorts> {
        let identity = Identity { type_name: kind.type_name, unique_id, boot_epoch, version: kind.version, build };
        let mut node = Node::new(identity, name);
        for port in kind.ports {
            node.add_port(port.config()).ok_or(TooManyPorts { need: kind.ports.len() + 1, have: PORTS })?;
        }
        Ok(Self { node, kind, echo: Echo::new(), stream: Stream::new(), scratch: [0; BYTES] })
    }

    /// The node.
    #[must_use]
    pub const fn node(&self) -> &Node<SLOTS, BYTES, GATEWAYS, PORTS> {
        &self.node
    }

    /// The node, to add gateways to or to open them.
    pub const fn node_mut(&mut self) -> &mut Node<SLOTS, BYTES, GATEWAYS, PORTS> {
        &mut self.node
    }

    /// What kind of device it is.
    #[must_use]
    pub const fn kind(&self) -> &'static Kind {
        self.kind
    }

    /// As [`Node::receive`].
    ///
    /// # Errors
    /// The cause of the packet's drop, already counted.
    pub fn receive(
        &mut self,
        arrival: Arrival,
        packet: &mut [u8],
        started: LocalTicks,
        now: LocalTicks,
    ) -> Result<(), DropCause> {
        self.node.receive(arrival, packet, started, now)
    }

    /// What the network itself wants done: answers queries, drops what expired, notices neighbours gone.
    pub fn route(&mut self, now: LocalTicks) {
        self.node.run(now);
    }

    /// What the ports have to do: at most as many packets as wait when it is called, then what is due.
    pub fn serve(&mut self, now: LocalTicks) {
        for (port, service) in ports(self.kind) {
            for _ in 0..self.node.waiting(port) {
                let Some(delivery) = self.node.take(port, now) else { break };
                match service {
                    Service::Echo => self.echo.accept(&mut self.node, delivery, &mut self.scratch, now),
                    Service::Stream => self.stream.accept(&mut self.node, delivery, BYTES, now),
                }
            }
            match service {
                Service::Echo => self.echo.poll(&mut self.node, now),
                Service::Stream => self.stream.poll(&mut self.node, port, &mut self.scratch, now),
            }
        }
    }

    /// [`Device::route`] and [`Device::serve`], where there is one task for both.
    pub fn run(&mut self, now: LocalTicks) {
        self.route(now);
        self.serve(now);
    }

    /// As [`Node::transmit`].
    pub fn transmit(&mut self, gateway: GatewayIndex, now: LocalTicks, out: &mut [u8]) -> Option<Outgoing> {
        self.node.transmit(gateway, now, out)
    }

    /// As [`Node::has_output`].
    #[must_use]
    pub fn has_output(&self, gateway: GatewayIndex, now: LocalTicks) -> bool {
        self.node.has_output(gateway, now)
    }

    /// Packets that wait for [`Device::route`] to answer them.
    #[must_use]
    pub fn queries_waiting(&self) -> usize {
        self.node.waiting(PortIndex::NETRESPONDER)
    }

    /// Packets that wait for [`Device::serve`], and one for each service that is due to send.
    #[must_use]
    pub fn services_waiting(&self, now: LocalTicks) -> usize {
        let packets: usize = ports(self.kind).map(|(port, _)| self.node.waiting(port)).sum();
        let due = [self.echo.next_wake(), self.stream.next_wake()];
        packets + due.into_iter().flatten().filter(|at| *at <= now).count()
    }

    /// When [`Device::route`] or [`Device::serve`] has something to do even if no packet comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        [self.node.next_wake(), self.echo.next_wake(), self.stream.next_wake()].into_iter().flatten().min()
    }

    /// The new name, once after each renaming, to be written to non-volatile memory, `[DSC-05]`.
    pub fn take_new_name(&mut self) -> Option<&str> {
        self.node.take_new_name()
    }
}

/// A kind's ports and what they lead to.
fn ports(kind: &'static Kind) -> impl Iterator<Item = (PortIndex, Service)> {
    (1..).zip(kind.ports).filter_map(|(index, entry)| Some((PortIndex::new(index)?, entry.service)))
}
