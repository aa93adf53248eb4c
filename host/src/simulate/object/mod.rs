//! The objects a simulated finger touches, with their exact shape: foot points, normals, signed distance.
//!
//! Three kinds: smooth solids given by a function (`solid`), block and cylinder with sharp edges
//! (`sharp`), and any closed triangle mesh (`facets`). All are millimetres, near the origin.
//!
//! Foot points on a smooth solid start from the nearest point of a dense mesh of it and are refined by
//! Newton's method on the solid's exact derivatives. The other way, to let every function be a true distance
//! and follow its gradient, was given up: blends (fillets, soft minima) are not distances, and blends are
//! what makes a mug. Where two places are about equally near, each is refined and the nearest kept, so the
//! distance is the global one as long as the mesh (2 mm cells) sees both.

mod facets;
mod jet;
mod sharp;
mod solid;
mod tetrahedra;

use crate::Vec3;
use crate::mesh::{AabbTree, TriangleMesh, sample_by_area};
use facets::Facets;
use jet::Jet;
use nalgebra::{Matrix4, Vector4};
use sharp::Sharp;
use solid::Solid;

/// Cell of the mesh from which foot points on smooth solids start, millimetres. Chords
/// of 2.8 mm are then within 0.25 mm of the surface where its radius is 4 mm, the smallest there is (the lip
/// of the mug), and within 0.05 mm where it is 20 mm.
const CELL_MM: f64 = 2.0;

/// Feet whose mesh distance is within this of the nearest are refined as well, millimetres: more than the mesh
/// is off the surface anywhere.
const RIVAL_MM: f64 = 0.3;

/// A foot within this of the last one is the same foot, millimetres: wider than the few triangles around a
/// foot that differ by less than [`RIVAL_MM`] on a gentle slope.
const SAME_FOOT_MM: f64 = 12.0;

/// The point of an object's surface that is nearest to some point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// The nearest point of the surface, millimetres.
    pub position_mm: Vec3,
    /// Outward unit normal there. From outside, the direction from the foot to the point, so that at a sharp
    /// edge it is the normal at which a ball touches.
    pub normal: Vec3,
    /// Signed distance, negative inside, millimetres.
    pub distance_mm: f64,
}

/// Why something cannot be an object, and what to do about it.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ObjectError {
    /// No object of that name.
    #[error("no object is called {name:?}; known: {known}, or the path of a closed mesh")]
    Unknown {
        /// What was asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// The mesh does not enclose anything.
    #[error("{name}: not a closed surface ({reason}); close it and make its faces face one way")]
    NotClosed {
        /// Name of the mesh.
        name: String,
        /// Which count is wrong.
        reason: String,
    },
}

#[derive(Clone, Debug)]
enum Shape {
    Smooth {
        solid: Solid,
        mesh: TriangleMesh,
        tree: AabbTree,
    },
    Sharp(Sharp),
    Facets(Box<Facets>),
}

/// An object with its exact shape.
#[derive(Clone, Debug)]
pub struct Object {
    name: String,
    shape: Shape,
}

impl Object {
    /// The names of the built-in objects.
    pub const NAMES: [&'static str; 10] = [
        "sphere",
        "ellipsoid",
        "torus",
        "two-holed-torus",
        "mug",
        "bowl",
        "bean",
        "trilobe",
        "cube",
        "cylinder",
    ];

    /// A built-in object.
    ///
    /// # Errors
    /// [`ObjectError::Unknown`] with the names there are.
    pub fn named(name: &str) -> Result<Self, ObjectError> {
        let smooth = |solid: Solid| {
            let mesh = tetrahedra::polygonize(solid, CELL_MM);
            let tree = AabbTree::new(&mesh);
            Shape::Smooth { solid, mesh, tree }
        };
        let shape = match name {
            "sphere" => smooth(Solid::Sphere),
            "ellipsoid" => smooth(Solid::Ellipsoid),
            "torus" => smooth(Solid::Torus),
            "two-holed-torus" => smooth(Solid::TwoHoledTorus),
            "mug" => smooth(Solid::Mug),
            "bowl" => smooth(Solid::Bowl),
            "bean" => smooth(Solid::Bean),
            "trilobe" => smooth(Solid::Trilobe),
            "cube" => Shape::Sharp(Sharp::Block { half_mm: 50.0 }),
            "cylinder" => Shape::Sharp(Sharp::Cylinder {
                radius_mm: 45.0,
                half_height_mm: 60.0,
            }),
            _ => {
                return Err(ObjectError::Unknown {
                    name: name.to_owned(),
                    known: Self::NAMES.join(", "),
                });
            }
        };
        Ok(Self {
            name: name.to_owned(),
            shape,
        })
    }

