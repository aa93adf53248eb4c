//! `palpus simulate`: a simulated hand on pseudo-terminals, or its tracks alone as a point file.

use super::{Common, Exit, Failure};
use anyhow::{Context, anyhow};
use palpus_host::cloud::write_ply;
use palpus_host::export::{sampled_from_mesh, write_bytes, write_mesh};
use palpus_host::import::read_mesh;
use palpus_host::simulate::{Object, PointSet};
use std::path::PathBuf;

/// Longest side given to an object that comes from a mesh file without `--size`, millimetres.
const MESH_SIDE_MM: f64 = 150.0;

/// Arguments of `palpus simulate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to touch: sphere, ellipsoid, torus, two-holed-torus, mug, bowl, bean, trilobe, cube, cylinder, or a
    /// closed mesh file (.ply, .obj, .stl).
    #[arg(long, value_name = "NAME|FILE")]
    object: String,
    /// Longest side of an object from a mesh file, in millimetres [default: 150].
    #[arg(long, value_name = "MM")]
    size: Option<f64>,
    /// Everything random follows from this.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write the object's true shape as a mesh, for `palpus evaluate --against`.
    #[arg(long, value_name = "MESH")]
    truth: Option<PathBuf>,
    /// Make this many points of the tracks at once, without boards, and write them to -o.
    #[arg(long, value_name = "N", requires = "output")]
    points: Option<usize>,
    /// Where to write the points (.ply).
    #[arg(short, long, value_name = "FILE", requires = "points")]
    output: Option<PathBuf>,
    /// With --points: touch one sector only and repeat it this often by rotation about the z axis.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "points")]
    copies: usize,
    /// With --points: scale the result so that the object's longest side has this length.
    #[arg(long, value_name = "LENGTH", requires = "points")]
    longest_side: Option<f64>,
    /// With --points: standard deviation of the positions per axis, in the result's unit.
    #[arg(long, value_name = "SIGMA", default_value_t = 0.0, requires = "points")]
    position_noise: f64,
    /// With --points: root mean square angle by which normals are turned, in degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        requires = "points"
    )]
    normal_noise: f64,
}

/// Runs `palpus simulate`.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    for (name, value) in [("--size", args.size), ("--longest-side", args.longest_side)] {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
            let error = anyhow!("{name} {value}: a length above 0 is needed");
            return Err(Failure::new(Exit::Usage, error));
        }
    }
    for (name, value) in [
        ("--position-noise", args.position_noise),
        ("--normal-noise", args.normal_noise),
    ] {
        if !(value.is_finite() && value >= 0.0) {
            let error = anyhow!("{name} {value}: a number of at least 0 is needed");
            return Err(Failure::new(Exit::Usage, error));
        }
    }
    let object = object(&args.object, args.size)?;
    if let Some(path) = &args.truth {
        let mut mesh = object.truth_mesh();
        if let (Some(side), Some((low, high))) = (args.longest_side, mesh.bounding_box()) {
            let scale = side / (high - low).max();
            mesh.positions.iter_mut().for_each(|p| *p *= scale);
        }
        write_mesh(path, &sampled_from_mesh(&mesh)).map_err(|e| Failure::new(Exit::Usage, e))?;
    }
    match (args.points, &args.output) {
        (Some(count), Some(output)) => {
            let set = PointSet {
                count,
                copies: args.copies,
                longest_side: args.longest_side,
                position_noise: args.position_noise,
                normal_noise_degrees: args.normal_noise,
                seed: args.seed,
                ..PointSet::default()
            };
            let cloud = set.points(&object);
            let mut bytes = Vec::new();
            write_ply(&cloud, &mut bytes)
                .context("the points cannot be encoded")
                .map_err(|e| Failure::new(Exit::Usage, e))?;
            write_bytes(output, &bytes).map_err(|e| Failure::new(Exit::Usage, e))?;
            if common.json {
                println!(
                    "{}",
                    serde_json::json!({ "object": object.name(), "points": cloud.points.len(), "file": output })
                );
            }
            Ok(Exit::Done)
        }
        _ => Err(Failure::new(
            Exit::Usage,
            anyhow!("give --points N and -o FILE"),
        )),
    }
}

/// The object of that name, or of that file.
pub fn object(name: &str, size_mm: Option<f64>) -> Result<Object, Failure> {
    let refused = |e: anyhow::Error| Failure::new(Exit::Input, e);
    if Object::NAMES.contains(&name) {
        if size_mm.is_some() {
            let error = anyhow!("--size is for mesh files; {name} has its own size");
            return Err(Failure::new(Exit::Usage, error));
        }
        return Object::named(name).map_err(|e| refused(e.into()));
    }
    let path = PathBuf::from(name);
    if !path.exists() {
        // The message lists the names there are.
        return Object::named(name).map_err(|e| Failure::new(Exit::Usage, e));
    }
    let mesh = read_mesh(&path).map_err(|e| refused(e.into()))?;
    Object::from_mesh(name, &mesh, Some(size_mm.unwrap_or(MESH_SIDE_MM)))
        .map_err(|e| refused(e.into()))
}
