//! The four phases, and the driver that runs them. The only place where cloud, mesh and spline meet.

pub mod averaging;
pub mod chart;
pub mod creases;
mod driver;
pub mod extract;
pub mod fit;
pub mod frame;
mod quadric;
pub mod refine;
mod repeats;
pub mod simplify;
pub mod surfacing;

pub use driver::{Options, Progress, ReconstructError, Reconstruction, Stage, reconstruct};
