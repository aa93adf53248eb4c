//! Which measured points belong to one smooth sheet, and between which sheets the surface breaks.
//!
//! Regions grow from the flattest places: a point joins when the sheet through the region's points
//! next to it predicts its position and normal. A smooth surface carries a region over itself as far
//! as the points are dense enough to follow; at a crease the prediction fails on both sides. It also fails where
//! a surface bends faster than the points show, so every boundary between two regions is tried:
//! it is a crease only where both sheets, carried on from their own side, meet between the points at an
//! angle, no point near by contradicts them, and the normals beside it do not turn gradually (`ramp`: on the lip of a mug, of
//! two spacings' radius, sheets bend so far that what is left between them looks like an edge). Regions on both sides
//! of any other boundary are joined, unless both break with others: such sheets are what they seem, and stay apart where
//! nothing shows that one goes on as the other.
//! What a gap parts joins again if one plane explains both sides, or the quadric of a large region a small one.

use super::ramp;
use super::sheet::{Piece, Scatter, Sheet, meet};
use crate::Vec3;
use crate::cloud::{Cloud, Neighbourhoods, OrientedPoint};
use crate::mesh::NONE;
use crate::mesh::topology::Union;
use crate::reconstruct::quadric::{Place, QuadricFit};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Neighbours of a point, for growing and for boundaries.
const NEIGHBOURS: usize = 14;
/// Points a sheet is made from, at most.
pub(super) const SHEET_POINTS: usize = 30;
/// A sheet whose mean squared residual is larger than this (1: that of the scatter) does not explain its points.
/// At 1.5 a quadric reaches so far around a cylinder that it misses the rim by half the scatter.
const MISFIT_MAX: f64 = 1.2;
/// A region with fewer points is no sheet of its own.
const REGION_MIN: usize = 8;
/// Standard deviations within which a point agrees with a sheet.
const AGREE: f64 = 3.5;
/// What a sheet may further be off in the normal when carried on by one point, radians (8 degrees): the
/// turn of curvature that the sheet does not know yet.
const AGREE_NORMAL: f64 = 0.14;
/// The same for the position, in shares of the distance to the nearest point of the sheet.
const AGREE_SLOPE: f64 = 0.12;
/// How far, in spacings, a sheet's own points may end before the place where it meets another: sheets, planes.
const SHEET_SIGHT: f64 = 2.5;
const PLANE_SIGHT: f64 = 4.5;
/// A region with fewer points may be a cut-off piece of another.
const FRAGMENT_MAX: usize = 60;
/// Least scatter assumed, of positions in spacings and of normals in radians: what a curved surface is off a quadric
/// over a sheet's reach. Below it the sheets of an exact cylinder contradict their own points.
const LEAST_SCATTER: f64 = 0.04;
const LEAST_SCATTER_NORMAL: f64 = 0.02;
/// How far, in spacings, a sheet is carried on to such a piece.
const SIGHT: f64 = 8.0;
/// Least cosine between the normals of planes that may be one (10 degrees).
const PARALLEL: f64 = 0.985;
/// Places at which two sheets must be seen to meet at an angle.
const PLACES_MIN: usize = 5;
/// Share of the places along a boundary that must be sharp.
const SHARE_MIN: f64 = 0.7;
/// A region with fewer points shows an edge by itself only if it turns by as much as this in the mean, radians (50 degrees): a dozen
/// points on a mug's bottom rounding, of a spacing's radius, seemed to end in one of 40.
const PATCH_MAX: usize = 20;
const PATCH_TURN: f64 = 0.87;
/// Distance from an edge, in spacings, within which points show whether it is one; the same along the edge, from the middle of a stretch.
const EDGE_SIGHT: f64 = 3.5;
const STRETCH: f64 = 5.0;
/// Standard deviations by which points may lie nearer to an edge or farther from it than they seem to.
const BLUR: f64 = 3.0;
/// Least cosine between normals on one side of a wall.
const FACING: f64 = 0.2;

/// Points in smooth regions.
pub(super) struct Regions<'a> {
    pub(super) points: &'a [OrientedPoint],
    pub(super) tree: Neighbourhoods,
    /// Per point; [`NONE`] where it fits nowhere.
    pub(super) label: Vec<u32>,
    /// Pairs of regions (lower first) between which the surface breaks.
    pub(super) sharp: Vec<[u32; 2]>,
    pub(super) scatter: Scatter,
    /// Typical distance of neighbouring points.
    pub(super) spacing: f64,
    /// The points of each region, once they are known.
    index: BTreeMap<u32, Members>,
}

/// A region that is a plane.
struct Plane {
    region: u32,
    normal: Vec3,
    places: Vec<Place>,
}

/// The points of one region.
struct Members {
    tree: Neighbourhoods,
    points: Vec<u32>,
}

