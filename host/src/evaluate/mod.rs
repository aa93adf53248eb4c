//! How far two shapes are from each other: distances both ways, angles between normals, topology of both.
//!
//! A shape is a surface file, a mesh or a set of points with normals ([`Shape`]). Three figures come out of
//! [`compare`]:
//! - *accuracy*: from samples of the shape in question, spread evenly by area, to the reference;
//! - *completeness*: from samples of the reference (from its points, if it is points) to the shape;
//! - *normals*: angle between the two shapes' normals, at the accuracy's samples and their foot points.
//!
//! # What is exact
//! Distances to a mesh are distances to its triangles. Distances to a surface are to the patches themselves
//! (Newton's method from the nearest of a fine mesh, crossing into neighbours), not to a mesh of them.
//! Distances to points are estimates: [`points::PointSet`] bridges the gaps between points by their tangent planes.
//! Samples are a fixed sequence, so the same files give the same figures, on any number of threads.

mod foot;
mod points;
mod shape;

pub use foot::{SurfaceFoot, SurfaceLocator};
pub use points::PointSet;
pub use shape::{Foot, Place, Shape};

use crate::cloud::ReadError;
use crate::export::SurfaceFileError;
use crate::import::ImportError;
use crate::spline::{SurfaceError, angle_degrees};
use rayon::prelude::*;
use serde::Serialize;

/// Why shapes cannot be compared, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The surface file is refused.
    #[error(transparent)]
    SurfaceFile(#[from] SurfaceFileError),
    /// The mesh is refused.
    #[error(transparent)]
    Mesh(#[from] ImportError),
    /// The points are refused.
    #[error(transparent)]
    Points(#[from] ReadError),
    /// The surface is damaged.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The shape in question is points.
    #[error("{file}: holds points; give a surface file or a mesh here, and points after --against")]
    NoSurface {
        /// File.
        file: String,
    },
    /// A shape without area.
    #[error("{file}: has no area; check that the right file was given")]
    Flat {
        /// File.
        file: String,
    },
}

/// Distances, in the unit of the files and relative to the diagonal of the reference's bounding box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Distances {
    /// Places the distance was measured at.
    pub count: usize,
    /// Root mean square.
    pub rms: f64,
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares.
    pub sum: f64,
    /// Sum.
    pub abs_sum: f64,
    /// Root mean square over the diagonal.
    pub rms_relative: f64,
    /// Mean over the diagonal.
    pub mean_relative: f64,
    /// Largest over the diagonal.
    pub max_relative: f64,
}

impl Distances {
    /// Statistics of distances; all zero without any.
    pub fn of(distances: &[f64], diagonal: f64) -> Self {
        let count = distances.len();
        let share = 1.0 / count.max(1) as f64;
        let sum: f64 = distances.iter().map(|d| d * d).sum();
        let abs_sum: f64 = distances.iter().sum();
        let max = distances.iter().copied().fold(0.0, f64::max);
        let (rms, mean) = ((sum * share).sqrt(), abs_sum * share);
        let scale = if diagonal > 0.0 { 1.0 / diagonal } else { 0.0 };
        Self {
            count,
            rms,
            mean,
            max,
            sum,
            abs_sum,
            rms_relative: rms * scale,
            mean_relative: mean * scale,
            max_relative: max * scale,
        }
    }
}

/// Angles between normals, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Angles {
    /// Mean.
    pub mean_degrees: f64,
    /// 95 of 100 are not larger.
    pub p95_degrees: f64,
    /// Largest.
    pub max_degrees: f64,
}

impl Angles {
    /// Statistics of angles; all zero without any.
    pub fn of(mut degrees: Vec<f64>) -> Self {
        let count = degrees.len();
        if count == 0 {
            return Self::default();
        }
        let mean_degrees = degrees.iter().sum::<f64>() / count as f64;
        degrees.sort_by(f64::total_cmp);
        // Linear between the two neighbouring ranks.
        let rank = 0.95 * (count - 1) as f64;
        let (low, high) = (
            degrees[rank as usize],
            degrees[(rank as usize + 1).min(count - 1)],
        );
        Self {
            mean_degrees,
            p95_degrees: low + (high - low) * rank.fract(),
            max_degrees: degrees[count - 1],
        }
    }
}

/// What a file holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Described {
    /// File.
    pub file: String,
    /// `surface`, `mesh` or `points`.
    pub kind: &'static str,
    /// Diagonal of the bounding box.
    pub bbox_diagonal: f64,
    /// Points, if it is points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<usize>,
    /// Topology of the triangles or patches, if it is not points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topology: Option<TopologyFigures>,
    /// Largest angle across smooth edges, measured, if it is a surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub g1_max_degrees: Option<f64>,
}

