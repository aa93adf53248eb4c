//! Polynomials of the parameter plane in Bernstein form, and their blossoms.
//!
//! The blossom of a polynomial F of degree n is the one symmetric function of n points that is affine in
//! each of them and gives F(u) when all of them are u. It carries a polynomial from one form to any other:
//! the Bernstein coefficients over a triangle are its values at the corners, the coefficients of a triangular
//! B-spline its values at the knots.

use std::ops::{Add, Mul};

use super::orientation::twice_area;
use super::{Vec2, exponent_count};

/// What a spline may have as control points: numbers, points, tangent vectors.
pub trait Blend: Copy + Add<Output = Self> + Mul<f64, Output = Self> {}
impl<T: Copy + Add<Output = T> + Mul<f64, Output = T>> Blend for T {}

/// A polynomial of the plane by its Bernstein coefficients over a triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarPolynomial<T> {
    corners: [Vec2; 3],
    degree: usize,
    coefficients: Vec<T>,
}

impl<T: Blend> PlanarPolynomial<T> {
    /// From (n + 1)(n + 2) / 2 coefficients over a triangle, in the order of [`super::exponents`]; `None` if
    /// their number fits no degree or the corners lie on one line.
    pub fn new(corners: [Vec2; 3], coefficients: Vec<T>) -> Option<Self> {
        let degree = (0..=coefficients.len())
            .find(|degree| exponent_count(*degree) >= coefficients.len())?;
        let area = twice_area(corners[0], corners[1], corners[2]);
        (exponent_count(degree) == coefficients.len() && area.is_normal()).then_some(Self {
            corners,
            degree,
            coefficients,
        })
    }

    /// Degree of the form (the polynomial's own may be lower).
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Value at a point.
    pub fn value(&self, u: Vec2) -> T {
        self.polarise((0..self.degree).map(|_| u))
    }

    /// The blossom at as many points as the degree; `None` for any other number of points.
    pub fn blossom(&self, points: &[Vec2]) -> Option<T> {
        (points.len() == self.degree).then(|| self.polarise(points.iter().copied()))
    }

    /// De Casteljau's algorithm with one point per step.
    fn polarise(&self, points: impl Iterator<Item = Vec2>) -> T {
        let mut values = self.coefficients.clone();
        for (step, point) in points.enumerate() {
            let [b0, b1, b2] = self.barycentric(point);
            let mut row = 0;
            for rest in 0..self.degree - step {
                for last in 0..=rest {
                    let first = rest * (rest + 1) / 2 + last;
                    let next = (rest + 1) * (rest + 2) / 2 + last;
                    values[row] = values[first] * b0 + values[next] * b1 + values[next + 1] * b2;
                    row += 1;
                }
            }
        }
        values[0]
    }

    fn barycentric(&self, u: Vec2) -> [f64; 3] {
        let [a, b, c] = self.corners;
        let area = twice_area(a, b, c);
        [
            twice_area(u, b, c) / area,
            twice_area(a, u, c) / area,
            twice_area(a, b, u) / area,
        ]
    }
}