impl<'a> Regions<'a> {
    /// Finds regions and their sharp boundaries. `turn_min`: the least angle of a crease, radians.
    pub(super) fn new(cloud: &'a Cloud, turn_min: f64) -> Self {
        let points = cloud.points.as_slice();
        let tree = Neighbourhoods::new(points.iter().map(|p| p.position).collect());
        let neighbours: Vec<Vec<u32>> = (0..points.len())
            .map(|i| {
                tree.nearest(&points[i].position, NEIGHBOURS + 1)
                    .into_iter()
                    .map(|(j, _)| j as u32)
                    .filter(|j| {
                        *j as usize != i && points[*j as usize].normal.dot(&points[i].normal) > -0.7
                    })
                    .collect()
            })
            .collect();
        let mut gaps: Vec<f64> = (0..points.len())
            .filter_map(|i| {
                let far = *neighbours[i].get(6)?;
                Some(
                    (points[far as usize].position - points[i].position).norm() / 6f64.sqrt() * 1.6,
                )
            })
            .collect();
        gaps.sort_by(f64::total_cmp);
        let spacing = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
        let mut out = Self {
            points,
            tree,
            label: vec![NONE; points.len()],
            sharp: Vec::new(),
            scatter: Scatter {
                position: 0.1 * spacing,
                normal: 0.1,
            },
            spacing,
            index: BTreeMap::new(),
        };
        out.scatter = out.measure_scatter(&neighbours);
        out.grow(&neighbours);
        out.settle(&neighbours, turn_min);
        out.sort_members();
        out.join_pieces();
        out.join_planes();
        out.sharpen_planes(turn_min);
        out
    }

    /// Scatter of positions and normals about local sheets, from medians, so that the few points at creases do not count.
    fn measure_scatter(&self, neighbours: &[Vec<u32>]) -> Scatter {
        let (mut off, mut turn) = (Vec::new(), Vec::new());
        for (i, p) in self.points.iter().enumerate() {
            let near: Vec<OrientedPoint> = neighbours[i]
                .iter()
                .map(|j| self.points[*j as usize])
                .filter(|q| q.normal.dot(&p.normal) > 0.8)
                .collect();
            if near.len() < 7 {
                continue;
            }
            let wide = Scatter {
                position: 0.1 * self.spacing,
                normal: 0.1,
            };
            if let Some(sheet) = Sheet::through(&near, &p.position, 2.0 * self.spacing, &wide) {
                off.push(sheet.distance(&p.position).abs());
                turn.push((sheet.normal(&p.position) - p.normal).norm());
            }
        }
        let median = |list: &mut Vec<f64>| {
            list.sort_by(f64::total_cmp);
            list.get(list.len() / 2).copied()
        };
        // The median of |z| is 0.674 sigma; that of the length of two components 1.177 sigma.
        Scatter {
            position: median(&mut off).map_or(0.1 * self.spacing, |m| {
                (m / 0.674).max(LEAST_SCATTER * self.spacing)
            }),
            normal: median(&mut turn).map_or(0.1, |m| (m / 1.177).max(LEAST_SCATTER_NORMAL)),
        }
    }

    /// The regions, rising.
    pub(super) fn names(&self) -> Vec<u32> {
        self.index.keys().copied().collect()
    }

    /// The points of `region` nearest to `at`, nearest first.
    fn members_near(&self, region: u32, at: &Vec3, most: usize) -> Vec<OrientedPoint> {
        if let Some(index) = self.index.get(&region) {
            let near = index.tree.nearest(at, most).into_iter();
            return near
                .map(|(k, _)| self.points[index.points[k] as usize])
                .collect();
        }
        self.tree
            .nearest(at, 4 * most)
            .into_iter()
            .filter(|(j, _)| self.label[*j] == region)
            .take(most)
            .map(|(j, _)| self.points[j])
            .collect()
    }

    fn through(&self, near: &[OrientedPoint], at: &Vec3) -> Option<Sheet> {
        let reach = (near.last()?.position - at).norm().max(self.spacing);
        Sheet::through(near, at, 0.7 * reach, &self.scatter)
    }

    /// The sheet of `region` near `at`, through its points there.
    pub(super) fn sheet(&self, region: u32, at: &Vec3, most: usize) -> Option<Sheet> {
        self.through(&self.members_near(region, at, most), at)
    }

    /// The sheet of `region` near `at` through as many points as one plane or quadric explains: the more,
    /// the less their noise moves it where it is carried on past them.
    pub(super) fn wide_sheet(&self, region: u32, at: &Vec3) -> Option<Sheet> {
        let near = self.members_near(region, at, 8 * SHEET_POINTS);
        [8, 4, 2]
            .iter()
            .filter_map(|times| self.through(&near[..near.len().min(times * SHEET_POINTS)], at))
            .find(|sheet| sheet.misfit < MISFIT_MAX)
            .or_else(|| self.through(&near[..near.len().min(SHEET_POINTS)], at))
    }

    /// Sorts the points of every region for quick look-ups; again whenever regions have joined.
    fn sort_members(&mut self) {
        self.index.clear();
        for (l, points) in self.members() {
            let tree = Neighbourhoods::new(
                points
                    .iter()
                    .map(|i| self.points[*i as usize].position)
                    .collect(),
            );
            self.index.insert(l, Members { tree, points });
        }
    }

    /// The points of each region.
    fn members(&self) -> BTreeMap<u32, Vec<u32>> {
        let mut members: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (i, l) in self.label.iter().enumerate() {
            if *l != NONE {
                members.entry(*l).or_default().push(i as u32);
            }
        }
        members
    }

