//! A smooth sheet near one place: a height field of degree 1 or 2 through points and normals together; or the one plane or
//! quadric that is all of it.

use crate::Vec3;
use crate::cloud::OrientedPoint;
use crate::mesh::unit_or_zero;
use crate::reconstruct::quadric::Quadric;
use nalgebra::{SMatrix, SVector};

/// How far the measurements scatter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatter {
    /// Of a position along the normal, in the unit of the input.
    pub position: f64,
    /// Of a normal's component, radians.
    pub normal: f64,
}

/// A height field z = f(x, y) of degree 1 or 2 in its own frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sheet {
    origin: Vec3,
    /// The two directions of the tangent plane and the normal.
    frame: [Vec3; 3],
    /// Unit of the frame's coordinates.
    scale: f64,
    /// Coefficients of 1, x, y, x^2, xy, y^2.
    height: [f64; 6],
    /// Sum of squared residuals over their number less the coefficients, in units of the scatter: about
    /// 1 if the sheet is what the points show.
    pub(super) misfit: f64,
    /// Number of coefficients that were fitted.
    degrees: usize,
}

impl Sheet {
    /// Least squares over `points` around `centre`, each giving three equations: its height and the two
    /// slopes of its normal, weighted by the scatter and by a Gaussian of width `reach` in the distance
    /// from the centre. The quadric is taken only if it betters the plane by more than its three further
    /// coefficients would by chance (Schwarz' criterion): planes reach further.
    ///
    /// `None` with fewer than four points, or normals that do not look the same way.
    pub(super) fn through(
        points: &[OrientedPoint],
        centre: &Vec3,
        reach: f64,
        scatter: &Scatter,
    ) -> Option<Self> {
        if points.len() < 4 {
            return None;
        }
        let weight =
            |p: &OrientedPoint| (-0.5 * ((p.position - centre).norm() / reach).powi(2)).exp();
        let mut normal = Vec3::zeros();
        for p in points {
            normal += p.normal * weight(p);
        }
        let normal = unit_or_zero(normal);
        if normal == Vec3::zeros() {
            return None;
        }
        let across = if normal.x.abs() < 0.6 {
            Vec3::x()
        } else {
            Vec3::y()
        };
        let u = unit_or_zero(across - normal * across.dot(&normal));
        let frame = [u, normal.cross(&u), normal];
        let scale = reach.max(1e-300);
        let mut left = SMatrix::<f64, 6, 6>::zeros();
        let mut right = SVector::<f64, 6>::zeros();
        let mut squares = 0.0;
        let mut equations = 0.0;
        let (wp, wn) = (
            (scale / scatter.position.max(1e-9 * scale)).powi(2),
            (1.0 / scatter.normal.max(1e-6)).powi(2),
        );
        for p in points {
            let w = weight(p);
            let d = (p.position - centre) / scale;
            let (x, y, z) = (d.dot(&frame[0]), d.dot(&frame[1]), d.dot(&frame[2]));
            let n = [0, 1, 2].map(|k| p.normal.dot(&frame[k]));
            if n[2] < 0.2 {
                return None;
            }
            // Slopes scatter more than normals by 1 / n_z^2.
            let steep = n[2].powi(4);
            let rows = [
                (SVector::from([1.0, x, y, x * x, x * y, y * y]), z, wp),
                (
                    SVector::from([0.0, 1.0, 0.0, 2.0 * x, y, 0.0]),
                    -n[0] / n[2],
                    wn * steep,
                ),
                (
                    SVector::from([0.0, 0.0, 1.0, 0.0, x, 2.0 * y]),
                    -n[1] / n[2],
                    wn * steep,
                ),
            ];
            for (row, value, precision) in rows {
                left += row * row.transpose() * (w * precision);
                right += row * (value * w * precision);
                squares += value * value * w * precision;
                equations += w;
            }
        }
        let plane = left.fixed_view::<3, 3>(0, 0).into_owned();
        let plane_right = right.fixed_rows::<3>(0).into_owned();
        let flat = plane.cholesky()?.solve(&plane_right);
        let flat_misfit = (squares - flat.dot(&plane_right)).max(0.0);
        let mut out = Self {
            origin: *centre,
            frame,
            scale,
            height: [flat[0], flat[1], flat[2], 0.0, 0.0, 0.0],
            misfit: flat_misfit / (equations - 3.0).max(1.0),
            degrees: 3,
        };
        if points.len() >= 5
            && let Some(curved) = left.cholesky().map(|c| c.solve(&right))
        {
            let misfit = (squares - curved.dot(&right)).max(0.0);
            if flat_misfit - misfit > 3.0 * equations.max(2.0).ln()
                && curved.iter().all(|c| c.is_finite())
            {
                out.height = curved.into();
                out.misfit = misfit / (equations - 6.0).max(1.0);
                out.degrees = 6;
            }
        }
        out.height.iter().all(|c| c.is_finite()).then_some(out)
    }

