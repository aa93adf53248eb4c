//! Phase 2: from the dense extracted mesh to the few well-shaped triangles that carry the patches.
//!
//! Source: Hoppe, DeRose, Duchamp, McDonald, Stuetzle, "Mesh Optimization" (1993), which is the second
//! phase of the paper "Curved Surface Reconstruction Using Active Tactile Sensing and Surface Normal
//! Information".
//!
//! # What comes out
//! A manifold of the same topology as the mesh that went in. Its vertices lie on that mesh (or on the
//! field behind it, where one is handed in). Creases and borders are kept as lines of edges: their
//! corners stay where they were, and no face crosses them. The edges follow a sizing field
//! (`sizing`): short where the surface bends or a wall is thin, long where nothing happens. Triangles
//! are close to equilateral and interior vertices have 4 to 8 edges, nearly always 5 to 7, because the patches that
//! are fitted later fold at vertices of high valence and at thin triangles.
//!
//! # How
//! 1. `decimate`: collapses of short edges, measured by the sizing field, until the number of faces that the field
//!    asks for is reached.
//! 2. `relax`: flips towards valence 6, tangential smoothing, reprojection; long edges split, short ones
//!    collapsed.
//! 3. `optimize`: Hoppe's energy decides over further collapses, splits and flips ([`energy`]).
//! 4. `relax` once more, so that the vertices end on the surface; then faces with two edges of one smooth line are opened.
//!
//! Two orders were weighed: Hoppe's own, whose energy drives every one of the thousands of collapses
//! (minutes in 1993, and its piecewise linear surface cares neither for valence nor for angles), and
//! this one, where the sizing field does the bulk and the energy the trade between
//! the last few hundred faces. Both end at the same kind of mesh; this one takes a hundredth of the time.

mod decimate;
pub mod energy;
mod optimize;
mod reference;
mod relax;
mod sizing;
#[cfg(test)]
mod tests;
mod work;

use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::{MeshError, TriangleMesh};
use reference::Reference;
use thiserror::Error;
use work::Work;

/// Takes a point near the surface to a point on it and the outward unit normal there; `None` where the
/// surface is not defined.
pub type Project<'a> = dyn Fn(&Vec3) -> Option<(Vec3, Vec3)> + Sync + 'a;

/// The crease lines of a dense mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CreaseLines {
    /// Crease edges by their ends in the dense mesh.
    pub edges: Vec<[u32; 2]>,
    /// Vertices that must stay besides the ends and branch points of the lines, which stay anyway: bends
    /// within one line, for example.
    pub corners: Vec<u32>,
}

/// How coarse the simplified mesh may be.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Number of faces to aim for. Without it the limits below decide.
    pub target_faces: Option<usize>,
    /// How far the surface may turn along one edge, degrees. With an accuracy asked for as well, noisy torus, bean,
    /// three lobes, two-holed torus and mug are fitted as truly at 115 as at 85, with half the patches on the mug.
    pub turn_max_degrees: f64,
    /// Largest distance, in the unit of the input, that the fitted patches may keep from the surface.
    /// Without it, only the turn limits the edges on curved regions.
    pub accuracy: Option<f64>,
    /// Longest edge as a multiple of the thickness of the wall (or the width of the gap) it lies on. On five noisy mugs
    /// the fit is as true at 2.5 as at 1.5, with half the patches; a bowl with a thin wall loses at 4.
    pub thickness_ratio: f64,
    /// Longest edge along a direction in which the surface hardly bends, as a multiple of that across it.
    /// 1 makes all faces equilateral. On torus, two-holed torus, bean and mug 1.6 saved a third of the faces at
    /// the same turn, but with as many equilateral faces the fit was closer (torus: 78 faces 0.32e-3 of the
    /// diagonal, 74 stretched ones 0.39e-3); long prisms and cylinders may gain.
    pub aspect_max: f64,
    /// How fast the edge length may grow along the surface: 0.5 lets it grow by half of the way gone.
    pub gradation: f64,
    /// Longest edge as a share of the bounding-box diagonal of the component it lies on.
    pub edge_max_ratio: f64,
    /// Shortest edge asked for, in the unit of the input. Without it: the mean edge of the dense mesh.
    pub edge_min: Option<f64>,
    /// Rounds of Hoppe's optimization, with falling spring constants. 0 leaves it out.
    pub energy_rounds: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            target_faces: None,
            turn_max_degrees: 115.0,
            accuracy: None,
            thickness_ratio: 2.5,
            aspect_max: 1.0,
            gradation: 0.5,
            edge_max_ratio: 0.4,
            edge_min: None,
            energy_rounds: 3,
        }
    }
}

