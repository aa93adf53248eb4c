//! A field with creases: each smooth sheet of contacts has a field of its own, and the solid is what they bound together.
//!
//! One field over a crease has to bend there as no smooth function can; between the tracks it swings out, and corners
//! that no contact comes near to tear open. Once it is known which contacts form a smooth sheet and which sheets break
//! with one another, every sheet is fitted from its own contacts alone and carried on past its end; where two sheets meet
//! in an outer edge the solid lies behind both (the larger value counts), in an inner edge behind either (the smaller).
//!
//! Which sheet bounds the solid at a place is a contest of the sheets near by: one loses to another that ends it there, unless
//! that one was itself ended by a third (the plane of a notch's floor runs on through the block beside it), or the sheet's own
//! contacts at the place lie beyond it (a plate's top goes on behind the block on it). A formula of unions and
//! intersections for the whole was weighed, too; it would need to know the solid beforehand.
//!
//! A sheet that is one plane or quadric (a cylinder's side, a ball) is taken as that: whether it is, its local fits tell. On
//! noisy cubes and cylinders their edges then are half as far off (0.6 to 0.8 instead of 1.0 to 1.6, in 1e-3 of the diagonal).
//! Local fits with more contacts were weighed, too: they cost with the second power and never go as far.
//!
//! Two ways were weighed: to keep one field and give it kernels that may bend (it then follows the noise too), and this
//! one, the sharp features of multi-level partitions of unity (Ohtake et al. 2003) with sheets that were found beforehand.

use super::{
    Fits,
    contacts::Normalised,
    field::{Ball, BlendedField},
    kernel::Kernel,
    options::ExtractError,
    sides::Sides,
    smoothing,
    smoothing::Levels,
};
use crate::{
    Vec3,
    cloud::Neighbourhoods,
    reconstruct::quadric::{Place, Quadric, QuadricFit},
};

/// A sheet has a say at a place if its nearest contact is not this many times farther than the nearest of all, and this
/// many contact spacings: a bent one, which swings where it is carried on, and a flat one.
const SAY_RATIO: f64 = 2.0;
const SAY_SPACINGS: f64 = 8.0;
const SAY_SPACINGS_FLAT: f64 = 14.0;
/// Contacts within so many spacings of the other sheet tell whether two sheets form an outer or an inner edge.
const EDGE_SPACINGS: f64 = 5.0;
/// Mean angle between neighbouring normals of two sheets from which they form an edge, radians (30 degrees).
const EDGE_TURN: f64 = 0.52;
/// A contact lies beyond a sheet if it is more than so many spacings and standard deviations on the side on which its own
/// sheet would have ended.
const BEYOND_SPACINGS: f64 = 0.5;
const BEYOND_DEVIATIONS: f64 = 3.0;
/// Share of a sheet's contacts that may lie on the other side of a sheet whose edge with it no contact shows; with more, the
/// two cross without ending one another.
const BEYOND_MOST: f64 = 0.2;
/// Kernel of a sheet: quadratic polynomials are carried on past the end of a bent sheet without swinging, planes past
/// that of a flat one.
const BENT: Kernel = Kernel::Quintic;
const FLAT: Kernel = Kernel::Cubic;
/// Standard deviations, and radians, within which the normals of a flat sheet lie around their mean, and the share of its
/// contacts that may lean out of it: touches of its very edge, which would bend it where it is carried on (a cylinder's
/// lid with 3 of 100: 91 contacts of the rim beyond the tolerance).
const FLAT_DEVIATIONS: f64 = 4.0;
const FLAT_ANGLE: f64 = 0.01;
const LEANING_MOST: f64 = 0.05;
/// One plane or quadric stands for the whole sheet if the local fits differ from it by no more than their own errors: mean and
/// largest squared difference at their centres, in variances of theirs. At 2 in the mean what it errs by is what it saves.
const WHOLE_MEAN: f64 = 2.0;
const WHOLE_MOST: f64 = 12.0;
/// Standard deviations, relative to the size and in radians, below which a plane or quadric is as good as exact: normals of
/// the facets of a cylinder with 720 of them are off by 2.5e-3.
const EXACT_POSITION: f64 = 2e-5;
const EXACT_NORMAL: f64 = 4e-3;
/// Contacts from which a plane and a quadric are sought.
const PLANE_CONTACTS: usize = 8;
const QUADRIC_CONTACTS: usize = 20;

