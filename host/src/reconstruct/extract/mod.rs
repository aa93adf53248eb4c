//! Phase 1: from contacts to a first triangle mesh, by way of a field whose zero set is the surface.
//!
//! 1. Contacts that contradict their neighbours are set aside ([`Extracted::outliers`]).
//! 2. Noise of positions and normals and the smoothness of the surface are estimated from the rest.
//! 3. The field is built: by default a partition of unity of local Gaussian-process fits to positions and normals
//!    ([`Method::Hermite`]); the paper's distance to averaged tangent planes can be had instead
//!    ([`Method::TangentPlanes`]).
//! 4. Marching cubes follow the zero set, and every vertex is moved onto it.
//!
//! Everything inside happens in coordinates normalised to a bounding box of diagonal 1 around the origin, so
//! results do not depend on the unit or place of the input (up to rounding).
//!
//! Promises: no panic for any input; the same bytes for the same input at any number of threads; a manifold mesh.

mod cube;
mod field;
mod kernel;
mod lattice;
mod local_fit;
mod orthogonal;
mod smoothing;

use rayon::prelude::*;

use self::{
    field::{Ball, BlendedField},
    lattice::Lattice,
    smoothing::{Levels, Normalised},
};
use crate::{
    Vec3,
    cloud::{Cloud, Neighbourhoods},
    mesh::TriangleMesh,
};

pub use self::kernel::Kernel;

/// How the field is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Local Gaussian-process fits to positions and normals together, blended.
    Hermite(Kernel),
    /// The paper's: distance to the nearest averaged tangent plane (section 4.1).
    TangentPlanes,
}

/// What to extract and how far to go.
#[derive(Clone, Debug)]
pub struct Options {
    /// How the field is made.
    pub method: Method,
    /// Contacts per local fit; more carry further across gaps and cost with the third power.
    pub neighbours: usize,
    /// Spacing of the lattice in the unit of the input; from the data if `None`.
    pub spacing: Option<f64>,
    /// Most bytes the extraction may take; refused beforehand if it would take more.
    pub max_memory: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Hermite(Kernel::Quintic),
            neighbours: 80,
            spacing: None,
            max_memory: 2 << 30,
        }
    }
}

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

/// Fewest contacts a surface is extracted from.
pub const LEAST_CONTACTS: usize = 6;

/// What the contacts say about their own noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimate {
    /// Standard deviation of a typical position along the normal, in the unit of the input.
    pub position_sigma: f64,
    /// Standard deviation of each of the two tilts of a normal, radians.
    pub normal_sigma: f64,
}

/// The field whose zero set is the surface, in the unit of the input; negative inside.
#[derive(Clone, Debug)]
pub struct Field {
    frame: Frame,
    blended: BlendedField,
    tree: Neighbourhoods,
    levels: Levels,
}

impl Field {
    /// Approximate signed distance at `x`; NaN far from all contacts.
    pub fn value(&self, x: &Vec3) -> f64 {
        self.frame.scale * self.blended.value(&self.frame.inward(x))
    }

    /// Gradient at `x`: about unit length near the surface, pointing outward.
    pub fn gradient(&self, x: &Vec3) -> Vec3 {
        self.blended.value_and_gradient(&self.frame.inward(x)).1
    }

    /// The point of the zero set that Newton steps along the gradient reach from `x`; `None` if they leave the
    /// neighbourhood (a hundredth of the bounding box's diagonal at most, per step) or do not settle.
    pub fn project(&self, x: &Vec3) -> Option<Vec3> {
        project(&self.blended, &self.frame.inward(x), 0.01).map(|y| self.frame.outward(&y))
    }

    /// Standard deviation of the surface's position near `x`, unit of the input: a share of the noise at the contacts,
    /// growing with the square of the distance to the nearest one.
    pub fn confidence(&self, x: &Vec3) -> f64 {
        let distance2 = self
            .tree
            .nearest_one(&self.frame.inward(x))
            .map_or(1.0, |(_, d2)| d2);
        self.frame.scale * (0.35 * self.levels.position_sigma).hypot(1.5 * distance2)
    }