    /// Whether `sheet` predicts `point`, whose distance to the nearest point of the sheet is `gap`.
    fn agrees(&self, sheet: &Sheet, point: &OrientedPoint, gap: f64) -> bool {
        let off = sheet.distance(&point.position).abs();
        let turn = (sheet.normal(&point.position) - point.normal).norm();
        off < AGREE * self.scatter.position + AGREE_SLOPE * gap
            && turn < AGREE * self.scatter.normal + AGREE_NORMAL
    }

    fn grow(&mut self, neighbours: &[Vec<u32>]) {
        let bend = |i: usize| -> f64 {
            let list = &neighbours[i][..neighbours[i].len().min(8)];
            let sum: f64 = list
                .iter()
                .map(|j| 1.0 - self.points[*j as usize].normal.dot(&self.points[i].normal))
                .sum();
            sum / list.len().max(1) as f64
        };
        let mut seeds: Vec<(f64, u32)> = (0..self.points.len())
            .map(|i| (bend(i), i as u32))
            .collect();
        seeds.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut next = 0;
        for (_, seed) in seeds {
            if self.label[seed as usize] != NONE {
                continue;
            }
            self.grow_from(seed, next, neighbours);
            next += 1;
        }
    }

    fn grow_from(&mut self, seed: u32, region: u32, neighbours: &[Vec<u32>]) {
        let start = self.points[seed as usize];
        let cone = (AGREE * self.scatter.normal + 2.0 * AGREE_NORMAL)
            .min(1.0)
            .cos();
        let mut members = vec![seed];
        for &j in &neighbours[seed as usize] {
            if members.len() < 7
                && self.label[j as usize] == NONE
                && self.points[j as usize].normal.dot(&start.normal) > cone
            {
                members.push(j);
            }
        }
        let mut queue: VecDeque<u32> = VecDeque::new();
        let mut tries: Vec<u8> = vec![0; self.points.len()];
        for &m in &members {
            self.label[m as usize] = region;
            queue.extend(&neighbours[m as usize]);
        }
        while let Some(j) = queue.pop_front() {
            if self.label[j as usize] != NONE || tries[j as usize] >= 6 {
                continue;
            }
            tries[j as usize] += 1;
            let p = self.points[j as usize];
            // The nearest point of the region on the same side of the wall.
            let gap = neighbours[j as usize]
                .iter()
                .filter(|i| self.label[**i as usize] == region)
                .map(|i| (self.points[*i as usize].position - p.position).norm())
                .fold(f64::INFINITY, f64::min);
            if gap.is_finite()
                && let Some(sheet) = self.sheet(region, &p.position, 16)
                && self.agrees(&sheet, &p, gap)
            {
                self.label[j as usize] = region;
                queue.extend(
                    neighbours[j as usize]
                        .iter()
                        .filter(|i| self.label[**i as usize] == NONE),
                );
            }
        }
    }

    /// Joins regions across boundaries that are not sharp and keeps the sharp ones.
    fn settle(&mut self, neighbours: &[Vec<u32>], turn_min: f64) {
        self.drop_small();
        self.adopt(neighbours);
        self.join_fragments();
        for _ in 0..4 {
            let mut pairs = self.boundaries(neighbours, turn_min);
            // A sheet that breaks with some other is no bend that is faster than the points show: what counts at its
            // other boundaries is what most places say, or nearly all of those that are not contradicted, and between two
            // such sheets one place is enough.
            let mut edged: BTreeSet<u32> = (pairs.iter().filter(|b| b.is_sharp()))
                .flat_map(|b| b.regions)
                .collect();
            // Likewise a plane or quadric that breaks with such a sheet by what most places say: so are the faces of which contacts
            // near their edges contradict much.
            loop {
                let breaking = pairs.iter().filter(|b| b.breaks_among(&edged));
                let faces: Vec<u32> = breaking
                    .flat_map(|b| {
                        (0..2)
                            .filter(|side| b.whole[*side])
                            .map(|side| b.regions[side])
                    })
                    .filter(|region| !edged.contains(region))
                    .collect();
                if faces.is_empty() {
                    break;
                }
                edged.extend(faces);
            }
            let is_sharp = |b: &Boundary| b.breaks_among(&edged);
            let apart = |b: &Boundary| {
                is_sharp(b) || b.known(&edged) == 2 && 2 * b.smooth <= b.places && !b.rounded
            };
            let count = self
                .label
                .iter()
                .filter(|l| **l != NONE)
                .max()
                .map_or(0, |m| *m as usize + 1);
            let mut set = Union::new(count);
            let sharp: Vec<[u32; 2]> = pairs
                .iter()
                .filter(|b| is_sharp(b))
                .map(|b| b.regions)
                .collect();
            // The least sharp boundaries vanish first; none may vanish that would join across a sharp one, nor join two sheets that break
            // with others by way of a scrap between them: what is left of it is asked again in the next round.
            pairs.retain(|b| !apart(b));
            pairs.sort_by(|a, b| a.turn.total_cmp(&b.turn).then(a.regions.cmp(&b.regions)));
            let mut breaks: Vec<bool> = (0..count).map(|r| edged.contains(&(r as u32))).collect();
            let mut joined = false;
            for b in &pairs {
                let [a, c] = b.regions.map(|r| set.root(r as usize));
                let broken = sharp.iter().any(|s| {
                    let [s, t] = s.map(|r| set.root(r as usize));
                    (s, t) == (a, c) || (t, s) == (a, c)
                });
                let by_a_scrap = breaks[a] && breaks[c] && b.known(&edged) < 2;
                if a != c && !broken && !by_a_scrap {
                    set.join(a, c);
                    let root = set.root(a);
                    breaks[root] = breaks[a] || breaks[c];
                    joined = true;
                }
            }
            for l in &mut self.label {
                if *l != NONE {
                    *l = set.root(*l as usize) as u32;
                }
            }
            self.sharp = sharp
                .iter()
                .map(|s| {
                    let [s, t] = s.map(|r| set.root(r as usize) as u32);
                    [s.min(t), s.max(t)]
                })
                .collect();
            self.sharp.sort_unstable();
            self.sharp.dedup();
            if !joined {
                break;
            }
        }
    }

