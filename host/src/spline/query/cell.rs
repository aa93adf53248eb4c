//! A triangular part of a patch, with what certifies a closest point on it.
//!
//! The squared distance f = |S - q|^2 / 2 has the Hessian |S_d|^2 + (S - q) . S_dd along d. With c the part's middle it is
//! the sum of |S_d|^2 + (S - c) . S_dd, which does not depend on q, and of (c - q) . S_dd: polynomials of degree 8 and 3,
//! bounded by their coefficients. Where the sum of the bounds is positive for all d, f is convex on the part and a foot
//! point there is the only one.
//!
//! Two tests of convexity were weighed: the coefficients of the whole Hessian at every query (tight, microseconds) and this
//! one, which bounds the first polynomial once per part (looser where it varies). The second was taken: halving the part
//! makes up for it, and most parts never need it.

use super::super::bernstein::{CONTROL_POINTS, DEGREE, EXPONENTS, count, index};
use super::super::surface::lower;
use crate::Vec3;
use std::sync::LazyLock;

/// Coefficients of the first and second derivatives, and of the part of the Hessian that does not depend on the query.
const FIRST: usize = count(DEGREE - 1);
const SECOND: usize = count(DEGREE - 2);
const HESSIAN: usize = count(2 * DEGREE - 2);

/// Part of a patch.
#[derive(Clone, Debug)]
pub(super) struct Cell {
    /// The patch.
    pub face: u32,
    /// Corners in the patch's barycentric coordinates.
    pub corners: [[f64; 3]; 3],
    /// Control points of the part as a patch of its own.
    pub points: [Vec3; CONTROL_POINTS],
    /// The point at its middle.
    pub place: Vec3,
}

/// How much a part bends: tells where the distance to it is convex.
#[derive(Clone, Debug)]
pub(super) struct Bend {
    /// Lower bound of |S_d|^2 + (S - place) . S_dd over the part and all d with |S_d| = 1 at its middle.
    stretch: f64,
    /// Coefficients of S_xx, S_xy, S_yy in directions x, y whose tangents at the middle are orthonormal.
    second: [[Vec3; 3]; SECOND],
}

impl Cell {
    /// The part of a patch between `corners`, by its blossom.
    pub fn new(patch: &[Vec3; CONTROL_POINTS], face: u32, corners: [[f64; 3]; 3]) -> Self {
        let points = EXPONENTS.map(|exponents| {
            let mut work = *patch;
            let arguments =
                (0..3).flat_map(|c| std::iter::repeat_n(corners[c], exponents[c].into()));
            for (degree, argument) in (0..DEGREE).rev().zip(arguments) {
                lower(&mut work, degree, argument);
            }
            work[0]
        });
        Self::with(points, face, corners)
    }

    fn with(points: [Vec3; CONTROL_POINTS], face: u32, corners: [[f64; 3]; 3]) -> Self {
        Self {
            face,
            corners,
            place: middle(&points, DEGREE),
            points,
        }
    }

    /// Box of the control points, which hold the part.
    pub fn hull_box(&self) -> (Vec3, Vec3) {
        let first = self.points[0];
        self.points
            .iter()
            .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)))
    }

    /// Squared distance that no point of the part undercuts: the control points lie beyond a plane across the way to the
    /// part's middle.
    pub fn beyond(&self, target: &Vec3) -> f64 {
        let way = self.place - target;
        let nearest = self
            .points
            .iter()
            .map(|p| (p - target).dot(&way))
            .fold(f64::INFINITY, f64::min)
            .max(0.0);
        let length2 = way.norm_squared();
        if length2 > 0.0 {
            nearest * nearest / length2
        } else {
            0.0
        }
    }

    /// The two halves on both sides of the middle of the longest edge.
    pub fn halves(&self) -> [Self; 2] {
        let at = [0, 15, 20].map(|k| self.points[k]);
        let length = |m: usize| (at[(m + 1) % 3] - at[m]).norm_squared();
        let from = (0..3).fold(0, |m, n| if length(n) > length(m) { n } else { m });
        let to = (from + 1) % 3;
        let mut half = [0.0; 3];
        half[from] = 0.5;
        half[to] = 0.5;
        let mut halves = [self.points; 2];
        let mut work = self.points;
        for step in 1..=DEGREE {
            lower(&mut work, DEGREE - step, half);
            for (points, corner) in halves.iter_mut().zip([from, to]) {
                for (number, exponents) in EXPONENTS.iter().enumerate() {
                    if usize::from(exponents[corner]) == step {
                        let mut rest = *exponents;
                        rest[corner] = 0;
                        points[number] = work[index(rest)];
                    }
                }
            }
        }
        let split: [f64; 3] =
            std::array::from_fn(|m| 0.5 * (self.corners[from][m] + self.corners[to][m]));
        let mut corner = [from, to].into_iter();
        halves.map(|points| {
            let mut corners = self.corners;
            corners[corner.next().unwrap_or(from)] = split;
            Self::with(points, self.face, corners)
        })
    }

    /// Coordinates within the part as coordinates of the patch.
    pub fn of_patch(&self, local: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|m| (0..3).map(|c| local[c] * self.corners[c][m]).sum())
    }

    /// Coordinates of the patch as coordinates within the part, moved into it.
    pub fn local(&self, at: [f64; 3]) -> [f64; 3] {
        let [a, b, c] = self.corners;
        let (e, f) = ([b[1] - a[1], b[2] - a[2]], [c[1] - a[1], c[2] - a[2]]);
        let d = [at[1] - a[1], at[2] - a[2]];
        let det = e[0] * f[1] - e[1] * f[0];
        let inside = [
            (d[0] * f[1] - d[1] * f[0]) / det,
            (e[0] * d[1] - e[1] * d[0]) / det,
        ];
        let all = [1.0 - inside[0] - inside[1], inside[0], inside[1]].map(|x| x.max(0.0));
        let sum: f64 = all.iter().sum();
        all.map(|x| x / sum)
    }
}

