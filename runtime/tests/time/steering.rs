//! How system time is steered and told: `[TIM-09]`, `[TIM-10]`, `[TIM-12]`, `[TIM-15]`, `[TIM-17]`.

use crate::common::{ask, us};
use crate::network::Network;
use crate::refusals::{Forger, IT};
use osap_protocol::discovery::{ClockChange, DebugPage, Event, Query, UniqueId};
use osap_runtime::clock::{AGE_MAX_US, DEFAULT_SETTINGS};

/// `[TIM-10]`: where nothing is live a root that is 5 ms on is set to at once, which is counted and told; where something is live the
/// clock is slewed there, never by more than the limit, and the bound says how far it has to go.
#[test]
fn live_clocks_are_slewed_and_others_set() {
    for live in [false, true] {
        let mut it = Forger::new();
        it.honest(60);
        it.node.clock_mut().set_live(live);
        let (steps, cursor) = (it.status().steps, it.node.debug().end());
        let mut last = (it.at_us, it.node.system_time(us(it.at_us)).at);
        for _ in 0..40 {
            let mut reply = it.asked();
            reply.system = reply.system.shifted(5_000 << 8);
            it.say(&reply).unwrap();
            let time = it.node.system_time(us(it.at_us));
            let passed = i64::try_from(it.at_us - last.0).unwrap() << 8;
            let gained = time.at.steps_after(last.1) - passed;
            last = (it.at_us, time.at);
            if live {
                // two steps where pieces of the map meet, and what the link's estimate moves by at first: a part in a million
                let most = passed * i64::from(DEFAULT_SETTINGS.skew_limit_ppb + 1_000) / 1_000_000_000 + 2;
                assert!(gained.abs() <= most, "{gained} in {passed}");
                let left = it.status().behind_steps;
                assert!(left > 0 && time.bound.unwrap().steps() >= left.unsigned_abs());
            }
        }
        let behind = it.status().behind_steps;
        let page = it.node.debug().page(cursor, None);
        let told =
            page.events.iter().any(|it| matches!(it.event, Event::Clock { change: ClockChange::SetAnew, tier: 1 }));
        if live {
            // 2.4 s at 500 ppm are 1.2 ms
            assert!(((5_000 - 1_300) << 8..(5_000 - 1_100) << 8).contains(&behind), "{behind}");
        } else {
            assert!(behind.abs() < 256, "{behind}");
        }
        assert_eq!((it.status().steps, told), (steps + u16::from(!live), !live));
    }
}

/// `[TIM-06]`, `[TIM-10]`: a live clock that has a second to go to another root's time goes on believing that root all the way, though its
/// own time is further off than the gate.
#[test]
fn a_long_way_to_go_is_not_absurd() {
    let mut it = Forger::new();
    it.honest(60);
    it.node.clock_mut().set_live(true);
    for _ in 0..100 {
        let mut reply = it.asked();
        (reply.tier, reply.root.priority, reply.root.unique_id) = (1, 64, UniqueId([7; 12]));
        reply.system = reply.system.shifted(1_000_000 << 8);
        it.say(&reply).unwrap();
        assert_eq!((it.node.clock().tier(), it.node.clock().root().unique_id), (2, UniqueId([7; 12])));
    }
    let behind = it.status().behind_steps;
    // 6 s at 500 ppm are 3 ms
    assert!(((1_000_000 - 3_300) << 8..(1_000_000 - 2_700) << 8).contains(&behind), "{behind}");
}

/// `[TIM-09]`: a settled clock takes nothing from a neighbour that is not settled, which has no bound to tell; it would rather be root.
#[test]
fn who_is_settled_follows_the_settled_only() {
    let mut it = Forger::new();
    it.honest(30);
    let began = it.at_us;
    while it.at_us < began + AGE_MAX_US + 100_000 {
        let mut reply = it.asked();
        (reply.is_settled, reply.bound_steps) = (false, u32::MAX);
        it.say(&reply).unwrap();
        assert!(it.node.system_time(us(it.at_us)).bound.is_some());
    }
    assert_eq!(it.node.clock().tier(), 0);
    // it has gone on in the same time, and its id is lower
    it.honest(1);
    assert_eq!(it.node.clock().tier(), 0);
    let mut reply = it.asked();
    reply.root.priority = 64;
    it.say(&reply).unwrap();
    assert_eq!((it.node.clock().tier(), it.node.clock().root().unique_id), (1, IT));
}

/// `[TIM-15]`: debug pages carry both clocks once time is settled, and not before.
#[test]
fn pages_carry_both_clocks_once_settled() {
    let mut it = Forger::new();
    let mark = |it: &mut Forger| {
        let page: DebugPage = ask(&mut it.node, Query::DebugMessages, &0u32, us(it.at_us)).unwrap();
        page.clock
    };
    // it is its own root for a quarter of a second before it is settled, and follows another one before that
    it.honest(3);
    assert!(!it.node.clock().is_settled());
    assert_eq!(mark(&mut it), None);
    it.honest(30);
    let time = it.node.system_time(us(it.at_us));
    let found = mark(&mut it).unwrap();
    assert_eq!((found.local_steps, found.system_steps), (us(it.at_us).steps(), time.at.steps()));
    assert_eq!(u64::from(found.bound_steps), time.bound.unwrap().steps());
    assert!(found.rate_ppb.abs() < 5_000, "{}", found.rate_ppb);
}

/// `[TIM-17]`: settings, calibrations and rates outlast a reset, and a neighbour that was known begins with its rate.
#[test]
fn what_is_known_outlasts_a_reset() {
    let mut net = Network::new(&[(900_000, 40), (0, -40)], &[(0, 1)]);
    net.set(1, |it| it.interval_us = 40_000);
    net.run_for(15_000_000);
    let now = net.local(1);
    let kept = net.seats[1].node.take_time_to_keep(now).expect("settings and a rate");
    assert_eq!(kept.settings.interval_us, 40_000);
    let (of, ppb) = kept.links[0].peer.unwrap();
    assert!(of.0 == [1; 12] && (79_900..80_100).contains(&ppb), "{of} {ppb}");
    assert!(net.seats[1].node.take_time_to_keep(now).is_none(), "once");

    let mut fresh = Network::new(&[(900_000, 40), (0, -40)], &[(0, 1)]);
    fresh.seats[1].node.restore_time(&kept);
    assert_eq!(fresh.seats[1].node.clock().settings(), kept.settings);
    while fresh.link(1, 0).exchanges < 2 {
        fresh.run_for(200);
    }
    // two exchanges 5 ms apart and of 1 µs each say no more than 200 ppm
    let rate_ppb = fresh.link(1, 0).rate_ppb;
    assert!((75_000..85_000).contains(&rate_ppb), "{rate_ppb}");
    let now = fresh.local(1);
    assert!(fresh.seats[1].node.take_time_to_keep(now).is_none(), "nothing new");
}
