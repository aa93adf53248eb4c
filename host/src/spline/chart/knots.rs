//! Knot clouds for a planar triangulation.
//!
//! Each vertex is the centre of its cloud: the other n knots lie on a circle around it, evenly spread, with a
//! radius that is a fixed share of the smallest height of the triangles around the vertex. As long as that
//! share is below a third, every triangle keeps its orientation when its corners move to any of their knots, so
//! the triangles of knots are proper. Three knots on a line are avoided by turning each cloud so that
//! the lines through two of its knots point as far away from the neighbouring vertices as possible.
//!
//! Two shapes of clouds were weighed: random ones (general position for free, but sometimes almost degenerate) and
//! these regular ones, turned. The second was taken because its worst case can be stated ([`CloudBounds`]).

use super::super::simplex::{SimplexError, Vec2};
use std::f64::consts::{PI, TAU};

/// What the clouds keep to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudBounds {
    /// Radius of a cloud over the smallest height of the triangles around its vertex.
    pub radius_share: f64,
    /// Smallest angle between a line through two knots of a cloud and the line from their middle to a
    /// neighbouring vertex, degrees: what keeps three knots from one line.
    pub least_turn_degrees: f64,
}

/// Radius of a cloud over the smallest height around its vertex. A share above 1/3 could fold triangles.
/// Larger clouds spread the changes of the highest derivative and keep pieces wide; smaller ones leave more of each triangle one polynomial.
const RADIUS_SHARE: f64 = 0.12;
/// Turns tried per cloud.
const TURNS: usize = 64;

/// Knot clouds of degree + 1 knots for each vertex, itself first, and the bounds they keep.
///
/// # Errors
/// [`SimplexError::NoSuchVertex`] if a triangle names a vertex that is not there.
pub fn knot_clouds(
    degree: usize,
    vertices: &[Vec2],
    triangles: &[[u32; 3]],
) -> Result<(Vec<Vec<Vec2>>, CloudBounds), SimplexError> {
    let mut height = vec![f64::INFINITY; vertices.len()];
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); vertices.len()];
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|v| **v as usize >= vertices.len()) {
            return Err(SimplexError::NoSuchVertex {
                triangle,
                vertex,
                vertices: vertices.len(),
            });
        }
        let [a, b, c] = corners.map(|v| vertices[v as usize]);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let least = (b - a).perp(&(c - a)).abs() / longest.max(f64::MIN_POSITIVE);
        for k in 0..3 {
            let vertex = corners[k] as usize;
            height[vertex] = height[vertex].min(least);
            around[vertex].extend([corners[(k + 1) % 3], corners[(k + 2) % 3]]);
        }
    }
    let mut bounds = CloudBounds {
        radius_share: RADIUS_SHARE,
        least_turn_degrees: 180.0,
    };
    let mut clouds = Vec::with_capacity(vertices.len());
    for (number, vertex) in vertices.iter().enumerate() {
        let neighbours = &mut around[number];
        neighbours.sort_unstable();
        neighbours.dedup();
        let radius = if height[number].is_finite() {
            RADIUS_SHARE * height[number]
        } else {
            0.0
        };
        // An even number of knots would lie opposite each other, on one line with the vertex.
        let spread = (degree | 1) as f64;
        let cloud_at = |turn: f64| -> Vec<Vec2> {
            let mut cloud = vec![*vertex];
            cloud.extend((0..degree).map(|k| {
                let angle = turn + TAU * k as f64 / spread;
                vertex + Vec2::new(angle.cos(), angle.sin()) * radius
            }));
            cloud
        };
        let mut best = (f64::NEG_INFINITY, cloud_at(0.0));
        for step in 0..TURNS {
            // The golden angle from vertex to vertex keeps neighbouring clouds from being copies of each other.
            let turn = PI * (step as f64 / TURNS as f64 + 0.618_033_988_749_895 * number as f64);
            let cloud = cloud_at(turn);
            let least = least_turn(&cloud, neighbours, vertices);
            if least > best.0 {
                best = (least, cloud);
            }
        }
        if !neighbours.is_empty() {
            bounds.least_turn_degrees = bounds.least_turn_degrees.min(best.0.to_degrees());
        }
        clouds.push(best.1);
    }
    Ok((clouds, bounds))
}

