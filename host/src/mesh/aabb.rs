//! Closest-point and ray queries on a triangle mesh, in time logarithmic in the number of faces.
//!
//! Two structures were weighed: a uniform grid (fastest to build, but a fingertip's mesh has triangles of
//! very different sizes and the query has to walk empty cells far from the surface) and a binary tree of
//! axis-aligned boxes. The tree was taken: no parameter, no bad case for points far away, 40 bytes a
//! node. It is built by splitting at the median centroid along the longest axis, so its shape, and with
//! it every answer, depends on the mesh alone. Ties go to the face with the lower index.

use super::TriangleMesh;
use super::closest::closest_on_triangle;
use crate::Vec3;

/// Faces in a leaf. Between 2 and 8 the query time hardly changes; 4 halves the nodes against 2.
const LEAF: usize = 4;

/// A tree over the faces of one mesh. The mesh is not kept: hand the same one to every query.
#[derive(Clone, Debug)]
pub struct AabbTree {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Node {
    low: Vec3,
    high: Vec3,
    /// First entry of `order` (leaf) or index of the right child (the left one follows its parent).
    link: u32,
    /// Number of faces in a leaf; 0 in an inner node.
    count: u32,
}

/// A foot point on a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootPoint {
    /// The face it lies in.
    pub face: u32,
    /// Barycentric coordinates in that face; they sum to 1 and none is negative.
    pub barycentric: [f64; 3],
    /// The point itself.
    pub position: Vec3,
    /// Distance from the query point, in the unit of the mesh.
    pub distance: f64,
}

/// A crossing of a ray with a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// The face that is hit.
    pub face: u32,
    /// Distance along the ray in lengths of its direction.
    pub distance: f64,
}

impl AabbTree {
    /// Builds the tree. Faces with a vertex index out of range or a coordinate that is not finite are left out.
    pub fn new(mesh: &TriangleMesh) -> Self {
        let mut order = Vec::with_capacity(mesh.faces.len());
        let mut centroids = vec![Vec3::zeros(); mesh.faces.len()];
        for f in 0..mesh.faces.len() {
            if let Some([a, b, c]) = mesh.corners(f as u32) {
                let centroid = (a + b + c) / 3.0;
                if centroid.iter().all(|x| x.is_finite()) {
                    centroids[f] = centroid;
                    order.push(f as u32);
                }
            }
        }
        let mut tree = Self {
            nodes: Vec::with_capacity(order.len()),
            order,
        };
        let all = tree.order.len();
        if all > 0 {
            tree.build(mesh, &centroids, 0, all);
        }
        tree
    }

    fn build(&mut self, mesh: &TriangleMesh, centroids: &[Vec3], start: usize, end: usize) {
        let (low, high) = box_of(mesh, &self.order[start..end]);
        let at = self.nodes.len();
        let count = end - start;
        self.nodes.push(Node {
            low,
            high,
            link: start as u32,
            count: count as u32,
        });
        if count <= LEAF {
            return;
        }
        let mut span_low = centroids[self.order[start] as usize];
        let mut span_high = span_low;
        for &f in &self.order[start..end] {
            span_low = span_low.inf(&centroids[f as usize]);
            span_high = span_high.sup(&centroids[f as usize]);
        }
        let axis = (span_high - span_low).imax();
        let middle = count / 2;
        self.order[start..end].select_nth_unstable_by(middle, |&a, &b| {
            centroids[a as usize][axis]
                .total_cmp(&centroids[b as usize][axis])
                .then(a.cmp(&b))
        });
        self.build(mesh, centroids, start, start + middle);
        self.nodes[at].link = self.nodes.len() as u32;
        self.nodes[at].count = 0;
        self.build(mesh, centroids, start + middle, end);
    }

    /// The closest point of `mesh` to `point`; `None` without faces or for a point that is not finite.
    pub fn closest(&self, mesh: &TriangleMesh, point: &Vec3) -> Option<FootPoint> {
        self.closest_where(mesh, point, f64::INFINITY, |_| true)
    }

