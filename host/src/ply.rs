//! The PLY container: header, elements, scalar and list properties, in its three encodings.
//!
//! [`crate::cloud`] reads points and [`crate::import`] reads meshes through [`Header`] and [`Body`]; what a
//! property means is theirs to say. What is promised on any bytes: no panic, no allocation larger than the
//! file itself calls for (a header's counts are never trusted), and every error names the line (text) or
//! the record (binary) and the value.

use std::fmt;
use std::sync::Arc;

/// How the values after the header are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// One row of text per record.
    Ascii,
    /// Packed, least significant byte first.
    BinaryLittleEndian,
    /// Packed, most significant byte first.
    BinaryBigEndian,
}

/// Type of a scalar; `char` to `double` or `int8` to `float64` in the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value in `bytes`, which holds exactly [`Self::size`] bytes; `None` otherwise.
    pub fn decode(self, bytes: &[u8], big_endian: bool) -> Option<f64> {
        macro_rules! decode {
            ($type:ty) => {{
                let bytes = bytes.try_into().ok()?;
                f64::from(if big_endian {
                    <$type>::from_be_bytes(bytes)
                } else {
                    <$type>::from_le_bytes(bytes)
                })
            }};
        }
        Some(match self {
            Self::I8 => decode!(i8),
            Self::U8 => decode!(u8),
            Self::I16 => decode!(i16),
            Self::U16 => decode!(u16),
            Self::I32 => decode!(i32),
            Self::U32 => decode!(u32),
            Self::F32 => decode!(f32),
            Self::F64 => decode!(f64),
        })
    }
}

/// Scalar or list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One value per record.
    Scalar(Scalar),
    /// A count, then that many values.
    List {
        /// Type of the count.
        count: Scalar,
        /// Type of the values.
        item: Scalar,
    },
}

/// A named column of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Name in the header.
    pub name: String,
    /// Scalar or list, with types.
    pub kind: Kind,
}

/// A table of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Name in the header: `vertex`, `face`, …
    pub name: Arc<str>,
    /// Records the header declares. Nothing may be allocated from it.
    pub count: u64,
    /// Columns in the order of the file.
    pub properties: Vec<Property>,
}

impl Element {
    /// Column number of the scalar property of that name.
    pub fn scalar(&self, name: &str) -> Option<usize> {
        self.properties
            .iter()
            .position(|p| p.name == name && matches!(p.kind, Kind::Scalar(_)))
    }

    /// Column number of the list property of that name.
    pub fn list(&self, name: &str) -> Option<usize> {
        self.properties
            .iter()
            .position(|p| p.name == name && matches!(p.kind, Kind::List { .. }))
    }

    /// Bytes of a binary record, if no column is a list.
    fn fixed_size(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| match p.kind {
            Kind::Scalar(scalar) => Some(sum + scalar.size()),
            Kind::List { .. } => None,
        })
    }
}

/// Where in the file something stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Line of a text, from 1.
    Line(usize),
    /// Record of a binary element, from 1.
    Record(Arc<str>, u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Record(element, record) => write!(f, "{element} {record}"),
        }
    }
}

/// Why a PLY file cannot be read, and what to do next.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlyError {
    /// The file does not begin with `ply`.
    #[error("line 1: `{found}` where `ply` has to stand; check that this is a PLY file")]
    Magic {
        /// Beginning of the first line.
        found: String,
    },
    /// A header line that means nothing.
    #[error(
        "line {line}: header says `{found}` where {expected} has to stand; correct the header or export the file again"
    )]
    Header {
        /// Line, from 1.
        line: usize,
        /// The line.
        found: String,
        /// What would be right.
        expected: &'static str,
    },
    /// No `end_header`.
    #[error("line {line}: the file ends inside its header; copy or export it again")]
    HeaderEnd {
        /// Last line.
        line: usize,
    },
    /// The file ends before its last record.
    #[error(
        "the file ends in {element} {record} of {declared} declared; it was cut off: copy or export it again"
    )]
    Truncated {
        /// Element that is not complete.
        element: String,
        /// Record, from 1, in which the file ends.
        record: u64,
        /// Records that the header declares.
        declared: u64,
    },
    /// A text value that is no number.
    #[error("{place}: `{value}` is no number for property `{property}`; correct the line")]
    Value {
        /// Where.
        place: Place,
        /// Column.
        property: String,
        /// What stands there.
        value: String,
    },
    /// A text row with too few values.
    #[error(
        "{place}: {found} values where element `{element}` needs {needed}; correct the line or the header"
    )]
    Columns {
        /// Where.
        place: Place,
        /// Values found.
        found: usize,
        /// Element.
        element: String,
        /// Values needed.
        needed: usize,
    },
    /// A list whose count is negative, broken or beyond the end of the file.
    #[error(
        "{place}: list `{property}` declares {count} items, which the file does not hold; export it again"
    )]
    ListCount {
        /// Where.
        place: Place,
        /// Column.
        property: String,
        /// Count found.
        count: f64,
    },
}

