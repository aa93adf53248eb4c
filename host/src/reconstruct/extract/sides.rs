//! Inside or outside where the contacts leave no doubt.
//!
//! Away from the contacts a field may turn over: inside a thick wall, in a tube, behind the end of a sheet it can cross
//! zero without any surface there, and such phantoms hang on the surface by pinholes. But a place that the nearest contact
//! sees straight behind it lies inside, and straight before it outside, if no other contact around sees it otherwise. There the
//! distance to the nearest tangent plane (the paper's field) takes the field's place; beside the contacts, in gaps, the
//! field alone decides.
//!
//! Two ways were weighed: to cut phantoms off the mesh afterwards (they share pinholes with the surface, which tear it),
//! and this one, which never makes them.

use crate::{Vec3, cloud::Neighbourhoods};

/// Contacts that are asked at most, and how much farther than the nearest one they may be.
const WITNESSES: usize = 12;
const WITNESS_RATIO: f64 = 1.5;
/// Cosine of the angle between the nearest contact's normal and the way to it from which, and at which, it is straight
/// ahead.
const AHEAD: [f64; 2] = [0.5, 0.8];
/// Distance from the nearest contact, in spacings, from which, and at which, the field is no longer asked.
const AWAY: [f64; 2] = [0.7, 1.4];

/// Distance from the nearest contact, in spacings, beyond which no gap is in doubt (cubes and cylinders with gaps up to 5
/// spacings wide: lower values take the planes of their sides for the surface in the gaps at their edges).
const FAR: f64 = 3.5;

/// What contacts say about inside and outside, in normalised coordinates.
#[derive(Clone, Copy)]
pub(super) struct Sides<'a> {
    /// The contacts' normals.
    pub normals: &'a [Vec3],
    /// Their positions.
    pub tree: &'a Neighbourhoods,
    /// Typical distance of neighbouring contacts.
    pub spacing: f64,
}

impl Sides<'_> {
    /// The field's `value` at `x`, or the distance to the nearest tangent plane where the contacts leave no doubt.
    pub(super) fn settle(&self, x: &Vec3, value: f64) -> f64 {
        let near = self.tree.nearest(x, WITNESSES);
        let Some(&(first, d2)) = near.first() else {
            return value;
        };
        let positions = self.tree.positions();
        let height = |j: usize| (x - positions[j]).dot(&self.normals[j]);
        let (distance, plane) = (d2.sqrt(), height(first));
        let ahead = plane.abs() / distance.max(f64::MIN_POSITIVE);
        let weight = ramp(AHEAD, ahead) * ramp(AWAY.map(|a| a * self.spacing), distance);
        if weight == 0.0 {
            return value;
        }
        let unanimous = near
            .iter()
            .take_while(|(_, other)| *other <= WITNESS_RATIO * WITNESS_RATIO * d2)
            .all(|&(j, d2)| {
                // Far outside one that sees the place from beside has nothing to say; near an edge it has.
                let height = height(j);
                let beside = height * height < AHEAD[0] * AHEAD[0] * d2;
                let far_outside = plane > 0.0 && distance > FAR * self.spacing;
                height * plane > 0.0 || (beside && far_outside)
            });
        match (unanimous, value.is_finite()) {
            (true, true) => value + weight * (plane - value),
            (true, false) => plane,
            (false, _) => value,
        }
    }
}

/// 0 below the first bound, 1 above the second, smooth between.
fn ramp([low, high]: [f64; 2], x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn behind_all_contacts_is_inside_and_gaps_are_left_to_the_field() {
        // Two walls, 0.4 apart, that face away from one another, with contacts every 0.1.
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for i in 0..10 {
            for j in 0..10 {
                for side in [-1.0, 1.0] {
                    let (x, y) = (0.1 * f64::from(i), 0.1 * f64::from(j));
                    positions.push(Vec3::new(x, y, 0.2 * side));
                    normals.push(Vec3::z() * side);
                }
            }
        }
        let sides = Sides {
            normals: &normals,
            tree: &Neighbourhoods::new(positions),
            spacing: 0.1,
        };
        assert!(sides.settle(&Vec3::new(0.42, 0.47, 0.01), 0.3) < -0.15);
        assert!(sides.settle(&Vec3::new(0.42, 0.47, 0.5), -0.3) > 0.15);
        // Beside a contact, and near the surface, the field is asked.
        assert_eq!(sides.settle(&Vec3::new(1.2, 0.45, 0.2), 0.3), 0.3);
        assert_eq!(sides.settle(&Vec3::new(0.42, 0.47, 0.18), 0.3), 0.3);
    }
}
