//! The border as a smooth curve through the outermost contacts, in place of the closing's.
//!
//! Two ways were weighed: a closing of the contacts with ever wider discs, whose border touches every outermost contact,
//! those that noise carried outward too, and dips between them; and an estimate of how far the surface reaches, from all
//! contacts near the border and their noise ([`frontier`](super::frontier)). The second is taken: on three noisy bowls the
//! border is at most 4.8 (1e-3 of the diagonal) off the true rim where contacts reach it, with the closing 9.3; along
//! the whole rim 3.5 against 8.0, rms of the worst. The closing decides what is a hole and gives the line over which the
//! heights are measured, and its border stays where the estimate would change the topology.

use std::collections::BTreeMap;

use super::{
    border,
    contacts::Normalised,
    frontier::{self, Line, Touch},
};
use crate::{
    Vec3,
    cloud::Neighbourhoods,
    mesh::{TriangleMesh, topology},
};

/// Contacts and vertices up to this many spacings from the border belong to it.
const STRIP: f64 = 6.0;
/// The border comes no farther from the contacts than this (spacings), just below where holes begin.
const FARTHEST: f64 = 3.0;
/// Spacings over which the closing's border is smoothed to give the line that heights are measured over.
const SMOOTHED: f64 = 1.5;
/// Nodes per spacing.
const NODES: f64 = 3.0;
const LEAST_NODES: usize = 48;
/// Loops shorter than this (spacings) stay as they are.
const SHORTEST: f64 = 10.0;
/// Least standard deviation of a height, spacings.
const LEAST_SIGMA: f64 = 0.03;
/// Where the closing's border turns outward by more than this within so many spacings to both sides (radians, spacings),
/// there is a corner, and turning costs a tenth.
const CORNER: f64 = 0.87;
const CORNER_REACH: f64 = 3.0;
const CORNER_PRICE: f64 = 0.1;

/// A smoothed border loop with the heights of the border over it; a ring of evenly spread samples.
struct Rim {
    places: Vec<Vec3>,
    normals: Vec<Vec3>,
    tangents: Vec<Vec3>,
    outward: Vec<Vec3>,
    length: f64,
    corner: Vec<bool>,
    heights: Option<Vec<f64>>,
}

/// What the contacts say, in normalised coordinates.
pub(super) struct Contacts<'a> {
    pub data: &'a Normalised,
    /// Standard deviation of a typical position.
    pub sigma: f64,
    /// Typical distance of neighbouring contacts.
    pub spacing: f64,
}

/// The surface with the border drawn through the outermost contacts: `mesh` is what was followed beyond the contacts,
/// `support` the distance of its vertices from them, `level` what the closing makes of it, `closed` the mesh after it; `finish` tidies a mesh that was cut.
pub(super) fn smooth_border(
    mesh: &TriangleMesh,
    (support, level): (&[f64], &[f64]),
    closed: TriangleMesh,
    contacts: &Contacts,
    finish: impl Fn(&TriangleMesh) -> TriangleMesh,
) -> TriangleMesh {
    let Contacts {
        data,
        sigma,
        spacing,
    } = *contacts;
    let mut rims = rims(&closed, spacing);
    if rims.is_empty() {
        return closed;
    }
    let strip = Strip::new(&rims, spacing);
    let mut touches: Vec<Vec<Touch>> = vec![Vec::new(); rims.len()];
    for (i, x) in data.positions.iter().enumerate() {
        if let Some(at) = strip.locate(&rims, x, &data.normals[i]) {
            touches[at.rim].push(Touch {
                along: at.along / spacing,
                height: at.height / spacing,
                sigma: (sigma * data.relative_sigma[i] / spacing).max(LEAST_SIGMA),
            });
        }
    }
    for (rim, touches) in rims.iter_mut().zip(&touches) {
        rim.heights = frontier::heights(&rim.line(spacing), touches);
    }
    let normals = mesh.vertex_normals();
    let level: Vec<f64> = (0..mesh.positions.len())
        .map(|v| {
            let found = strip.locate(&rims, &mesh.positions[v], &normals[v]);
            let reached = found.and_then(|at| {
                let rim = &rims[at.rim];
                Some(spacing * rim.height_at(at.along)? - at.height)
            });
            reached.map_or(level[v], |reached| {
                reached.min(level[v].max(FARTHEST * spacing - support[v]))
            })
        })
        .collect();
    let drawn = finish(&border::clip(mesh, &level));
    let (before, after) = (topology(&closed), topology(&drawn));
    let same = before.components == after.components
        && before.border_loops == after.border_loops
        && before.euler == after.euler
        && after.is_manifold();
    if same { drawn } else { closed }
}

