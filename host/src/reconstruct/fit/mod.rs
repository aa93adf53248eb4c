//! Phase 3: least-squares fit of the patch network to points and normals.
//!
//! Each round finds the foot point of every datum, forms one linear system and solves it; four rounds usually
//! do. A datum contributes (paper, eqs. 5 to 8, with the tangent distance in place of the point distance):
//!
//! - the squared distance along the surface normal at its foot point, plus a fiftieth of the squared
//!   distance within the tangent plane (the point may slide: that is what makes four rounds enough);
//! - lambda times the squared disagreement of the tangents with its measured normal ([`NormalTerm`]).
//!
//! Third derivatives and the jump of curvature across edges hold what the data leave open. A round that
//! makes things worse is thrown away.

mod cholesky;
pub mod fairness;
pub mod foot;
pub mod system;

use crate::Vec3;
use crate::spline::bernstein::{CONTROL_POINTS, FIRST, values};
use crate::spline::network::Network;
use crate::spline::patch_regularity;
use foot::{Finder, Foot};
use nalgebra::{Matrix2, Matrix3};
use rayon::prelude::*;
use system::{PatchSums, System, SystemError};

/// Weight of the distance within the tangent plane relative to that along the normal. Below 0.005 points
/// creep along the surface (sphere, 80 patches); above 0.1 the fit converges as slowly as point distance.
const TANGENTIAL: f64 = 0.02;
/// Least weight of the patches' energy within the plane of the base triangle: there it shapes only the
/// parameters, which the data leave open. Below 1e-6 many patches of clean scans fold in their own plane
/// (kitten, bunny); above it exact data lose accuracy (bean: 0.051e-3 of the diagonal at 1e-6, 0.057 at 3e-6, 0.10 at 1e-5;
/// 0.050 at 1e-7).
const PARAMETER_SMOOTHING: f64 = 1e-6;
/// Patches that fold all the same get up to this, in so many attempts.
const MAX_STIFFNESS: f64 = 1e-2;
const UNFOLD_ROUNDS: usize = 2;
/// Distance, relative to the size of the data, that counts as much as two normals at 60 degrees when foot
/// points are searched: more than any wall is thick, less than the object.
const NORMAL_SCALE: f64 = 0.15;
/// Tether of control points to the previous round, relative to the mean diagonal: bounds what no datum holds.
const TETHER: f64 = 1e-8;
/// Beyond this tether a system that cannot be factored is given up.
const MAX_TETHER: f64 = 1e-2;
/// Edge, relative to the size of the data, of the patch for which the smoothing is stated, and the shortest edge by
/// which the energy is scaled.
const REFERENCE_EDGE: f64 = 0.15;
const LEAST_EDGE: f64 = 0.01;
/// A foot point whose normal is more than 78 degrees off the measured one is not believed.
const NORMAL_GATE: f64 = 0.2;

/// One thing the surface has to meet: a measured contact, or a sample of the extracted surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Datum {
    /// Position.
    pub position: Vec3,
    /// Outward unit normal.
    pub normal: Vec3,
    /// Weight of its squared distance.
    pub weight: f64,
    /// Weight of the squared sine of the angle to its normal relative to the squared distance (length^2):
    /// (sigma of the position / sigma of the normal)^2.
    pub normal_weight: f64,
    /// Where it comes from.
    pub kind: Kind,
}

/// Where a datum comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A measured contact.
    Measured,
    /// A sample of the extracted surface.
    Field,
    /// A point of a line that the network's border or creases have to follow: its foot point is sought on
    /// those edges alone, and it holds them from both sides.
    Line,
}

/// How the measured normal enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum NormalTerm {
    /// The component of the normal in the tangent plane, whatever the parameters: the squared sine of the
    /// angle between measured and surface normal.
    #[default]
    ParameterFree,
    /// The paper's eqs. 7 and 8: in the frame of the base triangle the tangents have to be
    /// [1, 0, -nx/nz] and [0, 1, -ny/nz].
    FaceFrame,
}