    /// The points of a region with their scatter.
    fn places(&self, region: u32) -> Vec<Place> {
        let points = self.index.get(&region).map(|m| m.points.as_slice());
        let points = points.unwrap_or_default().iter();
        points.map(|i| self.place(*i)).collect()
    }

    fn place(&self, point: u32) -> Place {
        let p = &self.points[point as usize];
        Place {
            position: p.position,
            normal: p.normal,
            sigma: self.scatter.position,
            tilt: self.scatter.normal,
        }
    }

    /// The regions that break with others, rising.
    fn edged(&self) -> Vec<u32> {
        let mut edged: Vec<u32> = self.sharp.iter().flatten().copied().collect();
        edged.sort_unstable();
        edged.dedup();
        edged
    }

    /// The regions that break with others and are planes, with a normal and their places.
    fn planes(&self) -> Vec<Plane> {
        let of_region = |region: u32| {
            let points = &self.index.get(&region)?.points;
            let own: Vec<OrientedPoint> =
                (points.iter()).map(|i| self.points[*i as usize]).collect();
            let centre = own.iter().map(|p| p.position).sum::<Vec3>() / own.len().max(1) as f64;
            let reach = own
                .iter()
                .map(|p| (p.position - centre).norm())
                .fold(0.0, f64::max);
            let sheet = Sheet::through(&own, &centre, reach, &self.scatter)?;
            (sheet.is_plane() && sheet.misfit < MISFIT_MAX).then(|| Plane {
                region,
                normal: sheet.normal(&centre),
                places: self.places(region),
            })
        };
        self.edged().into_iter().filter_map(of_region).collect()
    }

    /// Pieces of a sheet that is one quadric join it: those with few points that it explains, and it explains its own. Around a
    /// cylinder's rim ten points may lean so that they seem to break with its side.
    fn join_pieces(&mut self) {
        for host in self.edged() {
            let own = self.places(host);
            if own.len() < FRAGMENT_MAX {
                continue;
            }
            let Some(whole) = QuadricFit::quadric(&own).filter(|fit| fit.quadric.explains(&own))
            else {
                continue;
            };
            let pieces: Vec<u32> = (self.names().into_iter())
                .filter(|piece| {
                    let places = self.places(*piece);
                    *piece != host && places.len() < FRAGMENT_MAX && whole.quadric.explains(&places)
                })
                .collect();
            for piece in pieces {
                self.join([host, piece]);
            }
        }
    }

    /// Takes region `b` into `a`.
    fn join(&mut self, [a, b]: [u32; 2]) {
        for label in self.label.iter_mut().filter(|l| **l == b) {
            *label = a;
        }
        for region in self.sharp.iter_mut().flatten().filter(|l| **l == b) {
            *region = a;
        }
        for pair in &mut self.sharp {
            pair.sort_unstable();
        }
        self.sharp.retain(|[a, b]| a != b);
        self.sharp.sort_unstable();
        self.sharp.dedup();
        self.sort_members();
    }

