//! How long the edges should be, at every vertex of the dense mesh.
//!
//! The shortest of:
//! - the turn limit over the larger principal curvature: a patch must not turn further than its degree
//!   can follow;
//! - where an accuracy is asked for, the length at which fitted patches reach it, by curvature and its change;
//! - the thickness limit: a multiple of the distance to the next sheet facing the other way, inside
//!   (walls, tubes) or outside (gaps);
//! - on creases and borders, the turn limit over the curvature of the line;
//! - a share of the component's size.
//!
//! Then the length is not allowed to grow faster along the surface than the gradation.
//!
//! A tube bends across and hardly along: there the edges may be longer along it, by the aspect limit.
//! So the field is a metric, a symmetric tensor M per vertex, and an edge d has the length asked for when
//! d M d = 1. Two ways were weighed: one length per vertex (simpler; on the torus at 85 degrees it takes 120
//! faces) and this one (75 faces; the fit is then as close as with 75 unstretched ones or a little less).

use super::Options;
use super::reference::Reference;
use crate::Vec3;
use crate::mesh::topology::face_components;
use crate::mesh::{Freedom, HalfEdgeMesh};
use nalgebra::{Matrix3, SymmetricEigen};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Largest distance of degree-5 G1 patches from a sphere of radius 1, over the cube of the edge
/// length. Fitted to 20 patches (edge 1.05: 6.7e-4) and 80 patches (edge 0.58: 1.0e-4), no noise.
const PATCH_ERROR: f64 = 5.5e-4;

/// Weight of the change of the curvature along the surface against the square of the curvature in that law (both are one
/// over a length squared). On noisy and clean torus, bean, three lobes, two-holed torus and mug, 15 and 13 sets: below
/// 4 three lobes and mug lose, above 6 there are more patches for the same error; without it a torus takes as many as
/// three lobes need.
const CHANGE: f64 = 4.8;

/// Area of an equilateral triangle with edges of length 1.
pub(super) const UNIT_AREA: f64 = 0.433_012_701_892_219_3;

/// What is asked for at one place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizing {
    /// Edge d has the length asked for when d M d = 1.
    pub(super) metric: Matrix3<f64>,
    /// The edge of an equilateral triangle of the area asked for.
    pub(super) size: f64,
}

impl Sizing {
    /// Weighted sum, for weights that sum to 1.
    pub(super) fn mix<const N: usize>(parts: [(&Self, f64); N]) -> Self {
        let mut out = Self {
            metric: Matrix3::zeros(),
            size: 0.0,
        };
        for (part, weight) in parts {
            out.metric += part.metric * weight;
            out.size += part.size * weight;
        }
        out
    }

    /// Squared length of `d` in the metric.
    pub(super) fn squared(&self, d: &Vec3) -> f64 {
        d.dot(&(self.metric * d))
    }
}

/// What is asked for at every vertex.
pub(super) fn sizes(reference: &Reference<'_>, options: &Options) -> Vec<Sizing> {
    let half = &reference.half;
    let turn = options.turn_max_degrees.to_radians();
    let ceilings = component_ceilings(reference, options.edge_max_ratio);
    let mean_edge = mean_edge(half);
    let floor = options.edge_min.unwrap_or(mean_edge);
    // Lengths across the bend, and limits of those along it.
    let mut sizes = vec![f64::INFINITY; half.vertex_slots()];
    let mut limits = vec![f64::INFINITY; half.vertex_slots()];
    let mut normals = vec![Vec3::zeros(); half.vertex_slots()];
    for f in half.faces() {
        for (k, v) in half.face_vertices(f).into_iter().enumerate() {
            normals[v as usize] += reference.normals[f as usize][k];
        }
    }
    for normal in &mut normals {
        *normal = crate::mesh::unit_or_zero(*normal);
    }
    let curvature = curvatures(reference, &normals, turn, mean_edge);
    for v in half.vertices() {
        let i = v as usize;
        let change = CHANGE * curvature[i].change;
        let for_curvature = |k: f64| {
            let size = ceilings[i].min(turn / k.max(1e-300));
            let exact =
                |accuracy: f64| (accuracy / (PATCH_ERROR * (k * k + change)).max(1e-300)).cbrt();
            size.min(options.accuracy.map_or(f64::INFINITY, exact))
        };
        let mut size = for_curvature(curvature[i].across);
        let mut limit = for_curvature(curvature[i].along);
        let n = normals[i];
        let reach = size / options.thickness_ratio;
        if let Some(thickness) = reference.thickness(v, &n, reach) {
            size = size.min(options.thickness_ratio * thickness);
            limit = limit.min(options.thickness_ratio * thickness);
        }
        if half.freedom(v) == Freedom::Curve {
            let along_line = turn / line_curvature(half, v, 4.0 * mean_edge).max(1e-300);
            size = size.min(along_line);
            limit = limit.min(along_line);
        }
        sizes[i] = size.max(floor);
        limits[i] = limit;
    }
    grade(half, &mut sizes, options.gradation);
    let mut out: Vec<Sizing> = (0..sizes.len())
        .map(|i| {
            let across = sizes[i];
            let along = limits[i].clamp(across, options.aspect_max * across);
            let e = curvature[i].direction;
            let (low, high) = (along.powi(-2), across.powi(-2));
            Sizing {
                metric: Matrix3::identity() * low + e * e.transpose() * (high - low),
                size: (along * across).sqrt(),
            }
        })
        .collect();
    if let Some(target) = options.target_faces {
        let factor = (faces_asked(half, &out) / (target as f64).max(1.0)).sqrt();
        for s in &mut out {
            s.size *= factor;
            s.metric /= factor * factor;
        }
    }
    out
}

