//! A serial line that goes wrong on purpose: a proxy between a board's device and a device of its own.
//!
//! All faults come from a seed. Rates are per byte and can be set for each direction while the line runs; it can
//! hang up, and come back under another name.
//!
//! What an end does not take at once waits, as in the driver of a serial port ([`WAITING_BYTES`]): on a busy machine
//! a reader may come seconds late, which a pseudo-terminal's own 4 kB do not last for. What finds no room there is
//! lost, and counted as a fault.

use crate::bench_board::pseudo_terminal;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serialport::{SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Bytes that wait in each direction at most: what the system keeps for a serial port.
pub const WAITING_BYTES: usize = 1 << 16;

/// What goes wrong, and how often: chances per byte.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// One bit is flipped.
    pub flip: f64,
    /// The byte is lost.
    pub drop: f64,
    /// The byte comes twice.
    pub double: f64,
    /// The byte changes places with the next one.
    pub swap: f64,
    /// A burst of 1 to 200 bytes of noise replaces what would have come.
    pub burst: f64,
    /// 1 to 200 bytes are lost in one go, as when a write was cut short.
    pub truncate: f64,
    /// The line stalls for 1 to 50 ms.
    pub stall: f64,
    /// What is sent together comes late by up to this, us; each time another delay, and in order.
    pub late_us: u32,
    /// All bytes come as at a wrong baud rate: noise.
    pub garbage: bool,
    /// Nothing is read any more from this side.
    pub blocked: bool,
}

impl Faults {
    /// A line without faults.
    pub const NONE: Self = Self {
        flip: 0.0,
        drop: 0.0,
        double: 0.0,
        swap: 0.0,
        burst: 0.0,
        truncate: 0.0,
        stall: 0.0,
        late_us: 0,
        garbage: false,
        blocked: false,
    };

    /// Every fault by byte, together `rate` per byte.
    pub fn mixed(rate: f64) -> Self {
        Self {
            flip: 0.4 * rate,
            drop: 0.25 * rate,
            double: 0.15 * rate,
            swap: 0.15 * rate,
            burst: 0.02 * rate,
            truncate: 0.03 * rate,
            ..Self::NONE
        }
    }
}

/// Applies faults to bytes; the same seed and the same bytes give the same result.
#[derive(Clone, Debug)]
pub struct FaultInjector {
    rng: ChaCha8Rng,
    noise_left: usize,
    lost_left: usize,
    /// Bytes that were changed, lost or added.
    pub injected: u64,
}

impl FaultInjector {
    /// An injector with its own sequence of chances.
    pub fn new(seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            noise_left: 0,
            lost_left: 0,
            injected: 0,
        }
    }

    /// What comes of `bytes`, and how long the line stalls first.
    pub fn apply(&mut self, bytes: &[u8], faults: &Faults) -> (Vec<u8>, Duration) {
        let mut out = Vec::with_capacity(bytes.len() + 8);
        let mut stall = Duration::ZERO;
        let mut held: Option<u8> = None;
        for &byte in bytes {
            if self.lost_left > 0 {
                self.lost_left -= 1;
                self.injected += 1;
                continue;
            }
            if self.noise_left > 0 || faults.garbage {
                self.noise_left = self.noise_left.saturating_sub(1);
                self.injected += 1;
                out.push(self.rng.random());
                continue;
            }
            let chance: f64 = self.rng.random();
            let mut up_to = 0.0;
            let mut falls_in = |rate: f64| {
                up_to += rate;
                chance >= up_to - rate && chance < up_to
            };
            if falls_in(faults.flip) {
                self.injected += 1;
                out.push(byte ^ (1 << self.rng.random_range(0..8)));
            } else if falls_in(faults.drop) {
                self.injected += 1;
            } else if falls_in(faults.double) {
                self.injected += 1;
                out.extend([byte, byte]);
            } else if falls_in(faults.swap) && held.is_none() {
                self.injected += 1;
                held = Some(byte);
                continue;
            } else if falls_in(faults.burst) {
                self.injected += 1;
                self.noise_left = self.rng.random_range(0..200);
                out.push(self.rng.random());
            } else if falls_in(faults.truncate) {
                self.injected += 1;
                self.lost_left = self.rng.random_range(0..200);
            } else {
                if falls_in(faults.stall) {
                    stall += Duration::from_millis(self.rng.random_range(1..=50));
                }
                out.push(byte);
            }
            out.extend(held.take());
        }
        out.extend(held);
        (out, stall)
    }

    /// How late what is sent now comes.
    pub fn lateness(&mut self, faults: &Faults) -> Duration {
        if faults.late_us == 0 {
            return Duration::ZERO;
        }
        Duration::from_micros(self.rng.random_range(0..=u64::from(faults.late_us)))
    }
}

/// Bytes on their way, in the order in which they were sent.
#[derive(Debug, Default)]
pub struct OnTheWay {
    parts: VecDeque<(Instant, Vec<u8>)>,
    bytes: usize,
}

impl OnTheWay {
    /// Sends bytes that arrive at `due`, but not before those sent earlier; returns how many found no room.
    pub fn send(&mut self, due: Instant, mut bytes: Vec<u8>) -> u64 {
        let room = WAITING_BYTES.saturating_sub(self.bytes).min(bytes.len());
        let lost = bytes.len() - room;
        bytes.truncate(room);
        if !bytes.is_empty() {
            let earliest = self.parts.back().map_or(due, |(due, _)| *due);
            self.bytes += room;
            self.parts.push_back((due.max(earliest), bytes));
        }
        lost as u64
    }

