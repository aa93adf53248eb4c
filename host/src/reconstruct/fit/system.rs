//! The linear system of a fit: sparse normal equations of the control points under the G1 equations.
//!
//! Minimise x^T H x - 2 b^T x subject to A x = 0 by an augmented Lagrangian: factor H + rho A^T A once per
//! round (its pattern never changes, so the symbolic factorisation is made once per network), then repeat
//! x = solve(b - A^T y), y += rho A x. Redundant equations do no harm and no rank has to be decided.
//!
//! Unknowns are control points as blocks of three coordinates: the distance along a surface normal couples
//! x, y and z. Entries are added in a fixed order on one thread, so results do not depend on threads.

use super::cholesky::{BlockPattern, Cholesky};
use super::fairness::Jump;
use crate::Vec3;
use crate::spline::bernstein::CONTROL_POINTS;
use crate::spline::energy::{PatchForm, THIN_PLATE, THIRD, jump_rows};
use crate::spline::network::{Equation, Network};
use faer::Mat;
use nalgebra::Matrix3;
use std::sync::LazyLock;

/// Entries of the lower triangle of a patch's 21 x 21 form.
pub const PAIRS: usize = CONTROL_POINTS * (CONTROL_POINTS + 1) / 2;

/// Why a system could not be solved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SystemError {
    /// The symbolic or numeric factorisation failed.
    #[error(
        "the equations of the fit could not be factored ({0}); use a coarser tolerance or fewer patches"
    )]
    Factor(String),
    /// The solution is not finite.
    #[error("the fit has no finite solution; check the input for coinciding or far-off points")]
    NotFinite,
}

/// Penalty of the G1 equations relative to the mean diagonal of the energy: large enough to converge in a
/// few steps, small enough that rounding leaves the soft directions alone.
const PENALTY: f64 = 1e4;
/// Most steps of the multipliers, and the residual (relative to the size of the surface) at which they are
/// good enough for the projection to end the work.
const MULTIPLIER_STEPS: usize = 6;
/// Steps of a round after which others follow: its surface only has to tell where the foot points are.
const ROUGH_STEPS: usize = 2;
const ROUGH_RESIDUAL: f64 = 1e-8;
/// Steps of the projection onto the equations, and the residual at which it ends: about 1e-12 degrees.
const PROJECTION_STEPS: usize = 12;
const RESIDUAL: f64 = 1e-16;
/// Added to the diagonal of A A^T, relative to its mean, so that redundant equations can be factored.
const REDUNDANCY: f64 = 1e-11;

/// The sums that data contribute to one patch: lower triangle of 3 x 3 blocks, and the right-hand side.
#[derive(Clone)]
pub struct PatchSums {
    /// Blocks (a, b), a >= b, at a (a + 1) / 2 + b: symmetric, as xx, xy, xz, yy, yz, zz.
    pub blocks: Vec<[f64; 6]>,
    /// Right-hand side per control point.
    pub right: [Vec3; CONTROL_POINTS],
}

impl Default for PatchSums {
    fn default() -> Self {
        Self {
            blocks: vec![[0.0; 6]; PAIRS],
            right: [Vec3::zeros(); CONTROL_POINTS],
        }
    }
}

impl PatchSums {
    /// Adds the patch's own energy, weighted per direction by `metric`.
    pub fn add_energy(&mut self, metric: &Matrix3<f64>) {
        let m = upper(metric);
        let mut slot = 0;
        for a in 0..CONTROL_POINTS {
            for b in 0..=a {
                for (sum, value) in self.blocks[slot].iter_mut().zip(m) {
                    *sum += PATCH_ENERGY[a][b] * value;
                }
                slot += 1;
            }
        }
    }

    /// Adds the square of the linear residual `metric^(1/2) (sum weights * point - target)`.
    pub fn add(&mut self, weights: &[f64; CONTROL_POINTS], metric: &Matrix3<f64>, target: &Vec3) {
        let m = upper(metric);
        let mut slot = 0;
        for a in 0..CONTROL_POINTS {
            for b in 0..=a {
                let product = weights[a] * weights[b];
                for (sum, value) in self.blocks[slot].iter_mut().zip(m) {
                    *sum += product * value;
                }
                slot += 1;
            }
        }
        let pulled = metric * target;
        for (sum, weight) in self.right.iter_mut().zip(weights) {
            *sum += pulled * *weight;
        }
    }
}

