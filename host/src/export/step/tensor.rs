//! Triangular patches as parts of tensor-product patches, exactly, by their blossom.
//!
//! With f the five-argument blossom of a triangular patch of degree 5 and Q00, Q10, Q01, Q11 the barycentric
//! corners of a quadrilateral in its parameter plane, the patch over that quadrilateral (bilinearly
//! parametrised) is the tensor-product Bézier patch with control points
//!
//! c_ij = 1/(C(5,i) C(5,j)) sum of 5!/(n00! n10! n01! n11!) f(Q00^n00, Q10^n10, Q01^n01, Q11^n11)
//!
//! over all n with n10 + n11 = i, n01 + n11 = j and sum 5. Corners may lie outside the triangle.

use crate::Vec3;
use crate::spline::bernstein::FIRST;
use crate::spline::bernstein::{CONTROL_POINTS, DEGREE};
use crate::spline::{casteljau, combine};

/// Barycentric coordinates; the sum is 1, none has to be positive.
type Barycentric = [f64; 3];

/// A tensor-product Bézier patch of degree (5, 5) over the unit square.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorPatch {
    /// Control points, first index along u, second along v.
    pub control_points: [[Vec3; DEGREE + 1]; DEGREE + 1],
}

/// Least area element that the whole parallelogram has to keep, relative to the mean over the triangle and
/// along its direction. 0 is where folding begins. Readers divide by the area element in projections, so a
/// tenth is kept.
const LEAST_ELEMENT: f64 = 0.1;

/// Places along each side of the parallelogram at which folding is looked for.
const PLACES: usize = 13;

impl TensorPatch {
    /// The patch over the parallelogram on local edge `base`: with b the barycentric coordinate opposite, the
    /// corner `base` lies at (0, 0), the next at (1, 0) and the last at (1/2, 1).
    pub fn parallelogram(points: &[Vec3; CONTROL_POINTS], base: usize) -> Self {
        Self::over(points, parallelogram(base))
    }

    /// The patch over the quadrilateral at corner `k`: corner (0, 0), middle of the edge to the next corner
    /// (1, 0), of the edge to the one before (0, 1), centroid (1, 1).
    pub fn piece(points: &[Vec3; CONTROL_POINTS], k: usize) -> Self {
        let at = |weights: [f64; 3]| {
            let mut out = [0.0; 3];
            for (offset, weight) in weights.into_iter().enumerate() {
                out[(k + offset) % 3] = weight;
            }
            out
        };
        let third = 1.0 / 3.0;
        Self::over(
            points,
            [
                at([1.0, 0.0, 0.0]),
                at([0.5, 0.5, 0.0]),
                at([0.5, 0.0, 0.5]),
                [third; 3],
            ],
        )
    }

    /// The patch over the quadrilateral with corners Q00, Q10, Q01, Q11.
    pub fn over(points: &[Vec3; CONTROL_POINTS], corners: [Barycentric; 4]) -> Self {
        let [q00, q10, q01, q11] = corners;
        let control_points = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let mut sum = Vec3::zeros();
                let mut total = 0.0;
                for n11 in 0..=i.min(j) {
                    let (n10, n01) = (i - n11, j - n11);
                    let Some(n00) = DEGREE.checked_sub(n10 + n01 + n11) else {
                        continue;
                    };
                    let mut arguments = [q00; DEGREE];
                    arguments[n00..n00 + n10].fill(q10);
                    arguments[n00 + n10..n00 + n10 + n01].fill(q01);
                    arguments[n00 + n10 + n01..].fill(q11);
                    let ways = factorial(DEGREE)
                        / (factorial(n00) * factorial(n10) * factorial(n01) * factorial(n11));
                    sum += blossom(points, &arguments) * ways;
                    total += ways;
                }
                // The numbers of ways add up to C(5, i) C(5, j).
                sum / total
            })
        });
        Self { control_points }
    }

    /// The control points, first index along u, at the lowest degrees that carry the patch.
    pub fn lowered(&self) -> Vec<Vec<Vec3>> {
        let rows: Vec<Vec<Vec3>> = self.control_points.iter().map(|r| r.to_vec()).collect();
        transposed(&lower_together(transposed(&lower_together(rows))))
    }

    /// Point at (u, v).
    pub fn point(&self, u: f64, v: f64) -> Vec3 {
        let rows = self.control_points.map(|row| bezier(&row, v));
        bezier(&rows, u)
    }
}

