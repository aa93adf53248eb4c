//! Points from text: one per line, six columns or the columns that a header names.
//!
//! A header is a line before the first point of which no word is a number, or a comment that names a
//! position (`//X Y Z Nx Ny Nz`, as CloudCompare writes). A single whole number before the first point is
//! taken for a count, as some `.xyz` and `.pts` files have, and passed over. Columns beyond those known are
//! ignored, but what stands in a column that is used has to be a number.

use super::ReadError;
use super::columns::Columns;
use super::sieve::Sieve;
use crate::cloud::Cloud;
use crate::ply::{Lines, number_of, shown};

pub(super) fn parse(file: &str, bytes: &[u8]) -> Result<Cloud, ReadError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut lines = Lines {
        bytes,
        offset: 0,
        line: 0,
    };
    let mut columns = Columns::PLAIN;
    let mut named = false;
    let mut sieve = Sieve::new(file);
    let mut begun = false;
    let mut values = Vec::new();
    let mut words: Vec<&[u8]> = Vec::new();
    while let Some(raw) = lines.next_line() {
        let line = lines.line;
        let (content, comment) = split_comment(raw);
        if !begun && !named && content.is_empty() {
            split(comment, &mut words);
            let names = names(&words);
            if Columns::name_a_position(&names) {
                columns = Columns::find(file, &names)?;
                named = true;
            }
        }
        if content.is_empty() {
            continue;
        }
        split(content, &mut words);
        if !begun {
            if !named && words.iter().all(|word| number_of(word).is_none()) {
                let names = names(&words);
                if !Columns::name_a_position(&names) {
                    return Err(ReadError::Header {
                        file: file.to_owned(),
                        line,
                        found: shown(content),
                        expected: "six numbers, or the names x y z nx ny nz",
                    });
                }
                columns = Columns::find(file, &names)?;
                named = true;
                continue;
            }
            if let [only] = words[..]
                && only.iter().all(u8::is_ascii_digit)
            {
                continue;
            }
            begun = true;
        }
        let needed = columns.width();
        values.clear();
        for word in words.iter().take(needed) {
            let value = number_of(word).ok_or_else(|| ReadError::Value {
                file: file.to_owned(),
                line,
                value: shown(word),
                hint: hint(word),
            })?;
            values.push(value);
        }
        if values.len() < needed {
            let file = file.to_owned();
            return Err(ReadError::Columns {
                file,
                line,
                found: values.len(),
                needed,
            });
        }
        sieve.put(line, &columns.row(&values));
    }
    sieve.finish()
}

fn hint(word: &[u8]) -> &'static str {
    if word.is_empty() {
        " (the field is empty)"
    } else if word.contains(&b',') {
        " (decimals need a point, not a comma)"
    } else {
        ""
    }
}

fn names<'a>(words: &[&'a [u8]]) -> Vec<&'a str> {
    let name = |word: &&'a [u8]| {
        std::str::from_utf8(word)
            .unwrap_or_default()
            .trim_matches(['"', '\''])
            .trim()
    };
    words.iter().map(name).collect()
}

/// Content of a line and the comment after it, both trimmed.
fn split_comment(line: &[u8]) -> (&[u8], &[u8]) {
    let at = (0..line.len()).find(|&k| {
        matches!(line[k], b'#' | b'%') || (line[k] == b'/' && line.get(k + 1) == Some(&b'/'))
    });
    match at {
        None => (line.trim_ascii(), &[]),
        Some(at) => {
            let comment = line[at..].trim_ascii();
            let marks = comment
                .iter()
                .take_while(|b| matches!(b, b'#' | b'%' | b'/'))
                .count();
            (line[..at].trim_ascii(), comment[marks..].trim_ascii())
        }
    }
}

/// Fields of a line: at semicolons if there is one, else at commas if there is one, else at blanks.
fn split<'a>(line: &'a [u8], words: &mut Vec<&'a [u8]>) {
    words.clear();
    let separator = [b';', b','].into_iter().find(|s| line.contains(s));
    match separator {
        // A field may itself be several values: "1 2 3, 0 0 1".
        Some(separator) => {
            let line = line.strip_suffix(&[separator]).unwrap_or(line);
            for field in line.split(|b| *b == separator) {
                let field = field.trim_ascii();
                if field.is_empty() {
                    words.push(field);
                }
                words.extend(blanks(field));
            }
        }
        None => words.extend(blanks(line)),
    }
}

fn blanks(field: &[u8]) -> impl Iterator<Item = &[u8]> {
    field
        .split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first(text: &str) -> [f64; 6] {
        let cloud = parse("t.xyz", text.as_bytes()).unwrap_or_else(|e| panic!("{text}: {e}"));
        let (p, n) = (cloud.points[0].position, cloud.points[0].normal);
        [p.x, p.y, p.z, n.x, n.y, n.z]
    }

    #[test]
    fn separators_headers_and_comments() {
        let texts = [
            "1 2 3 0 0 1",
            "1\t2\t3\t0\t0\t1\n",
            "1,2,3,0,0,1\r\n",
            "1, 2, 3, 0, 0, 1,\r",
            " 1;2 ;3; 0;0;1;",
            "1 2 3, 0 0 1",
            "# comment\n\n1 2 3 0 0 1 # more",
            "\u{feff}x,y,z,nx,ny,nz\n1,2,3,0,0,1",
            "\"X\" \"Y\" \"Z\" \"NX\" \"NY\" \"NZ\"\n1 2 3 0 0 1",
            "//X Y Z R G B Nx Ny Nz\n1 2 3 9 9 9 0 0 1",
            "12\n1 2 3 0 0 1",
            "nz ny nx z y x name\n1 0 0 3 2 1 seven",
            "1 2 3 0 0 1 red",
            "1e0 +2 3.0 0 -0 1",
        ];
        for text in texts {
            assert_eq!(first(text), [1.0, 2.0, 3.0, 0.0, 0.0, 1.0], "{text}");
        }
    }

    #[test]
    fn named_extras_are_kept() {
        let text = "x,y,z,nx,ny,nz,sigma,finger,time_us\n1,2,3,0,0,1,0.5,2,1700000000000001\n";
        let point = parse("t.csv", text.as_bytes()).unwrap().points[0];
        assert_eq!((point.sigma, point.finger), (Some(0.5), Some(2)));
        assert_eq!(point.time_us, Some(1_700_000_000_000_001));
    }

    #[test]
    fn errors_name_file_line_and_value() {
        let cases = [
            (
                "1 2 3 0 0 1\n1 2 x 0 0 1",
                "t.xyz: line 2: `x` is no number;",
            ),
            (
                "1 2 3 0 0 1\n\n1 2 3 0 0",
                "t.xyz: line 3: 5 values where 6",
            ),
            (
                "1,5;2;3;0;0;1",
                "line 1: `1,5` is no number (decimals need a point",
            ),
            ("1,2,,0,0,1", "line 1: `` is no number (the field is empty)"),
            (
                "hello world\n1 2 3 0 0 1",
                "line 1: header says `hello world`",
            ),
            ("x y z\n1 2 3", "no column `nx` (columns: x y z)"),
            (
                "1 2 3 nan 0 1\n1 2 3 0 0 1\n1 2 inf 0 0 1",
                "2 of 3 rows are unusable, first line 1",
            ),
        ];
        for (text, part) in cases {
            let error = parse("t.xyz", text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