    /// Number of local fits.
    pub fn fits(&self) -> usize {
        self.blended.len()
    }
}

/// The way from input coordinates to normalised ones and back.
#[derive(Clone, Copy, Debug)]
struct Frame {
    origin: Vec3,
    scale: f64,
}

impl Frame {
    fn inward(&self, x: &Vec3) -> Vec3 {
        (x - self.origin) / self.scale
    }

    fn outward(&self, x: &Vec3) -> Vec3 {
        x * self.scale + self.origin
    }
}

/// Result of the extraction.
#[derive(Clone, Debug)]
pub struct Extracted {
    /// The mesh, on the field's zero set, in the unit of the input.
    pub mesh: TriangleMesh,
    /// The field.
    pub field: Field,
    /// Noise of the contacts.
    pub noise: NoiseEstimate,
    /// Contacts set aside because they contradict the others, ascending.
    pub outliers: Vec<usize>,
    /// Spacing of the lattice, unit of the input.
    pub spacing: f64,
    /// Cubes of the lattice that hold surface.
    pub cubes: usize,
    /// Bytes of field and lattice.
    pub bytes: usize,
}

/// Extracts the surface through `cloud`.
///
/// # Errors
/// [`ExtractError`] says what is wrong with the contacts or options and what to do.
pub fn extract(cloud: &Cloud, options: &Options) -> Result<Extracted, ExtractError> {
    let (frame, data) = normalise(cloud)?;
    let tree = Neighbourhoods::new(data.positions.clone());
    let kernel = match options.method {
        Method::Hermite(kernel) => kernel,
        Method::TangentPlanes => Kernel::Quintic,
    };
    let balls = smoothing::cover(&data.positions, &tree, options.neighbours.max(8), 0.5);
    let levels = smoothing::estimate(kernel, &data, &balls, &tree);
    let blended = build_field(kernel, &data, &balls, &levels)?;
    let mut spread: Vec<f64> = balls
        .iter()
        .map(|b| b.radius * (std::f64::consts::PI / b.members.len() as f64).sqrt())
        .collect();
    let typical = smoothing::median(&mut spread).unwrap_or(0.05);
    let spacing = options.spacing.map_or(0.8 * typical, |s| s / frame.scale);
    if spacing.is_nan() || spacing <= 0.0 {
        return Err(ExtractError::BadOption {
            name: "spacing",
            value: options.spacing.unwrap_or(f64::NAN),
            range: "a length above 0",
        });
    }
    let lattice = Lattice { spacing };
    let seeds: Vec<Vec3> = data
        .positions
        .par_iter()
        .filter_map(|p| project(&blended, p, spacing))
        .collect();
    let reach = 5.0 * typical;
    let limit = options.max_memory / 1000;
    let marched = lattice.march(
        |x| blended.value(x),
        &seeds,
        |x| {
            tree.nearest_one(x)
                .is_some_and(|(_, d2)| d2 < reach * reach)
        },
        limit,
    );
    if marched.truncated {
        return Err(ExtractError::TooMuchMemory {
            spacing: spacing * frame.scale,
            needed: marched.cubes * 1000,
            limit: options.max_memory,
        });
    }
    let mut mesh = marched.mesh;
    if mesh.faces.is_empty() {
        return Err(ExtractError::NoSurface);
    }
    mesh.positions = mesh
        .positions
        .par_iter()
        .map(|x| project(&blended, x, 0.5 * spacing).unwrap_or(*x))
        .map(|x| frame.outward(&x))
        .collect();
    let bytes = blended.bytes() + marched.nodes * 40 + marched.cubes * 120;
    Ok(Extracted {
        mesh,
        field: Field {
            frame,
            blended,
            tree,
            levels,
        },
        noise: NoiseEstimate {
            position_sigma: levels.position_sigma * frame.scale,
            normal_sigma: levels.normal_sigma,
        },
        outliers: Vec::new(),
        spacing: spacing * frame.scale,
        cubes: marched.cubes,
        bytes,
    })
}

