//! One level of a chart's fit: foot points, one linear system, again.
//!
//! A datum contributes as in the network's fit ([`crate::reconstruct::fit`]): the squared distance along the
//! surface normal at its foot point, a fiftieth of that within the tangent plane, the measured normal's
//! component in the tangent plane, with weights from the noise. The border of the extracted mesh holds the edge
//! of the region and may slide along it.
//!
//! What the data leave open is held by the variation of the second derivatives: differences of the Hessian between
//! neighbouring samples, over their distance, in a frame in which the triangle has unit edges. That is the energy of third
//! derivatives of the network's fit, and it also counts the jumps that a spline of degree 2 has across knot lines.

use super::flatten::Flat;
use super::lattice::Lattice;
use super::system::{Normal, Row};
use super::{ChartFitError, ChartOptions, FittedChart};
use crate::Vec3;
use crate::mesh::{AabbTree, TriangleMesh};
use crate::reconstruct::fit::foot::Foot;
use crate::reconstruct::fit::{Datum, Kind};
use crate::spline::chart::{Chart, CloudBounds, inside, knot_clouds, nearest_on_border};
use crate::spline::simplex::{Approach, KnotNet, TriangularBSpline, Vec2, Workspace};
use nalgebra::{Matrix2, Matrix3};
use rayon::prelude::*;

/// Weight of the distance within the tangent plane relative to that along the normal. The map into the plane is a good
/// parameterisation already: it is kept stiffer than the network's (0.02), or the parameters drift towards the border until
/// the rim folds (bowl).
const TANGENTIAL: f64 = 0.1;
/// Weight of the energy within the tangent plane: there it shapes only the parameters.
const PARAMETER_SMOOTHING: f64 = 1e-5;
/// Where the parameters fold all the same, and around, the weight grows by this factor in each of so many further rounds.
const UNFOLD: f64 = 50.0;
const UNFOLD_ROUNDS: usize = 2;
/// Share of the plain second derivatives in the energy; keeps quadratics bounded in the ring.
const BENDING: f64 = 1e-3;
/// Tether of control points to where they were, relative to the mean diagonal.
const TETHER: f64 = 1e-9;
/// A foot point whose normal is more than 78 degrees off the measured one is not believed.
const NORMAL_GATE: f64 = 0.2;
/// Samples along a triangle's edge for the energy: knot lines run in bundles a quarter of an edge wide.
const ENERGY_STEPS: usize = 4;
/// Gauss-Newton steps per round and datum.
const FOOT_STEPS: usize = 5;

/// Where a datum belongs on the chart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its parameters.
    pub u: Vec2,
    /// The surface point.
    pub point: Vec3,
    /// Derivatives by both parameters.
    pub tangents: [Vec3; 2],
}

impl Place {
    fn normal(&self) -> Option<Vec3> {
        let [du, dv] = self.tangents;
        let cross = du.cross(&dv);
        let scale = du.norm_squared().max(dv.norm_squared());
        (cross.norm() > 1e-9 * scale).then(|| cross.normalize())
    }
}

/// The data of a chart and their first places: measured points and samples by their foot point on the extracted mesh,
/// points of the border by the border itself.
pub(super) fn place(
    mesh: &TriangleMesh,
    flat: &Flat,
    data: &[Datum],
) -> (Vec<Datum>, Vec<Option<Place>>) {
    let tree = AabbTree::new(mesh);
    let mut all: Vec<Datum> = data
        .iter()
        .filter(|d| d.kind != Kind::Line)
        .copied()
        .collect();
    let mut places: Vec<Option<Place>> = all
        .par_iter()
        .map(|datum| {
            let facing = |f: u32| mesh.face_normal(f).dot(&datum.normal) > NORMAL_GATE;
            let foot = tree
                .closest_where(mesh, &datum.position, f64::INFINITY, facing)
                .or_else(|| tree.closest(mesh, &datum.position))?;
            let face = mesh.faces[foot.face as usize];
            let u = (0..3)
                .map(|k| flat.places[face[k] as usize] * foot.barycentric[k])
                .sum();
            Some(Place {
                u,
                point: foot.position,
                tangents: [Vec3::zeros(); 2],
            })
        })
        .collect();
    let weight = data
        .iter()
        .find(|d| d.kind == Kind::Line)
        .map_or(1.0, |d| d.weight);
    for vertex in &flat.border {
        let position = mesh.positions[*vertex as usize];
        all.push(Datum {
            position,
            normal: Vec3::z(),
            weight,
            normal_weight: 0.0,
            kind: Kind::Line,
        });
        places.push(Some(Place {
            u: flat.places[*vertex as usize],
            point: position,
            tangents: [Vec3::zeros(); 2],
        }));
    }
    (all, places)
}

