//! The space of tangent-plane continuous patch networks over a triangulation, as linear equations.
//!
//! Patches of degree 5 share the control points of their edges (G0). Across a smooth edge from a to b with
//! faces (a, b, c) and (b, a, d) the tangent planes agree if
//!
//! ```text
//! alpha(t) D_P(t) + beta(t) D_Q(t) = gamma(t) C'(t)
//! ```
//!
//! with D_P the derivative along c - a, D_Q along d - a, C' along the edge, and linear alpha, beta, gamma
//! that depend on the triangulation alone. That is six linear equations per edge in the control points
//! ([`Network::equations`]), so any quadratic energy is minimised by one linear solve and the result is
//! G1 up to rounding (Loop 1994; Mourrain, Vidunas, Villamizar 2016).
//!
//! **Gluing data.** Two ways were weighed. Fixed data by valence (alpha = beta = 1, gamma from the cosine of
//! 2 pi / valence) make every star look regular, which bends the parameters of an uneven mesh. Here each
//! vertex star is unfolded into the plane with its own angles, scaled to the sum that smoothness asks for
//! (2 pi inside; pi on each side of a smooth crease or border; corners keep their angles): a plane region
//! of any triangulation is then reproduced with its own affine parameters, and a sphere is met about three
//! times closer at the same number of patches. It needs angles away from 0 and pi, which
//! [`MIN_ANGLE`] keeps, and it is why phase 2 has to end in well-shaped triangles.
//!
//! **Solving.** A global basis of the space is not formed: its dimension jumps with parities and symmetric
//! edges, and deciding a rank is fragile. The equations are met by an augmented Lagrangian instead, which
//! needs no rank decision.

use super::bernstein::{CONTROL_POINTS, DEGREE, edge_index};
use super::edges::{EdgeError, EdgeTable, Sectors};
use crate::Vec3;
use std::collections::BTreeSet;
use std::f64::consts::PI;

/// Angles of an unfolded star stay between this and pi minus this (radians, 12 degrees): flatter triangles
/// make alpha or beta vanish.
pub const MIN_ANGLE: f64 = 0.21;

/// A triangulation with gluing data: which control points its patches share and which equations they meet.
#[derive(Clone, Debug)]
pub struct Network {
    /// Three vertices per face.
    pub faces: Vec<[u32; 3]>,
    /// Edges.
    pub table: EdgeTable,
    /// Per edge: two faces that share a tangent plane.
    pub smooth: Vec<bool>,
    /// Global number of each patch's control points.
    pub numbers: Vec<[u32; CONTROL_POINTS]>,
    /// How many control points there are.
    pub point_count: usize,
    /// Per smooth edge (others zero): gluing data (alpha, beta, gamma) at the lower and the higher vertex.
    gluing: Vec<[[f64; 3]; 2]>,
}

/// One linear equation on control points: sum of weight * point = 0, for each coordinate.
#[derive(Clone, Debug, PartialEq)]
pub struct Equation {
    /// Control point and weight; each point once.
    pub terms: Vec<(u32, f64)>,
}

impl Network {
    /// Numbers control points and computes gluing data from the triangulation's own angles.
    ///
    /// `creases` are edges (either order of vertices) without tangent continuity, `corners` vertices where
    /// a crease or border may turn sharply although only two of its edges meet there.
    ///
    /// # Errors
    /// Faces that are no proper triangulation.
    pub fn new(
        vertices: &[Vec3],
        faces: &[[u32; 3]],
        creases: &[[u32; 2]],
        corners: &[u32],
    ) -> Result<Self, EdgeError> {
        let table = EdgeTable::new(vertices.len(), faces)?;
        let creases: BTreeSet<[u32; 2]> = creases
            .iter()
            .map(|[a, b]| [*a.min(b), *a.max(b)])
            .collect();
        let smooth: Vec<bool> = table
            .edges
            .iter()
            .map(|edge| !edge.is_border() && !creases.contains(&edge.vertices))
            .collect();
        let (numbers, point_count) = number_points(vertices.len(), faces, &table);
        let mut network = Self {
            faces: faces.to_vec(),
            table,
            smooth,
            numbers,
            point_count,
            gluing: Vec::new(),
        };
        network.glue(vertices, &corners.iter().copied().collect());
        Ok(network)
    }