/// What stands before the data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Encoding of the data.
    pub encoding: Encoding,
    /// Tables in the order of the file.
    pub elements: Vec<Element>,
    /// Byte at which the data begin.
    offset: usize,
    /// Lines of the header.
    lines: usize,
}

impl Header {
    /// Whether `bytes` begin like a PLY file.
    pub fn detect(bytes: &[u8]) -> bool {
        bytes.starts_with(b"ply") && matches!(bytes.get(3), Some(b'\n' | b'\r' | b' '))
    }

    /// Parses the header of a PLY file.
    ///
    /// # Errors
    /// A line that is not understood, or a missing end.
    pub fn parse(bytes: &[u8]) -> Result<Self, PlyError> {
        let mut lines = Lines {
            bytes,
            offset: 0,
            line: 0,
        };
        let first = lines.next_line().unwrap_or_default();
        if first.trim_ascii() != b"ply" {
            return Err(PlyError::Magic {
                found: shown(first),
            });
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let Some(raw) = lines.next_line() else {
                return Err(PlyError::HeaderEnd { line: lines.line });
            };
            let line = lines.line;
            let wrong = |expected| PlyError::Header {
                line,
                found: shown(raw),
                expected,
            };
            let text = std::str::from_utf8(raw).unwrap_or("\u{fffd}");
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match words.as_slice() {
                [] | ["comment" | "obj_info", ..] => {}
                _ if raw.starts_with(b"comment") || raw.starts_with(b"obj_info") => {}
                ["format", kind, "1.0"] => {
                    encoding = Some(match *kind {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::BinaryLittleEndian,
                        "binary_big_endian" => Encoding::BinaryBigEndian,
                        _ => {
                            return Err(wrong(
                                "`ascii`, `binary_little_endian` or `binary_big_endian`",
                            ));
                        }
                    });
                }
                ["element", name, count] => elements.push(Element {
                    name: (*name).into(),
                    count: count
                        .parse()
                        .map_err(|_| wrong("`element NAME COUNT`, a whole count from 0"))?,
                    properties: Vec::new(),
                }),
                ["property", rest @ ..] => {
                    let Some(element) = elements.last_mut() else {
                        return Err(wrong("an element before its first property"));
                    };
                    let scalar = |name| {
                        Scalar::parse(name).ok_or_else(|| wrong("a PLY type such as `float`"))
                    };
                    let (kind, name) = match rest {
                        ["list", count, item, name] => (
                            Kind::List {
                                count: scalar(count)?,
                                item: scalar(item)?,
                            },
                            name,
                        ),
                        [kind, name] => (Kind::Scalar(scalar(kind)?), name),
                        _ => return Err(wrong("`property TYPE NAME`")),
                    };
                    element.properties.push(Property {
                        name: (*name).to_owned(),
                        kind,
                    });
                }
                ["end_header"] => break,
                _ => {
                    return Err(wrong(
                        "`format`, `element`, `property`, `comment` or `end_header`",
                    ));
                }
            }
        }
        let Some(encoding) = encoding else {
            return Err(PlyError::Header {
                line: lines.line,
                found: "end_header".into(),
                expected: "a `format` line before the end",
            });
        };
        Ok(Self {
            encoding,
            elements,
            offset: lines.offset,
            lines: lines.line,
        })
    }

