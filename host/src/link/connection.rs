//! Messages over a port: receiving, sending, asking until there is an answer.
//!
//! A connection keeps the bytes of every accepted frame as they came, so that a log can hold the wire itself.

use super::LinkError;
use super::host_clock::HostClock;
use super::port::{Port, SerialDevice};
use palpus_protocol::{
    BoardMessage, Command, DELIMITER, Decoder, Frame, HostMessage, Identify, Identity,
    MAX_FRAME_BYTES, MessageError, Outcome, Request,
};
use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

/// How long a request waits before it is repeated. A reply may queue behind a full transmit buffer at 115 200 Bd.
pub const REPEAT_AFTER: Duration = Duration::from_millis(250);
/// How long a request is repeated before it is given up.
pub const GIVE_UP_AFTER: Duration = Duration::from_secs(3);
/// Messages that came while an answer was waited for; older ones are dropped beyond this.
const MAX_WAITING: usize = 4_096;

/// One accepted frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Host's clock when the frame had been read, microseconds since the Unix epoch.
    pub at_us: i64,
    /// The bytes between two delimiters, untouched.
    pub wire: Vec<u8>,
    /// The message, or why it can't be read.
    pub message: Result<BoardMessage, MessageError>,
}

/// What a connection has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConnectionCounts {
    /// Bytes received.
    pub bytes: u64,
    /// Frames with a right check sum.
    pub frames: u64,
    /// Frames without one, but for the one in whose middle the port was opened.
    pub bad: u64,
}

/// A board on a port.
pub struct Connection {
    name: String,
    port: Box<dyn Port>,
    clock: HostClock,
    decoder: Decoder,
    partial: Vec<u8>,
    waiting: VecDeque<Received>,
    counts: ConnectionCounts,
    /// Whether a delimiter has come: what is before the first one is the end of a frame whose beginning was read, or let
    /// go, before this connection was there, and no damage.
    joined: bool,
    next_id: u32,
    peer: Option<Peer>,
}

/// What the board's frames say they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its protocol version.
    pub version: u8,
    /// The low half of its schema hash.
    pub schema_tag: u16,
}

impl Peer {
    /// Whether this program understands it; the error names both sides.
    ///
    /// # Errors
    /// [`MessageError::Version`], [`MessageError::Schema`].
    pub fn check(&self) -> Result<(), MessageError> {
        Frame {
            version: self.version,
            schema_tag: self.schema_tag,
            kind: 0,
            body: &[],
        }
        .check_version()
    }
}

/// A request number that differs from run to run: a board outlives the host's.
fn random_id() -> u32 {
    use std::hash::{BuildHasher, Hasher};
    let hash = std::collections::hash_map::RandomState::new()
        .build_hasher()
        .finish();
    (hash as u32).max(1)
}

impl Connection {
    /// Opens a serial device.
    ///
    /// # Errors
    /// [`LinkError::Open`].
    pub fn open(path: &str, baud: u32, clock: HostClock) -> Result<Self, LinkError> {
        let device = SerialDevice::open(path, baud)?;
        Ok(Self::new(path, Box::new(device), clock))
    }

    /// A connection over any port; `name` serves messages.
    pub fn new(name: &str, port: Box<dyn Port>, clock: HostClock) -> Self {
        Self {
            name: name.into(),
            port,
            clock,
            decoder: Decoder::new(),
            partial: Vec::with_capacity(MAX_FRAME_BYTES),
            waiting: VecDeque::new(),
            counts: ConnectionCounts::default(),
            joined: false,
            next_id: random_id(),
            peer: None,
        }
    }

    /// Name of the port.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The clock that frames are dated and waited by.
    pub fn clock(&self) -> HostClock {
        self.clock
    }

    /// The counts so far.
    pub fn counts(&self) -> ConnectionCounts {
        self.counts
    }

    /// What the last accepted frame said of its sender's version.
    pub fn peer(&self) -> Option<Peer> {
        self.peer
    }