/// Pattern, constant parts and symbolic factorisation for one network.
pub struct System {
    count: usize,
    /// Block columns: rows (>= column) of column c stand in rows[starts[c] .. starts[c + 1]], the diagonal first.
    starts: Vec<usize>,
    rows: Vec<u32>,
    /// Column of each block.
    block_columns: Vec<u32>,
    /// Block of each pair of each patch.
    patch_blocks: Vec<[u32; PAIRS]>,
    /// Scalar part (times the unit matrix) of the jump energy and of the G1 equations per block.
    energy: Vec<f64>,
    penalty: Vec<f64>,
    equations: Vec<Equation>,
    /// H + rho A^T A.
    matrix: Cholesky,
    /// A A^T, factored.
    gram: Cholesky,
}

/// Energy of one patch: third derivatives, and a thousandth of the thin plate that keeps quadratics bounded
/// where there are no data.
static PATCH_ENERGY: LazyLock<PatchForm> = LazyLock::new(|| {
    std::array::from_fn(|a| std::array::from_fn(|b| THIRD[a][b] + 1e-3 * THIN_PLATE[a][b]))
});

impl System {
    /// Lays out the system of a network; `scales` weighs the energy of each patch, and that of the jump across each
    /// edge by the larger of its two.
    ///
    /// # Errors
    /// When the symbolic factorisation fails (memory).
    pub fn new(network: &Network, scales: &[f64]) -> Result<Self, SystemError> {
        let count = network.point_count;
        let equations = network.equations();
        let jumps: Vec<(f64, Vec<(u32, f64)>)> = (0..network.table.edges.len())
            .flat_map(|edge| {
                let sides = network.table.edges[edge].sides.iter().flatten();
                let scale = sides.map(|s| scales[s.face as usize]).fold(0.0, f64::max);
                jump_rows(network, edge)
                    .into_iter()
                    .map(move |row| (scale, row))
            })
            .collect();
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        let mut couple = |numbers: &mut Vec<u32>| {
            numbers.sort_unstable();
            for (place, column) in numbers.iter().enumerate() {
                pairs.extend(numbers[place..].iter().map(|row| (*column, *row)));
            }
        };
        for numbers in &network.numbers {
            couple(&mut numbers.to_vec());
        }
        for edge in 0..network.table.edges.len() {
            // All equations and jumps of an edge lie among the points of its two patches' first rows.
            let mut numbers: Vec<u32> = network
                .edge_equations(edge)
                .iter()
                .flat_map(|e| e.terms.iter().map(|t| t.0))
                .collect();
            for row in jump_rows(network, edge) {
                numbers.extend(row.iter().map(|t| t.0));
            }
            numbers.sort_unstable();
            numbers.dedup();
            couple(&mut numbers);
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0; count + 1];
        for (column, _) in &pairs {
            starts[*column as usize + 1] += 1;
        }
        for column in 0..count {
            starts[column + 1] += starts[column];
        }
        let rows: Vec<u32> = pairs.iter().map(|(_, row)| *row).collect();
        let block_columns: Vec<u32> = pairs.iter().map(|(column, _)| *column).collect();
        let block = |a: u32, b: u32| find_block(&starts, &rows, a, b);
        let mut energy = vec![0.0; rows.len()];
        let mut penalty = vec![0.0; rows.len()];
        let mut patch_blocks = Vec::with_capacity(network.numbers.len());
        for numbers in &network.numbers {
            let mut blocks = [0; PAIRS];
            let mut slot = 0;
            for a in 0..CONTROL_POINTS {
                for b in 0..=a {
                    blocks[slot] = block(numbers[a], numbers[b]) as u32;
                    slot += 1;
                }
            }
            patch_blocks.push(blocks);
        }
        let square = |target: &mut Vec<f64>, terms: &[(u32, f64)], weight: f64| {
            for (place, (a, wa)) in terms.iter().enumerate() {
                for (b, wb) in &terms[..=place] {
                    target[block(*a, *b)] += weight * wa * wb;
                }
            }
        };
        for equation in &equations {
            square(&mut penalty, &equation.terms, 1.0);
        }
        for (scale, row) in &jumps {
            square(&mut energy, row, *scale);
        }
        let blocks = BlockPattern {
            starts: &starts,
            rows: &rows,
            size: 3,
        };
        let matrix = Cholesky::new(&blocks, 1).map_err(SystemError::Factor)?;
        Ok(Self {
            matrix,
            count,
            starts,
            rows,
            block_columns,
            patch_blocks,
            energy,
            penalty,
            gram: gram(&equations, count).map_err(SystemError::Factor)?,
            equations,
        })
    }

