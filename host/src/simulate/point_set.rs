//! Pure point sets: what a finger's tracks over an object yield, without boards, lines and joints.
//!
//! For tests and benchmarks that need so many points of a known shape with known noise. The tracks are those
//! of the simulated fingers (one finger with no limit of reach), the points sit only where the tip can touch.

use super::itinerary::{Leg, tour};
use super::object::Object;
use super::touch::Placement;
use super::track::Track;
use super::waypoints::Waypoints;
use crate::Vec3;
use crate::cloud::{Cloud, OrientedPoint};
use nalgebra::{Rotation3, Unit};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

use super::noise::normal_deviate;

/// What point set to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointSet {
    /// Points to make; of each copy if there are copies.
    pub count: usize,
    /// Copies by rotation about the z axis: with 3, a third of the object is touched and the points are
    /// repeated by two rigid transformations, as in the paper's second case. 0 and 1 both mean none.
    pub copies: usize,
    /// Length of the longest side of the object's bounding box in the result; `None` leaves millimetres.
    pub longest_side: Option<f64>,
    /// Standard deviation of the positions per axis, in the unit of the result.
    pub position_noise: f64,
    /// Root mean square angle by which normals are turned, degrees.
    pub normal_noise_degrees: f64,
    /// Radius of the tip, millimetres on the object's own size.
    pub tip_radius_mm: f64,
    /// Everything random follows from it.
    pub seed: u64,
}

impl Default for PointSet {
    fn default() -> Self {
        Self {
            count: 1229,
            copies: 1,
            longest_side: None,
            position_noise: 0.0,
            normal_noise_degrees: 0.0,
            tip_radius_mm: 20.0,
            seed: 1,
        }
    }
}

impl PointSet {
    /// Makes the points, in the order in which the finger would touch them; exactly `count` per copy, none if
    /// the tip can touch nowhere.
    pub fn points(&self, object: &Object) -> Cloud {
        let copies = self.copies.max(1);
        let half_sector = PI / copies as f64;
        let in_sector = |p: &Placement| {
            let at = p.foot.position_mm;
            copies == 1 || at.y.atan2(at.x).abs() <= half_sector
        };
        // As far apart along a track as across: about two points per waypoint.
        let places = (self.count * copies / 2).clamp(60, 6000);
        let waypoints = Waypoints::spread(object, self.tip_radius_mm, places, self.seed);
        let visit: Vec<usize> = (0..waypoints.placements.len())
            .filter(|&k| in_sector(&waypoints.placements[k]))
            .collect();
        let tracks: Vec<Track> = tour(
            object,
            &waypoints,
            self.tip_radius_mm,
            &visit,
            &Vec3::new(0.0, 0.0, 1e3),
            &in_sector,
            &|_| true,
        )
        .into_iter()
        .filter_map(|leg| match leg {
            Leg::Slide(path) => Some(Track::new(path)),
            Leg::Flight(_) | Leg::Swing(_) => None,
        })
        .collect();

        let (low, high) = object
            .truth_mesh()
            .bounding_box()
            .unwrap_or((Vec3::zeros(), Vec3::zeros()));
        let scale = self
            .longest_side
            .map_or(1.0, |side| side / (high - low).max());
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let touched: Vec<(Vec3, Vec3)> = self
            .spread_over(object, &tracks)
            .into_iter()
            .map(|p| {
                let noise = Vec3::from_fn(|_, _| normal_deviate(&mut random));
                let position = p.foot.position_mm * scale + noise * self.position_noise;
                (position, self.turned(p.foot.normal, &mut random))
            })
            .collect();
        let points = (0..copies)
            .flat_map(|copy| {
                let turn =
                    Rotation3::from_axis_angle(&Vec3::z_axis(), TAU * copy as f64 / copies as f64);
                touched.iter().map(move |(position, normal)| OrientedPoint {
                    position: turn * position,
                    normal: turn * normal,
                    sigma: None,
                    finger: None,
                    time_us: None,
                })
            })
            .collect();
        Cloud {
            points,
            rejected: Vec::new(),
        }
    }

