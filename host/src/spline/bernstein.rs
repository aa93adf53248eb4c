//! Bernstein polynomials on the triangle: numbering, values, derivatives, exact integrals.
//!
//! A polynomial of degree n on a triangle has (n+1)(n+2)/2 coefficients, numbered by their barycentric
//! exponents (i, j, k), i + j + k = n: i falling, then j falling. In a patch of degree 5, corner 0 is
//! number 0, corner 1 number 15 and corner 2 number 20.
//!
//! Parameters are u = b1 and v = b2 (barycentric coordinates of corners 1 and 2), so that derivatives by
//! u and v run along the directions corner 1 - corner 0 and corner 2 - corner 0.

use std::sync::LazyLock;

/// Degree of the network's patches.
pub const DEGREE: usize = 5;
/// Control points of a patch of degree 5.
pub const CONTROL_POINTS: usize = 21;

/// Barycentric exponents (i, j, k), i + j + k = 5, of each control point.
pub const EXPONENTS: [[u8; 3]; CONTROL_POINTS] = exponents::<CONTROL_POINTS>(DEGREE as u8);

/// Coefficients of a polynomial of the given degree.
pub const fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

/// Barycentric exponents of all coefficients of the given degree, `N = count(degree)`.
pub const fn exponents<const N: usize>(degree: u8) -> [[u8; 3]; N] {
    let mut table = [[0; 3]; N];
    let mut row = 0;
    let mut i = degree + 1;
    while i > 0 {
        i -= 1;
        let mut j = degree - i + 1;
        while j > 0 {
            j -= 1;
            table[row] = [i, j, degree - i - j];
            row += 1;
        }
    }
    table
}

/// Number of the coefficient with exponents (i, j, k), whose sum is the degree.
pub const fn index(exponents: [u8; 3]) -> usize {
    let rest = (exponents[1] + exponents[2]) as usize;
    rest * (rest + 1) / 2 + exponents[2] as usize
}

/// Number of the control point in row `row` (0: on the edge) at place `along` (0 ..= 5 - row) seen from
/// local edge `edge`, which runs from corner `edge` to corner `edge + 1` (modulo 3).
pub const fn edge_index(edge: usize, row: usize, along: usize) -> usize {
    let mut exponents = [0; 3];
    exponents[edge] = (DEGREE - row - along) as u8;
    exponents[(edge + 1) % 3] = along as u8;
    exponents[(edge + 2) % 3] = row as u8;
    index(exponents)
}

/// What the Bernstein polynomials of one degree need, made once: `N` is their number.
struct Terms<const N: usize>;

impl<const N: usize> Terms<N> {
    const EXPONENTS: [[u8; 3]; N] = exponents::<N>(degree_of(N));
    const MULTINOMIALS: [f64; N] = {
        let mut table = [0.0; N];
        let mut row = 0;
        while row < N {
            let [i, j, k] = Self::EXPONENTS[row];
            let all = factorial(degree_of(N));
            table[row] = all / (factorial(i) * factorial(j) * factorial(k));
            row += 1;
        }
        table
    };
}

const fn factorial(n: u8) -> f64 {
    if n < 2 {
        1.0
    } else {
        n as f64 * factorial(n - 1)
    }
}

/// The degree whose polynomials have this many coefficients.
const fn degree_of(number: usize) -> u8 {
    let mut degree = 0;
    while count(degree) < number {
        degree += 1;
    }
    degree as u8
}

/// Values of the Bernstein polynomials of degree `degree` at barycentric coordinates, `N = count(degree)`.
pub fn values<const N: usize>(degree: u8, barycentric: [f64; 3]) -> [f64; N] {
    debug_assert_eq!(count(usize::from(degree)), N);
    let mut powers = [[1.0; 8]; 3];
    for axis in 0..3 {
        for power in 1..=usize::from(degree) {
            powers[axis][power] = powers[axis][power - 1] * barycentric[axis];
        }
    }
    let mut out = [0.0; N];
    for ((value, [i, j, k]), multinomial) in
        (out.iter_mut().zip(Terms::<N>::EXPONENTS)).zip(Terms::<N>::MULTINOMIALS)
    {
        *value = multinomial
            * powers[0][usize::from(i)]
            * powers[1][usize::from(j)]
            * powers[2][usize::from(k)];
    }
    out
}

