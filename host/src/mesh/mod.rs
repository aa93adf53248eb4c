//! Triangle meshes: the indexed form that travels between stages and files, the half-edge form whose
//! connectivity can be changed, and the questions asked of both.

mod aabb;
mod closest;
mod half_edge;
mod legal;
mod moves;
mod sampling;
#[cfg(test)]
pub(crate) mod shapes;
pub mod topology;
mod triangle_mesh;

pub use aabb::{AabbTree, FootPoint, RayHit};
pub use closest::{closest_on_segment, closest_on_triangle};
pub use half_edge::{Compact, HalfEdgeMesh, MeshError, NONE};
pub use legal::{CollapseTo, Freedom, IllegalMove};
pub use sampling::{Sample, sample_by_area};
pub use topology::{Topology, topology};
pub use triangle_mesh::TriangleMesh;
pub(crate) use triangle_mesh::unit_or_zero;
