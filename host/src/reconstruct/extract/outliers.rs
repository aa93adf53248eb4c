//! Contacts that contradict the others: slips, false touches, flipped normals.
//!
//! Four looks. Before anything is fitted, a contact needs neighbours that could lie on one smooth sheet with it
//! ([`unsupported`]); this finds gross errors, which would spoil any fit around them. Once the field is known, a
//! contact is set aside if the field misses it by many standard deviations *and* no neighbour agrees with it
//! ([`contradicting`]). The second condition keeps the contacts beside creases: there a smooth field misses
//! them all, but each side agrees with itself. And a false contact that stands alone draws the field to itself, so
//! the few that many neighbours could not share a sheet with are foretold from the others around them.
//!
//! Two ways were weighed for these: weights that fall with the misfit, over and over (the field gives way to a lone
//! false contact from the start, so that its misfit is small and its weight stays), and leaving out, which costs one
//! small fit for each of the few. With 5 % of false contacts, up to a hundred standard deviations off, 290 of 300 on five
//! shapes are found instead of 274, and the surfaces are hardly less true than without any.

use rayon::prelude::*;

use super::{
    contacts::Normalised,
    field::{Ball, BlendedField},
    sheets::SheetField,
    smoothing::{Cover, Levels},
};
use crate::{Vec3, cloud::Neighbourhoods};

/// Neighbours that are asked.
const ASKED: usize = 12;
/// Neighbours that have to agree.
const NEEDED: usize = 2;
/// Slope of the chord against the mean tangent plane up to which two contacts may share a smooth sheet. On
/// a circle the chord never leaves the mean plane, whatever the curvature; only its change counts. 0.35 keeps all
/// contacts of clean mug, cube and torus tracks; a false contact 10 sigma off needs less than 0.1 between contacts to pass.
const SLOPE: f64 = 0.35;
/// Least cosine between normals that may share a sheet.
const COSINE: f64 = 0.3;
/// Beyond this many standard deviations a contact has to be confirmed by its neighbours.
const DEVIATIONS: f64 = 4.5;
/// Standard deviations below which a contact contradicts nothing, relative to the size and in radians: where contacts
/// are exact the field's own error is many of theirs (clean bean: 219 of 1229 good contacts were set aside, and its
/// surface was half as true).
const LEAST_POSITION_SIGMA: f64 = 1e-4;
const LEAST_NORMAL_SIGMA: f64 = 8e-3;
/// Turn, radians, by which curvature alone may part the normals of neighbours that confirm one another, and slope by which
/// its change along the way may part them in height. Without these none of the exact contacts of a peanut (0.16 from one
/// to the next at its waist) was confirmed, and 532 of 1229 were set aside where a gap had spoilt the field beside them.
const CURVED: f64 = 0.3;
const BENT: f64 = 0.1;
/// Cosine between the normals of contacts on opposite sides of a wall, at most.
const OPPOSITE: f64 = -0.5;
/// Contacts from which a doubtful one is foretold.
const WITNESSES: usize = 16;
/// Beyond this many standard deviations of both together it is not what was foretold.
const SURPRISE: f64 = 6.0;
/// Standard deviations that such a field promises, against those it keeps.
const TRUST: f64 = 3.0;
/// If more than this share looks unsupported, the test does not suit the data and nothing is set aside.
const MOST: f64 = 0.3;

/// Contacts without neighbours that could lie on one smooth sheet with them.
pub(super) fn unsupported(data: &Normalised, tree: &Neighbourhoods) -> Vec<bool> {
    let count = data.positions.len();
    if count < 2 * ASKED {
        return vec![false; count];
    }
    let alone: Vec<bool> = (0..count)
        .into_par_iter()
        .map(|i| {
            let supporters = tree
                .nearest(&data.positions[i], ASKED + 1)
                .into_iter()
                .filter(|&(j, _)| j != i && shares_a_sheet(data, i, j))
                .count();
            supporters < NEEDED
        })
        .collect();
    keep_if_few(alone)
}

fn shares_a_sheet(data: &Normalised, i: usize, j: usize) -> bool {
    let d = data.positions[j] - data.positions[i];
    let mean = data.normals[i] + data.normals[j];
    data.normals[i].dot(&data.normals[j]) > COSINE
        && d.dot(&mean).abs() <= SLOPE * d.norm() * mean.norm()
}

