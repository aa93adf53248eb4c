//! The whole board on the host: simulated gauges and encoders in, frames out, commands and faults in between.

use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample, JointState,
};
use palpus_firmware::store::{CalibrationStore, RECORD_BYTES, RamStore, StoreError};
use palpus_firmware::{Board, BoardConfig};
use palpus_protocol::*;
use proptest::prelude::*;

const PERIOD_US: u64 = 5000;
const GAUGES: usize = 6;

/// Gauges that show what they are told, each as it is asked.
struct Gauges {
    counts: [i32; MAX_GAUGES],
    flags: [GaugeFlags; MAX_GAUGES],
    age_us: u64,
    resets: u32,
    noise: u64,
}

impl GaugeFrontEnd for Gauges {
    fn gauges(&self) -> usize {
        GAUGES
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        let mut counts = self.counts;
        if self.noise != 0 {
            for count in &mut counts {
                self.noise = self
                    .noise
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                *count += (self.noise >> 33) as i32 % 21 - 10;
            }
        }
        GaugeSample {
            time_us: now_us - self.age_us,
            counts,
            flags: self.flags,
        }
    }

    fn chip_resets(&self) -> u32 {
        self.resets
    }
}

struct Joints(JointSample);

impl JointFrontEnd for Joints {
    fn sample(&mut self, now_us: u64) -> JointSample {
        JointSample {
            time_us: now_us,
            ..self.0
        }
    }
}

/// Gauge counts per N and N mm: every gauge sees every axis, as a real sensor's do. Rows are gauges.
fn sensitivity() -> [[f64; 6]; 6] {
    core::array::from_fn(|gauge| {
        core::array::from_fn(|axis| {
            let scale = if axis < 3 { 20_000.0 } else { 1_000.0 };
            let cross = 0.05 * ((gauge * 5 + axis * 3) % 7) as f64 - 0.15;
            scale * (if gauge == axis { 1.0 } else { cross })
        })
    })
}

/// Inverse by Gauss-Jordan with pivots, row-major: the calibration's matrix.
fn inverse(mut a: [[f64; 6]; 6]) -> Vec<f32> {
    let mut b: [[f64; 6]; 6] =
        core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))));
    for column in 0..6 {
        let pivot = (column..6)
            .max_by(|&i, &j| a[i][column].abs().total_cmp(&a[j][column].abs()))
            .expect("rows");
        a.swap(column, pivot);
        b.swap(column, pivot);
        let scale = a[column][column];
        for j in 0..6 {
            a[column][j] /= scale;
            b[column][j] /= scale;
        }
        for i in (0..6).filter(|&i| i != column) {
            let factor = a[i][column];
            for j in 0..6 {
                a[i][j] -= factor * a[column][j];
                b[i][j] -= factor * b[column][j];
            }
        }
    }
    b.iter().flatten().map(|&value| value as f32).collect()
}

fn calibration(id: u32) -> Calibration {
    Calibration::sealed(id, GAUGES as u8, &inverse(sensitivity())).expect("sound")
}

const ZERO: [i32; 6] = [120_000, -340_000, 56_000, 7_000, -900_000, 1_000_000];

/// Counts of a wrench at the sensor.
fn counts(wrench: [f64; 6]) -> [i32; MAX_GAUGES] {
    let rows = sensitivity();
    core::array::from_fn(|gauge| {
        let Some(zero) = ZERO.get(gauge) else {
            return 0;
        };
        zero + (0..6)
            .map(|axis| rows[gauge][axis] * wrench[axis])
            .sum::<f64>()
            .round() as i32
    })
}

/// The wrench at the sensor of a frictionless push of `force` N at the tip (R = 20, centre at 35 mm), tilted about y by `degrees`.
fn push(force: f64, degrees: f64) -> [f64; 6] {
    let (s, c) = degrees.to_radians().sin_cos();
    let (fx, fz) = (-force * s, -force * c);
    // c x f is zero for a force along the normal; d x f = (0, 35 fx, 0).
    [fx, 0.0, fz, 0.0, 35.0 * fx, 0.0]
}

type TestBoard<S = RamStore> = Board<Gauges, Joints, S>;

struct Bench<S = RamStore> {
    board: TestBoard<S>,
    now_us: u64,
    next_id: u32,
    decoder: Decoder,
    heard: Vec<BoardMessage>,
}

impl Bench {
    fn new() -> Self {
        Self::with_store(RamStore::new())
    }
}

impl<S: CalibrationStore> Bench<S> {
    fn with_store(store: S) -> Self {
        Self::with_store_and_period(store, PERIOD_US as u32)
    }

