//! What can be asked of the extraction, and why it may refuse.

use super::kernel::Kernel;

/// How the field is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Local Gaussian-process fits to positions and normals together, blended.
    Hermite(Kernel),
    /// The paper's: distance to the nearest averaged tangent plane (section 4.1).
    TangentPlanes,
}

/// What the lattice will take, before any of it is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Cubes of the lattice that hold surface.
    pub cubes: usize,
    /// Bytes of field and lattice.
    pub bytes: usize,
    /// Bytes allowed.
    pub limit: usize,
}

/// What to extract and how far to go.
#[derive(Clone, Debug)]
pub struct Options {
    /// How the field is made.
    pub method: Method,
    /// Contacts per local fit, 8 to 500; more carry further across gaps and cost with the second power.
    pub neighbours: usize,
    /// Spacing of the lattice in the unit of the input; from the data if `None`.
    pub spacing: Option<f64>,
    /// Widest gap of the data that is closed, as the diameter of a disc that fits into it, in the unit of the
    /// input; from the data, hole by hole, if `None`.
    pub max_gap: Option<f64>,
    /// Most bytes that extraction, simplification and fit may each take; refused beforehand if one would take more.
    pub max_memory: usize,
    /// Told what the lattice will take, before it is made; more than once where it is made again.
    pub announce: fn(Estimate),
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Hermite(Kernel::Septic),
            neighbours: 80,
            spacing: None,
            max_gap: None,
            max_memory: 2 << 30,
            announce: |_| {},
        }
    }
}

impl Options {
    pub(super) fn check(&self) -> Result<(), ExtractError> {
        let positive = |name, value: Option<f64>| match value {
            Some(v) if !(v.is_finite() && v > 0.0) => Err(ExtractError::BadOption {
                name,
                value: v,
                range: "a finite length above 0",
            }),
            _ => Ok(()),
        };
        positive("spacing", self.spacing)?;
        positive("max_gap", self.max_gap)?;
        if !(8..=500).contains(&self.neighbours) {
            return Err(ExtractError::BadOption {
                name: "neighbours",
                value: self.neighbours as f64,
                range: "8 to 500",
            });
        }
        Ok(())
    }
}

/// Fewest contacts a surface is extracted from.
pub const LEAST_CONTACTS: usize = 6;

/// Why nothing could be extracted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExtractError {
    /// Too few usable contacts.
    #[error(
        "{found} usable contacts are too few for a surface; at least {LEAST_CONTACTS} are needed: touch more of the object"
    )]
    TooFewContacts {
        /// How many there are.
        found: usize,
    },
    /// A coordinate or normal is not finite.
    #[error(
        "contact {index} has a position, normal or sigma that is not finite or a normal of length 0: drop it when reading"
    )]
    NotFinite {
        /// Its index in the cloud.
        index: usize,
    },
    /// All contacts are on one point or line.
    #[error("all contacts lie on a {what}, which spans no surface: touch the object elsewhere too")]
    NoExtent {
        /// "point" or "line".
        what: &'static str,
    },
    /// An option is out of range.
    #[error("option {name} is {value}, but it has to be {range}")]
    BadOption {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// The lattice would take too much memory.
    #[error(
        "a lattice of spacing {spacing} would take about {needed} bytes, more than the {limit} allowed: use a wider spacing or allow more memory"
    )]
    TooMuchMemory {
        /// Spacing asked for, unit of the input.
        spacing: f64,
        /// Bytes it would take.
        needed: usize,
        /// Bytes allowed.
        limit: usize,
    },
    /// The field has no zero set near the contacts.
    #[error(
        "the contacts fit no common surface: check that normals point outward and belong to their positions"
    )]
    NoSurface,
}
