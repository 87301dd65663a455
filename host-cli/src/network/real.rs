//! The host's node over links of this computer: one thread for the node, the links' own beside it.
//!
//! - **Walk:** a link's threads → one bounded channel → the node's thread → [`HostCore`] → the link's writer, one packet when it is clear
//!   to send. The caller hands in one [`Task`] at a time and waits until it is done.
//! - **Invariants:** bounded channels only. The node's thread waits for nothing but the next event or the core's next wake, never
//!   longer and never in a loop. Dropping the network ends and joins all threads.
//! - **Context:** the calls are the caller's thread's; `Runner` is the node's.
//! - **Clauses:** `[LNK-01]`, `[NOD-12]`, `[TIM-03]`, `[TIM-14]`.

use super::capture::LinkCapture;
use super::{Network, Task};
use crate::core::{HostCore, HostIdentity, LINKS_MAX};
use crate::error::{NetworkError, OpenError};
use crate::link::{self, Clock, LinkDescription, LinkEvent, LinkHandle, LinkSpec};
use crate::session::{OpenOptions, host_identity};
use fixed_math::time::{LocalTicks, Span};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::GatewayKind;
use osap_protocol::header::Arrival;
use osap_runtime::{GatewayConfig, Stamps};
use osap_sim::capture::Direction;
use osap_sim::endpoint::Endpoint;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{SystemTime, UNIX_EPOCH};

/// Events of links that wait for the node's thread; beyond that the links' readers wait, and then the peers.
const EVENTS_MAX: usize = 256;
/// Events taken before the core is run: fewer than what one link may hold.
const EVENTS_A_RUN: usize = 32;
/// The least that is waited for where something is due already that only an event can set going.
const PATIENCE: Span = Span::from_us(1_000);
/// Between two offers of UNIX time, which computers correct by and by.
const UNIX_INTERVAL: Span = Span::from_us(1_000_000);
/// The longest wait: `recv_timeout` takes no "for ever".
const WAIT_MAX: Span = Span::from_us(60_000_000);
/// A gateway that no link has. An event from it says nothing but that a job waits.
const WAKE: u8 = 63;
const _: () = assert!(LINKS_MAX <= WAKE as usize, "the waker's number is free");

/// What the caller wants the node's thread to do.
struct Job {
    until: LocalTicks,
    task: Task,
}

/// Links of this computer as a network.
#[derive(Debug)]
pub struct RealNetwork {
    clock: Clock,
    names: Vec<String>,
    jobs: Option<SyncSender<Job>>,
    waker: SyncSender<(GatewayIndex, LinkEvent)>,
    done: Receiver<()>,
    thread: Option<JoinHandle<()>>,
    capture: Option<LinkCapture>,
}

impl RealNetwork {
    /// Starts the links and the node. It returns at once; links say when they open.
    ///
    /// # Errors
    /// [`OpenError`] for what no waiting can mend.
    pub fn open(specs: &[LinkSpec], options: &OpenOptions) -> Result<Self, OpenError> {
        let clock = Clock::new();
        let mut opening = Opening::new(clock, &host_identity(options.name.as_deref()));
        if let Some(priority) = options.root {
            opening.core.set_root(priority);
        }
        opening.capture = options.capture.as_deref().map(LinkCapture::create).transpose()?;
        for spec in specs {
            opening.add(spec.to_string(), |gateway, events, clock| {
                link::open(spec, gateway, events, clock, &options.link)
                    .map_err(|source| OpenError::Link { spec: spec.to_string(), source })
            })?;
        }
        opening.start()
    }

    /// A network over links that are started by `open`, one call for each of `names`: how a test brings its own.
    ///
    /// # Errors
    /// What `open` gives, and [`OpenError`] for more links than there may be.
    pub fn over<F>(names: &[&str], clock: Clock, mut open: F) -> Result<Self, OpenError>
    where
        F: FnMut(&str, GatewayIndex, SyncSender<(GatewayIndex, LinkEvent)>, &Clock) -> Result<LinkHandle, OpenError>,
    {
        let mut opening = Opening::new(clock, &host_identity(None));
        for name in names {
            opening.add((*name).to_owned(), |gateway, events, clock| open(name, gateway, events, clock))?;
        }
        opening.start()
    }
}

