//! Speed of each phase and of the whole, on 1229 noisy contact-track points of a torus of unit size.
#![allow(missing_docs, reason = "criterion's macros make public items")]

use criterion::{Criterion, criterion_group, criterion_main};
use palpus_host::cloud::Cloud;
use palpus_host::reconstruct::{Options, Stage, reconstruct};
use palpus_host::simulate::{Object, PointSet};
use std::hint::black_box;

fn points() -> Cloud {
    let object = Object::named("torus").expect("torus is a known object");
    PointSet {
        count: 1229,
        longest_side: Some(1.0),
        position_noise: 0.005,
        normal_noise_degrees: 3.0,
        ..PointSet::default()
    }
    .points(&object)
}

fn phases(criterion: &mut Criterion) {
    let cloud = points();
    let mut group = criterion.benchmark_group("reconstruct 1229 points");
    group.sample_size(10);
    for (name, stop_after) in [
        ("extract", Stage::Extract),
        ("extract, simplify", Stage::Simplify),
        ("extract, simplify, fit", Stage::Fit),
        ("whole", Stage::Refine),
    ] {
        for threads in [1, 2] {
            let options = Options {
                stop_after,
                threads: Some(threads),
                ..Options::default()
            };
            group.bench_function(format!("{name}, {threads} thread(s)"), |b| {
                b.iter(|| reconstruct(black_box(&cloud), &options, &|_| ()));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, phases);
criterion_main!(benches);
