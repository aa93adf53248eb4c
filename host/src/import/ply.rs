//! Meshes from PLY: element `vertex` with `x y z`, element `face` with a list `vertex_indices` (or
//! `vertex_index`). A file without faces is a point file and no mesh.

use super::{ImportError, fan, vertex};
use crate::mesh::TriangleMesh;
use crate::ply::{Header, Place, Record};

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    let wrap = |error| ImportError::Ply {
        file: file.to_owned(),
        error,
    };
    let missing = |found| ImportError::Format {
        file: file.to_owned(),
        found,
    };
    let header = Header::parse(bytes).map_err(wrap)?;
    let mut body = header.body(bytes);
    let mut record = Record::default();
    let mut mesh = TriangleMesh::default();
    let mut polygons: Vec<(Place, Vec<u32>)> = Vec::new();
    for element in &header.elements {
        match &*element.name {
            "vertex" => {
                let (Some(x), Some(y), Some(z)) = (
                    element.scalar("x"),
                    element.scalar("y"),
                    element.scalar("z"),
                ) else {
                    return Err(missing("has vertices without x, y and z"));
                };
                for number in 1..=element.count {
                    let place = body.read(element, number, &mut record).map_err(wrap)?;
                    let coordinates = [x, y, z].map(|column| record.values[column]);
                    mesh.positions
                        .push(vertex(file, || place.to_string(), coordinates)?);
                }
            }
            "face" => {
                let list = element
                    .list("vertex_indices")
                    .or_else(|| element.list("vertex_index"));
                let Some(list) = list else {
                    return Err(missing("has faces without a list `vertex_indices`"));
                };
                for number in 1..=element.count {
                    let place = body.read(element, number, &mut record).map_err(wrap)?;
                    let mut corners = Vec::with_capacity(record.list(list).len());
                    for value in record.list(list) {
                        if !(*value >= 0.0 && value.fract() == 0.0 && *value < f64::from(u32::MAX))
                        {
                            return Err(index(file, &place, *value));
                        }
                        corners.push(*value as u32);
                    }
                    // Checked against the vertices later: they may come after the faces.
                    polygons.push((place, corners));
                }
            }
            _ => body.skip(element).map_err(wrap)?,
        }
    }
    for (place, corners) in &polygons {
        if let Some(corner) = corners
            .iter()
            .find(|c| **c as usize >= mesh.positions.len())
        {
            return Err(index(file, place, f64::from(*corner)));
        }
        fan(corners, &mut mesh.faces);
    }
    Ok(mesh)
}

fn index(file: &str, place: &Place, value: f64) -> ImportError {
    ImportError::Value {
        file: file.to_owned(),
        place: place.to_string(),
        value: value.to_string(),
        problem: "is the number of no vertex".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_and_false_indices() {
        let text = |faces: &str| {
            format!(
                "ply\nformat ascii 1.0\nelement vertex 4\nproperty float y\nproperty float x\nproperty float z\n\
                 property uchar red\nelement face 1\nproperty uchar flags\nproperty list uchar int vertex_index\n\
                 element edge 1\nproperty int a\nend_header\n0 1 2 9\n1 1 2 9\n1 0 2 9\n0 0 2 9\n{faces}\n5\n"
            )
        };
        let mesh = parse("a.ply", text("7 4 0 1 2 3").as_bytes()).unwrap();
        assert_eq!(mesh.faces, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[0].x, 1.0);
        let error = parse("a.ply", text("7 3 0 1 4").as_bytes())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("a.ply: line 18: `4` is the number of no vertex"),
            "{error}"
        );
        let error = parse("a.ply", text("7 3 0 1 -4").as_bytes())
            .unwrap_err()
            .to_string();
        assert!(error.contains("`-4`"), "{error}");
    }

    #[test]
    fn a_coordinate_that_is_not_finite_is_refused() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 nan 0\n";
        let error = parse("a.ply", text.as_bytes()).unwrap_err().to_string();
        assert!(
            error.contains("line 8: `NaN` is no finite coordinate"),
            "{error}"
        );
    }
}
