//! The simplex spline M(u|V) by its plain recursion; the yardstick for the shared evaluation.
//!
//! M(u|w0,w1,w2) = 1/|d(w0,w1,w2)| on the half-open triangle, d being twice the signed area;
//! M(u|V) = sum over j of B_j(u|W) M(u|V \ {w_j}), W the triple of V with the largest |d|, so that no
//! barycentric coordinate exceeds 1 in size within the hull of V.

use super::orientation::{Approach, side_of_line, twice_area};
use super::{MAX_DEGREE, Vec2};

/// Value at `u` of the simplex spline with the given 3 to 8 knots (degree = knots - 3). Knots on one line,
/// fewer than three or more than eight give 0.
pub fn simplex_spline(u: Vec2, knots: &[Vec2], approach: Approach) -> f64 {
    simplex_spline_derivative(u, knots, &[], approach)
}

/// Derivative of the simplex spline along each of the `directions` in turn (as many as wanted; more than
/// the degree give 0).
///
/// D_y M(u|V) = n sum over j of mu_j M(u|V \ {w_j}) with y = sum of mu_j w_j, the mu_j summing to 0.
pub fn simplex_spline_derivative(
    u: Vec2,
    knots: &[Vec2],
    directions: &[Vec2],
    approach: Approach,
) -> f64 {
    if knots.len() < 3 || knots.len() > MAX_DEGREE + 3 {
        return 0.0;
    }
    let degree = knots.len() - 3;
    let (w, area) = widest_triple(knots);
    if area == 0.0 || directions.len() > degree {
        return 0.0;
    }
    let [a, b, c] = w.map(|index| knots[index]);
    if degree == 0 {
        let turn = side_of_line(a, b, c, Approach::from_side(Vec2::zeros()));
        let inside = [(a, b), (b, c), (c, a)]
            .into_iter()
            .all(|(from, to)| turn != 0 && side_of_line(from, to, u, approach) == turn);
        return if inside { 1.0 / area.abs() } else { 0.0 };
    }
    let (factors, rest) = match directions.split_first() {
        None => (
            [
                twice_area(u, b, c) / area,
                twice_area(a, u, c) / area,
                twice_area(a, b, u) / area,
            ],
            directions,
        ),
        Some((y, rest)) => {
            let scale = degree as f64 / area;
            (
                [
                    -scale * y.perp(&(c - b)),
                    -scale * y.perp(&(a - c)),
                    -scale * y.perp(&(b - a)),
                ],
                rest,
            )
        }
    };
    let mut sum = 0.0;
    let mut fewer = [Vec2::zeros(); MAX_DEGREE + 2];
    for (left_out, factor) in w.into_iter().zip(factors) {
        for (slot, index) in (0..knots.len())
            .filter(|index| *index != left_out)
            .enumerate()
        {
            fewer[slot] = knots[index];
        }
        sum += factor * simplex_spline_derivative(u, &fewer[..knots.len() - 1], rest, approach);
    }
    sum
}

/// The triple of knots with the largest triangle, and twice its signed area; the first of equals.
fn widest_triple(knots: &[Vec2]) -> ([usize; 3], f64) {
    let mut best = ([0, 1, 2], 0.0_f64);
    for i in 0..knots.len() {
        for j in i + 1..knots.len() {
            for k in j + 1..knots.len() {
                let area = twice_area(knots[i], knots[j], knots[k]);
                if area.abs() > best.1.abs() {
                    best = ([i, j, k], area);
                }
            }
        }
    }
    best
}
