//! Whole runs of the simplification on shapes whose answer is known.

use super::*;
use crate::cloud::OrientedPoint;
use crate::mesh::{sample_by_area, shapes, topology};

fn cloud_on(mesh: &TriangleMesh, count: usize) -> Cloud {
    let points = sample_by_area(mesh, count)
        .into_iter()
        .map(|s| OrientedPoint {
            position: s.position,
            normal: mesh.face_normal(s.face),
            sigma: None,
            finger: None,
            time_us: None,
        })
        .collect();
    Cloud {
        points,
        ..Cloud::default()
    }
}

fn run(mesh: &TriangleMesh, creases: &CreaseLines, options: &Options) -> Simplified {
    simplify(mesh, &cloud_on(mesh, 1000), creases, options, None).unwrap()
}

/// Every promise of the module that holds for any shape.
fn check_promises(dense: &TriangleMesh, simple: &Simplified) {
    let (before, after) = (topology(dense), topology(&simple.mesh));
    assert!(after.is_manifold());
    assert_eq!(after.genus(), before.genus());
    assert_eq!(after.components, before.components);
    assert_eq!(after.border_loops, before.border_loops);
    assert_eq!(after.border_edges, simple.border.len());
    assert!(simple.shape.valence[0] >= 4, "{:?}", simple.shape);
    assert!(simple.shape.valence[1] <= 8, "{:?}", simple.shape);
    assert!(simple.shape.angle_min_degrees > 15.0, "{:?}", simple.shape);
    let tree = crate::mesh::AabbTree::new(dense);
    for p in &simple.mesh.positions {
        let off = tree.closest(dense, p).unwrap().distance;
        assert!(
            off < 1e-9 * dense.diagonal(),
            "a vertex lies {off} off the surface"
        );
    }
}

#[test]
fn closed_shapes_keep_their_genus_and_end_well_shaped() {
    for dense in [
        shapes::icosphere(4),
        shapes::torus(0.35, 0.15, 60, 30),
        shapes::torus(1.0, 0.1, 160, 20),
    ] {
        let simple = run(&dense, &CreaseLines::default(), &Options::default());
        check_promises(&dense, &simple);
        assert!(simple.mesh.faces.len() * 5 < dense.faces.len());
        assert!(simple.shape.valence_5_to_7 > 0.7, "{:?}", simple.shape);
    }
}

#[test]
fn faces_shrink_where_the_surface_bends() {
    // An ellipsoid of half-axes 1, 0.4, 0.4: sharpest at its tips.
    let mut dense = shapes::icosphere(4);
    for p in &mut dense.positions {
        *p = p.component_mul(&Vec3::new(1.0, 0.4, 0.4));
    }
    let simple = run(&dense, &CreaseLines::default(), &Options::default());
    check_promises(&dense, &simple);
    let mean_size = |near_tip: bool| {
        let chosen: Vec<f64> = (0..simple.mesh.positions.len())
            .filter(|v| (simple.mesh.positions[*v].x.abs() > 0.8) == near_tip)
            .map(|v| simple.sizes[v])
            .collect();
        chosen.iter().sum::<f64>() / chosen.len() as f64
    };
    assert!(mean_size(true) < 0.75 * mean_size(false));
}

#[test]
fn the_number_of_faces_follows_the_target_the_turn_and_the_accuracy() {
    let dense = shapes::torus(0.35, 0.15, 60, 30);
    let count = |options: Options| {
        let simple = run(&dense, &CreaseLines::default(), &options);
        check_promises(&dense, &simple);
        simple.mesh.faces.len() as f64
    };
    for target in [120.0, 300.0, 600.0] {
        let got = count(Options {
            target_faces: Some(target as usize),
            ..Options::default()
        });
        assert!(
            (got / target - 1.0).abs() < 0.25,
            "{got} faces for {target}"
        );
    }
    let finer = count(Options {
        turn_max_degrees: 40.0,
        ..Options::default()
    });
    assert!(finer > 1.5 * count(Options::default()));
    let exact = Options {
        accuracy: Some(1e-5),
        ..Options::default()
    };
    assert!(count(exact) > 1.5 * count(Options::default()));
}

