//! The contacts in normalised coordinates: checked, moved to a box of diagonal 1 around the origin.

use super::{ExtractError, LEAST_CONTACTS, smoothing::median};
use crate::{Vec3, cloud::Cloud};

/// The way from input coordinates to normalised ones and back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub origin: Vec3,
    pub scale: f64,
}

impl Frame {
    pub(super) fn inward(&self, x: &Vec3) -> Vec3 {
        (x - self.origin) / self.scale
    }

    pub(super) fn outward(&self, x: &Vec3) -> Vec3 {
        x * self.scale + self.origin
    }
}

/// Contacts in normalised coordinates.
#[derive(Clone, Debug)]
pub(super) struct Normalised {
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Standard deviation of each position against the typical one.
    pub relative_sigma: Vec<f64>,
    /// Standard deviation of each normal against the typical one.
    pub relative_tilt: Vec<f64>,
    /// Index of each contact in the cloud.
    pub source: Vec<usize>,
}

impl Normalised {
    /// Those contacts that are not marked in `without`.
    pub(super) fn without(&self, without: &[bool]) -> Self {
        let kept: Vec<usize> = (0..self.positions.len()).filter(|&i| !without[i]).collect();
        Self {
            positions: kept.iter().map(|&i| self.positions[i]).collect(),
            normals: kept.iter().map(|&i| self.normals[i]).collect(),
            relative_sigma: kept.iter().map(|&i| self.relative_sigma[i]).collect(),
            relative_tilt: kept.iter().map(|&i| self.relative_tilt[i]).collect(),
            source: kept.iter().map(|&i| self.source[i]).collect(),
        }
    }
}

/// Checks the contacts and moves them to a box of diagonal 1 around the origin.
pub(super) fn normalise(cloud: &Cloud) -> Result<(Frame, Normalised), ExtractError> {
    let found = cloud.points.len();
    if found < LEAST_CONTACTS {
        return Err(ExtractError::TooFewContacts { found });
    }
    for (index, p) in cloud.points.iter().enumerate() {
        let length = p.normal.norm();
        let fine = p.position.iter().all(|x| x.abs() < 1e150)
            && length.is_finite()
            && length > 0.0
            && p.sigma.is_none_or(|s| s.is_finite() && s >= 0.0);
        if !fine {
            return Err(ExtractError::NotFinite { index });
        }
    }
    let (low, high) = cloud
        .bounding_box()
        .ok_or(ExtractError::TooFewContacts { found: 0 })?;
    let scale = (high - low).norm();
    if scale < 1e-140 || scale <= 1e-12 * low.abs().sup(&high.abs()).max() {
        return Err(ExtractError::NoExtent { what: "point" });
    }
    let frame = Frame {
        origin: low + (high - low) / 2.0,
        scale,
    };
    let positions: Vec<Vec3> = cloud
        .points
        .iter()
        .map(|p| frame.inward(&p.position))
        .collect();
    if on_a_line(&positions) {
        return Err(ExtractError::NoExtent { what: "line" });
    }
    let mut stated: Vec<f64> = cloud
        .points
        .iter()
        .filter_map(|p| p.sigma)
        .filter(|&s| s > 0.0)
        .collect();
    let typical = median(&mut stated);
    let relative_sigma = cloud
        .points
        .iter()
        .map(|p| match (p.sigma, typical) {
            (Some(s), Some(t)) => (s / t).clamp(0.05, 20.0),
            _ => 1.0,
        })
        .collect();
    Ok((
        frame,
        Normalised {
            positions,
            normals: cloud.points.iter().map(|p| p.normal.normalize()).collect(),
            relative_sigma,
            relative_tilt: vec![1.0; found],
            source: (0..found).collect(),
        },
    ))
}

/// Share of the extent within which points are taken to lie on one line: twice what the grid moves them that they come
/// on ([`crate::reconstruct::frame`]).
const ON_A_LINE: f64 = 2e-5;

/// Whether all points lie on one line.
fn on_a_line(positions: &[Vec3]) -> bool {
    let first = positions[0];
    let axis = positions
        .iter()
        .map(|p| p - first)
        .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
        .unwrap_or_default();
    let length = axis.norm();
    positions
        .iter()
        .all(|p| axis.cross(&(p - first)).norm() <= ON_A_LINE * length * length.max(1e-6))
}
