//! Counts contacts by their sequence numbers: accepted, lost, doubled, late.
//!
//! Promise: between the first contact and the latest, `accepted + lost` is the number of contacts the board made
//! for the stream, exactly, whatever order they came in: a number counts as lost from the moment a later one
//! arrives until it arrives itself, if it still does within the last [`WINDOW`] numbers.

use palpus_protocol::{CONTACT_SEQUENCE_MODULUS, CONTACT_TIME_MODULUS_US, Contact};

/// How far behind the latest contact a late one is still recognised.
pub const WINDOW: u32 = 64;
/// A board's clock that is back by more than this has restarted, microseconds.
const RESTART_US: u64 = 1_000_000;

/// What a contact's number says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// The first of its stream.
    First,
    /// The one that was expected, or the first after so many lost ones.
    After {
        /// Numbers skipped just now.
        lost: u32,
    },
    /// One that had been counted as lost.
    Late,
    /// One that was there already.
    Duplicate,
    /// The board has started anew and counts from the beginning.
    Restarted,
}

/// Counts of one stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceCounts {
    /// Contacts accepted, each once.
    pub accepted: u64,
    /// Numbers that never came.
    pub lost: u64,
    /// Contacts that came again.
    pub duplicates: u64,
    /// Contacts that came after a later one.
    pub out_of_order: u64,
    /// Times the board started anew.
    pub restarts: u64,
}

#[derive(Clone, Copy, Debug)]
struct Latest {
    sequence: u32,
    time_us: u64,
    /// Bit k: the number k steps before the latest has come.
    come: u64,
}

/// Follows the sequence numbers of one board.
#[derive(Clone, Copy, Debug)]
pub struct SequenceTracker {
    every: u32,
    latest: Option<Latest>,
    counts: SequenceCounts,
}

impl Default for SequenceTracker {
    fn default() -> Self {
        Self::new(1)
    }
}

impl SequenceTracker {
    /// A tracker of a stream of every `every`-th contact (0 is taken as 1).
    pub fn new(every: u32) -> Self {
        Self {
            every: every.max(1),
            latest: None,
            counts: SequenceCounts::default(),
        }
    }

    /// The counts so far.
    pub fn counts(&self) -> SequenceCounts {
        self.counts
    }

    /// The board is known to have started anew: the next contact is a first one.
    pub fn restart(&mut self) {
        if self.latest.take().is_some() {
            self.counts.restarts += 1;
        }
    }

    /// Takes one contact.
    pub fn take(&mut self, contact: &Contact) -> Arrival {
        let Some(latest) = &mut self.latest else {
            self.latest = Some(first(contact));
            self.counts.accepted += 1;
            return Arrival::First;
        };
        let behind_us = time_behind_us(latest.time_us, contact.board_time_us);
        let ahead = contact.sequence.wrapping_sub(latest.sequence) % CONTACT_SEQUENCE_MODULUS;
        let behind = (CONTACT_SEQUENCE_MODULUS - ahead) % CONTACT_SEQUENCE_MODULUS;
        if behind_us > RESTART_US {
            self.latest = Some(first(contact));
            self.counts.restarts += 1;
            self.counts.accepted += 1;
            return Arrival::Restarted;
        }
        if behind_us > 0 || ahead == 0 {
            // Not later than the latest: it came before, or fills a gap.
            let steps = behind / self.every;
            let bit = 1_u64.checked_shl(steps).unwrap_or(0);
            if steps >= WINDOW || latest.come & bit != 0 {
                self.counts.duplicates += 1;
                return Arrival::Duplicate;
            }
            latest.come |= bit;
            self.counts.accepted += 1;
            self.counts.out_of_order += 1;
            self.counts.lost = self.counts.lost.saturating_sub(1);
            return Arrival::Late;
        }
        let steps = (ahead / self.every).max(1);
        let lost = steps - 1;
        latest.come = latest.come.checked_shl(steps).unwrap_or(0) | 1;
        latest.sequence = contact.sequence;
        latest.time_us = contact.board_time_us;
        self.counts.accepted += 1;
        self.counts.lost += u64::from(lost);
        Arrival::After { lost }
    }
}

fn first(contact: &Contact) -> Latest {
    Latest {
        sequence: contact.sequence,
        time_us: contact.board_time_us,
        // What lies before the first contact was never asked for.
        come: u64::MAX,
    }
}

