//! The line through the bounds: which offset and rate of a board's clock all messages of the window allow.
//!
//! A message from the host bounds the line from below where the board had it, one from the board from above where
//! it was sent. Only those on the hulls of the two sets can decide.

use super::{MAX_DRIFT, RoundTrip};

/// Spread of the rates of crystals that are expected (one standard deviation); decides only while the
/// window is too short to tell.
const USUAL_DRIFT: f64 = 100e-6;

/// The line `host = offset + rate * board` with what is known of its quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockFit {
    /// Board time the line is written around, microseconds.
    pub(super) origin_board_us: i64,
    /// Host time at that board time, microseconds since the Unix epoch.
    origin_host_us: i64,
    /// Correction to the host time at the origin, microseconds.
    shift_us: f64,
    /// How much faster the host's clock runs than the board's, as a fraction (1e-6 = 1 ppm).
    pub drift: f64,
    /// How far the line lies from the further of its bounds: no error is larger as long as the rate is right.
    pub bound_us: f64,
    /// How far below and above this line the window allows others of the same rate, microseconds.
    pub(super) room_us: (f64, f64),
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

/// The bounds of one direction: board time and bound of (host - board), both relative to the newest round trip's.
struct Direction {
    /// 1: bounds from below; -1: from above.
    side: f64,
    hull: Vec<(f64, f64)>,
    count: f64,
    /// Mean of the board times and of the bounds.
    mean: (f64, f64),
}

impl Direction {
    fn new(points: Vec<(f64, f64)>, side: f64) -> Self {
        let count = points.len() as f64;
        let sum = points
            .iter()
            .fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
        Self {
            side,
            count,
            mean: (sum.0 / count, sum.1 / count),
            hull: hull(points, side),
        }
    }

    /// The bound on the line's height at the origin, for a given rate.
    fn height(&self, drift: f64) -> f64 {
        let nearest = self
            .hull
            .iter()
            .map(|&(board, bound)| self.side * (bound - drift * board))
            .fold(f64::NEG_INFINITY, f64::max);
        self.side * nearest
    }

    /// Mean delay beyond the least one, for a given rate.
    fn mean_delay(&self, drift: f64) -> f64 {
        self.side * (self.height(drift) - (self.mean.1 - drift * self.mean.0))
    }
}

/// Both directions, with what their delays are like.
struct Bounds {
    below: Direction,
    above: Direction,
    /// One over the mean delay beyond the least one, per microsecond.
    lambda: (f64, f64),
}

impl Bounds {
    fn new(below: Direction, above: Direction) -> Self {
        let mut bounds = Self {
            below,
            above,
            lambda: (1.0, 1.0),
        };
        // The rate that fits if both directions are alike shows what each is like.
        let drift = bounds.likeliest();
        let lambda = |direction: &Direction| 1.0 / direction.mean_delay(drift).max(1.0);
        bounds.lambda = (lambda(&bounds.below), lambda(&bounds.above));
        bounds
    }

    /// Largest lower and smallest upper bound of the line's height at the origin, for a given rate.
    fn room(&self, drift: f64) -> (f64, f64) {
        (self.below.height(drift), self.above.height(drift))
    }

    /// How unlikely a rate is: minus the logarithm of its likelihood, but for a constant.
    fn cost(&self, drift: f64) -> f64 {
        self.lambda.0 * self.below.count * self.below.mean_delay(drift)
            + self.lambda.1 * self.above.count * self.above.mean_delay(drift)
    }

    /// The rate of least cost: a convex function, so shrinking the interval by thirds finds it.
    fn likeliest(&self) -> f64 {
        let (mut left, mut right) = (-MAX_DRIFT, MAX_DRIFT);
        // (2/3)^40 of 1e-3 is 1e-10: 6 ns over a minute.
        for _ in 0..40 {
            let third = (right - left) / 3.0;
            let (a, b) = (left + third, right - third);
            let (at_a, at_b) = (self.cost(a), self.cost(b));
            if at_a > at_b {
                left = a;
            } else if at_a < at_b {
                right = b;
            } else {
                (left, right) = (a, b);
            }
        }
        0.5 * (left + right)
    }

