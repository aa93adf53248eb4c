//! Light: two lamps beside the viewer, light from all around, and how much of that reaches hollows.
//!
//! Ambient occlusion is estimated on the picture itself: around each pixel, surface that rises above the pixel's
//! tangent plane within a fixed radius takes light away in proportion to its height angle. Source of the
//! estimator: McGuire, Osman, Bukowski, Hennessy, "The Alchemy screen-space ambient obscurance algorithm" (2011).

use rayon::prelude::*;

use super::camera::{Camera, Seen};
use super::colour::Colour;

/// Places looked at around each pixel.
const LOOKS: usize = 24;
/// Radius within which surface takes light away, as a share of the scene's radius.
const RADIUS: f32 = 0.22;
/// How dark hollows get.
const STRENGTH: f32 = 1.5;
/// Turns of the spiral on which the places lie; has no common divisor with [`LOOKS`].
const TURNS: f32 = 7.0;

/// Where the main lamp stands, above left, in view space.
const MAIN_LAMP: [f32; 3] = [-0.4364, 0.6547, 0.6172];

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// What a normal gets of the main lamp, 0 to 1: a little also from beyond its rim.
fn main_lamp(normal: [f32; 3]) -> f32 {
    ((dot(normal, MAIN_LAMP) + 0.18) / 1.18).max(0.0)
}

/// Colour of the ground at a height of the picture, 0 above to 1 below.
pub(super) fn background(height: f32) -> Colour {
    let above = Colour([1.0, 1.0, 1.0]);
    let below = Colour([0.86, 0.885, 0.915]);
    above.mix(below, height.clamp(0.0, 1.0).powi(2))
}

/// Colour of a surface with a unit normal in view space and the given openness (0 hidden, 1 open).
pub(super) fn shade(normal: [f32; 3], colour: Colour, open: f32) -> Colour {
    // The fill lamp stands on the right.
    let fill = [0.8321, 0.0555, 0.5518];
    let lamps = 0.60 * main_lamp(normal) * (0.35 + 0.65 * open) + 0.13 * dot(normal, fill).max(0.0);
    let ambient = (0.33 + 0.09 * normal[1]) * open;
    // Halfway between lamp and viewer, for a soft highlight.
    let half = [-0.2426, 0.3640, 0.8992];
    let gloss = 0.07 * dot(normal, half).max(0.0).powi(48) * open;
    Colour(colour.0.map(|x| x * (lamps + ambient) + gloss))
}

/// Colour of a surface whose colour stands for a number: its shape shows, but no highlight and no deep shade gives the
/// colour a false hue.
pub(super) fn shade_evenly(normal: [f32; 3], colour: Colour, open: f32) -> Colour {
    let light = (0.74 + 0.26 * main_lamp(normal)) * (0.7 + 0.3 * open);
    Colour(colour.0.map(|x| x * light))
}

/// Colour of a polished surface among strip lights that run from left to right: `light` where it mirrors a light,
/// dark where it mirrors a gap. Six of each over half a turn.
pub(super) fn strip_lights(normal: [f32; 3], gaze: [f32; 3], light: Colour) -> Colour {
    let along: f32 = normal.iter().zip(&gaze).map(|(n, g)| n * g).sum();
    let mirrored = [0, 1, 2].map(|i| gaze[i] - 2.0 * along * normal[i]);
    let angle = mirrored[1].atan2(mirrored[2]);
    if (12.0 * angle).sin() > 0.0 {
        light
    } else {
        Colour([0.013, 0.022, 0.033])
    }
}

/// How much light from around reaches each pixel.
pub(super) struct Occlusion {
    width: usize,
    height: usize,
    nearness: Vec<f32>,
    open: Vec<f32>,
}

