//! Well-shaped triangles: flips towards the ideal valence, tangential smoothing with reprojection onto
//! the surface, long edges split, short ones collapsed (after Botsch and Kobbelt 2004, with the sizing field and
//! feature lines added).

use super::decimate::collapse_best;
use super::work::{Candidate, Work};
use crate::Vec3;
use crate::mesh::{Freedom, HalfEdgeMesh};

/// Edges stretched beyond this are split. 4/3 is where halving brings the length nearer to 1.
const SPLIT_ABOVE: f64 = 1.5;
/// Edges stretched less than this are collapsed.
const COLLAPSE_BELOW: f64 = 0.6;
/// No move may leave a face poorer than this, unless it was poorer before.
const FITNESS_MIN: f64 = 0.45;

/// `rounds` rounds of split, collapse, flip and smooth.
pub(super) fn relax(work: &mut Work<'_>, rounds: usize) {
    for round in 0..rounds {
        if round + 2 < rounds {
            split_long(work);
            collapse_short(work);
        }
        equalise_valences(work, FITNESS_MIN);
        smooth(work, round + 1 == rounds);
    }
}

/// Puts every vertex that is free on the surface down onto it, wherever an optimization left it.
pub(super) fn land(work: &mut Work<'_>) {
    for v in 0..work.mesh.vertex_slots() as u32 {
        if work.mesh.has_vertex(v) && work.mesh.freedom(v) == Freedom::Surface {
            // What was fit before may not be so on the surface; the rounds that follow mend that.
            let p = work.mesh.position(v);
            work.settle(v, &p, true);
        }
    }
}

fn split_long(work: &mut Work<'_>) {
    let mut long: Vec<(f64, u32)> = work
        .mesh
        .edges()
        .map(|h| (work.stretch(h), h))
        .filter(|(s, _)| *s > SPLIT_ABOVE)
        .collect();
    long.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, h) in long {
        if work.mesh.is_live(h) && work.stretch(h) > SPLIT_ABOVE {
            work.split(h);
        }
    }
}

fn collapse_short(work: &mut Work<'_>) {
    let mut short: Vec<(f64, u32)> = work
        .mesh
        .edges()
        .map(|h| (work.stretch(h), h))
        .filter(|(s, _)| *s < COLLAPSE_BELOW)
        .collect();
    short.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, h) in short {
        if work.mesh.is_live(h) && work.stretch(h) < COLLAPSE_BELOW {
            collapse_best(work, h, 1.4, FITNESS_MIN);
        }
    }
}

/// Flips every edge whose flip brings the four valences nearer to their ideal, until none does.
pub(super) fn equalise_valences(work: &mut Work<'_>, least: f64) {
    for _ in 0..4 {
        let mut flips = 0;
        for h in 0..3 * work.mesh.face_slots() as u32 {
            if !work.mesh.is_live(h) || work.mesh.twin(h) < h || work.mesh.may_flip(h).is_err() {
                continue;
            }
            if flip_gain(work, h, least) {
                flips += usize::from(work.mesh.flip(h).is_ok());
            }
        }
        if flips == 0 {
            break;
        }
    }
}

/// Whether flipping the edge of `h` betters the valences, or leaves them and betters the faces.
fn flip_gain(work: &Work<'_>, h: u32, least: f64) -> bool {
    let mesh = &work.mesh;
    let t = mesh.twin(h);
    let (a, b, c, d) = (
        mesh.origin(h),
        mesh.destination(h),
        mesh.apex(h),
        mesh.apex(t),
    );
    let off = |v: u32, change: i64| {
        let off = mesh.valence(v) as i64 + change - work.ideal_valence(v);
        off * off
    };
    let before = off(a, 0) + off(b, 0) + off(c, 0) + off(d, 0);
    let after = off(a, -1) + off(b, -1) + off(c, 1) + off(d, 1);
    if after > before {
        return false;
    }
    let region = work.region[(h / 3) as usize];
    let fit = |ids: [u32; 3]| work.fitness(&Candidate { ids, region });
    let (Some(one), Some(other)) = (fit([a, d, c]), fit([b, c, d])) else {
        return false;
    };
    let now = work.fitness(&work.face(h / 3)).unwrap_or(0.0);
    let now = now.min(work.fitness(&work.face(t / 3)).unwrap_or(0.0));
    let then = one.min(other);
    if after == before {
        then > now + 0.1
    } else {
        then >= least.min(now)
    }
}

