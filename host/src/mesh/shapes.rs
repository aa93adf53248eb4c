//! Small meshes of known topology, for the tests of this crate.

use super::TriangleMesh;
use crate::Vec3;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// The unit sphere: an icosahedron with every face cut in four `levels` times.
pub(crate) fn icosphere(levels: usize) -> TriangleMesh {
    let t = (1.0 + 5f64.sqrt()) / 2.0;
    let mut positions = Vec::new();
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        positions.push(Vec3::new(a, b, 0.0));
    }
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        positions.push(Vec3::new(0.0, a, b));
    }
    for (a, b) in [(-1.0, t), (1.0, t), (-1.0, -t), (1.0, -t)] {
        positions.push(Vec3::new(b, 0.0, a));
    }
    let mut mesh = TriangleMesh {
        positions,
        faces: vec![
            [0, 11, 5],
            [0, 5, 1],
            [0, 1, 7],
            [0, 7, 10],
            [0, 10, 11],
            [1, 5, 9],
            [5, 11, 4],
            [11, 10, 2],
            [10, 7, 6],
            [7, 1, 8],
            [3, 9, 4],
            [3, 4, 2],
            [3, 2, 6],
            [3, 6, 8],
            [3, 8, 9],
            [4, 9, 5],
            [2, 4, 11],
            [6, 2, 10],
            [8, 6, 7],
            [9, 8, 1],
        ],
    };
    for _ in 0..levels {
        mesh = quarter(&mesh);
    }
    for p in &mut mesh.positions {
        *p = p.normalize();
    }
    mesh
}

/// Every face cut in four at the middles of its edges.
pub(crate) fn quarter(mesh: &TriangleMesh) -> TriangleMesh {
    let mut out = TriangleMesh {
        positions: mesh.positions.clone(),
        faces: Vec::new(),
    };
    let mut middles = BTreeMap::new();
    for &[a, b, c] in &mesh.faces {
        let mut middle = |u: u32, v: u32| {
            *middles.entry((u.min(v), u.max(v))).or_insert_with(|| {
                let p = (mesh.positions[u as usize] + mesh.positions[v as usize]) * 0.5;
                out.positions.push(p);
                out.positions.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        out.faces
            .extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    out
}

/// A torus around z: `large` to the tube's centre line, tube radius `small`, `m` by `n` quads cut in two.
pub(crate) fn torus(large: f64, small: f64, m: u32, n: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for i in 0..m {
        for j in 0..n {
            let (u, v) = (
                TAU * f64::from(i) / f64::from(m),
                TAU * f64::from(j) / f64::from(n),
            );
            let r = large + small * v.cos();
            mesh.positions
                .push(Vec3::new(r * u.cos(), r * u.sin(), small * v.sin()));
            let at = |i: u32, j: u32| (i % m) * n + j % n;
            let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.faces.push([quad[0], quad[1], quad[2]]);
            mesh.faces.push([quad[0], quad[2], quad[3]]);
        }
    }
    mesh
}

/// The unit square in z = 0 as `m` by `n` quads cut in two.
pub(crate) fn grid(m: u32, n: u32) -> TriangleMesh {
    sheet(m, n, false, |s, t| Vec3::new(s, t, 0.0))
}

/// A cylinder's side around z without its lids.
pub(crate) fn open_cylinder(radius: f64, height: f64, m: u32, n: u32) -> TriangleMesh {
    sheet(m, n, true, |s, t| {
        Vec3::new(
            radius * (TAU * s).cos(),
            radius * (TAU * s).sin(),
            height * t,
        )
    })
}

/// A rectangle of parameters (s, t) in the unit square; with `around`, s = 1 is s = 0.
pub(crate) fn sheet(m: u32, n: u32, around: bool, at: impl Fn(f64, f64) -> Vec3) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let columns = if around { m } else { m + 1 };
    for i in 0..columns {
        for j in 0..=n {
            mesh.positions
                .push(at(f64::from(i) / f64::from(m), f64::from(j) / f64::from(n)));
        }
    }
    let id = |i: u32, j: u32| (i % columns) * (n + 1) + j;
    for i in 0..m {
        for j in 0..n {
            mesh.faces.push([id(i, j), id(i + 1, j), id(i + 1, j + 1)]);
            mesh.faces.push([id(i, j), id(i + 1, j + 1), id(i, j + 1)]);
        }
    }
    mesh
}

/// The cube [-1, 1]^3, every side `n` by `n` quads cut in two.
pub(crate) fn cube(n: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut ids = BTreeMap::new();
    let mut corner = |mesh: &mut TriangleMesh, key: [u32; 3]| {
        *ids.entry(key).or_insert_with(|| {
            mesh.positions.push(Vec3::from_fn(|k, _| {
                2.0 * f64::from(key[k]) / f64::from(n) - 1.0
            }));
            mesh.positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, n] {
            for i in 0..n {
                for j in 0..n {
                    let mut at = |di: u32, dj: u32| {
                        let mut key = [0; 3];
                        key[axis] = side;
                        key[(axis + 1) % 3] = i + di;
                        key[(axis + 2) % 3] = j + dj;
                        corner(&mut mesh, key)
                    };
                    let (a, b, c, d) = (at(0, 0), at(1, 0), at(1, 1), at(0, 1));
                    if side == 0 {
                        mesh.faces.extend([[a, c, b], [a, d, c]]);
                    } else {
                        mesh.faces.extend([[a, b, c], [a, c, d]]);
                    }
                }
            }
        }
    }
    mesh
}