#[test]
fn thin_walls_get_small_faces() {
    // Two flat sheets, close and wide, joined by rounded rims: a flat box with its edges smoothed away.
    let box_of = |half_height: f64| {
        let mut dense = shapes::icosphere(5);
        for p in &mut dense.positions {
            let r = (p.x.powi(4) + p.y.powi(4) + p.z.powi(4)).powf(0.25);
            *p = p.component_mul(&Vec3::new(1.0, 1.0, half_height)) / r;
        }
        dense
    };
    let thin = box_of(0.15);
    let simple = run(&thin, &CreaseLines::default(), &Options::default());
    check_promises(&thin, &simple);
    // On the flat part the thickness of 0.3 decides.
    let limit = Options::default().thickness_ratio * 0.3;
    let mut flat = 0;
    for (p, size) in simple.mesh.positions.iter().zip(&simple.sizes) {
        if p.x.hypot(p.y) < 0.5 {
            assert!(*size <= 1.1 * limit, "{size} at {p}");
            flat += 1;
        }
    }
    assert!(flat > 0);
}

#[test]
fn a_border_stays_on_the_border() {
    let dense = shapes::open_cylinder(0.5, 1.0, 48, 24);
    let simple = run(&dense, &CreaseLines::default(), &Options::default());
    check_promises(&dense, &simple);
    for v in simple.border.iter().flatten() {
        let p = simple.mesh.positions[*v as usize];
        assert!(p.z.abs() < 1e-12 || (p.z - 1.0).abs() < 1e-12, "{p}");
    }
    // A square's corners are corners of the border.
    let sheet = shapes::grid(20, 20);
    let simple = run(&sheet, &CreaseLines::default(), &Options::default());
    for corner in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let at = Vec3::new(corner.0, corner.1, 0.0);
        assert!(simple.mesh.positions.contains(&at), "{at} is gone");
    }
    assert_eq!(simple.corners.len(), 4);
    assert!((simple.mesh.area() - 1.0).abs() < 1e-12);
}

fn cube_with_creases(n: u32) -> (TriangleMesh, CreaseLines) {
    let mesh = shapes::cube(n);
    let mut creases = CreaseLines::default();
    for face in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            let (p, q) = (mesh.positions[a as usize], mesh.positions[b as usize]);
            if a < b
                && (0..3)
                    .filter(|&i| p[i] == q[i] && p[i].abs() == 1.0)
                    .count()
                    == 2
            {
                creases.edges.push([a, b]);
            }
        }
    }
    (mesh, creases)
}

#[test]
fn a_cube_with_creases_ends_as_the_same_cube() {
    let (dense, creases) = cube_with_creases(10);
    let simple = run(&dense, &creases, &Options::default());
    assert_eq!(topology(&simple.mesh).genus(), Some(0));
    assert!(simple.mesh.faces.len() < 150, "{}", simple.mesh.faces.len());
    assert!(
        (simple.mesh.area() - 24.0).abs() < 1e-9,
        "no face cuts an edge"
    );
    assert_eq!(simple.corners.len(), 8);
    let length: f64 = simple
        .creases
        .iter()
        .map(|[a, b]| {
            (simple.mesh.positions[*a as usize] - simple.mesh.positions[*b as usize]).norm()
        })
        .sum();
    assert!((length - 24.0).abs() < 1e-9, "{length}");
}

#[test]
fn same_input_same_mesh() {
    let dense = shapes::torus(0.35, 0.15, 60, 30);
    let once = run(&dense, &CreaseLines::default(), &Options::default());
    assert_eq!(
        once,
        run(&dense, &CreaseLines::default(), &Options::default())
    );
}

#[test]
fn the_energy_falls() {
    let mut dense = shapes::icosphere(4);
    for p in &mut dense.positions {
        *p = p.component_mul(&Vec3::new(1.0, 0.6, 0.3));
    }
    let simple = run(&dense, &CreaseLines::default(), &Options::default());
    let [before, after] = simple.energy.unwrap();
    assert!(after.distance + after.representation < before.distance + before.representation);
}