/// How many equilateral faces of the asked size fill the surface.
pub(super) fn faces_asked(half: &HalfEdgeMesh, sizes: &[Sizing]) -> f64 {
    let mut faces = 0.0;
    for f in half.faces() {
        let mean: f64 = half
            .face_vertices(f)
            .iter()
            .map(|v| sizes[*v as usize].size.powi(-2))
            .sum();
        faces += half.area_vector(f).norm() * mean / (3.0 * UNIT_AREA);
    }
    faces
}

fn mean_edge(half: &HalfEdgeMesh) -> f64 {
    let (sum, count) = half
        .edges()
        .fold((0.0, 0usize), |(s, n), h| (s + half.length(h), n + 1));
    sum / count.max(1) as f64
}

/// Per vertex, the longest edge its component allows.
fn component_ceilings(reference: &Reference<'_>, ratio: f64) -> Vec<f64> {
    let mesh = reference.mesh;
    let parts = face_components(mesh);
    let count = parts.iter().max().map_or(0, |m| *m as usize + 1);
    let mut boxes = vec![(Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)); count];
    for (f, &part) in parts.iter().enumerate() {
        for p in mesh.corners(f as u32).iter().flatten() {
            let (low, high) = &mut boxes[part as usize];
            *low = low.inf(p);
            *high = high.sup(p);
        }
    }
    let mut out = vec![f64::INFINITY; mesh.positions.len()];
    for (f, &part) in parts.iter().enumerate() {
        let (low, high) = boxes[part as usize];
        for &v in &mesh.faces[f] {
            out[v as usize] = ratio * (high - low).norm();
        }
    }
    out
}

/// How the surface bends at one place.
#[derive(Clone, Copy, Debug)]
struct Bend {
    /// The larger principal curvature, without its sign.
    across: f64,
    /// The smaller one.
    along: f64,
    /// Unit direction of the larger one.
    direction: Vec3,
    /// How fast the curvature tensor changes along the surface, seen in the tangent plane: its norm per length.
    change: f64,
}

impl Bend {
    fn new(tensor: &Matrix3<f64>) -> Self {
        let eigen = SymmetricEigen::new(*tensor);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| {
            eigen.eigenvalues[*b]
                .abs()
                .total_cmp(&eigen.eigenvalues[*a].abs())
                .then(a.cmp(b))
        });
        // The third one belongs to the normal and is small.
        Self {
            across: eigen.eigenvalues[order[0]].abs(),
            along: eigen.eigenvalues[order[1]].abs(),
            direction: eigen.eigenvectors.column(order[0]).into_owned(),
            change: 0.0,
        }
    }
}

/// The principal curvatures at every vertex, as seen at the scale of the edges to come.
///
/// Curvature tensors per face from the turn of the corner normals along its edges (Rusinkiewicz 2004),
/// averaged over the star by area, then over neighbours until the averaging reaches a fifth of the
/// edge length that follows from it: ripples of the extraction, a cube wide, must not count.
fn curvatures(reference: &Reference<'_>, normals: &[Vec3], turn: f64, mean_edge: f64) -> Vec<Bend> {
    let half = &reference.half;
    let n = half.vertex_slots();
    let mut tensors = vec![Matrix3::zeros(); n];
    let mut weights = vec![0.0; n];
    for f in half.faces() {
        let area = half.area_vector(f).norm();
        let tensor = face_tensor(&half.corners(f), &reference.normals[f as usize]);
        for v in half.face_vertices(f) {
            tensors[v as usize] += tensor * area;
            weights[v as usize] += area;
        }
    }
    for (t, w) in tensors.iter_mut().zip(&weights) {
        if *w > 0.0 {
            *t /= *w;
        }
    }
    let largest = |t: &Matrix3<f64>| Bend::new(t).across;
    for _ in 0..3 {
        tensors = averaged(half, &tensors);
    }
    let mut typical: Vec<f64> = half
        .vertices()
        .map(|v| largest(&tensors[v as usize]))
        .collect();
    typical.sort_by(f64::total_cmp);
    let median = typical.get(typical.len() / 2).copied().unwrap_or(0.0);
    let radius = 0.2 * turn / median.max(1e-300) / mean_edge.max(1e-300);
    let rounds = (radius * radius).min(12.0) as usize;
    for _ in 3..rounds {
        tensors = averaged(half, &tensors);
    }
    let mut bends: Vec<Bend> = tensors.iter().map(Bend::new).collect();
    for v in half.vertices() {
        let (mut sum, mut count) = (0.0, 0.0);
        if half.freedom(v) != Freedom::Surface {
            continue;
        }
        let n = normals[v as usize];
        let plane = Matrix3::identity() - n * n.transpose();
        for w in within(half, v) {
            let way = (half.position(w) - half.position(v)).norm_squared();
            let change = plane * (tensors[w as usize] - tensors[v as usize]) * plane;
            sum += change.norm_squared() / way.max(1e-300);
            count += 1.0;
        }
        bends[v as usize].change = f64::sqrt(sum / f64::max(count, 1.0));
    }
    bends
}