    /// Whether its points show no curvature.
    pub(super) fn is_plane(&self) -> bool {
        self.degrees == 3
    }

    fn local(&self, p: &Vec3) -> Vec3 {
        let d = (p - self.origin) / self.scale;
        Vec3::new(
            d.dot(&self.frame[0]),
            d.dot(&self.frame[1]),
            d.dot(&self.frame[2]),
        )
    }

    fn slopes(&self, q: &Vec3) -> [f64; 2] {
        let [_, b, c, d, e, f] = self.height;
        [b + 2.0 * d * q.x + e * q.y, c + e * q.x + 2.0 * f * q.y]
    }

    /// Signed distance of `p` to the sheet (to first order), positive outside.
    pub(super) fn distance(&self, p: &Vec3) -> f64 {
        let q = self.local(p);
        let [a, b, c, d, e, f] = self.height;
        let height = a + b * q.x + c * q.y + d * q.x * q.x + e * q.x * q.y + f * q.y * q.y;
        let [s, t] = self.slopes(&q);
        (q.z - height) / (1.0 + s * s + t * t).sqrt() * self.scale
    }

    /// Unit normal of the sheet above or below `p`.
    pub(super) fn normal(&self, p: &Vec3) -> Vec3 {
        let [s, t] = self.slopes(&self.local(p));
        unit_or_zero(self.frame[2] - self.frame[0] * s - self.frame[1] * t)
    }
}

/// What is known of a sheet at a place.
#[derive(Clone, Copy, Debug)]
pub(super) enum Piece {
    /// The sheet through the points near by.
    Near(Sheet),
    /// All of the sheet.
    Whole(Quadric),
}

impl Piece {
    /// Signed distance of `p` to the sheet (to first order), positive outside.
    pub(super) fn distance(&self, p: &Vec3) -> f64 {
        match self {
            Self::Near(sheet) => sheet.distance(p),
            Self::Whole(quadric) => quadric.value(p) / quadric.gradient(p).norm(),
        }
    }

    /// Unit normal of the sheet next to `p`.
    pub(super) fn normal(&self, p: &Vec3) -> Vec3 {
        match self {
            Self::Near(sheet) => sheet.normal(p),
            Self::Whole(quadric) => unit_or_zero(quadric.gradient(p)),
        }
    }
}

