//! Levels, events and the lag of an actuator.

use fixed_math::lag::Lag;
use fixed_math::level::{Level, LevelError};
use fixed_math::time::{NetTime, Span};
use proptest::prelude::*;

#[test]
fn what_is_no_level_is_refused_with_its_operands() {
    let us = NetTime::from_us;
    let (first, second) = (Level { start: us(5), value: 1 }, Level { start: us(6), value: 1 });
    assert_eq!(second.check_after(&first), Ok(()));
    for start in [us(5), us(4)] {
        let refused = LevelError::NotLater { start, previous: us(5) };
        assert_eq!(Level { start, value: 2 }.check_after(&first), Err(refused));
    }
    assert_eq!(Level::event(us(1), Span::ZERO, 1, 0), Err(LevelError::NoWidth { start: us(1), width: Span::ZERO }));
    // one that ends past the end of time
    let start = NetTime::MAX.shifted(-5);
    let width = Span::from_steps(6);
    assert_eq!(Level::event(start, width, 1, 0), Err(LevelError::NoWidth { start, width }));
    assert!(Level::event(start, Span::from_steps(5), 1, 0).is_ok());
}

#[test]
fn a_lag_looks_ahead_and_stops_at_the_end_of_time() {
    assert_eq!(Lag(Span::from_us(3)).ahead(NetTime::from_us(4)), NetTime::from_us(7));
    assert_eq!(Lag::NONE.ahead(NetTime::from_us(4)), NetTime::from_us(4));
    assert_eq!(Lag(Span::from_us(3)).ahead(NetTime::MAX), NetTime::MAX);
}

proptest! {
    /// The last one that has begun is read, by counting forwards where the code looks backwards.
    #[test]
    fn the_last_that_has_begun_is_read(gaps in proptest::collection::vec((1u64..50, any::<i32>()), 0..12), at in 0u64..400) {
        let mut now = 0;
        let mut levels = Vec::new();
        for (gap, value) in gaps {
            now += gap;
            levels.push(Level { start: NetTime::from_steps(now), value });
        }
        let mut expected = None;
        for level in &levels {
            if level.start.steps() <= at {
                expected = Some(level.value);
            }
        }
        prop_assert_eq!(Level::read(&levels, NetTime::from_steps(at)), expected);
    }
}
