//! The recursion of all basis functions of one triangle, with every shared sub-term computed once.
//!
//! A simplex spline is told by its set of knots, and the basis functions of a triangle have most of their
//! subsets in common. So a triangle's recursion is laid out once as a list of steps, smallest subsets first;
//! a step takes three earlier results and the barycentric coordinates of one triple W. To evaluate is to
//! walk through the list: no search, no branch, no allocation.
//!
//! Which W is taken decides how much is shared. The last knots of each cloud (v_{i,b0}, v_{j,b1}, v_{k,b2})
//! lead from V_beta to its neighbours in the same family, so they are taken whenever their triangle is at least
//! [`SHARING_SHARE`] of the widest one in the subset, and the widest otherwise. So barycentric coordinates stay
//! below 1 / `SHARING_SHARE` in size within the hull, which bounds the loss of digits.

use std::collections::{BTreeMap, BTreeSet};

use super::orientation::{Approach, place, side_of_line, twice_area};
use super::{Vec2, exponents};

/// How large the sharing triple's triangle must be, as a share of the widest. On jittered grids with clouds of an
/// eighth of the edge, 0.02 to 0.5 give the same list (degree 5: 143 constants, 334 steps, against 5103 pieces of the
/// plain recursion); above 1 nothing is taken for its sharing (degree 2: 29 constants instead of 23). The smaller
/// half of that range would only let large coordinates in where clouds are as wide as the triangle.
const SHARING_SHARE: f64 = 0.25;

/// Value, gradient and Hessian matrix of a function of the parameter plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet<T> {
    /// The value.
    pub value: T,
    /// First derivatives by u.x and u.y.
    pub gradient: [T; 2],
    /// Second derivatives xx, xy, yy.
    pub hessian: [T; 3],
}

/// Steps to evaluate the simplex splines of all basis functions of one triangle.
#[derive(Clone, Debug)]
pub(super) struct Program {
    /// Convex hull of all knots, counter-clockwise; everything is zero outside.
    hull: Vec<Vec2>,
    /// Pairs of knots that span a line some constant piece or triple is bounded by.
    lines: Vec<[u8; 2]>,
    /// Constant pieces: values 1 to their number.
    triangles: Vec<Constant>,
    /// Triples whose barycentric coordinates are needed.
    triples: Vec<Triple>,
    /// Results of higher degree, in order; values after the constant pieces.
    steps: Vec<Step>,
    /// Result of each basis function and its factor |d(v_{i,b0}, v_{j,b1}, v_{k,b2})|.
    outputs: Vec<(u16, f64)>,
}

/// 1/|d| on a half-open triangle.
#[derive(Clone, Copy, Debug)]
struct Constant {
    lines: [u16; 3],
    /// The sides on which a point inside lies, 1 left and -1 right.
    sides: [i8; 3],
    height: f64,
}

/// A barycentric coordinate is the determinant of the line opposite its knot, times a scale.
#[derive(Clone, Copy, Debug)]
struct Triple {
    /// Lines opposite knots 0, 1, 2.
    lines: [u16; 3],
    scales: [f64; 3],
    gradients: [Vec2; 3],
}

#[derive(Clone, Copy, Debug)]
struct Step {
    triple: u16,
    degree: u8,
    /// Values (0 is the number zero) of the subsets without the triple's knots 0, 1, 2.
    without: [u16; 3],
}

/// Room for intermediate results, to be used again from point to point.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    placements: Vec<(f64, i8)>,
    coordinates: Vec<[f64; 3]>,
    values: Vec<f64>,
    jets: Vec<[f64; 6]>,
}

