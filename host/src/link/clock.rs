//! Where a board's clock stands against the host's, kept up from round trips.
//!
//! Every round trip has four times: the host sent at `sent_us`, the board had the request at
//! `board_received_us` and sent its answer at `board_sent_us`, the host had it at `received_us`. Whatever the
//! link did to the two messages, for the line `host = offset + rate * board`
//!
//! ```text
//! sent_us  <=  offset + rate * board_received_us   and   offset + rate * board_sent_us  <=  received_us.
//! ```
//!
//! [`ClockFilter`] keeps the round trips of a sliding window and takes the line with the widest room
//! between the two sets of bounds: the largest of the lower bounds and the smallest of the upper ones
//! decide, so this is a minimum-delay filter with the minimum taken for each direction on its own.
//!
//! Two ways were weighed. *The round trip of least total delay decides* (NTP): with delays of 0 to 5 ms
//! both ways and 100 round trips the quickest still carries about 0.7 ms, half of which goes into the
//! offset. *Each direction's bound on its own* (Moon, Skelly, Towsley, "Estimation and removal of clock
//! skew from network delay measurements", 1999, here with one slope for both directions) needs a quick
//! request and a quick answer only somewhere in the window, and is ten times closer on the same data.
//! The second is used.
//!
//! What it cannot see: a constant difference between the two directions' *least* delays goes into the
//! offset by half, as for every method that only has round trips. The time the bytes take on a wire of
//! known baud rate is known and is taken out before (see [`WireTime`]).

use std::collections::VecDeque;

/// Largest believed rate difference between a board's clock and the host's. Crystals stay within
/// 100 ppm; the internal RC oscillator of an STM32F4 is trimmed to 1 % and is not meant to be used.
pub const MAX_DRIFT: f64 = 500e-6;
/// Spread of the rates of crystals that are expected (one standard deviation); decides only while the
/// window is too short to tell.
const USUAL_DRIFT: f64 = 100e-6;
/// How much of the past counts. A minute lets the slope settle to well under 1 ppm at 5 ms of jitter and
/// still follows a crystal that warms up (about 1 ppm a minute).
pub const WINDOW_US: i64 = 60_000_000;
/// Round trips a second while the line is younger than [`START_US`]. On 300 simulated boards with 0 to
/// 5 ms of delay each way the error after ten seconds was 87 us rms and 303 us at worst with 10 a second,
/// 50 and 253 with 20, and is below 200 at worst with 40. A streaming board's answers wait behind its
/// contacts: sixty sets of three whole boards (`tests/tests/clock_alignment.rs`) were apart by up to 458 us
/// with 40, and are by up to 168 with 80.
pub const START_RATE_HZ: f64 = 80.0;
/// Round trips a second from then on.
pub const STEADY_RATE_HZ: f64 = 10.0;
/// How long a line is young, microseconds.
pub const START_US: i64 = 10_000_000;
/// Most round trips kept: more than both rates fill the window with.
const MAX_ROUND_TRIPS: usize = 1_400;
/// A round trip whose bounds miss every line that the window allows by more than this contradicts it.
const CONTRADICTION_US: f64 = 3_000.0;
/// So many contradicting round trips in a row mean that one of the clocks was set, not that one answer
/// was mismatched.
const CONTRADICTIONS_FOR_A_JUMP: usize = 3;

/// A request and its answer, as both clocks saw them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundTrip {
    /// Host's clock right before the request was written, microseconds since the Unix epoch.
    pub sent_us: i64,
    /// Board's clock when it had the request, microseconds since its start.
    pub board_received_us: i64,
    /// Board's clock when it sent the answer, microseconds since its start.
    pub board_sent_us: i64,
    /// Host's clock right after the answer had been read, microseconds since the Unix epoch.
    pub received_us: i64,
}

/// Time that bytes spend on the wire itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum WireTime {
    /// Bytes arrive as they are written: USB and pseudo-terminals.
    #[default]
    None,
    /// A UART: ten bits a byte.
    Baud(u32),
}

impl WireTime {
    /// Microseconds that `bytes` bytes take.
    pub fn of(self, bytes: usize) -> i64 {
        match self {
            Self::None | Self::Baud(0) => 0,
            Self::Baud(baud) => (bytes as i64 * 10_000_000) / i64::from(baud),
        }
    }
}

