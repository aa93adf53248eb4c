//! Contacts foretold in the gaps of thin walls and tubes, each from the contacts of its own side alone.
//!
//! Through a thin wall a local fit hears the contacts of both sides. Between them its field has a ridge, which no smooth
//! function has; where one side has a gap wider than the wall is thick, the other side's contacts have the last word
//! there, and the surface bulges or falls in (a mug with exact contacts: 0.16 of its size off a gap 0.3 wide). What
//! goes on across such a gap is the side on which it lies. So a place in the gap is foretold from the contacts that face
//! the way of that side, and takes part in all later fits as a contact, with the uncertainty that it was foretold with.
//!
//! Two ways were weighed: to give every side of a wall fits of its own and let their fields compete (as
//! sheets do that meet in creases; along rims and around tubes sides turn into one another, and nothing says where one
//! ends), and this one, which leaves the field as it is. Where no other side is near nothing is foretold: a place
//! foretold from the same contacts as the field tells it nothing new.

use rayon::prelude::*;

use super::{
    contacts::Normalised,
    kernel::Kernel,
    smoothing::{self, Apart, Cover, Levels},
    try_balls,
};
use crate::{Vec3, cloud::Neighbourhoods};

/// Contacts of its own side from which a place is foretold.
const WITNESSES: usize = 24;
/// Contacts among which they are sought; the more where the other sides have more.
const ASKED: [usize; 2] = [72, 240];
/// Cosine between normals of one side, at least, and of opposite sides, at most.
const SAME: f64 = 0.2;
const OPPOSITE: f64 = -0.5;
/// Distance of a place from the contact next to which it is sought, least one from all contacts of its side, and from other
/// places of its side, in spacings.
const STEP: f64 = 1.6;
const CLEAR: f64 = 1.1;
const APART: f64 = 1.3;
/// Rings of places from the rim of a gap inwards; the last meets in the middle of the widest gap that is closed.
const RINGS: usize = 3;
/// A foretold place is believed up to this uncertainty, and this far from the plane of the contact beside it, in spacings.
/// Bent rims and tubes are foretold badly (the mug with 1229 noisy contacts: 0.02 off with looser bounds, and its surface by
/// 17e-3 of the diagonal instead of 7e-3).
const SURE: f64 = 0.4;
const RISE: f64 = 0.35;
/// The uncertainty where another side's contacts are nearer than its own: anything is better there than to follow those (a
/// wall of 0.07 with a gap of 0.3: surface off by 122e-3, 14e-3 with this).
const SURE_ALONE: f64 = 0.6;
/// Contacts that face across are asked within this distance, and take what lies within this of their plane for neither side,
/// in spacings.
const ACROSS: f64 = 4.0;
const LEVEL: f64 = 0.2;
/// Standard deviations that such a fit promises, against those it keeps ([`super::outliers`] has the like).
const TRUST: f64 = 2.0;
/// Quadratic polynomials go on past the last contact without swinging, as for sheets.
const KERNEL: Kernel = Kernel::Quintic;

/// A place in a gap, before it is foretold.
struct Place {
    at: Vec3,
    /// Normal of the contact beside it, which tells its side.
    facing: Vec3,
    beside: Vec3,
}

/// The ball of contacts that a place is foretold from.
struct Witnesses {
    cover: Cover,
    /// Whether a contact of another side is nearer than all of them.
    alone: bool,
}

/// The contacts, and after them those that are foretold in the gaps of thin walls.
pub(super) fn bridged(
    data: &Normalised,
    tree: &Neighbourhoods,
    levels: &Levels,
    spacing: f64,
) -> Normalised {
    let mut out = data.clone();
    let mut begin = 0;
    let mut common: Option<Levels> = None;
    for _ in 0..RINGS {
        let all = Neighbourhoods::new(out.positions.clone());
        let places = places(&out, begin, &all, spacing);
        let (places, covers): (Vec<(Place, bool)>, Vec<Cover>) = places
            .into_iter()
            .filter_map(|place| {
                let Witnesses { cover, alone } = witnesses(data, tree, &place)?;
                Some(((place, alone), cover))
            })
            .unzip();
        if covers.is_empty() {
            break;
        }
        let levels = *common
            .get_or_insert_with(|| smoothing::with_smoothness(KERNEL, data, &covers, levels));
        begin = out.positions.len();
        let balls = try_balls(KERNEL, data, &covers, &levels);
        for ((place, alone), ball) in places.iter().zip(balls) {
            let Some(ball) = ball else { continue };
            let sure = if *alone { SURE_ALONE } else { SURE };
            let sigma = TRUST * ball.radius * ball.fit.centre_variance.sqrt();
            let foretold = foot(&place.at, |x| ball.value_and_gradient(x));
            let Some((at, normal)) = foretold.filter(|_| sigma <= sure * spacing) else {
                continue;
            };
            let rise = (at - place.at).norm();
            if rise > RISE * spacing
                || normal.dot(&place.facing) < SAME
                || !on_its_side(&at, &normal, place, (data, tree), spacing)
            {
                continue;
            }
            out.positions.push(at);
            out.normals.push(normal);
            out.relative_sigma
                .push((sigma / levels.position_sigma).max(1.0));
            let tilt = sigma / (spacing * levels.normal_sigma);
            out.relative_tilt.push(tilt.max(1.0));
            out.source.push(usize::MAX);
        }
    }
    out
}