    /// Minimises the data's squares plus `jump` times the jump energy, `fair.1` times the squared jumps of curvature,
    /// `tether` (relative to the mean diagonal) times the squared distance to `previous`, under the G1 equations: to the last
    /// digits if `exact`, else about to 1e-3 degrees.
    ///
    /// # Errors
    /// When the factorisation fails or the result is not finite.
    pub fn solve(
        &mut self,
        sums: &[PatchSums],
        jump: f64,
        fair: (&[Jump], f64),
        tether: f64,
        previous: &[Vec3],
        size: f64,
        exact: bool,
    ) -> Result<Vec<Vec3>, SystemError> {
        let mut values = vec![0.0; self.matrix.entries()];
        let mut right = vec![Vec3::zeros(); self.count];
        for (patch, blocks) in sums.iter().zip(&self.patch_blocks) {
            for (block, sum) in blocks.iter().zip(&patch.blocks) {
                self.add_block(&mut values, *block as usize, sum);
            }
        }
        // The right-hand side is summed over patches through the same numbering.
        for (patch, blocks) in sums.iter().zip(&self.patch_blocks) {
            for a in 0..CONTROL_POINTS {
                let diagonal = blocks[a * (a + 1) / 2 + a] as usize;
                right[self.rows[diagonal] as usize] += patch.right[a];
            }
        }
        for (block, energy) in self.energy.iter().enumerate() {
            self.add_scalar(&mut values, block, jump * energy);
        }
        for Jump { terms, normal } in fair.0 {
            let metric = upper(&(normal * normal.transpose() * fair.1));
            for (place, (a, left)) in terms.iter().enumerate() {
                for (b, right) in &terms[..=place] {
                    let weight = left * right;
                    self.add_block(&mut values, self.block(*a, *b), &metric.map(|m| m * weight));
                }
            }
        }
        let mut mean = 0.0;
        for column in 0..self.count {
            for k in 0..3 {
                mean += values[self.matrix.columns()[3 * column + k]];
            }
        }
        mean /= (3 * self.count).max(1) as f64;
        if !(mean > 0.0 && mean.is_finite()) {
            return Err(SystemError::NotFinite);
        }
        let hold = tether * mean;
        for column in 0..self.count {
            self.add_scalar(&mut values, self.starts[column], hold);
            right[column] += previous[column] * hold;
        }
        let rho = PENALTY * mean;
        for (block, penalty) in self.penalty.iter().enumerate() {
            self.add_scalar(&mut values, block, rho * penalty);
        }
        self.matrix.factor(&values).map_err(SystemError::Factor)?;
        let mut multipliers = vec![Vec3::zeros(); self.equations.len()];
        let mut points = vec![Vec3::zeros(); self.count];
        let steps = if exact { MULTIPLIER_STEPS } else { ROUGH_STEPS };
        for _ in 0..steps {
            let mut load = right.clone();
            for (equation, multiplier) in self.equations.iter().zip(&multipliers) {
                for (number, weight) in &equation.terms {
                    load[*number as usize] -= multiplier * *weight;
                }
            }
            let mut vector = Mat::from_fn(3 * self.count, 1, |row, _| load[row / 3][row % 3]);
            self.matrix.solve(&mut vector);
            points = (0..self.count)
                .map(|n| Vec3::from_fn(|k, _| vector[(3 * n + k, 0)]))
                .collect();
            if !points.iter().all(|p| p.iter().all(|x| x.is_finite())) {
                return Err(SystemError::NotFinite);
            }
            let residuals = self.residuals(&points);
            for (residual, multiplier) in residuals.iter().zip(&mut multipliers) {
                *multiplier += residual * rho;
            }
            if largest(&residuals) <= ROUGH_RESIDUAL * size {
                break;
            }
        }
        if exact {
            self.project(&mut points, size);
        }
        Ok(points)
    }

    /// The block of two control points that lie in the first three rows beside one edge, or in one patch.
    fn block(&self, a: u32, b: u32) -> usize {
        find_block(&self.starts, &self.rows, a, b)
    }

    /// Residual of each G1 equation.
    fn residuals(&self, points: &[Vec3]) -> Vec<Vec3> {
        self.equations
            .iter()
            .map(|equation| {
                equation
                    .terms
                    .iter()
                    .map(|(number, weight)| points[*number as usize] * *weight)
                    .sum()
            })
            .collect()
    }

