//! GLB files judged by the Khronos validator: no error, no warning, no hint.

use palpus_host::export::MeshFormat;
use palpus_tests::patches;
use std::path::{Path, PathBuf};
use std::process::Command;

#[test]
fn the_khronos_validator_finds_nothing() {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    let made = tests.join("../target/test-node/node_modules");
    let modules = std::env::var_os("PALPUS_TEST_NODE_MODULES").map_or(made, PathBuf::from);
    let folder = tempfile::tempdir().unwrap();
    let mut sphere = patches::lumpy_sphere(1);
    sphere.sigma = (0..sphere.vertices.len())
        .map(|k| 0.01 * k as f64)
        .collect();
    for (name, surface) in [
        ("sphere", sphere),
        ("cube", patches::cube(100.0)),
        ("sheet", patches::sheet(2)),
    ] {
        let sampled = surface.sample_per_patch(5).unwrap();
        let path = folder.path().join(name).with_extension("glb");
        std::fs::write(&path, MeshFormat::Glb.encode(&sampled).unwrap()).unwrap();
        let out = Command::new("node")
            .arg(tests.join("node/check_glb.js"))
            .args([&modules, &path])
            .output()
            .unwrap_or_else(|e| panic!("no node ({e}): run tests/setup"));
        assert!(
            out.status.success(),
            "no validator: run tests/setup\n{}",
            String::from_utf8_lossy(&out.stderr)
        );
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        for kind in ["numErrors", "numWarnings", "numHints"] {
            assert_eq!(report[kind], 0, "{name}: {report}");
        }
        assert_eq!(
            report["info"]["totalTriangleCount"],
            sampled.triangles.len()
        );
        assert_eq!(report["info"]["totalVertexCount"], sampled.positions.len());
    }
}