/// Deviation, relative to the largest coordinate, up to which a curve counts as one of lower degree: what rounding leaves
/// of a polynomial raised to degree 5 and extended beyond its triangle.
const ROUNDING: f64 = 1e-13;

/// The Bézier curve at the lowest degree that carries it, its end points as they are.
pub fn lowered(points: &[Vec3]) -> Vec<Vec3> {
    lower_together(vec![points.to_vec()]).swap_remove(0)
}

/// Lowers the degree of Bézier curves as far as all of them allow.
fn lower_together(mut curves: Vec<Vec<Vec3>>) -> Vec<Vec<Vec3>> {
    let largest = curves.iter().flatten().map(Vec3::amax).fold(0.0, f64::max);
    while let Some(lower) = curves
        .iter()
        .map(|curve| lower_once(curve, ROUNDING * largest))
        .collect()
    {
        curves = lower;
    }
    curves
}

/// The control points of degree n - 1 of a curve of degree n, from both ends; `None` where it has none, or n is 1.
fn lower_once(points: &[Vec3], tolerance: f64) -> Option<Vec<Vec3>> {
    let n = points.len().checked_sub(1).filter(|n| *n > 1)?;
    // Raising the degree makes b_i = i/n a_(i-1) + (1 - i/n) a_i.
    let share = |i: usize| i as f64 / n as f64;
    let mut lower = vec![Vec3::zeros(); n];
    (lower[0], lower[n - 1]) = (points[0], points[n]);
    for i in 1..n.div_ceil(2) {
        lower[i] = (points[i] - lower[i - 1] * share(i)) / (1.0 - share(i));
    }
    for i in (n.div_ceil(2) + 1..n).rev() {
        lower[i - 1] = (points[i] - lower[i] * (1.0 - share(i))) / share(i);
    }
    (1..n)
        .all(|i| {
            let raised = lower[i - 1] * share(i) + lower[i] * (1.0 - share(i));
            (raised - points[i]).amax() <= tolerance
        })
        .then_some(lower)
}

fn transposed(rows: &[Vec<Vec3>]) -> Vec<Vec<Vec3>> {
    let columns = rows.first().map_or(0, Vec::len);
    (0..columns)
        .map(|k| rows.iter().map(|row| row[k]).collect())
        .collect()
}

fn parallelogram(base: usize) -> [Barycentric; 4] {
    let at = |start: f64, end: f64, apex: f64| {
        let mut out = [0.0; 3];
        out[base % 3] = start;
        out[(base + 1) % 3] = end;
        out[(base + 2) % 3] = apex;
        out
    };
    [
        at(1.0, 0.0, 0.0),
        at(0.0, 1.0, 0.0),
        at(0.5, -0.5, 1.0),
        at(-0.5, 0.5, 1.0),
    ]
}

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

/// The blossom: de Casteljau's algorithm with an argument of its own per step.
pub fn blossom(points: &[Vec3; CONTROL_POINTS], arguments: &[Barycentric; DEGREE]) -> Vec3 {
    let mut points = *points;
    for (degree, b) in (0..DEGREE).rev().zip(arguments) {
        let mut row = 0;
        for rest in 0..=degree {
            for k in 0..=rest {
                let first = rest * (rest + 1) / 2 + k;
                let next = (rest + 1) * (rest + 2) / 2 + k;
                points[row] = points[first] * b[0] + points[next] * b[1] + points[next + 1] * b[2];
                row += 1;
            }
        }
    }
    points[0]
}

