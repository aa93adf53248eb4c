//! What stands beside the scene: title and caption, the bar of a colour map, a scale bar.

use super::camera::Camera;
use super::colour::{Colour, ColourMap, Srgb};
use super::image::Image;
use super::lettering::{Anchor, round_length, short_number};

const INK: Srgb = Colour::hex(0x1E2730);
const PALE_INK: Srgb = Colour::hex(0x5B6773);

/// Meaning of a colour map's colours.
#[derive(Clone, Debug, PartialEq)]
pub struct Legend {
    /// What the numbers are, with their unit.
    pub label: String,
    /// At the map's first colour.
    pub low: f64,
    /// At the map's last colour.
    pub high: f64,
    /// The map.
    pub map: ColourMap,
}

/// Lettering of a figure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Caption {
    /// In large letters.
    pub title: String,
    /// Below it, in small letters.
    pub text: String,
    /// Bar of a colour map.
    pub legend: Option<Legend>,
    /// Unit of lengths, written beside the scale bar; empty if unknown.
    pub unit: String,
}

impl Caption {
    /// Writes everything onto a picture of what the camera saw.
    pub fn write(&self, image: &mut Image, camera: &Camera) {
        let unit = image.height as f32 / 900.0;
        let left = 40.0 * unit;
        image.text(
            &self.title,
            left,
            58.0 * unit,
            21.0 * unit,
            Anchor::Left,
            INK,
        );
        image.text(
            &self.text,
            left,
            92.0 * unit,
            13.0 * unit,
            Anchor::Left,
            PALE_INK,
        );
        self.scale_bar(image, camera, unit);
        if let Some(legend) = &self.legend {
            legend.draw(image, unit);
        }
    }

    fn scale_bar(&self, image: &mut Image, camera: &Camera, unit: f32) {
        let pixel = camera.pixel_size(image.height);
        let length = round_length(0.17 * image.width as f64 * pixel);
        let pixels = (length / pixel) as f32;
        let (left, base) = (40.0 * unit, image.height as f32 - 46.0 * unit);
        let mut bar = |points: &[[f32; 2]]| image.polyline(points, 2.2 * unit, INK);
        bar(&[[left, base], [left + pixels, base]]);
        for x in [left, left + pixels] {
            bar(&[[x, base - 6.0 * unit], [x, base + 6.0 * unit]]);
        }
        let label = format!("{} {}", short_number(length), self.unit);
        let middle = left + pixels / 2.0;
        image.text(
            label.trim_end(),
            middle,
            base - 14.0 * unit,
            13.0 * unit,
            Anchor::Middle,
            INK,
        );
    }
}

impl Legend {
    fn draw(&self, image: &mut Image, unit: f32) {
        let (width, height) = (image.width as f32, image.height as f32);
        let (left, right) = (width - 122.0 * unit, width - 98.0 * unit);
        let (top, bottom) = (height * 0.26, height * 0.76);
        let rows = (bottom - top).ceil() as usize;
        for row in 0..rows {
            let y = top + row as f32;
            let share = 1.0 - (row as f32 + 0.5) / (bottom - top);
            let colour = Srgb(self.map.colour(f64::from(share)).to_srgb());
            image.fill([left, y], [right, (y + 1.0).min(bottom)], colour);
        }
        let frame = [
            [left, top],
            [right, top],
            [right, bottom],
            [left, bottom],
            [left, top],
        ];
        image.polyline(&frame, 1.2 * unit, INK);
        let span = self.high - self.low;
        let step = round_length(span / 3.0);
        let first = (self.low / step - 1e-6).ceil();
        for tick in 0..12_u8 {
            let value = (first + f64::from(tick)) * step;
            if span.is_nan() || span <= 0.0 || value > self.high + 1e-6 * step {
                break;
            }
            let y = bottom + (top - bottom) * ((value - self.low) / span) as f32;
            image.polyline(&[[right, y], [right + 5.0 * unit, y]], 1.2 * unit, INK);
            // Negative zero would carry its sign.
            let text = short_number(if value == 0.0 { 0.0 } else { value });
            image.text(
                &text,
                right + 10.0 * unit,
                y + 5.0 * unit,
                11.0 * unit,
                Anchor::Left,
                INK,
            );
        }
        for (line, text) in self.label.split('\n').rev().enumerate() {
            let y = top - (18.0 + 20.0 * line as f32) * unit;
            image.text(
                text,
                width - 30.0 * unit,
                y,
                12.0 * unit,
                Anchor::Right,
                INK,
            );
        }
    }
}
