//! Speed of triangular B-splines: the plain recursion, the shared programs, and batches in parallel.
//!
//! One iteration evaluates all basis functions that reach each of [`POINTS`] random points of a jittered grid.
#![allow(missing_docs, reason = "criterion's macros make public items")]

use criterion::{Criterion, criterion_group, criterion_main};
use palpus_host::Vec3;
use palpus_host::spline::simplex::{
    Approach, TriangularBSpline, Vec2, Workspace, simplex_spline, simplex_spline_derivative,
};
use simplex_net::{net, plain};
use std::hint::black_box;

mod simplex_net;

const POINTS: usize = 64;

fn splines(criterion: &mut Criterion) {
    let approach = Approach::default();
    for degree in [2, 3, 5] {
        let (net, points) = net(degree, POINTS);
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
