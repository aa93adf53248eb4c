//! The two templates of adaptive refinement, on a base triangulation.
//!
//! Template 1 splits a face in four at the middles of its edges; template 2 splits a face in two at the one
//! edge it shares with a face split by template 1. A face beside two such faces is split in three (the
//! shorter diagonal), beside three in four. So the mesh stays without hanging vertices and only faces that
//! share an edge with a split one change.

use crate::Vec3;
use crate::spline::edges::{EdgeError, EdgeTable};

/// A base triangulation with its sharp features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Base {
    /// Vertices.
    pub vertices: Vec<Vec3>,
    /// Faces.
    pub faces: Vec<[u32; 3]>,
    /// Crease edges.
    pub creases: Vec<[u32; 2]>,
    /// Vertices where a crease or border turns sharply.
    pub corners: Vec<u32>,
}

/// Splits the faces marked in `split`. `middle(face, local, t)` gives the surface point in the middle of a
/// face's local edge.
///
/// # Errors
/// A base that is no proper triangulation.
pub fn split_faces(
    base: &Base,
    split: &[bool],
    middle: impl Fn(usize, usize) -> Vec3,
) -> Result<Base, EdgeError> {
    let table = EdgeTable::new(base.vertices.len(), &base.faces)?;
    let mut out = Base {
        vertices: base.vertices.clone(),
        corners: base.corners.clone(),
        ..Base::default()
    };
    let mut new_vertex: Vec<Option<u32>> = vec![None; table.edges.len()];
    for (face, marked) in split.iter().enumerate().take(base.faces.len()) {
        if !marked {
            continue;
        }
        for local in 0..3 {
            let edge = table.of_face[face][local] as usize;
            if new_vertex[edge].is_none() {
                new_vertex[edge] = Some(out.vertices.len() as u32);
                out.vertices.push(middle(face, local));
            }
        }
    }
    for crease in &base.creases {
        let [a, b] = *crease;
        match table.find(a, b).and_then(|e| new_vertex[e]) {
            Some(m) => out
                .creases
                .extend([[a.min(m), a.max(m)], [b.min(m), b.max(m)]]),
            None => out.creases.push([a.min(b), a.max(b)]),
        }
    }
    out.creases.sort_unstable();
    for (face, corners) in base.faces.iter().enumerate() {
        let middles = table.of_face[face].map(|e| new_vertex[e as usize]);
        let turn = |start: usize| {
            let c = [0, 1, 2].map(|m| corners[(start + m) % 3]);
            let e = [0, 1, 2].map(|m| middles[(start + m) % 3]);
            (c, e)
        };
        match middles.iter().flatten().count() {
            0 => out.faces.push(*corners),
            1 => {
                let start = middles.iter().position(Option::is_some).unwrap_or(0);
                let ([a, b, c], [m, ..]) = turn(start);
                let m = m.unwrap_or(a);
                out.faces.extend([[a, m, c], [m, b, c]]);
            }
            2 => {
                // Start behind the whole edge: edges `start` and `start + 1` are cut.
                let whole = middles.iter().position(Option::is_none).unwrap_or(0);
                let ([a, b, c], [m, n, _]) = turn((whole + 1) % 3);
                let (m, n) = (m.unwrap_or(a), n.unwrap_or(b));
                out.faces.push([m, b, n]);
                let length = |v: u32, w: u32| {
                    (out.vertices[v as usize] - out.vertices[w as usize]).norm_squared()
                };
                if length(a, n) <= length(m, c) {
                    out.faces.extend([[a, m, n], [a, n, c]]);
                } else {
                    out.faces.extend([[a, m, c], [m, n, c]]);
                }
            }
            _ => {
                let ([a, b, c], e) = turn(0);
                let [d, e, f] = e.map(|m| m.unwrap_or(a));
                out.faces
                    .extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
            }
        }
    }
    Ok(out)
}

