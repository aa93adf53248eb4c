//! Contacts that contradict the others: slips, false touches, flipped normals.
//!
//! Two looks. Before anything is fitted, a contact needs neighbours that could lie on one smooth sheet with it
//! ([`unsupported`]); this finds gross errors, which would spoil any fit around them. Once the field is known, a
//! contact is set aside if the field misses it by many standard deviations *and* no neighbour agrees with it
//! ([`contradicting`]). The second condition keeps the contacts beside creases: there a smooth field misses
//! them all, but each side agrees with itself.

use rayon::prelude::*;

use super::{contacts::Normalised, field::BlendedField, smoothing::Levels};
use crate::cloud::Neighbourhoods;

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

/// Contacts that the field misses by far and no neighbour confirms.
pub(super) fn contradicting(
    data: &Normalised,
    tree: &Neighbourhoods,
    field: &BlendedField,
    levels: &Levels,
) -> Vec<bool> {
    let levels = &Levels {
        position_sigma: levels.position_sigma.max(LEAST_POSITION_SIGMA),
        normal_sigma: levels.normal_sigma.max(LEAST_NORMAL_SIGMA),
        ..*levels
    };
    let found = (0..data.positions.len())
        .into_par_iter()
        .map(|i| {
            let (value, gradient) = field.value_and_gradient(&data.positions[i]);
            let length = gradient.norm();
            let sigma = levels.position_sigma * data.relative_sigma[i];
            let off = value.abs() / (length * sigma);
            let normal = data.normals[i];
            let tilt = (gradient / length - normal).norm() / levels.normal_sigma;
            let fits = off <= DEVIATIONS && tilt <= DEVIATIONS;
            !fits && !confirmed(data, tree, levels, i)
        })
        .collect();
    keep_if_few(found)
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
            turn <= tilt && height <= DEVIATIONS * levels.position_sigma + tilt * d2.sqrt()
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
