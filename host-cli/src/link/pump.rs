//! The two threads of every link: one opens it and reads, one writes.
//!
//! - **Walk in:** [`Opener`] → [`Source`] → fault layer → frame's check → [`LinkEvent::Packet`].
//!   **Walk out:** outbox → frame → fault layer → [`Sink`] → [`LinkEvent::Sent`].
//! - **Invariants:** for the node's thread events come as `Up`, then any number of `Sent`, then `Down`: each is sent under the lock
//!   of [`Current`]. A full events' channel makes both threads wait. No wait is longer than [`WAIT_MAX`] without a look at the stop flag.
//!   A departure's stamp is read before its first byte leaves, however long that then takes.
//! - **Context:** in real time a fault layer is as exact as the system's timers: some milliseconds late on a socket.
//! - **Clauses:** `[LNK-01]`, `[LNK-06]` opening again, `[LNK-07]` faults, `[FRM-06]`, `[FRM-07]`, `[FRM-08]`, `[TIM-03]` departures.

use super::handle::{LinkFaults, Parcel, Shared};
use super::{Clock, LinkDescription, LinkError, LinkEvent, LinkHandle, LinkOptions, MTU_BYTES_MAX};
use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::address::GatewayIndex;
use osap_protocol::framing::{self, Check, Deframer};
use osap_protocol::time::stamp;
use osap_sim::faults::FaultLayer;
use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Longest wait without a look at whether the link shall end.
pub(super) const WAIT_MAX: Duration = Duration::from_millis(100);
/// Between two looks at an events' channel that is full.
const FULL_RETRY: Duration = Duration::from_millis(1);
/// Longest packet with the longest check.
const FRAME_BYTES_MAX: usize = MTU_BYTES_MAX as usize + Check::Crc32.len();

/// What a medium gave.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Incoming {
    /// A frame with its delimiter, or a whole packet, and the stamp of its first byte.
    Frame { bytes: Vec<u8>, started: LocalTicks },
    /// Something that is none.
    Bad(DropCause),
}

/// The half of an open link that gives frames.
pub(super) trait Source: Send {
    /// Waits at most `wait` and appends what came; nothing at all is no error. An error ends the session, after what was appended.
    fn read(&mut self, wait: Duration, out: &mut Vec<Incoming>) -> io::Result<()>;
}

/// The half of an open link that takes frames.
pub(super) trait Sink: Send {
    /// Puts one frame out whole, or fails: as soon as `ending` is set too. An error ends the session.
    fn write(&mut self, frame: &[u8], ending: &Ending<'_>) -> io::Result<()>;
}

/// An open link.
pub(super) struct Session {
    pub(super) source: Box<dyn Source>,
    pub(super) sink: Box<dyn Sink>,
}

/// How an attempt to open ended.
pub(super) enum Attempt {
    Opened(Session),
    /// Nobody came yet; nothing is wrong. The opener has waited.
    NotYet,
    /// It did not work; worth another try after a while.
    Failed(String),
    /// Somebody was there who does not have the key, `[LNK-05]`.
    Refused(String),
    /// It will never open again.
    Over(String),
}

/// Opens a link, again and again.
pub(super) trait Opener: Send {
    /// Tries once. May wait for somebody for up to [`WAIT_MAX`].
    fn open(&mut self, ending: &Ending<'_>) -> Attempt;

    /// Time to the next try after `failures` in a row, one or more.
    fn retry_after(&self, failures: u32) -> Duration;
}

/// How packets become frames.
#[derive(Clone, Copy, Debug)]
pub(super) enum Form {
    /// COBS with this check, `[FRM-01]`.
    Stuffed(Check),
    /// One packet a datagram or message, `[FRM-09]`.
    Whole,
}

/// Tells a wait that is under way to give up: the handle was dropped, or the session ended.
pub(super) struct Ending<'a> {
    shared: &'a Shared,
    session: &'a AtomicBool,
}

impl Ending<'_> {
    pub(super) fn is_set(&self) -> bool {
        self.shared.stop.is_set() || self.session.load(Ordering::Acquire)
    }

    /// Waits, but not past the end of the link.
    pub(super) fn wait(&self, duration: Duration) {
        self.shared.stop.wait(duration);
    }
}

/// The thread shall end.
struct Ended;

/// Where a link's threads send their events.
#[derive(Clone)]
struct Events {
    gateway: GatewayIndex,
    channel: SyncSender<(GatewayIndex, LinkEvent)>,
    shared: Arc<Shared>,
}

