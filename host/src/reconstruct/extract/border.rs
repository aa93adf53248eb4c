//! Where the surface ends: holes of the data that are closed, and borders where it is left open.
//!
//! The extracted mesh goes on beyond the data, because the field does. A part of it farther than `radius` from every
//! contact that could lie on its sheet is a *hole* of the data. Each hole is closed (kept) or opened:
//!
//! - with a `max_gap`, a hole is closed exactly if no disc of that diameter fits between the contacts around it;
//! - without, a hole is closed if the mesh closes it by itself with little invented surface (at most
//!   [`CLOSED_SHARE`] of the supported area). A bowl, a half-touched ball, a single sheet fail this and are opened.
//!
//! An opened hole is grown back by `radius`, so that the border touches the outermost contacts: a morphological
//! closing of the contacts within the surface, which is what an alpha shape would give (Edelsbrunner et al. 1983).
//! Two ways were weighed: cutting at a fixed distance from the data frays with the tracks and lies outside
//! the data everywhere; the closing follows the contacts and is smooth between them.
//!
//! That radius decides what a hole is; as the radius of the border it would dip far into the gaps between the
//! outermost contacts. So next to an opened hole the contacts are closed a second time, with a radius as wide as the hole
//! allows. Over that border, which still touches contacts that noise carried outward and dips between them, the
//! final one is estimated ([`rim`](super::rim)).

use std::collections::HashMap;

use crate::{Vec3, cloud::Neighbourhoods, mesh::TriangleMesh};

use super::contacts::Normalised;

/// Share of the supported area that a single hole may have and still be closed without being asked to. The largest
/// hole of a scanned bunny's base has 2 %, the missing half of a half-touched ball 100 %, a bowl's opening 60 %.
pub(super) const CLOSED_SHARE: f64 = 0.12;

/// The same where the field's surface comes farther than the search reaches from the contacts that could lie on its sheet, and
/// yet ends in itself: the far side of a tube that one track tells of (the handles of two mugs from 374 contacts, 0.3 and 2 %;
/// left open the tube is missing, 16e-3 of the diagonal off instead of 5e-3).
const FAR_SHARE: f64 = 0.04;

/// Share of the supported area up to which a place without support is a speck, not a hole: a few faces that a jag of the
/// lattice turned away from their contacts.
const SPECK_SHARE: f64 = 0.002;

/// What happened to one hole of the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Somewhere inside, unit of the input.
    pub place: Vec3,
    /// Largest distance of its surface from a contact, unit of the input.
    pub depth: f64,
    /// Its area against the area with data.
    pub area_share: f64,
    /// Whether the field's surface ends in it by itself (it did not run off to where the search stopped).
    pub bounded: bool,
    /// Whether it was closed (kept) or opened.
    pub closed: bool,
}

/// How holes are treated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Closing {
    /// Distance from the contacts beyond which there is a hole; also the radius of the closing.
    pub radius: f64,
    /// Largest depth that is closed, if the user says so.
    pub deepest: Option<f64>,
    /// Distance from the contacts where the search for surface stopped.
    pub reach: f64,
    /// Radius of the wide closing that straightens the border between the outermost contacts.
    pub wide: f64,
    /// Distance from the contacts up to which the wide closing may add surface.
    pub fill: f64,
}

/// Half way where a vertex without any contact on its sheet (infinitely far) leaves no share to compute.
fn share(t: f64) -> f64 {
    if t.is_finite() { t } else { 0.5 }
}

/// Distance of each vertex from the nearest contact that could lie on its sheet: whose normal is within
/// a right angle of the vertex's.
pub(super) fn support(mesh: &TriangleMesh, data: &Normalised, tree: &Neighbourhoods) -> Vec<f64> {
    use rayon::prelude::*;
    let mut normals = vec![Vec3::zeros(); mesh.positions.len()];
    for f in &mesh.faces {
        let [a, b, c] = f.map(|i| mesh.positions[i as usize]);
        let area = (b - a).cross(&(c - a));
        for &i in f {
            normals[i as usize] += area;
        }
    }
    mesh.positions
        .par_iter()
        .zip(&normals)
        .map(|(x, n)| {
            nearest_facing(tree, &data.normals, x, n).map_or(f64::INFINITY, |(_, d2)| d2.sqrt())
        })
        .collect()
}