/// A simplified mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simplified {
    /// The mesh.
    pub mesh: TriangleMesh,
    /// Its crease edges, the lower vertex index first, in rising order.
    pub creases: Vec<[u32; 2]>,
    /// Its border edges, the lower vertex index first, in rising order.
    pub border: Vec<[u32; 2]>,
    /// Its vertices that lie where lines meet, bend or end, in rising order.
    pub corners: Vec<u32>,
    /// Outward unit normals of the surface at the vertices; zero at creases, where there is more than one.
    pub normals: Vec<Vec3>,
    /// Edge length the sizing field asks for at the vertices (the geometric mean of those along and across
    /// the bend), in the unit of the input.
    pub sizes: Vec<f64>,
    /// Hoppe's energy before and after its optimization.
    pub energy: Option<[energy::Energy; 2]>,
    /// Counts and shape of the result.
    pub shape: Shape,
}

/// How well-shaped a mesh is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shape {
    /// Lowest and highest valence of an interior vertex off all creases; 0, 0 if there is none.
    pub valence: [usize; 2],
    /// Share of those vertices with valence 5 to 7.
    pub valence_5_to_7: f64,
    /// Smallest angle of a triangle, degrees.
    pub angle_min_degrees: f64,
    /// Largest angle between two corner normals of one face, degrees.
    pub turn_max_degrees: f64,
}

/// Why a mesh could not be simplified.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SimplifyError {
    /// The mesh has no faces.
    #[error("there is no face to simplify; check that the extraction found a surface")]
    Empty,
    /// The mesh is not an oriented manifold.
    #[error("the extracted mesh is not a manifold: {0}")]
    NotManifold(#[from] MeshError),
    /// A crease names an edge that the mesh does not have.
    #[error(
        "crease edge {0}-{1} is no edge of the mesh; name edges by vertex indices of the dense mesh"
    )]
    NoSuchCrease(u32, u32),
    /// A corner names a vertex that the mesh does not have.
    #[error("corner {0} is no vertex of the mesh; name vertices of the dense mesh")]
    NoSuchCorner(u32),
    /// An option has no meaning.
    #[error("option {name} is {value}, it must be {must}; correct it")]
    BadOption {
        /// The option's name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
}

/// Simplifies `mesh`, which came out of the extraction, to the base mesh of the patch network.
///
/// `cloud` holds the measured points, which Hoppe's energy measures distances to; `creases` the lines to
/// keep; `project` the field behind the mesh, if it can be asked
/// (not used where there are creases, which a field rounds off).
/// Same input, same result, on every machine and with any number of threads.
///
/// # Errors
/// See [`SimplifyError`]; a mesh that cannot be coarsened further is no error.
pub fn simplify(
    mesh: &TriangleMesh,
    cloud: &Cloud,
    creases: &CreaseLines,
    options: &Options,
    project: Option<&Project<'_>>,
) -> Result<Simplified, SimplifyError> {
    check(options)?;
    let reference = Reference::new(mesh, creases, options, project)?;
    let mut work = Work::new(&reference, options);
    let target = work.target_faces();
    decimate::decimate(&mut work, target);
    relax::relax(&mut work, 8);
    let mut energies = None;
    if options.energy_rounds > 0 {
        energies = optimize::optimize(&mut work, cloud, options.energy_rounds);
        relax::land(&mut work);
        relax::relax(&mut work, 4);
    }
    relax::mend_valences(&mut work);
    relax::open_ears(&mut work);
    Ok(work.finish(energies))
}

fn check(options: &Options) -> Result<(), SimplifyError> {
    let positive = "positive and finite";
    let checks = [
        (
            "turn_max_degrees",
            options.turn_max_degrees,
            (1.0..=150.0),
            "1 to 150",
        ),
        (
            "thickness_ratio",
            options.thickness_ratio,
            (1e-3..=1e6),
            positive,
        ),
        ("gradation", options.gradation, (1e-3..=1e6), positive),
        (
            "edge_max_ratio",
            options.edge_max_ratio,
            (1e-6..=1e6),
            positive,
        ),
        ("aspect_max", options.aspect_max, (1.0..=10.0), "1 to 10"),
        (
            "accuracy",
            options.accuracy.unwrap_or(1.0),
            (1e-300..=1e300),
            positive,
        ),
        (
            "edge_min",
            options.edge_min.unwrap_or(1.0),
            (1e-300..=1e300),
            positive,
        ),
    ];
    for (name, value, range, must) in checks {
        if !range.contains(&value) {
            return Err(SimplifyError::BadOption { name, value, must });
        }
    }
    Ok(())
}
