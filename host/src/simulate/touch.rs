//! A ball against an object: where it touches, and how it slides along without ever digging in.
//!
//! The centres of a ball of radius R that touches and does not penetrate are the places whose distance to
//! the object is R. Staying on that level set is therefore all it takes to "touch where a sphere can touch":
//! in a groove narrower than the ball the nearest point jumps from one flank to the other and the bottom is
//! never reached.

use super::object::{Foot, Object};
use crate::Vec3;

/// How exactly the gap is kept, millimetres: far below the 0.05 mm asked of a contact.
const GAP_TOLERANCE_MM: f64 = 1e-6;

/// A ball at a fixed gap from the object: its centre, and the foot of its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    /// Centre of the ball, millimetres.
    pub centre_mm: Vec3,
    /// Where the object is nearest.
    pub foot: Foot,
}

/// The placement at distance `distance_mm` from the object (the ball's radius, plus a gap to glide at) that
/// is reached from `near` by moving straight away from, or to, whatever is nearest. `None` if there is none
/// close by (a cavity narrower than the ball).
pub(crate) fn place(object: &Object, near: &Vec3, distance_mm: f64) -> Option<Placement> {
    let mut centre_mm = *near;
    for _ in 0..60 {
        let foot = object.foot(&centre_mm);
        let lack = distance_mm - foot.distance_mm;
        if lack.abs() < GAP_TOLERANCE_MM {
            return Some(Placement { centre_mm, foot });
        }
        let step = foot.normal * lack;
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        centre_mm += step;
    }
    // Between two flanks the steps shrink without end; a gap that is a little too wide is no harm.
    let foot = object.foot(&centre_mm);
    ((foot.distance_mm - distance_mm).abs() < 1e-3).then_some(Placement { centre_mm, foot })
}

/// Slides from `from` towards `to` on the level set, in steps of at most `step_mm` of the centre.
///
/// Returns the placements after `from`, the last of them within a step of `to`; `None` when the way is
/// blocked (the ball comes no nearer to its goal) or `allowed` refuses a placement on the way.
pub(crate) fn slide(
    object: &Object,
    from: &Placement,
    to: &Vec3,
    distance_mm: f64,
    step_mm: f64,
    allowed: &dyn Fn(&Placement) -> bool,
) -> Option<Vec<Placement>> {
    let mut path = Vec::new();
    let mut at = *from;
    let mut least = (to - at.centre_mm).norm();
    let mut idle = 0;
    // Around an edge the way on the level set is up to pi / 2 times the straight one; twice is generous.
    let longest = (2.0 * least / step_mm).ceil() as usize + 8;
    for _ in 0..longest {
        let towards = to - at.centre_mm;
        if towards.norm() <= step_mm {
            let end = place(object, to, distance_mm)?;
            // The goal may have been given roughly; it must not have been pushed somewhere else.
            if (end.centre_mm - at.centre_mm).norm() > 3.0 * step_mm || !allowed(&end) {
                return None;
            }
            path.push(end);
            return Some(path);
        }
        let tangential = towards - at.foot.normal * towards.dot(&at.foot.normal);
        let length = tangential.norm();
        if length < 1e-3 * towards.norm() {
            return None;
        }
        let next = place(
            object,
            &(at.centre_mm + tangential * (step_mm / length)),
            distance_mm,
        )?;
        if (next.centre_mm - at.centre_mm).norm() > 3.0 * step_mm || !allowed(&next) {
            return None;
        }
        at = next;
        path.push(at);
        let left = (to - at.centre_mm).norm();
        if left < least - 1e-6 {
            least = left;
            idle = 0;
        } else {
            idle += 1;
            if idle > 5 {
                return None;
            }
        }
    }
    None
}

/// Whether a ball of `radius_mm` moves from `from` to `to` in a straight line without coming nearer than that.
pub(crate) fn line_is_free(object: &Object, from: &Vec3, to: &Vec3, radius_mm: f64) -> bool {
    let length = (to - from).norm();
    let mut travelled = 0.0;
    while travelled < length {
        let spare = object.foot(&from.lerp(to, travelled / length)).distance_mm - radius_mm;
        if spare.is_nan() || spare < -GAP_TOLERANCE_MM {
            return false;
        }
        travelled += spare.max(0.5);
    }
    object.foot(to).distance_mm >= radius_mm - 1e-3
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIP: f64 = 20.0;

    #[test]
    fn sliding_never_digs_in_and_never_leaves() {
        for name in ["mug", "two-holed-torus", "cube", "trilobe"] {
            let object = Object::named(name).unwrap();
            let samples = object.sample(40);
            let mut slides = 0;
            for pair in samples.windows(2) {
                let [from, to] = [&pair[0], &pair[1]]
                    .map(|f| place(&object, &(f.position_mm + f.normal * TIP), TIP));
                let (Some(from), Some(to)) = (from, to) else {
                    continue;
                };
                let Some(path) = slide(&object, &from, &to.centre_mm, TIP, 1.0, &|_| true) else {
                    continue;
                };
                slides += 1;
                let mut last = from.centre_mm;
                for placement in path {
                    let gap = object.foot(&placement.centre_mm).distance_mm - TIP;
                    assert!(gap.abs() < 1e-3, "{name}: {gap}");
                    assert!(gap > -2.0 * GAP_TOLERANCE_MM, "{name}: digs in by {gap}");
                    assert!((placement.centre_mm - last).norm() <= 3.0);
                    last = placement.centre_mm;
                }
                assert!((last - to.centre_mm).norm() < 1e-2);
            }
            assert!(slides >= 5, "{name}: only {slides} slides");
        }
    }

    #[test]
    fn a_ball_touches_the_flanks_of_a_groove_and_not_its_bottom() {
        // The valley between two balls of the trilobe, on the line at 60 degrees.
        let object = Object::named("trilobe").unwrap();
        let direction = Vec3::new(0.5, 0.75f64.sqrt(), 0.0);
        let placed = place(&object, &(direction * 70.0), TIP).unwrap();
        let bottom = object.foot(&(direction * 45.0)).position_mm;
        assert!(placed.foot.distance_mm > TIP - 1e-3);
        assert!(object.foot(&(bottom + direction * TIP)).distance_mm <= TIP + 1e-6);
    }

    #[test]
    fn a_line_through_the_hole_is_free_and_one_through_the_ring_is_not() {
        let object = Object::named("torus").unwrap();
        let free = |x: f64| {
            let (above, below) = (Vec3::new(x, 0.0, 120.0), Vec3::new(x, 0.0, -120.0));
            line_is_free(&object, &above, &below, TIP)
        };
        assert!(free(0.0) && free(11.0));
        assert!(!free(13.0) && !free(60.0));
    }
}