impl Events {
    /// Waits while the channel is full: this is what slows a peer down that sends more than the node takes.
    fn emit(&self, event: LinkEvent) -> Result<(), Ended> {
        let mut message = (self.gateway, event);
        loop {
            message = match self.channel.try_send(message) {
                Ok(()) => return Ok(()),
                Err(TrySendError::Disconnected(_)) => return Err(Ended),
                Err(TrySendError::Full(_)) if self.shared.stop.is_set() => return Err(Ended),
                Err(TrySendError::Full(message)) => message,
            };
            self.shared.stop.wait(FULL_RETRY);
        }
    }
}

/// The session of now, as the writer sees it.
struct Current {
    /// Counts sessions, so that a `Sent` owed to one is not given to the next.
    number: u64,
    sink: Option<Box<dyn Sink>>,
}

/// What the two threads share beside the handle's part.
struct Between {
    current: Mutex<Current>,
    /// Tells a writer that waits, and so holds the lock of `current`, that the session is over.
    session_over: AtomicBool,
    /// What the writer found wrong, for the reader to end the session with.
    writer_failed: Mutex<Option<String>>,
}

impl Between {
    fn current(&self) -> MutexGuard<'_, Current> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failure(&self) -> MutexGuard<'_, Option<String>> {
        self.writer_failed.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Everything [`start`] needs but the opener.
pub(super) struct Plan<'a> {
    pub(super) description: LinkDescription,
    pub(super) form: Form,
    pub(super) gateway: GatewayIndex,
    pub(super) events: SyncSender<(GatewayIndex, LinkEvent)>,
    pub(super) clock: &'a Clock,
    pub(super) options: &'a LinkOptions,
}

/// Starts a link's threads.
pub(super) fn start(plan: Plan<'_>, opener: Box<dyn Opener>) -> Result<LinkHandle, LinkError> {
    let Plan { description, form, gateway, events, clock, options } = plan;
    let (name, mtu) = (description.name.clone(), usize::from(description.mtu_bytes));
    let (mut handle, outbox, shared) = LinkHandle::new(description);
    let events = Events { gateway, channel: events, shared: Arc::clone(&shared) };
    let between = Arc::new(Between {
        current: Mutex::new(Current { number: 0, sink: None }),
        session_over: AtomicBool::new(true),
        writer_failed: Mutex::new(None),
    });
    // Draws of their own for each gateway and direction of one seed.
    let layer = |direction: u64| {
        let stream = u64::from(gateway.get()) * 2 + direction;
        options.faults.map(|faults| FaultLayer::new(faults.for_stream(stream)))
    };
    let (outgoing, incoming) = (layer(0), layer(1));
    if outgoing.is_some() {
        *shared.faults.lock().unwrap_or_else(PoisonError::into_inner) = Some(LinkFaults::default());
    }

    let mut writer = Writer {
        events: events.clone(),
        between: Arc::clone(&between),
        outbox,
        form,
        mtu,
        clock: clock.clone(),
        faults: outgoing,
        owed: VecDeque::new(),
    };
    let mut reader = Reader {
        events,
        between,
        opener,
        form,
        mtu,
        clock: clock.clone(),
        faults: incoming,
        deframer: Box::new(Deframer::new(match form {
            Form::Stuffed(check) => check,
            Form::Whole => Check::None,
        })),
        told: None,
    };
    let spawn = |role: &str, body: Box<dyn FnOnce() + Send>| {
        let thread = std::thread::Builder::new().name(format!("{role} {name}"));
        thread.spawn(body).map_err(|source| LinkError::Thread { name: name.clone(), source })
    };
    handle.keep(spawn("write", Box::new(move || writer.run()))?);
    handle.keep(spawn("read", Box::new(move || reader.run()))?);
    Ok(handle)
}

/// Opens the link and reads from it.
struct Reader {
    /// First of the fields, so that it is dropped before the session's sink: a listener has closed by the time its peer sees the
    /// connection end and calls again.
    opener: Box<dyn Opener>,
    events: Events,
    between: Arc<Between>,
    form: Form,
    mtu: usize,
    clock: Clock,
    faults: Option<FaultLayer>,
    deframer: Box<Deframer<FRAME_BYTES_MAX>>,
    /// Why the link is down, as told last: the same reason is told once, not with every try.
    told: Option<String>,
}

impl Reader {
    fn run(&mut self) {
        let mut failures = 0;
        // `Ended` says no more than that the handle or the node's thread is gone.
        while !self.events.shared.stop.is_set() && self.open_and_read(&mut failures).is_ok() {}
        // It will not open again: the writer need not wait for packets either.
        self.events.shared.stop.set();
    }

