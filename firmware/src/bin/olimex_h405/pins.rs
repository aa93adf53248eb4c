//! Which pin does what. The same table is in the firmware's README, "Wiring".

use stm32_metapac::gpio::Gpio;
use stm32_metapac::gpio::vals::{Moder, Ospeedr, Pupdr};
use stm32_metapac::{GPIOA, GPIOB, GPIOC, RCC};

/// A pin: its port and number.
#[derive(Clone, Copy)]
pub struct Pin(pub Gpio, pub usize);

/// Transmit, receive and alternate function of a serial port.
#[derive(Clone, Copy)]
pub struct SerialPins(pub Pin, pub Pin, pub u8);

/// USART1, the host.
pub const HOST: SerialPins = SerialPins(Pin(GPIOA, 9), Pin(GPIOA, 10), 7);
/// USART2, USART3 and USART6, the bridge converters in the order of the gauges.
pub const CONVERTERS: [SerialPins; 3] = [
    SerialPins(Pin(GPIOA, 2), Pin(GPIOA, 3), 7),
    SerialPins(Pin(GPIOB, 10), Pin(GPIOB, 11), 7),
    SerialPins(Pin(GPIOC, 6), Pin(GPIOC, 7), 8),
];
/// UART4, the encoders. Its other pins are the button (PA0) and the USB switch (PC11).
pub const ENCODERS: SerialPins = SerialPins(Pin(GPIOC, 10), Pin(GPIOA, 1), 8);
/// Direction of the encoders' transceiver: high to talk.
pub const ENCODER_DIRECTION: Pin = Pin(GPIOC, 8);
/// The green lamp, lit when low.
pub const LAMP: Pin = Pin(GPIOC, 12);

impl Pin {
    /// Drives the pin.
    pub fn set(self, high: bool) {
        self.0.bsrr().write(|w| {
            if high {
                w.set_bs(self.1, true)
            } else {
                w.set_br(self.1, true)
            }
        });
    }

    fn output(self, high: bool) {
        self.set(high);
        self.0
            .moder()
            .modify(|w| w.set_moder(self.1, Moder::OUTPUT));
    }

    fn alternate(self, function: u8, pull: Pupdr) {
        self.0
            .afr(self.1 / 8)
            .modify(|w| w.set_afr(self.1 % 8, function));
        self.0.pupdr().modify(|w| w.set_pupdr(self.1, pull));
        self.0
            .ospeedr()
            .modify(|w| w.set_ospeedr(self.1, Ospeedr::MEDIUM_SPEED));
        self.0
            .moder()
            .modify(|w| w.set_moder(self.1, Moder::ALTERNATE));
    }
}

/// Sets all pins up; the transceiver listens.
pub fn bring_up() {
    RCC.ahb1enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
    });
    for SerialPins(transmit, receive, function) in
        [HOST, CONVERTERS[0], CONVERTERS[1], CONVERTERS[2], ENCODERS]
    {
        transmit.alternate(function, Pupdr::FLOATING);
        // An open receive pin reads as an idle line.
        receive.alternate(function, Pupdr::PULL_UP);
    }
    ENCODER_DIRECTION.output(false);
    LAMP.output(true);
}
