//! A simulated hand that explores an object: the truth, never handed to `reconstruct`.

pub mod object;

pub use object::{Foot, Object, ObjectError};
