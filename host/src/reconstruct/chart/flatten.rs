//! The extracted mesh of a disk laid into the plane: as rigid as it can be without a fold.
//!
//! A convex map (Tutte's, border on a circle by arc length) is the start: it has no folds, whatever the mesh. Local and
//! global steps (Liu et al. 2008, "A local/global approach to mesh parameterization") then make every
//! triangle as congruent to its original as possible; each step is shortened until no more than slivers fold and
//! the border does not cross itself.
//!
//! Two ways were weighed: a conformal map (LSCM: one linear solve, but ears and handles of a shape shrink
//! exponentially, and the border may cross itself) and this one (some more solves with one factorisation, lengths
//! kept, so that even triangles in the plane are about even on the surface). The second was taken.

use super::ChartFitError;
use crate::Vec3;
use crate::mesh::TriangleMesh;
use crate::spline::edges::EdgeTable;
use crate::spline::simplex::Vec2;
use faer::linalg::solvers::Solve;
use faer::prelude::*;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};

/// Local and global steps; the energy changes by less than a per cent after 15 (half sphere, bowl).
const STEPS: usize = 20;
/// Share of the area that may fold: slivers of the extracted mesh do, and the places they give to data are only where the
/// search for foot points begins. Without it one sliver stops the whole map (kitten: lengths stretched 69 times).
const FOLDED_SHARE: f64 = 1e-3;
/// A step is halved so many times before the map is left as it is.
const HALVINGS: usize = 6;

/// Quantile of the edges' stretches that is reported at both ends.
const STRETCH_QUANTILE: f64 = 0.01;

/// A mesh with a place in the plane for each vertex, in the unit of the mesh.
#[derive(Clone, Debug)]
pub struct Flat {
    /// Place of each vertex.
    pub places: Vec<Vec2>,
    /// The border's vertices in order, counter-clockwise.
    pub border: Vec<u32>,
    /// Length of an edge in the plane over its length on the mesh: all but the last hundredth at either end lie below
    /// the first and above the second.
    pub stretch: [f64; 2],
}

/// Lays `mesh` into the plane.
///
/// # Errors
/// [`ChartFitError::NoDisk`] if it is not one piece with one border and no handles; [`ChartFitError::Factor`] if
/// its equations cannot be solved.
pub fn flatten(mesh: &TriangleMesh) -> Result<Flat, ChartFitError> {
    let table = EdgeTable::new(mesh.positions.len(), &mesh.faces)
        .map_err(|e| ChartFitError::NoSurface(e.to_string()))?;
    let topology = crate::spline::Topology::new(mesh.positions.len(), &mesh.faces, &table);
    if (topology.components, topology.borders, topology.genus) != (1, 1, 0) {
        return Err(ChartFitError::NoDisk {
            components: topology.components,
            borders: topology.borders,
            genus: topology.genus,
        });
    }
    let border = border_loop(mesh, &table)?;
    let mut places = on_circle(mesh, &table, &border)?;
    rigid(mesh, &border, &mut places)?;
    let mut stretches: Vec<f64> = table
        .edges
        .iter()
        .map(|edge| {
            let [a, b] = edge.vertices.map(|v| v as usize);
            let length = (mesh.positions[a] - mesh.positions[b]).norm();
            (places[a] - places[b]).norm() / length.max(1e-300)
        })
        .collect();
    stretches.sort_by(f64::total_cmp);
    let rank = (STRETCH_QUANTILE * stretches.len() as f64) as usize;
    let stretch = [stretches[stretches.len() - 1 - rank], stretches[rank]];
    Ok(Flat {
        places,
        border,
        stretch,
    })
}

/// The one border loop, in the direction of the faces.
fn border_loop(mesh: &TriangleMesh, table: &EdgeTable) -> Result<Vec<u32>, ChartFitError> {
    let mut next = vec![u32::MAX; mesh.positions.len()];
    let mut count = 0;
    for edge in table.edges.iter().filter(|e| e.is_border()) {
        let Some(side) = edge.sides.iter().flatten().next() else {
            continue;
        };
        let face = mesh.faces[side.face as usize];
        let local = usize::from(side.local);
        next[face[local] as usize] = face[(local + 1) % 3];
        count += 1;
    }
    let start = next.iter().position(|v| *v != u32::MAX).unwrap_or(0) as u32;
    let mut border = vec![start];
    let mut at = start;
    while border.len() <= count {
        at = next.get(at as usize).copied().unwrap_or(u32::MAX);
        if at == start || at == u32::MAX {
            break;
        }
        border.push(at);
    }
    if border.len() != count {
        return Err(ChartFitError::NoSurface("its border touches itself".into()));
    }
    Ok(border)
}

/// A sparse symmetric matrix, factored.
fn factor(
    size: usize,
    triplets: &[Triplet<usize, usize, f64>],
) -> Result<Llt<usize, f64>, ChartFitError> {
    let failed = |e: String| ChartFitError::Factor(e);
    let matrix = SparseColMat::try_new_from_triplets(size, size, triplets)
        .map_err(|e| failed(format!("{e:?}")))?;
    let symbolic = SymbolicLlt::try_new(matrix.symbolic(), faer::Side::Lower)
        .map_err(|e| failed(format!("{e:?}")))?;
    Llt::try_new_with_symbolic(symbolic, matrix.as_ref(), faer::Side::Lower)
        .map_err(|e| failed(format!("{e:?}")))
}

