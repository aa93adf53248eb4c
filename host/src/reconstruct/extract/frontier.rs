//! How far a surface reaches along its border, from contacts that lie on its inner side up to noise.
//!
//! The border is a height `H(s)` over a closed line of length `length`; a contact has a place `s` on the line and a
//! height `h`. The contacts are taken for a Poisson process: within the sheet with a density `a`, on its edge, where
//! tracks stop and turn, with `rho` per length; beyond there are none, and each height is known to `sigma`. With
//! `z = (H(s) - h) / sigma` the log likelihood is
//!
//! ```text
//! sum log(a Phi(z) + rho phi(z) / sigma) - a int H ds
//! ```
//!
//! (a production frontier with noise: Aigner, Lovell, Schmidt 1977, with Poisson counts instead of one gap each). It is
//! maximised together with a price on the turning of the border: Huber's function of its curvature, so that straight
//! stretches may meet at a corner. For fixed shares of edge and sheet in each contact the problem is convex; Newton's
//! method solves it, and the shares and `rho` follow (expectation-maximisation).
//!
//! All lengths are in spacings of the contacts.

/// A contact near the border.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Place along the line.
    pub along: f64,
    /// Height over the line, outward.
    pub height: f64,
    /// Standard deviation of the height.
    pub sigma: f64,
}

/// A closed line over which heights are sought.
#[derive(Clone, Debug)]
pub(super) struct Line {
    /// Length of the line; its nodes are evenly spread.
    pub length: f64,
    /// Curvature of the line within the surface at each node, positive where it bulges outward.
    pub curvature: Vec<f64>,
    /// Price of turning at each node, 1 as a rule.
    pub price: Vec<f64>,
}

/// Density that emptiness counts with, against one contact per spacing squared. Contacts come in tracks, so an empty place
/// says less than independent contacts would: with 1 the borders of bowls dip where tracks stop short, below 0.3 noisy
/// borders come to lie outside of all contacts.
const EMPTINESS: f64 = 0.3;
/// The same before anything is known about contacts on the edge.
const EMPTINESS_AT_FIRST: f64 = 1.0;
/// Weight of squared curvature up to [`BEND`], in spacings, for exact contacts, and how much it grows with their noise
/// (share per spacing of standard deviation).
const STIFFNESS: f64 = 1000.0;
const STIFFNESS_OF_NOISE: f64 = 4.0;
/// Curvature (per spacing) above which turning has a price per angle only. Price ([`STIFFNESS`] times this, 6.6 per
/// radian) tuned on bowls, balls with straight and wavy rims, tubes, discs, squares, sheets with holes: up to 13
/// the rims of noisy bowls, balls and tubes gain; beyond 8 those of exact wavy ones are cut short.
const BEND: f64 = 0.0066;
/// Heights where the density within the sheet is counted, below the border.
const COUNTED: [f64; 2] = [1.0, 5.0];
/// Least density within the sheet.
const LEAST_DENSITY: f64 = 0.1;
const ROUNDS: usize = 6;
const STEPS: usize = 60;

/// The height at each node of the line; `None` if there is no finite solution.
pub(super) fn heights(line: &Line, touches: &[Touch]) -> Option<Vec<f64>> {
    let count = line.curvature.len();
    if count < 8 || touches.is_empty() {
        return None;
    }
    let step = line.length / count as f64;
    let noise = touches.iter().map(|t| t.sigma).sum::<f64>() / touches.len() as f64;
    let mut problem = Problem {
        line,
        step,
        touches,
        edge_share: vec![0.0; touches.len()],
        emptiness: EMPTINESS_AT_FIRST,
        stiffness: STIFFNESS * (1.0 + STIFFNESS_OF_NOISE * noise),
    };
    let mut heights = vec![0.0; count];
    let mut on_edge: Option<f64> = None;
    for _ in 0..ROUNDS {
        problem.solve(&mut heights)?;
        let below: Vec<f64> = touches
            .iter()
            .map(|t| problem.height_at(&heights, t) - t.height)
            .collect();
        let [least, most] = COUNTED;
        let counted = below.iter().filter(|b| (least..most).contains(*b)).count();
        let density = (counted as f64 / ((most - least) * line.length)).max(LEAST_DENSITY);
        let rho = on_edge.unwrap_or(density);
        for ((share, t), b) in problem.edge_share.iter_mut().zip(touches).zip(&below) {
            let z = b / t.sigma;
            // Edge against sheet is rho / (density sigma) * phi / Phi, and that ratio is the hazard.
            let ratio = rho / (density * t.sigma) * hazard(z);
            *share = ratio / (1.0 + ratio);
        }
        on_edge = Some(problem.edge_share.iter().sum::<f64>() / line.length);
        problem.emptiness = EMPTINESS;
    }
    Some(heights)
}

