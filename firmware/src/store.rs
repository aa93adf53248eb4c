//! The calibration's place in memory that outlives the power: two slots, a check sum, and a
//! fallback.
//!
//! A new calibration goes into the slot that does not hold the newest one, so the last good one
//! survives a power cut at any moment of the write. Each record carries a generation number; the
//! highest intact one is loaded. The check sum is written last and is read back.
//!
//! ```text
//! offset  0      4           8       10                   10 + length   252
//!         magic  generation  length  calibration (postcard)  0xff...    CRC-32C of bytes 0 to 252
//! ```

use palpus_protocol::{CRC, Calibration};

/// Bytes of a record; a slot holds at least this.
pub const RECORD_BYTES: usize = 256;
/// Slots of a store.
pub const SLOTS: usize = 2;

const MAGIC: [u8; 4] = *b"PCAL";
const HEADER_BYTES: usize = 10;
const CRC_AT: usize = RECORD_BYTES - 4;

/// Why a slot could not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// There is no memory behind the store, or it refused to be written.
    NotWritable,
    /// What was read back is not what was written.
    Unreliable,
}

impl core::fmt::Display for StoreError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotWritable => "calibration store can't be written: the calibration is kept in RAM until the power goes",
            Self::Unreliable => "calibration store does not keep what is written: the calibration is kept in RAM until the power goes",
        })
    }
}

impl core::error::Error for StoreError {}

/// Memory with two slots of [`RECORD_BYTES`].
pub trait CalibrationStore {
    /// Whether what is written outlives the power.
    fn is_permanent(&self) -> bool;

    /// Copies a slot (0 or 1); memory that was never written reads as anything.
    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES];

    /// Erases a slot and writes the record, its last four bytes last. May take as long as an erase
    /// does; never called while streaming.
    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError>;
}

/// A store in RAM: for tests, simulations, and boards without other memory.
#[derive(Clone, Debug)]
pub struct RamStore {
    slots: [[u8; RECORD_BYTES]; SLOTS],
}

impl RamStore {
    /// An empty store.
    pub const fn new() -> Self {
        Self {
            slots: [[0xff; RECORD_BYTES]; SLOTS],
        }
    }
}

impl Default for RamStore {
    fn default() -> Self {
        Self::new()
    }
}

impl CalibrationStore for RamStore {
    fn is_permanent(&self) -> bool {
        false
    }

    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
        self.slots
            .get(slot)
            .copied()
            .unwrap_or([0xff; RECORD_BYTES])
    }

    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
        *self.slots.get_mut(slot).ok_or(StoreError::NotWritable)? = *record;
        Ok(())
    }
}

// A store that the caller keeps, as tests do.
impl<S: CalibrationStore + ?Sized> CalibrationStore for &mut S {
    fn is_permanent(&self) -> bool {
        (**self).is_permanent()
    }

    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
        (**self).read(slot)
    }

    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
        (**self).write(slot, record)
    }
}

fn encode(calibration: &Calibration, generation: u32) -> Result<[u8; RECORD_BYTES], StoreError> {
    let mut record = [0xff; RECORD_BYTES];
    let length = postcard::to_slice(calibration, &mut record[HEADER_BYTES..CRC_AT])
        .map_err(|_| StoreError::NotWritable)?
        .len();
    record[..4].copy_from_slice(&MAGIC);
    record[4..8].copy_from_slice(&generation.to_le_bytes());
    record[8..HEADER_BYTES].copy_from_slice(&(length as u16).to_le_bytes());
    let crc = CRC.checksum(&record[..CRC_AT]);
    record[CRC_AT..].copy_from_slice(&crc.to_le_bytes());
    Ok(record)
}

fn decode(record: &[u8; RECORD_BYTES]) -> Option<(u32, Calibration)> {
    let (content, crc) = record.split_last_chunk::<4>()?;
    if CRC.checksum(content) != u32::from_le_bytes(*crc) {
        return None;
    }
    let content = content.strip_prefix(&MAGIC)?;
    let (generation, content) = content.split_first_chunk::<4>()?;
    let (length, content) = content.split_first_chunk::<2>()?;
    let bytes = content.get(..usize::from(u16::from_le_bytes(*length)))?;
    let calibration: Calibration = postcard::from_bytes(bytes).ok()?;
    calibration.check().ok()?;
    Some((u32::from_le_bytes(*generation), calibration))
}

