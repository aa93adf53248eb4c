//! Contact point, normal, forces and spin from the wrench at the tip's centre (intrinsic contact
//! sensing).
//!
//! Source: A. Bicchi, J. K. Salisbury, D. L. Brock, "Contact sensing from force measurements",
//! 1990: a soft finger touches the tip's surface at c with a force p and a moment along the normal
//! only, m0 = K B^2 c + c x p, where B^2 c is along the normal.
//!
//! The tip is an ellipsoid with semi-axes a, b, c, a sphere being the case of equal ones. All
//! lengths are divided by r = (abc)^(1/3), so B = diag(r/a, r/b, r/c) has determinant 1 and the
//! formulas for the ellipsoid lose their factors; for a sphere B is 1. With mu = m0 / r:
//!
//! ```text
//! sigma = |B^-1 mu|^2 - |B p|^2        delta = sqrt(sigma^2 + 4 (p.mu)^2)
//! sigma <= 0:  s = -sqrt((delta - sigma) / 2),  K = (p.mu) / s
//! sigma >  0:  K = -copysign(sqrt((delta + sigma) / 2), p.mu),  s = (p.mu) / K
//! c / r = (K B^-2 mu + (B^2 p) x mu + s p) / (K^2 + |B p|^2)
//! ```
//!
//! (K, s) and (-K, -s) both solve the equations; s < 0 is compression. The textbook's form divides
//! by K, which goes to zero with the spin: in `f32`, at a spin of 0.01 mm times the normal force, a
//! third of its results were NaN and the rest off by 1 mm in the median. Here each case divides by
//! the larger of the two.

use super::Vec3;
use super::wrench::Wrench;
use palpus_protocol::TipGeometry;

/// Shape of the tip, prepared for the solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// Geometric mean of the semi-axes, mm.
    radius_mm: f32,
    /// Diagonal of B^2.
    b2: Vec3,
    /// Diagonal of B^-2.
    inverse_b2: Vec3,
    /// Trace of B^2.
    trace_b2: f32,
    /// Tip centre in sensor coordinates, mm.
    centre_mm: Vec3,
}

/// A contact on the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSolution {
    /// Contact point from the tip's centre, mm.
    pub point_mm: Vec3,
    /// Outward unit normal of the tip there.
    pub normal: Vec3,
    /// Force along the normal, compression positive, N.
    pub normal_force_n: f32,
    /// Magnitude of the force in the tangent plane, N.
    pub tangential_force_n: f32,
    /// Moment about the outward normal, N mm.
    pub spin_n_mm: f32,
    /// By how much the moment exceeds what a force through the tip could make, N mm; above zero the
    /// line of force misses the tip.
    pub excess_moment_n_mm: f32,
}

impl ContactSolution {
    /// What stands in a contact that could not be solved: zeros, and a normal along the finger.
    pub const NONE: Self = Self {
        point_mm: Vec3::new(0.0, 0.0, 0.0),
        normal: Vec3::new(0.0, 0.0, 1.0),
        normal_force_n: 0.0,
        tangential_force_n: 0.0,
        spin_n_mm: 0.0,
        excess_moment_n_mm: 0.0,
    };
}

impl Tip {
    /// Prepares a shape; `None` unless the semi-axes are positive and all numbers finite.
    pub fn new(geometry: &TipGeometry) -> Option<Self> {
        let axes = Vec3::from(geometry.semi_axes_mm);
        let centre_mm = Vec3::from(geometry.centre_offset_mm);
        // Limits far beyond any finger keep every product below within f32.
        let axes_fit = axes.iter().all(|axis| (1e-2..=1e4).contains(axis));
        let centre_fits = centre_mm.iter().all(|value| value.abs() <= 1e4);
        if !axes_fit || !centre_fits {
            return None;
        }
        let radius_mm = libm::cbrtf(axes.x * axes.y * axes.z);
        let b2 = axes.map(|axis| (radius_mm / axis) * (radius_mm / axis));
        Some(Self {
            radius_mm,
            b2,
            inverse_b2: b2.map(|b| 1.0 / b),
            trace_b2: b2.sum(),
            centre_mm,
        })
    }

