//! Speed of triangular B-splines: the plain recursion, the shared programs, and batches in parallel.
//!
//! One iteration evaluates all basis functions that reach each of [`POINTS`] random points of a jittered grid.
#![allow(missing_docs, reason = "criterion's macros make public items")]

use criterion::{Criterion, criterion_group, criterion_main};
use palpus_host::Vec3;
use palpus_host::spline::simplex::{
    Approach, KnotNet, TriangularBSpline, Vec2, Workspace, exponents, simplex_spline,
    simplex_spline_derivative,
};
use std::hint::black_box;

const SIDE: usize = 6;
const POINTS: usize = 64;

/// Numbers between -1 and 1 from a seed (splitmix64).
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn net(degree: usize) -> (KnotNet, Vec<Vec2>) {
    let mut dice = Dice(1);
    let mut clouds = Vec::new();
    for row in 0..SIDE {
        for column in 0..SIDE {
            let vertex =
                Vec2::new(column as f64, row as f64) + Vec2::new(dice.next(), dice.next()) * 0.125;
            let mut cloud = vec![vertex];
            cloud.extend((0..degree).map(|_| vertex + Vec2::new(dice.next(), dice.next()) * 0.125));
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
    let middle = (SIDE - 1) as f64 / 2.0;
    let points = (0..POINTS)
        .map(|_| Vec2::new(middle, middle) + Vec2::new(dice.next(), dice.next()) * (middle - 1.4))
        .collect();
    let net = KnotNet::new(degree, &clouds, triangles).expect("clouds are small");
    (net, points)
}

/// Sum over all basis functions at a point of `of(knots)` times the normalisation.
fn plain(net: &KnotNet, u: Vec2, of: impl Fn(&[Vec2]) -> f64) -> f64 {
    let mut sum = 0.0;
    for triangle in net.triangles_at(u) {
        let corners = net.triangles()[triangle];
        for beta in exponents(net.degree()) {
            let knots: Vec<Vec2> = (0..3)
                .flat_map(|k| &net.cloud(corners[k] as usize)[..=beta[k]])
                .copied()
                .collect();
            let [a, b, c] = [0, 1, 2].map(|k| net.cloud(corners[k] as usize)[beta[k]]);
            sum += (b - a).perp(&(c - a)).abs() * of(&knots);
        }
    }
    sum
}

fn splines(criterion: &mut Criterion) {
    let approach = Approach::default();
    for degree in [2, 3, 5] {
        let (net, points) = net(degree);
        let mut group = criterion.benchmark_group(format!("basis functions, degree {degree}"));
        group.sample_size(10);
        group.bench_function("values, plain recursion", |b| {
            b.iter(|| {
                points
                    .iter()
                    .map(|u| plain(&net, *u, |knots| simplex_spline(*u, knots, approach)))
                    .sum::<f64>()
            });
        });
        let mut workspace = Workspace::default();
        group.bench_function("values, shared", |b| {
            b.iter(|| {
                let mut sum = 0.0;
                for u in black_box(&points) {
                    for triangle in net.triangles_at(*u) {
                        sum += net
                            .values(triangle, *u, approach, &mut workspace)
                            .iter()
                            .sum::<f64>();
                    }
                }
                sum
            });
        });
        let (x, y) = (Vec2::x(), Vec2::y());
        let orders: [&[Vec2]; 6] = [&[], &[x], &[y], &[x, x], &[x, y], &[y, y]];
        group.bench_function("jets, plain recursion", |b| {
            b.iter(|| {
                points
                    .iter()
                    .map(|u| {
                        plain(&net, *u, |knots| {
                            orders
                                .iter()
                                .map(|along| simplex_spline_derivative(*u, knots, along, approach))
                                .sum()
                        })
                    })
                    .sum::<f64>()
            });
        });
        group.bench_function("jets, shared", |b| {
            b.iter(|| {
                let mut sum = 0.0;
                for u in black_box(&points) {
                    for triangle in net.triangles_at(*u) {
                        for jet in net.jets(triangle, *u, approach, &mut workspace) {
                            sum += jet.value + jet.gradient[0] + jet.hessian[1];
                        }
                    }
                }
                sum
            });
        });
        group.finish();
        let control = net
            .greville_points()
            .iter()
            .map(|u| Vec3::new(u.x, u.y, u.x * u.y))
            .collect();
        let surface = TriangularBSpline::new(net, control).expect("one per basis function");
        let many: Vec<Vec2> = points.iter().cycle().take(100 * POINTS).copied().collect();
        let mut group = criterion.benchmark_group(format!("surface, degree {degree}"));
        group.sample_size(10);
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("threads");
            group.bench_function(format!("{} points, {threads} thread(s)", many.len()), |b| {
                b.iter(|| pool.install(|| surface.values(black_box(&many))));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, splines);
criterion_main!(benches);
