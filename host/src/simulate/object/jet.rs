//! Second-order jets: a value with its exact gradient and Hessian in space.
//!
//! The solids of [`super::solid`] are written once, generic over [`Smooth`]; with `f64` they are evaluated
//! fast, with [`Jet`] they yield the derivatives that the closest-point iteration needs, without difference
//! quotients. Where a formula has a kink (a minimum of two branches, a root at 0) the jet holds the
//! derivatives of one side.

use crate::Vec3;
use nalgebra::Matrix3;
use std::ops::{Add, Mul, Neg, Sub};

/// What the formula of a solid may do with a number.
pub(super) trait Smooth:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
{
    /// A constant.
    fn constant(value: f64) -> Self;
    /// The value alone.
    fn value(self) -> f64;
    /// Square root; 0 with zero derivatives for anything not above 0.
    fn sqrt(self) -> Self;
    /// e to this.
    fn exp(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;

    /// The square.
    fn squared(self) -> Self {
        self * self
    }
    /// Length of a vector of two.
    fn hypot(self, other: Self) -> Self {
        (self.squared() + other.squared()).sqrt()
    }
    /// Absolute value.
    fn abs(self) -> Self {
        if self.value() < 0.0 { -self } else { self }
    }
    /// The smaller of two.
    fn min(self, other: Self) -> Self {
        if self.value() <= other.value() {
            self
        } else {
            other
        }
    }
    /// The larger of two.
    fn max(self, other: Self) -> Self {
        if self.value() >= other.value() {
            self
        } else {
            other
        }
    }
    /// This where it is above 0, otherwise 0.
    fn positive_part(self) -> Self {
        self.max(Self::constant(0.0))
    }
}

impl Smooth for f64 {
    fn constant(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn sqrt(self) -> Self {
        if self > 0.0 { f64::sqrt(self) } else { 0.0 }
    }
    fn exp(self) -> Self {
        f64::exp(self)
    }
    fn ln(self) -> Self {
        f64::ln(self)
    }
}

/// Value, gradient and Hessian.
#[derive(Clone, Copy, Debug)]
pub(super) struct Jet {
    pub value: f64,
    pub gradient: Vec3,
    pub hessian: Matrix3<f64>,
}

impl Jet {
    /// The three coordinates of a point, as jets in themselves.
    pub(super) fn coordinates(point: &Vec3) -> [Self; 3] {
        std::array::from_fn(|k| Self {
            value: point[k],
            gradient: Vec3::ith(k, 1.0),
            hessian: Matrix3::zeros(),
        })
    }

    /// A function of this, given its value and first two derivatives here.
    fn chain(self, value: f64, first: f64, second: f64) -> Self {
        Self {
            value,
            gradient: self.gradient * first,
            hessian: self.hessian * first + self.gradient * self.gradient.transpose() * second,
        }
    }
}

impl Add for Jet {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            gradient: self.gradient + other.gradient,
            hessian: self.hessian + other.hessian,
        }
    }
}

impl Neg for Jet {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            value: -self.value,
            gradient: -self.gradient,
            hessian: -self.hessian,
        }
    }
}

impl Sub for Jet {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Jet {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let cross = self.gradient * other.gradient.transpose();
        Self {
            value: self.value * other.value,
            gradient: self.gradient * other.value + other.gradient * self.value,
            hessian: self.hessian * other.value
                + other.hessian * self.value
                + cross
                + cross.transpose(),
        }
    }
}

impl Add<f64> for Jet {
    type Output = Self;
    fn add(mut self, constant: f64) -> Self {
        self.value += constant;
        self
    }
}

impl Sub<f64> for Jet {
    type Output = Self;
    fn sub(self, constant: f64) -> Self {
        self + -constant
    }
}

impl Mul<f64> for Jet {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self {
            value: self.value * factor,
            gradient: self.gradient * factor,
            hessian: self.hessian * factor,
        }
    }
}

impl Smooth for Jet {
    fn constant(value: f64) -> Self {
        Self {
            value,
            gradient: Vec3::zeros(),
            hessian: Matrix3::zeros(),
        }
    }
    fn value(self) -> f64 {
        self.value
    }
    fn sqrt(self) -> Self {
        if self.value > 0.0 {
            let root = self.value.sqrt();
            self.chain(root, 0.5 / root, -0.25 / (root * self.value))
        } else {
            Self::constant(0.0)
        }
    }
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.chain(e, e, e)
    }
    fn ln(self) -> Self {
        let inverse = 1.0 / self.value;
        self.chain(self.value.ln(), inverse, -inverse * inverse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_a_formula_worked_by_hand() {
        // f = ln(exp(x y) + z^2) at (1, 2, 3): u = e^2 + 9.
        let [x, y, z] = Jet::coordinates(&Vec3::new(1.0, 2.0, 3.0));
        let f = ((x * y).exp() + z.squared()).ln();
        let e = 2.0f64.exp();
        let u = e + 9.0;
        assert!((f.value - u.ln()).abs() < 1e-14);
        assert!((f.gradient - Vec3::new(2.0 * e, e, 6.0) / u).norm() < 1e-14);
        // d2f/dx2 = 4e/u - 4e^2/u^2, d2f/dxdy = (e + 2e)/u - 2e^2/u^2, d2f/dz2 = 2/u - 36/u^2.
        assert!((f.hessian[(0, 0)] - (4.0 * e / u - 4.0 * e * e / (u * u))).abs() < 1e-14);
        assert!((f.hessian[(0, 1)] - (3.0 * e / u - 2.0 * e * e / (u * u))).abs() < 1e-14);
        assert!((f.hessian[(2, 2)] - (2.0 / u - 36.0 / (u * u))).abs() < 1e-14);
        assert!((f.hessian - f.hessian.transpose()).norm() < 1e-15);
    }

    #[test]
    fn root_of_the_squared_length_has_the_curvature_of_a_sphere() {
        let [x, y, z] = Jet::coordinates(&Vec3::new(0.0, 0.0, 5.0));
        let r = (x.squared() + y.squared() + z.squared()).sqrt();
        let expected = Matrix3::from_diagonal(&Vec3::new(0.2, 0.2, 0.0));
        assert!((r.hessian - expected).norm() < 1e-15);
    }
}
