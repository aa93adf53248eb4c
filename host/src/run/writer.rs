//! Writes a run as it goes.
//!
//! Promises: only ever appends; what [`RunWriter::flush`] has returned from is with the system, in chunks that are
//! complete, and survives the end of the process; a second thread puts it on the disk right behind (`fdatasync`),
//! so that it survives a loss of power. After the first failed write nothing more is written, so that a file is
//! never patched behind a hole. Memory does not grow with what is written, but for the index that closes an MCAP
//! file: about 300 bytes for each flush.
//!
//! Waiting for the disk in the writing thread was tried first: on a busy computer `fdatasync` took a second, what
//! came meanwhile was only in memory, and a `kill -9` then cost 1.4 s.

use super::schema::{self, LinkState, Log, PointCloud, RoundTrip, Schema, WireFrame};
use super::{FLUSH_EVERY, FORMAT_VERSION, RunError};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, McapError, WriteOptions};
use prost::Message;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

/// Something bytes can be appended to and made safe on.
pub trait Durable: Write {
    /// Sees to it, at once or soon, that everything written so far survives a loss of power.
    ///
    /// # Errors
    /// Those of the disk, also of earlier calls.
    fn make_safe(&mut self) -> io::Result<()>;

    /// Returns once everything is safe; nothing is written afterwards.
    ///
    /// # Errors
    /// Those of the disk, also of earlier calls.
    fn close(&mut self) -> io::Result<()> {
        self.make_safe()
    }
}

/// A file that a thread of its own keeps in step with the disk.
pub struct LogFile {
    file: File,
    /// Wakes the thread; one wake-up waits at most, since one sync covers all that was written before it.
    wake: Option<SyncSender<()>>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl LogFile {
    /// Takes a file that is open for writing.
    ///
    /// # Errors
    /// Those of duplicating the file's handle.
    pub fn new(file: File) -> io::Result<Self> {
        let twin = file.try_clone()?;
        let (wake, woken) = sync_channel(1);
        let thread = std::thread::spawn(move || {
            while woken.recv().is_ok() {
                sync(&twin)?;
            }
            sync(&twin)
        });
        Ok(Self {
            file,
            wake: Some(wake),
            thread: Some(thread),
        })
    }

    /// What became of the thread, which has ended or is about to.
    fn end(&mut self) -> io::Result<()> {
        self.wake = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(io::Error::other("the thread that syncs the file failed")),
            None => Ok(()),
        }
    }
}

