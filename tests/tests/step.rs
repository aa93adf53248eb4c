//! STEP files opened by OpenCASCADE: valid, watertight, the right topology, the patches themselves.

use palpus_host::Vec3;
use palpus_host::export::{SurfaceFile, step};
use palpus_host::reconstruct::{Options, reconstruct};
use palpus_host::simulate::{Object, PointSet};
use palpus_host::spline::Surface;
use palpus_host::spline::chart::{Chart, knot_clouds};
use palpus_host::spline::simplex::{KnotNet, TriangularBSpline, Vec2};
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

/// The surface reconstructed from 1229 noisy contacts with an object of unit size.
fn reconstructed(object: &str) -> Surface {
    let points = PointSet {
        count: 1229,
        longest_side: Some(1.0),
        position_noise: 0.005,
        normal_noise_degrees: 3.0,
        seed: 3,
        ..PointSet::default()
    };
    let cloud = points.points(&Object::named(object).unwrap());
    let options = Options {
        tolerance: Some(0.02),
        ..Options::default()
    };
    let result = reconstruct(&cloud, &options, &|_| ()).unwrap();
    result.surface.unwrap()
}

#[test]
fn reconstructed_objects_open_as_what_they_are() {
    for (object, euler, closed) in [
        ("torus", 0, true),
        ("mug", 0, true),
        ("cube", 2, true),
        ("bowl", 2, true),
    ] {
        let surface = reconstructed(object);
        if object == "cube" {
            assert!(!surface.creases.is_empty());
        }
        let figures = check(object, &surface);
        assert_eq!(figures["euler"], euler, "{object}");
        assert_eq!(figures["free_edges"] == 0, closed, "{object}");
    }
}

#[test]
fn a_chart_is_a_shell_of_its_pieces() {
    // Eight triangles and their ring, knots of degree 2, a region that cuts through them.
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for row in 0..5_u32 {
        for column in 0..5_u32 {
            vertices.push(Vec2::new(
                f64::from(column) + 0.5 * f64::from(row),
                0.9 * f64::from(row),
            ));
            if row < 4 && column < 4 {
                let corner = row * 5 + column;
                triangles.push([corner, corner + 1, corner + 5]);
                triangles.push([corner + 1, corner + 6, corner + 5]);
            }
        }
    }
    let (clouds, _) = knot_clouds(2, &vertices, &triangles).unwrap();
    let net = KnotNet::new(2, &clouds, triangles).unwrap();
    let control = net
        .greville_points()
        .iter()
        .map(|u| Vec3::new(u.x, u.y, 0.2 * u.x * u.y + 0.1 * (3.0 * u.x).sin()))
        .collect();
    let border = [(2.1, 1.0), (3.5, 1.1), (3.9, 2.4), (2.9, 2.5)];
    let border = border.map(|(x, y)| Vec2::new(x, y)).to_vec();
    let spline = TriangularBSpline::new(net, control).unwrap();
    let chart = Chart::new(spline, border, Vec::new()).unwrap();
    let pieces = chart.pieces().unwrap().surface;
    let figures = check("chart", &pieces);
    assert_eq!(figures["euler"], 1);
}
