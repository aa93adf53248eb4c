//! Points from a PCD file of the Point Cloud Library: ascii, binary, binary_compressed.
//!
//! Binary data are little endian. Compressed data hold one field after the other instead of one point after
//! the other.

use super::columns::Columns;
use super::sieve::Sieve;
use super::{ReadError, lzf};
use crate::cloud::Cloud;
use crate::ply::{Lines, number_of, shown};

/// Type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Type {
    Signed,
    Unsigned,
    Float,
}

#[derive(Clone, Debug)]
struct Field {
    name: String,
    kind: Type,
    size: usize,
    count: usize,
}

impl Field {
    /// Bytes of this field in one point; checked against overflow in the header.
    fn width(&self) -> usize {
        self.size * self.count
    }

    /// The first value of the field.
    fn decode(&self, bytes: &[u8]) -> f64 {
        let mut raw = [0; 8];
        let Some(bytes) = bytes.get(..self.size) else {
            return f64::NAN;
        };
        raw[..self.size].copy_from_slice(bytes);
        let word = u64::from_le_bytes(raw);
        let unused = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            (Type::Float, 4) => f64::from(f32::from_bits(word as u32)),
            (Type::Float, _) => f64::from_bits(word),
            (Type::Unsigned, _) => word as f64,
            (Type::Signed, _) => ((word << unused) as i64 >> unused) as f64,
        }
    }
}

/// Whether `bytes` begin like a PCD file.
pub(super) fn detect(bytes: &[u8]) -> bool {
    let mut lines = Lines {
        bytes: bytes.get(..4096).unwrap_or(bytes),
        offset: 0,
        line: 0,
    };
    while let Some(line) = lines.next_line() {
        let line = line.trim_ascii();
        if line.starts_with(b"# .PCD") {
            return true;
        }
        if !line.is_empty() && !line.starts_with(b"#") {
            return line.starts_with(b"VERSION") || line.starts_with(b"FIELDS");
        }
    }
    false
}

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Cloud, ReadError> {
    let mut lines = Lines {
        bytes,
        offset: 0,
        line: 0,
    };
    let mut fields: Vec<Field> = Vec::new();
    let (mut width, mut height, mut points) = (None, None, None);
    let data = loop {
        let Some(raw) = lines.next_line() else {
            return Err(ReadError::Header {
                file: file.to_owned(),
                line: lines.line,
                found: "end of file".into(),
                expected: "`DATA ascii`, `DATA binary` or `DATA binary_compressed`",
            });
        };
        let line = lines.line;
        let wrong = |expected| ReadError::Header {
            file: file.to_owned(),
            line,
            found: shown(raw),
            expected,
        };
        let text = std::str::from_utf8(raw).map_err(|_| wrong("a line of text"))?;
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let Some((&key, rest)) = words.split_first() else {
            continue;
        };
        let number = |expected| match rest {
            [count] => count.parse::<u64>().map_err(|_| wrong(expected)),
            _ => Err(wrong(expected)),
        };
        let per_field = || {
            if rest.len() == fields.len() {
                Ok(())
            } else {
                Err(wrong("one value per field"))
            }
        };
        match key {
            _ if key.starts_with('#') => {}
            "VERSION" | "VIEWPOINT" => {}
            "FIELDS" | "COLUMNS" => {
                let field = |name: &&str| Field {
                    name: (*name).to_owned(),
                    kind: Type::Float,
                    size: 4,
                    count: 1,
                };
                fields = rest.iter().map(field).collect();
            }
            "SIZE" => {
                per_field()?;
                for (field, word) in fields.iter_mut().zip(rest) {
                    field.size = match *word {
                        "1" => 1,
                        "2" => 2,
                        "4" => 4,
                        "8" => 8,
                        _ => return Err(wrong("sizes of 1, 2, 4 or 8")),
                    };
                }
            }
            "TYPE" => {
                per_field()?;
                for (field, word) in fields.iter_mut().zip(rest) {
                    field.kind = match *word {
                        "F" => Type::Float,
                        "I" => Type::Signed,
                        "U" => Type::Unsigned,
                        _ => return Err(wrong("types of F, I or U")),
                    };
                }
            }
            "COUNT" => {
                per_field()?;
                for (field, word) in fields.iter_mut().zip(rest) {
                    let count = word.parse::<u32>().map_err(|_| wrong("counts from 1"))?;
                    field.count = count as usize;
                }
            }
            "WIDTH" => width = Some(number("`WIDTH COUNT`")?),
            "HEIGHT" => height = Some(number("`HEIGHT COUNT`")?),
            "POINTS" => points = Some(number("`POINTS COUNT`")?),
            "DATA" => match rest {
                ["ascii" | "binary" | "binary_compressed"] => break rest[0].to_owned(),
                _ => {
                    return Err(wrong(
                        "`DATA ascii`, `DATA binary` or `DATA binary_compressed`",
                    ));
                }
            },
            _ => return Err(wrong("a PCD keyword such as FIELDS, SIZE or DATA")),
        }
    };
    let wrong = |found: String, expected| ReadError::Header {
        file: file.to_owned(),
        line: lines.line,
        found,
        expected,
    };
    let declared = points.or_else(|| width?.checked_mul(height?));
    let Some(declared) = declared else {
        return Err(wrong("DATA".into(), "`POINTS COUNT` before it"));
    };
    for field in &fields {
        if field.kind == Type::Float && field.size < 4 {
            return Err(wrong(
                format!("field {} of type F and size {}", field.name, field.size),
                "a size of 4 or 8",
            ));
        }
    }
    let names: Vec<&str> = fields
        .iter()
        .map(|f| if f.count == 1 { f.name.as_str() } else { "" })
        .collect();
    let columns = Columns::find(file, &names)?;
    if data == "ascii" {
        return parse_ascii(file, lines, &fields, columns, declared);
    }
    let size = fields.iter().try_fold(0usize, |sum, f| {
        sum.checked_add(f.size.checked_mul(f.count)?)
    });
    let Some(size) = size.filter(|size| *size > 0) else {
        return Err(wrong("COUNT".into(), "fields of a possible size"));
    };
    let body = bytes.get(lines.offset..).unwrap_or(&[]);
    let mut sieve = Sieve::new(file);
    let mut values = vec![0.0; fields.len()];
    if data == "binary" {
        let held = (body.len() / size) as u64;
        if held < declared {
            return Err(ReadError::Truncated {
                file: file.to_owned(),
                point: held + 1,
                declared,
            });
        }
        for (number, point) in body.chunks_exact(size).take(declared as usize).enumerate() {
            let mut at = 0;
            for (value, field) in values.iter_mut().zip(&fields) {
                *value = field.decode(&point[at..]);
                at += field.width();
            }
            sieve.put(number + 1, &columns.row(&values));
        }
        return sieve.finish();
    }
    let unpacked = unpack(file, body, lines.offset, size, declared)?;
    let count = declared as usize;
    for number in 0..count {
        let mut begin = 0;
        for (value, field) in values.iter_mut().zip(&fields) {
            *value = field.decode(&unpacked[begin + number * field.width()..]);
            begin += count * field.width();
        }
        sieve.put(number + 1, &columns.row(&values));
    }
    sieve.finish()
}