    fn with_store_and_period(store: S, period_us: u32) -> Self {
        let tip = TipGeometry {
            semi_axes_mm: [20.0; 3],
            centre_offset_mm: [0.0, 0.0, 35.0],
        };
        let config = BoardConfig {
            period_us,
            ..BoardConfig::new(*b"0123456789ab", 1, "index", tip)
        };
        let gauges = Gauges {
            counts: counts([0.0; 6]),
            flags: [GaugeFlags::none(); MAX_GAUGES],
            age_us: 500,
            resets: 0,
            noise: 1,
        };
        let joints = JointSample {
            time_us: 0,
            angles_rad: [0.1, 0.2, 0.3],
            states: [JointState::Good; 3],
        };
        let board = Board::new(config, gauges, Joints(joints), store, 0).expect("sound");
        Self {
            board,
            now_us: 0,
            next_id: 100,
            decoder: Decoder::new(),
            heard: Vec::new(),
        }
    }

    /// Runs some periods, listening all the while.
    fn run(&mut self, periods: u32) {
        for _ in 0..periods {
            self.now_us += u64::from(self.board.config().period_us);
            self.board.tick(self.now_us);
            self.board.tick_ended(self.now_us + 100);
            self.listen();
        }
    }

    fn listen(&mut self) {
        while let Some(frame) = self.board.take_frame(self.now_us) {
            for &byte in frame {
                if let Some(result) = self.decoder.push(byte) {
                    self.heard.push(
                        BoardMessage::try_from(result.expect("undamaged")).expect("readable"),
                    );
                }
            }
        }
    }

    fn send(&mut self, message: impl Into<HostMessage>) {
        let mut out = [0; MAX_FRAME_BYTES];
        let length = message.into().encode(&mut out).expect("room");
        self.board.receive(&out[..length], self.now_us);
    }

    /// Asks and waits for the outcome, at most ten seconds.
    fn ask(&mut self, command: Command) -> Outcome {
        self.next_id += 1;
        let request_id = self.next_id;
        self.send(Request {
            request_id,
            command,
        });
        self.outcome_of(request_id)
    }

    fn outcome_of(&mut self, request_id: u32) -> Outcome {
        for _ in 0..2000 {
            self.listen();
            let found = self.heard.iter().position(|message| matches!(message, BoardMessage::Reply(reply) if reply.request_id == request_id));
            if let Some(found) = found {
                let BoardMessage::Reply(reply) = self.heard.remove(found) else {
                    unreachable!()
                };
                return reply.outcome;
            }
            self.run(1);
        }
        panic!("no answer to request {request_id}");
    }

    fn ready() -> Self
    where
        S: Default,
    {
        Self::ready_with_period(PERIOD_US as u32)
    }

    fn ready_with_period(period_us: u32) -> Self
    where
        S: Default,
    {
        let mut bench = Self::with_store_and_period(S::default(), period_us);
        assert!(matches!(
            bench.ask(Command::SetCalibration(calibration(7))),
            Outcome::CalibrationStored(_)
        ));
        assert!(matches!(
            bench.ask(Command::Tare(TareRequest {
                samples: 100,
                force: false
            })),
            Outcome::Tared(_)
        ));
        bench.heard.clear();
        bench
    }

    fn contacts(&mut self) -> Vec<Contact> {
        let contacts = self.heard.iter().filter_map(|message| match message {
            BoardMessage::Contact(contact) => Some(*contact),
            _ => None,
        });
        let contacts = contacts.collect();
        self.heard
            .retain(|message| !matches!(message, BoardMessage::Contact(_)));
        contacts
    }

    fn logs(&self) -> Vec<String> {
        self.heard
            .iter()
            .filter_map(|message| match message {
                BoardMessage::Log(log) => Some(log.text.as_str().to_owned()),
                _ => None,
            })
            .collect()
    }

    fn statistics(&mut self) -> (Statistics, Vec<GaugeCounts>) {
        self.next_id += 1;
        self.send(Request {
            request_id: self.next_id,
            command: Command::Statistics,
        });
        self.listen();
        let mut gauges = Vec::new();
        let mut statistics = None;
        for message in &self.heard {
            match message {
                BoardMessage::Statistics(found) if found.request_id == self.next_id => {
                    statistics = Some(*found)
                }
                BoardMessage::GaugeStatistics(page) if page.request_id == self.next_id => {
                    assert_eq!(usize::from(page.first), gauges.len());
                    gauges.extend(page.gauges.iter().copied());
                }
                _ => {}
            }
        }
        (statistics.expect("answered"), gauges)
    }
}

const STREAM: Command = Command::Start(Streams {
    contact_every: 1,
    raw_every: 0,
});

#[test]
fn a_board_says_who_it_is_when_it_starts_and_when_asked() {
    let mut bench = Bench::new();
    bench.listen();
    let Some(BoardMessage::Identity(first)) = bench.heard.first() else {
        panic!("{:?}", bench.heard)
    };
    assert_eq!(
        (
            first.request_id,
            first.finger_name.as_str(),
            first.period_us
        ),
        (0, "index", 5000)
    );
    assert_eq!(
        (first.schema_hash, first.gauges, first.calibration_id),
        (SCHEMA_HASH, 6, 0)
    );
    bench.heard.clear();
    bench.send(Identify { request_id: 9 });
    bench.listen();
    assert!(
        matches!(&bench.heard[..], [BoardMessage::Identity(identity)] if identity.request_id == 9)
    );
}

