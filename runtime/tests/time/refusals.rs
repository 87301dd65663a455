//! What a neighbour may say that is not believed: `[TIM-06]`, `[TIM-08]`.

use crate::common::{BYTES, TestNode, UART, ask, gateway, identity, link, node, route, us};
use fixed_math::time::{NetTime, PeerTicks, Span};
use osap_protocol::DropCause;
use osap_protocol::discovery::{Query, TimeLink, TimeStatus, UniqueId};
use osap_protocol::header::{Arrival, SYSTEM_HEADER_BYTES, Terminal, emit};
use osap_protocol::system::{ANNOUNCE_TTL_US, ANNOUNCEMENT_VERSION, Announcement, SystemKey};
use osap_protocol::time::{Root, TimeReply, TimeRequest, unwrap_stamp};
use osap_runtime::OUTLIERS_MAX;
use osap_runtime::clock::AGE_MAX_US;

/// The forged neighbour's counter, and so its system time, is ahead by so much: it is older, and so the root.
const AHEAD_US: u64 = 10_000_000;
const ME: UniqueId = UniqueId([5; 12]);
pub(crate) const IT: UniqueId = UniqueId([9; 12]);

/// A node whose neighbour's every word is made up.
pub(crate) struct Forger {
    pub(crate) node: TestNode,
    pub(crate) at_us: u64,
    sequence: u8,
}

impl Forger {
    pub(crate) fn new() -> Self {
        assert_eq!(identity(5).unique_id, ME);
        let mut it = Self { node: node(5, &[UART]), at_us: 1_000, sequence: 0 };
        it.announce();
        it
    }

    fn message(&mut self, key: SystemKey, payload: &[u8]) -> Result<(), DropCause> {
        let mut packet = [0; BYTES];
        let steps = route(&[link(0)]);
        let at =
            emit(&mut packet, ANNOUNCE_TTL_US, 256, steps.as_route(), Terminal::System { key: key.key() }).unwrap();
        packet[at..at + payload.len()].copy_from_slice(payload);
        let now = us(self.at_us);
        self.node.receive(Arrival::Link(gateway(0)), &mut packet[..at + payload.len()], now, now)
    }

    fn announce(&mut self) {
        let announcement = Announcement {
            version: ANNOUNCEMENT_VERSION,
            unique_id: IT,
            boot_epoch: 1,
            wants_answer: false,
            drop: None,
        };
        let mut payload = [0; 64];
        let len = announcement.encode(&mut payload).unwrap();
        self.message(SystemKey::Announcement, &payload[..len]).unwrap();
    }

    /// Lets the node ask, 60 ms after it did last, and makes an honest answer of a root that has been settled for long: 20 µs there, 50
    /// to answer, 20 back.
    pub(crate) fn asked(&mut self) -> TimeReply {
        let mut packet = [0; BYTES];
        // a root asks only every eighth interval
        for _ in 0..64 {
            let Some(out) = self.node.transmit(gateway(0), us(self.at_us), &mut packet) else {
                self.at_us += 60_000;
                self.announce();
                self.node.run(us(self.at_us));
                continue;
            };
            let payload = &packet[SYSTEM_HEADER_BYTES + 1..out.len];
            if out.is_stamped
                && let Ok((TimeRequest { sequence, .. }, slot)) = TimeRequest::decode(payload)
            {
                self.sequence = sequence;
                let heard = PeerTicks::from_us(unwrap_stamp(slot, us(self.at_us)).as_us() + AHEAD_US + 20);
                self.at_us += 90;
                return TimeReply {
                    sequence,
                    asked_slot: slot,
                    heard,
                    system: NetTime::from_steps(heard.steps()),
                    tick_steps: 256,
                    root: Root { priority: 128, unique_id: IT },
                    is_settled: true,
                    answered_slot: low(heard.steps() + (50 << 8)),
                    ..TimeReply::default()
                };
            }
        }
        panic!("no request came")
    }

    pub(crate) fn say(&mut self, reply: &TimeReply) -> Result<(), DropCause> {
        let mut payload = [0; TimeReply::LEN];
        reply.encode(&mut payload).unwrap();
        self.message(SystemKey::TimeReply, &payload)
    }

    /// `count` honest exchanges.
    pub(crate) fn honest(&mut self, count: usize) {
        for _ in 0..count {
            let reply = self.asked();
            self.say(&reply).unwrap();
        }
    }

    pub(crate) fn status(&mut self) -> TimeStatus {
        ask(&mut self.node, Query::TimeStatus, &(), us(self.at_us)).unwrap()
    }

