//! Whether a contact may be believed, and if not, why.
//!
//! The force threshold is no number of its own: a contact counts when its point's standard
//! deviation is good enough, that is, from the force at which sigma reaches the limit (0.5 mm).
//! Hysteresis keeps a force that hovers there from flickering: a contact begins at 0.8 of the limit
//! and ends at the limit, so no valid contact is ever worse than the limit.

use super::contact::ContactSolution;
use super::uncertainty::WrenchNoise;
use super::wrench::Wrench;
use palpus_protocol::ContactFlags;

/// What a believable contact is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactLimits {
    /// Largest standard deviation of the point, mm; contact ends above it.
    pub sigma_mm: f32,
    /// Contact begins below this part of `sigma_mm`.
    pub sigma_enter_ratio: f32,
    /// Largest tangential over normal force. Dry rubber reaches about 1.2; beyond 1.5 the wrench is
    /// no single touch.
    pub friction: f32,
    /// Largest spin moment over normal force, mm: friction times two thirds of the radius of the
    /// contact patch, which is a few mm.
    pub spin_mm: f32,
    /// How many standard deviations the line of force may miss the tip, and the point may lie
    /// behind the equator.
    pub deviations: f32,
}

impl ContactLimits {
    /// The limits for a spherical tip of about 20 mm and the paper's 0.5 mm.
    pub const STANDARD: Self = Self {
        sigma_mm: 0.5,
        sigma_enter_ratio: 0.8,
        friction: 1.5,
        spin_mm: 5.0,
        deviations: 3.0,
    };
}

/// Remembers between periods what the hysteresis needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContactGate {
    in_contact: bool,
    loaded: bool,
}

/// Force or moment above this many standard deviations of noise is a load; below
/// `UNLOAD_DEVIATIONS` it is none.
///
/// At 5 chance takes a free tip for loaded for one sample every 24 minutes (six axes at 200 Hz,
/// 5.7e-7 each), at 4 every 13 seconds, which would keep the tare from being followed; at 8 a touch
/// of 0.1 N would be followed as drift.
const LOAD_DEVIATIONS: f32 = 5.0;
const UNLOAD_DEVIATIONS: f32 = 3.5;

impl ContactGate {
    /// A gate without contact.
    pub const fn new() -> Self {
        Self {
            in_contact: false,
            loaded: false,
        }
    }

    /// Whether anything at all presses on the tip, as far as noise lets one say.
    pub const fn is_loaded(&self) -> bool {
        self.loaded
    }

    /// Judges whether the wrench at the sensor is a load; a NaN is one.
    pub fn judge_load(&mut self, at_sensor: &Wrench, noise: &WrenchNoise) {
        let deviations = if self.loaded {
            UNLOAD_DEVIATIONS
        } else {
            LOAD_DEVIATIONS
        };
        let within = |value: f32, limit: f32| value.abs() <= limit;
        let free = at_sensor
            .force_n
            .iter()
            .all(|&value| within(value, deviations * noise.force_n))
            && at_sensor
                .moment_n_mm
                .iter()
                .all(|&value| within(value, deviations * noise.moment_n_mm));
        self.loaded = !free;
    }

    /// Judges a solved contact with the standard deviation of its point; returns the reasons
    /// against it.
    pub fn judge(
        &mut self,
        contact: &ContactSolution,
        sigma_mm: f32,
        noise: &WrenchNoise,
        limits: &ContactLimits,
    ) -> ContactFlags {
        let mut flags = ContactFlags::none();
        let enter = if self.in_contact {
            1.0
        } else {
            limits.sigma_enter_ratio
        };
        // Comparisons are written so that a NaN counts against the contact.
        self.in_contact = sigma_mm <= limits.sigma_mm * enter;
        if !self.in_contact {
            flags.insert(ContactFlags::BELOW_FORCE_THRESHOLD);
        }
        let moment_noise = noise.moment_n_mm + noise.force_n * contact.point_mm.norm();
        let within = |value: f32, limit: f32| value <= limit;
        if !within(contact.excess_moment_n_mm, limits.deviations * moment_noise) {
            flags.insert(ContactFlags::LINE_MISSES_TIP);
        }
        if !within(
            contact.tangential_force_n,
            limits.friction * contact.normal_force_n,
        ) {
            flags.insert(ContactFlags::FRICTION_LIMIT);
        }
        if !within(
            contact.spin_n_mm.abs(),
            limits.spin_mm * contact.normal_force_n,
        ) {
            flags.insert(ContactFlags::SPIN_LIMIT);
        }
        if !within(
            -contact.point_mm.z,
            limits.deviations * sigma_mm.min(limits.sigma_mm),
        ) {
            flags.insert(ContactFlags::OFF_HEMISPHERE);
        }
        flags
    }

