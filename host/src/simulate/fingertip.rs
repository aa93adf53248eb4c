//! The sensor side of one simulated finger: from a touch to gauge counts and joint readings, as the front ends
//! of a real [`palpus_firmware::Board`].

use super::gauges::{GAUGES, Reading};
use super::motion::Moment;
use crate::Vec3;
use crate::hand::Finger;
use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JOINTS, JointFrontEnd, JointSample, JointState,
};
use palpus_protocol::{GaugeFlags, MAX_GAUGES};
use std::f64::consts::TAU;

/// What the surface does to a tip that slides over it, beside pushing back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rubbing {
    /// Tangential over normal force while sliding.
    pub friction: f64,
    /// Largest moment about the normal, N mm; it swings slowly between plus and minus this.
    pub spin_n_mm: f64,
}

/// Periods of one swing of the spin moment.
const SPIN_PERIODS: f64 = 611.0;

/// The wrench of the object on the tip at the sensor's origin, in sensor coordinates: N, N mm.
///
/// Force: the normal force along the object's normal, and friction against the sliding. Moment: the force's
/// about the sensor's origin, and the spin about the tip's outward normal.
pub(crate) fn wrench_at_sensor(
    finger: &Finger,
    moment: &Moment,
    rubbing: &Rubbing,
    period: u64,
) -> (Vec3, Vec3) {
    let Some(foot) = moment.contact else {
        return (Vec3::zeros(), Vec3::zeros());
    };
    let force = (foot.normal - moment.sliding * rubbing.friction) * moment.normal_force_n;
    // The moment about the normal grows with the normal force, full at 2 N.
    let share = (moment.normal_force_n / 2.0).min(1.0);
    let spin = rubbing.spin_n_mm * share * (period as f64 * TAU / SPIN_PERIODS).sin();
    let sensor = finger.sensor_pose_mm(&moment.angles);
    let lever = foot.position_mm - sensor.translation.vector;
    let about_sensor = lever.cross(&force) - foot.normal * spin;
    let turn = sensor.rotation.inverse();
    (turn * force, turn * about_sensor)
}

/// Gauges whose next reading is set from outside.
#[derive(Clone, Debug)]
pub(crate) struct HeldGauges {
    reading: Reading,
    time_us: u64,
}

impl HeldGauges {
    pub(crate) fn new() -> Self {
        Self {
            reading: Reading {
                counts: [0; GAUGES],
                saturated: [false; GAUGES],
            },
            time_us: 0,
        }
    }

    pub(crate) fn hold(&mut self, reading: Reading, time_us: u64) {
        self.reading = reading;
        self.time_us = time_us;
    }
}

impl GaugeFrontEnd for HeldGauges {
    fn gauges(&self) -> usize {
        GAUGES
    }

    fn sample(&mut self, _now_us: u64) -> GaugeSample {
        let mut sample = GaugeSample {
            time_us: self.time_us,
            counts: [0; MAX_GAUGES],
            flags: [GaugeFlags::none(); MAX_GAUGES],
        };
        for gauge in 0..GAUGES {
            sample.counts[gauge] = self.reading.counts[gauge];
            if self.reading.saturated[gauge] {
                sample.flags[gauge].insert(GaugeFlags::SATURATED);
            }
        }
        sample
    }
}

/// Joint encoders whose next reading is set from outside.
#[derive(Clone, Debug)]
pub(crate) struct HeldJoints {
    angles_rad: [f32; JOINTS],
    time_us: u64,
    /// Steps of a turn; `None` for encoders without end.
    steps: Option<f64>,
}

impl HeldJoints {
    /// Encoders of `bits` bits a turn, or ideal ones.
    pub(crate) fn new(bits: Option<u32>) -> Self {
        Self {
            angles_rad: [0.0; JOINTS],
            time_us: 0,
            steps: bits.map(|bits| 2f64.powi(bits.min(30) as i32)),
        }
    }

    pub(crate) fn hold(&mut self, angles: &[f64; 3], time_us: u64) {
        self.angles_rad = angles.map(|angle| match self.steps {
            Some(steps) => ((angle * steps / TAU).round() * TAU / steps) as f32,
            None => angle as f32,
        });
        self.time_us = time_us;
    }
}

impl JointFrontEnd for HeldJoints {
    fn sample(&mut self, _now_us: u64) -> JointSample {
        JointSample {
            time_us: self.time_us,
            angles_rad: self.angles_rad,
            states: [JointState::Good; JOINTS],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::object::Foot;
    use super::*;
    use crate::hand::Hand;

    #[test]
    fn a_touch_at_the_pole_by_hand() {
        let hand = Hand::from_urdf(Hand::THREE_FINGER_URDF, "three_finger.urdf").unwrap();
        let (_, index) = hand.finger("index").unwrap();
        // Stretched along -x: tip centre at x = -150, its pole at -170, the sensor at -135. The object's wall
        // faces +x. Sensor axes in the world: z along -x, x along -z, so y along -y.
        let foot = Foot {
            position_mm: Vec3::new(-170.0, 0.0, 0.0),
            normal: Vec3::x(),
            distance_mm: 20.0,
        };
        let moment = Moment {
            angles: [0.0; 3],
            centre_mm: Vec3::new(-150.0, 0.0, 0.0),
            contact: Some(foot),
            normal_force_n: 2.0,
            sliding: Vec3::y(),
        };
        let rubbing = Rubbing {
            friction: 0.5,
            spin_n_mm: 0.0,
        };
        let (force, about) = wrench_at_sensor(index, &moment, &rubbing, 0);
        // Pushed back along -z by 2 N; the tip slides along the world's +y, so friction drags it along the world's
        // -y, the sensor's +y, by 1 N on a lever of 35 mm along z: (0, 0, 35) x (0, 1, -2) = (-35, 0, 0).
        assert!((force - Vec3::new(0.0, 1.0, -2.0)).norm() < 1e-9, "{force}");
        assert!(
            (about - Vec3::new(-35.0, 0.0, 0.0)).norm() < 1e-9,
            "{about}"
        );

        let spinning = Rubbing {
            friction: 0.0,
            spin_n_mm: 3.0,
        };
        // A quarter of the swing: the whole spin, about the tip's outward normal, which is the sensor's z here.
        let (_, about) = wrench_at_sensor(index, &moment, &spinning, 153);
        assert!((about - Vec3::new(0.0, 0.0, 3.0)).norm() < 1e-3, "{about}");
    }

    #[test]
    fn encoders_round_to_their_steps() {
        let mut joints = HeldJoints::new(Some(14));
        let step = TAU / 16384.0;
        joints.hold(&[0.4 * step, 0.6 * step, -1.0], 7);
        let sample = joints.sample(7);
        assert_eq!(sample.time_us, 7);
        assert_eq!(sample.angles_rad[0], 0.0);
        assert!((f64::from(sample.angles_rad[1]) - step).abs() < 1e-9);
        assert!((f64::from(sample.angles_rad[2]) + 1.0).abs() < 0.5 * step + 1e-7);
        let mut ideal = HeldJoints::new(None);
        ideal.hold(&[0.1, 0.2, 0.3], 0);
        assert_eq!(ideal.sample(0).angles_rad, [0.1f32, 0.2, 0.3]);
    }
}
