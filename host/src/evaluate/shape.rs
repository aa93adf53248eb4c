//! The forms in which a shape can come: a surface, a mesh, or points with normals.

use super::foot::SurfaceLocator;
use super::points::PointSet;
use super::{Described, EvaluateError};
use crate::Vec3;
use crate::cloud::{self, Cloud};
use crate::export::SurfaceFile;
use crate::import;
use crate::mesh::{AabbTree, TriangleMesh, sample_by_area, topology};
use crate::ply::Header;
use crate::spline::Surface;
use std::fs;
use std::path::Path;

/// A place on a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Where.
    pub position: Vec3,
    /// Unit normal there: of the surface, of the mesh's triangle, or of the point.
    pub normal: Vec3,
    /// Interpolated vertex normal of a mesh.
    pub smooth_normal: Option<Vec3>,
}

/// What of a shape is nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// Distance.
    pub distance: f64,
    /// Unit normal there.
    pub normal: Vec3,
}

/// A shape, ready for queries.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A network of patches.
    Surface(Described, Box<SurfaceLocator>),
    /// Triangles, with their tree and vertex normals.
    Mesh(Described, TriangleMesh, AabbTree, Vec<Vec3>),
    /// Points.
    Points(Described, PointSet),
}

impl Shape {
    /// Reads a surface file, a mesh or points, by content and extension. A PLY file is a mesh if it has faces.
    ///
    /// # Errors
    /// Those of the reader that the file calls for.
    pub fn read(path: &Path) -> Result<Self, EvaluateError> {
        let file = path.display().to_string();
        let bytes = fs::read(path).map_err(|source| cloud::ReadError::Open {
            file: file.clone(),
            source,
        })?;
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        let faces = || {
            Header::parse(&bytes)
                .is_ok_and(|h| h.elements.iter().any(|e| *e.name == *"face" && e.count > 0))
        };
        if extension.as_deref() == Some("json") || bytes.starts_with(b"{") {
            Self::surface(&file, SurfaceFile::from_bytes(&file, &bytes)?.surface)
        } else if matches!(extension.as_deref(), Some("obj" | "stl" | "glb"))
            || (Header::detect(&bytes) && faces())
        {
            Ok(Self::mesh(&file, import::mesh_from_bytes(&file, &bytes)?))
        } else {
            Ok(Self::points(&file, cloud::from_bytes(&file, &bytes)?))
        }
    }

    /// A surface.
    ///
    /// # Errors
    /// A surface that is no valid network.
    pub fn surface(file: &str, surface: Surface) -> Result<Self, EvaluateError> {
        let measures = surface.measure()?;
        let net = TriangleMesh {
            positions: surface.vertices.clone(),
            faces: surface.faces.clone(),
        };
        let locator = SurfaceLocator::new(surface)?;
        let described = Described {
            file: file.to_owned(),
            kind: "surface",
            bbox_diagonal: locator.mesh().diagonal(),
            topology: Some(topology(&net).into()),
            g1_max_degrees: Some(measures.g1_max_degrees),
            points: None,
        };
        Ok(Self::Surface(described, Box::new(locator)))
    }

    /// A mesh.
    pub fn mesh(file: &str, mesh: TriangleMesh) -> Self {
        let described = Described {
            file: file.to_owned(),
            kind: "mesh",
            bbox_diagonal: mesh.diagonal(),
            topology: Some(topology(&mesh).into()),
            ..Described::default()
        };
        let (tree, normals) = (AabbTree::new(&mesh), mesh.vertex_normals());
        Self::Mesh(described, mesh, tree, normals)
    }

    /// Points with normals.
    pub fn points(file: &str, cloud: Cloud) -> Self {
        let described = Described {
            file: file.to_owned(),
            kind: "points",
            bbox_diagonal: cloud.diagonal(),
            points: Some(cloud.points.len()),
            ..Described::default()
        };
        Self::Points(described, PointSet::new(&cloud))
    }

    /// What the shape is.
    pub fn describe(&self) -> Described {
        match self {
            Self::Surface(described, ..)
            | Self::Mesh(described, ..)
            | Self::Points(described, ..) => described.clone(),
        }
    }

    /// `count` places spread evenly by area; of points, every one.
    pub fn places(&self, count: usize) -> Vec<Place> {
        match self {
            Self::Surface(_, locator) => {
                let place = |sample: &crate::mesh::Sample| {
                    let (face, at) = locator.parameters(sample.face as usize, sample.barycentric);
                    Place {
                        position: locator.surface().point(face, at),
                        normal: locator.surface().normal(face, at),
                        smooth_normal: None,
                    }
                };
                sample_by_area(locator.mesh(), count)
                    .iter()
                    .map(place)
                    .collect()
            }
            Self::Mesh(_, mesh, _, normals) => {
                let place = |sample: &crate::mesh::Sample| {
                    let corners = mesh.faces[sample.face as usize];
                    let weighted = corners
                        .iter()
                        .zip(sample.barycentric)
                        .fold(Vec3::zeros(), |sum, (v, w)| sum + normals[*v as usize] * w);
                    let normal = mesh.face_normal(sample.face);
                    Place {
                        position: sample.position,
                        normal,
                        smooth_normal: Some(weighted.try_normalize(0.0).unwrap_or(normal)),
                    }
                };
                sample_by_area(mesh, count).iter().map(place).collect()
            }
            Self::Points(_, set) => set
                .points()
                .map(|(position, normal)| Place {
                    position,
                    normal,
                    smooth_normal: None,
                })
                .collect(),
        }
    }

    /// Distance to the nearest part of the shape and the normal there; `None` for an empty shape.
    pub fn foot(&self, point: &Vec3) -> Option<Foot> {
        match self {
            Self::Surface(_, locator) => {
                let foot = locator.foot(point)?;
                let normal = locator.surface().normal(foot.face, foot.barycentric);
                Some(Foot {
                    distance: foot.distance,
                    normal,
                })
            }
            Self::Mesh(_, mesh, tree, _) => {
                let foot = tree.closest(mesh, point)?;
                Some(Foot {
                    distance: foot.distance,
                    normal: mesh.face_normal(foot.face),
                })
            }
            Self::Points(_, set) => {
                let (distance, normal) = set.distance(point)?;
                Some(Foot { distance, normal })
            }
        }
    }
}
