//! Colours of mesh vertices: blue over pale grey to orange, which also the common colour-blind can tell apart.
//!
//! The stops are #2166ac, #ebebeb and #d95f02 of sRGB; glTF wants them as linear light.

use crate::spline::SampledSurface;

const SRGB: [[f32; 3]; 3] = [[33.0, 102.0, 172.0], [235.0; 3], [217.0, 95.0, 2.0]];
const LINEAR: [[f32; 3]; 3] = [[3.9, 33.9, 105.2], [211.9; 3], [176.9, 29.2, 0.2]];
/// Share of the vertices whose mean curvature lies within the range of the colours.
const WITHIN: f64 = 0.98;

/// Colour of a share (0 to 1) as sRGB.
pub(super) fn srgb(share: f32) -> [u8; 3] {
    mix(&SRGB, share)
}

/// Colour of a share (0 to 1) as linear light.
pub(super) fn linear(share: f32) -> [u8; 3] {
    mix(&LINEAR, share)
}

fn mix(stops: &[[f32; 3]; 3], share: f32) -> [u8; 3] {
    let share = share.clamp(0.0, 1.0);
    let (from, to, t) = if share < 0.5 {
        (stops[0], stops[1], 2.0 * share)
    } else {
        (stops[1], stops[2], 2.0 * share - 1.0)
    };
    [0, 1, 2].map(|k| (from[k] + (to[k] - from[k]) * t).round() as u8)
}

/// Mean curvature of each point as a share: pale where the surface is flat, orange where it bends outwards, blue
/// inwards. Empty if the curvature is unknown.
pub(super) fn curvature_shares(sampled: &SampledSurface) -> Vec<f32> {
    if sampled.curvature.len() != sampled.positions.len() {
        return Vec::new();
    }
    let mut sizes: Vec<f64> = sampled.curvature.iter().map(|c| c[0].abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let rank = ((sizes.len() as f64 * WITHIN) as usize).min(sizes.len().saturating_sub(1));
    let range = sizes.get(rank).copied().unwrap_or(0.0);
    let share = |mean: f64| {
        if range > 0.0 {
            (0.5 + 0.5 * mean / range) as f32
        } else {
            0.5
        }
    };
    sampled.curvature.iter().map(|c| share(c[0])).collect()
}
