//! Which moves keep a mesh a manifold of the same topology, with its borders and creases in place.
//!
//! The rules for collapses are the link condition (Dey, Edelsbrunner, Guha, Nekhayev 1999; Hoppe et al.
//! 1993, section 4.1, give the same three for closed meshes and meshes with border), with the border
//! treated as if a further vertex closed it. On top of it lie the rules for features (crease and border
//! edges): a smooth vertex may vanish into a feature, a feature vertex only along its feature, and a
//! fixed vertex not at all.

use super::half_edge::{HalfEdgeMesh, NONE};
use thiserror::Error;

/// Why a move was refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum IllegalMove {
    /// The half-edge was removed or never existed.
    #[error("there is no such half-edge; name one of edges()")]
    NoSuchEdge,
    /// The ends have a common neighbour besides the apexes of the edge's faces.
    #[error("the collapse would fold the mesh onto itself; collapse another edge first")]
    LinkCondition,
    /// The edge joins two borders, or two stretches of one, through the inside.
    #[error("the collapse would pinch the border; collapse along the border instead")]
    PinchesBorder,
    /// The edge joins two features without being one.
    #[error("the collapse would join two features; collapse along a feature instead")]
    JoinsFeatures,
    /// Both ends must stay.
    #[error("both ends are fixed; choose another edge")]
    BothFixed,
    /// A border or crease edge cannot be flipped.
    #[error("the edge is a crease or a border; choose another edge")]
    Feature,
    /// The vertices a flip would join are joined already.
    #[error("the edge the flip would make exists already; choose another edge")]
    EdgeExists,
    /// A vertex would be left with too few edges.
    #[error("a vertex would keep too few edges; choose another edge")]
    TooFewEdges,
    /// The position is not a finite number.
    #[error("the position is not finite; compute another one")]
    NotFinite,
}

/// How free a vertex is to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Freedom {
    /// On the surface.
    Surface,
    /// Along a crease or a border: exactly two feature edges meet here.
    Curve,
    /// Nowhere: pinned, the end of a crease, or a corner of three and more feature edges.
    Fixed,
}

/// Where the vertex that a collapse leaves behind may be put.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CollapseTo {
    /// Anywhere on the surface.
    Surface,
    /// Anywhere on the feature that the edge is part of.
    Curve,
    /// Where this vertex is, and nowhere else.
    Vertex(u32),
}

impl HalfEdgeMesh {
    /// How free `v` is to move.
    pub fn freedom(&self, v: u32) -> Freedom {
        if self.pinned[v as usize] {
            return Freedom::Fixed;
        }
        match self.features_at(v).count() {
            0 => Freedom::Surface,
            2 => Freedom::Curve,
            _ => Freedom::Fixed,
        }
    }

    /// Whether the edge of `h` may be collapsed, and where the remaining vertex may be put.
    ///
    /// # Errors
    /// The rule that forbids it.
    pub fn may_collapse(&self, h: u32) -> Result<CollapseTo, IllegalMove> {
        if !self.is_live(h) {
            return Err(IllegalMove::NoSuchEdge);
        }
        let (a, b) = (self.origin(h), self.destination(h));
        let twin = self.twin(h);
        if twin != NONE && self.is_border_vertex(a) && self.is_border_vertex(b) {
            return Err(IllegalMove::PinchesBorder);
        }
        for side in [h, twin] {
            if side == NONE {
                continue;
            }
            // The two other edges of the face become one.
            let (one, other) = (Self::next(side), Self::prev(side));
            if self.is_border(one) && self.is_border(other) {
                return Err(IllegalMove::PinchesBorder);
            }
            if self.is_feature(one) && self.is_feature(other) {
                return Err(IllegalMove::JoinsFeatures);
            }
        }
        let apex = self.apex(h);
        let far = if twin == NONE { NONE } else { self.apex(twin) };
        for v in self.neighbours(a) {
            if v != apex && v != far && self.neighbours(b).any(|w| w == v) {
                return Err(IllegalMove::LinkCondition);
            }
        }
        // Two faces besides those of the edge may span its ends' common link only in a tetrahedron.
        if far != NONE && self.valence(a) == 3 && self.valence(b) == 3 {
            return Err(IllegalMove::LinkCondition);
        }
        let (fa, fb) = (self.freedom(a), self.freedom(b));
        match (fa, fb) {
            (Freedom::Surface, Freedom::Surface) => Ok(CollapseTo::Surface),
            (Freedom::Surface, _) => Ok(CollapseTo::Vertex(b)),
            (_, Freedom::Surface) => Ok(CollapseTo::Vertex(a)),
            _ if !self.is_feature(h) => Err(IllegalMove::JoinsFeatures),
            (Freedom::Fixed, Freedom::Fixed) => Err(IllegalMove::BothFixed),
            (Freedom::Curve, Freedom::Curve) => Ok(CollapseTo::Curve),
            (Freedom::Curve, Freedom::Fixed) => Ok(CollapseTo::Vertex(b)),
            (Freedom::Fixed, Freedom::Curve) => Ok(CollapseTo::Vertex(a)),
        }
    }

    /// Whether the edge of `h` may be replaced by the other diagonal of its two faces.
    ///
    /// # Errors
    /// The rule that forbids it.
    pub fn may_flip(&self, h: u32) -> Result<(), IllegalMove> {
        if !self.is_live(h) {
            return Err(IllegalMove::NoSuchEdge);
        }
        if self.is_feature(h) {
            return Err(IllegalMove::Feature);
        }
        let (c, d) = (self.apex(h), self.apex(self.twin(h)));
        if c == d || self.find_edge(c, d).is_some() {
            return Err(IllegalMove::EdgeExists);
        }
        for v in [self.origin(h), self.destination(h)] {
            let least = if self.is_border_vertex(v) { 2 } else { 3 };
            if self.valence(v) <= least {
                return Err(IllegalMove::TooFewEdges);
            }
        }
        Ok(())
    }
}