/// Syncs a file; a pipe or a device has nothing to be synced.
fn sync(file: &File) -> io::Result<()> {
    match file.sync_data() {
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => Ok(()),
        other => other,
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Durable for LogFile {
    fn make_safe(&mut self) -> io::Result<()> {
        match self.wake.as_ref().map(|wake| wake.try_send(())) {
            Some(Ok(()) | Err(TrySendError::Full(()))) => Ok(()),
            Some(Err(TrySendError::Disconnected(()))) | None => self.end(),
        }
    }

    fn close(&mut self) -> io::Result<()> {
        self.end()
    }
}

impl Durable for Vec<u8> {
    fn make_safe(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<T: Durable + ?Sized> Durable for Box<T> {
    fn make_safe(&mut self) -> io::Result<()> {
        (**self).make_safe()
    }

    fn close(&mut self) -> io::Result<()> {
        (**self).close()
    }
}

/// Counts the bytes that went through; flushing it makes them safe.
struct Counted<W> {
    inner: W,
    written: Arc<AtomicU64>,
}

impl<W: Durable> Write for Counted<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = self.inner.write(bytes)?;
        self.written.fetch_add(taken as u64, Ordering::Relaxed);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()?;
        self.inner.make_safe()
    }
}

type Sink<W> = NoSeek<BufWriter<Counted<W>>>;

/// What is known when a run starts.
#[derive(Clone, Debug, Default)]
pub struct RunStart {
    /// When, nanoseconds since the Unix epoch.
    pub started_ns: u64,
    /// Names and texts of the files the hand is read from ([`crate::hand::Hand::sources`]).
    pub hand: Vec<(String, String)>,
    /// The fingers' names, in the order of their numbers.
    pub fingers: Vec<String>,
    /// Anything else worth keeping: program, options, object.
    pub notes: BTreeMap<String, String>,
}

/// Channels of one finger.
#[derive(Clone, Copy, Debug)]
struct Channels {
    wire: u16,
    points: u16,
    clock: u16,
    link: u16,
}

/// A run being written.
pub struct RunWriter<W: Durable> {
    path: PathBuf,
    /// Gone once a write has failed or the run is finished.
    mcap: Option<mcap::Writer<Sink<W>>>,
    fingers: Vec<Channels>,
    events: u16,
    sequence: BTreeMap<u16, u32>,
    /// What boards have said of themselves so far, in number.
    identities: u32,
    written: Arc<AtomicU64>,
    safe_bytes: u64,
    last_flush: Instant,
    unflushed: bool,
}

/// A contact in the world, as viewers shall see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldContact {
    /// Where, m.
    pub position_m: [f32; 3],
    /// Outward unit normal of the object.
    pub normal: [f32; 3],
    /// Standard deviation of the position per tangent axis, m.
    pub sigma_m: f32,
    /// Normal force, N.
    pub force_n: f32,
}

impl RunWriter<LogFile> {
    /// Creates the file and writes what is known at the start.
    ///
    /// # Errors
    /// [`RunError::Exists`] unless `replace`; [`RunError::Create`]; [`RunError::Write`].
    pub fn create(path: &Path, replace: bool, start: &RunStart) -> Result<Self, RunError> {
        let mut options = File::options();
        options.write(true);
        if replace {
            options.create(true).truncate(true);
        } else {
            options.create_new(true);
        }
        let file = options.open(path).map_err(|source| {
            if source.kind() == io::ErrorKind::AlreadyExists {
                RunError::Exists { path: path.into() }
            } else {
                RunError::Create {
                    path: path.into(),
                    source,
                }
            }
        })?;
        let log = LogFile::new(file).map_err(|source| RunError::Create {
            path: path.into(),
            source,
        })?;
        let run = Self::new(log, path, start)?;
        // The folder's entry has to be on the disk as well. Not every file system lets a folder be synced.
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
            let _ = folder.sync_all();
        }
        Ok(run)
    }
}

