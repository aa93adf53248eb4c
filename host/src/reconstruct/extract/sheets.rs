//! A field with creases: each smooth sheet of contacts has a field of its own, and the solid is what they bound together.
//!
//! One field over a crease has to bend there as no smooth function can; between the tracks it swings out, and corners
//! that no contact comes near to tear open. Once it is known which contacts form a smooth sheet and which sheets break
//! with one another, every sheet is fitted from its own contacts alone and carried on past its end; where two sheets meet
//! in an outer edge the solid lies behind both (the larger value counts), in an inner edge behind either (the smaller).
//!
//! Two ways were weighed: to keep one field and give it kernels that may bend (it then follows the noise too), and this
//! one, the sharp features of multi-level partitions of unity (Ohtake et al. 2003) with sheets that were found beforehand.

use super::{
    build_field, contacts::Normalised, field::BlendedField, kernel::Kernel, options::ExtractError,
    sides::Sides, smoothing, smoothing::Levels,
};
use crate::{Vec3, cloud::Neighbourhoods};

/// A sheet has a say at a place if its nearest contact is not this many times farther than the nearest of all, and this
/// many contact spacings.
const SAY_RATIO: f64 = 2.0;
const SAY_SPACINGS: f64 = 8.0;
/// Contacts within so many spacings of the other sheet tell whether two sheets form an outer or an inner edge.
const EDGE_SPACINGS: f64 = 5.0;
/// Mean angle between neighbouring normals of two sheets from which they form an edge, radians (30 degrees).
const EDGE_TURN: f64 = 0.52;
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
    field: BlendedField,
    contacts: Neighbourhoods,
    normals: Vec<Vec3>,
}

/// The fields of all sheets and how they meet.
#[derive(Clone, Debug)]
pub(super) struct SheetField {
    sheets: Vec<Sheet>,
    /// How sheets i and j meet, at i * sheets + j.
    edges: Vec<Edge>,
    spacing: f64,
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
            let field = build_field(kernel, &own, &covers, &[], &levels)?;
            sheets.push(Sheet {
                field,
                contacts: tree,
                normals: own.normals,
            });
        }
        let mut out = Self {
            edges: vec![Edge::None; sheets.len() * sheets.len()],
            sheets,
            spacing,
        };
        for i in 0..names.len() {
            for j in 0..i {
                let broken = sharp.contains(&[names[j], names[i]]);
                let edge = out.meeting(i, j, broken);
                out.edges[i * names.len() + j] = edge;
                out.edges[j * names.len() + i] = edge;
            }
        }
        Ok(out)
    }

    /// How sheets `i` and `j` meet: whether the contacts of each near the other lie behind it. Sheets that are not known
    /// to be `broken` meet in an edge all the same if one turns away from the other's contacts by more than
    /// [`EDGE_TURN`]: small pieces of a sheet show too little of their edge to be sure of it.
    fn meeting(&self, i: usize, j: usize, broken: bool) -> Edge {
        match self.meeting_within(EDGE_SPACINGS * self.spacing, [i, j], broken) {
            // A gap hides their edge: all their contacts tell.
            None if broken => self.meeting_within(f64::INFINITY, [i, j], broken),
            edge => edge,
        }
        .unwrap_or(Edge::None)
    }

    /// The same, from the contacts within `reach` of the other sheet; `None` without any.
    fn meeting_within(&self, reach: f64, [i, j]: [usize; 2], broken: bool) -> Option<Edge> {
        let (mut behind, mut turn, mut count) = (0.0, 0.0, 0.0);
        for (of, against) in [(i, j), (j, i)] {
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
                }
            }
        }
        if count == 0.0 {
            return None;
        }
        Some(if !broken && turn < EDGE_TURN * count {
            Edge::None
        } else if behind < 0.0 {
            Edge::Outer
        } else {
            Edge::Inner
        })
    }

    /// The sheet that bounds the solid nearest to `x`, and its `value` there; `None` without sheets.
    fn leading(&self, x: &Vec3, value: impl Fn(&Sheet) -> f64) -> Option<(&Sheet, f64)> {
        let away: Vec<f64> = self
            .sheets
            .iter()
            .map(|s| {
                s.contacts
                    .nearest_one(x)
                    .map_or(f64::INFINITY, |(_, d2)| d2.sqrt())
            })
            .collect();
        let least = away.iter().copied().fold(f64::INFINITY, f64::min);
        let limit = SAY_RATIO * least + SAY_SPACINGS * self.spacing;
        let heard: Vec<(usize, f64)> = (0..self.sheets.len())
            .filter(|&i| away[i] <= limit)
            .map(|i| (i, value(&self.sheets[i])))
            .filter(|(_, f)| f.is_finite())
            .collect();
        let count = self.sheets.len();
        // The sheet that prevails against most of those it breaks with; of equals the nearest.
        let (best, value) = *heard.iter().max_by(|(i, f), (j, g)| {
            let losses = |i: usize, f: f64| {
                let lost = heard
                    .iter()
                    .filter(|(k, h)| match self.edges[i * count + k] {
                        Edge::None => false,
                        Edge::Outer => *h > f,
                        Edge::Inner => *h < f,
                    });
                lost.count()
            };
            losses(*j, *g)
                .cmp(&losses(*i, *f))
                .then(away[*j].total_cmp(&away[*i]))
                .then(j.cmp(i))
        })?;
        Some((self.sheets.get(best)?, value))
    }

    /// Value at `x`; NaN where nothing speaks.
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        self.leading(x, |s| s.field.value(x))
            .map_or(f64::NAN, |(_, value)| value)
    }

    /// The same, with the sign from each sheet's own contacts where these leave no doubt.
    pub(super) fn settled(&self, x: &Vec3) -> f64 {
        let value = |sheet: &Sheet| {
            let sides = Sides {
                normals: &sheet.normals,
                tree: &sheet.contacts,
                spacing: self.spacing,
            };
            sides.settle(x, sheet.field.value(x))
        };
        self.leading(x, value).map_or(f64::NAN, |(_, value)| value)
    }

    /// Value and gradient at `x`; NaN where nothing speaks.
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        self.leading(x, |s| s.field.value(x)).map_or_else(
            || (f64::NAN, Vec3::repeat(f64::NAN)),
            |(s, _)| s.field.value_and_gradient(x),
        )
    }

    /// Standard deviation of the leading sheet's fits.
    pub(super) fn sigma(&self, x: &Vec3) -> Option<f64> {
        self.leading(x, |s| s.field.value(x))?.0.field.sigma(x)
    }

    /// Number of local fits.
    pub(super) fn len(&self) -> usize {
        self.sheets.iter().map(|s| s.field.len()).sum()
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.sheets.iter().map(|s| s.field.bytes()).sum()
    }
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
