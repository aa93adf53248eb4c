//! One period: read, judge, tare, calibrate, solve, validate, encode, queue; and the clock's
//! honesty about it.

use crate::board::Board;
use crate::commands::PendingReply;
use crate::event::Event;
use crate::front_end::{
    GaugeFrontEnd, GaugeSample, JOINTS, JointFrontEnd, JointSample, JointState,
};
use crate::sensing::contact::ContactSolution;
use crate::sensing::uncertainty::WrenchNoise;
use crate::sensing::validity::ContactGate;
use crate::sensing::wrench::GaugeMatrix;
use crate::store::CalibrationStore;
use crate::tare::{Tare, TareProgress};
use heapless::Vec;
use palpus_protocol::{
    BoardMessage, CONTACT_FRAME_BYTES, CONTACT_SEQUENCE_MODULUS, CONTACT_TIME_MODULUS_US, Contact,
    ContactFlags, GaugeCounts, GaugeFlags, GaugeValue, MAX_GAUGES, Outcome, RawGauges, StorePlace,
};

/// Counters of sampling; see [`palpus_protocol::Statistics`].
#[derive(Clone, Debug, Default)]
pub(crate) struct SamplingCounters {
    pub ticks: u32,
    pub rate_millihertz: u32,
    pub jitter_rms_us: u32,
    pub jitter_max_us: u32,
    pub tick_max_us: u32,
    pub overruns: u32,
    pub late_ticks: u32,
    pub contacts: u32,
    pub contacts_valid: u32,
    pub raw_frames: u32,
    pub joint_errors: u32,
    gauges: [GaugeCounts; MAX_GAUGES],
}

/// What sampling remembers from period to period.
#[derive(Debug)]
pub(crate) struct Sampling {
    gauges: usize,
    period_us: u32,
    clock: SampleClock,
    pub tare: Tare,
    /// Whom to answer when the tare is done.
    pub tare_request_id: Option<u32>,
    pub gate: ContactGate,
    noise_floor: WrenchNoise,
    noise: WrenchNoise,
    last_counts: [i32; MAX_GAUGES],
    last_time_us: u64,
    unchanged: [u16; MAX_GAUGES],
    faulty: [GaugeFlags; MAX_GAUGES],
    joint_states: [JointState; JOINTS],
    chip_resets: u32,
    until_contact: u8,
    until_raw: u8,
    tick_began_us: u64,
    last_contact: Option<Contact>,
}

impl Sampling {
    pub fn new(gauges: usize, period_us: u32, noise_floor: WrenchNoise) -> Self {
        Self {
            gauges,
            period_us,
            clock: SampleClock::default(),
            tare: Tare::new(gauges, period_us),
            tare_request_id: None,
            gate: ContactGate::new(),
            noise_floor,
            noise: noise_floor,
            last_counts: [0; MAX_GAUGES],
            last_time_us: 0,
            unchanged: [0; MAX_GAUGES],
            faulty: [GaugeFlags::none(); MAX_GAUGES],
            joint_states: [JointState::Good; JOINTS],
            chip_resets: 0,
            until_contact: 0,
            until_raw: 0,
            tick_began_us: 0,
            last_contact: None,
        }
    }

    pub const fn last_contact(&self) -> Option<&Contact> {
        self.last_contact.as_ref()
    }

    /// Counters of one gauge with its zero as it is now.
    pub fn gauge_counts(&self, gauge: usize, counters: &SamplingCounters) -> GaugeCounts {
        let counted = counters.gauges.get(gauge).copied().unwrap_or_default();
        GaugeCounts {
            tare_counts: self.tare.offset_counts(gauge),
            drift_counts: libm::roundf(self.tare.drift_counts(gauge)) as i32,
            ..counted
        }
    }

    /// The streams begin anew: the next period is sent.
    pub const fn restart_streams(&mut self) {
        self.until_contact = 0;
        self.until_raw = 0;
    }