/// Moves every vertex towards the middle of its star, along the surface or along its line.
fn smooth(work: &mut Work<'_>, fine: bool) {
    for v in 0..work.mesh.vertex_slots() as u32 {
        if !work.mesh.has_vertex(v) {
            continue;
        }
        match work.mesh.freedom(v) {
            Freedom::Fixed => {}
            Freedom::Curve => smooth_along_line(work, v),
            Freedom::Surface => smooth_on_surface(work, v, fine),
        }
    }
}

fn smooth_on_surface(work: &mut Work<'_>, v: u32, fine: bool) {
    let p = work.mesh.position(v);
    let (mut sum, mut weight) = (Vec3::zeros(), 0.0);
    for h in work.mesh.around(v) {
        let f = h / 3;
        let ids = work.mesh.face_vertices(f);
        let corners = work.mesh.corners(f);
        let (_, w) = work.metric_shape(ids, &corners);
        sum += (corners[0] + corners[1] + corners[2]) * (w / 3.0);
        weight += w;
    }
    if weight.is_nan() || weight <= 0.0 {
        return;
    }
    let n = work.single_normal(v);
    let step = sum / weight - p;
    let tangential = step - n * step.dot(&n);
    try_moves(work, v, p, tangential, |work, q| work.settle(v, q, fine));
}

fn smooth_along_line(work: &mut Work<'_>, v: u32) {
    let p = work.mesh.position(v);
    let ends: Vec<u32> = work
        .mesh
        .features_at(v)
        .map(|h| work.mesh.other_end(h, v))
        .collect();
    let [a, b] = ends.as_slice() else {
        return;
    };
    let (pa, pb) = (work.mesh.position(*a), work.mesh.position(*b));
    let (la, lb) = (work.stretch_between(v, *a), work.stretch_between(v, *b));
    // Along the longer arm until both are equally stretched.
    let step = if la > lb {
        (pa - p) * (0.5 * (1.0 - lb / la))
    } else if lb > 0.0 {
        (pb - p) * (0.5 * (1.0 - la / lb))
    } else {
        return;
    };
    try_moves(work, v, p, step, |work, q| work.slide(v, q));
}

/// Tries the whole step, then half of it, then a quarter; goes back if the star gets worse than allowed.
fn try_moves(
    work: &mut Work<'_>,
    v: u32,
    p: Vec3,
    step: Vec3,
    place: impl Fn(&mut Work<'_>, &Vec3) -> bool,
) {
    let before = work.star_fitness(v);
    let kept = work.attributes(v);
    for share in [0.8, 0.4, 0.2] {
        if !place(work, &(p + step * share)) {
            break;
        }
        let after = work.star_fitness(v);
        if after >= FITNESS_MIN.min(before) && after > 0.0 {
            return;
        }
        if before == 0.0 && share < 0.3 {
            // Broken as it was: the short step can only help.
            return;
        }
        work.restore(v, &kept);
    }
    work.restore(v, &kept);
}

/// Ends valences below 4 and above 8 where that is possible: first by flips at the price of poorer
/// faces, then by collapsing an edge of the vertex (below 4) or splitting its longest opposite edge's
/// neighbour (above 8).
pub(super) fn mend_valences(work: &mut Work<'_>) {
    for _ in 0..3 {
        let bad: Vec<u32> = work
            .mesh
            .vertices()
            .filter(|v| badness(work, *v) > 0)
            .collect();
        if bad.is_empty() {
            return;
        }
        for v in bad {
            if !work.mesh.has_vertex(v) || badness(work, v) == 0 {
                continue;
            }
            if work.mesh.valence(v) < 4 {
                mend_low(work, v);
            } else {
                mend_high(work, v);
            }
        }
        for v in 0..work.mesh.vertex_slots() as u32 {
            if work.mesh.has_vertex(v) && work.mesh.freedom(v) == Freedom::Surface {
                smooth_on_surface(work, v, true);
            }
        }
    }
}

/// By how much an interior vertex off all features misses valences 4 to 8.
fn badness(work: &Work<'_>, v: u32) -> usize {
    if work.mesh.freedom(v) != Freedom::Surface {
        return 0;
    }
    let valence = work.mesh.valence(v);
    4usize.saturating_sub(valence) + valence.saturating_sub(8)
}

/// Flips the edge of `h` if its faces will be worth `least` and the valences at them get better.
fn flip_if(work: &mut Work<'_>, h: u32, least: f64) -> bool {
    if work.mesh.may_flip(h).is_err() {
        return false;
    }
    let four = [
        work.mesh.origin(h),
        work.mesh.destination(h),
        work.mesh.apex(h),
        work.mesh.apex(work.mesh.twin(h)),
    ];
    let sum = |work: &Work<'_>| four.iter().map(|v| badness(work, *v)).sum::<usize>();
    let before = sum(work);
    flip_unless(work, h, least, |work| sum(work) >= before)
}

/// Flips the edge of `h` if its faces will be worth `least`, and back if the mesh is `worse` then.
fn flip_unless(work: &mut Work<'_>, h: u32, least: f64, worse: impl Fn(&Work<'_>) -> bool) -> bool {
    if work.mesh.may_flip(h).is_err() {
        return false;
    }
    let t = work.mesh.twin(h);
    let (a, b, c, d) = (
        work.mesh.origin(h),
        work.mesh.destination(h),
        work.mesh.apex(h),
        work.mesh.apex(t),
    );
    let region = work.region[(h / 3) as usize];
    let fit = |ids: [u32; 3]| work.fitness(&Candidate { ids, region }).unwrap_or(0.0);
    if fit([a, d, c]).min(fit([b, c, d])) < least || work.mesh.flip(h).is_err() {
        return false;
    }
    if worse(work) {
        // The same edge back: `flip` twice turns it by a whole half.
        let _ = work.mesh.flip(h);
        return false;
    }
    true
}

