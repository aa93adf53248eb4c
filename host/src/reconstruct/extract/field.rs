//! The field: local fits blended into one function that is smooth wherever it is defined.
//!
//! Partition of unity (Franke 1977; Wendland 2005, chapter 15): f = sum w_i f_i / sum w_i with the compact
//! C^2 weights (1-t)^4 (4t+1) of each fit's ball. A coarse fit over the whole cloud takes part everywhere with
//! a weight so small that it only speaks where no ball reaches, so that f is defined, and smooth, everywhere.

use std::collections::HashMap;

use super::{
    contacts::Frame, local_fit::LocalField, planes::TangentPlanes, sheets::SheetField,
    smoothing::Levels,
};
use crate::{Vec3, cloud::Neighbourhoods, reconstruct::quadric::Quadric};

/// The field whose zero set is the surface, in the unit of the input; negative inside.
#[derive(Clone, Debug)]
pub struct Field {
    frame: Frame,
    shape: Shape,
    contacts: Neighbourhoods,
    /// The same with what they foretell in gaps.
    foretold: Neighbourhoods,
    levels: Levels,
    contact_spacing: f64,
}

impl Field {
    pub(super) fn new(
        frame: Frame,
        shape: Shape,
        [contacts, foretold]: [Neighbourhoods; 2],
        levels: Levels,
        contact_spacing: f64,
    ) -> Self {
        Self {
            frame,
            shape,
            contacts,
            foretold,
            levels,
            contact_spacing,
        }
    }

    /// Approximate signed distance at `x`; NaN where `x` is not finite.
    pub fn value(&self, x: &Vec3) -> f64 {
        self.frame.scale * self.shape.value(&self.frame.inward(x))
    }

    /// Gradient at `x`: about unit length near the surface, pointing outward.
    pub fn gradient(&self, x: &Vec3) -> Vec3 {
        self.shape.value_and_gradient(&self.frame.inward(x)).1
    }

    /// The point of the zero set that Newton steps along the gradient reach from `x`; `None` if they do not settle.
    /// No step is longer than a hundredth of the bounding box's diagonal.
    pub fn project(&self, x: &Vec3) -> Option<Vec3> {
        self.shape
            .project(&self.frame.inward(x), 0.01)
            .map(|y| self.frame.outward(&y))
    }

    /// As [`Self::project`], with the field's gradient there.
    pub(in crate::reconstruct) fn foot(&self, x: &Vec3) -> Option<(Vec3, Vec3)> {
        let (foot, gradient) = self.shape.newton(&self.frame.inward(x), 0.01)?;
        let gradient = gradient.unwrap_or_else(|| self.shape.value_and_gradient(&foot).1);
        Some((self.frame.outward(&foot), gradient))
    }

    /// Standard deviation of the surface's position near `x`, unit of the input.
    ///
    /// The posterior ones of the local fits at their centres are blended like their values, and grow with the distance d
    /// from the nearest contact by 1 + (d / contact spacing)^2: on the mug's tracks the true error grew from 1.0 to 7.2
    /// (in 1e-3 of the diagonal) from d = 0.3 to 2.5 spacings, as this factor does, while the posterior alone
    /// promised far less than that.
    pub fn confidence(&self, x: &Vec3) -> f64 {
        self.sigma_beside(x, &self.contacts)
    }

    /// The same where a place that the contacts foretell in a gap counts as one of them: how far the field's own samples are
    /// to be trusted there beside measured contacts.
    pub fn sample_sigma(&self, x: &Vec3) -> f64 {
        self.sigma_beside(x, &self.foretold)
    }

    fn sigma_beside(&self, x: &Vec3, places: &Neighbourhoods) -> f64 {
        let x = self.frame.inward(x);
        let distance2 = places.nearest_one(&x).map_or(1.0, |(_, d2)| d2);
        let least = 0.1 * self.levels.position_sigma;
        let sigma = self
            .shape
            .sigma(&x)
            .map_or(self.levels.position_sigma, |s| s.max(least));
        self.frame.scale * sigma * (1.0 + distance2 / self.contact_spacing.powi(2))
    }

    /// The label of the smooth sheet that bounds the solid nearest to `x`; `None` of a field without sheets.
    pub fn sheet(&self, x: &Vec3) -> Option<u32> {
        match &self.shape {
            Shape::Sheets(sheets) => sheets.label(&self.frame.inward(x)),
            Shape::Blended(_) | Shape::Planes(_) => None,
        }
    }

