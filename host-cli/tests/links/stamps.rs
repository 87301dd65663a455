//! Stamps of departures, `[TIM-03]`: written by the link, when the frame leaves.
//!
//! - **Walk:** a packet with an empty slot → [`LinkHandle::send_stamped`](osap::link::LinkHandle::send_stamped) → the writer's stamp → the other
//!   side. Readings of the same clock before and after enclose it.

use crate::support::{Side, pair, plain, tcp_pair, with_faults, with_key};
use fixed_math::time::LocalTicks;
use osap::link::{Clock, LinkEvent};
use osap_protocol::time::unwrap_stamp;

const PACKET: [u8; 9] = [1, 2, 3, 4, 5, 0, 0, 0, 0];

/// The packet as it came, and the stamp of its arrival.
fn packet(side: &Side) -> (Vec<u8>, LocalTicks) {
    loop {
        match side.next() {
            LinkEvent::Packet { bytes, started } => return (bytes, started),
            LinkEvent::Sent => {}
            other => panic!("{other:?} instead of a packet"),
        }
    }
}

/// The stamp lies between the packet being handed over and its arrival, all by one clock, with and without faults on the way.
#[test]
fn a_departures_stamp_is_of_when_it_left() {
    for options in [plain(), with_faults("delay=2ms,seed=1")] {
        let clock = Clock::new();
        let (one, other) = pair(&options, &clock);
        let before = clock.now();
        one.handle.send_stamped(PACKET.to_vec()).unwrap();
        let (bytes, arrived) = packet(&other);
        assert_eq!(bytes[..5], PACKET[..5]);
        let slot = u32::from_le_bytes(*bytes.last_chunk().unwrap());
        let departed = unwrap_stamp(slot, arrived);
        assert!(before <= departed && departed <= arrived, "{before:?} {departed:?} {arrived:?}");
    }
}

/// Framed or encrypted, the stamp is under the check: it comes through as it was written; what has no slot is left as it is.
#[test]
fn a_stamp_is_written_before_the_check_and_only_where_it_belongs() {
    let keyed = with_key(7);
    for (tail, options) in [("", plain()), (",check=crc32", plain()), ("", keyed)] {
        let (listener, dialler) = tcp_pair(tail, &options, &options);
        dialler.handle.send_stamped(PACKET.to_vec()).unwrap();
        let (stamped, _) = packet(&listener);
        assert_eq!(stamped[..5], PACKET[..5]);
        assert_ne!(stamped[5..], PACKET[5..], "a clock that is some milliseconds old is not at zero");
        dialler.handle.send(PACKET.to_vec()).unwrap();
        assert_eq!(packet(&listener).0, PACKET);
    }
}
