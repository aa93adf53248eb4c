//! From a URDF (and an optional list of fingers) to a [`Hand`]: finds each tip's chain and checks it.

use super::kinematics::{Finger, FingerJoint, JointMotion, MAX_JOINTS};
use super::{Hand, HandError};
use crate::Vec3;
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion};
use std::collections::BTreeMap;
use urdf_rs::{Joint, JointType, Pose, Robot};

/// How far a tip's axes may be turned against its sensor's before the hand is refused, radians: the digits
/// people write pi/2 with leave 1e-4 at most, and 1e-3 rad would move a contact by 0.02 mm on a 20 mm tip.
const PARALLEL_RAD: f64 = 1e-3;

/// The JSON hand file.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FingerList {
    /// URDF, relative to the JSON.
    pub urdf: String,
    /// The fingers.
    pub fingers: Vec<FingerEntry>,
}

/// One finger of the JSON hand file.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FingerEntry {
    name: String,
    tip_link: String,
    #[serde(default)]
    sensor_link: Option<String>,
}

pub(super) fn parse_finger_list(text: &str, file: &str) -> Result<FingerList, HandError> {
    serde_json::from_str(text).map_err(|error| HandError::Json {
        file: file.to_owned(),
        reason: error.to_string(),
    })
}

pub(super) fn hand(
    text: &str,
    file: &str,
    fingers: Option<&[FingerEntry]>,
) -> Result<Hand, HandError> {
    let robot = urdf_rs::read_from_string(text).map_err(|error| HandError::Urdf {
        file: file.to_owned(),
        reason: error.to_string(),
    })?;
    let tree = Tree::new(&robot, file)?;
    let named = match fingers {
        Some(list) => list
            .iter()
            .map(|f| tree.finger(&f.name, &f.tip_link, f.sensor_link.as_deref()))
            .collect::<Result<Vec<_>, _>>()?,
        None => robot
            .links
            .iter()
            .filter_map(|link| Some((link.name.strip_suffix("_tip")?, &link.name)))
            .filter(|(name, _)| !name.is_empty())
            .map(|(name, tip)| {
                let sensor = format!("{name}_sensor");
                let sensor = tree.links.contains(&sensor.as_str()).then_some(sensor);
                tree.finger(name, tip, sensor.as_deref())
            })
            .collect::<Result<Vec<_>, _>>()?,
    };
    if named.is_empty() {
        return Err(HandError::NoFinger {
            file: file.to_owned(),
        });
    }
    for (k, finger) in named.iter().enumerate() {
        if named[..k].iter().any(|other| other.name == finger.name) {
            return Err(HandError::Chain {
                file: file.to_owned(),
                finger: finger.name.clone(),
                reason: "is named twice; give each finger a name of its own".into(),
            });
        }
    }
    Ok(Hand {
        name: robot.name,
        fingers: named,
    })
}

/// The URDF as a tree: each link's parent joint.
struct Tree<'a> {
    file: &'a str,
    links: Vec<&'a str>,
    parent_joint: BTreeMap<&'a str, &'a Joint>,
}

impl<'a> Tree<'a> {
    fn new(robot: &'a Robot, file: &'a str) -> Result<Self, HandError> {
        let mut parent_joint = BTreeMap::new();
        for joint in &robot.joints {
            if let Some(other) = parent_joint.insert(joint.child.link.as_str(), joint) {
                return Err(HandError::Urdf {
                    file: file.to_owned(),
                    reason: format!(
                        "link {} is the child of both joint {} and joint {}",
                        joint.child.link, other.name, joint.name
                    ),
                });
            }
        }
        Ok(Self {
            file,
            links: robot.links.iter().map(|link| link.name.as_str()).collect(),
            parent_joint,
        })
    }

