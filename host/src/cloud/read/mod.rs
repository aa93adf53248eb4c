//! Reads point files: PLY, PCD and text (XYZ, CSV), told apart by content first and extension second.
//!
//! What a file has to hold and what is promised stands in the module above, [`crate::cloud`].

mod columns;
mod lzf;
mod pcd;
mod ply;
mod sieve;
mod text;

use super::Cloud;
use crate::ply::PlyError;
use std::fs;
use std::path::Path;

pub use sieve::LARGEST;

/// Why points cannot be read, and what to do next.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened or read.
    #[error("{file}: cannot be read ({source}); check the path and the permissions")]
    Open {
        /// File.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is of no known format.
    #[error("{file}: {found}; give points with normals as PLY, PCD, XYZ or CSV")]
    Format {
        /// File.
        file: String,
        /// What it seems to be.
        found: String,
    },
    /// The PLY container is damaged.
    #[error("{file}: {error}")]
    Ply {
        /// File.
        file: String,
        /// What is wrong, and where.
        error: PlyError,
    },
    /// A needed column is not there.
    #[error(
        "{file}: has no column `{missing}` (columns: {columns}); points need position and normal: estimate and orient normals first"
    )]
    Missing {
        /// File.
        file: String,
        /// Column.
        missing: String,
        /// Columns that are there.
        columns: String,
    },
    /// A header line that means nothing.
    #[error(
        "{file}: line {line}: header says `{found}` where {expected} has to stand; correct it or export the file again"
    )]
    Header {
        /// File.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What stands there.
        found: String,
        /// What would be right.
        expected: &'static str,
    },
    /// A value that is no number.
    #[error(
        "{file}: line {line}: `{value}` is no number{hint}; correct the line, or begin it with # to leave it out"
    )]
    Value {
        /// File.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What stands there.
        value: String,
        /// What may be meant.
        hint: &'static str,
    },
    /// A row with too few values.
    #[error(
        "{file}: line {line}: {found} values where {needed} are needed (position and normal); correct the line, or begin it with # to leave it out"
    )]
    Columns {
        /// File.
        file: String,
        /// Line, from 1.
        line: usize,
        /// Values found.
        found: usize,
        /// Values needed.
        needed: usize,
    },
    /// The file ends too early.
    #[error(
        "{file}: ends in point {point} of {declared} declared; it was cut off: copy or export it again"
    )]
    Truncated {
        /// File.
        file: String,
        /// Point, from 1, in which the file ends.
        point: u64,
        /// Points that the header declares.
        declared: u64,
    },
    /// Compressed data that cannot be unpacked.
    #[error(
        "{file}: compressed data are damaged at byte {offset}: {what}; copy it again, or save it uncompressed"
    )]
    Compressed {
        /// File.
        file: String,
        /// Byte of the file.
        offset: usize,
        /// What is wrong.
        what: String,
    },
    /// More than half of the rows are unusable.
    #[error(
        "{file}: {bad} of {rows} rows are unusable, first line {line}: {reason}; export the file again with valid points and normals"
    )]
    MostlyBad {
        /// File.
        file: String,
        /// Unusable rows.
        bad: usize,
        /// All rows.
        rows: usize,
        /// First unusable line or record, from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// No row at all.
    #[error("{file}: holds no point; check that the right file was given")]
    NoPoints {
        /// File.
        file: String,
    },
}

impl Cloud {
    /// Appends the points and the rejected rows of `other`.
    pub fn append(&mut self, mut other: Self) {
        self.points.append(&mut other.points);
        self.rejected.append(&mut other.rejected);
    }
}

/// Reads a point file.
///
/// # Errors
/// See [`ReadError`]; every message names the file and, where one is to blame, the line and the value.
pub fn read(path: &Path) -> Result<Cloud, ReadError> {
    let file = path.display().to_string();
    match fs::read(path) {
        Ok(bytes) => from_bytes(&file, &bytes),
        Err(source) => Err(ReadError::Open { file, source }),
    }
}

/// Reads several point files and joins them in the given order.
///
/// # Errors
/// As [`read`], for the first file that fails.
pub fn read_all<P: AsRef<Path>>(paths: &[P]) -> Result<Cloud, ReadError> {
    let mut joined = Cloud::default();
    for path in paths {
        joined.append(read(path.as_ref())?);
    }
    Ok(joined)
}

