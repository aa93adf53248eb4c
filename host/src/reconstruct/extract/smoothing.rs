//! How noisy the contacts are and how smooth the surface is, from the contacts themselves.
//!
//! Two ways were weighed. Generalised cross validation picks one smoothing weight and says nothing of the
//! noise. The restricted likelihood of the local models separates the three things that matter: standard
//! deviation of the positions, of the normals, and the smoothness `tau^2`; it won on all of torus, bean and
//! two-holed torus with contact tracks (noise 0.005 and 3 degrees). The likelihood's noise levels would follow every outlier, so
//! they are set by the medians of the leave-one-out deviations instead: for the right levels these
//! deviations are standard normal.

use std::collections::HashMap;

use rayon::prelude::*;

use super::{
    contacts::Normalised,
    kernel::Kernel,
    local_fit::{Contacts, LocalProblem},
};
use crate::{Vec3, cloud::Neighbourhoods};

/// Balls from which the noise is estimated; more change the estimate by less than its own error.
const SAMPLED_BALLS: usize = 32;
/// Contacts per ball for that: small balls, so that many hold neither crease nor feature.
const SAMPLED_CONTACTS: usize = 40;
/// Rounds of noise estimation at most, with a third of the balls and with all.
const ROUNDS: usize = 8;
/// Contacts of a ball from which half of them tell its smoothness.
const THINNED_FROM: usize = 48;
/// Change of the noise from one round to the next that ends them: its own error is about as large. The same for the rounds with
/// a third of the balls.
const SETTLED: f64 = 0.04;
const SETTLED_ROUGHLY: f64 = 0.2;
/// Least noise assumed, normalised units and radians: keeps the systems solvable for exact data. Normals are never met to
/// less than a thousandth, and below a twenty thousandth only rounds would be lost.
const LEAST_POSITION_SIGMA: f64 = 1e-7;
const LEAST_NORMAL_SIGMA: f64 = 5e-5;

/// Noise levels and smoothness, normalised units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Levels {
    pub position_sigma: f64,
    pub normal_sigma: f64,
    /// `tau^2` for lengths in normalised units; a ball of radius r uses `tau^2 r^(p-2)`.
    pub tau2: f64,
}

impl Levels {
    /// The same with at least this much noise.
    pub(super) fn at_least(&self, position_sigma: f64, normal_sigma: f64) -> Self {
        Self {
            position_sigma: self.position_sigma.max(position_sigma),
            normal_sigma: self.normal_sigma.max(normal_sigma),
            ..*self
        }
    }
}

/// A ball of neighbouring contacts.
#[derive(Clone, Debug)]
pub(super) struct Cover {
    pub centre: Vec3,
    pub radius: f64,
    pub members: Vec<u32>,
}

impl Cover {
    /// The ball of the `count` contacts nearest to `centre`.
    pub(super) fn around(centre: Vec3, tree: &Neighbourhoods, count: usize) -> Self {
        let found = tree.nearest(&centre, count);
        Self {
            centre,
            radius: 1.0001 * found.last().map_or(0.0, |(_, d2)| d2.sqrt()),
            members: found.iter().map(|&(j, _)| j as u32).collect(),
        }
    }

    /// The same ball with every second contact, if enough are left: smoothness is seen as well by half of the contacts
    /// over the same breadth, at a sixth of the work.
    pub(super) fn thinned(&self) -> Option<Self> {
        (self.members.len() >= THINNED_FROM).then(|| Self {
            members: self.members.iter().step_by(2).copied().collect(),
            ..*self
        })
    }
}

/// Covers the contacts with balls of `k` neighbours such that every contact lies within `share` of a radius of
/// some centre. Contacts are visited in their order, so the cover depends on nothing else.
pub(super) fn cover(positions: &[Vec3], tree: &Neighbourhoods, k: usize, share: f64) -> Vec<Cover> {
    let mut covered = vec![false; positions.len()];
    let mut balls = Vec::new();
    for i in 0..positions.len() {
        if covered[i] {
            continue;
        }
        let found = tree.nearest(&positions[i], k);
        let radius = found.last().map_or(0.0, |(_, d2)| d2.sqrt());
        for &(j, d2) in &found {
            if d2 <= (share * radius).powi(2) {
                covered[j] = true;
            }
        }
        covered[i] = true;
        balls.push(Cover {
            centre: positions[i],
            radius: radius * 1.0001,
            members: found.iter().map(|&(j, _)| j as u32).collect(),
        });
    }
    balls
}

