//! On which side of a line a point of the plane lies: exact, and with the half-open rule.
//!
//! The pieces of a simplex spline meet on lines through its knots. A point on such a line must belong to
//! exactly one side, and the same one in every triangle that the line bounds; otherwise values there are
//! lost or counted twice. The rule: a point counts as moved by an infinitesimal (e p + e^2 q), q being p
//! turned by a quarter. With the default p = (1, 0) that is (e, e^2). Other p give the limit from that
//! side, and so exact one-sided derivatives.
//!
//! The signs are exact (unless products underflow): floating-point filters decide the clear cases, error-free sums of
//! products the others. Source: Shewchuk, "Adaptive precision floating-point arithmetic and fast robust geometric
//! predicates" (1997).

use super::Vec2;

/// From where a point is approached when it lies on a knot line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach(Vec2);

impl Approach {
    /// The limit from the side of `direction`. A zero direction leaves points on knot lines outside of all.
    pub fn from_side(direction: Vec2) -> Self {
        Self(direction)
    }
}

impl Default for Approach {
    /// The point moved by an infinitesimal (e, e^2).
    fn default() -> Self {
        Self(Vec2::new(1.0, 0.0))
    }
}

/// 1 if `point`, seen from `from` to `to`, lies left of the line, -1 if right, by the half-open rule; 0 only
/// if both ends coincide or a value is not finite.
pub fn side_of_line(from: Vec2, to: Vec2, point: Vec2, approach: Approach) -> i8 {
    place(from, to, point, approach).1
}

/// Twice the signed area of a triangle, with small relative error however thin it is.
pub(super) fn twice_area(a: Vec2, b: Vec2, c: Vec2) -> f64 {
    determinant(a, b, c).0
}

/// [`twice_area`] of (from, to, point), and [`side_of_line`].
pub(super) fn place(from: Vec2, to: Vec2, point: Vec2, approach: Approach) -> (f64, i8) {
    let (determinant, certain) = determinant(from, to, point);
    if certain {
        return (determinant, if determinant > 0.0 { 1 } else { -1 });
    }
    let exact = sign_of_sum(&[
        (from.x, to.y),
        (-from.y, to.x),
        (to.x, point.y),
        (-to.y, point.x),
        (point.x, from.y),
        (-point.y, from.x),
    ]);
    if exact != 0 {
        return (determinant, exact);
    }
    let p = approach.0;
    let side = match turn(from, to, p) {
        0 => turn(from, to, Vec2::new(-p.y, p.x)),
        sign => sign,
    };
    (0.0, side)
}

/// det(from - point, to - point), and whether its sign is certain.
///
/// Plain arithmetic is good to 3 e / 0.05, below 1e-14, as long as its two products do not cancel to less than a
/// twentieth; otherwise the rounding errors of differences and products are added, which leaves an absolute error
/// of some 10 e^2 of the products' size. Barycentric coordinates would lose up to six digits at thin triangles
/// without this (partition of unity on 25 500 random points: off by up to 4e-12 without, 1e-15 with).
fn determinant(from: Vec2, to: Vec2, point: Vec2) -> (f64, bool) {
    let (a, b) = (from - point, to - point);
    let (left, right) = (a.x * b.y, a.y * b.x);
    let plain = left - right;
    let size = left.abs() + right.abs();
    if plain.abs() > 0.05 * size {
        return (plain, true);
    }
    let tail = |x: f64, y: f64| two_sum(x, -y).1;
    let (a_tail, b_tail) = (
        Vec2::new(tail(from.x, point.x), tail(from.y, point.y)),
        Vec2::new(tail(to.x, point.x), tail(to.y, point.y)),
    );
    let left_error = a.x.mul_add(b.y, -left);
    let right_error = a.y.mul_add(b.x, -right);
    let (difference, error) = two_sum(left, -right);
    let tails = (a.x * b_tail.y + b.y * a_tail.x) - (a.y * b_tail.x + b.x * a_tail.y);
    let refined = difference + (error + (left_error - right_error) + tails);
    (refined, refined.abs() > 1e-30 * size)
}

/// Sign of det(to - from, direction), exact.
fn turn(from: Vec2, to: Vec2, direction: Vec2) -> i8 {
    sign_of_sum(&[
        (to.x, direction.y),
        (-from.x, direction.y),
        (-to.y, direction.x),
        (from.y, direction.x),
    ])
}

/// Exact sign of a sum of at most six products: the running sum is kept as non-overlapping parts of rising size.
fn sign_of_sum(products: &[(f64, f64)]) -> i8 {
    let mut parts = [0.0_f64; 12];
    let mut used = 0;
    for &(a, b) in products {
        let high = a * b;
        let low = a.mul_add(b, -high);
        for addend in [low, high] {
            let mut carry = addend;
            for part in &mut parts[..used] {
                let (sum, error) = two_sum(carry, *part);
                *part = error;
                carry = sum;
            }
            parts[used] = carry;
            used += 1;
        }
    }
    parts[..used]
        .iter()
        .rev()
        .find(|part| **part != 0.0)
        .map_or(0, |part| {
            if *part > 0.0 {
                1
            } else if *part < 0.0 {
                -1
            } else {
                0
            }
        })
}

/// a + b and its rounding error.
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_virtual = sum - a;
    (sum, (a - (sum - b_virtual)) + (b - b_virtual))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_exact_where_rounding_would_decide() {
        let approach = Approach::default();
        let tiny = f64::EPSILON;
        // Points next to the diagonal, in steps of one unit in the last place.
        let (from, to) = (Vec2::new(12.0, 12.0), Vec2::new(24.0, 24.0));
        for row in 0..64 {
            for column in 0..64 {
                let point = Vec2::new(0.5 + f64::from(column) * tiny, 0.5 + f64::from(row) * tiny);
                let expected = match row.cmp(&column) {
                    std::cmp::Ordering::Greater => 1,
                    std::cmp::Ordering::Less => -1,
                    // On the diagonal: moved by (e, e^2), so right of it.
                    std::cmp::Ordering::Equal => -1,
                };
                assert_eq!(
                    side_of_line(from, to, point, approach),
                    expected,
                    "{row} {column}"
                );
                assert_eq!(
                    side_of_line(to, from, point, approach),
                    -expected,
                    "{row} {column}"
                );
            }
        }
    }

    #[test]
    fn a_point_on_a_line_counts_as_moved_right_and_a_little_up() {
        let approach = Approach::default();
        let at = Vec2::new(0.25, 0.5);
        let up = (Vec2::new(0.25, 0.0), Vec2::new(0.25, 1.0));
        let right = (Vec2::new(0.0, 0.5), Vec2::new(1.0, 0.5));
        assert_eq!(side_of_line(up.0, up.1, at, approach), -1);
        assert_eq!(side_of_line(right.0, right.1, at, approach), 1);
        let from_left = Approach::from_side(Vec2::new(-1.0, 0.0));
        assert_eq!(side_of_line(up.0, up.1, at, from_left), 1);
        assert_eq!(side_of_line(right.0, right.1, at, from_left), -1);
    }

    #[test]
    fn hopeless_input_gives_no_side() {
        let a = Vec2::new(1.0, 2.0);
        assert_eq!(side_of_line(a, a, a, Approach::default()), 0);
        let nan = Vec2::new(f64::NAN, 0.0);
        assert_eq!(side_of_line(a, nan, a, Approach::default()), 0);
    }
}