    /// A new matrix: what noise the gauges' counts stand for.
    pub fn calibrated(&mut self, matrix: &GaugeMatrix) {
        self.tare
            .set_noise_floor(&matrix.counts_of(&self.noise_floor));
        self.judge_noise(matrix);
    }

    /// Noise of the wrench: what the gauges showed while taring, and no less than the floor.
    fn judge_noise(&mut self, matrix: &GaugeMatrix) {
        let (force_n, moment_n_mm) = matrix.noise(self.tare.noise_counts());
        self.noise = WrenchNoise {
            force_n,
            moment_n_mm,
        }
        .at_least(&self.noise_floor);
    }

    /// Judges age and lack of change of each gauge, on top of what the front end saw.
    fn judge_gauges(
        &mut self,
        sample: &GaugeSample,
        now_us: u64,
        stuck_after: u16,
    ) -> [GaugeFlags; MAX_GAUGES] {
        let mut flags = sample.flags;
        let late = now_us.saturating_sub(sample.time_us) > u64::from(self.period_us) * 3 / 2;
        let fresh = sample.time_us != self.last_time_us;
        for gauge in 0..self.gauges {
            if flags[gauge].contains(GaugeFlags::MISSING) {
                self.unchanged[gauge] = 0;
                continue;
            }
            // One chip of several may be late: it repeats its count, which then says nothing.
            let converted = fresh && !flags[gauge].contains(GaugeFlags::LATE);
            if late {
                flags[gauge].insert(GaugeFlags::LATE);
            }
            if converted {
                let same = sample.counts[gauge] == self.last_counts[gauge];
                self.unchanged[gauge] = if same {
                    self.unchanged[gauge].saturating_add(1)
                } else {
                    0
                };
                self.last_counts[gauge] = sample.counts[gauge];
            }
            // A saturated gauge does not change either; that has its own name.
            if stuck_after > 0
                && self.unchanged[gauge] >= stuck_after
                && !flags[gauge].contains(GaugeFlags::SATURATED)
            {
                flags[gauge].insert(GaugeFlags::STUCK);
            }
        }
        self.last_time_us = sample.time_us;
        flags
    }
}

/// How well the periods keep their time.
#[derive(Clone, Debug, Default)]
struct SampleClock {
    last_us: Option<u64>,
    window_began_us: u64,
    window_ticks: u32,
    window_squares: u64,
}

impl SampleClock {
    /// Notes a tick; returns the periods skipped before it.
    fn tick(&mut self, now_us: u64, period_us: u32, counters: &mut SamplingCounters) -> u32 {
        counters.ticks = counters.ticks.wrapping_add(1);
        let Some(last_us) = self.last_us.replace(now_us) else {
            self.window_began_us = now_us;
            return 0;
        };
        let period = u64::from(period_us);
        let elapsed = now_us.saturating_sub(last_us);
        let skipped = ((elapsed + period / 2) / period).saturating_sub(1);
        let skipped = u32::try_from(skipped).unwrap_or(u32::MAX);
        if skipped > 0 {
            counters.overruns = counters.overruns.wrapping_add(skipped);
            counters.late_ticks = counters.late_ticks.wrapping_add(1);
        } else {
            let deviation = elapsed.abs_diff(period);
            counters.jitter_max_us = counters
                .jitter_max_us
                .max(u32::try_from(deviation).unwrap_or(u32::MAX));
            self.window_squares = self
                .window_squares
                .saturating_add(deviation.saturating_mul(deviation));
        }
        self.window_ticks += 1;
        let window_us = now_us.saturating_sub(self.window_began_us);
        if window_us >= 1_000_000 {
            let ticks = u64::from(self.window_ticks);
            counters.rate_millihertz =
                u32::try_from(ticks * 1_000_000_000 / window_us).unwrap_or(u32::MAX);
            counters.jitter_rms_us =
                libm::roundf(libm::sqrtf((self.window_squares / ticks) as f32)) as u32;
            *self = Self {
                last_us: Some(now_us),
                window_began_us: now_us,
                window_ticks: 0,
                window_squares: 0,
            };
        }
        skipped
    }
}

