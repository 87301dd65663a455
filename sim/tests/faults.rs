//! Faulty wires: nothing wrong is delivered, and everything that is not delivered is counted.

mod common;

use common::{Probe, add_probe, assert_all_slots_home, gateway, over, probe, us, with_probe};
use fixed_math::time::LocalTicks;
use osap_protocol::DropCause;
use osap_protocol::framing::{Check, decode, encode};
use osap_runtime::GatewayConfig;
use osap_sim::faults::{FaultConfig, FaultLayer};
use osap_sim::machines::UART;
use osap_sim::world::{LinkId, LinkModel, NodeId, World};
use std::sync::{Arc, Mutex};

const UART_32: GatewayConfig = GatewayConfig { check: Check::Crc32, ..UART };

/// Two probes on one link; sends `count` numbered datagrams from the first to the second, one a millisecond.
fn send_numbered(
    seed: u64,
    config: GatewayConfig,
    faults: &str,
    count: u32,
) -> (World, NodeId, NodeId, LinkId, Vec<Vec<u8>>) {
    let mut world = World::new(seed);
    let a = add_probe(&mut world, &[config]);
    let b = add_probe(&mut world, &[config]);
    let model = LinkModel { faults: Some(faults.parse().unwrap()), ..LinkModel::WIRE };
    let link = world.connect((a, gateway(0)), (b, gateway(0)), model);
    let sent = Arc::new(Mutex::new(Vec::new()));
    let tapped = Arc::clone(&sent);
    world.tap_link(
        link,
        Box::new(move |event| {
            if event.way == 0 {
                tapped.lock().unwrap().push(event.packet.to_vec());
            }
        }),
    );
    for number in 0..count {
        with_probe(&mut world, a, |it, now| {
            // where the hold is full the node counts it
            let _counted = it.datagram(&over(&[0], 1, 60_000), &numbered(number), now);
        });
        world.run_for(us(1_000));
    }
    world.run_for(us(200_000));
    let sent = sent.lock().unwrap().clone();
    (world, a, b, link, sent)
}

fn numbered(number: u32) -> Vec<u8> {
    (0..16u32).flat_map(|n| (number.wrapping_mul(0x9e37_79b9) ^ n).to_le_bytes()).chain(number.to_le_bytes()).collect()
}

/// How many frames were dropped for `cause`.
fn dropped(world: &World, id: NodeId, cause: DropCause) -> u32 {
    probe(world, id).node.counters().of(cause)
}

/// `[FRM-07]`, `[NOD-09]`: with flipped bits, what arrives is what an independent model makes of the same faulty bytes: the stream
/// cut at its zeros, each piece decoded by itself. So no loss is without its counter, and no counter without its loss.
#[test]
fn bit_errors_are_caught_and_counted_one_by_one() {
    let faults = "ber=0.0003,seed=11";
    let (world, _, b, link, sent) = send_numbered(0, UART_32, faults, 2_000);

    let mut layer = FaultLayer::new(faults.parse::<FaultConfig>().unwrap().for_stream(0));
    let mut stream = Vec::new();
    for packet in &sent {
        let mut frame = [0; 512];
        let len = encode(packet, Check::Crc32, &mut frame).unwrap();
        layer.offer(LocalTicks::ZERO, &frame[..len]);
        while let Some(bytes) = layer.poll(LocalTicks::MAX) {
            stream.extend(bytes);
        }
    }
    assert_eq!(world.link_faults(link)[0].unwrap().bits_flipped, layer.counts().bits_flipped);
    let end = stream.iter().rposition(|byte| *byte == 0).unwrap();
    let (mut whole, mut malformed, mut check, mut short) = (0, 0, 0, 0);
    for piece in stream[..end].split(|byte| *byte == 0).filter(|piece| !piece.is_empty()) {
        use osap_protocol::framing::FrameError;
        match decode(piece, Check::Crc32, &mut [0; 4096]) {
            Ok(_) => whole += 1,
            Err(FrameError::Malformed) => malformed += 1,
            Err(FrameError::Check { .. }) => check += 1,
            Err(FrameError::TooShort { .. }) => short += 1,
            Err(error) => panic!("{error}"),
        }
    }
    let node = &probe(&world, b).node;
    assert_eq!(dropped(&world, b, DropCause::FrameMalformed), malformed);
    assert_eq!(dropped(&world, b, DropCause::FrameCheck), check);
    assert_eq!(dropped(&world, b, DropCause::FrameTooShort), short);
    assert_eq!(node.gateway(gateway(0)).unwrap().info().received, whole);
    assert!(malformed > 0 && check > 100 && whole > 1_000, "{malformed} {check} {whole}");
    assert_nothing_wrong_arrived(probe(&world, b));
    assert_all_slots_home(&world);
}

