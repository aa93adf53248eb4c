//! A finger that slides over a ball: the world behind the emulated chips, and the truth to hold contacts against.
//!
//! The finger is the index of the hand that comes with the host, read from its URDF. It hovers until it is told to set
//! down, and then follows a spiral over a cap of the ball, in and out. Wrenches come from the forward model of intrinsic contact sensing: force f at
//! the contact, spin moment along the normal, both seen from the sensor's origin. Gauges answer linearly through a crosstalk matrix with an offset each.

use super::ads122u04::Input;
use super::chips::World;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use palpus_host::hand::Finger;
use palpus_protocol::Calibration;
use std::time::Duration;

type Vec3 = Vector3<f64>;

/// Volts of one count at gain 128 and 3.3 V.
const VOLTS_PER_COUNT: f64 = 3.3 / 128.0 / 8_388_608.0;

/// How the finger moves and presses.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Radius of the ball, mm.
    pub ball_mm: f64,
    /// Centre of the ball in the world, mm.
    pub centre_mm: [f64; 3],
    /// Middle of the cap, seen from the ball's centre.
    pub pole: [f64; 3],
    /// Half angle of the cap, rad.
    pub cap_rad: f64,
    /// Distance of the spiral's turns along the ball, mm.
    pub pitch_mm: f64,
    /// Speed of the contact along the ball, mm/s.
    pub speed_mm_s: f64,
    /// Normal force, N.
    pub force_n: f64,
    /// Friction force along the motion, as a part of the normal force.
    pub friction: f64,
    /// Spin moment per newton of normal force, mm.
    pub spin_mm: f64,
    /// Standard deviation of a gauge, counts; the last bit of the converter flickers in any case.
    pub noise_counts: f64,
}

impl Motion {
    /// A ball of 120 mm in the middle of the hand, its upper side towards the index finger, pressed with 3 N.
    pub const STANDARD: Self = Self {
        ball_mm: 60.0,
        centre_mm: [0.0, 0.0, 0.0],
        pole: [0.55, 0.0, 0.83],
        cap_rad: 0.75,
        pitch_mm: 5.0,
        speed_mm_s: 30.0,
        force_n: 3.0,
        friction: 0.25,
        spin_mm: 0.4,
        noise_counts: 0.0,
    };
}

/// What is wrong with a gauge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GaugeFault {
    /// Nothing.
    #[default]
    None,
    /// Overloaded: beyond the converter's range.
    Saturated,
    /// A wire is off.
    Open,
}

/// The sliding finger.
pub struct SlidingFinger {
    finger: Finger,
    motion: Motion,
    time_s: f64,
    turn_rad: f64,
    outwards: bool,
    joints: [f64; 3],
    wrench: Vector6<f64>,
    offsets: [f64; 6],
    noise: u64,
    counts: [f64; 6],
    /// Faults by gauge.
    pub faults: [GaugeFault; 6],
    /// Since when the finger is set down.
    down_since_s: Option<f64>,
}

impl SlidingFinger {
    /// The index finger of this hand's file.
    pub fn new(finger: Finger, motion: Motion) -> Self {
        let mut slide = Self {
            finger,
            motion,
            time_s: 0.0,
            turn_rad: 0.0,
            outwards: true,
            // Elbow up, tip over the ball: where Newton's method starts.
            joints: [0.0, -1.4, 2.2],
            wrench: Vector6::zeros(),
            offsets: [31_000.0, -52_000.0, 8_000.0, 120_000.0, -77_000.0, 4_000.0],
            noise: 0x9e37_79b9_7f4a_7c15,
            counts: [0.0; 6],
            faults: [GaugeFault::None; 6],
            down_since_s: None,
        };
        // From the start to the first place in small steps, so that the elbow stays up.
        slide.place(0.0);
        slide
    }

    /// Counts per N and per N mm: six gauges, each most sensitive to another axis, with a fifth of crosstalk.
    fn sensitivity() -> Matrix6<f64> {
        let mut matrix = Matrix6::from_fn(|gauge, axis| {
            let crosstalk = [0.21, -0.13, 0.17, -0.08, 0.11, -0.19][(2 * gauge + 3 * axis) % 6];
            if gauge == axis { 1.0 } else { crosstalk }
        });
        for axis in 0..6 {
            let scale = if axis < 3 { 21_500.0 } else { 1_100.0 };
            matrix.column_mut(axis).scale_mut(scale);
        }
        matrix
    }

    /// The calibration that undoes the sensitivity.
    pub fn calibration(id: u32) -> Calibration {
        let inverse = Self::sensitivity()
            .try_inverse()
            .unwrap_or_else(Matrix6::zeros);
        let rows: Vec<f32> = (0..6)
            .flat_map(|row| (0..6).map(move |column| (row, column)))
            .map(|at| inverse[at] as f32)
            .collect();
        Calibration::sealed(id, 6, &rows).unwrap_or_else(|error| panic!("{error}"))
    }