/// Counts the flags of one gauge.
fn count_gauge(counts: &mut GaugeCounts, flags: GaugeFlags) {
    for (flag, counter) in [
        (GaugeFlags::SATURATED, &mut counts.saturated),
        (GaugeFlags::OPEN, &mut counts.open),
        (GaugeFlags::STUCK, &mut counts.stuck),
        (GaugeFlags::MISSING, &mut counts.missing),
        (GaugeFlags::LATE, &mut counts.late),
    ] {
        if flags.contains(flag) {
            *counter = counter.wrapping_add(1);
        }
    }
    if flags.is_good() {
        counts.good = counts.good.wrapping_add(1);
    }
}

/// The contact's reasons that come from its gauges.
fn reasons(gauges: GaugeFlags) -> ContactFlags {
    let mut flags = ContactFlags::none();
    for (of_gauge, of_contact) in [
        (GaugeFlags::SATURATED, ContactFlags::GAUGE_SATURATED),
        (GaugeFlags::OPEN, ContactFlags::GAUGE_OPEN),
        (GaugeFlags::STUCK, ContactFlags::GAUGE_STUCK),
        (GaugeFlags::MISSING, ContactFlags::GAUGE_MISSING),
        (GaugeFlags::LATE, ContactFlags::GAUGE_LATE),
    ] {
        if gauges.contains(of_gauge) {
            flags.insert(of_contact);
        }
    }
    flags
}

/// Whether this period of a stream of every n-th is sent; counts down.
const fn is_due(every: u8, until: &mut u8) -> bool {
    if every == 0 {
        return false;
    }
    if *until == 0 {
        *until = every - 1;
        true
    } else {
        *until -= 1;
        false
    }
}

impl<G: GaugeFrontEnd, J: JointFrontEnd, S: CalibrationStore> Board<G, J, S> {
    /// Runs one period. `now_us` is the board time, which never goes back.
    pub fn tick(&mut self, now_us: u64) {
        self.sampling.tick_began_us = now_us;
        let skipped = self
            .sampling
            .clock
            .tick(now_us, self.config.period_us, &mut self.counters);
        if skipped > 0 {
            self.note(Event::Overrun { periods: skipped }, now_us);
        }
        let sample = self.gauges.sample(now_us);
        let joints = self.joints.sample(now_us);
        let gauge_flags = self
            .sampling
            .judge_gauges(&sample, now_us, self.config.stuck_after);
        let mut all_gauges = GaugeFlags::none();
        for gauge in 0..self.sampling.gauges {
            count_gauge(&mut self.counters.gauges[gauge], gauge_flags[gauge]);
            all_gauges = all_gauges.union(gauge_flags[gauge]);
        }
        self.note_faults(&gauge_flags, now_us);
        let joint_flags = self.judge_joints(&joints, now_us);

        self.advance_tare(&sample, &gauge_flags, now_us);
        let tared = self.sampling.tare.apply(&sample.counts);
        let mut flags = reasons(all_gauges).union(joint_flags);
        if skipped > 0 {
            flags.insert(ContactFlags::LATE_SAMPLE);
        }
        let contact = self.sense(&sample, &tared, all_gauges, &joints, flags);
        // Without a calibration nobody knows whether the tip is free.
        let free = self.matrix.is_some() && all_gauges.is_good() && !self.sampling.gate.is_loaded();
        self.sampling.tare.follow(&tared, free);

        if is_due(self.streams.contact_every, &mut self.sampling.until_contact) {
            self.queue_contact(&contact);
        }
        if is_due(self.streams.raw_every, &mut self.sampling.until_raw) {
            self.queue_raw(&sample, &tared, &gauge_flags);
        }
        self.sampling.last_contact = Some(contact);
    }

    /// Notes the end of a tick, for the longest time one took.
    pub fn tick_ended(&mut self, now_us: u64) {
        let took = now_us.saturating_sub(self.sampling.tick_began_us);
        self.counters.tick_max_us = self
            .counters
            .tick_max_us
            .max(u32::try_from(took).unwrap_or(u32::MAX));
    }

