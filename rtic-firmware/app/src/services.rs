//! The services behind a device's ports, apart from its node: what a user function may take its time for.
//!
//! - **Walk:** stack → [`Services::serve_next`] → one service → a reply or a new packet.
//! - **Invariants:** ports from 1 on are those of the kind's table, in its order. The node is reached through a [`Mailbox`] only, so that
//!   a service holds it for single calls and never while it works.
//! - **Context:** the serving task, below routing. **Clauses:** `[APP-01]`.
//!
//! ```
//! use firmware_app::{kind, services::Services};
//! use fixed_math::time::LocalTicks;
//! use osap_protocol::discovery::{BuildKind, UniqueId};
//! use osap_runtime::{Identity, Node};
//!
//! let identity = Identity { type_name: "motor", unique_id: UniqueId([1; 12]), boot_epoch: 1, version: [0, 1, 0], build: BuildKind::Host };
//! let mut node = Node::<8, 256, 1, 5>::new(identity, "m");
//! let mut services = Services::<256, 1024>::new(&kind::MOTOR);
//! assert!(!services.serve_next(&mut node, LocalTicks::ZERO)); // nothing waits
//! ```

use crate::echo::Echo;
use crate::kind::{Kind, Service};
use crate::motion::MotionService;
use crate::spin;
use crate::stream::Stream;
use fixed_math::time::LocalTicks;
use osap_protocol::{DropCause, PortIndex};
use osap_runtime::{Delivery, Mailbox};

/// The services of one kind of device, for packets of up to `BYTES` bytes and messages of up to `MESSAGE_BYTES` bytes.
#[derive(Debug)]
pub struct Services<const BYTES: usize, const MESSAGE_BYTES: usize> {
    kind: &'static Kind,
    echo: Echo<MESSAGE_BYTES>,
    stream: Stream,
    /// Of a device that has an interpolator.
    motion: Option<MotionService>,
    /// Payload of the packet in work.
    scratch: [u8; BYTES],
}

impl<const BYTES: usize, const MESSAGE_BYTES: usize> Services<BYTES, MESSAGE_BYTES> {
    /// The services of `kind`, with nothing under way.
    #[must_use]
    pub const fn new(kind: &'static Kind) -> Self {
        Self { kind, echo: Echo::new(), stream: Stream::new(), motion: None, scratch: [0; BYTES] }
    }

    /// Gives a kind with a motion port what answers there. Without it that port refuses.
    pub fn set_motion(&mut self, motion: MotionService) {
        self.motion = Some(motion);
    }

    /// What kind of device it is.
    #[must_use]
    pub const fn kind(&self) -> &'static Kind {
        self.kind
    }

    /// The ports they stand behind.
    pub fn ports(&self) -> impl Iterator<Item = PortIndex> + use<BYTES, MESSAGE_BYTES> {
        ports(self.kind).map(|(port, _)| port)
    }

    /// At most as many packets as wait when it is called, then what is due.
    pub fn serve(&mut self, node: &mut impl Mailbox, now: LocalTicks) {
        for (port, service) in ports(self.kind) {
            for _ in 0..node.waiting(port) {
                let Some(delivery) = node.take(port, now) else { break };
                self.accept(service, node, delivery, now);
            }
            self.poll(port, service, node, now);
        }
    }

    /// What is due, and one packet if one waits: whether one did. For a task that others preempt, since it lets each packet have its own
    /// time.
    pub fn serve_next(&mut self, node: &mut impl Mailbox, now: LocalTicks) -> bool {
        for (port, service) in ports(self.kind) {
            self.poll(port, service, node, now);
            if node.waiting(port) > 0
                && let Some(delivery) = node.take(port, now)
            {
                self.accept(service, node, delivery, now);
                return true;
            }
        }
        false
    }

    /// Services that have something to send at `now`.
    #[must_use]
    pub fn due(&self, now: LocalTicks) -> usize {
        self.wakes().into_iter().flatten().filter(|at| *at <= now).count()
    }

    /// When a service has something to do even if no packet comes.
    #[must_use]
    pub fn next_wake(&self) -> Option<LocalTicks> {
        self.wakes().into_iter().flatten().min()
    }

    fn wakes(&self) -> [Option<LocalTicks>; 3] {
        let motion = self.kind.port_of(Service::Motion).and(self.motion.as_ref()).map(MotionService::next_wake);
        [self.echo.next_wake(), self.stream.next_wake(), motion]
    }

    fn accept(&mut self, service: Service, node: &mut impl Mailbox, delivery: Delivery, now: LocalTicks) {
        match service {
            Service::Echo => self.echo.accept(node, delivery, &mut self.scratch, now),
            Service::Stream => self.stream.accept(node, delivery, BYTES, now),
            Service::Spin => spin::accept(node, delivery, now),
            Service::Motion => match &mut self.motion {
                Some(motion) => motion.accept(node, delivery, &mut self.scratch, now),
                None => node.release(delivery, Some(DropCause::PortRefused), now),
            },
        }
    }

    fn poll(&mut self, port: PortIndex, service: Service, node: &mut impl Mailbox, now: LocalTicks) {
        match service {
            Service::Echo => self.echo.poll(node, now),
            Service::Stream => self.stream.poll(node, port, &mut self.scratch, now),
            Service::Spin => {}
            Service::Motion => {
                if let Some(motion) = &mut self.motion {
                    motion.poll(node, port, now);
                }
            }
        }
    }
}

/// A kind's ports and what they lead to.
fn ports(kind: &'static Kind) -> impl Iterator<Item = (PortIndex, Service)> {
    (1..).zip(kind.ports).filter_map(|(index, entry)| Some((PortIndex::new(index)?, entry.service)))
}