/// How two sheets meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Edge {
    /// They do not meet, or go on into one another.
    None,
    /// The solid lies behind both.
    Outer,
    /// The solid lies behind either.
    Inner,
}

/// One sheet's field and contacts, in normalised coordinates.
#[derive(Clone, Debug)]
struct Sheet {
    field: Carried,
    contacts: Neighbourhoods,
    normals: Vec<Vec3>,
    flat: bool,
    /// Which contact lies beyond which sheet that it breaks with, at contact * sheets + other: where that sheet's surface, carried
    /// on, cuts through this one, it is not the one that ends it.
    beyond: Vec<bool>,
}

/// What carries a sheet on past its contacts.
#[derive(Clone, Debug)]
enum Carried {
    /// Local fits.
    Blended(BlendedField),
    /// The one plane or quadric that the sheet is.
    Whole(Box<QuadricFit>),
}

impl Carried {
    fn value(&self, x: &Vec3) -> f64 {
        match self {
            Self::Blended(field) => field.value(x),
            Self::Whole(fit) => fit.quadric.value(x),
        }
    }

    fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        match self {
            Self::Blended(field) => field.value_and_gradient(x),
            Self::Whole(fit) => (fit.quadric.value(x), fit.quadric.gradient(x)),
        }
    }

    fn sigma(&self, x: &Vec3) -> Option<f64> {
        match self {
            Self::Blended(field) => field.sigma(x),
            Self::Whole(fit) => Some(fit.sigma(x)),
        }
    }

    /// Number of fits and their bytes.
    fn size(&self) -> (usize, usize) {
        match self {
            Self::Blended(field) => (field.len(), field.bytes()),
            Self::Whole(_) => (1, size_of::<QuadricFit>()),
        }
    }
}

/// The fields of all sheets and how they meet.
#[derive(Clone, Debug)]
pub(super) struct SheetField {
    sheets: Vec<Sheet>,
    /// The label of each.
    names: Vec<u32>,
    /// How sheets i and j meet, at i * sheets + j.
    edges: Vec<Edge>,
    spacing: f64,
    /// Distance from a sheet up to which it is not sure on which side of it a contact lies.
    tolerance: f64,
}

impl SheetField {
    /// Fits every sheet. `labels` tells the sheet of each contact (a number that names none leaves the contact out),
    /// `sharp` which of them break with one another.
    ///
    /// # Errors
    /// When a sheet cannot be fitted.
    pub(super) fn new(
        data: &Normalised,
        labels: &[u32],
        sharp: &[[u32; 2]],
        levels: &Levels,
        neighbours: usize,
        spacing: f64,
    ) -> Result<Self, ExtractError> {
        let mut names: Vec<u32> = labels.to_vec();
        names.retain(|l| *l != crate::mesh::NONE);
        names.sort_unstable();
        names.dedup();
        let mut sheets = Vec::with_capacity(names.len());
        for name in &names {
            let others: Vec<bool> = labels.iter().map(|l| l != name).collect();
            let mut own = data.without(&others);
            let mut kernel = BENT;
            if let Some(leaning) = leaning(&own.normals, levels) {
                own = own.without(&leaning);
                kernel = FLAT;
            }
            let tree = Neighbourhoods::new(own.positions.clone());
            let count = neighbours.min(own.positions.len());
            let covers = smoothing::cover(&own.positions, &tree, count, super::COVERED);
            let levels = smoothing::with_smoothness(kernel, &own, &covers, levels);
            let places = places(&own, &levels.at_least(EXACT_POSITION, EXACT_NORMAL));
            let fits = Fits::new(kernel, own, tree, covers, Vec::new(), &levels);
            let field = match whole(&places, &fits) {
                Some(fit) => Carried::Whole(Box::new(fit)),
                None => Carried::Blended(fits.blend()?),
            };
            sheets.push(Sheet {
                field,
                contacts: fits.tree,
                normals: fits.data.normals,
                flat: kernel == FLAT,
                beyond: Vec::new(),
            });
        }
        let mut out = Self {
            edges: vec![Edge::None; sheets.len() * sheets.len()],
            sheets,
            names,
            spacing,
            tolerance: BEYOND_SPACINGS * spacing + BEYOND_DEVIATIONS * levels.position_sigma,
        };
        let count = out.sheets.len();
        for i in 0..count {
            for j in 0..i {
                let broken = sharp.contains(&[out.names[j], out.names[i]]);
                let edge = out.meeting(i, j, broken);
                out.edges[i * count + j] = edge;
                out.edges[j * count + i] = edge;
            }
        }
        for i in 0..count {
            out.sheets[i].beyond = out.beyond(i);
        }
        Ok(out)
    }

