//! Measures what the link promises: damages millions of frames in every way a line can, and prints
//! what came of them.
//!
//! ```text
//! cargo run --release -p palpus-protocol --example link_promises [damaged frames per fault]
//! ```
//!
//! Every damaged frame is followed by clean ones. "wrong" counts frames that were accepted with
//! other contents than were sent; the promise is none. "16 bits" counts damaged frames whose check
//! sum would have passed if only its low 16 bits were compared: about one in 65 536 of those that
//! are damaged at random, which shows that the check sum does its work and what a CRC-16 would have
//! let through. "recovery" is the largest number of clean frames lost after a damaged one; the
//! promise is one at most. Ends with status 1 if a promise is broken.

use palpus_protocol::{
    BoardMessage, CRC, CRC_BYTES, Contact, ContactFlags, DELIMITER, Decoder, ENVELOPE_BYTES,
    MAX_FRAME_BYTES,
};
use std::process::ExitCode;

/// SplitMix64 (Steele, Lea, Flood 2014): the same faults in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform below `bound` (small bounds, so the bias is below 1e-16).
    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    fn byte(&mut self) -> u8 {
        (self.next() >> 56) as u8
    }

    fn signed(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }
}

fn contact(random: &mut Random, sequence: u32) -> Contact {
    let direction = [random.signed(), random.signed(), random.signed()];
    let length = direction
        .iter()
        .map(|x| x * x)
        .sum::<f32>()
        .sqrt()
        .max(1e-3);
    let normal = direction.map(|x| x / length);
    Contact {
        sequence: sequence & 0x00ff_ffff,
        board_time_us: u64::from(sequence) * 5000,
        point_mm: normal.map(|x| 20.0 * x),
        normal,
        normal_force_n: 2.0 + random.signed(),
        tangential_force_n: 0.5 + 0.5 * random.signed(),
        spin_n_mm: 4.0 * random.signed(),
        sigma_mm: 0.28,
        joint_angles_rad: [random.signed(), random.signed(), random.signed()],
        flags: ContactFlags::LOADED,
    }
}

/// Damages a frame in place.
type Fault = fn(&mut Random, &mut Vec<u8>);

const FAULTS: [(&str, Fault); 11] = [
    ("1 bit flipped", |random, frame| flip_bits(random, frame, 1)),
    ("2 to 5 bits flipped", |random, frame| {
        let bits = 2 + random.below(4);
        flip_bits(random, frame, bits);
    }),
    ("1 % of bits flipped", |random, frame| {
        for bit in 0..8 * frame.len() {
            if random.below(100) == 0 {
                frame[bit / 8] ^= 1 << (bit % 8);
            }
        }
    }),
    ("burst of 2 to 32 bits", |random, frame| {
        let length = 2 + random.below(31);
        let start = random.below(8 * frame.len() - length);
        for bit in start..start + length {
            if bit == start || bit == start + length - 1 || random.below(2) == 0 {
                frame[bit / 8] ^= 1 << (bit % 8);
            }
        }
    }),
    ("1 byte replaced", |random, frame| {
        let place = random.below(frame.len());
        frame[place] = random.byte();
    }),
    ("1 to 4 bytes dropped", |random, frame| {
        for _ in 0..=random.below(4) {
            let place = random.below(frame.len());
            frame.remove(place);
        }
    }),
    ("1 to 4 bytes doubled", |random, frame| {
        for _ in 0..=random.below(4) {
            let place = random.below(frame.len());
            frame.insert(place, frame[place]);
        }
    }),
    ("2 bytes swapped", |random, frame| {
        let (a, b) = (random.below(frame.len()), random.below(frame.len()));
        frame.swap(a, b);
    }),
    ("cut off, delimiter kept", |random, frame| {
        let keep = random.below(frame.len() - 1);
        frame.drain(keep..frame.len() - 1);
    }),
    ("cut off, delimiter lost", |random, frame| {
        frame.truncate(random.below(frame.len()))
    }),
    ("contents replaced by noise", |random, frame| {
        let last = frame.len() - 1;
        frame[..last].fill_with(|| random.byte());
    }),
];

fn flip_bits(random: &mut Random, frame: &mut [u8], bits: usize) {
    for _ in 0..bits {
        let bit = random.below(8 * frame.len());
        frame[bit / 8] ^= 1 << (bit % 8);
    }
}

/// Whether other contents than `sent` have a check sum whose low 16 bits agree (`bytes` as they
/// stand between two delimiters).
fn sixteen_bits_agree(bytes: &[u8], sent: &[u8]) -> bool {
    let mut bytes = bytes.to_vec();
    let Ok(length) = cobs::decode_in_place(&mut bytes) else {
        return false;
    };
    let Some((content, crc)) = bytes[..length].split_last_chunk::<CRC_BYTES>() else {
        return false;
    };
    content.len() >= ENVELOPE_BYTES
        && content != sent
        && CRC.checksum(content).to_le_bytes()[..2] == crc[..2]
}