/// The place of `tree` nearest to `x` whose normal is within a right angle of `normal`, with the squared distance.
pub(super) fn nearest_facing(
    tree: &Neighbourhoods,
    normals: &[Vec3],
    x: &Vec3,
    normal: &Vec3,
) -> Option<(usize, f64)> {
    // A thin wall's other side can hold all of the first ones.
    [12, 96].into_iter().find_map(|k| {
        let mut found = tree.nearest(x, k).into_iter();
        found.find(|&(j, _)| normals[j].dot(normal) > 0.0)
    })
}

/// Closes or opens the holes: returns what became of each, and where some were opened a level for every vertex that is
/// positive on what stays ([`clip`]).
pub(super) fn close_or_open(
    mesh: &TriangleMesh,
    support: &[f64],
    closing: &Closing,
) -> (Option<Vec<f64>>, Vec<Hole>) {
    let radius = closing.radius;
    let inside = |v: u32| support[v as usize] > radius;
    // Components of the vertices in holes.
    let mut group = Groups::new(mesh.positions.len());
    for f in &mesh.faces {
        for i in 0..3 {
            let (a, b) = (f[i], f[(i + 1) % 3]);
            if inside(a) && inside(b) {
                group.join(a as usize, b as usize);
            }
        }
    }
    let on_border = border_vertices(mesh);
    let mut holes: Vec<Hole> = Vec::new();
    let mut number: HashMap<usize, usize> = HashMap::new();
    let mut far: Vec<bool> = Vec::new();
    let mut supported = 0.0;
    for v in 0..mesh.positions.len() {
        if !inside(v as u32) {
            continue;
        }
        let next = holes.len();
        let n = *number.entry(group.root(v)).or_insert(next);
        if n == next {
            holes.push(Hole {
                place: mesh.positions[v],
                depth: 0.0,
                area_share: 0.0,
                bounded: true,
                closed: false,
            });
        }
        far.resize(holes.len(), false);
        let hole = &mut holes[n];
        if support[v] > hole.depth {
            hole.depth = support[v];
            hole.place = mesh.positions[v];
        }
        // What no contact faces may still be closed: a pocket that ends in itself. Where it runs off it has a border.
        far[n] |= support[v] >= closing.reach && support[v].is_finite();
        hole.bounded &= !on_border[v];
    }
    for f in &mesh.faces {
        let [a, b, c] = f.map(|i| mesh.positions[i as usize]);
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        match f.iter().find(|&&v| inside(v)) {
            Some(&v) => {
                if let Some(&n) = number.get(&group.root(v as usize)) {
                    holes[n].area_share += area;
                }
            }
            None => supported += area,
        }
    }
    for (hole, far) in holes.iter_mut().zip(far) {
        hole.area_share /= f64::max(supported, f64::MIN_POSITIVE);
        hole.bounded &= !far || hole.area_share <= FAR_SHARE;
        hole.closed = hole.bounded
            && match closing.deepest {
                Some(deepest) => hole.depth <= deepest || hole.area_share <= SPECK_SHARE,
                None => hole.area_share <= CLOSED_SHARE,
            };
    }
    let opened = |v: u32| {
        inside(v)
            && number
                .get(&group.root_of(v as usize))
                .is_some_and(|&n| !holes[n].closed)
    };
    // Rims of the opened holes, where the support crosses the radius.
    let mut rim = Vec::new();
    for f in &mesh.faces {
        for i in 0..3 {
            let (a, b) = (f[i], f[(i + 1) % 3]);
            if opened(a) && !inside(b) || opened(b) && !inside(a) {
                rim.push(crossing(mesh, support, [a, b], radius));
            }
        }
    }
    if rim.is_empty() {
        return (None, holes);
    }
    let rim = Neighbourhoods::new(rim);
    let far = far_rims(
        mesh,
        support,
        closing,
        |v| opened(v).then(|| number[&group.root_of(v as usize)]),
        &holes,
    );
    let level: Vec<f64> = (0..mesh.positions.len())
        .map(|v| {
            let x = &mesh.positions[v];
            let near = if opened(v as u32) {
                -radius
            } else {
                rim.nearest_one(x)
                    .map_or(radius, |(_, d2)| d2.sqrt() - radius)
            };
            let filled = far
                .iter()
                .filter_map(|(radius, rim)| Some(rim.nearest_one(x)?.1.sqrt() - radius))
                .fold(closing.fill - support[v], f64::min);
            near.max(filled)
        })
        .collect();
    (Some(level), holes)
}

