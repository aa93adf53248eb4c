//! Wire types, framing and versions shared by the fingertip board and the host.
//!
//! # The line
//!
//! 8-N-1 serial, 115 200 Bd or more, so ten bits a byte. A contact frame is 48 bytes on the wire,
//! whatever its values: 5 envelope + 37 contact + 4 check sum + 1 stuffing + 1 delimiter. At 200 Hz
//! that is 96 000 Bd, 83 % of 115 200 Bd; the remaining 1 920 bytes a second carry time sync (an
//! answer is at most 47 bytes), statistics (500 bytes for eight gauges), log lines and, thinned
//! out, raw gauges: every twentieth period for eight gauges is 1 150 bytes a second. At 921 600 Bd
//! the same frames go at 1 kHz (52 %).
//!
//! # Messages
//!
//! | kind | message | from | says | largest frame, bytes |
//! |---|---|---|---|---|
//! | 01 | [`Identity`] | board | who it is, its tip, its calibration (frozen layout) | 113 |
//! | 02 | [`Contact`] | board | one contact | 48 |
//! | 03 | [`RawGauges`] | board | counts and tared counts of one period | 115 |
//! | 04 | [`Statistics`] | board | its counters | 144 |
//! | 05 | [`GaugeStatistics`] | board | counters of up to four gauges | 178 |
//! | 06 | [`Log`] | board | a line of text | 103 |
//! | 07 | [`Reply`] | board | answer to a request ([`Outcome`]) | 221 |
//! | 81 | [`Identify`] | host | who are you? (frozen layout) | 16 |
//! | 82 | [`Request`] | host | any other request ([`Command`]) | 221 |
//!
//! # A frame there and back
//!
//! ```
//! use palpus_protocol::{Command, Decoder, HostMessage, MAX_FRAME_BYTES, Request};
//!
//! let ping = HostMessage::from(Request { request_id: 1, command: Command::Ping(7) });
//! let mut wire = [0; MAX_FRAME_BYTES];
//! let length = ping.encode(&mut wire)?;
//!
//! let mut decoder = Decoder::new();
//! let mut heard = None;
//! for &byte in &wire[..length] {
//!     if let Some(frame) = decoder.push(byte) {
//!         heard = Some(HostMessage::try_from(frame?)?);
//!     }
//! }
//! assert_eq!(heard, Some(ping));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Promises
//!
//! - No damaged frame is taken for a good one, but for one in 2^32 (see [`frame`](crate::Frame)).
//! - Any garbage costs at most the one frame it runs into.
//! - Contacts are numbered when they are made, so every one that is lost, on the board or on the
//!   way, is counted exactly.
//! - Requests carry ids and may be repeated; a board acts once and answers each time.
//! - Sides of different version or schema know it from the first frame, can still ask who the other
//!   is, and the error names both.
//!
//! # Wire layout: two ways
//!
//! *Self-describing* (CBOR, MessagePack, protobuf): unknown fields are skipped, versions mix
//! freely. A contact takes 80 to 120 bytes, so 200 Hz would need 230 400 Bd, and the board spends
//! its time on field names. *Positional* (postcard) with a version, a schema tag in each frame and
//! a frozen pair of messages for saying who one is: half the bytes, and a mismatch is a clear
//! refusal instead of a half-understood message. The second was taken. Within it, messages that are
//! rare are plain postcard (varints); a contact is fixed-point at fixed offsets, so that its size,
//! and with it the load of the line, does not depend on what is touched.
//!
//! # Units
//!
//! Lengths mm, forces N, moments N mm, angles rad, times us; every field's doc says so.
#![no_std]

mod board;
mod command;
mod contact;
mod frame;
mod message;
mod wire;

pub use board::{
    GAUGES_PER_PAGE, GaugeCounts, GaugeFlags, GaugeStatistics, GaugeValue, Identity, Log, LogLevel,
    MAX_GAUGES, RawGauges, Statistics, TipGeometry,
};
pub use command::{
    Calibration, CalibrationError, CalibrationStored, Command, Identify, Outcome, Refusal, Reply,
    Request, StorePlace, Streams, TareRequest, Tared, TimeSyncAnswer, TimeSyncRequest, WRENCH_AXES,
};
pub use contact::{
    CONTACT_SEQUENCE_MODULUS, CONTACT_TIME_MODULUS_US, Contact, ContactFlags, PackedContact,
};
pub use frame::{
    CRC_BYTES, DELIMITER, Decoder, DecoderCounters, ENVELOPE_BYTES, EncodeError, Frame, FrameError,
    MAGIC, MAX_FRAME_BYTES, MAX_RAW_BYTES, MessageError, wire_bytes,
};
pub use message::{BoardMessage, HostMessage};
pub use wire::Wire;

/// Version of the protocol: raised when the meaning of a message changes in a way its definition
/// does not show.
pub const PROTOCOL_VERSION: u8 = 1;

/// Fingerprint of all message definitions of this build.
pub const SCHEMA_HASH: u32 = {
    let hash = wire::fnv1a_nested(BoardMessage::SCHEMA, HostMessage::SCHEMA);
    (hash ^ (hash >> 32)) as u32
};

/// The low half of [`SCHEMA_HASH`], carried by every frame.
pub const SCHEMA_TAG: u16 = SCHEMA_HASH as u16;

/// Largest body of any message, bytes.
pub const MAX_BODY_BYTES: usize =
    wire::larger(BoardMessage::MAX_BODY_BYTES, HostMessage::MAX_BODY_BYTES);

/// Bytes of a contact on the wire.
pub const CONTACT_FRAME_BYTES: usize = wire_bytes(<Contact as Wire>::MAX_BYTES);

/// CRC-32C (Castagnoli, as in iSCSI), the check sum of frames and calibrations.
pub static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI);

// 200 Hz fit 115 200 Bd only while these hold.
const _: () = assert!(CONTACT_FRAME_BYTES <= 48);
const _: () = assert!(CONTACT_FRAME_BYTES as u64 * 10 * 200 <= 115_200);
// Frames of fewer than 254 bytes before stuffing need one stuffing byte, in front, and stay far
// below the 655 bytes of CRC-32C's distance 6.
const _: () = assert!(MAX_RAW_BYTES < 254);
