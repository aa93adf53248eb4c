//! Phase 1: from contacts to a first triangle mesh, by way of a field whose zero set is the surface.
//!
//! 1. Contacts that contradict their neighbours are set aside ([`Extracted::outliers`]).
//! 2. Noise of positions and normals and the smoothness of the surface are estimated from the rest.
//! 3. The field is built: by default a partition of unity of local Gaussian-process fits to positions and normals
//!    ([`Method::Hermite`]); the paper's distance to averaged tangent planes can be had instead
//!    ([`Method::TangentPlanes`]). In gaps of thin walls it is helped by places that each side foretells for itself.
//! 4. Marching cubes follow the zero set outward from the contacts, and every vertex is moved onto it.
//! 5. Holes of the data are closed or become clean borders ([`Extracted::holes`]).
//!
//! Everything inside happens in coordinates normalised to a bounding box of diagonal 1 around the origin, so
//! results do not depend on the unit or place of the input (up to rounding).
//!
//! Promises: no panic for any input; the same bytes for the same input at any number of threads; a manifold mesh,
//! consistently oriented outward, closed or with clean borders.

mod border;
mod bridges;
mod contacts;
mod cube;
mod dense;
mod field;
mod frontier;
mod kernel;
mod lattice;
mod local_fit;
mod options;
mod orthogonal;
mod outliers;
mod planes;
mod rim;
mod sheets;
mod sides;
mod smoothing;

use rayon::prelude::*;

use self::{
    border::Closing,
    contacts::{Frame, Normalised},
    field::{Ball, BlendedField, Shape},
    lattice::Lattice,
    local_fit::LocalProblem,
    planes::TangentPlanes,
    rim::Contacts,
    sheets::SheetField,
    sides::Sides,
    smoothing::{Cover, Levels},
};
use crate::{
    Vec3,
    cloud::{Cloud, Neighbourhoods},
    mesh::TriangleMesh,
};

pub use self::{
    border::Hole,
    field::Field,
    kernel::Kernel,
    options::{Estimate, ExtractError, LEAST_CONTACTS, Method, Options},
};

/// What the contacts say about their own noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimate {
    /// Standard deviation of a typical position along the normal, in the unit of the input.
    pub position_sigma: f64,
    /// Standard deviation of each of the two tilts of a normal, radians.
    pub normal_sigma: f64,
}

/// Result of the extraction.
#[derive(Clone, Debug)]
pub struct Extracted {
    /// The mesh, on the field's zero set, in the unit of the input.
    pub mesh: TriangleMesh,
    /// The field.
    pub field: Field,
    /// Noise of the contacts.
    pub noise: NoiseEstimate,
    /// Contacts set aside because they contradict the others, ascending.
    pub outliers: Vec<usize>,
    /// Holes of the data and what became of them.
    pub holes: Vec<Hole>,
    /// Components of the zero set left out because hardly any contact lies on them.
    pub dropped_components: usize,
    /// Spacing of the lattice, unit of the input.
    pub spacing: f64,
    /// Typical distance between neighbouring contacts if they were spread evenly, unit of the input.
    pub contact_spacing: f64,
    /// Cubes of the lattice that hold surface.
    pub cubes: usize,
    /// Bytes of field and lattice.
    pub bytes: usize,
}

/// Radius of a ball of contacts that a contact has to lie within to count as covered: at half of the radius the blend's
/// weight is still a fifth of that at the centre.
const COVERED: f64 = 0.5;
/// Lattice spacing against the contacts' spacing.
const FINENESS: f64 = 0.8;
/// Largest spacing where sheets meet in edges, which the lattice chamfers (normalised): with 374 contacts on cylinders and
/// rings their edges come from 12 to 15 to 7 to 11 (in 1e-3 of the diagonal, at most); finer gives no more.
const SHEETS_CUBE: f64 = 0.026;
/// A hole of the data starts this many contact spacings from the nearest contact. Tracks over closed objects leave
/// places up to 3 spacings away (torus, mug, trilobe: 2.0 to 2.9); a smaller value would open those, a larger one
/// rounds off the corners of open surfaces.
const HOLE_SPACINGS: f64 = 3.3;
/// Standard deviation at the middle of a gap, against that of one contact, up to which the smooth kernel is trusted there.
/// It promises 0.2 to 0.35 on smooth shapes (torus, bean, blob), where it keeps its word, and 0.3 to 2.5 on the
/// mug, where it errs by several times that.
const SURE: f64 = 0.5;
/// The same for exact contacts, against the diagonal.
const SURE_LEAST: f64 = 1e-4;
/// Surface is followed this far from the contacts (normalised) when holes may be closed.
const REACH: f64 = 0.25;
/// The same where sheets bound one another: a plane may be carried on across half a face (a cube with 374 contacts).
const SHEETS_REACH: f64 = 0.5;
/// Radius (normalised) of the closing that straightens a border between the outermost contacts: as wide as the reach allows.
const WIDE_CLOSING: f64 = 0.8 * REACH;
/// It adds surface up to this many contact spacings from a contact. Between 1.5 and 3 the rims of five bowls came out the
/// same; the least of them invents least in narrow bays.
const FILL_SPACINGS: f64 = 1.5;
/// Bytes per lattice cube, everything counted (values, cuts, vertices, faces); measured at 380 to 450.
const BYTES_PER_CUBE: usize = 500;