#[test]
fn a_push_becomes_a_contact_where_it_was() {
    let mut bench = Bench::<RamStore>::ready();
    assert_eq!(bench.ask(STREAM), Outcome::Done);
    for degrees in [0.0, 20.0, -45.0, 80.0] {
        bench.board.gauges_mut().counts = counts(push(3.0, degrees));
        bench.heard.clear();
        bench.run(20);
        let contacts = bench.contacts();
        assert_eq!(contacts.len(), 20);
        let expected = [
            20.0 * degrees.to_radians().sin(),
            0.0,
            20.0 * degrees.to_radians().cos(),
        ];
        for contact in contacts {
            assert!(
                contact.is_valid(),
                "{:?}",
                contact.flags.names().collect::<Vec<_>>()
            );
            // 10 counts of noise are half a mN and 10 uN m: some hundredths of a mm at 3 N.
            for axis in 0..3 {
                assert!(
                    (f64::from(contact.point_mm[axis]) - expected[axis]).abs() < 0.05,
                    "{contact:?}"
                );
                assert!((f64::from(contact.normal[axis]) - expected[axis] / 20.0).abs() < 0.0025);
            }
            assert!(
                (contact.normal_force_n - 3.0).abs() < 5e-3 && contact.tangential_force_n < 5e-3
            );
            assert!(contact.sigma_mm > 0.1 && contact.sigma_mm < 0.3);
            assert!(
                contact
                    .flags
                    .contains(ContactFlags::LOADED.union(ContactFlags::CALIBRATION_VOLATILE))
            );
            assert!((contact.joint_angles_rad[2] - 0.3).abs() < 6e-6);
        }
    }
}

#[test]
fn contacts_are_numbered_without_gaps_and_timed_by_their_sample() {
    let mut bench = Bench::<RamStore>::ready();
    assert_eq!(
        bench.ask(Command::Start(Streams {
            contact_every: 3,
            raw_every: 5
        })),
        Outcome::Done
    );
    let began = bench.now_us;
    bench.run(30);
    let contacts = bench.contacts();
    assert_eq!(contacts.len(), 10);
    for (index, contact) in contacts.iter().enumerate() {
        assert_eq!(contact.sequence, index as u32);
        // The first period after the start is sent, then every third; the front end's samples are 500 us old.
        assert_eq!(
            contact.board_time_us,
            began + PERIOD_US * (1 + 3 * index as u64) - 500
        );
    }
    let raw: Vec<_> = bench
        .heard
        .iter()
        .filter_map(|m| {
            if let BoardMessage::RawGauges(raw) = m {
                Some(raw)
            } else {
                None
            }
        })
        .collect();
    assert_eq!(raw.len(), 6);
    assert_eq!((raw[5].sequence, raw[0].gauges.len()), (5, GAUGES));
    for (gauge, value) in raw[0].gauges.iter().enumerate() {
        assert!((value.counts - ZERO[gauge]).abs() <= 10 && value.tared_counts.abs() <= 15);
    }
    assert_eq!(bench.ask(Command::Stop), Outcome::Done);
    bench.heard.clear();
    bench.run(10);
    assert!(bench.heard.is_empty(), "{:?}", bench.heard);
}

#[test]
fn nothing_is_valid_before_calibration_and_tare() {
    let mut bench = Bench::new();
    bench.ask(STREAM);
    bench.run(1);
    let flags = bench.contacts()[0].flags;
    assert!(flags.contains(ContactFlags::CALIBRATION_MISSING.union(ContactFlags::NOT_TARED)));
    bench.ask(Command::Stop);
    bench.ask(Command::SetCalibration(calibration(7)));
    bench.ask(STREAM);
    bench.run(1);
    let flags = bench.contacts().last().expect("one").flags;
    assert!(
        flags.contains(ContactFlags::NOT_TARED)
            && !flags.intersects(ContactFlags::CALIBRATION_MISSING)
    );
}

#[test]
fn a_host_that_stops_reading_loses_the_oldest_and_knows_how_many() {
    let mut bench = Bench::<RamStore>::ready();
    bench.ask(STREAM);
    bench.contacts();
    // Ten seconds without listening.
    let before = bench.board.statistics(0, 0);
    for _ in 0..2000 {
        bench.now_us += PERIOD_US;
        bench.board.tick(bench.now_us);
    }
    bench.listen();
    let contacts = bench.contacts();
    let after = bench.board.statistics(0, 0);
    assert_eq!(contacts.len(), 64);
    // The newest is there, and the gap before the first is exactly what the board says it dropped.
    assert_eq!(contacts[63].board_time_us, bench.now_us - 500);
    assert_eq!(
        contacts[0].lost_since(before.contacts.wrapping_sub(1)),
        after.contacts_dropped - before.contacts_dropped
    );
    assert_eq!(after.contacts_dropped - before.contacts_dropped, 2000 - 64);
    assert_eq!(after.contact_queue_high_water, 64);
    assert!(
        contacts
            .windows(2)
            .all(|pair| pair[1].lost_since(pair[0].sequence) == 0)
    );
}

