//! The frame in which a reconstruction computes: centred, of unit size.
//!
//! All thresholds then mean the same for a thimble in metres and a statue in millimetres, and coordinates far
//! from the origin lose no digits to cancellation.

use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::TriangleMesh;
use crate::spline::Surface;

/// Translation and scale from the input's coordinates to unit size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Centre of the bounding box, in the input's coordinates.
    pub centre: Vec3,
    /// Diagonal of the bounding box, in the input's unit.
    pub scale: f64,
}

impl Frame {
    /// The frame of a cloud; `None` if it has no extent or is not finite.
    pub fn of(cloud: &Cloud) -> Option<Self> {
        let (low, high) = cloud.bounding_box()?;
        let scale = (high - low).norm();
        let centre = low + (high - low) / 2.0;
        (scale > 0.0 && scale.is_finite() && centre.iter().all(|x| x.is_finite()))
            .then_some(Self { centre, scale })
    }

    /// A position in this frame.
    pub fn enter(&self, position: Vec3) -> Vec3 {
        (position - self.centre) / self.scale
    }

    /// A position back in the input's coordinates.
    pub fn leave(&self, position: Vec3) -> Vec3 {
        position * self.scale + self.centre
    }

    /// A cloud in this frame.
    pub fn cloud(&self, cloud: &Cloud) -> Cloud {
        let mut out = Cloud {
            points: cloud.points.clone(),
            rejected: Vec::new(),
        };
        for point in &mut out.points {
            point.position = self.enter(point.position);
            point.sigma = point.sigma.map(|s| s / self.scale);
        }
        out
    }

    /// A mesh back in the input's coordinates.
    pub fn mesh(&self, mesh: &TriangleMesh) -> TriangleMesh {
        TriangleMesh {
            positions: mesh.positions.iter().map(|p| self.leave(*p)).collect(),
            faces: mesh.faces.clone(),
        }
    }

    /// A surface back in the input's coordinates.
    pub fn surface(&self, surface: &Surface) -> Surface {
        Surface {
            vertices: surface.vertices.iter().map(|p| self.leave(*p)).collect(),
            faces: surface.faces.clone(),
            control_points: surface
                .control_points
                .iter()
                .map(|patch| patch.map(|p| self.leave(p)))
                .collect(),
            creases: surface.creases.clone(),
            sigma: surface.sigma.iter().map(|s| s * self.scale).collect(),
        }
    }
}
