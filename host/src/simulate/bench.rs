//! One simulated finger: motion, gauges and encoders around a real firmware board. Knows no thread and no port.

use super::SimulateError;
use super::finger::Reacher;
use super::fingertip::{HeldGauges, HeldJoints, Rubbing, wrench_at_sensor};
use super::gauges::{GAUGES, Gauges};
use super::hand::Noise;
use super::motion::{Moment, Motion};
use crate::Vec3;
use palpus_firmware::store::{self, RamStore};
use palpus_firmware::{Board, BoardConfig};
use palpus_protocol::{
    Calibration, Command, HostMessage, MAX_FRAME_BYTES, Request, TareRequest, TipGeometry,
};

/// Readings of the tare that the simulated operator takes before anybody connects.
const TARE_SAMPLES: u16 = 200;
/// Most periods that tare may take, rounds of averaging included.
const TARE_PERIODS: u32 = 1000;
/// Periods the finger waits at home after the host has asked for contacts, so that a host that wants its own
/// tare can take it: half a second.
const WAIT: u32 = 100;

/// What was true when a contact was made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueContact {
    /// The board's sequence number of the contact.
    pub sequence: u32,
    /// Where the object was touched, millimetres, in the world.
    pub position_mm: Vec3,
    /// The object's outward normal there.
    pub normal: Vec3,
    /// Normal force, N.
    pub normal_force_n: f64,
}

/// A finger with its board.
pub(crate) struct FingerBench {
    board: Board<HeldGauges, HeldJoints, RamStore>,
    motion: Motion,
    gauges: Gauges,
    rubbing: Rubbing,
    period_us: u64,
    periods: u64,
    streaming_for: u32,
}

impl FingerBench {
    /// A tared, calibrated finger at home, its board's clock at `now_us` (well above 0).
    pub(crate) fn new(
        number: u8,
        motion: Motion,
        noise: &Noise,
        rubbing: Rubbing,
        tip_radius_mm: f64,
        period_us: u32,
        seed: u64,
        now_us: u64,
    ) -> Result<Self, SimulateError> {
        let finger = motion.reacher().finger();
        let mut gauges = Gauges::new(noise.gauges, seed);
        let offset = finger.tip_in_sensor_mm.map(|v| v as f32);
        let tip = TipGeometry {
            semi_axes_mm: [tip_radius_mm as f32; 3],
            centre_offset_mm: offset.into(),
        };
        let mut board_id = *b"SIM\0\0\0\0\0\0\0\0\0";
        board_id[3] = number;
        board_id[4..].copy_from_slice(&seed.to_le_bytes());
        let mut config = BoardConfig::new(board_id, number, &finger.name, tip);
        config.period_us = period_us;
        if noise.gauges.noise_counts == 0.0 {
            // A gauge without noise repeats its counts and is not stuck.
            config.stuck_after = 0;
        }
        let refused = |reason: String| SimulateError::Board {
            finger: finger.name.clone(),
            reason,
        };
        let calibration =
            Calibration::sealed(1 + u32::from(number), GAUGES as u8, &gauges.calibration())
                .map_err(|e| refused(e.to_string()))?;
        let mut store = RamStore::new();
        store::save(&mut store, &calibration).map_err(|e| refused(e.to_string()))?;
        let mut joints = HeldJoints::new(noise.encoder_bits);
        joints.hold(&motion.at_home().angles, 0);
        let start_us = now_us.saturating_sub(u64::from(period_us) * u64::from(TARE_PERIODS));
        let board = Board::new(config, HeldGauges::new(), joints, store, start_us)
            .map_err(|e| refused(e.to_string()))?;
        gauges.read(&Vec3::zeros(), &Vec3::zeros(), 0.0);
        let mut bench = Self {
            board,
            motion,
            gauges,
            rubbing,
            period_us: u64::from(period_us),
            periods: 0,
            streaming_for: 0,
        };
        bench.tare_at_home(start_us, now_us)?;
        Ok(bench)
    }

