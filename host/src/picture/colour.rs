//! Colours in linear light, and colour maps that people with any colour vision can read.
//!
//! Shading and averaging happen in linear light; only the finished picture is turned into sRGB.

/// Red, green and blue in linear light, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour(pub [f32; 3]);

impl Colour {
    /// From 0xRRGGBB in sRGB, as colours are usually written.
    pub const fn hex(code: u32) -> Srgb {
        Srgb([(code >> 16) as u8, (code >> 8) as u8, code as u8])
    }

    /// This colour and another, the other with weight `t`.
    pub fn mix(self, other: Self, t: f32) -> Self {
        Self([0, 1, 2].map(|i| self.0[i] + (other.0[i] - self.0[i]) * t))
    }

    /// In sRGB with 8 bits, clamped.
    pub fn to_srgb(self) -> [u8; 3] {
        self.0.map(|linear| {
            let linear = linear.clamp(0.0, 1.0);
            let coded = if linear <= 0.003_130_8 {
                12.92 * linear
            } else {
                1.055 * linear.powf(1.0 / 2.4) - 0.055
            };
            (coded * 255.0 + 0.5) as u8
        })
    }
}

/// Red, green and blue in sRGB with 8 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Srgb(pub [u8; 3]);

impl From<Srgb> for Colour {
    fn from(Srgb(code): Srgb) -> Self {
        Self(code.map(|byte| {
            let coded = f32::from(byte) / 255.0;
            if coded <= 0.040_45 {
                coded / 12.92
            } else {
                ((coded + 0.055) / 1.055).powf(2.4)
            }
        }))
    }
}

/// A way to turn numbers from 0 to 1 into colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourMap {
    /// Dark violet over green to yellow: ten stations of viridis (S. van der Walt, N. Smith; CC0).
    Viridis,
    /// Dark blue over grey to yellow: ten stations of cividis (Nuñez, Anderton, Renslow 2018), the same to
    /// people who see no red or no green.
    Cividis,
    /// Blue over white to brown, for values on both sides of zero: lightness falls evenly to both ends, and
    /// blue and brown differ in every common form of colour blindness.
    BlueBrown,
}

impl ColourMap {
    fn stations(self) -> &'static [u32] {
        match self {
            Self::Viridis => &[
                0x440154, 0x482878, 0x3E4989, 0x31688E, 0x26828E, 0x1F9E89, 0x35B779, 0x6ECE58,
                0xB5DE2B, 0xFDE725,
            ],
            Self::Cividis => &[
                0x00224E, 0x123570, 0x3B496C, 0x575D6D, 0x707173, 0x8A8678, 0xA59C74, 0xC3B369,
                0xE1CC55, 0xFEE838,
            ],
            Self::BlueBrown => &[
                0x1B3A6B, 0x3F7FB5, 0xA6C8E0, 0xF4F4F2, 0xF0C29A, 0xC9723C, 0x7A2F12,
            ],
        }
    }

    /// The colour of `t`, clamped to 0 to 1; light grey for NaN.
    pub fn colour(self, t: f64) -> Colour {
        if t.is_nan() {
            return Colour::hex(0xC8C8C8).into();
        }
        let stations = self.stations();
        let place = t.clamp(0.0, 1.0) * (stations.len() - 1) as f64;
        let first = (place as usize).min(stations.len() - 2);
        let [a, b] = [first, first + 1].map(|i| Colour::hex(stations[i]).0);
        let share = place - first as f64;
        // Between stations in sRGB, where they are evenly spaced to the eye.
        Srgb(
            [0, 1, 2].map(|i| {
                (f64::from(a[i]) + (f64::from(b[i]) - f64::from(a[i])) * share).round() as u8
            }),
        )
        .into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(colour: Colour) -> f32 {
        let [r, g, b] = colour.0;
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    #[test]
    fn srgb_survives_the_way_to_linear_light_and_back() {
        for byte in 0..=255_u8 {
            let colour: Colour = Srgb([byte, 255 - byte, byte / 2]).into();
            assert_eq!(colour.to_srgb(), [byte, 255 - byte, byte / 2]);
        }
    }

    #[test]
    fn lightness_rises_along_the_one_sided_maps_and_falls_from_the_middle_of_the_other() {
        for map in [ColourMap::Viridis, ColourMap::Cividis] {
            let steps: Vec<f32> = (0..=50)
                .map(|i| lightness(map.colour(f64::from(i) / 50.0)))
                .collect();
            assert!(steps.windows(2).all(|pair| pair[0] < pair[1]), "{map:?}");
        }
        let steps: Vec<f32> = (0..=20)
            .map(|i| lightness(ColourMap::BlueBrown.colour(0.5 + f64::from(i) / 40.0)))
            .collect();
        assert!(steps.windows(2).all(|pair| pair[0] > pair[1]));
    }

    #[test]
    fn values_out_of_range_are_clamped_and_nan_is_grey() {
        assert_eq!(
            ColourMap::Viridis.colour(7.0),
            ColourMap::Viridis.colour(1.0)
        );
        assert_eq!(
            ColourMap::Viridis.colour(f64::NEG_INFINITY),
            ColourMap::Viridis.colour(0.0)
        );
        assert_eq!(ColourMap::Viridis.colour(f64::NAN).to_srgb(), [0xC8; 3]);
    }
}