    /// The closest point within `limit` among the faces that `accept` lets through (for example those
    /// whose normal agrees with the measured one). `None` when there is none.
    pub fn closest_where(
        &self,
        mesh: &TriangleMesh,
        point: &Vec3,
        limit: f64,
        mut accept: impl FnMut(u32) -> bool,
    ) -> Option<FootPoint> {
        if self.nodes.is_empty() || !point.iter().all(|x| x.is_finite()) {
            return None;
        }
        let mut best: Option<(f64, FootPoint)> = None;
        let mut bound = limit * limit;
        let mut stack = vec![(0u32, box_distance2(&self.nodes[0], point))];
        while let Some((at, reach)) = stack.pop() {
            if reach > bound {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count == 0 {
                let (left, right) = (at + 1, node.link);
                let dl = box_distance2(&self.nodes[left as usize], point);
                let dr = box_distance2(&self.nodes[right as usize], point);
                if dl <= dr {
                    stack.push((right, dr));
                    stack.push((left, dl));
                } else {
                    stack.push((left, dl));
                    stack.push((right, dr));
                }
                continue;
            }
            let first = node.link as usize;
            for &f in &self.order[first..first + node.count as usize] {
                if !accept(f) {
                    continue;
                }
                let Some([a, b, c]) = mesh.corners(f) else {
                    continue;
                };
                let w = closest_on_triangle(point, &a, &b, &c);
                let q = a * w[0] + b * w[1] + c * w[2];
                let d2 = (point - q).norm_squared();
                let wins = match &best {
                    None => d2 <= bound,
                    Some((b2, foot)) => d2 < *b2 || (d2 == *b2 && f < foot.face),
                };
                if wins {
                    bound = d2;
                    let foot = FootPoint {
                        face: f,
                        barycentric: w,
                        position: q,
                        distance: d2.sqrt(),
                    };
                    best = Some((d2, foot));
                }
            }
        }
        best.map(|(_, foot)| foot)
    }

    /// The first face hit by the ray from `origin` along `direction` at a distance in `(from, to)`, among
    /// those `accept` lets through.
    pub fn ray(
        &self,
        mesh: &TriangleMesh,
        origin: &Vec3,
        direction: &Vec3,
        from: f64,
        to: f64,
        mut accept: impl FnMut(u32) -> bool,
    ) -> Option<RayHit> {
        let mut best: Option<RayHit> = None;
        let mut bound = to;
        let mut stack = if self.nodes.is_empty() {
            Vec::new()
        } else {
            vec![0u32]
        };
        while let Some(at) = stack.pop() {
            let node = &self.nodes[at as usize];
            if !ray_meets_box(node, origin, direction, from, bound) {
                continue;
            }
            if node.count == 0 {
                stack.push(node.link);
                stack.push(at + 1);
                continue;
            }
            let first = node.link as usize;
            for &f in &self.order[first..first + node.count as usize] {
                let Some(corners) = mesh.corners(f) else {
                    continue;
                };
                if let Some(t) = ray_triangle(origin, direction, &corners)
                    && t > from
                    && (t < bound || (t == bound && best.is_some_and(|b| f < b.face)))
                    && accept(f)
                {
                    bound = t;
                    best = Some(RayHit {
                        face: f,
                        distance: t,
                    });
                }
            }
        }
        best
    }
}

fn box_of(mesh: &TriangleMesh, faces: &[u32]) -> (Vec3, Vec3) {
    let mut low = Vec3::repeat(f64::INFINITY);
    let mut high = Vec3::repeat(f64::NEG_INFINITY);
    for &f in faces {
        for p in mesh.corners(f).iter().flatten() {
            low = low.inf(p);
            high = high.sup(p);
        }
    }
    (low, high)
}

fn box_distance2(node: &Node, p: &Vec3) -> f64 {
    let mut sum = 0.0;
    for k in 0..3 {
        let d = (node.low[k] - p[k]).max(p[k] - node.high[k]).max(0.0);
        sum += d * d;
    }
    sum
}

fn ray_meets_box(node: &Node, origin: &Vec3, direction: &Vec3, from: f64, to: f64) -> bool {
    let (mut t0, mut t1) = (from, to);
    for k in 0..3 {
        if direction[k] == 0.0 {
            if origin[k] < node.low[k] || origin[k] > node.high[k] {
                return false;
            }
            continue;
        }
        let a = (node.low[k] - origin[k]) / direction[k];
        let b = (node.high[k] - origin[k]) / direction[k];
        t0 = t0.max(a.min(b));
        t1 = t1.min(a.max(b));
    }
    t0 <= t1
}

/// Moeller and Trumbore 1997, both sides, edges included.
fn ray_triangle(origin: &Vec3, direction: &Vec3, [a, b, c]: &[Vec3; 3]) -> Option<f64> {
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(&e2);
    let det = e1.dot(&p);
    if det == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(&p) / det;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / det;
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
        Some(e2.dot(&q) / det)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use rand::{Rng, RngExt, SeedableRng};

    fn random_point(rng: &mut impl Rng) -> Vec3 {
        Vec3::from_fn(|_, _| rng.random_range(-1.5..1.5))
    }

    #[test]
    fn agrees_with_looking_at_every_face() {
        let mesh = shapes::torus(1.0, 0.4, 24, 12);
        let tree = AabbTree::new(&mesh);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        for _ in 0..500 {
            let p = random_point(&mut rng);
            let mut want = (f64::INFINITY, 0);
            for f in 0..mesh.faces.len() as u32 {
                let [a, b, c] = mesh.corners(f).unwrap();
                let w = closest_on_triangle(&p, &a, &b, &c);
                let d2 = (p - (a * w[0] + b * w[1] + c * w[2])).norm_squared();
                if d2 < want.0 {
                    want = (d2, f);
                }
            }
            let got = tree.closest(&mesh, &p).unwrap();
            assert_eq!(got.face, want.1);
            assert!((got.distance - want.0.sqrt()).abs() < 1e-14);
        }
    }

    #[test]
    fn a_filter_reaches_the_other_sheet() {
        let mesh = shapes::icosphere(2);
        let tree = AabbTree::new(&mesh);
        let p = Vec3::new(0.0, 0.0, 1.0);
        let foot = tree
            .closest_where(&mesh, &p, 10.0, |f| mesh.face_normal(f).z < -0.2)
            .unwrap();
        assert!(mesh.face_normal(foot.face).z < -0.2);
        assert!(
            tree.closest_where(&mesh, &(p * 3.0), 0.5, |_| true)
                .is_none()
        );
    }

    #[test]
    fn rays_cross_the_tube_at_its_thickness() {
        let mesh = shapes::torus(1.0, 0.4, 200, 100);
        let tree = AabbTree::new(&mesh);
        let hit = tree
            .ray(
                &mesh,
                &Vec3::new(1.4, 0.0, 0.0),
                &-Vec3::x(),
                1e-6,
                10.0,
                |_| true,
            )
            .unwrap();
        assert!((hit.distance - 0.8).abs() < 2e-3, "{}", hit.distance);
        assert!(
            tree.ray(
                &mesh,
                &Vec3::new(0.0, 0.0, 2.0),
                &-Vec3::z(),
                0.0,
                10.0,
                |_| true
            )
            .is_none()
        );
    }

    #[test]
    fn bad_input_is_left_out_not_a_panic() {
        let mut mesh = shapes::icosphere(1);
        mesh.faces.push([0, 1, 9999]);
        mesh.positions[0] = Vec3::repeat(f64::NAN);
        let tree = AabbTree::new(&mesh);
        assert!(tree.closest(&mesh, &Vec3::zeros()).is_some());
        assert!(tree.closest(&mesh, &Vec3::repeat(f64::NAN)).is_none());
        let empty = TriangleMesh::default();
        assert!(
            AabbTree::new(&empty)
                .closest(&empty, &Vec3::zeros())
                .is_none()
        );
    }
}
