//! Closest point on a triangle, the primitive under every foot point on a mesh.

use crate::Vec3;

/// Closest point of triangle `(a, b, c)` to `p`, as barycentric coordinates that sum to 1 and are never
/// negative. Degenerate triangles (needles, points) are handled: the answer is then the closest point of
/// the longest edge.
///
/// The regions of the plane are told apart as in Ericson, "Real-Time Collision Detection" (2005), 5.1.5.
pub fn closest_on_triangle(p: &Vec3, a: &Vec3, b: &Vec3, c: &Vec3) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 - d3 > 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 - d6 > 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    let (e, g) = (d4 - d3, d5 - d6);
    if va <= 0.0 && e >= 0.0 && g >= 0.0 && e + g > 0.0 {
        let t = e / (e + g);
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    if sum > 0.0 {
        let (v, w) = (vb / sum, vc / sum);
        let u = (1.0 - v - w).max(0.0);
        [u, v, w]
    } else {
        longest_edge(p, [a, b, c])
    }
}

/// Closest point of segment `(a, b)` to `p`: the parameter from `a` (0) to `b` (1).
pub fn closest_on_segment(p: &Vec3, a: &Vec3, b: &Vec3) -> f64 {
    let d = b - a;
    let length2 = d.norm_squared();
    if length2 > 0.0 {
        ((p - a).dot(&d) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

fn longest_edge(p: &Vec3, corners: [&Vec3; 3]) -> [f64; 3] {
    let mut best = (0, -1.0);
    for k in 0..3 {
        let length2 = (corners[(k + 1) % 3] - corners[k]).norm_squared();
        if length2 > best.1 {
            best = (k, length2);
        }
    }
    let (i, j) = (best.0, (best.0 + 1) % 3);
    let t = closest_on_segment(p, corners[i], corners[j]);
    let mut out = [0.0; 3];
    out[i] = 1.0 - t;
    out[j] = t;
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Vec3> {
        (-2.0..2.0f64, -2.0..2.0f64, -2.0..2.0f64).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn no_sampled_point_of_the_triangle_is_closer(p in point(), a in point(), b in point(), c in point()) {
            let w = closest_on_triangle(&p, &a, &b, &c);
            prop_assert!(w.iter().all(|x| *x >= 0.0));
            prop_assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let found = (p - (a * w[0] + b * w[1] + c * w[2])).norm();
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (s, t) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                    let q = a * (1.0 - s - t) + b * s + c * t;
                    prop_assert!(found <= (p - q).norm() + 1e-9);
                }
            }
        }
    }

    #[test]
    fn degenerate_triangles_give_the_closest_point_of_their_longest_edge() {
        let (a, b, c) = (Vec3::zeros(), Vec3::x(), Vec3::x() * 0.4);
        let w = closest_on_triangle(&Vec3::new(0.7, 1.0, 0.0), &a, &b, &c);
        let q = a * w[0] + b * w[1] + c * w[2];
        assert!((q - Vec3::new(0.7, 0.0, 0.0)).norm() < 1e-12);
        let w = closest_on_triangle(&Vec3::x(), &a, &a, &a);
        assert_eq!(w.iter().sum::<f64>(), 1.0);
    }
}
