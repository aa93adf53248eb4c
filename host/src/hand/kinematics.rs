//! Forward kinematics of one finger: joint angles to the pose of its tip.
//!
//! A chain is a product of fixed placements and joint motions, T = P1 M1(q1) P2 M2(q2) ... Pend, with URDF's
//! convention: a joint's `origin` places its frame in the parent link, the motion follows about or along
//! `axis` in that frame.

use crate::Vec3;
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion};

/// Most joints a finger may have: a contact frame carries three joint angles.
pub const MAX_JOINTS: usize = 3;

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointMotion {
    /// Turns about its axis; the joint value is an angle in radians.
    Turn,
    /// Slides along its axis; the joint value is a length in metres.
    Slide,
}

/// One movable joint of a finger.
#[derive(Clone, Debug, PartialEq)]
pub struct FingerJoint {
    /// Name in the URDF.
    pub name: String,
    /// Turning or sliding.
    pub motion: JointMotion,
    /// Lowest and highest joint value, radians or metres; infinite where the URDF sets no limit.
    pub limits: (f64, f64),
    /// From the frame of the joint before (or the root) to this joint's frame; millimetres.
    pub placement_mm: Isometry3<f64>,
    /// Axis in the joint's own frame.
    pub axis: Unit<Vec3>,
}

impl FingerJoint {
    fn motion(&self, value: f64) -> Isometry3<f64> {
        match self.motion {
            JointMotion::Turn => Isometry3::from_parts(
                Translation3::identity(),
                UnitQuaternion::from_axis_angle(&self.axis, value),
            ),
            JointMotion::Slide => {
                Translation3::from(self.axis.into_inner() * (value * 1000.0)).into()
            }
        }
    }
}

/// One finger: the joints from the root to the sensor, and the tip on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Finger {
    /// Name by which the finger is called on the command line and in a run.
    pub name: String,
    /// One to three movable joints, root first.
    pub joints: Vec<FingerJoint>,
    /// From the frame of the last joint to the sensor's frame; millimetres.
    pub sensor_placement_mm: Isometry3<f64>,
    /// Centre of the tip in sensor coordinates, millimetres; the axes of tip and sensor are parallel.
    pub tip_in_sensor_mm: Vec3,
}

/// A contact in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldContact {
    /// Where the surface was touched, millimetres.
    pub position_mm: Vec3,
    /// Outward unit normal of the touched surface (opposite to the tip's own).
    pub normal: Vec3,
}

impl Finger {
    /// Where the joints, the sensor and the centre of the tip are, root first, to draw the finger; millimetres.
    ///
    /// Angles as in [`Self::sensor_pose_mm`].
    pub fn chain_mm(&self, angles: &[f64]) -> Vec<Vec3> {
        let mut pose = Isometry3::identity();
        let mut places = Vec::with_capacity(self.joints.len() + 2);
        for (k, joint) in self.joints.iter().enumerate() {
            pose = pose * joint.placement_mm * joint.motion(angles.get(k).copied().unwrap_or(0.0));
            places.push(pose.translation.vector);
        }
        let sensor = pose * self.sensor_placement_mm;
        places.push(sensor.translation.vector);
        places.push(
            (sensor * Translation3::from(self.tip_in_sensor_mm))
                .translation
                .vector,
        );
        places
    }

    /// Pose of the sensor in the world (the URDF's root link), millimetres.
    ///
    /// `angles` are the joint values in the order of [`Self::joints`]; further values are ignored, missing
    /// ones taken as 0, so that a frame's three angles fit a finger with fewer joints.
    pub fn sensor_pose_mm(&self, angles: &[f64]) -> Isometry3<f64> {
        let chain = self
            .joints
            .iter()
            .zip(angles.iter().copied().chain(std::iter::repeat(0.0)))
            .fold(Isometry3::identity(), |pose, (joint, value)| {
                pose * joint.placement_mm * joint.motion(value)
            });
        chain * self.sensor_placement_mm
    }

    /// Pose of the tip in the world: origin at the tip's centre, axes as the sensor's, millimetres.
    ///
    /// Angles as in [`Self::sensor_pose_mm`].
    pub fn tip_pose_mm(&self, angles: &[f64]) -> Isometry3<f64> {
        self.sensor_pose_mm(angles) * Translation3::from(self.tip_in_sensor_mm)
    }

    /// A contact reported in tip coordinates, in the world.
    ///
    /// `contact_mm` is measured from the tip's centre, `tip_normal` is the tip's outward unit normal there.
    pub fn world_contact(
        &self,
        angles: &[f64],
        contact_mm: &Vec3,
        tip_normal: &Vec3,
    ) -> WorldContact {
        let pose = self.tip_pose_mm(angles);
        WorldContact {
            position_mm: pose.transform_point(&(*contact_mm).into()).coords,
            normal: -(pose.rotation * tip_normal),
        }
    }