/// A direction in the parameter plane, in barycentric coordinates (sum 0).
pub type Direction = [f64; 3];

/// Along corner 1 - corner 0.
pub const ALONG_U: Direction = [-1.0, 1.0, 0.0];
/// Along corner 2 - corner 0.
pub const ALONG_V: Direction = [-1.0, 0.0, 1.0];

/// Directions x and y of an equilateral parameter triangle with unit edges whose edge 0-1 lies along x:
/// the frame in which no corner of a face is preferred.
pub const EQUILATERAL: [Direction; 2] = [
    ALONG_U,
    // (2 v - u) / sqrt 3
    [
        -0.577_350_269_189_625_8,
        -0.577_350_269_189_625_8,
        1.154_700_538_379_251_5,
    ],
];

/// Coefficients (degree n - 1) of the derivative along `direction` of a polynomial of degree n given by
/// its coefficients.
pub fn derivative(degree: u8, direction: Direction, coefficients: &[f64]) -> Vec<f64> {
    let lower = degree - 1;
    let mut out = Vec::with_capacity(count(usize::from(lower)));
    for i in (0..=lower).rev() {
        for j in (0..=lower - i).rev() {
            let k = lower - i - j;
            let sum = direction[0] * coefficients[index([i + 1, j, k])]
                + direction[1] * coefficients[index([i, j + 1, k])]
                + direction[2] * coefficients[index([i, j, k + 1])];
            out.push(sum * f64::from(degree));
        }
    }
    out
}

/// A linear map from the 21 control points of a patch to the coefficients of one of its derivatives:
/// `rows[r][c]`, one row per coefficient of the derivative.
#[derive(Clone, Debug)]
pub struct DerivativeMatrix {
    /// Degree of the derivative.
    pub degree: u8,
    /// One row per coefficient, one column per control point.
    pub rows: Vec<[f64; CONTROL_POINTS]>,
}

impl DerivativeMatrix {
    /// The derivative along the given directions, one after the other (at most five).
    pub fn along(directions: &[Direction]) -> Self {
        let degree = DEGREE as u8 - directions.len() as u8;
        let mut rows = vec![[0.0; CONTROL_POINTS]; count(usize::from(degree))];
        for column in 0..CONTROL_POINTS {
            let mut coefficients = vec![0.0; CONTROL_POINTS];
            coefficients[column] = 1.0;
            for (step, direction) in directions.iter().enumerate() {
                coefficients = derivative(DEGREE as u8 - step as u8, *direction, &coefficients);
            }
            for (row, value) in rows.iter_mut().zip(coefficients) {
                row[column] = value;
            }
        }
        Self { degree, rows }
    }

    /// Weight of each control point in the derivative's value at barycentric coordinates.
    pub fn weights(&self, barycentric: [f64; 3]) -> [f64; CONTROL_POINTS] {
        let mut out = [0.0; CONTROL_POINTS];
        let mut add = |values: &[f64]| {
            for (row, value) in self.rows.iter().zip(values) {
                for (sum, entry) in out.iter_mut().zip(row) {
                    *sum += value * entry;
                }
            }
        };
        match self.degree {
            4 => add(&values::<15>(4, barycentric)),
            3 => add(&values::<10>(3, barycentric)),
            2 => add(&values::<6>(2, barycentric)),
            1 => add(&values::<3>(1, barycentric)),
            _ => add(&[1.0]),
        }
        out
    }

