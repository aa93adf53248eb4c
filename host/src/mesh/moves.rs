//! The three moves of mesh optimization (Hoppe et al. 1993, section 4.1): edge collapse, split and flip
//! (there: swap). Each keeps a manifold a manifold of the same topology or is refused; each takes time
//! proportional to the valences involved. Crease tags travel with the edges.

use super::half_edge::{HalfEdgeMesh, NONE};
use super::legal::{CollapseTo, IllegalMove};
use crate::Vec3;

impl HalfEdgeMesh {
    /// Collapses the edge of `h` to a vertex at `position` and returns that vertex: the destination
    /// of `h`, which keeps its index, while the origin and one or two faces vanish. Where the rules
    /// leave no freedom ([`CollapseTo::Vertex`]) `position` is not used.
    ///
    /// # Errors
    /// The rule that forbids it; the mesh is then unchanged.
    pub fn collapse(&mut self, h: u32, position: Vec3) -> Result<u32, IllegalMove> {
        let to = self.may_collapse(h)?;
        let (a, b) = (self.origin(h), self.destination(h));
        let position = match to {
            CollapseTo::Vertex(v) => self.position(v),
            _ => position,
        };
        if !position.iter().all(|x| x.is_finite()) {
            return Err(IllegalMove::NotFinite);
        }
        let twin = self.twin(h);
        let gone = [
            Self::face_of(h),
            if twin == NONE {
                NONE
            } else {
                Self::face_of(twin)
            },
        ];
        let stay = |g: &u32| !gone.contains(&Self::face_of(*g));
        let from_a: Vec<u32> = self.around(a).filter(stay).collect();
        let from_b: Vec<u32> = self.around(b).filter(stay).collect();
        for &g in &from_a {
            self.origin[g as usize] = b;
        }
        for side in [h, twin] {
            if side == NONE {
                continue;
            }
            let apex = self.apex(side);
            let (one, other) = (Self::next(side), Self::prev(side));
            let (x, y) = (self.twin(one), self.twin(other));
            let crease = self.crease[one as usize] || self.crease[other as usize];
            for (g, partner) in [(x, y), (y, x)] {
                if g != NONE {
                    self.twin[g as usize] = partner;
                    self.crease[g as usize] = crease;
                }
            }
            // `other` left the apex; were it the stored one at a border, it had no twin, and `x` has none now.
            if self.outgoing[apex as usize] == other {
                self.outgoing[apex as usize] = x;
            }
        }
        for f in gone {
            if f != NONE {
                for k in 0..3 {
                    self.origin[(3 * f + k) as usize] = NONE;
                    self.twin[(3 * f + k) as usize] = NONE;
                    self.crease[(3 * f + k) as usize] = false;
                }
                self.live_faces -= 1;
            }
        }
        self.outgoing[a as usize] = NONE;
        self.live_vertices -= 1;
        self.pinned[b as usize] |= self.pinned[a as usize];
        self.pinned[a as usize] = false;
        self.positions[b as usize] = position;
        let stays = from_a.iter().chain(&from_b);
        let border = stays.clone().find(|g| self.twin[**g as usize] == NONE);
        if let Some(&start) = border.or_else(|| stays.clone().min()) {
            self.outgoing[b as usize] = start;
        }
        Ok(b)
    }

