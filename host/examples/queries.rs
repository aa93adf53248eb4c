//! Figures of the queries: closest points on a million places, and curvature from 1229 clean contacts.
//!
//!     cargo run --release -p palpus-host --example queries

use palpus_host::Vec3;
use palpus_host::mesh::{AabbTree, TriangleMesh};
use palpus_host::reconstruct::{Options, reconstruct};
use palpus_host::simulate::{Object, PointSet};
use palpus_host::spline::Surface;
use palpus_host::spline::query::SurfaceTree;
use std::time::Instant;

/// Reconstructed from 1229 points of an object of unit size, random over it, without noise.
fn surface(object: &str) -> Surface {
    let points = PointSet {
        count: 1229,
        longest_side: Some(1.0),
        position_noise: 0.0,
        normal_noise_degrees: 0.0,
        ..PointSet::default()
    };
    let object = Object::named(object).expect("a known object");
    let result = reconstruct(&points.points(&object), &Options::default(), &|_| ());
    result.expect("clean points").surface.expect("not stopped")
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

fn curvature(name: &str, surface: &Surface, truth: impl Fn(&Vec3) -> [f64; 2]) {
    let mut sampled = surface.sample_per_patch(8).expect("a valid surface");
    surface.add_curvature(&mut sampled);
    for (part, of) in [(0, "mean"), (1, "Gaussian")] {
        // Where the Gaussian curvature of a torus crosses zero, its share has no meaning: relative to the median size.
        let mut sizes: Vec<f64> = sampled
            .positions
            .iter()
            .map(|p| truth(p)[part].abs())
            .collect();
        let typical = quantile(&mut sizes, 0.5);
        let mut errors: Vec<f64> = sampled
            .positions
            .iter()
            .zip(&sampled.curvature)
            .map(|(p, c)| {
                let wanted = truth(p)[part];
                (c[part] - wanted).abs() / wanted.abs().max(typical)
            })
            .collect();
        println!(
            "{name}, {} patches: {of} curvature off by {:.2} % in the median, {:.2} % at the 95th percentile ({} places)",
            surface.faces.len(),
            100.0 * quantile(&mut errors, 0.5),
            100.0 * quantile(&mut errors, 0.95),
            errors.len()
        );
    }
}

fn main() {
    let sphere = surface("sphere");
    curvature("sphere", &sphere, |_| [2.0, 4.0]);
    let torus = surface("torus");
    // The simulation's torus has radii 60 and 28, here scaled to a diameter of 1; its axis is z.
    let (large, small) = (60.0 / 176.0, 28.0 / 176.0);
    curvature("torus", &torus, |p| {
        let cosine = (p.xy().norm() - large) / small;
        let around = cosine / (large + small * cosine);
        [0.5 * (1.0 / small + around), around / small]
    });

    let (low, high) = torus.bounding_box().expect("has patches");
    const QUERIES: usize = 1_000_000;
    let mut state = 5_u64;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let queries: Vec<Vec3> = (0..QUERIES)
        .map(|_| low + (high - low).component_mul(&Vec3::new(next(), next(), next())))
        .collect();
    let started = Instant::now();
    let tree = SurfaceTree::new(&torus);
    println!("tree: {:.3} s", started.elapsed().as_secs_f64());
    let started = Instant::now();
    let found = tree.closest_all(&torus, &queries);
    let seconds = started.elapsed().as_secs_f64();
    let worst_residual = found
        .iter()
        .flatten()
        .map(|f| f.residual)
        .fold(0.0, f64::max);
    let widest_gap = found.iter().flatten().map(|f| f.gap).fold(0.0, f64::max);
    let open = found.iter().flatten().filter(|f| f.gap > 1e-11).count();
    println!(
        "{QUERIES} closest points in {seconds:.2} s on {} threads, {:.0} a second; largest residual {worst_residual:.1e}; certified to {widest_gap:.1e}, {open} to more than 1e-11",
        std::thread::available_parallelism().map_or(1, usize::from),
        QUERIES as f64 / seconds
    );
    let fine = torus.sample_per_patch(64).expect("a valid surface");
    let mesh = TriangleMesh {
        positions: fine.positions,
        faces: fine.triangles,
    };
    let started = Instant::now();
    let mesh_tree = AabbTree::new(&mesh);
    let mut farther = 0;
    let (mut sum, mut worst) = (0.0, 0.0_f64);
    for (query, found) in queries.iter().zip(&found) {
        let (Some(foot), Some(found)) = (mesh_tree.closest(&mesh, query), found) else {
            continue;
        };
        let off = found.distance - foot.distance;
        // The mesh's triangles cut corners by their chord error.
        farther += usize::from(off > 1e-4);
        sum += off * off;
        worst = worst.max(off.abs());
    }
    println!(
        "against a mesh of {} triangles ({:.1} s): distances differ by {:.1e} rms, {worst:.1e} at most; {farther} farther by more than 1e-4",
        mesh.faces.len(),
        started.elapsed().as_secs_f64(),
        (sum / QUERIES as f64).sqrt()
    );
}