/// A triangulation with knots, ready to be fitted.
pub(super) struct Level {
    net: KnotNet,
    bounds: CloudBounds,
    outline: Vec<Vec2>,
    /// Number of each basis function among the shared control points.
    numbers: Vec<u32>,
    count: usize,
    /// Energy of each triangle.
    energy: Vec<Energy>,
    /// Triangles that meet the region.
    inner: Vec<u32>,
}

/// What a level's fit gave.
pub(super) struct LevelFit {
    chart: Chart,
    pub places: Vec<Option<Place>>,
    functions: usize,
    bounds: CloudBounds,
    history: Vec<f64>,
}

/// The energy of one triangle as a quadratic form on the functions it sees.
struct Energy {
    /// The functions, in rising order.
    numbers: Vec<u32>,
    /// Lower triangle of the form, row by row.
    form: Vec<f64>,
    /// The triangle's middle.
    middle: Vec2,
}

/// Values and gradients of the shared functions at a point.
struct Basis {
    value: Row,
    along: [Row; 2],
}

impl Level {
    pub fn new(degree: usize, lattice: &Lattice, outline: &[Vec2]) -> Result<Self, ChartFitError> {
        let (clouds, bounds) = knot_clouds(degree, &lattice.vertices, &lattice.triangles)?;
        let net = KnotNet::new(degree, &clouds, lattice.triangles.clone())?;
        let (numbers, count) = net.shared_numbers();
        let blank = TriangularBSpline::new(net.clone(), vec![Vec3::zeros(); net.functions()])?;
        let inner = Chart::new(blank, outline.to_vec(), Vec::new())?
            .inner_triangles()
            .to_vec();
        let mut level = Self {
            net,
            bounds,
            outline: outline.to_vec(),
            numbers,
            count,
            energy: Vec::new(),
            inner,
        };
        level.energy = level.energies();
        Ok(level)
    }

    pub fn inner_count(&self) -> usize {
        self.inner.len()
    }

    /// Hessians (xx, sqrt 2 xy, yy) of the shared functions at a point.
    fn hessians(&self, u: Vec2, workspace: &mut Workspace) -> Vec<(u32, [f64; 3])> {
        let per = self.net.functions_per_triangle();
        let mut out: Vec<(u32, [f64; 3])> = Vec::new();
        for triangle in self.net.triangles_at(u) {
            let jets = self.net.jets(triangle, u, Approach::default(), workspace);
            for (jet, number) in jets.iter().zip(&self.numbers[triangle * per..]) {
                let [xx, xy, yy] = jet.hessian;
                if xx != 0.0 || xy != 0.0 || yy != 0.0 {
                    out.push((*number, [xx, std::f64::consts::SQRT_2 * xy, yy]));
                }
            }
        }
        out.sort_by_key(|entry| entry.0);
        out
    }

    fn energies(&self) -> Vec<Energy> {
        (0..self.net.triangles().len())
            .into_par_iter()
            .map_init(Workspace::default, |workspace, triangle| {
                self.energy_of(triangle, workspace)
            })
            .collect()
    }

