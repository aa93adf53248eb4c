//! The readers of files. What is read has to keep the reader's promises; what is not has to be said.

use palpus_host::cloud::{self, Cloud};
use palpus_host::export::SurfaceFile;
use palpus_host::hand::Hand;
use palpus_host::import::mesh_from_bytes;
use palpus_host::link::calibration::{estimate, parse_loads};
use palpus_host::run::points::points;
use palpus_host::run::reader::Run;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// A refusal says something, and not the whole input.
fn said(error: &impl Display) {
    let text = error.to_string();
    assert!(!text.is_empty() && text.len() < 20_000, "{text}");
}

/// A run, opened, gone through and made points of.
pub fn run(bytes: &[u8]) {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
        // In memory where there is such a folder: a busy disk is not what is tested.
        tempfile::tempdir_in("/dev/shm")
            .or_else(|_| tempfile::tempdir())
            .expect("a folder")
    });
    // Threads of one test program may run this at once.
    let thread = format!("{:?}.mcap", std::thread::current().id());
    let path: PathBuf = FOLDER.path().join(thread);
    std::fs::write(&path, bytes).expect("room for a small file");
    match Run::open(&path) {
        Ok(run) => {
            run.each(drop).expect("what was read once is read again");
            match points(&[path], None) {
                Ok(result) => usable(&result.cloud),
                Err(error) => said(&error),
            }
        }
        Err(error) => said(&error),
    }
}

fn usable(cloud: &Cloud) {
    for point in &cloud.points {
        assert!(point.position.iter().all(|x| x.is_finite()));
        assert!((point.normal.norm() - 1.0).abs() < 1e-6);
        assert!(point.sigma.is_none_or(|s| s.is_finite() && s >= 0.0));
    }
}

fn read_points(name: &str, bytes: &[u8]) {
    match cloud::from_bytes(name, bytes) {
        Ok(read) => {
            usable(&read);
            let mut written = Vec::new();
            cloud::write_ply(&read, &mut written).expect("memory can be written");
            let again = cloud::from_bytes("again.ply", &written).expect("what was written is read");
            assert_eq!(again.points.len(), read.points.len());
        }
        Err(error) => said(&error),
    }
}

/// A PLY file of points.
pub fn points_ply(bytes: &[u8]) {
    read_points("points.ply", bytes);
}

/// XYZ, and CSV if the first byte is odd.
pub fn points_text(bytes: &[u8]) {
    if let [first, rest @ ..] = bytes {
        read_points(["points.xyz", "points.csv"][usize::from(first & 1)], rest);
    }
}

/// A PCD file.
pub fn points_pcd(bytes: &[u8]) {
    read_points("points.pcd", bytes);
}

fn read_mesh(name: &str, bytes: &[u8]) {
    match mesh_from_bytes(name, bytes) {
        Ok(mesh) => {
            assert!(!mesh.faces.is_empty());
            assert!((0..mesh.faces.len()).all(|f| mesh.corners(f as u32).is_some()));
            assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
        }
        Err(error) => said(&error),
    }
}

/// A PLY mesh.
pub fn mesh_ply(bytes: &[u8]) {
    read_mesh("mesh.ply", bytes);
}

/// An STL mesh, ASCII or binary.
pub fn mesh_stl(bytes: &[u8]) {
    read_mesh("mesh.stl", bytes);
}

/// An OBJ mesh.
pub fn mesh_obj(bytes: &[u8]) {
    read_mesh("mesh.obj", bytes);
}

fn moved(hand: &Hand) {
    for finger in hand.fingers() {
        let _ = finger.tip_pose_mm(&[0.1, f64::NAN, 1e300]);
    }
}

/// A hand's URDF.
pub fn hand_urdf(bytes: &[u8]) {
    match Hand::from_urdf(&String::from_utf8_lossy(bytes), "hand.urdf") {
        Ok(hand) => moved(&hand),
        Err(error) => said(&error),
    }
}

/// A list of fingers, with the hand that is shipped.
pub fn hand_file(bytes: &[u8]) {
    let sources = [
        ("hand.json".into(), String::from_utf8_lossy(bytes).into()),
        ("hand.urdf".into(), Hand::THREE_FINGER_URDF.to_owned()),
    ];
    match Hand::from_sources(&sources) {
        Ok(hand) => moved(&hand),
        Err(error) => said(&error),
    }
}

/// A table of loads, and the calibration made of it.
pub fn load_table(bytes: &[u8]) {
    match parse_loads(&String::from_utf8_lossy(bytes), Path::new("loads.csv")) {
        Ok(loads) => match estimate(&loads, 1) {
            Ok(made) => assert!(made.calibration.matrix.iter().all(|v| v.is_finite())),
            Err(error) => said(&error),
        },
        Err(error) => said(&error),
    }
}

/// A surface file.
pub fn surface(bytes: &[u8]) {
    match SurfaceFile::from_bytes("surface.json", bytes) {
        Ok(file) => {
            let written = file.to_bytes().expect("what was read can be written");
            let again = SurfaceFile::from_bytes("again.json", &written);
            assert_eq!(
                again.expect("what was written is read").surface,
                file.surface
            );
        }
        Err(error) => said(&error),
    }
}
