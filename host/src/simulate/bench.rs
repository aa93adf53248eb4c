//! One simulated finger: motion, gauges and encoders around a real firmware board. Knows no thread and no port.

use super::finger::Reacher;
use super::fingertip::{HeldGauges, HeldJoints, Rubbing, wrench_at_sensor};
use super::gauges::{GAUGES, Gauges};
use super::hand::Noise;
use super::motion::{Moment, Motion};
use super::SimulateError;
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
        let calibration = Calibration::sealed(1 + u32::from(number), GAUGES as u8, &gauges.calibration())
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
        let refused = |reason: String| SimulateError::Board { finger, reason };
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
            Err(refused("the tare in the air failed; lower the noise".into()))
        }
    }

    /// One period of the board at `moment`; returns what was true.
    fn sense(&mut self, moment: &Moment, now_us: u64) -> Option<TrueContact> {
        self.periods += 1;
        let finger = self.motion.reacher().finger();
        let (force, about) = wrench_at_sensor(finger, moment, &self.rubbing, self.periods);
        let reading = self.gauges.read(&force, &about, self.period_us as f64 * 1e-6);
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
