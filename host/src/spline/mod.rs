//! Splines over triangles: mathematics only; knows no file, no cloud and no serial line.

pub mod bernstein;
pub mod chart;
pub mod conversion;
pub mod edges;
pub mod energy;
pub mod local_shape;
mod measures;
pub mod network;
pub mod query;
mod sampling;
pub mod simplex;
mod surface;

pub use measures::{Measures, PLACES, Topology, angle_degrees, patch_regularity};
pub use sampling::{Fineness, MAX_SEGMENTS, SampledSurface};
pub use surface::{Surface, SurfaceError, casteljau, combine, point_and_tangents};
