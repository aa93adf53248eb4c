//! The report page: one HTML file that needs no network, no library and no server.
//!
//! The three-dimensional view is drawn by a small WebGL 2 program of our own (`viewer.js`, put into the file as it
//! stands); a still picture stands in for it where there is no WebGL, and all tables and charts are plain HTML and SVG,
//! so they print and read without a script. A library such as three.js was weighed and left: it is ten times the
//! size of the page for a fraction of its use.

mod charts;
mod tables;

use std::fmt::Write as _;

use super::camera::{Camera, Projection, View};
use super::colour::{Colour, ColourMap};
use super::scene::{Balls, Body, Lines, Paint, Scene};
use super::stages::{Foot, feet_on_surface, patch_borders, quantile};
use super::{PictureError, Srgb};
use crate::Vec3;
use crate::cloud::Cloud;
use crate::export::SurfaceFile;
use crate::report::Report;
use crate::spline::SampledSurface;
use crate::spline::bernstein::{DEGREE, index};

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("style.css");
const VIEWER: &str = include_str!("viewer.js");

/// Triangles that the page may hold: about a megabyte and a half, and smooth on a phone.
const TRIANGLES: usize = 60_000;

/// What a report page is made from.
#[derive(Clone, Copy, Debug)]
pub struct Page<'a> {
    /// Name of the surface, as its heading.
    pub title: &'a str,
    /// The surface file.
    pub file: &'a SurfaceFile,
    /// The figures of the reconstruction, where they are at hand.
    pub report: Option<&'a Report>,
    /// The points, where they are at hand.
    pub cloud: Option<&'a Cloud>,
}