#[derive(Default)]
struct Counts {
    damaged: u64,
    harmless: u64,
    refused: u64,
    wrong: u64,
    sixteen_bits: u64,
    clean: u64,
    clean_lost: u64,
    recovery: u64,
}

/// Sends `frames` damaged frames, each followed by two clean ones.
fn measure(fault: Fault, frames: u64, seed: u64) -> Counts {
    let mut random = Random(seed);
    let mut decoder = Decoder::new();
    let mut counts = Counts::default();
    let mut out = [0; MAX_FRAME_BYTES];
    let mut damaged = Vec::with_capacity(2 * MAX_FRAME_BYTES);
    let mut sequence = 0;
    while counts.damaged < frames {
        let sent = contact(&mut random, sequence);
        sequence = sequence.wrapping_add(1);
        let Ok(length) = BoardMessage::Contact(sent).encode(&mut out) else {
            continue;
        };
        damaged.clear();
        damaged.extend_from_slice(&out[..length]);
        fault(&mut random, &mut damaged);
        if damaged == out[..length] {
            continue;
        }
        counts.damaged += 1;
        let expected = contents(&out[..length]);
        for part in damaged.split(|&byte| byte == DELIMITER) {
            counts.sixteen_bits += u64::from(sixteen_bits_agree(part, &expected));
        }
        // A fault that only adds a delimiter in front leaves the frame whole: accepted, and rightly
        // so.
        let check =
            |decoder: &mut Decoder, bytes: &[u8], expected: &[Vec<u8>], counts: &mut Counts| {
                let mut found = 0u64;
                for &byte in bytes {
                    match decoder.push(byte) {
                        Some(Ok(frame))
                            if expected
                                .iter()
                                .any(|sent| sent[ENVELOPE_BYTES..] == *frame.body) =>
                        {
                            found += 1
                        }
                        Some(Ok(_)) => counts.wrong += 1,
                        Some(Err(_)) => counts.refused += 1,
                        None => {}
                    }
                }
                found
            };
        counts.harmless += check(
            &mut decoder,
            &damaged,
            std::slice::from_ref(&expected),
            &mut counts,
        );
        let mut lost = 0;
        for _ in 0..2 {
            let sent = contact(&mut random, sequence);
            sequence = sequence.wrapping_add(1);
            let Ok(length) = BoardMessage::Contact(sent).encode(&mut out) else {
                continue;
            };
            counts.clean += 1;
            let clean = contents(&out[..length]);
            lost += 1 - check(&mut decoder, &out[..length], &[clean], &mut counts).min(1);
        }
        counts.clean_lost += lost;
        counts.recovery = counts.recovery.max(lost);
    }
    counts
}

/// Envelope and body of an undamaged frame; empty for a damaged one.
fn contents(frame: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<u8> = frame
        .iter()
        .copied()
        .filter(|&byte| byte != DELIMITER)
        .collect();
    let length = cobs::decode_in_place(&mut bytes).unwrap_or(0);
    bytes.truncate(length);
    match bytes.split_last_chunk::<CRC_BYTES>() {
        Some((content, crc)) if CRC.checksum(content).to_le_bytes() == *crc => content.to_vec(),
        _ => Vec::new(),
    }
}

fn main() -> ExitCode {
    let frames = match std::env::args().nth(1).map(|text| text.parse()) {
        None => 1_000_000,
        Some(Ok(frames)) => frames,
        Some(Err(_)) => {
            eprintln!("usage: link_promises [damaged frames per fault, a whole number]");
            return ExitCode::from(2);
        }
    };
    println!(
        "| {:<26} | {:>9} | {:>9} | {:>8} | {:>5} | {:>7} | {:>9} | {:>10} | {:>8} |",
        "fault",
        "damaged",
        "refused",
        "harmless",
        "wrong",
        "16 bits",
        "clean",
        "clean lost",
        "recovery"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let mut sum = Counts::default();
    for (number, (name, fault)) in FAULTS.into_iter().enumerate() {
        let counts = measure(fault, frames, number as u64 + 1);
        print_row(name, &counts);
        sum.damaged += counts.damaged;
        sum.refused += counts.refused;
        sum.harmless += counts.harmless;
        sum.wrong += counts.wrong;
        sum.sixteen_bits += counts.sixteen_bits;
        sum.clean += counts.clean;
        sum.clean_lost += counts.clean_lost;
        sum.recovery = sum.recovery.max(counts.recovery);
    }
    print_row("all", &sum);
    if sum.wrong == 0 && sum.recovery <= 1 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn print_row(name: &str, counts: &Counts) {
    let Counts {
        damaged,
        harmless,
        refused,
        wrong,
        sixteen_bits,
        clean,
        clean_lost,
        recovery,
    } = counts;
    println!(
        "| {name:<26} | {damaged:>9} | {refused:>9} | {harmless:>8} | {wrong:>5} | {sixteen_bits:>7} | {clean:>9} | {clean_lost:>10} | {recovery:>8} |"
    );
}