    /// The data that follow this header in the same `bytes`.
    pub fn body<'a>(&self, bytes: &'a [u8]) -> Body<'a> {
        Body {
            encoding: self.encoding,
            lines: Lines {
                bytes,
                offset: self.offset.min(bytes.len()),
                line: self.lines,
            },
        }
    }
}

/// Values of one record; reused from record to record.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// One value per column; for a list, its number of items.
    pub values: Vec<f64>,
    /// Items of all lists of the record, one list after the other.
    items: Vec<f64>,
    /// Per column, where its items begin in `items`.
    begins: Vec<usize>,
}

impl Record {
    /// Items of the list in the given column; empty for a scalar.
    pub fn list(&self, column: usize) -> &[f64] {
        let begin = self.begins.get(column).copied().unwrap_or(0);
        let end = self
            .begins
            .get(column + 1)
            .copied()
            .unwrap_or(self.items.len());
        self.items.get(begin..end).unwrap_or(&[])
    }
}

/// Reads records one after the other.
#[derive(Clone, Debug)]
pub struct Body<'a> {
    encoding: Encoding,
    lines: Lines<'a>,
}

impl Body<'_> {
    /// Reads record number `number` (from 1) of `element` into `record` and says where it stands.
    ///
    /// # Errors
    /// End of the file, or a value that cannot be read.
    pub fn read(
        &mut self,
        element: &Element,
        number: u64,
        record: &mut Record,
    ) -> Result<Place, PlyError> {
        record.values.clear();
        record.items.clear();
        record.begins.clear();
        match self.encoding {
            Encoding::Ascii => self.read_text(element, number, record),
            Encoding::BinaryLittleEndian => self.read_binary(element, number, record, false),
            Encoding::BinaryBigEndian => self.read_binary(element, number, record, true),
        }
    }

    /// Skips all records of `element`.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn skip(&mut self, element: &Element) -> Result<(), PlyError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        if self.encoding != Encoding::Ascii
            && let Some(size) = element.fixed_size()
        {
            let rest = self.lines.bytes.len() - self.lines.offset;
            let held = (rest / size) as u64;
            if held < element.count {
                return Err(truncated(element, held + 1));
            }
            // `held` records fit into memory, and `count` is no larger.
            self.lines.offset += element.count as usize * size;
            return Ok(());
        }
        let mut record = Record::default();
        for number in 1..=element.count {
            self.read(element, number, &mut record)?;
        }
        Ok(())
    }

    fn read_text(
        &mut self,
        element: &Element,
        number: u64,
        record: &mut Record,
    ) -> Result<Place, PlyError> {
        if element.properties.is_empty() {
            return Ok(Place::Line(self.lines.line));
        }
        let row = loop {
            match self.lines.next_line() {
                None => return Err(truncated(element, number)),
                Some(row) if row.trim_ascii().is_empty() => {}
                Some(row) => break row,
            }
        };
        let place = Place::Line(self.lines.line);
        let mut words = row
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        let mut found = 0;
        let mut next = |property: &Property, missing: usize| -> Result<f64, PlyError> {
            let word = words.next().ok_or_else(|| PlyError::Columns {
                place: place.clone(),
                found,
                element: element.name.to_string(),
                needed: found + missing,
            })?;
            found += 1;
            number_of(word).ok_or_else(|| PlyError::Value {
                place: place.clone(),
                property: property.name.clone(),
                value: shown(word),
            })
        };
        for (column, property) in element.properties.iter().enumerate() {
            let left = element.properties.len() - column;
            record.begins.push(record.items.len());
            let value = next(property, left)?;
            record.values.push(value);
            if let Kind::List { .. } = property.kind {
                // At least two bytes of the row per item, so a false count ends early.
                let count = list_count(value, row.len(), &place, property)?;
                for item in 0..count {
                    let value = next(property, count - item + left - 1)?;
                    record.items.push(value);
                }
            }
        }
        Ok(place)
    }

    fn read_binary(
        &mut self,
        element: &Element,
        number: u64,
        record: &mut Record,
        big_endian: bool,
    ) -> Result<Place, PlyError> {
        let place = || Place::Record(Arc::clone(&element.name), number);
        for property in &element.properties {
            record.begins.push(record.items.len());
            let (first, item) = match property.kind {
                Kind::Scalar(scalar) => (scalar, None),
                Kind::List { count, item } => (count, Some(item)),
            };
            let value = self
                .lines
                .take(first.size())
                .and_then(|bytes| first.decode(bytes, big_endian))
                .ok_or_else(|| truncated(element, number))?;
            record.values.push(value);
            if let Some(item) = item {
                let rest = (self.lines.bytes.len() - self.lines.offset) / item.size();
                let count = list_count(value, rest, &place(), property)?;
                let bytes = self
                    .lines
                    .take(count * item.size())
                    .ok_or_else(|| truncated(element, number))?;
                let values = bytes
                    .chunks_exact(item.size())
                    .filter_map(|bytes| item.decode(bytes, big_endian));
                record.items.extend(values);
            }
        }
        Ok(place())
    }
}

