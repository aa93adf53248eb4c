//! The dense mesh as a surface to come back to: foot points with normals, regions between creases, and
//! the crease and border lines as curves.

use super::sizing::{self, Sizing};
use super::{CreaseLines, Options, Project, SimplifyError};
use crate::Vec3;
use crate::mesh::{AabbTree, HalfEdgeMesh, NONE, TriangleMesh, closest_on_segment, unit_or_zero};

/// The dense mesh, with everything that is asked of it prepared.
pub(super) struct Reference<'a> {
    pub(super) mesh: &'a TriangleMesh,
    pub(super) half: HalfEdgeMesh,
    tree: AabbTree,
    face_normals: Vec<Vec3>,
    /// Per face, the normals at its corners; faces on both sides of a crease have normals of their own.
    pub(super) normals: Vec<[Vec3; 3]>,
    /// Per face, the region between creases it belongs to.
    pub(super) region: Vec<u32>,
    /// Per vertex, the edges asked for.
    pub(super) sizing: Vec<Sizing>,
    /// Crease and border edges, as pairs of vertices, with the line they belong to.
    segments: Vec<Segment>,
    project: Option<&'a Project<'a>>,
}

#[derive(Clone, Copy)]
struct Segment {
    ends: [u32; 2],
    line: u32,
}

/// A point of the reference surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) sizing: Sizing,
}

/// A point of a crease or border line.
#[derive(Clone, Copy, Debug)]
pub(super) struct LineFoot {
    pub(super) position: Vec3,
    pub(super) line: u32,
    pub(super) sizing: Sizing,
}

impl<'a> Reference<'a> {
    pub(super) fn new(
        mesh: &'a TriangleMesh,
        creases: &CreaseLines,
        options: &Options,
        project: Option<&'a Project<'a>>,
    ) -> Result<Self, SimplifyError> {
        if mesh.faces.is_empty() {
            return Err(SimplifyError::Empty);
        }
        let mut half = HalfEdgeMesh::new(mesh)?;
        for &[a, b] in &creases.edges {
            let h = half
                .find_edge(a, b)
                .ok_or(SimplifyError::NoSuchCrease(a, b))?;
            if !half.is_border(h) {
                half.set_crease(h, true);
            }
        }
        for &v in &creases.corners {
            if !half.has_vertex(v) {
                return Err(SimplifyError::NoSuchCorner(v));
            }
            half.set_pinned(v, true);
        }
        pin_border_corners(&mut half);
        // A field rounds creases off; beside them the mesh, cut along them, is the better surface.
        let project = project.filter(|_| creases.edges.is_empty());
        let face_normals: Vec<Vec3> = (0..mesh.faces.len() as u32)
            .map(|f| mesh.face_normal(f))
            .collect();
        let normals = corner_normals(&half, &face_normals, project);
        let region = regions(&half);
        let segments = lines(&half);
        let tree = AabbTree::new(mesh);
        let mut out = Self {
            mesh,
            half,
            tree,
            face_normals,
            normals,
            region,
            sizing: Vec::new(),
            segments,
            project,
        };
        out.sizing = sizing::sizes(&out, options);
        Ok(out)
    }

    /// The foot point of `p` among the faces of `region` whose normal agrees with `toward` (all of them,
    /// if that is zero), else among those of the region, else among all.
    pub(super) fn foot(&self, p: &Vec3, region: u32, toward: &Vec3) -> Option<Foot> {
        let agrees = |f: u32| self.face_normals[f as usize].dot(toward) >= 0.0;
        let inside = |f: u32| self.region[f as usize] == region;
        let everywhere = f64::INFINITY;
        let found = self
            .tree
            .closest_where(self.mesh, p, everywhere, |f| inside(f) && agrees(f))
            .or_else(|| self.tree.closest_where(self.mesh, p, everywhere, inside))
            .or_else(|| self.tree.closest(self.mesh, p))?;
        let f = found.face as usize;
        let mut normal = Vec3::zeros();
        for k in 0..3 {
            normal += self.normals[f][k] * found.barycentric[k];
        }
        Some(Foot {
            position: found.position,
            normal: unit_or_zero(normal),
            sizing: Sizing::mix([0, 1, 2].map(|k| {
                let v = self.mesh.faces[f][k] as usize;
                (&self.sizing[v], found.barycentric[k])
            })),
        })
    }