    /// Tells of gauges that went bad, of all being good again, and of chips found reset. While a gauge stays bad, each
    /// of its flags is told once; gauges with the same new flag are told together.
    fn note_faults(&mut self, flags: &[GaugeFlags; MAX_GAUGES], now_us: u64) {
        let told = self.sampling.faulty;
        let gauges = self.sampling.gauges;
        let is_new = |gauge: usize| !told[gauge].contains(flags[gauge]);
        if (0..gauges).any(is_new) {
            for (flag, _) in GaugeFlags::NAMES {
                let bits = (0..gauges)
                    .filter(|&gauge| flags[gauge].contains(flag) && !told[gauge].contains(flag))
                    .fold(0_u8, |bits, gauge| bits | 1 << gauge);
                if bits != 0 {
                    self.note(Event::GaugeFault { gauges: bits, flag }, now_us);
                }
            }
        }
        let was_faulty = told.iter().any(|flags| !flags.is_good());
        for gauge in 0..gauges {
            self.sampling.faulty[gauge] = if flags[gauge].is_good() {
                GaugeFlags::none()
            } else {
                told[gauge].union(flags[gauge])
            };
        }
        if was_faulty && self.sampling.faulty.iter().all(|flags| flags.is_good()) {
            self.note(Event::GaugesGood, now_us);
        }
        let resets = self.gauges.chip_resets();
        if resets != self.sampling.chip_resets {
            self.sampling.chip_resets = resets;
            self.note(Event::ChipReset { total: resets }, now_us);
        }
    }

    fn judge_joints(&mut self, joints: &JointSample, now_us: u64) -> ContactFlags {
        let mut flags = ContactFlags::none();
        let is_good = |states: &[JointState; JOINTS]| *states == [JointState::Good; JOINTS];
        if !is_good(&joints.states) {
            flags.insert(ContactFlags::JOINT_INVALID);
            self.counters.joint_errors = self.counters.joint_errors.wrapping_add(1);
        } else if now_us.saturating_sub(joints.time_us) > u64::from(self.config.period_us) * 3 / 2 {
            flags.insert(ContactFlags::JOINT_LATE);
        }
        // A joint is told when it goes bad, and when it becomes bad in another way.
        let told = core::mem::replace(&mut self.sampling.joint_states, joints.states);
        if told == joints.states {
            return flags;
        }
        for state in [JointState::Missing, JointState::BadCheck] {
            let bits = (0..JOINTS)
                .filter(|&joint| joints.states[joint] == state && told[joint] != state)
                .fold(0_u8, |bits, joint| bits | 1 << joint);
            if bits != 0 {
                self.note(
                    Event::JointFault {
                        joints: bits,
                        state,
                    },
                    now_us,
                );
            }
        }
        if is_good(&joints.states) {
            self.note(Event::JointsGood, now_us);
        }
        flags
    }

    fn advance_tare(
        &mut self,
        sample: &GaugeSample,
        flags: &[GaugeFlags; MAX_GAUGES],
        now_us: u64,
    ) {
        let good = flags.map(GaugeFlags::is_good);
        let outcome = match self.sampling.tare.advance(&sample.counts, &good) {
            TareProgress::Idle | TareProgress::Running => return,
            TareProgress::Done(tared) => {
                if let Some(matrix) = &self.matrix {
                    self.sampling.judge_noise(matrix);
                }
                self.note(
                    Event::Tared {
                        samples: tared.samples,
                    },
                    now_us,
                );
                Outcome::Tared(tared)
            }
            TareProgress::Failed(refusal) => {
                let request_id = self.sampling.tare_request_id.unwrap_or(0);
                self.note(
                    Event::Refused {
                        request_id,
                        refusal,
                    },
                    now_us,
                );
                Outcome::Refused(refusal)
            }
        };
        if let Some(request_id) = self.sampling.tare_request_id.take() {
            self.recent.settle(request_id, &outcome);
            self.replies.push(PendingReply::Outcome {
                request_id,
                outcome,
            });
        }
    }

