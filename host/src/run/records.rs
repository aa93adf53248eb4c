//! Reads the records of an MCAP file of which any part may be missing or damaged.
//!
//! Two ways were weighed. *The MCAP library's reader* stops at the first record that is not as it should be and
//! panics on some damaged attachments; what comes after the damage is lost. *A reader of our own* for the few
//! record types a run consists of, which treats damage as one more thing to report and goes on behind it, is
//! 300 lines. The second is used; that the library reads what is written, and that both read the same, is
//! tested.
//!
//! Promises: no panic on any bytes; memory is bounded by the largest whole record (at most
//! [`MAX_RECORD_BYTES`]); every byte of the file is either read, skipped as index, or named in a [`Damage`].
//! After damage reading resumes at the next chunk, which is found by a header that agrees with itself in five
//! places.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom};

/// First and last bytes of every MCAP file.
pub const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// No record of a run is larger; a larger length is damage.
pub const MAX_RECORD_BYTES: u64 = 1 << 28;
/// Bytes of a chunk record between its length and its records, where no compression is named.
const CHUNK_HEADER_BYTES: u64 = 8 + 8 + 8 + 4 + 4 + 8;
/// How much is looked through at a time for the next chunk.
const SEARCH_BYTES: usize = 1 << 16;

const OP_HEADER: u8 = 0x01;
const OP_FOOTER: u8 = 0x02;
const OP_CHANNEL: u8 = 0x04;
const OP_MESSAGE: u8 = 0x05;
const OP_CHUNK: u8 = 0x06;
const OP_MESSAGE_INDEX: u8 = 0x07;
const OP_ATTACHMENT: u8 = 0x09;
const OP_METADATA: u8 = 0x0c;
const OP_DATA_END: u8 = 0x0f;

const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// A part of the file that could not be used as it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Damage {
    /// The file ends where more should follow: it was cut off, or the program writing it was stopped.
    CutOff {
        /// Byte at which the broken record starts, or the file ends.
        at: u64,
    },
    /// A chunk's check sum is wrong; its messages are handed out as doubtful.
    Checksum {
        /// Byte at which the chunk starts.
        at: u64,
    },
    /// Bytes that are no record.
    Skipped {
        /// First of them.
        from: u64,
        /// Byte behind the last.
        to: u64,
    },
    /// A record that does not hold what it should.
    Malformed {
        /// Byte at which it starts.
        at: u64,
        /// Which kind of record.
        what: &'static str,
    },
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::CutOff { at } => write!(f, "cut off at byte {at}"),
            Self::Checksum { at } => write!(f, "chunk at byte {at} has a wrong check sum"),
            Self::Skipped { from, to } => write!(f, "bytes {from} to {to} are unreadable"),
            Self::Malformed { at, what } => write!(f, "{what} at byte {at} is malformed"),
        }
    }
}

/// What a file consists of, in file order.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// The header.
    Header {
        /// Who it is for.
        profile: String,
        /// Who wrote it.
        library: String,
    },
    /// A channel; repeated at the end of a complete file.
    Channel {
        /// Its number.
        id: u16,
        /// Its name.
        topic: String,
    },
    /// A message.
    Message(Message),
    /// An attachment with a right check sum.
    Attachment {
        /// Its name.
        name: String,
        /// Its bytes.
        data: Vec<u8>,
    },
    /// Metadata.
    Metadata {
        /// Its name.
        name: String,
        /// Its entries.
        entries: BTreeMap<String, String>,
    },
    /// Something is missing.
    Damage(Damage),
    /// The file is complete to its last byte.
    End,
}

/// A message of some channel.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Message {
    /// Number of the channel.
    pub channel: u16,
    /// Sequence number within the channel.
    pub sequence: u32,
    /// When it was logged, nanoseconds since the Unix epoch.
    pub log_time_ns: u64,
    /// When what it tells of happened.
    pub publish_time_ns: u64,
    /// Its content.
    pub data: Vec<u8>,
    /// The chunk it stands in is damaged: the content may be, too.
    pub doubtful: bool,
}

/// Takes little-endian values off the front of a slice.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.bytes(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes(4)?.try_into().ok().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.bytes(8)?.try_into().ok().map(u64::from_le_bytes)
    }

    fn prefixed(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(usize::try_from(length).ok()?)
    }

    fn string(&mut self) -> Option<String> {
        String::from_utf8(self.prefixed()?.to_vec()).ok()
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Fields(self.prefixed()?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            map.insert(inner.string()?, inner.string()?);
        }
        Some(map)
    }
}