/// Places in the tangent planes of the contacts from number `begin` on where no contact of their side is near.
fn places(data: &Normalised, begin: usize, tree: &Neighbourhoods, spacing: f64) -> Vec<Place> {
    let of_side = |facing: &Vec3, j: usize| data.normals[j].dot(facing) > SAME;
    let candidates: Vec<Place> = (begin..data.positions.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let (beside, facing) = (data.positions[i], data.normals[i]);
            smoothing::around(beside, facing, STEP * spacing).filter_map(move |at| {
                let near = tree.within(&at, CLEAR * spacing);
                let free = near.iter().all(|(j, _)| !of_side(&facing, *j));
                free.then_some(Place { at, facing, beside })
            })
        })
        .collect();
    let mut taken = Apart::by(APART * spacing);
    let apart = |place: &Place| {
        let same_side = |facing: &Vec3| facing.dot(&place.facing) > SAME;
        taken.take(&place.at, place.facing, same_side)
    };
    candidates.into_iter().filter(apart).collect()
}

/// The ball of contacts that a place is foretold from; `None` without enough of them, or without another side as near.
fn witnesses(data: &Normalised, tree: &Neighbourhoods, place: &Place) -> Option<Witnesses> {
    let facing = |j: usize| data.normals[j].dot(&place.facing);
    let (near, own) = ASKED.into_iter().find_map(|asked| {
        let near = tree.nearest(&place.at, asked);
        let own: Vec<(usize, f64)> = (near.iter().copied())
            .filter(|(j, _)| facing(*j) > SAME)
            .take(WITNESSES)
            .collect();
        (own.len() == WITNESSES).then_some((near, own))
    })?;
    let farthest = own[WITNESSES - 1].1;
    let another = |(j, d2): &&(usize, f64)| *d2 < farthest && facing(*j) < OPPOSITE;
    let nearest = near.iter().find(another)?;
    Some(Witnesses {
        cover: Cover {
            centre: place.at,
            radius: 1.0001 * farthest.sqrt(),
            members: own.iter().map(|(j, _)| *j as u32).collect(),
        },
        alone: nearest.1 < own[0].1,
    })
}

/// Newton's steps to the zero set, and the unit normal there.
fn foot(start: &Vec3, jet: impl Fn(&Vec3) -> (f64, Vec3)) -> Option<(Vec3, Vec3)> {
    let mut at = *start;
    for _ in 0..4 {
        let (value, gradient) = jet(&at);
        at -= gradient * (value / gradient.norm_squared());
    }
    let (_, gradient) = jet(&at);
    let length = gradient.norm();
    let fine = at.iter().all(|x| x.is_finite()) && (0.5..2.0).contains(&length);
    fine.then(|| (at, gradient / length))
}

