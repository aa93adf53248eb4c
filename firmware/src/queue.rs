//! A queue that never refuses: when it is full the oldest entry goes, and is counted.
//!
//! For a surface the newest contact is worth most, and a host that has stalled for ten seconds
//! wants to know where the finger is, not where it was. So the sampling side never waits and never
//! fails, and what was lost is a number in the statistics and a gap in the sequence.

use heapless::Deque;

/// At most `N` (1 or more) entries, oldest first.
#[derive(Debug)]
pub struct DropOldest<T, const N: usize> {
    entries: Deque<T, N>,
    high_water: u16,
    dropped: u32,
}

impl<T, const N: usize> Default for DropOldest<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T, const N: usize> DropOldest<T, N> {
    /// An empty queue.
    pub const fn new() -> Self {
        Self {
            entries: Deque::new(),
            high_water: 0,
            dropped: 0,
        }
    }

    /// Adds an entry; returns whether the oldest had to go for it.
    pub fn push(&mut self, entry: T) -> bool {
        let full = self.entries.is_full();
        if full {
            self.entries.pop_front();
            self.dropped = self.dropped.wrapping_add(1);
        }
        // There is room now: N is at least 1 (asserted where the queue is made).
        let _ = self.entries.push_back(entry);
        self.high_water = self
            .high_water
            .max(u16::try_from(self.entries.len()).unwrap_or(u16::MAX));
        full
    }

    /// Takes the oldest entry.
    pub fn pop(&mut self) -> Option<T> {
        self.entries.pop_front()
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Number of entries waiting.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether an entry like this waits.
    pub fn any(&self, matches: impl FnMut(&T) -> bool) -> bool {
        self.entries.iter().any(matches)
    }

    /// Most entries that ever waited.
    pub const fn high_water(&self) -> u16 {
        self.high_water
    }

    /// Entries that were dropped.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the plainest model: a list cut from the front.
        #[test]
        fn the_newest_stay_in_order(steps in proptest::collection::vec(any::<Option<u8>>(), 0..200)) {
            let mut queue = DropOldest::<u8, 4>::new();
            let mut model = std::vec::Vec::new();
            let (mut dropped, mut high) = (0, 0);
            for step in steps {
                match step {
                    Some(entry) => {
                        model.push(entry);
                        let full = model.len() > 4;
                        if full {
                            model.remove(0);
                            dropped += 1;
                        }
                        prop_assert_eq!(queue.push(entry), full);
                    }
                    None => {
                        let expected = if model.is_empty() { None } else { Some(model.remove(0)) };
                        prop_assert_eq!(queue.pop(), expected);
                    }
                }
                high = high.max(model.len());
                prop_assert_eq!(queue.len(), model.len());
                prop_assert_eq!(queue.dropped(), dropped);
                prop_assert_eq!(usize::from(queue.high_water()), high);
            }
        }
    }
}
