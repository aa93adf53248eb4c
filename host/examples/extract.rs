//! Extracts the surface through an ASCII PLY or six-column XYZ file and writes it as PLY, to look at phase 1 alone.
//!
//! `cargo run --release --example extract -- POINTS MESH.ply [neighbours] [cubic|quintic|septic|planes]`

use std::{error::Error, fmt::Write, fs, time::Instant};

use palpus_host::{
    Vec3,
    cloud::{Cloud, OrientedPoint},
    reconstruct::extract::{Kernel, Method, Options, extract},
};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(input), Some(output)) = (arguments.next(), arguments.next()) else {
        return Err("usage: extract POINTS MESH.ply [neighbours] [kernel]".into());
    };
    let text = fs::read_to_string(input)?;
    let body = text
        .split_once("end_header\n")
        .map_or(&text[..], |(_, body)| body);
    let mut cloud = Cloud::default();
    for line in body.lines() {
        let v: Vec<f64> = line
            .split_whitespace()
            .map_while(|w| w.parse().ok())
            .collect();
        if v.len() >= 6 {
            cloud.points.push(OrientedPoint {
                position: Vec3::new(v[0], v[1], v[2]),
                normal: Vec3::new(v[3], v[4], v[5]),
                sigma: None,
                finger: None,
                time_us: None,
            });
        }
    }
    let mut options = Options::default();
    if let Some(k) = arguments.next() {
        options.neighbours = k.parse()?;
    }
    options.method = match arguments.next().as_deref() {
        Some("cubic") => Method::Hermite(Kernel::Cubic),
        Some("septic") => Method::Hermite(Kernel::Septic),
        Some("quintic") => Method::Hermite(Kernel::Quintic),
        Some("planes") => Method::TangentPlanes,
        _ => options.method,
    };
    let start = Instant::now();
    let result = extract(&cloud, &options)?;
    let seconds = start.elapsed().as_secs_f64();
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        result.mesh.positions.len(),
        result.mesh.faces.len()
    );
    for p in &result.mesh.positions {
        writeln!(ply, "{} {} {}", p.x, p.y, p.z)?;
    }
    for f in &result.mesh.faces {
        writeln!(ply, "3 {} {} {}", f[0], f[1], f[2])?;
    }
    fs::write(output, ply)?;
    println!(
        "{} holes, {} components dropped\n{seconds:.3} s, {} points, {} triangles, {} fits, spacing {:.4}, noise {:.5} {:.2} deg, {} outliers, {} cubes, {} bytes",
        result.holes.len(),
        result.dropped_components,
        cloud.points.len(),
        result.mesh.faces.len(),
        result.field.fits(),
        result.spacing,
        result.noise.position_sigma,
        result.noise.normal_sigma.to_degrees(),
        result.outliers.len(),
        result.cubes,
        result.bytes
    );
    Ok(())
}
