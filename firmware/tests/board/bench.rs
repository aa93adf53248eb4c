//! A board on the bench: simulated gauges and encoders in, frames and commands out and in.

use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JointFrontEnd, JointSample, JointState,
};
use palpus_firmware::store::{CalibrationStore, RamStore};
use palpus_firmware::{Board, BoardConfig};
use palpus_protocol::*;

pub const PERIOD_US: u64 = 5000;
pub const GAUGES: usize = 6;

/// Gauges that show what they are told, each as it is asked.
pub struct Gauges {
    pub counts: [i32; MAX_GAUGES],
    pub flags: [GaugeFlags; MAX_GAUGES],
    pub age_us: u64,
    pub resets: u32,
    pub noise: u64,
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

pub struct Joints(pub JointSample);

impl JointFrontEnd for Joints {
    fn sample(&mut self, now_us: u64) -> JointSample {
        JointSample {
            time_us: now_us,
            ..self.0
        }
    }
}

/// Gauge counts per N and N mm: every gauge sees every axis, as a real sensor's do. Rows are
/// gauges.
pub fn sensitivity() -> [[f64; 6]; 6] {
    core::array::from_fn(|gauge| {
        core::array::from_fn(|axis| {
            let scale = if axis < 3 { 20_000.0 } else { 1_000.0 };
            let cross = 0.05 * ((gauge * 5 + axis * 3) % 7) as f64 - 0.15;
            scale * (if gauge == axis { 1.0 } else { cross })
        })
    })
}

/// Inverse by Gauss-Jordan with pivots, row-major: the calibration's matrix.
pub fn inverse(mut a: [[f64; 6]; 6]) -> Vec<f32> {
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

pub fn calibration(id: u32) -> Calibration {
    Calibration::sealed(id, GAUGES as u8, &inverse(sensitivity())).expect("sound")
}

pub const ZERO: [i32; 6] = [120_000, -340_000, 56_000, 7_000, -900_000, 1_000_000];

/// Counts of a wrench at the sensor.
pub fn counts(wrench: [f64; 6]) -> [i32; MAX_GAUGES] {
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

/// The wrench at the sensor of a frictionless push of `force` N at the tip (R = 20, centre at 35
/// mm), tilted about y by `degrees`.
pub fn push(force: f64, degrees: f64) -> [f64; 6] {
    let (s, c) = degrees.to_radians().sin_cos();
    let (fx, fz) = (-force * s, -force * c);
    // c x f is zero for a force along the normal; d x f = (0, 35 fx, 0).
    [fx, 0.0, fz, 0.0, 35.0 * fx, 0.0]
}

pub type TestBoard<S = RamStore> = Board<Gauges, Joints, S>;

pub struct Bench<S = RamStore> {
    pub board: TestBoard<S>,
    pub now_us: u64,
    pub next_id: u32,
    pub decoder: Decoder,
    pub heard: Vec<BoardMessage>,
}

impl Bench {
    pub fn new() -> Self {
        Self::with_store(RamStore::new())
    }
}

impl<S: CalibrationStore> Bench<S> {
    pub fn with_store(store: S) -> Self {
        Self::with_store_and_period(store, PERIOD_US as u32)
    }

    pub fn with_store_and_period(store: S, period_us: u32) -> Self {
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
    pub fn run(&mut self, periods: u32) {
        for _ in 0..periods {
            self.now_us += u64::from(self.board.config().period_us);
            self.board.tick(self.now_us);
            self.board.tick_ended(self.now_us + 100);
            self.listen();
        }
    }

    pub fn listen(&mut self) {
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

    pub fn send(&mut self, message: impl Into<HostMessage>) {
        let mut out = [0; MAX_FRAME_BYTES];
        let length = message.into().encode(&mut out).expect("room");
        self.board.receive(&out[..length], self.now_us);
    }

    /// Asks and waits for the outcome, at most ten seconds.
    pub fn ask(&mut self, command: Command) -> Outcome {
        self.next_id += 1;
        let request_id = self.next_id;
        self.send(Request {
            request_id,
            command,
        });
        self.outcome_of(request_id)
    }

    pub fn outcome_of(&mut self, request_id: u32) -> Outcome {
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

    pub fn ready() -> Self
    where
        S: Default,
    {
        Self::ready_with_period(PERIOD_US as u32)
    }

    pub fn ready_with_period(period_us: u32) -> Self
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

    pub fn contacts(&mut self) -> Vec<Contact> {
        let contacts = self.heard.iter().filter_map(|message| match message {
            BoardMessage::Contact(contact) => Some(*contact),
            _ => None,
        });
        let contacts = contacts.collect();
        self.heard
            .retain(|message| !matches!(message, BoardMessage::Contact(_)));
        contacts
    }

    pub fn logs(&self) -> Vec<String> {
        self.heard
            .iter()
            .filter_map(|message| match message {
                BoardMessage::Log(log) => Some(log.text.as_str().to_owned()),
                _ => None,
            })
            .collect()
    }

    pub fn statistics(&mut self) -> (Statistics, Vec<GaugeCounts>) {
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

pub const STREAM: Command = Command::Start(Streams {
    contact_every: 1,
    raw_every: 0,
});
