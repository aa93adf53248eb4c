//! The host's line: queues between the port's interrupt and the board's frames.
//!
//! Received bytes wait in a queue of 512 (44 ms of line) until the lowest-priority task has them decoded. Sent bytes wait in a queue of 448,
//! two largest frames; it is kept that short so that a backlog stands in the board's own queues, where the oldest contact goes first
//! and is counted. Nothing here waits.

use heapless::spsc::{Consumer, Producer};

use crate::uart::Port;

/// Bytes that can wait to be decoded, plus one.
pub const RECEIVED: usize = 513;
/// Bytes that can wait to be sent, plus one.
pub const TO_SEND: usize = 449;

/// The interrupt's side.
pub struct HostPort {
    port: Port,
    received: Producer<'static, u8>,
    to_send: Consumer<'static, u8>,
}

/// What the interrupt found.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct Served {
    /// A frame may be whole: its delimiter came, or the queue is half full.
    pub received: bool,
    /// There is room for more to send.
    pub room: bool,
}

impl HostPort {
    /// A port with its ends of the queues.
    pub const fn new(
        port: Port,
        received: Producer<'static, u8>,
        to_send: Consumer<'static, u8>,
    ) -> Self {
        Self {
            port,
            received,
            to_send,
        }
    }

    /// The port's interrupt.
    pub fn interrupt(&mut self) -> Served {
        let mut served = Served::default();
        if let Some(byte) = self.port.take() {
            // A queue that overflows costs the frame; its check sum tells.
            let _ = self.received.enqueue(byte);
            served.received =
                byte == palpus_protocol::DELIMITER || self.received.len() >= RECEIVED / 2;
        }
        if self.port.wants_room() && self.port.has_room() {
            match self.to_send.dequeue() {
                Some(byte) => self.port.put(byte),
                None => self.port.want_room(false),
            }
            served.room = self.to_send.len() == TO_SEND / 4;
        }
        served
    }
}

/// The task's side.
pub struct HostQueues {
    port: Port,
    received: Consumer<'static, u8>,
    to_send: Producer<'static, u8>,
}

impl HostQueues {
    /// The other ends of the queues.
    pub const fn new(
        port: Port,
        received: Consumer<'static, u8>,
        to_send: Producer<'static, u8>,
    ) -> Self {
        Self {
            port,
            received,
            to_send,
        }
    }

    /// Up to 32 bytes that came.
    pub fn received(&mut self) -> heapless::Vec<u8, 32> {
        core::iter::from_fn(|| self.received.dequeue())
            .take(32)
            .collect()
    }

    /// Whether a frame of any size fits.
    pub fn has_room(&self) -> bool {
        self.to_send.capacity() - self.to_send.len() >= palpus_protocol::MAX_FRAME_BYTES
    }

    /// Queues a frame and wakes the port.
    pub fn send(&mut self, frame: &[u8]) {
        for &byte in frame {
            // The caller has asked for room.
            let _ = self.to_send.enqueue(byte);
        }
        self.port.want_room(true);
    }
}
