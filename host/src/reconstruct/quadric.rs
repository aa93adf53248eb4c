//! Planes and quadrics as implicit functions, fitted to points and normals of a whole sheet.
//!
//! f(x) = m(u)^T c with the monomials m of degree at most two and u = (x - origin) / scale: like a signed distance near the
//! sheet, because the measured normals are its gradients there. Planes, balls and round cylinders are met exactly, as
//! (|x|^2 - r^2) / 2r. Two ways were weighed: a height field over one plane (a cylinder's side is none, and a piece of it
//! is a parabola only nearly) and this one, whose coefficients follow from one linear system (Taubin 1991 with gradients
//! for the constraint).

use crate::Vec3;
use nalgebra::{SMatrix, SVector};

/// Monomials of degree at most 1, and at most 2.
const PLANE: usize = 4;
const QUADRIC: usize = 10;
/// Prior standard deviation of the coefficients of degree 2, over the unit ball: holds what the points cannot tell (a
/// plane says nothing of z^2).
const LOOSE: f64 = 10.0;

/// Mean squared residual of places, a height and two tilts to each (the normals are of unit length), in variances of theirs, up to
/// which a plane or quadric explains them.
const EXPLAINED: f64 = 1.5;

/// A plane or quadric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Quadric {
    origin: Vec3,
    /// Length of a unit of u.
    scale: f64,
    /// Of 1, x, y, z, x^2, y^2, z^2, xy, yz, zx.
    coefficients: SVector<f64, QUADRIC>,
}

/// A measured place: position, unit normal, and the standard deviations of the position along it and of the normal's
/// components.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub position: Vec3,
    pub normal: Vec3,
    pub sigma: f64,
    pub tilt: f64,
}

/// A fitted plane or quadric and how well the places are met.
#[derive(Clone, Debug)]
pub(super) struct QuadricFit {
    pub quadric: Quadric,
    /// That of the places it was fitted to.
    pub misfit: f64,
    /// Of the coefficients.
    covariance: SMatrix<f64, QUADRIC, QUADRIC>,
}

fn monomials(u: &Vec3) -> SVector<f64, QUADRIC> {
    let [x, y, z]: [f64; 3] = (*u).into();
    SVector::from([1.0, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x])
}

/// Their derivatives by x, y, z.
fn slopes(u: &Vec3) -> [SVector<f64, QUADRIC>; 3] {
    let [x, y, z]: [f64; 3] = (*u).into();
    [
        [0.0, 1.0, 0.0, 0.0, 2.0 * x, 0.0, 0.0, y, 0.0, z],
        [0.0, 0.0, 1.0, 0.0, 0.0, 2.0 * y, 0.0, x, z, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0 * z, 0.0, y, x],
    ]
    .map(SVector::from)
}

/// The equations of a place: row and right-hand side, in standard deviations.
fn rows(place: &Place, origin: &Vec3, scale: f64) -> [(SVector<f64, QUADRIC>, f64); 4] {
    let u = (place.position - origin) / scale;
    let [x, y, z] = slopes(&u);
    let (height, tilt) = (scale / place.sigma, 1.0 / place.tilt);
    let n = place.normal;
    [
        (monomials(&u) * height, 0.0),
        (x * tilt, n.x * tilt),
        (y * tilt, n.y * tilt),
        (z * tilt, n.z * tilt),
    ]
}

impl QuadricFit {
    /// The plane through the places, which have to be four at least; `None` if they are fewer or no numbers.
    pub(super) fn plane(places: &[Place]) -> Option<Self> {
        Self::through(places, PLANE)
    }

    /// The same for the quadric.
    pub(super) fn quadric(places: &[Place]) -> Option<Self> {
        Self::through(places, QUADRIC)
    }

    fn through(places: &[Place], terms: usize) -> Option<Self> {
        if places.len() < PLANE {
            return None;
        }
        let origin = places.iter().map(|p| p.position).sum::<Vec3>() / places.len() as f64;
        let scale = places
            .iter()
            .map(|p| (p.position - origin).norm())
            .fold(0.0, f64::max);
        let rows = |place: &Place| rows(place, &origin, scale);
        let mut left = SMatrix::<f64, QUADRIC, QUADRIC>::zeros();
        let mut right = SVector::<f64, QUADRIC>::zeros();
        for (row, value) in places.iter().flat_map(rows) {
            left.syger(1.0, &row, &row, 1.0);
            right += row * value;
        }
        left.fill_upper_triangle_with_lower_triangle();
        for i in PLANE..QUADRIC {
            left[(i, i)] += LOOSE.powi(-2);
        }
        // What is left out is held at 0.
        for i in terms..QUADRIC {
            left.row_mut(i).fill(0.0);
            left.column_mut(i).fill(0.0);
            left[(i, i)] = 1.0;
            right[i] = 0.0;
        }
        let factor = left.cholesky()?;
        let coefficients = factor.solve(&right);
        let mut covariance = factor.inverse();
        for i in terms..QUADRIC {
            covariance[(i, i)] = 0.0;
        }
        let quadric = Quadric {
            origin,
            scale,
            coefficients,
        };
        let misfit = quadric.misfit(places);
        let finite = misfit.is_finite() && coefficients.iter().all(|c| c.is_finite());
        finite.then_some(Self {
            quadric,
            misfit,
            covariance,
        })
    }