    fn energy_of(&self, triangle: usize, workspace: &mut Workspace) -> Energy {
        const STEPS: usize = ENERGY_STEPS;
        let [a, b, c] = self.net.triangles()[triangle].map(|v| self.net.cloud(v as usize)[0]);
        let area = (b - a).perp(&(c - a)) / 2.0;
        // Edge of the equilateral triangle of the same area.
        let edge = (4.0 * area / 3.0_f64.sqrt()).sqrt();
        let middle = (a + b + c) / 3.0;
        let mut samples = Vec::new();
        let mut pairs = Vec::new();
        // Rows of falling length: row 0 has STEPS + 1 samples.
        let place = |i: usize, j: usize| i * (STEPS + 1) - i * i.saturating_sub(1) / 2 + j;
        for i in 0..=STEPS {
            for j in 0..=STEPS - i {
                let k = STEPS - i - j;
                let u = (a * i as f64 + b * j as f64 + c * k as f64) / STEPS as f64;
                // Drawn a little inwards: the triangle's own edges are knot lines.
                let u = middle + (u - middle) * 0.98;
                samples.push((u, self.hessians(u, workspace)));
                if i + j < STEPS {
                    pairs.push((place(i, j), place(i + 1, j)));
                    pairs.push((place(i, j), place(i, j + 1)));
                    pairs.push((place(i + 1, j), place(i, j + 1)));
                }
            }
        }
        let mut numbers: Vec<u32> = samples
            .iter()
            .flat_map(|(_, entries)| entries.iter().map(|e| e.0))
            .collect();
        numbers.sort_unstable();
        numbers.dedup();
        let local = |number: u32| numbers.binary_search(&number).unwrap_or(0);
        let mut form = vec![0.0; numbers.len() * (numbers.len() + 1) / 2];
        let mut add = |parts: &[(usize, f64)]| {
            for part in 0..3 {
                let mut row: Row = Vec::new();
                for (sample, weight) in parts {
                    let entries = &samples[*sample].1;
                    row.extend(entries.iter().map(|(n, h)| (*n, h[part] * weight)));
                }
                let row: Vec<(usize, f64)> =
                    merged(row).iter().map(|(n, w)| (local(*n), *w)).collect();
                for (k, (i, wi)) in row.iter().enumerate() {
                    for (j, wj) in &row[..=k] {
                        form[i * (i + 1) / 2 + j] += wi * wj;
                    }
                }
            }
        };
        let weight = (2.0 / pairs.len() as f64).sqrt() * edge.powi(3);
        for (p, q) in pairs {
            let scale = weight / (samples[p].0 - samples[q].0).norm();
            add(&[(p, scale), (q, -scale)]);
        }
        let weight = (BENDING / samples.len() as f64).sqrt() * edge.powi(2);
        for sample in 0..samples.len() {
            add(&[(sample, weight)]);
        }
        Energy {
            numbers,
            form,
            middle,
        }
    }

    fn basis(&self, u: Vec2, workspace: &mut Workspace) -> Basis {
        let per = self.net.functions_per_triangle();
        let (mut value, mut x, mut y) = (Vec::new(), Vec::new(), Vec::new());
        for triangle in self.net.triangles_at(u) {
            let jets = self.net.jets(triangle, u, Approach::default(), workspace);
            for (jet, number) in jets.iter().zip(&self.numbers[triangle * per..]) {
                if jet.value != 0.0 {
                    value.push((*number, jet.value));
                    x.push((*number, jet.gradient[0]));
                    y.push((*number, jet.gradient[1]));
                }
            }
        }
        Basis {
            value: merged(value),
            along: [merged(x), merged(y)],
        }
    }

    fn chart(&self, points: &[Vec3]) -> Result<Chart, ChartFitError> {
        let control = self.numbers.iter().map(|n| points[*n as usize]).collect();
        let spline = TriangularBSpline::new(self.net.clone(), control)?;
        Ok(Chart::new(spline, self.outline.clone(), Vec::new())?)
    }

    /// Rounds of fit and reparameterisation. `places` are taken from the level before or from [`place`].
    pub fn fit(
        &self,
        mesh: &TriangleMesh,
        flat: &Flat,
        data: &[Datum],
        places: Vec<Option<Place>>,
        options: &ChartOptions,
        rounds: usize,
    ) -> Result<LevelFit, ChartFitError> {
        let mut points = self.start(mesh, flat);
        let mut places = places;
        let mut chart = None;
        let mut best = f64::INFINITY;
        let mut tether = TETHER;
        let mut history = Vec::new();
        let fresh = places
            .iter()
            .flatten()
            .all(|p| p.tangents[0] == Vec3::zeros());
        let mut stiffness = vec![PARAMETER_SMOOTHING; self.energy.len()];
        for round in 0..rounds + UNFOLD_ROUNDS {
            let first = fresh && round == 0;
            if round >= rounds {
                let Some(chart) = chart
                    .as_ref()
                    .filter(|chart| self.stiffen(chart, &mut stiffness))
                else {
                    break;
                };
                // Stiffer parameters fit less well: that is no reason to throw the round away.
                best = f64::INFINITY;
                points = self.shared_points(chart);
            }
            let weights = weigh(data, &places, options, first);
            let next = self.solve(
                data, &places, &weights, options, &stiffness, tether, &points, first,
            )?;
            let next_chart = self.chart(&next)?;
            let next_places = self.feet(&next_chart, data, &places);
            let error = misfit(data, &next_places, &weights);
            if error <= best * 1.05 || chart.is_none() {
                best = best.min(error);
                (points, places) = (next, next_places);
                chart = Some(next_chart);
                history.push(measured_rms(data, &places));
            } else {
                // A round that makes things worse is thrown away; a shorter step is tried in the next.
                tether = (tether * 1e4).min(1.0);
            }
        }
        let chart = chart.ok_or(super::ChartSystemError::NotFinite)?;
        let mut reached = vec![false; self.count];
        let seen: Vec<Basis> = self
            .region_samples()
            .par_iter()
            .map_init(Workspace::default, |workspace, u| self.basis(*u, workspace))
            .collect();
        for basis in &seen {
            for (number, _) in &basis.value {
                reached[*number as usize] = true;
            }
        }
        Ok(LevelFit {
            chart,
            places,
            functions: reached.iter().filter(|r| **r).count(),
            bounds: self.bounds,
            history,
        })
    }

