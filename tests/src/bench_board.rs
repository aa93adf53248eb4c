//! A fingertip board on the bench: the real firmware library behind a pseudo-terminal, with a tip that is pressed
//! at points moving over its hemisphere.
//!
//! The board runs in a thread on a clock of its own, which may start anywhere and run fast or slow. It remembers
//! every frame it sent, if asked to, so that a test can tell what was lost and whether what arrived was ever sent.

use palpus_firmware::front_end::{
    GaugeFrontEnd, GaugeSample, JOINTS, JointFrontEnd, JointSample, JointState,
};
use palpus_firmware::store::{RamStore, save};
use palpus_firmware::{Board, BoardConfig};
use palpus_host::link::host_clock::HostClock;
use palpus_protocol::{Calibration, GaugeFlags, MAX_GAUGES, TipGeometry, WRENCH_AXES};
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Radius of the bench tip, mm.
pub const RADIUS_MM: f64 = 20.0;
/// Tip centre above the sensor, mm.
pub const ARM_MM: f64 = 15.0;
/// N per count; moments have ten times as many N mm per count.
const STEP_N: f64 = 1e-4;

/// The last of the calls that make a pseudo-terminal is not safe to make from two threads.
static PAIRS: Mutex<()> = Mutex::new(());

/// A pseudo-terminal: the end that stays with the test, and the device the host opens; this handle of it only keeps
/// it alive, and is not locked.
pub fn pseudo_terminal() -> (TTYPort, TTYPort) {
    let _one_at_a_time = PAIRS.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut near, device) = TTYPort::pair().expect("pseudo-terminals are there");
    near.set_timeout(Duration::from_millis(1))
        .expect("near end");
    (near, device)
}

/// What makes a bench board.
#[derive(Clone, Debug)]
pub struct BenchSettings {
    /// Name of the finger.
    pub name: String,
    /// Number of the finger and, spread over the id, of the board.
    pub number: u8,
    /// How much faster than the host's its clock runs, as a fraction.
    pub drift: f64,
    /// What its clock shows at the start, us.
    pub start_us: u64,
    /// Sampling period, us.
    pub period_us: u32,
    /// The time that passes for the board, but for its drift.
    pub clock: HostClock,
    /// Whether it keeps every frame it sends.
    pub remembers: bool,
}

impl BenchSettings {
    /// A board at 200 Hz whose clock is true and starts at a second.
    pub fn new(name: &str, number: u8) -> Self {
        Self {
            name: name.into(),
            number,
            drift: 0.0,
            start_us: 1_000_000,
            period_us: 5_000,
            clock: HostClock::start(),
            remembers: true,
        }
    }
}

/// Outward normal of the tip where it is pressed at a time, and the joint angles then.
pub fn pressed_at(time_us: u64) -> ([f64; 3], [f64; JOINTS]) {
    let t = time_us as f64 * 1e-6;
    let (tilt, turn) = (0.4 + 0.3 * (0.7 * t).sin(), 0.9 * t);
    let normal = [tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()];
    let angles = [0.3 * (0.2 * t).sin(), 0.5, -0.8 + 0.1 * (0.31 * t).cos()];
    (normal, angles)
}

struct Pressed {
    loaded: Arc<AtomicBool>,
}

impl GaugeFrontEnd for Pressed {
    fn gauges(&self) -> usize {
        WRENCH_AXES
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        let mut counts = [0; MAX_GAUGES];
        // Every gauge has an offset, which a tare takes away.
        for (k, count) in counts.iter_mut().enumerate() {
            *count = 1_000 * (k as i32 + 1);
        }
        if self.loaded.load(Ordering::Relaxed) {
            let ([x, y, z], _) = pressed_at(now_us);
            let push_n = 2.5;
            let f = [-push_n * x, -push_n * y, -push_n * z];
            // Where it is pressed, from the sensor's origin.
            let c = [RADIUS_MM * x, RADIUS_MM * y, RADIUS_MM * z + ARM_MM];
            let m = [
                c[1] * f[2] - c[2] * f[1],
                c[2] * f[0] - c[0] * f[2],
                c[0] * f[1] - c[1] * f[0],
            ];
            for axis in 0..3 {
                counts[axis] += (f[axis] / STEP_N).round() as i32;
                counts[axis + 3] += (m[axis] / (10.0 * STEP_N)).round() as i32;
            }
        }
        let mut flags = [GaugeFlags::MISSING; MAX_GAUGES];
        flags[..WRENCH_AXES].fill(GaugeFlags::none());
        GaugeSample {
            time_us: now_us,
            counts,
            flags,
        }
    }
}

