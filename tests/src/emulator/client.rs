//! A plain client of a board on a serial line: asks, and keeps everything that comes.

use palpus_protocol::{
    BoardMessage, Command, Contact, Decoder, GaugeCounts, HostMessage, Identify, Identity,
    MAX_FRAME_BYTES, Outcome, Request, Statistics, Streams, TimeSyncAnswer, TimeSyncRequest,
};
use serialport::TTYPort;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Times a question is repeated, and how long its answer is waited for each time.
const TRIES: u32 = 10;
const PATIENCE: Duration = Duration::from_secs(2);

/// Ids of requests go on from client to client: a board does not act twice on an id that it remembers.
static NEXT_ID: AtomicU32 = AtomicU32::new(1_000);

#[derive(Default)]
struct Received {
    messages: Mutex<Vec<BoardMessage>>,
    changed: Condvar,
    damaged: AtomicU32,
    paused: AtomicBool,
}

/// A client with its reading thread.
pub struct Client {
    port: TTYPort,
    received: Arc<Received>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Client {
    /// Opens a line.
    pub fn open(path: &str) -> io::Result<Self> {
        let port = serialport::new(path, 115_200)
            .timeout(Duration::from_millis(20))
            .open_native()
            .map_err(io::Error::other)?;
        let mut reader = port.try_clone_native()?;
        let received = Arc::new(Received::default());
        let stop = Arc::new(AtomicBool::new(false));
        let (kept, stopped) = (Arc::clone(&received), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            super::chips::hurry();
            let mut decoder = Decoder::new();
            let mut bytes = [0_u8; 1024];
            while !stopped.load(Ordering::Relaxed) {
                if kept.paused.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(10));
                    continue;
                }
                let count = match reader.read(&mut bytes) {
                    Ok(count) => count,
                    Err(error)
                        if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) =>
                    {
                        0
                    }
                    Err(_) => break,
                };
                for &byte in &bytes[..count] {
                    match decoder.push(byte) {
                        Some(Ok(frame)) => {
                            if let Ok(message) = BoardMessage::try_from(frame) {
                                lock(&kept.messages).push(message);
                                kept.changed.notify_all();
                            }
                        }
                        Some(Err(_)) => {
                            kept.damaged.fetch_add(1, Ordering::Relaxed);
                        }
                        None => {}
                    }
                }
            }
        });
        Ok(Self {
            port,
            received,
            stop,
            thread: Some(thread),
        })
    }

    /// Everything that came, in order.
    pub fn messages(&self) -> Vec<BoardMessage> {
        lock(&self.received.messages).clone()
    }

    /// The contacts among it.
    pub fn contacts(&self) -> Vec<Contact> {
        contacts(&lock(&self.received.messages))
    }

    /// Frames that came damaged.
    pub fn damaged(&self) -> u32 {
        self.received.damaged.load(Ordering::Relaxed)
    }

    /// Stops or goes on reading, as a host does that is busy with other things.
    pub fn pause(&self, on: bool) {
        self.received.paused.store(on, Ordering::Relaxed);
    }

    /// Forgets what came.
    pub fn clear(&self) {
        lock(&self.received.messages).clear();
    }

    /// Sends bytes as they are.
    pub fn send_raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.write_all(bytes)
    }

    /// Sends a message.
    pub fn send(&mut self, message: &HostMessage) -> io::Result<()> {
        let mut frame = [0; MAX_FRAME_BYTES];
        let length = message.encode(&mut frame).map_err(io::Error::other)?;
        self.port.write_all(&frame[..length])
    }

    /// Waits until `find` finds something in what came.
    pub fn wait<T>(
        &self,
        patience: Duration,
        mut find: impl FnMut(&[BoardMessage]) -> Option<T>,
    ) -> Option<T> {
        let deadline = Instant::now() + patience;
        let mut messages = lock(&self.received.messages);
        loop {
            if let Some(found) = find(&messages) {
                return Some(found);
            }
            let left = deadline.checked_duration_since(Instant::now())?;
            let (guard, _) = self
                .received
                .changed
                .wait_timeout(messages, left)
                .unwrap_or_else(PoisonError::into_inner);
            messages = guard;
        }
    }

    fn ask<T>(
        &mut self,
        message: &HostMessage,
        mut find: impl FnMut(&BoardMessage) -> Option<T>,
    ) -> io::Result<T> {
        // What came before the question is no answer to it, and grows long.
        let mut next = lock(&self.received.messages).len();
        for _ in 0..TRIES {
            self.send(message)?;
            if let Some(answer) = self.wait(PATIENCE, |messages| {
                let new = messages.get(next..).unwrap_or_default();
                next = messages.len();
                new.iter().find_map(&mut find)
            }) {
                return Ok(answer);
            }
        }
        Err(io::Error::new(
            ErrorKind::TimedOut,
            format!("no answer to {message:?}"),
        ))
    }

    /// Asks for something and waits for what came of it.
    pub fn request(&mut self, command: Command) -> io::Result<Outcome> {
        let request_id = self.id();
        self.ask(
            &Request {
                request_id,
                command,
            }
            .into(),
            |message| match message {
                BoardMessage::Reply(reply) if reply.request_id == request_id => {
                    Some(reply.outcome.clone())
                }
                _ => None,
            },
        )
    }

    /// Who the board is.
    pub fn identify(&mut self) -> io::Result<Identity> {
        let request_id = self.id();
        self.ask(&Identify { request_id }.into(), |message| match message {
            BoardMessage::Identity(identity) if identity.request_id == request_id => {
                Some(identity.clone())
            }
            _ => None,
        })
    }

    /// What the board has counted.
    pub fn statistics(&mut self) -> io::Result<Statistics> {
        let request_id = self.id();
        self.ask(
            &Request {
                request_id,
                command: Command::Statistics,
            }
            .into(),
            |message| match message {
                BoardMessage::Statistics(statistics) if statistics.request_id == request_id => {
                    Some(*statistics)
                }
                _ => None,
            },
        )
    }

    /// What the board has counted of each gauge.
    pub fn gauge_statistics(&mut self) -> io::Result<Vec<GaugeCounts>> {
        let Statistics {
            request_id, gauges, ..
        } = self.statistics()?;
        self.wait(PATIENCE, |messages| {
            let mut counts = Vec::new();
            for message in messages {
                if let BoardMessage::GaugeStatistics(page) = message
                    && page.request_id == request_id
                    && usize::from(page.first) == counts.len()
                {
                    counts.extend(page.gauges.iter().copied());
                }
            }
            (counts.len() == usize::from(gauges)).then_some(counts)
        })
        .ok_or_else(|| io::Error::new(ErrorKind::TimedOut, "no gauges' statistics"))
    }

    /// Compares clocks once; the host's time is that of the caller.
    pub fn time_sync(&mut self, host_send_us: u64) -> io::Result<TimeSyncAnswer> {
        match self.request(Command::TimeSync(TimeSyncRequest { host_send_us }))? {
            Outcome::Time(answer) => Ok(answer),
            other => Err(io::Error::other(format!("{other:?}"))),
        }
    }

    /// Starts the contact stream.
    pub fn start_contacts(&mut self) -> io::Result<Outcome> {
        self.request(Command::Start(Streams {
            contact_every: 1,
            raw_every: 0,
        }))
    }

    fn id(&mut self) -> u32 {
        NEXT_ID.fetch_add(1, Ordering::Relaxed)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The contacts among some messages.
pub fn contacts(messages: &[BoardMessage]) -> Vec<Contact> {
    messages
        .iter()
        .filter_map(|message| match message {
            BoardMessage::Contact(contact) => Some(*contact),
            _ => None,
        })
        .collect()
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