impl Occlusion {
    /// From nearness (`f32::MIN`: nothing there) and normal of each pixel's middle.
    pub(super) fn new(
        camera: &Camera,
        width: usize,
        height: usize,
        nearness: Vec<f32>,
        normals: &[[f32; 3]],
    ) -> Self {
        let radius = RADIUS * camera.reach() as f32;
        let radius_pixels = radius / camera.pixel_size(height) as f32;
        let place = |column: usize, row: usize| {
            let nearness = nearness[row * width + column];
            (nearness > f32::MIN).then(|| {
                let seen = Seen {
                    x: column as f32 + 0.5,
                    y: row as f32 + 0.5,
                    nearness,
                };
                camera.unsee(seen, width, height)
            })
        };
        let raw: Vec<f32> = (0..height)
            .into_par_iter()
            .flat_map_iter(|row| {
                (0..width).map(move |column| {
                    let Some(here) = place(column, row) else {
                        return 1.0;
                    };
                    let normal = normals[row * width + column];
                    // Neighbours look in different directions; the blur below joins their answers.
                    let turn = ((column % 4) * 4 + row % 4) as f32 / 16.0 * std::f32::consts::TAU;
                    let mut taken = 0.0;
                    for look in 0..LOOKS {
                        let share = (look as f32 + 0.5) / LOOKS as f32;
                        let (sin, cos) = (share * TURNS * std::f32::consts::TAU + turn).sin_cos();
                        let x = column as f32 + 0.5 + cos * share * radius_pixels;
                        let y = row as f32 + 0.5 + sin * share * radius_pixels;
                        if x < 0.0 || y < 0.0 || x >= width as f32 || y >= height as f32 {
                            continue;
                        }
                        let Some(there) = place(x as usize, y as usize) else {
                            continue;
                        };
                        let to = [0, 1, 2].map(|i| there[i] - here[i]);
                        let square: f32 = to.iter().map(|x| x * x).sum();
                        let rise: f32 = to.iter().zip(&normal).map(|(a, b)| a * b).sum();
                        let fade = (1.0 - square / (radius * radius)).max(0.0);
                        let angle = rise / square.sqrt().max(1e-6 * radius);
                        taken += (angle - 0.06).max(0.0) * fade;
                    }
                    (1.0 - STRENGTH * 2.0 * taken / LOOKS as f32).clamp(0.0, 1.0)
                })
            })
            .collect();
        let open = smoothed(&raw, &nearness, width, height);
        Self {
            width,
            height,
            nearness,
            open,
        }
    }

    /// Openness of something seen at a place between the pixels' middles, from those neighbours that lie at the same depth.
    pub(super) fn open_at(&self, x: f32, y: f32, nearness: f32) -> f32 {
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (column, row) = (left + dx, top + dy);
            if column < 0.0 || row < 0.0 || column >= self.width as f32 || row >= self.height as f32
            {
                continue;
            }
            let pixel = row as usize * self.width + column as usize;
            let near = (1.0 - (x - column).abs()) * (1.0 - (y - row).abs()) + 1e-3;
            let weight = near * same_depth(self.nearness[pixel], nearness) + 1e-9;
            sum += weight
                * if self.nearness[pixel] > f32::MIN {
                    self.open[pixel]
                } else {
                    1.0
                };
            weights += weight;
        }
        if weights > 0.0 { sum / weights } else { 1.0 }
    }
}

/// 1 for equal depths, falling to 0 about a hundredth of the viewing distance apart.
fn same_depth(a: f32, b: f32) -> f32 {
    let apart = (a - b) / 0.004;
    1.0 / (1.0 + apart * apart)
}

/// Each pixel averaged with its 7 x 7 neighbours at the same depth, so that every direction has been looked at.
fn smoothed(raw: &[f32], nearness: &[f32], width: usize, height: usize) -> Vec<f32> {
    let pass =
        |from: &[f32], step: usize, limit: &(dyn Fn(usize) -> (usize, usize) + Sync)| -> Vec<f32> {
            (0..from.len())
                .into_par_iter()
                .map(|pixel| {
                    let here = nearness[pixel];
                    if here == f32::MIN {
                        return 1.0;
                    }
                    let (before, after) = limit(pixel);
                    let (mut sum, mut weights) = (0.0, 0.0);
                    for offset in 0..=before.min(3) + after.min(3) {
                        let other = pixel + offset * step - before.min(3) * step;
                        let weight = same_depth(nearness[other], here);
                        sum += weight * from[other];
                        weights += weight;
                    }
                    sum / weights
                })
                .collect()
        };
    let across = pass(raw, 1, &|pixel| (pixel % width, width - 1 - pixel % width));
    pass(&across, width, &|pixel| {
        (pixel / width, height - 1 - pixel / width)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_that_stand_for_numbers_keep_their_hue() {
        let colour = Colour([0.5, 0.2, 0.05]);
        // Towards the lamp, the viewer, away from both; open and in a hollow.
        for normal in [MAIN_LAMP, [0.0, 0.0, 1.0], [0.6, -0.8, 0.0]] {
            for open in [0.0, 1.0] {
                let Colour(lit) = shade_evenly(normal, colour, open);
                let share = lit[0] / colour.0[0];
                assert!((0.5..=1.001).contains(&share), "{share}");
                assert!((lit[2] / colour.0[2] - share).abs() < 1e-6);
            }
        }
    }
}