    /// Whether what is left of the `count` places that this quadric was fitted to is no more than their scatter, its coefficients
    /// allowed for.
    pub(super) fn explains_its_own(&self, count: usize) -> bool {
        let free = (3 * count).saturating_sub(QUADRIC);
        self.misfit < EXPLAINED * free as f64
    }

    /// Standard deviation of the value at `x`.
    pub(super) fn sigma(&self, x: &Vec3) -> f64 {
        let m = monomials(&self.quadric.inward(x));
        self.quadric.scale * m.dot(&(self.covariance * m)).max(0.0).sqrt()
    }
}

impl Quadric {
    fn inward(&self, x: &Vec3) -> Vec3 {
        (x - self.origin) / self.scale
    }

    /// Sum of the squared residuals of places (a height and three components of a normal each), in standard deviations.
    pub(super) fn misfit(&self, places: &[Place]) -> f64 {
        let equations = places
            .iter()
            .flat_map(|place| rows(place, &self.origin, self.scale));
        equations
            .map(|(row, value)| (row.dot(&self.coefficients) - value).powi(2))
            .sum()
    }

    /// Whether what is left of the places is no more than their scatter.
    pub(super) fn explains(&self, places: &[Place]) -> bool {
        self.misfit(places) < EXPLAINED * 3.0 * places.len() as f64
    }

    /// Value at `x`: near the sheet the signed distance from it, positive on the side its normals point to.
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        self.scale * monomials(&self.inward(x)).dot(&self.coefficients)
    }

    /// Gradient of the value.
    pub(super) fn gradient(&self, x: &Vec3) -> Vec3 {
        slopes(&self.inward(x))
            .map(|s| s.dot(&self.coefficients))
            .into()
    }

    /// The same in coordinates in which `x` is at `scale x + origin`.
    pub(super) fn moved(&self, scale: f64, origin: &Vec3) -> Self {
        Self {
            origin: self.origin * scale + origin,
            scale: self.scale * scale,
            coefficients: self.coefficients,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(position: Vec3, normal: Vec3) -> Place {
        Place {
            position,
            normal,
            sigma: 1e-3,
            tilt: 1e-2,
        }
    }

    /// A third of the side of a cylinder of radius 2 around the z axis through (5, 0, 0).
    fn side() -> Vec<Place> {
        let places = (0..12).flat_map(|i| (0..8).map(move |j| (i, j)));
        places
            .map(|(i, j)| {
                let (sin, cos) = (0.18 * f64::from(i)).sin_cos();
                let position = Vec3::new(5.0 + 2.0 * cos, 2.0 * sin, 0.4 * f64::from(j));
                place(position, Vec3::new(cos, sin, 0.0))
            })
            .collect()
    }

    #[test]
    fn a_cylinder_is_met_also_far_beyond_the_places() {
        let fit = QuadricFit::quadric(&side()).unwrap();
        assert!(fit.misfit < 1e-6, "{}", fit.misfit);
        let far = Vec3::new(3.0, 0.0, 9.0);
        assert!(fit.quadric.value(&far).abs() < 1e-6);
        assert!((fit.quadric.gradient(&far) + Vec3::x()).norm() < 1e-6);
        // Beside it, to first order.
        assert!((fit.quadric.value(&Vec3::new(7.01, 0.0, 1.0)) - 0.01).abs() < 1e-4);
        assert!(fit.sigma(&far) > 10.0 * fit.sigma(&Vec3::new(7.0, 0.5, 1.0)));
        let moved = fit.quadric.moved(3.0, &Vec3::new(0.0, 1.0, 0.0));
        assert!((moved.value(&Vec3::new(21.3, 1.0, 3.0)) - 0.3).abs() < 1e-2);
    }

    #[test]
    fn a_plane_does_not_explain_it() {
        assert!(QuadricFit::plane(&side()).unwrap().misfit > 1e4);
    }

    #[test]
    fn a_plane_is_met_by_both_and_its_own_scatter_foretold() {
        let places: Vec<Place> = (0..49)
            .map(|k| {
                // Heights of 1e-3 that go up and down.
                let [x, y] = [k % 7, k / 7].map(|i| 0.1 * f64::from(i));
                let up = 1e-3 * if k % 2 == 0 { 1.0 } else { -1.0 };
                place(Vec3::new(x, y, 4.0 + up), Vec3::z())
            })
            .collect();
        for fit in [QuadricFit::plane(&places), QuadricFit::quadric(&places)] {
            let fit = fit.unwrap();
            // One standard deviation each, and the normals are exact.
            assert!((fit.misfit / 49.0 - 1.0).abs() < 0.1, "{}", fit.misfit);
            let middle = Vec3::new(0.3, 0.3, 4.0);
            assert!(fit.quadric.value(&middle).abs() < 3.0 * fit.sigma(&middle));
        }
        let sigma = QuadricFit::plane(&places)
            .unwrap()
            .sigma(&Vec3::new(0.3, 0.3, 4.0));
        assert!((sigma * 7.0 / 1e-3 - 1.0).abs() < 0.05, "{sigma}");
    }

    #[test]
    fn too_few_places_and_none_that_are_numbers_are_refused() {
        assert!(QuadricFit::plane(&side()[..3]).is_none());
        let mut spoilt = side();
        spoilt[4].position.x = f64::NAN;
        assert!(QuadricFit::quadric(&spoilt).is_none());
        let same = vec![place(Vec3::x(), Vec3::z()); 9];
        assert!(QuadricFit::quadric(&same).is_none());
    }
}