/// Checks the contacts and moves them to a box of diagonal 1 around the origin.
fn normalise(cloud: &Cloud) -> Result<(Frame, Normalised), ExtractError> {
    let found = cloud.points.len();
    if found < LEAST_CONTACTS {
        return Err(ExtractError::TooFewContacts { found });
    }
    for (index, p) in cloud.points.iter().enumerate() {
        let length = p.normal.norm();
        let fine = p.position.iter().all(|x| x.abs() < 1e150)
            && length.is_finite()
            && length > 0.0
            && p.sigma.is_none_or(|s| s.is_finite() && s >= 0.0);
        if !fine {
            return Err(ExtractError::NotFinite { index });
        }
    }
    let (low, high) = cloud
        .bounding_box()
        .ok_or(ExtractError::TooFewContacts { found: 0 })?;
    let scale = (high - low).norm();
    if scale < 1e-140 || scale <= 1e-12 * low.abs().sup(&high.abs()).max() {
        return Err(ExtractError::NoExtent { what: "point" });
    }
    let frame = Frame {
        origin: (low + high) / 2.0,
        scale,
    };
    let positions: Vec<Vec3> = cloud
        .points
        .iter()
        .map(|p| frame.inward(&p.position))
        .collect();
    if on_a_line(&positions) {
        return Err(ExtractError::NoExtent { what: "line" });
    }
    let mut stated: Vec<f64> = cloud
        .points
        .iter()
        .filter_map(|p| p.sigma)
        .filter(|&s| s > 0.0)
        .collect();
    let typical = smoothing::median(&mut stated);
    let relative_sigma = cloud
        .points
        .iter()
        .map(|p| match (p.sigma, typical) {
            (Some(s), Some(t)) => (s / t).clamp(0.05, 20.0),
            _ => 1.0,
        })
        .collect();
    Ok((
        frame,
        Normalised {
            positions,
            normals: cloud.points.iter().map(|p| p.normal.normalize()).collect(),
            relative_sigma,
        },
    ))
}

/// Whether all points lie within a millionth of the extent of one line.
fn on_a_line(positions: &[Vec3]) -> bool {
    let first = positions[0];
    let far = |from: &Vec3| {
        positions
            .iter()
            .map(|p| p - from)
            .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))
            .unwrap_or_default()
    };
    let axis = far(&first);
    let length = axis.norm();
    positions
        .iter()
        .all(|p| axis.cross(&(p - first)).norm() <= 1e-6 * length * length.max(1e-6))
}

/// Fits every ball and the coarse field and blends them.
fn build_field(
    kernel: Kernel,
    data: &Normalised,
    covers: &[smoothing::Cover],
    levels: &Levels,
) -> Result<BlendedField, ExtractError> {
    let fitted: Vec<Option<Ball>> = covers
        .par_iter()
        .map(|cover| fit_ball(kernel, data, cover, levels))
        .collect();
    let balls: Vec<Ball> = fitted.into_iter().flatten().collect();
    if balls.is_empty() {
        return Err(ExtractError::NoSurface);
    }
    let coarse = fit_ball(kernel, data, &coarse_cover(&data.positions), levels);
    Ok(BlendedField::new(balls, coarse))
}

fn fit_ball(
    kernel: Kernel,
    data: &Normalised,
    cover: &smoothing::Cover,
    levels: &Levels,
) -> Option<Ball> {
    if cover.radius <= 0.0 {
        return None;
    }
    let problem = smoothing::problem(kernel, data, cover, levels);
    let tau2 = smoothing::choose_tau2(&problem, cover.radius, levels.tau2, Some(levels.tau2));
    let fit = problem.solve(smoothing::local_tau2(&problem, cover.radius, tau2))?;
    Some(Ball {
        centre: cover.centre,
        radius: cover.radius,
        fit,
    })
}

