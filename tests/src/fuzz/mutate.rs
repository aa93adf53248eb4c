//! Small damage to an input, from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Values at which programs err: in text, and as bytes.
const WORDS: [&[u8]; 18] = [
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"1e308",
    b"-1e-320",
    b"4294967295",
    b"4294967296",
    b"18446744073709551615",
    b"99999999999999999999999",
    b" ",
    b"\n",
    b"\0\0\0\0",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\0\0\0\0\0\0\xf0\x7f",
    b"\0\0\0\0\0\0\xf8\x7f",
    b"\x01\0\0\0\0\0\0\0",
];

/// One of `inputs` (none is taken as empty) with one to eight things changed, at most `longest` bytes; the same for
/// the same seed.
pub fn mutate(inputs: &[Vec<u8>], longest: usize, seed: u64) -> Vec<u8> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let one_of = |rng: &mut ChaCha8Rng| -> Vec<u8> {
        match inputs.len() {
            0 => Vec::new(),
            n => inputs[rng.random_range(0..n)].clone(),
        }
    };
    let mut bytes = one_of(&mut rng);
    for _ in 0..rng.random_range(1..=8) {
        let at = rng.random_range(0..=bytes.len());
        let end = bytes.len().min(at + rng.random_range(1..=32));
        match rng.random_range(0..7) {
            0 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << rng.random_range(0..8);
                }
            }
            1 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = rng.random();
                }
            }
            2 => drop(bytes.drain(at..end)),
            3 => {
                let copied = bytes[at..end].to_vec();
                bytes.splice(at..at, copied);
            }
            4 => {
                let word = WORDS[rng.random_range(0..WORDS.len())];
                let replaced = rng.random_range(0..=word.len()).min(bytes.len() - at);
                bytes.splice(at..at + replaced, word.iter().copied());
            }
            5 => bytes.truncate(at),
            _ => {
                let other = one_of(&mut rng);
                let from = rng.random_range(0..=other.len());
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
        }
    }
    bytes.truncate(longest);
    bytes
}