    fn open_and_read(&mut self, failures: &mut u32) -> Result<(), Ended> {
        let between = Arc::clone(&self.between);
        let shared = Arc::clone(&self.events.shared);
        // There is no session to end yet.
        let attempt = self.opener.open(&Ending { shared: &shared, session: &AtomicBool::new(false) });
        match attempt {
            Attempt::NotYet => return Ok(()),
            Attempt::Opened(Session { source, sink }) => {
                *failures = 0;
                let reason = self.session(source, sink)?;
                between.session_over.store(true, Ordering::Release);
                let mut current = between.current();
                current.sink = None;
                self.told = Some(reason.clone());
                return self.events.emit(LinkEvent::Down { reason });
            }
            Attempt::Failed(reason) => self.tell_down(reason)?,
            Attempt::Refused(reason) => {
                self.events.emit(LinkEvent::Dropped(DropCause::PeerRefused))?;
                self.tell_down(reason)?;
            }
            Attempt::Over(reason) => {
                self.tell_down(reason)?;
                return Err(Ended);
            }
        }
        *failures = failures.saturating_add(1);
        shared.stop.wait(self.opener.retry_after(*failures));
        Ok(())
    }

    fn tell_down(&mut self, reason: String) -> Result<(), Ended> {
        if self.told.as_ref() == Some(&reason) {
            return Ok(());
        }
        self.told = Some(reason.clone());
        self.events.emit(LinkEvent::Down { reason })
    }

    /// Reads until the session ends, and says why it did.
    fn session(&mut self, mut source: Box<dyn Source>, sink: Box<dyn Sink>) -> Result<String, Ended> {
        self.deframer.reset();
        self.told = None;
        *self.between.failure() = None;
        {
            let mut current = self.between.current();
            current.number += 1;
            current.sink = Some(sink);
            self.between.session_over.store(false, Ordering::Release);
            self.events.emit(LinkEvent::Up)?;
        }
        let mut incoming = Vec::new();
        loop {
            let due = self.faults.as_ref().and_then(FaultLayer::next_at);
            let wait = due.map_or(WAIT_MAX, |at| self.clock.until(at).min(WAIT_MAX));
            let outcome = source.read(wait, &mut incoming);
            for item in incoming.drain(..) {
                self.take(item)?;
            }
            self.release()?;
            if let Err(error) = outcome {
                return Ok(error.to_string());
            }
            if let Some(reason) = self.between.failure().take() {
                return Ok(reason);
            }
            if self.events.shared.stop.is_set() {
                return Err(Ended);
            }
        }
    }

    fn take(&mut self, item: Incoming) -> Result<(), Ended> {
        match (item, &mut self.faults) {
            (Incoming::Bad(cause), _) => self.events.emit(LinkEvent::Dropped(cause)),
            (Incoming::Frame { bytes, .. }, Some(layer)) => {
                layer.offer(self.clock.now(), &bytes);
                Ok(())
            }
            (Incoming::Frame { bytes, started }, None) => self.deliver(bytes, started),
        }
    }

    /// What the fault layer lets out now; the stamp is then that of its coming out.
    fn release(&mut self) -> Result<(), Ended> {
        let now = self.clock.now();
        while let Some(bytes) = self.faults.as_mut().and_then(|layer| layer.poll(now)) {
            self.deliver(bytes, now)?;
        }
        if let Some(layer) = &self.faults {
            note(&self.events.shared, |faults| faults.incoming = layer.counts());
        }
        Ok(())
    }

    /// Frame to packet.
    fn deliver(&mut self, bytes: Vec<u8>, started: LocalTicks) -> Result<(), Ended> {
        let mtu = self.mtu;
        let event = |bytes: Vec<u8>, started| match bytes.len() {
            0 => LinkEvent::Dropped(DropCause::FrameTooShort),
            len if len > mtu => LinkEvent::Dropped(DropCause::FrameTooLong),
            _ => LinkEvent::Packet { bytes, started },
        };
        if let Form::Whole = self.form {
            return self.events.emit(event(bytes, started));
        }
        // Byte by byte even here, since a fault can take a delimiter away or make one.
        for byte in bytes {
            match self.deframer.push(byte, started) {
                None => {}
                Some(Ok(frame)) => self.events.emit(event(frame.packet.to_vec(), frame.started))?,
                Some(Err(error)) => self.events.emit(LinkEvent::Dropped(error.into()))?,
            }
        }
        Ok(())
    }
}

/// Takes packets from the node and writes them.
struct Writer {
    events: Events,
    between: Arc<Between>,
    outbox: Receiver<Parcel>,
    form: Form,
    mtu: usize,
    clock: Clock,
    faults: Option<FaultLayer>,
    /// Sessions to which a `Sent` is owed, and when the fault layer's wire is free.
    owed: VecDeque<(u64, LocalTicks)>,
}

impl Writer {
    fn run(&mut self) {
        while self.step().is_ok() {}
    }