/// The chunk whose messages are being handed out.
struct Chunk {
    /// Byte of the file at which `records` starts.
    at: u64,
    records: Vec<u8>,
    /// How far it has been read.
    read: usize,
    doubtful: bool,
}

/// Hands out the records of a file one after the other.
pub struct Records<R> {
    source: R,
    length: u64,
    at: u64,
    chunk: Option<Chunk>,
    waiting: Option<Damage>,
    ended: bool,
}

impl<R: Read + Seek> Records<R> {
    /// Starts on a file; `None` if it does not even begin like an MCAP file.
    ///
    /// # Errors
    /// Those of the source.
    pub fn new(mut source: R) -> io::Result<Option<Self>> {
        let length = source.seek(SeekFrom::End(0))?;
        source.seek(SeekFrom::Start(0))?;
        let mut magic = [0; MAGIC.len()];
        if length < MAGIC.len() as u64 {
            return Ok(None);
        }
        source.read_exact(&mut magic)?;
        Ok((magic == *MAGIC).then_some(Self {
            source,
            length,
            at: MAGIC.len() as u64,
            chunk: None,
            waiting: None,
            ended: false,
        }))
    }

    /// The next record; `None` behind the end.
    ///
    /// # Errors
    /// Those of the source.
    pub fn next_record(&mut self) -> io::Result<Option<Record>> {
        loop {
            if let Some(damage) = self.waiting.take() {
                return Ok(Some(Record::Damage(damage)));
            }
            if let Some(record) = self.next_in_chunk() {
                return Ok(Some(record));
            }
            if self.ended {
                return Ok(None);
            }
            if let Some(record) = self.next_in_file()? {
                return Ok(Some(record));
            }
        }
    }

    fn next_in_chunk(&mut self) -> Option<Record> {
        loop {
            let chunk = self.chunk.as_mut()?;
            if chunk.read == chunk.records.len() {
                self.chunk = None;
                return None;
            }
            let at = chunk.at + chunk.read as u64;
            let mut fields = Fields(&chunk.records[chunk.read..]);
            let whole = fields
                .bytes(1)
                .map(|op| op[0])
                .zip(fields.u64())
                .and_then(|(op, length)| Some((op, fields.bytes(usize::try_from(length).ok()?)?)));
            let Some((op, body)) = whole else {
                // The rest of the chunk can't be told apart; where it was cut off that has been said already.
                let damage = Damage::Malformed {
                    at,
                    what: "end of a chunk",
                };
                let said = chunk.doubtful;
                self.chunk = None;
                return (!said).then_some(Record::Damage(damage));
            };
            chunk.read += 9 + body.len();
            let doubtful = chunk.doubtful;
            match op {
                OP_MESSAGE => {
                    return Some(match message(body, doubtful) {
                        Some(message) => Record::Message(message),
                        None => malformed(at, "message"),
                    });
                }
                // A doubtful chunk may name a channel wrongly.
                OP_CHANNEL if !doubtful => {
                    return Some(channel(body).unwrap_or_else(|| malformed(at, "channel")));
                }
                OP_CHANNEL => {
                    if let Some(record) = channel(body) {
                        return Some(record);
                    }
                }
                _ => {}
            }
        }
    }

    /// The next record outside of a chunk; opens chunks and skips indexes, for which it returns `None`.
    fn next_in_file(&mut self) -> io::Result<Option<Record>> {
        let at = self.at;
        if self.length - at < 9 {
            // Behind a footer there is the magic again; without one the file was cut off.
            self.ended = true;
            return Ok(Some(Record::Damage(Damage::CutOff { at })));
        }
        let mut head = [0; 9];
        self.source.seek(SeekFrom::Start(at))?;
        self.source.read_exact(&mut head)?;
        let op = head[0];
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        let length = u64::from_le_bytes(length);
        let fits = length <= self.length - at - 9;
        if op == OP_CHUNK {
            return self.open_chunk(at, length);
        }
        // Opcodes from 0x80 are private records, which anyone may skip; nothing is defined between.
        let known = (OP_HEADER..=OP_DATA_END).contains(&op) || op >= 0x80;
        if !known || !fits || length > MAX_RECORD_BYTES {
            return self.skip_damage(at).map(Some);
        }
        self.at = at + 9 + length;
        let (what, record) = match op {
            OP_FOOTER => {
                self.ended = true;
                let tail = self.length - self.at;
                let complete = tail == MAGIC.len() as u64 && self.read_at(self.at, tail)? == MAGIC;
                return Ok(Some(if complete {
                    Record::End
                } else {
                    Record::Damage(Damage::CutOff { at: self.at })
                }));
            }
            OP_MESSAGE_INDEX => {
                if message_index_agrees(&self.read(length.min(6))?, length) {
                    return Ok(None);
                }
                ("message index", None)
            }
            OP_HEADER => ("header", header(&self.read(length)?)),
            OP_CHANNEL => ("channel", channel(&self.read(length)?)),
            OP_MESSAGE => (
                "message",
                message(&self.read(length)?, false).map(Record::Message),
            ),
            OP_ATTACHMENT => ("attachment", attachment(&self.read(length)?)),
            OP_METADATA => ("metadata", metadata(&self.read(length)?)),
            _ => return Ok(None),
        };
        if record.is_some() {
            return Ok(record);
        }
        // Its length may be what is wrong: no chunk may lie within.
        if let Some(chunk) = self.find_chunk(at + 9)? {
            self.at = self.at.min(chunk);
        }
        Ok(Some(malformed(at, what)))
    }