    /// Whether the joint values are all within the URDF's limits. Values as in [`Self::sensor_pose_mm`].
    pub fn within_limits(&self, angles: &[f64]) -> bool {
        self.joints
            .iter()
            .zip(angles)
            .all(|(joint, &value)| joint.limits.0 <= value && value <= joint.limits.1)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Hand;
    use crate::Vec3;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn shipped() -> Hand {
        Hand::from_urdf(Hand::THREE_FINGER_URDF, "three_finger.urdf").unwrap()
    }

    #[test]
    fn stretched_finger_points_through_the_centre() {
        // Base on the ring at 300 mm, links of 190 and 260 mm stretched towards the centre.
        let hand = shipped();
        for (k, finger) in hand.fingers().iter().enumerate() {
            let pose = finger.tip_pose_mm(&[0.0; 3]);
            let (sin, cos) = (2.0 * PI * k as f64 / 3.0).sin_cos();
            let expected = Vec3::new(cos, sin, 0.0) * (300.0 - 450.0);
            assert!((pose.translation.vector - expected).norm() < 1e-9);
            let pole = pose.rotation * Vec3::z();
            assert!((pole + Vec3::new(cos, sin, 0.0)).norm() < 1e-12);
        }
    }

    #[test]
    fn bent_finger_by_hand() {
        // Index at (300, 0, 0) facing -x. Yaw 90 degrees: it faces -y. Shoulder -90 degrees (about its y axis,
        // right-handed, x turns up to +z): the upper link stands up, elbow at (300, 0, 190). Elbow +90 degrees:
        // the fore link lies along the base's x again, so the tip is 260 mm along -y, pole along -y.
        let hand = shipped();
        let (_, index) = hand.finger("index").unwrap();
        let pose = index.tip_pose_mm(&[FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2]);
        assert!((pose.translation.vector - Vec3::new(300.0, -260.0, 190.0)).norm() < 1e-9);
        assert!((pose.rotation * Vec3::z() - Vec3::new(0.0, -1.0, 0.0)).norm() < 1e-12);
        // Sensor x after the plate's quarter turn about y: it was the link's -z.
        assert!((pose.rotation * Vec3::x() - Vec3::new(0.0, 0.0, -1.0)).norm() < 1e-12);
        let chain = index.chain_mm(&[FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2]);
        let elbow = Vec3::new(300.0, 0.0, 190.0);
        assert!(chain.len() == 5 && (chain[2] - elbow).norm() < 1e-9);
        assert!((chain[4] - pose.translation.vector).norm() < 1e-9);
        let sensor = index.sensor_pose_mm(&[FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2]);
        assert!((sensor.translation.vector - Vec3::new(300.0, -245.0, 190.0)).norm() < 1e-9);
    }

    #[test]
    fn contact_at_the_pole_is_a_radius_ahead_and_faces_back() {
        let hand = shipped();
        let (_, index) = hand.finger("index").unwrap();
        let contact = index.world_contact(&[0.0; 3], &Vec3::new(0.0, 0.0, 20.0), &Vec3::z());
        assert!((contact.position_mm - Vec3::new(-170.0, 0.0, 0.0)).norm() < 1e-9);
        assert!((contact.normal - Vec3::x()).norm() < 1e-12);
    }

    #[test]
    fn sliding_joints_and_short_chains_are_understood() {
        let urdf = r#"<robot name="gantry">
            <link name="base"/><link name="slide"/><link name="x_tip"/>
            <joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/>
              <origin xyz="0.1 0 0"/><axis xyz="0 2 0"/><limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
            <joint name="cap" type="fixed"><parent link="slide"/><child link="x_tip"/><origin xyz="0 0 0.03"/></joint>
            </robot>"#;
        let hand = Hand::from_urdf(urdf, "gantry.urdf").unwrap();
        let (_, finger) = hand.finger("x").unwrap();
        assert_eq!(finger.joints.len(), 1);
        assert!((finger.tip_in_sensor_mm - Vec3::new(0.0, 0.0, 30.0)).norm() < 1e-12);
        let pose = finger.tip_pose_mm(&[0.25, 9.0, 9.0]);
        assert!((pose.translation.vector - Vec3::new(100.0, 250.0, 30.0)).norm() < 1e-9);
        assert!(finger.within_limits(&[0.5]) && !finger.within_limits(&[0.6]));
    }
}