/// Extracts the surface through `cloud`.
///
/// # Errors
/// [`ExtractError`] says what is wrong with the contacts or options and what to do.
pub fn extract(cloud: &Cloud, options: &Options) -> Result<Extracted, ExtractError> {
    fit_field(cloud, options)?.trace(options)
}

/// The first half of [`extract`]: outliers, noise and field.
///
/// # Errors
/// As [`extract`].
pub fn fit_field(cloud: &Cloud, options: &Options) -> Result<FieldFit, ExtractError> {
    options.check()?;
    let (frame, all) = contacts::normalise(cloud)?;
    fit(frame, all, options, Care::Whole)
}

/// Outliers and noise of contacts that will be followed sheet by sheet: the field that tells them needs no care in gaps.
///
/// # Errors
/// As [`extract`].
pub fn find_outliers(
    cloud: &Cloud,
    options: &Options,
) -> Result<(Vec<usize>, NoiseEstimate), ExtractError> {
    options.check()?;
    let (frame, all) = contacts::normalise(cloud)?;
    let field = fit(frame, all, options, Care::AtContacts)?;
    let noise = field.noise();
    Ok((field.outliers, noise))
}

/// Where a field has to be good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Care {
    /// Wherever the surface may run.
    Whole,
    /// At the contacts, also beside edges: cubic fits, none in gaps.
    AtContacts,
}

/// Extracts the surface again, now that it is known which contacts of `cloud` form smooth sheets and which of these break
/// with one another: edges and corners come out sharp, also where no contact comes near. `labels` gives the sheet of
/// each contact ([`NONE`](crate::mesh::NONE): of no sheet), `sharp` the pairs of sheets, `noise` is that found before.
/// Contacts that lie off all sheets alone are set aside, too.
///
/// # Errors
/// As [`extract`].
pub fn extract_sheets(
    cloud: &Cloud,
    options: &Options,
    labels: &[u32],
    sharp: &[[u32; 2]],
    noise: &NoiseEstimate,
) -> Result<Extracted, ExtractError> {
    options.check()?;
    let (frame, mut data) = contacts::normalise(cloud)?;
    let mut tree = Neighbourhoods::new(data.positions.clone());
    let covers = smoothing::cover(&data.positions, &tree, options.neighbours, COVERED);
    let contact_spacing = contact_spacing(&covers);
    let levels = Levels {
        position_sigma: noise.position_sigma / frame.scale,
        normal_sigma: noise.normal_sigma,
        tau2: 1.0,
    };
    let neighbours = options.neighbours;
    let mut field = SheetField::new(&data, labels, sharp, &levels, neighbours, contact_spacing)?;
    let false_ones = outliers::off_sheets(&data, &tree, &field, &levels);
    let outliers: Vec<usize> = (0..data.positions.len())
        .filter(|&i| false_ones[i])
        .collect();
    if !outliers.is_empty() {
        data = data.without(&false_ones);
        tree = Neighbourhoods::new(data.positions.clone());
        let labels: Vec<u32> = data.source.iter().map(|&i| labels[i]).collect();
        field = SheetField::new(&data, &labels, sharp, &levels, neighbours, contact_spacing)?;
    }
    FieldFit {
        frame,
        witnesses: (data.normals.clone(), tree.clone()),
        data,
        tree,
        shape: Shape::Sheets(field),
        levels,
        contact_spacing,
        outliers,
    }
    .trace(options)
}

/// A field through the contacts, whose surface has not been followed yet, and what it was made from.
pub struct FieldFit {
    frame: Frame,
    data: Normalised,
    tree: Neighbourhoods,
    /// Normals and places of those that tell inside from outside: the contacts and what they foretell in gaps.
    witnesses: (Vec<Vec3>, Neighbourhoods),
    shape: Shape,
    levels: Levels,
    contact_spacing: f64,
    outliers: Vec<usize>,
}

impl FieldFit {
    /// Contacts set aside, rising.
    pub fn outliers(&self) -> &[usize] {
        &self.outliers
    }

    /// Noise of the contacts, in the unit of the cloud.
    pub fn noise(&self) -> NoiseEstimate {
        NoiseEstimate {
            position_sigma: self.levels.position_sigma * self.frame.scale,
            normal_sigma: self.levels.normal_sigma,
        }
    }

