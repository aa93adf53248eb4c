//! Basis functions of a net at so many points, by the plain recursion or by the shared programs: instructions to count, which
//! are the same in every run. `POINTS` 0 costs what comes before (net and programs); take it off.
//!
//!     cargo build --release -p palpus-host --example basis
//!     for points in 0 64; do for way in plain shared; do
//!         valgrind --tool=callgrind --callgrind-out-file=/dev/null target/release/examples/basis $way 3 $points
//!     done; done
//!
//! Arguments: `plain` or `shared`, the degree (1 to 5), the number of points.

#[path = "../benches/simplex_net/mod.rs"]
mod simplex_net;

use palpus_host::spline::simplex::{Approach, Workspace, simplex_spline};
use simplex_net::{net, plain};

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [way, degree, count] = &arguments[..] else {
        return Err("usage: basis plain|shared DEGREE POINTS".into());
    };
    let number = |text: &String| {
        text.parse::<usize>()
            .map_err(|e| format!("{text}: {e}; give a number"))
    };
    let (degree, count) = (number(degree)?, number(count)?);
    let approach = Approach::default();
    let (net, points) = net(degree, count);
    let mut workspace = Workspace::default();
    let sum: f64 = match way.as_str() {
        "plain" => points
            .iter()
            .map(|u| plain(&net, *u, |knots| simplex_spline(*u, knots, approach)))
            .sum(),
        "shared" => points
            .iter()
            .map(|u| {
                net.triangles_at(*u)
                    .map(|t| {
                        net.values(t, *u, approach, &mut workspace)
                            .iter()
                            .sum::<f64>()
                    })
                    .sum::<f64>()
            })
            .sum(),
        other => return Err(format!("{other}: give plain or shared")),
    };
    // Partition of unity: the sum is the number of points.
    println!("{sum}");
    Ok(())
}
