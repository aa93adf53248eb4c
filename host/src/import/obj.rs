//! Meshes from Wavefront OBJ: `v` and `f`; everything else is passed over. Indices may be negative
//! (counted back from the vertex read last) and carry texture and normal indices (`1/2/3`, `1//3`).

use super::{ImportError, fan, vertex_in_line, wrong_in_line};
use crate::mesh::TriangleMesh;
use crate::ply::Lines;

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    let mut lines = Lines {
        bytes,
        offset: 0,
        line: 0,
    };
    let mut mesh = TriangleMesh::default();
    let mut faces: Vec<(usize, Vec<u32>)> = Vec::new();
    while let Some(raw) = lines.next_line() {
        let line = lines.line;
        let wrong = |value: &[u8], problem: &str| wrong_in_line(file, line, value, problem);
        let content = raw.split(|b| *b == b'#').next().unwrap_or_default();
        let mut words = content
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        match words.next() {
            Some(b"v") => {
                mesh.positions
                    .push(vertex_in_line(file, line, raw, &mut words)?);
            }
            Some(b"f") => {
                let mut corners = Vec::new();
                for word in words {
                    let index = word.split(|b| *b == b'/').next().unwrap_or_default();
                    let index: Option<i64> = std::str::from_utf8(index)
                        .ok()
                        .and_then(|text| text.parse().ok());
                    let number = match index {
                        Some(k) if k > 0 => k - 1,
                        Some(k) if k < 0 => k + mesh.positions.len() as i64,
                        _ => -1,
                    };
                    corners.push(
                        u32::try_from(number)
                            .map_err(|_| wrong(word, "is the number of no vertex"))?,
                    );
                }
                if corners.len() < 3 {
                    return Err(wrong(raw, "has less than 3 corners"));
                }
                faces.push((line, corners));
            }
            _ => {}
        }
    }
    for (line, corners) in &faces {
        // A face may name a vertex that comes after it.
        if let Some(corner) = corners
            .iter()
            .find(|c| **c as usize >= mesh.positions.len())
        {
            return Err(ImportError::Value {
                file: file.to_owned(),
                place: format!("line {line}"),
                value: (u64::from(*corner) + 1).to_string(),
                problem: "is the number of no vertex".to_owned(),
            });
        }
        fan(corners, &mut mesh.faces);
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_to_write_a_face() {
        let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0 # more\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\nvn 0 0 1\n\
                    f 1 2 3\nf 1/1 2/2 3/3\nf 1//1 2//1 3//1\nf -4 -3 -2 -1\n";
        let mesh = parse("a.obj", text.as_bytes()).unwrap();
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(
            mesh.faces,
            [[0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 2, 3]]
        );
    }

    #[test]
    fn errors_name_line_and_value() {
        let cases = [
            ("v 0 x 0\n", "line 1: `x` is no number"),
            ("v 0 0\n", "line 1: `v 0 0` has less"),
            ("v 0 0 inf\n", "line 1: `inf` is no finite"),
            (
                "v 0 0 0\nf 1 1 2\n",
                "line 2: `2` is the number of no vertex",
            ),
            (
                "v 0 0 0\nf 1 1 0\n",
                "line 2: `0` is the number of no vertex",
            ),
            (
                "v 0 0 0\nf 1 -2 1\n",
                "line 2: `-2` is the number of no vertex",
            ),
            ("f 1 2\n", "less than 3 corners"),
        ];
        for (text, part) in cases {
            let error = parse("a.obj", text.as_bytes()).unwrap_err().to_string();
            assert!(
                error.starts_with("a.obj: ") && error.contains(part),
                "{error}"
            );
        }
    }
}
