//! Volume and area of a surface.
//!
//! Volume: a third of the flux of the position through the patches, polynomials of degree 13, integrated exactly by Gauss
//! and Legendre's rule on the collapsed triangle. Area: the same rule on halves of halves, until two levels agree.

use super::super::bernstein::CONTROL_POINTS;
use super::super::surface::Surface;
use super::patch_jet;
use crate::Vec3;
use rayon::prelude::*;

/// Places and weights of the Gauss-Legendre rule with 8 points on 0 to 1: exact to degree 15 (Abramowitz and
/// Stegun, table 25.4, mapped).
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];
/// Most halvings of a triangle in the area.
const HALVINGS: usize = 6;

impl Surface {
    /// Signed volume inside a closed surface (positive if its normals point outwards), exact up to rounding. Of
    /// an open surface: that of the cone from its bounding box's middle over it.
    pub fn volume(&self) -> f64 {
        let (low, high) = self.bounding_box().unwrap_or_default();
        let middle = (low + high) / 2.0;
        let parts: Vec<f64> = self
            .control_points
            .par_iter()
            .map(|patch| {
                integral(patch, &WHOLE, |point, cross| {
                    (point - middle).dot(&cross) / 3.0
                })
            })
            .collect();
        parts.iter().sum()
    }

    /// Area, each patch to `accuracy` of its own.
    pub fn area(&self, accuracy: f64) -> f64 {
        let parts: Vec<f64> = self
            .control_points
            .par_iter()
            .map(|patch| {
                let whole = integral(patch, &WHOLE, |_, cross| cross.norm());
                area_of(patch, &WHOLE, whole, accuracy * whole, HALVINGS)
            })
            .collect();
        parts.iter().sum()
    }
}

/// Corners of the whole triangle.
const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn area_of(
    patch: &[Vec3; CONTROL_POINTS],
    corners: &[[f64; 3]; 3],
    before: f64,
    allowed: f64,
    halvings: usize,
) -> f64 {
    let between = |i: usize, j: usize| [0, 1, 2].map(|m| 0.5 * (corners[i][m] + corners[j][m]));
    let [ab, bc, ca] = [between(0, 1), between(1, 2), between(2, 0)];
    let parts = [
        [corners[0], ab, ca],
        [ab, corners[1], bc],
        [ca, bc, corners[2]],
        [ab, bc, ca],
    ];
    let areas = parts.map(|part| integral(patch, &part, |_, cross| cross.norm()));
    let sum: f64 = areas.iter().sum();
    if halvings == 0 || (sum - before).abs() <= allowed {
        return sum;
    }
    (0..4)
        .map(|k| area_of(patch, &parts[k], areas[k], allowed / 4.0, halvings - 1))
        .sum()
}

/// Integral of `of(point, S_u x S_v)` over a part of the parameter triangle.
fn integral(
    patch: &[Vec3; CONTROL_POINTS],
    corners: &[[f64; 3]; 3],
    of: impl Fn(Vec3, Vec3) -> f64,
) -> f64 {
    let side = |k: usize| [1, 2].map(|m| corners[k][m] - corners[0][m]);
    let [p, q] = [side(1), side(2)];
    let scale = p[0] * q[1] - p[1] * q[0];
    let places = || {
        GAUSS
            .iter()
            .flat_map(|(x, w)| [(0.5 - 0.5 * x, 0.5 * w), (0.5 + 0.5 * x, 0.5 * w)])
    };
    let mut sum = 0.0;
    for (s, ws) in places() {
        for (t, wt) in places() {
            let at = [0, 1, 2].map(|m| {
                (1.0 - s) * corners[0][m] + s * (1.0 - t) * corners[1][m] + s * t * corners[2][m]
            });
            let jet = patch_jet(patch, at);
            sum += ws * wt * s * of(jet.point, jet.first[0].cross(&jet.first[1]));
        }
    }
    sum * scale
}

#[cfg(test)]
mod tests {
    use crate::export::shapes;

    #[test]
    fn cube_and_finely_sampled_sphere() {
        let cube = shapes::cube();
        assert!((cube.volume() - 1.0).abs() < 1e-14);
        assert!((cube.area(1e-9) - 6.0).abs() < 1e-13);
        // Against triangles: their error falls with the square of their number along an edge.
        let surface = shapes::lumpy_sphere();
        let of_triangles = |segments: usize| {
            let sampled = surface.sample_per_patch(segments).unwrap();
            sampled
                .triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(|v| sampled.positions[v as usize]);
                    [
                        a.dot(&b.cross(&c)) / 6.0,
                        (b - a).cross(&(c - a)).norm() / 2.0,
                    ]
                })
                .fold([0.0; 2], |sum, part| [sum[0] + part[0], sum[1] + part[1]])
        };
        let (coarse, fine) = (of_triangles(12), of_triangles(24));
        let limit = [0, 1].map(|k| fine[k] + (fine[k] - coarse[k]) / 3.0);
        let found = [surface.volume(), surface.area(1e-9)];
        for k in 0..2 {
            let share = (found[k] - limit[k]).abs() / (fine[k] - coarse[k]).abs();
            assert!(share < 0.01, "{found:?} {limit:?} {fine:?} {coarse:?}");
        }
    }
}