/// Six places around a contact in its tangent plane.
pub(super) fn around(position: Vec3, normal: Vec3, distance: f64) -> impl Iterator<Item = Vec3> {
    let across = normal.cross(&Vec3::ith(normal.iamin(), 1.0)).normalize();
    let along = normal.cross(&across);
    (0..6).map(move |i| {
        let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_3).sin_cos();
        position + distance * (cos * across + sin * along)
    })
}

/// Balls around places between the contacts, so that gaps are interpolated from all sides instead of extrapolated from
/// each: on the mug's tracks the largest error falls by a third.
///
/// Places are tried around every contact in its tangent plane, and taken if they are `spacing` away from all
/// contacts and `apart` spacings from each other.
pub(super) fn gap_covers(
    data: &Normalised,
    tree: &Neighbourhoods,
    k: usize,
    spacing: f64,
    apart: f64,
) -> Vec<Cover> {
    let candidates: Vec<Vec3> = data
        .positions
        .par_iter()
        .zip(&data.normals)
        .flat_map_iter(|(p, n)| {
            around(*p, *n, 1.6 * spacing).filter_map(move |x| {
                let (_, d2) = tree.nearest_one(&x)?;
                (d2 > (1.1 * spacing).powi(2)).then_some(x)
            })
        })
        .collect();
    let mut taken = Apart::by(apart * spacing);
    candidates
        .into_iter()
        .filter(|x| taken.take(x, (), |()| true))
        .map(|x| Cover::around(x, tree, k))
        .collect()
}

/// Places that keep a distance from one another, with something known of each.
pub(super) struct Apart<T> {
    distance: f64,
    taken: HashMap<[i32; 3], Vec<(Vec3, T)>>,
}

impl<T> Apart<T> {
    /// None yet; they will be `distance` apart.
    pub(super) fn by(distance: f64) -> Self {
        Self {
            distance,
            taken: HashMap::new(),
        }
    }

    /// Takes `x` if no place that `clashes` is nearer; says whether it did.
    pub(super) fn take(&mut self, x: &Vec3, known: T, clashes: impl Fn(&T) -> bool) -> bool {
        let cell: [i32; 3] = std::array::from_fn(|a| (x[a] / self.distance).floor() as i32);
        let near = (0..27).any(|n| {
            let other = [
                cell[0] + n % 3 - 1,
                cell[1] + n / 3 % 3 - 1,
                cell[2] + n / 9 - 1,
            ];
            let near = |(y, t): &(Vec3, T)| (x - y).norm() < self.distance && clashes(t);
            self.taken.get(&other).is_some_and(|t| t.iter().any(near))
        });
        if !near {
            self.taken.entry(cell).or_default().push((*x, known));
        }
        !near
    }
}

/// Contacts of the coarse field: farthest-point samples of the whole cloud.
pub(super) fn coarse_cover(positions: &[Vec3]) -> Cover {
    const COARSE: usize = 100;
    let mut members = vec![0_u32];
    let mut distance: Vec<f64> = positions
        .iter()
        .map(|p| (p - positions[0]).norm_squared())
        .collect();
    while members.len() < COARSE.min(positions.len()) {
        let (mut best, mut far) = (0, 0.0);
        for (i, &d) in distance.iter().enumerate() {
            if d > far {
                (best, far) = (i, d);
            }
        }
        if far == 0.0 {
            break;
        }
        members.push(best as u32);
        let p = positions[best];
        for (d, q) in distance.iter_mut().zip(positions) {
            *d = d.min((q - p).norm_squared());
        }
    }
    Cover {
        centre: Vec3::zeros(),
        radius: 0.5,
        members,
    }
}

