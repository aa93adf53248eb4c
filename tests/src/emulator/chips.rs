//! The chips on the board's serial ports, and the world they measure.

use super::ads122u04::{Ads122u04, Input};
use super::amt21::Encoder;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What the chips measure. It stands still while a round of measurements is under way, so that all gauges and angles of a
/// round belong together.
pub trait World: Send {
    /// Moves on to a time since the start.
    fn advance(&mut self, time: Duration);
    /// What a conversion finds at a gauge's terminals.
    fn gauge(&mut self, gauge: usize) -> Input;
    /// Angle of a joint, rad.
    fn joint_rad(&self, joint: usize) -> f64;
}

/// A world that the test keeps a hand on.
impl<W: World> World for Arc<Mutex<W>> {
    fn advance(&mut self, time: Duration) {
        self.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .advance(time);
    }

    fn gauge(&mut self, gauge: usize) -> Input {
        self.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .gauge(gauge)
    }

    fn joint_rad(&self, joint: usize) -> f64 {
        self.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .joint_rad(joint)
    }
}

/// A round counts as over after this, even when a chip never finished it.
const ROUND_LIMIT: Duration = Duration::from_millis(20);

/// All chips of one board and their world; tests reach in to break things.
pub struct Bench {
    /// The bridge converters, in the order of the gauges.
    pub converters: [Ads122u04; 3],
    /// The encoders, base joint first.
    pub encoders: [Encoder; 3],
    /// What they measure.
    pub world: Box<dyn World>,
    started: Instant,
    rounds: [Option<Instant>; 4],
}

impl Bench {
    /// Chips that measure a world; the encoders have the addresses of the board.
    pub fn new(world: Box<dyn World>) -> Self {
        Self {
            converters: Default::default(),
            encoders: [0x54, 0x58, 0x5c].map(|address| Encoder {
                address,
                ..Encoder::default()
            }),
            world,
            started: Instant::now(),
            rounds: [None; 4],
        }
    }

    /// A line begins a round; the world moves on when no other line is in the middle of one.
    fn begin_round(&mut self, line: usize) {
        let now = Instant::now();
        let busy = |start: &Option<Instant>| start.is_some_and(|start| now - start < ROUND_LIMIT);
        self.rounds[line] = None;
        if !self.rounds.iter().any(busy) {
            self.world.advance(now - self.started);
        }
        self.rounds[line] = Some(now);
    }

    fn converter(&mut self, chip: usize, byte: u8) -> Vec<u8> {
        let now_us = self.started.elapsed().as_micros() as u64;
        let before = self.converters[chip].conversions;
        // A start of the first channel's conversion begins a round; the end of the second's ends it.
        if byte == 0x08 && self.converters[chip].channel() == Some(0) {
            self.begin_round(chip);
        }
        let Self {
            converters, world, ..
        } = self;
        let answer =
            converters[chip].receive(byte, now_us, |channel| world.gauge(2 * chip + channel));
        if converters[chip].conversions != before && converters[chip].channel() == Some(1) {
            self.rounds[chip] = None;
        }
        answer
    }

    fn encoder(&mut self, question: u8) -> Vec<u8> {
        if question == self.encoders[0].address {
            self.begin_round(3);
        }
        for joint in 0..self.encoders.len() {
            if let Some(answer) = self.encoders[joint].answer(question, self.world.joint_rad(joint))
            {
                if joint + 1 == self.encoders.len() {
                    self.rounds[3] = None;
                }
                return answer.to_vec();
            }
        }
        Vec::new()
    }
}

/// The bench behind its lock; a thread that died with it must not hide the first failure.
pub(super) fn lock(bench: &Mutex<Bench>) -> MutexGuard<'_, Bench> {
    bench.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Serves one line until the emulator is gone. Lines 0 to 2 are the converters', 3 the encoders'.
pub(super) fn serve(
    line: usize,
    mut stream: UnixStream,
    bench: Arc<Mutex<Bench>>,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        hurry();
        let mut bytes = [0_u8; 256];
        while let Ok(count @ 1..) = stream.read(&mut bytes) {
            let mut answer = Vec::new();
            {
                let mut bench = lock(&bench);
                for &byte in &bytes[..count] {
                    if line < 3 {
                        answer.extend(bench.converter(line, byte));
                    } else {
                        // On a bus only the answer to the last question is still wanted.
                        answer = bench.encoder(byte);
                    }
                }
            }
            if !answer.is_empty() && stream.write_all(&answer).is_err() {
                break;
            }
        }
    })
}

/// Asks for real-time priority for this thread, not for programs it starts; without it a busy machine makes slow chips.
pub(super) fn hurry() {
    // "PID/task/TID"
    let thread = std::fs::read_link("/proc/thread-self").ok();
    let number = thread.as_deref().and_then(std::path::Path::file_name);
    if let Some(number) = number {
        let _ = Command::new("chrt")
            .args(["--reset-on-fork", "--rr", "--pid", "1"])
            .arg(number)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
    }
}
