//! Port 0: answers what a scanner asks.
//!
//! - **Walk:** stack → *here* → the query's own packet, turned back → stack.
//! - **Invariants:** one answer or one named drop a query, in bounded time; a refusal changes nothing; asking again gives the same,
//!   since a request may come more than once, `[TRN-06]`.
//! - **Context:** the node's (the routing task), so that no user code delays it. **Clauses:** `[DSC-01]` to `[DSC-07]`.

use crate::clock::Clock;
use crate::counters::Counters;
use crate::debug::DebugRing;
use crate::gateway::Gateway;
use crate::mailbox::{Delivery, Mailbox};
use crate::node::{Identity, Node};
use crate::pool::Pool;
use crate::port::Port;
use fixed_math::time::LocalTicks;
use osap_protocol::discovery::{
    BODY_BYTES_MAX, Event, Message, NAME_BYTES_MAX, Name, Query, Refusal, RuntimeInfo, ScanId, TimeAsymmetry,
    TimeSettings, VERSION, Verbosity, check_query, decode, encode,
};
use osap_protocol::header::PORT_HEADER_BYTES;
use osap_protocol::transport::{SequencedHeader, SequencedKind};
use osap_protocol::{DropCause, PortIndex};

/// Longest query: a name, with its length, behind key and version, and room to spare for time settings (6 numbers of 5 bytes).
const QUERY_BYTES_MAX: usize = 2 + 1 + NAME_BYTES_MAX;

impl<const SLOTS: usize, const BYTES: usize, const GATEWAYS: usize, const PORTS: usize>
    Node<SLOTS, BYTES, GATEWAYS, PORTS>
{
    /// Answers every query that waits, at most one a slot.
    pub(crate) fn answer_queries(&mut self, now: LocalTicks) {
        while self.waiting(PortIndex::NETRESPONDER) > 0 {
            // what has expired is taken for nobody
            let Some(delivery) = self.take(PortIndex::NETRESPONDER, now) else { break };
            self.answer(delivery, now);
        }
    }

    fn answer(&mut self, delivery: Delivery, now: LocalTicks) {
        let cause = match delivery.sequenced.map(|header| header.kind) {
            Some(SequencedKind::Request) => check_query(self.payload(&delivery)).err(),
            Some(SequencedKind::Reply | SequencedKind::Refusal) => Some(DropCause::ReplyUnmatched),
            None => Some(DropCause::QueryMalformed),
        };
        if let Some(cause) = cause {
            self.release(delivery, Some(cause), now);
            return;
        }
        let payload = self.payload(&delivery);
        let key = payload[0];
        // a copy of the query, and its slot for the answer: nothing else is as long
        let query = heapless::Vec::<u8, QUERY_BYTES_MAX>::from_slice(payload);
        let served = match query {
            Ok(query) => {
                let limit = self.room_for_answer(&delivery);
                let (pool, mut desk) = self.desk(now);
                let room = delivery.room(pool);
                let limit = limit.min(room.len());
                decode(&query).and_then(|message| desk.serve(message, &mut room[..limit]))
            }
            // longer than any query: its body cannot decode, if its version is ours at all
            Err(_) => decode(payload).and(Err(Refusal::Body)),
        };
        // an answer is counted where it fails, so nothing is lost silently
        let _counted = match served {
            Ok(len) => self.reply_in_place(delivery, len, now),
            Err(refusal) => self.refuse(delivery, &[&[key, VERSION, refusal.code()]], now),
        };
    }

    /// The pool, and all else that a query may read or change.
    fn desk(&mut self, now: LocalTicks) -> (&mut Pool<SLOTS, BYTES>, Desk<'_, SLOTS, BYTES>) {
        let desk = Desk {
            now,
            identity: &self.identity,
            name: &mut self.name,
            renamed: &mut self.renamed,
            gateways: &mut self.gateways,
            ports: &self.ports,
            counters: &self.counters,
            debug: &mut self.debug,
            clock: &mut self.clock,
            visits: &mut self.visits,
            topology_generation: self.topology_generation,
        };
        (&mut self.pool, desk)
    }

    /// Bytes that an answer may have, so that its packet fits the route's MTU and the slot.
    fn room_for_answer(&self, delivery: &Delivery) -> usize {
        let head = PORT_HEADER_BYTES + self.taken_steps(delivery).len() + SequencedHeader::LEN;
        let mtu = usize::from(delivery.mtu_bytes).min(BYTES);
        mtu.saturating_sub(head).min(2 + BODY_BYTES_MAX)
    }
}

/// What queries read and change, apart from the pool: the answer is written into the query's own slot.
struct Desk<'a, const SLOTS: usize, const BYTES: usize> {
    now: LocalTicks,
    identity: &'a Identity,
    name: &'a mut Name,
    renamed: &'a mut bool,
    gateways: &'a mut [Gateway],
    ports: &'a [Port],
    counters: &'a Counters,
    debug: &'a mut DebugRing,
    clock: &'a mut Clock,
    visits: &'a mut [ScanId; 2],
    topology_generation: u32,
}