/// What steers a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitOptions {
    /// Rounds of fit and reparameterisation.
    pub rounds: usize,
    /// How the measured normal enters.
    pub normal_term: NormalTerm,
    /// Weight of the energy per datum, in the direction across the patch, for a patch whose edges are 0.15 of the size of
    /// the data; it falls with the fourth power of the edges.
    pub smoothing: f64,
    /// Scale beyond which a measured datum counts less (same unit as positions); infinite: never.
    pub outlier_scale: f64,
    /// Weight of the jump of curvature across smooth edges: at 1 the mean squared jump over an edge, as the length by
    /// which the second derivatives of patches with edges of 0.15 of the size part, counts as much as an edge's share
    /// of the data. 0: none.
    pub fair_curvature: f64,
}

/// A fitted network.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Global control points.
    pub points: Vec<Vec3>,
    /// Foot point of each datum; `None` where none could be found.
    pub feet: Vec<Option<Foot>>,
    /// Root of the mean squared distance of the measured data after each round.
    pub history: Vec<f64>,
}

/// Fits `network` over base `vertices` to the data, starting from the flat network.
///
/// # Errors
/// When a system cannot be solved.
pub fn fit(
    network: &Network,
    vertices: &[Vec3],
    data: &[Datum],
    options: &FitOptions,
) -> Result<Fit, SystemError> {
    let points = network.flat(vertices);
    let Some(first) = points.first().copied() else {
        return Err(SystemError::NotFinite);
    };
    let (low, high) = data.iter().fold((first, first), |(low, high), d| {
        (low.inf(&d.position), high.sup(&d.position))
    });
    let size = (high - low).norm().max(1e-300);
    let scales = energy_scales(network, vertices, size);
    let system = System::new(network, &scales)?;
    let mut fitting = Fitting {
        network,
        vertices,
        data,
        options,
        system,
        size,
        tether: TETHER,
        stiffness: scales
            .iter()
            .map(|s| (s * options.smoothing).max(PARAMETER_SMOOTHING))
            .collect(),
        scales,
        feet: Finder::new(network, &points, NORMAL_SCALE * size).find_all(data),
        points,
        exact: false,
    };
    let mut history = Vec::new();
    let mut best = f64::INFINITY;
    for round in 0..options.rounds {
        let next = fitting.round(round == 0, round + 1 == options.rounds)?;
        // The first round knows no curvature yet; that the next pays for it with distance is no reason to refuse it.
        let dearer = options.fair_curvature > 0.0 && round == 1;
        if dearer || next.error <= best * 1.05 {
            best = if dearer {
                next.error
            } else {
                best.min(next.error)
            };
            history.push(measured_rms(data, &next.feet));
            fitting.take(next);
        } else if next.exact && !fitting.exact {
            // It alone meets the G1 equations to the last digits: the round before is moved onto them to compare.
            fitting.make_exact();
            let weights = weigh(data, &fitting.feet, options, false);
            if next.error < misfit(data, &fitting.feet, &weights) {
                history.push(measured_rms(data, &next.feet));
                fitting.take(next);
            }
        } else {
            // A round that makes things worse is thrown away; a shorter step is tried in the next.
            fitting.tether = (fitting.tether * 1e4).min(1.0);
        }
    }
    fitting.make_exact();
    fitting.unfold(&mut history)?;
    fitting.cross_creases();
    Ok(Fit {
        points: fitting.points,
        feet: fitting.feet,
        history,
    })
}

/// Weight of each patch's energy. Third derivatives by the parameters grow with the cube of a patch's edge h, so the
/// energy per area of the same surface grows with h^4; divided by it, large and small patches are equally stiff.
fn energy_scales(network: &Network, vertices: &[Vec3], size: f64) -> Vec<f64> {
    let faces = network.faces.iter();
    faces
        .map(|face| {
            let [a, b, c] = face.map(|v| vertices[v as usize] / size);
            let area = 0.5 * (b - a).cross(&(c - a)).norm();
            // Edge of the equilateral triangle of that area.
            let edge = (area * 4.0 / 3.0_f64.sqrt()).sqrt();
            (REFERENCE_EDGE / edge.max(LEAST_EDGE)).powi(4)
        })
        .collect()
}