/// One convex problem: the shares are fixed.
struct Problem<'a> {
    line: &'a Line,
    step: f64,
    touches: &'a [Touch],
    edge_share: Vec<f64>,
    emptiness: f64,
    stiffness: f64,
}

impl Problem<'_> {
    /// The nodes to both sides of a touch and the weight of the second.
    fn nodes(&self, touch: &Touch) -> (usize, usize, f64) {
        let count = self.line.curvature.len();
        let at = (touch.along / self.step).rem_euclid(count as f64);
        let first = (at.floor() as usize).min(count - 1);
        (first, (first + 1) % count, at - first as f64)
    }

    fn height_at(&self, heights: &[f64], touch: &Touch) -> f64 {
        let (a, b, t) = self.nodes(touch);
        (1.0 - t) * heights[a] + t * heights[b]
    }

    /// Deviation of the border's curvature from the line's mean at node `k`, with the nodes it comes from.
    fn bend(&self, heights: &[f64], k: usize, mean: f64) -> (f64, [usize; 3]) {
        let count = heights.len();
        let [a, b] = [(k + count - 1) % count, (k + 1) % count];
        let second = (heights[a] - 2.0 * heights[k] + heights[b]) / self.step.powi(2);
        (second - self.line.curvature[k] + mean, [a, k, b])
    }

    fn mean_curvature(&self) -> f64 {
        self.line.curvature.iter().sum::<f64>() / self.line.curvature.len() as f64
    }

    fn cost(&self, heights: &[f64]) -> f64 {
        let mean = self.mean_curvature();
        let empty: f64 = heights.iter().map(|h| self.emptiness * self.step * h).sum();
        let bent: f64 = (0..heights.len())
            .map(|k| {
                let bend = self.bend(heights, k, mean).0.abs();
                let huber = if bend < BEND {
                    0.5 * bend * bend
                } else {
                    BEND * (bend - 0.5 * BEND)
                };
                self.stiffness * self.step * self.line.price[k] * huber
            })
            .sum();
        let touched: f64 = self
            .touches
            .iter()
            .zip(&self.edge_share)
            .map(|(t, share)| {
                let z = (self.height_at(heights, t) - t.height) / t.sigma;
                0.5 * share * z * z - (1.0 - share) * log_normal_cdf(z)
            })
            .sum();
        empty + bent + touched
    }

    /// Newton's method with step control from `heights`; the Huber weights are those of the last step.
    fn solve(&self, heights: &mut Vec<f64>) -> Option<()> {
        let mean = self.mean_curvature();
        let mut cost = self.cost(heights);
        for _ in 0..STEPS {
            let count = heights.len();
            let mut gradient = vec![self.emptiness * self.step; count];
            let mut matrix = CyclicBand::new(count);
            for k in 0..count {
                let (bend, nodes) = self.bend(heights, k, mean);
                let huber = (BEND / bend.abs().max(f64::MIN_POSITIVE)).min(1.0);
                let weight = self.stiffness * self.step * self.line.price[k] * huber;
                let factors = [1.0, -2.0, 1.0].map(|f| f / self.step.powi(2));
                for (i, fi) in nodes.into_iter().zip(factors) {
                    gradient[i] += weight * bend * fi;
                    for (j, fj) in nodes.into_iter().zip(factors) {
                        matrix.add(i, j, weight * fi * fj);
                    }
                }
                matrix.add(k, k, 1e-9);
            }
            for (t, share) in self.touches.iter().zip(&self.edge_share) {
                let (a, b, second) = self.nodes(t);
                let z = (self.height_at(heights, t) - t.height) / t.sigma;
                let r = hazard(z);
                let first = (share * z - (1.0 - share) * r) / t.sigma;
                let bowed = (share + (1.0 - share) * (r * (z + r)).max(0.0)) / t.sigma.powi(2);
                let ends = [(a, 1.0 - second), (b, second)];
                for (i, fi) in ends {
                    gradient[i] += first * fi;
                    for (j, fj) in ends {
                        matrix.add(i, j, bowed * fi * fj);
                    }
                }
            }
            let step = matrix.solve(&gradient)?;
            let slope: f64 = -gradient.iter().zip(&step).map(|(g, s)| g * s).sum::<f64>();
            let mut share = 1.0;
            loop {
                let tried: Vec<f64> = heights
                    .iter()
                    .zip(&step)
                    .map(|(h, s)| h - share * s)
                    .collect();
                let new = self.cost(&tried);
                if new <= cost + 1e-4 * share * slope {
                    *heights = tried;
                    cost = new;
                    break;
                }
                share *= 0.5;
                if share < 1e-6 {
                    return Some(());
                }
            }
            if step.iter().fold(0.0, |m, s| f64::max(m, s.abs())) * share < 1e-5 {
                break;
            }
        }
        heights.iter().all(|h| h.is_finite()).then_some(())
    }
}