struct Still;

impl JointFrontEnd for Still {
    fn sample(&mut self, now_us: u64) -> JointSample {
        let (_, angles) = pressed_at(now_us);
        JointSample {
            time_us: now_us,
            angles_rad: angles.map(|a| a as f32),
            states: [JointState::Good; JOINTS],
        }
    }
}

/// The calibration that belongs to the bench tip's gauges.
pub fn bench_calibration(id: u32) -> Calibration {
    let mut matrix = [0.0; WRENCH_AXES * WRENCH_AXES];
    for axis in 0..WRENCH_AXES {
        let step = if axis < 3 { STEP_N } else { 10.0 * STEP_N };
        matrix[axis * WRENCH_AXES + axis] = step as f32;
    }
    Calibration::sealed(id, WRENCH_AXES as u8, &matrix).expect("a plain matrix")
}

/// A board of the firmware library with the bench tip.
pub type FirmwareBoard = Board<PressedTip, StillJoints, RamStore>;

/// Gauges of the bench tip.
pub struct PressedTip(Pressed);
/// Joints of the bench finger.
pub struct StillJoints(Still);

impl GaugeFrontEnd for PressedTip {
    fn gauges(&self) -> usize {
        self.0.gauges()
    }

    fn sample(&mut self, now_us: u64) -> GaugeSample {
        self.0.sample(now_us)
    }
}

impl JointFrontEnd for StillJoints {
    fn sample(&mut self, now_us: u64) -> JointSample {
        self.0.sample(now_us)
    }
}

/// Starts the firmware at a board time; `loaded` presses the tip.
pub fn firmware(settings: &BenchSettings, now_us: u64, loaded: &Arc<AtomicBool>) -> FirmwareBoard {
    let tip = TipGeometry {
        semi_axes_mm: [RADIUS_MM as f32; 3],
        centre_offset_mm: [0.0, 0.0, ARM_MM as f32],
    };
    let id = [settings.number; 12];
    let mut config = BoardConfig::new(id, settings.number, &settings.name, tip);
    config.period_us = settings.period_us;
    // Without noise a gauge rightly shows the same count again.
    config.stuck_after = 0;
    let mut store = RamStore::new();
    save(&mut store, &bench_calibration(1)).expect("RAM can be written");
    let gauges = PressedTip(Pressed {
        loaded: Arc::clone(loaded),
    });
    Board::new(config, gauges, StillJoints(Still), store, now_us).expect("a sound configuration")
}

/// What a bench board and its test share.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    loaded: Arc<AtomicBool>,
    /// Counts restarts asked for.
    restarts: AtomicU32,
    /// When it was started first, by [`BenchSettings::clock`].
    began_us: AtomicI64,
    sent: Mutex<Vec<Vec<u8>>>,
}

/// A running bench board.
pub struct BenchBoard {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// The device the host opens; kept so that the terminal lives when the host closes it.
    device: Option<TTYPort>,
    path: String,
    settings: BenchSettings,
}

impl BenchBoard {
    /// Starts a board on a pseudo-terminal of its own.
    pub fn start(settings: BenchSettings) -> Self {
        let (near, device) = pseudo_terminal();
        let path = device.name().expect("a pseudo-terminal has a name");
        let shared = Arc::new(Shared::default());
        let its = Arc::clone(&shared);
        let own = settings.clone();
        let thread = std::thread::spawn(move || run(near, &own, &its));
        Self {
            settings,
            shared,
            thread: Some(thread),
            device: Some(device),
            path,
        }
    }

