//! Meshes from STL, binary and text. Vertices of equal coordinates are joined; facet normals are passed over
//! (the order of the corners says the same).

use super::{ImportError, joined, vertex, vertex_in_line, wrong_in_line};
use crate::mesh::TriangleMesh;
use crate::ply::Lines;

/// Whether the length fits the number of triangles after the 80-byte comment.
pub(super) fn detect_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|count| bytes.len() as u64 == 84 + 50 * count)
}

fn declared(bytes: &[u8]) -> Option<u64> {
    let count = bytes.get(80..84)?.try_into().ok()?;
    Some(u64::from(u32::from_le_bytes(count)))
}

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    // Some binary files begin with "solid" too, so the length decides first.
    let text = !detect_binary(bytes) && bytes.trim_ascii_start().starts_with(b"solid");
    let apart = if text {
        parse_text(file, bytes)?
    } else {
        parse_binary(file, bytes)?
    };
    Ok(joined(&apart))
}

fn parse_binary(file: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    let mut mesh = TriangleMesh::default();
    let Some(count) = declared(bytes) else {
        return Ok(mesh);
    };
    let triangles = bytes.get(84..).unwrap_or_default().chunks_exact(50);
    let held = triangles.len();
    if (held as u64) < count {
        return Err(ImportError::Truncated {
            file: file.to_owned(),
            held,
            declared: count,
        });
    }
    for (number, triangle) in triangles.take(count as usize).enumerate() {
        for corner in triangle[12..48].chunks_exact(12) {
            let mut coordinates = [0.0; 3];
            for (coordinate, bytes) in coordinates.iter_mut().zip(corner.chunks_exact(4)) {
                let bytes = bytes.try_into().unwrap_or_default();
                *coordinate = f64::from(f32::from_le_bytes(bytes));
            }
            let place = || format!("triangle {}", number + 1);
            mesh.positions.push(vertex(file, place, coordinates)?);
        }
        let first = 3 * number as u32;
        mesh.faces.push([first, first + 1, first + 2]);
    }
    Ok(mesh)
}

fn parse_text(file: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    let mut lines = Lines {
        bytes,
        offset: 0,
        line: 0,
    };
    let mut mesh = TriangleMesh::default();
    let mut in_loop = 0;
    while let Some(raw) = lines.next_line() {
        let line = lines.line;
        let wrong = |value: &[u8], problem: &str| wrong_in_line(file, line, value, problem);
        let mut words = raw
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        match words.next() {
            Some(b"vertex") => {
                mesh.positions
                    .push(vertex_in_line(file, line, raw, &mut words)?);
                in_loop += 1;
            }
            Some(b"endloop") => {
                if in_loop != 3 {
                    return Err(wrong(
                        raw,
                        &format!("ends a loop of {in_loop} vertices, not 3"),
                    ));
                }
                let first = mesh.positions.len() as u32 - 3;
                mesh.faces.push([first, first + 1, first + 2]);
                in_loop = 0;
            }
            Some(b"solid" | b"facet" | b"outer" | b"endfacet" | b"endsolid") | None => {}
            Some(_) => return Err(wrong(raw, "is no line of an STL text")),
        }
    }
    if in_loop != 0 {
        let (held, file) = (mesh.faces.len(), file.to_owned());
        return Err(ImportError::Truncated {
            file,
            held,
            declared: held as u64 + 1,
        });
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "solid a\nfacet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1 0 0\n  vertex 0 1e0 0\n endloop\nendfacet\n\
        facet normal 0 0 1\n outer loop\n  vertex 1 0 0\n  vertex 1 1 0\n  vertex 0 1 -0\n endloop\nendfacet\nendsolid a\n";

    #[test]
    fn text_is_joined() {
        let mesh = parse("a.stl", TEXT.as_bytes()).unwrap();
        assert_eq!((mesh.positions.len(), mesh.faces.len()), (4, 2));
        let cut = parse(
            "a.stl",
            &TEXT.as_bytes()[..TEXT.find("  vertex 0 1 -0").unwrap()],
        )
        .unwrap_err()
        .to_string();
        assert!(cut.contains("holds 1 triangles of 2"), "{cut}");
        let error = parse("a.stl", TEXT.replace("1e0", "one").as_bytes())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("a.stl: line 6: `one` is no number"),
            "{error}"
        );
        let error = parse("a.stl", TEXT.replace("  vertex 1 1 0\n", "").as_bytes()).unwrap_err();
        assert!(
            error.to_string().contains("ends a loop of 2 vertices"),
            "{error}"
        );
    }

    #[test]
    fn binary_is_known_by_its_length() {
        let mut bytes = b"solid, although binary".to_vec();
        bytes.resize(80, b' ');
        bytes.extend(1u32.to_le_bytes());
        for value in [
            0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0,
        ] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0, 0]);
        assert_eq!(parse("a.stl", &bytes).unwrap().faces, [[0, 1, 2]]);
        bytes[0] = b'S';
        bytes.truncate(130);
        let error = parse("a.stl", &bytes).unwrap_err().to_string();
        assert!(error.contains("holds 0 triangles of 1 declared"), "{error}");
    }
}
