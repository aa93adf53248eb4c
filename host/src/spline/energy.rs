//! Quadratic energies that keep a network fair where data are few: matrices on the control points.
//!
//! Everything is in the equilateral parameter frame of each face (unit edges), so an energy weighs a wiggle
//! by its size relative to its patch: patches that follow the shape's features carry a smoothing that does
//! too.

use super::bernstein::{CONTROL_POINTS, DerivativeMatrix, Direction, EQUILATERAL, edge_index};
use super::edges::Side;
use super::network::Network;
use std::sync::LazyLock;

/// A quadratic form on the 21 control points of a patch.
pub type PatchForm = [[f64; CONTROL_POINTS]; CONTROL_POINTS];

fn sum_of_squares(parts: &[(f64, &[Direction])]) -> PatchForm {
    let mut form = [[0.0; CONTROL_POINTS]; CONTROL_POINTS];
    for (weight, directions) in parts {
        let matrix = DerivativeMatrix::along(directions);
        let gram = matrix.gram(&matrix);
        for (row, add) in form.iter_mut().zip(&gram) {
            for (sum, value) in row.iter_mut().zip(add) {
                *sum += weight * value;
            }
        }
    }
    form
}

/// Thin plate: mean over the patch of S_xx^2 + 2 S_xy^2 + S_yy^2.
pub static THIN_PLATE: LazyLock<PatchForm> = LazyLock::new(|| {
    let [x, y] = EQUILATERAL;
    sum_of_squares(&[(1.0, &[x, x]), (2.0, &[x, y]), (1.0, &[y, y])])
});

/// Third derivatives: mean over the patch of S_xxx^2 + 3 S_xxy^2 + 3 S_xyy^2 + S_yyy^2. Leaves quadratics
/// free, so it does not flatten what is evenly curved.
pub static THIRD: LazyLock<PatchForm> = LazyLock::new(|| {
    let [x, y] = EQUILATERAL;
    sum_of_squares(&[
        (1.0, &[x, x, x]),
        (3.0, &[x, x, y]),
        (3.0, &[x, y, y]),
        (1.0, &[y, y, y]),
    ])
});

/// Places along an edge at which the jump of the second cross derivative is measured.
const JUMP_PLACES: usize = 5;

/// Weights of one patch's control points in its second derivative across local edge `edge`, at each of the
/// places along it seen from corner `edge`.
static SECOND_ACROSS: LazyLock<[[[f64; CONTROL_POINTS]; JUMP_PLACES]; 3]> = LazyLock::new(|| {
    [0, 1, 2].map(|edge: usize| {
        let matrix = DerivativeMatrix::along(&[across(edge); 2]);
        std::array::from_fn(|place| matrix.weights(place_on(edge, place, JUMP_PLACES)))
    })
});

/// Across a local edge: from its middle to the opposite corner, as a unit direction of the equilateral frame (height
/// sqrt 3 / 2).
pub(crate) fn across(edge: usize) -> Direction {
    let height = 0.75_f64.sqrt();
    let mut across = [-0.5 / height; 3];
    across[(edge + 2) % 3] = 1.0 / height;
    across
}

/// Barycentric coordinates of one of `places` even places on a local edge, seen from corner `edge`.
pub(crate) fn place_on(edge: usize, place: usize, places: usize) -> [f64; 3] {
    let t = (place as f64 + 0.5) / places as f64;
    let mut at = [0.0; 3];
    at[edge] = 1.0 - t;
    at[(edge + 1) % 3] = t;
    at
}

/// Adds to a row (control point, weight) the three rows of control points next to one side of an edge, each with the
/// weight that `weight` gives for its slot in the patch.
pub(crate) fn add_side(
    row: &mut Vec<(u32, f64)>,
    network: &Network,
    side: &Side,
    weight: impl Fn(usize) -> f64,
) {
    for r in 0..3 {
        for along in 0..=5 - r {
            let slot = edge_index(usize::from(side.local), r, along);
            let number = network.numbers[side.face as usize][slot];
            match row.iter_mut().find(|(known, _)| *known == number) {
                Some((_, sum)) => *sum += weight(slot),
                None => row.push((number, weight(slot))),
            }
        }
    }
}

/// Rows (control point, weight) whose squares sum to the mean squared jump of the second cross derivative
/// over smooth edge `edge`; empty for creases and borders.
pub fn jump_rows(network: &Network, edge: usize) -> Vec<Vec<(u32, f64)>> {
    let (Some(sides), true) = (network.table.edges[edge].both(), network.smooth[edge]) else {
        return Vec::new();
    };
    let scale = 1.0 / (JUMP_PLACES as f64).sqrt();
    (0..JUMP_PLACES)
        .map(|place| {
            let mut row: Vec<(u32, f64)> = Vec::with_capacity(24);
            for (side, sign) in sides.iter().zip([1.0, -1.0]) {
                let place = if sign > 0.0 {
                    place
                } else {
                    JUMP_PLACES - 1 - place
                };
                let weights = &SECOND_ACROSS[usize::from(side.local)][place];
                add_side(&mut row, network, side, |slot| sign * scale * weights[slot]);
            }
            row.retain(|(_, weight)| *weight != 0.0);
            row
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::bernstein::EXPONENTS;

    fn energy(form: &PatchForm, points: &[f64; CONTROL_POINTS]) -> f64 {
        (0..CONTROL_POINTS)
            .map(|a| {
                (0..CONTROL_POINTS)
                    .map(|b| points[a] * form[a][b] * points[b])
                    .sum::<f64>()
            })
            .sum()
    }

    #[test]
    fn energies_leave_low_degrees_free() {
        let linear = EXPONENTS.map(|e| f64::from(e[1]) * 0.3 - f64::from(e[2]));
        assert!(energy(&THIN_PLATE, &linear).abs() < 1e-18 * 1e6);
        // b0^2 raised to degree 5: coefficients i (i - 1) / 20.
        let square = EXPONENTS.map(|e| f64::from(e[0]) * (f64::from(e[0]) - 1.0) / 20.0);
        assert!(energy(&THIRD, &square).abs() < 1e-12);
        // Its second derivatives are constant: b0 has gradient length 2 / sqrt 3, so 2 g g^T has squared
        // norm 4 (4/3)^2.
        assert!((energy(&THIN_PLATE, &square) - 64.0 / 9.0).abs() < 1e-10);
    }
}