impl<W: Durable> RunWriter<W> {
    /// Starts a run on `out`; `path` only serves messages.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn new(out: W, path: &Path, start: &RunStart) -> Result<Self, RunError> {
        let written = Arc::new(AtomicU64::new(0));
        let sink = NoSeek::new(BufWriter::with_capacity(
            1 << 16,
            Counted {
                inner: out,
                written: Arc::clone(&written),
            },
        ));
        let mcap = WriteOptions::new()
            .profile("palpus")
            .library(concat!("palpus ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            // A chunk is assembled in memory and goes out in one piece.
            .disable_seeking(true)
            .chunk_size(Some(1 << 20))
            .create(sink)
            .map_err(|error| RunError::Write {
                path: path.into(),
                source: io_error(error),
                flushed_bytes: 0,
            })?;
        let mut run = Self {
            path: path.into(),
            mcap: Some(mcap),
            fingers: Vec::new(),
            events: 0,
            sequence: BTreeMap::new(),
            identities: 0,
            written,
            safe_bytes: 0,
            last_flush: Instant::now(),
            unflushed: true,
        };
        run.write_start(start)?;
        run.flush()?;
        Ok(run)
    }

    fn write_start(&mut self, start: &RunStart) -> Result<(), RunError> {
        let mut about = start.notes.clone();
        about.insert("format_version".into(), FORMAT_VERSION.to_string());
        about.insert("started_ns".into(), start.started_ns.to_string());
        about.insert("palpus_version".into(), env!("CARGO_PKG_VERSION").into());
        about.insert("fingers".into(), start.fingers.join("\n"));
        self.metadata("palpus.run", about)?;
        for (name, text) in &start.hand {
            let attachment = Attachment {
                log_time: start.started_ns,
                create_time: start.started_ns,
                name: format!("hand/{name}"),
                media_type: "application/octet-stream".into(),
                data: Cow::Borrowed(text.as_bytes()),
            };
            self.with(|mcap| mcap.attach(&attachment))?;
        }
        let schemas = [
            Schema::wire_frame(),
            Schema::point_cloud(),
            Schema::round_trip(),
            Schema::link_state(),
            Schema::log(),
        ];
        let mut ids = Vec::new();
        for schema in &schemas {
            let data = schema.descriptor.encode_to_vec();
            ids.push(self.with(|mcap| mcap.add_schema(schema.name, "protobuf", &data))?);
        }
        for finger in &start.fingers {
            let mut channel = |schema: u16, topic: &str| {
                let topic = format!("/{finger}/{topic}");
                let about = BTreeMap::from([("finger".to_owned(), finger.clone())]);
                self.with(|mcap| mcap.add_channel(schema, &topic, "protobuf", &about))
            };
            let channels = Channels {
                wire: channel(ids[0], "wire")?,
                points: channel(ids[1], "points")?,
                clock: channel(ids[2], "clock")?,
                link: channel(ids[3], "link")?,
            };
            self.fingers.push(channels);
        }
        let none = BTreeMap::new();
        self.events = self.with(|mcap| mcap.add_channel(ids[4], "/events", "protobuf", &none))?;
        Ok(())
    }

    /// Bytes that the system has, in complete chunks.
    pub fn safe_bytes(&self) -> u64 {
        self.safe_bytes
    }

    /// Keeps what a board said of itself; `about` should hold the finger's name under `finger`. The records are
    /// numbered, since other readers take two of one name for one.
    ///
    /// # Errors
    /// [`RunError::Write`], as for everything that writes.
    pub fn identity(&mut self, about: BTreeMap<String, String>) -> Result<(), RunError> {
        self.identities += 1;
        let name = format!("{}/{}", super::IDENTITY, self.identities);
        self.metadata(&name, about)
    }

    /// Keeps one frame of finger number `finger` as it came: received at `received_ns`, its sample taken at
    /// `sampled_ns`, both on the host's clock.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn frame(
        &mut self,
        finger: usize,
        received_ns: u64,
        sampled_ns: u64,
        frame: &[u8],
    ) -> Result<(), RunError> {
        let Some(channels) = self.fingers.get(finger) else {
            return Ok(());
        };
        let message = WireFrame {
            frame: frame.to_vec(),
        };
        self.message(channels.wire, received_ns, sampled_ns, &message)
    }

