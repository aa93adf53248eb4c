//! An indexed triangle mesh: the form in which meshes are handed from stage to stage and to files.

use crate::Vec3;

/// Indexed triangles, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Three vertex indices per face.
    pub faces: Vec<[u32; 3]>,
}