    /// Tip centre in sensor coordinates, mm.
    pub const fn centre_mm(&self) -> &Vec3 {
        &self.centre_mm
    }

    /// Geometric mean of the semi-axes, mm.
    pub const fn radius_mm(&self) -> f32 {
        self.radius_mm
    }

    /// Diagonal of B^2, of its inverse, and the trace of B^2 (lengths in units of the mean radius).
    pub(crate) const fn curvature(&self) -> (&Vec3, &Vec3, f32) {
        (&self.b2, &self.inverse_b2, self.trace_b2)
    }

    /// Solves for the contact that explains a wrench about the tip's centre; `None` without a
    /// force, or when a number is not finite.
    pub fn solve(&self, about_centre: &Wrench) -> Option<ContactSolution> {
        let p = about_centre.force_n;
        let mu = about_centre.moment_n_mm / self.radius_mm;
        let b2_p = self.b2.component_mul(&p);
        let inverse_b2_mu = self.inverse_b2.component_mul(&mu);
        let force_squared = p.dot(&b2_p);
        let moment_squared = mu.dot(&inverse_b2_mu);
        // Below 1e-6 N squares leave f32; a NaN is in no range.
        if !(1e-12..=1e12).contains(&force_squared) || !(0.0..=1e12).contains(&moment_squared) {
            return None;
        }
        let power = p.dot(&mu);
        let sigma = moment_squared - force_squared;
        let delta = libm::sqrtf(sigma * sigma + 4.0 * power * power);
        let (k, s) = if sigma <= 0.0 {
            let s = -libm::sqrtf(0.5 * (delta - sigma));
            // s = 0 needs sigma = 0 and power = 0: the line touches the tip and neither presses nor
            // spins.
            (if s < 0.0 { power / s } else { 0.0 }, s)
        } else {
            let k = -libm::sqrtf(0.5 * (delta + sigma)).copysign(power);
            (k, power / k)
        };
        let unit_point = (inverse_b2_mu * k + b2_p.cross(&mu) + p * s) / (k * k + force_squared);
        let gradient = self.b2.component_mul(&unit_point);
        let length = gradient.norm();
        if !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let normal = gradient / length;
        let normal_force_n = -p.dot(&normal);
        let tangential = p + normal * normal_force_n;
        Some(ContactSolution {
            point_mm: unit_point * self.radius_mm,
            normal,
            normal_force_n,
            tangential_force_n: tangential.norm(),
            spin_n_mm: k * length * self.radius_mm,
            excess_moment_n_mm: (libm::sqrtf(moment_squared) - libm::sqrtf(force_squared))
                * self.radius_mm,
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    /// A contact of known truth, computed in f64.
    struct Truth {
        point: Vector3<f64>,
        normal: Vector3<f64>,
        normal_force: f64,
        tangential_force: f64,
        spin: f64,
        wrench_at_sensor: (Vector3<f64>, Vector3<f64>),
    }

    fn tip(axes: [f64; 3], centre: [f64; 3]) -> Tip {
        Tip::new(&TipGeometry {
            semi_axes_mm: axes.map(|a| a as f32),
            centre_offset_mm: centre.map(|a| a as f32),
        })
        .expect("sound")
    }

    /// Forward simulation: a tip pressed at the point with the given direction from its centre (in
    /// axes' units).
    fn press(axes: [f64; 3], centre: [f64; 3], direction: [f64; 3], load: [f64; 4]) -> Truth {
        let [normal_force, tangential_force, tangent_angle, spin] = load;
        let unit = Vector3::from(direction).normalize();
        let point = unit.component_mul(&Vector3::from(axes));
        let normal = unit.component_div(&Vector3::from(axes)).normalize();
        let seed = if normal.z.abs() < 0.9 {
            Vector3::z()
        } else {
            Vector3::x()
        };
        let first = normal.cross(&seed).normalize();
        let tangent = first * tangent_angle.cos() + normal.cross(&first) * tangent_angle.sin();
        let force = normal * -normal_force + tangent * tangential_force;
        let moment = point.cross(&force) + normal * spin + Vector3::from(centre).cross(&force);
        Truth {
            point,
            normal,
            normal_force,
            tangential_force,
            spin,
            wrench_at_sensor: (force, moment),
        }
    }

    fn solve(tip: &Tip, truth: &Truth) -> ContactSolution {
        let (force, moment) = truth.wrench_at_sensor;
        let wrench = Wrench {
            force_n: force.cast(),
            moment_n_mm: moment.cast(),
        };
        tip.solve(&wrench.about(tip.centre_mm()))
            .expect("a contact")
    }

    fn worst(solution: &ContactSolution, truth: &Truth) -> [f64; 4] {
        let chord = (solution.normal.cast::<f64>() - truth.normal).norm();
        [
            (solution.point_mm.cast::<f64>() - truth.point).norm(),
            (2.0 * (chord / 2.0).min(1.0).asin()).to_degrees(),
            (f64::from(solution.normal_force_n) - truth.normal_force)
                .abs()
                .max((f64::from(solution.tangential_force_n) - truth.tangential_force).abs()),
            (f64::from(solution.spin_n_mm) - truth.spin).abs(),
        ]
    }

    const SPHERE: [f64; 3] = [20.0; 3];
    const CENTRE: [f64; 3] = [0.0, 0.0, 35.0];

    #[test]
    fn generic_pole_rim_no_spin_and_high_friction() {
        let tip = tip(SPHERE, CENTRE);
        let tilt = |polar: f64, turn: f64| {
            let (polar, turn) = (polar.to_radians(), turn.to_radians());
            [
                polar.sin() * turn.cos(),
                polar.sin() * turn.sin(),
                polar.cos(),
            ]
        };
        for (direction, load) in [
            (tilt(35.0, 50.0), [2.0, 0.6, 0.4, -4.0]),
            (tilt(35.0, 50.0), [2.0, 0.6, 0.4, 0.0]),
            (tilt(0.0, 0.0), [1.0, 0.0, 0.0, 0.0]),
            (tilt(60.0, 240.0), [1.5, 1.35, 2.0, 3.0]),
            (tilt(89.0, 10.0), [3.0, 0.3, 1.0, 1.0]),
        ] {
            let truth = press(SPHERE, CENTRE, direction, load);
            let [point, degrees, force, spin] = worst(&solve(&tip, &truth), &truth);
            assert!(
                point < 4e-5 && degrees < 1e-4 && force < 1e-6 && spin < 1e-4,
                "{point} {degrees} {force} {spin}"
            );
        }
    }

    /// Figures over many cases: the largest errors of point (mm), normal (degrees), forces (N),
    /// spin (N mm).
    fn sweep(axes: [f64; 3], spin_scale: f64) -> [f64; 4] {
        let tip = tip(axes, [0.0; 3]);
        // A fixed linear congruential sequence (Knuth, MMIX): the same cases every time.
        let mut state = 1u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut largest = [0.0f64; 4];
        for _ in 0..20_000 {
            let (z, turn) = (random(), random() * std::f64::consts::TAU);
            let r = (1.0 - z * z).sqrt();
            let normal_force = 0.2 + 9.8 * random();
            let load = [
                normal_force,
                normal_force * random(),
                random() * std::f64::consts::TAU,
                normal_force * spin_scale * (2.0 * random() - 1.0),
            ];
            let truth = press(axes, [0.0; 3], [r * turn.cos(), r * turn.sin(), z], load);
            for (most, error) in largest.iter_mut().zip(worst(&solve(&tip, &truth), &truth)) {
                // `max` would hide a NaN.
                assert!(error.is_finite());
                *most = most.max(error);
            }
        }
        largest
    }

    #[test]
    fn twenty_thousand_spheres_stay_within_microns_for_any_spin() {
        for spin_scale in [0.0, 1e-6, 1e-3, 0.01, 1.0, 5.0] {
            let [point, degrees, force, spin] = sweep(SPHERE, spin_scale);
            std::println!(
                "sphere, spin up to {spin_scale} mm x fn: {point:.1e} mm {degrees:.1e} deg {force:.1e} N {spin:.1e} N mm"
            );
            assert!(point < 2e-5 && degrees < 6e-5 && force < 1e-5 && spin < 2e-4);
        }
    }

    #[test]
    fn twenty_thousand_ellipsoids_stay_within_microns_for_any_spin() {
        for spin_scale in [0.0, 1e-6, 1e-3, 0.01, 1.0, 5.0] {
            let [point, degrees, force, spin] = sweep([12.0, 16.0, 25.0], spin_scale);
            std::println!(
                "ellipsoid, spin up to {spin_scale} mm x fn: {point:.1e} mm {degrees:.1e} deg {force:.1e} N {spin:.1e} N mm"
            );
            assert!(point < 5e-5 && degrees < 2e-4 && force < 2e-5 && spin < 4e-4);
        }
    }

    #[test]
    fn a_line_that_misses_shows_as_excess_moment() {
        let tip = tip(SPHERE, [0.0; 3]);
        // 1 N along -z at a lever of 25 mm, 5 mm outside the tip.
        let wrench = Wrench {
            force_n: Vec3::new(0.0, 0.0, -1.0),
            moment_n_mm: Vec3::new(0.0, 25.0, 0.0),
        };
        let solution = tip.solve(&wrench).expect("solvable");
        assert!((solution.excess_moment_n_mm - 5.0).abs() < 1e-4);
        assert!(solution.point_mm.iter().all(|x| x.is_finite()));
    }

    #[test]
    fn a_pull_lands_on_the_far_side() {
        let tip = tip(SPHERE, [0.0; 3]);
        let wrench = Wrench {
            force_n: Vec3::new(0.0, 0.0, 1.0),
            moment_n_mm: Vec3::zeros(),
        };
        let solution = tip.solve(&wrench).expect("solvable");
        assert!(solution.point_mm.z < -19.9 && solution.normal_force_n > 0.99);
    }

    #[test]
    fn bad_shapes_are_refused() {
        for axes in [
            [0.0, 20.0, 20.0],
            [-1.0, 20.0, 20.0],
            [f32::NAN, 1.0, 1.0],
            [f32::INFINITY, 1.0, 1.0],
            [1e9, 1.0, 1.0],
        ] {
            assert_eq!(
                Tip::new(&TipGeometry {
                    semi_axes_mm: axes,
                    centre_offset_mm: [0.0; 3]
                }),
                None
            );
        }
        assert_eq!(
            Tip::new(&TipGeometry {
                semi_axes_mm: [1.0; 3],
                centre_offset_mm: [f32::NAN, 0.0, 0.0]
            }),
            None
        );
    }

    proptest! {
        #[test]
        fn any_floats_give_a_finite_contact_or_none(values in any::<[f32; 6]>(), exponent in -8i32..8) {
            let tip = tip([12.0, 16.0, 25.0], CENTRE);
            let scale = 10f32.powi(exponent);
            for factor in [1.0, scale / values.iter().fold(1e-30f32, |most, v| if v.is_finite() { most.max(v.abs()) } else { most })] {
                let [fx, fy, fz, mx, my, mz] = values.map(|value| value * factor);
                let wrench = Wrench { force_n: Vec3::new(fx, fy, fz), moment_n_mm: Vec3::new(mx, my, mz) };
                if let Some(solution) = tip.solve(&wrench) {
                    prop_assert!(solution.point_mm.iter().all(|x| x.is_finite()));
                    prop_assert!((solution.normal.norm() - 1.0).abs() < 1e-5);
                    prop_assert!(solution.normal_force_n.is_finite() && solution.spin_n_mm.is_finite());
                    // Compression is the branch taken, up to rounding.
                    prop_assert!(solution.normal_force_n >= -1e-3 * wrench.force_n.norm());
                }
            }
        }
    }
}
