//! A part of the plane cut into convex polygons by segments, always conforming.
//!
//! Two ways were weighed: the exact arrangement of all segments (every crossing a vertex, so slivers of any
//! thinness) and cutting a polygon mesh segment by segment, each cut carried through to the far side of the
//! polygons it enters. The second was taken: it stays a valid mesh whatever the rounding, and vertices within
//! a stated distance of a segment are taken to lie on it, so no piece gets thinner than that distance allows.

use super::super::simplex::Vec2;
use std::collections::HashMap;

/// Polygons over common points; each shared edge has the same two points on both sides.
#[derive(Clone, Debug, Default)]
pub(super) struct Partition {
    pub points: Vec<Vec2>,
    /// Corners counter-clockwise; some may lie on a straight side.
    pub faces: Vec<Vec<u32>>,
    /// The triangle each polygon was cut from.
    pub origin: Vec<u32>,
    boxes: Vec<[f64; 4]>,
    /// Face to the left of a directed edge. Looked up only, never walked through.
    left: HashMap<[u32; 2], u32>,
}

impl Partition {
    /// From counter-clockwise triangles.
    pub fn new(points: Vec<Vec2>, triangles: &[[u32; 3]]) -> Self {
        let mut out = Self {
            points,
            ..Self::default()
        };
        for (number, corners) in triangles.iter().enumerate() {
            out.push(corners.to_vec(), number as u32);
        }
        out
    }

    fn push(&mut self, corners: Vec<u32>, origin: u32) {
        self.faces.push(corners);
        self.origin.push(origin);
        self.boxes.push([0.0; 4]);
        self.register(self.faces.len() - 1);
    }

    /// Notes a face's edges and box.
    fn register(&mut self, face: usize) {
        let corners = &self.faces[face];
        let mut box_ = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        for (place, corner) in corners.iter().enumerate() {
            let next = corners[(place + 1) % corners.len()];
            self.left.insert([*corner, next], face as u32);
            let p = self.points[*corner as usize];
            box_ = [
                box_[0].min(p.x),
                box_[1].min(p.y),
                box_[2].max(p.x),
                box_[3].max(p.y),
            ];
        }
        self.boxes[face] = box_;
    }

    /// Cuts every polygon that the segment crosses on more than `snap`. Points within `snap` of its line count
    /// as lying on it.
    pub fn cut(&mut self, from: Vec2, to: Vec2, snap: f64) {
        let length = (to - from).norm();
        if length <= snap {
            return;
        }
        let along = (to - from) / length;
        let across = Vec2::new(-along.y, along.x);
        let (low, high) = (from.inf(&to), from.sup(&to));
        let faces = self.faces.len();
        for face in 0..faces {
            let [x0, y0, x1, y1] = self.boxes[face];
            if x0 <= high.x && low.x <= x1 && y0 <= high.y && low.y <= y1 {
                self.cut_face(face, from, along, across, length, snap);
            }
        }
    }