    fn finger(&self, name: &str, tip: &str, sensor: Option<&str>) -> Result<Finger, HandError> {
        let refuse = |reason: String| HandError::Chain {
            file: self.file.to_owned(),
            finger: name.to_owned(),
            reason,
        };
        for link in std::iter::once(tip).chain(sensor) {
            if !self.links.contains(&link) {
                return Err(refuse(format!("link {link} does not exist in the URDF")));
            }
        }
        // Joints from the tip up to the root.
        let mut upward: Vec<&Joint> = Vec::new();
        let mut link = tip;
        while let Some(joint) = self.parent_joint.get(link) {
            if upward.len() >= self.parent_joint.len() {
                return Err(refuse(format!(
                    "the links above {tip} go round in a circle; a hand must be a tree"
                )));
            }
            upward.push(joint);
            link = &joint.parent.link;
        }
        let sensor = match sensor {
            Some(sensor) => sensor,
            None => upward
                .first()
                .map(|joint| joint.parent.link.as_str())
                .ok_or_else(|| {
                    refuse(format!(
                        "link {tip} hangs on no joint; connect it to the hand"
                    ))
                })?,
        };
        let from_sensor = upward
            .iter()
            .position(|joint| joint.parent.link == sensor)
            .map(|k| k + 1)
            .or((sensor == tip).then_some(0))
            .ok_or_else(|| refuse(format!("the sensor {sensor} is not above the tip {tip}")))?;
        let (tip_side, hand_side) = upward.split_at(from_sensor);

        let mut tip_placement = Isometry3::identity();
        for joint in tip_side.iter().rev() {
            if joint.joint_type != JointType::Fixed {
                return Err(refuse(format!(
                    "joint {} between the sensor and the tip is not fixed",
                    joint.name
                )));
            }
            tip_placement *= placement(joint).map_err(&refuse)?;
        }
        if tip_placement.rotation.angle() > PARALLEL_RAD {
            return Err(refuse(format!(
                "the tip is turned by {:.3} degrees against its sensor; give both links the same axes (the board \
                 reports contacts in the sensor's axes)",
                tip_placement.rotation.angle().to_degrees()
            )));
        }

        let mut joints = Vec::new();
        let mut pending = Isometry3::identity();
        for joint in hand_side.iter().rev() {
            pending *= placement(joint).map_err(&refuse)?;
            if let Some(motion) = motion(joint).map_err(&refuse)? {
                joints.push(FingerJoint {
                    name: joint.name.clone(),
                    motion,
                    limits: limits(joint).map_err(&refuse)?,
                    placement_mm: pending,
                    axis: axis(joint).map_err(&refuse)?,
                });
                pending = Isometry3::identity();
            }
        }
        if joints.is_empty() || joints.len() > MAX_JOINTS {
            return Err(refuse(format!(
                "{} movable joints between the root and the tip; a contact frame carries 1 to {MAX_JOINTS}",
                joints.len()
            )));
        }
        Ok(Finger {
            name: name.to_owned(),
            joints,
            sensor_placement_mm: pending,
            tip_in_sensor_mm: tip_placement.translation.vector,
        })
    }
}

/// A joint's origin, metres to millimetres; roll, pitch, yaw about the fixed axes x, y, z.
fn placement(joint: &Joint) -> Result<Isometry3<f64>, String> {
    let Pose { xyz, rpy } = &joint.origin;
    if let Some(bad) = xyz.iter().chain(rpy.iter()).find(|v| !v.is_finite()) {
        return Err(format!("joint {}: origin holds {bad}", joint.name));
    }
    Ok(Isometry3::from_parts(
        Translation3::from(Vec3::from(xyz.0) * 1000.0),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    ))
}

fn motion(joint: &Joint) -> Result<Option<JointMotion>, String> {
    if let Some(mimic) = &joint.mimic {
        return Err(format!(
            "joint {} mimics {}; coupled joints have no angle of their own in a contact frame",
            joint.name, mimic.joint
        ));
    }
    match joint.joint_type {
        JointType::Fixed => Ok(None),
        JointType::Revolute | JointType::Continuous => Ok(Some(JointMotion::Turn)),
        JointType::Prismatic => Ok(Some(JointMotion::Slide)),
        JointType::Floating | JointType::Planar | JointType::Spherical => Err(format!(
            "joint {} moves in more than one direction; use revolute, continuous, prismatic or fixed joints",
            joint.name
        )),
    }
}

fn axis(joint: &Joint) -> Result<Unit<Vec3>, String> {
    let axis = Vec3::from(joint.axis.xyz.0);
    Unit::try_new(axis, 1e-9)
        .filter(|unit| unit.iter().all(|v| v.is_finite()))
        .ok_or_else(|| {
            format!(
                "joint {}: axis {} {} {} has no direction",
                joint.name, axis.x, axis.y, axis.z
            )
        })
}

fn limits(joint: &Joint) -> Result<(f64, f64), String> {
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    if joint.joint_type == JointType::Continuous {
        return Ok((f64::NEG_INFINITY, f64::INFINITY));
    }
    if lower.is_nan() || upper.is_nan() || lower > upper {
        return Err(format!(
            "joint {}: limits {lower} to {upper} are not a range",
            joint.name
        ));
    }
    Ok((lower, upper))
}