impl Program {
    /// For the three knot clouds of a triangle, each of degree + 1 knots.
    pub(super) fn new(clouds: [&[Vec2]; 3]) -> Self {
        let size = clouds[0].len();
        let degree = size - 1;
        let knots: Vec<Vec2> = clouds.concat();
        let mut levels: Vec<BTreeSet<u32>> = vec![BTreeSet::new(); degree + 1];
        let roots: Vec<(u32, f64)> = exponents(degree)
            .map(|beta| {
                let set = (0..3).fold(0, |set, cloud| {
                    set | (((1_u32 << (beta[cloud] + 1)) - 1) << (cloud * size))
                });
                let last = [0, 1, 2].map(|cloud| clouds[cloud][beta[cloud]]);
                (set, twice_area(last[0], last[1], last[2]).abs())
            })
            .collect();
        levels[degree].extend(roots.iter().map(|(set, _)| *set));
        let mut chosen = BTreeMap::new();
        for level in (0..=degree).rev() {
            for set in std::mem::take(&mut levels[level]) {
                // Subsets on one line are zero and need no entry.
                if let Some(triple) = triple_of(set, &knots, size) {
                    chosen.insert((level, set), triple);
                    if level > 0 {
                        levels[level - 1].extend(triple.map(|knot| set & !(1 << knot)));
                    }
                }
            }
        }
        let mut program = Self {
            hull: convex_hull(&knots),
            lines: Vec::new(),
            triangles: Vec::new(),
            triples: Vec::new(),
            steps: Vec::new(),
            outputs: Vec::new(),
        };
        let mut value_of: BTreeMap<u32, u16> = BTreeMap::new();
        let mut line_of: BTreeMap<[u8; 2], u16> = BTreeMap::new();
        let mut number_of_triple: BTreeMap<[u8; 3], u16> = BTreeMap::new();
        for ((level, set), triple) in chosen {
            value_of.insert(set, value_of.len() as u16 + 1);
            let [a, b, c] = triple.map(|knot| knots[usize::from(knot)]);
            let area = twice_area(a, b, c);
            // Edge e runs from knot e + 1 to knot e + 2, so opposite knot e; turned, it is told by a sign of -1.
            let mut lines_around = |lines: &mut Vec<[u8; 2]>| {
                let mut signs = [1; 3];
                let numbers = [0, 1, 2].map(|edge| {
                    let mut line = [triple[(edge + 1) % 3], triple[(edge + 2) % 3]];
                    if line[0] > line[1] {
                        line.swap(0, 1);
                        signs[edge] = -1;
                    }
                    *line_of.entry(line).or_insert_with(|| {
                        lines.push(line);
                        lines.len() as u16 - 1
                    })
                });
                (numbers, signs)
            };
            if level == 0 {
                let (lines, signs) = lines_around(&mut program.lines);
                let turn = side_of_line(a, b, c, Approach::from_side(Vec2::zeros()));
                program.triangles.push(Constant {
                    lines,
                    sides: signs.map(|sign| sign * turn),
                    height: 1.0 / area.abs(),
                });
            } else {
                let number = *number_of_triple.entry(triple).or_insert_with(|| {
                    let (lines, signs) = lines_around(&mut program.lines);
                    let across = |edge: Vec2| Vec2::new(-edge.y, edge.x) / area;
                    program.triples.push(Triple {
                        lines,
                        scales: signs.map(|sign| f64::from(sign) / area),
                        gradients: [across(c - b), across(a - c), across(b - a)],
                    });
                    program.triples.len() as u16 - 1
                });
                program.steps.push(Step {
                    triple: number,
                    degree: level as u8,
                    without: triple
                        .map(|knot| value_of.get(&(set & !(1 << knot))).copied().unwrap_or(0)),
                });
            }
        }
        program.outputs = roots
            .into_iter()
            .map(|(set, factor)| (value_of.get(&set).copied().unwrap_or(0), factor))
            .collect();
        program
    }

    /// Number of steps, for tests and documentation of the cost.
    #[cfg(test)]
    pub(super) fn size(&self) -> (usize, usize) {
        (self.triangles.len(), self.steps.len())
    }

    /// Values of all basis functions at `u`.
    pub(super) fn values(
        &self,
        knot: impl Fn(usize) -> Vec2,
        u: Vec2,
        approach: Approach,
        scratch: &mut Scratch,
        out: &mut [f64],
    ) {
        if !self.constants(knot, u, approach, scratch) {
            out.fill(0.0);
            return;
        }
        self.coordinates(scratch);
        for step in &self.steps {
            let b = scratch.coordinates[usize::from(step.triple)];
            let [x, y, z] = step.without.map(|value| scratch.values[usize::from(value)]);
            scratch.values.push(b[0] * x + b[1] * y + b[2] * z);
        }
        for (slot, (value, factor)) in out.iter_mut().zip(&self.outputs) {
            *slot = factor * scratch.values[usize::from(*value)];
        }
    }

    /// Values and derivatives to second order of all basis functions at `u`.
    pub(super) fn jets(
        &self,
        knot: impl Fn(usize) -> Vec2,
        u: Vec2,
        approach: Approach,
        scratch: &mut Scratch,
        out: &mut [Jet<f64>],
    ) {
        if !self.constants(knot, u, approach, scratch) {
            out.fill(Jet {
                value: 0.0,
                gradient: [0.0; 2],
                hessian: [0.0; 3],
            });
            return;
        }
        self.coordinates(scratch);
        scratch.jets.clear();
        scratch.jets.extend(
            scratch
                .values
                .iter()
                .map(|value| [*value, 0.0, 0.0, 0.0, 0.0, 0.0]),
        );
        for step in &self.steps {
            let b = scratch.coordinates[usize::from(step.triple)];
            let [g0, g1, g2] = self.triples[usize::from(step.triple)].gradients;
            let [x, y, z] = step.without.map(|value| scratch.jets[usize::from(value)]);
            let n = f64::from(step.degree);
            let along_x = |part: usize| n * (g0.x * x[part] + g1.x * y[part] + g2.x * z[part]);
            let along_y = |part: usize| n * (g0.y * x[part] + g1.y * y[part] + g2.y * z[part]);
            scratch.jets.push([
                b[0] * x[0] + b[1] * y[0] + b[2] * z[0],
                along_x(0),
                along_y(0),
                along_x(1),
                along_x(2),
                along_y(2),
            ]);
        }
        for (slot, (value, factor)) in out.iter_mut().zip(&self.outputs) {
            let [v, x, y, xx, xy, yy] = scratch.jets[usize::from(*value)].map(|part| factor * part);
            *slot = Jet {
                value: v,
                gradient: [x, y],
                hessian: [xx, xy, yy],
            };
        }
    }