    /// Fills the gluing data from unfolded vertex stars.
    fn glue(&mut self, vertices: &[Vec3], corners: &BTreeSet<u32>) {
        let sharp_edges = |smooth: &[bool], table: &EdgeTable, count: usize| {
            let mut sharp = vec![0usize; count];
            for (edge, smooth) in table.edges.iter().zip(smooth) {
                for vertex in edge.vertices {
                    sharp[vertex as usize] += usize::from(!smooth);
                }
            }
            sharp
        };
        let sharp = sharp_edges(&self.smooth, &self.table, vertices.len());
        let sectors = Sectors::new(&self.faces, &self.table, |e| self.smooth[e]);
        let mut members: Vec<Vec<(usize, usize)>> = vec![Vec::new(); sectors.vertex.len()];
        for (face, corners) in sectors.of_corner.iter().enumerate() {
            for (corner, sector) in corners.iter().enumerate() {
                members[*sector as usize].push((face, corner));
            }
        }
        let mut angle = vec![[0.0; 3]; self.faces.len()];
        for (sector, members) in members.iter().enumerate() {
            let vertex = sectors.vertex[sector];
            let mut angles: Vec<f64> = members
                .iter()
                .map(|(face, corner)| self.corner_angle(vertices, *face, *corner))
                .collect();
            let target = match sharp[vertex as usize] {
                0 | 1 => Some(2.0 * PI),
                2 if !corners.contains(&vertex) => Some(PI),
                _ => None,
            };
            spread_angles(&mut angles, target);
            for ((face, corner), value) in members.iter().zip(angles) {
                angle[*face][*corner] = value;
            }
        }
        self.gluing = (0..self.table.edges.len())
            .map(|number| {
                let edge = &self.table.edges[number];
                match edge.both() {
                    Some(sides) if self.smooth[number] => {
                        let length = |v: u32, w: u32| {
                            (vertices[v as usize] - vertices[w as usize])
                                .norm()
                                .max(1e-300)
                        };
                        let [a, b] = edge.vertices;
                        let opposite = sides
                            .map(|s| self.faces[s.face as usize][(usize::from(s.local) + 2) % 3]);
                        // Side 0 runs from a to b, side 1 from b to a.
                        let at = |v: u32, o: u32, corner: [usize; 2]| {
                            let [c, d] = opposite;
                            let t = [0, 1].map(|s| {
                                let local = usize::from(sides[s].local);
                                angle[sides[s].face as usize][(local + corner[s]) % 3]
                            });
                            let (lb, lc, ld) = (length(v, o), length(v, c), length(v, d));
                            let alpha = ld * t[1].sin();
                            let beta = lc * t[0].sin();
                            let gamma = (alpha * lc * t[0].cos() + beta * ld * t[1].cos()) / lb;
                            let scale = 2.0 / (alpha + beta);
                            [alpha * scale, beta * scale, gamma * scale]
                        };
                        let low = at(a, b, [0, 1]);
                        let mut high = at(b, a, [1, 0]);
                        high[2] = 2.0 - high[2];
                        [low, high]
                    }
                    _ => [[0.0; 3]; 2],
                }
            })
            .collect();
    }

    fn corner_angle(&self, vertices: &[Vec3], face: usize, corner: usize) -> f64 {
        let [a, b, c] = [0, 1, 2].map(|m| vertices[self.faces[face][(corner + m) % 3] as usize]);
        let (u, w) = (b - a, c - a);
        u.cross(&w).norm().atan2(u.dot(&w))
    }

