//! One finger moving along its itinerary, period by period: where the tip is, what it touches, how hard.

use super::finger::{Elbow, Reacher};
use super::itinerary::{BentLeg, Leg};
use super::object::{Foot, Object};
use super::track::Track;
use crate::Vec3;
use std::sync::Arc;

/// Periods in which the force rises after landing, and falls before taking off.
const RAMP: u32 = 8;
/// Periods of a swing from one bend to the other.
const SWING: u32 = 120;
/// Largest way of the tip through the air in one period, millimetres: 0.8 m/s at 200 Hz.
const FLIGHT_STEP_MM: f64 = 4.0;
/// How much further the force of a finger's servo strays than noise alone, as a share of the force, over
/// [`RIPPLE_PERIODS`].
const RIPPLE: f64 = 0.05;
/// Periods of one ripple of the force.
const RIPPLE_PERIODS: f64 = 37.0;

/// What happens to a finger in one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moment {
    /// Joint angles, rad.
    pub angles: [f64; 3],
    /// Centre of the tip, millimetres.
    pub centre_mm: Vec3,
    /// Where the object is touched; `None` in the air.
    pub contact: Option<Foot>,
    /// Normal force, N; 0 in the air.
    pub normal_force_n: f64,
    /// Direction in which the tip moves over the object; zero at rest.
    pub sliding: Vec3,
}

/// What a finger does in the course of time.
#[derive(Clone, Debug)]
enum Stage {
    Slide(Track),
    Flight {
        centres: Vec<Vec3>,
        way_mm: Vec<f64>,
    },
    Swing,
}

/// A finger on its way.
#[derive(Debug)]
pub(crate) struct Motion {
    object: Arc<Object>,
    reacher: Reacher,
    stages: Vec<(Stage, Elbow)>,
    tip_radius_mm: f64,
    force_n: f64,
    pace_mm: f64,
    stage: usize,
    period: u32,
    /// Progress within the stage, millimetres.
    progress_mm: f64,
    periods: u64,
    rounds: u64,
    last_centre_mm: Vec3,
}

/// Millimetres of sliding in an itinerary, as [`Track`] counts them.
pub(crate) fn sliding_mm(legs: &[BentLeg]) -> f64 {
    legs.iter()
        .map(|leg| match &leg.leg {
            Leg::Slide(path) => Track::new(path.clone()).length_mm(),
            Leg::Flight(_) | Leg::Swing(_) => 0.0,
        })
        .sum()
}

impl Motion {
    /// A finger at home, about to follow `legs` at `pace_mm` of sliding per period, pressing with `force_n`.
    pub(crate) fn new(
        object: Arc<Object>,
        reacher: Reacher,
        legs: Vec<BentLeg>,
        tip_radius_mm: f64,
        force_n: f64,
        pace_mm: f64,
    ) -> Self {
        let stages = legs
            .into_iter()
            .map(|BentLeg { leg, elbow }| {
                let stage = match leg {
                    Leg::Slide(path) => Stage::Slide(Track::new(path)),
                    Leg::Flight(centres) => {
                        let mut way_mm = vec![0.0; centres.len()];
                        for k in 1..centres.len() {
                            way_mm[k] = way_mm[k - 1] + (centres[k] - centres[k - 1]).norm();
                        }
                        Stage::Flight { centres, way_mm }
                    }
                    Leg::Swing(_) => Stage::Swing,
                };
                (stage, elbow)
            })
            .collect();
        let last_centre_mm = reacher.home_mm();
        Self {
            object,
            reacher,
            stages,
            tip_radius_mm,
            force_n,
            pace_mm,
            stage: 0,
            period: 0,
            progress_mm: 0.0,
            periods: 0,
            rounds: 0,
            last_centre_mm,
        }
    }

    /// How often the whole itinerary has been gone through.
    pub(crate) fn rounds(&self) -> u64 {
        self.rounds
    }

