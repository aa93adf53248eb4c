//! One finger, continuously: streams its contacts, keeps its clock in line, counts what is missing, and finds the
//! board again when it goes.
//!
//! A session runs in a thread of its own and hands [`LinkEvent`]s to a sink that must not block; what the sink
//! does not take is counted. Sessions know nothing of each other: one that has lost its board searches on while
//! the others go on.
//!
//! **Finding a board again.** A board is known by its number and finger name ([`same_board`]), not by the name of
//! its port: after an unplugged cable the ports that differ from the old one only in their number are asked in
//! turn. A port that another session uses is locked and so never asked.

use super::LinkError;
use super::clock::{
    ClockEvent, ClockFilter, RoundTrip, START_RATE_HZ, START_US, STEADY_RATE_HZ, WireTime,
};
use super::connection::{Connection, GIVE_UP_AFTER, Received};
use super::host_clock::HostClock;
use super::port::{candidates, wire_time};
use super::sequence::{Arrival, SequenceTracker};
use palpus_protocol::{
    BoardMessage, CONTACT_FRAME_BYTES, Command, Contact, HostMessage, Identity, LogLevel, Outcome,
    Request, Streams, TimeSyncAnswer, TimeSyncRequest,
};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A streaming board that says nothing for so long is asked whether it is there.
const SILENCE: Duration = Duration::from_secs(1);
/// How long a port is given to answer while a lost board is searched.
const SEARCH_PATIENCE: Duration = Duration::from_millis(600);
/// Pause between two rounds of searching.
const SEARCH_PAUSE: Duration = Duration::from_millis(200);
/// A time request without an answer for so long is forgotten.
const SYNC_PATIENCE: Duration = Duration::from_millis(500);
/// Time requests that wait for their answers at most. With one at a time every request or answer that the line damages
/// costs half a second of comparing: a twentieth of the frames lost made the alignment half as good.
const MOST_ASKED: usize = 8;
/// Round trips made before the stream starts, so that the first contact already has a time.
const FIRST_ROUND_TRIPS: usize = 4;
/// Largest time answer on the wire, bytes.
const SYNC_ANSWER_BYTES: f64 = 45.0;
/// A board's clock that is back by more than this has restarted, microseconds.
const RESTART_US: u64 = 1_000_000;

/// What a session is told.
#[derive(Clone, Debug)]
pub struct SessionSettings {
    /// Name of the finger.
    pub finger: String,
    /// Device it is connected to at first.
    pub port: String,
    /// Baud rate.
    pub baud: u32,
    /// What the board shall stream.
    pub streams: Streams,
}

/// How grave a note is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// Worth knowing.
    Info,
    /// Something is missing or was repaired.
    Warning,
    /// Something failed.
    Error,
}

/// What a session reports.
#[derive(Clone, Debug)]
pub enum LinkEvent {
    /// A board has been found and understood.
    Connected {
        /// Where.
        port: String,
        /// What it says of itself.
        identity: Box<Identity>,
    },
    /// An accepted frame.
    Frame {
        /// Host's clock when it had been read, microseconds since the Unix epoch.
        received_us: i64,
        /// Host's clock when the sample was taken, as aligned now; for frames without a sample as `received_us`.
        sampled_us: i64,
        /// The bytes between two delimiters, untouched.
        wire: Vec<u8>,
        /// The contact, if it is one that has not come before.
        contact: Option<Contact>,
    },
    /// The clocks have been compared.
    RoundTrip(RoundTrip),
    /// The counters, once a second and at the end.
    Status(LinkStatus),
    /// Something happened.
    Note {
        /// How grave it is.
        weight: Weight,
        /// What.
        text: String,
    },
}

/// State of a finger's link since the session began.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkStatus {
    /// Device the board is, or was last, connected to.
    pub port: String,
    /// Whether it answers.
    pub connected: bool,
    /// Contacts accepted, each once.
    pub contacts: u64,
    /// Contacts the board calls valid.
    pub valid: u64,
    /// Contacts the board made that never came.
    pub lost: u64,
    /// Frames with a wrong check sum, encoding or length.
    pub bad: u64,
    /// Frames with a right check sum that could not be read.
    pub unreadable: u64,
    /// Contacts that came twice.
    pub duplicates: u64,
    /// Contacts that came after a later one.
    pub out_of_order: u64,
    /// Times the board was found again.
    pub reconnects: u64,
    /// Times the board started anew.
    pub reboots: u64,
    /// Events the sink did not take.
    pub dropped_by_host: u64,
    /// Host's clock minus board's, microseconds.
    pub offset_us: i64,
    /// How much faster the host's clock runs, as a fraction.
    pub drift: f64,
    /// Half of the room the round trips leave the offset, microseconds.
    pub clock_bound_us: f64,
    /// Round trips the alignment rests on.
    pub round_trips: usize,
}

