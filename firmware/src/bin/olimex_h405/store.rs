//! The calibration's two slots in flash: sectors 10 and 11, 128 KiB each.
//!
//! # Which sectors: two ways
//!
//! *Sectors 1 and 2* (16 KiB) erase in 0.25 s, but the program would have to go around them. *Sectors 10 and 11* lie behind the program
//! and erase in 1 to 2 s. A calibration is written a few times in a board's life and never while streaming, so the simple map was taken.
//!
//! The core stands still during an erase, since its code comes from the same flash: the watchdog is given more time, and board time, which
//! counts interrupts, is put right afterwards from the cycle counter.

use palpus_firmware::store::{CalibrationStore, RECORD_BYTES, StoreError};
use stm32_metapac::FLASH;
use stm32_metapac::flash::vals::Psize;

use crate::time;
use crate::watchdog::{self, Patience};

/// Sector number and address of each slot.
const SLOTS: [(u8, usize); 2] = [(10, 0x080c_0000), (11, 0x080e_0000)];

/// Words of a record.
const WORDS: usize = RECORD_BYTES / 4;

/// Keys that unlock the flash's control register (reference manual RM0090, 3.6.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];

/// Polls for the end of an erase or a word; each takes at least ten cycles, so this is more than 3 s at 168 MHz.
const BUSY_POLLS: u32 = 50_000_000;

/// The slots.
pub struct FlashStore {
    core_hz: u32,
}

impl FlashStore {
    /// The store of a core at this speed.
    pub const fn new(core_hz: u32) -> Self {
        Self { core_hz }
    }

    fn wait() -> Result<(), StoreError> {
        for _ in 0..BUSY_POLLS {
            let status = FLASH.sr().read();
            if !status.bsy() {
                let failed =
                    status.wrperr() || status.pgaerr() || status.pgperr() || status.pgserr();
                return if failed {
                    Err(StoreError::NotWritable)
                } else {
                    Ok(())
                };
            }
        }
        Err(StoreError::NotWritable)
    }

    fn erase(&self, sector: u8) -> Result<(), StoreError> {
        watchdog::set(Patience::Erasing);
        let before = time::Stopwatch::start();
        FLASH.cr().write(|w| {
            w.set_psize(Psize::PSIZE32);
            w.set_ser(true);
            w.set_snb(sector);
        });
        FLASH.cr().modify(|w| w.set_strt(true));
        let result = Self::wait();
        before.catch_up(self.core_hz);
        watchdog::set(Patience::Normal);
        result
    }

    fn program(address: usize, words: &[u32; WORDS]) -> Result<(), StoreError> {
        FLASH.cr().write(|w| {
            w.set_psize(Psize::PSIZE32);
            w.set_pg(true);
        });
        for (index, word) in words.iter().enumerate() {
            // SAFETY: an aligned word within an erased sector that holds nothing but this store's records.
            unsafe { (address as *mut u32).add(index).write_volatile(*word) };
            Self::wait()?;
        }
        Ok(())
    }

    fn load(address: usize) -> [u8; RECORD_BYTES] {
        let mut record = [0; RECORD_BYTES];
        for (index, word) in record.chunks_exact_mut(4).enumerate() {
            // SAFETY: an aligned word of flash, which can always be read.
            let value = unsafe { (address as *const u32).add(index).read_volatile() };
            word.copy_from_slice(&value.to_le_bytes());
        }
        record
    }
}

impl CalibrationStore for FlashStore {
    fn is_permanent(&self) -> bool {
        true
    }

    fn read(&mut self, slot: usize) -> [u8; RECORD_BYTES] {
        SLOTS
            .get(slot)
            .map_or([0xff; RECORD_BYTES], |&(_, address)| Self::load(address))
    }

    fn write(&mut self, slot: usize, record: &[u8; RECORD_BYTES]) -> Result<(), StoreError> {
        let &(sector, address) = SLOTS.get(slot).ok_or(StoreError::NotWritable)?;
        let mut words = [0; WORDS];
        for (word, bytes) in words.iter_mut().zip(record.chunks_exact(4)) {
            *word = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        }
        for key in KEYS {
            FLASH.keyr().write_value(key);
        }
        let result = if FLASH.cr().read().lock() {
            Err(StoreError::NotWritable)
        } else {
            self.erase(sector)
                .and_then(|()| Self::program(address, &words))
        };
        FLASH.cr().write(|w| w.set_lock(true));
        // The data cache may still hold what stood there before.
        FLASH.acr().modify(|w| w.set_dcen(false));
        FLASH.acr().modify(|w| w.set_dcrst(true));
        FLASH.acr().modify(|w| w.set_dcrst(false));
        FLASH.acr().modify(|w| w.set_dcen(true));
        result?;
        if Self::load(address) == *record {
            Ok(())
        } else {
            Err(StoreError::Unreliable)
        }
    }
}
