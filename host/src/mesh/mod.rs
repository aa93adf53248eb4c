//! Triangle meshes.

mod triangle_mesh;

pub use triangle_mesh::TriangleMesh;