    /// `count` placements at equal distances along all tracks taken together.
    fn spread_over(&self, object: &Object, tracks: &[Track]) -> Vec<Placement> {
        // A track of a single touch still deserves a point: each is taken a little longer than it is.
        let total: f64 = tracks.iter().map(Track::length_mm).sum();
        let spare = 0.5 * total / self.count.max(1) as f64;
        let spare = if total > 0.0 { spare } else { 1.0 };
        let step = (total + spare * tracks.len() as f64) / self.count.max(1) as f64;
        let mut placements = Vec::with_capacity(self.count);
        let mut before = 0.0;
        for track in tracks {
            let length = track.length_mm() + spare;
            while placements.len() < self.count {
                let along = (placements.len() as f64 + 0.5) * step - before;
                if along > length {
                    break;
                }
                match track.at(object, along - 0.5 * spare, self.tip_radius_mm) {
                    Some(placement) => placements.push(placement),
                    None => break,
                }
            }
            before += length;
        }
        placements
    }

    /// A normal turned about a random axis across it, by an angle with the noise's root mean square.
    fn turned(&self, normal: Vec3, random: &mut ChaCha8Rng) -> Vec3 {
        let sigma = self.normal_noise_degrees.to_radians() / 2f64.sqrt();
        let raw = Vec3::from_fn(|_, _| normal_deviate(random));
        let across = (raw - normal * raw.dot(&normal)) * sigma;
        match Unit::try_new(normal.cross(&across), 1e-12) {
            Some(axis) => Rotation3::from_axis_angle(&axis, across.norm()) * normal,
            None => normal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exactly_so_many_points_of_the_surface() {
        let object = Object::named("torus").unwrap();
        let set = PointSet {
            count: 333,
            ..PointSet::default()
        };
        let cloud = set.points(&object);
        assert_eq!(cloud.points.len(), 333);
        for point in &cloud.points {
            let foot = object.foot(&point.position);
            assert!(foot.distance_mm.abs() < 1e-5);
            assert!((foot.normal - point.normal).norm() < 1e-6);
        }
        assert_eq!(cloud, set.points(&object));
        let other = PointSet { seed: 2, ..set };
        assert_ne!(cloud, other.points(&object));
    }

    #[test]
    fn noise_has_the_size_asked_for() {
        let object = Object::named("sphere").unwrap();
        let set = PointSet {
            count: 2000,
            longest_side: Some(2.0),
            position_noise: 0.005,
            normal_noise_degrees: 3.0,
            ..PointSet::default()
        };
        let cloud = set.points(&object);
        let n = cloud.points.len() as f64;
        let radial = |p: &OrientedPoint| p.position.norm() - 1.0;
        let rms = (cloud.points.iter().map(|p| radial(p).powi(2)).sum::<f64>() / n).sqrt();
        assert!((rms - 0.005).abs() < 4e-4, "{rms}");
        let angle = |p: &OrientedPoint| p.normal.angle(&p.position).to_degrees();
        let turned = (cloud.points.iter().map(|p| angle(p).powi(2)).sum::<f64>() / n).sqrt();
        assert!((turned - 3.0).abs() < 0.2, "{turned}");
    }

    #[test]
    fn a_third_is_repeated_by_two_rotations() {
        let object = Object::named("trilobe").unwrap();
        let set = PointSet {
            count: 374,
            copies: 3,
            longest_side: Some(1.0),
            ..PointSet::default()
        };
        let cloud = set.points(&object);
        assert_eq!(cloud.points.len(), 3 * 374);
        let third = Rotation3::from_axis_angle(&Vec3::z_axis(), TAU / 3.0);
        for k in 0..374 {
            let angle = cloud.points[k].position.y.atan2(cloud.points[k].position.x);
            assert!(angle.abs() <= PI / 3.0 + 1e-9);
            assert!(
                (third * cloud.points[k].position - cloud.points[374 + k].position).norm() < 1e-12
            );
        }
        let (low, high) = cloud.bounding_box().unwrap();
        assert!(((high - low).max() - 1.0).abs() < 0.03);
    }
}