fn assert_nothing_wrong_arrived(probe: &Probe) {
    let mut last = None;
    for (_, payload) in &probe.datagrams {
        let number = u32::from_le_bytes(*payload.last_chunk().unwrap());
        assert_eq!(*payload, numbered(number));
        assert!(last < Some(number), "{number} after {last:?}");
        last = Some(number);
    }
}

/// `[LNK-07]`: every frame that was sent arrived, was lost by the layer, or came twice.
#[test]
fn losses_and_copies_add_up() {
    let (world, _, b, link, sent) = send_numbered(3, UART, "loss=0.1,dup=0.05,reorder=0.05,jitter=300us,seed=5", 3_000);
    let faults = world.link_faults(link)[0].unwrap();
    let node = &probe(&world, b).node;
    // a copy of an answer about time was not asked for, one that was overtaken is not of the last question, and one
    // that was held up for longer than any before it is too far off
    let causes = [DropCause::TimeUnasked, DropCause::TimeOrder, DropCause::TimeAbsurd];
    let refused = causes.iter().map(|cause| node.counters().of(*cause)).sum::<u32>();
    let received = u64::from(node.gateway(gateway(0)).unwrap().info().received + refused);
    assert_eq!(faults.offered, sent.len() as u64);
    assert_eq!(received, faults.offered + faults.duplicated - faults.lost);
    assert!(faults.lost > 200 && faults.duplicated > 80 && faults.reordered > 80, "{faults:?}");
    assert!(refused > 0);
    assert_eq!(node.counters().total(), u64::from(refused));
    assert!(probe(&world, b).datagrams.len() as u64 <= received);
    assert_all_slots_home(&world);
}

/// `[LNK-07]`: the same seed gives the same faults; another seed of the faults, or of the world, gives others.
#[test]
fn faults_are_drawn_from_their_seeds() {
    let run = |seed, faults| {
        let (world, _, b, link, _) = send_numbered(seed, UART, faults, 300);
        (world.digest(), world.link_faults(link), probe(&world, b).datagrams.len())
    };
    let first = run(1, "loss=0.2,seed=1");
    assert_eq!(first, run(1, "loss=0.2,seed=1"));
    assert_ne!(first.1, run(1, "loss=0.2,seed=2").1);
    assert_ne!(first.1, run(2, "loss=0.2,seed=1").1);
}

/// A fault layer with less bandwidth than the wire holds the sender back: nothing piles up inside it.
#[test]
fn a_narrow_fault_layer_holds_the_sender_back() {
    let (world, a, b, link, _) = send_numbered(1, UART, "bandwidth=400k,seed=1", 200);
    // 82 bytes of 8 bits at 400 kbit/s: 1.64 ms a frame, one sent each millisecond, 60 ms to live
    assert_eq!(world.link_faults(link)[0].unwrap().overflowed, 0);
    let counters = probe(&world, a).node.counters();
    let held = counters.of(DropCause::HoldFull) + counters.of(DropCause::Expired) + counters.of(DropCause::Displaced);
    assert!(held > 20, "{held}");
    assert_eq!(probe(&world, b).datagrams.len() + held as usize, 200);
}