    /// Notes a period in which nothing could be judged.
    pub const fn lose_contact(&mut self) {
        self.in_contact = false;
    }
}

#[cfg(test)]
mod tests {
    use super::super::Vec3;
    use super::super::contact::Tip;
    use super::*;
    use palpus_protocol::TipGeometry;

    const NOISE: WrenchNoise = WrenchNoise::TYPICAL;

    fn tip() -> Tip {
        Tip::new(&TipGeometry {
            semi_axes_mm: [20.0; 3],
            centre_offset_mm: [0.0; 3],
        })
        .expect("sound")
    }

    fn judge(gate: &mut ContactGate, force: Vec3, moment: Vec3) -> ContactFlags {
        let contact = tip()
            .solve(&Wrench {
                force_n: force,
                moment_n_mm: moment,
            })
            .expect("solvable");
        let sigma = NOISE.point_sigma_mm(&tip(), &contact);
        gate.judge(&contact, sigma, &NOISE, &ContactLimits::STANDARD)
    }

    #[test]
    fn contact_begins_above_and_ends_at_the_force_of_half_a_millimetre() {
        // sqrt(0.30^2 + 0.25^2) = 0.3905 N mm: 0.5 mm at 0.781 N, 0.4 mm at 0.976 N.
        let mut gate = ContactGate::new();
        for (force, valid) in [
            (0.9, false),
            (0.97, false),
            (0.98, true),
            (0.9, true),
            (0.79, true),
            (0.77, false),
            (0.9, false),
        ] {
            let flags = judge(&mut gate, Vec3::new(0.0, 0.0, -force), Vec3::zeros());
            assert_eq!(flags.is_valid(), valid, "{force} N");
            assert_eq!(flags.contains(ContactFlags::BELOW_FORCE_THRESHOLD), !valid);
        }
    }

    #[test]
    fn each_reason_is_named_alone() {
        let ahead = Vec3::new(0.0, 0.0, -2.0);
        for (force, moment, expected) in [
            (ahead, Vec3::zeros(), ContactFlags::none()),
            (ahead, Vec3::new(0.0, 0.0, 9.0), ContactFlags::none()),
            (ahead, Vec3::new(0.0, 0.0, 11.0), ContactFlags::SPIN_LIMIT),
            // At the pole with a force 60 degrees off the normal: friction 1.73.
            (
                Vec3::new(3.46, 0.0, -2.0),
                Vec3::new(0.0, 69.2, 0.0),
                ContactFlags::FRICTION_LIMIT,
            ),
            // A pull: the far side of the tip.
            (-ahead, Vec3::zeros(), ContactFlags::OFF_HEMISPHERE),
        ] {
            assert_eq!(
                judge(&mut ContactGate::new(), force, moment),
                expected,
                "{force} {moment}"
            );
        }
        // A lever of 22 mm on a tip of 20 mm: the point is on the silhouette, where friction has no
        // limit either.
        let flags = judge(&mut ContactGate::new(), ahead, Vec3::new(0.0, 44.0, 0.0));
        assert!(flags.contains(ContactFlags::LINE_MISSES_TIP));
        // Missing by less than noise explains is no reason.
        let flags = judge(&mut ContactGate::new(), ahead, Vec3::new(0.0, 41.0, 0.0));
        assert!(!flags.contains(ContactFlags::LINE_MISSES_TIP));
    }

    #[test]
    fn load_has_hysteresis_and_a_nan_is_a_load() {
        let mut gate = ContactGate::new();
        let with = |z: f32| Wrench {
            force_n: Vec3::new(0.0, 0.0, z),
            moment_n_mm: Vec3::zeros(),
        };
        for (force, loaded) in [
            (0.0, false),
            (0.06, false),
            (0.065, true),
            (0.05, true),
            (0.04, false),
            (f32::NAN, true),
        ] {
            gate.judge_load(&with(force), &NOISE);
            assert_eq!(gate.is_loaded(), loaded, "{force} N");
        }
    }

    #[test]
    fn numbers_that_are_none_make_no_contact() {
        let nan = f32::NAN;
        let contact = ContactSolution {
            point_mm: Vec3::new(nan, nan, nan),
            normal: Vec3::new(nan, nan, nan),
            normal_force_n: nan,
            tangential_force_n: nan,
            spin_n_mm: nan,
            excess_moment_n_mm: nan,
        };
        let flags = ContactGate::new().judge(&contact, nan, &NOISE, &ContactLimits::STANDARD);
        assert!(
            flags.contains(ContactFlags::BELOW_FORCE_THRESHOLD.union(ContactFlags::OFF_HEMISPHERE))
        );
    }
}
