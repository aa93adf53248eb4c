//! Phase 4: adaptive refinement of the faces that hold a point beyond the tolerance.
//!
//! A face is split (template 1) if it holds a point farther off than the tolerance and its data say that the
//! surface, not the noise, is to blame: the residuals of a face that fits are as large as the noise and
//! change sign; those of one that is too coarse are larger or all lie on one side, also without the largest of them. So
//! refinement never chases noise or a single false contact, and a tolerance below the noise ends with that reason instead
//! of with thousands of patches. Nor is a face split again for the sake of a contact that two levels brought no closer, and a
//! level is kept only if what it gains is worth its patches ([`super::surfacing::refine`]).

pub mod templates;

use super::fit::foot::Foot;
use super::fit::{Datum, Kind};

/// What the data of one face say about its fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceFit {
    /// Measured data with their foot point here.
    pub count: usize,
    /// Largest distance.
    pub max: f64,
    /// The same datum's signed distance along the surface normal.
    pub max_signed: f64,
    /// Sum of signed distances along the surface normal.
    pub signed_sum: f64,
    /// Sum of squared distances.
    pub square_sum: f64,
}

/// Gathers the residuals of the measured data per face.
pub fn face_fits(face_count: usize, data: &[Datum], feet: &[Option<Foot>]) -> Vec<FaceFit> {
    let mut fits = vec![FaceFit::default(); face_count];
    for (datum, foot) in data.iter().zip(feet) {
        let (Kind::Measured, Some(foot)) = (datum.kind, foot) else {
            continue;
        };
        let residual = datum.position - foot.point;
        let fit = &mut fits[foot.face as usize];
        let signed = foot.normal().unwrap_or(datum.normal).dot(&residual);
        fit.add(residual.norm(), signed);
    }
    fits
}

impl FaceFit {
    /// Takes in a datum at this distance, and signed distance along the surface normal.
    fn add(&mut self, distance: f64, signed: f64) {
        self.count += 1;
        self.signed_sum += signed;
        self.square_sum += distance * distance;
        if distance > self.max {
            self.max = distance;
            self.max_signed = signed;
        }
    }

    /// Whether the residuals are more than noise of standard deviation `sigma` explains: their mean square
    /// or their mean lies beyond what chance gives once in a thousand faces, also if the largest is left out. One contact
    /// that all others around it contradict is false; a finer face would bulge to meet it.
    pub fn is_lack_of_fit(&self, sigma: f64) -> bool {
        let others = Self {
            count: self.count.saturating_sub(1),
            signed_sum: self.signed_sum - self.max_signed,
            square_sum: self.square_sum - self.max * self.max,
            ..*self
        };
        self.is_beyond_chance(sigma) && (others.count == 0 || others.is_beyond_chance(sigma))
    }

    fn is_beyond_chance(&self, sigma: f64) -> bool {
        if self.count == 0 {
            return false;
        }
        let n = self.count as f64;
        let variance = sigma * sigma;
        // Wilson and Hilferty: (chi^2 / n)^(1/3) is nearly normal, mean 1 - 2/(9n), variance 2/(9n).
        let spread = 2.0 / (9.0 * n);
        let square = (self.square_sum / (n * variance).max(1e-300)).cbrt();
        let too_large = square > 1.0 - spread + 3.1 * spread.sqrt();
        let one_sided = self.signed_sum.abs() > 3.3 * sigma * n.sqrt();
        too_large || one_sided
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_not_lack_of_fit_but_bias_is() {
        let sigma = 0.1;
        let face = |residuals: &[f64]| {
            let mut fit = FaceFit::default();
            for r in residuals {
                fit.add(r.abs(), *r);
            }
            fit
        };
        let alternating: Vec<f64> = (0..20)
            .map(|i| if i % 2 == 0 { 0.11 } else { -0.11 })
            .collect();
        assert!(!face(&alternating).is_lack_of_fit(sigma));
        assert!(face(&[0.09; 20]).is_lack_of_fit(sigma));
        assert!(face(&[0.5, -0.4]).is_lack_of_fit(sigma));
        assert!(!face(&[0.25]).is_lack_of_fit(sigma));
        // One false contact among good ones, and two that agree.
        let with = |far: &[f64]| face(&[&alternating, far].concat()).is_lack_of_fit(sigma);
        assert!(!with(&[1.5]) && with(&[1.5, 1.4]));
    }
}
