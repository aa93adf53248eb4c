//! A tree of boxes over the pieces of a surface's patches.
//!
//! Every patch is cut in [`PIECES`] triangles of the same size in its parameters; the control points of a piece
//! hold it, so their box does. Two bounds were weighed: boxes (cheap to test, loose on slanted pieces) and oriented slabs
//! (tighter, several times the cost per test). Boxes were taken: halving a piece tightens its box
//! fourfold across, so cutting once or twice makes up for the slant.

use super::super::surface::Surface;
use super::cell::{Bend, Cell};
use crate::Vec3;

/// Cuts of a patch's edge; pieces are its square.
const CUTS: usize = 4;
/// Pieces of a patch.
pub const PIECES: usize = CUTS * CUTS;
/// Pieces in a leaf.
const LEAF: usize = 2;

/// Boxes over the pieces of one surface. The surface is not kept: hand the same one to every query.
#[derive(Clone, Debug)]
pub struct SurfaceTree {
    pub(super) nodes: Vec<Node>,
    pub(super) pieces: Vec<Piece>,
}

/// A box and what it holds.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub low: Vec3,
    pub high: Vec3,
    /// First piece (leaf) or right child (the left one follows its parent).
    pub link: u32,
    /// Pieces in a leaf; 0 in an inner node.
    pub count: u32,
}

/// A part of a patch.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub cell: Cell,
    pub bend: Bend,
    /// Barycentric coordinates of its middle.
    pub middle: [f64; 3],
    pub low: Vec3,
    pub high: Vec3,
}

impl SurfaceTree {
    /// Builds the tree; it depends on the surface alone.
    pub fn new(surface: &Surface) -> Self {
        let mut pieces = Vec::with_capacity(PIECES * surface.control_points.len());
        for (face, points) in surface.control_points.iter().enumerate() {
            for corners in cuts() {
                let cell = Cell::new(points, face as u32, corners);
                let (low, high) = cell.hull_box();
                if low.iter().chain(high.iter()).all(|x| x.is_finite()) {
                    pieces.push(Piece {
                        middle: cell.of_patch([1.0 / 3.0; 3]),
                        bend: Bend::new(&cell),
                        cell,
                        low,
                        high,
                    });
                }
            }
        }
        let mut tree = Self {
            nodes: Vec::with_capacity(pieces.len()),
            pieces,
        };
        if !tree.pieces.is_empty() {
            tree.build(0, tree.pieces.len());
        }
        tree
    }

    /// The box that holds the whole surface; `None` without patches.
    pub fn bounding_box(&self) -> Option<(Vec3, Vec3)> {
        self.nodes.first().map(|node| (node.low, node.high))
    }

    fn build(&mut self, start: usize, end: usize) {
        let pieces = &mut self.pieces[start..end];
        let (low, high) = pieces.iter().fold(
            (Vec3::repeat(f64::MAX), Vec3::repeat(f64::MIN)),
            |(low, high), piece| (low.inf(&piece.low), high.sup(&piece.high)),
        );
        let at = self.nodes.len();
        self.nodes.push(Node {
            low,
            high,
            link: start as u32,
            count: (end - start) as u32,
        });
        if end - start <= LEAF {
            return;
        }
        let axis = (high - low).imax();
        let middle = pieces.len() / 2;
        let key = |piece: &Piece| piece.low[axis] + piece.high[axis];
        pieces.select_nth_unstable_by(middle, |a, b| {
            key(a)
                .total_cmp(&key(b))
                .then(a.cell.face.cmp(&b.cell.face))
                .then(a.middle[0].total_cmp(&b.middle[0]))
                .then(a.middle[1].total_cmp(&b.middle[1]))
        });
        self.build(start, start + middle);
        self.nodes[at].link = self.nodes.len() as u32;
        self.nodes[at].count = 0;
        self.build(start + middle, end);
    }
}

/// Corners of the pieces of a patch.
fn cuts() -> impl Iterator<Item = [[f64; 3]; 3]> {
    let at = |i: usize, j: usize| [i, j, CUTS - i - j].map(|m| m as f64 / CUTS as f64);
    (0..CUTS).flat_map(move |i| {
        (0..CUTS - i).flat_map(move |j| {
            let upright = [at(i, j), at(i + 1, j), at(i, j + 1)];
            let turned =
                (i + j + 2 <= CUTS).then(|| [at(i + 1, j + 1), at(i, j + 1), at(i + 1, j)]);
            std::iter::once(upright).chain(turned)
        })
    })
}

/// Squared distance of a point from a box.
pub(super) fn box_distance2(low: &Vec3, high: &Vec3, point: &Vec3) -> f64 {
    (point.sup(low).inf(high) - point).norm_squared()
}