impl Network for RealNetwork {
    fn drive(&mut self, until: LocalTicks, task: Task) -> Result<(), NetworkError> {
        let jobs = self.jobs.as_ref().ok_or(NetworkError::Stopped)?;
        jobs.send(Job { until, task }).map_err(|_| NetworkError::Stopped)?;
        // a full channel wakes the thread as well
        let _woken = self.waker.try_send((GatewayIndex::from_low_bits(WAKE), LinkEvent::Sent));
        self.done.recv().map_err(|_| NetworkError::Stopped)
    }

    fn now(&self) -> LocalTicks {
        self.clock.now()
    }

    fn link_names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn is_simulated(&self) -> bool {
        false
    }

    fn capture_fault(&self) -> Option<String> {
        self.capture.as_ref().and_then(LinkCapture::fault)
    }
}

impl Drop for RealNetwork {
    fn drop(&mut self) {
        self.jobs = None;
        let _woken = self.waker.try_send((GatewayIndex::from_low_bits(WAKE), LinkEvent::Sent));
        if let Some(thread) = self.thread.take() {
            // a thread that panicked has said so itself
            let _ended = thread.join();
        }
    }
}

/// A network whose links are being started.
struct Opening {
    clock: Clock,
    /// Of that clock.
    tick: Span,
    core: HostCore,
    handles: Vec<LinkHandle>,
    names: Vec<String>,
    events: SyncSender<(GatewayIndex, LinkEvent)>,
    inbox: Receiver<(GatewayIndex, LinkEvent)>,
    capture: Option<LinkCapture>,
}

impl Opening {
    fn new(clock: Clock, identity: &HostIdentity) -> Self {
        let (events, inbox) = sync_channel(EVENTS_MAX);
        let core = HostCore::new(identity);
        let tick = clock.tick();
        Self { clock, tick, core, handles: Vec::new(), names: Vec::new(), events, inbox, capture: None }
    }

    fn add(
        &mut self,
        name: String,
        open: impl FnOnce(GatewayIndex, SyncSender<(GatewayIndex, LinkEvent)>, &Clock) -> Result<LinkHandle, OpenError>,
    ) -> Result<(), OpenError> {
        let number = self.handles.len();
        let too_many = || OpenError::TooManyLinks { given: number + 1, limit: LINKS_MAX };
        let index = u8::try_from(number).ok().and_then(GatewayIndex::new).ok_or_else(too_many)?;
        let handle = open(index, self.events.clone(), &self.clock)?;
        let stamps = Stamps { tick: self.tick, wire: Span::ZERO, late: Span::ZERO };
        self.core.add_link(config_of(&handle.description, stamps)).ok_or_else(too_many)?;
        if let Some(capture) = &self.capture {
            capture.add(&name, handle.description.bit_rate);
        }
        self.handles.push(handle);
        self.names.push(name);
        Ok(())
    }

    fn start(self) -> Result<RealNetwork, OpenError> {
        let Self { clock, core, handles, names, events, inbox, capture, .. } = self;
        let (jobs, job_inbox) = sync_channel(1);
        let (done_sender, done) = sync_channel(1);
        let runner = Runner {
            clear: vec![false; handles.len()],
            core,
            clock: clock.clone(),
            handles,
            inbox,
            jobs: job_inbox,
            done: done_sender,
            job: None,
            capture: capture.clone(),
            unix_at: LocalTicks::ZERO,
        };
        let thread = std::thread::Builder::new().name("osap-node".into()).spawn(move || runner.run());
        let thread = Some(thread.map_err(OpenError::Thread)?);
        Ok(RealNetwork { clock, names, jobs: Some(jobs), waker: events, done, thread, capture })
    }
}

/// The node's thread.
struct Runner {
    core: HostCore,
    clock: Clock,
    handles: Vec<LinkHandle>,
    /// Which links take a packet now.
    clear: Vec<bool>,
    inbox: Receiver<(GatewayIndex, LinkEvent)>,
    jobs: Receiver<Job>,
    done: SyncSender<()>,
    job: Option<Job>,
    capture: Option<LinkCapture>,
    /// When to offer UNIX time next.
    unix_at: LocalTicks,
}

impl Runner {
    fn run(mut self) {
        while self.take_job() {
            let now = self.clock.now();
            self.core.run(now);
            self.offer_unix(now);
            self.work_on_job(now);
            self.transmit();
            if !self.wait() {
                break;
            }
        }
        let Self { handles, inbox, .. } = self;
        // a link's reader may be waiting for room in the channel: without a receiver it ends, and can be joined
        drop(inbox);
        drop(handles);
    }

    /// Whether there is still somebody to work for.
    fn take_job(&mut self) -> bool {
        if self.job.is_some() {
            return true;
        }
        match self.jobs.try_recv() {
            Ok(job) => self.job = Some(job),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return false,
        }
        true
    }

