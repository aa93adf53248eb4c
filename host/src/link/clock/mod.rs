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
//! A contact says when it was made: what comes of the stream bounds the line as an answer does, at no cost to the line.
//!
//! [`ClockFilter`] keeps the round trips of a sliding window and the quickest of the stream's contacts, and takes the
//! likeliest line between the two sets of bounds: the largest of the lower bounds and the smallest of the upper ones
//! decide, so this is a minimum-delay filter with the minimum taken for each direction on its own.
//!
//! Two ways were weighed. *The round trip of least total delay decides* (NTP): with delays of 0 to 5 ms
//! both ways and 100 round trips the quickest still carries about 0.7 ms, half of which goes into the
//! offset. *Each direction's bound on its own* (Moon, Skelly, Towsley, "Estimation and removal of clock
//! skew from network delay measurements", 1999, here with one slope for both directions) needs a quick
//! request and a quick answer only somewhere in the window, and is ten times closer on the same data.
//! The second is used. It also takes what comes one way only: 200 contacts a second pin the rate down, and a direction
//! of few messages then has only the offset left to find.
//!
//! What it cannot see: a constant difference between the two directions' *least* delays goes into the
//! offset by half, as for every method that only has round trips. The time the bytes take on a wire of
//! known baud rate is known and is taken out before (see [`WireTime`]).

mod line;

use line::fit;
use std::collections::VecDeque;

pub use line::ClockFit;

/// Largest believed rate difference between a board's clock and the host's. Crystals stay within
/// 100 ppm; the internal RC oscillator of an STM32F4 is trimmed to 1 % and is not meant to be used.
pub const MAX_DRIFT: f64 = 500e-6;
/// How much of the past counts. A minute lets the slope settle to well under 1 ppm at 5 ms of jitter and
/// still follows a crystal that warms up (about 1 ppm a minute).
pub const WINDOW_US: i64 = 60_000_000;
/// Round trips a second while the line is younger than [`START_US`]. On 300 simulated boards with 0 to 5 ms of delay
/// each way that stream nothing the error after ten seconds was 303 us at worst with 10 a second, 253 with 20, and is
/// below 200 with 40. Sixty sets of three whole boards (`tests/tests/clock_alignment.rs`) with 80 were apart by up to
/// 168 us when only the round trips counted, and are by 38 with the contacts.
pub const START_RATE_HZ: f64 = 80.0;
/// Round trips a second from then on.
pub const STEADY_RATE_HZ: f64 = 10.0;
/// How long a line is young, microseconds.
pub const START_US: i64 = 10_000_000;
/// Most round trips kept: more than both rates fill the window with.
const MAX_ROUND_TRIPS: usize = 1_400;
/// Of the contacts made within so long only the quickest is kept, microseconds of board time: as many then are kept as
/// round trips, and none that could decide is let go.
const QUICKEST_OF_US: i64 = 50_000;
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
    /// What the stream brought: the host's time and the board's, oldest first.
    heard: VecDeque<(i64, i64)>,
    /// Board time from which on contacts are compared with the last one of `heard`.
    compared_from_us: i64,
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
            self.heard.clear();
            self.fit = fit(self.window.iter(), std::iter::empty());
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
        while self.heard.front().is_some_and(|(received_us, _)| {
            trip.received_us.saturating_sub(*received_us) > WINDOW_US
        }) {
            self.heard.pop_front();
        }
        self.fit = fit(self.window.iter(), self.heard.iter().copied());
        ClockEvent::Kept
    }

    /// Takes in that the host had at `received_us` what the board made at `board_us`; later ones than before, and only
    /// once there is a line. Tells the next [`Self::add`] more, and doesn't move the line before.
    pub fn hear(&mut self, received_us: i64, board_us: i64) {
        let Some(fit) = &self.fit else {
            return;
        };
        // What contradicts the line waits for round trips to say who is right.
        let above = fit.host_us(board_us).saturating_sub(received_us);
        if beyond_room_us(fit, above, 0, board_us).abs() > CONTRADICTION_US {
            return;
        }
        let lateness =
            |(received_us, board_us): (i64, i64)| received_us.saturating_sub(fit.host_us(board_us));
        let now = (received_us, board_us);
        let compared = board_us.saturating_sub(self.compared_from_us);
        match self.heard.back_mut() {
            Some(last) if (0..QUICKEST_OF_US).contains(&compared) => {
                if lateness(now) < lateness(*last) {
                    *last = now;
                }
            }
            _ => {
                self.compared_from_us = board_us;
                self.heard.push_back(now);
                if self.heard.len() > MAX_ROUND_TRIPS {
                    self.heard.pop_front();
                }
            }
        }
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
        beyond_room_us(fit, above, below, trip.board_sent_us)
    }
}