    /// [`Sheet::beyond`] of sheet `i`.
    fn beyond(&self, i: usize) -> Vec<bool> {
        let edges = &self.edges[i * self.sheets.len()..(i + 1) * self.sheets.len()];
        let mut out = Vec::with_capacity(edges.len() * self.sheets[i].normals.len());
        for p in self.sheets[i].contacts.positions() {
            out.extend(
                edges
                    .iter()
                    .zip(&self.sheets)
                    .map(|(edge, other)| match edge {
                        Edge::None => false,
                        Edge::Outer => other.field.value(p) > self.tolerance,
                        Edge::Inner => other.field.value(p) < -self.tolerance,
                    }),
            );
        }
        out
    }

    /// How sheets `i` and `j` meet: whether the contacts of each near the other lie behind it. Sheets that are not known
    /// to be `broken` meet in an edge all the same if one turns away from the other's contacts by more than
    /// [`EDGE_TURN`]: small pieces of a sheet show too little of their edge to be sure of it.
    fn meeting(&self, i: usize, j: usize, broken: bool) -> Edge {
        match self.meeting_within(EDGE_SPACINGS * self.spacing, [i, j], broken) {
            // A gap hides their edge, if they have one: all their contacts tell.
            None if broken => self.meeting_within(f64::INFINITY, [i, j], broken),
            edge => edge,
        }
        .unwrap_or(Edge::None)
    }

    /// The same, from the contacts within `reach` of the other sheet; `None` without any.
    fn meeting_within(&self, reach: f64, [i, j]: [usize; 2], broken: bool) -> Option<Edge> {
        let (mut behind, mut turn, mut count) = (0.0, 0.0, 0.0);
        // How many contacts of each lie behind and before the other.
        let mut sides = [[0_usize; 2]; 2];
        for (direction, (of, against)) in [(i, j), (j, i)].into_iter().enumerate() {
            let (of, against) = (&self.sheets[of], &self.sheets[against]);
            for (p, n) in of.contacts.positions().iter().zip(&of.normals) {
                let Some((k, d2)) = against.contacts.nearest_one(p) else {
                    continue;
                };
                let height = against.field.value(p);
                if d2 < reach * reach && height.is_finite() {
                    behind += height;
                    turn += n.angle(&against.normals[k]);
                    count += 1.0;
                    if height.abs() > self.tolerance {
                        sides[direction][usize::from(height > 0.0)] += 1;
                    }
                }
            }
        }
        if count == 0.0 {
            return None;
        }
        // Far from one another they may as well cross without ending one another.
        let crossing = reach.is_infinite()
            && sides.iter().any(|[behind, before]| {
                *behind.min(before) as f64 > BEYOND_MOST * (behind + before) as f64
            });
        Some(if crossing || !broken && turn < EDGE_TURN * count {
            Edge::None
        } else if behind < 0.0 {
            Edge::Outer
        } else {
            Edge::Inner
        })
    }