    /// Control points by their shared numbers.
    fn shared_points(&self, chart: &Chart) -> Vec<Vec3> {
        let mut points = vec![Vec3::zeros(); self.count];
        for (number, point) in self.numbers.iter().zip(chart.spline().control_points()) {
            points[*number as usize] = *point;
        }
        points
    }

    /// Raises the weight of the parameters' energy at folded triangles and their neighbours; false if none folds.
    fn stiffen(&self, chart: &Chart, stiffness: &mut [f64]) -> bool {
        let folded = chart.folded_triangles();
        let mut near = vec![false; self.net.vertices()];
        for triangle in &folded {
            for vertex in self.net.triangles()[*triangle as usize] {
                near[vertex as usize] = true;
            }
        }
        for (corners, weight) in self.net.triangles().iter().zip(stiffness) {
            if corners.iter().any(|v| near[*v as usize]) {
                *weight *= UNFOLD;
            }
        }
        !folded.is_empty()
    }

    /// Points all over the region, a twelfth of an edge apart.
    fn region_samples(&self) -> Vec<Vec2> {
        const STEPS: usize = 12;
        let mut out = self.outline.clone();
        for triangle in &self.inner {
            let [a, b, c] =
                self.net.triangles()[*triangle as usize].map(|v| self.net.cloud(v as usize)[0]);
            for i in 0..=STEPS {
                for j in 0..=STEPS - i {
                    let k = STEPS - i - j;
                    let u = (a * i as f64 + b * j as f64 + c * k as f64) / STEPS as f64;
                    if inside(&self.outline, u) {
                        out.push(u);
                    }
                }
            }
        }
        out
    }

    /// First control points: the extracted mesh near each function's Greville point.
    fn start(&self, mesh: &TriangleMesh, flat: &Flat) -> Vec<Vec3> {
        let plane = TriangleMesh {
            positions: flat
                .places
                .iter()
                .map(|u| Vec3::new(u.x, u.y, 0.0))
                .collect(),
            faces: mesh.faces.clone(),
        };
        let tree = AabbTree::new(&plane);
        let mut points = vec![Vec3::zeros(); self.count];
        for (u, number) in self.net.greville_points().iter().zip(&self.numbers) {
            if let Some(foot) = tree.closest(&plane, &Vec3::new(u.x, u.y, 0.0)) {
                let face = mesh.faces[foot.face as usize];
                points[*number as usize] = (0..3)
                    .map(|k| mesh.positions[face[k] as usize] * foot.barycentric[k])
                    .sum();
            }
        }
        points
    }

    fn solve(
        &self,
        data: &[Datum],
        places: &[Option<Place>],
        weights: &[f64],
        options: &ChartOptions,
        stiffness: &[f64],
        tether: f64,
        previous: &[Vec3],
        first: bool,
    ) -> Result<Vec<Vec3>, ChartFitError> {
        let mut sums = Normal::new(self.count);
        let before = if first {
            None
        } else {
            Some(self.chart(previous)?)
        };
        let across = options.smoothing;
        let metrics: Vec<Matrix3<f64>> = self
            .energy
            .par_iter()
            .zip(stiffness)
            .map_init(Workspace::default, |workspace, (energy, along)| {
                let normal = before.as_ref().and_then(|chart| {
                    let jet = chart.jet(energy.middle, workspace)?;
                    jet.gradient[0].cross(&jet.gradient[1]).try_normalize(1e-12)
                });
                let along = *along;
                let mut metric = Matrix3::identity() * along;
                if let Some(n) = normal {
                    metric += n * n.transpose() * (across - along);
                }
                metric
            })
            .collect();
        for (energy, metric) in self.energy.iter().zip(&metrics) {
            sums.add_form(&energy.numbers, &energy.form, metric);
        }
        let seen: Vec<Option<Basis>> = places
            .par_iter()
            .map_init(Workspace::default, |workspace, place| {
                place.as_ref().map(|p| self.basis(p.u, workspace))
            })
            .collect();
        for (number, datum) in data.iter().enumerate() {
            let (Some(basis), Some(place)) = (&seen[number], &places[number]) else {
                continue;
            };
            if weights[number] > 0.0 {
                self.add_datum(&mut sums, datum, place, basis, weights[number], first);
            }
        }
        Ok(sums.solve(tether, previous)?)
    }

