//! Moved, turned and scaled contacts give the moved, turned and scaled surface: the same patches, every control point
//! in its place up to the rounding of the input. The tolerance is given: its default follows the bounding box of the
//! input, whose sides do not turn with the contacts.
//!
//! `cargo test --release -p palpus-tests --test invariance -- --nocapture` prints the table.

use nalgebra::{Rotation3, Unit};
use palpus_host::Vec3;
use palpus_host::cloud::Cloud;
use palpus_host::reconstruct::{Options, reconstruct};
use palpus_host::simulate::{Object, PointSet};
use palpus_host::spline::Surface;

/// What is done to the contacts, and by how much of the size a control point may be off its place then.
struct Case {
    name: &'static str,
    scale: f64,
    turn: Rotation3<f64>,
    /// In sizes of the object as scaled.
    shift: Vec3,
    bound: f64,
}

fn cases() -> Vec<Case> {
    let still = Rotation3::identity();
    let turned = |x: f64, y: f64, z: f64, angle: f64| {
        Rotation3::from_axis_angle(&Unit::new_normalize(Vec3::new(x, y, z)), angle)
    };
    let case = |name, scale, turn, shift: [f64; 3], bound| Case {
        name,
        scale,
        turn,
        shift: Vec3::from(shift),
        bound,
    };
    let none = [0.0; 3];
    let million = [1e6, -0.7e6, 0.3e6];
    vec![
        case("again", 1.0, still, none, 0.0),
        case("1024 times as large", 1024.0, still, none, 0.0),
        case("scaled by 1e-6", 1e-6, still, none, 1e-14),
        case("scaled by 1e6", 1e6, still, none, 1e-14),
        case("scaled by 25.4", 25.4, still, none, 1e-14),
        case(
            "turned by 90 degrees about z",
            1.0,
            turned(0.0, 0.0, 1.0, std::f64::consts::FRAC_PI_2),
            none,
            1e-14,
        ),
        case(
            "turned by 37 degrees",
            1.0,
            turned(1.0, 2.0, -0.5, 0.65),
            none,
            1e-14,
        ),
        case(
            "turned by 171 degrees",
            1.0,
            turned(-0.3, 1.0, 0.7, 2.98),
            none,
            1e-14,
        ),
        case("moved by 1e3 sizes", 1.0, still, [1e3, 2e3, -5e2], 1e-12),
        case("moved by 1e6 sizes", 1.0, still, million, 1e-9),
        case(
            "all three",
            1e-6,
            turned(0.2, -1.0, 0.4, 1.1),
            million,
            1e-9,
        ),
    ]
}

fn surface(cloud: &Cloud, tolerance: f64) -> Surface {
    let options = Options {
        tolerance: Some(tolerance),
        threads: Some(2),
        ..Options::default()
    };
    let made = reconstruct(cloud, &options, &|_| {}).expect("contacts of an object");
    let surface = made.surface.expect("a surface");
    // The figures are those of the surface as it is handed out, in its unit of length.
    let told = made.report.surface.expect("figures").curvature_jump_rms;
    let measured = surface.measure().expect("a surface").curvature_jump_rms;
    assert!((told.expect("a jump") / measured - 1.0).abs() < 0.01);
    surface
}

fn changes(object: &str, points: &PointSet) {
    let cloud = points.points(&Object::named(object).expect("a known object"));
    let size = cloud.diagonal();
    let tolerance = 1e-3 * size;
    let first = surface(&cloud, tolerance);
    let mut failed = Vec::new();
    for case in cases() {
        let mut other = cloud.clone();
        let shift = case.shift * size * case.scale;
        let there = |p: Vec3| case.turn * p * case.scale + shift;
        for point in &mut other.points {
            point.position = there(point.position);
            point.normal = case.turn * point.normal;
            point.sigma = point.sigma.map(|s| s * case.scale);
        }
        let made = surface(&other, tolerance * case.scale);
        let off = made
            .control_points
            .iter()
            .zip(&first.control_points)
            .flat_map(|(a, b)| a.iter().zip(b))
            .map(|(a, b)| (a - there(*b)).norm() / (size * case.scale))
            .fold(0.0, f64::max);
        println!(
            "| {object} | {} | {} | {} | {off:.1e} |",
            case.name,
            first.faces.len(),
            made.faces.len()
        );
        if made.faces != first.faces || off > case.bound {
            failed.push(case.name);
        }
    }
    assert!(failed.is_empty(), "{object}: {failed:?}");
}

fn noisy(count: usize) -> PointSet {
    PointSet {
        count,
        longest_side: Some(1.0),
        position_noise: 0.005,
        normal_noise_degrees: 3.0,
        seed: 3,
        ..PointSet::default()
    }
}

#[test]
fn a_noisy_torus_keeps_its_patches() {
    changes("torus", &noisy(1229));
}

#[test]
fn a_clean_bean_keeps_its_patches() {
    let clean = PointSet {
        position_noise: 0.0,
        normal_noise_degrees: 0.0,
        ..noisy(600)
    };
    changes("bean", &clean);
}

#[test]
fn a_noisy_cube_keeps_its_edges() {
    changes("cube", &noisy(600));
}
