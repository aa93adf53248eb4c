//! The way of one finger over an object: long slides over the places it is to visit, short flights between
//! them, and a swing from one bend of the elbow to the other.
//!
//! The order of the places is greedy: always the nearest one left, where "near" counts more along one of the
//! axes than across, so that the finger goes to and fro in stripes instead of running in circles. The
//! alternative, planes cut through the object at fixed heights, gives straighter tracks but uneven ones
//! where the surface is parallel to the planes.

use super::finger::{Elbow, Reacher};
use super::object::Object;
use super::touch::{Placement, line_is_free, place, slide};
use super::waypoints::{HOVER_MM, STEP_MM, Waypoints, apart};
use crate::Vec3;

/// How much further across the stripes counts than along them, for squared distances.
const ACROSS: f64 = 8.0;

/// Longest slide between two places, in spacings of the waypoints; beyond, the finger takes off.
const LONGEST_SLIDE: f64 = 4.0;

/// A stretch of a finger's way.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Leg {
    /// In contact from placement to placement, which are at most a few millimetres apart.
    Slide(Vec<Placement>),
    /// In the air along centres.
    Flight(Vec<Vec3>),
    /// In the air, far from the object: from one bend to the other at the home position.
    Swing(Elbow),
}

/// A leg and the bend of the finger during it (for a swing, before it).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BentLeg {
    pub leg: Leg,
    pub elbow: Elbow,
}

/// Slides through all of `visit` (indices of waypoints), taking off only where the surface or `allowed` makes
/// it; begins at the waypoint nearest to `start`. Places to which there is no way are left out.
pub(crate) fn tour(
    object: &Object,
    waypoints: &Waypoints,
    tip_radius_mm: f64,
    visit: &[usize],
    start: &Vec3,
    allowed: &dyn Fn(&Placement) -> bool,
    reachable: &dyn Fn(&Placement) -> bool,
) -> Vec<Leg> {
    let order = order(waypoints, visit, start);
    let mut legs: Vec<Leg> = Vec::new();
    let mut current: Vec<Placement> = Vec::new();
    for k in order {
        let next = waypoints.placements[k];
        if let Some(last) = current.last() {
            let near = apart(last, &next) < 2.0 * LONGEST_SLIDE * waypoints.spacing_mm;
            let direct = if near {
                slide(
                    object,
                    last,
                    &next.centre_mm,
                    tip_radius_mm,
                    STEP_MM,
                    allowed,
                )
            } else {
                None
            };
            if let Some(path) = direct {
                current.extend(path);
                continue;
            }
            let Some(path) = waypoints.glide(
                object,
                tip_radius_mm + HOVER_MM,
                &last.centre_mm,
                k,
                reachable,
            ) else {
                continue;
            };
            let landed = std::mem::take(&mut current);
            legs.push(Leg::Slide(landed));
            legs.push(Leg::Flight(path));
        }
        current.push(next);
    }
    if !current.is_empty() {
        legs.push(Leg::Slide(current));
    }
    legs
}

/// The waypoints of `visit` in the order described above.
fn order(waypoints: &Waypoints, visit: &[usize], start: &Vec3) -> Vec<usize> {
    let mut left = visit.to_vec();
    let mut order = Vec::with_capacity(left.len());
    let Some(first) = (0..left.len()).min_by(|&a, &b| {
        let gap = |k: usize| (waypoints.placements[left[k]].centre_mm - start).norm();
        gap(a).total_cmp(&gap(b)).then(a.cmp(&b))
    }) else {
        return order;
    };
    let mut at = left.swap_remove(first);
    order.push(at);
    while !left.is_empty() {
        let here = &waypoints.placements[at];
        // Across the stripes is the axis most in the surface; earlier axes win ties.
        let normal = here.foot.normal.abs();
        let axis = (0..3).fold(0, |best, k| if normal[k] < normal[best] { k } else { best });
        let cost = |k: usize| {
            let there = &waypoints.placements[k];
            let gap = apart(here, there);
            let across = there.foot.position_mm[axis] - here.foot.position_mm[axis];
            gap * gap + ACROSS * across * across
        };
        let mut best = (0, f64::INFINITY);
        for (slot, &k) in left.iter().enumerate() {
            let cost = cost(k);
            if cost < best.1 || (cost == best.1 && k < left[best.0]) {
                best = (slot, cost);
            }
        }
        at = left.swap_remove(best.0);
        order.push(at);
    }
    order
}

/// Which waypoints each finger visits with which bend, and how many no finger can reach.
#[derive(Clone, Debug)]
pub(crate) struct Division {
    /// Per finger, per bend (in the order of [`Elbow::BOTH`]): indices of waypoints.
    pub parts: Vec<[Vec<usize>; 2]>,
    /// Waypoints that no finger can touch with its hemisphere.
    pub unreachable: usize,
}

