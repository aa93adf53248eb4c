//! Creases of made-up point sets with known edges.

use super::*;
use crate::Vec3;
use crate::cloud::OrientedPoint;
use crate::mesh::{HalfEdgeMesh, shapes, topology};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIGMA: f64 = 0.005;
const SIGMA_NORMAL: f64 = 0.052;

/// Sum of twelve uniform numbers less six: close to a normal distribution.
fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
}

fn noisy(position: Vec3, normal: Vec3, rng: &mut ChaCha8Rng) -> OrientedPoint {
    let shift = Vec3::from_fn(|_, _| gauss(rng)) * SIGMA;
    let turn = Vec3::from_fn(|_, _| gauss(rng)) * SIGMA_NORMAL;
    OrientedPoint {
        position: position + shift,
        normal: (normal + turn).normalize(),
        sigma: None,
        finger: None,
        time_us: None,
    }
}

/// Points of the cube [-a, a]^3.
fn cube_points(count: usize, a: f64) -> Cloud {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut cloud = Cloud::default();
    for i in 0..count {
        let axis = i % 3;
        let mut n = Vec3::zeros();
        n[axis] = if (i / 3) % 2 == 0 { 1.0 } else { -1.0 };
        let mut p = Vec3::from_fn(|_, _| rng.random_range(-a..a));
        p[axis] = a * n[axis];
        cloud.points.push(noisy(p, n, &mut rng));
    }
    cloud
}

/// A dense mesh of the cube with its edges rounded off.
fn rounded_cube(a: f64, radius: f64) -> TriangleMesh {
    let mut mesh = shapes::cube(28);
    for p in &mut mesh.positions {
        let q = *p * a;
        let core = q.map(|x| x.clamp(-(a - radius), a - radius));
        let out = q - core;
        if out.norm() > 0.0 {
            *p = core + out.normalize() * radius;
        } else {
            *p = q;
        }
    }
    mesh
}

/// Distance of `p` to the nearest edge of the cube.
fn off_edge(p: &Vec3, a: f64) -> f64 {
    let mut d: Vec<f64> = p.iter().map(|x| (x.abs() - a).abs()).collect();
    d.sort_by(f64::total_cmp);
    d[0].hypot(d[1])
}

#[test]
fn the_twelve_edges_of_a_noisy_cube_are_found_and_placed() {
    let a = 0.4;
    let found = Sheets::of(&cube_points(1229, a), &CreaseOptions::default())
        .cut(&rounded_cube(a, 0.06), None)
        .unwrap();
    assert_eq!(found.sheets, 6);
    let half = HalfEdgeMesh::new(&found.mesh).unwrap();
    assert_eq!(topology(&found.mesh).genus(), Some(0));
    let mut at = vec![0; half.vertex_slots()];
    let diagonal = 2.0 * a * 3f64.sqrt();
    let mut length = 0.0;
    for &[v, w] in &found.lines.edges {
        at[v as usize] += 1;
        at[w as usize] += 1;
        let (p, q) = (half.position(v), half.position(w));
        length += (p - q).norm();
        for x in [p, q] {
            assert!(
                off_edge(&x, a) < 2e-3 * diagonal,
                "{x} lies {} off",
                off_edge(&x, a)
            );
        }
    }
    assert!((length / (24.0 * a) - 1.0).abs() < 0.05, "{length}");
    assert_eq!(at.iter().filter(|n| **n == 3).count(), 8);
    assert!(at.iter().all(|n| [0, 2, 3].contains(n)));
}