#[test]
fn a_field_behind_the_mesh_is_followed() {
    let dense = shapes::icosphere(3);
    let project = |p: &Vec3| Some((p.normalize(), p.normalize()));
    let options = Options::default();
    let simple = simplify(
        &dense,
        &cloud_on(&dense, 500),
        &CreaseLines::default(),
        &options,
        Some(&project),
    )
    .unwrap();
    for p in &simple.mesh.positions {
        assert!((p.norm() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn bad_input_is_refused_with_a_reason() {
    let none = CreaseLines::default();
    let options = Options::default();
    let cloud = Cloud::default();
    let of = |mesh: &TriangleMesh, creases: &CreaseLines, options: &Options| {
        simplify(mesh, &cloud, creases, options, None).map(|s| s.mesh.faces.len())
    };
    assert_eq!(
        of(&TriangleMesh::default(), &none, &options),
        Err(SimplifyError::Empty)
    );
    let sphere = shapes::icosphere(2);
    let bad = CreaseLines {
        edges: vec![[0, 1]],
        corners: Vec::new(),
    };
    assert_eq!(
        of(&sphere, &bad, &options),
        Err(SimplifyError::NoSuchCrease(0, 1))
    );
    let bad = CreaseLines {
        edges: Vec::new(),
        corners: vec![1 << 30],
    };
    assert_eq!(
        of(&sphere, &bad, &options),
        Err(SimplifyError::NoSuchCorner(1 << 30))
    );
    let bad = Options {
        gradation: f64::NAN,
        ..Options::default()
    };
    assert!(matches!(
        of(&sphere, &none, &bad),
        Err(SimplifyError::BadOption {
            name: "gradation",
            ..
        })
    ));
    let mut broken = sphere.clone();
    broken.faces.push([0, 1, 2]);
    assert!(matches!(
        of(&broken, &none, &options),
        Err(SimplifyError::NotManifold(_))
    ));
    // Without a point there is still a mesh: the energy is left out.
    assert!(of(&sphere, &none, &options).is_ok());
}

#[test]
fn degenerate_meshes_do_not_panic() {
    let cloud = Cloud::default();
    let options = Options::default();
    // No area at all.
    let mut flat = shapes::icosphere(1);
    for p in &mut flat.positions {
        *p = Vec3::zeros();
    }
    let tiny = shapes::grid(1, 1);
    // Far away and very small.
    let mut far = shapes::icosphere(2);
    for p in &mut far.positions {
        *p = *p * 1e-9 + Vec3::repeat(1e3);
    }
    for mesh in [flat, tiny, far] {
        let simple = simplify(&mesh, &cloud, &CreaseLines::default(), &options, None).unwrap();
        assert_eq!(topology(&simple.mesh).euler, topology(&mesh).euler);
    }
}

#[test]
fn no_face_has_two_edges_of_one_smooth_rim() {
    // A cylinder as a surface of revolution; its rims are creases. Its lids are flat, so that few faces would do.
    let around = 48_u32;
    let lid = (1..=8).map(|i| (f64::from(i) / 8.0, 0.0));
    let side = (1..=16).map(|i| (1.0, f64::from(i) / 6.0));
    let top = (1..8).rev().map(|i| (f64::from(i) / 8.0, 16.0 / 6.0));
    let profile: Vec<(f64, f64)> = lid.chain(side).chain(top).collect();
    let at = |ring: u32, k: u32| 1 + ring * around + k % around;
    let last = profile.len() as u32 - 1;
    let pole = 1 + (last + 1) * around;
    let mut positions = vec![Vec3::zeros()];
    let (mut faces, mut edges) = (Vec::new(), Vec::new());
    for (ring, (radius, height)) in (0..).zip(&profile) {
        for k in 0..around {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(around)).sin_cos();
            positions.push(Vec3::new(radius * cos, radius * sin, *height));
            if ring == 0 {
                faces.push([0, at(0, k + 1), at(0, k)]);
            } else {
                faces.push([at(ring - 1, k), at(ring - 1, k + 1), at(ring, k)]);
                faces.push([at(ring - 1, k + 1), at(ring, k + 1), at(ring, k)]);
            }
            if ring == last {
                faces.push([at(last, k), at(last, k + 1), pole]);
            }
            if ring == 7 || ring == 23 {
                edges.push([at(ring, k), at(ring, k + 1)]);
            }
        }
    }
    positions.push(Vec3::new(0.0, 0.0, 16.0 / 6.0));
    let dense = TriangleMesh { positions, faces };
    let creases = CreaseLines {
        edges,
        ..CreaseLines::default()
    };
    for target in [16, 24, 32] {
        let options = Options {
            target_faces: Some(target),
            ..Options::default()
        };
        let simple = run(&dense, &creases, &options);
        check_promises(&dense, &simple);
        for face in &simple.mesh.faces {
            let on_rim = |k: &usize| {
                let (a, b) = (face[*k], face[(*k + 1) % 3]);
                simple.creases.contains(&[a.min(b), a.max(b)])
            };
            let edges = (0..3).filter(on_rim).count();
            assert!(edges < 2, "{face:?} of {} faces", simple.mesh.faces.len());
        }
    }
}
