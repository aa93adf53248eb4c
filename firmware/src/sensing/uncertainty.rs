//! Standard deviation of a contact point, from the noise of the wrench.
//!
//! First order in the noise. With the contact from the sensor's origin L = d + c, an error (df, dm)
//! at the sensor moves the point by a tangent step dc that obeys M dc = (dm - L x df) in the
//! tangent plane, where M = (K P B^2 P + fn [n x]), lengths in mean radii. So
//!
//! ```text
//! variance per tangent axis = (sm^2 + sf^2 (|L|^2 + (L.n)^2) / 2) * |M^-1|_F^2 / 2
//! ```
//!
//! For a sphere this is sqrt(sm^2 + R^2 sf^2) / sqrt(fn^2 + (spin/R)^2) with the noise taken at the
//! tip's centre. Friction does not enter. The lever L counts from the sensor, since that is where
//! force and moment have independent noise: a sensor 35 mm below the tip doubles the error at 1 N.

use super::contact::{ContactSolution, Tip};

/// Noise of the wrench at the sensor's origin, standard deviation per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchNoise {
    /// Of a force component, N.
    pub force_n: f32,
    /// Of a moment component, N mm.
    pub moment_n_mm: f32,
}

impl WrenchNoise {
    /// What six-axis sensors of this size showed in public logs at 100 Hz: 10 to 17 mN and 0.1 to
    /// 0.4 N mm.
    pub const TYPICAL: Self = Self {
        force_n: 12.5e-3,
        moment_n_mm: 0.30,
    };

    /// Component by component the larger of two.
    #[must_use]
    pub fn at_least(&self, floor: &Self) -> Self {
        // f32::max returns the number when the other is NaN.
        Self {
            force_n: self.force_n.max(floor.force_n),
            moment_n_mm: self.moment_n_mm.max(floor.moment_n_mm),
        }
    }

    /// Standard deviation of the contact point along a tangent axis, mm (root mean square over the
    /// two axes); infinite without load.
    pub fn point_sigma_mm(&self, tip: &Tip, contact: &ContactSolution) -> f32 {
        let lever = tip.centre_mm() + contact.point_mm;
        let along = lever.dot(&contact.normal);
        let moment_variance = self.moment_n_mm * self.moment_n_mm
            + self.force_n * self.force_n * 0.5 * (lever.norm_squared() + along * along);
        let (b2, inverse_b2, trace) = tip.curvature();
        let n = &contact.normal;
        // Curvature of the tip in the tangent plane, without a basis: trace and determinant of P
        // B^2 P.
        let tangent_trace = trace - n.dot(&b2.component_mul(n));
        let tangent_determinant = n.dot(&inverse_b2.component_mul(n));
        // spin = K |B^2 c|, and |B^2 c| = 1 / (c.n) where c / r is on B's unit ellipsoid.
        let support = contact.point_mm.dot(n) / tip.radius_mm();
        let k = contact.spin_n_mm * support / tip.radius_mm();
        let fn_squared = contact.normal_force_n * contact.normal_force_n;
        let squares =
            k * k * (tangent_trace * tangent_trace - 2.0 * tangent_determinant) + 2.0 * fn_squared;
        let determinant = k * k * tangent_determinant + fn_squared;
        // M is in N (lengths in mean radii on both sides), so a moment over M is a length.
        libm::sqrtf(0.5 * moment_variance * squares) / determinant
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::Vec3;
    use super::super::wrench::Wrench;
    use super::*;
    use palpus_protocol::TipGeometry;

    fn tip(axes: [f32; 3], offset: f32) -> Tip {
        Tip::new(&TipGeometry {
            semi_axes_mm: axes,
            centre_offset_mm: [0.0, 0.0, offset],
        })
        .expect("sound")
    }

    fn pressed(tip: &Tip, force: Vec3, moment: Vec3) -> ContactSolution {
        tip.solve(&Wrench {
            force_n: force,
            moment_n_mm: moment,
        })
        .expect("a contact")
    }

    #[test]
    fn the_sphere_agrees_with_its_closed_form() {
        let tip = tip([20.0; 3], 0.0);
        let noise = WrenchNoise::TYPICAL;
        for (fz, spin) in [(1.0, 0.0), (2.0, 0.0), (5.0, 0.0), (1.0, 10.0)] {
            let contact = pressed(&tip, Vec3::new(0.0, 0.0, -fz), Vec3::new(0.0, 0.0, spin));
            let expected = (0.30f32.powi(2) + (20.0 * 12.5e-3f32).powi(2)).sqrt()
                / (fz * fz + (spin / 20.0).powi(2)).sqrt();
            assert!((noise.point_sigma_mm(&tip, &contact) - expected).abs() < 1e-5);
        }
        // 0.55 mm at 1 N is the distance from the true point, over both tangent axes.
        let contact = pressed(&tip, Vec3::new(0.0, 0.0, -1.0), Vec3::zeros());
        assert!((noise.point_sigma_mm(&tip, &contact) * 2f32.sqrt() - 0.55).abs() < 0.01);
    }

    /// The closed form against the scatter of the solve itself under noise at the sensor.
    fn scatter(tip: &Tip, force: Vec3, moment_about_centre: Vec3) -> (f32, f32) {
        let noise = WrenchNoise {
            force_n: 2e-3,
            moment_n_mm: 0.05,
        };
        let clean = pressed(tip, force, moment_about_centre);
        let at_sensor = Wrench {
            force_n: force,
            moment_n_mm: moment_about_centre + tip.centre_mm().cross(&force),
        };
        let mut state = 7u64;
        // Sum of twelve uniform numbers: unit variance, near enough to normal.
        let mut gauss = || {
            let mut sum = -6.0f32;
            for _ in 0..12 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 40) as f32 / (1u64 << 24) as f32;
            }
            sum
        };
        let mut squares = 0.0;
        let trials = 20_000;
        for _ in 0..trials {
            let noisy = Wrench {
                force_n: at_sensor.force_n + Vec3::new(gauss(), gauss(), gauss()) * noise.force_n,
                moment_n_mm: at_sensor.moment_n_mm
                    + Vec3::new(gauss(), gauss(), gauss()) * noise.moment_n_mm,
            };
            let moved = tip.solve(&noisy.about(tip.centre_mm())).expect("a contact");
            squares += (moved.point_mm - clean.point_mm).norm_squared();
        }
        (
            (squares / trials as f32 / 2.0).sqrt(),
            noise.point_sigma_mm(tip, &clean),
        )
    }

    #[test]
    fn the_closed_form_is_the_scatter_of_the_solve() {
        let oblique = Vec3::new(-0.6, -0.4, -2.0);
        for (tip, force, moment) in [
            (
                tip([20.0; 3], 35.0),
                Vec3::new(0.0, 0.0, -2.0),
                Vec3::new(3.0, 1.0, 0.0),
            ),
            (tip([20.0; 3], 35.0), oblique, Vec3::new(-12.3, 2.9, -0.9)),
            (
                tip([14.0, 18.0, 24.0], 35.0),
                oblique,
                Vec3::new(-8.0, 4.0, -0.9),
            ),
            (
                tip([14.0, 18.0, 24.0], 35.0),
                oblique,
                Vec3::new(-8.0, 4.0, -6.0),
            ),
        ] {
            let (measured, stated) = scatter(&tip, force, moment);
            std::println!("measured {measured:.4} mm, stated {stated:.4} mm");
            // 20 000 trials leave 0.5 % of chance; the rest is the isotropic average over the
            // tangent plane.
            assert!(
                (measured / stated - 1.0).abs() < 0.04,
                "measured {measured}, stated {stated}"
            );
        }
    }
}
