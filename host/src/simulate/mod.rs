//! A simulated hand that explores an object, and what is true about both.
//!
//! ```text
//! object        exact shape: foot points, normals, signed distance
//! touch         a ball that touches and never digs in
//! waypoints     places it can touch, evenly spread, and roads between them
//! itinerary     who touches what in which order; finger: joint angles for it
//! motion        one finger, period by period
//! fingertip     touch -> wrench at the sensor; gauges: wrench -> counts
//! bench         all that around a real board of `palpus-firmware`
//! hand          a thread and a pseudo-terminal per board
//! point_set     or only the points, without boards
//! ```
//!
//! The mathematics of sensing is the firmware's own; here is only its inverse, from a touch to counts. What is
//! true is for checks and never goes to `reconstruct`.
//!
//! Not simulated: collisions of links and of fingers with each other, the weight of the tip, elasticity of tip
//! and object, more than one contact per tip (in a groove the tip touches the nearer flank).

mod bench;
mod finger;
mod fingertip;
mod gauges;
mod hand;
mod itinerary;
mod motion;
mod noise;
pub mod object;
mod point_set;
mod touch;
mod track;
mod waypoints;

pub use bench::TrueContact;
pub use gauges::GaugeFaults;
pub use hand::{FingerPort, HandOptions, Noise, SimulatedHand, TIP_RADIUS_MM};
pub use object::{Foot, Object, ObjectError};
pub use point_set::PointSet;

/// Why a hand cannot be simulated, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// Not that many fingers.
    #[error("{asked} fingers: the simulated hand has 1 to {known}")]
    Fingers {
        /// What was asked for.
        asked: usize,
        /// Fingers of the shipped hand.
        known: usize,
    },
    /// An option out of its range.
    #[error("{name} {value}: choose {low} to {high}")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Least.
        low: f64,
        /// Most.
        high: f64,
    },
    /// Nothing of the object can be touched.
    #[error(
        "{object}: no finger can touch it anywhere; it should be 50 to 220 mm long (see --size)"
    )]
    OutOfReach {
        /// The object.
        object: String,
    },
    /// A board cannot be set up.
    #[error("the board of finger {finger} cannot be set up: {reason}")]
    Board {
        /// The finger.
        finger: String,
        /// Why.
        reason: String,
    },
    /// The system gives no pseudo-terminal.
    #[error("no pseudo-terminal: {reason}; check that /dev/ptmx is there and may be opened")]
    Terminal {
        /// Why.
        reason: String,
    },
    /// The shipped hand is broken.
    #[error(transparent)]
    Hand(#[from] crate::hand::HandError),
}
