//! One time on a bus: its members find the one of them who is nearest to the root, `[TIM-18]`.

mod common;

use common::gateway;
use fixed_math::time::Span;
use osap_protocol::discovery::UniqueId;
use osap_sim::device::SimDevice;
use osap_sim::machines::shapes::bus_cell;
use osap_sim::world::{LinkModel, NodeId, World};

/// Who a node says its root is, its tier, its time less `than`, steps, and its bound, steps.
fn told(world: &mut World, node: NodeId) -> (UniqueId, u8, u64, Option<u64>) {
    let now = world.local_now(node);
    let device = world.endpoint::<SimDevice>(node).expect("a device");
    let (clock, time) = (device.node().clock(), device.node().system_time(now));
    (clock.root().unique_id, clock.tier(), time.at.steps(), time.bound.map(Span::steps))
}

/// `[TIM-18]`, `[TIM-09]`: a root behind the hub, the hub, and eight members of its bus. All follow the one root, the members over the hub;
/// no error is above its bound; members agree with the root to within 50 µs, as 50 ppm over two exchanges 0.4 s apart before a rate is known.
#[test]
fn a_bus_keeps_the_time_of_the_network_it_is_on() {
    let mut world = World::new(18);
    let cell = bus_cell(&mut world, 8);
    let root = {
        let outside = bus_cell(&mut world, 1);
        outside.hub
    };
    world.connect((root, gateway(0)), (cell.hub, gateway(0)), LinkModel::WIRE);
    world.run_for(Span::from_us(8_000_000));
    let (expected, ..) = told(&mut world, cell.hub);
    let mut largest = 0;
    for _ in 0..400 {
        world.run_for(Span::from_us(9_973));
        let (_, _, truth, _) = {
            let all = [root, cell.hub];
            let at_root = all.into_iter().find(|node| told(&mut world, *node).1 == 0).expect("one of two is root");
            told(&mut world, at_root)
        };
        let hub_tier = told(&mut world, cell.hub).1;
        for node in &cell.devices {
            let (of, tier, system, bound) = told(&mut world, *node);
            assert_eq!((of, tier), (expected, hub_tier + 1), "a member of the bus");
            let error = system.abs_diff(truth);
            // a step for each of the two maps' roundings
            assert!(error <= bound.expect("settled by now") + 2, "{error} steps off, {bound:?} said");
            largest = largest.max(error);
        }
    }
    assert!(largest < Span::from_us(50).steps(), "{largest} steps");
}

/// `[TIM-18]`, `[TIM-07]`: the root of a bus boots again. Its time is younger then: the others go on with theirs, and it joins them.
#[test]
fn members_that_lose_their_root_agree_on_another() {
    let mut world = World::new(19);
    let cell = bus_cell(&mut world, 5);
    let all: Vec<NodeId> = std::iter::once(cell.hub).chain(cell.devices).collect();
    world.run_for(Span::from_us(8_000_000));
    let before = told(&mut world, all[0]).0;
    assert!(all.iter().all(|node| told(&mut world, *node).0 == before));
    let root = *all.iter().find(|node| told(&mut world, **node).1 == 0).expect("one is root");
    assert!(world.reset(root));
    world.run_for(Span::from_us(20_000_000));
    let after = told(&mut world, all[0]).0;
    assert_ne!(after, before, "who has just started is no root");
    for node in all {
        assert_eq!(told(&mut world, node).0, after);
    }
}