    /// A closed mesh as an object, moved to the origin and, if `longest_side_mm` is given, scaled so that its
    /// bounding box's longest side has that length; otherwise its unit is taken as millimetres.
    ///
    /// # Errors
    /// [`ObjectError::NotClosed`] for a mesh with borders, non-manifold edges, faces that disagree about
    /// outside, or no volume.
    pub fn from_mesh(
        name: &str,
        mesh: &TriangleMesh,
        longest_side_mm: Option<f64>,
    ) -> Result<Self, ObjectError> {
        let facets = Facets::new(name, mesh, longest_side_mm)?;
        Ok(Self {
            name: name.to_owned(),
            shape: Shape::Facets(Box::new(facets)),
        })
    }

    /// The object's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the surface has a tangent plane everywhere.
    pub fn is_smooth(&self) -> bool {
        matches!(self.shape, Shape::Smooth { .. })
    }

    /// The point of the surface nearest to `point`. For a point that is not finite, the answer is some point
    /// of the surface with a distance that is not a number.
    pub fn foot(&self, point: &Vec3) -> Foot {
        match &self.shape {
            Shape::Smooth { solid, mesh, tree } => smooth_foot(*solid, mesh, tree, point),
            Shape::Sharp(sharp) => sharp.foot(point),
            Shape::Facets(facets) => facets.foot(point),
        }
    }

    /// Lowest and highest corner of a box around the object, millimetres, with a few to spare.
    pub fn bounding_box_mm(&self) -> (Vec3, Vec3) {
        match &self.shape {
            Shape::Smooth { solid, .. } => {
                let (low, high) = solid.bounds_mm();
                (low.into(), high.into())
            }
            Shape::Sharp(sharp) => sharp.bounding_box_mm(),
            Shape::Facets(facets) => facets.bounding_box_mm(),
        }
    }

    /// The true shape as a dense mesh, for comparing reconstructions with: vertices on the surface, chords
    /// within 0.25 mm of it at the sharpest bend and 0.05 mm where a fingertip fits.
    pub fn truth_mesh(&self) -> TriangleMesh {
        match &self.shape {
            Shape::Smooth { mesh, .. } => mesh.clone(),
            Shape::Sharp(sharp) => sharp.mesh(),
            Shape::Facets(facets) => facets.mesh().clone(),
        }
    }

    /// `count` points of the surface with equal shares of its area, each with its normal; the same on every
    /// call.
    pub fn sample(&self, count: usize) -> Vec<Foot> {
        let owned;
        let mesh = match &self.shape {
            Shape::Smooth { mesh, .. } => mesh,
            _ => {
                owned = self.truth_mesh();
                &owned
            }
        };
        sample_by_area(mesh, count)
            .iter()
            .map(|sample| {
                // On a surface with edges, the direction to the foot is taken from a place clearly outside.
                let lift = if self.is_smooth() { 0.0 } else { 0.5 };
                let foot = self.foot(&(sample.position + mesh.face_normal(sample.face) * lift));
                Foot {
                    position_mm: foot.position_mm,
                    normal: foot.normal,
                    distance_mm: 0.0,
                }
            })
            .collect()
    }
}

fn smooth_foot(solid: Solid, mesh: &TriangleMesh, tree: &AabbTree, point: &Vec3) -> Foot {
    let sign = if solid.field::<f64>((*point).into()) < 0.0 {
        -1.0
    } else {
        1.0
    };
    let mut best: Option<(f64, Vec3)> = None;
    let mut starts: Vec<Vec3> = Vec::new();
    let mut limit = f64::INFINITY;
    // Four rivals: a point on the axis of a hole has endlessly many, and any will do.
    while starts.len() < 4 {
        let start = tree.closest_where(mesh, point, limit, |face| {
            starts.is_empty()
                || mesh
                    .corners(face)
                    .is_some_and(|[a, _, _]| starts.iter().all(|s| (s - a).norm() > SAME_FOOT_MM))
        });
        let Some(start) = start else { break };
        if starts.is_empty() {
            limit = start.distance + RIVAL_MM;
        }
        starts.push(start.position);
        let foot = refine(solid, point, start.position);
        let distance = (point - foot).norm();
        if best.is_none_or(|(least, _)| distance < least) {
            best = Some((distance, foot));
        }
    }
    let (distance, position_mm) = best.unwrap_or((f64::NAN, Vec3::zeros()));
    let gradient = solid.field(Jet::coordinates(&position_mm)).gradient;
    Foot {
        position_mm,
        normal: crate::mesh::unit_or_zero(gradient),
        distance_mm: sign * distance,
    }
}

