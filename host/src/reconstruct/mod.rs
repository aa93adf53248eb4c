//! The four phases, and the driver that runs them. The only place where cloud, mesh and spline meet.

pub mod extract;
pub mod fit;
pub mod refine;
pub mod simplify;
pub mod surfacing;