#[test]
fn an_edge_that_hardly_any_point_comes_near_is_an_edge() {
    let a = 0.4;
    let mut cloud = cube_points(374, a);
    // A third of the width off one edge, and all of a corner besides.
    cloud.points.retain(|p| {
        let [x, y, z] = [p.position.x / a, p.position.y / a, p.position.z / a];
        let (edge, corner) = (x > 0.35 && y > 0.35, x < -0.2 && y > 0.0 && z > 0.0);
        !edge && !corner
    });
    let sheets = Sheets::of(&cloud, &CreaseOptions::default());
    let mut labels = sheets.labels().to_vec();
    labels.retain(|l| *l != crate::mesh::NONE);
    labels.sort_unstable();
    labels.dedup();
    assert_eq!(labels.len(), 6);
    assert_eq!(sheets.sharp().len(), 12);
}

#[test]
fn a_face_that_a_gap_parts_is_one_sheet() {
    let a = 0.4;
    let mut cloud = cube_points(1229, a);
    // Seven spacings wide, all across the face.
    cloud
        .points
        .retain(|p| p.normal.x < 0.9 || p.position.y.abs() > 0.16);
    let sheets = Sheets::of(&cloud, &CreaseOptions::default());
    let face = |side: f64| {
        let mut labels: Vec<u32> = (cloud.points.iter().zip(sheets.labels()))
            .filter(|(p, _)| p.normal.x > 0.9 && side * p.position.y > 0.2)
            .map(|(_, label)| *label)
            .collect();
        labels.sort_unstable();
        labels.dedup();
        labels
    };
    assert_eq!(face(1.0).len(), 1);
    assert_eq!(face(1.0), face(-1.0));
    assert_eq!(sheets.sharp().len(), 12);
    // A step of two standard deviations is none.
    for p in &mut cloud.points {
        if p.normal.x > 0.9 && p.position.y > 0.0 {
            p.position.x += 2.0 * SIGMA;
        }
    }
    let sheets = Sheets::of(&cloud, &CreaseOptions::default());
    let mut labels = sheets.labels().to_vec();
    labels.retain(|l| *l != crate::mesh::NONE);
    labels.sort_unstable();
    labels.dedup();
    assert_eq!(labels.len(), 7);
}

/// Points of a cylinder from z = 0 to its height, a quarter of them on its lids.
fn cylinder_points(radius: f64, height: f64) -> Cloud {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut cloud = Cloud::default();
    for i in 0..1229 {
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let (c, s) = (angle.cos(), angle.sin());
        if i % 4 == 0 {
            let r = radius * rng.random_range(0.0f64..1.0).sqrt();
            let z = if i % 8 == 0 { height } else { 0.0 };
            let n = Vec3::z() * if i % 8 == 0 { 1.0 } else { -1.0 };
            cloud
                .points
                .push(noisy(Vec3::new(r * c, r * s, z), n, &mut rng));
        } else {
            let z = rng.random_range(0.0..height);
            let n = Vec3::new(c, s, 0.0);
            cloud
                .points
                .push(noisy(Vec3::new(radius * c, radius * s, z), n, &mut rng));
        }
    }
    cloud
}

/// Mean and largest distance of the crease edges from the rims, against the diagonal, and their length against that of both.
fn off_rims(found: &Creased, radius: f64, height: f64) -> (f64, f64, f64) {
    let diagonal = (8.0 * radius * radius + height * height).sqrt();
    let mut length = 0.0;
    let mut off = Vec::new();
    for &[v, w] in &found.lines.edges {
        let [p, q] = [v, w].map(|v| found.mesh.positions[v as usize]);
        length += (p - q).norm();
        let off_z = p.z.abs().min((p.z - height).abs());
        off.push((p.x.hypot(p.y) - radius).hypot(off_z) / diagonal);
    }
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let most = off.iter().copied().fold(0.0, f64::max);
    (mean, most, length / (2.0 * std::f64::consts::TAU * radius))
}

