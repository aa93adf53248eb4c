//! A chart: a disk-like surface as one triangular B-spline over a region of the parameter plane.
//!
//! The spline lives over a planar triangulation with knots in general position, so it is C^(n-1) across every
//! knot line; the triangulation reaches beyond the region by a ring of triangles, so that the basis functions
//! sum to 1 up to the border. The region is bounded by one closed polygon.
//!
//! | file | holds |
//! |---|---|
//! | `knots` | knot clouds for a triangulation: proper, within bounds, turned away from edges |
//! | `partition` | a region cut into convex polygons |
//! | `pieces` | the chart as Bézier triangles over the cells of its knot lines |
//! | `sampling` | triangles for viewers, up to the border |
//! | `measures` | continuity of normal and curvature, regularity |

mod knots;
mod measures;
mod partition;
pub(super) mod pieces;
mod sampling;
#[cfg(test)]
pub(crate) mod shapes;

pub use knots::{CloudBounds, knot_clouds};
pub use measures::ChartMeasures;
pub use pieces::Pieces;

use super::local_shape::LocalShape;
use super::simplex::{Jet, SimplexError, TriangularBSpline, Vec2, Workspace};
use crate::Vec3;

/// Why something is no chart.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ChartError {
    /// Net and control points do not fit together.
    #[error(transparent)]
    Simplex(#[from] SimplexError),
    /// The border is no polygon around an area.
    #[error(
        "the border of the region has {0} corners and runs around no area: give at least three, counter-clockwise"
    )]
    Border(usize),
    /// The border leaves the triangulation.
    #[error(
        "the border of the region leaves the triangulation near ({x}, {y}): add triangles there"
    )]
    Uncovered {
        /// Abscissa.
        x: f64,
        /// Ordinate.
        y: f64,
    },
    /// Lists of different lengths.
    #[error("{found} standard deviations for {vertices} vertices: give one for each, or none")]
    Sigma {
        /// Given.
        found: usize,
        /// Vertices of the triangulation.
        vertices: usize,
    },
    /// The pieces do not form a surface.
    #[error("the chart cannot be cut into pieces ({0}); reconstruct again with another tolerance")]
    Pieces(String),
}

/// One triangular B-spline over a region.
#[derive(Clone, Debug)]
pub struct Chart {
    spline: TriangularBSpline<Vec3>,
    border: Vec<Vec2>,
    sigma: Vec<f64>,
    /// Triangles that meet the region, in rising order.
    inner: Vec<u32>,
}

impl PartialEq for Chart {
    /// Same knots, triangles, control points, region and deviations.
    fn eq(&self, other: &Self) -> bool {
        let (net, theirs) = (self.spline.net(), other.spline.net());
        net.degree() == theirs.degree()
            && net.triangles() == theirs.triangles()
            && net.vertices() == theirs.vertices()
            && (0..net.vertices()).all(|v| net.cloud(v) == theirs.cloud(v))
            && self.spline.control_points() == other.spline.control_points()
            && self.border == other.border
            && self.sigma == other.sigma
    }
}

impl Chart {
    /// From a spline, the corners of the region counter-clockwise, and the standard deviation of the position
    /// per vertex of the triangulation (or none).
    ///
    /// # Errors
    /// A border that is no polygon or leaves the triangulation; standard deviations of another number.
    pub fn new(
        spline: TriangularBSpline<Vec3>,
        border: Vec<Vec2>,
        sigma: Vec<f64>,
    ) -> Result<Self, ChartError> {
        let twice: f64 = (0..border.len())
            .map(|k| border[k].perp(&border[(k + 1) % border.len()]))
            .sum();
        if border.len() < 3 || !twice.is_finite() || twice <= 0.0 {
            return Err(ChartError::Border(border.len()));
        }
        let mut chart = Self {
            spline,
            border,
            sigma: Vec::new(),
            inner: Vec::new(),
        }
        .with_sigma(sigma)?;
        let mut meets = vec![false; chart.spline.net().triangles().len()];
        for corner in &chart.border {
            match chart.triangle_at(*corner) {
                Some((triangle, _)) => meets[triangle] = true,
                None => {
                    return Err(ChartError::Uncovered {
                        x: corner.x,
                        y: corner.y,
                    });
                }
            }
        }
        const STEPS: usize = 8;
        for (triangle, meets) in meets.iter_mut().enumerate() {
            let corners = chart.corners(triangle);
            *meets |= (0..=STEPS).any(|i| {
                (0..=STEPS - i).any(|j| {
                    let k = STEPS - i - j;
                    let u = (corners[0] * i as f64 + corners[1] * j as f64 + corners[2] * k as f64)
                        / STEPS as f64;
                    chart.contains(u)
                })
            });
        }
        chart.inner = (0..meets.len() as u32)
            .filter(|t| meets[*t as usize])
            .collect();
        Ok(chart)
    }

    /// The spline.
    pub fn spline(&self) -> &TriangularBSpline<Vec3> {
        &self.spline
    }

    /// Corners of the region, counter-clockwise.
    pub fn border(&self) -> &[Vec2] {
        &self.border
    }