    /// Derivative of the given order along one direction, of all basis functions at `u`.
    pub(super) fn directional(
        &self,
        knot: impl Fn(usize) -> Vec2,
        u: Vec2,
        approach: Approach,
        direction: Vec2,
        order: usize,
        scratch: &mut Scratch,
        out: &mut [f64],
    ) {
        out.fill(0.0);
        if !self.constants(knot, u, approach, scratch) {
            return;
        }
        self.coordinates(scratch);
        // The first `order` levels from the top differentiate, the rest evaluate.
        let top = self.steps.last().map_or(0, |step| usize::from(step.degree));
        if order > top {
            return;
        }
        for step in &self.steps {
            let [x, y, z] = step.without.map(|value| scratch.values[usize::from(value)]);
            let b = if usize::from(step.degree) + order > top {
                self.triples[usize::from(step.triple)]
                    .gradients
                    .map(|g| g.dot(&direction) * f64::from(step.degree))
            } else {
                scratch.coordinates[usize::from(step.triple)]
            };
            scratch.values.push(b[0] * x + b[1] * y + b[2] * z);
        }
        for (slot, (value, factor)) in out.iter_mut().zip(&self.outputs) {
            *slot = factor * scratch.values[usize::from(*value)];
        }
    }

    /// Fills in the constant pieces; false if `u` lies in none.
    fn constants(
        &self,
        knot: impl Fn(usize) -> Vec2,
        u: Vec2,
        approach: Approach,
        scratch: &mut Scratch,
    ) -> bool {
        if self.is_beyond(u) {
            return false;
        }
        scratch.placements.clear();
        scratch.placements.extend(
            self.lines
                .iter()
                .map(|line| place(knot(line[0].into()), knot(line[1].into()), u, approach)),
        );
        scratch.values.clear();
        scratch.values.push(0.0);
        let mut any = false;
        for piece in &self.triangles {
            let inside = (0..3).all(|edge| {
                scratch.placements[usize::from(piece.lines[edge])].1 == piece.sides[edge]
            });
            any |= inside;
            scratch.values.push(if inside { piece.height } else { 0.0 });
        }
        any
    }

    /// Whether `u` lies outside of the hull by more than rounding can make of it. Two thirds of the triangles whose
    /// box holds a point are passed over here.
    fn is_beyond(&self, u: Vec2) -> bool {
        (0..self.hull.len()).any(|corner| {
            let from = self.hull[corner] - u;
            let to = self.hull[(corner + 1) % self.hull.len()] - u;
            let (left, right) = (from.x * to.y, from.y * to.x);
            left - right < -1e-14 * (left.abs() + right.abs())
        })
    }

    fn coordinates(&self, scratch: &mut Scratch) {
        scratch.coordinates.clear();
        scratch
            .coordinates
            .extend(self.triples.iter().map(|triple| {
                [0, 1, 2]
                    .map(|i| scratch.placements[usize::from(triple.lines[i])].0 * triple.scales[i])
            }));
    }
}

/// Corners of the convex hull, counter-clockwise (Andrew's monotone chain).
fn convex_hull(knots: &[Vec2]) -> Vec<Vec2> {
    let mut sorted = knots.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    let mut hull: Vec<Vec2> = Vec::new();
    for _ in 0..2 {
        let first = hull.len();
        for knot in &sorted {
            while hull.len() > first + 1 {
                let [a, b] = [hull[hull.len() - 2], hull[hull.len() - 1]];
                if twice_area(a, b, *knot) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(*knot);
        }
        // The end of one half is the start of the other.
        hull.pop();
        sorted.reverse();
    }
    hull
}

/// The triple W of a set of knots: the last knot of each cloud if they span enough, else the widest; `None` if
/// all lie on one line.
fn triple_of(set: u32, knots: &[Vec2], size: usize) -> Option<[u8; 3]> {
    let members: Vec<u8> = (0..knots.len() as u8)
        .filter(|knot| set >> knot & 1 == 1)
        .collect();
    let area = |triple: [u8; 3]| {
        let [a, b, c] = triple.map(|knot| knots[usize::from(knot)]);
        twice_area(a, b, c).abs()
    };
    let mut widest = ([0; 3], 0.0);
    for (i, &a) in members.iter().enumerate() {
        for (j, &b) in members.iter().enumerate().skip(i + 1) {
            for &c in &members[j + 1..] {
                let size = area([a, b, c]);
                if size > widest.1 {
                    widest = ([a, b, c], size);
                }
            }
        }
    }
    if widest.1 == 0.0 {
        return None;
    }
    let last_of = |cloud: usize| {
        members
            .iter()
            .rev()
            .find(|knot| usize::from(**knot) / size == cloud)
            .copied()
    };
    if let (Some(a), Some(b), Some(c)) = (last_of(0), last_of(1), last_of(2))
        && area([a, b, c]) >= SHARING_SHARE * widest.1
    {
        return Some([a, b, c]);
    }
    Some(widest.0)
}