    fn read_at(&mut self, at: u64, count: u64) -> io::Result<Vec<u8>> {
        self.source.seek(SeekFrom::Start(at))?;
        self.read(count)
    }

    fn read(&mut self, count: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        (&mut self.source).take(count).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn open_chunk(&mut self, at: u64, length: u64) -> io::Result<Option<Record>> {
        let room = self.length - at - 9;
        let header = self.read(room.min(CHUNK_HEADER_BYTES))?;
        let Some(chunk) = chunk_header(&header, length) else {
            return self.skip_damage(at).map(Some);
        };
        if length > room {
            // Cut off, or the length is wrong: the records end at the next chunk, where there is one.
            let next = self.find_chunk(at + 9)?;
            let end = next.unwrap_or(self.length);
            let start = (at + 9 + CHUNK_HEADER_BYTES).min(end);
            let records = self.read_at(start, (end - start).min(MAX_RECORD_BYTES))?;
            self.chunk = Some(Chunk {
                at: start,
                records,
                read: 0,
                doubtful: true,
            });
            self.at = end;
            self.ended = next.is_none();
            return Ok(Some(Record::Damage(Damage::CutOff { at })));
        }
        let records = self.read(chunk.records_bytes)?;
        let doubtful = chunk.crc != 0 && CRC.checksum(&records) != chunk.crc;
        if doubtful {
            self.waiting = Some(Damage::Checksum { at });
        }
        self.chunk = Some(Chunk {
            at: at + 9 + CHUNK_HEADER_BYTES,
            records,
            read: 0,
            doubtful,
        });
        self.at = at + 9 + length;
        Ok(None)
    }

    /// Goes on at the next chunk behind `from`, or ends.
    fn skip_damage(&mut self, from: u64) -> io::Result<Record> {
        Ok(Record::Damage(match self.find_chunk(from + 1)? {
            Some(to) => {
                self.at = to;
                Damage::Skipped { from, to }
            }
            None => {
                self.ended = true;
                Damage::CutOff { at: from }
            }
        }))
    }

    /// Where the next chunk starts at or behind `from`.
    fn find_chunk(&mut self, from: u64) -> io::Result<Option<u64>> {
        const NEEDED: usize = 9 + CHUNK_HEADER_BYTES as usize;
        let mut window = vec![0; SEARCH_BYTES];
        let mut at = from;
        while at + NEEDED as u64 <= self.length {
            self.source.seek(SeekFrom::Start(at))?;
            let filled = (self.length - at).min(SEARCH_BYTES as u64) as usize;
            self.source.read_exact(&mut window[..filled])?;
            for offset in 0..=filled - NEEDED {
                if window[offset] != OP_CHUNK {
                    continue;
                }
                let mut fields = Fields(&window[offset + 1..offset + NEEDED]);
                let length = fields.u64().unwrap_or(0);
                if chunk_header(fields.0, length).is_some() {
                    return Ok(Some(at + offset as u64));
                }
            }
            at += (filled - NEEDED + 1) as u64;
        }
        Ok(None)
    }
}

struct ChunkHeader {
    crc: u32,
    records_bytes: u64,
}

/// The header of an uncompressed chunk whose lengths agree with each other.
fn chunk_header(header: &[u8], length: u64) -> Option<ChunkHeader> {
    let mut fields = Fields(header);
    let (start, end) = (fields.u64()?, fields.u64()?);
    let uncompressed = fields.u64()?;
    let crc = fields.u32()?;
    let compression = fields.u32()?;
    let records_bytes = fields.u64()?;
    let agrees = start <= end
        && compression == 0
        && uncompressed == records_bytes
        && records_bytes <= MAX_RECORD_BYTES
        && length == CHUNK_HEADER_BYTES + records_bytes;
    agrees.then_some(ChunkHeader { crc, records_bytes })
}

/// Whether a message index of `length` bytes is as long as its list says.
fn message_index_agrees(front: &[u8], length: u64) -> bool {
    let mut fields = Fields(front);
    let list_bytes = fields.u16().and_then(|_| fields.u32());
    list_bytes.is_some_and(|bytes| 6 + u64::from(bytes) == length)
}

fn malformed(at: u64, what: &'static str) -> Record {
    Record::Damage(Damage::Malformed { at, what })
}

fn header(body: &[u8]) -> Option<Record> {
    let mut fields = Fields(body);
    Some(Record::Header {
        profile: fields.string()?,
        library: fields.string()?,
    })
}

fn channel(body: &[u8]) -> Option<Record> {
    let mut fields = Fields(body);
    let id = fields.u16()?;
    fields.u16()?;
    Some(Record::Channel {
        id,
        topic: fields.string()?,
    })
}

fn message(body: &[u8], doubtful: bool) -> Option<Message> {
    let mut fields = Fields(body);
    Some(Message {
        channel: fields.u16()?,
        sequence: fields.u32()?,
        log_time_ns: fields.u64()?,
        publish_time_ns: fields.u64()?,
        data: fields.0.to_vec(),
        doubtful,
    })
}

fn attachment(body: &[u8]) -> Option<Record> {
    let (content, crc) = body.split_last_chunk::<4>()?;
    let crc = u32::from_le_bytes(*crc);
    if crc != 0 && crc != CRC.checksum(content) {
        return None;
    }
    let mut fields = Fields(content);
    fields.u64()?;
    fields.u64()?;
    let name = fields.string()?;
    fields.string()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    let data = fields.bytes(length)?.to_vec();
    Some(Record::Attachment { name, data })
}

fn metadata(body: &[u8]) -> Option<Record> {
    let mut fields = Fields(body);
    Some(Record::Metadata {
        name: fields.string()?,
        entries: fields.map()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::writer::{RunStart, RunWriter, WorldContact};
    use proptest::prelude::*;
    use std::io::Cursor;
    use std::path::Path;
    use std::sync::{Arc, Mutex};

    /// A file in memory that outlives its writer.
    #[derive(Clone, Default)]
    pub struct Shared(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl crate::run::writer::Durable for Shared {
        fn make_safe(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn frame(chunk: u8, k: u8) -> Vec<u8> {
        (1..48).map(|i: u8| i.wrapping_mul(chunk + 3) ^ k).collect()
    }

    /// Four chunks of ten frames each, flushed one by one, and where the file ended after each flush.
    fn small_run() -> (Vec<u8>, Vec<u64>) {
        let file = Shared::default();
        let start = RunStart {
            started_ns: 1_000,
            hand: vec![("hand.urdf".into(), "<robot/>".into())],
            fingers: vec!["thumb".into(), "index".into()],
            notes: BTreeMap::new(),
        };
        let mut run = RunWriter::new(file.clone(), Path::new("x"), &start).unwrap();
        let mut ends = vec![run.safe_bytes()];
        for chunk in 0..4 {
            for k in 0..10 {
                let time_ns = 2_000 + u64::from(chunk) * 100 + u64::from(k);
                run.frame(usize::from(k % 2), time_ns, time_ns - 5, &frame(chunk, k))
                    .unwrap();
            }
            let contact = WorldContact {
                position_m: [0.1, 0.2, 0.3],
                normal: [0.0, 0.0, 1.0],
                sigma_m: 1e-4,
                force_n: 2.0,
            };
            run.points(0, 2_000, &[contact; 3]).unwrap();
            run.flush().unwrap();
            ends.push(run.safe_bytes());
        }
        run.finish().unwrap();
        let bytes = file.0.lock().unwrap().clone();
        (bytes, ends)
    }

    fn read(bytes: &[u8]) -> Vec<Record> {
        let mut records = Vec::new();
        if let Some(mut reader) = Records::new(Cursor::new(bytes)).unwrap() {
            while let Some(record) = reader.next_record().unwrap() {
                records.push(record);
            }
        }
        records
    }

    fn messages(records: &[Record]) -> Vec<&Message> {
        records
            .iter()
            .filter_map(|r| match r {
                Record::Message(m) => Some(m),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn reads_what_the_library_reads() {
        let (bytes, _) = small_run();
        let records = read(&bytes);
        assert_eq!(records.last(), Some(&Record::End));
        assert!(!records.iter().any(|r| matches!(r, Record::Damage(_))));
        let theirs: Vec<_> = mcap::MessageStream::new(&bytes)
            .unwrap()
            .map(|m| m.unwrap())
            .collect();
        let ours = messages(&records);
        assert_eq!(ours.len(), 44);
        assert_eq!(ours.len(), theirs.len());
        for (our, their) in ours.iter().zip(&theirs) {
            assert_eq!(our.channel, their.channel.id);
            assert_eq!(our.sequence, their.sequence);
            assert_eq!(our.log_time_ns, their.log_time);
            assert_eq!(our.publish_time_ns, their.publish_time);
            assert_eq!(our.data, *their.data);
            assert!(!our.doubtful);
            let schema = their.channel.schema.as_ref().unwrap();
            assert_eq!(schema.encoding, "protobuf");
        }
        let attachment = records.iter().find_map(|r| match r {
            Record::Attachment { name, data } => Some((name.as_str(), data.as_slice())),
            _ => None,
        });
        assert_eq!(attachment, Some(("hand/hand.urdf", &b"<robot/>"[..])));
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 44);
    }

    #[test]
    fn cut_off_at_any_byte_everything_flushed_is_read() {
        let (bytes, ends) = small_run();
        let whole = read(&bytes);
        let whole = messages(&whole);
        for cut in 0..bytes.len() {
            let records = read(&bytes[..cut]);
            if cut < MAGIC.len() {
                assert!(records.is_empty());
                continue;
            }
            assert!(
                matches!(records.last(), Some(Record::Damage(Damage::CutOff { .. })))
                    || matches!(records.last(), Some(Record::Message(m)) if m.doubtful)
                    || matches!(records.last(), Some(Record::Channel { .. })),
                "cut at {cut}: {:?}",
                records.last()
            );
            assert!(
                records
                    .iter()
                    .any(|r| matches!(r, Record::Damage(Damage::CutOff { .. }))),
                "cut at {cut} is said"
            );
            let flushed = ends.iter().filter(|end| **end <= cut as u64).count();
            let got = messages(&records);
            assert!(
                got.len() >= flushed.saturating_sub(1) * 11,
                "cut at {cut}: {} messages, {flushed} flushes",
                got.len()
            );
            for (a, b) in got.iter().zip(&whole) {
                assert_eq!(a.data, b.data, "cut at {cut}");
            }
        }
    }

    #[test]
    fn a_damaged_byte_costs_at_most_its_chunk() {
        let (bytes, ends) = small_run();
        let whole = read(&bytes);
        let whole = messages(&whole);
        // From the first flush to the last: the data of the four chunks.
        for at in ends[0]..ends[4] {
            for bit in [0, 3, 7] {
                let mut damaged = bytes.clone();
                damaged[at as usize] ^= 1 << bit;
                let records = read(&damaged);
                let got = messages(&records);
                let same = whole
                    .iter()
                    .filter(|m| {
                        got.iter()
                            .any(|g| g.data == m.data && g.log_time_ns == m.log_time_ns)
                    })
                    .count();
                assert!(same >= 33, "byte {at}, bit {bit}: {same} of 44 messages");
            }
        }
    }

    #[test]
    fn zeros_in_the_middle_and_at_the_end_are_skipped() {
        let (bytes, ends) = small_run();
        let mut zeroed = bytes.clone();
        zeroed[ends[1] as usize..ends[2] as usize].fill(0);
        let records = read(&zeroed);
        assert_eq!(messages(&records).len(), 33);
        assert!(records.contains(&Record::Damage(Damage::Skipped {
            from: ends[1],
            to: ends[2]
        })));
        assert_eq!(records.last(), Some(&Record::End));

        let mut tail = bytes[..ends[3] as usize].to_vec();
        tail.resize(tail.len() + 10_000, 0);
        let records = read(&tail);
        assert_eq!(messages(&records).len(), 33);
        assert_eq!(
            records.last(),
            Some(&Record::Damage(Damage::CutOff { at: ends[3] }))
        );
    }

    proptest! {
        #[test]
        fn any_bytes_end_without_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..4000)) {
            read(&bytes);
            let mut with_magic = MAGIC.to_vec();
            with_magic.extend_from_slice(&bytes);
            read(&with_magic);
        }

        #[test]
        fn damage_anywhere_ends_without_a_panic(
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20)
        ) {
            let (mut bytes, _) = small_run();
            for (at, value) in edits {
                let at = at.index(bytes.len());
                bytes[at] = value;
            }
            read(&bytes);
        }
    }
}