/// Topology of a mesh or of a network of patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TopologyFigures {
    /// Vertices that a face uses.
    pub vertices: usize,
    /// Edges.
    pub edges: usize,
    /// Triangles or patches.
    pub faces: usize,
    /// Connected components.
    pub components: usize,
    /// Border loops.
    pub border_loops: usize,
    /// Edges with three and more faces.
    pub non_manifold_edges: usize,
    /// Vertices whose faces form more than one fan.
    pub non_manifold_vertices: usize,
    /// Edges whose faces face opposite ways.
    pub misoriented_edges: usize,
    /// Vertices - edges + faces.
    pub euler: i64,
    /// Handles; `null` where the mesh is not manifold.
    pub genus: Option<usize>,
    /// Whether every edge has exactly two faces.
    pub watertight: bool,
}

impl From<crate::mesh::Topology> for TopologyFigures {
    fn from(t: crate::mesh::Topology) -> Self {
        Self {
            vertices: t.vertices,
            edges: t.edges,
            faces: t.faces,
            components: t.components,
            border_loops: t.border_loops,
            non_manifold_edges: t.non_manifold_edges,
            non_manifold_vertices: t.non_manifold_vertices,
            misoriented_edges: t.misoriented_edges,
            euler: t.euler,
            genus: t.genus(),
            watertight: t.faces > 0 && t.border_edges == 0 && t.non_manifold_edges == 0,
        }
    }
}

/// Everything that comparing two shapes yields.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// The shape in question.
    pub shape: Described,
    /// The reference.
    pub against: Described,
    /// From the shape to the reference.
    pub accuracy: Distances,
    /// From the reference to the shape.
    pub completeness: Distances,
    /// Between the shape's own normals (of its triangles, if it is a mesh) and the reference's.
    pub normals: Angles,
    /// Between a mesh's interpolated vertex normals (what a smooth shader shows) and the reference's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smooth_normals: Option<Angles>,
    /// Between the normals of the reference's points and the shape's at their foot points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_normals: Option<Angles>,
}

/// Samples taken of a shape, unless told otherwise.
pub const SAMPLES: usize = 40_000;

