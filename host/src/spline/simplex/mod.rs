//! Simplex splines and triangular B-splines of degree 1 to 5 over planar triangulations.
//!
//! Every vertex of the triangulation carries a cloud of n + 1 knots, its own position first. With the
//! knots in general position the splines are C^(n-1) everywhere; with each cloud pulled together on its
//! vertex they become the Bernstein polynomials of the triangle.
//!
//! | file | holds |
//! |---|---|
//! | `orientation` | on which side of a line a point lies: exact, with the half-open rule |
//! | `recursion` | M(u\|V) by the plain recursion: slow, short, the yardstick for the rest |
//! | `program` | the same recursion with shared sub-terms, laid out once per triangle |
//! | `knot_net` | triangulation with knot clouds; normalised basis functions N(u\|V_beta) |
//! | `spline` | surface (or any other value) over a knot net, with derivatives |
//! | `polynomial` | polynomials of the plane and their blossoms |
//!
//! Guaranteed: partition of unity wherever all triangles whose knots reach the point are part of the net;
//! decisions about sides are exact, so no point is counted twice or lost on a knot line. Not guaranteed:
//! accuracy where three knots of a triangle are almost on one line compared with its size.
//!
//! Sources: Dahmen, Micchelli, Seidel, "Blossoming begets B-spline bases built better by B-patches"
//! (1992); section 3 of "Curved Surface Reconstruction Using Active Tactile Sensing and Surface Normal
//! Information".
//!
//! Two ways to evaluate were weighed: recursion per basis function (short, but the same smaller simplex
//! splines are computed again and again) and a program per triangle in which each subset of knots stands
//! once. The second was taken for the net; the first is kept as the yardstick of the tests.

mod knot_net;
mod orientation;
mod polynomial;
mod program;
mod recursion;
mod spline;
#[cfg(test)]
mod tests;

pub use knot_net::{KnotNet, Workspace};
pub use orientation::{Approach, side_of_line};
pub use polynomial::{Blend, PlanarPolynomial};
pub use program::Jet;
pub use recursion::{simplex_spline, simplex_spline_derivative};
pub use spline::TriangularBSpline;

/// Point or direction of the parameter plane.
pub type Vec2 = nalgebra::Vector2<f64>;

/// Highest degree of the simplex splines here.
pub const MAX_DEGREE: usize = 5;

/// Why a knot net or a spline over it was refused; every variant says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimplexError {
    /// The degree is not 1 to 5.
    #[error("degree {0} is not supported: use 1 to {MAX_DEGREE}")]
    Degree(usize),
    /// A vertex does not carry degree + 1 knots.
    #[error("vertex {vertex} carries {found} knots, but degree {degree} needs {}: give each vertex degree + 1 knots", degree + 1)]
    KnotCount {
        /// The vertex.
        vertex: usize,
        /// Knots it carries.
        found: usize,
        /// Degree of the net.
        degree: usize,
    },
    /// A knot is NaN or infinite.
    #[error("knot {knot} of vertex {vertex} is ({x}, {y}): use finite coordinates")]
    KnotNotFinite {
        /// The vertex.
        vertex: usize,
        /// Number in the cloud.
        knot: usize,
        /// Abscissa.
        x: f64,
        /// Ordinate.
        y: f64,
    },
    /// A triangle names a vertex that does not exist.
    #[error(
        "triangle {triangle} names vertex {vertex}, but there are only {vertices}: correct the triangle list"
    )]
    NoSuchVertex {
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices there are.
        vertices: usize,
    },
    /// Knots of a triangle's clouds do not form counter-clockwise triangles.
    #[error(
        "triangle {triangle}: knots {knots:?} of its vertices do not form a counter-clockwise triangle: \
             list its vertices counter-clockwise, or keep the knots closer to their vertices"
    )]
    Folded {
        /// The triangle.
        triangle: usize,
        /// Number of the knot in each of its three clouds.
        knots: [usize; 3],
    },
    /// The number of control points does not fit the net.
    #[error(
        "{found} control points given, but the net has {expected} basis functions: give one for each"
    )]
    ControlCount {
        /// Control points given.
        found: usize,
        /// Basis functions of the net.
        expected: usize,
    },
}

/// Number of barycentric exponents of a degree: (n + 1)(n + 2) / 2.
pub const fn exponent_count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

/// Barycentric exponents (b0, b1, b2) of a degree, numbered as control points are everywhere: b0 falling,
/// then b1 falling.
pub fn exponents(degree: usize) -> impl Iterator<Item = [usize; 3]> + Clone {
    (0..=degree)
        .flat_map(move |rest| (0..=rest).map(move |last| [degree - rest, rest - last, last]))
}