    /// Where the cost has risen by `rise` from that of the likeliest rate, on the side of `limit`.
    fn edge(&self, likeliest: f64, limit: f64, rise: f64) -> f64 {
        let most = self.cost(likeliest) + rise;
        if self.cost(limit) <= most {
            return limit;
        }
        let (mut inside, mut outside) = (likeliest, limit);
        for _ in 0..30 {
            let middle = 0.5 * (inside + outside);
            if self.cost(middle) <= most {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        inside
    }

    /// The line's height for a given rate: the middle of the room, less what the quickest of each direction is
    /// expected to have been late beyond the least delay. That is the more the fewer came, so without it a direction
    /// of few messages would draw the line to its side.
    fn shift(&self, drift: f64) -> f64 {
        let (low, high) = self.room(drift);
        let late = |direction: &Direction, lambda: f64| 1.0 / (direction.count * lambda);
        let uneven = late(&self.below, self.lambda.0) - late(&self.above, self.lambda.1);
        let middle = 0.5 * (low + high + uneven);
        if low <= high {
            middle.clamp(low, high)
        } else {
            0.5 * (low + high)
        }
    }
}

/// The mean of all lines the window allows, each weighed by its likelihood.
///
/// Delays beyond the least one are taken as exponential with their measured mean `1 / lambda`, each direction with its
/// own and with a least delay of its own. The likelihood of a rate then is `exp(-sum of lambda * delay)` with the
/// delays that this rate leaves. Against the single likeliest line, which hangs on three messages, the mean halves
/// the error after ten seconds.
pub(super) fn fit<'a>(
    trips: impl ExactSizeIterator<Item = &'a RoundTrip> + Clone,
    heard: impl Iterator<Item = (i64, i64)>,
) -> Option<ClockFit> {
    let round_trips = trips.len();
    let (first, last) = (trips.clone().next()?, trips.clone().last()?);
    let (origin_board_us, origin_host_us) = (last.board_received_us, last.sent_us);
    let relative = |host_us: i64, board_us: i64| {
        let board = board_us.saturating_sub(origin_board_us);
        let height = host_us.saturating_sub(origin_host_us).saturating_sub(board);
        (board as f64, height as f64)
    };
    let below = trips
        .clone()
        .map(|t| relative(t.sent_us, t.board_received_us))
        .collect();
    let above = trips
        .map(|t| (t.received_us, t.board_sent_us))
        .chain(heard)
        .map(|(received_us, board_us)| relative(received_us, board_us))
        .collect();
    let bounds = Bounds::new(Direction::new(below, 1.0), Direction::new(above, -1.0));
    let likeliest = bounds.likeliest();
    let least = bounds.cost(likeliest);

    // exp(-12) is 6e-6: what lies further out does not count.
    let left = bounds.edge(likeliest, -MAX_DRIFT, 12.0);
    let right = bounds.edge(likeliest, MAX_DRIFT, 12.0);
    const STEPS: usize = 32;
    let (mut weight, mut drift, mut shift) = (0.0, 0.0, 0.0);
    for step in 0..=STEPS {
        let rate = left + (right - left) * step as f64 / STEPS as f64;
        let likelihood = (least - bounds.cost(rate)).exp();
        let prior = (-0.5 * (rate / USUAL_DRIFT).powi(2)).exp();
        let share = likelihood * prior;
        weight += share;
        drift += share * rate;
        shift += share * bounds.shift(rate);
    }
    let (drift, shift_us) = if weight > 0.0 {
        (drift / weight, shift / weight)
    } else {
        (likeliest, bounds.shift(likeliest))
    };
    let (low, high) = bounds.room(drift);
    let room_us = ((shift_us - low).max(0.0), (high - shift_us).max(0.0));
    Some(ClockFit {
        origin_board_us,
        origin_host_us,
        shift_us,
        drift,
        bound_us: room_us.0.max(room_us.1),
        room_us,
        round_trips,
        span_us: last
            .board_received_us
            .saturating_sub(first.board_received_us),
    })
}
