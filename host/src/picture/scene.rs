//! What is drawn: shaded triangles, balls and lines in space, in the unit of the input.

use super::colour::{Colour, ColourMap, Srgb};
use crate::Vec3;
use crate::mesh::TriangleMesh;
use crate::spline::SampledSurface;

/// How a body is coloured.
#[derive(Clone, Debug, PartialEq)]
pub enum Paint {
    /// One colour.
    Plain(Srgb),
    /// One number per vertex (or point), shown by a colour map from `low` to `high`.
    Scalar {
        /// The numbers; NaN is grey.
        values: Vec<f64>,
        /// Shown as the map's first colour.
        low: f64,
        /// Shown as the map's last colour.
        high: f64,
        /// The map.
        map: ColourMap,
    },
    /// One colour per vertex (or point).
    Each(Vec<Srgb>),
    /// What a polished surface would show of strip lights that run across the view: stripes that are continuous where
    /// the surface's tangent plane is and free of kinks where its curvature is.
    Reflections,
}

impl Paint {
    /// Colours of `count` vertices; grey where there is no value.
    pub(super) fn colours(&self, count: usize) -> Vec<Colour> {
        match self {
            Self::Plain(colour) => vec![(*colour).into(); count],
            Self::Scalar {
                values,
                low,
                high,
                map,
            } => (0..count)
                .map(|i| {
                    let value = values.get(i).copied().unwrap_or(f64::NAN);
                    let width = high - low;
                    map.colour(if width > 0.0 {
                        (value - low) / width
                    } else {
                        0.0 * value
                    })
                })
                .collect(),
            Self::Each(colours) => (0..count)
                .map(|i| {
                    colours
                        .get(i)
                        .copied()
                        .unwrap_or(Colour::hex(0xC8C8C8))
                        .into()
                })
                .collect(),
            Self::Reflections => vec![Colour::hex(0xF2F4F6).into(); count],
        }
    }
}

/// Triangles with a skin.
#[derive(Clone, Debug)]
pub struct Body {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Outward normals per vertex for smooth shading; empty for flat triangles.
    pub normals: Vec<Vec3>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Colours of the outside.
    pub paint: Paint,
    /// Colour of the inside, where the surface is open.
    pub inside: Srgb,
}

/// Colour of the inside of open surfaces unless told otherwise.
pub const INSIDE: Srgb = Colour::hex(0xB58F6A);

impl Body {
    /// A mesh shaded flat, so that its triangles show.
    pub fn flat(mesh: &TriangleMesh, paint: Paint) -> Self {
        Self {
            positions: mesh.positions.clone(),
            normals: Vec::new(),
            triangles: mesh.faces.clone(),
            paint,
            inside: INSIDE,
        }
    }

    /// A sampled surface shaded by its exact normals.
    pub fn smooth(sampled: &SampledSurface, paint: Paint) -> Self {
        Self {
            positions: sampled.positions.clone(),
            normals: sampled.normals.clone(),
            triangles: sampled.triangles.clone(),
            paint,
            inside: INSIDE,
        }
    }
}

/// Points as small balls of one size on the picture.
#[derive(Clone, Debug)]
pub struct Balls {
    /// Centres.
    pub centres: Vec<Vec3>,
    /// Radius in pixels of a picture 900 pixels high.
    pub radius: f32,
    /// Colours.
    pub paint: Paint,
    /// How far balls are lifted towards the viewer so that a surface through their centres does not hide them, as a
    /// share of the scene's size.
    pub lift: f64,
}

/// Line segments of one width on the picture.
#[derive(Clone, Debug)]
pub struct Lines {
    /// Ends of each segment.
    pub segments: Vec<[Vec3; 2]>,
    /// Width in pixels of a picture 900 pixels high.
    pub width: f32,
    /// Colour.
    pub colour: Srgb,
    /// 0 (not there) to 1 (covers).
    pub opacity: f32,
    /// How far segments are lifted towards the viewer so that the surface they lie on does not hide them, as a
    /// share of the scene's size.
    pub lift: f64,
}

/// Everything on a picture, apart from lettering.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Shaded bodies.
    pub bodies: Vec<Body>,
    /// Points.
    pub balls: Vec<Balls>,
    /// Lines.
    pub lines: Vec<Lines>,
}

impl Scene {
    /// Every position in the scene, to frame it.
    pub fn positions(&self) -> impl Iterator<Item = &Vec3> {
        let bodies = self.bodies.iter().flat_map(|body| &body.positions);
        let balls = self.balls.iter().flat_map(|balls| &balls.centres);
        let lines = self
            .lines
            .iter()
            .flat_map(|lines| lines.segments.iter().flatten());
        bodies.chain(balls).chain(lines)
    }
}
