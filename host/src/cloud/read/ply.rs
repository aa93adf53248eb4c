//! Points from a PLY file.

use super::sieve::{Row, Sieve};
use super::{ReadError, columns::Columns};
use crate::cloud::Cloud;
use crate::ply::{Header, Kind, Place, PlyError, Record};

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Cloud, ReadError> {
    let wrap = |error: PlyError| ReadError::Ply {
        file: file.to_owned(),
        error,
    };
    let header = Header::parse(bytes).map_err(wrap)?;
    let Some(at) = header.elements.iter().position(|e| *e.name == *"vertex") else {
        return Err(ReadError::NoPoints {
            file: file.to_owned(),
        });
    };
    let element = &header.elements[at];
    let names: Vec<&str> = element
        .properties
        .iter()
        .map(|p| {
            if matches!(p.kind, Kind::Scalar(_)) {
                p.name.as_str()
            } else {
                ""
            }
        })
        .collect();
    let columns = Columns::find(file, &names)?;
    let mut body = header.body(bytes);
    for earlier in &header.elements[..at] {
        body.skip(earlier).map_err(wrap)?;
    }
    let mut sieve = Sieve::new(file);
    let mut record = Record::default();
    for number in 1..=element.count {
        let place = body.read(element, number, &mut record).map_err(wrap)?;
        let line = match place {
            Place::Line(line) => line,
            Place::Record(_, number) => number as usize,
        };
        let row: Row = columns.row(&record.values);
        sieve.put(line, &row);
    }
    sieve.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;

    #[test]
    fn other_properties_and_elements_are_passed_over() {
        let mut bytes = b"ply\nformat binary_big_endian 1.0\nelement camera 1\nproperty double f\n\
            element vertex 2\nproperty list uchar ushort tags\nproperty double z\nproperty float y\n\
            property float x\nproperty uchar red\nproperty float nz\nproperty float ny\nproperty float nx\n\
            property float sigma\nproperty ushort finger\nproperty double time_us\nelement face 7\n\
            property list uchar int vertex_indices\nend_header\n"
            .to_vec();
        bytes.extend(1.0f64.to_be_bytes());
        for k in 0..2u8 {
            bytes.extend([k, 0, 9, 0, 9][..1 + 2 * k as usize].iter());
            bytes.extend(3.0f64.to_be_bytes());
            bytes.extend(2.0f32.to_be_bytes());
            bytes.extend(1.0f32.to_be_bytes());
            bytes.push(255);
            for normal in [0.0f32, 0.0, 5.0, 0.25] {
                bytes.extend(normal.to_be_bytes());
            }
            bytes.extend(u16::from(k).to_be_bytes());
            bytes.extend(1.7e15f64.to_be_bytes());
        }
        let cloud = parse("a.ply", &bytes).unwrap();
        assert_eq!(cloud.points.len(), 2);
        let point = cloud.points[1];
        assert_eq!(
            (point.position, point.normal),
            (Vec3::new(1.0, 2.0, 3.0), Vec3::x())
        );
        assert_eq!((point.sigma, point.finger), (Some(0.25), Some(1)));
        assert_eq!(point.time_us, Some(1_700_000_000_000_000));
        bytes.truncate(bytes.len() - 1);
        let error = parse("a.ply", &bytes).unwrap_err().to_string();
        assert!(
            error.contains("a.ply: the file ends in vertex 2 of 2"),
            "{error}"
        );
    }

    #[test]
    fn a_missing_normal_is_named() {
        let text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nend_header\n0 0 0 1\n";
        let error = parse("a.ply", text).unwrap_err().to_string();
        assert!(
            error.contains("no column `ny` (columns: x y z nx)"),
            "{error}"
        );
    }
}