/// The local problem of a ball.
pub(super) fn problem(
    kernel: Kernel,
    data: &Normalised,
    ball: &Cover,
    levels: &Levels,
) -> LocalProblem {
    let local = |i: &u32| (data.positions[*i as usize] - ball.centre) / ball.radius;
    LocalProblem::new(
        kernel,
        Contacts {
            nodes: ball.members.iter().map(local).collect(),
            normals: ball
                .members
                .iter()
                .map(|&i| data.normals[i as usize])
                .collect(),
            position_sigma: ball
                .members
                .iter()
                .map(|&i| levels.position_sigma * data.relative_sigma[i as usize] / ball.radius)
                .collect(),
            normal_sigma: ball
                .members
                .iter()
                .map(|&i| levels.normal_sigma * data.relative_tilt[i as usize])
                .collect(),
        },
    )
}

/// `tau^2` in the local units of a ball.
pub(super) fn local_tau2(problem: &LocalProblem, radius: f64, tau2: f64) -> f64 {
    tau2 * radius.powi(problem.kernel().exponent() - 2)
}

/// Where the search for the smoothness begins at least: far below it the evidence is flat, since the fit is a polynomial anyway, and
/// a search that begins there may stay there.
const LEAST_START: f64 = 1e-3;
/// Decades by which one ball's smoothness may differ from the common one before its own evidence has to be
/// that much stronger (a normal prior on log10 tau^2).
const TAU_SPREAD: f64 = 1.0;

/// The smoothness of a ball: most likely given its contacts, drawn towards the `common` one if given.
pub(super) fn choose_tau2(
    problem: &LocalProblem,
    radius: f64,
    start: f64,
    common: Option<f64>,
) -> f64 {
    let cost = |decade: f64| -> f64 {
        let prior = common.map_or(0.0, |c| 0.5 * ((decade - c.log10()) / TAU_SPREAD).powi(2));
        problem
            .evidence(local_tau2(problem, radius, 10f64.powf(decade)))
            .map_or(f64::INFINITY, |e| e + prior)
    };
    10f64.powf(minimise(start.max(LEAST_START).log10(), cost))
}

/// Steps of a decade downhill, then the parabola through the best three.
fn minimise(start: f64, cost: impl Fn(f64) -> f64) -> f64 {
    let mut at = start;
    let (mut low, mut mid, mut high) = (cost(at - 1.0), cost(at), cost(at + 1.0));
    for _ in 0..12 {
        if low < mid && low <= high {
            at -= 1.0;
            (high, mid) = (mid, low);
            low = cost(at - 1.0);
        } else if high < mid {
            at += 1.0;
            (low, mid) = (mid, high);
            high = cost(at + 1.0);
        } else {
            break;
        }
    }
    let bend = low - 2.0 * mid + high;
    if bend.is_finite() && bend > 0.0 {
        at + (0.5 * (low - high) / bend).clamp(-0.5, 0.5)
    } else {
        at
    }
}

/// Estimates noise and smoothness from a sample of small balls, from a third of them first.
///
/// The noise is taken from the smoother half of them: where the surface bends sharply (creases, the handle of a
/// mug) a rough field follows the noise, and the deviations say nothing.
pub(super) fn estimate(kernel: Kernel, data: &Normalised, tree: &Neighbourhoods) -> Levels {
    let balls = cover(&data.positions, tree, SAMPLED_CONTACTS, 0.5);
    let sample = sampled(&balls);
    let few: Vec<&Cover> = sample.iter().copied().step_by(3).collect();
    let mut levels = first_guess(data, tree);
    for (sample, settled) in [(&few, SETTLED_ROUGHLY), (&sample, SETTLED)] {
        let mut starts = vec![levels.tau2; sample.len()];
        for _ in 0..ROUNDS {
            let before = levels;
            levels = better_levels(kernel, data, sample, &mut starts, &before);
            let same = |now: f64, before: f64| (now / before - 1.0).abs() < settled;
            if same(levels.position_sigma, before.position_sigma)
                && same(levels.normal_sigma, before.normal_sigma)
            {
                break;
            }
        }
    }
    levels
}