    fn work_on_job(&mut self, now: LocalTicks) {
        if let Some(job) = &mut self.job
            && ((job.task)(&mut self.core, now) || job.until <= now)
        {
            self.job = None;
            // one job, one word: the channel has room, and a caller who is gone needs none
            let _told = self.done.try_send(());
        }
    }

    /// Tells the time of day now and then, `[TIM-14]`: the node wakes often enough for its exchanges.
    fn offer_unix(&mut self, now: LocalTicks) {
        if self.unix_at > now {
            return;
        }
        let unix_us = SystemTime::now().duration_since(UNIX_EPOCH).map(|since| since.as_micros());
        // a computer that believes it is before 1970 does not know the time
        if let Ok(unix_us) = unix_us.map(|us| i64::try_from(us).unwrap_or(i64::MAX))
            && self.core.offer_unix(unix_us, now)
        {
            self.unix_at = now + UNIX_INTERVAL;
        }
    }

    /// Gives each link that is clear to send its next packet, `[LNK-01]`.
    fn transmit(&mut self) {
        for (number, handle) in self.handles.iter().enumerate() {
            let Some(gateway) = u8::try_from(number).ok().and_then(GatewayIndex::new) else { continue };
            let now = self.clock.now();
            if !self.clear[number] || !self.core.has_output(gateway, now) {
                continue;
            }
            let mut packet = vec![0; usize::from(handle.description.mtu_bytes)];
            let Some(outgoing) = self.core.transmit(gateway, now, &mut packet) else { continue };
            packet.truncate(outgoing.len);
            if let Some(capture) = &self.capture {
                capture.packet(number, now, Direction::Sent, &packet);
            }
            self.clear[number] = false;
            let sent = if outgoing.is_stamped { handle.send_stamped(packet) } else { handle.send(packet) };
            if let Err(gone) = sent {
                self.core.set_link(gateway, Some(gone.to_string()), now);
            }
        }
    }

    /// Waits for events until the core or the job is due, and takes those there are; `false` where no event can ever come.
    fn wait(&mut self) -> bool {
        let now = self.clock.now();
        let wake = [self.core.next_wake(), self.job.as_ref().map(|job| job.until)].into_iter().flatten().min();
        // what is due and was not done above waits for a link to be clear: its event ends the wait
        let wake = wake
            .unwrap_or(LocalTicks::MAX)
            .max(now + if wake.is_some_and(|at| at <= now) { PATIENCE } else { Span::ZERO });
        match self.inbox.recv_timeout(self.clock.until(wake.min(now + WAIT_MAX))) {
            Ok((gateway, event)) => self.handle(gateway, event),
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
        for _ in 1..EVENTS_A_RUN {
            let Ok((gateway, event)) = self.inbox.try_recv() else { break };
            self.handle(gateway, event);
        }
        true
    }

    fn handle(&mut self, gateway: GatewayIndex, event: LinkEvent) {
        let now = self.clock.now();
        let Some(clear) = self.clear.get_mut(gateway.at()) else { return };
        match event {
            LinkEvent::Up => {
                *clear = true;
                self.core.set_link(gateway, None, now);
            }
            LinkEvent::Down { reason } => {
                *clear = false;
                self.core.set_link(gateway, Some(reason), now);
            }
            LinkEvent::Packet { mut bytes, started } => {
                if let Some(capture) = &self.capture {
                    capture.packet(gateway.at(), started, Direction::Received, &bytes);
                }
                self.core.receive(Arrival::Link(gateway), &mut bytes, started, now);
            }
            LinkEvent::Dropped(cause) => self.core.count(cause, Some(gateway), now),
            LinkEvent::Sent => *clear = true,
        }
    }
}

/// A link as the node's gateway.
fn config_of(description: &LinkDescription, stamps: Stamps) -> GatewayConfig {
    // kinds that links of this crate have; the node keeps its names in static memory
    let known = ["usb-cdc", "serial", "tcp", "udp", "pty", "in-process"];
    GatewayConfig {
        type_name: known.into_iter().find(|name| *name == description.type_name).unwrap_or("link"),
        kind: GatewayKind::Link,
        mtu_bytes: description.mtu_bytes,
        bit_rate: description.bit_rate,
        bits_a_byte: description.bits_a_byte,
        check: description.check,
        packet_hold_max: 0, // the core says what its links may hold
        stamps,
    }
}