    /// Planes that a gap parts and that are one join: if one plane explains the places of both about as well as two do
    /// (Schwarz' criterion for its three coefficients). Otherwise the corners where both meet a third are none.
    fn join_planes(&mut self) {
        loop {
            let planes = self.planes();
            let pairs = (0..planes.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
            let one = pairs
                .map(|(j, i)| [&planes[j], &planes[i]])
                .find(|[a, b]| self.are_one(a, b));
            let Some(pair) = one.map(|pair| pair.map(|plane| plane.region)) else {
                return;
            };
            self.join(pair);
        }
    }

    fn are_one(&self, a: &Plane, b: &Plane) -> bool {
        let pair = [a.region.min(b.region), a.region.max(b.region)];
        if a.normal.dot(&b.normal) < PARALLEL || self.sharp.contains(&pair) {
            return false;
        }
        let near = |place: &Place| {
            let found = self.index[&b.region].tree.nearest_one(&place.position);
            found.is_some_and(|(_, d2)| d2 < (SIGHT * self.spacing).powi(2))
        };
        let both = [a.places.as_slice(), &b.places].concat();
        let misfit = |places: &[Place]| QuadricFit::plane(places).map(|fit| fit.misfit);
        let criterion = 3.0 * (3.0 * both.len() as f64).ln();
        a.places.iter().any(near)
            && matches!(
                (misfit(&both), misfit(&a.places), misfit(&b.places)),
                (Some(one), Some(a), Some(b)) if one - a - b < criterion
            )
    }

    /// Planes that break with other sheets break with one another, too, where gaps or single points at their common
    /// edge hide it: a plane goes on until something ends it.
    fn sharpen_planes(&mut self, turn_min: f64) {
        let planes = self.planes();
        for (k, a) in planes.iter().enumerate() {
            for b in &planes[..k] {
                let turn = a.normal.angle(&b.normal);
                if turn > turn_min && turn < std::f64::consts::PI - turn_min {
                    let [a, b] = [a.region, b.region];
                    self.sharp.push([a.min(b), a.max(b)]);
                }
            }
        }
        self.sharp.sort_unstable();
        self.sharp.dedup();
    }

    fn drop_small(&mut self) {
        let mut count = BTreeMap::new();
        for l in &self.label {
            *count.entry(*l).or_insert(0usize) += 1;
        }
        for l in &mut self.label {
            if count.get(l).copied().unwrap_or(0) < REGION_MIN {
                *l = NONE;
            }
        }
    }

    /// A small region that a gap in the data cuts off from its sheet joins the region whose sheet, carried
    /// on across the gap, predicts most of its points.
    fn join_fragments(&mut self) {
        let members = self.members();
        let mut small: Vec<(usize, u32)> = members
            .iter()
            .filter(|(_, m)| m.len() < FRAGMENT_MAX)
            .map(|(l, m)| (m.len(), *l))
            .collect();
        small.sort_unstable();
        for (_, fragment) in small {
            let own: Vec<usize> = (0..self.label.len())
                .filter(|i| self.label[*i] == fragment)
                .collect();
            let mut votes: BTreeMap<u32, usize> = BTreeMap::new();
            for &i in &own {
                let p = self.points[i];
                // The nearest point of every other region in sight.
                let mut gaps: BTreeMap<u32, f64> = BTreeMap::new();
                for (j, squared) in self.tree.within(&p.position, SIGHT * self.spacing) {
                    let l = self.label[j];
                    if l != NONE && l != fragment && self.points[j].normal.dot(&p.normal) > 0.0 {
                        gaps.entry(l).or_insert(squared.sqrt());
                    }
                }
                for (l, gap) in gaps {
                    if let Some(sheet) = self.wide_sheet(l, &p.position)
                        && self.agrees(&sheet, &p, gap)
                    {
                        *votes.entry(l).or_default() += 1;
                    }
                }
            }
            let best = votes
                .iter()
                .max_by_key(|(l, n)| (**n, std::cmp::Reverse(**l)));
            if let Some((l, n)) = best
                && n * 5 >= own.len() * 4
            {
                for i in own {
                    self.label[i] = *l;
                }
            }
        }
    }

    /// Points of dropped regions join the neighbouring region whose sheet predicts them best, within twice
    /// the usual bounds.
    fn adopt(&mut self, neighbours: &[Vec<u32>]) {
        for _ in 0..3 {
            let mut found = Vec::new();
            for i in (0..self.points.len()).filter(|i| self.label[*i] == NONE) {
                let mut labels: Vec<u32> = neighbours[i]
                    .iter()
                    .map(|j| self.label[*j as usize])
                    .collect();
                labels.retain(|l| *l != NONE);
                labels.sort_unstable();
                labels.dedup();
                let p = &self.points[i];
                let mut best: Option<(f64, u32)> = None;
                for l in labels {
                    let Some(sheet) = self.sheet(l, &p.position, 16) else {
                        continue;
                    };
                    let off = sheet.distance(&p.position).abs()
                        / (2.0 * AGREE * self.scatter.position + 0.2 * self.spacing);
                    let turn = (sheet.normal(&p.position) - p.normal).norm()
                        / (2.0 * AGREE * self.scatter.normal + 2.0 * AGREE_NORMAL);
                    let miss = off.max(turn);
                    if miss < 1.0 && best.is_none_or(|(m, _)| miss < m) {
                        best = Some((miss, l));
                    }
                }
                if let Some((_, l)) = best {
                    found.push((i, l));
                }
            }
            if found.is_empty() {
                break;
            }
            for (i, l) in found {
                self.label[i] = l;
            }
        }
    }

    /// All pairs of regions with neighbouring points, and how they meet.
    fn boundaries(&self, neighbours: &[Vec<u32>], turn_min: f64) -> Vec<Boundary> {
        let mut places: Vec<([u32; 2], u32, u32)> = Vec::new();
        for i in 0..self.points.len() as u32 {
            for &j in neighbours[i as usize].iter().take(10) {
                let (a, b) = (self.label[i as usize], self.label[j as usize]);
                let twice = j < i && neighbours[j as usize].iter().take(10).any(|k| *k == i);
                if a != NONE && b != NONE && a != b && !twice {
                    let (i, j) = if a < b { (i, j) } else { (j, i) };
                    places.push(([a.min(b), a.max(b)], i, j));
                }
            }
        }
        places.sort_unstable();
        let members = self.members();
        let mut explained: BTreeMap<u32, bool> = BTreeMap::new();
        let same = |a: &([u32; 2], u32, u32), b: &([u32; 2], u32, u32)| a.0 == b.0;
        let mut out = Vec::new();
        for places in places.chunk_by(same) {
            let regions = places[0].0;
            let mut boundary = Boundary {
                regions,
                least: regions
                    .map(|r| members[&r].len())
                    .into_iter()
                    .fold(usize::MAX, usize::min),
                places: 0,
                sharp: 0,
                smooth: 0,
                turn: 0.0,
                whole: [false; 2],
                rounded: false,
            };
            let mut crossings = Vec::new();
            for &(regions, i, j) in places {
                let meeting = self.meeting(regions, i, j);
                let turn = match meeting {
                    Meeting::Angle(crossing) => crossing.turn(),
                    Meeting::Smooth | Meeting::Contradicted => 0.0,
                };
                boundary.places += 1;
                match meeting {
                    Meeting::Angle(crossing) if turn > turn_min => {
                        boundary.sharp += 1;
                        crossings.push(crossing);
                    }
                    Meeting::Contradicted => {}
                    _ => boundary.smooth += 1,
                }
                boundary.turn += (turn - boundary.turn) / boundary.places as f64;
            }
            boundary.whole = regions.map(|region| {
                let whole = explained.entry(region);
                *whole.or_insert_with(|| self.explained(&members[&region]))
            });
            let mut unexplained =
                [0, 1].map(|k| (!boundary.whole[k]).then(|| members[&regions[k]].len()));
            unexplained.sort_unstable();
            boundary.rounded = !crossings.is_empty()
                && match unexplained {
                    [None, None] => false,
                    [None, Some(least)] | [Some(least), Some(_)] if least < FRAGMENT_MAX => true,
                    _ => self.is_rounded(&crossings),
                };
            out.push(boundary);
        }
        out
    }

    /// Whether one plane or quadric explains points of a region.
    fn explained(&self, points: &[u32]) -> bool {
        let places: Vec<Place> = points.iter().map(|i| self.place(*i)).collect();
        QuadricFit::quadric(&places).is_some_and(|fit| fit.explains_its_own(places.len()))
    }

    /// Whether the normals turn gradually where two sheets seem to cross, or too few points tell.
    fn is_rounded(&self, crossings: &[Crossing]) -> bool {
        let edge = Neighbourhoods::new(crossings.iter().map(|c| c.at).collect());
        let mut near: Vec<usize> = crossings
            .iter()
            .flat_map(|c| self.tree.within(&c.at, EDGE_SIGHT * self.spacing))
            .map(|(point, _)| point)
            .collect();
        near.sort_unstable();
        near.dedup();
        let seen = |point: usize| {
            let point = &self.points[point];
            let (crossing, _) = edge.nearest_one(&point.position)?;
            let crossing = &crossings[crossing];
            let [a, b] = &crossing.normals;
            if point.normal.dot(&(a + b).normalize()) < FACING {
                return None;
            }
            let towards = (b - a * a.dot(b)).normalize();
            let seen = ramp::Seen {
                side: crossing.across.dot(&(point.position - crossing.at)) / self.spacing,
                angle: point.normal.dot(&towards).atan2(point.normal.dot(a)),
                turn: crossing.turn(),
            };
            Some((point.position, seen))
        };
        let (places, seen): (Vec<Vec3>, Vec<ramp::Seen>) =
            near.into_iter().filter_map(seen).unzip();
        // Lines along the whole edge would have to follow all that its sheets do.
        let tree = Neighbourhoods::new(places.clone());
        let mut taken = vec![false; seen.len()];
        let mut stretches: Vec<Vec<ramp::Seen>> = Vec::new();
        for middle in 0..seen.len() {
            if taken[middle] {
                continue;
            }
            let around = tree.within(&places[middle], STRETCH * self.spacing);
            let free = around.into_iter().map(|(point, _)| point);
            let free = free.filter(|point| !std::mem::replace(&mut taken[*point], true));
            stretches.push(free.map(|point| seen[point]).collect());
        }
        let blur = BLUR * self.scatter.position / self.spacing;
        ramp::is_likelier(&stretches, blur).unwrap_or(true)
    }

    /// How the sheets of two regions meet between points `i` and `j`.
    fn meeting(&self, regions: [u32; 2], i: u32, j: u32) -> Meeting {
        let (p, q) = (&self.points[i as usize], &self.points[j as usize]);
        let middle = (p.position + q.position) * 0.5;
        let (Some(a), Some(b)) = (
            self.sheet(regions[0], &middle, SHEET_POINTS),
            self.sheet(regions[1], &middle, SHEET_POINTS),
        ) else {
            return Meeting::Contradicted;
        };
        let reach = 1.5 * self.spacing.max((p.position - q.position).norm());
        let Some(x) = meet(&[Piece::Near(a), Piece::Near(b)], &middle, reach) else {
            return Meeting::Smooth;
        };
        // Each sheet must end in points of its own: carried on by more than two spacings it is a guess, unless both are
        // planes, which go far.
        let sight = if a.is_plane() && b.is_plane() {
            PLANE_SIGHT
        } else {
            SHEET_SIGHT
        };
        let mut ends = [f64::INFINITY; 2];
        let (mut near, mut against) = (0usize, 0usize);
        for (k, squared) in self.tree.within(&x, sight * self.spacing) {
            let side = regions.iter().position(|r| *r == self.label[k]);
            if let Some(s) = side {
                ends[s] = ends[s].min(squared.sqrt());
            }
            let point = &self.points[k];
            if point.normal.dot(&(p.normal + q.normal)) <= 0.0 {
                continue;
            }
            near += 1;
            let sheet = match side {
                Some(0) => &a,
                Some(_) => &b,
                None => {
                    against += 1;
                    continue;
                }
            };
            against += usize::from(!self.agrees(sheet, point, 0.0));
        }
        if ends.iter().any(|e| !e.is_finite()) || against * 5 > near {
            return Meeting::Contradicted;
        }
        let normals = [a.normal(&x), b.normal(&x)];
        let [m, n] = &normals;
        let across = m.cross(n).cross(&(m + n));
        let across = across * across.dot(&(q.position - p.position)).signum();
        Meeting::Angle(Crossing {
            at: x,
            normals,
            across: across.try_normalize(0.0).unwrap_or_default(),
        })
    }
}

/// Where two sheets meet at an angle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Crossing {
    at: Vec3,
    /// Of the two sheets.
    normals: [Vec3; 2],
    /// Unit vector across the edge, from the first sheet to the second.
    across: Vec3,
}

