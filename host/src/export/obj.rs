//! Triangles as Wavefront OBJ text: `v`, `vn` and `f v//vn`.
//!
//! Positions stand once, so the mesh is connected across creases; normals stand once per side. Numbers are
//! written with as many digits as it takes to read the same `f64` back.

use super::weld::Welded;
use crate::spline::SampledSurface;
use std::fmt::Write;

/// The file's content.
pub fn encode(sampled: &SampledSurface) -> Vec<u8> {
    let welded = Welded::exact(sampled);
    let mut out = String::with_capacity(sampled.positions.len() * 110);
    out += "# surface sampled by palpus, normals of the surface itself\n";
    // Writing to a string does not fail.
    for p in &welded.positions {
        let _ = writeln!(out, "v {} {} {}", p.x + 0.0, p.y + 0.0, p.z + 0.0);
    }
    for n in &sampled.normals {
        let [x, y, z] = [n.x, n.y, n.z].map(|c| c as f32 + 0.0);
        let _ = writeln!(out, "vn {x} {y} {z}");
    }
    let has_normals = sampled.normals.len() == sampled.positions.len();
    for triangle in &sampled.triangles {
        let corner = |k: usize| {
            let point = triangle[k];
            let slot = welded.of_point.get(point as usize)?;
            Some((slot + 1, point + 1))
        };
        let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else {
            continue;
        };
        if a.0 == b.0 || b.0 == c.0 || c.0 == a.0 {
            continue;
        }
        let _ = if has_normals {
            writeln!(out, "f {}//{} {}//{} {}//{}", a.0, a.1, b.0, b.1, c.0, c.1)
        } else {
            writeln!(out, "f {} {} {}", a.0, b.0, c.0)
        };
    }
    out.into_bytes()
}
