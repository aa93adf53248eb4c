//! STEP files opened by OpenCASCADE: valid, watertight, the right topology, the patches themselves.

use palpus_host::Vec3;
use palpus_host::export::{SurfaceFile, step};
use palpus_host::spline::Surface;
use palpus_tests::{patches, python};

/// Writes the surface both ways and has the checker hold them against each other.
fn check(name: &str, surface: &Surface) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let (json, stp) = (
        folder.path().join("surface.json"),
        folder.path().join("surface.step"),
    );
    SurfaceFile {
        surface: surface.clone(),
        ..SurfaceFile::default()
    }
    .write(&json)
    .unwrap();
    step::write(&stp, surface, None).unwrap();
    let out = python::run("check_step.py", &[&json, &stp]);
    let figures: serde_json::Value = serde_json::from_str(out.lines().last().unwrap()).unwrap();
    eprintln!("{name}: {figures}");
    assert_eq!(figures["failures"], serde_json::json!([]), "{name}");
    figures
}

#[test]
fn closed_surfaces_are_solids() {
    assert_eq!(check("sphere", &patches::lumpy_sphere(1))["euler"], 2);
    assert_eq!(check("torus", &patches::torus(10, 6))["euler"], 0);
    let cube = check("cube", &patches::cube(100.0));
    assert_eq!((&cube["faces"], &cube["euler"]), (&12.into(), &2.into()));
}

#[test]
fn open_surfaces_are_shells() {
    let sheet = check("sheet", &patches::sheet(3));
    assert_eq!(
        (&sheet["euler"], &sheet["free_edges"]),
        (&1.into(), &12.into())
    );
}

#[test]
fn folding_patches_are_written_in_pieces() {
    let mut surface = patches::lumpy_sphere(1);
    // Two neighbours, and one alone.
    for patch in [0, 3, 20] {
        patches::spread(&mut surface, patch);
    }
    let figures = check("spread", &surface);
    assert_eq!(
        (&figures["faces"], &figures["euler"]),
        (&(32 + 6).into(), &2.into())
    );
}

#[test]
fn several_components_are_several_solids_or_shells() {
    let (cube, sheet) = (patches::cube(1.0), patches::sheet(2));
    let solids = patches::beside(&cube, &patches::lumpy_sphere(0), Vec3::x() * 4.0);
    assert_eq!(check("two solids", &solids)["euler"], 4);
    check(
        "solid and sheet",
        &patches::beside(&cube, &sheet, Vec3::x() * 4.0),
    );
}