    fn add_datum(
        &self,
        sums: &mut Normal,
        datum: &Datum,
        place: &Place,
        basis: &Basis,
        weight: f64,
        first: bool,
    ) {
        let [du, dv] = place.tangents;
        if datum.kind == Kind::Line {
            // May slide along the border only.
            let (side, _, _) = nearest_on_border(&self.outline, place.u);
            let way = self.outline[(side + 1) % self.outline.len()] - self.outline[side];
            let along = (du * way.x + dv * way.y).try_normalize(1e-300);
            let free = along.map_or_else(Matrix3::zeros, |a| a * a.transpose());
            let metric = (Matrix3::identity() - free * (1.0 - TANGENTIAL)) * weight;
            sums.add(&basis.value, &metric, &datum.position);
            return;
        }
        let normal = match place.normal() {
            Some(normal) if !first && normal.dot(&datum.normal) > 0.5 => normal,
            _ => datum.normal,
        };
        // The first round takes the map into the plane as it is.
        let slide = if first { 0.0 } else { 1.0 - TANGENTIAL };
        let free = Matrix3::identity() - normal * normal.transpose();
        let metric = (Matrix3::identity() - free * slide) * weight;
        sums.add(&basis.value, &metric, &datum.position);
        let strength = weight * datum.normal_weight;
        if strength <= 0.0 {
            return;
        }
        let measured = datum.normal * datum.normal.transpose() * strength;
        let form = if first {
            // The map into the plane keeps lengths about as they are.
            Matrix2::identity()
        } else {
            let trace = du.norm_squared() + dv.norm_squared();
            Matrix2::new(
                du.norm_squared(),
                du.dot(&dv),
                du.dot(&dv),
                dv.norm_squared(),
            ) + Matrix2::identity() * (0.01 * trace + 1e-300)
        };
        // r^T form^-1 r = |L^-1 r|^2 with form = L L^T.
        let l00 = form[(0, 0)].sqrt();
        let l10 = form[(1, 0)] / l00;
        let l11 = (form[(1, 1)] - l10 * l10).max(1e-300).sqrt();
        let mix = |x: f64, y: f64| -> Row {
            basis.along[0]
                .iter()
                .zip(&basis.along[1])
                .map(|((n, a), (_, b))| (*n, x * a + y * b))
                .collect()
        };
        sums.add(&mix(1.0 / l00, 0.0), &measured, &Vec3::zeros());
        sums.add(
            &mix(-l10 / (l00 * l11), 1.0 / l11),
            &measured,
            &Vec3::zeros(),
        );
    }

    /// New foot points by Gauss-Newton steps from the old ones, kept within the region.
    fn feet(&self, chart: &Chart, data: &[Datum], places: &[Option<Place>]) -> Vec<Option<Place>> {
        let reach = self.net_edge();
        data.par_iter()
            .zip(places)
            .map_init(Workspace::default, |workspace, (datum, place)| {
                let start = place.as_ref()?.u;
                let mut at =
                    self.evaluate(chart, self.within_region(datum.kind, start), workspace)?;
                let mut best = at;
                let mut best_distance = (datum.position - at.point).norm_squared();
                for _ in 0..FOOT_STEPS {
                    let step = self.foot_step(datum, &at);
                    let length = step.norm();
                    let step = step * (reach / length.max(reach));
                    let next = self.within_region(datum.kind, at.u + step);
                    let moved = (next - at.u).norm();
                    at = self.evaluate(chart, next, workspace)?;
                    let distance = (datum.position - at.point).norm_squared();
                    if distance < best_distance {
                        (best, best_distance) = (at, distance);
                    }
                    if moved < 1e-12 * reach {
                        break;
                    }
                }
                Some(best)
            })
            .collect()
    }

    fn net_edge(&self) -> f64 {
        let mut sum = 0.0;
        for triangle in &self.inner {
            let [a, b, _] =
                self.net.triangles()[*triangle as usize].map(|v| self.net.cloud(v as usize)[0]);
            sum += (b - a).norm();
        }
        sum / self.inner.len().max(1) as f64
    }

