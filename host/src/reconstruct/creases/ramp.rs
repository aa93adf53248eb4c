//! Whether the normals across a seeming edge jump, or turn gradually from one sheet to the other.
//!
//! The normals' angle over the distance from the edge is fitted twice: with a line on each side, which leaves a jump between them,
//! and with lines that end at -w and begin at w, and a ramp that joins them. At an edge that is one no ramp explains the angles better;
//! where the edge is rounded with a radius of a spacing or two, one leaves a third of what the jump leaves. Wider roundings
//! are followed by the sheets themselves. Positions are noisy across the edge, too, where an angle may be right of either
//! sheet: so each point may choose, within that noise, how far from the edge it lies.

use nalgebra::{Matrix4, Vector4};

/// Least and further half widths of a ramp, each so many times as wide as the last, in spacings.
const LEAST: f64 = 0.8;
const WIDTHS: i32 = 5;
const WIDER: f64 = 1.3;
/// Sum of squares left by the jump against that left by the best ramp, from which on it is a ramp: 1.6 to 11 on rounded
/// edges of mugs (radius 1 to 2 spacings), at most 0.7 on true edges of flat and free-form sheets.
const BETTER: f64 = 1.2;
/// Share of the points that may touch an edge itself, with normals between the sheets': so many of the worst are left out. On the
/// narrowest ramp that counts lie twice as many.
const ON_EDGES: f64 = 0.12;
/// Points across a stretch of an edge that show whether it is one.
const POINTS_MIN: usize = 12;

/// A point across a seeming edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Distance from the edge, negative on the first sheet, in spacings.
    pub(super) side: f64,
    /// Angle of its normal from that of the first sheet at the edge, towards the second's, radians.
    pub(super) angle: f64,
    /// Angle between the two sheets there.
    pub(super) turn: f64,
}

/// Whether ramps explain stretches of a seeming edge better than jumps; `None` where too few points tell. Distances may be off by
/// `blur`, in spacings.
pub(super) fn is_likelier(stretches: &[Vec<Seen>], blur: f64) -> Option<bool> {
    let told: Vec<&Vec<Seen>> = stretches.iter().filter(|s| s.len() >= POINTS_MIN).collect();
    if told.is_empty() {
        return None;
    }
    let misfit = |w: f64| {
        let mut squares: Vec<f64> = told.iter().flat_map(|s| squares(s, w, blur)).collect();
        squares.sort_by(f64::total_cmp);
        let kept = squares.len() - (ON_EDGES * squares.len() as f64) as usize;
        squares[..kept].iter().sum::<f64>()
    };
    let least = LEAST.max(2.0 * blur);
    let best = (0..WIDTHS)
        .map(|k| misfit(least * WIDER.powi(k)))
        .fold(f64::INFINITY, f64::min);
    Some(BETTER * best < misfit(0.0))
}

/// The squared residuals of the angles about two lines with a ramp of half width `w` between them.
fn squares(stretch: &[Seen], w: f64, blur: f64) -> Vec<f64> {
    // Offset and slope of either line.
    let row = |side: f64| {
        if side <= -w {
            Vector4::new(1.0, side + w, 0.0, 0.0)
        } else if side >= w {
            Vector4::new(0.0, 0.0, 1.0, side - w)
        } else {
            let share = (side + w) / (2.0 * w);
            Vector4::new(1.0 - share, 0.0, share, 0.0)
        }
    };
    // Where no points tell, lines run on as the sheets do.
    let mut left = Matrix4::from_diagonal(&Vector4::new(1e-6, 1e-2, 1e-6, 1e-2));
    let mut right = Vector4::zeros();
    for seen in stretch.iter().filter(|s| s.side.abs() > w.max(blur)) {
        let row = row(seen.side);
        left += row * row.transpose();
        right += row * (seen.angle - seen.turn * row[2]);
    }
    let Some(factor) = left.cholesky() else {
        return vec![f64::INFINITY; stretch.len()];
    };
    let lines = factor.solve(&right);
    let rest = |seen: &Seen| {
        let squared = |side: f64| {
            let row = row(side);
            (seen.angle - seen.turn * row[2] - row.dot(&lines)).powi(2)
        };
        [-1.0, -0.5, 0.0, 0.5, 1.0]
            .map(|share| squared(seen.side + share * blur))
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    };
    stretch.iter().map(rest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const BLUR: f64 = 0.4;

    /// Noisy angles across an edge of 80 degrees whose sheets bend by themselves, rounded with this half width, spacings.
    fn stretches(width: f64) -> Vec<Vec<Seen>> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut even = move || 2.0 * random.random::<f64>() - 1.0;
        let turn = 1.4;
        let mut seen = || {
            let side = 3.5 * even();
            let share = (0.5 + 0.5 * side / width.max(1e-9)).clamp(0.0, 1.0);
            let beyond = (side.abs() - width).max(0.0);
            Seen {
                side: side + 0.3 * even(),
                angle: turn * share + 0.15 * beyond * side.signum() + 0.1 * even(),
                turn,
            }
        };
        (0..4).map(|_| (0..25).map(|_| seen()).collect()).collect()
    }

    #[test]
    fn a_jump_is_none_and_a_rounding_is_a_ramp() {
        assert_eq!(is_likelier(&stretches(0.0), BLUR), Some(false));
        for width in [1.0, 1.3, 1.6] {
            assert_eq!(is_likelier(&stretches(width), BLUR), Some(true), "{width}");
        }
    }

    #[test]
    fn points_that_touch_the_edge_itself_make_no_ramp() {
        let mut touched = stretches(0.0);
        for stretch in &mut touched {
            for (k, seen) in stretch.iter_mut().take(2).enumerate() {
                seen.side = 0.1;
                seen.angle = 0.4 + 0.5 * k as f64;
            }
        }
        assert_eq!(is_likelier(&touched, BLUR), Some(false));
    }

    #[test]
    fn a_few_points_tell_nothing() {
        let few: Vec<Vec<Seen>> = stretches(0.0).iter().map(|s| s[..8].to_vec()).collect();
        assert_eq!(is_likelier(&few, BLUR), None);
        assert_eq!(is_likelier(&[], BLUR), None);
    }
}