/// The line `host = offset + rate * board` with what is known of its quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockFit {
    /// Board time the line is written around, microseconds.
    origin_board_us: i64,
    /// Host time at that board time, microseconds since the Unix epoch.
    origin_host_us: i64,
    /// Correction to the host time at the origin, microseconds.
    shift_us: f64,
    /// How much faster the host's clock runs than the board's, as a fraction (1e-6 = 1 ppm).
    pub drift: f64,
    /// Half of the room between the bounds: no error is larger as long as the rate is right.
    pub bound_us: f64,
    /// How far below and above this line the window allows others of the same rate, microseconds.
    room_us: (f64, f64),
    /// Round trips in the window.
    pub round_trips: usize,
    /// Time between the first and the last of them on the board's clock.
    pub span_us: i64,
}

impl ClockFit {
    /// Host time, microseconds since the Unix epoch, at which the board's clock showed `board_us`.
    pub fn host_us(&self, board_us: i64) -> i64 {
        let since = board_us.saturating_sub(self.origin_board_us);
        let correction = self.shift_us + self.drift * since as f64;
        self.origin_host_us
            .saturating_add(since)
            .saturating_add(correction.round() as i64)
    }

    /// Host time minus board time at `board_us`, microseconds.
    pub fn offset_us(&self, board_us: i64) -> i64 {
        self.host_us(board_us).saturating_sub(board_us)
    }
}

/// What adding a round trip did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockEvent {
    /// It joined the window.
    Kept,
    /// It can't be: an answer before its request. Left out.
    Impossible,
    /// It contradicts the line; left out unless the next ones agree with it.
    Doubted,
    /// The last few agree with each other and not with the line: a clock was set, or the board
    /// restarted. The window starts anew with them.
    Jumped {
        /// By how much the board's clock moved against the line, microseconds.
        by_us: i64,
    },
}

/// Keeps a board's clock in line with the host's; one per connection to a board.
#[derive(Clone, Debug, Default)]
pub struct ClockFilter {
    window: VecDeque<RoundTrip>,
    doubted: Vec<RoundTrip>,
    fit: Option<ClockFit>,
}

impl ClockFilter {
    /// A filter that knows nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The line as it stands; `None` before the first round trip.
    pub fn fit(&self) -> Option<&ClockFit> {
        self.fit.as_ref()
    }

    /// Forgets everything: the board has restarted.
    pub fn restart(&mut self) {
        *self = Self::default();
    }

    /// Takes one round trip in and brings the line up to date.
    pub fn add(&mut self, trip: RoundTrip) -> ClockEvent {
        if trip.received_us < trip.sent_us || trip.board_sent_us < trip.board_received_us {
            return ClockEvent::Impossible;
        }
        let miss_us = self.miss_us(&trip);
        if miss_us.abs() > CONTRADICTION_US {
            self.doubted.push(trip);
            if self.doubted.len() < CONTRADICTIONS_FOR_A_JUMP {
                return ClockEvent::Doubted;
            }
            let doubted = std::mem::take(&mut self.doubted);
            self.window.clear();
            self.window.extend(doubted);
            self.fit = fit(&self.window);
            return ClockEvent::Jumped {
                by_us: -miss_us.round() as i64,
            };
        }
        self.doubted.clear();
        self.window.push_back(trip);
        while self.window.len() > MAX_ROUND_TRIPS
            || self
                .window
                .front()
                .is_some_and(|oldest| trip.sent_us.saturating_sub(oldest.sent_us) > WINDOW_US)
        {
            self.window.pop_front();
        }
        self.fit = fit(&self.window);
        ClockEvent::Kept
    }

    /// By how far all lines that the window allows pass outside the bounds of a round trip: positive above,
    /// negative below. After slow answers the room is wide and the line somewhere in it: a quick answer that
    /// moves the line within its room contradicts nothing.
    fn miss_us(&self, trip: &RoundTrip) -> f64 {
        let Some(fit) = &self.fit else {
            return 0.0;
        };
        let above = fit
            .host_us(trip.board_sent_us)
            .saturating_sub(trip.received_us);
        let below = fit
            .host_us(trip.board_received_us)
            .saturating_sub(trip.sent_us);
        let miss = if above > 0 {
            (above as f64 - fit.room_us.0).max(0.0)
        } else if below < 0 {
            (below as f64 + fit.room_us.1).min(0.0)
        } else {
            0.0
        };
        // A young line may still be off by the whole believed drift.
        let age_us = trip.board_sent_us.saturating_sub(fit.origin_board_us);
        let slack = 2.0 * MAX_DRIFT * age_us.unsigned_abs() as f64;
        // The slack only excuses what a wrong rate can explain while the window is short.
        let excused = if fit.span_us < 2_000_000 { slack } else { 0.0 };
        if miss.abs() <= excused { 0.0 } else { miss }
    }
}