/// Point of a Bézier curve.
fn bezier(points: &[Vec3; DEGREE + 1], t: f64) -> Vec3 {
    let mut points = *points;
    for level in (0..DEGREE).rev() {
        for k in 0..=level {
            points[k] = points[k] * (1.0 - t) + points[k + 1] * t;
        }
    }
    points[0]
}

/// Both halves of a Bézier curve.
pub fn halves(points: &[Vec3; DEGREE + 1]) -> [[Vec3; DEGREE + 1]; 2] {
    let mut work = *points;
    let (mut first, mut second) = (*points, *points);
    for level in (0..DEGREE).rev() {
        for k in 0..=level {
            work[k] = (work[k] + work[k + 1]) * 0.5;
        }
        first[DEGREE - level] = work[0];
        second[level] = work[level];
    }
    [first, second]
}

/// Point at the centroid.
pub fn centroid(points: &[Vec3; CONTROL_POINTS]) -> Vec3 {
    casteljau(points, [1.0 / 3.0; 3])
}

/// The curve from the middle of local edge `k` to the centroid.
pub fn middle_to_centroid(points: &[Vec3; CONTROL_POINTS], k: usize) -> [Vec3; DEGREE + 1] {
    let mut middle = [0.0; 3];
    middle[k % 3] = 0.5;
    middle[(k + 1) % 3] = 0.5;
    std::array::from_fn(|inwards| {
        let mut arguments = [middle; DEGREE];
        arguments[..inwards].fill([1.0 / 3.0; 3]);
        blossom(points, &arguments)
    })
}