fn solve(factor: &Llt<usize, f64>, right: &[Vec2]) -> Vec<Vec2> {
    let mut vector = Mat::from_fn(right.len(), 2, |row, k| right[row][k]);
    factor.solve_in_place(vector.as_mut());
    (0..right.len())
        .map(|row| Vec2::new(vector[(row, 0)], vector[(row, 1)]))
        .collect()
}

/// Tutte's map: every inner vertex in the middle of its neighbours.
fn on_circle(
    mesh: &TriangleMesh,
    table: &EdgeTable,
    border: &[u32],
) -> Result<Vec<Vec2>, ChartFitError> {
    let count = mesh.positions.len();
    let at = |v: u32| mesh.positions[v as usize];
    let lengths: Vec<f64> = (0..border.len())
        .map(|k| (at(border[(k + 1) % border.len()]) - at(border[k])).norm())
        .collect();
    let whole: f64 = lengths.iter().sum();
    // The circle gets the area of the mesh, so that the rigid steps begin at the right size.
    let radius = (mesh.area() / std::f64::consts::PI).sqrt();
    let mut places = vec![Vec2::zeros(); count];
    let mut fixed = vec![false; count];
    let mut gone = 0.0;
    for (vertex, length) in border.iter().zip(&lengths) {
        let angle = std::f64::consts::TAU * gone / whole.max(1e-300);
        places[*vertex as usize] = Vec2::new(angle.cos(), angle.sin()) * radius;
        fixed[*vertex as usize] = true;
        gone += length;
    }
    let mut diagonal = vec![0.0; count];
    let mut right = vec![Vec2::zeros(); count];
    let mut triplets = Vec::new();
    for edge in &table.edges {
        let [a, b] = edge.vertices.map(|v| v as usize);
        for (v, w) in [(a, b), (b, a)] {
            if !fixed[v] {
                diagonal[v] += 1.0;
                if fixed[w] {
                    right[v] += places[w];
                }
            }
        }
        if !fixed[a] && !fixed[b] {
            triplets.push(Triplet::new(a.max(b), a.min(b), -1.0));
        }
    }
    for v in 0..count {
        // Fixed vertices, and those that no face uses, stay where they are.
        if diagonal[v] == 0.0 {
            diagonal[v] = 1.0;
            right[v] = places[v];
        }
        triplets.push(Triplet::new(v, v, diagonal[v]));
    }
    Ok(solve(&factor(count, &triplets)?, &right))
}

/// Local and global steps towards a map that keeps every triangle's shape.
fn rigid(mesh: &TriangleMesh, border: &[u32], places: &mut Vec<Vec2>) -> Result<(), ChartFitError> {
    let count = places.len();
    // Each face in its own plane, and the weights of its edges (half the cotangent of the angle opposite).
    let flat: Vec<[Vec2; 3]> = mesh
        .faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|v| mesh.positions[v as usize]);
            let x = (b - a).try_normalize(0.0).unwrap_or_else(Vec3::x);
            let along = (c - a).dot(&x);
            let height = ((c - a).norm_squared() - along * along).max(0.0).sqrt();
            [
                Vec2::zeros(),
                Vec2::new((b - a).norm(), 0.0),
                Vec2::new(along, height),
            ]
        })
        .collect();
    let weights: Vec<[f64; 3]> = flat
        .iter()
        .map(|p| {
            [0, 1, 2].map(|edge| {
                let apex = p[(edge + 2) % 3];
                let (u, v) = (p[edge] - apex, p[(edge + 1) % 3] - apex);
                // Obtuse angles have negative weights, which would cost definiteness: a little is kept instead.
                (u.dot(&v) / u.perp(&v).abs().max(1e-300)).clamp(0.05, 20.0)
            })
        })
        .collect();
    let mut triplets = vec![Triplet::new(0, 0, 1.0)];
    let mut diagonal = vec![1e-9; count];
    for (face, weight) in mesh.faces.iter().zip(&weights) {
        for edge in 0..3 {
            let (a, b) = (face[edge] as usize, face[(edge + 1) % 3] as usize);
            diagonal[a] += weight[edge];
            diagonal[b] += weight[edge];
            triplets.push(Triplet::new(a.max(b), a.min(b), -weight[edge]));
        }
    }
    triplets.extend((0..count).map(|v| Triplet::new(v, v, diagonal[v])));
    let factor = factor(count, &triplets)?;
    for _ in 0..STEPS {
        let mut right = vec![Vec2::zeros(); count];
        right[0] = places[0];
        for ((face, p), weight) in mesh.faces.iter().zip(&flat).zip(&weights) {
            let q = face.map(|v| places[v as usize]);
            // The rotation nearest to the map of this face: the angle that the edges turn by, weighted.
            let (mut cosine, mut sine) = (0.0, 0.0);
            for edge in 0..3 {
                let from = p[(edge + 1) % 3] - p[edge];
                let to = q[(edge + 1) % 3] - q[edge];
                cosine += weight[edge] * from.dot(&to);
                sine += weight[edge] * from.perp(&to);
            }
            let size = cosine.hypot(sine).max(1e-300);
            let (cosine, sine) = (cosine / size, sine / size);
            for edge in 0..3 {
                let way = p[(edge + 1) % 3] - p[edge];
                let turned =
                    Vec2::new(cosine * way.x - sine * way.y, sine * way.x + cosine * way.y)
                        * weight[edge];
                right[face[edge] as usize] -= turned;
                right[face[(edge + 1) % 3] as usize] += turned;
            }
        }
        for v in 0..count {
            right[v] += places[v] * 1e-9;
        }
        let wanted = solve(&factor, &right);
        let mut share = 1.0;
        let mut taken = false;
        for _ in 0..=HALVINGS {
            let next: Vec<Vec2> = places
                .iter()
                .zip(&wanted)
                .map(|(from, to)| from + (to - from) * share)
                .collect();
            if is_embedding(mesh, border, &next) {
                *places = next;
                taken = true;
                break;
            }
            share *= 0.5;
        }
        if !taken {
            break;
        }
    }
    Ok(())
}