    /// Global number of the control point in row `row` at place `along` from the lower vertex, on side
    /// `side` (0 or 1) of an inner edge.
    pub fn beside_edge(&self, edge: usize, side: usize, row: usize, along: usize) -> Option<u32> {
        let at = self.table.edges[edge].sides[side]?;
        let along = if side == 0 {
            along
        } else {
            DEGREE - row - along
        };
        Some(self.numbers[at.face as usize][edge_index(usize::from(at.local), row, along)])
    }

    /// The six equations of smooth edge `edge` (empty for creases and borders).
    pub fn edge_equations(&self, edge: usize) -> Vec<Equation> {
        if !self.smooth[edge] {
            return Vec::new();
        }
        let [low, high] = self.gluing[edge];
        let point = |side, row, along| self.beside_edge(edge, side, row, along).unwrap_or(0);
        (0..=DEGREE)
            .map(|k| {
                let mut terms: Vec<(u32, f64)> = Vec::with_capacity(10);
                let mut add = |number: u32, weight: f64| match terms
                    .iter_mut()
                    .find(|(known, _)| *known == number)
                {
                    Some((_, sum)) => *sum += weight,
                    None => terms.push((number, weight)),
                };
                // Coefficient k of a product of a linear and a quartic polynomial.
                let mut part = |data: [f64; 3], share: f64, at: usize| {
                    let [alpha, beta, gamma] = data.map(|x| x * share);
                    add(point(0, 1, at), alpha);
                    add(point(1, 1, at), beta);
                    add(point(0, 0, at), gamma - alpha - beta);
                    add(point(0, 0, at + 1), -gamma);
                };
                if k >= 1 {
                    part(high, k as f64 / DEGREE as f64, k - 1);
                }
                if k < DEGREE {
                    part(low, 1.0 - k as f64 / DEGREE as f64, k);
                }
                Equation { terms }
            })
            .collect()
    }

    /// All equations, edge by edge.
    pub fn equations(&self) -> Vec<Equation> {
        (0..self.table.edges.len())
            .flat_map(|edge| self.edge_equations(edge))
            .collect()
    }

    /// Control points of the flat network: every patch is its plane triangle.
    pub fn flat(&self, vertices: &[Vec3]) -> Vec<Vec3> {
        let mut points = vec![Vec3::zeros(); self.point_count];
        for (face, numbers) in self.faces.iter().zip(&self.numbers) {
            for (number, exponents) in numbers.iter().zip(super::bernstein::EXPONENTS) {
                points[*number as usize] = (0..3)
                    .map(|m| vertices[face[m] as usize] * (f64::from(exponents[m]) / DEGREE as f64))
                    .sum();
            }
        }
        points
    }

    /// The control points of each patch.
    pub fn patches(&self, points: &[Vec3]) -> Vec<[Vec3; CONTROL_POINTS]> {
        self.numbers
            .iter()
            .map(|numbers| numbers.map(|n| points[n as usize]))
            .collect()
    }

    /// Edges that are inner but not smooth.
    pub fn creases(&self) -> Vec<[u32; 2]> {
        self.table
            .edges
            .iter()
            .zip(&self.smooth)
            .filter(|(edge, smooth)| !**smooth && !edge.is_border())
            .map(|(edge, _)| edge.vertices)
            .collect()
    }
}