/// What one round gave.
struct Round {
    points: Vec<Vec3>,
    feet: Vec<Option<Foot>>,
    /// Whether the G1 equations hold to the last digits.
    exact: bool,
    /// Weighted mean squared distance.
    error: f64,
}

/// A fit under way.
struct Fitting<'a> {
    network: &'a Network,
    vertices: &'a [Vec3],
    data: &'a [Datum],
    options: &'a FitOptions,
    system: System,
    size: f64,
    tether: f64,
    /// Weight of each patch's energy against the one smoothing for all.
    scales: Vec<f64>,
    /// Weight of each patch's energy within the plane of its base triangle.
    stiffness: Vec<f64>,
    points: Vec<Vec3>,
    feet: Vec<Option<Foot>>,
    /// Whether the G1 equations hold to the last digits.
    exact: bool,
}

impl Fitting<'_> {
    /// Adds every datum and the patches' own energy to the sums of the patches.
    fn accumulate(&self, weights: &[f64], first: bool) -> Vec<PatchSums> {
        let mut of_face: Vec<Vec<u32>> = vec![Vec::new(); self.network.faces.len()];
        for (number, foot) in self.feet.iter().enumerate() {
            if let Some(foot) = foot
                && weights[number] > 0.0
            {
                of_face[foot.face as usize].push(number as u32);
            }
        }
        of_face
            .par_iter()
            .enumerate()
            .map(|(face, members)| self.sums(face, members, weights, first))
            .collect()
    }

    fn sums(&self, face: usize, members: &[u32], weights: &[f64], first: bool) -> PatchSums {
        let corners = self.network.faces[face].map(|v| self.vertices[v as usize]);
        let [a, b, c] = corners;
        let (across, along) = (
            self.options.smoothing * self.scales[face],
            self.stiffness[face],
        );
        let mut metric = Matrix3::identity() * along;
        if let Some(n) = (b - a).cross(&(c - a)).try_normalize(0.0) {
            metric += n * n.transpose() * (across - along);
        }
        let mut sums = PatchSums::default();
        sums.add_energy(&metric);
        for number in members {
            let number = *number as usize;
            let datum = &self.data[number];
            let Some(foot) = &self.feet[number] else {
                continue;
            };
            let normal = match foot.normal() {
                Some(normal) if !first && normal.dot(&datum.normal) > 0.5 => normal,
                _ => datum.normal,
            };
            add_datum(
                &mut sums,
                datum,
                foot,
                normal,
                weights[number],
                self.options,
                &corners,
            );
        }
        sums
    }

    fn take(&mut self, round: Round) {
        self.points = round.points;
        self.feet = round.feet;
        self.exact = round.exact;
    }

    /// Puts the surface onto the G1 equations, where the last round, which does, was thrown away.
    fn make_exact(&mut self) {
        if !self.exact {
            self.system.project(&mut self.points, self.size);
            self.feet = self.found(&self.points);
            self.exact = true;
        }
    }

    /// The foot points on the network with these control points.
    fn found(&self, points: &[Vec3]) -> Vec<Option<Foot>> {
        Finder::new(self.network, points, NORMAL_SCALE * self.size).find_all(self.data)
    }

    /// One round: weights, sums, solution (`exact` or about so), new foot points.
    fn round(&mut self, first: bool, exact: bool) -> Result<Round, SystemError> {
        let weights = weigh(self.data, &self.feet, self.options, first);
        let sums = self.accumulate(&weights, first);
        let (jumps, fair) = self.fairness(&weights, first);
        let points = loop {
            let smoothing = self.options.smoothing;
            match self.system.solve(
                &sums,
                smoothing,
                (&jumps, fair),
                self.tether,
                &self.points,
                self.size,
                exact,
            ) {
                // Patches that nothing holds: hold them to where they are.
                Err(SystemError::Factor(_)) if self.tether < MAX_TETHER => self.tether *= 100.0,
                solved => break solved?,
            }
        };
        let feet = self.found(&points);
        let error = misfit(self.data, &feet, &weights);
        Ok(Round {
            points,
            feet,
            exact,
            error,
        })
    }

    /// Jumps of curvature and their weight; none in the first round, whose start is flat.
    fn fairness(&self, weights: &[f64], first: bool) -> (Vec<fairness::Jump>, f64) {
        let strength = self.options.fair_curvature;
        let smooth = self.network.smooth.iter().filter(|s| **s).count();
        if first || strength <= 0.0 || smooth == 0 {
            return (Vec::new(), 0.0);
        }
        let total: f64 = weights.iter().sum();
        let jumps = fairness::jumps(self.network, &self.points, &self.scales);
        (jumps, strength * total / smooth as f64)
    }

    /// Stiffens the parameters of folded patches and of their neighbours until none is left or it no longer
    /// helps.
    fn unfold(&mut self, history: &mut Vec<f64>) -> Result<(), SystemError> {
        let mut folded = self.folded();
        for _ in 0..UNFOLD_ROUNDS {
            if folded.is_empty() {
                return Ok(());
            }
            let mut stiffer: Vec<usize> = folded.clone();
            for face in &folded {
                let across = (0..3).filter_map(|l| self.network.table.across(*face, l));
                stiffer.extend(across.map(|side| side.face as usize));
            }
            stiffer.sort_unstable();
            stiffer.dedup();
            for face in stiffer {
                self.stiffness[face] = (self.stiffness[face] * 50.0).min(MAX_STIFFNESS);
            }
            let before = (self.points.clone(), self.feet.clone());
            let next = self.round(false, true)?;
            self.take(next);
            let now = self.folded();
            if now.len() > folded.len() {
                (self.points, self.feet) = before;
                return Ok(());
            }
            folded = now;
            history.push(measured_rms(self.data, &self.feet));
        }
        Ok(())
    }

    /// Contacts that a sheet misses by more than the outlier scale although they lie on the other sheet at its crease
    /// get their foot points there: the normal of a finger that slips over an edge lags behind its place. They are on
    /// the surface, and finer patches would not bring the sheet that their normals name closer.
    fn cross_creases(&mut self) {
        if self.network.creases().is_empty() {
            return;
        }
        let finder = Finder::of_known(self.network, &self.points);
        for (datum, foot) in self.data.iter().zip(&mut self.feet) {
            if let (Kind::Measured, Some(foot)) = (datum.kind, foot)
                && (datum.position - foot.point).norm() > self.options.outlier_scale
                && let Some(other) = finder.across_crease(datum.position, foot)
            {
                *foot = other;
            }
        }
    }

    /// Patches whose normal turns over.
    fn folded(&self) -> Vec<usize> {
        self.network
            .patches(&self.points)
            .iter()
            .enumerate()
            .filter(|(_, patch)| patch_regularity(patch).1)
            .map(|(face, _)| face)
            .collect()
    }
}

