//! The smooth solids: functions that are negative inside, 0 on the surface, positive outside.
//!
//! Lengths are millimetres; every solid is centred near the origin and between 100 and 210 mm long. Close
//! to the surface each function is about the distance to it, and its gradient does not vanish there; further
//! away it is only guaranteed to have the right sign. Concave places are blended with a radius above the
//! 20 mm of the fingertip where that leaves the object what it is, so that a tip can touch nearly all of it.

use super::jet::Smooth;
use std::f64::consts::PI;

/// A solid with a smooth surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Solid {
    Sphere,
    Ellipsoid,
    Torus,
    TwoHoledTorus,
    Mug,
    Bowl,
    Bean,
    Trilobe,
}

impl Solid {
    /// A box that holds the solid with a few millimetres to spare: half its sides, and its centre.
    pub(super) fn bounds_mm(self) -> ([f64; 3], [f64; 3]) {
        let (low, high) = match self {
            Self::Sphere => ([-60.0; 3], [60.0; 3]),
            Self::Ellipsoid => ([-85.0, -60.0, -45.0], [85.0, 60.0, 45.0]),
            Self::Torus => ([-88.0, -88.0, -28.0], [88.0, 88.0, 28.0]),
            Self::TwoHoledTorus => ([-100.0, -56.0, -21.0], [100.0, 56.0, 21.0]),
            Self::Mug => ([-50.0, -50.0, -65.0], [116.0, 50.0, 65.0]),
            Self::Bowl => ([-85.0, -85.0, -48.0], [85.0, 85.0, 32.0]),
            Self::Bean => ([-84.0, -47.0, -30.0], [84.0, 47.0, 30.0]),
            Self::Trilobe => ([-82.0, -82.0, -42.0], [82.0, 82.0, 42.0]),
        };
        let spare = 4.0;
        (low.map(|v| v - spare), high.map(|v| v + spare))
    }

    /// The function at a point, millimetres.
    pub(super) fn field<S: Smooth>(self, [x, y, z]: [S; 3]) -> S {
        match self {
            Self::Sphere => x.hypot(y).hypot(z) - 60.0,
            Self::Ellipsoid => {
                let [a, b, c] = [85.0, 60.0, 45.0];
                ((x * (1.0 / a)).hypot(y * (1.0 / b)).hypot(z * (1.0 / c)) - 1.0) * c
            }
            Self::Torus => torus(x, y, z, 60.0, 28.0),
            Self::TwoHoledTorus => round_union(
                torus(x + 44.0, y, z, 42.0, 14.0),
                torus(x - 44.0, y, z, 42.0, 14.0),
                22.0,
            ),
            Self::Mug => mug(x, y, z),
            Self::Bowl => bowl(x.hypot(y), z),
            Self::Bean => bent_capsule(x, y + 45.0, z, 60.0, PI / 3.0, 30.0),
            Self::Trilobe => {
                // Three balls at 120 degrees, blended by a soft minimum of 15 mm.
                let balls = [0.0, 1.0, 2.0].map(|k: f64| {
                    let (sin, cos) = (2.0 * PI * k / 3.0).sin_cos();
                    (x - 40.0 * cos).hypot(y - 40.0 * sin).hypot(z) - 34.0
                });
                soft_minimum(balls, 15.0)
            }
        }
    }
}

/// Ring of radius `major` about the z axis, tube of radius `minor`; an exact distance.
fn torus<S: Smooth>(x: S, y: S, z: S, major: f64, minor: f64) -> S {
    (x.hypot(y) - major).hypot(z) - minor
}

/// Cup of outer radius 50 and height 130 with walls of 8, round inside at the bottom (24), with a handle
/// whose hole is 52 high and 50 wide. The handle joins the solid cup first and the cavity is cut last, so
/// that no handle is left inside.
fn mug<S: Smooth>(x: S, y: S, z: S) -> S {
    let rho = x.hypot(y);
    let edge = if z.value() < 0.0 { 32.0 } else { 4.0 };
    let cup = rounded_rectangle(rho - 50.0, z.abs() - 65.0, edge);
    let cavity = rounded_rectangle(rho - 42.0, -z - 57.0, 24.0);
    // The handle's spine is a rounded rectangle in the plane y = 0, from inside the cup to x = 108.
    let spine = rounded_rectangle((x - 64.0).abs() - 44.0, (z - 2.0).abs() - 34.0, 30.0);
    let handle = spine.hypot(y) - 8.0;
    round_intersection(round_union(cup, handle, 21.0), -cavity, 4.0)
}

/// Thick shell: an arc of radius 79 and 75 degrees to either side of the bottom, thickened by 6, turned
/// about the z axis; the lip is round. An exact distance.
fn bowl<S: Smooth>(rho: S, z: S) -> S {
    let (sin, cos) = (75.0f64).to_radians().sin_cos();
    let up = z - 35.0;
    // Beyond the arc's end when the direction from the centre is turned past 75 degrees from -z.
    let beyond = rho.value() * cos + up.value() * sin > 0.0;
    let spine = if beyond {
        (rho - 79.0 * sin).hypot(up + 79.0 * cos)
    } else {
        (rho.hypot(up) - 79.0).abs()
    };
    spine - 6.0
}

/// Capsule bent along an arc of radius `major` in the plane z = 0, `half_angle` to either side of +y.
/// An exact distance.
fn bent_capsule<S: Smooth>(x: S, y: S, z: S, major: f64, half_angle: f64, minor: f64) -> S {
    let (sin, cos) = half_angle.sin_cos();
    let side = x.abs();
    let spine = if side.value() * cos > y.value() * sin {
        (side - major * sin).hypot(y - major * cos).hypot(z)
    } else {
        (x.hypot(y) - major).hypot(z)
    };
    spine - minor
}

/// Rectangle with rounded corners, given how far a point is beyond its two sides; an exact distance.
fn rounded_rectangle<S: Smooth>(beyond_u: S, beyond_v: S, radius: f64) -> S {
    let (u, v) = (beyond_u + radius, beyond_v + radius);
    let inside = u.max(v).min(S::constant(0.0));
    u.positive_part().hypot(v.positive_part()) + inside - radius
}

/// Union of two solids given by distances, the valley between them filled with a fillet of `radius`.
fn round_union<S: Smooth>(a: S, b: S, radius: f64) -> S {
    let (u, v) = ((-a + radius).positive_part(), (-b + radius).positive_part());
    a.min(b).max(S::constant(radius)) - u.hypot(v)
}

/// Intersection of two solids given by distances, the ridge between them rounded with `radius`.
fn round_intersection<S: Smooth>(a: S, b: S, radius: f64) -> S {
    -round_union(-a, -b, radius)
}

/// Soft minimum -k ln(sum exp(-d / k)): smooth of every order, below the minimum by at most k ln 3.
fn soft_minimum<S: Smooth>(distances: [S; 3], k: f64) -> S {
    // Shifted by the minimum, so that no exponential overflows.
    let least = distances
        .iter()
        .fold(f64::INFINITY, |least, d| least.min(d.value()));
    let sum = distances
        .iter()
        .map(|&d| ((d - least) * (-1.0 / k)).exp())
        .fold(S::constant(0.0), |sum, e| sum + e);
    -(sum.ln() * k) + least
}