    /// Splits the edge of `h` at `position` and returns the new vertex. One or two faces are added;
    /// `h` then leads from its old origin to the new vertex, and both halves keep the crease tag.
    ///
    /// # Errors
    /// [`IllegalMove::NoSuchEdge`] or [`IllegalMove::NotFinite`]; the mesh is then unchanged.
    pub fn split(&mut self, h: u32, position: Vec3) -> Result<u32, IllegalMove> {
        if !self.is_live(h) {
            return Err(IllegalMove::NoSuchEdge);
        }
        if !position.iter().all(|x| x.is_finite()) {
            return Err(IllegalMove::NotFinite);
        }
        let twin = self.twin(h);
        let crease = self.crease[h as usize];
        let m = self.positions.len() as u32;
        self.positions.push(position);
        self.pinned.push(false);
        self.outgoing.push(NONE);
        self.live_vertices += 1;
        let near = self.split_side(h, m, crease);
        if twin == NONE {
            self.twin[near as usize] = NONE;
            self.twin[h as usize] = NONE;
        } else {
            let far = self.split_side(twin, m, crease);
            self.link(h, far);
            self.link(twin, near);
        }
        self.outgoing[m as usize] = near;
        Ok(m)
    }

    /// Cuts the face of `h` from `m`, a point of that edge, to its apex. `h` keeps the near half;
    /// returns the half-edge from `m` to the old destination, whose twin is left to the caller.
    fn split_side(&mut self, h: u32, m: u32, crease: bool) -> u32 {
        let (one, b, c) = (Self::next(h), self.destination(h), self.apex(h));
        let new = self.origin.len() as u32;
        self.origin.extend([m, b, c]);
        self.twin.extend([NONE; 3]);
        self.crease
            .extend([crease, self.crease[one as usize], false]);
        self.live_faces += 1;
        self.move_to(one, new + 1);
        self.origin[one as usize] = m;
        self.crease[one as usize] = false;
        self.link(one, new + 2);
        if self.outgoing[b as usize] == one {
            self.outgoing[b as usize] = new + 1;
        }
        new
    }

    /// Replaces the edge of `h` by the other diagonal of its two faces. `h` then leads from the far
    /// apex to the near one.
    ///
    /// # Errors
    /// The rule that forbids it; the mesh is then unchanged.
    pub fn flip(&mut self, h: u32) -> Result<(), IllegalMove> {
        self.may_flip(h)?;
        let t = self.twin(h);
        let (a, b, c, d) = (
            self.origin(h),
            self.destination(h),
            self.apex(h),
            self.apex(t),
        );
        let (h1, h2, t1, t2) = (Self::next(h), Self::prev(h), Self::next(t), Self::prev(t));
        let old: [(u32, bool); 4] =
            [h1, h2, t1, t2].map(|g| (self.twin(g), self.crease[g as usize]));
        // From slot, to slot, new origin of that slot.
        let moves = [(h1, t2, b), (h2, h1, c), (t1, h2, a), (t2, t1, d)];
        let ends = [a, b, c, d].map(|v| self.outgoing[v as usize]);
        for (k, (_, to, origin)) in moves.into_iter().enumerate() {
            let (partner, crease) = old[k];
            self.origin[to as usize] = origin;
            self.crease[to as usize] = crease;
            self.twin[to as usize] = partner;
            if partner != NONE {
                self.twin[partner as usize] = to;
            }
        }
        self.origin[h as usize] = d;
        self.origin[t as usize] = c;
        for (v, out) in [a, b, c, d].into_iter().zip(ends) {
            let place = if out == h {
                h2
            } else if out == t {
                t2
            } else {
                moves.iter().find(|m| m.0 == out).map_or(out, |m| m.1)
            };
            self.outgoing[v as usize] = place;
        }
        Ok(())
    }

    fn link(&mut self, g: u32, h: u32) {
        self.twin[g as usize] = h;
        self.twin[h as usize] = g;
    }