#[test]
fn replies_do_not_hold_up_contacts() {
    let mut bench = Bench::<RamStore>::ready();
    bench.ask(STREAM);
    bench.contacts();
    for _ in 0..4 {
        bench.now_us += PERIOD_US;
        bench.board.tick(bench.now_us);
    }
    for number in 0..4 {
        bench.send(Request {
            request_id: 1000 + number,
            command: Command::Ping(number),
        });
    }
    bench.heard.clear();
    bench.listen();
    let kinds: Vec<u8> = bench.heard.iter().map(BoardMessage::kind).collect();
    // The answer to the start went last, so a contact is next.
    assert_eq!(kinds, [2, 7, 2, 7, 2, 7, 2, 7]);
}

#[test]
fn a_repeated_request_is_done_once_and_answered_each_time() {
    let mut bench = Bench::<RamStore>::ready();
    let tare = Request {
        request_id: 5000,
        command: Command::Tare(TareRequest {
            samples: 50,
            force: false,
        }),
    };
    // Three copies before it is done, three after: one tare, four equal answers.
    for _ in 0..3 {
        bench.send(tare.clone());
        bench.run(10);
    }
    let first = bench.outcome_of(5000);
    assert!(matches!(first, Outcome::Tared(_)));
    for _ in 0..3 {
        bench.send(tare.clone());
        assert_eq!(bench.outcome_of(5000), first);
    }
    assert_eq!(
        bench
            .logs()
            .iter()
            .filter(|line| line.starts_with("tared"))
            .count(),
        1
    );
    assert_eq!(bench.board.statistics(0, 0).requests_repeated, 5);
    // The same id with another content is another request.
    bench.send(Request {
        request_id: 5000,
        command: Command::Stop,
    });
    assert_eq!(bench.outcome_of(5000), Outcome::Done);
}

#[test]
fn a_delayed_copy_of_start_does_not_undo_stop() {
    let mut bench = Bench::<RamStore>::ready();
    let start = Request {
        request_id: 6000,
        command: STREAM,
    };
    bench.send(start.clone());
    bench.send(Request {
        request_id: 6001,
        command: Command::Stop,
    });
    bench.send(start);
    assert_eq!(bench.board.streams(), Streams::default());
}

#[test]
fn tare_is_refused_in_contact_unless_forced() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().counts = counts(push(0.2, 10.0));
    bench.run(2);
    let refused = bench.ask(Command::Tare(TareRequest {
        samples: 20,
        force: false,
    }));
    assert_eq!(refused, Outcome::Refused(Refusal::InContact));
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::LOADED))
    );
    assert!(matches!(
        bench.ask(Command::Tare(TareRequest {
            samples: 20,
            force: true
        })),
        Outcome::Tared(_)
    ));
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| !contact.flags.contains(ContactFlags::LOADED))
    );
    assert_eq!(
        bench.ask(Command::Tare(TareRequest {
            samples: 0,
            force: true
        })),
        Outcome::Refused(Refusal::SampleCount)
    );
}

#[test]
fn contacts_during_a_tare_are_marked_and_a_second_tare_waits() {
    let mut bench = Bench::<RamStore>::ready();
    bench.send(Request {
        request_id: 1,
        command: Command::Tare(TareRequest {
            samples: 100,
            force: false,
        }),
    });
    bench.run(5);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::TARING))
    );
    assert_eq!(
        bench.ask(Command::Tare(TareRequest {
            samples: 10,
            force: false
        })),
        Outcome::Refused(Refusal::Busy)
    );
    assert!(matches!(bench.outcome_of(1), Outcome::Tared(_)));
}

#[test]
fn every_gauge_fault_is_a_reason_a_count_and_a_line_and_passes() {
    for (fault, reason, name) in [
        (
            GaugeFlags::SATURATED,
            ContactFlags::GAUGE_SATURATED,
            "gauge 4: saturated",
        ),
        (GaugeFlags::OPEN, ContactFlags::GAUGE_OPEN, "gauge 4: open"),
        (
            GaugeFlags::STUCK,
            ContactFlags::GAUGE_STUCK,
            "gauge 4: stuck",
        ),
        (
            GaugeFlags::MISSING,
            ContactFlags::GAUGE_MISSING,
            "gauge 4: missing",
        ),
        (GaugeFlags::LATE, ContactFlags::GAUGE_LATE, "gauge 4: late"),
    ] {
        let mut bench = Bench::<RamStore>::ready();
        bench.board.gauges_mut().counts = counts(push(3.0, 10.0));
        bench.ask(STREAM);
        bench.run(10);
        bench.contacts();
        let (_, before) = bench.statistics();
        bench.board.gauges_mut().flags[4] = fault;
        bench.run(10);
        let contacts = bench.contacts();
        assert!(
            contacts
                .iter()
                .all(|contact| !contact.is_valid() && contact.flags.contains(reason)),
            "{name}"
        );
        let (_, after) = bench.statistics();
        let counted = |counts: &GaugeCounts| {
            [
                counts.saturated,
                counts.open,
                counts.stuck,
                counts.missing,
                counts.late,
            ]
        };
        let rises: u32 =
            counted(&after[4]).iter().sum::<u32>() - counted(&before[4]).iter().sum::<u32>();
        assert_eq!((rises, after[4].good - before[4].good), (10, 0), "{name}");
        assert_eq!(after[3].good - before[3].good, 10);
        bench.board.gauges_mut().flags[4] = GaugeFlags::none();
        bench.run(3);
        let recovered = bench.contacts();
        assert!(recovered.last().expect("some").is_valid());
        let lines = bench.logs();
        assert_eq!(
            lines.iter().filter(|line| *line == name).count(),
            1,
            "{lines:?}"
        );
        assert!(lines.iter().any(|line| line == "all gauges good again"));
    }
}

