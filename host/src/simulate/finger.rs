//! Inverse kinematics of a simulated finger: where the joints must stand for the tip to be somewhere.
//!
//! The simulated fingers turn about an upright axis (yaw) and bend about two parallel axes (shoulder, elbow),
//! so that a tip position has one yaw and two ways to bend: elbow up or down. Three joints leave no choice of
//! the tip's orientation beyond that, and a contact must lie on the tip's hemisphere. Two ways out were weighed:
//! a wrist whose pose is published with the run, and long fingers around the object of which each can bend
//! both ways. The second was taken, because a run then needs nothing but the joint angles the boards report:
//! with three fingers on a ring and both bends there is, for every direction a surface may face, a finger
//! that meets it with its hemisphere. Links are not checked for collision, nor fingers against each other.
//!
//! The geometry (ring, link lengths) is read off the hand's own forward kinematics, not written down twice.

use crate::Vec3;
use crate::hand::{Finger, JointMotion};
use nalgebra::Isometry3;

/// Which way the finger bends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Elbow {
    /// The elbow stands above the line from shoulder to tip.
    Up,
    /// The elbow hangs below it.
    Down,
}

impl Elbow {
    pub(crate) const BOTH: [Self; 2] = [Self::Up, Self::Down];
}

/// A finger that bends as described above, with what its inverse kinematics needs.
#[derive(Clone, Debug)]
pub(crate) struct Reacher {
    finger: Finger,
    /// Frame of the yaw joint at angle 0, millimetres: z along the axis, x towards the tip.
    base_mm: Isometry3<f64>,
    upper_mm: f64,
    fore_mm: f64,
}

impl Reacher {
    /// `None` unless the finger is a yaw joint and two bending joints, all turning, in the arrangement above.
    pub(crate) fn new(finger: &Finger) -> Option<Self> {
        let [yaw, shoulder, elbow] = finger.joints.as_slice() else {
            return None;
        };
        let turning = [yaw, shoulder, elbow]
            .iter()
            .all(|joint| joint.motion == JointMotion::Turn);
        let near = |a: Vec3, b: Vec3| (a - b).norm() < 1e-6;
        let (s, e) = (&shoulder.placement_mm, &elbow.placement_mm);
        let tip = finger.sensor_placement_mm * nalgebra::Point3::from(finger.tip_in_sensor_mm);
        let (upper_mm, fore_mm) = (e.translation.vector.x, tip.x);
        let fits = turning
            && near(yaw.axis.into_inner(), Vec3::z())
            && near(shoulder.axis.into_inner(), Vec3::y())
            && near(elbow.axis.into_inner(), Vec3::y())
            && s.translation.vector.norm() < 1e-6
            && s.rotation.angle() < 1e-9
            && e.rotation.angle() < 1e-9
            && near(e.translation.vector, Vec3::x() * upper_mm)
            && near(tip.coords, Vec3::x() * fore_mm)
            && upper_mm > 0.0
            && fore_mm > 0.0;
        fits.then(|| Self {
            finger: finger.clone(),
            base_mm: yaw.placement_mm,
            upper_mm,
            fore_mm,
        })
    }

    /// The finger as the hand describes it.
    pub(crate) fn finger(&self) -> &Finger {
        &self.finger
    }

    /// Joint angles (rad) that bring the tip's centre to `centre_mm`; `None` out of reach or beyond a limit.
    pub(crate) fn angles(&self, centre_mm: &Vec3, elbow: Elbow) -> Option<[f64; 3]> {
        let local = self
            .base_mm
            .inverse_transform_point(&(*centre_mm).into())
            .coords;
        let ahead = local.x.hypot(local.y);
        let (a, b) = (self.upper_mm, self.fore_mm);
        let reach2 = local.norm_squared();
        let cos_bend = (reach2 - a * a - b * b) / (2.0 * a * b);
        if !(-1.0..=1.0).contains(&cos_bend) {
            return None;
        }
        // A positive turn about y lowers what lies along x: the elbow is up when it bends downwards.
        let bend = match elbow {
            Elbow::Up => cos_bend.acos(),
            Elbow::Down => -cos_bend.acos(),
        };
        let lowered = (-local.z).atan2(ahead);
        let within = (b * bend.sin()).atan2(a + b * bend.cos());
        let angles = [local.y.atan2(local.x), lowered - within, bend];
        self.finger.within_limits(&angles).then_some(angles)
    }

    /// Where to wait, out of the way: before the base, high up, where both bends are possible.
    pub(crate) fn home_mm(&self) -> Vec3 {
        let reach = self.upper_mm + self.fore_mm;
        (self.base_mm * nalgebra::Point3::new(0.25 * reach, 0.0, 0.8 * reach)).coords
    }

    /// Direction in which the tip's pole points in the world, for the given joint angles.
    pub(crate) fn pole(&self, angles: &[f64; 3]) -> Vec3 {
        self.finger.tip_pose_mm(angles).rotation * Vec3::z()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Hand;
    use proptest::prelude::*;

    fn reachers() -> Vec<Reacher> {
        let hand = Hand::from_urdf(Hand::THREE_FINGER_URDF, "three_finger.urdf").unwrap();
        hand.fingers()
            .iter()
            .map(|f| Reacher::new(f).unwrap())
            .collect()
    }

    proptest! {
        #[test]
        fn the_tip_comes_to_where_it_was_sent(
            which in 0usize..3, x in -145.0..145.0f64, y in -145.0..145.0f64, z in -145.0..145.0f64, up: bool,
        ) {
            let reacher = &reachers()[which];
            let target = Vec3::new(x, y, z);
            prop_assume!(target.norm() < 145.0);
            let elbow = if up { Elbow::Up } else { Elbow::Down };
            let angles = reacher.angles(&target, elbow);
            prop_assert!(angles.is_some(), "all of the object's surroundings are in reach");
            let angles = angles.unwrap();
            let tip = reacher.finger().tip_pose_mm(&angles).translation.vector;
            prop_assert!((tip - target).norm() < 1e-9);
            // The elbow really is above or below: the fore link comes down to the tip or up to it, relative
            // to the line from the shoulder.
            let elbow_at = target - reacher.pole(&angles) * reacher.fore_mm;
            let shoulder = reacher.base_mm.translation.vector;
            let to_tip = target - shoulder;
            let along = (elbow_at - shoulder).dot(&to_tip) / to_tip.norm_squared();
            prop_assert_eq!(elbow_at.z > shoulder.z + along * to_tip.z, up);
        }
    }

    #[test]
    fn out_of_reach_is_said_and_home_has_both_bends() {
        for reacher in reachers() {
            assert_eq!(reacher.angles(&Vec3::new(0.0, 0.0, 900.0), Elbow::Up), None);
            for elbow in Elbow::BOTH {
                assert!(reacher.angles(&reacher.home_mm(), elbow).is_some());
            }
        }
    }

    #[test]
    fn other_fingers_are_not_taken_for_this_one() {
        let other =
            Hand::THREE_FINGER_URDF.replace("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"1 0 0\"/>");
        let hand = Hand::from_urdf(&other, "other.urdf").unwrap();
        assert!(Reacher::new(&hand.fingers()[0]).is_none());
    }
}
