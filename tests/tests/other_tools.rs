//! What Palpus writes, read by other people's tools: runs by the MCAP library, meshes and points by trimesh.

use palpus_host::cloud::write_ply;
use palpus_host::export::write_mesh;
use palpus_host::run::capture::{CaptureSettings, capture};
use palpus_host::run::points::points;
use palpus_host::simulate::{HandOptions, Object, SimulatedHand};
use palpus_tests::script::last_json;
use palpus_tests::{patches, python};
use serde_json::json;
use std::sync::atomic::AtomicBool;

#[test]
fn runs_open_with_the_mcap_library_and_their_own_schemas() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run.mcap");
    let mut hand = HandOptions::new(Object::named("sphere").unwrap());
    hand.fingers = 2;
    let simulated = SimulatedHand::start(&hand).unwrap();
    let fingers = simulated.ports().iter();
    let fingers = fingers.map(|p| (p.finger.clone(), p.port.display().to_string()));
    let sources = vec![(
        "hand.urdf".to_owned(),
        palpus_host::hand::Hand::THREE_FINGER_URDF.to_owned(),
    )];
    let mut settings = CaptureSettings::every_contact(fingers.collect(), sources, run.clone());
    settings.points = Some(400);
    capture(&settings, &AtomicBool::new(false), &mut |_| {}).unwrap();
    simulated.stop();

    let seen = last_json(&python::run("check_mcap.py", &[&run]));
    assert_eq!(seen["failures"], json!([]), "{seen}");
    let cloud = points(std::slice::from_ref(&run), None).unwrap().cloud;
    let drawn: u64 = ["index", "middle"]
        .iter()
        .map(|finger| {
            let topic = &seen["topics"][format!("/{finger}/points")];
            assert_eq!(topic["schema"], "foxglove.PointCloud");
            topic["points"].as_u64().unwrap()
        })
        .sum();
    assert_eq!(drawn, cloud.points.len() as u64);
    assert_eq!(
        seen["topics"]["/events"]["schema"], "foxglove.Log",
        "{seen}"
    );
    for schema in seen["schemas"].as_array().unwrap() {
        assert_eq!(schema[1], "protobuf");
    }

    // The points, with normals, sigma, finger and time.
    let path = folder.path().join("points.ply");
    let mut bytes = Vec::new();
    write_ply(&cloud, &mut bytes).unwrap();
    std::fs::write(&path, bytes).unwrap();
    let seen = last_json(&python::run("check_meshes.py", &[&path]));
    assert_eq!(seen["points.ply"]["points"], cloud.points.len(), "{seen}");
}

#[test]
fn meshes_are_watertight_to_another_reader() {
    let folder = tempfile::tempdir().unwrap();
    let mut surface = patches::torus(10, 6);
    surface.sigma = vec![0.1; surface.vertices.len()];
    let sampled = surface.sample_per_patch(6).unwrap();
    let paths: Vec<_> = ["ply", "stl", "obj", "glb"]
        .iter()
        .map(|kind| folder.path().join("torus").with_extension(kind))
        .collect();
    for path in &paths {
        write_mesh(path, &sampled).unwrap();
    }
    let paths: Vec<&std::path::Path> = paths.iter().map(std::path::PathBuf::as_path).collect();
    let seen = last_json(&python::run("check_meshes.py", &paths));
    let volume = seen["torus.obj"]["volume"].as_f64().unwrap();
    for (name, mesh) in seen.as_object().unwrap() {
        assert_eq!(mesh["triangles"], sampled.triangles.len(), "{name}: {mesh}");
        assert_eq!(mesh["watertight"], true, "{name}: {mesh}");
        assert_eq!(mesh["winding"], true, "{name}: {mesh}");
        assert_eq!(mesh["euler"], 0, "{name}: {mesh}");
        let off = mesh["volume"].as_f64().unwrap() / volume - 1.0;
        assert!(off.abs() < 1e-5, "{name}: {mesh}");
        if let Some(agree) = mesh.get("normals_agree") {
            // No normal on the wrong side.
            assert!(agree.as_f64().unwrap() > 0.0, "{name}: {mesh}");
        }
    }
}