/// Contacts that the field misses by far, or that the others do not foretell, and no neighbour confirms. `refit` fits the
/// contacts of some balls.
pub(super) fn contradicting(
    data: &Normalised,
    tree: &Neighbourhoods,
    field: &BlendedField,
    levels: &Levels,
    refit: &dyn Fn(&[Cover]) -> Vec<Option<Ball>>,
) -> Vec<bool> {
    let levels = &levels.at_least(LEAST_POSITION_SIGMA, LEAST_NORMAL_SIGMA);
    let looks: Vec<Look> = (0..data.positions.len())
        .into_par_iter()
        .map(|i| {
            let (value, gradient) = field.value_and_gradient(&data.positions[i]);
            let misses = Miss::of(data, levels, i, value, &gradient).is_more_than([DEVIATIONS; 2]);
            let confirmed = confirmed(data, tree, levels, i);
            Look {
                gradient,
                contradicts: misses && !confirmed,
                doubtful: !confirmed && doubtful(data, tree, i),
            }
        })
        .collect();
    let (which, around): (Vec<usize>, Vec<Cover>) = (0..looks.len())
        .filter(|i| looks[*i].doubtful && !looks[*i].contradicts)
        .filter_map(|i| {
            let gradient = looks[i].gradient;
            let witness = |j: usize| {
                !looks[j].doubtful && data.normals[j].dot(&gradient) > OPPOSITE * gradient.norm()
            };
            Some((i, witnesses(data, tree, i, witness)?))
        })
        .unzip();
    let mut found: Vec<bool> = looks.iter().map(|look| look.contradicts).collect();
    if !which.is_empty() {
        for (i, ball) in which.into_iter().zip(refit(&around)) {
            found[i] = ball.is_some_and(|ball| !foretold(data, levels, i, &ball));
        }
    }
    keep_if_few(found)
}

/// Contacts whose place the field of the sheets misses by far and no neighbour confirms, where a flat sheet leads: a bent one
/// may miss good contacts of a tip. Their normal is not asked: touches of an edge lean.
pub(super) fn off_sheets(
    data: &Normalised,
    tree: &Neighbourhoods,
    field: &SheetField,
    levels: &Levels,
) -> Vec<bool> {
    let levels = &levels.at_least(LEAST_POSITION_SIGMA, LEAST_NORMAL_SIGMA);
    let found = (0..data.positions.len()).into_par_iter().map(|i| {
        let p = &data.positions[i];
        let (value, gradient) = field.value_and_gradient(p);
        let miss = Miss::of(data, levels, i, value, &gradient);
        miss.is_more_than([DEVIATIONS, f64::INFINITY])
            && field.is_flat(p)
            && !confirmed(data, tree, levels, i)
    });
    keep_if_few(found.collect())
}

/// What the field and the neighbours say of a contact.
struct Look {
    /// The field's gradient there.
    gradient: Vec3,
    /// The field misses it and no neighbour confirms it.
    contradicts: bool,
    /// No neighbour confirms it, and many cannot share a sheet with it.
    doubtful: bool,
}

/// How far a field is off a contact, in standard deviations of its position and of its normal.
struct Miss {
    off: f64,
    tilt: f64,
}

impl Miss {
    fn of(data: &Normalised, levels: &Levels, i: usize, value: f64, gradient: &Vec3) -> Self {
        let length = gradient.norm();
        let sigma = levels.position_sigma * data.relative_sigma[i];
        Self {
            off: value.abs() / (length * sigma),
            tilt: (gradient / length - data.normals[i]).norm() / levels.normal_sigma,
        }
    }

    /// Whether it is more than these bounds, or no number.
    fn is_more_than(&self, [off, tilt]: [f64; 2]) -> bool {
        !(self.off <= off && self.tilt <= tilt)
    }
}

/// Whether many of the neighbours that face the same way cannot lie on one smooth sheet with contact `i`.
fn doubtful(data: &Normalised, tree: &Neighbourhoods, i: usize) -> bool {
    let (mut asked, mut sharing) = (0, 0);
    for (j, _) in tree.nearest(&data.positions[i], ASKED + 1) {
        if j != i && data.normals[i].dot(&data.normals[j]) > OPPOSITE {
            asked += 1;
            sharing += usize::from(shares_a_sheet(data, i, j));
        }
    }
    4 * sharing < 3 * asked
}