/// The stationary point of the distance near `start`: Newton on (q - x + l grad f(q), f(q)) = 0, falling back
/// to tangential steps where Newton leaves the neighbourhood (a focal point, a kink between two blends).
fn refine(solid: Solid, point: &Vec3, start: Vec3) -> Vec3 {
    let begin = tetrahedra::onto_surface(solid, start, CELL_MM);
    let begin_distance = (point - begin).norm();
    let mut q = begin;
    let mut f = solid.field(Jet::coordinates(&q));
    let mut multiplier = (point - q).dot(&f.gradient) / f.gradient.norm_squared().max(1e-12);
    let mut converged = false;
    for _ in 0..12 {
        let gap = q - point + f.gradient * multiplier;
        if gap.norm() < 1e-10 && f.value.abs() < 1e-11 {
            converged = true;
            break;
        }
        let mut system = Matrix4::zeros();
        let block = nalgebra::Matrix3::identity() + f.hessian * multiplier;
        system.fixed_view_mut::<3, 3>(0, 0).copy_from(&block);
        system.fixed_view_mut::<3, 1>(0, 3).copy_from(&f.gradient);
        system
            .fixed_view_mut::<1, 3>(3, 0)
            .copy_from(&f.gradient.transpose());
        let right = Vector4::new(-gap.x, -gap.y, -gap.z, -f.value);
        let Some(step) = system.lu().solve(&right) else {
            break;
        };
        q += step.fixed_rows::<3>(0);
        multiplier += step[3];
        if (q - begin).norm() > 2.0 * CELL_MM {
            break;
        }
        f = solid.field(Jet::coordinates(&q));
    }
    if converged && (point - q).norm() <= begin_distance + 1e-9 {
        return q;
    }
    walk(solid, point, begin)
}

/// Walks along the surface towards the foot in Newton steps within the tangent plane, each no longer than a
/// reach that is halved when a step does not bring it nearer and doubled when it does. Near a focal point the
/// distance bends a thousandfold less across than along, so that steps down its slope would zigzag; where it bends
/// the wrong way, the step goes down all the same.
fn walk(solid: Solid, point: &Vec3, begin: Vec3) -> Vec3 {
    let mut q = begin;
    let mut reach_mm = CELL_MM;
    for _ in 0..200 {
        let f = solid.field(Jet::coordinates(&q));
        let to_point = point - q;
        let multiplier = to_point.dot(&f.gradient) / f.gradient.norm_squared().max(1e-12);
        let tangents = tangents(&crate::mesh::unit_or_zero(f.gradient));
        let slope = tangents.transpose() * to_point;
        if slope.norm() < 1e-10 || reach_mm < 1e-6 {
            break;
        }
        let hessian = nalgebra::Matrix3::identity() + f.hessian * multiplier;
        let bends = (tangents.transpose() * hessian * tangents).symmetric_eigen();
        let mut along = bends.eigenvectors.transpose() * slope;
        for (part, bend) in along.iter_mut().zip(&bends.eigenvalues) {
            *part /= bend.abs().max(1e-9);
        }
        let step = tangents * bends.eigenvectors * along;
        let step = step * (reach_mm / step.norm()).min(1.0);
        let next = tetrahedra::onto_surface(solid, q + step, CELL_MM);
        if (point - next).norm() < to_point.norm() {
            q = next;
            reach_mm = (reach_mm * 2.0).min(CELL_MM);
        } else {
            reach_mm = 0.5 * reach_mm.min(step.norm());
        }
    }
    q
}

/// Two unit vectors at right angles to a unit normal and to each other.
fn tangents(normal: &Vec3) -> nalgebra::Matrix3x2<f64> {
    let first = crate::mesh::unit_or_zero(normal.cross(&Vec3::ith(normal.iamin(), 1.0)));
    nalgebra::Matrix3x2::from_columns(&[first, normal.cross(&first)])
}

#[cfg(test)]
mod tests;