impl Bend {
    /// How `cell` bends.
    pub fn new(cell: &Cell) -> Self {
        let [du, dv] = differences(&cell.points, DEGREE);
        let (u, v) = (middle(&du, DEGREE - 1), middle(&dv, DEGREE - 1));
        // x = s u and y = t v + r u have orthonormal tangents at the middle.
        let s = 1.0 / u.norm();
        let along = u * s;
        let t = 1.0 / (v - along * along.dot(&v)).norm();
        let r = -along.dot(&v) * s * t;
        let first: [[Vec3; 2]; FIRST] = std::array::from_fn(|k| [du[k] * s, dv[k] * t + du[k] * r]);
        let [uu, uv] = differences(&du, DEGREE - 1);
        let [_, vv] = differences(&dv, DEGREE - 1);
        let second: [[Vec3; 3]; SECOND] = std::array::from_fn(|k| {
            [
                uu[k] * (s * s),
                uv[k] * (s * t) + uu[k] * (s * r),
                vv[k] * (t * t) + uv[k] * (2.0 * t * r) + uu[k] * (r * r),
            ]
        });
        let mut forms = [[0.0; 3]; HESSIAN];
        for product in &PRODUCTS.0 {
            let [[ax, ay], [bx, by]] = [first[product.left], first[product.right]];
            let form = &mut forms[product.of];
            form[0] += product.weight * ax.dot(&bx);
            form[1] += product.weight * 0.5 * (ax.dot(&by) + ay.dot(&bx));
            form[2] += product.weight * ay.dot(&by);
        }
        for product in &PRODUCTS.1 {
            let from = cell.points[product.left] - cell.place;
            let form = &mut forms[product.of];
            for (entry, second) in form.iter_mut().zip(&second[product.right]) {
                *entry += product.weight * from.dot(second);
            }
        }
        let stretch = forms
            .iter()
            .map(|[a, b, c]| 0.5 * (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt()))
            .fold(f64::INFINITY, f64::min);
        Self { stretch, second }
    }

    /// Whether the squared distance from `target` is certainly convex on the part, `cell`.
    pub fn convex(&self, cell: &Cell, target: &Vec3) -> bool {
        let way = cell.place - target;
        self.second.iter().all(|second| {
            let [a, b, c] = second.map(|d| d.dot(&way));
            let (a, c) = (a + self.stretch, c + self.stretch);
            // False for what is no number, as where the tangents at the middle vanish.
            a > 0.0 && c > 0.0 && a * c > b * b
        })
    }
}

/// A term of a product of two polynomials: coefficient `of` grows by `weight` times the coefficients `left` and `right`.
struct Product {
    left: usize,
    right: usize,
    of: usize,
    weight: f64,
}

/// Products of degrees 4 and 4 (each unordered pair once), and of degrees 5 and 3.
static PRODUCTS: LazyLock<(Vec<Product>, Vec<Product>)> = LazyLock::new(|| {
    let all = |a: usize, b: usize| {
        let degrees = [a, b].map(|n| exponents(n).collect::<Vec<_>>());
        let [left, right] = &degrees;
        let pairs = left
            .iter()
            .flat_map(|l| right.iter().map(move |r| (*l, *r)));
        let terms = pairs.map(|(l, r)| {
            let sum = [0, 1, 2].map(|m| l[m] + r[m]);
            Product {
                left: index(l),
                right: index(r),
                of: index(sum),
                weight: multinomial(l) * multinomial(r) / multinomial(sum),
            }
        });
        terms.collect::<Vec<_>>()
    };
    let mut squares = all(DEGREE - 1, DEGREE - 1);
    squares.retain(|p| p.left <= p.right);
    for product in &mut squares {
        if product.left < product.right {
            product.weight *= 2.0;
        }
    }
    (squares, all(DEGREE, DEGREE - 2))
});