/// Reads the content of a point file. `name` stands in messages; its extension decides where the content
/// alone does not.
///
/// # Errors
/// As [`read`].
pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Cloud, ReadError> {
    let format = |found: &str| ReadError::Format {
        file: name.to_owned(),
        found: found.to_owned(),
    };
    let extension = Path::new(name)
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    if bytes.trim_ascii().is_empty() {
        return Err(ReadError::NoPoints {
            file: name.to_owned(),
        });
    }
    if crate::ply::Header::detect(bytes) {
        return ply::parse(name, bytes);
    }
    if pcd::detect(bytes) {
        return pcd::parse(name, bytes);
    }
    if bytes.starts_with(b"\x89MCAP") {
        return Err(format(
            "is a run (MCAP), not a point file: `palpus points` turns it into one",
        ));
    }
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(format("is text in UTF-16; save it as UTF-8 or ASCII"));
    }
    match extension.as_str() {
        "ply" => return Err(format("does not begin with `ply` as a PLY file does")),
        "pcd" => return Err(format("has no PCD header")),
        "obj" | "stl" | "glb" | "gltf" | "off" | "step" | "stp" => {
            return Err(format("is a mesh or model, not a point file"));
        }
        _ => {}
    }
    if bytes.iter().take(4096).any(|&b| b == 0) {
        return Err(format("is a binary file of no known kind"));
    }
    text::parse(name, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;
    use crate::import::tests::{assert_refused, bytes_after};
    use proptest::prelude::*;

    #[test]
    fn formats_agree() {
        let rows = "1 2 3 0 0 2\n-1 0.5 1e-3 0 3 4\n";
        let ply = format!(
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
             property float nx\nproperty float ny\nproperty float nz\nend_header\n{rows}"
        );
        let pcd = format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z normal_x normal_y normal_z\nSIZE 4 4 4 4 4 4\n\
             TYPE F F F F F F\nCOUNT 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n{rows}"
        );
        let csv = "x;y;z;nx;ny;nz\n1;2;3;0;0;2\n-1;0.5;1e-3;0;3;4\n";
        let expected = from_bytes("a.xyz", rows.as_bytes()).unwrap();
        assert_eq!(expected.points[0].normal, Vec3::z());
        assert_eq!(expected.points[1].normal, Vec3::new(0.0, 0.6, 0.8));
        for (name, text) in [
            ("a.ply", ply.as_str()),
            ("a.pcd", &pcd),
            ("a.csv", csv),
            ("a", rows),
        ] {
            assert_eq!(
                from_bytes(name, text.as_bytes()).unwrap(),
                expected,
                "{name}"
            );
        }
    }

    #[test]
    fn several_files_are_joined_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let paths: Vec<_> = (0..3)
            .map(|k| folder.path().join(format!("{k}.xyz")))
            .collect();
        for (k, path) in paths.iter().enumerate() {
            fs::write(
                path,
                format!("{k} 0 0 0 0 1\n{k} 1 0 nan 0 1\n{k} 2 0 0 0 1\n"),
            )
            .unwrap();
        }
        let cloud = read_all(&paths).unwrap();
        let xs: Vec<f64> = cloud.points.iter().map(|p| p.position.x).collect();
        assert_eq!(xs, [0.0, 0.0, 1.0, 1.0, 2.0, 2.0]);
        assert_eq!(cloud.rejected.len(), 3);
        assert!(cloud.rejected[2].file.ends_with("2.xyz"));
        let missing = read(&folder.path().join("none.ply"))
            .unwrap_err()
            .to_string();
        assert!(missing.contains("none.ply") && missing.contains("check the path"));
    }

    #[test]
    fn what_is_no_point_file_is_refused() {
        let cases: [(&str, &[u8], &str); 7] = [
            ("a.xyz", b"", "no point"),
            ("a.mcap", b"\x89MCAP0\r\n", "palpus points"),
            ("a.txt", b"\xff\xfe1\0 \0", "UTF-16"),
            ("a.ply", b"1 2 3 0 0 1", "does not begin"),
            ("a.stl", b"solid", "a mesh"),
            ("a.bin", b"12 \0\x01", "binary"),
            ("a.xyz", b"# only\n# comments\n", "no point"),
        ];
        assert_refused(&cases, |name, bytes| {
            from_bytes(name, bytes).map_err(|e| e.to_string())
        });
    }

    proptest! {
        #[test]
        fn no_bytes_panic(
            bytes in bytes_after(&[
                b"",
                b"ply\nformat ascii 1.0\nelement vertex 99999999999999\nproperty float x\n",
                b"ply\nformat binary_little_endian 1.0\nelement face 3\nproperty list int int i\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n",
                b"# .PCD v0.7\nFIELDS x y z nx ny nz\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nPOINTS 999999999999\nDATA binary\n",
                b"# .PCD v0.7\nFIELDS x y z nx ny nz\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nPOINTS 99\nDATA binary_compressed\n",
            ], 400),
        ) {
            for name in ["a.ply", "a.pcd", "a.xyz"] {
                if let Ok(cloud) = from_bytes(name, &bytes) {
                    prop_assert!(cloud.points.iter().all(|p| (p.normal.norm() - 1.0).abs() < 1e-12));
                }
            }
        }
    }
}
