//! Contacts averaged in narrow regions (paper, section 4.1), where a track is so much denser than its neighbours that
//! the contacts around one another lie on a line.
//!
//! A finger that reports every 5 ms and slides slowly leaves contacts 0.1 mm apart on tracks that are millimetres apart.
//! The nearest contacts of a contact then say nothing of the surface across the track. So contacts are averaged in regions
//! that widen until neighbourhoods are as wide as a surface needs. Two ways were weighed: to drop contacts (simpler,
//! but loses what they know together) and to average them (their noise falls, and what they scatter within a region tells
//! the noise of one). Clouds whose neighbourhoods are wide enough are left as they are.

use crate::Vec3;
use crate::cloud::{Cloud, Neighbourhoods, OrientedPoint};
use nalgebra::{Matrix3, SymmetricEigen};

/// Contacts that make a neighbourhood, and of how many of them its shape is taken at most.
const NEIGHBOURS: usize = 60;
const SAMPLES: usize = 400;
/// Second over first principal extent of a neighbourhood: below the first bound contacts lie on a line, above the second
/// they are spread enough. Evenly spread contacts have 0.6 to 0.9, random tracks with gaps 0.4 and more.
const LINE: f64 = 0.2;
const SPREAD: f64 = 0.35;
/// A region is never wider than this share of the cloud's diagonal, nor are fewer averages made than this.
const WIDEST: f64 = 0.02;
const LEAST_AVERAGES: usize = 150;
/// Cosine of the largest angle between normals in one region.
const SAME_SIDE: f64 = 0.9;

/// Averages, and what went into each.
#[derive(Clone, Debug)]
pub struct Averaged {
    /// One point per region.
    pub cloud: Cloud,
    /// Indices of the contacts of each region.
    pub members: Vec<Vec<u32>>,
    /// Standard deviation of one contact about its region's average, along the normal.
    pub position_scatter: f64,
    /// Standard deviation of each component of a normal about its region's average, radians.
    pub normal_scatter: f64,
}

/// Averages `cloud` if its neighbourhoods are lines; `None` if they are wide enough, or nothing helps.
pub fn average(cloud: &Cloud) -> Option<Averaged> {
    let fine = |p: &OrientedPoint| {
        p.position
            .iter()
            .chain(p.normal.iter())
            .all(|x| x.is_finite())
    };
    if cloud.points.len() < 4 * LEAST_AVERAGES || !cloud.points.iter().all(fine) {
        return None;
    }
    let (width, reach) = neighbourhoods(cloud)?;
    if width >= LINE {
        return None;
    }
    // As many contacts as a neighbourhood has lie on `reach` of a line: their distance along it.
    let mut radius = 4.0 * reach / NEIGHBOURS as f64;
    let widest = WIDEST * cloud.diagonal();
    let mut best = None;
    while radius <= widest {
        let averaged = in_regions(cloud, radius);
        if averaged.members.len() < LEAST_AVERAGES {
            break;
        }
        let wide = neighbourhoods(&averaged.cloud).is_some_and(|(w, _)| w >= SPREAD);
        best = Some(averaged);
        if wide {
            break;
        }
        radius *= 1.4;
    }
    best
}

/// Median of the second over the first principal extent of neighbourhoods, and of their radii.
fn neighbourhoods(cloud: &Cloud) -> Option<(f64, f64)> {
    let tree = Neighbourhoods::new(cloud.points.iter().map(|p| p.position).collect());
    let step = cloud.points.len().div_ceil(SAMPLES).max(1);
    let (mut widths, mut radii) = (Vec::new(), Vec::new());
    for p in cloud.points.iter().step_by(step) {
        let near = tree.nearest(&p.position, NEIGHBOURS);
        let count = near.len().max(1) as f64;
        let at = |i: usize| cloud.points[i].position;
        let mean = near.iter().map(|(i, _)| at(*i)).sum::<Vec3>() / count;
        let spread: Matrix3<f64> = near
            .iter()
            .map(|(i, _)| (at(*i) - mean) * (at(*i) - mean).transpose())
            .sum();
        let mut extent: Vec<f64> = SymmetricEigen::new(spread)
            .eigenvalues
            .iter()
            .copied()
            .collect();
        extent.sort_by(|a, b| b.total_cmp(a));
        if extent[0] > 0.0 {
            widths.push((extent[1].max(0.0) / extent[0]).sqrt());
            radii.push(near.last().map_or(0.0, |(_, d2)| d2.sqrt()));
        }
    }
    let middle = |list: &mut Vec<f64>| {
        list.sort_by(f64::total_cmp);
        list.get(list.len() / 2).copied()
    };
    Some((middle(&mut widths)?, middle(&mut radii)?))
}