#[test]
fn the_board_itself_sees_stuck_and_late_gauges() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().noise = 0;
    bench.run(22);
    let flags = bench.board.last_contact().expect("one").flags;
    assert!(flags.contains(ContactFlags::GAUGE_STUCK));
    bench.board.gauges_mut().noise = 1;
    bench.run(1);
    assert!(
        !bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .intersects(ContactFlags::GAUGE_STUCK)
    );
    bench.board.gauges_mut().age_us = 7_600;
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::GAUGE_LATE)
    );
}

#[test]
fn joint_faults_are_reasons_and_pass() {
    let mut bench = Bench::<RamStore>::ready();
    for state in [JointState::Missing, JointState::BadCheck] {
        bench.board.joints_mut().0.states[1] = state;
        bench.run(4);
        assert!(
            bench
                .board
                .last_contact()
                .expect("one")
                .flags
                .contains(ContactFlags::JOINT_INVALID)
        );
        bench.board.joints_mut().0.states[1] = JointState::Good;
        bench.run(1);
        assert!(
            !bench
                .board
                .last_contact()
                .expect("one")
                .flags
                .intersects(ContactFlags::JOINT_INVALID)
        );
    }
    assert_eq!(bench.board.statistics(0, 0).joint_errors, 8);
    assert!(
        bench
            .logs()
            .iter()
            .any(|line| line == "joint 1: no good angle")
    );
}

#[test]
fn a_chip_reset_is_counted_and_told() {
    let mut bench = Bench::<RamStore>::ready();
    bench.board.gauges_mut().resets = 2;
    bench.run(2);
    assert_eq!(bench.board.statistics(0, 0).chip_resets, 2);
    assert_eq!(
        bench
            .logs()
            .iter()
            .filter(|line| line.starts_with("converter reset"))
            .count(),
        1
    );
}

#[test]
fn skipped_and_uneven_periods_are_counted() {
    let mut bench = Bench::<RamStore>::ready();
    bench.run(400);
    let (steady, _) = bench.statistics();
    assert_eq!(
        (
            steady.rate_millihertz,
            steady.jitter_rms_us,
            steady.overruns,
            steady.tick_max_us
        ),
        (200_000, 0, 0, 100)
    );
    bench.now_us += 3 * PERIOD_US;
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::LATE_SAMPLE)
    );
    let (late, _) = bench.statistics();
    assert_eq!((late.overruns, late.late_ticks), (3, 1));
    assert!(
        bench
            .logs()
            .iter()
            .any(|line| line == "3 periods without a sample")
    );
    // 300 us early and late by turns: 600 us from period to period.
    for step in 0..600 {
        bench.now_us += PERIOD_US;
        bench.board.tick(if step % 2 == 0 {
            bench.now_us - 300
        } else {
            bench.now_us + 300
        });
    }
    bench.now_us += PERIOD_US;
    let (uneven, _) = bench.statistics();
    assert_eq!(
        (uneven.jitter_rms_us, uneven.jitter_max_us, uneven.overruns),
        (600, 600, 3)
    );
}

/// Memory that outlives the power, as long as it is told to.
#[derive(Clone, Default)]
struct Flash {
    slots: RamStore,
    broken: bool,
}

impl CalibrationStore for Flash {
    fn is_permanent(&self) -> bool {
        true
    }

    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
        self.slots.read(slot)
    }

    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
        if self.broken {
            Err(StoreError::NotWritable)
        } else {
            self.slots.write(slot, record)
        }
    }
}

#[test]
fn a_calibration_outlives_the_power_and_can_be_read_back() {
    let mut bench = Bench::with_store(Flash::default());
    assert_eq!(
        bench.ask(Command::GetCalibration),
        Outcome::Refused(Refusal::NoCalibration)
    );
    let stored = bench.ask(Command::SetCalibration(calibration(7)));
    assert_eq!(
        stored,
        Outcome::CalibrationStored(CalibrationStored {
            id: 7,
            place: StorePlace::Permanent
        })
    );
    let flash = bench.board.store_mut().clone();
    let mut again = Bench::with_store(flash);
    again.listen();
    assert!(
        again
            .heard
            .iter()
            .any(|m| matches!(m, BoardMessage::Identity(identity) if identity.calibration_id == 7))
    );
    assert_eq!(
        again.ask(Command::GetCalibration),
        Outcome::Calibration(calibration(7))
    );
}

