//! Where on an object a ball can touch, spread evenly: the places a finger will visit, and how they hang
//! together.

use super::object::Object;
use super::touch::{Placement, place, slide};
use crate::Vec3;
use crate::cloud::Neighbourhoods;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Samples of the surface per waypoint to choose from. With 6, no place of the torus is further
/// than 1.6 spacings from a waypoint (tested); more make planning slower in proportion.
const CANDIDATES: usize = 6;

/// Share of the area that discs of half the spacing cover in the end. Random sequential packing would reach
/// 0.547; six candidates per waypoint leave it at 0.43 (measured on sphere and torus).
const PACKING: f64 = 0.43;

/// Neighbours per waypoint on the road map, by contact point and by centre.
const NEIGHBOURS: usize = 10;

/// Longest edge of the road map, millimetres: the arc of a 20 mm tip's centre around a sharp right-angled edge
/// is 31 long, and a fold can be sharper.
const LONGEST_EDGE_MM: f64 = 45.0;

/// How far above the contact the finger glides, millimetres.
pub(crate) const HOVER_MM: f64 = 2.0;

/// Step of the centre along a planned path, millimetres.
pub(crate) const STEP_MM: f64 = 1.0;

/// Evenly spread places where a ball of one radius touches one object, with a road map between them.
#[derive(Clone, Debug)]
pub(crate) struct Waypoints {
    /// The placements.
    pub placements: Vec<Placement>,
    /// Distance that any two contact points on the same side keep, millimetres.
    pub spacing_mm: f64,
    /// Share of the object's area that the ball can touch, 0 to 1.
    pub touchable: f64,
    roads: Vec<Vec<u32>>,
}

impl Waypoints {
    /// About `count` places, chosen by dart throwing from evenly spread samples; the same for the same seed.
    pub(crate) fn spread(object: &Object, tip_radius_mm: f64, count: usize, seed: u64) -> Self {
        let samples = object.sample((count * CANDIDATES).max(2000));
        let sampled = samples.len();
        let mut candidates: Vec<Placement> = samples
            .into_iter()
            .filter_map(|sample| {
                let centre_mm = sample.position_mm + sample.normal * tip_radius_mm;
                let foot = object.foot(&centre_mm);
                // Touchable where nothing else is nearer to the ball than the place meant.
                let same = (foot.position_mm - sample.position_mm).norm() < 0.5
                    && (foot.distance_mm - tip_radius_mm).abs() < 1e-2;
                if !same {
                    return None;
                }
                place(object, &centre_mm, tip_radius_mm)
            })
            .collect();
        let touchable = candidates.len() as f64 / sampled.max(1) as f64;
        let area = object.truth_mesh().area() * touchable;
        let spacing_mm =
            (PACKING * 4.0 * area / (std::f64::consts::PI * count.max(1) as f64)).sqrt();
        candidates.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));

        let positions = candidates.iter().map(|c| c.foot.position_mm).collect();
        let near = Neighbourhoods::new(positions);
        let mut taken = vec![false; candidates.len()];
        let mut placements = Vec::new();
        for (k, candidate) in candidates.iter().enumerate() {
            // The other side of a thin wall is not near.
            let crowded = near
                .within(&candidate.foot.position_mm, spacing_mm)
                .into_iter()
                .any(|(j, _)| {
                    taken[j] && candidates[j].foot.normal.dot(&candidate.foot.normal) > 0.0
                });
            if !crowded {
                taken[k] = true;
                placements.push(*candidate);
            }
        }
        let roads = roads(&placements);
        Self {
            placements,
            spacing_mm,
            touchable,
            roads,
        }
    }

    /// A way through the air close above the surface from one placement to a waypoint, as centres; `None` if
    /// there is none. `reachable` says which centres the finger can take.
    pub(crate) fn glide(
        &self,
        object: &Object,
        distance_mm: f64,
        from: &Vec3,
        to: usize,
        reachable: &dyn Fn(&Placement) -> bool,
    ) -> Option<Vec<Vec3>> {
        let start = place(object, from, distance_mm)?;
        let goal = self.placements.get(to)?.centre_mm;
        if let Some(path) = hover(object, &start, &goal, distance_mm, reachable) {
            return Some(path);
        }
        // Roads are only promises: where one turns out blocked it is closed, and the way sought again.
        let mut closed: Vec<(usize, usize)> = Vec::new();
        let entry = self.nearest(&start)?;
        'again: for _ in 0..12 {
            let route = self.route(entry, to, &closed)?;
            let mut at = start;
            let mut centres = Vec::new();
            let mut last = entry;
            for &node in &route {
                let next = self.placements[node].centre_mm;
                let Some(leg) = hover(object, &at, &next, distance_mm, reachable) else {
                    if node == entry {
                        return None;
                    }
                    closed.push((last, node));
                    continue 'again;
                };
                centres.extend(leg);
                at = place(object, centres.last().unwrap_or(from), distance_mm)?;
                last = node;
            }
            return Some(centres);
        }
        None
    }

    fn nearest(&self, placement: &Placement) -> Option<usize> {
        (0..self.placements.len()).min_by(|&a, &b| {
            let gap = |k: usize| apart(placement, &self.placements[k]);
            gap(a).total_cmp(&gap(b)).then(a.cmp(&b))
        })
    }

    /// Shortest way over the road map from `from` to `to`, both included.
    fn route(&self, from: usize, to: usize, closed: &[(usize, usize)]) -> Option<Vec<usize>> {
        let mut least = vec![f64::INFINITY; self.placements.len()];
        let mut before = vec![usize::MAX; self.placements.len()];
        // Nanometres as integers order totally.
        let mut open = BinaryHeap::from([(Reverse(0u64), from)]);
        least[from] = 0.0;
        while let Some((Reverse(key), at)) = open.pop() {
            if at == to {
                let mut route = vec![to];
                while route[route.len() - 1] != from {
                    route.push(before[route[route.len() - 1]]);
                }
                route.reverse();
                return Some(route);
            }
            if key as f64 > least[at] * 1e6 + 1.0 {
                continue;
            }
            for &next in &self.roads[at] {
                let next = next as usize;
                if closed.contains(&(at, next)) {
                    continue;
                }
                let step = (self.placements[at].centre_mm - self.placements[next].centre_mm).norm();
                // Places whose centres coincide (two flanks of a groove) still cost a little.
                let cost = least[at] + step + 0.01;
                if cost < least[next] {
                    least[next] = cost;
                    before[next] = at;
                    open.push((Reverse((cost * 1e6) as u64), next));
                }
            }
        }
        None
    }
}

