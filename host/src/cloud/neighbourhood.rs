//! Neighbourhood queries: which points are nearest, which lie within a radius.
//!
//! A balanced k-d tree over positions, stored as one permutation of the points' indices. Two ways were
//! weighed: the `kiddo` crate (faster by its SIMD leaves, but the order among equally distant points and
//! the last bit of a distance depend on its build) and this plain tree. Results decide which rows enter a
//! linear system, and those have to be the same on every machine; so this one.
//!
//! Promised: exact results, ordered by distance and then by index, for any finite positions, coinciding
//! ones included. Memory is 29 bytes per point beside the positions; recursion is log2 of the point count deep.

use crate::Vec3;
use std::collections::BinaryHeap;

/// Points of a leaf at most: below this, comparing all is cheaper than descending.
const LEAF: usize = 12;
/// Found points up to which a sorted list is quicker than a heap.
const FEW: usize = 24;

/// A k-d tree over fixed positions.
#[derive(Clone, Debug)]
pub struct Neighbourhoods {
    positions: Vec<Vec3>,
    /// Points in the order of the tree: the middle one of each range splits it.
    order: Vec<u32>,
    /// Positions in the same order, so that a leaf lies in one piece of memory.
    in_order: Vec<Vec3>,
    /// Axis along which the point at the same place of `order` splits its range.
    axes: Vec<u8>,
}

/// A found point with its squared distance; ordered by distance, then by index.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Found {
    squared: f64,
    index: u32,
}

impl Eq for Found {}

impl PartialOrd for Found {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Found {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.squared
            .total_cmp(&other.squared)
            .then(self.index.cmp(&other.index))
    }
}

impl Neighbourhoods {
    /// Builds the tree over the given positions; at most `u32::MAX` of them are indexed.
    pub fn new(positions: Vec<Vec3>) -> Self {
        let count = positions.len().min(u32::MAX as usize);
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut axes = vec![0; count];
        arrange(&positions, &mut order, &mut axes);
        let in_order = order.iter().map(|&i| positions[i as usize]).collect();
        Self {
            positions,
            order,
            in_order,
            axes,
        }
    }

    /// The positions the tree was built over.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// The nearest `count` points as (index, squared distance), nearest first; fewer if there are fewer.
    pub fn nearest(&self, query: &Vec3, count: usize) -> Vec<(usize, f64)> {
        self.nearest_few(query, count, f64::INFINITY)
    }

    /// The nearest point as (index, squared distance); `None` without points, or if `query` is not a number.
    pub fn nearest_one(&self, query: &Vec3) -> Option<(usize, f64)> {
        let mut one = One(Found {
            squared: f64::INFINITY,
            index: u32::MAX,
        });
        self.search(query, 0, self.order.len(), &mut one);
        (one.0.index != u32::MAX).then_some((one.0.index as usize, one.0.squared))
    }

    /// All points at most `radius` away as (index, squared distance), nearest first.
    pub fn within(&self, query: &Vec3, radius: f64) -> Vec<(usize, f64)> {
        let mut all = All {
            found: Vec::new(),
            limit: radius * radius,
        };
        if radius >= 0.0 {
            self.search(query, 0, self.order.len(), &mut all);
        }
        all.found.sort_unstable();
        pairs(all.found)
    }

    /// At most `count` points at most `radius` away as (index, squared distance), nearest first.
    pub fn nearest_within(&self, query: &Vec3, count: usize, radius: f64) -> Vec<(usize, f64)> {
        if radius >= 0.0 {
            self.nearest_few(query, count, radius * radius)
        } else {
            Vec::new()
        }
    }

    fn nearest_few(&self, query: &Vec3, count: usize, limit: f64) -> Vec<(usize, f64)> {
        let count = count.min(self.order.len());
        if count == 0 {
            return Vec::new();
        }
        if count <= FEW {
            let found = Vec::with_capacity(count);
            let mut few = Few {
                found,
                count,
                limit,
            };
            self.search(query, 0, self.order.len(), &mut few);
            return pairs(few.found);
        }
        let found = BinaryHeap::with_capacity(count);
        let mut many = Many {
            found,
            count,
            limit,
        };
        self.search(query, 0, self.order.len(), &mut many);
        pairs(many.found.into_sorted_vec())
    }

    /// Shows `keep` the points of a range of the tree that may be near enough.
    fn search(&self, query: &Vec3, begin: usize, end: usize, keep: &mut impl Keep) {
        let found = |place: usize| Found {
            squared: (self.in_order[place] - query).norm_squared(),
            index: self.order[place],
        };
        if end - begin <= LEAF {
            (begin..end).for_each(|place| keep.show(found(place)));
            return;
        }
        let middle = begin + (end - begin) / 2;
        keep.show(found(middle));
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.in_order[middle][axis];
        let (near, far) = if offset < 0.0 {
            ((begin, middle), (middle + 1, end))
        } else {
            ((middle + 1, end), (begin, middle))
        };
        self.search(query, near.0, near.1, keep);
        if offset * offset <= keep.reach() {
            self.search(query, far.0, far.1, keep);
        }
    }
}

/// What a search keeps of the points it comes across.
trait Keep {
    /// Takes the point or leaves it.
    fn show(&mut self, found: Found);
    /// Squared distance beyond which no point would be taken.
    fn reach(&self) -> f64;
}

/// The nearest one.
struct One(Found);

