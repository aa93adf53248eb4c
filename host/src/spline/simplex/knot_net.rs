//! A planar triangulation whose vertices carry knot clouds, and its normalised basis functions.
//!
//! For triangle (i, j, k) and beta = (b0, b1, b2), b0 + b1 + b2 = n, the knots of basis function beta are
//! V_beta = {v_{i,0..b0}, v_{j,0..b1}, v_{k,0..b2}}, and N(u|V_beta) = |d(v_{i,b0}, v_{j,b1}, v_{k,b2})| M(u|V_beta).
//! All N together are a partition of unity over the region that no missing neighbour's knots reach: give the
//! triangulation a ring of extra triangles, or pull the border's clouds together on their vertices.

use std::collections::BTreeMap;

use super::orientation::{Approach, side_of_line};
use super::program::{Jet, Program, Scratch};
use super::{MAX_DEGREE, SimplexError, Vec2, exponent_count, exponents};

/// A triangulation with knot clouds, ready to evaluate basis functions.
#[derive(Clone, Debug)]
pub struct KnotNet {
    degree: usize,
    /// Knots of vertex v at v (n + 1) and the following.
    knots: Vec<Vec2>,
    triangles: Vec<[u32; 3]>,
    programs: Vec<Program>,
    /// Bounding box of all knots of each triangle; its basis functions are zero outside.
    boxes: Vec<[Vec2; 2]>,
    cells: Cells,
}

/// Room for intermediate results; one per thread, to be used again from point to point.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    scratch: Scratch,
    pub(super) values: Vec<f64>,
    pub(super) jets: Vec<Jet<f64>>,
}

/// Square cells over the plane, each with the triangles whose box reaches into it, in rising order.
#[derive(Clone, Debug)]
struct Cells {
    low: Vec2,
    width: f64,
    columns: usize,
    rows: usize,
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl KnotNet {
    /// From the knot clouds of the vertices (degree + 1 each, the vertex itself first) and the triangles,
    /// counter-clockwise.
    ///
    /// # Errors
    /// [`SimplexError`] if the degree is not 1 to 5, a cloud has another size or a knot that is not finite, a
    /// triangle names a vertex that is not there, or the knots v_{i,b0}, v_{j,b1}, v_{k,b2} of a triangle are not
    /// counter-clockwise for some b0 + b1 + b2 <= n.
    pub fn new(
        degree: usize,
        clouds: &[Vec<Vec2>],
        triangles: Vec<[u32; 3]>,
    ) -> Result<Self, SimplexError> {
        if !(1..=MAX_DEGREE).contains(&degree) {
            return Err(SimplexError::Degree(degree));
        }
        for (vertex, cloud) in clouds.iter().enumerate() {
            if cloud.len() != degree + 1 {
                return Err(SimplexError::KnotCount {
                    vertex,
                    found: cloud.len(),
                    degree,
                });
            }
            for (knot, at) in cloud.iter().enumerate() {
                if !(at.x.is_finite() && at.y.is_finite()) {
                    return Err(SimplexError::KnotNotFinite {
                        vertex,
                        knot,
                        x: at.x,
                        y: at.y,
                    });
                }
            }
        }
        let mut programs = Vec::with_capacity(triangles.len());
        let mut boxes = Vec::with_capacity(triangles.len());
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners
                .iter()
                .find(|vertex| **vertex as usize >= clouds.len())
            {
                return Err(SimplexError::NoSuchVertex {
                    triangle,
                    vertex,
                    vertices: clouds.len(),
                });
            }
            let clouds = corners.map(|vertex| clouds[vertex as usize].as_slice());
            for knots in (0..=degree).flat_map(exponents) {
                let [a, b, c] = [0, 1, 2].map(|corner| clouds[corner][knots[corner]]);
                if side_of_line(a, b, c, Approach::from_side(Vec2::zeros())) != 1 {
                    return Err(SimplexError::Folded { triangle, knots });
                }
            }
            programs.push(Program::new(clouds));
            let all = clouds.into_iter().flatten();
            boxes.push([
                all.clone().fold(clouds[0][0], |low, knot| low.inf(knot)),
                all.fold(clouds[0][0], |high, knot| high.sup(knot)),
            ]);
        }
        Ok(Self {
            degree,
            knots: clouds.concat(),
            triangles,
            programs,
            cells: Cells::new(&boxes),
            boxes,
        })
    }