    /// The second half of [`extract`]: follows the field's zero set, its holes closed or open.
    ///
    /// # Errors
    /// As [`extract`].
    pub fn trace(self, options: &Options) -> Result<Extracted, ExtractError> {
        let noise = self.noise();
        let Self {
            frame,
            data,
            tree,
            witnesses,
            shape,
            levels,
            contact_spacing,
            outliers,
        } = self;
        let even = FINENESS * contact_spacing;
        let spacing = match (options.spacing, &shape) {
            (Some(spacing), _) => spacing / frame.scale,
            (None, Shape::Sheets(_)) => even.min(SHEETS_CUBE),
            (None, _) => even,
        };
        let limit = options.max_memory.saturating_sub(shape.bytes()) / BYTES_PER_CUBE;
        let too_much = |cubes: usize| ExtractError::TooMuchMemory {
            spacing: spacing * frame.scale,
            needed: shape
                .bytes()
                .saturating_add(cubes.saturating_mul(BYTES_PER_CUBE)),
            limit: options.max_memory,
        };
        // Every contact's spacing^2 of surface has about 1.5 (spacing / lattice spacing)^2 cubes.
        let expected = 1.5 * data.positions.len() as f64 * (contact_spacing / spacing).powi(2);
        if expected > limit as f64 {
            return Err(too_much(expected as usize));
        }
        (options.announce)(Estimate {
            cubes: expected as usize,
            bytes: shape.bytes() + expected as usize * BYTES_PER_CUBE,
            limit: options.max_memory,
        });
        let seeds: Vec<Vec3> = data
            .positions
            .par_iter()
            .filter_map(|p| shape.project(p, spacing.min(contact_spacing)))
            .collect();
        let hole_radius = options
            .max_gap
            .map_or(0.0, |gap| 0.5 * gap / frame.scale)
            .max(HOLE_SPACINGS * contact_spacing);
        let far = match shape {
            Shape::Sheets(_) => SHEETS_REACH,
            _ => REACH,
        };
        let reach = far.max(hole_radius + 2.0 * spacing);
        let sides = Sides {
            normals: &witnesses.0,
            tree: &witnesses.1,
            spacing: contact_spacing,
        };
        let marched = Lattice { spacing }.march(
            |x| match &shape {
                // Each sheet has asked its own contacts; those of another one that a place lies behind know nothing of
                // the edge beside it.
                Shape::Sheets(sheets) => sheets.settled(x),
                _ => sides.settle(x, shape.value(x)),
            },
            &seeds,
            |x| {
                tree.nearest_one(x)
                    .is_some_and(|(_, d2)| d2 < reach * reach)
            },
            limit,
        );
        if marched.truncated {
            return Err(too_much(marched.cubes));
        }
        let mut mesh = marched.mesh;
        if mesh.faces.is_empty() {
            return Err(ExtractError::NoSurface);
        }
        polish(&shape, &mut mesh, 0.5 * spacing);
        let support = border::support(&mesh, &data, &tree);
        let closing = Closing {
            radius: hole_radius,
            deepest: options.max_gap.map(|gap| 0.5 * gap / frame.scale),
            reach: reach - 2.0 * spacing,
            wide: WIDE_CLOSING,
            fill: FILL_SPACINGS * contact_spacing,
        };
        let (level, mut holes) = border::close_or_open(&mesh, &support, &closing);
        let least = (data.positions.len() / 200).clamp(3, 20);
        let touched = |mesh: &TriangleMesh| {
            let (mut mesh, dropped) = border::keep_touched(mesh, &seeds, least);
            border::separate_fans(&mut mesh);
            (mesh, dropped)
        };
        let (mut mesh, dropped_components) = match level {
            None => touched(&mesh),
            Some(level) => {
                let (closed, dropped) = touched(&border::clip(&mesh, &level));
                let contacts = Contacts {
                    data: &data,
                    sigma: levels.position_sigma,
                    spacing: contact_spacing,
                };
                let level = (&support[..], &level[..]);
                let finish = |mesh: &TriangleMesh| touched(mesh).0;
                let mesh = rim::smooth_border(&mesh, level, closed, &contacts, finish);
                (mesh, dropped)
            }
        };
        if mesh.faces.is_empty() {
            return Err(ExtractError::NoSurface);
        }
        for x in &mut mesh.positions {
            *x = frame.outward(x);
        }
        for hole in &mut holes {
            hole.place = frame.outward(&hole.place);
            hole.depth *= frame.scale;
        }
        let bytes = shape.bytes() + marched.cubes * BYTES_PER_CUBE;
        Ok(Extracted {
            mesh,
            field: Field::new(frame, shape, [tree, witnesses.1], levels, contact_spacing),
            noise,
            outliers,
            holes,
            dropped_components,
            spacing: spacing * frame.scale,
            contact_spacing: contact_spacing * frame.scale,
            cubes: marched.cubes,
            bytes,
        })
    }
}

/// Share of the contacts up to which setting them aside leaves noise and spacing as they were estimated with them: these are
/// medians.
const FEW: f64 = 0.02;