/// Where a place lies with respect to the rims.
struct Place {
    rim: usize,
    along: f64,
    /// Outward from the rim.
    height: f64,
}

/// The samples of all rims, to find the rim that a place lies beside.
struct Strip {
    samples: Neighbourhoods,
    /// Rim and number of each sample.
    of: Vec<(usize, usize)>,
    normals: Vec<Vec3>,
    width: f64,
}

impl Strip {
    fn new(rims: &[Rim], spacing: f64) -> Self {
        let of = rims
            .iter()
            .enumerate()
            .flat_map(|(n, rim)| (0..rim.places.len()).map(move |k| (n, k)));
        Self {
            samples: Neighbourhoods::new(rims.iter().flat_map(|r| r.places.clone()).collect()),
            of: of.collect(),
            normals: rims.iter().flat_map(|r| r.normals.clone()).collect(),
            width: STRIP * spacing,
        }
    }

    /// The nearest rim whose sheet faces the same way as `normal`; `None` beyond the strip.
    fn locate(&self, rims: &[Rim], x: &Vec3, normal: &Vec3) -> Option<Place> {
        let (sample, d2) = border::nearest_facing(&self.samples, &self.normals, x, normal)?;
        if d2 > self.width * self.width {
            return None;
        }
        let (n, k) = self.of[sample];
        let rim = &rims[n];
        let from = x - rim.places[k];
        Some(Place {
            rim: n,
            along: k as f64 * rim.step() + from.dot(&rim.tangents[k]),
            height: from.dot(&rim.outward[k]),
        })
    }
}

impl Rim {
    /// Distance of the samples along the rim.
    fn step(&self) -> f64 {
        self.length / self.places.len() as f64
    }

    /// The line for the estimate, in spacings.
    fn line(&self, spacing: f64) -> Line {
        let count = self.places.len();
        let curvature = (0..count)
            .map(|k| {
                let [a, b] = [(k + count - 1) % count, (k + 1) % count].map(|i| self.places[i]);
                let bent = (a - 2.0 * self.places[k] + b) / self.step().powi(2);
                -bent.dot(&self.outward[k]) * spacing
            })
            .collect();
        let price = |corner: &bool| if *corner { CORNER_PRICE } else { 1.0 };
        Line {
            length: self.length / spacing,
            curvature,
            price: self.corner.iter().map(price).collect(),
        }
    }

    /// Height of the border, in spacings.
    fn height_at(&self, along: f64) -> Option<f64> {
        let heights = self.heights.as_ref()?;
        let at = (along / self.step()).rem_euclid(heights.len() as f64);
        let first = (at.floor() as usize).min(heights.len() - 1);
        let t = at - first as f64;
        Some((1.0 - t) * heights[first] + t * heights[(first + 1) % heights.len()])
    }
}

/// The border loops of a mesh, smoothed.
fn rims(mesh: &TriangleMesh, spacing: f64) -> Vec<Rim> {
    let normals = mesh.vertex_normals();
    loops(mesh)
        .iter()
        .filter_map(|vertices| {
            let ring: Vec<[Vec3; 2]> = vertices
                .iter()
                .map(|&v| [mesh.positions[v as usize], normals[v as usize]])
                .collect();
            rim(&ring, spacing)
        })
        .collect()
}

