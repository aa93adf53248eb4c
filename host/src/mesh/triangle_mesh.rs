//! An indexed triangle mesh: the form in which meshes are handed from stage to stage and to files.
//!
//! Nothing is promised about it beyond the indices' meaning; [`super::topology`] says what it is,
//! [`super::HalfEdgeMesh`] accepts only manifold ones.

use crate::Vec3;

/// Indexed triangles, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Three vertex indices per face.
    pub faces: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The three corners of a face; `None` if the face does not exist or names a vertex that does not.
    pub fn corners(&self, face: u32) -> Option<[Vec3; 3]> {
        let [a, b, c] = *self.faces.get(face as usize)?;
        Some([
            *self.positions.get(a as usize)?,
            *self.positions.get(b as usize)?,
            *self.positions.get(c as usize)?,
        ])
    }

    /// Half the cross product of two edges: the face's normal, as long as the face is large.
    pub fn area_vector(&self, face: u32) -> Vec3 {
        self.corners(face)
            .map_or_else(Vec3::zeros, |[a, b, c]| (b - a).cross(&(c - a)) * 0.5)
    }

    /// Unit normal of a face; zero if it has no area.
    pub fn face_normal(&self, face: u32) -> Vec3 {
        unit_or_zero(self.area_vector(face))
    }

    /// Sum of the faces' areas, in the squared unit of the input.
    pub fn area(&self) -> f64 {
        (0..self.faces.len() as u32)
            .map(|f| self.area_vector(f).norm())
            .sum()
    }

    /// Unit normals at the vertices: the faces' normals weighted by their angle at the vertex (Thürmer
    /// and Wüthrich 1998), which does not depend on how a flat region is triangulated. Zero where no
    /// face with an area touches the vertex.
    pub fn vertex_normals(&self) -> Vec<Vec3> {
        let mut normals = vec![Vec3::zeros(); self.positions.len()];
        for f in 0..self.faces.len() as u32 {
            let Some(corners) = self.corners(f) else {
                continue;
            };
            let normal = self.face_normal(f);
            for k in 0..3 {
                let u = corners[(k + 1) % 3] - corners[k];
                let v = corners[(k + 2) % 3] - corners[k];
                let angle = u.cross(&v).norm().atan2(u.dot(&v));
                normals[self.faces[f as usize][k] as usize] += normal * angle;
            }
        }
        for n in &mut normals {
            *n = unit_or_zero(*n);
        }
        normals
    }

    /// Lowest and highest corner of the bounding box; `None` without vertices.
    pub fn bounding_box(&self) -> Option<(Vec3, Vec3)> {
        let first = *self.positions.first()?;
        Some(
            self.positions
                .iter()
                .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p))),
        )
    }

    /// Length of the bounding box's diagonal; 0 without vertices.
    pub fn diagonal(&self) -> f64 {
        self.bounding_box()
            .map_or(0.0, |(low, high)| (high - low).norm())
    }
}

/// `v` at length 1, or zero if it has no (finite) length.
pub(crate) fn unit_or_zero(v: Vec3) -> Vec3 {
    let length = v.norm();
    if length > 0.0 && length.is_finite() {
        v / length
    } else {
        Vec3::zeros()
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::shapes;

    #[test]
    fn a_fine_sphere_has_the_sphere_s_area_and_normals() {
        let mesh = shapes::icosphere(4);
        assert!((mesh.area() / (4.0 * std::f64::consts::PI) - 1.0).abs() < 3e-3);
        for (p, n) in mesh.positions.iter().zip(mesh.vertex_normals()) {
            assert!((p - n).norm() < 1e-2);
        }
        assert!((mesh.diagonal() - 12f64.sqrt()).abs() < 0.05);
    }
}
