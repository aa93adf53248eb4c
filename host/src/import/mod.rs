//! Reads triangle meshes from files: PLY, OBJ and STL, told apart by content first and extension second.
//!
//! Used to evaluate a surface against a mesh and to simulate touching an object that a file describes.
//! Polygons are cut into fans. STL, and files in which every triangle has three vertices of its own, are
//! joined where coordinates are equal; other files keep the connectivity they state.
//!
//! Promised on any bytes: no panic, memory in proportion to the file, and errors with file, line and value.
//! A coordinate that is not finite is refused: a mesh with a hole where a vertex was is another mesh.

mod obj;
mod ply;
mod stl;

use crate::Vec3;
use crate::mesh::TriangleMesh;
use crate::ply::{PlyError, number_of, shown};
use std::collections::HashMap;
use std::fs;
use std::path::Path;

/// Why a mesh cannot be read, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file cannot be opened or read.
    #[error("{file}: cannot be read ({source}); check the path and the permissions")]
    Open {
        /// File.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is of no known format.
    #[error("{file}: {found}; give a triangle mesh as PLY, OBJ or STL")]
    Format {
        /// File.
        file: String,
        /// What it seems to be.
        found: &'static str,
    },
    /// The PLY container is damaged.
    #[error("{file}: {error}")]
    Ply {
        /// File.
        file: String,
        /// What is wrong, and where.
        error: PlyError,
    },
    /// A value that cannot stand where it stands.
    #[error("{file}: {place}: `{value}` {problem}; correct it or export the file again")]
    Value {
        /// File.
        file: String,
        /// Line or record.
        place: String,
        /// What stands there.
        value: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The file ends too early.
    #[error(
        "{file}: holds {held} triangles of {declared} declared; it was cut off: copy or export it again"
    )]
    Truncated {
        /// File.
        file: String,
        /// Triangles that are there.
        held: usize,
        /// Triangles that the header declares.
        declared: u64,
    },
    /// No face at all, or only such as are an edge or a point.
    #[error(
        "{file}: holds no face with three different corners; check that the right file was given"
    )]
    NoFaces {
        /// File.
        file: String,
    },
}

/// Reads a mesh.
///
/// # Errors
/// See [`ImportError`]; every message names the file and, where one is to blame, the line and the value.
pub fn read_mesh(path: &Path) -> Result<TriangleMesh, ImportError> {
    let file = path.display().to_string();
    match fs::read(path) {
        Ok(bytes) => mesh_from_bytes(&file, &bytes),
        Err(source) => Err(ImportError::Open { file, source }),
    }
}

/// Reads the content of a mesh file. `name` stands in messages; its extension decides where the content
/// alone does not.
///
/// # Errors
/// As [`read_mesh`].
pub fn mesh_from_bytes(name: &str, bytes: &[u8]) -> Result<TriangleMesh, ImportError> {
    let extension = Path::new(name)
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    let format = |found| ImportError::Format {
        file: name.to_owned(),
        found,
    };
    let mesh = if crate::ply::Header::detect(bytes) {
        ply::parse(name, bytes)?
    } else if bytes.starts_with(b"glTF") {
        return Err(format("is a GLB file, which is only written"));
    } else if extension == "stl" || stl::detect_binary(bytes) {
        stl::parse(name, bytes)?
    } else if extension == "obj" {
        obj::parse(name, bytes)?
    } else if extension == "ply" {
        return Err(format("does not begin with `ply` as a PLY file does"));
    } else {
        return Err(format("is no mesh of a known kind"));
    };
    let apart = mesh.positions.len() == 3 * mesh.faces.len();
    let mesh = if apart { joined(&mesh) } else { mesh };
    // Triangles that were only an edge or a point are gone once vertices are joined.
    if mesh.faces.is_empty() {
        return Err(ImportError::NoFaces {
            file: name.to_owned(),
        });
    }
    Ok(mesh)
}

/// Joins vertices of equal coordinates and leaves out triangles that have become an edge or a point.
pub fn joined(mesh: &TriangleMesh) -> TriangleMesh {
    let mut seen: HashMap<[u64; 3], u32> = HashMap::with_capacity(mesh.positions.len());
    let mut out = TriangleMesh::default();
    let mut of_vertex = Vec::with_capacity(mesh.positions.len());
    for position in &mesh.positions {
        let next = out.positions.len() as u32;
        let key = [position.x, position.y, position.z].map(|c| (c + 0.0).to_bits());
        let number = *seen.entry(key).or_insert(next);
        if number == next {
            out.positions.push(*position);
        }
        of_vertex.push(number);
    }
    for face in &mesh.faces {
        let corner = |k: usize| of_vertex.get(face[k] as usize).copied();
        if let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2))
            && a != b
            && b != c
            && c != a
        {
            out.faces.push([a, b, c]);
        }
    }
    out
}

/// Cuts a polygon into a fan of triangles.
fn fan(corners: &[u32], faces: &mut Vec<[u32; 3]>) {
    if let [first, rest @ ..] = corners {
        for pair in rest.windows(2) {
            faces.push([*first, pair[0], pair[1]]);
        }
    }
}

