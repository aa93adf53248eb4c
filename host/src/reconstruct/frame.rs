//! The frame in which a reconstruction computes: turned with the contacts, centred, of unit size.
//!
//! All thresholds then mean the same for a thimble in metres and a statue in millimetres, and coordinates far
//! from the origin lose no digits to cancellation.
//!
//! **What it promises.** Moved, turned or scaled contacts enter it with the same coordinates, to the last bit, and so
//! give the same surface up to the rounding of its own coordinates (tests/tests/invariance.rs has the figures). All
//! phases are full of decisions (marching cubes, holes, collapses, foot points), of which some rounding tips one now
//! and then, and a fit that took one decision otherwise is off by 1e-6 to 1e-4 of the size. So positions are put on a
//! grid of 2^-17 of the size, far coarser than the rounding of the input (1e-16 of the size when turned or scaled,
//! 1e-10 when the origin is a million sizes away) and far finer than any surface needs. A coordinate that lies within
//! that rounding of the middle between two grid points still goes either way: of 1229 contacts a million sizes away
//! one coordinate does in one case of thirty, a thousand sizes away in one of thirty thousand. The result then differs
//! as that from contacts with a noise of 1e-5 does.
//!
//! Two other ways were tried. *A grid for phases 1 and 2 only*, the fit on the contacts as they are: the patches stayed
//! the same, their control points moved by 1e-6 to 1e-4. *A grid that follows the input's own rounding*: the same
//! contacts near and far then lie on different grids.
//!
//! **How the axes are chosen.** *Principal axes* are the same for any order of the contacts, but a ball, a cube or a
//! torus has two or three equal ones, and there rounding chooses. *The direction in which most normals point*, as
//! counted around single contacts, turns with the contacts whatever the shape is: counts are whole numbers, and of
//! equal ones the first contact's is taken. It also lays the lattice of phase 1 along an object's flat sides, where it
//! cuts cleanest (a noisy cube in line with it takes 36 patches, turned at random 106). The second is used; the same
//! contacts in another order may then give another frame.

use crate::Vec3;
use crate::cloud::Cloud;
use crate::mesh::TriangleMesh;
use crate::spline::Surface;
use nalgebra::Matrix3;

/// Step of the grid of positions, against the size: the noise it adds, 2e-6 of the size (0.2 um of a cup), is a tenth of
/// what the best fits to exact contacts leave (torus of 1229: 2e-5).
const POSITION_GRID: f64 = 1.0 / 131_072.0;
/// The same for the coordinates of normals, which have no far origin to lose digits to.
const NORMAL_GRID: f64 = 1.0 / 1_073_741_824.0;
/// Contacts around whose normals others are counted.
const CANDIDATES: usize = 64;
/// Normals count as pointing the same way, or opposite, within 15 degrees of one another: noise of 3 degrees stays
/// within, and the sides of a prism of eight do not.
const SAME_WAY: f64 = 0.966;
/// A direction across the first axis is more than 60 degrees from it (and not just 60, an angle that objects have).
const ACROSS: f64 = 0.49;

/// Rotation, translation and scale from the input's coordinates to unit size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Centre of the bounding box along the frame's axes, in the input's coordinates.
    pub centre: Vec3,
    /// Diagonal of that box, in the input's unit.
    pub scale: f64,
    /// The frame's axes in the input's coordinates, as columns.
    axes: Matrix3<f64>,
}

