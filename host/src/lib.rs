//! From contacts to a smooth surface.
//!
//! The folders follow the way of one contact: [`cloud`] holds world points with normals, [`mesh`] the
//! triangle meshes, [`spline`] the patches and their gluing, [`reconstruct`] the four phases that lead
//! from the first to the last. Everything is `f64`; lengths are in the unit of the input.

pub mod cloud;
pub mod demo;
pub mod evaluate;
pub mod export;
pub mod hand;
pub mod import;
pub mod link;
pub mod live;
pub mod mesh;
pub mod picture;
pub mod ply;
pub mod reconstruct;
pub mod report;
pub mod run;
pub mod simulate;
pub mod spline;

/// A point or a direction in space; lengths in the unit of the input.
pub type Vec3 = nalgebra::Vector3<f64>;