/// Unpacks compressed data: two sizes, then the packed bytes.
fn unpack(
    file: &str,
    body: &[u8],
    offset: usize,
    size: usize,
    declared: u64,
) -> Result<Vec<u8>, ReadError> {
    let damaged = |at: usize, what: String| ReadError::Compressed {
        file: file.to_owned(),
        offset: offset + at,
        what,
    };
    let word = |at: usize| {
        let bytes = body.get(at..at + 4).and_then(|b| b.try_into().ok());
        let word = bytes.map(u32::from_le_bytes);
        word.ok_or_else(|| damaged(at, "ends before its sizes".into()))
    };
    let (packed, unpacked) = (word(0)? as usize, word(4)? as usize);
    let expected = declared.checked_mul(size as u64);
    if expected != Some(unpacked as u64) {
        return Err(damaged(
            4,
            format!(
                "{unpacked} bytes declared where {declared} points of {size} bytes need another size"
            ),
        ));
    }
    let Some(data) = body.get(8..).and_then(|data| data.get(..packed)) else {
        return Err(damaged(
            0,
            format!("{packed} packed bytes declared, {} there", body.len() - 8),
        ));
    };
    lzf::decode(data, unpacked).map_err(|(at, what)| damaged(8 + at, what.to_owned()))
}