impl Page<'_> {
    /// The page, ready to be written to a file.
    ///
    /// # Errors
    /// [`PictureError::Surface`] if the surface is no valid network.
    pub fn html(&self) -> Result<String, PictureError> {
        let surface = &self.file.surface;
        let measures = surface.measure()?;
        let per_side = (TRIANGLES / surface.faces.len().max(1))
            .isqrt()
            .clamp(3, 24);
        let sampled = surface.sample_per_patch(per_side)?;
        let points = self.cloud.map_or(&[][..], |cloud| &cloud.points);
        let feet = feet_on_surface(&sampled, points);
        let poster = self.poster(&sampled)?;
        let facts = tables::Facts {
            page: self,
            measures: &measures,
            sampled: &sampled,
            feet: &feet,
        };
        let mut body = String::new();
        body.push_str(&charts::charts(self.report, &feet, self.tolerance()));
        body.push_str(&facts.figures());
        body.push_str(&facts.phases());
        body.push_str(&facts.origin());
        let parts = [
            ("title", escaped(self.title)),
            ("style", STYLE.to_owned()),
            ("verdict", facts.verdict()),
            ("poster", base64(&poster)),
            ("body", body),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("scene", self.scene(&sampled, &feet)),
            ("script", VIEWER.to_owned()),
        ];
        // One pass, so that braces in a value are never taken for a place to fill.
        let mut html = String::with_capacity(4_000_000);
        let mut rest = PAGE;
        while let Some((before, after)) = rest.split_once("{{") {
            html.push_str(before);
            let (name, after) = after.split_once("}}").unwrap_or((after, ""));
            if let Some((_, value)) = parts.iter().find(|(part, _)| *part == name) {
                html.push_str(value);
            }
            rest = after;
        }
        html.push_str(rest);
        Ok(html)
    }

    fn tolerance(&self) -> Option<f64> {
        let error = self.report.and_then(|report| report.error.as_ref());
        error
            .or(self.file.error.as_ref())
            .map(|error| error.tolerance)
    }

    fn unit(&self) -> &str {
        self.file.units.as_deref().unwrap_or("")
    }

    /// A still picture as PNG.
    fn poster(&self, sampled: &SampledSurface) -> Result<Vec<u8>, PictureError> {
        let scene = Scene {
            bodies: vec![Body::smooth(sampled, Paint::Plain(Colour::hex(0x9DB7CF)))],
            lines: patch_borders(&self.file.surface),
            balls: Vec::<Balls>::new(),
        };
        let camera = Camera::framing(
            View::default(),
            Projection::Perspective,
            scene.positions(),
            4.0 / 3.0,
        );
        scene.render(&camera, 800, 600).to_png()
    }

    /// Everything the script draws, as JSON with binary parts in base 64.
    fn scene(&self, sampled: &SampledSurface, feet: &[Foot]) -> String {
        let surface = &self.file.surface;
        let finite = sampled
            .positions
            .iter()
            .filter(|p| p.iter().all(|x| x.is_finite()));
        let (low, high) = finite.fold(
            (Vec3::repeat(f64::MAX), Vec3::repeat(f64::MIN)),
            |(low, high), p| (low.inf(p), high.sup(p)),
        );
        let centre = if low.x <= high.x {
            (low + high) / 2.0
        } else {
            Vec3::zeros()
        };
        let radius = sampled
            .positions
            .iter()
            .map(|p| (p - centre).norm())
            .fold(0.0, f64::max);
        let radius = if radius > 0.0 { radius } else { 1.0 };
        let around = |points: &mut dyn Iterator<Item = Vec3>| {
            base64(
                &points
                    .flat_map(|p| (p - centre).data.0[0].map(|x| (x as f32).to_le_bytes()))
                    .flatten()
                    .collect::<Vec<u8>>(),
            )
        };
        let numbers = |values: &mut dyn Iterator<Item = f64>| {
            base64(
                &values
                    .flat_map(|x| (x as f32).to_le_bytes())
                    .collect::<Vec<u8>>(),
            )
        };
        let whole = |values: &mut dyn Iterator<Item = u32>| {
            base64(&values.flat_map(u32::to_le_bytes).collect::<Vec<u8>>())
        };
        let normals: Vec<u8> = sampled
            .normals
            .iter()
            .flat_map(|n| n.data.0[0].map(|x| ((x * 32767.0).round() as i16).to_le_bytes()))
            .flatten()
            .collect();

        let mut out = String::from("{");
        let unit = if self.unit().is_empty() {
            "null".to_owned()
        } else {
            json(self.unit())
        };
        let _ = write!(
            out,
            "\"unit\":{unit},\"centre\":[{:?},{:?},{:?}],\"radius\":{radius:?},",
            centre.x, centre.y, centre.z
        );
        let _ = write!(
            out,
            "\"surface\":{{\"positions\":\"{}\",\"normals\":\"{}\",\"triangles\":\"{}\",\"patches\":\"{}\"}},",
            around(&mut sampled.positions.iter().copied()),
            base64(&normals),
            whole(&mut sampled.triangles.iter().flatten().copied()),
            whole(&mut sampled.patches.iter().copied()),
        );
        out.push_str("\"maps\":{");
        for (number, (name, map)) in MAPS.iter().enumerate() {
            let colours: Vec<u8> = (0..=255_u8)
                .flat_map(|i| map.colour(f64::from(i) / 255.0).to_srgb())
                .collect();
            let comma = if number == 0 { "" } else { "," };
            let _ = write!(out, "{comma}\"{name}\":\"{}\"", base64(&colours));
        }
        out.push_str("},\"fields\":[");
        for (number, field) in self.fields(sampled).iter().enumerate() {
            let comma = if number == 0 { "" } else { "," };
            let _ = write!(
                out,
                "{comma}{{\"name\":{},\"low\":{:?},\"high\":{:?},\"map\":\"{}\",\"values\":\"{}\"}}",
                json(&field.name),
                field.low,
                field.high,
                field.map,
                numbers(&mut field.values.iter().copied()),
            );
        }
        out.push_str("],\"lines\":[");
        let mut first = true;
        for layer in self.lines(radius) {
            let colour = layer.colour.map_or("null".to_owned(), |Srgb(rgb)| {
                let [r, g, b] = rgb.map(|x| f32::from(x) / 255.0);
                format!("[{r},{g},{b}]")
            });
            let _ = write!(
                out,
                "{}{{\"name\":\"{}\",\"on\":{},\"width\":{},\"opacity\":{},\"colour\":{colour},\"segments\":\"{}\"}}",
                if first { "" } else { "," },
                layer.name,
                layer.on,
                layer.width,
                layer.opacity,
                around(&mut layer.segments.iter().flatten().copied()),
            );
            first = false;
        }
        out.push(']');
        if let Some(cloud) = self
            .cloud
            .filter(|cloud| cloud.points.len() == feet.len() && !feet.is_empty())
        {
            let distances: Vec<f64> = feet.iter().map(|foot| foot.distance).collect();
            let high = quantile(&distances, 0.98);
            let _ = write!(
                out,
                ",\"points\":{{\"positions\":\"{}\",\"distances\":\"{}\",\"angles\":\"{}\",\"high\":{:?},\"radius\":{}}}",
                around(&mut cloud.points.iter().map(|p| p.position)),
                numbers(&mut distances.iter().copied()),
                numbers(&mut feet.iter().map(|foot| foot.angle_degrees)),
                if high > 0.0 { high } else { 1.0 },
                (3.4 * (1200.0 / feet.len() as f64).sqrt()).clamp(1.4, 4.5),
            );
        }
        let _ = write!(out, ",\"patches\":{}}}", surface.faces.len());
        out
    }

    /// Numbers that colour the surface.
    fn fields(&self, sampled: &SampledSurface) -> Vec<Field> {
        let surface = &self.file.surface;
        let mut fields = Vec::new();
        let with_unit = |name: &str, power: &str| match self.unit() {
            "" => name.to_owned(),
            unit => format!("{name}, {power}{unit}"),
        };
        if !sampled.sigma.is_empty() {
            fields.push(Field {
                name: with_unit("confidence (standard deviation)", ""),
                low: quantile(&sampled.sigma, 0.0),
                high: quantile(&sampled.sigma, 0.99),
                map: "cividis",
                values: sampled.sigma.clone(),
            });
        }
        let curvatures: Vec<[f64; 2]> = sampled
            .parameters
            .iter()
            .map(|(patch, at)| {
                surface
                    .curvature(*patch as usize, *at)
                    .unwrap_or([f64::NAN; 2])
            })
            .collect();
        for (number, name) in ["mean curvature", "Gaussian curvature"]
            .into_iter()
            .enumerate()
        {
            let values: Vec<f64> = curvatures.iter().map(|c| c[number]).collect();
            let sizes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
            let high = quantile(&sizes, 0.95);
            fields.push(Field {
                name: with_unit(name, if number == 0 { "1/" } else { "1/square " }),
                low: -high,
                high,
                map: "blue-brown",
                values,
            });
        }
        for field in &mut fields {
            let widest = field.low.abs().max(field.high.abs()).max(1e-12);
            if field.high - field.low < 1e-9 * widest {
                field.high = field.low + 1e-3 * widest;
            }
        }
        fields
    }

    /// Lines over the surface.
    fn lines(&self, radius: f64) -> Vec<LineLayer> {
        let surface = &self.file.surface;
        let names = |lines: &Lines| match (lines.colour, lines.width > 2.0) {
            (_, false) => ("patch borders", None, 1.5),
            (colour, true) if colour == Colour::hex(0xB3261E) => ("creases", Some(colour), 2.6),
            (_, true) => ("open border", None, 3.0),
        };
        let mut layers: Vec<LineLayer> = patch_borders(surface)
            .into_iter()
            .map(|lines| {
                let (name, colour, width) = names(&lines);
                LineLayer {
                    name,
                    on: true,
                    width,
                    opacity: 0.85,
                    colour,
                    segments: lines.segments,
                }
            })
            .collect();
        let net = surface.control_points.iter().flat_map(|points| {
            let at = |i: usize, j: usize, k: usize| points[index([i as u8, j as u8, k as u8])];
            (0..DEGREE).flat_map(move |i| {
                (0..DEGREE - i).flat_map(move |j| {
                    let k = DEGREE - 1 - i - j;
                    let [a, b, c] = [at(i + 1, j, k), at(i, j + 1, k), at(i, j, k + 1)];
                    [[a, b], [b, c], [c, a]]
                })
            })
        });
        layers.push(LineLayer {
            name: "control net",
            on: false,
            width: 0.9,
            opacity: 0.7,
            colour: Some(Colour::hex(0x8A5FA8)),
            segments: net.collect(),
        });
        if let Some(cloud) = self.cloud.filter(|cloud| !cloud.points.is_empty()) {
            layers.push(LineLayer {
                name: "measured normals",
                on: false,
                width: 1.2,
                opacity: 1.0,
                colour: Some(Colour::hex(0xC8642B)),
                segments: cloud
                    .points
                    .iter()
                    .map(|p| [p.position, p.position + p.normal * (0.055 * radius)])
                    .collect(),
            });
        }
        layers
    }
}