    /// The device to open.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Presses the tip, or lets it go.
    pub fn press(&self, loaded: bool) {
        self.shared.loaded.store(loaded, Ordering::Relaxed);
    }

    /// Takes the power away and gives it back: the clock starts at zero, nothing streams.
    pub fn restart(&self) {
        self.shared.restarts.fetch_add(1, Ordering::Relaxed);
    }

    /// When the clock of a board that was never restarted showed `board_us`, by [`BenchSettings::clock`].
    pub fn host_us(&self, board_us: u64) -> f64 {
        let since = board_us as f64 - self.settings.start_us as f64;
        self.shared.began_us.load(Ordering::Relaxed) as f64 + since / (1.0 + self.settings.drift)
    }

    /// Every frame sent so far, delimiters included; none if it does not remember them.
    pub fn sent(&self) -> Vec<Vec<u8>> {
        self.shared
            .sent
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

impl Drop for BenchBoard {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.device = None;
    }
}

fn run(mut port: TTYPort, settings: &BenchSettings, shared: &Shared) {
    let period_us = u64::from(settings.period_us);
    let mut start_us = settings.start_us;
    let mut began_us = settings.clock.now_us();
    shared.began_us.store(began_us, Ordering::Relaxed);
    let mut restarts = 0;
    let mut board = firmware(settings, start_us, &shared.loaded);
    let mut next_tick_us = start_us + period_us;
    let mut waiting: Vec<u8> = Vec::new();
    let mut buffer = [0; 512];
    while !shared.stop.load(Ordering::Relaxed) {
        let asked = shared.restarts.load(Ordering::Relaxed);
        if asked != restarts {
            restarts = asked;
            start_us = 0;
            began_us = settings.clock.now_us();
            board = firmware(settings, start_us, &shared.loaded);
            next_tick_us = period_us;
            waiting.clear();
        }
        let now_us = || {
            let passed_us = (settings.clock.now_us() - began_us) as f64;
            start_us + (passed_us * (1.0 + settings.drift)) as u64
        };
        // A board ticks by its own timer; when this thread was late, the ticks are made up with their own times. Each
        // gives the line at most its period to take what it has taken in time before: made up at once, two seconds
        // of contacts would overrun the board's queue, and be lost to no fault of the line.
        while next_tick_us <= now_us() {
            let late = next_tick_us + period_us <= now_us();
            board.tick(next_tick_us);
            next_tick_us += period_us;
            let end = Instant::now() + Duration::from_micros(period_us);
            while late && !waiting.is_empty() && Instant::now() < end {
                drain(&mut port, &mut waiting);
            }
            if waiting.is_empty() {
                let kept = settings.remembers.then_some(&shared.sent);
                let ticked_us = next_tick_us - period_us;
                send(&mut board, ticked_us, kept, &mut waiting, &mut port);
            }
        }
        if let Ok(count) = port.read(&mut buffer) {
            board.receive(&buffer[..count], now_us());
        }
        drain(&mut port, &mut waiting);
        if waiting.is_empty() {
            let kept = settings.remembers.then_some(&shared.sent);
            send(&mut board, now_us(), kept, &mut waiting, &mut port);
        }
    }
}

/// Hands frames to the line until it takes no more.
fn send(
    board: &mut FirmwareBoard,
    now_us: u64,
    kept: Option<&Mutex<Vec<Vec<u8>>>>,
    waiting: &mut Vec<u8>,
    port: &mut TTYPort,
) {
    while waiting.is_empty() {
        let Some(frame) = board.take_frame(now_us) else {
            return;
        };
        waiting.extend_from_slice(frame);
        if let Some(kept) = kept {
            let mut sent = kept.lock().unwrap_or_else(PoisonError::into_inner);
            sent.push(frame.to_vec());
        }
        drain(port, waiting);
    }
}

fn drain(port: &mut TTYPort, waiting: &mut Vec<u8>) {
    while !waiting.is_empty() {
        match port.write(waiting) {
            Ok(count) if count > 0 => drop(waiting.drain(..count)),
            // Nobody reads: the board's own queue fills and drops its oldest.
            _ => return,
        }
    }
}