#[test]
fn a_store_that_can_not_be_written_is_told_and_the_calibration_used() {
    let mut bench = Bench::with_store(Flash {
        broken: true,
        ..Flash::default()
    });
    let stored = bench.ask(Command::SetCalibration(calibration(7)));
    assert_eq!(
        stored,
        Outcome::CalibrationStored(CalibrationStored {
            id: 7,
            place: StorePlace::RamOnly
        })
    );
    assert_eq!(
        (
            bench.board.calibration_id(),
            bench.board.statistics(0, 0).store_failures
        ),
        (7, 1)
    );
    bench.run(1);
    assert!(
        bench
            .board
            .last_contact()
            .expect("one")
            .flags
            .contains(ContactFlags::CALIBRATION_VOLATILE)
    );
    assert!(bench.logs().iter().any(|line| line.contains("kept in RAM")));
}

#[test]
fn calibrations_that_can_not_be_used_are_refused_with_the_reason() {
    let mut bench = Bench::<RamStore>::ready();
    let sound = calibration(8);
    let mut refused =
        |calibration: Calibration| match bench.ask(Command::SetCalibration(calibration)) {
            Outcome::Refused(refusal) => refusal,
            other => panic!("{other:?}"),
        };
    assert_eq!(
        refused(Calibration {
            crc: sound.crc ^ 1,
            ..sound.clone()
        }),
        Refusal::CalibrationCrc
    );
    let two = Calibration::sealed(8, 2, &[1.0; 12]).expect("sound");
    assert_eq!(refused(two), Refusal::CalibrationShape(6));
    let mut infinite = Calibration {
        matrix: sound.matrix.clone(),
        ..sound.clone()
    };
    infinite.matrix[3] = f32::INFINITY;
    infinite.crc = infinite.computed_crc();
    assert_eq!(refused(infinite), Refusal::CalibrationValue);
    let mut nameless = Calibration {
        id: 0,
        ..sound.clone()
    };
    nameless.crc = nameless.computed_crc();
    assert_eq!(refused(nameless), Refusal::CalibrationValue);
    assert_eq!(bench.board.calibration_id(), 7);
    bench.ask(STREAM);
    assert_eq!(
        bench.ask(Command::SetCalibration(sound)),
        Outcome::Refused(Refusal::Streaming)
    );
}

#[test]
fn time_sync_answers_with_the_moments_of_receipt_and_of_leaving() {
    let mut bench = Bench::<RamStore>::ready();
    bench.send(Request {
        request_id: 1,
        command: Command::TimeSync(TimeSyncRequest { host_send_us: 123 }),
    });
    let received = bench.now_us;
    bench.now_us += 1700;
    let time = TimeSyncAnswer {
        host_send_us: 123,
        board_receive_us: received,
        board_send_us: bench.now_us,
    };
    assert_eq!(bench.outcome_of(1), Outcome::Time(time));
}

#[test]
fn a_host_of_another_version_learns_who_the_board_is() {
    let mut bench = Bench::<RamStore>::ready();
    let [low, high] = SCHEMA_TAG.to_le_bytes();
    for envelope in [
        [MAGIC, 9, low, high, 0x82],
        [MAGIC, PROTOCOL_VERSION, !low, high, 0x82],
    ] {
        let mut raw = envelope.to_vec();
        raw.extend([1, 2, 3]);
        raw.extend(CRC.checksum(&raw).to_le_bytes());
        let mut stuffed = vec![0; raw.len() + 2];
        cobs::encode(&raw, &mut stuffed);
        bench.heard.clear();
        // Ten of them make one answer.
        for _ in 0..10 {
            bench.board.receive(&stuffed, bench.now_us);
        }
        bench.listen();
        let identities = bench
            .heard
            .iter()
            .filter(|m| matches!(m, BoardMessage::Identity(_)))
            .count();
        assert_eq!(identities, 1);
        assert!(
            bench
                .logs()
                .iter()
                .any(|line| line.contains("the other side")),
            "{:?}",
            bench.logs()
        );
    }
    assert_eq!(bench.board.statistics(0, 0).frames_refused, 20);
}

#[test]
fn bytes_one_by_one_are_the_frames() {
    let (mut whole, mut single) = (Bench::<RamStore>::ready(), Bench::<RamStore>::ready());
    let mut frames = Vec::new();
    let mut bytes = Vec::new();
    for bench in [&mut whole, &mut single] {
        bench.send(Request {
            request_id: 1,
            command: STREAM,
        });
        for _ in 0..5 {
            bench.now_us += PERIOD_US;
            bench.board.tick(bench.now_us);
        }
    }
    while let Some(frame) = whole.board.take_frame(whole.now_us) {
        frames.extend_from_slice(frame);
    }
    while single.board.has_output() {
        bytes.extend(single.board.next_byte(single.now_us));
    }
    assert_eq!(frames, bytes);
    assert!(frames.len() > 5 * CONTACT_FRAME_BYTES && single.board.next_byte(0).is_none());
}