/// The point nearest to `p` on all of one to three sheets, by Newton's steps of least length; `None` if
/// they do not meet within `reach` of `p`.
pub(super) fn meet(sheets: &[Piece], p: &Vec3, reach: f64) -> Option<Vec3> {
    let mut x = *p;
    for _ in 0..8 {
        // Least step with n_i . step = -distance_i: the normals' combination N^T (N N^T)^-1 d.
        let normals: Vec<Vec3> = sheets.iter().map(|s| s.normal(&x)).collect();
        let n = normals.len().min(3);
        let mut gram = SMatrix::<f64, 3, 3>::identity();
        let mut right = Vec3::zeros();
        for i in 0..n {
            for j in 0..n {
                gram[(i, j)] = normals[i].dot(&normals[j]) + if i == j { 1e-9 } else { 0.0 };
            }
            right[i] = -sheets[i].distance(&x);
        }
        let share = gram.cholesky()?.solve(&right);
        let step: Vec3 = (0..n).map(|i| normals[i] * share[i]).sum();
        x += step;
        let way = (x - p).norm();
        if way.is_nan() || way > reach {
            return None;
        }
        if step.norm() < 1e-9 * reach {
            break;
        }
    }
    let off = sheets
        .iter()
        .map(|s| s.distance(&x).abs())
        .fold(0.0, f64::max);
    (off < 1e-3 * reach).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(position: Vec3, normal: Vec3) -> OrientedPoint {
        OrientedPoint {
            position,
            normal,
            sigma: None,
            finger: None,
            time_us: None,
        }
    }

    const FINE: Scatter = Scatter {
        position: 1e-4,
        normal: 1e-3,
    };

    /// Points of the sphere of radius 2 around the origin, near its pole.
    fn cap() -> Vec<OrientedPoint> {
        let mut out = Vec::new();
        for i in -3..=3 {
            for j in -3..=3 {
                let n = Vec3::new(f64::from(i) * 0.04, f64::from(j) * 0.04, 1.0).normalize();
                out.push(point(n * 2.0, n));
            }
        }
        out
    }

    #[test]
    fn a_cap_gives_a_quadric_that_carries_on_past_its_points() {
        let sheet = Sheet::through(&cap(), &Vec3::new(0.0, 0.0, 2.0), 0.3, &FINE).unwrap();
        assert_eq!(sheet.degrees, 6);
        let n = Vec3::new(0.2, 0.0, 1.0).normalize();
        assert!(sheet.distance(&(n * 2.0)).abs() < 2e-3);
        assert!((sheet.distance(&(n * 2.1)) - 0.1).abs() < 3e-3);
        assert!(sheet.normal(&(n * 2.0)).dot(&n) > 0.9998);
    }

    #[test]
    fn a_plane_stays_a_plane() {
        let flat: Vec<OrientedPoint> = (0..30)
            .map(|i| {
                point(
                    Vec3::new(f64::from(i % 6), f64::from(i / 6), 1.0) * 0.1,
                    Vec3::z(),
                )
            })
            .collect();
        let sheet = Sheet::through(&flat, &Vec3::new(0.2, 0.2, 0.1), 0.3, &FINE).unwrap();
        assert_eq!(sheet.degrees, 3);
        assert!(sheet.distance(&Vec3::new(3.0, -2.0, 0.1)).abs() < 1e-9);
        assert!(Sheet::through(&flat[..3], &Vec3::zeros(), 0.3, &FINE).is_none());
    }

    #[test]
    fn three_planes_meet_in_their_corner() {
        let sheets: Vec<Piece> = (0..3)
            .map(|k| {
                let mut n = Vec3::zeros();
                n[k] = 1.0;
                let points: Vec<OrientedPoint> = (0..16)
                    .map(|i| {
                        let mut p = Vec3::zeros();
                        p[(k + 1) % 3] = -0.1 * f64::from(i % 4);
                        p[(k + 2) % 3] = -0.1 * f64::from(i / 4);
                        p[k] = 0.5;
                        point(p, n)
                    })
                    .collect();
                Piece::Near(Sheet::through(&points, &Vec3::repeat(0.4), 0.5, &FINE).unwrap())
            })
            .collect();
        let corner = meet(&sheets, &Vec3::repeat(0.4), 1.0).unwrap();
        assert!((corner - Vec3::repeat(0.5)).norm() < 1e-9);
        assert!(meet(&sheets, &Vec3::repeat(0.4), 0.01).is_none());
        let edge = meet(&sheets[..2], &Vec3::new(0.45, 0.4, 0.1), 1.0).unwrap();
        assert!((edge - Vec3::new(0.5, 0.5, 0.1)).norm() < 1e-9);
    }
}
