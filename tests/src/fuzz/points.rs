//! Oriented points of any kind to the whole reconstruction.
//!
//! The first byte chooses how points are encoded and what is asked for, the rest are up to [`MOST_POINTS`] points:
//! floats of 64 or 32 bits, or signed bytes, whose few values make points that coincide or lie on lines and planes.
//!
//! An input takes the program 0.1 to 3 s with the options a user has by default, and several times that where all checks
//! are on: too slow for a search that lives on numbers. One bit of the first byte therefore decides whether they are
//! the user's ([`USUAL`]) or the same stages with little to do each: small local fits, few patches, one round.
//!
//! Bounds: each stage may take [`MEMORY_BYTES`]; `tests/fuzz/run` stops a target at 2 GB and an input at a minute.

use palpus_host::Vec3;
use palpus_host::cloud::{Cloud, OrientedPoint};
use palpus_host::export::{SurfaceFile, surface_file::Provenance};
use palpus_host::reconstruct::{Options, Stage, extract, reconstruct};

/// Most points of an input.
pub const MOST_POINTS: usize = 200;
/// The bit of the first byte that asks for the options a user has by default.
pub const USUAL: u8 = 1 << 5;
/// Memory that each stage may take.
const MEMORY_BYTES: usize = 256 << 20;

/// Points of the bytes behind the first.
fn cloud(encoding: u8, bytes: &[u8]) -> Cloud {
    let eight = |b: &[u8]| f64::from_le_bytes(b.try_into().unwrap_or_default());
    let four = |b: &[u8]| f64::from(f32::from_le_bytes(b.try_into().unwrap_or_default()));
    let one = |b: &[u8]| f64::from(b[0] as i8);
    let numbers: Vec<f64> = match encoding & 3 {
        0 => bytes.chunks_exact(8).map(eight).collect(),
        1 => bytes.chunks_exact(4).map(four).collect(),
        _ => bytes.chunks_exact(1).map(one).collect(),
    };
    let points = numbers
        .chunks_exact(6)
        .take(MOST_POINTS)
        .map(|n| OrientedPoint {
            position: Vec3::new(n[0], n[1], n[2]),
            normal: Vec3::new(n[3], n[4], n[5]),
            sigma: None,
            finger: None,
            time_us: None,
        });
    Cloud {
        points: points.collect(),
        rejected: Vec::new(),
    }
}

/// Ends in a surface that can be written and read, or in an error that says something.
pub fn reconstruction(bytes: &[u8]) {
    let [kind, rest @ ..] = bytes else {
        return;
    };
    let cloud = cloud(*kind, rest);
    let mut options = Options {
        threads: Some(1),
        max_patches: 500,
        extract: extract::Options {
            max_memory: MEMORY_BYTES,
            ..extract::Options::default()
        },
        ..Options::default()
    };
    if kind & USUAL == 0 {
        options.max_patches = 40;
        options.rounds = 1;
        options.extract.neighbours = 12;
        options.simplify.energy_rounds = 1;
    }
    match kind >> 2 & 7 {
        1 => options.chart = Some(2),
        2 => options.creases = None,
        3 => options.tolerance = Some(1e-30),
        4 => options.tolerance = Some(1e30),
        5 => options.extract.max_gap = Some(1.0),
        6 => options.extract.method = extract::Method::TangentPlanes,
        7 => options.stop_after = Stage::Simplify,
        _ => {}
    }
    match reconstruct(&cloud, &options, &|_| {}) {
        Ok(made) => {
            assert_eq!(made.distances.len(), cloud.points.len());
            assert!(!made.report.to_json().is_empty());
            if made.surface.is_none() && made.chart.is_none() {
                assert_eq!(options.stop_after, Stage::Simplify);
                return;
            }
            let file = SurfaceFile {
                surface: made.surface.unwrap_or_default(),
                chart: made.chart,
                units: None,
                provenance: Provenance::default(),
                error: made.report.error,
            };
            let written = file
                .to_bytes()
                .expect("a surface that was made can be written");
            SurfaceFile::from_bytes("made.json", &written).expect("what was written is read");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
