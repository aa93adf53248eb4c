//! Writes a cloud as a PLY point file: what `palpus points` yields and `palpus reconstruct` takes.

use super::Cloud;
use std::io::{self, Write};

/// Writes the points as binary little-endian PLY: `double x y z nx ny nz`, and `double sigma`,
/// `ushort finger`, `double time_us` if any point has one.
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
    writeln!(out, "end_header")?;
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
