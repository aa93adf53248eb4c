//! Truth about the truth: distance, normal and foot point agree with each other and with closed forms.

use super::*;
use crate::mesh::topology;
use proptest::prelude::*;
use std::sync::LazyLock;

static OBJECTS: LazyLock<Vec<Object>> = LazyLock::new(|| {
    let mut objects: Vec<Object> = Object::NAMES
        .iter()
        .map(|name| Object::named(name).unwrap())
        .collect();
    let tetrahedron = TriangleMesh {
        positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    };
    objects.push(Object::from_mesh("tetrahedron", &tetrahedron, Some(120.0)).unwrap());
    objects
});

fn object(name: &str) -> &'static Object {
    OBJECTS.iter().find(|o| o.name() == name).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn foot_is_on_the_surface_and_no_sample_is_nearer(
        which in 0..OBJECTS.len(),
        x in -130.0..130.0f64, y in -130.0..130.0f64, z in -90.0..90.0f64,
    ) {
        let object = &OBJECTS[which];
        let point = Vec3::new(x, y, z);
        let foot = object.foot(&point);
        prop_assert!((foot.normal.norm() - 1.0).abs() < 1e-9);
        // The foot is as far as it says, and is its own foot.
        prop_assert!(((point - foot.position_mm).norm() - foot.distance_mm.abs()).abs() < 1e-9);
        prop_assert!(object.foot(&foot.position_mm).distance_mm.abs() < 1e-7);
        // Along the normal, on the side the sign says (kinks between blends leave the walk 1e-3 rad off).
        if foot.distance_mm.abs() > 0.1 && (object.is_smooth() || foot.distance_mm > 0.0) {
            let along = (point - foot.position_mm).normalize() * foot.distance_mm.signum();
            prop_assert!((along - foot.normal).norm() < 2e-3, "{} {along} {}", object.name(), foot.normal);
        }
        // A coarse sampling of the surface finds nothing nearer.
        for sample in object.truth_mesh().positions.iter().step_by(7) {
            prop_assert!((point - sample).norm() >= foot.distance_mm.abs() - 1e-6, "{}", object.name());
        }
    }

    #[test]
    fn closed_forms_agree(x in -130.0..130.0f64, y in -130.0..130.0f64, z in -90.0..90.0f64) {
        let point = Vec3::new(x, y, z);
        let sphere = object("sphere").foot(&point);
        prop_assert!((sphere.distance_mm - (point.norm() - 60.0)).abs() < 1e-8);
        let torus = object("torus").foot(&point);
        let ring = (x.hypot(y) - 60.0).hypot(z) - 28.0;
        prop_assert!((torus.distance_mm - ring).abs() < 1e-8);
    }

    #[test]
    fn closed_forms_agree_near_focal_points(
        x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64,
        exponent in -3.0..1.0f64, azimuth in 0.0..6.2f64,
    ) {
        let off = Vec3::new(x, y, z) * 10f64.powf(exponent);
        let sphere = object("sphere").foot(&off);
        prop_assert!((sphere.distance_mm - (off.norm() - 60.0)).abs() < 1e-8, "{}", sphere.distance_mm);
        let near_core = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0) * 60.0 + off;
        let torus = object("torus").foot(&near_core);
        let ring = (near_core.x.hypot(near_core.y) - 60.0).hypot(near_core.z) - 28.0;
        prop_assert!((torus.distance_mm - ring).abs() < 1e-8, "{} {ring}", torus.distance_mm);
    }
}

#[test]
fn distance_has_slope_one_along_the_normal() {
    for object in OBJECTS.iter() {
        for foot in object.sample(300) {
            let out = foot.position_mm + foot.normal * 0.5;
            let distance = object.foot(&out).distance_mm;
            assert!(
                (distance - 0.5).abs() < 1e-6,
                "{} {distance}",
                object.name()
            );
            let inside = object.foot(&(foot.position_mm - foot.normal * 1e-3));
            assert!(inside.distance_mm < 0.0, "{}", object.name());
        }
    }
}

#[test]
fn samples_share_the_area_evenly() {
    // By symmetry the mean of a sphere's, torus's, cube's and cylinder's samples is the centre.
    for name in ["sphere", "torus", "cube", "cylinder"] {
        let samples = object(name).sample(2000);
        assert_eq!(samples.len(), 2000);
        let mean = samples.iter().map(|s| s.position_mm).sum::<Vec3>() / 2000.0;
        assert!(mean.norm() < 1.0, "{name} {mean}");
    }
}

#[test]
fn truth_meshes_are_closed() {
    for object in OBJECTS.iter() {
        let counted = topology(&object.truth_mesh());
        assert!(
            counted.is_manifold() && counted.border_loops == 0,
            "{}",
            object.name()
        );
        assert_eq!(counted.components, 1);
    }
}

#[test]
fn edges_of_the_cube_have_the_normal_of_the_ball_that_touches_them() {
    let foot = object("cube").foot(&Vec3::new(62.0, 66.0, 0.0));
    assert_eq!(foot.position_mm, Vec3::new(50.0, 50.0, 0.0));
    assert!((foot.normal - Vec3::new(0.6, 0.8, 0.0)).norm() < 1e-12);
    assert!((foot.distance_mm - 20.0).abs() < 1e-12);
}

#[test]
fn meshes_that_enclose_nothing_are_refused() {
    let refused = |faces: Vec<[u32; 3]>| {
        let mesh = TriangleMesh {
            positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()],
            faces,
        };
        Object::from_mesh("m.stl", &mesh, None)
            .unwrap_err()
            .to_string()
    };
    assert!(refused(vec![]).contains("no faces"));
    let open = refused(vec![[0, 2, 1], [0, 1, 3], [1, 2, 3]]);
    assert!(open.contains("3 edges with one face only"), "{open}");
    let turned = refused(vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 2, 3]]);
    assert!(turned.contains("disagree"), "{turned}");
    let unknown = Object::named("spoon").unwrap_err().to_string();
    assert!(unknown.contains("two-holed-torus"), "{unknown}");
}

#[test]
fn a_mesh_inside_out_is_turned() {
    let mesh = TriangleMesh {
        positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()],
        faces: vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]],
    };
    let object = Object::from_mesh("inside out", &mesh, Some(100.0)).unwrap();
    assert!(object.foot(&Vec3::new(-20.0, -20.0, -20.0)).distance_mm < 0.0);
    assert!(object.foot(&Vec3::new(90.0, 90.0, 90.0)).distance_mm > 0.0);
}
