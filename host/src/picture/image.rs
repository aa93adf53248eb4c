//! A finished picture: sRGB pixels, and the way to a PNG file.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::PictureError;
use super::colour::{Colour, Srgb};

/// Pixels in rows from the top, 8 bits per channel, sRGB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    pub(super) rgb: Vec<u8>,
}

impl Image {
    /// A picture of one colour.
    pub fn blank(width: usize, height: usize, colour: Srgb) -> Self {
        Self {
            width,
            height,
            rgb: colour.0.repeat(width * height),
        }
    }

    /// Colour of a pixel; black outside.
    pub fn pixel(&self, column: usize, row: usize) -> [u8; 3] {
        if column >= self.width || row >= self.height {
            return [0; 3];
        }
        let at = 3 * (row * self.width + column);
        [0, 1, 2].map(|i| self.rgb[at + i])
    }

    /// Covers a share of a pixel with a colour (averaged in sRGB, which suits thin dark marks on light ground).
    pub(super) fn blend(&mut self, column: usize, row: usize, colour: Srgb, cover: f32) {
        let at = 3 * (row * self.width + column);
        for (byte, new) in self.rgb[at..at + 3].iter_mut().zip(colour.0) {
            let old = f32::from(*byte);
            *byte = (old + (f32::from(new) - old) * cover + 0.5) as u8;
        }
    }

    /// Copies another picture into this one, its upper left corner at (column, row); what sticks out is left off.
    pub fn paste(&mut self, other: &Self, column: usize, row: usize) {
        let columns = other.width.min(self.width.saturating_sub(column));
        for line in 0..other.height.min(self.height.saturating_sub(row)) {
            let (from, to) = (
                3 * line * other.width,
                3 * ((row + line) * self.width + column),
            );
            self.rgb[to..to + 3 * columns].copy_from_slice(&other.rgb[from..from + 3 * columns]);
        }
    }

    /// The picture at half the width and height, averaged in linear light; an odd last row or column is left off.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut rgb = Vec::with_capacity(3 * width * height);
        for row in 0..height {
            for column in 0..width {
                let mut sum = [0.0_f32; 3];
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let Colour(part) = Srgb(self.pixel(2 * column + dx, 2 * row + dy)).into();
                    for i in 0..3 {
                        sum[i] += part[i] / 4.0;
                    }
                }
                rgb.extend(Colour(sum).to_srgb());
            }
        }
        Self { width, height, rgb }
    }

    /// The picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// [`PictureError::Encode`] if the picture is empty.
    pub fn to_png(&self) -> Result<Vec<u8>, PictureError> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes, None)
            .map_err(|error| PictureError::Encode(error.to_string()))?;
        Ok(bytes)
    }

    /// Writes a PNG.
    ///
    /// # Errors
    /// [`PictureError::Write`] with the path if the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), PictureError> {
        let failed = |reason: String| PictureError::Write {
            path: path.to_owned(),
            reason,
        };
        let file = File::create(path).map_err(|error| failed(error.to_string()))?;
        let mut file = BufWriter::new(file);
        self.encode(&mut file, None)
            .map_err(|error| failed(error.to_string()))?;
        file.flush().map_err(|error| failed(error.to_string()))
    }

    /// Writes pictures of one size as an animated PNG that repeats for ever; viewers without animation show the
    /// first.
    ///
    /// # Errors
    /// [`PictureError::Write`] with the path if the file cannot be written, or if there is no picture or their
    /// sizes differ.
    pub fn write_animation(
        frames: &[Self],
        frames_per_second: u16,
        path: &Path,
    ) -> Result<(), PictureError> {
        let failed = |reason: String| PictureError::Write {
            path: path.to_owned(),
            reason,
        };
        let Some(first) = frames.first() else {
            return Err(failed("an animation needs at least one picture".to_owned()));
        };
        if frames
            .iter()
            .any(|frame| (frame.width, frame.height) != (first.width, first.height))
        {
            return Err(failed(
                "the pictures of an animation must have one size".to_owned(),
            ));
        }
        let file = File::create(path).map_err(|error| failed(error.to_string()))?;
        let mut file = BufWriter::new(file);
        first
            .encode(&mut file, Some((frames, frames_per_second.max(1))))
            .map_err(|error| failed(error.to_string()))?;
        file.flush().map_err(|error| failed(error.to_string()))
    }

    fn encode(
        &self,
        out: impl Write,
        animation: Option<(&[Self], u16)>,
    ) -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        match animation {
            None => encoder.write_header()?.write_image_data(&self.rgb),
            Some((frames, rate)) => {
                encoder.set_animated(frames.len() as u32, 0)?;
                encoder.set_frame_delay(1, rate)?;
                let mut writer = encoder.write_header()?;
                for frame in frames {
                    writer.write_image_data(&frame.rgb)?;
                }
                writer.finish()
            }
        }
    }
}
