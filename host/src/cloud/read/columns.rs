//! Which column holds what, from the columns' names.

use super::ReadError;
use super::sieve::Row;

/// Column numbers of what a point is made of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns {
    position: [usize; 3],
    normal: [usize; 3],
    sigma: Option<usize>,
    finger: Option<usize>,
    time_us: Option<usize>,
}

const POSITION: [&[&str]; 3] = [&["x"], &["y"], &["z"]];
const NORMAL: [&[&str]; 3] = [
    &["nx", "normal_x"],
    &["ny", "normal_y"],
    &["nz", "normal_z"],
];

impl Columns {
    /// Six columns in the usual order.
    pub const PLAIN: Self = Self {
        position: [0, 1, 2],
        normal: [3, 4, 5],
        sigma: None,
        finger: None,
        time_us: None,
    };

    /// Columns of the given names; case does not matter.
    pub fn find(file: &str, names: &[&str]) -> Result<Self, ReadError> {
        let find = |wanted: &[&str]| {
            names
                .iter()
                .position(|name| wanted.iter().any(|w| w.eq_ignore_ascii_case(name)))
        };
        let need = |wanted: &[&str]| {
            find(wanted).ok_or_else(|| {
                let mut columns: Vec<&str> = names.iter().copied().take(20).collect();
                if names.len() > 20 {
                    columns.push("…");
                }
                ReadError::Missing {
                    file: file.to_owned(),
                    missing: wanted.first().copied().unwrap_or_default().to_owned(),
                    columns: columns.join(" "),
                }
            })
        };
        let three = |wanted: [&[&str]; 3]| -> Result<[usize; 3], ReadError> {
            Ok([need(wanted[0])?, need(wanted[1])?, need(wanted[2])?])
        };
        Ok(Self {
            position: three(POSITION)?,
            normal: three(NORMAL)?,
            sigma: find(&["sigma"]),
            finger: find(&["finger"]),
            time_us: find(&["time_us"]),
        })
    }

    /// Whether the names hold all of a position.
    pub fn name_a_position(names: &[&str]) -> bool {
        POSITION
            .iter()
            .all(|w| names.iter().any(|name| w[0].eq_ignore_ascii_case(name)))
    }

    /// Values a row needs at least.
    pub fn width(&self) -> usize {
        let six = self.position.iter().chain(&self.normal);
        let more = [self.sigma, self.finger, self.time_us];
        six.copied()
            .chain(more.into_iter().flatten())
            .max()
            .map_or(0, |last| last + 1)
    }

    /// The row that the values stand for; a value that is not there counts as NaN.
    pub fn row(&self, values: &[f64]) -> Row {
        let at = |column: usize| values.get(column).copied().unwrap_or(f64::NAN);
        Row {
            position: self.position.map(at),
            normal: self.normal.map(at),
            sigma: self.sigma.map(at),
            finger: self.finger.map(at),
            time_us: self.time_us.map(at),
        }
    }
}