/// What is wrong with a word, or the whole, of a line of text.
fn wrong_in_line(file: &str, line: usize, value: &[u8], problem: &str) -> ImportError {
    ImportError::Value {
        file: file.to_owned(),
        place: format!("line {line}"),
        value: shown(value),
        problem: problem.to_owned(),
    }
}

/// The vertex that the next three `words` of the line `raw` say.
fn vertex_in_line<'a>(
    file: &str,
    line: usize,
    raw: &[u8],
    words: &mut impl Iterator<Item = &'a [u8]>,
) -> Result<Vec3, ImportError> {
    let wrong = |value: &[u8], problem: &str| wrong_in_line(file, line, value, problem);
    let mut coordinates = [0.0; 3];
    for coordinate in &mut coordinates {
        let word = words
            .next()
            .ok_or_else(|| wrong(raw, "has less than 3 coordinates"))?;
        *coordinate = number_of(word).ok_or_else(|| wrong(word, "is no number"))?;
    }
    vertex(file, || format!("line {line}"), coordinates)
}

/// A vertex whose coordinates have to be finite.
fn vertex(
    file: &str,
    place: impl FnOnce() -> String,
    coordinates: [f64; 3],
) -> Result<Vec3, ImportError> {
    // Beyond 1e100, products of three differences of coordinates leave the range of f64.
    match coordinates
        .iter()
        .find(|c| c.is_nan() || c.abs() > crate::cloud::LARGEST)
    {
        None => Ok(Vec3::from(coordinates)),
        Some(value) => Err(ImportError::Value {
            file: file.to_owned(),
            place: place(),
            value: value.to_string(),
            problem: "is no finite coordinate".to_owned(),
        }),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::export::{self, MeshFormat};
    use crate::mesh::{shapes, topology};
    use proptest::prelude::*;

    /// Every content of a file is refused, with its name and the part of the message.
    pub(crate) fn assert_refused<T>(
        cases: &[(&str, &[u8], &str)],
        read: impl Fn(&str, &[u8]) -> Result<T, String>,
    ) {
        for (name, bytes, part) in cases {
            let error = read(name, bytes).err().expect(name);
            assert!(error.contains(name) && error.contains(part), "{error}");
        }
    }

    /// One of the beginnings, then up to so many bytes of any kind.
    pub(crate) fn bytes_after(
        starts: &[&'static [u8]],
        most: usize,
    ) -> impl Strategy<Value = Vec<u8>> {
        let start = prop::sample::select(starts.to_vec());
        (start, prop::collection::vec(any::<u8>(), 0..most))
            .prop_map(|(start, rest)| [start, &rest].concat())
    }

    #[test]
    fn what_is_written_is_read_back() {
        let mesh = shapes::torus(1.0, 0.4, 12, 8);
        let sampled = export::sampled_from_mesh(&mesh);
        for (name, format, exact) in [
            ("a.ply", MeshFormat::Ply, true),
            ("a.obj", MeshFormat::Obj, true),
            ("a.stl", MeshFormat::Stl, false),
        ] {
            let bytes = format.encode(&sampled).unwrap();
            let read = mesh_from_bytes(name, &bytes).unwrap();
            if exact {
                assert_eq!(read, mesh, "{name}");
            }
            assert_eq!(topology(&read), topology(&mesh), "{name}");
            assert!((read.area() - mesh.area()).abs() < 1e-6);
        }
    }

    #[test]
    fn triangles_with_vertices_of_their_own_are_joined() {
        let mesh = shapes::icosphere(1);
        let mut apart = TriangleMesh::default();
        for face in 0..mesh.faces.len() as u32 {
            apart.positions.extend(mesh.corners(face).unwrap());
            apart.faces.push([3 * face, 3 * face + 1, 3 * face + 2]);
        }
        assert_eq!(topology(&joined(&apart)), topology(&mesh));
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        let cases: [(&str, &[u8], &str); 6] = [
            ("a.glb", b"glTF\x02", "only written"),
            ("a.ply", b"solid", "does not begin"),
            ("a.xyz", b"1 2 3", "no mesh"),
            ("a.obj", b"# nothing\nv 0 0 0\n", "holds no face"),
            ("a.stl", b"", "holds no face"),
            // Found by fuzzing: its one face is an edge once vertices are joined.
            (
                "a.obj",
                b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 1\n",
                "holds no face",
            ),
        ];
        assert_refused(&cases, |name, bytes| {
            mesh_from_bytes(name, bytes).map_err(|e| e.to_string())
        });
    }

    proptest! {
        #[test]
        fn no_bytes_panic(
            bytes in bytes_after(&[
                b"",
                b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
                b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n",
                b"ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nelement face 99999999999\nproperty list uchar int vertex_indices\nend_header\n",
            ], 300),
        ) {
            for name in ["a.ply", "a.obj", "a.stl"] {
                if let Ok(mesh) = mesh_from_bytes(name, &bytes) {
                    prop_assert!((0..mesh.faces.len()).all(|f| mesh.corners(f as u32).is_some()));
                }
            }
        }
    }
}
