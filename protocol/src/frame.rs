//! Frames: envelope, body, check sum, byte stuffing, delimiter.
//!
//! ```text
//! magic  version  schema tag  kind   body (postcard)   CRC-32C        COBS over all of it    0
//! 1      1        2, LE       1      0 to MAX_BODY     4, LE          + 1 byte per 254       1
//! ```
//!
//! The envelope and the check sum are the same in every version. A frame of another version or
//! schema is still known as such, and [`Identify`](crate::Identify) and
//! [`Identity`](crate::Identity) are read all the same.
//!
//! **Why CRC-32C.** A CRC-16 lets one in 65 536 damaged frames pass; at 200 Hz and one damaged
//! frame in a hundred that is one false contact in nine hours, which no surface needs. CRC-32 costs
//! two bytes more and makes it one in 4.3e9 (68 years). Of the 32-bit polynomials Castagnoli's
//! keeps Hamming distance 6 up to 5243 bits, longer than any frame here, where Ethernet's has 5 at
//! that of a contact and 4 beyond 2974 bits (Koopman, "32-bit cyclic redundancy codes for internet
//! applications", 2002).
//!
//! **What remains.** A damaged frame passes with a chance of 2^-32 = 2.3e-10: at 200 Hz and one
//! damaged frame in a hundred, one false frame in 68 years. Damage that reaches the envelope must
//! also hit magic, version and tag, 2^-32 again. The check sum is over the bytes before stuffing,
//! so a bit flipped in a stuffing byte moves others, and the distance above holds for flips that
//! leave the stuffing alone. Measured (`cargo run --release -p palpus-protocol --example
//! link_promises`): of 11 million frames damaged in eleven ways (flipped bits, bursts, dropped,
//! doubled and swapped bytes, cuts, noise) none was accepted with other contents than were sent,
//! and never more than one clean frame was lost after a damaged one; 33 would have passed with 16
//! bits.
//!
//! **Why not more.** Forward error correction and retransmission of contacts were left out: a
//! contact 5 ms late is worth less than the next one, and every loss is counted by sequence number.

use crate::message::is_frozen;
use crate::wire::Wire;
use crate::{CRC, PROTOCOL_VERSION, SCHEMA_HASH, SCHEMA_TAG};
use serde::{Deserialize, Serialize};

/// First byte of every frame before stuffing.
pub const MAGIC: u8 = b'P';
/// Byte that ends every frame and occurs nowhere else.
pub const DELIMITER: u8 = 0;
/// Bytes of magic, version, schema tag and kind.
pub const ENVELOPE_BYTES: usize = 5;
/// Bytes of the check sum.
pub const CRC_BYTES: usize = 4;
/// Largest frame before stuffing.
pub const MAX_RAW_BYTES: usize = ENVELOPE_BYTES + crate::MAX_BODY_BYTES + CRC_BYTES;
/// Largest frame on the wire, stuffing and delimiter included.
pub const MAX_FRAME_BYTES: usize = wire_bytes(crate::MAX_BODY_BYTES);

/// Bytes on the wire of a frame with a body of `body_bytes`, at most: one stuffing byte per 254,
/// and the delimiter.
pub const fn wire_bytes(body_bytes: usize) -> usize {
    let raw = ENVELOPE_BYTES + body_bytes + CRC_BYTES;
    raw + raw.div_ceil(254) + 1
}

/// Why a message could not be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EncodeError {
    /// The buffer is too small: [`MAX_FRAME_BYTES`] are always enough.
    BufferTooSmall,
}

impl core::fmt::Display for EncodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "the buffer is too small for the frame: give it {MAX_FRAME_BYTES} bytes"
        )
    }
}

impl core::error::Error for EncodeError {}

/// Damage found in a received frame. Each is counted, and the frame is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// Longer than any frame.
    TooLong,
    /// Shorter than an envelope and a check sum.
    TooShort,
    /// The byte stuffing points beyond the end.
    Stuffing,
    /// The check sum is wrong.
    Crc,
    /// The check sum is right, but the frame is not one of this protocol.
    Magic,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::TooLong => "frame longer than any message: wrong baud rate, or another device",
            Self::TooShort => {
                "frame shorter than an envelope: damaged on the way, or another device"
            }
            Self::Stuffing => "frame with broken byte stuffing: damaged on the way",
            Self::Crc => "frame with a wrong check sum: damaged on the way",
            Self::Magic => "frame of another protocol: is this the right port?",
        })
    }
}