    /// Keeps the contacts of a tenth of a second for viewers.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn points(
        &mut self,
        finger: usize,
        time_ns: u64,
        contacts: &[WorldContact],
    ) -> Result<(), RunError> {
        let Some(channels) = self.fingers.get(finger) else {
            return Ok(());
        };
        self.message(
            channels.points,
            time_ns,
            time_ns,
            &point_cloud(time_ns, contacts),
        )
    }

    /// Keeps one round trip of the clock alignment.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn round_trip(
        &mut self,
        finger: usize,
        trip: crate::link::clock::RoundTrip,
    ) -> Result<(), RunError> {
        let Some(channels) = self.fingers.get(finger) else {
            return Ok(());
        };
        let time_ns = u64::try_from(trip.received_us)
            .unwrap_or(0)
            .saturating_mul(1000);
        let message = RoundTrip {
            sent_us: trip.sent_us,
            board_received_us: trip.board_received_us,
            board_sent_us: trip.board_sent_us,
            received_us: trip.received_us,
        };
        self.message(channels.clock, time_ns, time_ns, &message)
    }

    /// Keeps the state of a link.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn link_state(
        &mut self,
        finger: usize,
        time_ns: u64,
        state: &LinkState,
    ) -> Result<(), RunError> {
        let Some(channels) = self.fingers.get(finger) else {
            return Ok(());
        };
        self.message(channels.link, time_ns, time_ns, state)
    }

    /// Keeps something that happened.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn event(
        &mut self,
        time_ns: u64,
        level: schema::Level,
        name: &str,
        text: &str,
    ) -> Result<(), RunError> {
        let message = Log {
            timestamp: Some(schema::timestamp(time_ns)),
            level: level as i32,
            message: text.into(),
            name: name.into(),
            file: String::new(),
            line: 0,
        };
        self.message(self.events, time_ns, time_ns, &message)
    }

    /// Flushes if the last flush is [`FLUSH_EVERY`] ago and there is something to flush.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn flush_if_due(&mut self) -> Result<(), RunError> {
        if self.unflushed && self.last_flush.elapsed() >= FLUSH_EVERY {
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the chunk and hands it to the system, which puts it on the disk meanwhile.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn flush(&mut self) -> Result<(), RunError> {
        self.last_flush = Instant::now();
        // Goes down to `Counted::flush`, which sees to the disk.
        self.with(mcap::Writer::flush)?;
        self.unflushed = false;
        self.safe_bytes = self.written.load(Ordering::Relaxed);
        Ok(())
    }

    /// Closes the run with its index and returns its size when all of it is on the disk.
    ///
    /// A run that is dropped instead is closed as well, but errors can't be told.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn finish(mut self) -> Result<u64, RunError> {
        self.with(|mcap| mcap.finish().map(drop))?;
        let Some(mcap) = self.mcap.take() else {
            return Ok(self.safe_bytes);
        };
        let mut sink = mcap.into_inner().into_inner();
        let closed = sink.flush().and_then(|()| sink.get_mut().inner.close());
        closed.map_err(|source| self.write_error(source))?;
        Ok(self.written.load(Ordering::Relaxed))
    }

    fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), RunError> {
        let record = Metadata {
            name: name.into(),
            metadata,
        };
        self.with(|mcap| mcap.write_metadata(&record))
    }

    fn message(
        &mut self,
        channel_id: u16,
        log_time: u64,
        publish_time: u64,
        message: &impl Message,
    ) -> Result<(), RunError> {
        let next = self.sequence.entry(channel_id).or_insert(0);
        let header = MessageHeader {
            channel_id,
            sequence: *next,
            log_time,
            publish_time,
        };
        *next = next.wrapping_add(1);
        self.unflushed = true;
        self.with(|mcap| mcap.write_to_known_channel(&header, &message.encode_to_vec()))
    }

    fn with<T>(
        &mut self,
        write: impl FnOnce(&mut mcap::Writer<Sink<W>>) -> Result<T, McapError>,
    ) -> Result<T, RunError> {
        let Some(mcap) = &mut self.mcap else {
            return Err(self.write_error(io::Error::other("an earlier write failed")));
        };
        write(mcap).map_err(|error| {
            if let Some(mcap) = self.mcap.take() {
                // Keeps the library, and what is still buffered, from adding to a file with a hole.
                drop(mcap.into_inner().into_inner().into_parts());
            }
            self.write_error(io_error(error))
        })
    }

    fn write_error(&self, source: io::Error) -> RunError {
        RunError::Write {
            path: self.path.clone(),
            source,
            flushed_bytes: self.safe_bytes,
        }
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

fn point_cloud(time_ns: u64, contacts: &[WorldContact]) -> PointCloud {
    let names = ["x", "y", "z", "nx", "ny", "nz", "sigma", "force"];
    let mut data = Vec::with_capacity(contacts.len() * names.len() * 4);
    for contact in contacts {
        let [x, y, z] = contact.position_m;
        let [nx, ny, nz] = contact.normal;
        for value in [x, y, z, nx, ny, nz, contact.sigma_m, contact.force_n] {
            data.extend_from_slice(&value.to_le_bytes());
        }
    }
    PointCloud {
        timestamp: Some(schema::timestamp(time_ns)),
        frame_id: "world".into(),
        pose: Some(schema::Pose {
            position: Some(schema::Vector3::default()),
            orientation: Some(schema::Quaternion {
                w: 1.0,
                ..Default::default()
            }),
        }),
        point_stride: (names.len() * 4) as u32,
        fields: names
            .iter()
            .zip(0..)
            .map(|(name, index): (_, u32)| schema::PackedElementField {
                name: (*name).into(),
                offset: index * 4,
                r#type: schema::FLOAT32,
            })
            .collect(),
        data,
    }
}
