//! Points with normals as a reference: distance to the surface they were taken from, without knowing it.

use crate::Vec3;
use crate::cloud::{Cloud, Neighbourhoods};
use nalgebra::Matrix3;

/// Neighbours that state how the normal turns around a point.
const NEIGHBOURS: usize = 12;

/// Points with normals, ready for distance queries.
#[derive(Clone, Debug)]
pub struct PointSet {
    tree: Neighbourhoods,
    normals: Vec<Vec3>,
}

impl PointSet {
    /// Takes the points of a cloud.
    pub fn new(cloud: &Cloud) -> Self {
        let positions = cloud.points.iter().map(|p| p.position).collect();
        let normals = cloud.points.iter().map(|p| p.normal).collect();
        Self {
            tree: Neighbourhoods::new(positions),
            normals,
        }
    }

    /// Positions and normals.
    pub fn points(&self) -> impl Iterator<Item = (Vec3, Vec3)> + '_ {
        self.tree
            .positions()
            .iter()
            .copied()
            .zip(self.normals.iter().copied())
    }

    /// Estimated distance of `query` from the sampled surface and the normal of the nearest point; `None`
    /// without points.
    ///
    /// With p the nearest point and n its normal, a linear fit to the neighbours' normals gives the normal n'
    /// below the query; a surface of constant curvature between both places is then
    /// |(query - p) . (n + n')| / |n + n'| away, which is exact for spheres and planes. Where the query lies beyond the
    /// neighbours (past a rim), the distance to the nearest point itself is taken, and never more than that.
    pub fn distance(&self, query: &Vec3) -> Option<(f64, Vec3)> {
        let near = self.tree.nearest(query, NEIGHBOURS);
        let (first, squared) = *near.first()?;
        let point = self.tree.positions()[first];
        let normal = self.normals[first];
        let straight = squared.sqrt();
        let offsets: Vec<(Vec3, Vec3)> = near
            .iter()
            .map(|(k, _)| (self.tree.positions()[*k] - point, self.normals[*k] - normal))
            .collect();
        let reach = offsets.iter().map(|(x, _)| x.norm()).fold(0.0, f64::max);
        let mean = offsets.iter().map(|(x, _)| x.norm()).sum::<f64>() / offsets.len() as f64;
        if reach == 0.0 {
            return Some((straight, normal));
        }
        let mut square = Matrix3::zeros();
        let mut mixed = Matrix3::zeros();
        for (offset, turn) in &offsets {
            // Neighbours that face elsewhere lie on another sheet or across a crease.
            if (normal + turn).dot(&normal) <= 0.85 {
                continue;
            }
            let weight = 1.0 / (1.0 + offset.norm_squared() / (mean * mean));
            square += offset * offset.transpose() * weight;
            mixed += offset * turn.transpose() * weight;
        }
        square += Matrix3::identity() * (1e-6 * square.trace() + 1e-18 * reach * reach);
        let way = query - point;
        let tangential = way - normal * way.dot(&normal);
        if tangential.norm() > reach {
            return Some((straight, normal));
        }
        let turned = square.cholesky().map_or(normal, |factor| {
            let slope = factor.solve(&mixed);
            normal + slope.transpose() * tangential
        });
        let middle = (normal + turned).try_normalize(0.0).unwrap_or(normal);
        Some((way.dot(&middle).abs().min(straight), normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{OrientedPoint, unit_ball};

    fn sphere(count: usize) -> PointSet {
        PointSet::new(&unit_ball(count))
    }

    #[test]
    fn gaps_between_points_are_bridged() {
        let set = sphere(2000);
        for k in 0..300 {
            let t = f64::from(k);
            let direction = Vec3::new(t.sin(), (1.7 * t).cos(), (0.9 * t).sin() + 0.1).normalize();
            for height in [-0.02, 0.0, 0.01] {
                let (distance, _) = set.distance(&(direction * (1.0 + height))).unwrap();
                // Points are 0.08 apart: the nearest alone would be off by up to 0.05, its tangent
                // plane by 1e-3.
                assert!(
                    (distance - f64::abs(height)).abs() < 5e-5,
                    "{distance} {height}"
                );
            }
        }
    }

    #[test]
    fn beyond_a_rim_the_nearest_point_counts() {
        let mut cloud = Cloud::default();
        for k in 0..100 {
            cloud.points.push(OrientedPoint {
                position: Vec3::new(f64::from(k % 10), f64::from(k / 10), 0.0),
                normal: Vec3::z(),
                sigma: None,
                finger: None,
                time_us: None,
            });
        }
        let set = PointSet::new(&cloud);
        let (distance, normal) = set.distance(&Vec3::new(29.0, 4.0, 0.0)).unwrap();
        assert_eq!((distance, normal), (20.0, Vec3::z()));
        assert!(
            PointSet::new(&Cloud::default())
                .distance(&Vec3::zeros())
                .is_none()
        );
    }
}