    fn cut_face(
        &mut self,
        face: usize,
        from: Vec2,
        along: Vec2,
        across: Vec2,
        length: f64,
        snap: f64,
    ) {
        let corners = &self.faces[face];
        let count = corners.len();
        let heights: Vec<f64> = corners
            .iter()
            .map(|c| across.dot(&(self.points[*c as usize] - from)))
            .collect();
        let side = |place: usize| {
            let height = heights[place % count];
            if height.abs() <= snap {
                0
            } else if height > 0.0 {
                1
            } else {
                -1
            }
        };
        // Where the line leaves the left side for the right one, and where it comes back.
        let crossing = |sign: i32| {
            let start = (0..count).find(|p| side(*p) == sign && side(p + 1) != sign)?;
            let mut nearest: Option<usize> = None;
            for place in start + 1..start + count {
                match side(place) {
                    0 if nearest
                        .is_none_or(|n| heights[place % count].abs() < heights[n].abs()) =>
                    {
                        nearest = Some(place % count);
                    }
                    0 => {}
                    other if other == sign => return None,
                    _ => return Some((start, nearest)),
                }
            }
            None
        };
        let (Some(down), Some(up)) = (crossing(1), crossing(-1)) else {
            return;
        };
        let place_of = |(start, at): (usize, Option<usize>)| match at {
            Some(place) => self.points[corners[place] as usize],
            None => {
                // From the lower to the higher number, so that both sides of the edge compute the same bits.
                let (mut a, mut b) = (start, (start + 1) % count);
                if corners[a] > corners[b] {
                    (a, b) = (b, a);
                }
                let t = heights[a] / (heights[a] - heights[b]);
                let [p, q] = [a, b].map(|k| self.points[corners[k] as usize]);
                p + (q - p) * t
            }
        };
        let [first, second] = [down, up].map(place_of);
        let [mut t0, mut t1] = [first, second].map(|p| along.dot(&(p - from)));
        if t0 > t1 {
            (t0, t1) = (t1, t0);
        }
        if t1.min(length) - t0.max(0.0) <= snap {
            return;
        }
        let number = |partition: &mut Self, (start, at): (usize, Option<usize>), p: Vec2| match at {
            Some(place) => partition.faces[face][place],
            None => {
                let [a, b] = [start, (start + 1) % count].map(|k| partition.faces[face][k]);
                partition.split_edge(a, b, p)
            }
        };
        // The later edge first, so that the places of the other one stay.
        let (a, b) = if down.0 > up.0 {
            let a = number(self, down, first);
            (a, number(self, up, second))
        } else {
            let b = number(self, up, second);
            (number(self, down, first), b)
        };
        self.split_face(face, a, b);
    }

    /// Puts a point on the edge from a to b, in both faces.
    fn split_edge(&mut self, a: u32, b: u32, at: Vec2) -> u32 {
        let new = self.points.len() as u32;
        self.points.push(at);
        for [from, to] in [[a, b], [b, a]] {
            let Some(face) = self.left.remove(&[from, to]) else {
                continue;
            };
            let corners = &mut self.faces[face as usize];
            if let Some(place) = corners.iter().position(|c| *c == from) {
                corners.insert(place + 1, new);
            }
            self.left.insert([from, new], face);
            self.left.insert([new, to], face);
        }
        new
    }

    fn split_face(&mut self, face: usize, a: u32, b: u32) {
        let corners = &self.faces[face];
        let find = |c: u32| corners.iter().position(|other| *other == c);
        let (Some(a), Some(b)) = (find(a), find(b)) else {
            return;
        };
        let (a, b) = (a.min(b), a.max(b));
        if b - a < 2 || b - a > corners.len() - 2 {
            return;
        }
        let inner = corners[a..=b].to_vec();
        let outer = [&corners[b..], &corners[..=a]].concat();
        self.faces[face] = outer;
        self.register(face);
        self.push(inner, self.origin[face]);
    }

    /// The faces that `keep` takes.
    pub fn kept(&self, keep: impl Fn(&Self, usize) -> bool) -> Self {
        let mut out = Self {
            points: self.points.clone(),
            ..Self::default()
        };
        for face in (0..self.faces.len()).filter(|face| keep(self, *face)) {
            out.push(self.faces[face].clone(), self.origin[face]);
        }
        out
    }

    /// Mean of a face's corners.
    pub fn centre(&self, face: usize) -> Vec2 {
        let corners = &self.faces[face];
        corners
            .iter()
            .map(|c| self.points[*c as usize])
            .sum::<Vec2>()
            / corners.len() as f64
    }