/// Averages the contacts within `radius` of the first one left, again and again, in their order.
fn in_regions(cloud: &Cloud, radius: f64) -> Averaged {
    let points = &cloud.points;
    let tree = Neighbourhoods::new(points.iter().map(|p| p.position).collect());
    let mut taken = vec![false; points.len()];
    let mut out = Averaged {
        cloud: Cloud::default(),
        members: Vec::new(),
        position_scatter: 0.0,
        normal_scatter: 0.0,
    };
    let (mut heights, mut turns, mut freedom) = (0.0, 0.0, 0.0);
    for first in 0..points.len() {
        if taken[first] {
            continue;
        }
        let mut members: Vec<u32> = tree
            .within(&points[first].position, radius)
            .into_iter()
            .map(|(i, _)| i)
            .filter(|i| {
                let same = points[*i].normal.dot(&points[first].normal) > SAME_SIDE;
                !taken[*i] && (same || *i == first)
            })
            .map(|i| i as u32)
            .collect();
        members.sort_unstable();
        let count = members.len() as f64;
        let member = |i: &u32| &points[*i as usize];
        let position = members.iter().map(|i| member(i).position).sum::<Vec3>() / count;
        let sum: Vec3 = members.iter().map(|i| member(i).normal).sum();
        let normal = sum.try_normalize(0.0).unwrap_or(points[first].normal);
        for i in &members {
            taken[*i as usize] = true;
            heights += (member(i).position - position).dot(&normal).powi(2);
            turns += (member(i).normal - normal).norm_squared();
        }
        freedom += count - 1.0;
        let stated: Option<f64> = members.iter().map(|i| member(i).sigma).sum();
        out.cloud.points.push(OrientedPoint {
            position,
            normal,
            sigma: stated.map(|s| s / count / count.sqrt()),
            ..points[first]
        });
        out.members.push(members);
    }
    let freedom = f64::max(freedom, 1.0);
    out.position_scatter = (heights / freedom).sqrt();
    // A turn has two components.
    out.normal_scatter = (turns / freedom / 2.0).sqrt();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spiral over a ball of radius 20 with turns 5 apart and contacts `step` apart.
    fn spiral(step: f64) -> Cloud {
        let mut cloud = Cloud::default();
        let (mut polar, mut turn) = (0.15_f64, 0.0_f64);
        while polar < 2.9 {
            let n = Vec3::new(
                polar.sin() * turn.cos(),
                polar.sin() * turn.sin(),
                polar.cos(),
            );
            cloud.points.push(OrientedPoint {
                position: 20.0 * n,
                normal: n,
                sigma: None,
                finger: None,
                time_us: None,
            });
            let along = step / (20.0 * polar.sin());
            turn += along;
            polar += 5.0 / 20.0 * along / std::f64::consts::TAU;
        }
        cloud
    }

    #[test]
    fn dense_tracks_are_averaged_until_neighbourhoods_are_wide() {
        let cloud = spiral(0.1);
        let averaged = average(&cloud).unwrap();
        let mut all: Vec<u32> = averaged.members.iter().flatten().copied().collect();
        all.sort_unstable();
        assert!(all.iter().enumerate().all(|(i, m)| i == *m as usize));
        assert_eq!(all.len(), cloud.points.len());
        assert!(neighbourhoods(&cloud).unwrap().0 < LINE);
        assert!(neighbourhoods(&averaged.cloud).unwrap().0 >= SPREAD);
        for p in &averaged.cloud.points {
            assert!((p.position.norm() - 20.0).abs() < 0.02);
        }
        assert!(averaged.position_scatter < 0.02 && averaged.normal_scatter < 0.05);
    }

    #[test]
    fn even_contacts_are_left_alone() {
        assert!(average(&spiral(4.0)).is_none());
        assert!(average(&Cloud::default()).is_none());
    }
}
