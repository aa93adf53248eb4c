//! The polyharmonic splines the local fields are made of, and the polynomials they leave free.
//!
//! As a covariance of a random function f, `phi(x - y)` says how values go together; its derivatives
//! say the same of values with gradients and of gradients with gradients. Each kernel carries the sign
//! that makes it conditionally positive definite with respect to the polynomials of its degree
//! (Wendland, *Scattered Data Approximation*, 2005, chapters 8 and 16).

use crate::Vec3;

/// Most polynomial terms any kernel needs (degree 3).
pub(super) const MAX_TERMS: usize = 20;

/// Which polyharmonic spline: the higher the exponent, the smoother the surface it prefers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// r^3 with linear polynomials: the least bending of second kind in space ("triharmonic").
    Cubic,
    /// r^5 with quadratic polynomials.
    Quintic,
    /// r^7 with cubic polynomials.
    Septic,
}

/// `phi(r)` and the factors of its derivatives: gradient `a d`, Hessian `a I + b d d^T`.
#[derive(Clone, Copy)]
pub(super) struct Radial {
    pub value: f64,
    pub a: f64,
    pub b: f64,
}

impl Kernel {
    /// Number of free polynomial terms.
    pub(super) fn terms(self) -> usize {
        match self {
            Self::Cubic => 4,
            Self::Quintic => 10,
            Self::Septic => 20,
        }
    }

    /// Exponent of the distance.
    pub(super) fn exponent(self) -> i32 {
        match self {
            Self::Cubic => 3,
            Self::Quintic => 5,
            Self::Septic => 7,
        }
    }

    /// The next kernel with fewer free polynomial terms, for point sets that cannot fix them all.
    pub(super) fn simpler(self) -> Option<Self> {
        match self {
            Self::Cubic => None,
            Self::Quintic => Some(Self::Cubic),
            Self::Septic => Some(Self::Quintic),
        }
    }

    /// Value and derivative factors at the squared distance `r2`.
    #[inline(always)]
    pub(super) fn radial(self, r2: f64) -> Radial {
        let r = r2.sqrt();
        match self {
            Self::Cubic => Radial {
                value: r2 * r,
                a: 3.0 * r,
                b: if r > 0.0 { 3.0 / r } else { 0.0 },
            },
            Self::Quintic => Radial {
                value: -r2 * r2 * r,
                a: -5.0 * r2 * r,
                b: -15.0 * r,
            },
            Self::Septic => Radial {
                value: r2 * r2 * r2 * r,
                a: 7.0 * r2 * r2 * r,
                b: 35.0 * r2 * r,
            },
        }
    }

    /// The monomials at `x` (the first `terms()` entries) and their gradients.
    #[inline]
    pub(super) fn monomials(self, x: &Vec3) -> ([f64; MAX_TERMS], [[f64; 3]; MAX_TERMS]) {
        let (x, y, z) = (x.x, x.y, x.z);
        let mut value = [0.0; MAX_TERMS];
        let mut gradient = [[0.0; 3]; MAX_TERMS];
        value[0] = 1.0;
        value[1..4].copy_from_slice(&[x, y, z]);
        gradient[1] = [1.0, 0.0, 0.0];
        gradient[2] = [0.0, 1.0, 0.0];
        gradient[3] = [0.0, 0.0, 1.0];
        if self == Self::Cubic {
            return (value, gradient);
        }
        value[4..10].copy_from_slice(&[x * x, y * y, z * z, x * y, x * z, y * z]);
        gradient[4] = [2.0 * x, 0.0, 0.0];
        gradient[5] = [0.0, 2.0 * y, 0.0];
        gradient[6] = [0.0, 0.0, 2.0 * z];
        gradient[7] = [y, x, 0.0];
        gradient[8] = [z, 0.0, x];
        gradient[9] = [0.0, z, y];
        if self == Self::Quintic {
            return (value, gradient);
        }
        value[10..20].copy_from_slice(&[
            x * x * x,
            y * y * y,
            z * z * z,
            x * x * y,
            x * x * z,
            y * y * x,
            y * y * z,
            z * z * x,
            z * z * y,
            x * y * z,
        ]);
        gradient[10] = [3.0 * x * x, 0.0, 0.0];
        gradient[11] = [0.0, 3.0 * y * y, 0.0];
        gradient[12] = [0.0, 0.0, 3.0 * z * z];
        gradient[13] = [2.0 * x * y, x * x, 0.0];
        gradient[14] = [2.0 * x * z, 0.0, x * x];
        gradient[15] = [y * y, 2.0 * x * y, 0.0];
        gradient[16] = [0.0, 2.0 * y * z, y * y];
        gradient[17] = [z * z, 0.0, 2.0 * x * z];
        gradient[18] = [0.0, z * z, 2.0 * y * z];
        gradient[19] = [y * z, x * z, x * y];
        (value, gradient)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Kernel; 3] = [Kernel::Cubic, Kernel::Quintic, Kernel::Septic];

    #[test]
    fn derivative_factors_match_differences() {
        let d = Vec3::new(0.3, -0.5, 0.2);
        let h = 1e-5;
        for kernel in ALL {
            let at = |d: Vec3| kernel.radial(d.norm_squared());
            for i in 0..3 {
                let e = Vec3::ith(i, h);
                let slope = (at(d + e).value - at(d - e).value) / (2.0 * h);
                assert!((slope - at(d).a * d[i]).abs() < 1e-8, "{kernel:?}");
                for j in 0..3 {
                    let bend =
                        ((at(d + e).a * (d + e)[j]) - (at(d - e).a * (d - e)[j])) / (2.0 * h);
                    let expected = at(d).b * d[i] * d[j] + if i == j { at(d).a } else { 0.0 };
                    assert!((bend - expected).abs() < 1e-8, "{kernel:?}");
                }
            }
        }
    }

    #[test]
    fn monomial_gradients_match_differences() {
        let x = Vec3::new(0.3, -0.5, 0.2);
        let h = 1e-5;
        for kernel in ALL {
            let (_, gradient) = kernel.monomials(&x);
            for i in 0..3 {
                let e = Vec3::ith(i, h);
                let (high, low) = (kernel.monomials(&(x + e)).0, kernel.monomials(&(x - e)).0);
                for t in 0..kernel.terms() {
                    let slope = (high[t] - low[t]) / (2.0 * h);
                    assert!((slope - gradient[t][i]).abs() < 1e-8, "{kernel:?} term {t}");
                }
            }
        }
    }
}
