//! Text and other flat marks on a finished picture: a small stroke font of our own, lines, boxes, dots.
//!
//! A letter is a few strokes on a grid: x 0 to 6, y with the base line at 2, small letters to 6, capitals to 8.
//! Two digits are a point, a space ends a stroke, `~` makes a stroke round. Everything is anti-aliased by the
//! distance to the stroke.

use super::colour::Srgb;
use super::image::Image;

/// Strokes of a character, or those of a box for one that is not there.
fn glyph(character: char) -> &'static str {
    match character {
        ' ' => "",
        '!' => "0804 0202",
        '"' => "0806 2826",
        '#' => "1218 3238 0444 0646",
        '%' => "0248 0818160608 3444423234",
        '&' => "42161728370403122244",
        '\'' => "0806",
        '(' => "~19070311",
        ')' => "~09171301",
        '*' => "2327 0446 0644",
        '+' => "2327 0545",
        ',' => "1201",
        '-' => "0535",
        '−' | '–' => "0545",
        '.' => "0202",
        '/' => "0139",
        '0' => "~28060422444628",
        '1' => "172822 1232",
        '2' => "~0718384746 460242",
        '3' => "~07183847463525 ~25354443321203",
        '4' => "32380444",
        '5' => "480805 ~0516364543321203",
        '6' => "~473818060412324344351504",
        '7' => "084812",
        '8' => "~28070625464728 ~25040322434425",
        '9' => "~031232444638180706153546",
        ':' => "0202 0505",
        ';' => "1515 1201",
        '<' => "370533",
        '=' => "0444 0646",
        '>' => "073503",
        '?' => "~07183847462524 2222",
        '@' => "~353424253635 35344547381807031242",
        'A' => "022842 1434",
        'B' => "02083847463505 3544433202",
        'C' => "~4738180604123243",
        'D' => "02082846442202",
        'E' => "48080242 0535",
        'F' => "480802 0535",
        'G' => "~4738180604123243 434525",
        'H' => "0208 4248 0545",
        'I' => "0208",
        'J' => "3833221203",
        'K' => "0208 4804 1542",
        'L' => "080242",
        'M' => "0208244842",
        'N' => "02084248",
        'O' => "~280604223254563828",
        'P' => "02083847463505",
        'Q' => "~280604223254563828 3452",
        'R' => "02083847463505 2542",
        'S' => "~473818070615354443321203",
        'T' => "0848 2822",
        'U' => "080312324348",
        'V' => "082248",
        'W' => "0822374268",
        'X' => "0248 0842",
        'Y' => "082548 2522",
        'Z' => "08480242",
        '$' => "~473818070615354443321203 2921",
        '`' => "0817",
        '[' => "19090111",
        '\\' => "0931",
        ']' => "09191101",
        '^' => "062846",
        '_' => "0141",
        'a' => "3632 ~3526160503122233",
        'b' => "0802 ~0516263533221203",
        'c' => "~3526160503122233",
        'd' => "3832 ~3526160503122233",
        'e' => "0434 ~343526160503122233",
        'f' => "281712 0626",
        'g' => "3631201001 ~3526160503122233",
        'h' => "0802 ~05162635 3532",
        'i' => "0206 0808",
        'j' => "161100 1818",
        'k' => "0802 3603 1432",
        'l' => "0802",
        'm' => "0602 05162522 25364542",
        'n' => "0602 ~05162635 3532",
        'o' => "~160503122233352616",
        'p' => "0600 ~0516263533221203",
        'q' => "3630 ~3526160503122233",
        'r' => "0602 ~041626",
        's' => "~35261605142433221203",
        't' => "181322 0626",
        'u' => "0603122233 3632",
        'v' => "062246",
        'w' => "0612253246",
        'x' => "0632 0236",
        'y' => "0622 4610",
        'z' => "06360232",
        '{' => "29181605141221",
        '|' => "0901",
        '}' => "09181625141201",
        '~' => "~04163446",
        '°' => "~1807162718",
        '×' => "0347 0743",
        'µ' | 'μ' => "0600 0603122233 3632",
        '±' => "2428 0646 0242",
        '·' => "0505",
        _ => "0208484202",
    }
}

