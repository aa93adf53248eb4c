//! Points with normals, as measured: what every reader yields and every later stage starts from.

mod neighbourhood;
mod read;
mod write;

pub use neighbourhood::Neighbourhoods;
pub use read::{LARGEST, ReadError, from_bytes, read, read_all};
pub use write::write_ply;

use crate::Vec3;

/// One measured point of the surface with the outward unit normal there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedPoint {
    /// Where the surface was touched, in the unit of the input.
    pub position: Vec3,
    /// Outward unit normal.
    pub normal: Vec3,
    /// Standard deviation of the position per axis where the source states one, in the unit of the input.
    pub sigma: Option<f64>,
    /// Which finger (or other source) measured it, where known.
    pub finger: Option<u16>,
    /// When it was measured, microseconds of the host's clock since the Unix epoch, where known.
    pub time_us: Option<i64>,
}

/// A row of an input that was left out, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RejectedRow {
    /// File the row came from.
    pub file: String,
    /// Line (text formats, from 1) or record (binary formats, from 1).
    pub line: usize,
    /// What is wrong with it, with the value.
    pub reason: String,
}

/// Points with normals, in the order they were read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// The usable points.
    pub points: Vec<OrientedPoint>,
    /// The rows that were dropped.
    pub rejected: Vec<RejectedRow>,
}

impl Cloud {
    /// Lowest and highest corner of the bounding box; `None` without points.
    pub fn bounding_box(&self) -> Option<(Vec3, Vec3)> {
        let first = self.points.first()?.position;
        Some(self.points.iter().fold((first, first), |(low, high), p| {
            (low.inf(&p.position), high.sup(&p.position))
        }))
    }

    /// Length of the bounding box's diagonal; 0 without points.
    pub fn diagonal(&self) -> f64 {
        self.bounding_box()
            .map_or(0.0, |(low, high)| (high - low).norm())
    }
}
