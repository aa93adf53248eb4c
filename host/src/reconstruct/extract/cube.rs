//! One cube of marching cubes: which polygons the zero set cuts out of it, whatever the signs.
//!
//! Instead of a table (Lorensen and Cline 1987, MC33 of Chernyaev 1995 with the corrections of Custodio et al.
//! 2013) the polygons are traced: each face of the cube contributes one or two directed segments, an ambiguous
//! face is settled by the saddle of its bilinear interpolant (Nielson and Hamann 1991), and segments join to
//! loops. Two ways were weighed: tetrahedra have no ambiguity but twice the triangles and a lattice bias; a
//! table of 33 cases is fast but long and easy to get wrong, and tracing costs little beside the field's values.
//!
//! Promises: both cubes at a face draw the same segments, because the decision uses only that face's values; each
//! loop becomes a disc, or two loops a tube where the trilinear interpolant has a tunnel; no diagonal lies in
//! a cube face. So the mesh over any set of cubes is a manifold, closed except at cubes left out.
//! Three and more loops are always discs (the rare tunnels of case 13.5 are cut; a finer lattice shows them).
//!
//! Corners: bit 0 is x, bit 1 y, bit 2 z.   2---3      6---7
//!                                          |   |      |   |
//!                                          0---1 (z0) 4---5 (z1)

use crate::Vec3;

