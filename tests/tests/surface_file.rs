//! The surface file as other programs read it: the Python of the documentation, with numpy alone.

use palpus_host::export::SurfaceFile;
use palpus_tests::{patches, python};
use std::process::Command;

#[test]
fn the_documented_python_evaluates_the_file() {
    let source = include_str!("../../host/src/export/surface_file.rs");
    let (_, block) = source.split_once("```python\n").unwrap();
    let (block, _) = block.split_once("//! ```").unwrap();
    let strip = |line: &str| {
        line.strip_prefix("//!")
            .unwrap()
            .trim_start_matches(' ')
            .len()
    };
    assert!(block.lines().all(|line| line == "//!" || strip(line) > 0));
    let code: String = block
        .lines()
        .map(|line| format!("{}\n", line.strip_prefix("//! ").unwrap_or_default()))
        .collect();

    let surface = patches::lumpy_sphere(0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("SURFACE.json");
    SurfaceFile {
        surface: surface.clone(),
        ..SurfaceFile::default()
    }
    .write(&path)
    .unwrap();
    let more = "print(*map(float, np.concatenate(point(3, (0.2, 0.5, 0.3)))))\n";
    let out = Command::new(python::interpreter())
        .current_dir(folder.path())
        .args(["-c", &(code + more)])
        .output()
        .unwrap_or_else(|e| panic!("no Python with the tests' packages ({e}): run tests/setup"));
    let stdout = String::from_utf8_lossy(&out.stdout);
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let numbers: Vec<f64> = stdout
        .lines()
        .last()
        .unwrap()
        .split_whitespace()
        .map(|number| number.parse().unwrap())
        .collect();
    let (point, normal) = (
        surface.point(3, [0.2, 0.5, 0.3]),
        surface.normal(3, [0.2, 0.5, 0.3]),
    );
    for (found, expected) in numbers.iter().zip(point.iter().chain(normal.iter())) {
        assert!((found - expected).abs() < 1e-14, "{stdout}");
    }
    assert_eq!(numbers.len(), 6);
}