/// Flips smooth edges whose flip brings the valences of its four vertices closer to 6 (4 on a border or
/// crease) without thin triangles or turned normals. Returns how many were flipped.
///
/// # Errors
/// A base that is no proper triangulation.
pub fn flip_to_even_valence(base: &mut Base) -> Result<usize, EdgeError> {
    const MIN_COSINE_TURN: f64 = 0.5;
    let mut flipped = 0;
    for _ in 0..8 {
        let table = EdgeTable::new(base.vertices.len(), &base.faces)?;
        let mut valence = vec![0i64; base.vertices.len()];
        let mut sharp = vec![false; base.vertices.len()];
        for edge in &table.edges {
            let is_sharp = edge.is_border() || base.creases.binary_search(&edge.vertices).is_ok();
            for v in edge.vertices {
                valence[v as usize] += 1;
                sharp[v as usize] |= is_sharp;
            }
        }
        let mut touched = vec![false; base.faces.len()];
        let mut any = false;
        for edge in &table.edges {
            let Some([p, q]) = edge.both() else { continue };
            if base.creases.binary_search(&edge.vertices).is_ok()
                || touched[p.face as usize]
                || touched[q.face as usize]
            {
                continue;
            }
            let [a, b] = edge.vertices;
            let c = base.faces[p.face as usize][(usize::from(p.local) + 2) % 3];
            let d = base.faces[q.face as usize][(usize::from(q.local) + 2) % 3];
            if c == d || table.find(c, d).is_some() {
                continue;
            }
            let excess = |v: u32, change: i64| {
                let wanted = if sharp[v as usize] { 4 } else { 6 };
                let off = valence[v as usize] + change - wanted;
                off * off
            };
            let before: i64 = [a, b, c, d].iter().map(|v| excess(*v, 0)).sum();
            let after = excess(a, -1) + excess(b, -1) + excess(c, 1) + excess(d, 1);
            if after >= before || [a, b].iter().any(|v| valence[*v as usize] <= 4) {
                continue;
            }
            let at = |v: u32| base.vertices[v as usize];
            let area = |x: u32, y: u32, z: u32| (at(y) - at(x)).cross(&(at(z) - at(x)));
            let old = [area(a, b, c), area(b, a, d)];
            let new = [area(a, d, c), area(d, b, c)];
            let turns = new.iter().all(|n| {
                old.iter()
                    .all(|o| n.dot(o) > MIN_COSINE_TURN * n.norm() * o.norm())
            });
            let quality = |n: &Vec3, x: u32, y: u32, z: u32| {
                let sides = (at(x) - at(y)).norm_squared()
                    + (at(y) - at(z)).norm_squared()
                    + (at(z) - at(x)).norm_squared();
                n.norm() / sides.max(1e-300)
            };
            let worst_old = quality(&old[0], a, b, c).min(quality(&old[1], b, a, d));
            let worst_new = quality(&new[0], a, d, c).min(quality(&new[1], d, b, c));
            // An equilateral triangle has quality 0.289; below 0.12 its smallest angle is under 20 degrees.
            if !turns || worst_new < (0.8 * worst_old).min(0.12) {
                continue;
            }
            base.faces[p.face as usize] = [a, d, c];
            base.faces[q.face as usize] = [d, b, c];
            for (v, change) in [(a, -1), (b, -1), (c, 1), (d, 1)] {
                valence[v as usize] += change;
            }
            touched[p.face as usize] = true;
            touched[q.face as usize] = true;
            // A neighbour's flip could make the same edge twice: look again in the next pass.
            for face in [p.face, q.face] {
                for local in table.of_face[face as usize] {
                    for side in table.edges[local as usize].sides.iter().flatten() {
                        touched[side.face as usize] = true;
                    }
                }
            }
            flipped += 1;
            any = true;
        }
        if !any {
            break;
        }
    }
    Ok(flipped)
}