    /// A calibration that knows each gauge's main axis and nothing of the crosstalk.
    pub fn naive_calibration(id: u32) -> Calibration {
        let sensitivity = Self::sensitivity();
        let entries: Vec<f32> = (0..36)
            .map(|at| {
                if at % 7 == 0 {
                    (1.0 / sensitivity[(at / 7, at / 7)]) as f32
                } else {
                    0.0
                }
            })
            .collect();
        Calibration::sealed(id, 6, &entries).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Known loads with the tared counts they give, as a table for `palpus board PORT calibrate`: weights hung on the tip in many
    /// directions and at many places, each read with noise of this standard deviation.
    pub fn load_table(&mut self, loads: usize, noise_counts: f64) -> String {
        let mut table = String::from("fx,fy,fz,mx,my,mz,g1,g2,g3,g4,g5,g6\n");
        for _ in 0..loads {
            let mut random = |scale: f64| {
                Vec3::new(self.next_random(), self.next_random(), self.next_random()) * scale
            };
            let (force, arm, spin) = (random(12.0), random(60.0), random(40.0));
            let moment = arm.cross(&force) + spin;
            let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            let clean = Self::sensitivity() * wrench;
            let cells: Vec<String> = wrench
                .iter()
                .map(|value| format!("{value:.6}"))
                .chain(clean.iter().map(|count| {
                    let normal: f64 = (0..12).map(|_| self.next_random()).sum();
                    format!("{:.1}", count + normal * noise_counts)
                }))
                .collect();
            table += &cells.join(",");
            table.push('\n');
        }
        table
    }

    /// The finger.
    pub const fn finger(&self) -> &Finger {
        &self.finger
    }

    /// The world's time, s.
    pub const fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Sets the finger down; it begins to slide 0.7 s later, where it last was.
    pub const fn set_down(&mut self) {
        if self.down_since_s.is_none() {
            self.down_since_s = Some(self.time_s);
        }
    }

    /// Lifts the finger and takes it back to the middle of the cap, to slide at another speed.
    pub const fn begin_again(&mut self, speed_mm_s: f64) {
        self.lift();
        self.turn_rad = 0.0;
        self.outwards = true;
        self.motion.speed_mm_s = speed_mm_s;
    }

    /// Lifts the finger.
    pub const fn lift(&mut self) {
        self.down_since_s = None;
    }

    /// Contact point from the tip's centre in tip axes, for these joint angles, if the ball is touched there; mm.
    pub fn true_contact_mm(
        finger: &Finger,
        motion: &Motion,
        joints: &[f64; 3],
        tip_mm: f64,
    ) -> Vec3 {
        let pose = finger.tip_pose_mm(joints);
        let towards = Vec3::from(motion.centre_mm) - pose.translation.vector;
        pose.rotation.inverse() * (towards.normalize() * tip_mm)
    }

    fn next_random(&mut self) -> f64 {
        self.noise ^= self.noise << 13;
        self.noise ^= self.noise >> 7;
        self.noise ^= self.noise << 17;
        (self.noise >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }

    /// Direction from the ball's centre at this turn of the spiral.
    fn direction(&self, turn_rad: f64) -> Vec3 {
        let pole = Vec3::from(self.motion.pole).normalize();
        let side = pole.cross(&Vec3::y()).normalize();
        let other = pole.cross(&side);
        let polar = turn_rad * self.motion.pitch_mm / self.motion.ball_mm / core::f64::consts::TAU;
        pole * polar.cos() + (side * turn_rad.cos() + other * turn_rad.sin()) * polar.sin()
    }

    /// Joint angles that put the tip's centre at a place: Newton's method with differences.
    fn reach(&mut self, place: &Vec3) {
        for _ in 0..40 {
            let miss = place - self.finger.tip_pose_mm(&self.joints).translation.vector;
            if miss.norm() < 1e-9 {
                return;
            }
            let step = 1e-6;
            let jacobian = Matrix3::from_columns(&[0, 1, 2].map(|joint| {
                let mut moved = self.joints;
                moved[joint] += step;
                let mut back = self.joints;
                back[joint] -= step;
                (self.finger.tip_pose_mm(&moved).translation.vector
                    - self.finger.tip_pose_mm(&back).translation.vector)
                    / (2.0 * step)
            }));
            let Some(inverse) = jacobian.try_inverse() else {
                return;
            };
            let change = inverse * miss;
            let scale = (0.2 / change.amax()).min(1.0);
            for joint in 0..3 {
                self.joints[joint] += scale * change[joint];
            }
        }
    }

    /// Moves the finger to where it is at a time, and makes its wrench.
    fn place(&mut self, time_s: f64) {
        let step_s = (time_s - self.time_s).max(0.0);
        self.time_s = time_s;
        let motion = self.motion;
        let tip_mm = 20.0;
        // Down in 0.4 s, pressed in another 0.3 s, then it slides.
        let down_s = self.down_since_s.map_or(0.0, |since_s| time_s - since_s);
        let height_mm = 10.0 * (1.0 - down_s / 0.4).max(0.0);
        let press = ((down_s - 0.4) / 0.3).clamp(0.0, 1.0);
        if press >= 1.0 {
            let per_turn = motion.pitch_mm / core::f64::consts::TAU;
            let polar = self.turn_rad * per_turn / motion.ball_mm;
            let path_per_rad = per_turn.hypot(motion.ball_mm * polar.sin());
            let change = motion.speed_mm_s * step_s / path_per_rad;
            self.turn_rad += if self.outwards { change } else { -change };
            if polar > motion.cap_rad {
                self.outwards = false;
            } else if self.turn_rad <= 0.0 {
                self.turn_rad = 0.0;
                self.outwards = true;
            }
        }
        let direction = self.direction(self.turn_rad);
        let ahead = self.direction(self.turn_rad + 1e-4) - direction;
        self.reach(
            &(Vec3::from(motion.centre_mm) + direction * (motion.ball_mm + tip_mm + height_mm)),
        );

        let pose: Isometry3<f64> = self.finger.tip_pose_mm(&self.joints);
        let contact = Self::true_contact_mm(&self.finger, &motion, &self.joints, tip_mm);
        let normal = contact / tip_mm;
        let normal_n = motion.force_n * press;
        // Friction holds the tip back.
        let along =
            pose.rotation.inverse() * ahead.normalize() * if self.outwards { -1.0 } else { 1.0 };
        let along = (along - normal * along.dot(&normal)).normalize();
        let force = (along * motion.friction - normal) * normal_n;
        let moment = contact.cross(&force)
            + normal * (motion.spin_mm * normal_n)
            + self.finger.tip_in_sensor_mm.cross(&force);
        self.wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        let clean = Self::sensitivity() * self.wrench;
        for gauge in 0..6 {
            self.counts[gauge] = clean[gauge] + self.offsets[gauge];
        }
    }
}

impl World for SlidingFinger {
    fn advance(&mut self, time: Duration) {
        // In steps of 5 ms at most, so that a pause of the machine is no jump for the solver.
        let target = time.as_secs_f64();
        while self.time_s + 5e-3 < target {
            let next = self.time_s + 5e-3;
            self.place(next);
        }
        self.place(target);
    }

    fn gauge(&mut self, gauge: usize) -> Input {
        match self.faults[gauge] {
            GaugeFault::None => {
                // The sum of twelve even ones is close to normal; the last bit flickers in every conversion.
                let normal: f64 = (0..12).map(|_| self.next_random()).sum();
                let noise = normal * self.motion.noise_counts + self.next_random() * 2.0;
                Input::Volts((self.counts[gauge] + noise) * VOLTS_PER_COUNT)
            }
            GaugeFault::Saturated => Input::Volts(30e-3),
            GaugeFault::Open => Input::Open,
        }
    }

    fn joint_rad(&self, joint: usize) -> f64 {
        self.joints[joint]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpus_host::hand::Hand;

    fn index() -> Finger {
        let hand = Hand::read(&super::super::hand_file()).expect("the shipped hand");
        hand.finger("index").expect("an index finger").1.clone()
    }

    #[test]
    fn the_finger_follows_the_ball_within_its_reach() {
        let mut slide = SlidingFinger::new(index(), Motion::STANDARD);
        slide.set_down();
        let mut lowest_pole = f64::MAX;
        for tick in 0..12_000 {
            slide.place(f64::from(tick) * 5e-3);
            if tick < 200 {
                continue;
            }
            let tip = slide.finger.tip_pose_mm(&slide.joints);
            let distance = (tip.translation.vector - Vec3::from(Motion::STANDARD.centre_mm)).norm();
            assert!((distance - 80.0).abs() < 1e-6, "tick {tick}: {distance}");
            assert!(
                slide.finger.within_limits(&slide.joints),
                "tick {tick}: {:?}",
                slide.joints
            );
            let contact =
                SlidingFinger::true_contact_mm(&slide.finger, &slide.motion, &slide.joints, 20.0);
            lowest_pole = lowest_pole.min(contact.z);
        }
        // The contact stays on the tip's hemisphere, with room to spare.
        assert!(lowest_pole > 2.0, "{lowest_pole}");
    }
}