    /// When the next bytes arrive.
    pub fn next_due(&self) -> Option<Instant> {
        self.parts.front().map(|(due, _)| *due)
    }

    /// Offers what has arrived by `now` to `take`, which says how many bytes it took, until it takes less than all.
    pub fn arrive(&mut self, now: Instant, mut take: impl FnMut(&[u8]) -> usize) {
        while let Some((due, bytes)) = self.parts.front_mut()
            && *due <= now
        {
            let taken = take(bytes).min(bytes.len());
            self.bytes -= taken;
            if taken < bytes.len() {
                bytes.drain(..taken);
                return;
            }
            self.parts.pop_front();
        }
    }
}

/// Faults of both directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineFaults {
    /// From the board to the host.
    pub to_host: Faults,
    /// From the host to the board.
    pub to_board: Faults,
}

struct Control {
    faults: LineFaults,
    /// The name under which the host finds the line; none while it is hung up.
    link: Option<PathBuf>,
}

struct Shared {
    stop: AtomicBool,
    control: Mutex<Control>,
}

impl Shared {
    fn control(&self) -> MutexGuard<'_, Control> {
        self.control.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A running line.
pub struct FaultLine {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<u64>>,
}

impl FaultLine {
    /// Puts a line between the board's device and `link`, a name to be made for the host to open.
    pub fn start(board_device: &str, link: &Path, faults: LineFaults, seed: u64) -> Self {
        let board = serialport::new(board_device, 115_200)
            .timeout(Duration::from_millis(1))
            .open_native()
            .expect("the board's device");
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            control: Mutex::new(Control {
                faults,
                link: Some(link.into()),
            }),
        });
        let its = Arc::clone(&shared);
        let thread = std::thread::spawn(move || pump(board, &its, seed));
        let line = Self {
            shared,
            thread: Some(thread),
        };
        line.wait_for(link);
        line
    }

    /// Sets other faults.
    pub fn set_faults(&self, faults: LineFaults) {
        self.shared.control().faults = faults;
    }

    /// Pulls the cable.
    pub fn hang_up(&self) {
        self.shared.control().link = None;
        // The pump looks several times a millisecond.
        std::thread::sleep(Duration::from_millis(50));
    }

    /// Plugs it in again under a name.
    pub fn come_back(&self, link: &Path) {
        self.shared.control().link = Some(link.into());
        self.wait_for(link);
    }

    /// Ends the line and returns how many bytes were changed, lost or added.
    pub fn finish(mut self) -> u64 {
        self.shared.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take();
        thread.and_then(|t| t.join().ok()).unwrap_or(0)
    }

    fn wait_for(&self, link: &Path) {
        let start = Instant::now();
        while !link.exists() && start.elapsed() < Duration::from_secs(5) {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for FaultLine {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The host's side of the line while it is plugged in.
struct HostSide {
    near: TTYPort,
    _device: TTYPort,
    link: PathBuf,
}

impl HostSide {
    fn plug_in(link: &Path) -> Self {
        let (near, device) = pseudo_terminal();
        let path = device.name().expect("a pseudo-terminal has a name");
        let _ = std::fs::remove_file(link);
        std::os::unix::fs::symlink(path, link).expect("the link's folder can be written");
        Self {
            near,
            _device: device,
            link: link.into(),
        }
    }
}

impl Drop for HostSide {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.link);
    }
}

fn pump(mut board: TTYPort, shared: &Shared, seed: u64) -> u64 {
    let mut to_host = FaultInjector::new(seed);
    let mut to_board = FaultInjector::new(seed ^ 0x5eed);
    let mut host: Option<HostSide> = None;
    let (mut for_host, mut for_board) = (OnTheWay::default(), OnTheWay::default());
    let mut buffer = [0; 1_024];
    while !shared.stop.load(Ordering::Relaxed) {
        let (faults, wanted) = {
            let control = shared.control();
            (control.faults, control.link.clone())
        };
        if host.as_ref().map(|side| &side.link) != wanted.as_ref() {
            // Dropped first: the old name goes before the new one comes.
            drop(host.take());
            for_host = OnTheWay::default();
            host = wanted.as_deref().map(HostSide::plug_in);
        }
        if !faults.to_host.blocked
            && let Ok(count) = board.read(&mut buffer)
        {
            let (bytes, stall) = to_host.apply(&buffer[..count], &faults.to_host);
            std::thread::sleep(stall);
            // Written before the other side is read: waiting for it would make the two directions differ.
            if let Some(side) = &mut host {
                let due = Instant::now() + to_host.lateness(&faults.to_host);
                to_host.injected += for_host.send(due, bytes);
                write_some(&mut side.near, &mut for_host);
            }
        }
        if let Some(side) = &mut host
            && !faults.to_board.blocked
            && let Ok(count) = side.near.read(&mut buffer)
        {
            let (bytes, stall) = to_board.apply(&buffer[..count], &faults.to_board);
            std::thread::sleep(stall);
            let due = Instant::now() + to_board.lateness(&faults.to_board);
            to_board.injected += for_board.send(due, bytes);
        }
        write_some(&mut board, &mut for_board);
        if let Some(side) = &mut host {
            write_some(&mut side.near, &mut for_host);
        }
    }
    to_host.injected + to_board.injected
}

/// Writes what has arrived and the other side takes now.
fn write_some(port: &mut TTYPort, arriving: &mut OnTheWay) {
    arriving.arrive(Instant::now(), |bytes| port.write(bytes).unwrap_or(0));
}
