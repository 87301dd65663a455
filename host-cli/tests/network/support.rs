//! A device in real time: the firmware's application on a thread, behind a link of this computer.

use firmware_app::{Device, kind};
use osap::link::{Clock, LinkEvent, LinkHandle};
use osap_protocol::GatewayIndex;
use osap_protocol::discovery::{BuildKind, GatewayKind, UniqueId};
use osap_protocol::header::Arrival;
use osap_runtime::{GatewayConfig, Stamps};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

type Motor = Device<16, 256, 1, 5, 4096>;

/// The device's only gateway.
pub(crate) fn gateway() -> GatewayIndex {
    GatewayIndex::new(0).unwrap()
}

/// A motor behind `link` until it is dropped.
pub(crate) struct Responder {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Responder {
    pub(crate) fn start(
        link: LinkHandle,
        events: Receiver<(GatewayIndex, LinkEvent)>,
        clock: Clock,
        name: &'static str,
    ) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let serve = move || {
            let mut motor = Motor::new(&kind::MOTOR, UniqueId([3; 12]), 1, BuildKind::Host, name).unwrap();
            let it = &link.description;
            let (mtu_bytes, bit_rate, bits_a_byte, check) = (it.mtu_bytes, it.bit_rate, it.bits_a_byte, it.check);
            let kind = GatewayKind::Link;
            let config = GatewayConfig {
                type_name: "test",
                kind,
                mtu_bytes,
                bit_rate,
                bits_a_byte,
                check,
                packet_hold_max: 8,
                stamps: Stamps::SOFTWARE,
            };
            motor.node_mut().add_gateway(config).unwrap();
            let mut is_clear = false;
            while !stopped.load(Ordering::Relaxed) {
                match events.recv_timeout(Duration::from_millis(5)) {
                    Ok((_, event)) => take(&mut motor, &clock, event, &mut is_clear),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                motor.run(clock.now());
                let mut packet = vec![0; 256];
                if is_clear && let Some(outgoing) = motor.transmit(gateway(), clock.now(), &mut packet) {
                    packet.truncate(outgoing.len);
                    let sent = if outgoing.is_stamped { link.send_stamped(packet) } else { link.send(packet) };
                    is_clear = sent.is_err();
                }
            }
            drop(events); // a reader that waits for room in the channel ends now, and can be joined
        };
        Self { stop, thread: Some(std::thread::spawn(serve)) }
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|ended| ended.is_ok()) || std::thread::panicking(), "the responder panicked");
    }
}

fn take(motor: &mut Motor, clock: &Clock, event: LinkEvent, is_clear: &mut bool) {
    match event {
        LinkEvent::Up => {
            *is_clear = true;
            motor.node_mut().set_open(gateway(), true, clock.now());
        }
        LinkEvent::Down { .. } => {
            *is_clear = false;
            motor.node_mut().set_open(gateway(), false, clock.now());
        }
        LinkEvent::Packet { mut bytes, started } => {
            let _counted = motor.receive(Arrival::Link(gateway()), &mut bytes, started, clock.now());
        }
        LinkEvent::Dropped(cause) => motor.node_mut().count(cause, Some(gateway()), clock.now()),
        LinkEvent::Sent => *is_clear = true,
    }
}

/// One test at a time: each wants its 50 ms of a processor that other tests are using.
pub(crate) fn alone() -> std::sync::MutexGuard<'static, ()> {
    static TURN: std::sync::Mutex<()> = std::sync::Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}
