//! The node: its tables, its memory, and what it does between packets.
//!
//! - **Walk:** `ingress` and `mailbox` put packets in, `egress` and `mailbox` take them out; [`Node::run`] keeps the promises in between.
//! - **Invariants:** `held` of a gateway or port is the number of slots it owns; `waiting` the number of stacked packets it shall take.
//! - **Context:** one. Time is an argument, `[NOD-12]`.
//! - **Clauses:** `[NOD-01]` to `[NOD-06]`, `[NOD-12]`.
//!
//! ```
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
//! use osap_protocol::framing::Check;
//! use osap_runtime::{GatewayConfig, Identity, Node, Stamps};
//!
//! let identity = Identity { type_name: "example", unique_id: UniqueId([7; 12]), boot_epoch: 1, version: [0, 1, 0], build: BuildKind::Host };
//! // 8 slots of 256 bytes, up to 2 gateways and 4 ports
//! let mut node = Node::<8, 256, 2, 4>::new(identity, "bench");
//! let uart = node.add_gateway(GatewayConfig {
//!     type_name: "uart", kind: GatewayKind::Link, mtu_bytes: 256, bit_rate: 3_000_000, bits_a_byte: 10, check: Check::Crc16, packet_hold_max: 4, stamps: Stamps::SOFTWARE,
//! }).unwrap();
//! let now = LocalTicks::from_us(10);
//! node.set_open(uart, true, now);
//! let mut packet = [0; 256];
//! let out = node.transmit(uart, now, &mut packet).expect("it announces itself");
//! assert!(out.len < 40);
//! ```

use crate::clock::{Clock, SystemTime};
use crate::counters::Counters;
use crate::debug::DebugRing;
use crate::gateway::{Gateway, GatewayConfig};
use crate::pool::{Owner, Pool, SlotId, Tag, Taker};
use crate::port::{Port, PortConfig};
use crate::route::{Exit, decide};
use crate::stack::Stack;
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::discovery::{BuildKind, Event, Name, NeighbourChange, ScanId, Stage, UniqueId, Verbosity};
use osap_protocol::halt::Halt;
use osap_protocol::system::NEIGHBOUR_TIMEOUT_US;
use osap_protocol::{DropCause, GatewayIndex, Instruction, PortIndex};

/// Who a node is.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// What kind of device; cut to `NAME_BYTES_MAX`.
    pub type_name: &'static str,
    /// Which one, from its silicon.
    pub unique_id: UniqueId,
    /// Another number after each boot.
    pub boot_epoch: u32,
    /// Version of the runtime: major, minor, patch.
    pub version: [u8; 3],
    /// What it was built for.
    pub build: BuildKind,
}

/// Least MTU of a gateway, bytes: an announcement has up to 29, on a bus 2 of route among them.
pub const MTU_BYTES_MIN: u16 = 32;

/// Packets the netresponder may hold of its own: none, since it only turns queries into replies.
const NETRESPONDER: PortConfig = PortConfig { type_name: "netresponder", name: "", packet_hold_max: 0 };