impl core::error::Error for FrameError {}

/// Why an undamaged frame could not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MessageError {
    /// The sender speaks another protocol version.
    Version {
        /// Version of this build.
        ours: u8,
        /// Version of the sender.
        theirs: u8,
    },
    /// The sender was built from other message definitions.
    Schema {
        /// Low 16 bits of [`SCHEMA_HASH`] of this build.
        ours: u16,
        /// The same of the sender.
        theirs: u16,
    },
    /// No message of this direction has this kind.
    UnknownKind(u8),
    /// The body does not hold the message that its kind promises.
    Body {
        /// The kind.
        kind: u8,
    },
}

impl core::fmt::Display for MessageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Version { ours, theirs } => write!(
                f,
                "the other side speaks protocol version {theirs}, this side {ours}: flash the board with this release's firmware, or use the host program of the board's release"
            ),
            Self::Schema { ours, theirs } => write!(
                f,
                "the other side's messages are schema {theirs:04x}, this side's {ours:04x}, under the same protocol version: build host and firmware from the same source"
            ),
            Self::UnknownKind(kind) => write!(
                f,
                "unknown message kind {kind:#04x}: are two hosts or two boards wired together?"
            ),
            Self::Body { kind } => write!(
                f,
                "unreadable message of kind {kind:#04x}: build host and firmware from the same source"
            ),
        }
    }
}

impl core::error::Error for MessageError {}

/// Writes one frame; see [`BoardMessage::encode`](crate::BoardMessage::encode).
///
/// Everything happens in `out`: the frame before stuffing stands from byte 1 on, and is then
/// stuffed where it stands. That works because a frame has fewer than 254 bytes ([`MAX_RAW_BYTES`],
/// asserted), so that stuffing puts one byte in front and only changes zeros.
pub(crate) fn encode_body<T: Serialize>(
    kind: u8,
    body: &T,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    const BODY_AT: usize = 1 + ENVELOPE_BYTES;
    let [tag_low, tag_high] = SCHEMA_TAG.to_le_bytes();
    let head = out.get_mut(..BODY_AT).ok_or(EncodeError::BufferTooSmall)?;
    head.copy_from_slice(&[DELIMITER, MAGIC, PROTOCOL_VERSION, tag_low, tag_high, kind]);
    let written = postcard::to_slice(body, &mut out[BODY_AT..])
        .map_err(|_| EncodeError::BufferTooSmall)?
        .len();
    let crc_at = BODY_AT + written;
    let end = crc_at + CRC_BYTES;
    let frame = out.get_mut(..=end).ok_or(EncodeError::BufferTooSmall)?;
    let crc = CRC.checksum(&frame[1..crc_at]);
    frame[crc_at..end].copy_from_slice(&crc.to_le_bytes());
    // Consistent overhead byte stuffing (Cheshire and Baker 1999): every zero becomes the distance
    // to the next one, counted from the byte in front; the delimiter is the last.
    frame[end] = DELIMITER;
    let mut distance = 0;
    for byte in frame[..end].iter_mut().rev() {
        distance += 1;
        if *byte == DELIMITER {
            *byte = distance;
            distance = 0;
        }
    }
    Ok(end + 1)
}

