//! A simulated hand that explores an object: the truth, never handed to `reconstruct`.

mod finger;
mod gauges;
mod itinerary;
mod motion;
mod noise;
pub mod object;
mod point_set;
mod touch;
mod track;
mod waypoints;

pub use object::{Foot, Object, ObjectError};
pub use point_set::PointSet;