impl Frame {
    /// The frame of a cloud; `None` if it has no extent or is not finite.
    pub fn of(cloud: &Cloud) -> Option<Self> {
        let (low, high) = cloud.bounding_box()?;
        let extent = (high - low).norm();
        if !(extent > 0.0 && extent.is_finite()) {
            return None;
        }
        // Of unit size from here on, so that no square leaves the range of f64.
        let mut places: Vec<Vec3> = cloud
            .points
            .iter()
            .map(|p| (p.position - low) / extent)
            .collect();
        let mean = places.iter().sum::<Vec3>() / places.len() as f64;
        places.iter_mut().for_each(|x| *x -= mean);
        let normals: Vec<Vec3> = cloud
            .points
            .iter()
            .filter_map(|p| p.normal.try_normalize(0.0))
            .collect();
        let axes = axes(&normals, &places);
        let first = axes.tr_mul(places.first()?);
        let (least, most) = places.iter().fold((first, first), |(least, most), x| {
            let x = axes.tr_mul(x);
            (least.inf(&x), most.sup(&x))
        });
        let centre = low + (mean + axes * (least + (most - least) / 2.0)) * extent;
        let scale = (most - least).norm() * extent;
        (scale > 0.0 && scale.is_finite() && centre.iter().all(|x| x.is_finite())).then_some(Self {
            centre,
            scale,
            axes,
        })
    }

    /// A position in this frame.
    pub fn enter(&self, position: Vec3) -> Vec3 {
        self.axes.tr_mul(&(position - self.centre)) / self.scale
    }

    /// A length in this frame, of 24 bits: like positions, the same whatever the input's unit.
    pub fn length(&self, length: f64) -> f64 {
        const HALF: u64 = 1 << 28;
        let bits = (length / self.scale).to_bits();
        f64::from_bits(bits.saturating_add(HALF) & !(2 * HALF - 1))
    }

    /// A position back in the input's coordinates.
    pub fn leave(&self, position: Vec3) -> Vec3 {
        self.axes * position * self.scale + self.centre
    }

    /// A cloud in this frame, on its grid.
    pub fn cloud(&self, cloud: &Cloud) -> Cloud {
        let mut out = Cloud {
            points: cloud.points.clone(),
            rejected: Vec::new(),
        };
        for point in &mut out.points {
            point.position = snap(self.enter(point.position), POSITION_GRID);
            point.normal = snap(self.axes.tr_mul(&point.normal), NORMAL_GRID);
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

/// On the grid; there is one zero only.
fn snap(x: Vec3, grid: f64) -> Vec3 {
    x.map(|c| (c / grid).round() * grid + 0.0)
}

/// Right-handed axes that turn with the contacts: along the normals most of which are parallel, and those most of which
/// are among the ones across these. Where all are parallel the place furthest across gives the second axis.
fn axes(normals: &[Vec3], places: &[Vec3]) -> Matrix3<f64> {
    let Some(x) = commonest(normals) else {
        return Matrix3::identity();
    };
    let across: Vec<Vec3> = normals
        .iter()
        .filter(|n| n.dot(&x).abs() < ACROSS)
        .copied()
        .collect();
    let second = commonest(&across).unwrap_or_else(|| {
        let off = |place: &Vec3| place - x * x.dot(place);
        let squares: f64 = places.iter().map(|p| off(p).norm_squared()).sum();
        // The first that is as far out as the mean square asks for; all may be equally far.
        let enough = 0.49 * squares / places.len().max(1) as f64;
        let found = places.iter().map(off).find(|v| v.norm_squared() >= enough);
        found.unwrap_or_default()
    });
    let z = x.cross(&second).try_normalize(1e-12);
    // All on one line along the normals: any direction across it.
    let z = z.unwrap_or_else(|| x.cross(&Vec3::ith(x.iamin(), 1.0)).normalize());
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// The mean of the unit vectors, or their opposites, around the one of [`CANDIDATES`] that has most of them near.
fn commonest(vectors: &[Vec3]) -> Option<Vec3> {
    let step = vectors.len().div_ceil(CANDIDATES).max(1);
    let near = |a: &Vec3, b: &Vec3| a.dot(b).abs() > SAME_WAY;
    let mut best: Option<(usize, Vec3)> = None;
    for candidate in vectors.iter().step_by(step) {
        let count = vectors.iter().filter(|v| near(v, candidate)).count();
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, *candidate));
        }
    }
    let (_, middle) = best?;
    let sum: Vec3 = vectors
        .iter()
        .filter(|v| near(v, &middle))
        .map(|v| v * v.dot(&middle).signum())
        .sum();
    sum.try_normalize(1e-12)
}