/// Corners of each face, counter-clockwise seen from outside the cube.
const FACES: [[u8; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// The cube's edges as (lower corner, axis).
pub(super) const EDGES: [(u8, u8); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// A vertex of the cut: on one of the cube's edges, or inside the cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Corner {
    /// On the edge of this number in [`EDGES`].
    Edge(u8),
    /// The `n`-th vertex inside this cube.
    Inside(u8),
}

/// What the zero set cuts out of a cube.
#[derive(Clone, Debug, Default)]
pub(super) struct Cut {
    /// Triangles, counter-clockwise seen from the positive side.
    pub triangles: Vec<[Corner; 3]>,
    /// Positions of the inside vertices in the unit cube.
    pub inside: Vec<Vec3>,
}

fn edge_between(a: u8, b: u8) -> u8 {
    let axis = (a ^ b).trailing_zeros() as u8;
    let low = a.min(b);
    EDGES
        .iter()
        .position(|&e| e == (low, axis))
        .map_or(0, |i| i as u8)
}

/// Faces (bits) an edge belongs to.
fn faces_of(edge: u8) -> u8 {
    let (corner, axis) = EDGES[edge as usize];
    (0..3)
        .filter(|&a| a != axis)
        .map(|a| 1 << (2 * a + (corner >> a & 1)))
        .sum()
}

/// Where the zero lies on an edge, in the unit cube.
pub(super) fn crossing(values: &[f64; 8], edge: u8) -> Vec3 {
    let (corner, axis) = EDGES[edge as usize];
    let (a, b) = (
        values[corner as usize],
        values[(corner | 1 << axis) as usize],
    );
    let mut x = Vec3::new(
        f64::from(corner & 1),
        f64::from(corner >> 1 & 1),
        f64::from(corner >> 2 & 1),
    );
    x[axis as usize] = a / (a - b);
    x
}

/// Cuts a cube with the given corner values; values >= 0 count as positive.
pub(super) fn cut(values: &[f64; 8]) -> Cut {
    let positive = |c: u8| values[c as usize] >= 0.0;
    let mut next = [u8::MAX; 12];
    // Corners joined through edges or across ambiguous faces, for the tunnel test.
    let mut region: [u8; 8] = std::array::from_fn(|c| c as u8);
    let join = |region: &mut [u8; 8], a: u8, b: u8| {
        let (from, to) = (region[a as usize], region[b as usize]);
        for r in region.iter_mut() {
            if *r == from {
                *r = to;
            }
        }
    };
    for face in &FACES {
        let edge = |i: usize| edge_between(face[i % 4], face[(i + 1) % 4]);
        let rising: Vec<usize> = (0..4)
            .filter(|&i| !positive(face[i]) && positive(face[(i + 1) % 4]))
            .collect();
        for i in 0..4 {
            if positive(face[i]) == positive(face[(i + 1) % 4]) {
                join(&mut region, face[i], face[(i + 1) % 4]);
            }
        }
        match rising.len() {
            1 => {
                let falling = (0..4)
                    .find(|&i| positive(face[i]) && !positive(face[(i + 1) % 4]))
                    .unwrap_or(0);
                next[edge(rising[0]) as usize] = edge(falling);
            }
            2 => {
                let v = |i: usize| values[face[i % 4] as usize];
                let first = (rising[0] + 1) % 4;
                let joined = v(first) * v(first + 2) > v(first + 1) * v(first + 3);
                for &i in &rising {
                    next[edge(i) as usize] = edge(if joined { i + 3 } else { i + 1 });
                }
                let at = if joined { first } else { first + 1 };
                join(&mut region, face[at % 4], face[(at + 2) % 4]);
            }
            _ => {}
        }
    }
    let loops = trace(&next);
    let mut result = Cut::default();
    if let [first, second] = &loops[..]
        && tunnel(values, &region)
        && let Some(tube) = bridge(values, first, second)
    {
        result.triangles = tube;
        return result;
    }
    for polygon in &loops {
        fill(values, polygon, &mut result);
    }
    result
}

/// Follows the segments to closed loops, counter-clockwise seen from the positive side.
fn trace(next: &[u8; 12]) -> Vec<Vec<u8>> {
    let mut seen = [false; 12];
    let mut loops = Vec::new();
    for start in 0..12 {
        if next[start] == u8::MAX || seen[start] {
            continue;
        }
        let mut polygon = Vec::new();
        let mut at = start;
        while !seen[at] {
            seen[at] = true;
            polygon.push(at as u8);
            at = next[at] as usize;
        }
        polygon.reverse();
        loops.push(polygon);
    }
    loops
}

/// Whether two regions of one sign, apart on the cube's surface, meet inside: some slice of the trilinear
/// interpolant joins them across its saddle.
fn tunnel(values: &[f64; 8], region: &[u8; 8]) -> bool {
    for positive in [true, false] {
        let sign = if positive { 1.0 } else { -1.0 };
        let mine = |c: usize| (values[c] >= 0.0) == positive;
        let mut names: Vec<u8> = (0..8).filter(|&c| mine(c)).map(|c| region[c]).collect();
        names.sort_unstable();
        names.dedup();
        if names.len() != 2 {
            continue;
        }
        for axis in 0..3 {
            let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
            let columns = [0, u, u | v, v];
            let at = |column: usize, t: f64| {
                let (a, b) = (values[column], values[column | 1 << axis]);
                sign * (a + t * (b - a))
            };
            for k in 1..32 {
                let t = f64::from(k) / 32.0;
                let s: [f64; 4] = std::array::from_fn(|i| at(columns[i], t));
                for (i, j) in [(0, 1), (1, 0)] {
                    let joined = s[i] > 0.0
                        && s[i + 2] > 0.0
                        && s[j] < 0.0
                        && s[(j + 2) % 4] < 0.0
                        && s[i] * s[i + 2] > s[j] * s[(j + 2) % 4];
                    if !joined {
                        continue;
                    }
                    let name = |column: usize| {
                        let end = if mine(column) {
                            column
                        } else {
                            column | 1 << axis
                        };
                        region[end]
                    };
                    if name(columns[i]) != name(columns[i + 2]) {
                        return true;
                    }
                }
            }
        }
    }
    false
}

/// Whether a chord between two edges' crossings would lie in a face of the cube.
fn in_face(a: u8, b: u8) -> bool {
    faces_of(a) & faces_of(b) != 0
}

/// Triangles of the disc bounded by `polygon`: the shortest diagonals of those that do not lie in a face, or a fan
/// around an inside vertex if there are none.
fn fill(values: &[f64; 8], polygon: &[u8], result: &mut Cut) {
    let n = polygon.len();
    if n < 3 {
        return;
    }
    let place: Vec<Vec3> = polygon.iter().map(|&e| crossing(values, e)).collect();
    let chord = |i: usize, j: usize| -> f64 {
        if j == i + 1 || (i == 0 && j == n - 1) {
            0.0
        } else if in_face(polygon[i], polygon[j]) {
            f64::INFINITY
        } else {
            (place[i] - place[j]).norm()
        }
    };
    // cost[i][j]: least sum of diagonals that triangulate the sub-polygon i..=j (Gilbert 1979, Klincsek 1980).
    let mut cost = vec![vec![0.0_f64; n]; n];
    let mut apex = vec![vec![0_usize; n]; n];
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            cost[i][j] = f64::INFINITY;
            for k in i + 1..j {
                let c = cost[i][k] + cost[k][j] + chord(i, k) + chord(k, j);
                if c < cost[i][j] {
                    cost[i][j] = c;
                    apex[i][j] = k;
                }
            }
        }
    }
    if cost[0][n - 1].is_finite() {
        let mut open = vec![(0, n - 1)];
        while let Some((i, j)) = open.pop() {
            if j < i + 2 {
                continue;
            }
            let k = apex[i][j];
            let corner = |m: usize| Corner::Edge(polygon[m]);
            result.triangles.push([corner(i), corner(k), corner(j)]);
            open.push((i, k));
            open.push((k, j));
        }
    } else {
        let middle = Corner::Inside(result.inside.len() as u8);
        result.inside.push(place.iter().sum::<Vec3>() / n as f64);
        for i in 0..n {
            result.triangles.push([
                Corner::Edge(polygon[i]),
                Corner::Edge(polygon[(i + 1) % n]),
                middle,
            ]);
        }
    }
}