/// Where the support crosses `level` on an edge.
fn crossing(mesh: &TriangleMesh, support: &[f64], edge: [u32; 2], level: f64) -> Vec3 {
    let [sa, sb] = edge.map(|v| support[v as usize]);
    let [pa, pb] = edge.map(|v| mesh.positions[v as usize]);
    let t = share((level - sa) / (sb - sa)).clamp(0.0, 1.0);
    pa + t * (pb - pa)
}

/// The rims of the opened holes (`hole_of` a vertex) as far from the contacts as the holes are deep, at most
/// `closing.wide`, with that distance.
fn far_rims(
    mesh: &TriangleMesh,
    support: &[f64],
    closing: &Closing,
    hole_of: impl Fn(u32) -> Option<usize>,
    holes: &[Hole],
) -> Vec<(f64, Neighbourhoods)> {
    let far = |n: usize| closing.wide.min(0.8 * holes[n].depth.min(closing.reach));
    let mut rims: Vec<Vec<Vec3>> = vec![Vec::new(); holes.len()];
    for f in &mesh.faces {
        for i in 0..3 {
            let (a, b) = (f[i], f[(i + 1) % 3]);
            let (sa, sb) = (support[a as usize], support[b as usize]);
            if let Some(n) = hole_of(a).or_else(|| hole_of(b))
                && (sa > far(n)) != (sb > far(n))
            {
                rims[n].push(crossing(mesh, support, [a, b], far(n)));
            }
        }
    }
    rims.into_iter()
        .enumerate()
        .filter(|(_, rim)| !rim.is_empty())
        .map(|(n, rim)| (far(n), Neighbourhoods::new(rim)))
        .collect()
}

/// The part of the mesh where `level` is positive, cut straight through the faces.
pub(super) fn clip(mesh: &TriangleMesh, level: &[f64]) -> TriangleMesh {
    let mut result = TriangleMesh::default();
    let mut kept: HashMap<u32, u32> = HashMap::new();
    let mut cut: HashMap<(u32, u32), u32> = HashMap::new();
    let positive = |v: u32| level[v as usize] > 0.0;
    for f in &mesh.faces {
        let count = f.iter().filter(|&&v| positive(v)).count();
        if count == 0 {
            continue;
        }
        let mut polygon: Vec<u32> = Vec::with_capacity(4);
        for i in 0..3 {
            let (a, b) = (f[i], f[(i + 1) % 3]);
            if positive(a) {
                polygon.push(*kept.entry(a).or_insert_with(|| {
                    result.positions.push(mesh.positions[a as usize]);
                    result.positions.len() as u32 - 1
                }));
            }
            if positive(a) != positive(b) {
                polygon.push(*cut.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let (low, high) = (a.min(b) as usize, a.max(b) as usize);
                    // Kept off the corners, so that no face degenerates.
                    let t = share(level[low] / (level[low] - level[high])).clamp(0.05, 0.95);
                    let (pl, ph) = (mesh.positions[low], mesh.positions[high]);
                    result.positions.push(pl + t * (ph - pl));
                    result.positions.len() as u32 - 1
                }));
            }
        }
        for i in 1..polygon.len() - 1 {
            result.faces.push([polygon[0], polygon[i], polygon[i + 1]]);
        }
    }
    result
}

fn border_vertices(mesh: &TriangleMesh) -> Vec<bool> {
    let mut on_border = vec![false; mesh.positions.len()];
    let mut edges: Vec<(u32, u32, i32)> = Vec::with_capacity(3 * mesh.faces.len());
    for f in &mesh.faces {
        for i in 0..3 {
            let (a, b) = (f[i], f[(i + 1) % 3]);
            edges.push((a.min(b), a.max(b), if a < b { 1 } else { -1 }));
        }
    }
    edges.sort_unstable();
    for pair in edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        if pair.len() == 1 {
            on_border[pair[0].0 as usize] = true;
            on_border[pair[0].1 as usize] = true;
        }
    }
    on_border
}