    /// Numbers the requests from `id` on, not from anywhere, where a run has to be repeated bit by bit.
    pub fn number_from(&mut self, id: u32) {
        self.next_id = id;
    }

    /// A number no request of this connection has had.
    pub fn new_id(&mut self) -> u32 {
        let id = self.next_id;
        self.next_id = self.next_id.wrapping_add(1).max(1);
        id
    }

    /// Sends a message and returns its bytes on the wire.
    ///
    /// # Errors
    /// [`LinkError::Encode`], [`LinkError::Io`].
    pub fn send(&mut self, message: &HostMessage) -> Result<usize, LinkError> {
        let mut frame = [DELIMITER; 1 + MAX_FRAME_BYTES];
        // The leading delimiter ends whatever noise the board may have heard before.
        let length = 1 + message.encode(&mut frame[1..]).map_err(LinkError::Encode)?;
        let mut rest = &frame[..length];
        while !rest.is_empty() {
            match self.port.write(rest) {
                Ok(0) => return Err(self.io(io::ErrorKind::WriteZero.into())),
                Ok(count) => rest = &rest[count..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.io(error)),
            }
        }
        Ok(length)
    }

    /// The next frame, waiting for it at most until `deadline`.
    ///
    /// # Errors
    /// [`LinkError::Io`] when the device fails; nothing coming is no error.
    pub fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, LinkError> {
        loop {
            if let Some(received) = self.waiting.pop_front() {
                return Ok(Some(received));
            }
            if !self.fill(deadline)?
                || (self.waiting.is_empty() && self.clock.instant() >= deadline)
            {
                return Ok(None);
            }
        }
    }