/// Whether two identities are of the same board: number and name agree.
pub fn same_board(a: &Identity, b: &Identity) -> bool {
    a.board_id == b.board_id && a.finger_name == b.finger_name && a.finger_number == b.finger_number
}

/// Takes an event, or returns false when it has no room.
pub type Sink<'a> = dyn FnMut(LinkEvent) -> bool + 'a;

/// A time request under way.
#[derive(Clone, Copy)]
struct Asked {
    id: u32,
    at: Instant,
    bytes: usize,
}

/// A finger's link.
pub struct Session {
    settings: SessionSettings,
    clock: HostClock,
    connection: Option<Connection>,
    identity: Identity,
    wire: WireTime,
    filter: ClockFilter,
    tracker: SequenceTracker,
    status: LinkStatus,
    /// Latest full board time known.
    board_us: u64,
    /// The time requests under way, oldest first.
    asked: VecDeque<Asked>,
    next_sync: Instant,
    young_until: i64,
    last_frame: Instant,
    next_status: Instant,
    /// Bad frames of connections that are closed.
    bad_before: u64,
    must_start: bool,
}

impl Session {
    /// Opens the port, asks who is there and aligns the clocks roughly.
    ///
    /// # Errors
    /// [`LinkError`]: no such device, no answer, another version or schema.
    pub fn connect(settings: SessionSettings, clock: HostClock) -> Result<Self, LinkError> {
        let connection = Connection::open(&settings.port, settings.baud, clock)?;
        Self::over(connection, settings)
    }

    /// The same over a connection that is open already, by its clock.
    ///
    /// # Errors
    /// [`LinkError`]: no answer, another version or schema.
    pub fn over(mut connection: Connection, settings: SessionSettings) -> Result<Self, LinkError> {
        let identity = connection.identify(GIVE_UP_AFTER)?;
        connection.check_peer()?;
        let clock = connection.clock();
        let now = clock.instant();
        let mut session = Self {
            wire: wire_time(&settings.port, settings.baud),
            tracker: SequenceTracker::new(u32::from(settings.streams.contact_every)),
            status: LinkStatus {
                port: settings.port.clone(),
                connected: true,
                ..LinkStatus::default()
            },
            settings,
            clock,
            connection: Some(connection),
            board_us: identity.board_time_us,
            identity,
            filter: ClockFilter::new(),
            asked: VecDeque::new(),
            next_sync: now,
            young_until: clock.now_us() + START_US,
            last_frame: now,
            next_status: now,
            bad_before: 0,
            must_start: true,
        };
        session.first_round_trips(None)?;
        Ok(session)
    }

    /// Takes the unloaded gauges' mean as zero, as [`super::board::tare`] does.
    ///
    /// # Errors
    /// [`LinkError`]; refused while the tip is in contact.
    pub fn tare(&mut self, samples: u16) -> Result<(), LinkError> {
        super::board::tare(self.connection()?, samples, false).map(drop)
    }

    /// What the board said of itself.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The state as it stands.
    pub fn status(&self) -> &LinkStatus {
        &self.status
    }

    /// Streams until `stop`, then tells the board to stop. `publish` gets the state several times a second.
    pub fn run(
        mut self,
        stop: &AtomicBool,
        sink: &mut Sink<'_>,
        publish: &mut dyn FnMut(&LinkStatus),
    ) -> LinkStatus {
        self.announce(sink);
        while !stop.load(Ordering::Relaxed) {
            let Err(error) = self.stream(stop, sink, publish) else {
                continue;
            };
            self.close();
            publish(&self.status);
            self.note(
                sink,
                Weight::Error,
                format!("{error}; searching for the board"),
            );
            self.search(stop, sink);
            publish(&self.status);
        }
        if let Some(connection) = &mut self.connection {
            // What came before the board stopped still counts.
            let stopped = connection.request(Command::Stop, Duration::from_secs(1));
            let end = self.clock.instant() + Duration::from_millis(1);
            while let Ok(Some(received)) = connection_receive(&mut self.connection, end) {
                self.handle(received, sink);
            }
            if let Err(error) = stopped {
                self.note(
                    sink,
                    Weight::Warning,
                    format!("stopping the stream: {error}"),
                );
            }
        }
        self.update_status();
        self.offer(sink, LinkEvent::Status(self.status.clone()));
        publish(&self.status);
        self.status
    }

