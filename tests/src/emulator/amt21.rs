//! Model of CUI AMT21 encoders on one RS-485 bus.

/// What is wrong with one encoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EncoderFault {
    /// Nothing.
    #[default]
    None,
    /// It does not answer.
    Silent,
    /// Its check bits are wrong.
    BadCheckBits,
}

/// One encoder.
#[derive(Clone, Copy, Debug, Default)]
pub struct Encoder {
    /// Address on the bus.
    pub address: u8,
    /// What is wrong.
    pub fault: EncoderFault,
}

impl Encoder {
    /// The answer to a question, when it is this encoder's. Positions are 14 bits of a turn.
    pub fn answer(&self, question: u8, angle_rad: f64) -> Option<[u8; 2]> {
        if question != self.address || self.fault == EncoderFault::Silent {
            return None;
        }
        let turn = (angle_rad / core::f64::consts::TAU).rem_euclid(1.0);
        let position = ((turn * 16_384.0).round() as u16) % 16_384;
        let mut word = position;
        for (bit, start) in [(15, 1), (14, 0)] {
            let ones: u32 = (start..14)
                .step_by(2)
                .map(|i| u32::from(position >> i) & 1)
                .sum();
            if ones.is_multiple_of(2) {
                word |= 1 << bit;
            }
        }
        if self.fault == EncoderFault::BadCheckBits {
            word ^= 0x8000;
        }
        Some(word.to_le_bytes())
    }
}
