//! Properties of simplex splines and triangular B-splines for all degrees, on random knots in general position.

use proptest::prelude::*;

use super::*;
use crate::Vec3;

/// Vertices along a side of the test triangulation.
const SIDE: usize = 5;

/// Random numbers from a seed (splitmix64), so that failing cases are told by one number.
struct Dice(u64);

impl Dice {
    /// From -1 to 1, a multiple of 2^-16: midpoints and sums of knots are then exact.
    fn dyadic(&mut self) -> f64 {
        f64::from((self.next() >> 47) as u32) / 65536.0 - 1.0
    }

    /// From 0 to 1.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

/// A jittered grid of 2 (SIDE - 1)^2 triangles around the square from 0 to SIDE - 1, its clouds as wide as
/// `spread` (0.16 and less keep all triangles proper).
fn clouds(degree: usize, spread: f64, dice: &mut Dice) -> (Vec<Vec<Vec2>>, Vec<[u32; 3]>) {
    let mut clouds = Vec::new();
    for row in 0..SIDE {
        for column in 0..SIDE {
            let mut jitter = |size: f64| Vec2::new(dice.dyadic() * size, dice.dyadic() * size);
            let vertex = Vec2::new(column as f64, row as f64) + jitter(0.125);
            let mut cloud = vec![vertex];
            cloud.extend((0..degree).map(|_| vertex + jitter(spread)));
            clouds.push(cloud);
        }
    }
    let mut triangles = Vec::new();
    for row in 0..SIDE - 1 {
        for column in 0..SIDE - 1 {
            let corner = (row * SIDE + column) as u32;
            let up = corner + SIDE as u32;
            triangles.push([corner, corner + 1, up + 1]);
            triangles.push([corner, up + 1, up]);
        }
    }
    (clouds, triangles)
}

fn net(degree: usize, seed: u64) -> (KnotNet, Dice) {
    let mut dice = Dice(seed);
    let (clouds, triangles) = clouds(degree, 0.125, &mut dice);
    let net =
        KnotNet::new(degree, &clouds, triangles).expect("clouds this small keep triangles proper");
    (net, dice)
}

/// A point that no missing neighbour's knots reach.
fn inner_point(dice: &mut Dice) -> Vec2 {
    let low = 1.3;
    let width = SIDE as f64 - 1.0 - 2.0 * low;
    Vec2::new(low + width * dice.unit(), low + width * dice.unit())
}

/// Points on knot lines, at knots and elsewhere: inner knots, middles of two knots, random ones.
fn delicate_points(net: &KnotNet, dice: &mut Dice) -> Vec<Vec2> {
    let mut points: Vec<Vec2> = (0..6).map(|_| inner_point(dice)).collect();
    let middle = SIDE * SIDE / 2;
    points.extend(net.cloud(middle));
    points.extend(
        net.cloud(middle)
            .iter()
            .zip(net.cloud(middle + 1))
            .map(|(a, b)| (a + b) / 2.0),
    );
    points.extend(
        net.cloud(middle)
            .windows(2)
            .map(|pair| (pair[0] + pair[1]) / 2.0),
    );
    points
}

/// All basis functions at a point, triangle by triangle.
fn all_values(net: &KnotNet, u: Vec2, approach: Approach) -> Vec<f64> {
    let mut workspace = Workspace::default();
    let per = net.functions_per_triangle();
    let mut all = vec![0.0; net.functions()];
    for triangle in net.triangles_at(u) {
        all[triangle * per..(triangle + 1) * per].copy_from_slice(net.values(
            triangle,
            u,
            approach,
            &mut workspace,
        ));
    }
    all
}

/// Sum of the sizes of all basis functions' derivatives of an order, the largest over four directions.
fn derivative_size(net: &KnotNet, u: Vec2, order: usize) -> f64 {
    let mut workspace = Workspace::default();
    let directions = [
        Vec2::new(1.0, 0.0),
        Vec2::new(0.0, 1.0),
        Vec2::new(1.0, 1.0),
        Vec2::new(1.0, -1.0),
    ];
    directions
        .into_iter()
        .map(|along| {
            net.triangles_at(u)
                .flat_map(|triangle| {
                    net.directional(
                        triangle,
                        u,
                        Approach::default(),
                        along,
                        order,
                        &mut workspace,
                    )
                    .to_vec()
                })
                .map(f64::abs)
                .sum::<f64>()
        })
        .fold(0.0, f64::max)
}

fn knots_of(net: &KnotNet, triangle: usize, beta: [usize; 3]) -> Vec<Vec2> {
    (0..3)
        .flat_map(|corner| &net.cloud(net.triangles()[triangle][corner] as usize)[..=beta[corner]])
        .copied()
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn basis_is_a_partition_of_unity_and_not_negative(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        for u in delicate_points(&net, &mut dice) {
            for approach in [Approach::default(), Approach::from_side(Vec2::new(-0.3, -0.7))] {
                let values = all_values(&net, u, approach);
                let sum = values.iter().sum::<f64>(); prop_assert!((sum - 1.0).abs() < 1e-13, "at {u:?}: {}", sum - 1.0);
                let least = values.iter().copied().fold(0.0, f64::min); prop_assert!(least > -1e-13, "at {u:?}: {least}");
            }
        }
    }

    #[test]
    fn derivatives_of_a_partition_of_unity_vanish(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let ones = TriangularBSpline::new(net.clone(), vec![1.0; net.functions()]).unwrap();
        let mut workspace = Workspace::default();
        for u in delicate_points(&net, &mut dice) {
            let jet = ones.jet(u, &mut workspace).unwrap();
            let rounding = [1, 2].map(|order| 1e-12 * derivative_size(&net, u, order));
            prop_assert!((jet.value - 1.0).abs() < 1e-12);
            prop_assert!(jet.gradient.iter().all(|part| part.abs() <= rounding[0]), "{jet:?}");
            prop_assert!(jet.hessian.iter().all(|part| part.abs() <= rounding[1]), "{jet:?}");
        }
    }

    #[test]
    fn shared_evaluation_equals_the_plain_recursion(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let approach = Approach::default();
        let mut workspace = Workspace::default();
        let u = inner_point(&mut dice);
        let direction = Vec2::new(dice.dyadic(), dice.dyadic());
        for triangle in net.triangles_at(u).take(4) {
            let jets = net.jets(triangle, u, approach, &mut workspace).to_vec();
            let values = net.values(triangle, u, approach, &mut workspace).to_vec();
            let slopes = net.directional(triangle, u, approach, direction, 1, &mut workspace).to_vec();
            for (number, beta) in exponents(degree).enumerate() {
                let knots = knots_of(&net, triangle, beta);
                let corner = |k: usize| net.cloud(net.triangles()[triangle][k] as usize)[beta[k]];
                let factor = orientation::twice_area(corner(0), corner(1), corner(2)).abs();
                let plain = |directions: &[Vec2]| factor * simplex_spline_derivative(u, &knots, directions, approach);
                let (x, y) = (Vec2::x(), Vec2::y());
                let jet = jets[number];
                prop_assert!((plain(&[]) - values[number]).abs() < 1e-13);
                prop_assert!((plain(&[]) - jet.value).abs() < 1e-13);
                prop_assert!((plain(&[direction]) - slopes[number]).abs() < 1e-12);
                for (expected, found) in [(plain(&[x]), jet.gradient[0]), (plain(&[y]), jet.gradient[1])] {
                    prop_assert!((expected - found).abs() < 1e-12);
                }
                let second = [plain(&[x, x]), plain(&[x, y]), plain(&[y, y])];
                for (expected, found) in second.into_iter().zip(jet.hessian) {
                    prop_assert!((expected - found).abs() < 1e-11, "{expected} {found}");
                }
            }
        }
    }

    #[test]
    fn affine_maps_leave_the_basis_as_it_is(degree in 1..=MAX_DEGREE, seed: u64) {
        let mut dice = Dice(seed);
        let (clouds, triangles) = clouds(degree, 0.125, &mut dice);
        let net = KnotNet::new(degree, &clouds, triangles.clone()).unwrap();
        let map = |u: Vec2| Vec2::new(1.7 * u.x - 0.6 * u.y + 3.0, 0.4 * u.x + 0.9 * u.y - 5.0);
        let mapped: Vec<Vec<Vec2>> = clouds.iter().map(|cloud| cloud.iter().map(|u| map(*u)).collect()).collect();
        let image = KnotNet::new(degree, &mapped, triangles).unwrap();
        for _ in 0..5 {
            let u = inner_point(&mut dice);
            let before = all_values(&net, u, Approach::default());
            let after = all_values(&image, map(u), Approach::default());
            for (before, after) in before.into_iter().zip(after) {
                prop_assert!((before - after).abs() < 1e-11);
            }
        }
    }

    #[test]
    fn surface_lies_in_the_hull_of_its_control_points(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let heights: Vec<f64> = (0..net.functions()).map(|_| dice.dyadic()).collect();
        let per = net.functions_per_triangle();
        let surface = TriangularBSpline::new(net.clone(), heights.clone()).unwrap();
        let mut workspace = Workspace::default();
        for u in delicate_points(&net, &mut dice) {
            let active: Vec<f64> = net.triangles_at(u).flat_map(|t| &heights[t * per..(t + 1) * per]).copied().collect();
            let (low, high) = active.iter().fold((f64::MAX, f64::MIN), |(l, h), c| (l.min(*c), h.max(*c)));
            let value = surface.value(u, &mut workspace).unwrap();
            prop_assert!(low - 1e-12 <= value && value <= high + 1e-12);
        }
    }

    #[test]
    fn basis_functions_are_zero_outside_the_hull_of_their_knots(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let triangle = SIDE * SIDE / 2;
        let mut workspace = Workspace::default();
        // Twice the area that a place spans with an edge of the hull.
        const NEAR_EDGE: f64 = 0.01;
        let (mut inside, mut outside) = (0, 0);
        let corners = net.triangles()[triangle];
        let middle = corners.iter().map(|v| net.cloud(*v as usize)[0]).sum::<Vec2>() / 3.0;
        for _ in 0..40 {
            let u = middle + Vec2::new(dice.dyadic(), dice.dyadic()) * 0.75;
            let values = net.values(triangle, u, Approach::default(), &mut workspace).to_vec();
            for (value, beta) in values.into_iter().zip(exponents(degree)) {
                let knots = knots_of(&net, triangle, beta);
                // Least over the hull's edges: positive inside, zero on an edge, negative outside.
                let depth = knots
                    .iter()
                    .flat_map(|a| knots.iter().map(move |b| (a, b)))
                    .filter(|(a, b)| a != b && knots.iter().all(|c| orientation::twice_area(**a, **b, *c) >= 0.0))
                    .map(|(a, b)| orientation::twice_area(*a, *b, u))
                    .fold(f64::INFINITY, f64::min);
                if depth < 0.0 {
                    outside += 1;
                    prop_assert_eq!(value, 0.0);
                } else if depth > NEAR_EDGE {
                    inside += 1;
                    prop_assert!(value > 0.0, "{value} at {u}, {depth} within {knots:?}");
                } else {
                    // There it ends like a power of the depth, below the rounding of the sum it is made of; on
                    // the edge itself the knots decide whether it is zero.
                    prop_assert!(value > -1e-15, "{value} at {u}, {depth} within {knots:?}");
                }
            }
        }
        prop_assert!(inside > 0 && outside > 0);
    }

    #[test]
    fn derivatives_up_to_degree_less_one_agree_from_both_sides_of_a_knot_line(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let heights: Vec<f64> = (0..net.functions()).map(|_| dice.dyadic()).collect();
        let surface = TriangularBSpline::new(net.clone(), heights).unwrap();
        let mut workspace = Workspace::default();
        let vertex = SIDE * SIDE / 2;
        let mut jumps = 0.0_f64;
        for (a, b) in net.cloud(vertex).iter().zip(net.cloud(vertex + 1)) {
            // Exactly on the line: knots are multiples of 2^-20.
            let u = a + (b - a) * 0.375;
            let across = Vec2::new(a.y - b.y, b.x - a.x);
            for order in 0..=degree {
                let [left, right] = [across, -across].map(|side| {
                    surface.directional(u, Approach::from_side(side), across, order, &mut workspace).unwrap()
                });
                if order < degree {
                    prop_assert!((left - right).abs() < 1e-10 * (1.0 + left.abs()), "order {order}: {left} {right}");
                } else {
                    jumps = jumps.max((left - right).abs());
                }
            }
        }
        // Degree n itself jumps, so the lines were truly crossed.
        prop_assert!(jumps > 1e-3, "{jumps}");
    }

    #[test]
    fn jets_agree_with_finite_differences_across_knot_lines(degree in 2..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let heights: Vec<f64> = (0..net.functions()).map(|_| dice.dyadic()).collect();
        let surface = TriangularBSpline::new(net.clone(), heights).unwrap();
        let mut workspace = Workspace::default();
        let h = 1e-6;
        for u in delicate_points(&net, &mut dice) {
            let jet = surface.jet(u, &mut workspace).unwrap();
            for (axis, step) in [Vec2::new(h, 0.0), Vec2::new(0.0, h)].into_iter().enumerate() {
                let [ahead, behind] = [u + step, u - step].map(|u| surface.jet(u, &mut workspace).unwrap());
                // A difference is off by at most h times the next derivative, which may jump on the way.
                let [size_2, size_3] = [2, 3].map(|order| {
                    [u, u + step, u - step].into_iter().map(|u| derivative_size(&net, u, order)).fold(0.0, f64::max)
                });
                let slope = (ahead.value - behind.value) / (2.0 * h);
                prop_assert!((slope - jet.gradient[axis]).abs() < h * size_2 + 1e-8, "{slope} {jet:?}");
                if degree > 2 {
                    for other in 0..2 {
                        let bend = (ahead.gradient[other] - behind.gradient[other]) / (2.0 * h);
                        prop_assert!((bend - jet.hessian[axis + other]).abs() < h * size_3 + 1e-6, "{bend} {jet:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn polynomials_are_reproduced_by_their_blossom(degree in 1..=MAX_DEGREE, seed: u64) {
        let (net, mut dice) = net(degree, seed);
        let corners = [Vec2::new(0.0, 0.0), Vec2::new(4.0, 0.5), Vec2::new(0.5, 4.0)];
        let coefficients = (0..exponent_count(degree))
            .map(|_| Vec3::new(dice.dyadic(), dice.dyadic(), dice.dyadic()))
            .collect();
        let polynomial = PlanarPolynomial::new(corners, coefficients).unwrap();
        let surface = TriangularBSpline::of_polynomial(net.clone(), &polynomial).unwrap();
        let mut workspace = Workspace::default();
        for u in delicate_points(&net, &mut dice) {
            let found = surface.value(u, &mut workspace).unwrap();
            prop_assert!((found - polynomial.value(u)).norm() < 1e-11);
        }
        // Greville points are the control points of the identity.
        let identity = TriangularBSpline::new(net.clone(), net.greville_points()).unwrap();
        for u in delicate_points(&net, &mut dice) {
            prop_assert!((identity.value(u, &mut workspace).unwrap() - u).norm() < 1e-11);
        }
    }

    #[test]
    fn clamped_knots_give_bernstein_polynomials(degree in 1..=MAX_DEGREE, seed: u64) {
        let mut dice = Dice(seed);
        let corners = [0.0, 2.1, 4.2].map(|angle: f64| {
            Vec2::new(angle.cos(), angle.sin()) + Vec2::new(dice.dyadic(), dice.dyadic()) * 0.25
        });
        let net = KnotNet::clamped(degree, &corners, vec![[0, 1, 2]]).unwrap();
        let control: Vec<Vec3> = (0..net.functions())
            .map(|_| Vec3::new(dice.dyadic(), dice.dyadic(), dice.dyadic()))
            .collect();
        let surface = TriangularBSpline::new(net, control.clone()).unwrap();
        let polynomial = PlanarPolynomial::new(corners, control.clone()).unwrap();
        let mut workspace = Workspace::default();
        for _ in 0..20 {
            let (a, b) = (dice.unit(), dice.unit());
            let barycentric = if a + b < 1.0 { [a, b, 1.0 - a - b] } else { [1.0 - a, 1.0 - b, a + b - 1.0] };
            let u = (0..3).map(|i| corners[i] * barycentric[i]).sum::<Vec2>();
            let found = surface.value(u, &mut workspace).unwrap();
            prop_assert!((found - polynomial.value(u)).norm() < 1e-12);
            if degree == crate::spline::bernstein::DEGREE {
                let patch = crate::spline::Surface {
                    control_points: vec![control.clone().try_into().unwrap()],
                    ..Default::default()
                };
                prop_assert!((found - patch.point(0, barycentric)).norm() < 1e-12);
            }
        }
    }
}

#[test]
fn every_point_of_clamped_neighbours_belongs_to_one_triangle() {
    // Knot lines are then the edges themselves; sums at vertices and on edges must be 1, not 2 and not 0.
    let vertices: Vec<Vec2> = (0..9)
        .map(|v| Vec2::new(f64::from(v % 3), f64::from(v / 3)))
        .collect();
    let triangles = vec![
        [0, 1, 4],
        [0, 4, 3],
        [1, 2, 5],
        [1, 5, 4],
        [3, 4, 7],
        [3, 7, 6],
        [4, 5, 8],
        [4, 8, 7],
    ];
    for degree in 1..=MAX_DEGREE {
        let net = KnotNet::clamped(degree, &vertices, triangles.clone()).unwrap();
        for row in 1..8 {
            for column in 1..8 {
                let u = Vec2::new(f64::from(column) / 4.0, f64::from(row) / 4.0);
                let sum: f64 = all_values(&net, u, Approach::default()).iter().sum();
                assert!((sum - 1.0).abs() < 1e-14, "{u}: {sum}");
            }
        }
    }
}

#[test]
fn moving_a_control_point_moves_only_its_surroundings() {
    let (net, mut dice) = net(3, 7);
    let before = TriangularBSpline::new(net.clone(), vec![0.0; net.functions()]).unwrap();
    let mut after = before.clone();
    let triangle = SIDE * SIDE / 2;
    after.control_points_mut()[triangle * net.functions_per_triangle() + 4] = 1.0;
    let points: Vec<Vec2> = (0..200).map(|_| inner_point(&mut dice)).collect();
    let mut changed = 0;
    for (u, value) in points.iter().zip(after.values(&points)) {
        let reached = net.triangles_at(*u).any(|active| active == triangle);
        assert!(reached || value == Some(0.0));
        changed += usize::from(value != Some(0.0));
    }
    assert!(changed > 0 && changed < 200);
}

#[test]
fn programs_share_most_of_the_recursion() {
    for degree in 1..=MAX_DEGREE {
        let (net, _) = net(degree, 3);
        let (constants, _) = net.program_size(SIDE * SIDE / 2);
        // The plain recursion computes 3^n pieces for each of the basis functions.
        let plain = exponent_count(degree) * 3_usize.pow(degree as u32);
        assert!(
            constants <= plain * 9 / 10,
            "degree {degree}: {constants} of {plain}"
        );
    }
}

#[test]
fn bad_nets_are_refused_with_a_reason() {
    let square = vec![
        vec![Vec2::new(0.0, 0.0); 4],
        vec![Vec2::new(1.0, 0.0); 4],
        vec![Vec2::new(0.0, 1.0); 4],
    ];
    assert_eq!(
        KnotNet::new(6, &square, vec![]).unwrap_err(),
        SimplexError::Degree(6)
    );
    assert!(matches!(
        KnotNet::new(2, &square, vec![]),
        Err(SimplexError::KnotCount {
            vertex: 0,
            found: 4,
            degree: 2
        })
    ));
    assert!(matches!(
        KnotNet::new(3, &square, vec![[0, 2, 1]]),
        Err(SimplexError::Folded {
            triangle: 0,
            knots: [0, 0, 0]
        })
    ));
    assert!(matches!(
        KnotNet::new(3, &square, vec![[0, 1, 9]]),
        Err(SimplexError::NoSuchVertex { vertex: 9, .. })
    ));
    let mut bad = square.clone();
    bad[1][2].y = f64::NAN;
    assert!(matches!(
        KnotNet::new(3, &bad, vec![[0, 1, 2]]),
        Err(SimplexError::KnotNotFinite {
            vertex: 1,
            knot: 2,
            ..
        })
    ));
    let net = KnotNet::new(3, &square, vec![[0, 1, 2]]).unwrap();
    assert!(matches!(
        TriangularBSpline::new(net.clone(), vec![0.0]),
        Err(SimplexError::ControlCount {
            found: 1,
            expected: 10
        })
    ));
    let spline = TriangularBSpline::new(net, vec![1.0; 10]).unwrap();
    let mut workspace = Workspace::default();
    assert_eq!(spline.value(Vec2::new(f64::NAN, 0.0), &mut workspace), None);
    assert_eq!(spline.value(Vec2::new(9.0, 9.0), &mut workspace), None);
}