/// The contacts around contact `i` that can tell what is to be expected there.
fn witnesses(
    data: &Normalised,
    tree: &Neighbourhoods,
    i: usize,
    witness: impl Fn(usize) -> bool,
) -> Option<Cover> {
    let centre = data.positions[i];
    let all: Vec<(usize, f64)> = (tree.nearest(&centre, 4 * WITNESSES).into_iter())
        .filter(|(j, _)| *j != i && witness(*j))
        .collect();
    // Beside a crease those of its own side.
    let mut near: Vec<(usize, f64)> = (all.iter().copied())
        .filter(|(j, _)| shares_a_sheet(data, i, *j))
        .collect();
    if near.len() < WITNESSES {
        near = all;
    }
    near.truncate(WITNESSES);
    let farthest = near.get(WITNESSES - 1)?.1;
    Some(Cover {
        centre,
        radius: farthest.sqrt(),
        members: near.iter().map(|(j, _)| *j as u32).collect(),
    })
}

/// Whether the field through the others around contact `i` foretells it. A false contact that stands alone draws a
/// smooth field to itself, which then misses it by little.
fn foretold(data: &Normalised, levels: &Levels, i: usize, others: &Ball) -> bool {
    let (value, gradient) = others.value_and_gradient(&data.positions[i]);
    let sigma = TRUST * others.radius * others.fit.centre_variance.sqrt();
    let spread = |own: f64, sigma: f64| (sigma / own).hypot(1.0);
    let off = spread(levels.position_sigma * data.relative_sigma[i], sigma);
    let tilt = spread(levels.normal_sigma, 2.0 * sigma / others.radius);
    !Miss::of(data, levels, i, value, &gradient)
        .is_more_than([off, tilt].map(|spread| SURPRISE * spread))
}

/// Whether enough neighbours have the same normal and tangent plane up to the noise.
fn confirmed(data: &Normalised, tree: &Neighbourhoods, levels: &Levels, i: usize) -> bool {
    let confirming = tree
        .nearest(&data.positions[i], ASKED + 1)
        .into_iter()
        .filter(|&(j, d2)| {
            if j == i {
                return false;
            }
            let d = data.positions[j] - data.positions[i];
            let turn = (data.normals[i] - data.normals[j]).norm();
            let height = (0.5 * d.dot(&(data.normals[i] + data.normals[j]))).abs();
            let tilt = DEVIATIONS * levels.normal_sigma;
            turn <= tilt.max(CURVED)
                && height <= DEVIATIONS * levels.position_sigma + tilt.max(BENT) * d2.sqrt()
        })
        .count();
    confirming >= NEEDED
}

fn keep_if_few(found: Vec<bool>) -> Vec<bool> {
    let count = found.iter().filter(|&&f| f).count();
    if count as f64 > MOST * found.len() as f64 {
        vec![false; found.len()]
    } else {
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_neighbours_on_a_bend_confirm_one_another_and_no_contact_off_it() {
        // A ball of radius 0.15, a contact every 0.024: normals turn by 0.16 from one to the next.
        let count = 500;
        let normals: Vec<Vec3> = (0..count)
            .map(|k| {
                let z = 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(count);
                let (sin, cos) = (2.399_963 * f64::from(k)).sin_cos();
                let flat = (1.0 - z * z).sqrt();
                Vec3::new(flat * cos, flat * sin, z)
            })
            .collect();
        let mut positions: Vec<Vec3> = normals.iter().map(|n| n * 0.15).collect();
        let moved = 250;
        positions[moved] *= 1.1;
        let count = positions.len();
        let data = Normalised {
            normals,
            relative_sigma: vec![1.0; count],
            relative_tilt: vec![1.0; count],
            source: (0..count).collect(),
            positions,
        };
        let tree = Neighbourhoods::new(data.positions.clone());
        let exact = Levels {
            position_sigma: LEAST_POSITION_SIGMA,
            normal_sigma: LEAST_NORMAL_SIGMA,
            tau2: 1.0,
        };
        for i in 0..count {
            assert_eq!(
                confirmed(&data, &tree, &exact, i),
                i != moved,
                "contact {i}"
            );
        }
    }
}