/// Fits the field to those contacts that do not contradict it.
fn fit(
    frame: Frame,
    mut data: Normalised,
    options: &Options,
    care: Care,
) -> Result<FieldFit, ExtractError> {
    let kernel = match options.method {
        Method::Hermite(kernel) => kernel,
        Method::TangentPlanes => Kernel::Septic,
    };
    let mut outliers = Vec::new();
    let mut tree = Neighbourhoods::new(data.positions.clone());
    let mut set_aside = |data: &mut Normalised, tree: &mut Neighbourhoods, marked: &[bool]| {
        let count = marked.iter().filter(|m| **m).count();
        if count > 0 {
            outliers.extend(
                (0..marked.len())
                    .filter(|&i| marked[i])
                    .map(|i| data.source[i]),
            );
            *data = data.without(marked);
            *tree = Neighbourhoods::new(data.positions.clone());
        }
        count
    };
    let marked = outliers::unsupported(&data, &tree);
    set_aside(&mut data, &mut tree, &marked);
    let begin = |data: &Normalised, tree: &Neighbourhoods| {
        let covers = smoothing::cover(&data.positions, tree, options.neighbours, COVERED);
        let levels = smoothing::estimate(kernel, data, tree);
        let contact_spacing = contact_spacing(&covers);
        let fits = match care {
            Care::Whole => {
                let known = (&levels, contact_spacing);
                Fits::bridged(kernel, data, tree, covers, known, options)
            }
            Care::AtContacts => {
                let calm = smoothing::with_smoothness(Kernel::Cubic, data, &covers, &levels);
                let (data, tree) = (data.clone(), tree.clone());
                Fits::new(Kernel::Cubic, data, tree, covers, Vec::new(), &calm)
            }
        };
        (fits, levels, contact_spacing)
    };
    let (mut fits, mut levels, mut contact_spacing) = begin(&data, &tree);
    let mut round = 0;
    let blended = loop {
        let blended = fits.blend()?;
        round += 1;
        if round == ROUNDS {
            break blended;
        }
        let refit = |covers: &[Cover]| {
            let calm = smoothing::with_smoothness(Kernel::Cubic, &data, covers, &levels);
            try_balls(Kernel::Cubic, &data, covers, &calm)
        };
        let marked = outliers::contradicting(&data, &tree, &blended, &levels, &refit);
        match set_aside(&mut data, &mut tree, &marked) {
            0 => break blended,
            few if few as f64 <= FEW * marked.len() as f64 => fits.without(marked),
            _ => (fits, levels, contact_spacing) = begin(&data, &tree),
        }
    };
    outliers.sort_unstable();
    let shape = match options.method {
        Method::Hermite(_) => Shape::Blended(blended),
        Method::TangentPlanes => Shape::Planes(TangentPlanes::new(&data, &tree, contact_spacing)),
    };
    Ok(FieldFit {
        frame,
        data,
        tree,
        witnesses: (fits.data.normals, fits.tree),
        shape,
        levels,
        contact_spacing,
        outliers,
    })
}

/// Typical distance of neighbouring contacts if they were spread evenly.
fn contact_spacing(covers: &[Cover]) -> f64 {
    let mut spread: Vec<f64> = covers
        .iter()
        .map(|b| b.radius * (std::f64::consts::PI / b.members.len() as f64).sqrt())
        .collect();
    smoothing::median(&mut spread).unwrap_or(0.05).max(1e-4)
}

/// Moves the vertices onto the zero set; those that would go far stay.
fn polish(field: &Shape, mesh: &mut TriangleMesh, farthest: f64) {
    mesh.positions.par_iter_mut().for_each(|x| {
        if let Some(y) = field.project(x, farthest)
            && (y - *x).norm() <= 2.0 * farthest
        {
            *x = y;
        }
    });
}

/// Spacings between the middles of balls in gaps. At 1.8 a torus has more of them than elsewhere and is no truer; where thin walls
/// have gaps, mugs are less true at 2.4.
const APART: f64 = 2.4;
const APART_AT_WALLS: f64 = 1.8;
/// Rounds of fitting and setting aside at most.
const ROUNDS: usize = 3;

/// The local fits of a field.
///
/// The smooth `kernel` is used where it knows the middle of the gaps nearly as well as a contact would, and the cubic one
/// elsewhere, whose extrapolation is the calmest. Tried on torus, two-holed torus, bean, blob, mug and cube: where the
/// surroundings are smooth the septic kernel is truer by a fifth than the cubic one, over the features of the mug and the
/// creases of the cube it swings out by a multiple.
struct Fits {
    /// The contacts, those that are foretold included.
    data: Normalised,
    tree: Neighbourhoods,
    /// Fits of one kernel with the same levels, in the order in which they are blended.
    groups: Vec<Group>,
    /// Levels of the cubic kernel.
    calm: Levels,
}

/// Local fits that share kernel and levels.
struct Group {
    kernel: Kernel,
    levels: Levels,
    covers: Vec<Cover>,
    balls: Vec<Option<Ball>>,
}

impl Group {
    fn new(kernel: Kernel, data: &Normalised, covers: Vec<Cover>, levels: &Levels) -> Self {
        let balls = try_balls(kernel, data, &covers, levels);
        Self {
            kernel,
            levels: *levels,
            covers,
            balls,
        }
    }
}

impl Fits {
    /// Fits the contacts and those that they foretell in the gaps of thin walls; `covers` are those of the contacts alone.
    fn bridged(
        kernel: Kernel,
        contacts: &Normalised,
        tree: &Neighbourhoods,
        covers: Vec<Cover>,
        (levels, spacing): (&Levels, f64),
        options: &Options,
    ) -> Self {
        let data = bridges::bridged(contacts, tree, levels, spacing);
        let foretold = data.positions.len() > contacts.positions.len();
        let k = options.neighbours;
        let (tree, covers) = if foretold {
            let tree = Neighbourhoods::new(data.positions.clone());
            let covers = smoothing::cover(&data.positions, &tree, k, COVERED);
            (tree, covers)
        } else {
            (tree.clone(), covers)
        };
        let apart = if foretold { APART_AT_WALLS } else { APART };
        let gaps = smoothing::gap_covers(&data, &tree, k, spacing, apart);
        Self::new(kernel, data, tree, covers, gaps, levels)
    }

