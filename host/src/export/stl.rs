//! Triangles as binary STL, for printers and slicers.
//!
//! Coordinates are `f32`. A point that several triangles share has the same `f32` in all of them, and
//! triangles that rounding has shrunk to an edge are left out, so a closed surface is watertight for every
//! reader that joins equal vertices. The unit is that of the surface; STL itself has none.

use super::ExportError;
use super::weld::Welded;
use crate::Vec3;
use crate::spline::SampledSurface;

/// The file's content: an 80-byte comment, the number of triangles, 50 bytes per triangle.
///
/// # Errors
/// More than `u32::MAX` triangles.
pub fn encode(sampled: &SampledSurface) -> Result<Vec<u8>, ExportError> {
    let welded = Welded::single(sampled);
    let triangles: Vec<[u32; 3]> = welded.triangles(sampled).collect();
    let count = u32::try_from(triangles.len()).map_err(|_| ExportError::TooLarge {
        file: "mesh".into(),
        what: format!("{} triangles", triangles.len()),
        format: "STL",
    })?;
    let mut out = Vec::with_capacity(84 + triangles.len() * 50);
    // Must not begin with "solid", by which readers recognise the text form.
    out.extend(b"binary STL, surface sampled by palpus");
    out.resize(80, b' ');
    out.extend(count.to_le_bytes());
    for triangle in triangles {
        let corners = triangle.map(|v| welded.positions[v as usize].map(|c| c as f32 + 0.0));
        let [a, b, c] = corners.map(|p| p.map(f64::from));
        let normal = (b - a)
            .cross(&(c - a))
            .try_normalize(0.0)
            .unwrap_or_else(Vec3::zeros);
        for value in normal
            .map(|c| c as f32 + 0.0)
            .iter()
            .chain(corners.iter().flatten())
        {
            out.extend(value.to_le_bytes());
        }
        out.extend([0, 0]);
    }
    Ok(out)
}