    /// Serves the board until `stop` or until it is lost.
    fn stream(
        &mut self,
        stop: &AtomicBool,
        sink: &mut Sink<'_>,
        publish: &mut dyn FnMut(&LinkStatus),
    ) -> Result<(), LinkError> {
        self.last_frame = self.clock.instant();
        while !stop.load(Ordering::Relaxed) {
            if self.must_start {
                let streams = self.settings.streams;
                self.connection()?
                    .request(Command::Start(streams), GIVE_UP_AFTER)?;
                self.must_start = false;
                self.last_frame = self.clock.instant();
            }
            self.ask_time()?;
            let deadline = self
                .next_sync
                .min(self.clock.instant() + Duration::from_millis(20));
            if let Some(received) = self.connection()?.receive(deadline)? {
                self.last_frame = self.clock.instant();
                self.handle(received, sink);
            }
            if self
                .clock
                .instant()
                .saturating_duration_since(self.last_frame)
                > SILENCE
            {
                let identity = self.connection()?.identify(GIVE_UP_AFTER)?;
                if !same_board(&identity, &self.identity) {
                    return Err(self.another_board(&identity));
                }
                self.note(
                    sink,
                    Weight::Warning,
                    "the board had stopped sending; started again".into(),
                );
                self.meet(&identity, sink);
                self.must_start = true;
            }
            self.update_status();
            if self.clock.instant() >= self.next_status {
                self.next_status = self.clock.instant() + Duration::from_secs(1);
                self.offer(sink, LinkEvent::Status(self.status.clone()));
            }
            publish(&self.status);
        }
        Ok(())
    }

    fn connection(&mut self) -> Result<&mut Connection, LinkError> {
        self.connection.as_mut().ok_or_else(|| LinkError::Io {
            port: self.settings.port.clone(),
            source: std::io::ErrorKind::NotConnected.into(),
        })
    }

    /// Takes one frame in.
    fn handle(&mut self, received: Received, sink: &mut Sink<'_>) {
        let Received {
            at_us,
            wire,
            message,
        } = received;
        let (mut sampled_us, mut contact) = (at_us, None);
        match message {
            Ok(BoardMessage::Contact(made)) => {
                let arrival = self.tracker.take(&made);
                match arrival {
                    Arrival::Restarted => self.restarted(made.board_time_us, sink),
                    Arrival::After { .. } => {
                        self.board_us = made.widen_time_us(self.board_us);
                    }
                    Arrival::First | Arrival::Late | Arrival::Duplicate => {}
                }
                let taken_us = made.widen_time_us(self.board_us);
                if let Arrival::First | Arrival::After { .. } = arrival {
                    let arrived_us = at_us - self.wire.of(wire.len() + 1);
                    self.filter
                        .hear(arrived_us, i64::try_from(taken_us).unwrap_or(i64::MAX));
                }
                if let Some(fit) = self.filter.fit() {
                    sampled_us = fit.host_us(i64::try_from(taken_us).unwrap_or(i64::MAX));
                }
                if arrival != Arrival::Duplicate {
                    self.status.valid += u64::from(made.is_valid());
                    contact = Some(made);
                }
            }
            Ok(BoardMessage::Identity(identity)) => self.meet(&identity, sink),
            Ok(BoardMessage::Reply(reply)) => {
                if let Outcome::Time(answer) = reply.outcome {
                    self.answer_time(reply.request_id, &answer, at_us, wire.len() + 1, sink);
                }
            }
            Ok(BoardMessage::RawGauges(raw)) => {
                if let Some(fit) = self.filter.fit() {
                    sampled_us = fit.host_us(i64::try_from(raw.board_time_us).unwrap_or(i64::MAX));
                }
            }
            Ok(BoardMessage::Log(log)) => {
                let weight = match log.level {
                    LogLevel::Info => Weight::Info,
                    LogLevel::Warning => Weight::Warning,
                    LogLevel::Error => Weight::Error,
                };
                self.note(sink, weight, format!("the board says: {}", log.text));
            }
            Ok(BoardMessage::Statistics(_) | BoardMessage::GaugeStatistics(_)) => {}
            Err(_) => self.status.unreadable += 1,
        }
        self.offer(
            sink,
            LinkEvent::Frame {
                received_us: at_us,
                sampled_us,
                wire,
                contact,
            },
        );
    }

