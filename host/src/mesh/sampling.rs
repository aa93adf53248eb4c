//! Points spread over a mesh, evenly by area and the same on every run.

use super::TriangleMesh;
use crate::Vec3;

/// A sample of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The face it lies in.
    pub face: u32,
    /// Barycentric coordinates in that face.
    pub barycentric: [f64; 3],
    /// The point itself.
    pub position: Vec3,
}

/// `count` points with equal shares of the area, in the order of the faces.
///
/// The i-th point lies where the running area reaches (i + 1/2) / count of the whole; inside the face the
/// two remaining coordinates come from the R2 sequence (fractional parts of i times the powers of the
/// inverse plastic number), so neighbouring samples do not line up. No random numbers. A mesh without
/// area gives no samples.
pub fn sample_by_area(mesh: &TriangleMesh, count: usize) -> Vec<Sample> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let total = mesh.area();
    let mut out = Vec::with_capacity(count);
    if !(total > 0.0 && total.is_finite()) {
        return out;
    }
    let mut reached = 0.0;
    let step = total / count as f64;
    for f in 0..mesh.faces.len() as u32 {
        let Some([a, b, c]) = mesh.corners(f) else {
            continue;
        };
        reached += mesh.area_vector(f).norm();
        while out.len() < count && (out.len() as f64 + 0.5) * step <= reached {
            let i = (out.len() + 1) as f64;
            let (mut s, mut t) = ((i / PLASTIC).fract(), (i / (PLASTIC * PLASTIC)).fract());
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let w = [1.0 - s - t, s, t];
            out.push(Sample {
                face: f,
                barycentric: w,
                position: a * w[0] + b * w[1] + c * w[2],
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    #[test]
    fn every_eighth_of_a_sphere_gets_its_share() {
        let samples = sample_by_area(&shapes::icosphere(3), 8000);
        assert_eq!(samples.len(), 8000);
        let mut octants = [0; 8];
        for s in &samples {
            let sign = |x: f64| usize::from(x > 0.0);
            octants[sign(s.position.x) + 2 * sign(s.position.y) + 4 * sign(s.position.z)] += 1;
        }
        assert!(
            octants.iter().all(|n| (900..1100).contains(n)),
            "{octants:?}"
        );
    }

    #[test]
    fn spread_inside_one_face_is_even() {
        let mesh = TriangleMesh {
            positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y()],
            faces: vec![[0, 1, 2]],
        };
        let samples = sample_by_area(&mesh, 400);
        let mean = samples.iter().map(|s| s.position).sum::<Vec3>() / 400.0;
        assert!(
            (mean - Vec3::new(1.0 / 3.0, 1.0 / 3.0, 0.0)).norm() < 0.01,
            "{mean}"
        );
        assert!(sample_by_area(&TriangleMesh::default(), 5).is_empty());
    }
}
