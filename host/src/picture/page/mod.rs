//! The report page: one HTML file that needs no network and no server.
//!
//! The three-dimensional view is drawn by three.js, of which the file holds what it uses (`vendor/three/`: one script of 0.6 MB
//! with its MIT licence at the head, made by its `build`). A still picture stands in for it where there is no WebGL,
//! and all tables and charts are plain HTML and SVG, so they print and read without a script. Two ways were weighed: a
//! WebGL program of our own (a twentieth of the size, but shaders, buffers, wide lines, camera control and picking to keep
//! alive through browsers and devices that we don't have), and a library that thousands use; so the latter. Modules with an
//! import map were left too: pages opened as files may not import files, and a script needs no such thing.

mod charts;
mod layers;
mod tables;

use super::PictureError;
use super::camera::{Camera, Projection, View};
use super::colour::Colour;
use super::scene::{Balls, Body, Paint, Scene};
use super::stages::{feet_on_surface, patch_borders};
use super::web::{self, base64, escaped};
use crate::cloud::Cloud;
use crate::export::SurfaceFile;
use crate::mesh::TriangleMesh;
use crate::report::Report;
use crate::spline::SampledSurface;

const PAGE: &str = include_str!("page.html");
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
    /// Triangles of phase 1, where they are at hand.
    pub extracted: Option<&'a TriangleMesh>,
    /// Triangles of phase 2, where they are at hand.
    pub simplified: Option<&'a TriangleMesh>,
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
        body.push_str(&charts::charts(self, &feet));
        body.push_str(&facts.figures());
        body.push_str(&facts.phases());
        body.push_str(&facts.origin());
        let parts = [
            ("title", escaped(self.title)),
            ("style", web::STYLE.to_owned()),
            ("verdict", facts.verdict()),
            ("poster", base64(&poster)),
            ("body", body),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("scene", self.scene(&sampled, &feet)),
            ("three", web::THREE.to_owned()),
            ("script", format!("{}{VIEWER}", web::SPACE)),
        ];
        Ok(web::filled(PAGE, &parts))
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::stages::tests::faceted_ball;

    #[test]
    fn page_is_whole_self_contained_and_holds_what_was_given() {
        let (cloud, mesh, surface) = faceted_ball();
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
            extracted: Some(&mesh),
            simplified: None,
        };
        let whole = page.html().unwrap();
        assert_eq!(
            whole.matches(web::THREE).count(),
            1,
            "library and its licence"
        );
        let html = whole.replace(web::THREE, "");
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
        assert_eq!(scene["fields"].as_array().unwrap().len(), 4);
        assert_eq!(scene["meshes"].as_array().unwrap().len(), 1);
        // 42 points of three 4-byte numbers in base 64.
        assert_eq!(
            scene["points"]["positions"].as_str().unwrap().len(),
            42 * 12 / 3 * 4
        );
        assert!(whole == page.html().unwrap());
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
            extracted: None,
            simplified: None,
        };
        assert!(matches!(page.html(), Err(PictureError::Surface(_))));
    }
}
