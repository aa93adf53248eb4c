//! The figures of a reconstruction, as `--report` writes them: keys are fixed, more may be added.
//!
//! Scripts read these keys, so a field keeps its name and its meaning. Lengths are in the unit of the input,
//! angles in degrees, times in seconds. A number that is not finite is written as `null`.

use crate::spline::Measures;
use serde::{Deserialize, Serialize};

/// Everything a reconstruction has to say about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// What came in.
    pub input: InputFigures,
    /// The phases in the order they ran; fewer than four if stopped early.
    pub phases: Vec<PhaseFigures>,
    /// The finished surface; absent if stopped before there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceFigures>,
    /// Distances of the points from the finished surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorFigures>,
    /// Angles between measured and surface normals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normals: Option<NormalFigures>,
    /// Decisions taken, limits met, parts without support: what a reader should know besides the figures.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Seconds from the first point read to the last figure.
    pub seconds: f64,
    /// Threads that were allowed.
    pub threads: usize,
    /// Version of the program.
    pub version: String,
}

/// What came in.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InputFigures {
    /// Rows found.
    pub points: usize,
    /// Rows used.
    pub used: usize,
    /// Rows left out because they are unusable.
    pub rejected: usize,
    /// The rows left out, each as `file:line: reason`; at most [`REJECTED_NAMED`] are named.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rejected_rows: Vec<String>,
    /// Diagonal of the points' bounding box.
    pub bbox_diagonal: f64,
    /// Standard deviation of the positions along the normal, found in the data.
    pub noise_sigma: f64,
    /// Standard deviation of the normals per axis, found in the data.
    #[serde(default)]
    pub noise_normal_degrees: f64,
}

/// Most rejected rows that the report names one by one.
pub const REJECTED_NAMED: usize = 100;

impl InputFigures {
    /// Counts of a cloud; the noise is for the caller to fill in.
    pub fn of(cloud: &crate::cloud::Cloud) -> Self {
        let (used, rejected) = (cloud.points.len(), cloud.rejected.len());
        let name =
            |row: &crate::cloud::RejectedRow| format!("{}:{}: {}", row.file, row.line, row.reason);
        Self {
            points: used + rejected,
            used,
            rejected,
            rejected_rows: cloud
                .rejected
                .iter()
                .take(REJECTED_NAMED)
                .map(name)
                .collect(),
            bbox_diagonal: cloud.diagonal(),
            noise_sigma: 0.0,
            noise_normal_degrees: 0.0,
        }
    }
}

/// One phase: `extract`, `simplify`, `fit` or `refine`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseFigures {
    /// Which phase.
    pub name: String,
    /// Seconds it took.
    pub seconds: f64,
    /// Triangles after it (extract, simplify).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub triangles: Option<usize>,
    /// Patches after it (fit, refine).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patches: Option<usize>,
    /// Rounds of fitting (fit).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rounds: Option<usize>,
    /// Levels of refinement in the surface that is kept (refine).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub levels: Option<usize>,
    /// Sum of squared distances (eq. 5 of the paper).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_sum: Option<f64>,
    /// Sum of distances.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_abs_sum: Option<f64>,
    /// Root mean square distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_rms: Option<f64>,
    /// Largest distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_max: Option<f64>,
    /// Every level that was tried (refine), from level 0, which is the fit's; the one that is kept is `levels`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub by_level: Vec<LevelFigures>,
}

/// One level of refinement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelFigures {
    /// Which, from 0.
    pub level: usize,
    /// Patches.
    pub patches: usize,
    /// Sum of squared distances.
    pub error_sum: f64,
    /// Root mean square distance.
    pub error_rms: f64,
    /// Largest distance.
    pub error_max: f64,
}

/// The finished surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceFigures {
    /// Patches.
    pub patches: usize,
    /// Degree of each.
    pub degree: usize,
    /// Corner points.
    pub vertices: usize,
    /// Free numbers of the surface: three coordinates of three values per vertex and two per smooth edge.
    #[serde(default)]
    pub degrees_of_freedom: usize,
    /// Vertices - edges + patches.
    pub euler: i64,
    /// Handles, summed over the components.
    pub genus: i64,
    /// Connected components.
    pub components: usize,
    /// Border loops.
    pub borders: usize,
    /// Edges across which only the position is continuous.
    pub crease_edges: usize,
    /// Largest angle between the two sides' normals on smooth edges and at smooth vertices, measured.
    pub g1_max_degrees: f64,
    /// Smallest area element relative to the mean of its patch, measured.
    pub min_jacobian: f64,
    /// Patches whose normal turns over, measured.
    pub folded_patches: usize,
    /// Largest jump of the mean curvature across smooth edges (and a chart's knot lines), 1 / length, measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curvature_jump_max: Option<f64>,
    /// Root of its mean square.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curvature_jump_rms: Option<f64>,
}