    /// With every cloud pulled together on its vertex: the Bernstein polynomials of each triangle.
    ///
    /// # Errors
    /// As [`KnotNet::new`].
    pub fn clamped(
        degree: usize,
        vertices: &[Vec2],
        triangles: Vec<[u32; 3]>,
    ) -> Result<Self, SimplexError> {
        let clouds: Vec<Vec<Vec2>> = vertices
            .iter()
            .map(|vertex| vec![*vertex; degree + 1])
            .collect();
        Self::new(degree, &clouds, triangles)
    }

    /// Degree of the basis functions.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Vertices of each triangle.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.knots.len() / (self.degree + 1)
    }

    /// Knots of a vertex, itself first; empty if there is no such vertex.
    pub fn cloud(&self, vertex: usize) -> &[Vec2] {
        let size = self.degree + 1;
        self.knots
            .get(vertex * size..(vertex + 1) * size)
            .unwrap_or(&[])
    }

    /// Basis functions of each triangle: (n + 1)(n + 2) / 2.
    pub fn functions_per_triangle(&self) -> usize {
        exponent_count(self.degree)
    }

    /// Basis functions of the net; number t * `functions_per_triangle` + b is number b of triangle t.
    pub fn functions(&self) -> usize {
        self.triangles.len() * self.functions_per_triangle()
    }

    /// The n knots at which a polynomial's blossom is the control point of each basis function of a triangle:
    /// (v_{i,0..b0-1}, v_{j,0..b1-1}, v_{k,0..b2-1}). Empty if there is no such triangle.
    pub fn blossom_arguments(&self, triangle: usize) -> Vec<Vec<Vec2>> {
        let Some(corners) = self.triangles.get(triangle) else {
            return Vec::new();
        };
        exponents(self.degree)
            .map(|beta| {
                (0..3)
                    .flat_map(|corner| &self.cloud(corners[corner] as usize)[..beta[corner]])
                    .copied()
                    .collect()
            })
            .collect()
    }

    /// A number for each basis function, the same for those of neighbours whose blossom arguments agree: one per
    /// vertex, n - 1 per edge, (n - 1)(n - 2) / 2 per triangle. Control points shared by this numbering still give every
    /// polynomial of degree n. Returns the numbers in the order of the basis functions and how many there are.
    pub fn shared_numbers(&self) -> (Vec<u32>, usize) {
        let mut known = BTreeMap::new();
        let numbers = self
            .triangles
            .iter()
            .flat_map(|corners| {
                exponents(self.degree).map(move |beta| {
                    let mut key = [0, 1, 2].map(|k| (corners[k], beta[k]));
                    for part in &mut key {
                        if part.1 == 0 {
                            part.0 = u32::MAX;
                        }
                    }
                    key.sort_unstable();
                    key
                })
            })
            .map(|key| {
                let next = known.len() as u32;
                *known.entry(key).or_insert(next)
            })
            .collect();
        (numbers, known.len())
    }

    /// Where the control points of the identity lie: the mean of each set of blossom arguments, in the order of
    /// the basis functions.
    pub fn greville_points(&self) -> Vec<Vec2> {
        (0..self.triangles.len())
            .flat_map(|triangle| self.blossom_arguments(triangle))
            .map(|knots| knots.iter().sum::<Vec2>() / self.degree as f64)
            .collect()
    }

    /// Triangles whose basis functions may differ from zero at `u`, in rising order.
    pub fn triangles_at(&self, u: Vec2) -> impl Iterator<Item = usize> + '_ {
        self.cells
            .at(u)
            .iter()
            .map(|triangle| *triangle as usize)
            .filter(move |triangle| {
                let [low, high] = self.boxes[*triangle];
                low.x <= u.x && u.x <= high.x && low.y <= u.y && u.y <= high.y
            })
    }

    /// Values of a triangle's basis functions at `u`.
    ///
    /// # Panics
    /// If there is no such triangle.
    pub fn values<'a>(
        &self,
        triangle: usize,
        u: Vec2,
        approach: Approach,
        workspace: &'a mut Workspace,
    ) -> &'a [f64] {
        workspace.values.resize(self.functions_per_triangle(), 0.0);
        self.programs[triangle].values(
            self.knots_of(triangle),
            u,
            approach,
            &mut workspace.scratch,
            &mut workspace.values,
        );
        &workspace.values
    }

    /// Values and derivatives to second order of a triangle's basis functions at `u`.
    ///
    /// # Panics
    /// If there is no such triangle.
    pub fn jets<'a>(
        &self,
        triangle: usize,
        u: Vec2,
        approach: Approach,
        workspace: &'a mut Workspace,
    ) -> &'a [Jet<f64>] {
        let zero = Jet {
            value: 0.0,
            gradient: [0.0; 2],
            hessian: [0.0; 3],
        };
        workspace.jets.resize(self.functions_per_triangle(), zero);
        self.programs[triangle].jets(
            self.knots_of(triangle),
            u,
            approach,
            &mut workspace.scratch,
            &mut workspace.jets,
        );
        &workspace.jets
    }

    /// Derivatives of the given order along `direction` of a triangle's basis functions at `u`, exact from the
    /// side of `approach`.
    ///
    /// # Panics
    /// If there is no such triangle.
    pub fn directional<'a>(
        &self,
        triangle: usize,
        u: Vec2,
        approach: Approach,
        direction: Vec2,
        order: usize,
        workspace: &'a mut Workspace,
    ) -> &'a [f64] {
        workspace.values.resize(self.functions_per_triangle(), 0.0);
        self.programs[triangle].directional(
            self.knots_of(triangle),
            u,
            approach,
            direction,
            order,
            &mut workspace.scratch,
            &mut workspace.values,
        );
        &workspace.values
    }

    /// Knots of a triangle by their number in its program: the three clouds one after the other.
    fn knots_of(&self, triangle: usize) -> impl Fn(usize) -> Vec2 + '_ {
        let size = self.degree + 1;
        let clouds = self.triangles[triangle].map(|vertex| self.cloud(vertex as usize));
        move |knot| clouds[knot / size][knot % size]
    }

    #[cfg(test)]
    pub(super) fn program_size(&self, triangle: usize) -> (usize, usize) {
        self.programs[triangle].size()
    }
}