    /// Moves the points the least way onto the space of the G1 equations: x -= A^T (A A^T + d)^-1 A x,
    /// repeated because of the small d that bridges redundant equations.
    pub fn project(&mut self, points: &mut [Vec3], size: f64) {
        let mut last = f64::INFINITY;
        for _ in 0..PROJECTION_STEPS {
            let residuals = self.residuals(points);
            let worst = largest(&residuals);
            if worst <= RESIDUAL * size || worst >= last {
                break;
            }
            last = worst;
            let mut vector = Mat::from_fn(residuals.len(), 3, |row, k| residuals[row][k]);
            self.gram.solve(&mut vector);
            for (row, equation) in self.equations.iter().enumerate() {
                let pull = Vec3::from_fn(|k, _| vector[(row, k)]);
                for (number, weight) in &equation.terms {
                    points[*number as usize] -= pull * *weight;
                }
            }
        }
    }

    /// Adds a symmetric 3 x 3 block (xx, xy, xz, yy, yz, zz).
    fn add_block(&self, values: &mut [f64], block: usize, m: &[f64; 6]) {
        const SLOT: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let row = self.rows[block] as usize;
        let column = self.block_columns[block] as usize;
        let place = block - self.starts[column];
        for k in 0..3 {
            let start = self.matrix.columns()[3 * column + k];
            if row == column {
                for i in k..3 {
                    values[start + i - k] += m[SLOT[i][k]];
                }
            } else {
                for i in 0..3 {
                    values[start + (3 - k) + 3 * (place - 1) + i] += m[SLOT[i][k]];
                }
            }
        }
    }

    fn add_scalar(&self, values: &mut [f64], block: usize, scalar: f64) {
        if scalar != 0.0 {
            self.add_block(values, block, &[scalar, 0.0, 0.0, scalar, 0.0, scalar]);
        }
    }
}

/// Factors A A^T (with a little on the diagonal for redundant equations).
fn gram(equations: &[Equation], count: usize) -> Result<Cholesky, String> {
    let mut by_point: Vec<Vec<(u32, f64)>> = vec![Vec::new(); count];
    for (row, equation) in equations.iter().enumerate() {
        for (number, weight) in &equation.terms {
            by_point[*number as usize].push((row as u32, *weight));
        }
    }
    let mut products = Vec::new();
    let mut trace = 0.0;
    for terms in &by_point {
        for (place, (a, wa)) in terms.iter().enumerate() {
            trace += wa * wa;
            for (b, wb) in &terms[..=place] {
                products.push((*b.min(a), *b.max(a), wa * wb));
            }
        }
    }
    let little = REDUNDANCY * trace / equations.len().max(1) as f64;
    products.extend((0..equations.len() as u32).map(|row| (row, row, little)));
    // Stable, so that equal places are summed in the order in which they arose.
    products.sort_by_key(|(column, row, _)| (*column, *row));
    let mut starts = vec![0];
    let (mut rows, mut values) = (Vec::new(), Vec::<f64>::new());
    let mut last = None;
    for (column, row, value) in products {
        match values.last_mut() {
            Some(sum) if last == Some((column, row)) => *sum += value,
            _ => {
                while starts.len() <= column as usize {
                    starts.push(rows.len());
                }
                rows.push(row);
                values.push(value);
            }
        }
        last = Some((column, row));
    }
    if !equations.is_empty() {
        starts.push(rows.len());
    }
    let blocks = BlockPattern {
        starts: &starts,
        rows: &rows,
        size: 1,
    };
    let mut factor = Cholesky::new(&blocks, 3)?;
    factor.factor(&values)?;
    Ok(factor)
}

/// Place of the block of control points `a` and `b` in the pattern.
fn find_block(starts: &[usize], rows: &[u32], a: u32, b: u32) -> usize {
    let (column, row) = (a.min(b) as usize, a.max(b));
    let range = &rows[starts[column]..starts[column + 1]];
    starts[column] + range.binary_search(&row).unwrap_or(0)
}

/// Entries xx, xy, xz, yy, yz, zz.
fn upper(m: &Matrix3<f64>) -> [f64; 6] {
    [
        m[(0, 0)],
        m[(0, 1)],
        m[(0, 2)],
        m[(1, 1)],
        m[(1, 2)],
        m[(2, 2)],
    ]
}

fn largest(residuals: &[Vec3]) -> f64 {
    residuals.iter().map(Vec3::norm).fold(0.0, f64::max)
}