/// Runs a board for ten seconds on a line of so many baud; returns its statistics and the contacts that came through.
fn ten_seconds_on_a_line(baud: u64, period_us: u64, streams: Streams) -> (Statistics, u32) {
    let mut bench = Bench::<RamStore>::ready_with_period(period_us as u32);
    bench.ask(Command::Start(streams));
    bench.heard.clear();
    let (mut bits, mut contacts) = (0, 0);
    for tick in 0..10_000_000 / period_us {
        bench.now_us += period_us;
        bench.board.tick(bench.now_us);
        // Clocks are compared and statistics asked for once a second, as a host does.
        if (tick * period_us) % 1_000_000 == 0 {
            let request_id = 10_000 + tick as u32;
            bench.send(Request {
                request_id,
                command: Command::TimeSync(TimeSyncRequest {
                    host_send_us: bench.now_us,
                }),
            });
            bench.send(Request {
                request_id: request_id + 1,
                command: Command::Statistics,
            });
        }
        // Eight bits, a start and a stop bit per byte; an idle line saves nothing up.
        bits += baud * period_us;
        while bits >= 10_000_000 {
            let Some(byte) = bench.board.next_byte(bench.now_us) else {
                bits = 0;
                break;
            };
            bits -= 10_000_000;
            if let Some(frame) = bench.decoder.push(byte) {
                contacts += u32::from(matches!(
                    BoardMessage::try_from(frame.expect("undamaged")),
                    Ok(BoardMessage::Contact(_))
                ));
            }
        }
    }
    (bench.board.statistics(0, 0), contacts)
}

#[test]
fn a_line_of_115_200_baud_carries_200_contacts_a_second_and_more() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        115_200,
        5000,
        Streams {
            contact_every: 1,
            raw_every: 20,
        },
    );
    assert_eq!(
        (
            statistics.contacts,
            statistics.contacts_dropped,
            statistics.raw_dropped
        ),
        (2000, 0, 0)
    );
    assert_eq!(
        (statistics.replies_dropped, statistics.rate_millihertz),
        (0, 200_000)
    );
    assert!(
        contacts >= 1998 && statistics.contact_queue_high_water <= 8,
        "{contacts} {statistics:?}"
    );
}

#[test]
fn a_line_of_921_600_baud_carries_a_thousand_contacts_a_second() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        921_600,
        1000,
        Streams {
            contact_every: 1,
            raw_every: 20,
        },
    );
    assert_eq!(
        (
            statistics.contacts,
            statistics.contacts_dropped,
            statistics.raw_dropped
        ),
        (10_000, 0, 0)
    );
    assert_eq!(
        (statistics.overruns, statistics.rate_millihertz),
        (0, 1_000_000)
    );
    assert!(contacts >= 9998, "{contacts}");
}

#[test]
fn what_a_line_can_not_carry_is_dropped_and_counted() {
    let (statistics, contacts) = ten_seconds_on_a_line(
        57_600,
        5000,
        Streams {
            contact_every: 1,
            raw_every: 0,
        },
    );
    // Room for 120 contacts a second of 200, less the replies.
    assert!((1150..=1200).contains(&contacts), "{contacts}");
    // Sent, dropped or still waiting: nothing else can have become of them. One may be half sent.
    let accounted = contacts + statistics.contacts_dropped;
    assert!(
        (2000 - 65..=2000 - 64).contains(&accounted),
        "{accounted} {statistics:?}"
    );
}

#[test]
fn slow_drift_is_followed_and_remarked_and_a_touch_is_not() {
    let mut bench = Bench::<RamStore>::ready();
    // 1 mN a second for two minutes: 120 mN, far beyond what would count as a load at once.
    for second in 0..120 {
        bench.board.gauges_mut().counts =
            counts([0.0, 0.0, 0.001 * f64::from(second), 0.0, 0.0, 0.0]);
        bench.run(200);
        assert!(
            bench
                .board
                .last_contact()
                .is_some_and(|contact| !contact.flags.contains(ContactFlags::LOADED)),
            "{second} s"
        );
    }
    let (_, gauges) = bench.statistics();
    // 0.119 N less the lag of 5 s, at 20 000 counts per N.
    assert!((gauges[2].drift_counts - 2280).abs() < 60, "{gauges:?}");
    // A touch of 0.3 N is a load at once and is not followed.
    let drift = gauges[2].drift_counts;
    bench.board.gauges_mut().counts = counts([0.0, 0.0, 0.119 - 0.3, 0.0, 0.0, 0.0]);
    bench.run(2000);
    assert!(
        bench
            .board
            .last_contact()
            .is_some_and(|contact| contact.flags.contains(ContactFlags::LOADED))
    );
    let (_, gauges) = bench.statistics();
    assert!((gauges[2].drift_counts - drift).abs() <= 1);
}