/// Space between letters, in grid units.
const GAP: f32 = 2.2;
/// Width of the space between words, in grid units.
const WORD_GAP: f32 = 1.4;

fn strokes(character: char) -> impl Iterator<Item = Vec<[f32; 2]>> {
    glyph(character).split_whitespace().map(|stroke| {
        let (digits, round) = match stroke.strip_prefix('~') {
            Some(rest) => (rest, true),
            None => (stroke, false),
        };
        let points: Vec<[f32; 2]> = digits
            .as_bytes()
            .chunks_exact(2)
            .map(|pair| [0, 1].map(|i| f32::from(pair[i] - b'0')))
            .collect();
        if round { rounded(&points) } else { points }
    })
}

/// A smooth curve through the points (Catmull-Rom), closed if the last is the first.
fn rounded(points: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let count = points.len();
    let closed = points.first() == points.last();
    let at = |i: isize| -> [f32; 2] {
        let last = count as isize - 1;
        if closed {
            points[i.rem_euclid(last) as usize]
        } else {
            points[i.clamp(0, last) as usize]
        }
    };
    let mut curve = vec![points[0]];
    for i in 0..count as isize - 1 {
        let [p, q, r, s] = [at(i - 1), at(i), at(i + 1), at(i + 2)];
        for step in 1..=4_u8 {
            let t = f32::from(step) / 4.0;
            curve.push([0, 1].map(|axis| {
                let (p, q, r, s) = (p[axis], q[axis], r[axis], s[axis]);
                0.5 * (2.0 * q
                    + (r - p) * t
                    + (2.0 * p - 5.0 * q + 4.0 * r - s) * t * t
                    + (3.0 * q - p - 3.0 * r + s) * t * t * t)
            }));
        }
    }
    curve
}

fn advance(character: char) -> f32 {
    if character == ' ' {
        return WORD_GAP + GAP;
    }
    strokes(character)
        .flatten()
        .map(|p| p[0])
        .fold(0.0, f32::max)
        + GAP
}

/// Where a text stands relative to its anchor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Begins at the anchor.
    Left,
    /// Is centred on it.
    Middle,
    /// Ends at it.
    Right,
}

/// Width of a text whose capitals are `size` pixels high.
pub fn text_width(text: &str, size: f32) -> f32 {
    (text.chars().map(advance).sum::<f32>() - GAP).max(0.0) * size / 6.0
}

impl Image {
    /// Writes a line of text; `y` is its base line, `size` the height of capitals in pixels.
    pub fn text(&mut self, text: &str, x: f32, y: f32, size: f32, anchor: Anchor, colour: Srgb) {
        let unit = size / 6.0;
        let width = text_width(text, size);
        let mut pen = match anchor {
            Anchor::Left => x,
            Anchor::Middle => x - width / 2.0,
            Anchor::Right => x - width,
        };
        let thickness = (0.82 * unit).max(1.15);
        for character in text.chars() {
            for stroke in strokes(character) {
                let points: Vec<[f32; 2]> = stroke
                    .iter()
                    .map(|p| [pen + p[0] * unit, y - (p[1] - 2.0) * unit])
                    .collect();
                self.polyline(&points, thickness, colour);
            }
            pen += advance(character) * unit;
        }
    }

    /// Draws a line through points with round ends, blended once where it crosses itself.
    pub fn polyline(&mut self, points: &[[f32; 2]], thickness: f32, colour: Srgb) {
        let half = thickness / 2.0;
        let Some(first) = points.first() else { return };
        let (mut low, mut high) = (*first, *first);
        for p in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        let pixel = |value: f32, limit: usize| (value.max(0.0) as usize).min(limit);
        for row in pixel(low[1] - half - 1.0, self.height)..pixel(high[1] + half + 2.0, self.height)
        {
            for column in
                pixel(low[0] - half - 1.0, self.width)..pixel(high[0] + half + 2.0, self.width)
            {
                let at = [column as f32 + 0.5, row as f32 + 0.5];
                let distance = if points.len() == 1 {
                    (at[0] - first[0]).hypot(at[1] - first[1])
                } else {
                    points
                        .windows(2)
                        .map(|ends| distance_to_segment(at, ends[0], ends[1]))
                        .fold(f32::MAX, f32::min)
                };
                let cover = (half + 0.5 - distance).clamp(0.0, 1.0);
                if cover > 0.0 {
                    self.blend(column, row, colour, cover);
                }
            }
        }
    }

