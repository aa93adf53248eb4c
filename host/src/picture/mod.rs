//! Pictures without a graphics card: the stages of a reconstruction as PNG files.
//!
//! | file | holds |
//! |---|---|
//! | `stages` | which figures there are and what is on them |
//! | `scene` | bodies, balls and lines in space |
//! | `camera` | view, framing, projection |
//! | `raster`, `shade` | from a scene to pixels |
//! | `lettering`, `legend` | titles, legends, scale bars |
//! | `page` | the report page: one HTML file |
//! | `fields` | numbers over a surface, for maps |
//! | `web` | what the report page and the live page share |
//! | `colour`, `image` | colours and colour maps, pixels, PNG |
//!
//! Guaranteed: the same input gives the same bytes on any number of threads; all figures of a set are seen
//! by one camera. Nothing here fails on bad geometry: what is not finite is left out.

mod camera;
mod colour;
mod fields;
mod image;
mod legend;
mod lettering;
mod page;
mod raster;
mod scene;
mod shade;
mod stages;
pub(crate) mod web;

use std::path::PathBuf;

pub use camera::{Camera, Projection, View};
pub use colour::{Colour, ColourMap, Srgb};
pub use image::Image;
pub use legend::{Caption, Legend};
pub use lettering::{Anchor, round_length, short_number, text_width};
pub use page::Page;
pub use scene::{Balls, Body, INSIDE, Lines, Paint, Scene};
pub use stages::{FigureOptions, Foot, Stages, feet_on_surface, open_borders, patch_borders};

/// Why a picture could not be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// The text is no view.
    #[error(
        "{0:?} is no view: give azimuth and elevation in degrees, such as -60,25 (elevation -90 to 90)"
    )]
    View(String),
    /// A picture of this size cannot be drawn.
    #[error("a picture of {width} x {height} pixels cannot be drawn: use 64 to 8192 for both")]
    Size {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The file cannot be written.
    #[error("cannot write {path}: {reason}; choose another folder or make room")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// A picture cannot be turned into a PNG.
    #[error("cannot encode the picture: {0}")]
    Encode(String),
    /// The surface is no valid network.
    #[error(transparent)]
    Surface(#[from] crate::spline::SurfaceError),
}