/// Averages over neighbours, but not from one side of a crease to the other, and not from a border, where the
/// tensors are one-sided.
fn averaged(half: &HalfEdgeMesh, tensors: &[Matrix3<f64>]) -> Vec<Matrix3<f64>> {
    let mut out = tensors.to_vec();
    for v in half.vertices() {
        // A vertex on a line counts itself only where nothing else counts.
        let own = if half.freedom(v) == Freedom::Surface {
            1.0
        } else {
            1e-6
        };
        let mut sum = tensors[v as usize] * own;
        let mut count = own;
        for w in within(half, v) {
            sum += tensors[w as usize];
            count += 1.0;
        }
        out[v as usize] = sum / count;
    }
    out
}

/// The neighbours of `v` that lie on no line.
fn within(half: &HalfEdgeMesh, v: u32) -> impl Iterator<Item = u32> {
    half.neighbours(v)
        .filter(|w| half.freedom(*w) == Freedom::Surface)
}

/// The second fundamental form of one face as a symmetric tensor in space.
fn face_tensor(p: &[Vec3; 3], n: &[Vec3; 3]) -> Matrix3<f64> {
    let u = crate::mesh::unit_or_zero(p[1] - p[0]);
    let normal = crate::mesh::unit_or_zero((p[1] - p[0]).cross(&(p[2] - p[0])));
    let v = normal.cross(&u);
    // Least squares for (a, b, c) with [a b; b c] (edge) = (turn of the normal).
    let mut left = Matrix3::zeros();
    let mut right = Vec3::zeros();
    for k in 0..3 {
        let (e, d) = (p[(k + 1) % 3] - p[k], n[(k + 1) % 3] - n[k]);
        let (s, t) = (e.dot(&u), e.dot(&v));
        for (row, value) in [
            (Vec3::new(s, t, 0.0), d.dot(&u)),
            (Vec3::new(0.0, s, t), d.dot(&v)),
        ] {
            left += row * row.transpose();
            right += row * value;
        }
    }
    let Some(x) = left.cholesky().map(|c| c.solve(&right)) else {
        return Matrix3::zeros();
    };
    if !x.iter().all(|c| c.is_finite()) {
        return Matrix3::zeros();
    }
    let cross = u * v.transpose();
    u * u.transpose() * x[0] + (cross + cross.transpose()) * x[1] + v * v.transpose() * x[2]
}

/// Curvature of a crease or border line at `v`, over at least `reach` to each side.
fn line_curvature(half: &HalfEdgeMesh, v: u32, reach: f64) -> f64 {
    let mut arms = [Vec3::zeros(); 2];
    let mut way = 0.0;
    for (k, first) in half.features_at(v).take(2).enumerate() {
        let (mut at, mut h, mut gone) = (v, first, 0.0);
        loop {
            gone += half.length(h);
            let next = half.other_end(h, at);
            let came = h;
            at = next;
            if gone >= reach || half.freedom(at) != Freedom::Curve || at == v {
                break;
            }
            let Some(on) = half
                .features_at(at)
                .find(|g| *g != came && (half.is_border(*g) || half.twin(*g) != came))
            else {
                break;
            };
            h = on;
        }
        arms[k] = half.position(at) - half.position(v);
        way += gone;
    }
    let turn = arms[0].cross(&arms[1]).norm().atan2(-arms[0].dot(&arms[1]));
    if way > 0.0 { 2.0 * turn / way } else { 0.0 }
}

#[derive(PartialEq)]
struct Reached(f64, u32);

impl Eq for Reached {}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0).then(self.1.cmp(&other.1))
    }
}

/// Lowers the sizes until none grows faster than `slope` along an edge (Dijkstra from the small ones).
fn grade(half: &HalfEdgeMesh, sizes: &mut [f64], slope: f64) {
    let mut queue: BinaryHeap<Reverse<Reached>> = half
        .vertices()
        .map(|v| Reverse(Reached(sizes[v as usize], v)))
        .collect();
    while let Some(Reverse(Reached(size, v))) = queue.pop() {
        if size > sizes[v as usize] {
            continue;
        }
        for w in half.neighbours(v) {
            let way = (half.position(w) - half.position(v)).norm();
            let reached = size + slope * way;
            if reached < sizes[w as usize] {
                sizes[w as usize] = reached;
                queue.push(Reverse(Reached(reached, w)));
            }
        }
    }
}