/// Numbers shared control points: vertices, then four per edge from its lower vertex on, then six per face.
fn number_points(
    vertex_count: usize,
    faces: &[[u32; 3]],
    table: &EdgeTable,
) -> (Vec<[u32; CONTROL_POINTS]>, usize) {
    const INNER_EDGE: usize = DEGREE - 1;
    const INNER_FACE: usize = (DEGREE - 1) * (DEGREE - 2) / 2;
    let first_edge = vertex_count;
    let first_face = first_edge + INNER_EDGE * table.edges.len();
    let numbers = faces
        .iter()
        .enumerate()
        .map(|(face, corners)| {
            let mut numbers = [u32::MAX; CONTROL_POINTS];
            for local in 0..3 {
                let number = table.of_face[face][local] as usize;
                let forward = table.edges[number].vertices[0] == corners[local];
                numbers[edge_index(local, 0, 0)] = corners[local];
                for along in 1..DEGREE {
                    let place = if forward { along } else { DEGREE - along };
                    numbers[edge_index(local, 0, along)] =
                        (first_edge + INNER_EDGE * number + place - 1) as u32;
                }
            }
            let inner = numbers.iter_mut().filter(|n| **n == u32::MAX);
            for (slot, next) in inner.zip(first_face + INNER_FACE * face..) {
                *slot = next as u32;
            }
            numbers
        })
        .collect();
    (numbers, first_face + INNER_FACE * faces.len())
}

