//! Nearly continuous curvature: the jump of curvature across smooth edges as linear residuals of a fit.
//!
//! On both sides of an edge with a common tangent plane the second fundamental form along the edge agrees by
//! itself, and so does its mixed entry; what is left is its entry across. With e the direction across in one patch
//! and a d + b t the same tangent vector in the other (d across, t along the edge),
//!
//! ```text
//! jump = n . (S_ee - a^2 S'_dd - 2 a b S'_dt - b^2 S'_tt)
//! ```
//!
//! is the jump of normal curvature times the squared length of e: zero exactly where curvature is continuous,
//! whatever the parameters do within the tangent plane. It is linear in the control points for given n, a and b; those are
//! taken from the round before (a and b hardly change: the G1 equations fix them but for the shape of the edge).
//!
//! Two ways were weighed: the jump of the whole second derivatives by the parameters, which the smoothing has already
//! (linear at once, but it also hinders patches of different size and shape from agreeing, and with weight it
//! costs accuracy), and this one. This one was taken.

use crate::Vec3;
use crate::spline::bernstein::{CONTROL_POINTS, DerivativeMatrix, Direction};
use crate::spline::combine;
use crate::spline::energy::{across, add_side, place_on};
use crate::spline::network::Network;
use std::sync::LazyLock;

/// Places along an edge: the jump is a polynomial of degree 10 at most.
const PLACES: usize = 5;

/// The jump at one place: normal . sum of weight * control point, a length.
pub struct Jump {
    /// Control points and their weights.
    pub terms: Vec<(u32, f64)>,
    /// Unit normal there.
    pub normal: Vec3,
}

/// Weights of a patch's control points at one place of one of its edges.
struct Place {
    across: [f64; CONTROL_POINTS],
    along: [f64; CONTROL_POINTS],
    /// Across across, across along, along along.
    second: [[f64; CONTROL_POINTS]; 3],
}

/// Places of the three edges, each seen from its corner with the edge's number.
static EDGES: LazyLock<[[Place; PLACES]; 3]> = LazyLock::new(|| {
    [0, 1, 2].map(|edge: usize| {
        let across = across(edge);
        let mut along: Direction = [0.0; 3];
        along[edge] = -1.0;
        along[(edge + 1) % 3] = 1.0;
        let matrices = [
            DerivativeMatrix::along(&[across]),
            DerivativeMatrix::along(&[along]),
            DerivativeMatrix::along(&[across, across]),
            DerivativeMatrix::along(&[across, along]),
            DerivativeMatrix::along(&[along, along]),
        ];
        std::array::from_fn(|place| {
            let at = place_on(edge, place, PLACES);
            let [across, along, second @ ..] = matrices.each_ref().map(|m| m.weights(at));
            Place {
                across,
                along,
                second,
            }
        })
    })
});

/// The jumps over all smooth edges, `PLACES` an edge, scaled so that the squares of an edge's sum to their mean times
/// the mean of its patches' `scales` (weights of squares of second derivatives, which make small and large patches alike:
/// without them large patches are held from following the shape, three lobes of 28 patches by a tenth). Places without
/// a tangent plane are left out.
pub fn jumps(network: &Network, points: &[Vec3], scales: &[f64]) -> Vec<Jump> {
    let patches = network.patches(points);
    let mut out = Vec::new();
    for (edge, smooth) in network.table.edges.iter().zip(&network.smooth) {
        let (Some(sides), true) = (edge.both(), *smooth) else {
            continue;
        };
        for place in 0..PLACES {
            let locals = sides.map(|s| usize::from(s.local));
            let here = &EDGES[locals[0]][place];
            let there = &EDGES[locals[1]][PLACES - 1 - place];
            let (mine, theirs) = (
                &patches[sides[0].face as usize],
                &patches[sides[1].face as usize],
            );
            let e = combine(mine, &here.across);
            let (d, t) = (
                combine(theirs, &there.across),
                combine(theirs, &there.along),
            );
            let Some(normal) = t.cross(&d).try_normalize(0.0) else {
                continue;
            };
            // e = a d + b t in the tangent plane.
            let area = normal.dot(&t.cross(&d));
            let a = normal.dot(&t.cross(&e)) / area;
            let b = normal.dot(&e.cross(&d)) / area;
            if !(a.is_finite() && b.is_finite() && a < 0.0) {
                continue;
            }
            let of = |side: usize| scales[sides[side].face as usize];
            let scale = (0.5 * (of(0) + of(1)) / PLACES as f64).sqrt();
            let mut terms: Vec<(u32, f64)> = Vec::with_capacity(24);
            let parts = [
                (sides[0], [1.0, 0.0, 0.0], &here.second),
                (sides[1], [-a * a, -2.0 * a * b, -b * b], &there.second),
            ];
            for (side, shares, second) in parts {
                add_side(&mut terms, network, &side, |slot| {
                    scale * (0..3).map(|m| shares[m] * second[m][slot]).sum::<f64>()
                });
            }
            out.push(Jump { terms, normal });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;
    use crate::spline::Surface;

    fn square(surface: &Surface) -> f64 {
        let network = Network::new(&surface.vertices, &surface.faces, &[], &[]).unwrap();
        let mut points = vec![Vec3::zeros(); network.point_count];
        for (numbers, patch) in network.numbers.iter().zip(&surface.control_points) {
            for (number, point) in numbers.iter().zip(patch) {
                points[*number as usize] = *point;
            }
        }
        let jumps = jumps(&network, &points, &vec![1.0; network.faces.len()]);
        assert!(!jumps.is_empty());
        jumps
            .iter()
            .map(|jump| {
                let sum: Vec3 = jump
                    .terms
                    .iter()
                    .map(|(n, w)| points[*n as usize] * *w)
                    .sum();
                sum.dot(&jump.normal).powi(2)
            })
            .sum()
    }

    #[test]
    fn a_surface_of_continuous_curvature_has_no_jump_whatever_its_parameters() {
        // One quadratic graph, its triangles of different shapes: second derivatives jump, curvature does not.
        let smooth = shapes::sheet();
        assert!(square(&smooth) < 1e-24, "{}", square(&smooth));
        let mut bent = smooth.clone();
        bent.control_points[0][12] += Vec3::z() * 0.1;
        assert!(square(&bent) > 1e-4);
    }
}
