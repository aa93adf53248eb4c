//! A net of triangular B-splines with random knots, and the plain recursion on it: what the benchmark times and the example
//! `basis` counts.

use palpus_host::spline::simplex::{KnotNet, Vec2, exponents};

const SIDE: usize = 6;

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

/// A jittered grid with clouds of an eighth of its edges, and so many points in its middle.
pub fn net(degree: usize, points: usize) -> (KnotNet, Vec<Vec2>) {
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
    let points = (0..points)
        .map(|_| Vec2::new(middle, middle) + Vec2::new(dice.next(), dice.next()) * (middle - 1.4))
        .collect();
    let net = KnotNet::new(degree, &clouds, triangles).expect("clouds are small");
    (net, points)
}

/// Sum over all basis functions at a point of `of(knots)` times the normalisation.
pub fn plain(net: &KnotNet, u: Vec2, of: impl Fn(&[Vec2]) -> f64) -> f64 {
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