fn truncated(element: &Element, record: u64) -> PlyError {
    PlyError::Truncated {
        element: element.name.to_string(),
        record,
        declared: element.count,
    }
}

fn list_count(
    value: f64,
    held: usize,
    place: &Place,
    property: &Property,
) -> Result<usize, PlyError> {
    if value >= 0.0 && value.fract() == 0.0 && value <= held as f64 {
        Ok(value as usize)
    } else {
        Err(PlyError::ListCount {
            place: place.clone(),
            property: property.name.clone(),
            count: value,
        })
    }
}

/// Number that a text value stands for, with the spellings of NaN and infinity of older C libraries.
pub(crate) fn number_of(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| {
        let bare = text.trim_start_matches(['+', '-']).to_ascii_lowercase();
        let (_, special) = bare.split_once(".#")?;
        match special.trim_end_matches('0') {
            "qnan" | "snan" | "ind" => Some(f64::NAN),
            "inf" if text.starts_with('-') => Some(f64::NEG_INFINITY),
            "inf" => Some(f64::INFINITY),
            _ => None,
        }
    })
}

/// Beginning of a piece of a file, fit to stand in a message.
pub(crate) fn shown(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes.get(..60).unwrap_or(bytes));
    let text = text.trim().replace(|c: char| c.is_control(), "\u{fffd}");
    if bytes.len() > 60 {
        format!("{text}…")
    } else {
        text
    }
}

/// Lines of a text that may end in LF, CR LF or CR, counted from 1.
#[derive(Clone, Debug)]
pub(crate) struct Lines<'a> {
    /// The whole file.
    pub(crate) bytes: &'a [u8],
    /// Next byte to read.
    pub(crate) offset: usize,
    /// Number of the line read last.
    pub(crate) line: usize,
}

impl<'a> Lines<'a> {
    /// The next line without its end; `None` after the last.
    pub(crate) fn next_line(&mut self) -> Option<&'a [u8]> {
        let rest = self
            .bytes
            .get(self.offset..)
            .filter(|rest| !rest.is_empty())?;
        self.line += 1;
        let end = rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let length = end.unwrap_or(rest.len());
        let stop = match (rest.get(length), rest.get(length + 1)) {
            (Some(b'\r'), Some(b'\n')) => 2,
            (Some(_), _) => 1,
            (None, _) => 0,
        };
        self.offset += length + stop;
        rest.get(..length)
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.offset.checked_add(length)?;
        let bytes = self.bytes.get(self.offset..end)?;
        self.offset = end;
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Rows = Vec<(String, Vec<f64>, Vec<f64>)>;

    fn rows(bytes: &[u8]) -> Result<Rows, PlyError> {
        let header = Header::parse(bytes)?;
        let mut body = header.body(bytes);
        let mut record = Record::default();
        let mut out = Vec::new();
        for element in &header.elements {
            for number in 1..=element.count {
                let place = body.read(element, number, &mut record)?;
                let list = record.list(element.properties.len() - 1).to_vec();
                out.push((place.to_string(), record.values.clone(), list));
            }
        }
        Ok(out)
    }

