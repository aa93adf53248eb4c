//! The paper's field: signed distance to the nearest averaged tangent plane.
//!
//! Contacts are gathered in narrow regions; each region's mean point and mean normal span a plane, and the value at x is
//! the distance to the plane of the nearest mean point ("Curved Surface Reconstruction Using Active Tactile
//! Sensing and Surface Normal Information", section 4.1, after Hoppe et al. 1992).
//!
//! Kept for comparison. The field jumps wherever the nearest plane changes: in gaps and at thin walls its zero set is
//! stepped, where the default field is smooth.

use super::contacts::Normalised;
use crate::{Vec3, cloud::Neighbourhoods};

/// Radius of a region against the contacts' spacing: two to four contacts of a track fall into one.
const REGION: f64 = 0.9;
/// Least cosine between the normals of one region.
const SAME_SIDE: f64 = 0.7;

/// Averaged tangent planes, normalised coordinates.
#[derive(Clone, Debug)]
pub(super) struct TangentPlanes {
    centres: Neighbourhoods,
    normals: Vec<Vec3>,
}

impl TangentPlanes {
    /// Averages the contacts in regions; every contact belongs to one region.
    pub(super) fn new(data: &Normalised, tree: &Neighbourhoods, contact_spacing: f64) -> Self {
        let mut gathered = vec![false; data.positions.len()];
        let (mut centres, mut normals) = (Vec::new(), Vec::new());
        for i in 0..data.positions.len() {
            if gathered[i] {
                continue;
            }
            let (mut point, mut normal, mut count) = (Vec3::zeros(), Vec3::zeros(), 0.0);
            for (j, _) in tree.within(&data.positions[i], REGION * contact_spacing) {
                if !gathered[j] && data.normals[i].dot(&data.normals[j]) >= SAME_SIDE {
                    gathered[j] = true;
                    point += data.positions[j];
                    normal += data.normals[j];
                    count += 1.0;
                }
            }
            centres.push(point / count);
            normals.push(normal.normalize());
        }
        Self {
            centres: Neighbourhoods::new(centres),
            normals,
        }
    }

    /// Distance to the plane of the nearest mean point, and its normal.
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        self.centres
            .nearest_one(x)
            .map_or((f64::NAN, Vec3::zeros()), |(i, _)| {
                let n = self.normals[i];
                ((x - self.centres.positions()[i]).dot(&n), n)
            })
    }

    /// Number of planes.
    pub(super) fn len(&self) -> usize {
        self.normals.len()
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.normals.len() * 60
    }
}
