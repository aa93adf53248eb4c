//! Between a network's patches and triangular B-splines with any knots.
//!
//! To B-spline form: the control point of exponents beta is the patch's blossom at the knots v_{i,0..b0-1},
//! v_{j,0..b1-1}, v_{k,0..b2-1} (Seidel 1991). Back: the spline is interpolated at the domain points of the
//! Bernstein form, which gives its polynomial exactly where it is one polynomial over the triangle.

use super::bernstein::CONTROL_POINTS;
use super::chart::ChartError;
use super::chart::pieces::triangle_matrix;
use super::simplex::{
    KnotNet, PlanarPolynomial, SimplexError, TriangularBSpline, Vec2, Workspace, exponents,
};
use crate::Vec3;

/// The spline over `net` (of degree 5) that equals a network's patch laid over the triangle `corners`, wherever the net's
/// basis functions sum to 1.
///
/// # Errors
/// [`SimplexError::Degree`] if the net is of another degree, [`SimplexError::Folded`] if the corners lie on one
/// line.
pub fn patch_to_spline(
    control_points: &[Vec3; CONTROL_POINTS],
    corners: [Vec2; 3],
    net: KnotNet,
) -> Result<TriangularBSpline<Vec3>, SimplexError> {
    let polynomial =
        PlanarPolynomial::new(corners, control_points.to_vec()).ok_or(SimplexError::Folded {
            triangle: 0,
            knots: [0; 3],
        })?;
    TriangularBSpline::of_polynomial(net, &polynomial)
}

/// The patch of degree 5 that equals a spline of degree 1 to 5 over the triangle `corners`, if the spline is one
/// polynomial there; else the patch that interpolates it.
///
/// # Errors
/// [`ChartError::Uncovered`] if the spline does not reach the triangle.
pub fn spline_to_patch(
    spline: &TriangularBSpline<Vec3>,
    corners: [Vec2; 3],
) -> Result<[Vec3; CONTROL_POINTS], ChartError> {
    let n = spline.net().degree();
    let matrix = triangle_matrix(n)?;
    let mut workspace = Workspace::default();
    let mut values = Vec::new();
    for e in exponents(n) {
        let u = (0..3)
            .map(|k| corners[k] * (e[k] as f64 / n as f64))
            .sum::<Vec2>();
        let value = spline.value(u, &mut workspace);
        values.push(value.ok_or(ChartError::Uncovered { x: u.x, y: u.y })?);
    }
    Ok(std::array::from_fn(|row| {
        values
            .iter()
            .enumerate()
            .map(|(column, value)| value * matrix[(row, column)])
            .sum()
    }))
}

#[cfg(test)]
mod tests {
    use super::super::chart::knot_clouds;
    use super::super::surface::casteljau;
    use super::*;
    use proptest::prelude::*;

    /// A triangle with a ring around it, its clouds moved by the given numbers.
    fn net(degree: usize, moves: &[f64]) -> (KnotNet, [Vec2; 3]) {
        const SIDE: u32 = 4;
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        for row in 0..SIDE {
            for column in 0..SIDE {
                vertices.push(Vec2::new(
                    f64::from(column) + 0.5 * f64::from(row),
                    f64::from(row) * 0.9,
                ));
                if row + 1 < SIDE && column + 1 < SIDE {
                    let corner = row * SIDE + column;
                    triangles.push([corner, corner + 1, corner + SIDE]);
                    triangles.push([corner + 1, corner + SIDE + 1, corner + SIDE]);
                }
            }
        }
        let (mut clouds, _) = knot_clouds(degree, &vertices, &triangles).unwrap();
        let mut moves = moves.iter().cycle();
        for knot in clouds.iter_mut().flat_map(|cloud| &mut cloud[1..]) {
            for axis in 0..2 {
                knot[axis] += 0.1 * moves.next().unwrap();
            }
        }
        let corners = [5, 6, 9].map(|v| vertices[v]);
        (KnotNet::new(degree, &clouds, triangles).unwrap(), corners)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_patch_goes_to_any_knots_and_back(
            points in prop::array::uniform21([-1.0..1.0f64, -1.0..1.0, -1.0..1.0].prop_map(Vec3::from)),
            moves in prop::collection::vec(-1.0..1.0f64, 37),
        ) {
            let (net, corners) = net(5, &moves);
            let spline = patch_to_spline(&points, corners, net).unwrap();
            let mut workspace = Workspace::default();
            for at in [[0.2, 0.3, 0.5], [0.9, 0.05, 0.05], [0.0, 0.5, 0.5], [1.0, 0.0, 0.0]] {
                let u = (0..3).map(|k| corners[k] * at[k]).sum();
                let found = spline.value(u, &mut workspace).unwrap();
                prop_assert!((found - casteljau(&points, at)).norm() < 1e-12);
            }
            let back = spline_to_patch(&spline, corners).unwrap();
            for (found, wanted) in back.iter().zip(&points) {
                prop_assert!((found - wanted).norm() < 1e-12, "{found} {wanted}");
            }
        }
    }

    #[test]
    fn lower_degrees_come_back_raised() {
        for degree in 2..5 {
            let (net, corners) = net(degree, &[0.3, -0.8, 0.1]);
            let plane = |u: &Vec2| Vec3::new(u.x, u.y, 2.0 * u.x - u.y);
            let control = net.greville_points().iter().map(plane).collect();
            let spline = TriangularBSpline::new(net, control).unwrap();
            let patch = spline_to_patch(&spline, corners).unwrap();
            for at in [[0.2, 0.3, 0.5], [0.6, 0.4, 0.0]] {
                let u: Vec2 = (0..3).map(|k| corners[k] * at[k]).sum();
                assert!((casteljau(&patch, at) - plane(&u)).norm() < 1e-12);
            }
        }
    }
}