/// Logarithm of the normal distribution function, to 1e-7: Press et al., Numerical Recipes (1992), section 6.2.
fn log_normal_cdf(z: f64) -> f64 {
    const FACTORS: [f64; 9] = [
        -0.822_152_23,
        1.488_515_87,
        -1.135_203_98,
        0.278_868_07,
        -0.186_288_06,
        0.096_784_18,
        0.374_091_96,
        1.000_023_68,
        -1.265_512_23,
    ];
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * x);
    let series = FACTORS.iter().fold(0.170_872_77, |sum, f| f + t * sum);
    let log_half = t.ln() - x * x + series - std::f64::consts::LN_2;
    if z < 0.0 {
        log_half
    } else {
        (-log_half.exp()).ln_1p()
    }
}

/// Normal density over the distribution function.
fn hazard(z: f64) -> f64 {
    let log_density = -0.5 * z * z - 0.5 * std::f64::consts::TAU.ln();
    (log_density - log_normal_cdf(z)).exp()
}

/// A symmetric matrix over a ring of nodes, of which each knows two to either side. Folded (0, n - 1, 1, n - 2, ...) it
/// is a band.
struct CyclicBand {
    count: usize,
    /// Of row i the entries i - 4 to i.
    rows: Vec<[f64; BAND + 1]>,
}

const BAND: usize = 4;

impl CyclicBand {
    fn new(count: usize) -> Self {
        Self {
            count,
            rows: vec![[0.0; BAND + 1]; count],
        }
    }

    fn folded(&self, k: usize) -> usize {
        if 2 * k < self.count {
            2 * k
        } else {
            2 * (self.count - k) - 1
        }
    }

    fn add(&mut self, i: usize, j: usize, value: f64) {
        let (i, j) = (self.folded(i), self.folded(j));
        if i >= j {
            self.rows[i][BAND + j - i] += value;
        }
    }

