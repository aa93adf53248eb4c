//! The serial ports: bytes in and out by interrupt, no waiting anywhere.

use heapless::Deque;
use palpus_firmware::front_end::serial::SerialLine;
use stm32_metapac::usart::Usart;
use stm32_metapac::{RCC, UART4, USART1, USART2, USART3, USART6};

use crate::clock::Clocks;
use crate::pins::{ENCODER_DIRECTION, Pin};

/// Speed of the host's line, Bd.
pub const HOST_BAUD: u32 = 115_200;
/// Speed of the converters' and the encoders' lines, Bd.
pub const CHIP_BAUD: u32 = 115_200;

/// Gives the ports their clocks.
pub fn bring_up() {
    RCC.apb1enr().modify(|w| {
        w.set_usart2en(true);
        w.set_usart3en(true);
        w.set_uart4en(true);
    });
    RCC.apb2enr().modify(|w| {
        w.set_usart1en(true);
        w.set_usart6en(true);
    });
}

/// One port.
#[derive(Clone, Copy)]
pub struct Port(Usart);

impl Port {
    /// USART1, the host's.
    pub fn host(clocks: &Clocks) -> Self {
        Self::start(USART1, clocks.apb2_hz, HOST_BAUD)
    }

    /// The converters' ports.
    pub fn converters(clocks: &Clocks) -> [Self; 3] {
        [
            Self::start(USART2, clocks.apb1_hz, CHIP_BAUD),
            Self::start(USART3, clocks.apb1_hz, CHIP_BAUD),
            Self::start(USART6, clocks.apb2_hz, CHIP_BAUD),
        ]
    }

    /// UART4, the encoders'.
    pub fn encoders(clocks: &Clocks) -> Self {
        Self::start(UART4, clocks.apb1_hz, CHIP_BAUD)
    }

    fn start(usart: Usart, bus_hz: u32, baud: u32) -> Self {
        // Sixteen samples a bit: the register is the divider in sixteenths, rounded.
        usart.brr().write(|w| w.0 = (bus_hz + baud / 2) / baud);
        usart.cr1().write(|w| {
            w.set_ue(true);
            w.set_te(true);
            w.set_re(true);
            w.set_rxneie(true);
        });
        Self(usart)
    }

    /// The byte that came, if any. Reading also clears a noisy stop bit; the byte is handed on all the same, since every protocol here
    /// has its own check sum. An overrun without a byte, where a byte was lost right after the last look, is only cleared.
    pub fn take(self) -> Option<u8> {
        let status = self.0.sr().read();
        let byte = (status.rxne() || status.ore()).then(|| self.0.dr().read().0 as u8)?;
        status.rxne().then_some(byte)
    }

    /// Whether a byte can be put.
    pub fn has_room(self) -> bool {
        self.0.sr().read().txe()
    }

    /// Puts a byte.
    pub fn put(self, byte: u8) {
        self.0.dr().write(|w| w.set_dr(u16::from(byte)));
    }

    /// Whether the interrupt for room is on.
    pub fn wants_room(self) -> bool {
        self.0.cr1().read().txeie()
    }

    /// Turns the interrupt for room on or off.
    pub fn want_room(self, on: bool) {
        self.0.cr1().modify(|w| w.set_txeie(on));
    }

    /// Whether the last stop bit has left and its interrupt is on.
    fn is_done(self) -> bool {
        self.0.cr1().read().tcie() && self.0.sr().read().tc()
    }

    fn want_done(self, on: bool) {
        self.0.cr1().modify(|w| w.set_tcie(on));
    }
}

/// A chip's line: what waits to be sent, and the port.
pub struct ChipLine {
    port: Port,
    waiting: Deque<u8, 64>,
    direction: Option<Pin>,
}

impl ChipLine {
    /// A full-duplex line.
    pub const fn new(port: Port) -> Self {
        Self {
            port,
            waiting: Deque::new(),
            direction: None,
        }
    }

    /// A half-duplex line with the transceiver's direction pin.
    pub const fn half_duplex(port: Port) -> Self {
        Self {
            port,
            waiting: Deque::new(),
            direction: Some(ENCODER_DIRECTION),
        }
    }

    /// The port's interrupt: sends the next byte, gives the line up after the last, and hands back a byte that came.
    pub fn interrupt(&mut self) -> Option<u8> {
        if self.port.wants_room() && self.port.has_room() {
            match self.waiting.pop_front() {
                Some(byte) => self.port.put(byte),
                None => self.port.want_room(false),
            }
            if self.waiting.is_empty() {
                self.port.want_room(false);
                if self.direction.is_some() {
                    self.port.want_done(true);
                }
            }
        } else if self.port.is_done() {
            self.port.want_done(false);
            if let Some(pin) = self.direction {
                pin.set(false);
            }
        }
        self.port.take()
    }
}

impl SerialLine for ChipLine {
    fn send(&mut self, bytes: &[u8]) {
        if let Some(pin) = self.direction {
            self.port.want_done(false);
            pin.set(true);
        }
        for &byte in bytes {
            // Room for twice what a driver ever has under way.
            let _ = self.waiting.push_back(byte);
        }
        self.port.want_room(true);
    }
}