    /// The board has said who it is: has it restarted meanwhile?
    fn meet(&mut self, identity: &Identity, sink: &mut Sink<'_>) {
        if identity.board_time_us.saturating_add(RESTART_US) < self.board_us {
            self.tracker.restart();
            self.restarted(identity.board_time_us, sink);
        }
        self.board_us = identity.board_time_us;
    }

    fn restarted(&mut self, board_us: u64, sink: &mut Sink<'_>) {
        self.filter.restart();
        self.board_us = board_us;
        self.asked.clear();
        self.must_start = true;
        self.next_sync = self.clock.instant();
        self.young_until = self.clock.now_us() + START_US;
        self.note(
            sink,
            Weight::Warning,
            "the board has restarted: its clock is aligned anew, its tare is gone; tare it when the tip is free"
                .into(),
        );
    }

    /// Sends a time request when one is due.
    fn ask_time(&mut self) -> Result<(), LinkError> {
        let now = self.clock.instant();
        if now < self.next_sync {
            return Ok(());
        }
        let waited = |asked: &Asked| now.saturating_duration_since(asked.at);
        while self
            .asked
            .front()
            .is_some_and(|a| waited(a) >= SYNC_PATIENCE)
        {
            self.asked.pop_front();
        }
        if self.asked.len() >= MOST_ASKED {
            self.next_sync = now + Duration::from_millis(5);
            return Ok(());
        }
        self.next_sync = now + Duration::from_secs_f64(1.0 / self.sync_rate_hz());
        self.send_time_request()
    }

    fn send_time_request(&mut self) -> Result<(), LinkError> {
        // Counted from the start of the clock, so that the number is short on the wire.
        let host_send_us = self.clock.running_us();
        let connection = self.connection()?;
        let request_id = connection.new_id();
        let message = HostMessage::from(Request {
            request_id,
            command: Command::TimeSync(TimeSyncRequest { host_send_us }),
        });
        let at = connection.clock().instant();
        let bytes = connection.send(&message)?;
        self.asked.push_back(Asked {
            id: request_id,
            at,
            bytes,
        });
        Ok(())
    }

    /// Round trips a second: quick while young, never more than half of what the line has to spare.
    fn sync_rate_hz(&self) -> f64 {
        let wanted = if self.clock.now_us() < self.young_until {
            START_RATE_HZ
        } else {
            STEADY_RATE_HZ
        };
        let WireTime::Baud(baud) = self.wire else {
            return wanted;
        };
        let every = f64::from(self.settings.streams.contact_every).max(1.0);
        let contacts_hz = 1e6 / f64::from(self.identity.period_us.max(1)) / every;
        let spare = f64::from(baud) / 10.0 - contacts_hz * CONTACT_FRAME_BYTES as f64;
        wanted.min(0.5 * spare / SYNC_ANSWER_BYTES).max(1.0)
    }

    fn answer_time(
        &mut self,
        request_id: u32,
        answer: &TimeSyncAnswer,
        at_us: i64,
        answer_bytes: usize,
        sink: &mut Sink<'_>,
    ) {
        let Some(place) = self.asked.iter().position(|a| a.id == request_id) else {
            return;
        };
        let Some(Asked { at, bytes, .. }) = self.asked.remove(place) else {
            return;
        };
        if answer.board_send_us.saturating_add(RESTART_US) < self.board_us {
            self.tracker.restart();
            self.restarted(answer.board_send_us, sink);
        }
        self.board_us = self.board_us.max(answer.board_send_us);
        let board = |us: u64| i64::try_from(us).unwrap_or(i64::MAX);
        let trip = RoundTrip {
            sent_us: self.clock.at_us(at) + self.wire.of(bytes),
            board_received_us: board(answer.board_receive_us),
            board_sent_us: board(answer.board_send_us),
            received_us: at_us - self.wire.of(answer_bytes),
        };
        match self.filter.add(trip) {
            ClockEvent::Jumped { by_us } => self.note(
                sink,
                Weight::Warning,
                format!("the board's clock was set by {:.3} s", by_us as f64 * 1e-6),
            ),
            ClockEvent::Kept | ClockEvent::Impossible | ClockEvent::Doubted => {}
        }
        self.offer(sink, LinkEvent::RoundTrip(trip));
    }