    /// What an operator does before anybody connects: a tare with the finger in the air, by the board's own
    /// command, over in a moment because nobody watches the clock.
    fn tare_at_home(&mut self, start_us: u64, now_us: u64) -> Result<(), SimulateError> {
        let request = HostMessage::Request(Request {
            request_id: 1,
            command: Command::Tare(TareRequest {
                samples: TARE_SAMPLES,
                force: false,
            }),
        });
        let mut wire = [0; MAX_FRAME_BYTES];
        let finger = self.motion.reacher().finger().name.clone();
        let refused = |reason: String| SimulateError::Board {
            finger: finger.clone(),
            reason,
        };
        let length = request
            .encode(&mut wire)
            .map_err(|e| refused(e.to_string()))?;
        self.board.receive(&wire[..length], start_us);
        let mut time_us = start_us;
        for _ in 0..TARE_PERIODS - 1 {
            time_us += self.period_us;
            self.sense(&self.motion.at_home(), time_us.min(now_us));
        }
        while self.board.take_frame(now_us).is_some() {}
        let tared = self.board.last_contact().is_some_and(|contact| {
            !contact
                .flags
                .intersects(palpus_protocol::ContactFlags::NOT_TARED)
        });
        if tared {
            Ok(())
        } else {
            Err(refused(
                "the tare in the air failed; lower the noise".into(),
            ))
        }
    }

    /// One period of the board at `moment`; returns what was true.
    fn sense(&mut self, moment: &Moment, now_us: u64) -> Option<TrueContact> {
        self.periods += 1;
        let finger = self.motion.reacher().finger();
        let (force, about) = wrench_at_sensor(finger, moment, &self.rubbing, self.periods);
        let reading = self
            .gauges
            .read(&force, &about, self.period_us as f64 * 1e-6);
        self.board.gauges_mut().hold(reading, now_us);
        self.board.joints_mut().hold(&moment.angles, now_us);
        self.board.tick(now_us);
        let sequence = self.board.last_contact()?.sequence;
        let foot = moment.contact?;
        Some(TrueContact {
            sequence,
            position_mm: foot.position_mm,
            normal: foot.normal,
            normal_force_n: moment.normal_force_n,
        })
    }

    /// One period: moves on while the host is listening (when it stops, the finger goes
    /// home and begins anew), and lets the board sample. Returns what was true if
    /// anything was touched.
    pub(crate) fn period(&mut self, now_us: u64) -> Option<TrueContact> {
        let listening = self.board.streams().contact_every > 0;
        if listening {
            self.streaming_for = self.streaming_for.saturating_add(1);
        } else if self.streaming_for > 0 {
            self.streaming_for = 0;
            self.motion.restart();
        }
        let moment = if self.streaming_for > WAIT {
            self.motion.step()
        } else {
            self.motion.at_home()
        };
        self.sense(&moment, now_us)
    }

    /// Bytes from the host.
    pub(crate) fn receive(&mut self, bytes: &[u8], now_us: u64) {
        self.board.receive(bytes, now_us);
    }

    /// The next frame for the host.
    pub(crate) fn take_frame(&mut self, now_us: u64) -> Option<&[u8]> {
        self.board.take_frame(now_us)
    }

    /// How often the whole itinerary has been gone through.
    pub(crate) fn rounds(&self) -> u64 {
        self.motion.rounds()
    }

    /// The finger.
    pub(crate) fn reacher(&self) -> &Reacher {
        self.motion.reacher()
    }
}

#[cfg(test)]
mod tests {
    use super::super::hand::{HandOptions, plan};
    use super::super::object::Object;
    use super::*;
    use palpus_protocol::{BoardMessage, Contact, ContactFlags, Decoder, Streams};

    const TIP: f64 = 20.0;

    /// Root mean square and largest error of valid contacts at full force, in mm and degrees, with their
    /// number, over one round of all fingers; and how many were invalid there.
    struct Errors {
        point_rms_mm: f64,
        point_max_mm: f64,
        normal_rms_degrees: f64,
        normal_max_degrees: f64,
        /// Distance of the reported points from the object, whichever point of it was touched.
        off_surface_max_mm: f64,
        contacts: usize,
        invalid: usize,
    }

