//! What a builder of the board may have to change.

use palpus_firmware::BoardConfig;
use palpus_firmware::front_end::serial::JointMount;
use palpus_protocol::TipGeometry;
use stm32_metapac::UID;

use crate::clock::Source;

/// Sampling period, us.
pub const PERIOD_US: u32 = 5_000;

/// Addresses of the encoders, base joint first. They leave the factory with 0x54; the maker's tool changes it.
pub const ENCODER_ADDRESSES: [u8; 3] = [0x54, 0x58, 0x5c];

/// How the encoders sit: their position at the joint's zero, and whether they count backwards.
pub const JOINT_MOUNTS: [JointMount; 3] = [JointMount {
    zero_steps: 0,
    reversed: false,
}; 3];

/// The tip: a ball of 20 mm radius, its centre 15 mm above the sensor's origin.
const TIP: TipGeometry = TipGeometry {
    semi_axes_mm: [20.0; 3],
    centre_offset_mm: [0.0, 0.0, 15.0],
};

/// Number of the finger: `PALPUS_FINGER` when the image was built, 0 to 9.
const FINGER: u8 = match option_env!("PALPUS_FINGER") {
    Some(text) => {
        assert!(
            text.len() == 1 && text.as_bytes()[0].is_ascii_digit(),
            "PALPUS_FINGER must be 0 to 9"
        );
        text.as_bytes()[0] - b'0'
    }
    None => 0,
};

/// Names of the fingers, by number.
const NAMES: [&str; 3] = ["index", "middle", "thumb"];

/// What the board is.
pub fn board(source: Source) -> BoardConfig {
    // The emulated core has no device number.
    let id = if source == Source::Fixed {
        *b"EMULATED-BRD"
    } else {
        device_number()
    };
    let name = NAMES.get(usize::from(FINGER)).copied().unwrap_or("finger");
    BoardConfig {
        period_us: PERIOD_US,
        ..BoardConfig::new(id, FINGER, name, TIP)
    }
}

fn device_number() -> [u8; 12] {
    let mut id = [0; 12];
    for (part, word) in id.chunks_exact_mut(4).zip(0..3) {
        part.copy_from_slice(&UID.uid(word).read().to_le_bytes());
    }
    id
}
