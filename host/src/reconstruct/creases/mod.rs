//! Creases and corners of the touched object, found in the measured points and cut into the extracted mesh.
//!
//! The paper leaves sharp features for future work; the extraction rounds them off. Here they are found from
//! the points alone (`regions`): smooth sheets are grown over the points, and where two sheets, carried on
//! from their own side, meet at an angle between the points, the surface breaks. The dense mesh is then cut
//! along those lines (`cut`): its vertices there are put on the true edge, where both sheets meet, also
//! where no point lies on it, and the rounded strip beside it is put back onto the sheets.
//!
//! Two ways were weighed: to look for high curvature in the extracted mesh (needs no points, but a thin rim
//! of a mug bends as sharply there as a rounded-off crease does) and to ask the points, which show the
//! rim's turning normals and do not show any at a crease. The second was taken.
//!
//! What it does not see: creases that turn by less than [`CreaseOptions::turn_min_degrees`], sheets with
//! fewer than eight points, and creases sharper than about 135 degrees of turn.

mod cut;
mod ramp;
mod regions;
mod sheet;
mod tidy;

use super::extract::Field;
use super::simplify::CreaseLines;
use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::{MeshError, TriangleMesh};
use regions::Regions;
pub use sheet::Scatter;

/// What counts as a crease.
#[derive(Clone, Debug, PartialEq)]
pub struct CreaseOptions {
    /// Least angle by which the surface turns at a crease, degrees.
    pub turn_min_degrees: f64,
}

impl Default for CreaseOptions {
    fn default() -> Self {
        Self {
            turn_min_degrees: 35.0,
        }
    }
}

/// A dense mesh with its creases along edges.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Creased {
    /// The mesh; without creases the one that was handed in.
    pub mesh: TriangleMesh,
    /// The crease edges and corners in it.
    pub lines: CreaseLines,
    /// How many smooth sheets the points form.
    pub sheets: usize,
    /// Scatter of the points about those sheets.
    pub scatter: Option<Scatter>,
}

/// The smooth sheets that the points of a cloud form.
pub struct Sheets<'a> {
    /// `None` where there is nothing to find them in.
    regions: Option<Regions<'a>>,
    turn_min: f64,
}

impl<'a> Sheets<'a> {
    /// Finds the sheets of `cloud`. Same input, same result.
    pub fn of(cloud: &'a Cloud, options: &CreaseOptions) -> Self {
        let usable = |v: &Vec3| v.iter().all(|x| x.is_finite());
        let fine = cloud.points.len() >= 20
            && cloud
                .points
                .iter()
                .all(|p| usable(&p.position) && usable(&p.normal));
        let turn_min = options.turn_min_degrees.to_radians();
        Self {
            regions: fine.then(|| Regions::new(cloud, turn_min)),
            turn_min,
        }
    }

    /// The sheet of each point; [`NONE`](crate::mesh::NONE) where it fits none.
    pub fn labels(&self) -> &[u32] {
        self.regions.as_ref().map_or(&[], |r| &r.label)
    }

    /// Pairs of sheets between which the surface breaks.
    pub fn sharp(&self) -> &[[u32; 2]] {
        self.regions.as_ref().map_or(&[], |r| &r.sharp)
    }

    /// Cuts `mesh`, which was extracted from the same points, along the lines where the surface breaks. The `field` that it was
    /// extracted from tells the sheet of a place on it, which sheets are one plane or quadric, and which break besides
    /// [`Self::sharp`]; without, the points near by have to do.
    ///
    /// # Errors
    /// When `mesh` is no oriented manifold.
    pub fn cut(&self, mesh: &TriangleMesh, field: Option<&Field>) -> Result<Creased, MeshError> {
        let plain = || Creased {
            mesh: mesh.clone(),
            ..Creased::default()
        };
        let Some(regions) = &self.regions else {
            return Ok(plain());
        };
        let mut out = if regions.sharp.is_empty() {
            plain()
        } else {
            let mut sharp = regions.sharp.clone();
            sharp.extend(field.map_or_else(Vec::new, Field::sharp));
            sharp.sort_unstable();
            sharp.dedup();
            cut::cut(regions, &sharp, mesh, field, self.turn_min)?
        };
        out.sheets = regions.names().len();
        out.scatter = Some(regions.scatter);
        Ok(out)
    }
}

#[cfg(test)]
mod tests;