/// The bounds of the round trips in the window, relative to the newest one; only those that can decide:
/// the upper hull of the lower bounds and the lower hull of the upper ones.
struct Bounds {
    /// Board time and lower bound of (host - board), microseconds.
    below: Vec<(f64, f64)>,
    /// Board time and upper bound of (host - board), microseconds.
    above: Vec<(f64, f64)>,
}

/// The upper (`side` = 1) or lower (`side` = -1) convex hull of points (Andrew's monotone chain).
fn hull(mut points: Vec<(f64, f64)>, side: f64) -> Vec<(f64, f64)> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for point in points {
        while let [.., (ax, ay), (bx, by)] = hull[..] {
            let turn = (bx - ax) * (point.1 - ay) - (by - ay) * (point.0 - ax);
            if side * turn < 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    }
    hull
}

impl Bounds {
    /// Largest lower and smallest upper bound of the line's height at the origin, for a given rate.
    fn room(&self, drift: f64) -> (f64, f64) {
        let height = |&(board, bound): &(f64, f64)| bound - drift * board;
        let low = self
            .below
            .iter()
            .map(height)
            .fold(f64::NEG_INFINITY, f64::max);
        let high = self.above.iter().map(height).fold(f64::INFINITY, f64::min);
        (low, high)
    }

    fn width(&self, drift: f64) -> f64 {
        let (low, high) = self.room(drift);
        high - low
    }

    /// The rate with the widest room: a concave function, so shrinking the interval by thirds finds it.
    fn widest(&self) -> f64 {
        let (mut left, mut right) = (-MAX_DRIFT, MAX_DRIFT);
        // (2/3)^40 of 1e-3 is 1e-10: 6 ns over a minute.
        for _ in 0..40 {
            let third = (right - left) / 3.0;
            let (a, b) = (left + third, right - third);
            let (at_a, at_b) = (self.width(a), self.width(b));
            if at_a < at_b {
                left = a;
            } else if at_a > at_b {
                right = b;
            } else {
                (left, right) = (a, b);
            }
        }
        0.5 * (left + right)
    }