/// The least z component, in tip coordinates, of the direction to a contact: 0 is the hemisphere's rim. 0.1
/// keeps contacts 5.7 degrees away from it, several times the angular error of a contact.
pub(crate) const LEAST_POLE: f64 = 0.1;

/// How squarely a finger meets a placement: the z component, in tip coordinates, of the direction to the
/// contact; `None` out of reach.
pub(crate) fn squareness(reacher: &Reacher, placement: &Placement, elbow: Elbow) -> Option<f64> {
    let angles = reacher.angles(&placement.centre_mm, elbow)?;
    Some(-reacher.pole(&angles).dot(&placement.foot.normal))
}

/// Gives every waypoint to the finger and bend that meet it most squarely, and shifts the borders between
/// fingers until all have about the same number.
pub(crate) fn divide(waypoints: &Waypoints, reachers: &[Reacher]) -> Division {
    let scores: Vec<Vec<[Option<f64>; 2]>> = waypoints
        .placements
        .iter()
        .map(|placement| {
            reachers
                .iter()
                .map(|r| {
                    Elbow::BOTH.map(|elbow| {
                        squareness(r, placement, elbow).filter(|&z| z >= LEAST_POLE + 0.02)
                    })
                })
                .collect()
        })
        .collect();
    let choose = |bonus: &[f64], scores: &[[Option<f64>; 2]]| {
        let mut best: Option<(f64, usize, usize)> = None;
        for (f, bends) in scores.iter().enumerate() {
            for (e, score) in bends.iter().enumerate() {
                if let Some(z) = score.map(|z| z + bonus[f])
                    && best.is_none_or(|(least, _, _)| z > least)
                {
                    best = Some((z, f, e));
                }
            }
        }
        best.map(|(_, f, e)| (f, e))
    };
    let mut bonus = vec![0.0; reachers.len()];
    for _ in 0..40 {
        let mut counts = vec![0.0; reachers.len()];
        for (f, _) in scores.iter().filter_map(|s| choose(&bonus, s)) {
            counts[f] += 1.0;
        }
        let mean = counts.iter().sum::<f64>() / counts.len().max(1) as f64;
        for (b, count) in bonus.iter_mut().zip(counts) {
            *b += 0.1 * (mean - count) / f64::max(mean, 1.0);
        }
    }
    let mut division = Division {
        parts: vec![[Vec::new(), Vec::new()]; reachers.len()],
        unreachable: 0,
    };
    for (k, scores) in scores.iter().enumerate() {
        match choose(&bonus, scores) {
            Some((f, e)) => division.parts[f][e].push(k),
            None => division.unreachable += 1,
        }
    }
    division
}

/// The whole way of one finger: from home, over its part with the elbow up, swing, its part with the elbow
/// down, and home with the elbow up again.
pub(crate) fn itinerary(
    object: &Object,
    waypoints: &Waypoints,
    tip_radius_mm: f64,
    reacher: &Reacher,
    parts: &[Vec<usize>; 2],
) -> Vec<BentLeg> {
    let hover_mm = tip_radius_mm + HOVER_MM;
    let home = reacher.home_mm();
    let mut whole: Vec<BentLeg> = Vec::new();
    for (elbow, part) in Elbow::BOTH.into_iter().zip(parts) {
        let mut legs: Vec<Leg> = Vec::new();
        let reachable = |p: &Placement| reacher.angles(&p.centre_mm, elbow).is_some();
        let allowed =
            |p: &Placement| squareness(reacher, p, elbow).is_some_and(|z| z >= LEAST_POLE);
        let gate = gate(object, waypoints, hover_mm, &home, &reachable);
        if let (Some(gate), false) = (gate, part.is_empty()) {
            let at_gate = waypoints.placements[gate].centre_mm;
            let touring = tour(
                object,
                waypoints,
                tip_radius_mm,
                part,
                &at_gate,
                &allowed,
                &reachable,
            );
            let ends = touring
                .iter()
                .find_map(first_placement)
                .zip(touring.iter().rev().find_map(last_placement));
            if let Some((first, last)) = ends {
                let to_first = nearest_waypoint(waypoints, &first);
                let arrive = waypoints.glide(object, hover_mm, &at_gate, to_first, &reachable);
                let leave = waypoints.glide(object, hover_mm, &last.centre_mm, gate, &reachable);
                if let (Some(arrive), Some(mut leave)) = (arrive, leave) {
                    let mut enter = straight(&home, arrive.first().unwrap_or(&at_gate));
                    enter.extend(arrive);
                    let exit = straight(leave.last().unwrap_or(&at_gate), &home);
                    leave.extend(exit);
                    legs.push(Leg::Flight(enter));
                    legs.extend(touring);
                    legs.push(Leg::Flight(leave));
                }
            }
        }
        if legs.is_empty() {
            legs.push(Leg::Flight(vec![home]));
        }
        legs.push(Leg::Swing(elbow));
        whole.extend(legs.into_iter().map(|leg| BentLeg { leg, elbow }));
    }
    whole
}

