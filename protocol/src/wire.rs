//! What a message costs on the wire and what its definition hashes to, both known at compile time.
//!
//! serde and postcard write the bytes. This file adds the two facts serde does not give a `no_std`
//! program: the largest encoded size of a type, and a fingerprint of its definition, so that two
//! sides built from different sources notice.
//!
//! Two ways were weighed. postcard's own `MaxSize` and `postcard-schema` derive both from the type,
//! at the price of two derive crates whose fingerprint changes with their version. The macros below
//! define the type, its size and its fingerprint from the same tokens, so they cannot drift apart,
//! nothing but `core` is involved, and renaming a field or changing the order of two changes the
//! fingerprint. The second way was taken.

/// A type with a known largest encoding and a fingerprint of its definition.
pub trait Wire {
    /// Largest number of bytes postcard writes for a value of this type.
    const MAX_BYTES: usize;
    /// Fingerprint of the definition: names, order and types of the fields, recursively (FNV-1a, 64
    /// bit).
    const SCHEMA: u64;
}

/// FNV-1a offset basis, the start value of every fingerprint.
pub const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;

/// Continues the FNV-1a hash `state` over `text`.
pub const fn fnv1a(mut state: u64, text: &[u8]) -> u64 {
    let mut i = 0;
    while i < text.len() {
        state ^= text[i] as u64;
        state = state.wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    state
}

/// Continues the FNV-1a hash `state` over the fingerprint of a nested type.
pub const fn fnv1a_nested(state: u64, nested: u64) -> u64 {
    fnv1a(state, &nested.to_le_bytes())
}

/// The larger of two sizes, for constant expressions.
pub const fn larger(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Bytes of the varint that can hold `value`.
const fn varint_bytes(mut value: usize) -> usize {
    let mut bytes = 1;
    while value >= 0x80 {
        value >>= 7;
        bytes += 1;
    }
    bytes
}

macro_rules! primitive {
    ($($type:ty => $bytes:expr),* $(,)?) => {
        $(impl Wire for $type {
            const MAX_BYTES: usize = $bytes;
            const SCHEMA: u64 = fnv1a(FNV_BASIS, stringify!($type).as_bytes());
        })*
    };
}

// postcard: one byte for 8-bit types and bool, little-endian IEEE for floats, varints (zigzag when
// signed) for the rest.
primitive! {
    u8 => 1, i8 => 1, bool => 1, f32 => 4,
    u16 => 3, i16 => 3, u32 => 5, i32 => 5, u64 => 10, i64 => 10,
}

impl<T: Wire, const N: usize> Wire for [T; N] {
    const MAX_BYTES: usize = N * T::MAX_BYTES;
    const SCHEMA: u64 = fnv1a_nested(
        fnv1a_nested(fnv1a(FNV_BASIS, b"array"), N as u64),
        T::SCHEMA,
    );
}

impl<T: Wire, const N: usize> Wire for heapless::Vec<T, N> {
    const MAX_BYTES: usize = varint_bytes(N) + N * T::MAX_BYTES;
    const SCHEMA: u64 = fnv1a_nested(fnv1a_nested(fnv1a(FNV_BASIS, b"vec"), N as u64), T::SCHEMA);
}

impl<const N: usize> Wire for heapless::String<N> {
    const MAX_BYTES: usize = varint_bytes(N) + N;
    const SCHEMA: u64 = fnv1a_nested(fnv1a(FNV_BASIS, b"string"), N as u64);
}

/// Defines a structure together with its largest encoding and its fingerprint.
macro_rules! wire_struct {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $( $(#[$field_meta:meta])* $visibility:vis $field:ident : $type:ty ),* $(,)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $name {
            $( $(#[$field_meta])* $visibility $field: $type, )*
        }

        impl $crate::wire::Wire for $name {
            const MAX_BYTES: usize = 0 $( + <$type as $crate::wire::Wire>::MAX_BYTES )*;
            const SCHEMA: u64 = {
                let state = $crate::wire::fnv1a($crate::wire::FNV_BASIS, stringify!($name).as_bytes());
                $(
                    let state = $crate::wire::fnv1a(state, stringify!($field).as_bytes());
                    let state = $crate::wire::fnv1a_nested(state, <$type as $crate::wire::Wire>::SCHEMA);
                )*
                state
            };
        }
    };
}

/// Defines an enumeration of unit and one-field variants (at most 128) with its largest encoding
/// and its fingerprint.
macro_rules! wire_enum {
    (
        $(#[$meta:meta])*
        pub enum $name:ident {
            $( $(#[$variant_meta:meta])* $variant:ident $( ( $type:ty ) )? ),* $(,)?
        }
    ) => {
        $(#[$meta])*
        // The large variants are calibrations; boxing them would need an allocator.
        #[allow(clippy::large_enum_variant)]
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $( $(#[$variant_meta])* $variant $( ( $type ) )?, )*
        }

        impl $crate::wire::Wire for $name {
            const MAX_BYTES: usize = {
                let largest = 0;
                $( let largest = $crate::wire::larger(largest, 0 $( + <$type as $crate::wire::Wire>::MAX_BYTES )?); )*
                1 + largest
            };
            const SCHEMA: u64 = {
                let state = $crate::wire::fnv1a($crate::wire::FNV_BASIS, stringify!($name).as_bytes());
                $(
                    let state = $crate::wire::fnv1a(state, stringify!($variant).as_bytes());
                    $( let state = $crate::wire::fnv1a_nested(state, <$type as $crate::wire::Wire>::SCHEMA); )?
                )*
                state
            };
        }
    };
}

pub(crate) use {wire_enum, wire_struct};