    /// As [`Self::foot`], carried on to the field where there is one and it agrees with the mesh.
    pub(super) fn fine_foot(&self, p: &Vec3, region: u32, toward: &Vec3) -> Option<Foot> {
        let mut foot = self.foot(p, region, toward)?;
        if let Some((q, n)) = self.project.and_then(|project| project(&foot.position)) {
            let near = (q - foot.position).norm() < 0.1 * foot.sizing.size;
            if near && n.dot(&foot.normal) > 0.7 && q.iter().all(|x| x.is_finite()) {
                foot.position = q;
                foot.normal = n;
            }
        }
        Some(foot)
    }

    /// Distance of `p` to the dense mesh.
    pub(super) fn distance(&self, p: &Vec3) -> Option<f64> {
        self.tree.closest(self.mesh, p).map(|foot| foot.distance)
    }

    /// The closest point of line `line` ([`NONE`]: of any line) to `p`.
    pub(super) fn line_foot(&self, p: &Vec3, line: u32) -> Option<LineFoot> {
        let mut best: Option<(f64, LineFoot)> = None;
        for s in self
            .segments
            .iter()
            .filter(|s| line == NONE || s.line == line)
        {
            let [a, b] = s.ends.map(|v| self.half.position(v));
            let t = closest_on_segment(p, &a, &b);
            let q = a + (b - a) * t;
            let d2 = (p - q).norm_squared();
            if best.as_ref().is_none_or(|(b2, _)| d2 < *b2) {
                let [sa, sb] = s.ends.map(|v| &self.sizing[v as usize]);
                let foot = LineFoot {
                    position: q,
                    line: s.line,
                    sizing: Sizing::mix([(sa, 1.0 - t), (sb, t)]),
                };
                best = Some((d2, foot));
            }
        }
        best.map(|(_, foot)| foot)
    }

    /// Per vertex, the line it lies on; [`NONE`] off all lines and at fixed vertices.
    pub(super) fn line_of_vertices(&self) -> Vec<u32> {
        let mut out = vec![NONE; self.half.vertex_slots()];
        for s in &self.segments {
            for v in s.ends {
                if self.half.freedom(v) == crate::mesh::Freedom::Curve {
                    out[v as usize] = s.line;
                }
            }
        }
        out
    }

    /// Distance to the next sheet that faces the other way, along the normal to both sides, from vertex
    /// `v` with normal `n`, looking no further than `reach`.
    pub(super) fn thickness(&self, v: u32, n: &Vec3, reach: f64) -> Option<f64> {
        let p = self.half.position(v);
        let start = 1e-6 * reach;
        let opposes = |f: u32| self.face_normals[f as usize].dot(n) < -0.3;
        [-1.0, 1.0]
            .iter()
            .filter_map(|side| {
                self.tree
                    .ray(self.mesh, &p, &(n * *side), start, reach, opposes)
            })
            .map(|hit| hit.distance)
            .min_by(f64::total_cmp)
    }
}

/// Normals per face corner: angle-weighted means of the faces in the same sector between creases.
fn corner_normals(
    half: &HalfEdgeMesh,
    faces: &[Vec3],
    project: Option<&Project<'_>>,
) -> Vec<[Vec3; 3]> {
    let mut out = vec![[Vec3::zeros(); 3]; faces.len()];
    for v in half.vertices() {
        let mut star: Vec<u32> = half.around(v).collect();
        let creases = star.iter().filter(|h| half.is_crease(**h)).count();
        if creases == 0
            && let Some((_, n)) = project.and_then(|project| project(&half.position(v)))
        {
            let mean: Vec3 = star.iter().map(|h| faces[(*h / 3) as usize]).sum();
            if n.dot(&unit_or_zero(mean)) > 0.7 {
                for h in star {
                    out[(h / 3) as usize][(h % 3) as usize] = n;
                }
                continue;
            }
        }
        if !half.is_border_vertex(v)
            && let Some(first) = star.iter().position(|h| half.is_crease(*h))
        {
            star.rotate_left(first);
        }
        let mut start = 0;
        for i in 1..=star.len() {
            if i == star.len() || half.is_crease(star[i]) {
                let mut sum = Vec3::zeros();
                for &h in &star[start..i] {
                    let (u, w) = (edge(half, h), -edge(half, HalfEdgeMesh::prev(h)));
                    sum += faces[(h / 3) as usize] * u.cross(&w).norm().atan2(u.dot(&w));
                }
                for &h in &star[start..i] {
                    out[(h / 3) as usize][(h % 3) as usize] = unit_or_zero(sum);
                }
                start = i;
            }
        }
    }
    out
}

