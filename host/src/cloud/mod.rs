//! Points with normals, as measured: what every reader yields and every later stage starts from.
//!
//! # Reading and writing
//! [`from_bytes`] and `read` take PLY, PCD and text (XYZ, CSV), told apart by content first and extension
//! second; [`write_ply`] writes what they read back.
//!
//! # What a point file has to hold
//! Six values per point: position and outward normal. Normals need not be unit. Optional columns `sigma`
//! (standard deviation of the position; not positive or not finite counts as unknown), `finger` and
//! `time_us` are kept wherever columns have names; all other columns are ignored.
//!
//! | format | columns |
//! |---|---|
//! | PLY 1.0, ascii, binary little and big endian | properties `x y z nx ny nz` (also `normal_x` …) of element `vertex`, in any order and type, with any others, lists included |
//! | PCD 0.7, ascii, binary, binary_compressed | fields `x y z normal_x normal_y normal_z` (also `nx` …) |
//! | text | six columns, or the columns that a header line names; separated by blanks, tabs, commas or semicolons; comments begin with `#`, `//` or `%` |
//!
//! # What is promised
//! Rows with a value that is NaN, infinite or beyond [`LARGEST`], or with a zero normal, are left out and
//! listed in [`Cloud::rejected`]; a file of which more than half is such is refused. Anything that is no
//! number is refused with file, line and value. On any bytes: no panic, and no more memory than in
//! proportion to the file.

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

/// Exact points spread evenly over the unit ball's surface, for tests.
#[cfg(test)]
pub(crate) fn unit_ball(count: usize) -> Cloud {
    let point = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (sin, cos) = (2.399_963_229_728_653 * k as f64).sin_cos();
        let normal = Vec3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z);
        OrientedPoint {
            position: normal,
            normal,
            sigma: None,
            finger: None,
            time_us: None,
        }
    };
    Cloud {
        points: (0..count).map(point).collect(),
        rejected: Vec::new(),
    }
}
