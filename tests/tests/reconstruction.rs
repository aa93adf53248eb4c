//! Points of known shapes to surfaces, by the real program, judged by what it wrote and by the true shape.

use palpus_host::Vec3;
use palpus_host::evaluate::SurfaceLocator;
use palpus_host::export::SurfaceFile;
use palpus_host::simulate::Object;
use palpus_tests::outcome::{listing, palpus};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

const CLEAN: &str = "";
const NOISY: &str = "--position-noise 0.005 --normal-noise 3";

fn run(folder: &Path, line: &str) -> String {
    let outcome = palpus(folder, &line.split_whitespace().collect::<Vec<_>>());
    assert_eq!(outcome.code, 0, "{line}: {outcome:?}");
    outcome.stdout
}

fn make_points(folder: &Path, object: &str, noise: &str) {
    run(
        folder,
        &format!(
            "simulate --object {object} --points 1229 --longest-side 1 {noise} --seed 3 -o p.ply"
        ),
    );
}

fn number(value: &Value, at: &str) -> f64 {
    value
        .pointer(at)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no number at {at} in {value}"))
}

/// Root mean square distances of the surface file in `folder` from the true shape and back, over its diagonal.
fn from_truth(folder: &Path, object: &str) -> [f64; 2] {
    let object = Object::named(object).unwrap();
    let (low, high) = object.truth_mesh().bounding_box().unwrap();
    let scale = 1.0 / (high - low).max();
    let diagonal = (high - low).norm() * scale;
    let surface = SurfaceFile::read(&folder.join("s.json")).unwrap().surface;
    let rms = |distances: Vec<f64>| {
        let sum: f64 = distances.iter().map(|d| d * d).sum();
        (sum / distances.len() as f64).sqrt() / diagonal
    };
    let places = surface.sample_per_patch(8).unwrap().positions;
    let there = |p: &Vec3| {
        let at = p / scale;
        (object.foot(&at).position_mm - at).norm() * scale
    };
    let accuracy = rms(places.iter().map(there).collect());
    let locator = SurfaceLocator::new(surface).unwrap();
    let back = |p: Vec3| (locator.foot(&p).unwrap().position - p).norm();
    let feet = object.sample(2000);
    let completeness = rms(feet.iter().map(|f| back(f.position_mm * scale)).collect());
    [accuracy, completeness]
}

