//! Numbers over a sampled surface, for maps: curvature, and how far the contacts lie from it.

use super::stages::{Foot, quantile};
use crate::Vec3;
use crate::cloud::{Neighbourhoods, OrientedPoint};
use crate::spline::{SampledSurface, Surface};
use rayon::prelude::*;

/// Contacts whose distances make the error at a place.
const CONTACTS: usize = 4;
/// Places farther from their nearest contact than so many times the median have no error of their own. Tracks with
/// gaps of two spacings between them are still joined at 4.
const FAR: f64 = 4.0;

/// Mean and Gaussian curvature per sampled point; NaN where the surface is not regular.
///
/// Curvature jumps at the edges between patches whose tangent planes alone agree. A point on an edge takes the mean of
/// all patches that use it there, so a map drawn through the points is even on both sides, and does not show which patch
/// the point was sampled from.
pub fn curvatures(surface: &Surface, sampled: &SampledSurface) -> Vec<[f64; 2]> {
    let mut users: Vec<Vec<u32>> = vec![Vec::new(); sampled.positions.len()];
    for (triangle, patch) in sampled.triangles.iter().zip(&sampled.patches) {
        for corner in triangle {
            let patches = &mut users[*corner as usize];
            if !patches.contains(patch) {
                patches.push(*patch);
            }
        }
    }
    sampled
        .parameters
        .par_iter()
        .zip(&users)
        .map(|((patch, at), users)| {
            let mut sum = [0.0; 2];
            let mut count = 0.0;
            for user in users {
                let inside = parameters_in(surface, *patch as usize, *at, *user as usize);
                let found = inside.and_then(|at| surface.curvature(*user as usize, at));
                if let Some(found) = found {
                    sum = [sum[0] + found[0], sum[1] + found[1]];
                    count += 1.0;
                }
            }
            sum.map(|x| x / count)
        })
        .collect()
}

/// Barycentric coordinates in patch `to` of the point `at` of patch `from`; `None` if it is not on a shared edge.
fn parameters_in(surface: &Surface, from: usize, at: [f64; 3], to: usize) -> Option<[f64; 3]> {
    if from == to {
        return Some(at);
    }
    let mut out = [0.0; 3];
    for (vertex, share) in surface.faces[from].iter().zip(at) {
        if share != 0.0 {
            let corner = surface.faces[to].iter().position(|v| v == vertex)?;
            out[corner] = share;
        }
    }
    Some(out)
}

/// Mean distance from the surface of the four contacts nearest to each sampled point; NaN where none is near.
pub fn contact_errors(
    sampled: &SampledSurface,
    points: &[OrientedPoint],
    feet: &[Foot],
) -> Vec<f64> {
    let (places, distances): (Vec<Vec3>, Vec<f64>) = points
        .iter()
        .zip(feet)
        .filter(|(_, foot)| foot.distance.is_finite())
        .map(|(point, foot)| (point.position, foot.distance))
        .unzip();
    let tree = Neighbourhoods::new(places);
    let found: Vec<(f64, f64)> = sampled
        .positions
        .par_iter()
        .map(|at| {
            let near = tree.nearest(at, CONTACTS);
            let sum: f64 = near.iter().map(|(contact, _)| distances[*contact]).sum();
            let away = near.first().map_or(f64::NAN, |(contact, _)| {
                (tree.positions()[*contact] - at).norm()
            });
            (sum / near.len() as f64, away)
        })
        .collect();
    let aways: Vec<f64> = found.iter().map(|(_, away)| *away).collect();
    let far = FAR * quantile(&aways, 0.5);
    found
        .into_iter()
        .map(|(error, away)| if away <= far { error } else { f64::NAN })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::stages::feet_on_surface;
    use super::super::stages::tests::faceted_ball;
    use super::*;

    #[test]
    fn a_point_on_an_edge_is_found_in_every_patch_that_has_it() {
        let (_, _, surface) = faceted_ball();
        let sampled = surface.sample_per_patch(4).unwrap();
        let mut shared = 0;
        for (triangle, patch) in sampled.triangles.iter().zip(&sampled.patches) {
            for corner in triangle {
                let (from, at) = sampled.parameters[*corner as usize];
                let at = parameters_in(&surface, from as usize, at, *patch as usize).unwrap();
                let again = surface.point(*patch as usize, at);
                let there = sampled.positions[*corner as usize];
                assert!((again - there).norm() < 1e-12);
                shared += usize::from(from != *patch);
            }
        }
        assert!(shared > 100);
        // Flat patches.
        assert!(
            curvatures(&surface, &sampled)
                .iter()
                .all(|c| c[0].abs() < 1e-9)
        );
    }

    #[test]
    fn errors_are_those_of_the_contacts_around_and_none_far_from_all() {
        let (cloud, _, surface) = faceted_ball();
        let sampled = surface.sample_per_patch(4).unwrap();
        // A contact over every sampled point, but nothing touched above.
        let points: Vec<OrientedPoint> = sampled
            .positions
            .iter()
            .filter(|p| p.z < 0.4)
            .map(|p| OrientedPoint {
                position: p * 1.01,
                normal: p.normalize(),
                ..cloud.points[0]
            })
            .collect();
        let feet = feet_on_surface(&sampled, &points);
        let errors = contact_errors(&sampled, &points, &feet);
        for (at, error) in sampled.positions.iter().zip(errors) {
            assert!(at.z > 0.3 || (error > 0.001 && error < 0.03), "{error}");
            assert!(at.z < 0.6 || error.is_nan(), "{error}");
        }
    }
}