    /// Triangles of the faces that `keep` takes, each with the number of the triangle it was cut from. Every
    /// polygon is cut so that its thinnest triangle is as wide as can be.
    pub fn triangulate(
        &mut self,
        keep: impl Fn(&Self, usize) -> bool,
    ) -> (Vec<[u32; 3]>, Vec<u32>) {
        let (mut triangles, mut origin) = (Vec::new(), Vec::new());
        for face in 0..self.faces.len() {
            if !keep(self, face) {
                continue;
            }
            let corners = self.faces[face].clone();
            let before = triangles.len();
            if !best_triangles(&self.points, &corners, &mut triangles) {
                let centre = self.points.len() as u32;
                self.points.push(self.centre(face));
                for (place, corner) in corners.iter().enumerate() {
                    triangles.push([*corner, corners[(place + 1) % corners.len()], centre]);
                }
            }
            origin.resize(origin.len() + triangles.len() - before, self.origin[face]);
        }
        (triangles, origin)
    }
}

/// Height of a triangle over its longest side, as a share of that side; negative if clockwise.
pub(super) fn quality(a: Vec2, b: Vec2, c: Vec2) -> f64 {
    let longest = (b - a)
        .norm_squared()
        .max((c - b).norm_squared())
        .max((a - c).norm_squared());
    (b - a).perp(&(c - a)) / longest.max(f64::MIN_POSITIVE)
}

/// The triangulation of a convex polygon whose worst triangle is best; false if even that one is flat.
fn best_triangles(points: &[Vec2], corners: &[u32], out: &mut Vec<[u32; 3]>) -> bool {
    const FLAT: f64 = 1e-9;
    let n = corners.len();
    let at = |k: usize| points[corners[k] as usize];
    // worst[i][j]: the best worst quality of the polygon i, i + 1, …, j, and its corner k.
    let mut worst = vec![vec![(f64::INFINITY, 0); n]; n];
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            let mut best = (f64::NEG_INFINITY, i + 1);
            for k in i + 1..j {
                let value = quality(at(i), at(k), at(j))
                    .min(worst[i][k].0)
                    .min(worst[k][j].0);
                if value > best.0 {
                    best = (value, k);
                }
            }
            worst[i][j] = best;
        }
    }
    if n < 3 || worst[0][n - 1].0 < FLAT {
        return false;
    }
    let mut open = vec![(0, n - 1)];
    while let Some((i, j)) = open.pop() {
        if j - i < 2 {
            continue;
        }
        let k = worst[i][j].1;
        out.push([corners[i], corners[k], corners[j]]);
        open.push((i, k));
        open.push((k, j));
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_cuts_keep_the_area_and_every_edge_shared() {
        let points = vec![
            Vec2::new(0.0, 0.0),
            Vec2::new(1.0, 0.0),
            Vec2::new(1.0, 1.0),
            Vec2::new(0.0, 1.0),
        ];
        let mut partition = Partition::new(points, &[[0, 1, 2], [0, 2, 3]]);
        let mut state = 7_u64;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f64 / (1_u64 << 24) as f64
        };
        for _ in 0..60 {
            let from = Vec2::new(next(), next());
            let to = Vec2::new(next(), next());
            partition.cut(from, to, 1e-4);
        }
        assert!(partition.faces.len() > 200);
        let (triangles, _) = partition.triangulate(|_, _| true);
        let area: f64 = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| partition.points[v as usize]);
                (b - a).perp(&(c - a)) / 2.0
            })
            .sum();
        assert!((area - 1.0).abs() < 1e-12, "{area}");
        let table =
            crate::spline::edges::EdgeTable::new(partition.points.len(), &triangles).unwrap();
        for edge in table.edges.iter().filter(|e| e.is_border()) {
            let [a, b] = edge.vertices.map(|v| partition.points[v as usize]);
            let on = |f: fn(Vec2) -> f64, value: f64| {
                (f(a) - value).abs() < 1e-12 && (f(b) - value).abs() < 1e-12
            };
            assert!(
                on(|p| p.x, 0.0) || on(|p| p.x, 1.0) || on(|p| p.y, 0.0) || on(|p| p.y, 1.0),
                "{a} {b}"
            );
        }
    }
}
