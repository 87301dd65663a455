//! Lets real time pass in a simulated machine, and carries packets between its bridge and links of the operating system.
//!
//! - **Walk:** a link's threads → [`Offer::run`] → bridge → the world, stepped to the time there is now → bridge → the links.
//! - **Invariants:** the world never runs ahead of the clock; where it cannot keep up it falls behind, and what it cannot make good is
//!   left out rather than hurried through. A cable is plugged in while somebody is at its other end.
//! - **Context:** the main thread; it waits for the next event of either side. **Clause:** `[LNK-01]`.

use super::bridge::Bridge;
use super::machine::Machine;
use crate::cli::Output;
use crate::cli::wait::Until;
use crate::link::{Clock, LinkError, LinkEvent, LinkHandle, LinkOptions, LinkSpec, listen};
use fixed_math::time::Span;
use osap_protocol::{DropCause, GatewayIndex};
use osap_sim::time::TrueTime;
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Events of links that wait for us.
const EVENTS: usize = 256;
/// Longest wait without a look at Ctrl-C.
const WAIT_MAX: Duration = Duration::from_millis(50);
/// Virtual time that is made good at once; a computer that slept longer goes on from there.
const BEHIND_MAX: Span = Span::from_us(1_000_000);

/// A machine that is offered.
pub(super) struct Offer {
    machine: Machine,
    events: Receiver<(GatewayIndex, LinkEvent)>,
    ends: Vec<End>,
    clock: Clock,
    /// Time of the clock that never passed in the world.
    left_out: Span,
}

/// A link of the operating system that stands for one of the machine's.
struct End {
    handle: LinkHandle,
    clear_to_send: bool,
    /// What its frames and peers were dropped for.
    dropped: BTreeMap<DropCause, u32>,
}

impl Offer {
    /// Listens, one link for each of the machine's.
    pub(super) fn open(machine: Machine, specs: &[LinkSpec], options: &LinkOptions) -> Result<Self, LinkError> {
        let (sender, events) = sync_channel(EVENTS);
        let clock = Clock::new();
        let mut ends = Vec::new();
        for (index, spec) in (0..).zip(specs) {
            let gateway = GatewayIndex::from_low_bits(index);
            let handle = listen(spec, gateway, sender.clone(), &clock, options)?;
            ends.push(End { handle, clear_to_send: false, dropped: BTreeMap::new() });
        }
        Ok(Self { machine, events, ends, clock, left_out: Span::ZERO })
    }

    /// What is listened on, in order of the machine's links.
    pub(super) fn names(&self) -> Vec<String> {
        self.ends.iter().map(|end| end.handle.description.name.clone()).collect()
    }

    /// Goes on until there is no time left.
    pub(super) fn run(&mut self, until: &Until, output: &mut Output<'_>) {
        while until.pause(Duration::ZERO) {
            let mut next = match self.events.recv_timeout(self.wait()) {
                Ok(event) => Some(event),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            self.catch_up();
            // What has come by now enters the machine now, not when the world last looked at the clock.
            while let Some((gateway, event)) = next {
                self.take(gateway, event, output);
                next = self.events.try_recv().ok();
            }
            self.send();
        }
    }

    /// Tells what was dropped while it ran.
    pub(super) fn sum_up(&self, output: &mut Output<'_>) {
        for end in &self.ends {
            for (cause, count) in &end.dropped {
                output.say(format!("{}: {count} dropped, {}", end.handle.description.name, cause.name()));
            }
        }
    }

    /// Time to the world's next event.
    fn wait(&self) -> Duration {
        let next = self.machine.world.next_event_at().map(|at| {
            let span = at.since(self.now());
            Duration::from_micros(span.as_us_ceil())
        });
        next.unwrap_or(WAIT_MAX).min(WAIT_MAX)
    }

    /// The world's time that belongs to the clock's.
    fn now(&self) -> TrueTime {
        TrueTime::from_steps(self.clock.now().steps()).before(self.left_out)
    }

    fn catch_up(&mut self) {
        let behind = self.now().since(self.machine.world.now());
        if behind > BEHIND_MAX {
            self.left_out = self.left_out + behind.saturating_sub(BEHIND_MAX);
        }
        let now = self.now();
        self.machine.world.run_until(now);
    }

    fn take(&mut self, gateway: GatewayIndex, event: LinkEvent, output: &mut Output<'_>) {
        let (Some(end), Some(link)) = (self.ends.get_mut(gateway.at()), self.machine.links.get(gateway.at())) else {
            return;
        };
        let name = &end.handle.description.name;
        match event {
            LinkEvent::Up => {
                end.clear_to_send = true;
                self.machine.world.replug(link.id);
                output.say(format!("{name}: somebody is at {}", link.leads_to));
            }
            LinkEvent::Down { reason } => {
                end.clear_to_send = false;
                self.machine.world.unplug(link.id);
                output.say(format!("{name}: {reason}"));
            }
            LinkEvent::Packet { bytes, .. } => {
                if let Some(bridge) = self.machine.world.endpoint_mut::<Bridge>(self.machine.bridge) {
                    bridge.enter(gateway, bytes);
                    self.machine.world.poke(self.machine.bridge);
                }
            }
            LinkEvent::Sent => end.clear_to_send = true,
            LinkEvent::Dropped(cause) => {
                let count = end.dropped.entry(cause).or_default();
                // Said once: a peer without the key comes back again and again.
                if *count == 0 {
                    output.say(format!("{name}: dropped, {}: {}", cause.name(), cause.meaning()));
                }
                *count = count.saturating_add(1);
            }
        }
    }

    /// Hands over one packet for each link that is clear to send.
    fn send(&mut self) {
        let Some(bridge) = self.machine.world.endpoint_mut::<Bridge>(self.machine.bridge) else { return };
        for (index, end) in (0..).zip(&mut self.ends) {
            if end.clear_to_send
                && let Some(packet) = bridge.leaving(GatewayIndex::from_low_bits(index))
            {
                end.clear_to_send = false;
                // A link that has ended for good has said so by itself, and is not clear to send any more.
                let _is_taken = end.handle.send(packet);
            }
        }
    }
}
