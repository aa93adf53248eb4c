//! One contact: what the finger tip felt in one period, and how it is packed into 37 bytes.
//!
//! The fields are fixed-point, little-endian and at fixed offsets, so that a contact has one size
//! and a decoder in any language is a few lines. Resolutions stay far below the sensing errors (0.5
//! mm and 3 degrees):
//!
//! | offset | bytes | field | unit on the wire | range | rounding error |
//! |---|---|---|---|---|---|
//! | 0 | 3 | sequence number | 1, modulo 2^24 | 23.3 h at 200 Hz | none |
//! | 3 | 5 | board time | us, modulo 2^40 | 12.7 days | none |
//! | 8 | 6 | contact point x, y, z | 2 um, signed | +-65.5 mm | 1 um per axis |
//! | 14 | 4 | normal, octahedral u, v | 1/32767, signed | unit sphere | 0.004 degrees |
//! | 18 | 2 | normal force | mN | 0 to 65.5 N | 0.5 mN |
//! | 20 | 2 | tangential force | mN | 0 to 65.5 N | 0.5 mN |
//! | 22 | 2 | spin moment | 0.01 N mm, signed | +-327 N mm | 0.005 N mm |
//! | 24 | 2 | sigma of the point | um | 0 to 65.5 mm | 0.5 um |
//! | 26 | 8 | three joint angles, 21 bits each, bit 63 zero | 1e-5 rad, signed | +-10.4 rad | 5e-6 rad |
//! | 34 | 3 | status flags | bits of [`ContactFlags`] | | |
//!
//! The normal could be had from the point and the tip's shape. It is sent all the same: a contact
//! then means something without the identity that came before it, and 4 bytes were to spare.

use crate::wire::{Wire, wire_struct};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Board times in a [`Contact`] count modulo this many microseconds (2^40 us, 12.7 days).
pub const CONTACT_TIME_MODULUS_US: u64 = 1 << 40;

/// Sequence numbers in a [`Contact`] count modulo this (2^24, 23.3 hours at 200 Hz).
pub const CONTACT_SEQUENCE_MODULUS: u32 = 1 << 24;

/// Microns per step of a packed point coordinate.
const POINT_STEP_UM: f32 = 2.0;
/// Steps of a packed joint angle per radian. All of this stays within the 24 bits of an `f32`,
/// since a board has no `f64`.
const ANGLE_STEPS_PER_RAD: f32 = 1e5;
/// Largest packed joint angle, in steps (21 bits, two's complement).
const ANGLE_LIMIT: f32 = ((1 << 20) - 1) as f32;

/// Status of a contact as bits: the reasons why it is not valid, and remarks that leave it valid.
///
/// The packed form has 24 bits. Bits 0 to 15 each make the contact invalid; bits 16 to 23 are
/// remarks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ContactFlags(u32);

impl ContactFlags {
    /// Nothing touches, or too lightly: the force is below the one at which the point's sigma
    /// reaches 0.5 mm.
    pub const BELOW_FORCE_THRESHOLD: Self = Self(1 << 0);
    /// The wrench's line of force misses the tip by more than noise explains: more than one
    /// contact, or a touch beside the tip.
    pub const LINE_MISSES_TIP: Self = Self(1 << 1);
    /// Tangential over normal force is above the limit.
    pub const FRICTION_LIMIT: Self = Self(1 << 2);
    /// Spin moment over normal force is above the limit.
    pub const SPIN_LIMIT: Self = Self(1 << 3);
    /// The point lies off the tip's hemisphere; a pull (adhesion) also ends here.
    pub const OFF_HEMISPHERE: Self = Self(1 << 4);
    /// A gauge is at the end of its range.
    pub const GAUGE_SATURATED: Self = Self(1 << 5);
    /// A gauge's bridge is open.
    pub const GAUGE_OPEN: Self = Self(1 << 6);
    /// A gauge has stopped changing.
    pub const GAUGE_STUCK: Self = Self(1 << 7);
    /// A gauge gave no value this period.
    pub const GAUGE_MISSING: Self = Self(1 << 8);
    /// A gauge's value is older than one period.
    pub const GAUGE_LATE: Self = Self(1 << 9);
    /// No calibration matrix that fits the gauges is loaded.
    pub const CALIBRATION_MISSING: Self = Self(1 << 10);
    /// No tare has been taken since the board started.
    pub const NOT_TARED: Self = Self(1 << 11);
    /// A joint angle is missing or failed its check bits.
    pub const JOINT_INVALID: Self = Self(1 << 12);
    /// A tare is being taken: the offsets are about to change.
    pub const TARING: Self = Self(1 << 13);
    /// A number in the frame was beyond its range (or not a number) and was clipped.
    pub const CLIPPED: Self = Self(1 << 14);
    /// A joint angle is older than one period.
    pub const JOINT_LATE: Self = Self(1 << 15);
    /// Remark: this sample was taken later than its period allows, or periods before it were
    /// skipped.
    pub const LATE_SAMPLE: Self = Self(1 << 16);
    /// Remark: the tare has drifted further than expected while nothing was touched.
    pub const TARE_DRIFTED: Self = Self(1 << 17);
    /// Remark: the calibration is held in RAM only and goes with the power.
    pub const CALIBRATION_VOLATILE: Self = Self(1 << 18);
    /// Remark: the tip is loaded (with hysteresis), whether or not the contact could be resolved.
    pub const LOADED: Self = Self(1 << 19);