/// How far apart two placements are for a sliding finger: way of the contact plus way of the centre.
pub(crate) fn apart(a: &Placement, b: &Placement) -> f64 {
    (a.foot.position_mm - b.foot.position_mm).norm() + (a.centre_mm - b.centre_mm).norm()
}

fn hover(
    object: &Object,
    from: &Placement,
    to: &Vec3,
    distance_mm: f64,
    reachable: &dyn Fn(&Placement) -> bool,
) -> Option<Vec<Vec3>> {
    let goal = place(object, to, distance_mm)?.centre_mm;
    let path = slide(object, from, &goal, distance_mm, 2.0 * STEP_MM, reachable)?;
    Some(path.iter().map(|p| p.centre_mm).collect())
}

fn roads(placements: &[Placement]) -> Vec<Vec<u32>> {
    let by_contact = Neighbourhoods::new(placements.iter().map(|p| p.foot.position_mm).collect());
    let by_centre = Neighbourhoods::new(placements.iter().map(|p| p.centre_mm).collect());
    placements
        .iter()
        .enumerate()
        .map(|(k, placement)| {
            let mut near: Vec<u32> = by_contact
                .nearest(&placement.foot.position_mm, NEIGHBOURS + 1)
                .into_iter()
                .chain(by_centre.nearest(&placement.centre_mm, NEIGHBOURS + 1))
                .filter(|&(j, _)| {
                    let way = (placements[j].centre_mm - placement.centre_mm).norm();
                    j != k && way < LONGEST_EDGE_MM
                })
                .map(|(j, _)| j as u32)
                .collect();
            near.sort_unstable();
            near.dedup();
            near
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIP: f64 = 20.0;

    #[test]
    fn spread_is_even_and_the_same_for_the_same_seed() {
        let object = Object::named("torus").unwrap();
        let spread = Waypoints::spread(&object, TIP, 300, 1);
        let again = Waypoints::spread(&object, TIP, 300, 1);
        assert_eq!(spread.placements, again.placements);
        assert_ne!(
            spread.placements,
            Waypoints::spread(&object, TIP, 300, 2).placements
        );
        assert!(
            (240..=360).contains(&spread.placements.len()),
            "{}",
            spread.placements.len()
        );
        // The hole's radius of 32 takes the tip, so all of the torus can be touched.
        assert_eq!(spread.touchable, 1.0);
        // No place is further from a waypoint than about the spacing.
        for sample in object.sample(1000) {
            let nearest = spread
                .placements
                .iter()
                .map(|p| (p.foot.position_mm - sample.position_mm).norm())
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 1.6 * spread.spacing_mm, "{nearest}");
        }
    }

    #[test]
    fn gliding_gets_from_inside_the_mug_to_outside_without_touching() {
        let object = Object::named("mug").unwrap();
        let waypoints = Waypoints::spread(&object, TIP, 400, 3);
        let place_of = |wanted: &dyn Fn(&Placement) -> bool| {
            waypoints.placements.iter().position(wanted).unwrap()
        };
        let inside = place_of(&|p| p.foot.position_mm.xy().norm() < 20.0 && p.foot.normal.z > 0.9);
        let outside =
            place_of(&|p| p.foot.position_mm.x < -49.0 && p.foot.position_mm.z.abs() < 20.0);
        let from = waypoints.placements[inside].centre_mm;
        let path = waypoints
            .glide(&object, TIP + HOVER_MM, &from, outside, &|_| true)
            .unwrap();
        for centre in &path {
            assert!(object.foot(centre).distance_mm > TIP + HOVER_MM - 1e-3);
        }
        assert!(path.iter().any(|c| c.z > 65.0), "over the lip");
        let end = path.last().unwrap();
        assert!((end - waypoints.placements[outside].centre_mm).norm() < HOVER_MM + 1e-6);
    }
}