fn mend_low(work: &mut Work<'_>, v: u32) {
    // An edge opposite to `v`, flipped, ends at `v`.
    let opposite: Vec<u32> = work.mesh.around(v).map(HalfEdgeMesh::next).collect();
    if opposite.into_iter().any(|h| flip_if(work, h, 0.25)) {
        return;
    }
    let spokes: Vec<u32> = work.mesh.around(v).collect();
    for h in spokes {
        let kept = work.mesh.destination(h);
        let position = work.mesh.position(kept);
        if work.mesh.may_collapse(h).is_ok() && work.collapse_fitness(v, kept, 2.0).is_some() {
            let _ = work.mesh.collapse(h, position);
            return;
        }
    }
}

fn mend_high(work: &mut Work<'_>, v: u32) {
    let spokes: Vec<u32> = work.mesh.around(v).collect();
    for h in spokes {
        if work.mesh.is_live(h) && flip_if(work, h, 0.25) {
            return;
        }
    }
    // Split the longest spoke: its middle takes over two neighbours by later flips.
    let longest = work
        .mesh
        .around(v)
        .max_by(|a, b| work.stretch(*a).total_cmp(&work.stretch(*b)));
    if let Some(h) = longest
        && let Some(m) = work.split(h)
    {
        let around: Vec<u32> = work.mesh.around(m).collect();
        for g in around {
            // Edges of `v` next to the split one, flipped away from `v`.
            let side = HalfEdgeMesh::next(g);
            if work.mesh.is_live(side)
                && (work.mesh.origin(side) == v || work.mesh.destination(side) == v)
            {
                flip_if(work, side, 0.2);
            }
        }
    }
}

/// Opens ears: faces with two edges of one smooth line. The patch there would have a corner of 180 degrees, in which its
/// Jacobian is 0. The edge opposite to that corner is flipped, or split where a flip would leave poor faces or another ear.
pub(super) fn open_ears(work: &mut Work<'_>) {
    // A face with three edges of lines takes three rounds.
    for _ in 0..3 {
        let ears: Vec<u32> = (0..3 * work.mesh.face_slots() as u32)
            .filter(|h| work.mesh.is_live(*h) && is_ear(work, *h))
            .collect();
        if ears.is_empty() {
            return;
        }
        let mut middles = Vec::new();
        for h in ears {
            if work.mesh.is_live(h) && is_ear(work, h) && !flip_open(work, h) {
                middles.extend(work.split(HalfEdgeMesh::next(h)));
            }
        }
        for v in middles {
            if work.mesh.has_vertex(v) && work.mesh.freedom(v) == Freedom::Surface {
                smooth_on_surface(work, v, true);
            }
        }
    }
}

/// Whether the face of `h` is an ear at the origin of `h`.
fn is_ear(work: &Work<'_>, h: u32) -> bool {
    work.mesh.freedom(work.mesh.origin(h)) == Freedom::Curve
        && work.mesh.is_feature(h)
        && work.mesh.is_feature(HalfEdgeMesh::prev(h))
}

/// Flips the edge opposite to the ear at the origin of `h`, if that makes no other ear.
fn flip_open(work: &mut Work<'_>, h: u32) -> bool {
    let opposite = HalfEdgeMesh::next(h);
    let ends = [work.mesh.origin(opposite), work.mesh.destination(opposite)];
    flip_unless(work, opposite, 0.25, |work| {
        let ear_at = |v: &u32| work.mesh.around(*v).any(|h| is_ear(work, h));
        ends.iter().any(ear_at)
    })
}