    /// Flags that make a contact invalid.
    pub const INVALIDATING: Self = Self(0x0000_ffff);

    /// Every flag with the words for a report, in bit order.
    pub const NAMES: [(Self, &'static str); 20] = [
        (Self::BELOW_FORCE_THRESHOLD, "force below threshold"),
        (Self::LINE_MISSES_TIP, "line of force misses the tip"),
        (Self::FRICTION_LIMIT, "friction above limit"),
        (Self::SPIN_LIMIT, "spin moment above limit"),
        (Self::OFF_HEMISPHERE, "point off the hemisphere"),
        (Self::GAUGE_SATURATED, "gauge saturated"),
        (Self::GAUGE_OPEN, "gauge open"),
        (Self::GAUGE_STUCK, "gauge stuck"),
        (Self::GAUGE_MISSING, "gauge missing"),
        (Self::GAUGE_LATE, "gauge late"),
        (Self::CALIBRATION_MISSING, "calibration missing"),
        (Self::NOT_TARED, "not tared"),
        (Self::JOINT_INVALID, "joint angle invalid"),
        (Self::TARING, "tare in progress"),
        (Self::CLIPPED, "value beyond its range"),
        (Self::JOINT_LATE, "joint angle late"),
        (Self::LATE_SAMPLE, "sample late"),
        (Self::TARE_DRIFTED, "tare drifted"),
        (Self::CALIBRATION_VOLATILE, "calibration in RAM only"),
        (Self::LOADED, "tip loaded"),
    ];

    /// No flag set: a valid contact without remarks.
    pub const fn none() -> Self {
        Self(0)
    }

    /// The flags of a 24-bit word; higher bits are dropped.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits & 0x00ff_ffff)
    }

    /// The flags as a 24-bit word.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Whether every flag of `other` is set here.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether any flag of `other` is set here.
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Sets every flag of `other`.
    pub const fn insert(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Both sets together.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether the contact may be used: no invalidating flag is set.
    pub const fn is_valid(self) -> bool {
        !self.intersects(Self::INVALIDATING)
    }

    /// The words for every flag that is set, in bit order.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES
            .iter()
            .filter(move |(flag, _)| self.contains(*flag))
            .map(|(_, name)| *name)
    }
}

/// One contact, in tip coordinates: origin at the tip's centre, z along the finger away from the
/// sensor.
///
/// Forces are those of the object on the tip. Encoding rounds to the steps in the module's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Counts every contact the board has made since it started, sent or dropped, modulo
    /// [`CONTACT_SEQUENCE_MODULUS`]; a gap is exactly the number lost ([`Contact::lost_since`]).
    pub sequence: u32,
    /// Time of the sample on the board's clock, us since start, modulo [`CONTACT_TIME_MODULUS_US`];
    /// widen with [`Contact::widen_time_us`].
    pub board_time_us: u64,
    /// Contact point on the tip's surface, from the tip's centre, mm.
    pub point_mm: [f32; 3],
    /// Outward unit normal of the tip at the point; the object's outward normal is its negative.
    pub normal: [f32; 3],
    /// Force along the normal, compression positive, N.
    pub normal_force_n: f32,
    /// Magnitude of the force in the tangent plane, N.
    pub tangential_force_n: f32,
    /// Moment about the outward normal, N mm.
    pub spin_n_mm: f32,
    /// Standard deviation of the point along each tangent axis, mm.
    pub sigma_mm: f32,
    /// Angles of the three joints, base first, rad.
    pub joint_angles_rad: [f32; 3],
    /// Why the contact is invalid, and remarks.
    pub flags: ContactFlags,
}

