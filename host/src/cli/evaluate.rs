//! `palpus evaluate`: how far a surface or mesh is from another, both ways.

use super::{Common, Exit, Failure};
use palpus_host::evaluate::{Angles, Described, Distances, EvaluateError, SAMPLES, Shape, compare};
use std::io::Write;
use std::path::PathBuf;

/// Compare a surface or mesh with a reference: distances both ways, normals, topology.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus evaluate surface.json --against truth.stl
  palpus evaluate surface.json --against points.ply --json")]
pub struct Args {
    /// Surface file (.json) or mesh (.ply, .obj, .stl).
    pub shape: PathBuf,
    /// The reference: surface file, mesh, or points with normals (.ply, .xyz, .csv, .pcd).
    #[arg(long, value_name = "MESH|POINTS")]
    pub against: PathBuf,
    /// Places on each shape at which to measure.
    #[arg(long, default_value_t = SAMPLES)]
    pub samples: usize,
}

/// Reads both, compares, prints.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let refused = |error: EvaluateError| Failure::new(Exit::Input, error);
    let shape = Shape::read(&args.shape).map_err(refused)?;
    let against = Shape::read(&args.against).map_err(refused)?;
    let result = compare(&shape, &against, args.samples).map_err(refused)?;
    // A reader that has gone away (a closed pipe) is no fault of the comparison.
    let mut out = std::io::stdout().lock();
    if common.json {
        let text = serde_json::to_string(&result).map_err(|e| Failure::new(Exit::Input, e))?;
        let _ = writeln!(out, "{text}");
        return Ok(Exit::Done);
    }
    describe(&mut out, "shape", &result.shape);
    describe(&mut out, "against", &result.against);
    let _ = writeln!(
        out,
        "distances (in brackets: per mille of the reference's diagonal)"
    );
    distances(&mut out, "shape to reference", &result.accuracy);
    distances(&mut out, "reference to shape", &result.completeness);
    let _ = writeln!(out, "normals, degrees");
    angles(&mut out, "shape to reference", &result.normals);
    if let Some(smooth) = &result.smooth_normals {
        angles(&mut out, "the same, shaded", smooth);
    }
    if let Some(points) = &result.point_normals {
        angles(&mut out, "points to shape", points);
    }
    Ok(Exit::Done)
}

fn describe(out: &mut impl Write, role: &str, shape: &Described) {
    let _ = writeln!(
        out,
        "{role:<8} {} ({}, diagonal {:.6})",
        shape.file, shape.kind, shape.bbox_diagonal
    );
    if let Some(points) = shape.points {
        let _ = writeln!(out, "         {points} points");
    }
    if let Some(t) = &shape.topology {
        let genus = t.genus.map_or("unknown".to_owned(), |g| g.to_string());
        let _ = writeln!(
            out,
            "         {} {}, {} vertices, components {}, genus {genus}, border loops {}, euler {}{}",
            t.faces,
            if shape.kind == "surface" {
                "patches"
            } else {
                "triangles"
            },
            t.vertices,
            t.components,
            t.border_loops,
            t.euler,
            if t.watertight { ", watertight" } else { "" },
        );
        let faults = t.non_manifold_edges + t.non_manifold_vertices + t.misoriented_edges;
        if faults > 0 {
            let _ = writeln!(
                out,
                "         not manifold: {} edges, {} vertices, {} edges with opposite faces",
                t.non_manifold_edges, t.non_manifold_vertices, t.misoriented_edges
            );
        }
    }
    if let Some(angle) = shape.g1_max_degrees {
        let _ = writeln!(
            out,
            "         largest angle across smooth edges {angle:.3e} degrees"
        );
    }
}

fn distances(out: &mut impl Write, way: &str, d: &Distances) {
    let _ = writeln!(
        out,
        "  {way:<20} rms {:.6} [{:.3}]  mean {:.6} [{:.3}]  max {:.6} [{:.3}]  ({} places)",
        d.rms,
        1e3 * d.rms_relative,
        d.mean,
        1e3 * d.mean_relative,
        d.max,
        1e3 * d.max_relative,
        d.count
    );
}

fn angles(out: &mut impl Write, way: &str, a: &Angles) {
    let _ = writeln!(
        out,
        "  {way:<20} mean {:.3}  95 % {:.3}  max {:.3}",
        a.mean_degrees, a.p95_degrees, a.max_degrees
    );
}