fn exponents(degree: usize) -> impl Iterator<Item = [u8; 3]> {
    let degree = degree as u8;
    (0..=degree).flat_map(move |j| (0..=degree - j).map(move |k| [degree - j - k, j, k]))
}

fn multinomial(exponents: [u8; 3]) -> f64 {
    let factorial = |n: u8| (1..=n).map(f64::from).product::<f64>();
    factorial(exponents.iter().sum()) / exponents.map(factorial).iter().product::<f64>()
}

/// The point at the middle.
fn middle(points: &[Vec3; CONTROL_POINTS], degree: usize) -> Vec3 {
    let mut work = *points;
    for degree in (0..degree).rev() {
        lower(&mut work, degree, [1.0 / 3.0; 3]);
    }
    work[0]
}

/// Control points of the derivatives by u and v of a patch of the given degree.
fn differences(points: &[Vec3; CONTROL_POINTS], degree: usize) -> [[Vec3; CONTROL_POINTS]; 2] {
    let mut out = [[Vec3::zeros(); CONTROL_POINTS]; 2];
    let mut row = 0;
    for rest in 0..degree {
        for k in 0..=rest {
            let first = points[rest * (rest + 1) / 2 + k];
            let next = (rest + 1) * (rest + 2) / 2 + k;
            out[0][row] = (points[next] - first) * degree as f64;
            out[1][row] = (points[next + 1] - first) * degree as f64;
            row += 1;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::patch_jet;
    use super::*;
    use crate::export::shapes;

    const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn halves_are_the_same_surface_and_coordinates_go_both_ways() {
        let patch = shapes::torus().control_points[3];
        let mut cells = vec![Cell::new(&patch, 3, WHOLE)];
        for _ in 0..3 {
            cells = cells.iter().flat_map(Cell::halves).collect();
        }
        let mut area = 0.0;
        for cell in &cells {
            let local = [0.2, 0.5, 0.3];
            let at = cell.of_patch(local);
            let own = patch_jet(&cell.points, local).point;
            assert!((own - patch_jet(&patch, at).point).norm() < 1e-14);
            for (back, local) in cell.local(at).iter().zip(local) {
                assert!((back - local).abs() < 1e-12);
            }
            let same = Cell::new(&patch, 3, cell.corners);
            for (p, q) in cell.points.iter().zip(&same.points) {
                assert!((p - q).norm() < 1e-14);
            }
            let [a, b, c] = cell.corners;
            area += (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1]);
        }
        assert!((area - 1.0).abs() < 1e-15);
    }

    #[test]
    fn where_convexity_is_certified_no_second_difference_is_negative() {
        let (mut certified, mut open) = (0, 0);
        for patch in shapes::lumpy_sphere().control_points.iter().step_by(9) {
            let mut cells = vec![Cell::new(patch, 0, WHOLE)];
            for _ in 0..2 {
                cells = cells.iter().flat_map(Cell::halves).collect();
            }
            for cell in cells {
                let bend = Bend::new(&cell);
                for k in -10..=10 {
                    // Along the normal to beyond both centres of curvature, and off to the side.
                    let normal = patch_jet(&cell.points, [1.0 / 3.0; 3]);
                    let normal = normal.first[0].cross(&normal.first[1]).normalize();
                    let target = cell.place + normal * (0.2 * f64::from(k)) + Vec3::x() * 0.05;
                    if !bend.convex(&cell, &target) {
                        open += 1;
                        continue;
                    }
                    certified += 1;
                    for [i, j, k] in EXPONENTS {
                        let jet = patch_jet(&cell.points, [i, j, k].map(|e| f64::from(e) / 5.0));
                        let away = jet.point - target;
                        let h = [0, 1, 2].map(|m| {
                            let [p, q] = [[0, 0], [0, 1], [1, 1]][m];
                            jet.first[p].dot(&jet.first[q]) + away.dot(&jet.second[m])
                        });
                        assert!(h[0] > 0.0 && h[0] * h[2] > h[1] * h[1], "{h:?}");
                    }
                }
            }
        }
        assert!(certified > 200 && open > 50, "{certified} {open}");
    }
}