    /// Where the room has shrunk by `loss_us` from its widest, on the side of `limit`.
    fn edge(&self, widest: f64, limit: f64, loss_us: f64) -> f64 {
        let threshold = self.width(widest) - loss_us;
        if self.width(limit) >= threshold {
            return limit;
        }
        let (mut inside, mut outside) = (widest, limit);
        for _ in 0..30 {
            let middle = 0.5 * (inside + outside);
            if self.width(middle) >= threshold {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        inside
    }
}

/// The mean of all lines the window allows, each weighed by its likelihood.
///
/// Delays beyond the least one are taken as exponential with their measured mean `1 / lambda`. Over n
/// round trips the likelihood of a rate then is `exp(n lambda width(rate))`, for any offset in the room
/// (the sum of all delays does not depend on the line, only the least delay does). Against the single
/// widest line, which hangs on three round trips, the mean halves the error after ten seconds.
fn fit(window: &VecDeque<RoundTrip>) -> Option<ClockFit> {
    let (first, last) = (window.front()?, window.back()?);
    let (origin_board_us, origin_host_us) = (last.board_received_us, last.sent_us);
    let relative = |host_us: i64, board: i64| {
        let height = host_us.saturating_sub(origin_host_us).saturating_sub(board);
        (board as f64, height as f64)
    };
    let (mut below, mut above, mut trips_us) = (Vec::new(), Vec::new(), 0.0);
    for trip in window {
        let received = trip.board_received_us.saturating_sub(origin_board_us);
        let sent = trip.board_sent_us.saturating_sub(origin_board_us);
        below.push(relative(trip.sent_us, received));
        above.push(relative(trip.received_us, sent));
        let away = trip.received_us.saturating_sub(trip.sent_us);
        trips_us += away.saturating_sub(sent.saturating_sub(received)) as f64;
    }
    let bounds = Bounds {
        below: hull(below, 1.0),
        above: hull(above, -1.0),
    };
    let count = window.len() as f64;
    let mean_trip_us = trips_us / count;
    let widest = bounds.widest();
    let width_us = bounds.width(widest);
    let lambda = 1.0 / (0.5 * (mean_trip_us - width_us)).max(1.0);

    // exp(-12) is 6e-6: what lies further out does not count.
    let loss_us = 12.0 / (count * lambda);
    let left = bounds.edge(widest, -MAX_DRIFT, loss_us);
    let right = bounds.edge(widest, MAX_DRIFT, loss_us);
    const STEPS: usize = 32;
    let (mut weight, mut drift, mut shift) = (0.0, 0.0, 0.0);
    for step in 0..=STEPS {
        let rate = left + (right - left) * step as f64 / STEPS as f64;
        let (low, high) = bounds.room(rate);
        let likelihood = (count * lambda * (high - low - width_us)).exp();
        let prior = (-0.5 * (rate / USUAL_DRIFT).powi(2)).exp();
        let share = likelihood * prior;
        weight += share;
        drift += share * rate;
        shift += share * 0.5 * (low + high);
    }
    let (drift, shift_us) = if weight > 0.0 {
        (drift / weight, shift / weight)
    } else {
        let (low, high) = bounds.room(widest);
        (widest, 0.5 * (low + high))
    };
    let (low, high) = bounds.room(drift);
    Some(ClockFit {
        origin_board_us,
        origin_host_us,
        shift_us,
        drift,
        bound_us: 0.5 * width_us.abs(),
        room_us: ((shift_us - low).max(0.0), (high - shift_us).max(0.0)),
        round_trips: window.len(),
        span_us: last
            .board_received_us
            .saturating_sub(first.board_received_us),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A board whose clock starts anywhere and runs fast or slow, behind a link with jitter.
    struct Board {
        start_us: f64,
        drift: f64,
        jitter_us: f64,
        rng: ChaCha8Rng,
    }

    impl Board {
        fn new(seed: u64, start_us: f64, drift: f64, jitter_us: f64) -> Self {
            Self {
                start_us,
                drift,
                jitter_us,
                rng: ChaCha8Rng::seed_from_u64(seed),
            }
        }

        fn board_us(&self, host_us: f64) -> f64 {
            (host_us - self.start_us) * (1.0 + self.drift)
        }

        fn trip(&mut self, sent_us: f64) -> RoundTrip {
            let out = 300.0 + self.rng.random_range(0.0..self.jitter_us);
            let back = 300.0 + self.rng.random_range(0.0..self.jitter_us);
            RoundTrip {
                sent_us: sent_us as i64,
                board_received_us: self.board_us(sent_us + out) as i64,
                board_sent_us: self.board_us(sent_us + out + 120.0) as i64,
                received_us: (sent_us + out + 120.0 + back) as i64,
            }
        }
    }

    const NOW: f64 = 1.7e15;

    fn after(seconds: f64, rate_hz: f64, board: &mut Board) -> ClockFilter {
        let mut filter = ClockFilter::new();
        for k in 0..(seconds * rate_hz) as usize {
            filter.add(board.trip(NOW + k as f64 * 1e6 / rate_hz));
        }
        filter
    }

    fn error_us(filter: &ClockFilter, board: &Board, host_us: f64) -> f64 {
        let read = board.board_us(host_us) as i64;
        filter.fit().expect("round trips were added").host_us(read) as f64 - host_us
    }

    #[test]
    fn boards_agree_within_200_us_after_10_s_of_5_ms_jitter_and_100_ppm() {
        let mut worst: f64 = 0.0;
        let mut sum = 0.0;
        for seed in 0..100 {
            for (start, drift) in [(3e6, 100e-6), (-7e9, -100e-6), (1.0, 37e-6)] {
                let mut board = Board::new(seed, NOW - start, drift, 5_000.0);
                let filter = after(10.0, START_RATE_HZ, &mut board);
                let error = error_us(&filter, &board, NOW + 10e6);
                sum += error * error;
                worst = worst.max(error.abs());
            }
        }
        let rms = (sum / 300.0_f64).sqrt();
        println!("worst {worst} us, rms {rms} us");
        assert!(worst < 200.0, "worst error {worst} us");
        assert!(rms < 50.0, "rms error {rms} us");
    }

    #[test]
    fn a_long_window_finds_the_drift() {
        let mut board = Board::new(7, NOW - 5e6, 83e-6, 5_000.0);
        let filter = after(120.0, 10.0, &mut board);
        let fit = filter.fit().expect("round trips were added");
        assert!((fit.drift + 83e-6).abs() < 2e-6, "drift {}", fit.drift);
        assert!(fit.span_us <= WINDOW_US + 200_000);
        assert!(error_us(&filter, &board, NOW + 120e6).abs() < 60.0);
    }

    #[test]
    fn the_first_round_trip_gives_its_middle() {
        let mut filter = ClockFilter::new();
        assert!(filter.fit().is_none());
        filter.add(RoundTrip {
            sent_us: 1_000,
            board_received_us: 50,
            board_sent_us: 50,
            received_us: 3_000,
        });
        let fit = filter.fit().expect("one round trip");
        assert_eq!(fit.host_us(50), 2_000);
        assert_eq!(fit.bound_us, 1_000.0);
    }

    #[test]
    fn an_answer_before_its_request_is_left_out() {
        let mut filter = ClockFilter::new();
        let event = filter.add(RoundTrip {
            sent_us: 10,
            board_received_us: 0,
            board_sent_us: 0,
            received_us: 9,
        });
        assert_eq!(event, ClockEvent::Impossible);
        assert!(filter.fit().is_none());
    }

    #[test]
    fn one_wrong_answer_is_doubted_and_a_set_clock_is_followed() {
        let mut board = Board::new(1, NOW, 20e-6, 1_000.0);
        let mut filter = after(20.0, 10.0, &mut board);
        let mut wrong = board.trip(NOW + 20e6);
        wrong.board_received_us += 400_000;
        wrong.board_sent_us += 400_000;
        assert_eq!(filter.add(wrong), ClockEvent::Doubted);
        assert_eq!(
            filter.add(board.trip(NOW + 20.1e6)),
            ClockEvent::Kept,
            "a true one is still believed"
        );
        assert!(error_us(&filter, &board, NOW + 20.1e6).abs() < 100.0);

        board.start_us -= 250_000.0; // the board's clock is set forward by 0.25 s
        let events: Vec<ClockEvent> = (0..3)
            .map(|k| filter.add(board.trip(NOW + 21e6 + k as f64 * 1e5)))
            .collect();
        assert_eq!(events[..2], [ClockEvent::Doubted, ClockEvent::Doubted]);
        let ClockEvent::Jumped { by_us } = events[2] else {
            panic!("expected a jump, got {:?}", events[2]);
        };
        assert!((by_us + 250_000).abs() < 5_000, "jump of {by_us} us");
        assert!(error_us(&filter, &board, NOW + 21.2e6).abs() < 1_000.0);
    }

    #[test]
    fn quick_answers_after_a_slow_one_are_no_contradiction() {
        // The board's clock is the host's. One way of the first round trip takes long, or the other.
        for (out, back) in [(90_000, 500), (500, 90_000)] {
            let mut filter = ClockFilter::new();
            let slow = RoundTrip {
                sent_us: 0,
                board_received_us: out,
                board_sent_us: out,
                received_us: out + back,
            };
            assert_eq!(filter.add(slow), ClockEvent::Kept);
            for start_us in (1..20).map(|k| 100_000 * k) {
                let quick = RoundTrip {
                    sent_us: start_us,
                    board_received_us: start_us + 500,
                    board_sent_us: start_us + 600,
                    received_us: start_us + 1_100,
                };
                assert_eq!(filter.add(quick), ClockEvent::Kept, "{start_us}");
            }
            let fit = filter.fit().expect("round trips were added");
            assert!(fit.host_us(2_000_000).abs_diff(2_000_000) < 600);
        }
    }

    #[test]
    fn extreme_times_do_not_panic() {
        let extremes = [i64::MIN, -1, 0, 1, i64::MAX];
        for sent_us in extremes {
            for board_us in extremes {
                for received_us in extremes {
                    let mut filter = ClockFilter::new();
                    for _ in 0..4 {
                        filter.add(RoundTrip {
                            sent_us: 0,
                            board_received_us: 0,
                            board_sent_us: 0,
                            received_us: 1,
                        });
                        filter.add(RoundTrip {
                            sent_us,
                            board_received_us: board_us,
                            board_sent_us: board_us.saturating_add(received_us),
                            received_us,
                        });
                    }
                    if let Some(fit) = filter.fit() {
                        fit.host_us(i64::MAX);
                        fit.offset_us(i64::MIN);
                    }
                }
            }
        }
    }

    #[test]
    fn wire_time_is_ten_bits_a_byte() {
        assert_eq!(WireTime::Baud(115_200).of(48), 4_166);
        assert_eq!(WireTime::None.of(48), 0);
        assert_eq!(WireTime::Baud(0).of(48), 0);
    }
}