    /// Integral over the triangle (area 1) of the product of two derivatives of the same degree, as a
    /// matrix on the control points: the sum over coefficients r, s of `self[r] gram[r][s] other[s]`.
    pub fn gram(&self, other: &Self) -> [[f64; CONTROL_POINTS]; CONTROL_POINTS] {
        let gram = gram(self.degree);
        let mut half = vec![[0.0; CONTROL_POINTS]; self.rows.len()];
        for (target, weights) in half.iter_mut().zip(&gram) {
            for (weight, row) in weights.iter().zip(&other.rows) {
                for (sum, entry) in target.iter_mut().zip(row) {
                    *sum += weight * entry;
                }
            }
        }
        let mut out = [[0.0; CONTROL_POINTS]; CONTROL_POINTS];
        for (left, right) in self.rows.iter().zip(&half) {
            for (target, factor) in out.iter_mut().zip(left) {
                for (sum, entry) in target.iter_mut().zip(right) {
                    *sum += factor * entry;
                }
            }
        }
        out
    }
}

/// Integrals over the triangle (area 1) of the products of the Bernstein polynomials of one degree:
/// C(i+p, i) C(j+q, j) C(k+r, k) / (C(2n, n) C(2n+2, 2)).
fn gram(degree: u8) -> Vec<Vec<f64>> {
    let choose = |n: u8, k: u8| factorial(n) / (factorial(k) * factorial(n - k));
    let mut exponents = Vec::new();
    for i in (0..=degree).rev() {
        for j in (0..=degree - i).rev() {
            exponents.push([i, j, degree - i - j]);
        }
    }
    let scale = choose(2 * degree, degree) * choose(2 * degree + 2, 2);
    exponents
        .iter()
        .map(|a| {
            exponents
                .iter()
                .map(|b| (0..3).map(|m| choose(a[m] + b[m], a[m])).product::<f64>() / scale)
                .collect()
        })
        .collect()
}

/// The first derivatives by u and v.
pub static FIRST: LazyLock<[DerivativeMatrix; 2]> = LazyLock::new(|| {
    [
        DerivativeMatrix::along(&[ALONG_U]),
        DerivativeMatrix::along(&[ALONG_V]),
    ]
});

/// The second derivatives by uu, uv and vv.
pub static SECOND: LazyLock<[DerivativeMatrix; 3]> = LazyLock::new(|| {
    [
        DerivativeMatrix::along(&[ALONG_U, ALONG_U]),
        DerivativeMatrix::along(&[ALONG_U, ALONG_V]),
        DerivativeMatrix::along(&[ALONG_V, ALONG_V]),
    ]
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbering_is_its_own_inverse() {
        for (number, exponents) in EXPONENTS.iter().enumerate() {
            assert_eq!(index(*exponents), number);
        }
        assert_eq!(edge_index(0, 0, 0), 0);
        assert_eq!(edge_index(1, 0, 0), 15);
        assert_eq!(edge_index(2, 0, 0), 20);
        assert_eq!(edge_index(2, 0, 5), 0);
    }

    #[test]
    fn values_sum_to_one_and_derivative_matches_differences() {
        let at = [0.2, 0.5, 0.3];
        let sum: f64 = values::<21>(5, at).iter().sum();
        assert!((sum - 1.0).abs() < 1e-14);
        let step = 1e-6;
        for (matrix, direction) in FIRST.iter().zip([ALONG_U, ALONG_V]) {
            let exact = matrix.weights(at);
            let shifted =
                |s: f64| values::<21>(5, std::array::from_fn(|m| at[m] + s * direction[m]));
            let (plus, minus) = (shifted(step), shifted(-step));
            for c in 0..CONTROL_POINTS {
                assert!((exact[c] - (plus[c] - minus[c]) / (2.0 * step)).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn gram_integrates_products_exactly() {
        // The product of (b0)^2 and (b1)^2 over a triangle of area 1: 2! 2! 2! / 6!.
        let entry = gram(2)[index([2, 0, 0])][index([0, 2, 0])];
        assert!((entry - 8.0 / 720.0).abs() < 1e-15);
    }
}