/// Whether the contacts around could lie on one surface with the place `at` and its `normal`.
///
/// Those of other sides have to see it as they see the contact beside it: behind them, through a wall, or before them, across
/// a slot; and some of them have to go on past it: where the other side ends, at a lip, so may this one (a lip of 0.025 with
/// none on it was carried on by 0.03, and the patches there shrank to nothing). Those that face across must not lie behind
/// its plane while it lies before theirs: so lies a face that is carried on past its edge into the air.
fn on_its_side(
    at: &Vec3,
    normal: &Vec3,
    place: &Place,
    contacts: (&Normalised, &Neighbourhoods),
    spacing: f64,
) -> bool {
    let (data, tree) = contacts;
    let mut goes_on = false;
    let fits = tree.nearest(at, WITNESSES).into_iter().all(|(j, d2)| {
        let (p, n) = (data.positions[j], data.normals[j]);
        let facing = n.dot(&place.facing);
        let height = |x: &Vec3| (x - p).dot(&n);
        if facing < OPPOSITE {
            goes_on |= (p - at).dot(&(at - place.beside)) > 0.0;
            height(at) * height(&place.beside) > 0.0
        } else if facing < SAME && d2 < (ACROSS * spacing).powi(2) {
            let level = LEVEL * spacing;
            height(at) < level || (p - at).dot(normal) > -level
        } else {
            true
        }
    });
    fits && goes_on
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPACING: f64 = 0.04;
    const LEVELS: Levels = Levels {
        position_sigma: 1e-3,
        normal_sigma: 1e-2,
        tau2: 1.0,
    };

    fn contacts(of: impl Iterator<Item = (Vec3, Vec3)>) -> Normalised {
        let (positions, normals): (Vec<Vec3>, Vec<Vec3>) = of.unzip();
        let count = positions.len();
        Normalised {
            positions,
            normals,
            relative_sigma: vec![1.0; count],
            relative_tilt: vec![1.0; count],
            source: (0..count).collect(),
        }
    }

    /// Places foretold for `data`, each with its normal and its uncertainty against that of a contact.
    fn foretold(data: &Normalised) -> Vec<(Vec3, Vec3, f64)> {
        let tree = Neighbourhoods::new(data.positions.clone());
        let all = bridged(data, &tree, &LEVELS, SPACING);
        (data.positions.len()..all.positions.len())
            .map(|i| (all.positions[i], all.normals[i], all.relative_sigma[i]))
            .collect()
    }

    fn grid(half: i32) -> impl Iterator<Item = (f64, f64)> + Clone {
        (-half..=half).flat_map(move |i| {
            (-half..=half).map(move |j| (SPACING * f64::from(i), SPACING * f64::from(j)))
        })
    }

    #[test]
    fn a_gap_in_one_side_of_a_thin_wall_is_filled_on_that_side() {
        // A bowed wall 0.05 thick, with a hole 0.32 wide in the contacts of its upper side.
        let height = |x: f64, y: f64| 0.3 * x * x + 0.1 * y * y;
        let up = |x: f64, y: f64| Vec3::new(-0.6 * x, -0.2 * y, 1.0).normalize();
        let upper = grid(9).filter(|(x, y)| x.hypot(*y) > 0.16);
        let upper = upper.map(|(x, y)| (Vec3::new(x, y, height(x, y)), up(x, y)));
        let lower = grid(9).map(|(x, y)| (Vec3::new(x, y, height(x, y) - 0.05), -up(x, y)));
        let found = foretold(&contacts(upper.chain(lower)));
        let hole: Vec<_> = found
            .iter()
            .filter(|(x, n, _)| x.xy().norm() < 0.16 && n.z > 0.0)
            .collect();
        assert!(hole.len() >= 8, "{}", hole.len());
        for (x, n, sigma) in &hole {
            let off = (x.z - height(x.x, x.y)).abs();
            assert!(
                off < 2e-3 && off < 3.0 * sigma * LEVELS.position_sigma,
                "{x:?} {off}"
            );
            assert!(n.dot(&up(x.x, x.y)) > 0.995 && *sigma >= 1.0);
        }
        let middle = hole.iter().filter(|(x, ..)| x.xy().norm() < 0.06).count();
        assert!(middle > 0, "the inner rings are missing");
    }

    #[test]
    fn the_faces_of_a_thin_bar_do_not_go_on_past_its_edges() {
        // A bar of square section, 0.12 wide, along y; the last contacts lie 0.03 from its edges.
        let at = [-0.03, 0.03];
        let bar = (-15..=15).flat_map(|j| {
            let y = SPACING * f64::from(j);
            at.into_iter().flat_map(move |s| {
                [-1.0, 1.0].into_iter().flat_map(move |side| {
                    [
                        (Vec3::new(s, y, 0.06 * side), Vec3::z() * side),
                        (Vec3::new(0.06 * side, y, s), Vec3::x() * side),
                    ]
                })
            })
        });
        for (x, ..) in foretold(&contacts(bar)) {
            let beyond = x.x.abs().max(x.z.abs()) - 0.06;
            assert!(beyond < 0.01 || x.y.abs() > 0.6, "{x:?}");
        }
    }

    #[test]
    fn where_no_other_side_is_near_nothing_is_foretold() {
        let sheet = grid(9).filter(|(x, y)| x.hypot(*y) > 0.1);
        let sheet = sheet.map(|(x, y)| (Vec3::new(x, y, 0.0), Vec3::z()));
        assert!(foretold(&contacts(sheet)).is_empty());
    }
}