    /// Gives the twin of `from` to `to`.
    fn move_to(&mut self, from: u32, to: u32) {
        let partner = self.twin[from as usize];
        self.twin[to as usize] = partner;
        if partner != NONE {
            self.twin[partner as usize] = to;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::legal::Freedom;
    use crate::mesh::{TriangleMesh, shapes, topology};
    use proptest::prelude::*;

    fn half(mesh: &TriangleMesh) -> HalfEdgeMesh {
        HalfEdgeMesh::new(mesh).unwrap()
    }

    fn middle(m: &HalfEdgeMesh, h: u32) -> Vec3 {
        (m.position(m.origin(h)) + m.position(m.destination(h))) * 0.5
    }

    fn first_legal(m: &HalfEdgeMesh) -> Option<u32> {
        m.edges().find(|&h| m.may_collapse(h).is_ok())
    }

    #[test]
    fn a_tetrahedron_has_no_legal_collapse_or_flip() {
        let mut m = half(&TriangleMesh {
            positions: vec![Vec3::zeros(), Vec3::x(), Vec3::y(), Vec3::z()],
            faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        });
        for h in m.edges().collect::<Vec<_>>() {
            assert_eq!(m.may_collapse(h), Err(IllegalMove::LinkCondition));
            assert_eq!(m.may_flip(h), Err(IllegalMove::EdgeExists));
        }
        assert_eq!(m.split(999, Vec3::zeros()), Err(IllegalMove::NoSuchEdge));
        assert_eq!(
            m.split(0, Vec3::repeat(f64::NAN)),
            Err(IllegalMove::NotFinite)
        );
    }

    #[test]
    fn the_link_condition_protects_a_waist_of_three_edges() {
        // A torus three vertices around has loops of three edges that bound no face.
        let m = half(&shapes::torus(1.0, 0.3, 3, 5));
        let waist = m
            .edges()
            .filter(|&h| m.may_collapse(h) == Err(IllegalMove::LinkCondition));
        assert!(waist.count() >= 15);
    }

    #[test]
    fn a_border_is_not_pinched_and_not_flipped() {
        let m = half(&shapes::grid(1, 3));
        let across = m.find_edge(1, 5).unwrap();
        assert_eq!(m.may_collapse(across), Err(IllegalMove::PinchesBorder));
        let rim = m.find_edge(1, 2).unwrap();
        assert_eq!(m.may_flip(rim), Err(IllegalMove::Feature));
        assert_eq!(m.may_collapse(rim), Ok(CollapseTo::Curve));
    }

    #[test]
    fn an_open_strip_collapses_to_one_face_and_no_further() {
        let mut m = half(&shapes::grid(2, 3));
        while let Some(h) = first_legal(&m) {
            m.collapse(h, middle(&m, h)).unwrap();
            m.sanity_check().unwrap();
            assert_eq!(topology(&m.compact().mesh).euler, 1);
        }
        assert_eq!(m.face_count(), 1);
    }

    #[test]
    fn creases_hold_their_vertices() {
        let mut m = half(&shapes::grid(4, 4));
        // A crease along the middle row: vertices 10..=14 (i = 2), ending on the border at both sides.
        for j in 0..4 {
            let h = m.find_edge(10 + j, 11 + j).unwrap();
            m.set_crease(h, true);
        }
        assert_eq!(m.freedom(12), Freedom::Curve);
        assert_eq!(m.freedom(10), Freedom::Fixed); // crease meets border
        assert_eq!(m.freedom(6), Freedom::Surface);
        let along = m.find_edge(11, 12).unwrap();
        assert_eq!(m.may_flip(along), Err(IllegalMove::Feature));
        let onto = m.find(6, 11).or_else(|| m.find(6, 12)).unwrap();
        assert_eq!(
            m.may_collapse(onto),
            Ok(CollapseTo::Vertex(m.destination(onto)))
        );
        let row: Vec<Vec3> = (10..15).map(|v| m.position(v)).collect();
        while let Some(h) = first_legal(&m) {
            m.collapse(h, middle(&m, h)).unwrap();
            m.sanity_check().unwrap();
        }
        let left = m.compact();
        assert!(!left.creases.is_empty());
        for end in [row[0], row[4]] {
            assert!(left.mesh.positions.contains(&end), "crease end moved");
        }
        for e in &left.creases {
            for v in e {
                assert!((left.mesh.positions[*v as usize].x - 0.5).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn pinned_vertices_stay() {
        let mut m = half(&shapes::icosphere(1));
        m.set_pinned(5, true);
        let p = m.position(5);
        while let Some(h) = first_legal(&m) {
            m.collapse(h, middle(&m, h)).unwrap();
        }
        assert!(m.vertices().any(|v| m.position(v) == p && m.is_pinned(v)));
        assert_eq!(m.face_count(), 4);
    }

    #[test]
    fn flipping_twice_gives_the_same_faces() {
        let mut m = half(&shapes::icosphere(1));
        let before = sorted_faces(&m);
        let h = m.edges().nth(17).unwrap();
        m.flip(h).unwrap();
        m.sanity_check().unwrap();
        assert_ne!(sorted_faces(&m), before);
        m.flip(h).unwrap();
        assert_eq!(sorted_faces(&m), before);
    }

    fn sorted_faces(m: &HalfEdgeMesh) -> Vec<[u32; 3]> {
        let mut out: Vec<[u32; 3]> = m
            .faces()
            .map(|f| {
                let mut ids = m.face_vertices(f);
                let least = (0..3).min_by_key(|k| ids[*k]).unwrap();
                ids.rotate_left(least);
                ids
            })
            .collect();
        out.sort_unstable();
        out
    }

    fn start(which: u8) -> HalfEdgeMesh {
        let mut m = match which {
            0 => half(&shapes::icosphere(1)),
            1 => half(&shapes::torus(1.0, 0.3, 6, 5)),
            2 => half(&shapes::grid(4, 3)),
            3 => half(&shapes::open_cylinder(1.0, 1.0, 5, 3)),
            _ => half(&shapes::cube(2)),
        };
        if which >= 4 {
            // The cube's twelve edges.
            for h in m.edges().collect::<Vec<_>>() {
                let (p, q) = (m.position(m.origin(h)), m.position(m.destination(h)));
                if (0..3)
                    .filter(|&k| p[k] == q[k] && p[k].abs() == 1.0)
                    .count()
                    == 2
                {
                    m.set_crease(h, true);
                }
            }
        }
        m
    }

    proptest! {
        #[test]
        fn random_moves_keep_topology_and_orientation(
            which in 0u8..5,
            steps in prop::collection::vec((0u8..3, any::<prop::sample::Index>()), 1..120),
        ) {
            let mut m = start(which);
            let before = topology(&m.compact().mesh);
            let creases = !m.compact().creases.is_empty();
            for (kind, pick) in steps {
                let edges: Vec<u32> = m.edges().collect();
                let h = edges[pick.index(edges.len())];
                let (faces, vertices) = (m.face_count(), m.vertex_count());
                let border = m.is_border(h);
                let result = match kind {
                    0 => m.collapse(h, middle(&m, h)).map(|_| (-1, if border { -1 } else { -2 })),
                    1 => m.split(h, middle(&m, h)).map(|_| (1, if border { 1 } else { 2 })),
                    _ => m.flip(h).map(|()| (0, 0)),
                };
                m.sanity_check().map_err(TestCaseError::fail)?;
                let (dv, df) = result.unwrap_or((0, 0));
                prop_assert_eq!(m.vertex_count() as i64, vertices as i64 + dv);
                prop_assert_eq!(m.face_count() as i64, faces as i64 + df);
            }
            let after = topology(&m.compact().mesh);
            prop_assert!(after.is_manifold());
            prop_assert_eq!(after.euler, before.euler);
            prop_assert_eq!(after.border_loops, before.border_loops);
            prop_assert_eq!(after.components, before.components);
            if creases {
                // The cube's corners are still there and still corners.
                let corners = m.vertices().filter(|&v| m.features_at(v).count() == 3).count();
                prop_assert_eq!(corners, 8);
                prop_assert!(m.vertices().all(|v| [0, 2, 3].contains(&m.features_at(v).count())));
            }
        }
    }
}