/// How far `time_us` lies behind `latest_us`, both modulo 2^40 us; 0 if it lies ahead.
fn time_behind_us(latest_us: u64, time_us: u64) -> u64 {
    let behind = latest_us.wrapping_sub(time_us) % CONTACT_TIME_MODULUS_US;
    if behind < CONTACT_TIME_MODULUS_US / 2 {
        behind
    } else {
        0
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use palpus_protocol::ContactFlags;
    use proptest::prelude::*;

    /// A valid contact of that number, counted without end, of a board that samples every 5 ms.
    pub(crate) fn contact(sequence: u64) -> Contact {
        Contact {
            sequence: (sequence % u64::from(CONTACT_SEQUENCE_MODULUS)) as u32,
            board_time_us: (sequence * 5_000) % CONTACT_TIME_MODULUS_US,
            point_mm: [0.0, 0.0, 20.0],
            normal: [0.0, 0.0, 1.0],
            normal_force_n: 2.0,
            tangential_force_n: 0.0,
            spin_n_mm: 0.0,
            sigma_mm: 0.2,
            joint_angles_rad: [0.0; 3],
            flags: ContactFlags::none(),
        }
    }

    #[test]
    fn gaps_across_the_wrap_of_the_number_are_exact() {
        let mut tracker = SequenceTracker::new(1);
        let wrap = u64::from(CONTACT_SEQUENCE_MODULUS);
        assert_eq!(tracker.take(&contact(wrap - 3)), Arrival::First);
        assert_eq!(tracker.take(&contact(wrap + 2)), Arrival::After { lost: 4 });
        assert_eq!(tracker.take(&contact(wrap + 2)), Arrival::Duplicate);
        assert_eq!(tracker.take(&contact(wrap - 1)), Arrival::Late);
        assert_eq!(tracker.take(&contact(wrap - 1)), Arrival::Duplicate);
        assert_eq!(tracker.take(&contact(wrap - 4)), Arrival::Duplicate);
        let counts = tracker.counts();
        assert_eq!((counts.accepted, counts.lost), (3, 3));
        assert_eq!((counts.duplicates, counts.out_of_order), (3, 1));
    }

    #[test]
    fn a_thinned_stream_has_no_gaps() {
        let mut tracker = SequenceTracker::new(4);
        for k in 0..100 {
            tracker.take(&contact(8 + 4 * k));
        }
        assert_eq!(tracker.counts().lost, 0);
        assert_eq!(
            tracker.take(&contact(8 + 4 * 103)),
            Arrival::After { lost: 3 }
        );
    }

    #[test]
    fn a_restarted_board_is_no_loss() {
        let mut tracker = SequenceTracker::new(1);
        tracker.take(&contact(100_000));
        assert_eq!(tracker.take(&contact(3)), Arrival::Restarted);
        assert_eq!(tracker.take(&contact(4)), Arrival::After { lost: 0 });
        tracker.restart();
        assert_eq!(tracker.take(&contact(1)), Arrival::First);
        assert_eq!(tracker.counts().restarts, 2);
        assert_eq!(tracker.counts().lost, 0);
    }

    proptest! {
        /// Any losses, doublings and short-range swaps: the books balance.
        #[test]
        fn accepted_and_lost_make_up_all(
            start in 0u64..20_000_000,
            fates in prop::collection::vec(0u8..10, 1..300),
        ) {
            let mut sent = Vec::new();
            let mut held: Option<u64> = None;
            for (k, fate) in fates.iter().enumerate() {
                let number = start + 1 + k as u64;
                match fate {
                    0 => {}
                    1 => sent.extend([number, number]),
                    2 if held.is_none() => held = Some(number),
                    _ => {
                        sent.push(number);
                        sent.extend(held.take());
                    }
                }
            }
            let mut tracker = SequenceTracker::new(1);
            tracker.take(&contact(start));
            let mut distinct = std::collections::BTreeSet::from([start]);
            for number in sent {
                tracker.take(&contact(number));
                distinct.insert(number);
            }
            let last = *distinct.last().unwrap();
            let counts = tracker.counts();
            prop_assert_eq!(counts.accepted, distinct.len() as u64);
            prop_assert_eq!(counts.accepted + counts.lost, last - start + 1);
            prop_assert_eq!(counts.restarts, 0);
        }
    }
}
