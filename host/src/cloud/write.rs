//! Writes a cloud as a PLY point file: what `palpus points` yields and `palpus reconstruct` takes.
//!
//! PLY has no names for sigma and time that all programs know: CloudCompare takes what is called `scalar_…`, and as
//! `f32`, in which microseconds since the Unix epoch are two minutes apart; MeshLab takes `quality`. Two ways were weighed:
//! to call our own columns so (nothing twice, but names that say little, and no exact time), or to add columns for
//! those programs. The second was taken; the reader does not heed them.

use super::Cloud;
use std::io::{self, Write};

/// Writes the points as binary little-endian PLY: `double x y z nx ny nz`, and `double sigma`,
/// `ushort finger`, `double time_us` if any point has one. For viewers then follow, as `float`, `quality` and
/// `scalar_sigma` (both sigma), `scalar_finger` and `scalar_time` (seconds since the first point).
///
/// `double` holds microseconds since the Unix epoch exactly (PLY has no 64-bit integer). A point without
/// `sigma` or `time_us` gets NaN there, one without `finger` 65535. Reading the file back yields the same
/// points bit for bit, normals to the last bit of their length; `finger` 65535 is read as finger 65535.
///
/// # Errors
/// Those of `out`.
pub fn write_ply(cloud: &Cloud, out: &mut impl Write) -> io::Result<()> {
    let any_sigma = cloud.points.iter().any(|p| p.sigma.is_some());
    let any_finger = cloud.points.iter().any(|p| p.finger.is_some());
    let any_time = cloud.points.iter().any(|p| p.time_us.is_some());
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    writeln!(
        out,
        "comment contact points with outward normals, written by palpus"
    )?;
    writeln!(out, "element vertex {}", cloud.points.len())?;
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(out, "property double {name}")?;
    }
    if any_sigma {
        writeln!(out, "property double sigma")?;
    }
    if any_finger {
        writeln!(out, "property ushort finger")?;
    }
    if any_time {
        writeln!(out, "property double time_us")?;
    }
    let for_viewers = [
        ("quality", any_sigma),
        ("scalar_sigma", any_sigma),
        ("scalar_finger", any_finger),
        ("scalar_time", any_time),
    ];
    for (name, _) in for_viewers.iter().filter(|(_, any)| *any) {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")?;
    let first_us = cloud.points.iter().filter_map(|p| p.time_us).min();
    for point in &cloud.points {
        for value in point.position.iter().chain(point.normal.iter()) {
            out.write_all(&value.to_le_bytes())?;
        }
        if any_sigma {
            out.write_all(&point.sigma.unwrap_or(f64::NAN).to_le_bytes())?;
        }
        if any_finger {
            out.write_all(&point.finger.unwrap_or(u16::MAX).to_le_bytes())?;
        }
        if any_time {
            let time = point.time_us.map_or(f64::NAN, |time| time as f64);
            out.write_all(&time.to_le_bytes())?;
        }
        let sigma = point.sigma.map_or(f32::NAN, |sigma| sigma as f32);
        let finger = point.finger.map_or(f32::NAN, f32::from);
        let since = point.time_us.zip(first_us);
        let time = since.map_or(f32::NAN, |(t, first)| {
            (1e-6 * (t as f64 - first as f64)) as f32
        });
        for (value, (_, any)) in [sigma, sigma, finger, time].iter().zip(for_viewers) {
            if any {
                out.write_all(&value.to_le_bytes())?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;
    use crate::cloud::{OrientedPoint, from_bytes};

    #[test]
    fn a_written_cloud_is_read_back() {
        let point = |k: i32| OrientedPoint {
            position: Vec3::new(0.1 * f64::from(k), -1.0 / 3.0, 1e-9),
            normal: Vec3::new(0.0, 0.6, 0.8),
            sigma: (k > 0).then_some(0.05),
            finger: Some(k as u16),
            time_us: (k != 2).then_some(1_763_775_000_123_456 + i64::from(k)),
        };
        let cloud = Cloud {
            points: (0..4).map(point).collect(),
            rejected: vec![],
        };
        let mut bytes = Vec::new();
        write_ply(&cloud, &mut bytes).unwrap();
        let read = from_bytes("a.ply", &bytes).unwrap();
        // The last number of the last point: three microseconds after the first.
        let last = bytes[bytes.len() - 4..].try_into().unwrap();
        assert!((f32::from_le_bytes(last) - 3e-6).abs() < 1e-12);
        let header = String::from_utf8_lossy(&bytes[..600]).into_owned();
        for name in ["quality", "scalar_sigma", "scalar_finger", "scalar_time"] {
            assert!(header.contains(&format!("property float {name}\n")));
        }
        for (a, b) in cloud.points.iter().zip(&read.points) {
            assert!((a.normal - b.normal).norm() < 1e-15);
            assert_eq!(
                OrientedPoint {
                    normal: a.normal,
                    ..*b
                },
                *a
            );
        }
        let mut bare = cloud;
        for point in &mut bare.points {
            (point.sigma, point.finger, point.time_us) = (None, None, None);
        }
        bytes.clear();
        write_ply(&bare, &mut bytes).unwrap();
        assert_eq!(from_bytes("a.ply", &bytes).unwrap().points[1].finger, None);
    }
}