/// Robust weight of each datum at its foot point (0: left out).
fn weigh(data: &[Datum], feet: &[Option<Foot>], options: &FitOptions, first: bool) -> Vec<f64> {
    data.iter()
        .zip(feet)
        .map(|(datum, foot)| {
            let Some(foot) = foot else { return 0.0 };
            if datum.kind == Kind::Line {
                return datum.weight;
            }
            let agreement = foot.normal().map_or(1.0, |n| n.dot(&datum.normal));
            if agreement < NORMAL_GATE && !first {
                return 0.0;
            }
            let distance = (datum.position - foot.point).norm();
            let robust =
                if datum.kind == Kind::Measured && !first && distance > options.outlier_scale {
                    // Beyond the scale the pull stays bounded (Geman-McClure's tail).
                    (options.outlier_scale / distance).powi(4)
                } else {
                    1.0
                };
            datum.weight * robust
        })
        .collect()
}

fn add_datum(
    sums: &mut PatchSums,
    datum: &Datum,
    foot: &Foot,
    normal: Vec3,
    weight: f64,
    options: &FitOptions,
    corners: &[Vec3; 3],
) {
    // A point of a line may slide along the line only, any other within the tangent plane.
    let free = match foot.along {
        Some(along) => along * along.transpose(),
        None => Matrix3::identity() - normal * normal.transpose(),
    };
    let metric = (Matrix3::identity() - free * (1.0 - TANGENTIAL)) * weight;
    let place = values::<CONTROL_POINTS>(5, foot.barycentric);
    sums.add(&place, &metric, &datum.position);
    let strength = weight * datum.normal_weight;
    if strength <= 0.0 {
        return;
    }
    let [du, dv] = [0, 1].map(|d| FIRST[d].weights(foot.barycentric));
    let mix = |u: f64, v: f64| -> [f64; CONTROL_POINTS] {
        std::array::from_fn(|c| u * du[c] + v * dv[c])
    };
    match options.normal_term {
        NormalTerm::ParameterFree => {
            let measured = datum.normal * datum.normal.transpose() * strength;
            let [u, v] = foot.tangents;
            let trace = u.norm_squared() + v.norm_squared();
            let form = Matrix2::new(u.norm_squared(), u.dot(&v), u.dot(&v), v.norm_squared())
                + Matrix2::identity() * (0.01 * trace + 1e-300);
            // r^T form^-1 r = |L^-1 r|^2 with form = L L^T.
            let l00 = form[(0, 0)].sqrt();
            let l10 = form[(1, 0)] / l00;
            let l11 = (form[(1, 1)] - l10 * l10).max(1e-300).sqrt();
            sums.add(&mix(1.0 / l00, 0.0), &measured, &Vec3::zeros());
            sums.add(
                &mix(-l10 / (l00 * l11), 1.0 / l11),
                &measured,
                &Vec3::zeros(),
            );
        }
        NormalTerm::FaceFrame => {
            let [a, b, c] = *corners;
            let Some(x) = (b - a).try_normalize(0.0) else {
                return;
            };
            let Some(z) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
                return;
            };
            let y = z.cross(&x);
            let nz = datum.normal.dot(&z);
            if nz < NORMAL_GATE {
                return;
            }
            // S_u = S_x (b - a).x, S_v = S_x (c - a).x + S_y (c - a).y.
            let (bx, cx, cy) = ((b - a).dot(&x), (c - a).dot(&x), (c - a).dot(&y));
            let metric = Matrix3::identity() * strength;
            for (weights, axis) in [(mix(1.0 / bx, 0.0), x), (mix(-cx / (bx * cy), 1.0 / cy), y)] {
                let tangent = axis - z * (datum.normal.dot(&axis) / nz);
                sums.add(&weights, &metric, &tangent);
            }
        }
    }
}