    const HEADER: &str = "comment free text, 1\nelement thing 2\nproperty short a\n\
                          property list uchar int b\nend_header\n";

    #[test]
    fn the_three_encodings_agree() {
        let ascii = format!("ply\nformat ascii 1.0\n{HEADER}-3 2 70000 -1\n\n4 0\n");
        let mut little = format!("ply\nformat binary_little_endian 1.0\n{HEADER}").into_bytes();
        let mut big = format!("ply\r\nformat binary_big_endian 1.0\r\n{HEADER}").into_bytes();
        for (bytes, swap) in [(&mut little, false), (&mut big, true)] {
            let mut put = |value: &[u8]| {
                let mut value = value.to_vec();
                if swap {
                    value.reverse();
                }
                bytes.extend(value);
            };
            put(&(-3i16).to_le_bytes());
            put(&[2]);
            put(&70000i32.to_le_bytes());
            put(&(-1i32).to_le_bytes());
            put(&4i16.to_le_bytes());
            put(&[0]);
        }
        let expected = [
            (vec![-3.0, 2.0], vec![70000.0, -1.0]),
            (vec![4.0, 0.0], vec![]),
        ];
        for bytes in [ascii.as_bytes(), &little, &big] {
            let found: Vec<_> = rows(bytes)
                .unwrap()
                .into_iter()
                .map(|r| (r.1, r.2))
                .collect();
            assert_eq!(found, expected);
        }
        assert_eq!(rows(ascii.as_bytes()).unwrap()[1].0, "line 10");
        assert_eq!(rows(&big).unwrap()[1].0, "thing 2");
    }

    #[test]
    fn false_counts_end_at_the_end_of_the_file() {
        for encoding in ["ascii", "binary_little_endian"] {
            let head = format!("ply\nformat {encoding} 1.0\nelement vertex 1000000000000\n");
            let scalar = format!("{head}property float x\nend_header\n");
            let header = Header::parse(scalar.as_bytes()).unwrap();
            let skipped = header.body(scalar.as_bytes()).skip(&header.elements[0]);
            assert!(matches!(
                skipped,
                Err(PlyError::Truncated { record: 1, .. })
            ));
            let empty = format!("{head}end_header\n");
            let header = Header::parse(empty.as_bytes()).unwrap();
            assert_eq!(
                header.body(empty.as_bytes()).skip(&header.elements[0]),
                Ok(())
            );
        }
        let list = b"ply\nformat binary_big_endian 1.0\nelement f 1\nproperty list uint double i\nend_header\n\xff\xff\xff\xff";
        assert!(matches!(rows(list), Err(PlyError::ListCount { .. })));
    }

    #[test]
    fn errors_name_line_and_value() {
        let cases = [
            ("plx\n", "line 1: `plx`"),
            (
                "ply\nformat ascii 2.0\n",
                "line 2: header says `format ascii 2.0`",
            ),
            ("ply\nproperty float x\n", "line 2"),
            ("ply\nformat ascii 1.0\nelement v many\n", "line 3"),
            (
                "ply\nformat ascii 1.0\nelement v 1\nproperty half x\n",
                "`property half x`",
            ),
            ("ply\nformat ascii 1.0\n", "line 2: the file ends"),
            (
                "ply\nformat ascii 1.0\nelement v 1\nproperty float x\nend_header\n1,5\n",
                "line 6: `1,5` is no number for property `x`",
            ),
            (
                "ply\nformat ascii 1.0\nelement v 1\nproperty float x\nproperty float y\nend_header\n1\n",
                "line 7: 1 values where element `v` needs 2",
            ),
        ];
        for (text, part) in cases {
            let error = rows(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn old_spellings_of_nan_are_read() {
        assert!(number_of(b"-1.#IND").unwrap().is_nan());
        assert!(number_of(b"1.#QNAN0").unwrap().is_nan());
        assert_eq!(number_of(b"-1.#INF"), Some(f64::NEG_INFINITY));
        assert_eq!(number_of(b"abc"), None);
    }
}