/// An undamaged frame: its envelope, and its body still encoded.
///
/// `BoardMessage::try_from(frame)` and `HostMessage::try_from(frame)` read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Protocol version of the sender.
    pub version: u8,
    /// Low 16 bits of the sender's schema hash.
    pub schema_tag: u16,
    /// Which message.
    pub kind: u8,
    /// The message in postcard.
    pub body: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Takes one frame apart in place. `bytes` is what stood between two delimiters, without them.
    pub fn open(bytes: &'a mut [u8]) -> Result<Self, FrameError> {
        let length = cobs::decode_in_place(bytes).map_err(|_| FrameError::Stuffing)?;
        let raw = bytes.get(..length).ok_or(FrameError::Stuffing)?;
        let (content, crc) = raw
            .split_last_chunk::<CRC_BYTES>()
            .ok_or(FrameError::TooShort)?;
        let (&[magic, version, tag_low, tag_high, kind], body) = content
            .split_first_chunk::<ENVELOPE_BYTES>()
            .ok_or(FrameError::TooShort)?;
        if CRC.checksum(content) != u32::from_le_bytes(*crc) {
            Err(FrameError::Crc)
        } else if magic != MAGIC {
            Err(FrameError::Magic)
        } else {
            Ok(Self {
                version,
                schema_tag: u16::from_le_bytes([tag_low, tag_high]),
                kind,
                body,
            })
        }
    }

    /// Whether the sender's version and schema are those of this build.
    pub fn check_version(&self) -> Result<(), MessageError> {
        if self.version != PROTOCOL_VERSION {
            Err(MessageError::Version {
                ours: PROTOCOL_VERSION,
                theirs: self.version,
            })
        } else if self.schema_tag != SCHEMA_TAG {
            Err(MessageError::Schema {
                ours: SCHEMA_TAG,
                theirs: self.schema_tag,
            })
        } else {
            Ok(())
        }
    }

    /// Reads the body as the message of this kind.
    pub(crate) fn body<T: Wire + Deserialize<'a>>(&self, kind: u8) -> Result<T, MessageError> {
        let frozen = is_frozen(kind);
        if !frozen {
            self.check_version()?;
        }
        let (message, rest) =
            postcard::take_from_bytes(self.body).map_err(|_| MessageError::Body { kind })?;
        // A later version may have appended fields to a frozen message; nothing else may have bytes
        // to spare.
        if rest.is_empty() || frozen {
            Ok(message)
        } else {
            Err(MessageError::Body { kind })
        }
    }
}

/// What a [`Decoder`] has seen. Counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounters {
    /// Bytes fed.
    pub bytes: u32,
    /// Undamaged frames.
    pub frames: u32,
    /// Frames too long for any message.
    pub too_long: u32,
    /// Frames too short for an envelope.
    pub too_short: u32,
    /// Frames with broken stuffing.
    pub stuffing: u32,
    /// Frames with a wrong check sum.
    pub crc: u32,
    /// Frames of another protocol.
    pub magic: u32,
}

impl DecoderCounters {
    /// All damaged frames.
    pub const fn bad(&self) -> u32 {
        self.too_long
            .wrapping_add(self.too_short)
            .wrapping_add(self.stuffing)
            .wrapping_add(self.crc)
            .wrapping_add(self.magic)
    }
}

/// Finds frames in a stream of bytes.
///
/// It holds one frame and allocates nothing. Any garbage costs at most the frame it runs into: the
/// delimiter occurs nowhere inside a frame, so the next one starts clean.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME_BYTES],
    length: usize,
    too_long: bool,
    counters: DecoderCounters,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the start of a stream.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME_BYTES],
            length: 0,
            too_long: false,
            counters: DecoderCounters {
                bytes: 0,
                frames: 0,
                too_long: 0,
                too_short: 0,
                stuffing: 0,
                crc: 0,
                magic: 0,
            },
        }
    }

    /// Takes one byte; returns a frame, or the damage found, when the byte ends one.
    ///
    /// Nothing between two delimiters is no frame and no error, so that a sender may lead with a
    /// delimiter.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, FrameError>> {
        self.counters.bytes = self.counters.bytes.wrapping_add(1);
        if byte != DELIMITER {
            match self.buffer.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.too_long = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.too_long) {
            self.counters.too_long = self.counters.too_long.wrapping_add(1);
            return Some(Err(FrameError::TooLong));
        }
        if length == 0 {
            return None;
        }
        let result = match self.buffer.get_mut(..length) {
            Some(bytes) => Frame::open(bytes),
            None => Err(FrameError::TooLong),
        };
        let counter = match result {
            Ok(_) => &mut self.counters.frames,
            Err(FrameError::TooLong) => &mut self.counters.too_long,
            Err(FrameError::TooShort) => &mut self.counters.too_short,
            Err(FrameError::Stuffing) => &mut self.counters.stuffing,
            Err(FrameError::Crc) => &mut self.counters.crc,
            Err(FrameError::Magic) => &mut self.counters.magic,
        };
        *counter = counter.wrapping_add(1);
        Some(result)
    }

    /// What has been seen so far.
    pub const fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Forgets the unfinished frame, as after the port was opened anew; the counters stay.
    pub const fn restart(&mut self) {
        self.length = 0;
        self.too_long = false;
    }
}

const _: () = assert!(SCHEMA_TAG == SCHEMA_HASH as u16);