    /// The finger as the hand describes it.
    pub(crate) fn reacher(&self) -> &Reacher {
        &self.reacher
    }

    /// The finger waiting at home.
    pub(crate) fn at_home(&self) -> Moment {
        home(&self.reacher)
    }

    /// Back home, to begin anew.
    pub(crate) fn restart(&mut self) {
        self.stage = 0;
        self.period = 0;
        self.progress_mm = 0.0;
        self.last_centre_mm = self.reacher.home_mm();
    }

    /// The next period.
    pub(crate) fn step(&mut self) -> Moment {
        self.periods += 1;
        let Some((stage, elbow)) = self.stages.get(self.stage) else {
            self.rounds += 1;
            return self.at_home();
        };
        let elbow = *elbow;
        let ended;
        let moment = match stage {
            Stage::Slide(track) => {
                let length = track.length_mm();
                let landing = self.period < RAMP;
                if !landing {
                    self.progress_mm = (self.progress_mm + self.pace_mm).min(length);
                }
                // Once at the end, `period` counts on from the ramp's beginning.
                let arrived = !landing && self.progress_mm >= length;
                let since = if arrived { self.period - RAMP } else { 0 };
                let share = if landing {
                    f64::from(self.period + 1) / f64::from(RAMP)
                } else if arrived {
                    1.0 - f64::from(since + 1) / f64::from(RAMP)
                } else {
                    1.0
                };
                self.period += u32::from(landing || arrived);
                ended = arrived && since + 1 >= RAMP;
                let placement = track.at(&self.object, self.progress_mm, self.tip_radius_mm);
                let ripple = 1.0
                    + RIPPLE * (self.periods as f64 * std::f64::consts::TAU / RIPPLE_PERIODS).sin();
                placement.map(|placement| {
                    let moved = placement.centre_mm - self.last_centre_mm;
                    let normal = placement.foot.normal;
                    let along = moved - normal * moved.dot(&normal);
                    let force = self.force_n * share * ripple;
                    Moment {
                        angles: [0.0; 3],
                        centre_mm: placement.centre_mm,
                        contact: (force > 0.0).then_some(placement.foot),
                        normal_force_n: force.max(0.0),
                        sliding: if landing || arrived || along.norm() < 1e-9 {
                            Vec3::zeros()
                        } else {
                            along.normalize()
                        },
                    }
                })
            }
            Stage::Flight { centres, way_mm } => {
                let length = way_mm.last().copied().unwrap_or(0.0);
                self.progress_mm = (self.progress_mm + FLIGHT_STEP_MM).min(length);
                ended = self.progress_mm >= length;
                let next = way_mm.partition_point(|&w| w < self.progress_mm);
                let centre = if next == 0 || next >= centres.len() {
                    centres.get(next).or(centres.last()).copied()
                } else {
                    let share =
                        (self.progress_mm - way_mm[next - 1]) / (way_mm[next] - way_mm[next - 1]);
                    Some(centres[next - 1].lerp(&centres[next], share))
                };
                centre.map(|centre_mm| Moment {
                    angles: [0.0; 3],
                    centre_mm,
                    contact: None,
                    normal_force_n: 0.0,
                    sliding: Vec3::zeros(),
                })
            }
            Stage::Swing => {
                self.period += 1;
                ended = self.period >= SWING;
                let share = f64::from(self.period) / f64::from(SWING);
                Some(self.swinging(elbow, share))
            }
        };
        let swinging = matches!(stage, Stage::Swing);
        if ended {
            self.stage += 1;
            self.period = 0;
            self.progress_mm = 0.0;
            if self.stage >= self.stages.len() {
                self.stage = 0;
                self.rounds += 1;
            }
        }
        let Some(mut moment) = moment else {
            return self.at_home();
        };
        if !swinging {
            // The itinerary only goes where the finger can reach.
            if let Some(angles) = self.reacher.angles(&moment.centre_mm, elbow) {
                moment.angles = angles;
            }
        }
        moment
    }