    fn foot_step(&self, datum: &Datum, at: &Place) -> Vec2 {
        let [du, dv] = at.tangents;
        let residual = datum.position - at.point;
        if datum.kind == Kind::Line {
            let (side, _, _) = nearest_on_border(&self.outline, at.u);
            let way = self.outline[(side + 1) % self.outline.len()] - self.outline[side];
            let along = du * way.x + dv * way.y;
            return way * (along.dot(&residual) / along.norm_squared().max(1e-300));
        }
        let (a, b, c) = (du.norm_squared(), du.dot(&dv), dv.norm_squared());
        let ridge = 1e-12 * (a + c) + 1e-300;
        let det = (a + ridge) * (c + ridge) - b * b;
        let (r, s) = (du.dot(&residual), dv.dot(&residual));
        Vec2::new(
            ((c + ridge) * r - b * s) / det,
            ((a + ridge) * s - b * r) / det,
        )
    }

    fn within_region(&self, kind: Kind, u: Vec2) -> Vec2 {
        if kind != Kind::Line && inside(&self.outline, u) {
            return u;
        }
        nearest_on_border(&self.outline, u).2
    }

    fn evaluate(&self, chart: &Chart, u: Vec2, workspace: &mut Workspace) -> Option<Place> {
        let jet = chart.jet(u, workspace)?;
        Some(Place {
            u,
            point: jet.value,
            tangents: jet.gradient,
        })
    }
}

/// Adds up entries of the same function.
fn merged(mut row: Row) -> Row {
    row.sort_by_key(|entry| entry.0);
    let mut out: Row = Vec::with_capacity(row.len());
    for (number, weight) in row {
        match out.last_mut() {
            Some((last, sum)) if *last == number => *sum += weight,
            _ => out.push((number, weight)),
        }
    }
    out
}

/// Robust weight of each datum at its place (0: left out).
fn weigh(
    data: &[Datum],
    places: &[Option<Place>],
    options: &ChartOptions,
    first: bool,
) -> Vec<f64> {
    data.iter()
        .zip(places)
        .map(|(datum, place)| {
            let Some(place) = place else { return 0.0 };
            if datum.kind == Kind::Line || first {
                return datum.weight;
            }
            let agreement = place.normal().map_or(1.0, |n| n.dot(&datum.normal));
            if agreement < NORMAL_GATE {
                return 0.0;
            }
            let distance = (datum.position - place.point).norm();
            let robust = if datum.kind == Kind::Measured && distance > options.outlier_scale {
                (options.outlier_scale / distance).powi(4)
            } else {
                1.0
            };
            datum.weight * robust
        })
        .collect()
}

/// Weighted mean squared distance.
fn misfit(data: &[Datum], places: &[Option<Place>], weights: &[f64]) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for ((datum, place), w) in data.iter().zip(places).zip(weights) {
        if let Some(place) = place {
            sum += w * (datum.position - place.point).norm_squared();
            weight += w;
        }
    }
    sum / f64::max(weight, 1e-300)
}

fn measured_rms(data: &[Datum], places: &[Option<Place>]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (datum, place) in data.iter().zip(places) {
        if let (Kind::Measured, Some(place)) = (datum.kind, place) {
            sum += (datum.position - place.point).norm_squared();
            count += 1;
        }
    }
    (sum / count.max(1) as f64).sqrt()
}

impl LevelFit {
    /// The chart with its foot points as the rest of the program knows them.
    pub fn finish(&self, data: &[Datum], stretch: [f64; 2]) -> FittedChart {
        let feet = data
            .iter()
            .zip(&self.places)
            .map(|(_, place)| {
                let place = place.as_ref()?;
                let (triangle, barycentric) = self.chart.triangle_at(place.u)?;
                Some(Foot {
                    face: triangle as u32,
                    barycentric,
                    point: place.point,
                    tangents: place.tangents,
                    along: None,
                })
            })
            .collect();
        let border = self.chart.border();
        let on_border = self
            .places
            .iter()
            .map(|place| {
                place.as_ref().is_some_and(|p| {
                    let (_, _, nearest) = nearest_on_border(border, p.u);
                    (nearest - p.u).norm() < 1e-9
                })
            })
            .collect();
        FittedChart {
            chart: self.chart.clone(),
            feet,
            on_border,
            functions: self.functions,
            bounds: self.bounds,
            stretch,
            history: self.history.clone(),
        }
    }
}