/// Compares `shape` with `against`, with about `samples` places on each.
///
/// # Errors
/// A shape that is points, or has no area.
pub fn compare(
    shape: &Shape,
    against: &Shape,
    samples: usize,
) -> Result<Evaluation, EvaluateError> {
    if matches!(shape, Shape::Points(..)) {
        return Err(EvaluateError::NoSurface {
            file: shape.describe().file,
        });
    }
    let (of_shape, of_reference) = (shape.describe(), against.describe());
    let diagonal = of_reference.bbox_diagonal;
    let feet = |from: &Shape, to: &Shape| -> Result<Vec<(Place, Foot)>, EvaluateError> {
        let places = from.places(samples.max(1));
        let feet: Vec<_> = places
            .into_par_iter()
            .filter_map(|place| to.foot(&place.position).map(|foot| (place, foot)))
            .collect();
        if feet.is_empty() {
            return Err(EvaluateError::Flat {
                file: from.describe().file,
            });
        }
        Ok(feet)
    };
    let forth = feet(shape, against)?;
    let back = feet(against, shape)?;
    let distances = |feet: &[(Place, Foot)]| {
        let list: Vec<f64> = feet.iter().map(|(_, foot)| foot.distance).collect();
        Distances::of(&list, diagonal)
    };
    let angles = |feet: &[(Place, Foot)]| {
        Angles::of(
            feet.iter()
                .map(|(p, foot)| angle_degrees(p.normal, foot.normal))
                .collect(),
        )
    };
    let smooth = |feet: &[(Place, Foot)]| {
        let list: Option<Vec<f64>> = feet
            .iter()
            .map(|(p, foot)| Some(angle_degrees(p.smooth_normal?, foot.normal)))
            .collect();
        list.map(Angles::of)
    };
    Ok(Evaluation {
        accuracy: distances(&forth),
        completeness: distances(&back),
        normals: angles(&forth),
        smooth_normals: smooth(&forth),
        point_normals: matches!(against, Shape::Points(..)).then(|| angles(&back)),
        shape: of_shape,
        against: of_reference,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;
    use crate::cloud::{Cloud, OrientedPoint};
    use crate::export::shapes as surfaces;
    use crate::mesh::{TriangleMesh, shapes};

    fn mesh(mesh: TriangleMesh) -> Shape {
        Shape::mesh("mesh", mesh)
    }

    fn scaled(mut mesh: TriangleMesh, factor: f64) -> TriangleMesh {
        mesh.positions.iter_mut().for_each(|p| *p *= factor);
        mesh
    }

    #[test]
    fn parallel_spheres_are_as_far_apart_as_their_radii() {
        let (inner, outer) = (shapes::icosphere(4), scaled(shapes::icosphere(5), 1.25));
        let result = compare(&mesh(inner), &mesh(outer), 5000).unwrap();
        let diagonal = 1.25 * 12f64.sqrt();
        assert!((result.against.bbox_diagonal - diagonal).abs() < 1e-2);
        for distances in [result.accuracy, result.completeness] {
            assert_eq!(distances.count, 5000);
            assert!((distances.rms - 0.25).abs() < 1e-3, "{distances:?}");
            assert!((distances.max - 0.25).abs() < 2e-3, "{distances:?}");
            assert!(
                (distances.rms_relative * result.against.bbox_diagonal - distances.rms).abs()
                    < 1e-12
            );
        }
        assert!(result.normals.max_degrees < 3.0, "{:?}", result.normals);
        // Facets of the coarser sphere turn by degrees, its shaded normals hardly: what is left are
        // the facets of the finer one.
        let smooth = result.smooth_normals.unwrap();
        assert!(
            smooth.mean_degrees < 0.7 * result.normals.mean_degrees,
            "{smooth:?}"
        );
        assert_eq!(result.shape.topology.unwrap().genus, Some(0));
    }

    #[test]
    fn a_missing_part_shows_in_completeness_only() {
        let whole = shapes::icosphere(4);
        let mut cap = whole.clone();
        cap.faces
            .retain(|f| f.iter().any(|v| whole.positions[*v as usize].z < 0.5));
        let pole_to = |v: &u32| (whole.positions[*v as usize] - Vec3::z()).norm();
        let to_rim = cap
            .faces
            .iter()
            .flatten()
            .map(pole_to)
            .fold(f64::INFINITY, f64::min);
        let result = compare(&mesh(cap), &mesh(whole), 4000).unwrap();
        assert!(result.accuracy.max < 1e-12);
        assert!(
            (result.completeness.max - to_rim).abs() < 0.03,
            "{:?}",
            result.completeness
        );
        let topology = result.shape.topology.unwrap();
        assert_eq!((topology.border_loops, topology.watertight), (1, false));
    }

    #[test]
    fn a_surface_against_its_own_exact_points() {
        let surface = surfaces::sheet();
        let sampled = surface.sample_per_patch(5).unwrap();
        let points = sampled
            .positions
            .iter()
            .zip(&sampled.normals)
            .map(|(p, n)| OrientedPoint {
                position: p + n * 0.01,
                normal: *n,
                sigma: None,
                finger: None,
                time_us: None,
            });
        let cloud = Cloud {
            points: points.collect(),
            rejected: vec![],
        };
        let count = cloud.points.len();
        let shape = Shape::surface("s.json", surface).unwrap();
        let result = compare(&shape, &Shape::points("p.ply", cloud), 3000).unwrap();
        assert_eq!(
            (result.completeness.count, result.against.points),
            (count, Some(count))
        );
        assert!(
            (result.completeness.max - 0.01).abs() < 1e-9,
            "{:?}",
            result.completeness
        );
        assert!(
            (result.completeness.mean - 0.01).abs() < 1e-9,
            "{:?}",
            result.completeness
        );
        assert!(
            result.point_normals.unwrap().max_degrees < 1e-4,
            "{:?}",
            result.point_normals
        );
        assert_eq!(result.shape.topology.unwrap().border_loops, 1);
        assert!(result.shape.g1_max_degrees.unwrap() < 1e-10);
        // To scattered points the distance is bridged by tangent planes.
        assert!(
            (result.accuracy.mean - 0.01).abs() < 1e-3,
            "{:?}",
            result.accuracy
        );
    }

    #[test]
    fn points_cannot_be_evaluated() {
        let point = OrientedPoint {
            position: Vec3::zeros(),
            normal: Vec3::z(),
            sigma: None,
            finger: None,
            time_us: None,
        };
        let points = Shape::points(
            "p.xyz",
            Cloud {
                points: vec![point],
                rejected: vec![],
            },
        );
        let error = compare(&points, &mesh(shapes::icosphere(1)), 10).unwrap_err();
        assert!(error.to_string().contains("after --against"));
        let flat = TriangleMesh {
            positions: vec![Vec3::zeros(); 3],
            faces: vec![[0, 1, 2]],
        };
        let error = compare(&mesh(flat), &points, 10).unwrap_err();
        assert!(error.to_string().contains("has no area"));
    }

    #[test]
    fn percentile_lies_between_ranks() {
        let angles = Angles::of((0..=10).rev().map(f64::from).collect());
        assert_eq!(
            (angles.mean_degrees, angles.p95_degrees, angles.max_degrees),
            (5.0, 9.5, 10.0)
        );
    }
}