    /// At home, on the way from one bend of the elbow to the other.
    fn swinging(&self, from: Elbow, share: f64) -> Moment {
        let home = self.reacher.home_mm();
        let to = match from {
            Elbow::Up => Elbow::Down,
            Elbow::Down => Elbow::Up,
        };
        let [from, to] = [from, to].map(|e| self.reacher.angles(&home, e).unwrap_or([0.0; 3]));
        let angles: [f64; 3] = std::array::from_fn(|k| from[k] + (to[k] - from[k]) * share);
        Moment {
            angles,
            centre_mm: self
                .reacher
                .finger()
                .tip_pose_mm(&angles)
                .translation
                .vector,
            contact: None,
            normal_force_n: 0.0,
            sliding: Vec3::zeros(),
        }
    }
}

fn home(reacher: &Reacher) -> Moment {
    let centre_mm = reacher.home_mm();
    Moment {
        angles: reacher.angles(&centre_mm, Elbow::Up).unwrap_or([0.0; 3]),
        centre_mm,
        contact: None,
        normal_force_n: 0.0,
        sliding: Vec3::zeros(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::itinerary::{divide, itinerary};
    use super::super::waypoints::Waypoints;
    use super::*;
    use crate::hand::Hand;

    const TIP: f64 = 20.0;

    #[test]
    fn force_is_kept_and_the_tip_never_digs_in_over_a_whole_round() {
        let object = Arc::new(Object::named("mug").unwrap());
        let hand = Hand::from_urdf(Hand::THREE_FINGER_URDF, "three_finger.urdf").unwrap();
        let reachers: Vec<Reacher> = hand
            .fingers()
            .iter()
            .map(|f| Reacher::new(f).unwrap())
            .collect();
        let waypoints = Waypoints::spread(&object, TIP, 150, 2);
        let division = divide(&waypoints, &reachers);
        let legs = itinerary(&object, &waypoints, TIP, &reachers[0], &division.parts[0]);
        let slides = legs
            .iter()
            .filter(|l| matches!(l.leg, Leg::Slide(_)))
            .count() as u32;
        let length = sliding_mm(&legs);
        let mut motion = Motion::new(
            Arc::clone(&object),
            reachers[0].clone(),
            legs,
            TIP,
            2.0,
            2.0,
        );
        let (mut full, mut touching, mut angles) = (0, 0, motion.at_home().angles);
        for _ in 0..100_000 {
            let moment = motion.step();
            let distance = object.foot(&moment.centre_mm).distance_mm;
            assert!(distance > TIP - 1e-3, "digs in: {distance}");
            let tip = motion
                .reacher()
                .finger()
                .tip_pose_mm(&moment.angles)
                .translation
                .vector;
            assert!((tip - moment.centre_mm).norm() < 1e-9);
            // No joint jumps: 0.25 rad in 5 ms would be 50 rad/s.
            for (a, b) in moment.angles.iter().zip(angles) {
                assert!((a - b).abs() < 0.25, "joint jumps from {b} to {a}");
            }
            angles = moment.angles;
            match moment.contact {
                Some(foot) => {
                    touching += 1;
                    assert!((distance - TIP).abs() < 1e-3);
                    assert!((foot.distance_mm - TIP).abs() < 1e-3);
                    assert!(moment.normal_force_n <= 2.0 * (1.0 + RIPPLE) + 1e-12);
                    full += u32::from(moment.normal_force_n >= 2.0 * (1.0 - RIPPLE) - 1e-12);
                }
                None => assert_eq!(moment.normal_force_n, 0.0),
            }
            if motion.rounds() > 0 {
                break;
            }
        }
        assert_eq!(motion.rounds(), 1);
        // In contact for the length of the way, and below full force only while landing and taking off.
        assert!(
            f64::from(full) >= (length / 2.0).floor() - f64::from(2 * slides),
            "{full}"
        );
        assert!(touching - full <= slides * 2 * RAMP);
    }
}
