//! What a running link and the node's thread say to each other.
//!
//! - **Walk:** a link's threads → [`LinkEvent`] through one bounded channel → the node's thread → [`LinkHandle::send`] → the link's writer.
//! - **Invariants:** `send` never waits, since the node's thread is also the one that empties the events' channel. Whatever is
//!   handed over ends in one `Sent` or, where it could not leave, in one `Dropped`.
//! - **Clauses:** `[LNK-01]` one packet when clear to send, `[LNK-02]` description, `[TIM-03]` stamps of departures.

use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::framing::Check;
use osap_sim::faults::FaultCounts;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Packets handed over and not yet taken by the writer. One, by `[LNK-01]`; and one that crossed with a `Down`.
const OUTBOX_PACKETS: usize = 2;

/// What a link's threads tell the node's thread. Sent through one bounded `SyncSender<(GatewayIndex, LinkEvent)>`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// It opened (again), and is clear to send.
    Up,
    /// It closed, or could not be opened; the reason is for people. It may come back. No `Sent` follows for what was handed
    /// over before.
    Down {
        /// For people, with what to do where something can be done.
        reason: String,
    },
    /// One whole, checked packet with the stamp of its first byte.
    Packet {
        /// The packet, without framing.
        bytes: Vec<u8>,
        /// When its first byte came, by the link's [`Clock`](super::Clock), `[FRM-08]`.
        started: LocalTicks,
    },
    /// A frame that gave no packet, a packet that could not leave, or a peer that was refused: to be counted.
    Dropped(DropCause),
    /// The packet handed over last is out: clear to send.
    Sent,
}

/// What does not change about a link while it runs, `[LNK-02]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkDescription {
    /// Which one, for people: `tcp:127.0.0.1:4100`.
    pub name: String,
    /// Kind of hardware: `usb-cdc`, `serial`, `tcp`, `udp`, `pty` or `in-process`.
    pub type_name: String,
    /// Largest packet, bytes.
    pub mtu_bytes: u16,
    /// Bits a second on the wire; 0 where unknown.
    pub bit_rate: u32,
    /// Bits each byte takes: 10 on a UART, 8 elsewhere.
    pub bits_a_byte: u8,
    /// What guards its frames.
    pub check: Check,
}

/// The link's threads have ended, and nothing can be sent any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the link's threads have ended")]
pub struct LinkGone;

/// What the fault layers of a link did so far, `[LNK-07]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkFaults {
    /// To what was sent.
    pub outgoing: FaultCounts,
    /// To what was received.
    pub incoming: FaultCounts,
}

/// A running link: takes one packet at a time when clear to send, `[LNK-01]`. Dropping it stops its threads and joins them.
#[derive(Debug)]
pub struct LinkHandle {
    /// What it is.
    pub description: LinkDescription,
    outbox: Option<SyncSender<Parcel>>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl LinkHandle {
    /// A handle whose threads are still to be started, and what they are started with.
    pub(super) fn new(description: LinkDescription) -> (Self, Receiver<Parcel>, Arc<Shared>) {
        let (outbox, packets) = sync_channel(OUTBOX_PACKETS);
        let shared = Arc::new(Shared::default());
        let handle = Self { description, outbox: Some(outbox), shared: Arc::clone(&shared), threads: Vec::new() };
        (handle, packets, shared)
    }

    /// Makes a thread one of those that end with the handle.
    pub(super) fn keep(&mut self, thread: JoinHandle<()>) {
        self.threads.push(thread);
    }

    /// Hands over one packet. It never waits: call it after `Up` or `Sent`, once for each. A packet too many, which can only
    /// be one that crossed with a `Down`, is dropped as `send-refused`.
    ///
    /// # Errors
    /// [`LinkGone`] where the link has ended for good.
    pub fn send(&self, packet: Vec<u8>) -> Result<(), LinkGone> {
        self.hand_over(Parcel { packet, is_stamped: false })
    }

    /// As [`LinkHandle::send`], of a packet that ends in a stamp slot: the link writes there when it leaves, `[TIM-03]`.
    ///
    /// # Errors
    /// [`LinkGone`] where the link has ended for good.
    pub fn send_stamped(&self, packet: Vec<u8>) -> Result<(), LinkGone> {
        self.hand_over(Parcel { packet, is_stamped: true })
    }

    fn hand_over(&self, parcel: Parcel) -> Result<(), LinkGone> {
        let outbox = self.outbox.as_ref().ok_or(LinkGone)?;
        match outbox.try_send(parcel) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => {
                self.shared.refused.fetch_add(1, Ordering::Relaxed);
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => Err(LinkGone),
        }
    }

    /// What its fault layers did so far; `None` where it has none.
    #[must_use]
    pub fn faults(&self) -> Option<LinkFaults> {
        *self.shared.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for LinkHandle {
    fn drop(&mut self) {
        self.shared.stop.set();
        self.outbox = None; // ends the writer's wait
        for thread in self.threads.drain(..) {
            // A thread that panicked has printed so itself; the others shall still be joined.
            let _ = thread.join();
        }
    }
}

/// A packet on its way to the writer.
#[derive(Debug)]
pub(super) struct Parcel {
    pub(super) packet: Vec<u8>,
    /// It ends in a stamp slot.
    pub(super) is_stamped: bool,
}

/// What a handle and its threads have in common.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// Set when the handle is dropped.
    pub(super) stop: Stop,
    /// Packets that did not fit the outbox, not yet told to the node.
    pub(super) refused: AtomicU32,
    /// Kept up to date by the threads where the link has fault layers.
    pub(super) faults: Mutex<Option<LinkFaults>>,
}

/// A flag that ends waits.
#[derive(Debug, Default)]
pub(super) struct Stop {
    set: AtomicBool,
    lock: Mutex<()>,
    changed: Condvar,
}

impl Stop {
    /// Ends the link.
    pub(super) fn set(&self) {
        // Under the lock, so that no waiter is between its look at the flag and its wait.
        let _guard = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        self.set.store(true, Ordering::Release);
        self.changed.notify_all();
    }

    /// Whether the link shall end.
    pub(super) fn is_set(&self) -> bool {
        self.set.load(Ordering::Acquire)
    }

    /// Waits for `duration`, or shorter where the link shall end.
    pub(super) fn wait(&self, duration: Duration) {
        let guard = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        let _outcome = self.changed.wait_timeout_while(guard, duration, |()| !self.is_set());
    }
}
