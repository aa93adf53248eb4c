//! Bernstein polynomials and de Casteljau's algorithm on the triangle.
//!
//! A patch of degree 5 has 21 control points, numbered by their barycentric exponents (i, j, k) in the
//! order of [`EXPONENTS`]: i falling, then j falling. So corner 0 (of vertex 0) is number 0, corner 1 is
//! number 15, corner 2 is number 20.

/// Degree of the network's patches.
pub const DEGREE: usize = 5;
/// Control points of a patch of degree 5.
pub const CONTROL_POINTS: usize = 21;

/// Barycentric exponents (i, j, k), i + j + k = 5, of each control point.
pub const EXPONENTS: [[u8; 3]; CONTROL_POINTS] = exponents();

const fn exponents() -> [[u8; 3]; CONTROL_POINTS] {
    let mut table = [[0; 3]; CONTROL_POINTS];
    let mut row = 0;
    let mut i = DEGREE as u8 + 1;
    while i > 0 {
        i -= 1;
        let mut j = DEGREE as u8 - i + 1;
        while j > 0 {
            j -= 1;
            table[row] = [i, j, DEGREE as u8 - i - j];
            row += 1;
        }
    }
    table
}

/// Number of the control point with exponents (i, j, k) in a patch of the given degree.
pub const fn index(degree: usize, exponents: [u8; 3]) -> usize {
    let rest = degree - exponents[0] as usize;
    rest * (rest + 1) / 2 + exponents[2] as usize
}