/// Slot, generation and contents of the newest intact record.
fn newest(store: &mut impl CalibrationStore) -> Option<(usize, u32, Calibration)> {
    let mut best: Option<(usize, u32, Calibration)> = None;
    for slot in 0..SLOTS {
        if let Some((generation, calibration)) = decode(&store.read(slot)) {
            // Generations wrap: the newer is ahead by less than half the circle.
            if best
                .as_ref()
                .is_none_or(|(_, other, _)| generation.wrapping_sub(*other).cast_signed() > 0)
            {
                best = Some((slot, generation, calibration));
            }
        }
    }
    best
}

/// The newest intact calibration, if there is one.
pub fn load(store: &mut impl CalibrationStore) -> Option<Calibration> {
    newest(store).map(|(_, _, calibration)| calibration)
}

/// Keeps a calibration, leaving the newest other one untouched, and reads it back.
pub fn save(
    store: &mut impl CalibrationStore,
    calibration: &Calibration,
) -> Result<(), StoreError> {
    let (slot, generation) = match newest(store) {
        Some((slot, generation, kept)) => {
            if kept == *calibration {
                return Ok(());
            }
            ((slot + 1) % SLOTS, generation.wrapping_add(1))
        }
        None => (0, 0),
    };
    let record = encode(calibration, generation)?;
    store.write(slot, &record)?;
    if store.read(slot) == record {
        Ok(())
    } else {
        Err(StoreError::Unreliable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn calibration(id: u32) -> Calibration {
        let matrix: [f32; 48] = core::array::from_fn(|i| i as f32 * 0.5 - 7.0);
        Calibration::sealed(id, 8, &matrix).expect("sound")
    }

    #[test]
    fn the_last_one_saved_is_loaded() {
        let mut store = RamStore::new();
        assert_eq!(load(&mut store), None);
        for id in 1..8 {
            save(&mut store, &calibration(id)).expect("room");
            assert_eq!(load(&mut store), Some(calibration(id)));
        }
    }

    #[test]
    fn saving_the_same_again_writes_nothing() {
        struct Once(RamStore, u32);
        impl CalibrationStore for Once {
            fn is_permanent(&self) -> bool {
                true
            }
            fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
                self.0.read(slot)
            }
            fn write(
                &mut self,
                slot: usize,
                record: &[u8; RECORD_BYTES],
            ) -> Result<(), StoreError> {
                self.1 += 1;
                self.0.write(slot, record)
            }
        }
        let mut store = Once(RamStore::new(), 0);
        for _ in 0..3 {
            save(&mut store, &calibration(1)).expect("room");
        }
        assert_eq!(store.1, 1);
    }

    #[test]
    fn a_write_cut_off_at_any_byte_leaves_the_last_good_one() {
        for cut in 0..RECORD_BYTES {
            let mut store = RamStore::new();
            save(&mut store, &calibration(1)).expect("room");
            save(&mut store, &calibration(2)).expect("room");
            let whole = encode(&calibration(3), 2).expect("room");
            // Slot 0 holds calibration 1, the older: it is erased, then written up to the cut.
            store.slots[0] = [0xff; RECORD_BYTES];
            store.slots[0][..cut].copy_from_slice(&whole[..cut]);
            assert_eq!(load(&mut store), Some(calibration(2)), "cut at {cut}");
            // The next one goes over the torn slot, not over the good one.
            save(&mut store, &calibration(4)).expect("room");
            assert_eq!(load(&mut store), Some(calibration(4)));
            assert_eq!(decode(&store.slots[1]).map(|(_, kept)| kept.id), Some(2));
        }
    }

    /// Flash as it is: an erase sets all bits bit by bit, a word written clears bits, the last word of a record goes last; and the power
    /// goes after so many of these steps.
    #[derive(Clone)]
    struct Flash {
        slots: [[u8; RECORD_BYTES]; SLOTS],
        steps_left: usize,
        steps: usize,
    }

    impl Flash {
        fn step(&mut self) -> Result<(), StoreError> {
            self.steps_left = self
                .steps_left
                .checked_sub(1)
                .ok_or(StoreError::NotWritable)?;
            self.steps += 1;
            Ok(())
        }
    }

    impl CalibrationStore for Flash {
        fn is_permanent(&self) -> bool {
            true
        }
        fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
            self.slots[slot]
        }
        fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
            for bit in 0..8 {
                self.step()?;
                for (place, byte) in self.slots[slot].iter_mut().enumerate() {
                    // Cells don't erase all at once.
                    *byte |= 1 << ((bit + place) % 8);
                }
            }
            for word in 0..RECORD_BYTES / 4 {
                self.step()?;
                for place in 4 * word..4 * word + 4 {
                    self.slots[slot][place] &= record[place];
                }
            }
            Ok(())
        }
    }

    #[test]
    fn the_power_may_go_at_any_step_of_erasing_and_writing() {
        let new = || Flash {
            slots: [[0xff; RECORD_BYTES]; SLOTS],
            steps_left: usize::MAX,
            steps: 0,
        };
        // So many calibrations lie in flash before: none, one slot, both, both written twice.
        for kept in 0..4 {
            let mut before = new();
            for id in 1..=kept {
                save(&mut before, &calibration(id)).expect("power");
            }
            let mut whole = before.clone();
            save(&mut whole, &calibration(9)).expect("power");
            let steps = whole.steps - before.steps;
            assert_eq!(steps, 8 + RECORD_BYTES / 4);
            for cut in 0..=steps {
                let mut flash = before.clone();
                flash.steps_left = cut;
                let saved = save(&mut flash, &calibration(9));
                assert_eq!(saved.is_ok(), cut == steps);
                // The old one or the new one, and the old one until the new one is whole.
                let expected = if cut == steps { 9 } else { kept };
                let found = load(&mut flash).map_or(0, |calibration| calibration.id);
                assert_eq!(found, expected, "{kept} kept, cut at {cut}");
                // The next one goes in, and the one that was good stays until then.
                flash.steps_left = usize::MAX;
                save(&mut flash, &calibration(10)).expect("power");
                assert_eq!(load(&mut flash), Some(calibration(10)));
                let others = [0, 1].map(|slot| decode(&flash.slots[slot]).map(|(_, kept)| kept.id));
                assert!(
                    expected == 0 || others.contains(&Some(expected)),
                    "{others:?}"
                );
            }
        }
    }

    #[test]
    fn the_generation_may_wrap() {
        let mut store = RamStore::new();
        store.slots[0] = encode(&calibration(1), u32::MAX).expect("room");
        save(&mut store, &calibration(2)).expect("room");
        assert_eq!(load(&mut store), Some(calibration(2)));
    }

    #[test]
    fn memory_that_forgets_is_noticed() {
        struct Forgetful;
        impl CalibrationStore for Forgetful {
            fn is_permanent(&self) -> bool {
                true
            }
            fn read(&mut self, _: usize) -> [u8; RECORD_BYTES] {
                [0; RECORD_BYTES]
            }
            fn write(&mut self, _: usize, _: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
                Ok(())
            }
        }
        assert_eq!(
            save(&mut Forgetful, &calibration(1)),
            Err(StoreError::Unreliable)
        );
        assert_eq!(load(&mut Forgetful), None);
    }

    proptest! {
        #[test]
        fn a_damaged_record_is_not_loaded(place in 0..RECORD_BYTES, mask in 1u8..) {
            let mut record = encode(&calibration(9), 5).expect("room");
            record[place] ^= mask;
            prop_assert_eq!(decode(&record), None);
        }

        #[test]
        fn any_memory_reads_as_nothing(bytes in proptest::collection::vec(any::<u8>(), RECORD_BYTES)) {
            let record: [u8; RECORD_BYTES] = bytes.try_into().expect("that many");
            prop_assert_eq!(decode(&record), None);
        }
    }
}