#[cfg(test)]
mod tests {
    use super::super::{Hand, HandError};
    use proptest::prelude::*;

    fn refused(urdf: &str) -> String {
        Hand::from_urdf(urdf, "hand.urdf").unwrap_err().to_string()
    }

    fn chain(joints: &str) -> String {
        format!(
            r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="f_sensor"/><link name="f_tip"/>{joints}</robot>"#
        )
    }

    const TURN: &str = r#"<joint name="j1" type="revolute"><parent link="a"/><child link="f_sensor"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"#;

    #[test]
    fn what_is_wrong_is_named() {
        let message = refused(&chain(&format!(
            r#"{TURN}<joint name="cap" type="fixed"><parent link="f_sensor"/><child link="f_tip"/><origin rpy="0 0.5 0"/></joint>"#
        )));
        assert!(message.contains("turned by 28.648 degrees"), "{message}");
        let message = refused(&chain(&format!(
            r#"{TURN}<joint name="cap" type="revolute"><parent link="f_sensor"/><child link="f_tip"/><limit effort="1" velocity="1"/></joint>"#
        )));
        assert!(
            message.contains("joint cap between the sensor and the tip is not fixed"),
            "{message}"
        );
        let message = refused(&chain(
            r#"<joint name="p" type="fixed"><parent link="f_tip"/><child link="f_sensor"/></joint>
               <joint name="q" type="fixed"><parent link="f_sensor"/><child link="f_tip"/></joint>"#,
        ));
        assert!(message.contains("circle"), "{message}");
        let message = refused(&chain(
            r#"<joint name="q" type="fixed"><parent link="f_sensor"/><child link="f_tip"/><origin xyz="0 nan 0"/></joint>"#,
        ));
        assert!(
            message.contains("hand.urdf") && message.contains("joint q") && message.contains("NaN"),
            "{message}"
        );
        let message = refused(&chain(
            r#"<joint name="q" type="fixed"><parent link="f_sensor"/><child link="f_tip"/></joint>"#,
        ));
        assert!(message.contains("0 movable joints"), "{message}");
    }

    #[test]
    fn a_hand_without_tips_and_a_text_that_is_no_urdf() {
        let none = Hand::from_urdf(r#"<robot name="r"><link name="a"/></robot>"#, "x.urdf");
        assert!(matches!(none, Err(HandError::NoFinger { .. })));
        let text = Hand::from_urdf("solid cube", "x.urdf");
        assert!(matches!(text, Err(HandError::Urdf { .. })));
    }

    #[test]
    fn fingers_of_another_naming_come_from_json() {
        let folder = tempfile::tempdir().unwrap();
        let urdf = chain(&format!(
            r#"{TURN}<joint name="cap" type="fixed"><parent link="f_sensor"/><child link="c"/><origin xyz="0 0 0.04"/></joint>"#
        ));
        std::fs::write(folder.path().join("robot.urdf"), urdf).unwrap();
        let json = folder.path().join("hand.json");
        std::fs::write(
            &json,
            r#"{"urdf": "robot.urdf", "fingers": [{"name": "probe", "tip_link": "c", "sensor_link": "f_sensor"}]}"#,
        )
        .unwrap();
        let hand = Hand::read(&json).unwrap();
        let (index, finger) = hand.finger("probe").unwrap();
        assert_eq!(index, 0);
        assert!((finger.tip_in_sensor_mm.z - 40.0).abs() < 1e-12);

        std::fs::write(
            &json,
            r#"{"urdf": "robot.urdf", "fingers": [{"name": "probe"}]}"#,
        )
        .unwrap();
        let message = Hand::read(&json).unwrap_err().to_string();
        assert!(
            message.contains("tip_link") && message.contains("line 1"),
            "{message}"
        );
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(start in 0usize..4000, length in 0usize..200, garbage in ".{0,40}") {
            let urdf = Hand::THREE_FINGER_URDF;
            let start = start.min(urdf.len());
            let end = (start + length).min(urdf.len());
            // The shipped text is ASCII, so that every cut falls on a character.
            let broken = format!("{}{garbage}{}", &urdf[..start], &urdf[end..]);
            let _ = Hand::from_urdf(&broken, "broken.urdf");
            let _ = Hand::from_urdf(&garbage, "garbage.urdf");
        }
    }
}