/// A node with `SLOTS` packets of up to `BYTES` bytes, up to `GATEWAYS` gateways (64 at most) and `PORTS` ports (2048 at most).
#[derive(Debug)]
pub struct Node<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize> {
    pub(crate) identity: Identity,
    pub(crate) name: Name,
    pub(crate) renamed: bool,
    pub(crate) pool: Pool<SLOTS, BYTES>,
    pub(crate) stack: Stack,
    pub(crate) gateways: heapless::Vec<Gateway, GATEWAYS>,
    pub(crate) ports: heapless::Vec<Port, PORTS>,
    pub(crate) counters: Counters,
    pub(crate) debug: DebugRing,
    pub(crate) clock: Clock,
    /// Scan id of the last visit, and of the one before it, `[DSC-03]`.
    pub(crate) visits: [ScanId; 2],
    pub(crate) topology_generation: u32,
    /// The latest halt there was.
    pub(crate) halt: Option<Halt>,
    /// It has changed since [`Node::take_halt_news`].
    pub(crate) halt_is_new: bool,
    /// No neighbour is silent for too long before this: the earliest of them when last looked, as they only ever move on.
    pub(crate) silence_at: LocalTicks,
}

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// A node with its netresponder on port 0 and no gateways; `name` is cut to `NAME_BYTES_MAX`.
    #[must_use]
    pub fn new(identity: Identity, name: &str) -> Self {
        const { assert!(GATEWAYS <= GatewayIndex::COUNT as usize, "six bits name a gateway") };
        const { assert!(PORTS >= 1 && PORTS <= PortIndex::COUNT as usize, "eleven bits name a port, port 0 among them") };
        const { assert!(BYTES >= 64, "a slot holds at least an announcement and a short reply") };
        let mut ports = heapless::Vec::new();
        let _always_fits = ports.push(Port::new(NETRESPONDER));
        Self {
            identity,
            name: crate::port::name_of(name),
            renamed: false,
            pool: Pool::new(),
            stack: Stack::new(),
            gateways: heapless::Vec::new(),
            ports,
            counters: Counters::new(),
            debug: DebugRing::new(),
            clock: Clock::new(identity.unique_id),
            visits: [ScanId::default(); 2],
            topology_generation: 0,
            halt: None,
            halt_is_new: false,
            silence_at: LocalTicks::MAX,
        }
    }

    /// Adds a gateway, closed; `None` where there are `GATEWAYS` already, or where it could not carry so much as an announcement
    /// ([`MTU_BYTES_MIN`]). Its MTU is cut to the pool's slots.
    pub fn add_gateway(&mut self, mut config: GatewayConfig) -> Option<GatewayIndex> {
        if config.mtu_bytes < MTU_BYTES_MIN {
            return None;
        }
        config.mtu_bytes = config.mtu_bytes.min(u16::try_from(BYTES).unwrap_or(u16::MAX));
        let index = GatewayIndex::new(u8::try_from(self.gateways.len()).ok()?)?;
        self.gateways.push(Gateway::new(config)).ok()?;
        Some(index)
    }

    /// Adds a port; `None` where there are `PORTS` already.
    pub fn add_port(&mut self, config: PortConfig) -> Option<PortIndex> {
        let index = PortIndex::new(u16::try_from(self.ports.len()).ok()?)?;
        self.ports.push(Port::new(config)).ok()?;
        Some(index)
    }

    /// Who this is.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Its present name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The new name, once after each renaming, for the application to keep, `[DSC-05]`.
    pub fn take_new_name(&mut self) -> Option<&str> {
        if core::mem::take(&mut self.renamed) { Some(&self.name) } else { None }
    }

    /// A gateway, where there is one.
    #[must_use]
    pub fn gateway(&self, index: GatewayIndex) -> Option<&Gateway> {
        self.gateways.get(index.at())
    }

    /// Indices of all gateways.
    pub fn gateway_indices(&self) -> impl Iterator<Item = GatewayIndex> + use<SLOTS, BYTES, GATEWAYS, PORTS> {
        (0..self.gateways.len()).filter_map(|n| GatewayIndex::new(u8::try_from(n).ok()?))
    }

    /// How often each cause of a drop happened.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What happened last.
    #[must_use]
    pub const fn debug(&self) -> &DebugRing {
        &self.debug
    }

    /// What happened last, to write a line into or to set the verbosity.
    pub const fn debug_mut(&mut self) -> &mut DebugRing {
        &mut self.debug
    }

    /// Slots nobody holds. With nothing stacked and nothing taken, all of them, `[NOD-02]`.
    #[must_use]
    pub const fn free_slots(&self) -> usize {
        self.pool.free_count()
    }

    /// Packets waiting for their takers.
    #[must_use]
    pub const fn stacked(&self) -> usize {
        self.stack.len()
    }

    /// Packets waiting for `port`: whether its task has anything to do.
    #[must_use]
    pub fn waiting(&self, port: PortIndex) -> usize {
        self.ports.get(port.at()).map_or(0, |port| usize::from(port.waiting))
    }

    /// Goes up with every change of a neighbour, `[SYS-04]`.
    #[must_use]
    pub const fn topology_generation(&self) -> u32 {
        self.topology_generation
    }

    /// The latest change of each gateway's neighbour, once.
    pub fn take_neighbour_change(&mut self) -> Option<(GatewayIndex, NeighbourChange)> {
        let at = self.gateways.iter().position(|gateway| gateway.change.is_some())?;
        Some((GatewayIndex::new(u8::try_from(at).ok()?)?, self.gateways[at].change.take()?))
    }

    /// Says whether a gateway can carry packets. Packets that wait for one that closed are dropped, `gateway-closed`.
    #[inline]
    pub fn set_open(&mut self, index: GatewayIndex, open: bool, now: LocalTicks) {
        if self.gateways.get(index.at()).is_some_and(|gateway| gateway.open != open) {
            self.change_open(index, open, now);
        }
    }

    // links say whether they are open each time they are looked at, and seldom something new
    #[cold]
    fn change_open(&mut self, index: GatewayIndex, open: bool, now: LocalTicks) {
        let Some(gateway) = self.gateways.get_mut(index.at()) else { return };
        gateway.open = open;
        gateway.announce_at = open.then_some(now);
        self.debug.record(Verbosity::Events, now, || Event::Gateway { gateway: index.get(), open });
        self.time_of_gateway(index, now);
        if !open {
            self.neighbour_lost(index, now);
            while let Some(id) = self.stack.take_for(&mut self.pool, Taker::Gateway(index)) {
                self.leave_stack(&id);
                self.discard(id, DropCause::GatewayClosed, now);
            }
        }
    }

    /// System time at `now`, by this node's own counter, `[TIM-09]`.
    #[must_use]
    pub fn system_time(&self, now: LocalTicks) -> SystemTime {
        self.clock.system_time(now)
    }

    /// The clock.
    #[must_use]
    pub const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// The clock, to set it or to say what is live.
    pub const fn clock_mut(&mut self) -> &mut Clock {
        &mut self.clock
    }

    /// Counts a drop that happened outside the node: a frame that failed its check, a ring that ran over.
    #[cold]
    pub fn count(&mut self, cause: DropCause, gateway: Option<GatewayIndex>, now: LocalTicks) {
        self.counters.add(cause);
        if let Some(gateway) = gateway.and_then(|index| self.gateways.get_mut(index.at())) {
            gateway.dropped = gateway.dropped.saturating_add(1);
        }
        let gateway = gateway.map(GatewayIndex::get);
        self.debug.record(Verbosity::Drops, now, || Event::Dropped { cause, gateway });
    }

    /// Does what is due at `now`: drops what has expired, notices neighbours gone, answers queries. Call it after every packet that
    /// came in and whenever [`Node::next_wake`] has come.
    pub fn run(&mut self, now: LocalTicks) {
        self.expire(now);
        if now >= self.silence_at {
            self.notice_silence(now);
        }
        if now >= self.clock.due_at() {
            self.keep_time(now);
        }
        self.answer_queries(now);
    }

    /// Takes leave of neighbours not heard of for too long, and notes when the next one may be.
    #[cold]
    fn notice_silence(&mut self, now: LocalTicks) {
        for index in self.gateway_indices() {
            let silent = self.gateways[index.at()]
                .heard
                .is_some_and(|heard| now.since(heard.at) > Span::from_us(NEIGHBOUR_TIMEOUT_US));
            if silent {
                self.neighbour_lost(index, now);
            }
        }
        self.silence_at = self.next_silence().unwrap_or(LocalTicks::MAX);
    }

    /// When the first neighbour will have been silent for too long.
    fn next_silence(&self) -> Option<LocalTicks> {
        let heard = self.gateways.iter().filter_map(|gateway| gateway.heard);
        heard.map(|heard| heard.at + Span::from_us(NEIGHBOUR_TIMEOUT_US) + Span::from_steps(1)).min()
    }

    /// When [`Node::run`] or, for an announcement, [`Node::transmit`] has something to do even if no packet comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        let expiry = self.stack.earliest_deadline(&self.pool);
        let announcements = self.gateways.iter().filter_map(|gateway| gateway.announce_at);
        let time = self.gateways.iter().map(|gateway| gateway.peer.due_at());
        let halts = self.gateways.iter().filter(|gateway| gateway.open).filter_map(|gateway| gateway.telling.due_at());
        let own = announcements.chain(time).chain(halts).chain([self.silence_at, self.clock.due_at()]).min();
        own.into_iter().chain(expiry).min().filter(|at| *at < LocalTicks::MAX)
    }

    /// Drops every stacked packet whose deadline has come, `[NOD-04]`.
    #[inline]
    pub(crate) fn expire(&mut self, now: LocalTicks) {
        if self.stack.earliest_deadline(&self.pool).is_some_and(|deadline| deadline <= now) {
            self.drop_expired(now);
        }
    }

    #[cold]
    fn drop_expired(&mut self, now: LocalTicks) {
        while let Some(id) = self.stack.take_expired(&mut self.pool, now) {
            self.leave_stack(&id);
            self.discard(id, DropCause::Expired, now);
        }
    }

    /// Finds a slot for a packet of `owner`, by displacement if it must, `[NOD-05]`.
    pub(crate) fn admit(&mut self, tag: Tag, now: LocalTicks) -> Result<SlotId, DropCause> {
        let (held, limit) = self.hold_of(tag.owner);
        if held < limit
            && let Some(id) = self.pool.claim(tag)
        {
            self.change_hold(tag.owner, 1);
            return Ok(id);
        }
        self.displace(tag, held < limit, now)
    }

    /// Finds a slot for `tag` by dropping a later packet: of the same owner, or of anybody where the owner is `within_hold`.
    #[cold]
    fn displace(&mut self, tag: Tag, within_hold: bool, now: LocalTicks) -> Result<SlotId, DropCause> {
        // an owner within its hold may not be kept out by others' later packets, where the holds together are more than the pool
        let mut giving_way = self.stack.take_latest_of(&mut self.pool, Some(tag.owner), tag.deadline);
        if giving_way.is_none() && within_hold {
            giving_way = self.stack.take_latest_of(&mut self.pool, None, tag.deadline);
        }
        let Some(id) = giving_way else {
            return Err(if within_hold { DropCause::PoolFull } else { DropCause::HoldFull });
        };
        self.leave_stack(&id);
        self.discard(id, DropCause::Displaced, now);
        let id = self.pool.claim(tag).ok_or(DropCause::PoolFull)?;
        self.change_hold(tag.owner, 1);
        Ok(id)
    }

    /// Who takes a packet of `len` bytes that is at `instruction`.
    pub(crate) fn decide(&self, instruction: Instruction, len: usize) -> Result<Taker, DropCause> {
        decide(instruction, len, self.ports.len(), |index| {
            let gateway = self.gateways.get(index.at())?;
            Some(Exit { kind: gateway.config.kind, open: gateway.open, mtu_bytes: gateway.config.mtu_bytes })
        })
    }

    /// Stacks a packet that has its tag.
    pub(crate) fn stack_up(&mut self, id: SlotId, now: LocalTicks) {
        let taker = self.pool.tag(&id).taker;
        match taker {
            Taker::Gateway(index) => self.gateways[index.at()].waiting += 1,
            Taker::Port(index) => self.ports[index.at()].waiting += 1,
        }
        self.stack.insert(&mut self.pool, id);
        self.stage(Stage::Stack, taker, now);
    }

    /// Keeps `waiting` true for a packet just taken out of the stack.
    pub(crate) fn leave_stack(&mut self, id: &SlotId) {
        match self.pool.tag(id).taker {
            Taker::Gateway(index) => self.gateways[index.at()].waiting -= 1,
            Taker::Port(index) => self.ports[index.at()].waiting -= 1,
        }
    }

    /// Gives a slot back to the pool and its owner's hold, `[NOD-02]`.
    pub(crate) fn relinquish(&mut self, id: SlotId) {
        let owner = self.pool.tag(&id).owner;
        self.pool.relinquish(id);
        self.change_hold(owner, -1);
    }

    /// Drops a packet that has a slot.
    #[cold]
    pub(crate) fn discard(&mut self, id: SlotId, cause: DropCause, now: LocalTicks) {
        let gateway = match self.pool.tag(&id).owner {
            Owner::Gateway(index) => Some(index),
            Owner::Port(_) => None,
        };
        self.relinquish(id);
        self.count(cause, gateway, now);
    }

    /// Records that a packet passed a stage.
    #[inline]
    pub(crate) fn stage(&mut self, stage: Stage, who: Taker, now: LocalTicks) {
        let index = || match who {
            Taker::Gateway(index) => u16::from(index.get()),
            Taker::Port(index) => index.get(),
        };
        self.debug.record(Verbosity::Packets, now, || Event::Stage { stage, index: index() });
    }

    fn hold_of(&self, owner: Owner) -> (u8, u8) {
        match owner {
            Owner::Gateway(index) => {
                let gateway = &self.gateways[index.at()];
                (gateway.held, gateway.config.packet_hold_max)
            }
            Owner::Port(index) => {
                let port = &self.ports[index.at()];
                (port.held, port.config.packet_hold_max)
            }
        }
    }

    fn change_hold(&mut self, owner: Owner, by: i8) {
        let held = match owner {
            Owner::Gateway(index) => &mut self.gateways[index.at()].held,
            Owner::Port(index) => &mut self.ports[index.at()].held,
        };
        *held = held.saturating_add_signed(by);
    }
}