impl<const SLOTS: usize, const BYTES: usize> Desk<'_, SLOTS, BYTES> {
    /// Carries out one query and writes its answer into `out`.
    fn serve(&mut self, message: Message<'_>, out: &mut [u8]) -> Result<usize, Refusal> {
        let Message { key, body } = message;
        match Query::from_key(key)? {
            Query::RuntimeInfo => {
                let id = body.read()?;
                let info = self.runtime_info(id);
                let len = encode(key, &info, out)?;
                self.remember_visit(id);
                Ok(len)
            }
            Query::TypeName => {
                body.read::<()>()?;
                encode(key, &crate::port::name_of(self.identity.type_name), out)
            }
            Query::RuntimeName => {
                body.read::<()>()?;
                encode(key, &*self.name, out)
            }
            Query::SetRuntimeName => {
                let name = body.read()?;
                self.rename(name);
                encode(key, &(), out)
            }
            Query::LinkInfo => {
                let gateway = self.gateways.get(usize::from(body.read::<u8>()?)).ok_or(Refusal::Index)?;
                encode(key, &gateway.info(), out)
            }
            Query::PortInfo => {
                let port = self.ports.get(usize::from(body.read::<u16>()?)).ok_or(Refusal::Index)?;
                encode(key, &port.info(), out)
            }
            Query::DebugMessages => {
                let cursor = body.read()?;
                self.encode_debug_page(cursor, out)
            }
            Query::SetDebugVerbosity => {
                let verbosity = body.read::<Verbosity>()?;
                self.debug.set_verbosity(verbosity);
                encode(key, &(), out)
            }
            Query::TimeControl => {
                body.read::<()>()?;
                self.clock.control(self.gateways, self.now).encode(out)
            }
            Query::SetTimeControl => {
                self.clock.set(body.read::<TimeSettings>()?)?;
                encode(key, &(), out)
            }
            Query::Counters => {
                let first = body.read()?;
                self.encode_counter_page(first, out)
            }
            Query::TimeStatus => {
                body.read::<()>()?;
                encode(key, &self.clock.status(self.now), out)
            }
            Query::TimeLink => {
                let gateway = self.gateways.get(usize::from(body.read::<u8>()?)).ok_or(Refusal::Index)?;
                encode(key, &gateway.peer.info(self.now), out)
            }
            Query::SetTimeAsymmetry => {
                self.calibrate(&body.read()?)?;
                encode(key, &(), out)
            }
        }
    }

    fn runtime_info(&self, id: ScanId) -> RuntimeInfo {
        let [last, before] = *self.visits;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "six bits, eleven bits, sixteen bits by Node::new and Pool::new"
        )]
        RuntimeInfo {
            // the same id again is a retry, and gets what the first try got, `[DSC-03]`
            previous: if id == last { before } else { last },
            unique_id: self.identity.unique_id,
            boot_epoch: self.identity.boot_epoch,
            version: self.identity.version,
            build: self.identity.build,
            gateways: self.gateways.len() as u8,
            ports: self.ports.len() as u16,
            packet_bytes_max: BYTES as u16,
            slots: SLOTS as u16,
            topology_generation: self.topology_generation,
            uptime_us: self.now.as_us(),
        }
    }

    fn remember_visit(&mut self, id: ScanId) {
        let [last, _] = *self.visits;
        if id != last {
            *self.visits = [id, last];
        }
    }

    #[cold]
    fn rename(&mut self, name: Name) {
        if *self.name != name {
            *self.name = name;
            *self.renamed = true;
            self.debug.record(Verbosity::Events, self.now, || Event::Renamed);
        }
    }

    /// Sets the asymmetry of all links of a type, `[TIM-13]`.
    #[cold]
    fn calibrate(&mut self, to: &TimeAsymmetry) -> Result<(), Refusal> {
        let mut found = false;
        for gateway in &mut *self.gateways {
            if gateway.config.type_name == to.type_name.as_str() {
                gateway.peer.calibrate(to.asymmetry_steps, gateway.config.stamps);
                found = true;
            }
        }
        self.clock.is_changed |= found;
        if found { Ok(()) } else { Err(Refusal::Index) }
    }

    /// A page of as many counters as fit, `[DSC-06]`.
    #[inline(never)]
    fn encode_counter_page(&self, first: u8, out: &mut [u8]) -> Result<usize, Refusal> {
        let mut page = self.counters.page(first);
        loop {
            match encode(Query::Counters.key(), &page, out) {
                Err(Refusal::TooLong) if page.values.pop().is_some() => {}
                result => return result,
            }
        }
    }

    /// A page of as many events as fit, `[DSC-06]`.
    #[inline(never)]
    fn encode_debug_page(&self, cursor: u32, out: &mut [u8]) -> Result<usize, Refusal> {
        let mut page = self.debug.page(cursor, self.clock.mark(self.now));
        loop {
            match encode(Query::DebugMessages.key(), &page, out) {
                Err(Refusal::TooLong) if page.events.pop().is_some() => page.next = page.next.wrapping_sub(1),
                result => return result,
            }
        }
    }
}
