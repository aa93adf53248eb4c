//! The host's end of the board's line, as a pseudo-terminal.
//!
//! Like a USB adapter and its driver it always takes what the board sends, keeps [`BUFFER`] bytes of it, and drops the rest when the
//! program behind the terminal does not read.

use serialport::{SerialPort, TTYPort};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Bytes kept for a program that is busy with other things: 1.4 s of contacts.
pub const BUFFER: usize = 16_384;

/// A pseudo-terminal in front of a board.
pub struct HostLine {
    path: String,
    /// Kept open, so that the line outlives the programs that use it.
    _terminal: File,
    stop: Arc<AtomicBool>,
    dropped: Arc<AtomicU64>,
    corrupt: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl HostLine {
    /// Between a board's socket and a new pseudo-terminal.
    pub fn new(board: UnixStream) -> io::Result<Self> {
        let (mut master, terminal) = TTYPort::pair()?;
        let path = terminal
            .name()
            .ok_or_else(|| io::Error::other("the terminal has no name"))?;
        // A second handle without the first one's exclusive lock, which would keep programs out.
        let keeper = File::options().read(true).write(true).open(&path)?;
        drop(terminal);
        master.set_timeout(Duration::ZERO)?;
        let mut from_host = master.try_clone_native()?;
        from_host.set_timeout(Duration::from_millis(50))?;
        let stop = Arc::new(AtomicBool::new(false));
        let dropped = Arc::new(AtomicU64::new(0));
        let corrupt = Arc::new(AtomicU64::new(0));

        let mut to_board = board.try_clone()?;
        let stopped = Arc::clone(&stop);
        let sender = std::thread::spawn(move || {
            let mut bytes = [0_u8; 512];
            while !stopped.load(Ordering::Relaxed) {
                match from_host.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(count) => {
                        if to_board.write_all(&bytes[..count]).is_err() {
                            break;
                        }
                    }
                    Err(error)
                        if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                    }
                    Err(_) => break,
                }
            }
        });
        let mut from_board = board;
        from_board.set_read_timeout(Some(Duration::from_millis(20)))?;
        let (lost, noise) = (Arc::clone(&dropped), Arc::clone(&corrupt));
        let receiver = std::thread::spawn(move || {
            super::chips::hurry();
            let mut bytes = [0_u8; 4096];
            let mut kept: VecDeque<u8> = VecDeque::new();
            loop {
                match from_board.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(count) => {
                        for byte in &mut bytes[..count] {
                            if noise.load(Ordering::Relaxed) > 0 {
                                noise.fetch_sub(1, Ordering::Relaxed);
                                *byte ^= 0x5a;
                            }
                        }
                        let room = count.min(BUFFER - kept.len());
                        kept.extend(&bytes[..room]);
                        lost.fetch_add((count - room) as u64, Ordering::Relaxed);
                    }
                    // The board is silent; the program may have made room.
                    Err(error)
                        if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(_) => break,
                }
                while let (front @ [_, ..], _) = kept.as_slices() {
                    match master.write(front) {
                        Ok(written @ 1..) => drop(kept.drain(..written)),
                        _ => break,
                    }
                }
            }
        });
        Ok(Self {
            path,
            _terminal: keeper,
            stop,
            dropped,
            corrupt,
            threads: vec![sender, receiver],
        })
    }

    /// What a program opens.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Bytes that nobody had read in time.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Damages the next bytes from the board.
    pub fn corrupt_next(&self, bytes: u64) {
        self.corrupt.store(bytes, Ordering::Relaxed);
    }
}

impl Drop for HostLine {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The receiver ends with the emulator.
        if !self.threads.is_empty() {
            let _ = self.threads.remove(0).join();
        }
    }
}
