//! Surfaces to export: patches over a triangle mesh, their control points moved by a map of space. Neighbours
//! share the bits of their common edge; across it they are continuous in position only.

use nalgebra::Vector3;
use palpus_host::Vec3;
use palpus_host::spline::Surface;
use palpus_host::spline::bernstein::EXPONENTS;
use std::collections::BTreeMap;

/// The triangles as patches of degree 5, every control point moved by `warp`.
pub fn warped(corners: &[Vec3], faces: &[[u32; 3]], warp: impl Fn(Vec3) -> Vec3) -> Surface {
    let patch = |face: &[u32; 3]| {
        EXPONENTS.map(|exponents| {
            // Summed by rising vertex number, so both sides of an edge round alike.
            let mut terms: Vec<(u32, u8)> = face.iter().copied().zip(exponents).collect();
            terms.sort_unstable();
            let mut sum = Vec3::zeros();
            for (vertex, exponent) in terms.into_iter().filter(|(_, e)| *e > 0) {
                sum += corners[vertex as usize] * f64::from(exponent);
            }
            warp(sum / 5.0)
        })
    };
    let control_points: Vec<_> = faces.iter().map(patch).collect();
    let mut vertices = corners.to_vec();
    for (face, points) in faces.iter().zip(&control_points) {
        for (corner, number) in [0, 15, 20].into_iter().enumerate() {
            vertices[face[corner] as usize] = points[number];
        }
    }
    Surface {
        vertices,
        faces: faces.to_vec(),
        control_points,
        ..Surface::default()
    }
}

/// An octahedron, each face cut in four `levels` times, blown up to a lumpy sphere.
pub fn lumpy_sphere(levels: usize) -> Surface {
    let mut corners: Vec<Vec3> = [
        Vec3::x(),
        -Vec3::x(),
        Vec3::y(),
        -Vec3::y(),
        Vec3::z(),
        -Vec3::z(),
    ]
    .into();
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for x in [0, 1] {
        for y in [2, 3] {
            for z in [4, 5] {
                let even = (x + y + z) % 2 == 0;
                faces.push(if even { [x, y, z] } else { [y, x, z] });
            }
        }
    }
    for _ in 0..levels {
        let mut middles = BTreeMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in faces {
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[p, q]| {
                *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                    corners.push((corners[p as usize] + corners[q as usize]).normalize());
                    corners.len() as u32 - 1
                })
            });
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces = finer;
    }
    warped(&corners, &faces, |p| {
        p * (1.1 / p.norm().max(0.5))
            + Vector3::new((3.0 * p.y).sin(), (2.0 * p.z).cos(), p.x) * 0.05
    })
}

/// A bent torus of 2 * `around` * `across` patches.
pub fn torus(around: u32, across: u32) -> Surface {
    let turn = |k: u32, n: u32| std::f64::consts::TAU * f64::from(k) / f64::from(n);
    let mut corners = Vec::new();
    let mut faces = Vec::new();
    for i in 0..around {
        for j in 0..across {
            let (u, v) = (turn(i, around), turn(j, across));
            let ring = 60.0 + 25.0 * v.cos();
            corners.push(Vec3::new(ring * u.cos(), ring * u.sin(), 25.0 * v.sin()));
            let at = |di, dj| ((i + di) % around) * across + (j + dj) % across;
            let [a, b, c, d] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    warped(&corners, &faces, |p| {
        p * (1.0 + 0.001 * p.x) + Vec3::z() * (0.002 * p.x * p.y)
    })
}

/// An open, bent sheet of 2 * `n`^2 patches.
pub fn sheet(n: u32) -> Surface {
    let mut corners = Vec::new();
    let mut faces = Vec::new();
    for i in 0..=n {
        for j in 0..=n {
            corners.push(Vec3::new(f64::from(i), f64::from(j), 0.0) / f64::from(n));
            if i < n && j < n {
                let at = |di, dj| (i + di) * (n + 1) + j + dj;
                faces.extend([
                    [at(0, 0), at(1, 0), at(1, 1)],
                    [at(0, 0), at(1, 1), at(0, 1)],
                ]);
            }
        }
    }
    warped(&corners, &faces, |p| {
        p + Vec3::z() * ((2.0 * p.x).sin() * 0.2 - 0.3 * p.x * p.y)
    })
}

/// A cube of the given edge with its 12 creases.
pub fn cube(edge: f64) -> Surface {
    let corners: Vec<Vec3> = (0..8u32)
        .map(|k| [k & 1, k >> 1 & 1, k >> 2])
        .map(|c| Vec3::from(c.map(f64::from)) * edge)
        .collect();
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let faces: Vec<[u32; 3]> = quads
        .iter()
        .flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]])
        .collect();
    let mut surface = warped(&corners, &faces, |p| p);
    for a in 0..8u32 {
        for bit in [1, 2, 4] {
            if a & bit == 0 {
                surface.creases.push([a, a | bit]);
            }
        }
    }
    surface.creases.sort_unstable();
    surface
}

/// Makes a patch fold outside of its triangle on all three sides, by spreading its inner control points.
pub fn spread(surface: &mut Surface, patch: usize) {
    let points = &mut surface.control_points[patch];
    let inner = [4, 7, 8, 11, 12, 13];
    let mut middle = Vec3::zeros();
    for k in inner {
        middle += points[k] / 6.0;
    }
    for k in inner {
        points[k] = middle + (points[k] - middle) * 1.5;
    }
}

/// Both surfaces in one, side by side.
pub fn beside(first: &Surface, second: &Surface, offset: Vec3) -> Surface {
    let mut both = first.clone();
    let shift = first.vertices.len() as u32;
    both.vertices
        .extend(second.vertices.iter().map(|v| v + offset));
    both.faces
        .extend(second.faces.iter().map(|face| face.map(|v| v + shift)));
    both.control_points.extend(
        second
            .control_points
            .iter()
            .map(|points| points.map(|p| p + offset)),
    );
    both.creases.extend(
        second
            .creases
            .iter()
            .map(|crease| crease.map(|v| v + shift)),
    );
    both
}