impl Cells {
    /// About one cell per triangle.
    fn new(boxes: &[[Vec2; 2]]) -> Self {
        let Some(first) = boxes.first() else {
            return Self {
                low: Vec2::zeros(),
                width: 1.0,
                columns: 0,
                rows: 0,
                starts: vec![0],
                triangles: Vec::new(),
            };
        };
        let (low, high) = boxes
            .iter()
            .fold((first[0], first[1]), |(low, high), box_| {
                (low.inf(&box_[0]), high.sup(&box_[1]))
            });
        let extent = high - low;
        // Long strips get no more than four times as many cells as there are triangles.
        let area = extent.x * extent.y / boxes.len() as f64;
        let width = area
            .sqrt()
            .max(extent.max() / (2 * boxes.len()) as f64)
            .max(f64::MIN_POSITIVE);
        let columns = (extent.x / width) as usize + 1;
        let rows = (extent.y / width) as usize + 1;
        let mut cells = Self {
            low,
            width,
            columns,
            rows,
            starts: Vec::new(),
            triangles: Vec::new(),
        };
        let mut members = vec![Vec::new(); columns * rows];
        for (triangle, [low, high]) in boxes.iter().enumerate() {
            let (first, last) = (cells.cell_of(*low), cells.cell_of(*high));
            for row in first.1..=last.1 {
                for column in first.0..=last.0 {
                    members[row * columns + column].push(triangle as u32);
                }
            }
        }
        cells.starts.push(0);
        for cell in members {
            cells.triangles.extend(cell);
            cells.starts.push(cells.triangles.len() as u32);
        }
        cells
    }

    /// Column and row, clamped to the cells there are.
    fn cell_of(&self, u: Vec2) -> (usize, usize) {
        let cell = (u - self.low) / self.width;
        (
            (cell.x.max(0.0) as usize).min(self.columns - 1),
            (cell.y.max(0.0) as usize).min(self.rows - 1),
        )
    }

    fn at(&self, u: Vec2) -> &[u32] {
        if self.columns == 0 {
            return &[];
        }
        let (column, row) = self.cell_of(u);
        let cell = row * self.columns + column;
        &self.triangles[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}