#[test]
fn wrong_configurations_are_refused() {
    use palpus_firmware::BoardError;
    let tip = TipGeometry {
        semi_axes_mm: [20.0; 3],
        centre_offset_mm: [0.0; 3],
    };
    let sound = BoardConfig::new([0; 12], 0, "a name far too long for sixteen bytes", tip);
    assert_eq!(sound.finger_name.as_str(), "a name far too l");
    let make = |config: BoardConfig| {
        let gauges = Gauges {
            counts: [0; MAX_GAUGES],
            flags: [GaugeFlags::none(); MAX_GAUGES],
            age_us: 0,
            resets: 0,
            noise: 0,
        };
        Board::new(
            config,
            gauges,
            Joints(JointSample::default()),
            RamStore::new(),
            0,
        )
        .err()
    };
    assert_eq!(make(sound.clone()), None);
    assert_eq!(
        make(BoardConfig {
            period_us: 0,
            ..sound.clone()
        }),
        Some(BoardError::Period)
    );
    let flat = TipGeometry {
        semi_axes_mm: [20.0, 0.0, 20.0],
        ..tip
    };
    assert_eq!(
        make(BoardConfig { tip: flat, ..sound }),
        Some(BoardError::Tip)
    );
}

fn any_command() -> impl Strategy<Value = Command> {
    let floats = proptest::collection::vec(any::<f32>(), 0..=48);
    prop_oneof![
        any::<u32>().prop_map(Command::Ping),
        any::<[u8; 2]>().prop_map(|[contact_every, raw_every]| Command::Start(Streams {
            contact_every,
            raw_every
        })),
        Just(Command::Stop),
        any::<(u16, bool)>().prop_map(|(samples, force)| Command::Tare(TareRequest {
            samples: samples % 60,
            force
        })),
        Just(Command::GetCalibration),
        (any::<u32>(), any::<u8>(), floats, any::<bool>()).prop_map(
            |(id, gauges, values, seal)| {
                let mut calibration = Calibration {
                    id,
                    gauges,
                    matrix: values.into_iter().collect(),
                    crc: 0,
                };
                if seal {
                    calibration.crc = calibration.computed_crc();
                }
                Command::SetCalibration(calibration)
            }
        ),
        any::<u64>().prop_map(|host_send_us| Command::TimeSync(TimeSyncRequest { host_send_us })),
        Just(Command::Statistics),
    ]
}

/// One thing that may happen to a board.
#[derive(Clone, Debug)]
enum Happening {
    Garbage(Vec<u8>),
    Command(u32, Command),
    Damaged(Command, usize, u8),
    Tick(u64),
    Counts([i32; 8], [u8; 8]),
    Listen,
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..300).prop_map(Happening::Garbage),
        (0u32..20, any_command()).prop_map(|(id, command)| Happening::Command(id, command)),
        (any_command(), any::<usize>(), 1u8..)
            .prop_map(|(command, place, mask)| Happening::Damaged(command, place, mask)),
        prop_oneof![Just(PERIOD_US), 0..100_000u64, any::<u64>()].prop_map(Happening::Tick),
        any::<([i32; 8], [u8; 8])>().prop_map(|(counts, flags)| Happening::Counts(counts, flags)),
        Just(Happening::Listen),
    ]
}

proptest! {
    /// Whatever happens, the board goes on: it still answers, and every frame it sends is whole and readable.
    #[test]
    fn nothing_stops_a_board(happenings in proptest::collection::vec(happening(), 0..60)) {
        let mut bench = Bench::new();
        for happening in happenings {
            match happening {
                Happening::Garbage(bytes) => bench.board.receive(&bytes, bench.now_us),
                Happening::Command(request_id, command) => bench.send(Request { request_id, command }),
                Happening::Damaged(command, place, mask) => {
                    let mut out = [0; MAX_FRAME_BYTES];
                    let length = HostMessage::from(Request { request_id: 3, command }).encode(&mut out).expect("room");
                    out[place % length] ^= mask;
                    bench.board.receive(&out[..length], bench.now_us);
                }
                Happening::Tick(elapsed) => {
                    bench.now_us = bench.now_us.saturating_add(elapsed);
                    bench.board.tick(bench.now_us.max(500));
                    bench.board.tick_ended(bench.now_us);
                }
                Happening::Counts(counts, flags) => {
                    bench.board.gauges_mut().noise = 0;
                    bench.board.gauges_mut().counts = counts;
                    bench.board.gauges_mut().flags = flags.map(GaugeFlags::from_bits);
                }
                Happening::Listen => bench.listen(),
            }
            while bench.board.take_event().is_some() {}
        }
        bench.board.receive(&[DELIMITER], bench.now_us);
        bench.listen();
        bench.heard.clear();
        bench.send(Identify { request_id: 77 });
        bench.listen();
        let answered = matches!(&bench.heard[..], [BoardMessage::Identity(identity)] if identity.request_id == 77);
        prop_assert!(answered);
    }
}
