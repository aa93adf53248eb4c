//! Why a board started, and whether it is still well: what a restart carries over, and when the watchdog is to be fed.
//!
//! A panic or a fault leaves its [`LastWords`] in RAM that a reset leaves alone. The next start takes them out and says [`Cause::Crash`].
//! What such RAM holds after the power comes on is anything; a check sum tells words from leavings.
//!
//! [`Vigil`] counts beats of the clock since sampling and the link last got through. A board whose ticks stand still, or whose link task
//! does, is not well: the watchdog restarts it. A host that does not listen makes no board unwell.

use crate::cut_off::CutOff;
use crate::event::Event;
use core::fmt::{Arguments, Write};
use heapless::String;
use palpus_protocol::CRC;

/// Room for what a panic says, bytes.
pub const TEXT_BYTES: usize = 120;

/// Words of a record: mark, kind, place, length, text, check sum.
pub const RECORD_WORDS: usize = HEADER_WORDS + TEXT_BYTES / 4 + 1;
const HEADER_WORDS: usize = 4;

/// "last" in ASCII.
const MARK: u32 = 0x6c61_7374;

/// What a board said when it crashed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LastWords {
    /// Whether it was a processor fault; else a panic.
    pub fault: bool,
    /// Address of the fault, or line of the panic.
    pub place: u32,
    /// What it said, as much as there was room for.
    pub text: String<TEXT_BYTES>,
}

impl LastWords {
    /// Of a panic in a source line.
    pub fn panic(line: u32, words: Arguments<'_>) -> Self {
        Self::new(false, line, words)
    }

    /// Of a processor fault at an address.
    pub fn fault(address: u32, words: Arguments<'_>) -> Self {
        Self::new(true, address, words)
    }

    fn new(fault: bool, place: u32, words: Arguments<'_>) -> Self {
        let mut text = String::new();
        // Ends where the room does.
        let _ = CutOff(&mut text).write_fmt(words);
        Self { fault, place, text }
    }

    /// The record that survives a reset.
    pub fn record(&self) -> [u32; RECORD_WORDS] {
        let mut record = [0; RECORD_WORDS];
        record[0] = MARK;
        record[1] = u32::from(self.fault);
        record[2] = self.place;
        record[3] = self.text.len() as u32;
        for (word, bytes) in record[HEADER_WORDS..]
            .iter_mut()
            .zip(self.text.as_bytes().chunks(4))
        {
            let mut whole = [0; 4];
            whole[..bytes.len()].copy_from_slice(bytes);
            *word = u32::from_le_bytes(whole);
        }
        record[RECORD_WORDS - 1] = check_sum(&record);
        record
    }

    /// The words in a record; `None` where there are none.
    pub fn from_record(record: &[u32; RECORD_WORDS]) -> Option<Self> {
        if record[0] != MARK || record[RECORD_WORDS - 1] != check_sum(record) {
            return None;
        }
        let mut bytes = [0; TEXT_BYTES];
        for (bytes, word) in bytes.chunks_exact_mut(4).zip(&record[HEADER_WORDS..]) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        let length = usize::try_from(record[3]).ok()?;
        let text = core::str::from_utf8(bytes.get(..length)?).ok()?;
        Some(Self {
            fault: record[1] != 0,
            place: record[2],
            text: String::try_from(text).ok()?,
        })
    }

    /// What to tell the host.
    pub const fn event(&self) -> Event {
        if self.fault {
            Event::FaultRestart {
                address: self.place,
            }
        } else {
            Event::PanicRestart { line: self.place }
        }
    }
}

/// Of all words but the last.
fn check_sum(record: &[u32; RECORD_WORDS]) -> u32 {
    let mut digest = CRC.digest();
    for word in &record[..RECORD_WORDS - 1] {
        digest.update(&word.to_le_bytes());
    }
    digest.finalize()
}

/// Why a board started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power, the reset button, or a debugger.
    Ordinary,
    /// The watchdog: sampling or the link had stood still.
    Watchdog,
    /// A panic or a fault.
    Crash(LastWords),
}

impl Cause {
    /// From the record that survived, and from whether the reset was the watchdog's. Words explain more than the watchdog does.
    pub fn of(record: &[u32; RECORD_WORDS], watchdog: bool) -> Self {
        match LastWords::from_record(record) {
            Some(words) => Self::Crash(words),
            None if watchdog => Self::Watchdog,
            None => Self::Ordinary,
        }
    }