    /// The sheet that bounds the solid nearest to `x`, by its number, and its `value` there; `None` without sheets.
    fn leading(&self, x: &Vec3, value: impl Fn(&Sheet) -> f64) -> Option<(usize, f64)> {
        // The nearest contact of each sheet and its distance.
        let near: Vec<(usize, f64)> = self
            .sheets
            .iter()
            .map(|s| {
                s.contacts
                    .nearest_one(x)
                    .map_or((0, f64::INFINITY), |(c, d2)| (c, d2.sqrt()))
            })
            .collect();
        let least = near.iter().map(|n| n.1).fold(f64::INFINITY, f64::min);
        let limit = |flat: bool| {
            let spacings = if flat {
                SAY_SPACINGS_FLAT
            } else {
                SAY_SPACINGS
            };
            SAY_RATIO * least + spacings * self.spacing
        };
        let heard: Vec<(usize, f64)> = (0..self.sheets.len())
            .filter(|&i| near[i].1 <= limit(self.sheets[i].flat))
            .map(|i| (i, value(&self.sheets[i])))
            .filter(|(_, f)| f.is_finite())
            .collect();
        let count = self.sheets.len();
        // The sheets that may end sheet i here, and how.
        let ends = |i: usize| {
            let beyond = &self.sheets[i].beyond[near[i].0 * count..];
            let heard = heard.iter().enumerate();
            heard.filter_map(move |(n, (k, h))| match self.edges[i * count + k] {
                Edge::None => None,
                edge => (!beyond[*k]).then_some((n, edge, *h)),
            })
        };
        // What a sheet says together with those that end it in inner edges, and in outer ones: a sheet has not won where
        // another has ended it before.
        let ended = |&(i, f): &(usize, f64)| {
            ends(i).fold([f, f], |[low, high], (_, edge, h)| match edge {
                Edge::Outer => [low, high.max(h)],
                _ => [low.min(h), high],
            })
        };
        let bounds: Vec<[f64; 2]> = heard.iter().map(ended).collect();
        let losses = |&(i, f): &(usize, f64)| {
            let lost = ends(i).filter(|&(n, edge, _)| match edge {
                Edge::Outer => bounds[n][0] > f,
                _ => bounds[n][1] < f,
            });
            (i, lost.count(), f)
        };
        // The sheet that prevails against most of those that end it; of equals the nearest.
        let (best, _, value) = heard
            .iter()
            .map(losses)
            .min_by(|(i, lost, _), (j, other, _)| {
                lost.cmp(other)
                    .then(near[*i].1.total_cmp(&near[*j].1))
                    .then(i.cmp(j))
            })?;
        Some((best, value))
    }

    /// The same by the sheets' fields as they are.
    fn leading_field(&self, x: &Vec3) -> Option<(usize, f64)> {
        self.leading(x, |s| s.field.value(x))
    }

    /// The labels of the sheets that meet in an edge, in pairs, the lower one first.
    pub(super) fn sharp(&self) -> Vec<[u32; 2]> {
        let count = self.sheets.len();
        (0..count)
            .flat_map(|i| (0..i).map(move |j| (j, i)))
            .filter(|(j, i)| self.edges[i * count + j] != Edge::None)
            .map(|(j, i)| [self.names[j], self.names[i]])
            .collect()
    }

    /// Value at `x`; NaN where nothing speaks.
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        self.leading_field(x).map_or(f64::NAN, |(_, value)| value)
    }

    /// The same, with the sign from each sheet's own contacts where these leave no doubt.
    pub(super) fn settled(&self, x: &Vec3) -> f64 {
        self.leading_settled(x).map_or(f64::NAN, |(_, value)| value)
    }

    /// The label of the sheet that bounds the solid nearest to `x`, told in the same way.
    pub(super) fn label(&self, x: &Vec3) -> Option<u32> {
        self.leading_settled(x).map(|(i, _)| self.names[i])
    }

    fn leading_settled(&self, x: &Vec3) -> Option<(usize, f64)> {
        self.leading(x, |sheet| {
            let sides = Sides {
                normals: &sheet.normals,
                tree: &sheet.contacts,
                spacing: self.spacing,
            };
            sides.settle(x, sheet.field.value(x))
        })
    }

    /// Value and gradient at `x`; NaN where nothing speaks.
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        self.leading_field(x).map_or_else(
            || (f64::NAN, Vec3::repeat(f64::NAN)),
            |(i, _)| self.sheets[i].field.value_and_gradient(x),
        )
    }

    /// Whether the sheet that bounds the solid nearest to `x` is flat.
    pub(super) fn is_flat(&self, x: &Vec3) -> bool {
        self.leading_field(x)
            .is_some_and(|(i, _)| self.sheets[i].flat)
    }

    /// Standard deviation of the leading sheet's fits.
    pub(super) fn sigma(&self, x: &Vec3) -> Option<f64> {
        self.sheets[self.leading_field(x)?.0].field.sigma(x)
    }

    /// The plane or quadric that stands for the whole sheet of this label, if one does.
    pub(super) fn whole(&self, label: u32) -> Option<&Quadric> {
        let sheet = self.names.binary_search(&label).ok()?;
        match &self.sheets[sheet].field {
            Carried::Whole(fit) => Some(&fit.quadric),
            Carried::Blended(_) => None,
        }
    }

    /// Number of local fits.
    pub(super) fn len(&self) -> usize {
        self.sheets.iter().map(|s| s.field.size().0).sum()
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.sheets.iter().map(|s| s.field.size().1).sum()
    }
}

