//! The report of a reconstruction: keys as users script against them.

use serde::{Deserialize, Serialize};

/// Everything a reconstruction says about itself; lengths in the unit of the input.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// What came in.
    pub input: InputReport,
    /// The phases that ran, in order.
    pub phases: Vec<PhaseReport>,
    /// The surface; absent when stopped before the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    /// Distances of the used points to the surface; absent when stopped before the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorReport>,
    /// Angles between measured and surface normals; absent when stopped before the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normals: Option<NormalReport>,
    /// What a reader should know: decisions taken, limits met, parts without support.
    pub notes: Vec<String>,
    /// Wall-clock seconds of all phases.
    pub seconds: f64,
    /// Threads used.
    pub threads: usize,
    /// Version of the program.
    pub version: String,
}

/// What came in.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InputReport {
    /// Rows read, the rejected ones included.
    pub points: usize,
    /// Points that took part.
    pub used: usize,
    /// Rows left out.
    pub rejected: usize,
    /// Diagonal of the bounding box.
    pub bbox_diagonal: f64,
    /// Standard deviation of the positions along the normal, found in the data.
    pub noise_sigma: f64,
    /// Standard deviation of the normals per axis, degrees, found in the data.
    pub noise_normal_degrees: f64,
}

/// One phase.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseReport {
    /// extract, simplify, fit or refine.
    pub name: String,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Triangles after the phase (extract, simplify).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<usize>,
    /// Patches after the phase (fit, refine).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patches: Option<usize>,
    /// Rounds of fit and reparameterisation (fit).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounds: Option<usize>,
    /// Levels of refinement (refine).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub levels: Option<usize>,
    /// Distances after the phase (fit, refine).
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub errors: Option<PhaseErrors>,
}

/// Distances of the used points after a phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseErrors {
    /// Sum of squared distances (paper, eq. 5).
    pub error_sum: f64,
    /// Sum of distances.
    pub error_abs_sum: f64,
    /// Root of the mean squared distance.
    pub error_rms: f64,
    /// Largest distance.
    pub error_max: f64,
}

/// The finished surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceReport {
    /// Patches.
    pub patches: usize,
    /// Degree of the patches.
    pub degree: usize,
    /// Vertices of the base mesh.
    pub vertices: usize,
    /// Free control points' coordinates less the equations between them: 3 per vertex and 2 per edge, times 3.
    pub degrees_of_freedom: usize,
    /// Euler characteristic.
    pub euler: i64,
    /// Genus, summed over components.
    pub genus: i64,
    /// Connected components.
    pub components: usize,
    /// Border loops.
    pub borders: usize,
    /// Edges that are creases.
    pub crease_edges: usize,
    /// Largest angle between the normals of both sides of a smooth edge, measured.
    pub g1_max_degrees: f64,
    /// Smallest |S_u x S_v| relative to its patch's mean, measured.
    pub min_jacobian: f64,
    /// Patches in which the normal turns by more than 90 degrees against their mean.
    pub folded_patches: usize,
}

/// Distances of the used points to the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorReport {
    /// The tolerance asked for or chosen.
    pub tolerance: f64,
    /// Where the tolerance comes from: option, diagonal or noise.
    pub tolerance_from: String,
    /// Whether every used point lies within the tolerance.
    pub met: bool,
    /// Why not, or what else to know.
    pub reason: Option<String>,
    /// Sum of squared distances.
    pub sum: f64,
    /// Sum of distances.
    pub abs_sum: f64,
    /// Root of the mean squared distance.
    pub rms: f64,
    /// Largest distance.
    pub max: f64,
    /// Used points beyond the tolerance.
    pub beyond: usize,
    /// Points taken for false contacts; not among the used ones.
    pub outliers: usize,
    /// Numbers of those points, from 0, in the order of the input.
    pub outlier_points: Vec<usize>,
}

/// Angles between measured and surface normals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NormalReport {
    /// Mean, degrees.
    pub mean_degrees: f64,
    /// Largest, degrees.
    pub max_degrees: f64,
}
