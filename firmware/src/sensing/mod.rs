//! From tared gauge counts to a contact: wrench, contact solve, uncertainty, validity.
//!
//! Coordinates: the sensor's frame is turned like the tip's; the tip's centre lies at
//! `centre_offset_mm` in it. Forces and moments are those of the object on the tip. Everything is
//! `f32`, closed form, without loops that depend on data.

pub mod contact;
pub mod uncertainty;
pub mod validity;
pub mod wrench;

/// Vectors of the board: mm, N, or N mm.
pub type Vec3 = nalgebra::Vector3<f32>;