    /// Solves by Cholesky's factor; `None` if the matrix is not positive definite.
    fn solve(mut self, right: &[f64]) -> Option<Vec<f64>> {
        let mut x = vec![0.0; self.count];
        for (k, value) in right.iter().enumerate() {
            x[self.folded(k)] = *value;
        }
        for i in 0..self.count {
            for j in i.saturating_sub(BAND)..=i {
                let mut sum = self.rows[i][BAND + j - i];
                for k in i.saturating_sub(BAND)..j {
                    if k + BAND >= j {
                        sum -= self.rows[i][BAND + k - i] * self.rows[j][BAND + k - j];
                    }
                }
                self.rows[i][BAND + j - i] = if j < i {
                    sum / self.rows[j][BAND]
                } else if sum > 0.0 {
                    sum.sqrt()
                } else {
                    return None;
                };
            }
            for k in i.saturating_sub(BAND)..i {
                x[i] -= self.rows[i][BAND + k - i] * x[k];
            }
            x[i] /= self.rows[i][BAND];
        }
        for i in (0..self.count).rev() {
            for k in i + 1..(i + BAND + 1).min(self.count) {
                x[i] -= self.rows[k][BAND + i - k] * x[k];
            }
            x[i] /= self.rows[i][BAND];
        }
        Some((0..self.count).map(|k| x[self.folded(k)]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(count: usize, length: f64) -> Line {
        Line {
            length,
            curvature: vec![0.0; count],
            price: vec![1.0; count],
        }
    }

    #[test]
    fn the_ring_is_solved() {
        for count in [8, 9, 30] {
            let mut matrix = CyclicBand::new(count);
            let x: Vec<f64> = (0..count).map(|k| (k as f64).sin()).collect();
            let mut right = vec![0.0; count];
            for k in 0..count {
                for (apart, value) in [(0, 7.0), (1, -2.0), (2, 1.0)] {
                    let j = (k + apart) % count;
                    matrix.add(k, j, value);
                    right[k] += value * x[j];
                    if apart > 0 {
                        matrix.add(j, k, value);
                        right[j] += value * x[k];
                    }
                }
            }
            for (a, b) in matrix.solve(&right).unwrap().iter().zip(&x) {
                assert!((a - b).abs() < 1e-12, "{a} {b}");
            }
        }
    }

    #[test]
    fn the_normal_distribution_is_right_far_out() {
        for (z, log) in [
            (-0.5, -1.175_911_8),
            (1.0, -0.172_753_8),
            (-3.0, -6.607_726_2),
            (-30.0, -454.321_243_6),
        ] {
            assert!((log_normal_cdf(z) - log).abs() < 3e-7 * (1.0 + log.abs()));
        }
        assert!((hazard(-30.0) - 30.033_259).abs() < 1e-4);
    }

    /// Contacts of density 1 up to a height that varies along the line.
    fn sheet(edge: impl Fn(f64) -> f64, length: f64, sigma: f64) -> Vec<Touch> {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let count = (8.0 * length) as usize;
        let mut touches = Vec::new();
        for _ in 0..count {
            let along = length * random.random::<f64>();
            let depth = 8.0 * random.random::<f64>();
            let noise: f64 = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            touches.push(Touch {
                along,
                height: edge(along) - depth + sigma * noise,
                sigma: sigma.max(0.03),
            });
        }
        touches
    }

    #[test]
    fn noise_does_not_carry_the_border_away_and_gaps_do_not_dent_it() {
        let wave = |s: f64| 0.5 + 0.3 * (std::f64::consts::TAU * s / 80.0).sin();
        for sigma in [0.0, 0.2] {
            let mut touches = sheet(wave, 80.0, sigma);
            // Where tracks stop short.
            touches.retain(|t| !(30.0..38.0).contains(&t.along) || t.height < wave(t.along) - 1.0);
            let found = heights(&straight(240, 80.0), &touches).unwrap();
            for (k, h) in found.iter().enumerate() {
                let miss = h - wave(k as f64 / 3.0);
                assert!(miss.abs() < 0.4, "{sigma}: {miss} at {k}");
            }
        }
    }

    #[test]
    fn a_wide_bay_is_followed() {
        let bay = |s: f64| if (30.0..50.0).contains(&s) { -3.0 } else { 0.0 };
        let touches = sheet(bay, 80.0, 0.1);
        let found = heights(&straight(240, 80.0), &touches).unwrap();
        assert!(found[120] < -2.0, "{}", found[120]);
        assert!(found[30].abs() < 0.5, "{}", found[30]);
    }

    #[test]
    fn strange_touches_end_in_a_result() {
        for height in [0.0, 5.0, -5.0] {
            for sigma in [1e-3, 1.0, 50.0] {
                let touch = Touch {
                    along: 1e9,
                    height,
                    sigma,
                };
                if let Some(found) = heights(&straight(48, 16.0), &[touch]) {
                    assert!(found.iter().all(|h| h.is_finite()));
                }
            }
        }
    }
}