    fn link(&mut self) -> TimeLink {
        ask(&mut self.node, Query::TimeLink, &0u8, us(self.at_us)).unwrap()
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the low bits are what a slot holds")]
fn low(steps: u64) -> u32 {
    steps as u32
}

/// What is done to an honest answer, and the name that it is dropped under.
type Lie = (&'static str, fn(&mut TimeReply), DropCause);

const LIES: [Lie; 14] = [
    ("another sequence", |it| it.sequence = it.sequence.wrapping_add(1), DropCause::TimeUnasked),
    (
        "a request that left before it was made",
        |it| it.asked_slot = it.asked_slot.wrapping_sub(10 << 8),
        DropCause::TimeUnasked,
    ),
    ("heard before the last answer left", |it| shift(it, -(70_000_000 << 8)), DropCause::TimeOrder),
    (
        "answered before it was heard, which reads as 16.7 s after",
        |it| it.answered_slot = it.answered_slot.wrapping_sub(60 << 8),
        DropCause::TimeOrder,
    ),
    (
        "a round trip shorter than none",
        |it| it.answered_slot = it.answered_slot.wrapping_add(100 << 8),
        DropCause::TimeOrder,
    ),
    ("a counter an hour ahead", |it| shift(it, 3_600_000_000 << 8), DropCause::TimeAbsurd),
    ("a counter a second ahead", |it| shift(it, 1_000_000 << 8), DropCause::TimeAbsurd),
    ("a system time a second ahead", |it| it.system = it.system.shifted(1_000_000 << 8), DropCause::TimeAbsurd),
    ("tier 0 with another's id", |it| it.root.unique_id = UniqueId([8; 12]), DropCause::TimeTier),
    ("tier 0 with this node's id", |it| it.root.unique_id = ME, DropCause::TimeTier),
    ("tier 0 and news of age", |it| it.age_us = 1, DropCause::TimeTier),
    ("tier 3 with its own id", |it| it.tier = 3, DropCause::TimeTier),
    ("tier 65", |it| it.tier = 65, DropCause::SystemMalformed),
    ("tier 200", |it| it.tier = 200, DropCause::SystemMalformed),
];

/// Another reading of the neighbour's counter, with all that goes with it.
fn shift(it: &mut TimeReply, steps: i64) {
    it.heard = it.heard.shifted(steps);
    it.answered_slot = low(it.heard.steps() + (50 << 8));
}

/// `[TIM-06]`, `[TIM-08]`: each lie is dropped under its name, counted where one looks for it, and changes nothing.
#[test]
fn lies_are_dropped_and_change_nothing() {
    for (name, lie, cause) in LIES {
        let mut it = Forger::new();
        it.honest(30);
        let before = it.status();
        assert!(before.is_settled && before.tier == 1 && before.root == IT, "{before:?}");
        let (known, counted) = (it.link(), it.node.counters().of(cause));
        let mut reply = it.asked();
        let map = *it.node.clock().map();
        lie(&mut reply);
        assert_eq!(it.say(&reply), Err(cause), "{name}");
        assert_eq!(it.node.counters().of(cause), counted + 1, "{name}");
        assert_eq!(*it.node.clock().map(), map, "{name}");
        let (after, now_known) = (it.status(), it.link());
        // what cannot even be read is no reply
        let refused = known.refused + u32::from(cause != DropCause::SystemMalformed);
        assert_eq!((now_known.refused, after.tier, after.root, after.is_settled), (refused, 1, IT, true), "{name}");
        // and the truth is believed as before
        it.honest(3);
        assert_eq!(it.status().steps, before.steps, "{name}");
    }
}

/// `[TIM-08]`: what comes from this node itself is heard and not followed.
#[test]
fn ones_own_time_is_not_followed() {
    let own: [fn(&mut TimeReply); 2] = [|it| it.is_yours = true, |it| (it.tier, it.root.unique_id) = (2, ME)];
    for change in own {
        let mut it = Forger::new();
        for _ in 0..30 {
            let mut reply = it.asked();
            change(&mut reply);
            it.say(&reply).unwrap();
        }
        assert_eq!((it.status().tier, it.status().root, it.status().sources), (0, ME, 0));
        assert_eq!(it.link().exchanges, 30, "its counter is known all the same");
    }
}

/// `[TIM-06]`: a whole reply that comes again, at once or when its number comes round, is not believed.
#[test]
fn replayed_replies_are_dropped() {
    let mut it = Forger::new();
    it.honest(20);
    let old = it.asked();
    it.say(&old).unwrap();
    assert_eq!(it.say(&old), Err(DropCause::TimeUnasked));
    loop {
        let reply = it.asked();
        if reply.sequence == old.sequence {
            break;
        }
        it.say(&reply).unwrap();
    }
    assert_eq!(it.say(&old), Err(DropCause::TimeUnasked));
}

/// `[TIM-06]`, `[TIM-08]`: a root whose time really is another one is not believed; its clock is forgotten after so many replies, and when
/// the news of what it was before are too old it is followed anew.
#[test]
fn what_stays_absurd_is_learned_anew() {
    let mut it = Forger::new();
    it.honest(30);
    let steps = it.status().steps;
    let began = it.at_us;
    let (mut said, mut refused) = (0, 0);
    while it.at_us < began + AGE_MAX_US + 60_000 * u64::from(OUTLIERS_MAX) {
        let mut reply = it.asked();
        reply.system = reply.system.shifted(100_000_000 << 8);
        said += 1;
        match it.say(&reply) {
            Ok(()) => {}
            Err(cause) => {
                assert_eq!(cause, DropCause::TimeAbsurd);
                refused += 1;
            }
        }
    }
    assert!(refused > u32::from(OUTLIERS_MAX), "{refused}");
    // else it would be those 30 more
    assert!(it.link().exchanges <= said, "what was known was forgotten");
    it.honest(0);
    let status = it.status();
    assert_eq!((status.tier, status.root, status.steps), (1, IT, steps + 1));
    let ahead = it.node.system_time(us(it.at_us)).at.as_us() - it.at_us;
    assert!(ahead.abs_diff(AHEAD_US + 100_000_000) < 100, "{ahead}");
}

/// `[TIM-08]`: a neighbour that lives but tells no time any more is its root until the age limit, to the microsecond.
#[test]
fn news_grow_old() {
    let mut it = Forger::new();
    it.honest(30);
    let heard = us(it.at_us);
    let limit = heard + Span::from_us(AGE_MAX_US);
    while it.at_us + 60_000 < limit.as_us() {
        it.asked();
    }
    it.node.run(limit);
    assert_eq!(it.node.clock().tier(), 1);
    let before = it.node.system_time(limit).at;
    it.node.run(limit + Span::from_us(1));
    assert_eq!(it.node.clock().tier(), 0);
    assert_eq!(it.node.system_time(limit).at, before, "without a step");
    assert!(it.node.clock().is_settled());
}