impl Crossing {
    /// The angle, radians.
    fn turn(&self) -> f64 {
        let [m, n] = &self.normals;
        m.cross(n).norm().atan2(m.dot(n))
    }
}

/// How two sheets meet at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meeting {
    /// At an angle.
    Angle(Crossing),
    /// They do not, though there are points of both: one goes on as the other.
    Smooth,
    /// Points near by contradict them, or end before the place.
    Contradicted,
}

/// How two regions meet.
#[derive(Clone, Copy, Debug)]
struct Boundary {
    regions: [u32; 2],
    /// Points of the smaller one.
    least: usize,
    /// Pairs of neighbouring points across it.
    places: usize,
    /// Those at which the sheets meet at an angle.
    sharp: usize,
    /// Those at which one sheet goes on as the other.
    smooth: usize,
    /// Mean angle, radians.
    turn: f64,
    /// Whether each region is one plane or quadric.
    whole: [bool; 2],
    /// Whether what seems to be an edge is rounded: the normals turn gradually, or a small region beside it is no sheet.
    rounded: bool,
}

impl Boundary {
    /// Whether most places are sharp, or, where points near by contradict many, two fifths are and hardly any is smooth
    /// (around a cylinder's lid of 60 noisy contacts 58 of 130 places are sharp, and none is smooth).
    fn mostly_sharp(&self) -> bool {
        let most = 2 * self.sharp > self.places
            || 5 * self.sharp > 2 * self.places && self.sharp > 4 * self.smooth;
        most && !self.rounded
    }