/// The waypoint nearest to home that the tip can fly to from there in a straight line.
fn gate(
    object: &Object,
    waypoints: &Waypoints,
    hover_mm: f64,
    home: &Vec3,
    reachable: &dyn Fn(&Placement) -> bool,
) -> Option<usize> {
    let mut order: Vec<usize> = (0..waypoints.placements.len()).collect();
    let gap = |k: usize| (waypoints.placements[k].centre_mm - home).norm();
    order.sort_by(|&a, &b| gap(a).total_cmp(&gap(b)).then(a.cmp(&b)));
    order.into_iter().find(|&k| {
        place(object, &waypoints.placements[k].centre_mm, hover_mm).is_some_and(|above| {
            reachable(&above) && line_is_free(object, home, &above.centre_mm, hover_mm)
        })
    })
}

fn nearest_waypoint(waypoints: &Waypoints, placement: &Placement) -> usize {
    (0..waypoints.placements.len())
        .min_by(|&a, &b| {
            let gap = |k: usize| apart(placement, &waypoints.placements[k]);
            gap(a).total_cmp(&gap(b)).then(a.cmp(&b))
        })
        .unwrap_or(0)
}

fn first_placement(leg: &Leg) -> Option<Placement> {
    match leg {
        Leg::Slide(path) => path.first().copied(),
        Leg::Flight(_) | Leg::Swing(_) => None,
    }
}

fn last_placement(leg: &Leg) -> Option<Placement> {
    match leg {
        Leg::Slide(path) => path.last().copied(),
        Leg::Flight(_) | Leg::Swing(_) => None,
    }
}

fn straight(from: &Vec3, to: &Vec3) -> Vec<Vec3> {
    let steps = ((to - from).norm() / (4.0 * STEP_MM)).ceil().max(1.0) as usize;
    (0..=steps)
        .map(|k| from.lerp(to, k as f64 / steps as f64))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Hand;

    const TIP: f64 = 20.0;

    fn reachers() -> Vec<Reacher> {
        let hand = Hand::from_urdf(Hand::THREE_FINGER_URDF, "three_finger.urdf").unwrap();
        hand.fingers()
            .iter()
            .map(|f| Reacher::new(f).unwrap())
            .collect()
    }

    #[test]
    fn three_fingers_reach_what_a_ball_can_touch() {
        for name in Object::NAMES {
            let object = Object::named(name).unwrap();
            let waypoints = Waypoints::spread(&object, TIP, 400, 1);
            let division = divide(&waypoints, &reachers());
            let all = waypoints.placements.len();
            assert_eq!(division.unreachable, 0, "{name}");
            let shares: Vec<usize> = division
                .parts
                .iter()
                .map(|[up, down]| up.len() + down.len())
                .collect();
            assert_eq!(shares.iter().sum::<usize>(), all);
            for share in shares {
                assert!(
                    share > all / 6,
                    "{name}: a finger has only {share} of {all}"
                );
            }
        }
    }

    #[test]
    fn a_whole_way_visits_its_part_on_the_hemisphere_and_never_digs_in() {
        for name in ["mug", "torus"] {
            let object = Object::named(name).unwrap();
            let waypoints = Waypoints::spread(&object, TIP, 240, 5);
            let reachers = reachers();
            let division = divide(&waypoints, &reachers);
            let mut visited = 0;
            for (reacher, parts) in reachers.iter().zip(&division.parts) {
                for BentLeg { leg, elbow } in itinerary(&object, &waypoints, TIP, reacher, parts) {
                    match leg {
                        Leg::Slide(path) => {
                            for placement in &path {
                                let gap = object.foot(&placement.centre_mm).distance_mm - TIP;
                                assert!(gap.abs() < 1e-3, "{name}: {gap}");
                                let z = squareness(reacher, placement, elbow).unwrap();
                                assert!(z >= LEAST_POLE);
                            }
                            visited += waypoints
                                .placements
                                .iter()
                                .filter(|w| path.contains(w))
                                .count();
                        }
                        Leg::Flight(centres) => {
                            for centre in &centres {
                                assert!(reacher.angles(centre, elbow).is_some());
                                assert!(object.foot(centre).distance_mm >= TIP + HOVER_MM - 1e-2);
                            }
                        }
                        Leg::Swing(before) => assert_eq!(before, elbow),
                    }
                }
            }
            // Two tracks may pass through one place, so more than all is possible and fewer is not.
            assert!(visited >= waypoints.placements.len(), "{name}: {visited}");
        }
    }
}
