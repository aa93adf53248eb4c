//! Joins the points that a sampled surface keeps once per side of a crease.

use crate::Vec3;
use crate::spline::SampledSurface;
use std::collections::HashMap;

/// Points without doubles.
#[derive(Clone, Debug, Default)]
pub(super) struct Welded {
    /// Distinct positions in the order of their first use.
    pub positions: Vec<Vec3>,
    /// Per distinct position the first point that has it.
    pub first: Vec<u32>,
    /// Per point of the sampled surface the number of its distinct position.
    pub of_point: Vec<u32>,
}

impl Welded {
    /// Joins points whose coordinates agree to the last bit (after -0 is made 0) in the precision of `key`.
    pub fn new<K: std::hash::Hash + Eq>(
        sampled: &SampledSurface,
        key: impl Fn(&Vec3) -> [K; 3],
    ) -> Self {
        let mut seen: HashMap<[K; 3], u32> = HashMap::with_capacity(sampled.positions.len());
        let mut welded = Self::default();
        for (number, position) in sampled.positions.iter().enumerate() {
            let next = welded.positions.len() as u32;
            let slot = *seen.entry(key(position)).or_insert(next);
            if slot == next {
                welded.positions.push(*position);
                welded.first.push(number as u32);
            }
            welded.of_point.push(slot);
        }
        welded
    }

    /// Joins points that agree as `f64`.
    pub fn exact(sampled: &SampledSurface) -> Self {
        Self::new(sampled, |p| [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits()))
    }

    /// Joins points that agree as `f32`.
    pub fn single(sampled: &SampledSurface) -> Self {
        Self::new(sampled, |p| {
            [p.x, p.y, p.z].map(|c| (c as f32 + 0.0).to_bits())
        })
    }

    /// The triangles over distinct positions, without those that have become an edge or a point.
    pub fn triangles<'a>(
        &'a self,
        sampled: &'a SampledSurface,
    ) -> impl Iterator<Item = [u32; 3]> + 'a {
        sampled
            .triangles
            .iter()
            .filter_map(|t| {
                let mut corners = [0; 3];
                for (corner, point) in corners.iter_mut().zip(t) {
                    *corner = *self.of_point.get(*point as usize)?;
                }
                Some(corners)
            })
            .filter(|[a, b, c]| a != b && b != c && c != a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubles_are_joined_and_collapsed_triangles_left_out() {
        let sampled = SampledSurface {
            positions: vec![
                Vec3::zeros(),
                Vec3::x(),
                Vec3::y(),
                Vec3::new(-0.0, 0.0, -0.0),
                Vec3::new(1.0 + 1e-12, 0.0, 0.0),
            ],
            triangles: vec![[0, 1, 2], [3, 1, 2], [3, 4, 1], [0, 1, 9]],
            ..SampledSurface::default()
        };
        let exact = Welded::exact(&sampled);
        assert_eq!(exact.positions.len(), 4);
        assert_eq!(exact.of_point, [0, 1, 2, 0, 3]);
        let triangles: Vec<_> = exact.triangles(&sampled).collect();
        assert_eq!(triangles, [[0, 1, 2], [0, 1, 2], [0, 3, 1]]);
        assert_eq!(Welded::single(&sampled).triangles(&sampled).count(), 2);
    }
}