    /// Standard deviation of the position per vertex of the triangulation; empty if unknown.
    pub fn sigma(&self) -> &[f64] {
        &self.sigma
    }

    /// The same chart with a standard deviation per vertex.
    ///
    /// # Errors
    /// As [`Chart::new`].
    pub fn with_sigma(mut self, sigma: Vec<f64>) -> Result<Self, ChartError> {
        let vertices = self.spline.net().vertices();
        if !sigma.is_empty() && sigma.len() != vertices {
            return Err(ChartError::Sigma {
                found: sigma.len(),
                vertices,
            });
        }
        self.sigma = sigma;
        Ok(self)
    }

    /// Degree of the spline; it is continuously differentiable one time less.
    pub fn degree(&self) -> usize {
        self.spline.net().degree()
    }

    /// Triangles that meet the region; the others are the ring around it.
    pub fn inner_triangles(&self) -> &[u32] {
        &self.inner
    }

    /// Positions of a triangle's vertices in the parameter plane.
    pub fn corners(&self, triangle: usize) -> [Vec2; 3] {
        let net = self.spline.net();
        net.triangles()[triangle].map(|v| net.cloud(v as usize)[0])
    }

    /// The same chart with its control points (and their deviations, times `scale`) moved.
    pub fn mapped(&self, scale: f64, map: impl Fn(Vec3) -> Vec3) -> Self {
        let mut out = self.clone();
        for point in out.spline.control_points_mut() {
            *point = map(*point);
        }
        for sigma in &mut out.sigma {
            *sigma *= scale;
        }
        out
    }

    /// Whether `u` lies in the region.
    pub fn contains(&self, u: Vec2) -> bool {
        inside(&self.border, u)
    }

    /// Value and derivatives to second order; `None` beyond the reach of the knots.
    pub fn jet(&self, u: Vec2, workspace: &mut Workspace) -> Option<Jet<Vec3>> {
        self.spline.jet(u, workspace)
    }

    /// Normal and curvatures at `u`; `None` where the surface is not regular.
    pub fn local_shape(&self, u: Vec2, workspace: &mut Workspace) -> Option<LocalShape> {
        let jet = self.jet(u, workspace)?;
        LocalShape::new(jet.gradient, jet.hessian)
    }

    /// The triangle around `u`, and its barycentric coordinates there.
    pub fn triangle_at(&self, u: Vec2) -> Option<(usize, [f64; 3])> {
        let net = self.spline.net();
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        for triangle in net.triangles_at(u) {
            let [a, b, c] = self.corners(triangle);
            let area = (b - a).perp(&(c - a));
            let at = [
                (b - u).perp(&(c - u)) / area,
                (c - u).perp(&(a - u)) / area,
                (a - u).perp(&(b - u)) / area,
            ];
            let least = at[0].min(at[1]).min(at[2]);
            if best.is_none_or(|(other, ..)| least > other) {
                best = Some((least, triangle, at));
            }
        }
        best.filter(|(least, ..)| *least > -1e-9)
            .map(|(_, triangle, at)| (triangle, at))
    }

    /// Standard deviation of the position at `u`, linear over each triangle; `None` if unknown.
    pub fn sigma_at(&self, u: Vec2) -> Option<f64> {
        if self.sigma.is_empty() {
            return None;
        }
        let (triangle, at) = self.triangle_at(u)?;
        let corners = self.spline.net().triangles()[triangle];
        Some(
            (0..3)
                .map(|k| at[k] * self.sigma[corners[k] as usize])
                .sum(),
        )
    }

    /// Typical edge length of the triangulation in the parameter plane.
    pub(super) fn edge_length(&self) -> f64 {
        let mut sum = 0.0;
        for triangle in &self.inner {
            let [a, b, c] = self.corners(*triangle as usize);
            sum += (b - a).norm() + (c - b).norm() + (a - c).norm();
        }
        sum / (3 * self.inner.len().max(1)) as f64
    }
}

/// Whether a point lies inside a polygon (even-odd rule).
pub(crate) fn inside(polygon: &[Vec2], u: Vec2) -> bool {
    let mut inside = false;
    for (k, a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        if (a.y > u.y) != (b.y > u.y) {
            let x = a.x + (u.y - a.y) / (b.y - a.y) * (b.x - a.x);
            inside ^= u.x < x;
        }
    }
    inside
}

/// Nearest point of a polygon's border: its place as (side, share of the side) and the point.
pub(crate) fn nearest_on_border(polygon: &[Vec2], u: Vec2) -> (usize, f64, Vec2) {
    let mut best = (0, 0.0, polygon.first().copied().unwrap_or(u));
    let mut least = f64::INFINITY;
    for (k, a) in polygon.iter().enumerate() {
        let side = polygon[(k + 1) % polygon.len()] - a;
        let t = ((u - a).dot(&side) / side.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let point = a + side * t;
        let distance = (u - point).norm_squared();
        if distance < least {
            least = distance;
            best = (k, t, point);
        }
    }
    best
}