impl Contact {
    /// Whether the contact may be used.
    pub const fn is_valid(&self) -> bool {
        self.flags.is_valid()
    }

    /// Contacts made and not received between the one numbered `previous` and this one; exact up to
    /// 23 hours of silence at 200 Hz.
    pub const fn lost_since(&self, previous: u32) -> u32 {
        self.sequence.wrapping_sub(previous).wrapping_sub(1) % CONTACT_SEQUENCE_MODULUS
    }

    /// The full board time nearest to `reference_us` that agrees with this contact's time modulo
    /// 2^40 us.
    ///
    /// `reference_us` is any full board time within 6 days of the contact, such as the last
    /// time-sync answer.
    pub const fn widen_time_us(&self, reference_us: u64) -> u64 {
        let half = CONTACT_TIME_MODULUS_US / 2;
        let low = self.board_time_us % CONTACT_TIME_MODULUS_US;
        let ahead = low.wrapping_sub(reference_us) % CONTACT_TIME_MODULUS_US;
        if ahead < half {
            reference_us + ahead
        } else {
            // `low` lies behind the reference; below time zero there is only `low` itself.
            match reference_us.checked_sub(CONTACT_TIME_MODULUS_US - ahead) {
                Some(time) => time,
                None => low,
            }
        }
    }
}

wire_struct! {
    /// The bytes of a [`Contact`], field by field; see the module's table.
    #[derive(Copy)]
    pub struct PackedContact {
        sequence: [u8; 3],
        board_time_us: [u8; 5],
        point_2um: [[u8; 2]; 3],
        normal_octahedral: [[u8; 2]; 2],
        normal_force_mn: [u8; 2],
        tangential_force_mn: [u8; 2],
        spin_10un_m: [u8; 2],
        sigma_um: [u8; 2],
        joint_angles_10urad: [u8; 8],
        flags: [u8; 3],
    }
}

/// Rounds to the nearest integer, halves away from zero, and clips; notes in `clipped` what did not
/// fit.
fn to_i16(value: f32, clipped: &mut bool) -> [u8; 2] {
    let limit = f32::from(i16::MAX);
    // A NaN is in no range, so it is noted; the cast makes it 0.
    if !(-limit..=limit).contains(&value) {
        *clipped = true;
    }
    let rounded = if value < 0.0 {
        value - 0.5
    } else {
        value + 0.5
    };
    (rounded.clamp(-limit, limit) as i16).to_le_bytes()
}

/// As [`to_i16`] for quantities that are never negative; values down to minus one step are rounding
/// and pass as 0.
fn to_u16(value: f32, clipped: &mut bool) -> [u8; 2] {
    let limit = f32::from(u16::MAX);
    if !(-1.0..=limit).contains(&value) {
        *clipped = true;
    }
    ((value + 0.5) as u16).to_le_bytes()
}

/// Joint angle in 21-bit two's complement steps.
fn to_angle(angle_rad: f32, clipped: &mut bool) -> u32 {
    let steps = angle_rad * ANGLE_STEPS_PER_RAD;
    if !(-ANGLE_LIMIT..=ANGLE_LIMIT).contains(&steps) {
        *clipped = true;
    }
    let rounded = if steps < 0.0 {
        steps - 0.5
    } else {
        steps + 0.5
    };
    let rounded = rounded.clamp(-ANGLE_LIMIT, ANGLE_LIMIT) as i32;
    rounded.cast_unsigned() & 0x001f_ffff
}

/// Folds a unit vector onto the octahedron and that onto the square [-1, 1]^2 (Meyer et al. 2010,
/// "On floating-point normal vectors").
fn to_octahedral([x, y, z]: [f32; 3]) -> [f32; 2] {
    let sum = x.abs() + y.abs() + z.abs();
    let (u, v) = (x / sum, y / sum);
    if z >= 0.0 {
        [u, v]
    } else {
        [(1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v)]
    }
}