/// Moves the vertices around the faces in `near` towards the mean of their neighbours and back onto the
/// surface (`project`), so that split triangles become well-shaped. Vertices on creases and borders stay, and a
/// step that would thin a triangle or turn it is not taken.
///
/// # Errors
/// A base that is no proper triangulation.
pub fn relax(
    base: &mut Base,
    near: &[bool],
    rounds: usize,
    project: &dyn Fn(&Vec3) -> Option<Vec3>,
) -> Result<(), EdgeError> {
    let table = EdgeTable::new(base.vertices.len(), &base.faces)?;
    let mut fixed = vec![true; base.vertices.len()];
    let mut faces_at: Vec<Vec<u32>> = vec![Vec::new(); base.vertices.len()];
    for (number, face) in base.faces.iter().enumerate() {
        for v in face {
            faces_at[*v as usize].push(number as u32);
            fixed[*v as usize] &= !near.get(number).copied().unwrap_or(false);
        }
    }
    for edge in &table.edges {
        if edge.is_border() || base.creases.binary_search(&edge.vertices).is_ok() {
            for v in edge.vertices {
                fixed[v as usize] = true;
            }
        }
    }
    for _ in 0..rounds {
        for v in 0..base.vertices.len() {
            if fixed[v] || faces_at[v].is_empty() {
                continue;
            }
            let at = base.vertices[v];
            let (mut sum, mut weight, mut normal) = (Vec3::zeros(), 0.0, Vec3::zeros());
            for face in &faces_at[v] {
                let [a, b, c] = base.faces[*face as usize].map(|v| base.vertices[v as usize]);
                let area = (b - a).cross(&(c - a));
                sum += (a + b + c) / 3.0 * area.norm();
                weight += area.norm();
                normal += area;
            }
            let Some(normal) = normal.try_normalize(1e-300) else {
                continue;
            };
            let pull = (sum / weight - at) * 0.7;
            let Some(to) = project(&(at + pull - normal * normal.dot(&pull))) else {
                continue;
            };
            let before = star_quality(base, &faces_at[v], &normal);
            base.vertices[v] = to;
            if star_quality(base, &faces_at[v], &normal) < before.min(0.1) {
                base.vertices[v] = at;
            }
        }
    }
    Ok(())
}

/// Worst quality (area over squared sides; equilateral 0.289) of some faces, negative if one turns away from
/// `normal`.
fn star_quality(base: &Base, faces: &[u32], normal: &Vec3) -> f64 {
    faces
        .iter()
        .map(|face| {
            let [a, b, c] = base.faces[*face as usize].map(|v| base.vertices[v as usize]);
            let area = (b - a).cross(&(c - a));
            let sides = (b - a).norm_squared() + (c - b).norm_squared() + (a - c).norm_squared();
            let quality = area.norm() / sides.max(1e-300);
            if area.dot(normal) > 0.0 {
                quality
            } else {
                -quality
            }
        })
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::Topology;

    fn grid(n: u32) -> Base {
        let mut base = Base::default();
        for y in 0..=n {
            for x in 0..=n {
                base.vertices
                    .push(Vec3::new(f64::from(x), f64::from(y), 0.0));
            }
        }
        for y in 0..n {
            for x in 0..n {
                let a = y * (n + 1) + x;
                base.faces.push([a, a + 1, a + n + 2]);
                base.faces.push([a, a + n + 2, a + n + 1]);
            }
        }
        base
    }

    fn area(base: &Base) -> f64 {
        base.faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|v| base.vertices[v as usize]);
                0.5 * (b - a).cross(&(c - a)).z
            })
            .sum()
    }

    #[test]
    fn every_pattern_of_split_faces_keeps_topology_and_area() {
        let base = grid(2);
        for pattern in 0u32..256 {
            let split: Vec<bool> = (0..8).map(|f| pattern >> f & 1 == 1).collect();
            let middle = |face: usize, local: usize| {
                let f = base.faces[face];
                (base.vertices[f[local] as usize] + base.vertices[f[(local + 1) % 3] as usize])
                    / 2.0
            };
            let mut out = split_faces(&base, &split, middle).unwrap();
            for _ in 0..2 {
                let table = EdgeTable::new(out.vertices.len(), &out.faces).unwrap();
                let topology = Topology::new(out.vertices.len(), &out.faces, &table);
                assert_eq!(
                    (topology.euler, topology.borders),
                    (1, 1),
                    "pattern {pattern}"
                );
                assert!((area(&out) - 4.0).abs() < 1e-12);
                flip_to_even_valence(&mut out).unwrap();
            }
        }
    }

    #[test]
    fn creases_are_split_with_their_faces() {
        let mut base = grid(1);
        base.creases = vec![[0, 3]];
        let out = split_faces(&base, &[true, false], |_, _| Vec3::new(0.5, 0.5, 0.0)).unwrap();
        assert_eq!(out.faces.len(), 6);
        assert_eq!(out.creases.len(), 2);
    }
}