    /// Asks `command` until it is answered, for at most `give_up`.
    ///
    /// Messages that come meanwhile are kept for [`Self::receive`].
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`], [`LinkError::Refused`], [`LinkError::Mismatch`], [`LinkError::Io`].
    pub fn request(&mut self, command: Command, give_up: Duration) -> Result<Outcome, LinkError> {
        let asked = command_name(&command);
        let request_id = self.new_id();
        let message = HostMessage::from(Request {
            request_id,
            command,
        });
        let outcome = self.ask(&message, asked, give_up, |message| match message {
            BoardMessage::Reply(reply) if reply.request_id == request_id => {
                Ok(reply.outcome.clone())
            }
            _ => Err(()),
        })?;
        match outcome {
            Outcome::Refused(reason) => Err(LinkError::Refused {
                port: self.name.clone(),
                asked,
                reason,
            }),
            outcome => Ok(outcome),
        }
    }

    /// Asks the board who it is; works whatever the versions of the two sides.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`], [`LinkError::Io`].
    pub fn identify(&mut self, give_up: Duration) -> Result<Identity, LinkError> {
        let request_id = self.new_id();
        let message = HostMessage::from(Identify { request_id });
        self.ask(&message, "identify", give_up, |message| match message {
            BoardMessage::Identity(identity) if identity.request_id == request_id => {
                Ok(identity.clone())
            }
            _ => Err(()),
        })
    }

    /// Refuses a board that this program would misunderstand; ask [`Self::identify`] first.
    ///
    /// # Errors
    /// [`LinkError::Mismatch`], naming both sides.
    pub fn check_peer(&self) -> Result<(), LinkError> {
        match self.peer.map(|peer| peer.check()) {
            Some(Err(reason)) => Err(LinkError::Mismatch {
                port: self.name.clone(),
                reason,
            }),
            _ => Ok(()),
        }
    }

    /// Sends `message` again and again until `answer` finds its answer among what comes.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`], [`LinkError::Mismatch`], [`LinkError::Io`].
    pub fn ask<T>(
        &mut self,
        message: &HostMessage,
        asked: &'static str,
        give_up: Duration,
        answer: impl Fn(&BoardMessage) -> Result<T, ()>,
    ) -> Result<T, LinkError> {
        let before = self.counts;
        let start = self.clock.instant();
        let end = start + give_up;
        let mut kept = VecDeque::new();
        let mut mismatch = None;
        let mut found = None;
        'asking: while self.clock.instant() < end {
            self.send(message)?;
            let repeat = (self.clock.instant() + REPEAT_AFTER).min(end);
            while let Some(received) = self.receive(repeat)? {
                match &received.message {
                    Ok(message) => found = answer(message).ok(),
                    Err(error @ (MessageError::Version { .. } | MessageError::Schema { .. })) => {
                        mismatch = Some(*error);
                    }
                    Err(_) => {}
                }
                kept.push_back(received);
                if found.is_some() {
                    break 'asking;
                }
                if kept.len() > MAX_WAITING {
                    kept.pop_front();
                }
            }
        }
        kept.append(&mut self.waiting);
        self.waiting = kept;
        match (found, mismatch) {
            (Some(found), _) => Ok(found),
            (None, Some(reason)) => Err(LinkError::Mismatch {
                port: self.name.clone(),
                reason,
            }),
            (None, None) => Err(LinkError::NoAnswer {
                port: self.name.clone(),
                asked,
                waited: give_up,
                bytes: self.counts.bytes - before.bytes,
                bad: self.counts.bad - before.bad,
            }),
        }
    }

    /// Reads what there is, waiting at most until `deadline`; false when nothing came.
    fn fill(&mut self, deadline: Instant) -> Result<bool, LinkError> {
        let mut buffer = [0; 4_096];
        let patience = deadline
            .saturating_duration_since(self.clock.instant())
            .max(Duration::from_micros(100));
        self.port.set_patience(patience).map_err(|e| self.io(e))?;
        let count = match self.port.read(&mut buffer) {
            Ok(count) => count,
            Err(error)
                if matches!(
                    error.kind(),
                    io::ErrorKind::TimedOut
                        | io::ErrorKind::WouldBlock
                        | io::ErrorKind::Interrupted
                ) =>
            {
                return Ok(false);
            }
            Err(error) => return Err(self.io(error)),
        };
        let at_us = self.clock.now_us();
        self.counts.bytes += count as u64;
        for &byte in &buffer[..count] {
            self.push(byte, at_us);
        }
        Ok(true)
    }

    fn push(&mut self, byte: u8, at_us: i64) {
        if byte != DELIMITER && self.partial.len() < MAX_FRAME_BYTES {
            self.partial.push(byte);
        }
        let joined = self.joined;
        self.joined |= byte == DELIMITER;
        let Some(result) = self.decoder.push(byte) else {
            if byte == DELIMITER {
                self.partial.clear();
            }
            return;
        };
        match result {
            Ok(frame) => {
                self.counts.frames += 1;
                self.peer = Some(Peer {
                    version: frame.version,
                    schema_tag: frame.schema_tag,
                });
                self.waiting.push_back(Received {
                    at_us,
                    wire: self.partial.clone(),
                    message: BoardMessage::try_from(frame),
                });
            }
            Err(_) => self.counts.bad += u64::from(joined),
        }
        self.partial.clear();
    }

    fn io(&self, source: io::Error) -> LinkError {
        LinkError::Io {
            port: self.name.clone(),
            source,
        }
    }
}

/// Decodes one frame as it came over the wire, without its delimiter.
///
/// # Errors
/// Why it can't be read, as text.
pub fn decode_wire(wire: &[u8]) -> Result<BoardMessage, String> {
    let mut bytes = wire.to_vec();
    let frame = Frame::open(&mut bytes).map_err(|e| e.to_string())?;
    BoardMessage::try_from(frame).map_err(|e| e.to_string())
}

/// What a command is called in messages.
fn command_name(command: &Command) -> &'static str {
    match command {
        Command::Ping(_) => "ping",
        Command::Start(_) => "start",
        Command::Stop => "stop",
        Command::Tare(_) => "tare",
        Command::GetCalibration => "get calibration",
        Command::SetCalibration(_) => "set calibration",
        Command::TimeSync(_) => "time sync",
        Command::Statistics => "statistics",
    }
}