    /// Fills an upright box.
    pub fn fill(&mut self, low: [f32; 2], high: [f32; 2], colour: Srgb) {
        let inside = |low: f32, high: f32, cell: usize| {
            (high.min(cell as f32 + 1.0) - low.max(cell as f32)).clamp(0.0, 1.0)
        };
        let pixel = |value: f32, limit: usize| (value.max(0.0) as usize).min(limit);
        for row in pixel(low[1], self.height)..pixel(high[1] + 1.0, self.height) {
            for column in pixel(low[0], self.width)..pixel(high[0] + 1.0, self.width) {
                let cover = inside(low[0], high[0], column) * inside(low[1], high[1], row);
                if cover > 0.0 {
                    self.blend(column, row, colour, cover);
                }
            }
        }
    }
}

fn distance_to_segment(at: [f32; 2], a: [f32; 2], b: [f32; 2]) -> f32 {
    let (along, to) = ([b[0] - a[0], b[1] - a[1]], [at[0] - a[0], at[1] - a[1]]);
    let length = along[0] * along[0] + along[1] * along[1];
    let t = if length > 0.0 {
        ((to[0] * along[0] + to[1] * along[1]) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (to[0] - t * along[0]).hypot(to[1] - t * along[1])
}

/// A number with about three digits, as short as it goes: 0.05, 12.5, 3e-7.
pub fn short_number(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let size = value.abs();
    if !(1e-4..1e6).contains(&size) {
        let text = format!("{value:.2e}");
        let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        let digits = if digits.contains('.') {
            digits.trim_end_matches('0').trim_end_matches('.')
        } else {
            digits
        };
        return format!("{digits}e{exponent}");
    }
    let decimals = (2 - size.log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// The largest of 1, 2, 5 times a power of ten that is not above `value` (1 if that is not positive).
pub fn round_length(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 1.0;
    }
    let power = 10_f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0]
        .into_iter()
        .map(|step| step * power)
        .find(|length| *length <= value * (1.0 + 1e-12))
        .unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_printable_character_has_strokes_on_the_grid() {
        for code in 33..127_u8 {
            let character = char::from(code);
            {
                assert!(glyph(character) != glyph('\u{1}'), "{character} is missing");
            }
            for point in strokes(character).flatten() {
                assert!(
                    (-1.0..=7.0).contains(&point[0]) && (-1.0..=10.0).contains(&point[1]),
                    "{character}"
                );
            }
        }
    }

    #[test]
    fn text_marks_pixels_between_its_ends_only() {
        let mut image = Image::blank(100, 40, Srgb([255; 3]));
        image.text("Hx", 10.0, 30.0, 12.0, Anchor::Left, Srgb([0; 3]));
        let dark = |column: usize| (0..40).any(|row| image.pixel(column, row)[0] < 128);
        assert!(!(0..8).any(dark));
        assert!((8..12).any(dark));
        let end = 10.0 + text_width("Hx", 12.0);
        assert!(!(end as usize + 3..100).any(dark));
    }

    #[test]
    fn numbers_are_short_and_lengths_are_round() {
        let cases = [
            (0.0, "0"),
            (0.05, "0.05"),
            (12.5, "12.5"),
            (123.4, "123"),
            (-0.001, "-0.001"),
            (3e-7, "3e-7"),
            (1.25e-5, "1.25e-5"),
            (2e7, "2e7"),
        ];
        for (value, text) in cases {
            assert_eq!(short_number(value), text);
        }
        for (value, length) in [
            (0.37, 0.2),
            (1.0, 1.0),
            (99.0, 50.0),
            (6e-5, 5e-5),
            (0.0, 1.0),
        ] {
            assert!((round_length(value) / length - 1.0).abs() < 1e-9, "{value}");
        }
    }
}
