//! What the first two derivatives of a surface say about its shape at a point.
//!
//! Signs: with the normal S_u x S_v, curvature is positive where the surface bends away from it (a sphere seen
//! from outside). Source: do Carmo, "Differential Geometry of Curves and Surfaces", section 3.3.

use crate::Vec3;

/// Normal and curvatures at a point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalShape {
    /// Unit normal.
    pub normal: Vec3,
    /// Mean curvature H, 1 / length.
    pub mean: f64,
    /// Gaussian curvature K, 1 / length^2.
    pub gauss: f64,
    /// Principal curvatures, the larger first; they solve k^2 - 2 H k + K = 0.
    pub principal: [f64; 2],
    /// Unit directions of the principal curvatures in space.
    pub directions: [Vec3; 2],
}

impl LocalShape {
    /// From the derivatives by u, v and by uu, uv, vv; `None` where the surface is not regular (tangents
    /// parallel to 1e-12, or not finite).
    pub fn new(first: [Vec3; 2], second: [Vec3; 3]) -> Option<Self> {
        let [du, dv] = first;
        let cross = du.cross(&dv);
        let size = du.norm_squared().max(dv.norm_squared());
        let regular = cross.norm() > 1e-12 * size;
        if !regular {
            return None;
        }
        let normal = cross / cross.norm();
        // In an orthonormal frame of the tangent plane the form is symmetric: eigenvalues without cancellation.
        let x = du / du.norm();
        let y = normal.cross(&x);
        let (a, b, d) = (du.norm(), dv.dot(&x), dv.dot(&y));
        let [l, m, n] = second.map(|s| -s.dot(&normal));
        // d/dx = d/du / a, d/dy = (d/dv - b d/dx) / d.
        let xx = l / (a * a);
        let xy = (m / a - b * xx) / d;
        let yy = (n - 2.0 * b * m / a + b * b * xx) / (d * d);
        let mean = 0.5 * (xx + yy);
        let half = 0.5 * (xx - yy);
        let spread = half.hypot(xy);
        let angle = 0.5 * xy.atan2(half);
        let along = x * angle.cos() + y * angle.sin();
        let shape = Self {
            normal,
            mean,
            gauss: xx * yy - xy * xy,
            principal: [mean + spread, mean - spread],
            directions: [along, normal.cross(&along)],
        };
        (shape.mean.is_finite() && shape.gauss.is_finite()).then_some(shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skewed_cylinder_has_its_curvature_across_its_axis() {
        // (r cos t, r sin t, z) with t = u + 0.3 v, z = 2 v.
        let (r, t): (f64, f64) = (0.25, 0.7);
        let around = Vec3::new(-r * t.sin(), r * t.cos(), 0.0);
        let inward = Vec3::new(-r * t.cos(), -r * t.sin(), 0.0);
        let first = [around, around * 0.3 + Vec3::z() * 2.0];
        let second = [inward, inward * 0.3, inward * 0.09];
        let shape = LocalShape::new(first, second).unwrap();
        assert!((shape.principal[0] - 4.0).abs() < 1e-13);
        assert!(shape.principal[1].abs() < 1e-13);
        assert!((shape.mean - 2.0).abs() < 1e-13 && shape.gauss.abs() < 1e-12);
        assert!((shape.directions[1].dot(&Vec3::z()).abs() - 1.0).abs() < 1e-13);
        assert!(LocalShape::new([around, around * 2.0], second).is_none());
    }
}