fn parse_ascii(
    file: &str,
    mut lines: Lines<'_>,
    fields: &[Field],
    columns: Columns,
    declared: u64,
) -> Result<Cloud, ReadError> {
    let mut sieve = Sieve::new(file);
    let mut values = Vec::new();
    let mut point = 0;
    while point < declared {
        let Some(raw) = lines.next_line() else {
            return Err(ReadError::Truncated {
                file: file.to_owned(),
                point: point + 1,
                declared,
            });
        };
        let raw = raw.trim_ascii();
        if raw.is_empty() || raw.starts_with(b"#") {
            continue;
        }
        point += 1;
        let line = lines.line;
        let mut words = raw
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        values.clear();
        let short = |values: &[f64]| ReadError::Columns {
            file: file.to_owned(),
            line,
            found: values.len(),
            needed: fields.len(),
        };
        for field in fields {
            // Fields of several values hold none that is used.
            let word = match field.count {
                0 => b"0",
                count => words.nth(count - 1).ok_or_else(|| short(&values))?,
            };
            values.push(number_of(word).ok_or_else(|| ReadError::Value {
                file: file.to_owned(),
                line,
                value: shown(word),
                hint: "",
            })?);
        }
        sieve.put(line, &columns.row(&values));
    }
    sieve.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vec3;

    fn header(points: u64, data: &str) -> Vec<u8> {
        format!(
            "# .PCD v.7\nVERSION .7\nFIELDS x y z tag normal_x normal_y normal_z curvature finger\n\
             SIZE 4 4 8 1 4 4 4 4 2\nTYPE F F F I F F F F U\nCOUNT 1 1 1 2 1 1 1 1 1\n\
             WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
        )
        .into_bytes()
    }

    /// Columns of bytes, one per field, of two points.
    fn columns() -> Vec<[Vec<u8>; 2]> {
        let pair = |a: f32, b: f32| [a.to_le_bytes().to_vec(), b.to_le_bytes().to_vec()];
        vec![
            pair(1.0, 4.0),
            pair(2.0, f32::NAN),
            [3f64.to_le_bytes().to_vec(), 6f64.to_le_bytes().to_vec()],
            [vec![7, 8], vec![9, 10]],
            pair(0.0, 1.0),
            pair(-2.0, 0.0),
            pair(0.0, 0.0),
            pair(0.5, 0.5),
            [vec![1, 1], vec![2, 0]],
        ]
    }

    fn check(cloud: &Cloud) {
        assert_eq!(cloud.points.len(), 1);
        assert_eq!(cloud.points[0].position, Vec3::new(1.0, 2.0, 3.0));
        assert_eq!(cloud.points[0].normal, -Vec3::y());
        assert_eq!(cloud.points[0].finger, Some(257));
        assert_eq!(cloud.rejected[0].reason, "y is NaN");
    }

    #[test]
    fn binary_compressed_and_ascii_agree() {
        let mut binary = header(2, "binary");
        for point in 0..2 {
            columns().iter().for_each(|c| binary.extend(&c[point]));
        }
        check(&parse("a.pcd", &binary).unwrap());
        let mut packed = Vec::new();
        for byte in columns().iter().flatten().flatten() {
            packed.extend([0, *byte]);
        }
        let mut compressed = header(2, "binary_compressed");
        compressed.extend((packed.len() as u32).to_le_bytes());
        compressed.extend((packed.len() as u32 / 2).to_le_bytes());
        compressed.extend(packed);
        check(&parse("a.pcd", &compressed).unwrap());
        let mut ascii = header(2, "ascii");
        ascii.extend(b"1 2 3 7 8 0 -2 0 .5 257\n4 nan 6 9 10 1 0 0 .5 2\n");
        check(&parse("a.pcd", &ascii).unwrap());
    }

    #[test]
    fn errors_say_where() {
        let mut short = header(1_000_000_000_000, "binary");
        short.extend([0; 100]);
        let mut packed = header(2, "binary_compressed");
        packed.extend([9, 0, 0, 0, 72, 0, 0, 0, 1]);
        let mut word = header(1, "ascii");
        word.extend(b"1 2 three 7 8 0 -2 0 .5 1\n");
        let cases: [(&[u8], &str); 6] = [
            (&short, "ends in point 3 of 1000000000000"),
            (&packed, "9 packed bytes declared, 1 there"),
            (&word, "line 12: `three` is no number"),
            (
                b"VERSION 0.7\nFIELDS x y\nSIZE 4\n",
                "line 3: header says `SIZE 4`",
            ),
            (b"VERSION 0.7\nFIELDS x\nTYPE Q\n", "types of F, I or U"),
            (
                b"VERSION 0.7\nFIELDS x y z\nPOINTS 1\nDATA ascii\n",
                "no column `nx`",
            ),
        ];
        for (bytes, part) in cases {
            let error = parse("a.pcd", bytes).unwrap_err().to_string();
            assert!(error.contains("a.pcd") && error.contains(part), "{error}");
        }
    }
}