const MAPS: [(&str, ColourMap); 3] = [
    ("viridis", ColourMap::Viridis),
    ("cividis", ColourMap::Cividis),
    ("blue-brown", ColourMap::BlueBrown),
];

/// Numbers over the surface with the range of their colours.
struct Field {
    name: String,
    low: f64,
    high: f64,
    map: &'static str,
    values: Vec<f64>,
}

/// Lines that can be switched on and off; without a colour they take that of the page's edges.
struct LineLayer {
    name: &'static str,
    on: bool,
    width: f64,
    opacity: f64,
    colour: Option<Srgb>,
    segments: Vec<[Vec3; 2]>,
}

/// Text for HTML.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            _ => out.push(character),
        }
    }
    out
}

/// Text as a JSON string that cannot end the script element it stands in.
fn json(text: &str) -> String {
    serde_json::Value::from(text)
        .to_string()
        .replace('<', "\\u003c")
}

/// Base 64 (RFC 4648) with padding.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = (0..3).fold(0_u32, |bits, i| {
            bits << 8 | u32::from(group.get(i).copied().unwrap_or(0))
        });
        for digit in 0..4 {
            if digit <= group.len() {
                out.push(char::from(DIGITS[(bits >> (18 - 6 * digit) & 63) as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::stages::tests::faceted_ball;

    #[test]
    fn base64_follows_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xFB, 0xFF]), "+/8=");
    }

    #[test]
    fn page_is_whole_self_contained_and_holds_what_was_given() {
        let (cloud, _, surface) = faceted_ball();
        let file = SurfaceFile {
            surface,
            units: Some("mm".to_owned()),
            ..SurfaceFile::default()
        };
        let page = Page {
            title: "<b>\"ball\" & </script>",
            file: &file,
            report: None,
            cloud: Some(&cloud),
        };
        let html = page.html().unwrap();
        assert!(
            !html.contains("{{") && !html.contains("}}<"),
            "every place is filled"
        );
        assert!(html.contains("&lt;b&gt;&quot;ball&quot; &amp; &lt;/script&gt;"));
        for away in ["http://", "https://", " src=\"/", "@import", "url("] {
            assert!(!html.contains(away), "{away} leads out of the file");
        }
        let start = html.find("id=\"scene\">").unwrap() + "id=\"scene\">".len();
        let end = start + html[start..].find("</script>").unwrap();
        let scene: serde_json::Value = serde_json::from_str(&html[start..end]).unwrap();
        assert_eq!(scene["patches"], 80);
        assert_eq!(scene["unit"], "mm");
        assert_eq!(scene["fields"].as_array().unwrap().len(), 3);
        // 42 points of three 4-byte numbers in base 64.
        assert_eq!(
            scene["points"]["positions"].as_str().unwrap().len(),
            42 * 12 / 3 * 4
        );
        assert!(html == page.html().unwrap());
    }

    #[test]
    fn damaged_surfaces_are_refused() {
        let (_, _, mut surface) = faceted_ball();
        surface.control_points.pop();
        let file = SurfaceFile {
            surface,
            ..SurfaceFile::default()
        };
        let page = Page {
            title: "ball",
            file: &file,
            report: None,
            cloud: None,
        };
        assert!(matches!(page.html(), Err(PictureError::Surface(_))));
    }
}