    fn new(
        kernel: Kernel,
        data: Normalised,
        tree: Neighbourhoods,
        covers: Vec<Cover>,
        gaps: Vec<Cover>,
        levels: &Levels,
    ) -> Self {
        let limit = (SURE * levels.position_sigma).max(SURE_LEAST);
        let in_gaps = try_balls(kernel, &data, &gaps, levels);
        let sure: Vec<bool> = in_gaps
            .iter()
            .map(|ball| {
                let sigma = |b: &Ball| b.radius * b.fit.centre_variance.sqrt();
                ball.as_ref().is_some_and(|b| sigma(b) <= limit)
            })
            .collect();
        let rough = |cover: &Cover| {
            let near = |g: &Cover| (g.centre - cover.centre).norm() < cover.radius;
            let (mut all, mut unsure) = (0, 0);
            for (g, &sure) in gaps.iter().zip(&sure) {
                if near(g) {
                    all += 1;
                    unsure += usize::from(!sure);
                }
            }
            3 * unsure > all
        };
        let (mut cubic, smooth): (Vec<Cover>, Vec<Cover>) = covers.into_iter().partition(rough);
        let mut certain = Group {
            kernel,
            levels: *levels,
            covers: Vec::new(),
            balls: Vec::new(),
        };
        for ((cover, ball), sure) in gaps.into_iter().zip(in_gaps).zip(sure) {
            if sure {
                certain.covers.push(cover);
                certain.balls.push(ball);
            } else {
                cubic.push(cover);
            }
        }
        let calm = smoothing::with_smoothness(Kernel::Cubic, &data, &cubic, levels);
        let smooth = Group::new(kernel, &data, smooth, levels);
        let cubic = Group::new(Kernel::Cubic, &data, cubic, &calm);
        Self {
            data,
            tree,
            groups: vec![smooth, cubic, certain],
            calm,
        }
    }

    /// Leaves contacts out that are `gone`. Only fits that held one of them are made again, with as many contacts as before.
    fn without(&mut self, mut gone: Vec<bool>) {
        gone.resize(self.data.positions.len(), false);
        self.data = self.data.without(&gone);
        self.tree = Neighbourhoods::new(self.data.positions.clone());
        let (data, tree) = (&self.data, &self.tree);
        let mut number = 0;
        let numbers: Vec<u32> = gone
            .iter()
            .map(|gone| {
                number += u32::from(!gone);
                number.wrapping_sub(1)
            })
            .collect();
        for group in &mut self.groups {
            let (mut changed, mut again) = (Vec::new(), Vec::new());
            for (place, cover) in group.covers.iter_mut().enumerate() {
                if cover.members.iter().any(|&i| gone[i as usize]) {
                    *cover = Cover::around(cover.centre, tree, cover.members.len());
                    changed.push(place);
                    again.push(cover.clone());
                } else {
                    for member in &mut cover.members {
                        *member = numbers[*member as usize];
                    }
                }
            }
            let balls = try_balls(group.kernel, data, &again, &group.levels);
            for (place, ball) in changed.into_iter().zip(balls) {
                group.balls[place] = ball;
            }
        }
    }

    /// The fits that were found.
    fn balls(&self) -> impl Iterator<Item = &Ball> {
        self.groups.iter().flat_map(|g| &g.balls).flatten()
    }

    /// Blends the fits and the coarse field.
    fn blend(&self) -> Result<BlendedField, ExtractError> {
        let balls: Vec<Ball> = self.balls().cloned().collect();
        if balls.is_empty() {
            return Err(ExtractError::NoSurface);
        }
        let whole = [smoothing::coarse_cover(&self.data.positions)];
        let coarse = try_balls(Kernel::Cubic, &self.data, &whole, &self.calm).pop();
        Ok(BlendedField::new(balls, coarse.flatten()))
    }
}