    /// Makes a few round trips; without a sink, whatever else comes was sent before the run began and is let go.
    fn first_round_trips(&mut self, mut sink: Option<&mut Sink<'_>>) -> Result<(), LinkError> {
        let end = self.clock.instant() + GIVE_UP_AFTER;
        let mut done = 0;
        while done < FIRST_ROUND_TRIPS && self.clock.instant() < end {
            self.asked.clear();
            self.send_time_request()?;
            let deadline = (self.clock.instant() + SYNC_PATIENCE).min(end);
            while !self.asked.is_empty() {
                let Some(received) = self.connection()?.receive(deadline)? else {
                    break;
                };
                match &mut sink {
                    Some(sink) => self.handle(received, sink),
                    None if matches!(received.message, Ok(BoardMessage::Reply(_))) => {
                        self.handle(received, &mut |_| true);
                    }
                    None => {}
                }
            }
            done += 1;
        }
        Ok(())
    }

    /// Looks for the board until it is found or `stop`.
    fn search(&mut self, stop: &AtomicBool, sink: &mut Sink<'_>) {
        while !stop.load(Ordering::Relaxed) {
            for port in candidates(&self.settings.port) {
                if stop.load(Ordering::Relaxed) {
                    return;
                }
                if self.try_port(&port, sink).is_ok() {
                    return;
                }
            }
            std::thread::sleep(SEARCH_PAUSE);
        }
    }

    fn try_port(&mut self, port: &str, sink: &mut Sink<'_>) -> Result<(), LinkError> {
        let mut connection = Connection::open(port, self.settings.baud, self.clock)?;
        let identity = connection.identify(SEARCH_PATIENCE)?;
        if !same_board(&identity, &self.identity) {
            return Err(self.another_board(&identity));
        }
        connection.check_peer()?;
        self.connection = Some(connection);
        self.wire = wire_time(port, self.settings.baud);
        self.settings.port = port.into();
        self.asked.clear();
        self.must_start = true;
        self.status.port = port.into();
        self.status.connected = true;
        self.status.reconnects += 1;
        self.meet(&identity, sink);
        self.identity = identity;
        self.announce(sink);
        self.note(sink, Weight::Info, format!("the board is back on {port}"));
        self.first_round_trips(Some(sink))
    }

    fn another_board(&self, found: &Identity) -> LinkError {
        LinkError::UnexpectedAnswer {
            port: self.settings.port.clone(),
            asked: "identify",
            answer: format!(
                "board {:02x?} of finger `{}`",
                found.board_id, found.finger_name
            ),
        }
    }

    fn close(&mut self) {
        self.update_status();
        if let Some(connection) = self.connection.take() {
            self.bad_before += connection.counts().bad;
        }
        self.status.connected = false;
        self.asked.clear();
    }

    fn announce(&mut self, sink: &mut Sink<'_>) {
        let event = LinkEvent::Connected {
            port: self.settings.port.clone(),
            identity: Box::new(self.identity.clone()),
        };
        self.offer(sink, event);
    }

    fn note(&mut self, sink: &mut Sink<'_>, weight: Weight, text: String) {
        self.offer(sink, LinkEvent::Note { weight, text });
    }

    fn offer(&mut self, sink: &mut Sink<'_>, event: LinkEvent) {
        if !sink(event) {
            self.status.dropped_by_host += 1;
        }
    }

    fn update_status(&mut self) {
        let counts = self.tracker.counts();
        let status = &mut self.status;
        status.contacts = counts.accepted;
        status.lost = counts.lost;
        status.duplicates = counts.duplicates;
        status.out_of_order = counts.out_of_order;
        status.reboots = counts.restarts;
        if let Some(connection) = &self.connection {
            status.bad = self.bad_before + connection.counts().bad;
        }
        if let Some(fit) = self.filter.fit() {
            status.offset_us = fit.offset_us(i64::try_from(self.board_us).unwrap_or(i64::MAX));
            status.drift = fit.drift;
            status.clock_bound_us = fit.bound_us;
            status.round_trips = fit.round_trips;
        }
    }
}

/// The next message of a connection that may be gone.
fn connection_receive(
    connection: &mut Option<Connection>,
    deadline: Instant,
) -> Result<Option<Received>, LinkError> {
    match connection {
        Some(connection) => connection.receive(deadline),
        None => Ok(None),
    }
}
