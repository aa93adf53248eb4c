//! Triangles as binary little-endian PLY, for MeshLab, CloudCompare and every mesh library.
//!
//! Element `vertex`: `double x y z`, `float nx ny nz`, and `float sigma` (standard deviation of the position)
//! where the surface knows it, followed by the same as `quality` and `scalar_sigma`, the names that MeshLab and
//! CloudCompare take for a number to colour by. Where it was asked for its curvature, also `float mean_curvature gauss_curvature` and, as
//! `uchar red green blue`, the mean curvature as a colour (orange bends outwards, blue inwards). Element `face`: `list uchar int vertex_indices`.
//!
//! A vertex of PLY has one normal. Two ways were weighed for the points of a crease, which have one per side:
//! to write them once per side (exact normals, but the mesh falls apart along creases for every program that
//! does not weld) or once with the mean of the sides' normals. The second was taken: the mesh keeps its
//! topology. Exact normals on both sides are in OBJ and GLB.

use super::colour::{curvature_shares, srgb};
use super::weld::Welded;
use crate::Vec3;
use crate::spline::SampledSurface;

/// What sigma is called: by us, by MeshLab, by CloudCompare.
const SIGMA_NAMES: [&str; 3] = ["sigma", "quality", "scalar_sigma"];

/// The file's content.
pub fn encode(sampled: &SampledSurface) -> Vec<u8> {
    let welded = Welded::exact(sampled);
    let triangles: Vec<[u32; 3]> = welded.triangles(sampled).collect();
    let mut normals = vec![Vec3::zeros(); welded.positions.len()];
    for (slot, normal) in welded.of_point.iter().zip(&sampled.normals) {
        normals[*slot as usize] += normal;
    }
    let has_sigma = !sampled.sigma.is_empty() && sampled.sigma.len() == sampled.positions.len();
    let mut header = String::from(
        "ply\nformat binary_little_endian 1.0\ncomment surface sampled by palpus, normals of the surface itself\n",
    );
    header += &format!("element vertex {}\n", welded.positions.len());
    for name in ["x", "y", "z"] {
        header += &format!("property double {name}\n");
    }
    for name in ["nx", "ny", "nz"] {
        header += &format!("property float {name}\n");
    }
    if has_sigma {
        for name in SIGMA_NAMES {
            header += &format!("property float {name}\n");
        }
    }
    let shares = curvature_shares(sampled);
    if !shares.is_empty() {
        header += "property float mean_curvature\nproperty float gauss_curvature\n";
        header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    header += &format!(
        "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        triangles.len()
    );
    let mut out = header.into_bytes();
    out.reserve(welded.positions.len() * 40 + triangles.len() * 13);
    for ((position, normal), first) in welded.positions.iter().zip(&normals).zip(&welded.first) {
        for value in position {
            out.extend((value + 0.0).to_le_bytes());
        }
        // Sides that face exactly away from each other have no mean: the first side's normal then.
        let unit = normal
            .try_normalize(1e-9)
            .or_else(|| sampled.normals.get(*first as usize).copied())
            .unwrap_or_else(Vec3::z);
        for value in &unit {
            out.extend((*value as f32).to_le_bytes());
        }
        if has_sigma {
            for _ in SIGMA_NAMES {
                out.extend((sampled.sigma[*first as usize] as f32).to_le_bytes());
            }
        }
        if let Some(share) = shares.get(*first as usize) {
            for value in sampled.curvature[*first as usize] {
                out.extend((value as f32).to_le_bytes());
            }
            out.extend(srgb(*share));
        }
    }
    for triangle in triangles {
        out.push(3);
        for corner in triangle {
            out.extend(corner.to_le_bytes());
        }
    }
    out
}
