//! The host's clock: steady like a monotonic clock, dated like a wall clock.
//!
//! All times of a run are read from one [`HostClock`], anchored once to the wall clock. Setting the wall clock
//! during a run (by hand, by NTP, by daylight saving) therefore moves no contact; [`HostClock::wall_jump_us`]
//! tells that it happened.
//!
//! Both what dates the clock and how fast it runs can be given ([`HostClock::of`]): tests set the wall clock of a
//! running capture without touching that of the machine, and make hours of board time pass in less. Time itself can
//! be given as well ([`HostClock::told`]): links wait by their clock and not by the system's, so that a session on a
//! simulated line runs in simulated time, and gives the same on every machine.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// A clock that never jumps; copies agree with each other.
#[derive(Clone, Copy, Debug)]
pub struct HostClock {
    anchor: Instant,
    anchor_us: i64,
    wall_us: fn() -> i64,
    now: fn() -> Instant,
    speed: f64,
}

/// The wall clock: microseconds since the Unix epoch.
pub fn wall_us() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |d| i64::try_from(d.as_micros()).unwrap_or(i64::MAX))
}

impl HostClock {
    /// A clock that agrees with the wall clock now.
    pub fn start() -> Self {
        Self::of(wall_us, 1.0)
    }

    /// A clock dated by `wall_us`, microseconds since the Unix epoch, that runs `speed` times as fast as time.
    pub fn of(wall_us: fn() -> i64, speed: f64) -> Self {
        Self::started(Instant::now, wall_us, speed)
    }

    /// A clock that is told the time by `now`, which must not go back, and dated by `wall_us`.
    pub fn told(now: fn() -> Instant, wall_us: fn() -> i64) -> Self {
        Self::started(now, wall_us, 1.0)
    }

    fn started(now: fn() -> Instant, wall_us: fn() -> i64, speed: f64) -> Self {
        Self {
            anchor: now(),
            anchor_us: wall_us(),
            wall_us,
            now,
            speed,
        }
    }

    /// This instant.
    pub fn instant(&self) -> Instant {
        (self.now)()
    }

    /// Microseconds since the Unix epoch.
    pub fn now_us(&self) -> i64 {
        self.at_us(self.instant())
    }

    /// Microseconds since the Unix epoch at an instant.
    pub fn at_us(&self, instant: Instant) -> i64 {
        let since = instant.saturating_duration_since(self.anchor);
        // A float holds whole microseconds for 285 years.
        self.anchor_us
            .saturating_add((since.as_nanos() as f64 * 1e-3 * self.speed) as i64)
    }

    /// Microseconds since the clock was started.
    pub fn running_us(&self) -> u64 {
        u64::try_from(self.now_us().saturating_sub(self.anchor_us)).unwrap_or(0)
    }

    /// The instant the clock was started, microseconds since the Unix epoch.
    pub fn started_us(&self) -> i64 {
        self.anchor_us
    }

    /// By how much the wall clock has moved against this one since it was started, microseconds.
    pub fn wall_jump_us(&self) -> i64 {
        let passed = self.instant().saturating_duration_since(self.anchor);
        let passed_us = passed.as_micros();
        (self.wall_us)()
            .saturating_sub(self.anchor_us)
            .saturating_sub(i64::try_from(passed_us).unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_agree_and_never_go_back() {
        let clock = HostClock::start();
        let copy = clock;
        let mut last = clock.now_us();
        for _ in 0..1_000 {
            let now = copy.now_us();
            assert!(now >= last);
            last = now;
        }
        let instant = Instant::now();
        assert_eq!(clock.at_us(instant), copy.at_us(instant));
        assert!(clock.started_us() <= last);
    }
}
