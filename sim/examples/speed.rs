//! A load for measuring the world: queries from outside to every node of a network of 1,000, ten times over.
//!
//! It prints how many events that took; the world knows no real clock, so time it from outside:
//! `cargo build --release --package osap-sim --example speed`, then `time` on the program.

use fixed_math::time::Span;
use osap_protocol::discovery::{Query, VERSION};
use osap_protocol::header::{Terminal, emit};
use osap_protocol::transport::Transport;
use osap_protocol::{GatewayIndex, PortIndex, RouteBuf, Step};
use osap_sim::machines::shapes::{self, Shape};
use osap_sim::world::{ExternalId, World};
use std::collections::{HashMap, VecDeque};

const NODES: usize = 1_000;
const EXTRA_LINKS: usize = 300;
const ROUNDS: u16 = 10;
const TTL_US: u16 = 60_000;

fn main() {
    let mut world = World::new(1);
    let shape = shapes::network(&mut world, NODES, EXTRA_LINKS);
    let first = GatewayIndex::new(0).expect("0 is below 64");
    let outside = world.attach_external(shape.nodes[0], first);
    world.external_open(outside, true);
    let routes = routes(&world, &shape, first);
    let longest = routes.iter().map(|route| route.as_route().steps().count()).max().unwrap_or(0);
    println!("{NODES} nodes, {} links, longest route {longest} steps", shape.links.len());
    world.run_for(Span::from_us(1_000_000));
    println!("{} events in the first second, of announcements alone", world.stats().events);

    let mut answers = 0;
    for round in 0..ROUNDS {
        for (at, route) in (0u16..).zip(&routes) {
            ask(&mut world, outside, route, round.wrapping_mul(1_000).wrapping_add(at));
            world.run_for(Span::from_us(400));
            answers += drain(&mut world, outside);
        }
    }
    world.run_for(Span::from_us(100_000));
    answers += drain(&mut world, outside);
    println!("{answers} of {} queries answered", usize::from(ROUNDS) * NODES);
    println!("{} events, {} frames, digest {:016x}", world.stats().events, world.stats().frames, world.digest());
}

/// The shortest route from outside to each node, breadth first; the first step enters the first node.
fn routes(world: &World, shape: &Shape, first: GatewayIndex) -> Vec<RouteBuf> {
    let mut neighbours: HashMap<_, Vec<_>> = HashMap::new();
    for link in &shape.links {
        let [a, b] = world.ends(*link);
        neighbours.entry(a.0).or_default().push((a.1, b.0));
        neighbours.entry(b.0).or_default().push((b.1, a.0));
    }
    let mut known = HashMap::new();
    let entry = RouteBuf::new().with(Step::Link(first)).expect("one step fits");
    known.insert(shape.nodes[0], entry);
    let mut next = VecDeque::from([shape.nodes[0]]);
    while let Some(node) = next.pop_front() {
        for (gateway, other) in neighbours.get(&node).into_iter().flatten() {
            if !known.contains_key(other) {
                let route = known[&node].with(Step::Link(*gateway)).expect("far fewer than 250 steps");
                known.insert(*other, route);
                next.push_back(*other);
            }
        }
    }
    shape.nodes.iter().map(|node| known[node].clone()).collect()
}

fn ask(world: &mut World, outside: ExternalId, route: &RouteBuf, sequence: u16) {
    let mut packet = [0; 256];
    let terminal = Terminal::Port {
        source: PortIndex::NETRESPONDER,
        destination: PortIndex::NETRESPONDER,
        transport: Transport::Sequenced.key(),
    };
    let at = emit(&mut packet, TTL_US, 256, route.as_route(), terminal).expect("it fits 256 bytes");
    let [low, high] = (sequence & 0x3fff).to_le_bytes();
    packet[at..at + 4].copy_from_slice(&[low, high, Query::TimeControl.key(), VERSION]);
    world.external_send(outside, &packet[..at + 4]);
}

/// Answers that came out; announcements are no answers.
fn drain(world: &mut World, outside: ExternalId) -> u32 {
    std::iter::from_fn(|| world.external_receive(outside)).filter(|packet| packet.len() > 60).map(|_| 1).sum()
}
