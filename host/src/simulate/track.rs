//! A slide as a function of how far it has gone.

use super::object::Object;
use super::touch::{Placement, place};

/// Share of the centre's way that counts as progress while the contact point hardly moves: rolling the tip
/// over a sharp edge takes a 20 mm tip 31 mm of way and no way of the contact. At 0.2 a turn
/// over a right-angled edge counts as 6 mm; at 1 a cube's edges would get more contacts than its faces.
const ROLLING: f64 = 0.2;

/// A slide, parametrised by the way of the contact point over the surface.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    placements: Vec<Placement>,
    /// Progress at each placement, millimetres, from 0.
    progress_mm: Vec<f64>,
}

impl Track {
    /// A track through the placements, in their order.
    pub(crate) fn new(placements: Vec<Placement>) -> Self {
        let mut progress_mm = Vec::with_capacity(placements.len());
        let mut sum = 0.0;
        for (k, placement) in placements.iter().enumerate() {
            if k > 0 {
                let last = &placements[k - 1];
                let contact = (placement.foot.position_mm - last.foot.position_mm).norm();
                let centre = (placement.centre_mm - last.centre_mm).norm();
                sum += contact.max(ROLLING * centre);
            }
            progress_mm.push(sum);
        }
        Self {
            placements,
            progress_mm,
        }
    }

    /// Progress at the end, millimetres.
    pub(crate) fn length_mm(&self) -> f64 {
        self.progress_mm.last().copied().unwrap_or(0.0)
    }

    /// The placement at some progress (clamped to the track), exactly on the surface; `None` for an empty
    /// track.
    pub(crate) fn at(
        &self,
        object: &Object,
        progress_mm: f64,
        distance_mm: f64,
    ) -> Option<Placement> {
        let next = self.progress_mm.partition_point(|&p| p < progress_mm);
        if next == 0 || next >= self.placements.len() {
            return self
                .placements
                .get(next)
                .or(self.placements.last())
                .copied();
        }
        let (from, to) = (self.progress_mm[next - 1], self.progress_mm[next]);
        let share = (progress_mm - from) / (to - from);
        let (a, b) = (&self.placements[next - 1], &self.placements[next]);
        let between = a.centre_mm.lerp(&b.centre_mm, share);
        Some(place(object, &between, distance_mm).unwrap_or(*a))
    }
}