/// The unit vector of a point of the square.
fn from_octahedral([u, v]: [f32; 2]) -> [f32; 3] {
    let z = 1.0 - u.abs() - v.abs();
    let (x, y) = if z >= 0.0 {
        (u, v)
    } else {
        ((1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v))
    };
    let length = libm::sqrtf(x * x + y * y + z * z);
    [x / length, y / length, z / length]
}

impl From<&Contact> for PackedContact {
    fn from(contact: &Contact) -> Self {
        let mut clipped = false;
        let [s0, s1, s2, _] = contact.sequence.to_le_bytes();
        let time = contact.board_time_us.to_le_bytes();
        let point_2um = contact
            .point_mm
            .map(|mm| to_i16(mm * (1000.0 / POINT_STEP_UM), &mut clipped));
        let normal_octahedral =
            to_octahedral(contact.normal).map(|u| to_i16(u * f32::from(i16::MAX), &mut clipped));
        let normal_force_mn = to_u16(contact.normal_force_n * 1e3, &mut clipped);
        let tangential_force_mn = to_u16(contact.tangential_force_n * 1e3, &mut clipped);
        let spin_10un_m = to_i16(contact.spin_n_mm * 1e2, &mut clipped);
        let sigma_um = to_u16(contact.sigma_mm * 1e3, &mut clipped);
        let [a, b, c] = contact
            .joint_angles_rad
            .map(|angle| to_angle(angle, &mut clipped));
        let mut flags = contact.flags;
        if clipped {
            flags.insert(ContactFlags::CLIPPED);
        }
        let [f0, f1, f2, _] = flags.bits().to_le_bytes();
        Self {
            sequence: [s0, s1, s2],
            board_time_us: [time[0], time[1], time[2], time[3], time[4]],
            point_2um,
            normal_octahedral,
            normal_force_mn,
            tangential_force_mn,
            spin_10un_m,
            sigma_um,
            joint_angles_10urad: (u64::from(a) | u64::from(b) << 21 | u64::from(c) << 42)
                .to_le_bytes(),
            flags: [f0, f1, f2],
        }
    }
}

impl From<PackedContact> for Contact {
    fn from(packed: PackedContact) -> Self {
        let [s0, s1, s2] = packed.sequence;
        let [t0, t1, t2, t3, t4] = packed.board_time_us;
        let angles = u64::from_le_bytes(packed.joint_angles_10urad);
        // Sign extension of 21 bits: shift them to the top, then back arithmetically.
        let angle = |shift: u32| {
            let steps = ((angles >> shift) << 43).cast_signed() >> 43;
            steps as f32 / ANGLE_STEPS_PER_RAD
        };
        let [f0, f1, f2] = packed.flags;
        Self {
            sequence: u32::from_le_bytes([s0, s1, s2, 0]),
            board_time_us: u64::from_le_bytes([t0, t1, t2, t3, t4, 0, 0, 0]),
            point_mm: packed
                .point_2um
                .map(|b| f32::from(i16::from_le_bytes(b)) * (POINT_STEP_UM / 1000.0)),
            normal: from_octahedral(packed.normal_octahedral.map(|b| {
                (f32::from(i16::from_le_bytes(b)) / f32::from(i16::MAX)).clamp(-1.0, 1.0)
            })),
            normal_force_n: f32::from(u16::from_le_bytes(packed.normal_force_mn)) / 1e3,
            tangential_force_n: f32::from(u16::from_le_bytes(packed.tangential_force_mn)) / 1e3,
            spin_n_mm: f32::from(i16::from_le_bytes(packed.spin_10un_m)) / 1e2,
            sigma_mm: f32::from(u16::from_le_bytes(packed.sigma_um)) / 1e3,
            joint_angles_rad: [angle(0), angle(21), angle(42)],
            flags: ContactFlags::from_bits(u32::from_le_bytes([f0, f1, f2, 0])),
        }
    }
}

impl Wire for Contact {
    const MAX_BYTES: usize = PackedContact::MAX_BYTES;
    const SCHEMA: u64 = PackedContact::SCHEMA;
}

impl Serialize for Contact {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        PackedContact::from(self).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Contact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        PackedContact::deserialize(deserializer).map(Self::from)
    }
}