/// Keeps the components of the mesh that hold at least `least` of the `seeds` (by nearest vertex); returns the mesh and
/// how many components were dropped.
pub(super) fn keep_touched(
    mesh: &TriangleMesh,
    seeds: &[Vec3],
    least: usize,
) -> (TriangleMesh, usize) {
    let mut group = Groups::new(mesh.positions.len());
    for f in &mesh.faces {
        group.join(f[0] as usize, f[1] as usize);
        group.join(f[0] as usize, f[2] as usize);
    }
    let vertices = Neighbourhoods::new(mesh.positions.clone());
    let mut touched: HashMap<usize, usize> = HashMap::new();
    for s in seeds {
        if let Some((v, _)) = vertices.nearest_one(s) {
            *touched.entry(group.root(v)).or_default() += 1;
        }
    }
    let enough = |v: u32| {
        let n = touched
            .get(&group.root_of(v as usize))
            .copied()
            .unwrap_or(0);
        n >= least
    };
    let level: Vec<f64> = (0..mesh.positions.len() as u32)
        .map(|v| if enough(v) { 1.0 } else { -1.0 })
        .collect();
    let mut used: Vec<usize> = mesh
        .faces
        .iter()
        .map(|f| group.root_of(f[0] as usize))
        .collect();
    used.sort_unstable();
    used.dedup();
    let dropped = used.iter().filter(|&&r| !enough(r as u32)).count();
    (clip(mesh, &level), dropped)
}

/// Gives every fan of faces around a vertex a vertex of its own, so that fans that only touch are apart.
pub(super) fn separate_fans(mesh: &mut TriangleMesh) {
    let mut around: Vec<Vec<(usize, usize)>> = vec![Vec::new(); mesh.positions.len()];
    for (n, f) in mesh.faces.iter().enumerate() {
        for (i, &v) in f.iter().enumerate() {
            around[v as usize].push((n, i));
        }
    }
    for v in 0..around.len() {
        let corners = &around[v];
        let mut group = Groups::new(corners.len());
        let mut by_neighbour: HashMap<u32, usize> = HashMap::new();
        for (k, &(n, i)) in corners.iter().enumerate() {
            let f = mesh.faces[n];
            for other in [f[(i + 1) % 3], f[(i + 2) % 3]] {
                match by_neighbour.get(&other) {
                    Some(&first) => group.join(first, k),
                    None => {
                        by_neighbour.insert(other, k);
                    }
                }
            }
        }
        let first = if corners.is_empty() { 0 } else { group.root(0) };
        let mut copies: HashMap<usize, u32> = HashMap::new();
        for k in 0..corners.len() {
            let root = group.root(k);
            if root == first {
                continue;
            }
            let position = mesh.positions[v];
            let copy = *copies.entry(root).or_insert_with(|| {
                mesh.positions.push(position);
                mesh.positions.len() as u32 - 1
            });
            let (n, i) = corners[k];
            mesh.faces[n][i] = copy;
        }
    }
}

/// Disjoint sets.
struct Groups {
    parent: Vec<u32>,
}

impl Groups {
    fn new(count: usize) -> Self {
        Self {
            parent: (0..count as u32).collect(),
        }
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.parent[i] as usize != i {
            self.parent[i] = self.parent[self.parent[i] as usize];
            i = self.parent[i] as usize;
        }
        i
    }

    fn root_of(&self, mut i: usize) -> usize {
        while self.parent[i] as usize != i {
            i = self.parent[i] as usize;
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b)] = a.min(b) as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;

    /// Whether a cap of a ball, this high and with contacts as far as `distance`, is closed.
    fn is_closed(cap: f64, distance: f64) -> bool {
        let ball = shapes::icosphere(4);
        let support: Vec<f64> = (ball.positions.iter())
            .map(|x| if x.z > 1.0 - cap { distance } else { 0.0 })
            .collect();
        let closing = Closing {
            radius: 0.1,
            deepest: None,
            reach: 0.5,
            wide: 0.3,
            fill: 0.05,
        };
        let (level, holes) = close_or_open(&ball, &support, &closing);
        assert_eq!(holes.len(), 1);
        assert_eq!(holes[0].closed, level.is_none());
        holes[0].closed
    }

    #[test]
    fn a_hole_that_ends_in_itself_is_closed_up_to_a_share_that_falls_with_its_distance() {
        // A cap of height h holds h / 2 of the ball.
        for (cap, near, far) in [(0.05, true, true), (0.15, true, false), (0.5, false, false)] {
            assert_eq!(is_closed(cap, 0.4), near, "{cap} near");
            assert_eq!(is_closed(cap, 0.7), far, "{cap} far");
        }
        assert!(
            is_closed(0.15, f64::INFINITY),
            "a pocket that no contact faces"
        );
    }
}