/// Weighted mean squared distance, the figure by which rounds are compared.
fn misfit(data: &[Datum], feet: &[Option<Foot>], weights: &[f64]) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for ((datum, foot), weight) in data.iter().zip(feet).zip(weights) {
        if let Some(foot) = foot {
            sum += weight * (datum.position - foot.point).norm_squared();
            total += weight;
        }
    }
    if total > 0.0 { sum / total } else { 0.0 }
}

fn measured_rms(data: &[Datum], feet: &[Option<Foot>]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (datum, foot) in data
        .iter()
        .zip(feet)
        .filter(|(d, _)| d.kind == Kind::Measured)
    {
        if let Some(foot) = foot {
            sum += (datum.position - foot.point).norm_squared();
            count += 1;
        }
    }
    (sum / count.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::Surface;
    use rand::{RngExt, SeedableRng};

    fn icosahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let g = (1.0 + 5.0_f64.sqrt()) / 2.0;
        let mut vertices = Vec::new();
        for turn in 0..3 {
            for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
                let mut v = Vec3::zeros();
                v[turn] = a;
                v[(turn + 1) % 3] = b;
                vertices.push(v.normalize());
            }
        }
        let mut faces = Vec::new();
        for a in 0..12u32 {
            for b in a + 1..12 {
                for c in b + 1..12 {
                    let [p, q, r] = [a, b, c].map(|v| vertices[v as usize]);
                    let near = |x: Vec3, y: Vec3| (x - y).norm() < 1.1;
                    if near(p, q) && near(q, r) && near(r, p) {
                        let outward = (q - p).cross(&(r - p)).dot(&p) > 0.0;
                        faces.push(if outward { [a, b, c] } else { [a, c, b] });
                    }
                }
            }
        }
        (vertices, faces)
    }

    /// The surface of a fit over a closed base.
    fn surface(network: &Network, fit: &Fit) -> Surface {
        let base_vertices = network
            .faces
            .iter()
            .flatten()
            .max()
            .map_or(0, |v| *v as usize + 1);
        Surface {
            vertices: fit.points[..base_vertices].to_vec(),
            faces: network.faces.clone(),
            control_points: network.patches(&fit.points),
            ..Surface::default()
        }
    }

    #[test]
    fn sphere_is_met_as_in_the_trials() {
        let (vertices, faces) = icosahedron();
        let network = Network::new(&vertices, &faces, &[], &[]).unwrap();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let data: Vec<Datum> =
            std::iter::repeat_with(|| Vec3::from_fn(|_, _| random.random_range(-1.0..1.0)))
                .filter(|v| v.norm() > 0.1 && v.norm() < 1.0)
                .take(1229)
                .map(|v| Datum {
                    position: v.normalize(),
                    normal: v.normalize(),
                    weight: 1.0,
                    normal_weight: 1e-2,
                    kind: Kind::Measured,
                })
                .collect();
        for normal_term in [NormalTerm::ParameterFree, NormalTerm::FaceFrame] {
            let options = FitOptions {
                rounds: 4,
                normal_term,
                smoothing: 1e-6,
                outlier_scale: f64::INFINITY,
                fair_curvature: 0.0,
            };
            let fit = fit(&network, &vertices, &data, &options).unwrap();
            let measures = surface(&network, &fit).measure().unwrap();
            println!("{normal_term:?} {:?} {measures:?}", fit.history);
            assert!(
                measures.g1_max_degrees < 1e-9,
                "{}",
                measures.g1_max_degrees
            );
            assert_eq!(measures.folded_patches, 0);
            if normal_term == NormalTerm::ParameterFree {
                // The trial: rms 1.6e-4 at 20 patches.
                assert!(*fit.history.last().unwrap() < 2.5e-4, "{:?}", fit.history);
            } else {
                assert!(*fit.history.last().unwrap() < 1e-2, "{:?}", fit.history);
            }
        }
    }

    #[test]
    fn fair_curvature_brings_curvature_together_and_keeps_to_the_data() {
        let (vertices, faces) = icosahedron();
        let network = Network::new(&vertices, &faces, &[], &[]).unwrap();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        // An ellipsoid, its points off by up to 0.01.
        let axes = Vec3::new(1.0, 0.8, 0.6);
        let data: Vec<Datum> =
            std::iter::repeat_with(|| Vec3::from_fn(|_, _| random.random_range(-1.0..1.0)))
                .filter(|v| v.norm() > 0.1 && v.norm() < 1.0)
                .take(1000)
                .enumerate()
                .map(|(k, v)| {
                    let round = v.normalize();
                    let normal = round.component_div(&axes).normalize();
                    Datum {
                        position: round.component_mul(&axes)
                            + normal * (0.01 * (12.9898 * k as f64).sin()),
                        normal,
                        weight: 1.0,
                        normal_weight: 1e-2,
                        kind: Kind::Measured,
                    }
                })
                .collect();
        let base: Vec<Vec3> = vertices.iter().map(|v| v.component_mul(&axes)).collect();
        let [plain, fair] = [0.0, 1.0].map(|fair_curvature| {
            let options = FitOptions {
                rounds: 4,
                normal_term: NormalTerm::ParameterFree,
                smoothing: 1e-6,
                outlier_scale: f64::INFINITY,
                fair_curvature,
            };
            let fit = fit(&network, &base, &data, &options).unwrap();
            let measures = surface(&network, &fit).measure().unwrap();
            assert!(measures.g1_max_degrees < 1e-9);
            (measures.curvature_jump_rms, *fit.history.last().unwrap())
        });
        assert!(fair.0 < 0.2 * plain.0, "{plain:?} {fair:?}");
        assert!(fair.1 < 1.1 * plain.1, "{plain:?} {fair:?}");
    }
}