    /// The plane or quadric that stands for the whole smooth sheet of this label, in the unit of the input; `None` of sheets that
    /// are neither, and of a field without sheets.
    pub(in crate::reconstruct) fn whole_sheet(&self, label: u32) -> Option<Quadric> {
        match &self.shape {
            Shape::Sheets(sheets) => Some(
                sheets
                    .whole(label)?
                    .moved(self.frame.scale, &self.frame.origin),
            ),
            Shape::Blended(_) | Shape::Planes(_) => None,
        }
    }

    /// The labels of the smooth sheets that meet in an edge, in pairs, the lower one first; none of a field without sheets.
    pub fn sharp(&self) -> Vec<[u32; 2]> {
        match &self.shape {
            Shape::Sheets(sheets) => sheets.sharp(),
            Shape::Blended(_) | Shape::Planes(_) => Vec::new(),
        }
    }

    /// Number of local fits, or of tangent planes.
    pub fn fits(&self) -> usize {
        self.shape.len()
    }
}

/// One of the ways to make the field, in normalised coordinates.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// Blended local fits.
    Blended(BlendedField),
    /// Averaged tangent planes.
    Planes(TangentPlanes),
    /// Smooth sheets that meet in creases.
    Sheets(SheetField),
}

/// Newton step, normalised units, after which a place counts as on the surface.
const PROJECTED: f64 = 1e-3;
/// Newton step, normalised units, over which the gradient is the same.
const SAME: f64 = 1e-5;

impl Shape {
    /// Value at `x`.
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        match self {
            Self::Blended(field) => field.value(x),
            Self::Planes(planes) => planes.value_and_gradient(x).0,
            Self::Sheets(sheets) => sheets.value(x),
        }
    }

    /// Value and gradient at `x`.
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        match self {
            Self::Blended(field) => field.value_and_gradient(x),
            Self::Planes(planes) => planes.value_and_gradient(x),
            Self::Sheets(sheets) => sheets.value_and_gradient(x),
        }
    }

    /// Newton steps along the gradient to the zero set; steps are cut at `longest`.
    pub(super) fn project(&self, x: &Vec3, longest: f64) -> Option<Vec3> {
        self.newton(x, longest).map(|(foot, _)| foot)
    }

    /// The same, with the gradient there if it came along with the steps.
    fn newton(&self, x: &Vec3, longest: f64) -> Option<(Vec3, Option<Vec3>)> {
        let mut at = *x;
        for _ in 0..8 {
            let (f, g) = self.value_and_gradient(&at);
            let step = g * (f / g.norm_squared());
            let length = step.norm();
            if !length.is_finite() {
                return None;
            }
            at -= if length > longest {
                step * (longest / length)
            } else {
                step
            };
            // What is left after a Newton step is about its square times a curvature.
            if length < PROJECTED {
                return Some((at, (length < SAME).then_some(g)));
            }
        }
        let (f, g) = self.value_and_gradient(&at);
        (f.abs() < 1e-5 * g.norm()).then_some((at, Some(g)))
    }

    fn sigma(&self, x: &Vec3) -> Option<f64> {
        match self {
            Self::Blended(field) => field.sigma(x),
            Self::Planes(_) => None,
            Self::Sheets(sheets) => sheets.sigma(x),
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Blended(field) => field.len(),
            Self::Planes(planes) => planes.len(),
            Self::Sheets(sheets) => sheets.len(),
        }
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Blended(field) => field.bytes(),
            Self::Planes(planes) => planes.bytes(),
            Self::Sheets(sheets) => sheets.bytes(),
        }
    }
}

/// Weight of the coarse fit against the 1 at a ball's centre. Nine tenths of the way out a ball still weighs
/// 5e-4; with 1e-6 the coarse fit shares only the outermost 2 % of the radius.
const COARSE_WEIGHT: f64 = 1e-6;

/// A local fit and the ball it speaks for, in normalised coordinates.
#[derive(Clone, Debug)]
pub(super) struct Ball {
    pub centre: Vec3,
    pub radius: f64,
    pub fit: LocalField,
}

impl Ball {
    fn value(&self, x: &Vec3) -> f64 {
        self.radius * self.fit.value(&((x - self.centre) / self.radius))
    }

    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        let (f, g) = self
            .fit
            .value_and_gradient(&((x - self.centre) / self.radius));
        (self.radius * f, g)
    }
}

/// The blended field in normalised coordinates.
#[derive(Clone, Debug)]
pub(super) struct BlendedField {
    balls: Vec<Ball>,
    coarse: Option<Ball>,
    cell: f64,
    lookup: HashMap<[i32; 3], Vec<u32>>,
}