/// One smoothed loop from places and normals in the order of the faces' edges; `None` if it is too short.
fn rim(ring: &[[Vec3; 2]], spacing: f64) -> Option<Rim> {
    let length = ring_length(ring);
    if length.is_nan() || length < SHORTEST * spacing {
        return None;
    }
    let count = ((NODES * length / spacing) as usize).max(LEAST_NODES);
    let raw = resample(ring, count);
    let smoothed = smooth(
        &raw,
        (SMOOTHED * spacing).min(length / 16.0) / (length / count as f64),
    );
    let length = ring_length(&smoothed);
    let even = resample(&smoothed, count);
    let raw_places: Vec<Vec3> = raw.iter().map(|r| r[0]).collect();
    let nearest_raw = Neighbourhoods::new(raw_places.clone());
    let places: Vec<Vec3> = even.iter().map(|r| r[0]).collect();
    let reach =
        ((CORNER_REACH * spacing * count as f64 / length).round() as usize).clamp(1, count / 4);
    let mut rim = Rim {
        normals: Vec::with_capacity(count),
        tangents: Vec::with_capacity(count),
        outward: Vec::with_capacity(count),
        length,
        corner: vec![false; count],
        heights: None,
        places,
    };
    for k in 0..count {
        let normal = even[k][1].try_normalize(1e-9)?;
        let along = rim.places[(k + 1) % count] - rim.places[(k + count - 1) % count];
        let tangent = along.try_normalize(1e-12)?;
        // Faces lie to the left of their edges.
        let outward = tangent.cross(&normal).try_normalize(1e-9)?;
        let at = nearest_raw.nearest_one(&rim.places[k])?.0;
        let [before, after] = [(at + count - reach) % count, (at + reach) % count];
        let into = raw_places[at] - raw_places[before];
        let out_of = raw_places[after] - raw_places[at];
        if into.cross(&out_of).dot(&normal).atan2(into.dot(&out_of)) > CORNER {
            for near in [k + count - 1, k, k + 1] {
                rim.corner[near % count] = true;
            }
        }
        rim.normals.push(normal);
        rim.tangents.push(tangent);
        rim.outward.push(outward);
    }
    Some(rim)
}

/// The border loops of a manifold mesh, along the faces' edges, in the order of their lowest vertices.
fn loops(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let mut edges: Vec<[u32; 2]> = mesh
        .faces
        .iter()
        .flat_map(|f| [[f[0], f[1]], [f[1], f[2]], [f[2], f[0]]])
        .collect();
    edges.sort_unstable();
    let mut next: BTreeMap<u32, u32> = edges
        .iter()
        .filter(|[a, b]| edges.binary_search(&[*b, *a]).is_err())
        .map(|[a, b]| (*a, *b))
        .collect();
    let mut loops = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut ring = Vec::new();
        let mut at = start;
        while let Some(to) = next.remove(&at) {
            ring.push(at);
            at = to;
        }
        loops.push(ring);
    }
    loops
}

/// Length of a closed ring of places.
fn ring_length(ring: &[[Vec3; 2]]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    ring.iter()
        .zip(next)
        .map(|(a, b)| (b[0] - a[0]).norm())
        .sum()
}

/// `count` samples of a closed ring, evenly spread along it.
fn resample(ring: &[[Vec3; 2]], count: usize) -> Vec<[Vec3; 2]> {
    let step = ring_length(ring) / count as f64;
    let mut samples = Vec::with_capacity(count);
    let mut gone = 0.0;
    for (a, b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
        let length = (b[0] - a[0]).norm();
        while samples.len() < count && samples.len() as f64 * step < gone + length {
            let t = (samples.len() as f64 * step - gone) / length;
            samples.push([0, 1].map(|i| a[i] + t * (b[i] - a[i])));
        }
        gone += length;
    }
    // Rounding may leave the last one out.
    while let (true, Some(last)) = (samples.len() < count, ring.last()) {
        samples.push(*last);
    }
    samples
}

/// A ring smoothed by a bell of standard deviation `width`, in samples.
fn smooth(ring: &[[Vec3; 2]], width: f64) -> Vec<[Vec3; 2]> {
    let count = ring.len();
    let reach = (4.0 * width).ceil() as usize;
    (0..count)
        .map(|k| {
            let mut sum = [Vec3::zeros(); 2];
            let mut weights = 0.0;
            for i in 0..=2 * reach {
                let away = (i as f64 - reach as f64) / width;
                let weight = (-0.5 * away * away).exp();
                let from = &ring[(k + i + (reach / count + 1) * count - reach) % count];
                for (sum, value) in sum.iter_mut().zip(from) {
                    *sum += weight * value;
                }
                weights += weight;
            }
            sum.map(|s| s / weights)
        })
        .collect()
}