fn edge(half: &HalfEdgeMesh, h: u32) -> Vec3 {
    half.position(half.destination(h)) - half.position(half.origin(h))
}

/// Faces connected without crossing a crease, numbered in the order of their first face.
fn regions(half: &HalfEdgeMesh) -> Vec<u32> {
    let mut out = vec![NONE; half.face_slots()];
    let mut next = 0;
    let mut stack = Vec::new();
    for seed in half.faces() {
        if out[seed as usize] != NONE {
            continue;
        }
        out[seed as usize] = next;
        stack.push(seed);
        while let Some(f) = stack.pop() {
            for h in 3 * f..3 * f + 3 {
                let t = half.twin(h);
                if t != NONE && !half.is_crease(h) && out[(t / 3) as usize] == NONE {
                    out[(t / 3) as usize] = next;
                    stack.push(t / 3);
                }
            }
        }
        next += 1;
    }
    out
}

/// All feature edges, numbered by the line they lie on: lines run between fixed vertices or close on
/// themselves.
fn lines(half: &HalfEdgeMesh) -> Vec<Segment> {
    let features: Vec<u32> = half.edges().filter(|h| half.is_feature(*h)).collect();
    let mut done = vec![false; 3 * half.face_slots()];
    let mark = |done: &mut Vec<bool>, h: u32| {
        done[h as usize] = true;
        if half.twin(h) != NONE {
            done[half.twin(h) as usize] = true;
        }
    };
    let mut out = Vec::new();
    let mut line = 0;
    for &seed in &features {
        if done[seed as usize] {
            continue;
        }
        mark(&mut done, seed);
        let ends = [half.origin(seed), half.destination(seed)];
        out.push(Segment { ends, line });
        for mut v in ends {
            while half.freedom(v) == crate::mesh::Freedom::Curve {
                let Some(h) = half.features_at(v).find(|h| !done[*h as usize]) else {
                    break;
                };
                mark(&mut done, h);
                let w = half.other_end(h, v);
                out.push(Segment { ends: [v, w], line });
                v = w;
            }
        }
        line += 1;
    }
    out
}

/// Pins border vertices at which the border turns by more than 60 degrees, seen over three edges to each
/// side (a ragged border of marching cubes turns to and fro and stays below).
fn pin_border_corners(half: &mut HalfEdgeMesh) {
    const REACH: usize = 3;
    let onward = |half: &HalfEdgeMesh, v: u32, back: bool| {
        half.features_at(v)
            .filter(|h| half.is_border(*h))
            .find(|h| (half.origin(*h) == v) != back)
            .map(|h| half.other_end(h, v))
    };
    let mut turns: Vec<(u32, f64, [u32; 2])> = Vec::new();
    for v in half.vertices().filter(|v| half.is_border_vertex(*v)) {
        let walk = |back: bool| {
            let mut at = v;
            for _ in 0..REACH {
                at = onward(half, at, back).unwrap_or(at);
            }
            at
        };
        let (before, after) = (walk(true), walk(false));
        let (u, w) = (
            half.position(v) - half.position(before),
            half.position(after) - half.position(v),
        );
        turns.push((v, u.cross(&w).norm().atan2(u.dot(&w)), [before, after]));
    }
    turns.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    for (v, turn, _) in turns {
        if turn < 60f64.to_radians() {
            break;
        }
        let mut near = false;
        for back in [true, false] {
            let mut at = v;
            for _ in 0..REACH {
                at = onward(half, at, back).unwrap_or(at);
                near |= half.is_pinned(at);
            }
        }
        if !near {
            half.set_pinned(v, true);
        }
    }
}