/// The local edge whose parallelogram stays farthest from folding; `None` where all three fold.
pub fn best_base(points: &[Vec3; CONTROL_POINTS]) -> Option<usize> {
    let element = |at: Barycentric| {
        let [du, dv] = [0, 1].map(|d| combine(points, &FIRST[d].weights(at)));
        du.cross(&dv)
    };
    let mut mean = Vec3::zeros();
    let mut inside = 0;
    for i in 0..PLACES {
        for j in 0..PLACES - i {
            let at = [i, j, PLACES - 1 - i - j].map(|m| m as f64 / (PLACES - 1) as f64);
            mean += element(at);
            inside += 1;
        }
    }
    mean /= f64::from(inside);
    let size = mean.norm_squared();
    let mut best = None;
    for base in 0..3 {
        let [q00, q10, q01, _] = parallelogram(base);
        let mut least = f64::INFINITY;
        for i in 0..PLACES {
            for j in 0..PLACES {
                let (u, v) = (
                    i as f64 / (PLACES - 1) as f64,
                    j as f64 / (PLACES - 1) as f64,
                );
                let at = [0, 1, 2].map(|m| q00[m] + u * (q10[m] - q00[m]) + v * (q01[m] - q00[m]));
                least = least.min(element(at).dot(&mean));
            }
        }
        if least > LEAST_ELEMENT * size && best.is_none_or(|(_, other)| least > other) {
            best = Some((base, least));
        }
    }
    best.map(|(base, _)| base)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn patch() -> impl Strategy<Value = [Vec3; CONTROL_POINTS]> {
        prop::array::uniform21([-1.0..1.0f64, -1.0..1.0, -1.0..1.0].prop_map(Vec3::from))
    }

    proptest! {
        #[test]
        fn tensor_patches_are_the_triangle(points in patch(), u in 0.0..1.0f64, v in 0.0..1.0f64) {
            for base in 0..3 {
                let tensor = TensorPatch::parallelogram(&points, base);
                let [q00, q10, q01, _] = parallelogram(base);
                let at = [0, 1, 2].map(|m| q00[m] + u * (q10[m] - q00[m]) + v * (q01[m] - q00[m]));
                let same = (tensor.point(u, v) - casteljau(&points, at)).norm();
                prop_assert!(same < 1e-12, "{same}");
                let apex = tensor.point(0.5, 1.0) - points[[20, 0, 15][base]];
                prop_assert!(apex.norm() < 1e-12);
            }
            for k in 0..3 {
                let tensor = TensorPatch::piece(&points, k);
                let mut at = [0.0; 3];
                let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v / 3.0];
                at[k] = weights[0] + 0.5 * weights[1] + 0.5 * weights[2] + weights[3];
                at[(k + 1) % 3] = 0.5 * weights[1] + weights[3];
                at[(k + 2) % 3] = 0.5 * weights[2] + weights[3];
                let same = (tensor.point(u, v) - casteljau(&points, at)).norm();
                prop_assert!(same < 1e-13, "{same}");
            }
        }

        #[test]
        fn curves_lie_on_the_patch(points in patch(), t in 0.0..1.0f64) {
            let edge: [Vec3; 6] =
                std::array::from_fn(|k| points[crate::spline::bernstein::edge_index(0, 0, k)]);
            let [first, second] = halves(&edge);
            prop_assert!((bezier(&first, t) - bezier(&edge, 0.5 * t)).norm() < 1e-14);
            prop_assert!((bezier(&second, t) - bezier(&edge, 0.5 + 0.5 * t)).norm() < 1e-14);
            for k in 0..3 {
                let curve = middle_to_centroid(&points, k);
                let mut at = [t / 3.0; 3];
                at[k] += 0.5 * (1.0 - t);
                at[(k + 1) % 3] += 0.5 * (1.0 - t);
                prop_assert!((bezier(&curve, t) - casteljau(&points, at)).norm() < 1e-13);
            }
        }
    }

    #[test]
    fn polynomials_of_lower_degree_are_found_and_no_others() {
        let raised = |mut curve: Vec<Vec3>| {
            while curve.len() <= DEGREE {
                let n = curve.len();
                let at = |k: usize| curve[k.min(n - 1)];
                curve = (0..=n)
                    .map(|i| {
                        let share = i as f64 / n as f64;
                        at(i.saturating_sub(1)) * share + at(i) * (1.0 - share)
                    })
                    .collect();
            }
            curve
        };
        let all: Vec<Vec3> = (0..=DEGREE)
            .map(|k| Vec3::new((3.7 * k as f64).sin(), (2.3 * k as f64).cos(), k as f64))
            .collect();
        for degree in 1..=DEGREE {
            let curve = all[..=degree].to_vec();
            let back = lowered(&raised(curve.clone()));
            assert_eq!(back.len(), degree + 1);
            for (p, q) in back.iter().zip(&curve) {
                assert!((p - q).norm() < 1e-13, "{degree}: {p} {q}");
            }
        }
        // A quadratic along one direction, a quintic along the other.
        let rows: [[Vec3; DEGREE + 1]; DEGREE + 1] = std::array::from_fn(|i| {
            let first = Vec3::x() * i as f64;
            let curve = raised(vec![
                first,
                first + Vec3::y() + Vec3::z(),
                first + Vec3::y() * 3.0,
            ]);
            std::array::from_fn(|j| curve[j] + Vec3::z() * (i * i * i * i) as f64)
        });
        let low = TensorPatch {
            control_points: rows,
        }
        .lowered();
        assert_eq!((low.len(), low[0].len()), (DEGREE, 3));
    }

    #[test]
    fn folding_beyond_the_triangle_is_found() {
        let flat = crate::spline::bernstein::EXPONENTS.map(|e| {
            Vec3::new(
                f64::from(e[1]) + 0.5 * f64::from(e[2]),
                f64::from(e[2]),
                0.0,
            ) / 5.0
        });
        assert!(best_base(&flat).is_some());
        // Inner control points spread by a half about the centroid: regular inside the triangle (least area
        // element 0.75 of the mean), folded beyond each of its edges (-0.34).
        let middle = flat.iter().sum::<Vec3>() / 21.0;
        let mut spread = flat;
        for inner in [4, 7, 8, 11, 12, 13] {
            spread[inner] = middle + (flat[inner] - middle) * 1.5;
        }
        assert_eq!(best_base(&spread), None);
        // A bump along the normal is a graph over its plane everywhere and folds nowhere.
        let mut bump = flat;
        bump[7].z += 3.0;
        assert!(best_base(&bump).is_some());
    }
}
