//! Splines over triangles: mathematics only; knows no file, no cloud and no serial line.

pub mod bernstein;
mod surface;

pub use surface::{SampledSurface, Surface};
