//! A simulated hand that explores an object: the truth, never handed to `reconstruct`.

mod finger;
pub mod object;
mod touch;

pub use object::{Foot, Object, ObjectError};