/// Scales the angles of a sector to `target` where there is one, keeping each within [`MIN_ANGLE`] of 0 and
/// pi: what one angle may not take is spread over the others.
fn spread_angles(angles: &mut [f64], target: Option<f64>) {
    let (low, high) = (MIN_ANGLE, PI - MIN_ANGLE);
    let Some(target) = target else {
        for angle in angles.iter_mut() {
            *angle = angle.clamp(low, high);
        }
        return;
    };
    let count = angles.len() as f64;
    if target <= count * low || target >= count * high {
        // No room to choose: a single face between two crease edges, say. Nothing is glued there.
        angles.fill(target / count);
        return;
    }
    for angle in angles.iter_mut() {
        *angle = angle.max(1e-6);
    }
    let sum_at = |scale: f64, angles: &[f64]| {
        angles
            .iter()
            .map(|a| (a * scale).clamp(low, high))
            .sum::<f64>()
    };
    // The clamped sum rises with the scale: bisection finds the one that meets the target.
    let (mut below, mut above) = (0.0, 1.0);
    while sum_at(above, angles) < target && above < 1e9 {
        above *= 2.0;
    }
    for _ in 0..200 {
        let middle = 0.5 * (below + above);
        if sum_at(middle, angles) < target {
            below = middle;
        } else {
            above = middle;
        }
    }
    for angle in angles.iter_mut() {
        *angle = (*angle * above).clamp(low, high);
    }
    // What rounding leaves goes to the angles that are free.
    let rest = target - angles.iter().sum::<f64>();
    let free = angles.iter().filter(|a| **a > low && **a < high).count();
    if free > 0 {
        for angle in angles.iter_mut().filter(|a| **a > low && **a < high) {
            *angle += rest / free as f64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn icosahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let g = (1.0 + 5.0_f64.sqrt()) / 2.0;
        let mut vertices = Vec::new();
        for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
            vertices.push(Vec3::new(a, b, 0.0));
        }
        for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
            vertices.push(Vec3::new(0.0, a, b));
        }
        for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
            vertices.push(Vec3::new(b, 0.0, a));
        }
        let mut faces = Vec::new();
        for a in 0..12u32 {
            for b in a + 1..12 {
                for c in b + 1..12 {
                    let [p, q, r] = [a, b, c].map(|v| vertices[v as usize]);
                    let near = |x: Vec3, y: Vec3| ((x - y).norm() - 2.0).abs() < 1e-9;
                    if near(p, q) && near(q, r) && near(r, p) {
                        let outward = (q - p).cross(&(r - p)).dot(&p) > 0.0;
                        faces.push(if outward { [a, b, c] } else { [a, c, b] });
                    }
                }
            }
        }
        for v in &mut vertices {
            *v = v.normalize();
        }
        (vertices, faces)
    }

    fn octahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let vertices = [
            Vec3::x(),
            -Vec3::x(),
            Vec3::y(),
            -Vec3::y(),
            Vec3::z(),
            -Vec3::z(),
        ];
        let mut faces = Vec::new();
        for x in [0u32, 1] {
            for y in [2u32, 3] {
                for z in [4u32, 5] {
                    let [p, q, r] = [x, y, z].map(|v| vertices[v as usize]);
                    let outward = p.cross(&q).dot(&r) > 0.0;
                    faces.push(if outward { [x, y, z] } else { [x, z, y] });
                }
            }
        }
        (vertices.to_vec(), faces)
    }

    fn split_in_four((vertices, faces): (Vec<Vec3>, Vec<[u32; 3]>)) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let table = EdgeTable::new(vertices.len(), &faces).unwrap();
        let mut all = vertices.clone();
        for edge in &table.edges {
            let [a, b] = edge.vertices.map(|v| vertices[v as usize]);
            all.push((a + b).normalize());
        }
        let mut out = Vec::new();
        for (face, edges) in faces.iter().zip(&table.of_face) {
            let [a, b, c] = *face;
            let [d, e, f] = edges.map(|e| e + vertices.len() as u32);
            out.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        (all, out)
    }

    /// Dimension of the space by singular values.
    fn dimension(network: &Network) -> usize {
        let equations = network.equations();
        let mut matrix = nalgebra::DMatrix::<f64>::zeros(equations.len(), network.point_count);
        for (row, equation) in equations.iter().enumerate() {
            for (number, weight) in &equation.terms {
                matrix[(row, *number as usize)] += weight;
            }
        }
        let values = matrix.singular_values();
        let largest = values.max();
        network.point_count - values.iter().filter(|v| **v > 1e-9 * largest).count()
    }

    #[test]
    fn dimensions_agree_with_the_rank_counts() {
        // On these regular meshes the unfolded stars give the fixed data of the valence, so the counts
        // by SVD of the fixed form hold: 3V + 2E and more at valences 4 and 6.
        for (mesh, wanted) in [(icosahedron(), 96), (octahedron(), 48)] {
            let network = Network::new(&mesh.0, &mesh.1, &[], &[]).unwrap();
            assert_eq!(dimension(&network), wanted);
        }
        // Uneven stars: exactly 3V + 2E.
        let (vertices, faces) = split_in_four(icosahedron());
        let network = Network::new(&vertices, &faces, &[], &[]).unwrap();
        assert_eq!(dimension(&network), 3 * 42 + 2 * 120);
    }

    #[test]
    fn plane_is_reproduced_with_its_own_parameters() {
        // A bent strip of uneven triangles in the plane: the flat network meets all equations.
        let vertices: Vec<Vec3> = [
            (0.0, 0.0),
            (1.0, 0.1),
            (2.2, -0.1),
            (0.3, 1.0),
            (1.2, 0.9),
            (1.9, 1.3),
            (0.1, 2.0),
            (1.0, 2.2),
            (2.1, 2.0),
        ]
        .map(|(x, y)| Vec3::new(x, y, 0.0))
        .to_vec();
        let faces = [
            [0, 1, 3],
            [1, 4, 3],
            [1, 2, 4],
            [2, 5, 4],
            [3, 4, 6],
            [4, 7, 6],
            [4, 5, 7],
            [5, 8, 7],
        ];
        let network = Network::new(&vertices, &faces, &[], &[0, 1, 2, 3, 5, 6, 7, 8]).unwrap();
        let points = network.flat(&vertices);
        for equation in network.equations() {
            let sum: Vec3 = equation
                .terms
                .iter()
                .map(|(n, w)| points[*n as usize] * *w)
                .sum();
            assert!(sum.norm() < 1e-13, "{sum}");
        }
    }

    #[test]
    fn angles_meet_their_sum_within_bounds() {
        let mut angles = [3.0, 0.05, 0.4, 0.5];
        spread_angles(&mut angles, Some(2.0 * PI));
        assert!((angles.iter().sum::<f64>() - 2.0 * PI).abs() < 1e-12);
        assert!(
            angles
                .iter()
                .all(|a| *a >= MIN_ANGLE - 1e-12 && *a <= PI - MIN_ANGLE + 1e-12)
        );
    }
}