/// Whether hardly anything folds and the border does not cross itself.
fn is_embedding(mesh: &TriangleMesh, border: &[u32], places: &[Vec2]) -> bool {
    let (mut folded, mut whole) = (0.0, 0.0);
    for (number, face) in mesh.faces.iter().enumerate() {
        let [a, b, c] = face.map(|v| places[v as usize]);
        let area = mesh.area_vector(number as u32).norm();
        whole += area;
        if (b - a).perp(&(c - a)) <= 0.0 {
            folded += area;
        }
    }
    folded <= FOLDED_SHARE * whole
        && is_simple(
            &border
                .iter()
                .map(|v| places[*v as usize])
                .collect::<Vec<_>>(),
        )
}

/// Whether no two sides of a polygon cross.
fn is_simple(polygon: &[Vec2]) -> bool {
    let count = polygon.len();
    let side = |a: Vec2, b: Vec2, c: Vec2| (b - a).perp(&(c - a));
    (0..count).all(|i| {
        let (a, b) = (polygon[i], polygon[(i + 1) % count]);
        let (low, high) = (a.inf(&b), a.sup(&b));
        (i + 2..count).all(|j| {
            if (j + 1) % count == i {
                return true;
            }
            let (c, d) = (polygon[j], polygon[(j + 1) % count]);
            let apart = c.x.max(d.x) < low.x
                || c.x.min(d.x) > high.x
                || c.y.max(d.y) < low.y
                || c.y.min(d.y) > high.y;
            apart || side(a, b, c) * side(a, b, d) > 0.0 || side(c, d, a) * side(c, d, b) > 0.0
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dome over a grid, higher in the middle by `height`.
    fn dome(height: f64) -> TriangleMesh {
        const SIDE: u32 = 12;
        let mut mesh = TriangleMesh::default();
        for row in 0..=SIDE {
            for column in 0..=SIDE {
                let x = f64::from(column) / f64::from(SIDE) - 0.5;
                let y = f64::from(row) / f64::from(SIDE) - 0.5;
                let z = height * (1.0 - 4.0 * x * x) * (1.0 - 4.0 * y * y);
                mesh.positions.push(Vec3::new(x, y, z));
                if row < SIDE && column < SIDE {
                    let corner = row * (SIDE + 1) + column;
                    let up = corner + SIDE + 1;
                    mesh.faces.push([corner, corner + 1, up + 1]);
                    mesh.faces.push([corner, up + 1, up]);
                }
            }
        }
        mesh
    }

    #[test]
    fn a_plane_stays_as_it_is_and_a_dome_keeps_its_lengths() {
        let flat = flatten(&dome(0.0)).unwrap();
        // The way from the disk to the square stops where its corners' angles are undone.
        assert!(
            flat.stretch[0] < 1.01 && flat.stretch[1] > 0.99,
            "{:?}",
            flat.stretch
        );
        let dome = dome(0.7);
        let flat = flatten(&dome).unwrap();
        assert!(
            flat.stretch[0] < 2.2 && flat.stretch[1] > 0.4,
            "{:?}",
            flat.stretch
        );
        assert!(is_embedding(&dome, &flat.border, &flat.places));
    }

    #[test]
    fn what_is_no_disk_is_named() {
        let mut torn = dome(0.1);
        torn.faces.remove(100);
        assert!(matches!(
            flatten(&torn),
            Err(ChartFitError::NoDisk {
                components: 1,
                borders: 2,
                genus: 0
            })
        ));
        let closed = crate::mesh::shapes::icosphere(1);
        assert!(matches!(
            flatten(&closed),
            Err(ChartFitError::NoDisk {
                components: 1,
                borders: 0,
                genus: 0
            })
        ));
    }
}