    fn step(&mut self) -> Result<(), Ended> {
        let received = match self.next_due() {
            None => self.outbox.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(at) => self.outbox.recv_timeout(self.clock.until(at)),
        };
        match received {
            Ok(parcel) => self.take(parcel)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Err(Ended),
        }
        for _ in 0..self.events.shared.refused.swap(0, Ordering::Relaxed) {
            self.events.emit(LinkEvent::Dropped(DropCause::SendRefused))?;
        }
        self.release()?;
        if self.events.shared.stop.is_set() { Err(Ended) } else { Ok(()) }
    }

    fn next_due(&self) -> Option<LocalTicks> {
        let owed = self.owed.front().map(|(_, at)| *at);
        let inside = self.faults.as_ref().and_then(FaultLayer::next_at);
        [owed, inside].into_iter().flatten().min()
    }

    fn take(&mut self, parcel: Parcel) -> Result<(), Ended> {
        let Parcel { mut packet, is_stamped } = parcel;
        let number = self.between.current().number;
        if packet.len() > self.mtu {
            self.events.emit(LinkEvent::Dropped(DropCause::OverMtu))?;
            return self.sent(number);
        }
        if is_stamped {
            // read before the byte leaves, so that what holds this thread up from here on only lengthens the round trip
            stamp(&mut packet, self.clock.now());
        }
        let frame = match self.form {
            Form::Whole => packet,
            Form::Stuffed(check) => stuffed(&packet, check),
        };
        let Some(layer) = &mut self.faults else {
            return if self.write(&frame)? { self.sent(number) } else { Ok(()) };
        };
        layer.offer(self.clock.now(), &frame);
        self.owed.push_back((number, layer.free_at()));
        Ok(())
    }

    /// What the fault layer lets out now, and the `Sent`s it held up.
    fn release(&mut self) -> Result<(), Ended> {
        let now = self.clock.now();
        while let Some(frame) = self.faults.as_mut().and_then(|layer| layer.poll(now)) {
            self.write(&frame)?;
        }
        if let Some(layer) = &self.faults {
            note(&self.events.shared, |faults| faults.outgoing = layer.counts());
        }
        while let Some((number, _)) = self.owed.pop_front_if(|(_, at)| *at <= now) {
            self.sent(number)?;
        }
        Ok(())
    }

    /// Whether the frame went out. Where it did not, the session is over and the packet counted.
    fn write(&mut self, frame: &[u8]) -> Result<bool, Ended> {
        let between = Arc::clone(&self.between);
        let mut current = between.current();
        let ending = Ending { shared: &self.events.shared, session: &between.session_over };
        let outcome = current.sink.as_mut().map(|sink| sink.write(frame, &ending));
        match outcome {
            Some(Ok(())) => return Ok(true),
            Some(Err(error)) => {
                current.sink = None;
                *between.failure() = Some(error.to_string());
            }
            None => {}
        }
        drop(current);
        self.events.emit(LinkEvent::Dropped(DropCause::GatewayClosed))?;
        Ok(false)
    }

    /// Clear to send, unless the session in which the packet was taken is over: then the next `Up` says it.
    fn sent(&self, number: u64) -> Result<(), Ended> {
        let current = self.between.current();
        if current.number == number && current.sink.is_some() {
            self.events.emit(LinkEvent::Sent)?;
        }
        Ok(())
    }
}

/// A packet as a frame of its own, `[FRM-01]`.
fn stuffed(packet: &[u8], check: Check) -> Vec<u8> {
    let mut frame = vec![0; framing::encoded_len_max(packet.len(), check)];
    let len =
        framing::encode(packet, check, &mut frame).expect("the buffer is as long as the longest frame of the packet");
    frame.truncate(len);
    frame
}

fn note(shared: &Shared, change: impl FnOnce(&mut LinkFaults)) {
    let mut faults = shared.faults.lock().unwrap_or_else(PoisonError::into_inner);
    change(faults.get_or_insert_default());
}