    /// From tared counts to a contact, as far as the gauges allow.
    fn sense(
        &mut self,
        sample: &GaugeSample,
        tared: &[f32; MAX_GAUGES],
        gauges: GaugeFlags,
        joints: &JointSample,
        mut flags: ContactFlags,
    ) -> Contact {
        let sampling = &mut self.sampling;
        if !sampling.tare.is_taken() {
            flags.insert(ContactFlags::NOT_TARED);
        }
        if sampling.tare.is_running() {
            flags.insert(ContactFlags::TARING);
        }
        if sampling.tare.has_drifted() {
            flags.insert(ContactFlags::TARE_DRIFTED);
        }
        let mut solution = None;
        match &self.matrix {
            None => flags.insert(ContactFlags::CALIBRATION_MISSING),
            Some(matrix) if !gauges.contains(GaugeFlags::MISSING) => {
                if self.calibration_place == StorePlace::RamOnly {
                    flags.insert(ContactFlags::CALIBRATION_VOLATILE);
                }
                let at_sensor = matrix.wrench(tared);
                sampling.gate.judge_load(&at_sensor, &sampling.noise);
                if sampling.gate.is_loaded() {
                    flags.insert(ContactFlags::LOADED);
                }
                solution = self
                    .tip
                    .solve(&at_sensor.about(self.tip.centre_mm()))
                    .map(|solved| {
                        let sigma_mm = sampling.noise.point_sigma_mm(&self.tip, &solved);
                        flags.insert(sampling.gate.judge(
                            &solved,
                            sigma_mm,
                            &sampling.noise,
                            &self.config.limits,
                        ));
                        (solved, sigma_mm)
                    });
                if solution.is_none() {
                    flags.insert(ContactFlags::BELOW_FORCE_THRESHOLD);
                    sampling.gate.lose_contact();
                }
            }
            Some(_) => sampling.gate.lose_contact(),
        }
        // Without a solution the fields say nothing, in a form that any reader can print; the flags
        // say why.
        let (solved, sigma_mm) = solution.unwrap_or((ContactSolution::NONE, 0.0));
        Contact {
            sequence: self.counters.contacts % CONTACT_SEQUENCE_MODULUS,
            board_time_us: sample.time_us % CONTACT_TIME_MODULUS_US,
            point_mm: solved.point_mm.into(),
            normal: solved.normal.into(),
            normal_force_n: solved.normal_force_n,
            tangential_force_n: solved.tangential_force_n,
            spin_n_mm: solved.spin_n_mm,
            // A sigma beyond 65 mm says no more than 65 mm, and must not count as clipped: a free
            // tip has it all the time.
            sigma_mm: if sigma_mm < 65.0 { sigma_mm } else { 65.0 },
            joint_angles_rad: joints.angles_rad,
            flags,
        }
    }

    fn queue_contact(&mut self, contact: &Contact) {
        self.counters.contacts = self.counters.contacts.wrapping_add(1);
        if contact.is_valid() {
            self.counters.contacts_valid = self.counters.contacts_valid.wrapping_add(1);
        }
        let mut frame = [0; CONTACT_FRAME_BYTES];
        // A contact's frame has that length whatever its values; the protocol's tests pin it.
        if BoardMessage::Contact(*contact).encode(&mut frame).is_ok() {
            self.contacts.push(frame);
        }
    }

    fn queue_raw(
        &mut self,
        sample: &GaugeSample,
        tared: &[f32; MAX_GAUGES],
        flags: &[GaugeFlags; MAX_GAUGES],
    ) {
        let gauges: Vec<GaugeValue, MAX_GAUGES> = (0..self.sampling.gauges)
            .map(|gauge| GaugeValue {
                counts: sample.counts[gauge],
                tared_counts: libm::roundf(tared[gauge]) as i32,
                flags: flags[gauge],
            })
            .collect();
        let sequence = self.counters.raw_frames;
        self.counters.raw_frames = sequence.wrapping_add(1);
        self.raw.push(RawGauges {
            sequence,
            board_time_us: sample.time_us,
            gauges,
        });
    }
}