impl SurfaceFigures {
    /// Figures of a measured surface.
    pub fn of(surface: &crate::spline::Surface, measures: &Measures) -> Self {
        let topology = &measures.topology;
        Self {
            patches: topology.faces,
            degree: crate::spline::Surface::DEGREE,
            vertices: topology.vertices,
            degrees_of_freedom: 9 * topology.vertices + 6 * topology.edges,
            euler: topology.euler,
            genus: topology.genus,
            components: topology.components,
            borders: topology.borders,
            crease_edges: surface.creases.len(),
            g1_max_degrees: measures.g1_max_degrees,
            min_jacobian: measures.min_jacobian,
            folded_patches: measures.folded_patches,
            curvature_jump_max: Some(measures.curvature_jump_max),
            curvature_jump_rms: Some(measures.curvature_jump_rms),
        }
    }
}

/// Distances of the points from the finished surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorFigures {
    /// Tolerance asked for, or derived from the data.
    pub tolerance: f64,
    /// Whether every inlier is within the tolerance.
    pub met: bool,
    /// Why not, or how the tolerance was found.
    pub reason: Option<String>,
    /// Sum of squared distances (eq. 5 of the paper).
    pub sum: f64,
    /// Sum of distances.
    pub abs_sum: f64,
    /// Root mean square distance.
    pub rms: f64,
    /// Largest distance.
    pub max: f64,
    /// Points of these figures beyond the tolerance.
    #[serde(default)]
    pub beyond: usize,
    /// Points left out of these figures as outliers.
    pub outliers: usize,
    /// Numbers of those points among the usable rows, from 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outlier_points: Vec<usize>,
}

/// Angles between measured and surface normals.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NormalFigures {
    /// Mean angle.
    pub mean_degrees: f64,
    /// Largest angle.
    pub max_degrees: f64,
}

impl ErrorFigures {
    /// Whether the tolerance is met, and if not, by how many points.
    pub fn outcome(&self) -> String {
        match (self.met, self.beyond) {
            (true, _) => "met".to_owned(),
            // Reports of before this was counted.
            (false, 0) => "not met".to_owned(),
            (false, 1) => "not met by 1 point".to_owned(),
            (false, count) => format!("not met by {count} points"),
        }
    }
}

impl Report {
    /// The report as it is written: indented JSON with a line end.
    pub fn to_json(&self) -> String {
        // Plain structs of numbers and strings always serialise.
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_that_scripts_read() {
        let report = Report {
            phases: vec![
                PhaseFigures {
                    name: "extract".into(),
                    triangles: Some(9),
                    ..Default::default()
                },
                PhaseFigures {
                    name: "refine".into(),
                    patches: Some(3),
                    levels: Some(2),
                    error_sum: Some(1e-3),
                    by_level: vec![LevelFigures::default()],
                    ..Default::default()
                },
            ],
            surface: Some(SurfaceFigures::default()),
            error: Some(ErrorFigures::default()),
            normals: Some(NormalFigures::default()),
            ..Default::default()
        };
        let value: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
        let keys = |at: &str| -> Vec<String> {
            value
                .pointer(at)
                .unwrap()
                .as_object()
                .unwrap()
                .keys()
                .cloned()
                .collect()
        };
        let has = |at: &str, wanted: &str| {
            let found = keys(at);
            for key in wanted.split(' ') {
                assert!(found.iter().any(|k| k == key), "{at}/{key}");
            }
        };
        has(
            "",
            "input phases surface error normals seconds threads version",
        );
        has("/input", "points used rejected bbox_diagonal noise_sigma");
        has(
            "/phases/1",
            "name seconds patches levels error_sum by_level",
        );
        has(
            "/phases/1/by_level/0",
            "level patches error_sum error_rms error_max",
        );
        has(
            "/surface",
            "patches degree vertices euler genus components borders crease_edges g1_max_degrees min_jacobian",
        );
        has(
            "/error",
            "tolerance met reason sum abs_sum rms max outliers",
        );
        has("/normals", "mean_degrees max_degrees");
        assert_eq!(keys("/phases/0").len(), 3);
        assert_eq!(
            serde_json::from_str::<Report>(&report.to_json()).unwrap(),
            report
        );
    }
}
