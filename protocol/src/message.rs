//! The messages of either direction, and the byte that names each on the wire.

use crate::board::{GaugeStatistics, Identity, Log, RawGauges, Statistics};
use crate::command::{Identify, Reply, Request};
use crate::contact::Contact;
use crate::frame::{EncodeError, Frame, MessageError, encode_body};
use crate::wire::{FNV_BASIS, Wire, fnv1a, fnv1a_nested, larger};

/// Largest of some sizes.
const fn largest(sizes: &[usize]) -> usize {
    let mut most = 0;
    let mut i = 0;
    while i < sizes.len() {
        most = larger(most, sizes[i]);
        i += 1;
    }
    most
}

macro_rules! messages {
    (
        $(#[$meta:meta])*
        pub enum $name:ident { $( $(#[$variant_meta:meta])* $variant:ident = $kind:literal, )* }
    ) => {
        $(#[$meta])*
        // A message lives on the stack between a buffer and its reader; boxing would need an
        // allocator.
        #[allow(clippy::large_enum_variant)]
        #[derive(Clone, Debug, PartialEq)]
        pub enum $name {
            $( $(#[$variant_meta])* $variant($variant), )*
        }

        impl $name {
            /// Largest body of any of these messages, bytes.
            pub const MAX_BODY_BYTES: usize = largest(&[ $( $variant::MAX_BYTES, )* ]);

            /// Fingerprint of these messages, their kinds and all types in them.
            pub(crate) const SCHEMA: u64 = {
                let state = fnv1a(FNV_BASIS, stringify!($name).as_bytes());
                $( let state = fnv1a_nested(fnv1a(state, &[$kind]), $variant::SCHEMA); )*
                state
            };

            /// The byte that names this message on the wire.
            pub const fn kind(&self) -> u8 {
                match self { $( Self::$variant(_) => $kind, )* }
            }

            /// Writes the message as a frame, delimiter included, and returns its length.
            ///
            /// [`MAX_FRAME_BYTES`](crate::MAX_FRAME_BYTES) are always enough.
            pub fn encode(&self, out: &mut [u8]) -> Result<usize, EncodeError> {
                match self { $( Self::$variant(body) => encode_body($kind, body, out), )* }
            }
        }

        $(
            impl From<$variant> for $name {
                fn from(body: $variant) -> Self {
                    Self::$variant(body)
                }
            }
        )*

        impl<'a> TryFrom<Frame<'a>> for $name {
            type Error = MessageError;

            fn try_from(frame: Frame<'a>) -> Result<Self, MessageError> {
                match frame.kind {
                    $( $kind => frame.body::<$variant>($kind).map(Self::$variant), )*
                    kind => {
                        // Another version may have kinds this one does not know: say so rather than
                        // "unknown kind".
                        frame.check_version()?;
                        Err(MessageError::UnknownKind(kind))
                    }
                }
            }
        }
    };
}

messages! {
    /// What a board sends.
    pub enum BoardMessage {
        /// Who the board is (frozen layout).
        Identity = 0x01,
        /// One contact.
        Contact = 0x02,
        /// The gauges of one period.
        RawGauges = 0x03,
        /// The board's counters.
        Statistics = 0x04,
        /// Counters of up to four gauges.
        GaugeStatistics = 0x05,
        /// A line of text.
        Log = 0x06,
        /// Answer to a request.
        Reply = 0x07,
    }
}

messages! {
    /// What a host sends.
    pub enum HostMessage {
        /// Who are you? (frozen layout)
        Identify = 0x81,
        /// Any other request.
        Request = 0x82,
    }
}

impl HostMessage {
    /// Id of the request.
    pub const fn request_id(&self) -> u32 {
        match self {
            Self::Identify(identify) => identify.request_id,
            Self::Request(request) => request.request_id,
        }
    }
}

/// Kinds whose layout never changes, so that they are read whatever the version and schema of the
/// sender.
pub(crate) const fn is_frozen(kind: u8) -> bool {
    matches!(kind, 0x01 | 0x81)
}