impl BlendedField {
    /// Blends `balls`; `coarse` speaks where none of them reaches.
    pub(super) fn new(balls: Vec<Ball>, coarse: Option<Ball>) -> Self {
        let mut radii: Vec<f64> = balls.iter().map(|b| b.radius).collect();
        radii.sort_by(f64::total_cmp);
        let cell = radii.get(radii.len() / 2).copied().unwrap_or(1.0) * 0.5;
        let mut lookup: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (i, ball) in balls.iter().enumerate() {
            let reach = Vec3::repeat(ball.radius);
            let low = bucket(&(ball.centre - reach), cell);
            let high = bucket(&(ball.centre + reach), cell);
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        let corner = Vec3::new(f64::from(x), f64::from(y), f64::from(z)) * cell;
                        let nearest = ball.centre.sup(&corner).inf(&(corner + Vec3::repeat(cell)));
                        if (nearest - ball.centre).norm_squared() < ball.radius * ball.radius {
                            lookup.entry([x, y, z]).or_default().push(i as u32);
                        }
                    }
                }
            }
        }
        Self {
            balls,
            coarse,
            cell,
            lookup,
        }
    }

    fn reaching(&self, x: &Vec3) -> impl Iterator<Item = (&Ball, f64)> {
        let x = *x;
        self.lookup
            .get(&bucket(&x, self.cell))
            .into_iter()
            .flatten()
            .filter_map(move |&i| {
                let ball = &self.balls[i as usize];
                let t = (x - ball.centre).norm() / ball.radius;
                (t < 1.0).then_some((ball, t))
            })
    }

    /// Value at `x`; NaN where nothing speaks.
    pub(super) fn value(&self, x: &Vec3) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (ball, t) in self.reaching(x) {
            let w = (1.0 - t).powi(4) * (4.0 * t + 1.0);
            sum += w * ball.value(x);
            weight += w;
        }
        if let (Some(coarse), Some((w, _))) = (&self.coarse, coarse_weight(weight)) {
            sum += w * coarse.value(x);
            weight += w;
        }
        sum / weight
    }

    /// Value and gradient at `x`, the blend's own derivative included; NaN where nothing speaks.
    pub(super) fn value_and_gradient(&self, x: &Vec3) -> (f64, Vec3) {
        let (mut sum, mut weight) = (0.0, 0.0);
        let (mut slope, mut weight_slope) = (Vec3::zeros(), Vec3::zeros());
        for (ball, t) in self.reaching(x) {
            let s = 1.0 - t;
            let w = s.powi(4) * (4.0 * t + 1.0);
            // dw/dt = -20 t (1-t)^3, dt/dx = (x - c) / (t r^2)
            let dw = (x - ball.centre) * (-20.0 * s.powi(3) / (ball.radius * ball.radius));
            let (f, g) = ball.value_and_gradient(x);
            sum += w * f;
            weight += w;
            slope += w * g + f * dw;
            weight_slope += dw;
        }
        if let (Some(coarse), Some((w, dw))) = (&self.coarse, coarse_weight(weight)) {
            let (f, g) = coarse.value_and_gradient(x);
            sum += w * f;
            weight += w;
            slope += w * g + f * dw * weight_slope;
            weight_slope *= 1.0 + dw;
        }
        let value = sum / weight;
        (value, (slope - value * weight_slope) / weight)
    }

    /// Standard deviations of the balls' fits at their centres, blended; `None` where none reaches.
    pub(super) fn sigma(&self, x: &Vec3) -> Option<f64> {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (ball, t) in self.reaching(x) {
            let w = (1.0 - t).powi(4) * (4.0 * t + 1.0);
            sum += w * ball.radius * ball.fit.centre_variance.sqrt();
            weight += w;
        }
        (weight > 0.0).then(|| sum / weight)
    }

    /// Number of balls.
    pub(super) fn len(&self) -> usize {
        self.balls.len()
    }

    /// Bytes held, the lookup included.
    pub(super) fn bytes(&self) -> usize {
        let balls = self.balls.iter().chain(&self.coarse);
        let lookup: usize = self.lookup.values().map(|v| 48 + 4 * v.len()).sum();
        balls.map(|b| b.fit.bytes()).sum::<usize>() + lookup
    }
}

/// Weight of the coarse fit where the balls together weigh `balls`, and its derivative by that; fades to
/// nothing where they weigh a thousand times more.
fn coarse_weight(balls: f64) -> Option<(f64, f64)> {
    let fade = 1e3 * COARSE_WEIGHT;
    let s = 1.0 - balls / fade;
    (s > 0.0).then_some((COARSE_WEIGHT * s * s, -2.0 * COARSE_WEIGHT * s / fade))
}

fn bucket(x: &Vec3, cell: f64) -> [i32; 3] {
    [
        (x.x / cell).floor() as i32,
        (x.y / cell).floor() as i32,
        (x.z / cell).floor() as i32,
    ]
}