/// Triangles of the tube between two loops, shortest rungs first; `None` if every way needs a rung in a face.
///
/// A tube is a cyclic sequence of steps along either loop. It is opened at a rung where a step along the second
/// is followed by one along the first; no rung may come twice, so neither loop is walked in one go.
fn bridge(values: &[f64; 8], first: &[u8], second: &[u8]) -> Option<Vec<[Corner; 3]>> {
    let (m, n) = (first.len(), second.len());
    let mut best: Option<(f64, Vec<[Corner; 3]>)> = None;
    for opening in 0..m * n {
        let one = |i: usize| first[(opening / n + i) % m];
        // The second loop runs the other way around the tube.
        let other = |j: usize| second[(opening % n + n - j % n) % n];
        let rung = |i: usize, j: usize| -> f64 {
            let (a, b) = (one(i), other(j));
            if in_face(a, b) || (i == m && j == 0) {
                f64::INFINITY
            } else {
                (crossing(values, a) - crossing(values, b)).norm()
            }
        };
        let mut cost = vec![vec![f64::INFINITY; n + 1]; m + 1];
        cost[0][0] = rung(0, 0);
        for i in 1..=m {
            for j in 0..=n {
                let along_first = if j == n && i == m {
                    f64::INFINITY
                } else {
                    cost[i - 1][j]
                };
                let along_second = if j > 0 { cost[i][j - 1] } else { f64::INFINITY };
                cost[i][j] = along_first.min(along_second) + rung(i, j);
            }
        }
        if cost[m][n].is_infinite() || best.as_ref().is_some_and(|(c, _)| *c <= cost[m][n]) {
            continue;
        }
        let (one, other) = (|i| Corner::Edge(one(i)), |j| Corner::Edge(other(j)));
        let (mut i, mut j) = (m, n);
        let mut triangles = Vec::new();
        while i + j > 0 {
            let second_last = (i, j) == (m, n);
            if j > 0 && (second_last || cost[i][j - 1] < cost[i - 1][j]) {
                triangles.push([one(i), other(j), other(j - 1)]);
                j -= 1;
            } else {
                triangles.push([one(i - 1), one(i), other(j)]);
                i -= 1;
            }
        }
        best = Some((cost[m][n], triangles));
    }
    best.map(|(_, t)| t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use std::collections::BTreeMap;

    fn place(cut: &Cut, values: &[f64; 8], corner: Corner) -> Vec3 {
        match corner {
            Corner::Edge(e) => crossing(values, e),
            Corner::Inside(i) => cut.inside[i as usize],
        }
    }

    fn key(corner: Corner) -> u8 {
        match corner {
            Corner::Edge(e) => e,
            Corner::Inside(i) => 100 + i,
        }
    }

    /// Directed edges that have no partner, as (from, to).
    fn border(cut: &Cut) -> Vec<(u8, u8)> {
        let mut count: BTreeMap<(u8, u8), i32> = BTreeMap::new();
        for t in &cut.triangles {
            for i in 0..3 {
                *count.entry((key(t[i]), key(t[(i + 1) % 3]))).or_default() += 1;
            }
        }
        assert!(count.values().all(|&n| n == 1), "an edge is used twice");
        count
            .keys()
            .filter(|&&(a, b)| !count.contains_key(&(b, a)))
            .copied()
            .collect()
    }

    fn random_values(mask: u32, random: &mut rand_chacha::ChaCha8Rng) -> [f64; 8] {
        std::array::from_fn(|c| {
            let size: f64 = 0.05 + random.random::<f64>();
            if mask >> c & 1 == 1 { size } else { -size }
        })
    }

    fn trilinear(values: &[f64; 8], x: &Vec3) -> f64 {
        (0..8)
            .map(|c| {
                let w: f64 = (0..3)
                    .map(|a| if c >> a & 1 == 1 { x[a] } else { 1.0 - x[a] })
                    .product();
                w * values[c]
            })
            .sum()
    }

    #[test]
    fn every_mask_is_bordered_by_its_face_segments_alone_and_looks_outward() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for mask in 0..256 {
            for _ in 0..40 {
                let values = random_values(mask, &mut random);
                let cut = cut(&values);
                let edges = border(&cut);
                // Each crossed edge of the cube is entered and left once, along two different faces.
                let crossed = (0..12u8).filter(|&e| {
                    let (c, a) = EDGES[e as usize];
                    (mask >> c & 1) != (mask >> (c | 1 << a) & 1)
                });
                for e in crossed {
                    assert_eq!(edges.iter().filter(|(a, _)| *a == e).count(), 1, "{mask}");
                    assert_eq!(edges.iter().filter(|(_, b)| *b == e).count(), 1, "{mask}");
                }
                for &(a, b) in &edges {
                    assert!(a < 100 && b < 100 && in_face(a, b), "{mask}: {a} {b}");
                }
                // No inner edge lies in a face: the neighbour could have it too.
                for t in &cut.triangles {
                    for i in 0..3 {
                        let (a, b) = (key(t[i]), key(t[(i + 1) % 3]));
                        if a < 100 && b < 100 && in_face(a, b) {
                            assert!(edges.contains(&(a, b)), "{mask}: diagonal in a face");
                        }
                    }
                }
                // The enclosed side is the negative one: the summed area vector follows the mean gradient.
                if let [t] = &cut.triangles[..] {
                    let p: Vec<Vec3> = t.iter().map(|&c| place(&cut, &values, c)).collect();
                    let normal = (p[1] - p[0]).cross(&(p[2] - p[0]));
                    let h = 1e-3 * normal.normalize();
                    let middle = (p[0] + p[1] + p[2]) / 3.0;
                    assert!(trilinear(&values, &(middle + h)) > trilinear(&values, &(middle - h)));
                }
            }
        }
    }

    #[test]
    fn neighbouring_cubes_share_the_segments_of_their_face() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for _ in 0..4000 {
            let left = random_values(random.random_range(0..256), &mut random);
            let mut right = random_values(random.random_range(0..256), &mut random);
            for (l, r) in [(1, 0), (3, 2), (5, 4), (7, 6)] {
                right[r] = left[l];
            }
            let on = |values: &[f64; 8], face: u8| -> Vec<(Vec3, Vec3)> {
                border(&cut(values))
                    .into_iter()
                    .filter(|&(a, b)| faces_of(a) & faces_of(b) & (1 << face) != 0)
                    .map(|(a, b)| (crossing(values, a), crossing(values, b)))
                    .collect()
            };
            let (from_left, from_right) = (on(&left, 1), on(&right, 0));
            assert_eq!(from_left.len(), from_right.len());
            for (a, b) in from_left {
                let shift = Vec3::x();
                assert!(
                    from_right
                        .iter()
                        .any(|(c, d)| (c + shift - b).norm() < 1e-12
                            && (d + shift - a).norm() < 1e-12)
                );
            }
        }
    }

    #[test]
    fn opposite_corners_are_joined_by_a_tube_exactly_where_the_interpolant_joins_them() {
        let mut values = [-0.1; 8];
        (values[0], values[7]) = (1.0, 1.0);
        let joined = cut(&values);
        assert_eq!(joined.triangles.len(), 6);
        let middle = trilinear(&values, &Vec3::repeat(0.5));
        assert!(middle > 0.0);
        values = [-1.0; 8];
        (values[0], values[7]) = (0.2, 0.2);
        assert_eq!(cut(&values).triangles.len(), 2);
    }
}