/// By how far a line and all others that its room allows pass above a bound from above that it misses by `above`, or
/// below one from below that it is off from by `below`.
fn beyond_room_us(fit: &ClockFit, above: i64, below: i64, board_us: i64) -> f64 {
    let miss = if above > 0 {
        (above as f64 - fit.room_us.0).max(0.0)
    } else if below < 0 {
        (below as f64 + fit.room_us.1).min(0.0)
    } else {
        0.0
    };
    // A young line may still be off by the whole believed drift.
    let age_us = board_us.saturating_sub(fit.origin_board_us);
    let slack = 2.0 * MAX_DRIFT * age_us.unsigned_abs() as f64;
    // The slack only excuses what a wrong rate can explain while the window is short.
    let excused = if fit.span_us < 2_000_000 { slack } else { 0.0 };
    if miss.abs() <= excused { 0.0 } else { miss }
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
    fn what_the_board_streams_pins_the_line_where_round_trips_are_few() {
        // Ten round trips a second, alone and with 200 contacts a second.
        let (mut alone, mut with): (f64, f64) = (0.0, 0.0);
        for seed in 0..40 {
            let mut board = Board::new(seed, NOW - 3e6, 100e-6, 5_000.0);
            let mut few = ClockFilter::new();
            let mut heard = ClockFilter::new();
            for k in 0..2_000 {
                let at = NOW + k as f64 * 5_000.0;
                if k % 20 == 0 {
                    let trip = board.trip(at);
                    few.add(trip);
                    heard.add(trip);
                }
                let late = 300.0 + board.rng.random_range(0.0..board.jitter_us);
                heard.hear((at + late) as i64, board.board_us(at) as i64);
            }
            alone = alone.max(error_us(&few, &board, NOW + 10e6).abs());
            let last = board.trip(NOW + 10e6);
            heard.add(last);
            with = with.max(error_us(&heard, &board, NOW + 10e6).abs());
            assert!(heard.heard.len() <= 201, "{}", heard.heard.len());
        }
        println!("alone {alone} us, with contacts {with} us");
        assert!(
            with < 0.5 * alone,
            "alone {alone} us, with contacts {with} us"
        );
    }

    #[test]
    fn a_contact_that_contradicts_the_line_moves_it_nowhere() {
        let mut board = Board::new(3, NOW - 5e6, 40e-6, 1_000.0);
        let mut filter = after(10.0, 10.0, &mut board);
        for k in 0..200 {
            let at = NOW + 10e6 + k as f64 * 5_000.0;
            filter.hear(at as i64, board.board_us(at) as i64 + 50_000);
        }
        assert!(filter.heard.is_empty());
        assert_eq!(filter.add(board.trip(NOW + 11e6)), ClockEvent::Kept);
        assert!(error_us(&filter, &board, NOW + 11e6).abs() < 100.0);
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
        assert!((fit.bound_us - 1_000.0).abs() < 1e-6, "{}", fit.bound_us);
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
                        filter.hear(received_us, board_us);
                        filter.hear(sent_us, received_us);
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