    /// What to tell the host, if anything.
    pub const fn event(&self) -> Option<Event> {
        match self {
            Self::Ordinary => None,
            Self::Watchdog => Some(Event::WatchdogRestart),
            Self::Crash(words) => Some(words.event()),
        }
    }
}

/// Whether sampling and the link go on.
#[derive(Debug)]
pub struct Vigil {
    patience_beats: u32,
    since_tick: u32,
    since_serve: u32,
}

impl Vigil {
    /// Well for so many beats from now.
    pub const fn new(patience_beats: u32) -> Self {
        Self {
            patience_beats,
            since_tick: 0,
            since_serve: 0,
        }
    }

    /// A beat of the clock.
    pub const fn beat(&mut self) {
        self.since_tick = self.since_tick.saturating_add(1);
        self.since_serve = self.since_serve.saturating_add(1);
    }

    /// A tick got through.
    pub const fn ticked(&mut self) {
        self.since_tick = 0;
    }

    /// The link's task got through, whether or not there was anything to do.
    pub const fn served(&mut self) {
        self.since_serve = 0;
    }

    /// Whether the watchdog may be fed.
    pub const fn is_well(&self) -> bool {
        self.since_tick < self.patience_beats && self.since_serve < self.patience_beats
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::format;

    #[test]
    fn words_survive_and_are_told() {
        let words = LastWords::panic(104, format_args!("time.rs:104: {}", "divided by zero"));
        assert_eq!(words.text.as_str(), "time.rs:104: divided by zero");
        assert_eq!(LastWords::from_record(&words.record()), Some(words.clone()));
        for watchdog in [false, true] {
            assert_eq!(
                Cause::of(&words.record(), watchdog),
                Cause::Crash(words.clone())
            );
        }
        assert_eq!(words.event(), Event::PanicRestart { line: 104 });
        let words = LastWords::fault(0x0800_1234, format_args!(""));
        assert_eq!(LastWords::from_record(&words.record()), Some(words.clone()));
        assert_eq!(
            format!("{}", words.event()),
            "restarted after a processor fault at 0x08001234"
        );
    }

    #[test]
    fn without_words_the_reset_flag_tells() {
        for leavings in [
            [0; RECORD_WORDS],
            [u32::MAX; RECORD_WORDS],
            [MARK; RECORD_WORDS],
        ] {
            assert_eq!(Cause::of(&leavings, false), Cause::Ordinary);
            assert_eq!(Cause::of(&leavings, true), Cause::Watchdog);
        }
        assert_eq!(Cause::Ordinary.event(), None);
        assert_eq!(Cause::Watchdog.event(), Some(Event::WatchdogRestart));
        // Taken out: the image clears the mark, so that the next start is an ordinary one.
        let mut record = LastWords::panic(1, format_args!("once")).record();
        record[0] = 0;
        assert_eq!(Cause::of(&record, false), Cause::Ordinary);
    }

    #[test]
    fn a_board_is_well_while_both_go_on() {
        let mut vigil = Vigil::new(10);
        for _ in 0..100 {
            for _ in 0..9 {
                vigil.beat();
                assert!(vigil.is_well());
            }
            vigil.ticked();
            vigil.served();
        }
        // Only one of the two, however often.
        for lives in [Vigil::ticked, Vigil::served] {
            let mut vigil = Vigil::new(10);
            for _ in 0..10 {
                vigil.beat();
                lives(&mut vigil);
            }
            assert!(!vigil.is_well());
        }
        for _ in 0..10 {
            vigil.beat();
        }
        assert!(!vigil.is_well());
        vigil.ticked();
        assert!(!vigil.is_well());
        vigil.served();
        assert!(vigil.is_well());
    }

    proptest! {
        #[test]
        fn long_words_are_cut_between_characters(text in "\\PC{0,200}", fault: bool, place: u32) {
            let words = LastWords::new(fault, place, format_args!("{text}"));
            prop_assert!(text.starts_with(words.text.as_str()));
            prop_assert!(words.text.len() == text.len() || words.text.len() > TEXT_BYTES - 4);
            prop_assert_eq!(LastWords::from_record(&words.record()), Some(words));
        }

        #[test]
        fn a_record_with_a_wrong_bit_says_nothing(text in "[a-z ]{0,120}", bit in 0..32 * RECORD_WORDS) {
            let mut record = LastWords::panic(7, format_args!("{text}")).record();
            record[bit / 32] ^= 1 << (bit % 32);
            prop_assert_eq!(LastWords::from_record(&record), None);
        }
    }
}