fn try_balls(
    kernel: Kernel,
    data: &Normalised,
    covers: &[Cover],
    levels: &Levels,
) -> Vec<Option<Ball>> {
    covers
        .par_iter()
        .map(|cover| {
            if cover.radius <= 0.0 {
                return None;
            }
            let choose = |problem: &LocalProblem| {
                smoothing::choose_tau2(problem, cover.radius, levels.tau2, Some(levels.tau2))
            };
            let thinned = cover.thinned();
            let sketch = thinned
                .as_ref()
                .map(|cover| choose(&smoothing::problem(kernel, data, cover, levels)));
            let problem = smoothing::problem(kernel, data, cover, levels);
            let tau2 = sketch.unwrap_or_else(|| choose(&problem));
            let fit = problem.solve(smoothing::local_tau2(&problem, cover.radius, tau2))?;
            Some(Ball {
                centre: cover.centre,
                radius: cover.radius,
                fit,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::OrientedPoint;
    use rand::{RngExt, SeedableRng};

    fn contact(position: Vec3, normal: Vec3) -> OrientedPoint {
        OrientedPoint {
            position,
            normal,
            sigma: None,
            finger: None,
            time_us: None,
        }
    }

    /// Points of an ellipsoid with the given noise of positions and normals.
    fn ellipsoid(count: usize, noise: f64, tilt: f64, seed: u64) -> Cloud {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move || 2.0 * random.random::<f64>() - 1.0;
        let mut cloud = Cloud::default();
        while cloud.points.len() < count {
            let u = Vec3::new(uniform(), uniform(), uniform());
            if u.norm() > 1.0 || u.norm() < 0.1 {
                continue;
            }
            let u = u.normalize();
            let axes = Vec3::new(0.5, 0.35, 0.25);
            // Twelve uniform numbers with variance 1/3 each: normal enough, variance 4.
            let mut normal = || 0.5 * (0..12).map(|_| uniform()).sum::<f64>();
            let mut jitter = || Vec3::new(normal(), normal(), normal());
            let position = u.component_mul(&axes) + noise * jitter();
            let normal = u.component_div(&axes).normalize() + tilt * jitter();
            cloud.points.push(contact(position, normal.normalize()));
        }
        cloud
    }

    fn distance(x: &Vec3) -> f64 {
        let axes = Vec3::new(0.5, 0.35, 0.25);
        let k = x.component_div(&axes).norm();
        k * (k - 1.0) / x.component_div(&axes.component_mul(&axes)).norm()
    }

    /// Euler characteristic; panics where an edge has not exactly two faces.
    fn euler(mesh: &TriangleMesh) -> i64 {
        let mut edges = std::collections::BTreeMap::new();
        for f in &mesh.faces {
            for i in 0..3 {
                *edges.entry((f[i], f[(i + 1) % 3])).or_insert(0) += 1;
            }
        }
        for (&(a, b), &n) in &edges {
            assert_eq!((n, edges.get(&(b, a))), (1, Some(&1)));
        }
        mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.faces.len() as i64
    }

    #[test]
    fn a_noisy_ellipsoid_comes_back_closed_and_far_truer_than_its_contacts() {
        let (noise, tilt) = (0.005, 0.04);
        let result = extract(&ellipsoid(900, noise, tilt, 1), &Options::default()).unwrap();
        assert_eq!(euler(&result.mesh), 2);
        let squares: f64 = result
            .mesh
            .positions
            .iter()
            .map(|x| distance(x).powi(2))
            .sum();
        let rms = (squares / result.mesh.positions.len() as f64).sqrt();
        assert!(rms < 0.25 * noise, "{rms}");
        assert!(
            (result.noise.position_sigma / noise - 1.0).abs() < 0.15,
            "{:?}",
            result.noise
        );
        assert!(
            (result.noise.normal_sigma / tilt - 1.0).abs() < 0.15,
            "{:?}",
            result.noise
        );
    }

    #[test]
    fn exact_contacts_are_met_exactly() {
        let cloud = ellipsoid(700, 0.0, 0.0, 2);
        let result = extract(&cloud, &Options::default()).unwrap();
        for p in &cloud.points {
            assert!(result.field.value(&p.position).abs() < 1e-5);
            assert!((result.field.gradient(&p.position) - p.normal).norm() < 1e-3);
        }
        let worst = result
            .mesh
            .positions
            .iter()
            .map(|x| distance(x).abs())
            .fold(0.0, f64::max);
        assert!(worst < 5e-4, "{worst}");
    }

    #[test]
    fn the_result_follows_unit_and_place_of_the_input() {
        let cloud = ellipsoid(300, 0.003, 0.02, 3);
        let mut moved = cloud.clone();
        let shift = Vec3::new(1000.0, -2000.0, 500.0);
        for p in &mut moved.points {
            p.position = p.position * 512.0 + shift;
        }
        let here = extract(&cloud, &Options::default()).unwrap();
        let there = extract(&moved, &Options::default()).unwrap();
        assert_eq!(here.mesh.faces.len(), there.mesh.faces.len());
        for (a, b) in here.mesh.positions.iter().zip(&there.mesh.positions) {
            assert!((a * 512.0 + shift - b).norm() < 1e-4);
        }
    }

    #[test]
    fn false_contacts_are_found_and_do_no_harm() {
        let (noise, tilt) = (0.005, 0.04);
        let clean = ellipsoid(900, noise, tilt, 6);
        let mut spoilt = clean.clone();
        let mut bad = Vec::new();
        for i in (10..900).step_by(20) {
            let p = &mut spoilt.points[i];
            match i / 20 % 3 {
                0 => p.normal = -p.normal,
                1 => p.position += 12.0 * noise * p.normal,
                _ => {
                    let at = |step: f64| (i as f64 * step).fract() - 0.5;
                    p.position = Vec3::new(at(0.618), 0.8 * at(0.755), 0.8 * at(0.57));
                }
            }
            bad.push(i);
        }
        let rms = |cloud: &Cloud| {
            let result = extract(cloud, &Options::default()).unwrap();
            assert_eq!(euler(&result.mesh), 2);
            let squares: f64 = result
                .mesh
                .positions
                .iter()
                .map(|x| distance(x).powi(2))
                .sum();
            (
                (squares / result.mesh.positions.len() as f64).sqrt(),
                result.outliers,
            )
        };
        let (before, none) = rms(&clean);
        let (after, found) = rms(&spoilt);
        assert!(none.len() <= 1, "{none:?}");
        let missed = bad.iter().filter(|i| !found.contains(i)).count();
        let wrong = found.iter().filter(|i| !bad.contains(i)).count();
        assert!(
            missed <= 2 && wrong <= 2,
            "missed {missed}, wrongly {wrong}"
        );
        assert!(after < 1.3 * before, "{before} {after}");
    }

    #[test]
    fn a_false_contact_that_stands_alone_is_found_though_the_field_gives_way_to_it() {
        let (noise, tilt) = (0.005, 0.04);
        let mut cloud = ellipsoid(600, noise, tilt, 8);
        let mut bad = Vec::new();
        for i in (10..600).step_by(60) {
            let p = &mut cloud.points[i];
            // Nobody is left near it, and it leans away, so that no neighbour sees it on the wrong side.
            p.position += 12.0 * noise * p.normal;
            p.normal = (p.normal + p.normal.cross(&Vec3::new(0.3, 0.5, 0.8)).normalize() * 2.5)
                .normalize();
            bad.push(p.position);
        }
        cloud.points.retain(|p| {
            bad.iter()
                .all(|b| *b == p.position || (b - p.position).norm() > 0.06)
        });
        let found = extract(&cloud, &Options::default()).unwrap().outliers;
        let found: Vec<Vec3> = found.iter().map(|i| cloud.points[*i].position).collect();
        let missed = bad.iter().filter(|b| !found.contains(b)).count();
        assert!(
            missed <= 1 && found.len() <= bad.len() + 1,
            "{missed} of {}: {found:?}",
            bad.len()
        );
    }

    /// The number of border loops; panics where an edge has more than two faces or a vertex more than one fan.
    fn border_loops(mesh: &TriangleMesh) -> usize {
        let mut next = std::collections::BTreeMap::new();
        let mut edges = std::collections::BTreeSet::new();
        for f in &mesh.faces {
            for i in 0..3 {
                assert!(
                    edges.insert((f[i], f[(i + 1) % 3])),
                    "an edge is used twice"
                );
            }
        }
        for &(a, b) in &edges {
            if !edges.contains(&(b, a)) {
                assert!(next.insert(a, b).is_none(), "two borders meet at a vertex");
            }
        }
        let mut loops = 0;
        while let Some((&start, _)) = next.first_key_value() {
            let mut at = start;
            while let Some(to) = next.remove(&at) {
                at = to;
            }
            assert_eq!(at, start);
            loops += 1;
        }
        loops
    }

    #[test]
    fn a_half_touched_ellipsoid_ends_in_one_border_at_the_last_contacts() {
        let mut cloud = ellipsoid(1400, 0.004, 0.04, 7);
        cloud.points.retain(|p| p.position.x < 0.1);
        let result = extract(&cloud, &Options::default()).unwrap();
        assert_eq!(border_loops(&result.mesh), 1);
        assert!(result.holes.iter().any(|h| !h.closed));
        for x in &result.mesh.positions {
            assert!(x.x < 0.13 && distance(x).abs() < 0.01, "{x:?}");
        }
        let most = result
            .mesh
            .positions
            .iter()
            .map(|x| x.x)
            .fold(-1.0, f64::max);
        assert!(most > 0.08);
    }

    #[test]
    fn a_border_runs_straight_from_one_outermost_contact_to_the_next() {
        // A square sheet whose last contacts at x = 1 are far apart.
        let mut cloud = Cloud::default();
        for i in 0..=25 {
            for j in 0..=25 {
                let x = Vec3::new(0.04 * f64::from(i), 0.04 * f64::from(j), 0.0);
                if x.x < 0.93 || j % 5 == 0 {
                    cloud.points.push(contact(x, Vec3::z()));
                }
            }
        }
        let result = extract(&cloud, &Options::default()).unwrap();
        assert_eq!(border_loops(&result.mesh), 1);
        let mesh = &result.mesh.positions;
        // A disc of 3.3 spacings would dip by about 0.05 between contacts 0.2 apart.
        for middle in [0.3, 0.5, 0.7] {
            let beside = mesh.iter().filter(|x| (x.y - middle).abs() < 0.03);
            let most = beside.map(|x| x.x).fold(0.0, f64::max);
            assert!((0.975..1.01).contains(&most), "{most} beside {middle}");
        }
    }

    #[test]
    fn a_noisy_border_runs_near_the_rim_between_sparse_contacts() {
        // A bowed disc; a closing of its contacts dips by 0.03 between them, 0.012 in the mean.
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(6);
        let mut bell = move |sigma: f64| {
            let sum: f64 = (0..12).map(|_| random.random::<f64>()).sum();
            sigma * (sum - 6.0)
        };
        let golden = std::f64::consts::TAU * 0.618_033_988_75;
        let mut cloud = Cloud::default();
        for k in 0..900 {
            // Random radius, so that not all come to the same distance from the rim.
            let share = (f64::from(k) + 0.5 + bell(20.0)) / 900.0;
            let radius = 0.5 * (1.0 - (1.0 - share).abs()).max(0.0).sqrt();
            let (sin, cos) = (golden * f64::from(k)).sin_cos();
            let x = Vec3::new(radius * cos, radius * sin, 0.3 * radius * radius);
            let normal = Vec3::new(-0.6 * x.x + bell(0.04), -0.6 * x.y + bell(0.04), 1.0);
            let noise = Vec3::new(bell(0.008), bell(0.008), bell(0.008));
            cloud.points.push(contact(x + noise, normal.normalize()));
        }
        let mesh = extract(&cloud, &Options::default()).unwrap().mesh;
        assert_eq!(border_loops(&mesh), 1);
        let half = crate::mesh::HalfEdgeMesh::new(&mesh).unwrap();
        let off: Vec<f64> = (0..mesh.positions.len() as u32)
            .filter(|v| half.is_border_vertex(*v))
            .map(|v| mesh.positions[v as usize].xy().norm() - 0.5)
            .collect();
        let rms = (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt();
        let most = off.iter().fold(0.0, |m, d| f64::max(m, d.abs()));
        assert!(rms < 0.007 && most < 0.016, "{rms} {most}");
    }

    #[test]
    fn a_hole_is_closed_up_to_the_widest_gap_asked_for() {
        let mut cloud = ellipsoid(1400, 0.002, 0.02, 8);
        cloud
            .points
            .retain(|p| (p.position - Vec3::new(0.0, 0.0, 0.25)).norm() > 0.16);
        let with = |max_gap| {
            let options = Options {
                max_gap,
                ..Options::default()
            };
            extract(&cloud, &options).unwrap()
        };
        for (gap, loops) in [(None, 0), (Some(0.4), 0), (Some(0.22), 1)] {
            let result = with(gap);
            assert_eq!(
                border_loops(&result.mesh),
                loops,
                "{gap:?} {:?}",
                result.holes
            );
        }
    }

    #[test]
    fn two_objects_become_two_closed_components() {
        let mut cloud = ellipsoid(500, 0.003, 0.03, 9);
        let shift = Vec3::new(0.3, 0.2, 0.8);
        let other = ellipsoid(500, 0.003, 0.03, 10).points;
        cloud.points.extend(other.into_iter().map(|mut p| {
            p.position += shift;
            p
        }));
        let result = extract(&cloud, &Options::default()).unwrap();
        assert_eq!(euler(&result.mesh), 4);
        for x in &result.mesh.positions {
            assert!(distance(x).abs().min(distance(&(x - shift)).abs()) < 0.01);
        }
    }

    #[test]
    fn the_papers_tangent_planes_give_a_closed_mesh_too() {
        let options = Options {
            method: Method::TangentPlanes,
            ..Options::default()
        };
        let result = extract(&ellipsoid(900, 0.002, 0.02, 11), &options).unwrap();
        assert_eq!(euler(&result.mesh), 2);
        for x in &result.mesh.positions {
            assert!(distance(x).abs() < 0.03);
        }
    }

    #[test]
    fn memory_is_refused_before_it_is_taken_and_options_are_checked() {
        let cloud = ellipsoid(200, 0.0, 0.0, 12);
        let with = |options: Options| extract(&cloud, &options).map(|_| ());
        let fine = Options {
            spacing: Some(1e-6),
            ..Options::default()
        };
        assert!(matches!(
            with(fine),
            Err(ExtractError::TooMuchMemory { .. })
        ));
        for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            let spacing = Options {
                spacing: Some(bad),
                ..Options::default()
            };
            assert!(matches!(
                with(spacing),
                Err(ExtractError::BadOption {
                    name: "spacing",
                    ..
                })
            ));
        }
    }

    #[test]
    fn confidence_is_best_on_the_contacts_and_worse_in_a_gap() {
        let mut cloud = ellipsoid(900, 0.005, 0.04, 13);
        let middle = Vec3::new(0.0, 0.0, 0.25);
        cloud.points.retain(|p| (p.position - middle).norm() > 0.12);
        let field = extract(&cloud, &Options::default()).unwrap().field;
        let on = field.confidence(&Vec3::new(0.0, 0.0, -0.25));
        assert!(on > 0.0002 && on < 0.005, "{on}");
        assert!(field.confidence(&middle) > 1.5 * on);
    }

    #[test]
    fn inputs_without_a_surface_are_refused_with_the_reason() {
        let with = |points: Vec<OrientedPoint>| {
            let cloud = Cloud {
                points,
                rejected: Vec::new(),
            };
            extract(&cloud, &Options::default()).map(|_| ())
        };
        let up = Vec3::z();
        for found in 0..LEAST_CONTACTS {
            let points = vec![contact(up, up); found];
            assert_eq!(with(points), Err(ExtractError::TooFewContacts { found }));
        }
        assert_eq!(
            with(vec![contact(up, up); 20]),
            Err(ExtractError::NoExtent { what: "point" })
        );
        let line = |i: usize| contact(Vec3::new(i as f64, 2.0 * i as f64, 1.0), up);
        assert_eq!(
            with((0..20).map(line).collect()),
            Err(ExtractError::NoExtent { what: "line" })
        );
        let mut points = ellipsoid(20, 0.0, 0.0, 4).points;
        points[7].normal = Vec3::zeros();
        assert_eq!(
            with(points.clone()),
            Err(ExtractError::NotFinite { index: 7 })
        );
        points[7] = contact(Vec3::new(f64::NAN, 0.0, 0.0), up);
        assert_eq!(with(points), Err(ExtractError::NotFinite { index: 7 }));
    }

    #[test]
    fn strange_clouds_end_in_a_result_or_an_error() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut uniform = move || 2.0 * random.random::<f64>() - 1.0;
        for count in [6, 7, 9, 20, 60] {
            for flat in [1.0, 1e-9, 0.0] {
                for scale in [1e-120, 1.0, 1e120] {
                    let points = (0..count)
                        .map(|_| {
                            let p = Vec3::new(uniform(), uniform(), flat * uniform());
                            contact(p * scale, Vec3::new(uniform(), uniform(), uniform()))
                        })
                        .collect();
                    let cloud = Cloud {
                        points,
                        rejected: Vec::new(),
                    };
                    if let Ok(result) = extract(&cloud, &Options::default()) {
                        let finite = |p: &Vec3| p.iter().all(|x| x.is_finite());
                        assert!(result.mesh.positions.iter().all(finite));
                    }
                }
            }
        }
    }
}