/// One round: the noise that makes the deviations of the sampled balls what they should be. `starts` are the balls' own
/// smoothness, from the last round and for the next.
fn better_levels(
    kernel: Kernel,
    data: &Normalised,
    sample: &[&Cover],
    starts: &mut Vec<f64>,
    levels: &Levels,
) -> Levels {
    let results: Vec<_> = sample
        .par_iter()
        .zip(&*starts)
        .map(|(ball, &start)| {
            let problem = problem(kernel, data, ball, levels);
            let tau2 = choose_tau2(&problem, ball.radius, start, None);
            let out = problem.leave_one_out(local_tau2(&problem, ball.radius, tau2));
            (tau2, out)
        })
        .collect();
    let mut order: Vec<usize> = (0..sample.len()).collect();
    order.sort_by(|&a, &b| results[a].0.total_cmp(&results[b].0).then(a.cmp(&b)));
    let (mut values, mut tangents) = (Vec::new(), Vec::new());
    for &s in &order[..sample.len().div_ceil(2)] {
        let deviations = results[s].1.iter().flatten();
        for (e, &i) in deviations.zip(&sample[s].members) {
            let normal = data.normals[i as usize];
            let e_normal = Vec3::new(e[1], e[2], e[3]);
            let along = normal * e_normal.dot(&normal);
            values.push(e[0].abs());
            tangents.push((e_normal - along).norm_squared());
        }
    }
    // Medians of |N(0,1)| and of chi-squared with two degrees of freedom.
    let position_factor = median(&mut values).map_or(1.0, |m| m / 0.674_49);
    let normal_factor = median(&mut tangents).map_or(1.0, |m| (m / 1.386_29).sqrt());
    *starts = results.iter().map(|(t, _)| *t).collect();
    let mut decades: Vec<f64> = starts.iter().map(|t| t.log10()).collect();
    Levels {
        position_sigma: (levels.position_sigma * position_factor.clamp(0.05, 20.0))
            .max(LEAST_POSITION_SIGMA),
        normal_sigma: (levels.normal_sigma * normal_factor.clamp(0.05, 20.0))
            .max(LEAST_NORMAL_SIGMA),
        tau2: median(&mut decades).map_or(levels.tau2, |d| 10f64.powf(d)),
    }
}

/// The same noise with the smoothness that suits another kernel.
pub(super) fn with_smoothness(
    kernel: Kernel,
    data: &Normalised,
    balls: &[Cover],
    levels: &Levels,
) -> Levels {
    let mut decades: Vec<f64> = sampled(balls)
        .par_iter()
        .map(|ball| {
            let thinned = ball.thinned();
            let problem = problem(kernel, data, thinned.as_ref().unwrap_or(ball), levels);
            choose_tau2(&problem, ball.radius, 0.1, None).log10()
        })
        .collect();
    Levels {
        tau2: median(&mut decades).map_or(levels.tau2, |d| 10f64.powf(d)),
        ..*levels
    }
}

fn sampled(balls: &[Cover]) -> Vec<&Cover> {
    let step = balls.len().div_ceil(SAMPLED_BALLS).max(1);
    balls
        .iter()
        .step_by(step)
        .filter(|b| b.radius > 0.0)
        .collect()
}

/// A rough start: neighbouring normals and the heights of neighbours over each other's tangent planes.
fn first_guess(data: &Normalised, tree: &Neighbourhoods) -> Levels {
    let (mut heights, mut turns) = (Vec::new(), Vec::new());
    let step = data.positions.len().div_ceil(2000).max(1);
    for i in (0..data.positions.len()).step_by(step) {
        for (j, _) in tree.nearest(&data.positions[i], 5) {
            if j == i || data.normals[i].dot(&data.normals[j]) < 0.5 {
                continue;
            }
            let d = data.positions[j] - data.positions[i];
            heights.push((0.5 * d.dot(&(data.normals[i] + data.normals[j]))).abs());
            turns.push((data.normals[i] - data.normals[j]).norm_squared());
        }
    }
    // Height: two positions; turn: two normals with two components each.
    let position = median(&mut heights).map_or(1e-3, |m| m / 0.674_49 / 2f64.sqrt());
    let normal = median(&mut turns).map_or(1e-2, |m| (m / 1.386_29 / 2.0).sqrt());
    Levels {
        position_sigma: position.clamp(LEAST_POSITION_SIGMA, 0.1),
        normal_sigma: normal.clamp(LEAST_NORMAL_SIGMA, 0.5),
        tau2: 1.0,
    }
}

/// The middle value; `None` of nothing.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let (_, m, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*m)
}
