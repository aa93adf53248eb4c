//! Contacts that repeat one another exactly are counted once.
//!
//! The same position, normal and sigma to the last bit is the same row read twice (a file joined with itself, a finger
//! that was logged while it stood still), not two measurements. A million of them would say nothing new, and every
//! neighbourhood would consist of them.

use crate::cloud::{Cloud, OrientedPoint};
use std::collections::HashMap;

/// A cloud without repeats.
pub(super) struct Distinct {
    /// The first of each.
    pub cloud: Cloud,
    /// For each contact of the whole cloud the index in `cloud` of the one it repeats, or is.
    pub first: Vec<u32>,
}

/// Leaves out contacts that repeat an earlier one; `None` where none does.
pub(super) fn without(cloud: &Cloud) -> Option<Distinct> {
    let key = |p: &OrientedPoint| {
        let sigma = p.sigma.map(f64::to_bits);
        let bits = |v: &crate::Vec3| [v.x, v.y, v.z].map(|c| (c + 0.0).to_bits());
        (bits(&p.position), bits(&p.normal), sigma)
    };
    let mut seen = HashMap::with_capacity(cloud.points.len());
    let mut distinct = Cloud::default();
    let first = cloud
        .points
        .iter()
        .map(|point| {
            *seen.entry(key(point)).or_insert_with(|| {
                distinct.points.push(*point);
                distinct.points.len() as u32 - 1
            })
        })
        .collect();
    (distinct.points.len() < cloud.points.len()).then_some(Distinct {
        cloud: distinct,
        first,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;

    #[test]
    fn the_first_of_each_stays() {
        let point = |x: f64| OrientedPoint {
            position: Vec3::new(x, 0.0, 0.0),
            normal: Vec3::z(),
            sigma: None,
            finger: None,
            time_us: None,
        };
        let cloud = |xs: &[f64]| Cloud {
            points: xs.iter().map(|x| point(*x)).collect(),
            rejected: Vec::new(),
        };
        let distinct = without(&cloud(&[3.0, 0.0, 3.0, 1.0, -0.0, 3.0])).unwrap();
        assert_eq!(distinct.cloud, cloud(&[3.0, 0.0, 1.0]));
        assert_eq!(distinct.first, [0, 1, 0, 2, 1, 0]);
        assert!(without(&cloud(&[3.0, 0.0, 1.0])).is_none());
    }
}