    fn explore(object: &str, noise: Noise, contacts: usize) -> Errors {
        let mut options = HandOptions::new(Object::named(object).unwrap());
        options.noise = noise;
        options.contacts = contacts;
        let plan = plan(&options).unwrap();
        let rubbing = Rubbing {
            friction: options.friction,
            spin_n_mm: options.spin_n_mm,
        };
        let mut errors = Errors {
            point_rms_mm: 0.0,
            point_max_mm: 0.0,
            normal_rms_degrees: 0.0,
            normal_max_degrees: 0.0,
            off_surface_max_mm: 0.0,
            contacts: 0,
            invalid: 0,
        };
        for (number, motion) in plan.motions.into_iter().enumerate() {
            let mut now_us = 60_000_000;
            let mut bench =
                FingerBench::new(number as u8, motion, &noise, rubbing, TIP, 5000, 7, now_us)
                    .unwrap();
            let start = HostMessage::Request(Request {
                request_id: 2,
                command: Command::Start(Streams {
                    contact_every: 1,
                    raw_every: 0,
                }),
            });
            let mut wire = [0; MAX_FRAME_BYTES];
            let length = start.encode(&mut wire).unwrap();
            bench.receive(&wire[..length], now_us);
            let mut decoder = Decoder::new();
            while bench.rounds() == 0 {
                now_us += 5000;
                let truth = bench.period(now_us);
                let mut received: Option<Contact> = None;
                while let Some(frame) = bench.take_frame(now_us) {
                    for &byte in frame {
                        if let Some(frame) = decoder.push(byte)
                            && let BoardMessage::Contact(contact) =
                                BoardMessage::try_from(frame.unwrap()).unwrap()
                        {
                            received = Some(contact);
                        }
                    }
                }
                let contact = received.expect("a contact every period");
                let Some(truth) = truth else {
                    assert!(!contact.is_valid(), "a contact in the air: {contact:?}");
                    continue;
                };
                assert_eq!(contact.sequence, truth.sequence);
                if truth.normal_force_n < 1.8 {
                    continue;
                }
                if !contact.is_valid() {
                    errors.invalid += 1;
                    continue;
                }
                let finger = bench.reacher().finger();
                let world = finger.world_contact(
                    &contact.joint_angles_rad.map(f64::from),
                    &Vec3::from(contact.point_mm.map(f64::from)),
                    &Vec3::from(contact.normal.map(f64::from)),
                );
                let point = (world.position_mm - truth.position_mm).norm();
                let normal = world.normal.angle(&truth.normal).to_degrees();
                errors.contacts += 1;
                errors.point_rms_mm += point * point;
                errors.normal_rms_degrees += normal * normal;
                errors.point_max_mm = errors.point_max_mm.max(point);
                errors.normal_max_degrees = errors.normal_max_degrees.max(normal);
                let off = options.object.foot(&world.position_mm).distance_mm.abs();
                errors.off_surface_max_mm = errors.off_surface_max_mm.max(off);
            }
        }
        let n = errors.contacts as f64;
        errors.point_rms_mm = (errors.point_rms_mm / n).sqrt();
        errors.normal_rms_degrees = (errors.normal_rms_degrees / n).sqrt();
        println!(
            "{object}: {} contacts ({} invalid), point rms {:.4} max {:.4} mm (off surface max {:.4}), normal rms {:.3} max {:.3} degrees",
            errors.contacts,
            errors.invalid,
            errors.point_rms_mm,
            errors.point_max_mm,
            errors.off_surface_max_mm,
            errors.normal_rms_degrees,
            errors.normal_max_degrees
        );
        errors
    }

    #[test]
    fn without_noise_the_whole_chain_is_within_50_um_and_0_2_degrees() {
        for object in ["torus", "mug", "cube"] {
            let errors = explore(object, Noise::none(), 1500);
            assert!(
                errors.point_max_mm < 0.05,
                "{object}: {} mm",
                errors.point_max_mm
            );
            assert!(
                errors.normal_max_degrees < 0.2,
                "{object}: {} degrees",
                errors.normal_max_degrees
            );
            assert!(errors.contacts > 1400, "{object}: {}", errors.contacts);
            assert_eq!(errors.invalid, 0, "{object}");
        }
    }

    #[test]
    fn with_standard_noise_contacts_are_within_half_a_millimetre_and_3_degrees_rms_at_2_n() {
        for object in ["torus", "mug"] {
            let errors = explore(object, Noise::standard(), 3000);
            assert!(
                errors.point_rms_mm < 0.5,
                "{object}: {} mm",
                errors.point_rms_mm
            );
            // Not better than the gauges and encoders can be, either.
            assert!(
                errors.point_rms_mm > 0.1,
                "{object}: {} mm",
                errors.point_rms_mm
            );
            assert!(
                errors.normal_rms_degrees < 3.0,
                "{object}: {}",
                errors.normal_rms_degrees
            );
            assert!(
                errors.invalid * 50 < errors.contacts,
                "{object}: {}",
                errors.invalid
            );
        }
    }

    #[test]
    fn without_a_tare_nothing_is_valid() {
        let options = HandOptions::new(Object::named("sphere").unwrap());
        let motion = plan(&options).unwrap().motions.remove(0);
        let rubbing = Rubbing {
            friction: 0.0,
            spin_n_mm: 0.0,
        };
        let bench = FingerBench::new(
            0,
            motion,
            &Noise::standard(),
            rubbing,
            TIP,
            5000,
            1,
            60_000_000,
        )
        .unwrap();
        // The operator's tare has been taken, and left nothing for the host to read.
        let contact = bench.board.last_contact().unwrap();
        assert!(!contact.flags.intersects(ContactFlags::NOT_TARED));
        assert!(!bench.board.has_output());
    }
}