    /// How many of its regions are `edged`: break with some other.
    fn known(&self, edged: &BTreeSet<u32>) -> usize {
        self.regions.iter().filter(|r| edged.contains(r)).count()
    }

    /// Whether the surface breaks there, by what is known of its regions.
    fn breaks_among(&self, edged: &BTreeSet<u32>) -> bool {
        let least = [usize::MAX, PLACES_MIN, 1][self.known(edged)];
        self.is_sharp() || self.sharp >= least && self.mostly_sharp()
    }

    /// Whether it shows by itself that the surface breaks there.
    fn is_sharp(&self) -> bool {
        !self.rounded
            && self.sharp >= PLACES_MIN
            && self.sharp as f64 >= SHARE_MIN * self.places as f64
            && (self.least >= PATCH_MAX || self.turn >= PATCH_TURN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use std::f64::consts::{FRAC_PI_2, TAU};

    fn boundary(least: usize, [places, sharp, smooth]: [usize; 3], degrees: f64) -> Boundary {
        Boundary {
            regions: [0, 1],
            least,
            places,
            sharp,
            smooth,
            turn: degrees.to_radians(),
            whole: [false; 2],
            rounded: false,
        }
    }

    #[test]
    fn a_dozen_points_show_an_edge_only_if_it_is_steep() {
        // Seen on a mug's rounded bottom, on a cylinder's lid, and on a face of a prism.
        assert!(!boundary(11, [33, 33, 0], 40.0).is_sharp());
        assert!(boundary(11, [50, 46, 0], 80.0).is_sharp());
        assert!(boundary(40, [33, 33, 0], 40.0).is_sharp());
    }

    #[test]
    fn places_that_others_contradict_do_not_outvote_sharp_ones_but_smooth_ones_do() {
        assert!(boundary(59, [130, 58, 0], 40.0).mostly_sharp());
        assert!(!boundary(59, [130, 58, 20], 40.0).mostly_sharp());
        assert!(!boundary(59, [130, 40, 0], 40.0).mostly_sharp());
        assert!(!boundary(59, [130, 58, 0], 40.0).is_sharp());
    }

    #[test]
    fn beside_sheets_that_break_with_others_most_places_count() {
        // A face of a hexagonal prism with 18 contacts, beside two other faces.
        let [some, few] = [[38, 20, 0], [27, 8, 0]].map(|places| boundary(18, places, 32.0));
        let edged = |regions: &[u32]| regions.iter().copied().collect::<BTreeSet<u32>>();
        for (regions, breaks) in [
            (&[][..], false),
            (&[5], false),
            (&[0], true),
            (&[0, 1], true),
        ] {
            assert_eq!(some.breaks_among(&edged(regions)), breaks, "{regions:?}");
            assert!(!few.breaks_among(&edged(regions)));
        }
        let rounded = Boundary {
            rounded: true,
            ..some
        };
        assert!(!rounded.breaks_among(&edged(&[0, 1])));
    }

    /// The side of a cylinder from z = 0 to 1, and its lid there.
    fn open_cylinder() -> Cloud {
        let mut cloud = Cloud::default();
        let mut push = |position, normal| {
            cloud.points.push(OrientedPoint {
                position,
                normal,
                sigma: None,
                finger: None,
                time_us: None,
            });
        };
        for k in 0..400_u32 {
            let (sin, cos) = (2.399_963 * f64::from(k)).sin_cos();
            let height = f64::from(k) / 400.0;
            push(
                Vec3::new(0.4 * cos, 0.4 * sin, height),
                Vec3::new(cos, sin, 0.0),
            );
            if k % 4 == 0 {
                let radius = 0.4 * height.sqrt();
                push(Vec3::new(radius * cos, radius * sin, 1.0), Vec3::z());
            }
        }
        cloud
    }

    /// Tracks over the edge between a cylinder's side and its lid, rounded with `radius`; noise of a sixth of their step.
    fn tracks_over_a_rim(radius: f64, seed: u64) -> Cloud {
        const STEP: f64 = 0.029;
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        // Nearly normal, of variance 1.
        let mut noise = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let mut cloud = Cloud::default();
        for track in 0..28 {
            let (sin, cos) = (TAU * f64::from(track) / 28.0).sin_cos();
            // From half way up the side to the middle of the lid.
            let mut way = -0.5 + 0.01 * noise();
            while way < radius * FRAC_PI_2 + 0.2 {
                let lid = (way - radius * FRAC_PI_2).max(0.0);
                let turned = match way {
                    way if way <= 0.0 => 0.0,
                    _ if lid > 0.0 => FRAC_PI_2,
                    way => way / radius,
                };
                let out = 0.35 - radius + radius * turned.cos() - lid;
                let up = 0.8 - radius + radius * turned.sin() + way.min(0.0);
                let mut jitter = |sigma: f64| Vec3::new(noise(), noise(), noise()) * sigma;
                let normal = Vec3::new(cos * turned.cos(), sin * turned.cos(), turned.sin());
                cloud.points.push(OrientedPoint {
                    position: Vec3::new(cos * out, sin * out, up) + jitter(STEP / 6.0),
                    normal: (normal + jitter(0.052)).normalize(),
                    sigma: None,
                    finger: None,
                    time_us: None,
                });
                way += STEP;
            }
        }
        cloud
    }

    #[test]
    fn a_rim_rounded_by_two_spacings_is_no_edge_and_a_sharp_one_is() {
        for seed in 0..8 {
            let rounded = tracks_over_a_rim(0.05, seed);
            let found = Regions::new(&rounded, 0.6).sharp;
            assert!(found.is_empty(), "{seed}: {found:?}");
            let sharp = tracks_over_a_rim(0.0, seed);
            assert_eq!(Regions::new(&sharp, 0.6).sharp.len(), 1, "{seed}");
        }
    }

    #[test]
    fn a_piece_of_a_cylinders_side_joins_it_and_its_lid_does_not() {
        let cloud = open_cylinder();
        let mut regions = Regions::new(&cloud, 0.6);
        assert_eq!((regions.names().len(), regions.sharp.len()), (2, 1));
        let whole = regions.label.clone();
        let [side, lid] = [0, 1].map(|point| whole[point]);
        // Twelve points of the side beside the lid, said to break with both.
        let near = regions.tree.nearest(&Vec3::new(0.4, 0.0, 0.8), 12);
        let piece = 7;
        for (k, _) in near {
            regions.label[k] = piece;
        }
        regions.sharp = [side, lid].map(|other| [other, piece]).to_vec();
        regions.sharp.push([side.min(lid), side.max(lid)]);
        regions.sharp.sort_unstable();
        regions.sort_members();
        regions.join_pieces();
        assert_eq!(regions.label, whole);
        assert_eq!(regions.sharp, [[side.min(lid), side.max(lid)]]);
    }
}
