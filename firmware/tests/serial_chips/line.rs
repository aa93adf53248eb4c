//! A serial line in virtual time.

use palpus_firmware::front_end::serial::SerialLine;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// One byte of eight bits, start and stop at 115 200 Bd, us.
pub const BYTE_US: u64 = 87;
/// From a question's last stop bit to its answer's first start bit: two bits.
const TURN_US: u64 = 17;

/// The driver's end.
#[derive(Clone, Default)]
pub struct Wire(Rc<RefCell<VecDeque<u8>>>);

impl SerialLine for Wire {
    fn send(&mut self, bytes: &[u8]) {
        self.0.borrow_mut().extend(bytes);
        // The driver's promise.
        assert!(
            self.0.borrow().len() <= 32,
            "{} bytes under way",
            self.0.borrow().len()
        );
    }
}

/// What is on the line.
#[derive(Default)]
pub struct Line {
    pub wire: Wire,
    going: Option<(u64, u8)>,
    coming: VecDeque<(u64, u8)>,
}

impl Line {
    /// The byte that has arrived at the chip by now, if any; the next one starts.
    pub fn at_chip(&mut self, now_us: u64) -> Option<u8> {
        let arrived = match self.going {
            Some((done_us, byte)) if now_us >= done_us => {
                self.going = None;
                Some(byte)
            }
            _ => None,
        };
        if self.going.is_none() {
            self.going = self
                .wire
                .0
                .borrow_mut()
                .pop_front()
                .map(|byte| (now_us + BYTE_US, byte));
        }
        arrived
    }

    /// The chip answers, or somebody makes noise.
    pub fn answer(&mut self, bytes: &[u8], now_us: u64) {
        let mut begin_us = self
            .coming
            .back()
            .map_or(0, |&(last_us, _)| last_us)
            .max(now_us + TURN_US);
        for &byte in bytes {
            begin_us += BYTE_US;
            self.coming.push_back((begin_us, byte));
        }
    }

    /// The byte that has arrived at the board by now, if any.
    pub fn at_board(&mut self, now_us: u64) -> Option<u8> {
        let &(arrives_us, byte) = self.coming.front()?;
        if now_us < arrives_us {
            return None;
        }
        self.coming.pop_front();
        Some(byte)
    }

    /// Cuts off what is on its way to the board: a wire that comes off.
    pub fn cut(&mut self) {
        self.coming.clear();
    }
}