#[test]
fn the_rims_of_a_noisy_cylinder_are_true_where_its_field_knows_it_for_one() {
    let (radius, height) = (0.3, 0.8);
    let cloud = cylinder_points(radius, height);
    let sheets = Sheets::of(&cloud, &CreaseOptions::default());
    let noise = crate::reconstruct::extract::NoiseEstimate {
        position_sigma: SIGMA,
        normal_sigma: SIGMA_NORMAL,
    };
    let extracted = crate::reconstruct::extract::extract_sheets(
        &cloud,
        &Default::default(),
        sheets.labels(),
        sheets.sharp(),
        &noise,
    )
    .unwrap();
    let found = sheets.cut(&extracted.mesh, Some(&extracted.field)).unwrap();
    let (mean, most, length) = off_rims(&found, radius, height);
    assert!(mean < 1e-3 && most < 2e-3, "mean {mean}, largest {most}");
    assert!((length - 1.0).abs() < 0.02, "{length}");
}

#[test]
fn the_two_rims_of_a_noisy_cylinder_are_found() {
    let (radius, height) = (0.3, 0.8);
    let cloud = cylinder_points(radius, height);
    // The dense mesh: the cylinder with rounded rims, as a surface of revolution over a sphere.
    let mut mesh = shapes::icosphere(4);
    let rounding = 0.05;
    for p in &mut mesh.positions {
        let (r, z) = (p.x.hypot(p.y), p.z);
        // From the sphere to the profile of the cylinder by its support in direction (r, z).
        let (core_r, core_z) = (radius - rounding, 0.5 * height - rounding);
        let stretch = (r / radius).max(z.abs() / (0.5 * height));
        let (qr, qz) = (r / stretch, z / stretch);
        let (cr, cz) = (qr.min(core_r), qz.clamp(-core_z, core_z));
        let (or, oz) = (qr - cr, qz - cz);
        let o = or.hypot(oz).max(1e-12);
        let (nr, nz) = if or.hypot(oz) > 0.0 {
            (cr + or / o * rounding, cz + oz / o * rounding)
        } else {
            (qr, qz)
        };
        let around = if r > 1e-9 { nr / r } else { 0.0 };
        *p = Vec3::new(p.x * around, p.y * around, nz + 0.5 * height);
    }
    let found = Sheets::of(&cloud, &CreaseOptions::default())
        .cut(&mesh, None)
        .unwrap();
    assert_eq!(found.sheets, 3);
    // The side is curved: its sheets reach less far than a cube's and the noise shows more.
    let (mean, most, length) = off_rims(&found, radius, height);
    assert!(mean < 2.5e-3 && most < 5e-3, "mean {mean}, largest {most}");
    assert!((length - 1.0).abs() < 0.05, "{length}");
}

#[test]
fn smooth_shapes_have_no_creases() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for dense in [shapes::torus(0.35, 0.15, 60, 30), shapes::icosphere(4)] {
        let normals = dense.vertex_normals();
        let mut cloud = Cloud::default();
        for s in crate::mesh::sample_by_area(&dense, 1229) {
            let ids = dense.faces[s.face as usize];
            let n: Vec3 = (0..3)
                .map(|k| normals[ids[k] as usize] * s.barycentric[k])
                .sum();
            cloud
                .points
                .push(noisy(s.position, n.normalize(), &mut rng));
        }
        let found = Sheets::of(&cloud, &CreaseOptions::default())
            .cut(&dense, None)
            .unwrap();
        assert!(found.lines.edges.is_empty());
        assert_eq!(found.mesh, dense);
    }
}

#[test]
fn bad_input_is_no_panic() {
    let mesh = shapes::icosphere(1);
    let mut cloud = cube_points(100, 0.4);
    cloud.points[7].position.x = f64::NAN;
    let options = CreaseOptions::default();
    assert_eq!(
        Sheets::of(&cloud, &options).cut(&mesh, None).unwrap().mesh,
        mesh
    );
    assert!(
        Sheets::of(&Cloud::default(), &options)
            .cut(&mesh, None)
            .unwrap()
            .lines
            .edges
            .is_empty()
    );
    let same = Cloud {
        points: vec![cloud.points[0]; 50],
        ..Cloud::default()
    };
    assert!(Sheets::of(&same, &options).cut(&mesh, None).is_ok());
}