/// Smallest angle between lines through two knots of a cloud and the ways to the neighbours.
fn least_turn(cloud: &[Vec2], neighbours: &[u32], vertices: &[Vec2]) -> f64 {
    let mut least = f64::INFINITY;
    for (k, a) in cloud.iter().enumerate() {
        for b in &cloud[k + 1..] {
            for neighbour in neighbours {
                let way = vertices[*neighbour as usize] - (a + b) / 2.0;
                let line = b - a;
                let angle = way.perp(&line).abs().atan2(way.dot(&line).abs());
                least = least.min(angle);
            }
        }
    }
    if least.is_finite() { least } else { PI / 2.0 }
}

#[cfg(test)]
mod tests {
    use super::super::super::simplex::{Approach, KnotNet, Workspace, side_of_line};
    use super::*;

    /// A hexagonal lattice, slightly jittered.
    fn lattice() -> (Vec<Vec2>, Vec<[u32; 3]>) {
        const SIDE: u32 = 6;
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        for row in 0..SIDE {
            for column in 0..SIDE {
                let jitter = 0.05 * f64::from((row * 7 + column * 3) % 5) - 0.1;
                vertices.push(Vec2::new(
                    f64::from(column) + 0.5 * f64::from(row) + jitter,
                    f64::from(row) * 0.75_f64.sqrt() - jitter / 2.0,
                ));
                if row + 1 < SIDE && column + 1 < SIDE {
                    let corner = row * SIDE + column;
                    triangles.push([corner, corner + 1, corner + SIDE]);
                    triangles.push([corner + 1, corner + SIDE + 1, corner + SIDE]);
                }
            }
        }
        (vertices, triangles)
    }

    #[test]
    fn clouds_are_proper_and_within_their_bounds() {
        let (vertices, triangles) = lattice();
        for degree in 2..=5 {
            let (clouds, bounds) = knot_clouds(degree, &vertices, &triangles).unwrap();
            let net = KnotNet::new(degree, &clouds, triangles.clone()).unwrap();
            assert!(bounds.least_turn_degrees > 1.0, "{degree}: {bounds:?}");
            for corners in &triangles {
                let knots: Vec<Vec2> = corners
                    .iter()
                    .flat_map(|v| &clouds[*v as usize])
                    .copied()
                    .collect();
                for (i, a) in knots.iter().enumerate() {
                    for (j, b) in knots.iter().enumerate().skip(i + 1) {
                        for c in &knots[j + 1..] {
                            let side = side_of_line(*a, *b, *c, Approach::from_side(Vec2::zeros()));
                            assert_ne!(side, 0);
                            let thin = (b - a).perp(&(c - a)).abs()
                                / (b - a)
                                    .norm()
                                    .max((c - a).norm())
                                    .max((c - b).norm())
                                    .powi(2);
                            assert!(thin > 1e-5, "{degree}: {thin}");
                        }
                    }
                }
            }
            // Two rings away from the border of the lattice the basis functions sum to 1.
            let mut workspace = Workspace::default();
            for (x, y) in [(2.0, 1.0), (2.3, 1.4), (3.1, 2.0), (2.9, 1.9)] {
                let u = Vec2::new(x + 0.5 * y, y * 0.75_f64.sqrt());
                let sum: f64 = net
                    .triangles_at(u)
                    .map(|t| {
                        net.values(t, u, Approach::default(), &mut workspace)
                            .iter()
                            .sum::<f64>()
                    })
                    .sum();
                assert!((sum - 1.0).abs() < 1e-12, "{degree}: {sum}");
            }
        }
    }
}