fn places(data: &Normalised, levels: &Levels) -> Vec<Place> {
    (0..data.positions.len())
        .map(|i| Place {
            position: data.positions[i],
            normal: data.normals[i],
            sigma: levels.position_sigma * data.relative_sigma[i],
            tilt: levels.normal_sigma * data.relative_tilt[i],
        })
        .collect()
}

/// The plane or quadric that explains the places of a sheet as well as the local `fits` do, if there is one. It knows the
/// sheet better than they do, above all at its edges, and carries it on straight.
fn whole(places: &[Place], fits: &Fits) -> Option<QuadricFit> {
    let balls: Vec<&Ball> = fits.balls().collect();
    let explains = |fit: &QuadricFit| {
        let (mut sum, mut most) = (0.0, 0.0_f64);
        for ball in &balls {
            let (value, _) = ball.value_and_gradient(&ball.centre);
            let variance =
                (ball.radius.powi(2) * ball.fit.centre_variance).max(EXACT_POSITION.powi(2));
            let off = (value - fit.quadric.value(&ball.centre)).powi(2) / variance;
            sum += off;
            most = most.max(off);
        }
        sum < WHOLE_MEAN * balls.len() as f64 && most < WHOLE_MOST && fit.quadric.explains(places)
    };
    let plane = || QuadricFit::plane(places).filter(|_| places.len() >= PLANE_CONTACTS);
    let quadric = || QuadricFit::quadric(places).filter(|_| places.len() >= QUADRIC_CONTACTS);
    plane()
        .filter(explains)
        .or_else(|| quadric().filter(explains))
}