/// Contacts of the coarse field: farthest-point samples of the whole cloud.
fn coarse_cover(positions: &[Vec3]) -> smoothing::Cover {
    const COARSE: usize = 100;
    let mut members = vec![0_u32];
    let mut distance: Vec<f64> = positions
        .iter()
        .map(|p| (p - positions[0]).norm_squared())
        .collect();
    while members.len() < COARSE.min(positions.len()) {
        let (mut best, mut far) = (0, 0.0);
        for (i, &d) in distance.iter().enumerate() {
            if d > far {
                (best, far) = (i, d);
            }
        }
        if far == 0.0 {
            break;
        }
        members.push(best as u32);
        let p = positions[best];
        for (d, q) in distance.iter_mut().zip(positions) {
            *d = d.min((q - p).norm_squared());
        }
    }
    smoothing::Cover {
        centre: Vec3::zeros(),
        radius: 0.5,
        members,
    }
}

/// Newton steps along the gradient to the zero set, normalised coordinates; steps are cut at `longest`.
fn project(field: &BlendedField, x: &Vec3, longest: f64) -> Option<Vec3> {
    let mut at = *x;
    for _ in 0..8 {
        let (f, g) = field.value_and_gradient(&at);
        let step = g * (f / g.norm_squared());
        let length = step.norm();
        if !length.is_finite() {
            return None;
        }
        at -= if length > longest {
            step * (longest / length)
        } else {
            step
        };
        if length < 1e-7 {
            return Some(at);
        }
    }
    let (f, g) = field.value_and_gradient(&at);
    (f.abs() < 1e-5 * g.norm()).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::OrientedPoint;
    use rand::{RngExt, SeedableRng};

    fn contact(position: Vec3, normal: Vec3) -> OrientedPoint {
        OrientedPoint {
            position,
            normal,
            sigma: None,
            finger: None,
            time_us: None,
        }
    }

    /// Points of an ellipsoid with the given noise of positions and normals.
    fn ellipsoid(count: usize, noise: f64, tilt: f64, seed: u64) -> Cloud {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move || 2.0 * random.random::<f64>() - 1.0;
        let mut cloud = Cloud::default();
        while cloud.points.len() < count {
            let u = Vec3::new(uniform(), uniform(), uniform());
            if u.norm() > 1.0 || u.norm() < 0.1 {
                continue;
            }
            let u = u.normalize();
            let axes = Vec3::new(0.5, 0.35, 0.25);
            let mut jitter = || Vec3::new(uniform(), uniform(), uniform()) * 3f64.sqrt();
            let position = u.component_mul(&axes) + noise * jitter();
            let normal = u.component_div(&axes).normalize() + tilt * jitter();
            cloud.points.push(contact(position, normal.normalize()));
        }
        cloud
    }

    fn distance(x: &Vec3) -> f64 {
        let axes = Vec3::new(0.5, 0.35, 0.25);
        let k = x.component_div(&axes).norm();
        k * (k - 1.0) / x.component_div(&axes.component_mul(&axes)).norm()
    }

    /// Euler characteristic; panics where an edge has not exactly two faces.
    fn euler(mesh: &TriangleMesh) -> i64 {
        let mut edges = std::collections::BTreeMap::new();
        for f in &mesh.faces {
            for i in 0..3 {
                *edges.entry((f[i], f[(i + 1) % 3])).or_insert(0) += 1;
            }
        }
        for (&(a, b), &n) in &edges {
            assert_eq!((n, edges.get(&(b, a))), (1, Some(&1)));
        }
        mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.faces.len() as i64
    }

    #[test]
    fn a_noisy_ellipsoid_comes_back_closed_and_far_truer_than_its_contacts() {
        let (noise, tilt) = (0.005, 0.04);
        let result = extract(&ellipsoid(900, noise, tilt, 1), &Options::default()).unwrap();
        assert_eq!(euler(&result.mesh), 2);
        let squares: f64 = result
            .mesh
            .positions
            .iter()
            .map(|x| distance(x).powi(2))
            .sum();
        let rms = (squares / result.mesh.positions.len() as f64).sqrt();
        assert!(rms < 0.25 * noise, "{rms}");
        assert!(
            (result.noise.position_sigma / noise - 1.0).abs() < 0.15,
            "{:?}",
            result.noise
        );
        assert!(
            (result.noise.normal_sigma / tilt - 1.0).abs() < 0.15,
            "{:?}",
            result.noise
        );
    }

    #[test]
    fn exact_contacts_are_met_exactly() {
        let cloud = ellipsoid(700, 0.0, 0.0, 2);
        let result = extract(&cloud, &Options::default()).unwrap();
        for p in &cloud.points {
            assert!(result.field.value(&p.position).abs() < 1e-5);
            assert!((result.field.gradient(&p.position) - p.normal).norm() < 1e-3);
        }
        let worst = result
            .mesh
            .positions
            .iter()
            .map(|x| distance(x).abs())
            .fold(0.0, f64::max);
        assert!(worst < 5e-4, "{worst}");
    }

    #[test]
    fn the_result_follows_unit_and_place_of_the_input() {
        let cloud = ellipsoid(300, 0.003, 0.02, 3);
        let mut moved = cloud.clone();
        let shift = Vec3::new(1000.0, -2000.0, 500.0);
        for p in &mut moved.points {
            p.position = p.position * 512.0 + shift;
        }
        let here = extract(&cloud, &Options::default()).unwrap();
        let there = extract(&moved, &Options::default()).unwrap();
        assert_eq!(here.mesh.faces.len(), there.mesh.faces.len());
        for (a, b) in here.mesh.positions.iter().zip(&there.mesh.positions) {
            assert!((a * 512.0 + shift - b).norm() < 1e-4);
        }
    }

    #[test]
    fn inputs_without_a_surface_are_refused_with_the_reason() {
        let with = |points: Vec<OrientedPoint>| {
            let cloud = Cloud {
                points,
                rejected: Vec::new(),
            };
            extract(&cloud, &Options::default()).map(|_| ())
        };
        let up = Vec3::z();
        for found in 0..LEAST_CONTACTS {
            let points = vec![contact(up, up); found];
            assert_eq!(with(points), Err(ExtractError::TooFewContacts { found }));
        }
        assert_eq!(
            with(vec![contact(up, up); 20]),
            Err(ExtractError::NoExtent { what: "point" })
        );
        let line = |i: usize| contact(Vec3::new(i as f64, 2.0 * i as f64, 1.0), up);
        assert_eq!(
            with((0..20).map(line).collect()),
            Err(ExtractError::NoExtent { what: "line" })
        );
        let mut points = ellipsoid(20, 0.0, 0.0, 4).points;
        points[7].normal = Vec3::zeros();
        assert_eq!(
            with(points.clone()),
            Err(ExtractError::NotFinite { index: 7 })
        );
        points[7] = contact(Vec3::new(f64::NAN, 0.0, 0.0), up);
        assert_eq!(with(points), Err(ExtractError::NotFinite { index: 7 }));
    }

    #[test]
    fn strange_clouds_end_in_a_result_or_an_error() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut uniform = move || 2.0 * random.random::<f64>() - 1.0;
        for count in [6, 7, 9, 20, 60] {
            for flat in [1.0, 1e-9, 0.0] {
                for scale in [1e-120, 1.0, 1e120] {
                    let points = (0..count)
                        .map(|_| {
                            let p = Vec3::new(uniform(), uniform(), flat * uniform());
                            contact(p * scale, Vec3::new(uniform(), uniform(), uniform()))
                        })
                        .collect();
                    let cloud = Cloud {
                        points,
                        rejected: Vec::new(),
                    };
                    if let Ok(result) = extract(&cloud, &Options::default()) {
                        let finite = |p: &Vec3| p.iter().all(|x| x.is_finite());
                        assert!(result.mesh.positions.iter().all(finite));
                    }
                }
            }
        }
    }
}