/// Makes points of `object`, reconstructs them and checks everything that is promised of any result.
fn reconstructs(object: &str, noise: &str, genus: i64, largest_rms: f64) {
    let folder = tempdir().unwrap();
    make_points(folder.path(), object, noise);
    let stdout = run(
        folder.path(),
        "reconstruct p.ply -o s.json --mesh m.stl --mesh m.obj --report r.json --json",
    );
    assert_eq!(
        listing(folder.path()),
        ["m.obj", "m.stl", "p.ply", "r.json", "s.json"]
    );
    let report: Value = serde_json::from_str(&stdout).unwrap();
    let names: Vec<&str> = report["phases"]
        .as_array()
        .unwrap()
        .iter()
        .map(|phase| phase["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["extract", "simplify", "fit", "refine"]);
    for at in [
        "/input/points /input/used /input/rejected /input/bbox_diagonal /input/noise_sigma",
        "/phases/0/seconds /phases/0/triangles /phases/1/seconds /phases/1/triangles",
        "/phases/2/seconds /phases/2/patches /phases/2/rounds /phases/2/error_sum",
        "/phases/2/error_abs_sum /phases/2/error_rms /phases/2/error_max /phases/3/seconds",
        "/phases/3/patches /phases/3/levels /phases/3/error_sum /phases/3/error_abs_sum",
        "/phases/3/error_rms /phases/3/error_max /surface/patches /surface/vertices",
        "/surface/min_jacobian /error/tolerance /error/sum /error/abs_sum /error/rms /error/max",
        "/error/outliers /normals/mean_degrees /normals/max_degrees /seconds /threads",
    ] {
        for at in at.split(' ') {
            assert!(number(&report, at).is_finite());
        }
    }
    assert_eq!(report["version"], env!("CARGO_PKG_VERSION"));
    let surface = &report["surface"];
    assert_eq!(surface["degree"], 5);
    assert_eq!(surface["genus"], genus, "{surface}");
    assert_eq!(surface["euler"], 2 - 2 * genus);
    assert_eq!(surface["borders"], 0);
    assert_eq!(surface["components"], 1);
    assert_eq!(surface["crease_edges"], 0);
    assert_eq!(surface["folded_patches"], 0);
    assert!(number(surface, "/g1_max_degrees") <= 1e-6, "{surface}");
    let error = &report["error"];
    assert!(
        error["met"] == true || error["reason"].as_str().is_some_and(|r| !r.is_empty()),
        "{error}"
    );
    let rms = from_truth(folder.path(), object);
    assert!(rms.iter().all(|&r| r <= largest_rms), "{object}: {rms:?}");
}

// The bounds are about twice what was measured when they were written.

#[test]
fn sphere() {
    reconstructs("sphere", CLEAN, 0, 1.6e-4);
}

#[test]
fn torus() {
    reconstructs("torus", CLEAN, 1, 4e-4);
}

#[test]
fn noisy_torus() {
    reconstructs("torus", NOISY, 1, 1.2e-3);
}

#[test]
fn ellipsoid() {
    reconstructs("ellipsoid", CLEAN, 0, 1e-3);
}

#[test]
fn bean() {
    reconstructs("bean", CLEAN, 0, 1e-3);
}

#[test]
fn two_holed_torus() {
    reconstructs("two-holed-torus", CLEAN, 2, 1e-3);
}

#[test]
fn a_torus_within_5e_4_takes_no_more_patches_than_the_paper() {
    let folder = tempdir().unwrap();
    make_points(folder.path(), "torus", CLEAN);
    let stdout = run(folder.path(), "reconstruct p.ply --tolerance 5e-4 --json");
    let report: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(report["error"]["met"], true, "{}", report["error"]);
    assert!(number(&report, "/error/max") <= 5e-4);
    assert!(number(&report, "/surface/patches") <= 195.0);
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = tempdir().unwrap();
    make_points(folder.path(), "torus", NOISY);
    let written = ["s.json", "m.stl", "m.obj"].map(|name| folder.path().join(name));
    let [one, two] = [1, 2].map(|threads| {
        let line = "reconstruct p.ply -o s.json --mesh m.stl --mesh m.obj";
        run(folder.path(), &format!("{line} --threads {threads}"));
        written.each_ref().map(|path| fs::read(path).unwrap())
    });
    assert!(one == two);
}

#[test]
fn the_result_scales_with_the_points() {
    let folder = tempdir().unwrap();
    make_points(folder.path(), "torus", CLEAN);
    let cloud = palpus_host::cloud::read(&folder.path().join("p.ply")).unwrap();
    for (name, scale) in [("unit.xyz", 1.0), ("large.xyz", 1024.0)] {
        let rows: String = cloud
            .points
            .iter()
            .map(|point| {
                let (p, n) = (point.position * scale, point.normal);
                format!("{} {} {} {} {} {}\n", p.x, p.y, p.z, n.x, n.y, n.z)
            })
            .collect();
        fs::write(folder.path().join(name), rows).unwrap();
    }
    let [near, far] = ["unit.xyz", "large.xyz"].map(|input| {
        let stdout = run(folder.path(), &format!("reconstruct {input} --json"));
        let report: Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(report["surface"]["genus"], 1);
        (
            report["surface"]["patches"].clone(),
            number(&report, "/error/rms"),
        )
    });
    assert_eq!(near.0, far.0);
    let ratio = far.1 / near.1;
    // A power of two scales without rounding, so nothing may change at all.
    assert!((ratio / 1024.0 - 1.0).abs() <= 1e-12, "{ratio}");
}

#[test]
fn what_would_take_minutes_or_more_memory_than_allowed_is_refused_or_ended() {
    let folder = tempdir().unwrap();
    make_points(folder.path(), "bean", CLEAN);
    let ask = |line: &str| {
        let mut words = vec!["reconstruct", "p.ply", "--json"];
        words.extend(line.split(' '));
        palpus(folder.path(), &words)
    };
    for (line, said) in [
        ("--lambda 1e30", "lambda"),
        ("--rounds 1000", "1 to 100"),
        ("--rounds 0", "1 to 100"),
    ] {
        let outcome = ask(line);
        assert_eq!(outcome.code, 2, "{line}: {outcome:?}");
        assert!(outcome.stderr.contains(said), "{line}: {outcome:?}");
    }
    let outcome = ask("--max-memory 4");
    assert_eq!(outcome.code, 3, "{outcome:?}");
    assert!(outcome.stderr.contains("4194304 allowed"), "{outcome:?}");
    // What is too fine to be made keeps nothing else from being written.
    let outcome = ask("--mesh m.stl --mesh-step 1e-30 -o s.json --report r.json");
    assert_eq!(outcome.code, 3, "{outcome:?}");
    for words in ["m.stl: ", "sample more coarsely", "2147483648 allowed"] {
        assert!(outcome.stderr.contains(words), "{outcome:?}");
    }
    let there = |name: &str| folder.path().join(name).exists();
    assert!(there("s.json") && there("r.json") && !there("m.stl"));
    // 32 MB are 83 patches.
    let outcome = ask("--max-memory 32 --tolerance 1e-9");
    assert_eq!(outcome.code, 0, "{outcome:?}");
    let report: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(number(&report, "/surface/patches") <= 83.0);
    let reason = report["error"]["reason"].as_str().unwrap();
    assert!(reason.contains("--max-memory"), "{reason}");
}