/// Which contacts lean out of a sheet that all the others show to be flat; `None` if it is bent.
fn leaning(normals: &[Vec3], levels: &Levels) -> Option<Vec<bool>> {
    let mean = crate::mesh::unit_or_zero(normals.iter().sum());
    let limit = FLAT_ANGLE + FLAT_DEVIATIONS * levels.normal_sigma;
    let leaning: Vec<bool> = normals.iter().map(|n| n.angle(&mean) > limit).collect();
    let count = leaning.iter().filter(|l| **l).count();
    (count as f64 <= LEANING_MOST * normals.len() as f64).then_some(leaning)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        cloud::{Cloud, OrientedPoint},
        mesh::topology,
        reconstruct::extract::{NoiseEstimate, Options, extract_sheets},
    };

    /// Contacts every `step` on upright rectangles, the label of each and the pairs of labels that are not parallel.
    #[derive(Default)]
    struct Touched {
        cloud: Cloud,
        labels: Vec<u32>,
        axes: Vec<usize>,
    }

    impl Touched {
        /// Faces `at[axis] = place` that look to `side`, each made of rectangles: low and high in the next two axes.
        fn face(&mut self, axis: usize, place: f64, side: f64, step: f64, rectangles: &[[f64; 4]]) {
            let label = self.axes.len() as u32;
            self.axes.push(axis);
            for [low_u, high_u, low_v, high_v] in rectangles {
                let count = |low: f64, high: f64| ((high - low) / step).round() as u32;
                for i in 0..=count(*low_u, *high_u) {
                    for j in 0..=count(*low_v, *high_v) {
                        let mut position = Vec3::zeros();
                        position[axis] = place;
                        position[(axis + 1) % 3] = low_u + f64::from(i) * step;
                        position[(axis + 2) % 3] = low_v + f64::from(j) * step;
                        let mut normal = Vec3::zeros();
                        normal[axis] = side;
                        self.cloud.points.push(OrientedPoint {
                            position,
                            normal,
                            sigma: None,
                            finger: None,
                            time_us: None,
                        });
                        self.labels.push(label);
                    }
                }
            }
        }

        fn extract(&self) -> crate::reconstruct::extract::Extracted {
            let count = self.axes.len();
            let sharp: Vec<[u32; 2]> = (0..count)
                .flat_map(|i| (0..i).map(move |j| [j, i]))
                .filter(|[j, i]| self.axes[*j] != self.axes[*i])
                .map(|pair| pair.map(|k| k as u32))
                .collect();
            let noise = NoiseEstimate {
                position_sigma: 1e-4,
                normal_sigma: 1e-3,
            };
            extract_sheets(
                &self.cloud,
                &Options::default(),
                &self.labels,
                &sharp,
                &noise,
            )
            .unwrap()
        }
    }

    #[test]
    fn a_block_with_a_notch_is_whole_also_where_its_end_is_not_touched() {
        // [0, 1] x [0, 0.8] x [0, 0.5] without x > 0.4, y > 0.4; the end at x = 0 is touched up to y = 0.4 alone. Every plane
        // of the notch, carried on, runs through the rest of the block.
        let mut touched = Touched::default();
        let step = 0.05;
        for (z, side) in [(0.0, -1.0), (0.5, 1.0)] {
            let parts = [[0.0, 1.0, 0.0, 0.4], [0.0, 0.4, 0.45, 0.8]];
            touched.face(2, z, side, step, &parts);
        }
        touched.face(1, 0.0, -1.0, step, &[[0.0, 0.5, 0.0, 1.0]]);
        touched.face(1, 0.4, 1.0, step, &[[0.0, 0.5, 0.4, 1.0]]);
        touched.face(1, 0.8, 1.0, step, &[[0.0, 0.5, 0.0, 0.4]]);
        touched.face(0, 0.0, -1.0, step, &[[0.0, 0.4, 0.0, 0.5]]);
        touched.face(0, 0.4, 1.0, step, &[[0.4, 0.8, 0.0, 0.5]]);
        touched.face(0, 1.0, 1.0, step, &[[0.0, 0.4, 0.0, 0.5]]);
        let found = touched.extract();
        assert_eq!(topology(&found.mesh).genus(), Some(0));
        for x in &found.mesh.positions {
            let notch = f64::min(x.x - 0.4, x.y - 0.4);
            let height = [-x.x, x.x - 1.0, -x.y, x.y - 0.8, -x.z, x.z - 0.5, notch]
                .into_iter()
                .fold(f64::NEG_INFINITY, f64::max);
            // Edges are cut off by up to a cube of the lattice.
            assert!(height.abs() < found.spacing, "{x} {height}");
        }
        // Each place belongs to its face, however far its contacts are.
        assert_eq!(found.field.sheet(&Vec3::new(0.0, 0.78, 0.25)), Some(5));
        assert_eq!(found.field.sheet(&Vec3::new(0.02, 0.8, 0.25)), Some(4));
        assert_eq!(found.field.sheet(&Vec3::new(0.7, 0.4, 0.25)), Some(3));
        let sharp = found.field.sharp();
        assert!(
            sharp.contains(&[3, 6]) && sharp.contains(&[0, 6]),
            "{sharp:?}"
        );
        // The front and a wall of the notch never meet, though their planes do.
        assert!(!sharp.contains(&[2, 6]), "{sharp:?}");
    }

    #[test]
    fn a_plate_goes_on_behind_the_block_that_stands_on_it() {
        // The plate [-1, 1]^2 x [-0.3, 0] with the block [-0.2, 0.2]^2 x [0, 0.3]: each wall of the block ends the plate's
        // top before it, and says nothing of it behind the other wall.
        let mut touched = Touched::default();
        let step = 0.1;
        let ring = [
            [-1.0, 1.0, -1.0, -0.3],
            [-1.0, 1.0, 0.3, 1.0],
            [-1.0, -0.3, -0.2, 0.2],
            [0.3, 1.0, -0.2, 0.2],
        ];
        touched.face(2, 0.0, 1.0, step, &ring);
        touched.face(2, -0.3, -1.0, step, &[[-1.0, 1.0, -1.0, 1.0]]);
        touched.face(2, 0.3, 1.0, step, &[[-0.2, 0.2, -0.2, 0.2]]);
        for side in [-1.0, 1.0] {
            touched.face(0, side, side, step, &[[-1.0, 1.0, -0.3, 0.0]]);
            touched.face(1, side, side, step, &[[-0.3, 0.0, -1.0, 1.0]]);
            touched.face(0, 0.2 * side, side, 0.5 * step, &[[-0.2, 0.2, 0.05, 0.3]]);
            touched.face(1, 0.2 * side, side, 0.5 * step, &[[0.05, 0.3, -0.2, 0.2]]);
        }
        let found = touched.extract();
        assert_eq!(topology(&found.mesh).genus(), Some(0));
        for x in &found.mesh.positions {
            let plate = (x.x.abs() - 1.0)
                .max(x.y.abs() - 1.0)
                .max(-0.3 - x.z)
                .max(x.z);
            let block = (x.x.abs() - 0.2)
                .max(x.y.abs() - 0.2)
                .max(x.z - 0.3)
                .max(-0.3 - x.z);
            let height = plate.min(block);
            assert!(height.abs() < found.spacing, "{x} {height}");
        }
    }

    /// 300 contacts around (x, y) with height and slopes from `surface`, noise as measured.
    fn whole_through(surface: impl Fn(f64, f64) -> [f64; 3]) -> Option<QuadricFit> {
        use rand::{RngExt, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let mut bell = |sigma: f64| {
            let sum: f64 = (0..12).map(|_| random.random::<f64>()).sum();
            sigma * (sum - 6.0)
        };
        let mut cloud = Cloud::default();
        for k in 0..300 {
            let x = f64::from(k % 20) / 20.0 - 0.5 + bell(0.01);
            let y = f64::from(k / 20) / 15.0 - 0.5 + bell(0.01);
            let [z, dx, dy] = surface(x, y);
            let normal = Vec3::new(-dx, -dy, 1.0).normalize();
            let tilt = Vec3::new(bell(0.05), bell(0.05), bell(0.05));
            cloud.points.push(OrientedPoint {
                position: Vec3::new(x, y, z) + normal * bell(0.005),
                normal: (normal + tilt).normalize(),
                sigma: None,
                finger: None,
                time_us: None,
            });
        }
        let (frame, data) = super::super::contacts::normalise(&cloud).unwrap();
        let tree = Neighbourhoods::new(data.positions.clone());
        let levels = Levels {
            position_sigma: 0.005 / frame.scale,
            normal_sigma: 0.05,
            tau2: 1.0,
        };
        let covers = smoothing::cover(&data.positions, &tree, 80, 0.5);
        let levels = smoothing::with_smoothness(BENT, &data, &covers, &levels);
        let places = places(&data, &levels);
        let fits = Fits::new(BENT, data, tree, covers, Vec::new(), &levels);
        whole(&places, &fits)
    }

    #[test]
    fn planes_and_quadrics_are_known_for_what_they_are_and_other_sheets_for_none() {
        let plane = whole_through(|x, y| [0.2 * x - 0.1 * y, 0.2, -0.1]).unwrap();
        let up = Vec3::new(-0.2, 0.1, 1.0).normalize();
        assert!(plane.quadric.gradient(&Vec3::x()).normalize().angle(&up) < 0.01);
        let ball = whole_through(|x, y| {
            let z = (1.0 - x * x - y * y).sqrt();
            [z, -x / z, -y / z]
        });
        assert!(ball.is_some());
        let wave = whole_through(|x, y| {
            let (sin, cos) = (9.0 * x).sin_cos();
            [0.05 * sin * y, 0.45 * cos * y, 0.05 * sin]
        });
        assert!(wave.is_none());
    }

    #[test]
    fn nothing_stands_out_where_the_contacts_near_an_edge_are_missing() {
        // The cube [-1, 1]^3; its top ends far before one edge, which is touched from the side alone.
        let mut cloud = Cloud::default();
        let (mut labels, mut sharp) = (Vec::new(), Vec::new());
        for face in 0..6_u32 {
            let (axis, side) = (face as usize / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
            for k in 0..81 {
                let mut position = Vec3::zeros();
                position[axis] = side;
                position[(axis + 1) % 3] = f64::from(k % 9) * 0.25 - 1.0;
                position[(axis + 2) % 3] = f64::from(k / 9) * 0.25 - 1.0;
                if axis == 2 && side > 0.0 && position.x > -0.3 {
                    continue;
                }
                let mut normal = Vec3::zeros();
                normal[axis] = side;
                cloud.points.push(OrientedPoint {
                    position,
                    normal,
                    sigma: None,
                    finger: None,
                    time_us: None,
                });
                labels.push(face);
            }
            sharp.extend((0..face).filter(|f| f / 2 != face / 2).map(|f| [f, face]));
        }
        let noise = NoiseEstimate {
            position_sigma: 1e-4,
            normal_sigma: 1e-3,
        };
        let found = extract_sheets(&cloud, &Options::default(), &labels, &sharp, &noise).unwrap();
        assert_eq!(topology(&found.mesh).genus(), Some(0));
        for x in &found.mesh.positions {
            // Edges are cut off by up to a cube of the lattice.
            let out = x.amax() - 1.0;
            assert!(out < 1e-3 && out > -found.spacing, "{x}");
        }
    }
}