impl Keep for One {
    fn show(&mut self, found: Found) {
        if found < self.0 {
            self.0 = found;
        }
    }

    fn reach(&self) -> f64 {
        self.0.squared
    }
}

/// The nearest few up to a squared distance, nearest first.
struct Few {
    found: Vec<Found>,
    count: usize,
    limit: f64,
}

impl Keep for Few {
    fn show(&mut self, found: Found) {
        if found.squared > self.limit {
            return;
        }
        if self.found.len() == self.count {
            if self.found.last().is_some_and(|worst| found >= *worst) {
                return;
            }
            self.found.pop();
        }
        let place = self.found.iter().rposition(|other| *other < found);
        self.found.insert(place.map_or(0, |p| p + 1), found);
    }

    fn reach(&self) -> f64 {
        match self.found.last() {
            Some(worst) if self.found.len() == self.count => worst.squared.min(self.limit),
            _ => self.limit,
        }
    }
}

/// The same for more than a few: the farthest on top of a heap.
struct Many {
    found: BinaryHeap<Found>,
    count: usize,
    limit: f64,
}

impl Keep for Many {
    fn show(&mut self, found: Found) {
        if found.squared > self.limit {
            return;
        }
        if self.found.len() < self.count {
            self.found.push(found);
        } else if let Some(mut worst) = self.found.peek_mut()
            && found < *worst
        {
            *worst = found;
        }
    }

    fn reach(&self) -> f64 {
        match self.found.peek() {
            Some(worst) if self.found.len() == self.count => worst.squared.min(self.limit),
            _ => self.limit,
        }
    }
}

/// All up to a squared distance.
struct All {
    found: Vec<Found>,
    limit: f64,
}

impl Keep for All {
    fn show(&mut self, found: Found) {
        if found.squared <= self.limit {
            self.found.push(found);
        }
    }

    fn reach(&self) -> f64 {
        self.limit
    }
}

fn pairs(found: Vec<Found>) -> Vec<(usize, f64)> {
    found
        .into_iter()
        .map(|f| (f.index as usize, f.squared))
        .collect()
}

/// Orders a range so that its middle point splits it along the widest axis, and so on in both halves.
fn arrange(positions: &[Vec3], order: &mut [u32], axes: &mut [u8]) {
    if order.len() <= LEAF {
        return;
    }
    let axis = widest(positions, order);
    let middle = order.len() / 2;
    let key = |index: &u32| (positions[*index as usize][axis], *index);
    order.select_nth_unstable_by(middle, |a, b| {
        let ((a, i), (b, j)) = (key(a), key(b));
        a.total_cmp(&b).then(i.cmp(&j))
    });
    axes[middle] = axis as u8;
    let (low, high) = order.split_at_mut(middle);
    let (low_axes, high_axes) = axes.split_at_mut(middle);
    arrange(positions, low, low_axes);
    arrange(positions, &mut high[1..], &mut high_axes[1..]);
}

/// Axis along which the points are spread most.
fn widest(positions: &[Vec3], order: &[u32]) -> usize {
    let start = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    let (low, high) = order.iter().fold(start, |(low, high), &index| {
        let position = &positions[index as usize];
        (low.inf(position), high.sup(position))
    });
    (high - low).imax()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute(positions: &[Vec3], query: &Vec3) -> Vec<(usize, f64)> {
        let mut all: Vec<_> = positions
            .iter()
            .map(|p| (p - query).norm_squared())
            .enumerate()
            .collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        all
    }

    proptest! {
        /// Coordinates on a coarse grid make many points coincide or be equally far.
        #[test]
        fn queries_equal_exhaustive_search(
            grid in prop::collection::vec((0..9i8, 0..9i8, 0..2i8), 0..400),
            at in (0..9i8, 0..9i8, 0..9i8),
            count in 0..60usize,
            radius in 0.0..6.0f64,
        ) {
            let point = |(x, y, z): (i8, i8, i8)| Vec3::new(x.into(), y.into(), z.into());
            let positions: Vec<Vec3> = grid.into_iter().map(point).collect();
            let query = point(at);
            let all = brute(&positions, &query);
            let tree = Neighbourhoods::new(positions);
            let nearest: Vec<_> = all.iter().copied().take(count).collect();
            prop_assert_eq!(tree.nearest(&query, count), nearest);
            let within: Vec<_> =
                all.iter().copied().filter(|f| f.1 <= radius * radius).collect();
            prop_assert_eq!(&tree.within(&query, radius), &within);
            let both: Vec<_> = within.into_iter().take(count).collect();
            prop_assert_eq!(tree.nearest_within(&query, count, radius), both);
        }
    }

    #[test]
    fn degenerate_input_is_harmless() {
        assert_eq!(
            Neighbourhoods::new(vec![]).nearest_one(&Vec3::zeros()),
            None
        );
        let tree = Neighbourhoods::new(vec![Vec3::repeat(1.0); 5000]);
        assert_eq!(tree.nearest(&Vec3::zeros(), 2), [(0, 3.0), (1, 3.0)]);
        assert!(tree.within(&Vec3::zeros(), -1.0).is_empty());
        tree.nearest(&Vec3::repeat(f64::NAN), 3);
        Neighbourhoods::new(vec![Vec3::repeat(f64::NAN); 50]).nearest(&Vec3::zeros(), 3);
    }
}
