//! Where a picture is taken from.
//!
//! The world's z points up. Azimuth turns the viewer around z, from the +x axis towards +y; elevation lifts
//! the viewer above the horizon. Framing is exact: all given points lie inside the picture's margins.

use std::str::FromStr;

use super::PictureError;
use crate::Vec3;

/// Direction from which to look, in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Around the z axis, from +x towards +y.
    pub azimuth_degrees: f64,
    /// Above the horizon, -90 to 90.
    pub elevation_degrees: f64,
}

impl Default for View {
    /// From the front right, a little above.
    fn default() -> Self {
        Self {
            azimuth_degrees: -60.0,
            elevation_degrees: 25.0,
        }
    }
}

impl FromStr for View {
    type Err = PictureError;

    /// Two numbers, `azimuth,elevation`, in degrees.
    fn from_str(text: &str) -> Result<Self, PictureError> {
        let wrong = || PictureError::View(text.to_owned());
        let (azimuth, elevation) = text.split_once(',').ok_or_else(wrong)?;
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite());
        let view = Self {
            azimuth_degrees: number(azimuth).ok_or_else(wrong)?,
            elevation_degrees: number(elevation).ok_or_else(wrong)?,
        };
        if (-90.0..=90.0).contains(&view.elevation_degrees) {
            Ok(view)
        } else {
            Err(wrong())
        }
    }
}

impl View {
    /// Right, up and backwards (towards the viewer) as unit vectors of the world.
    fn axes(self) -> [Vec3; 3] {
        let (azimuth, elevation) = (
            self.azimuth_degrees.to_radians(),
            self.elevation_degrees.to_radians(),
        );
        let right = Vec3::new(-azimuth.sin(), azimuth.cos(), 0.0);
        let back = Vec3::new(
            azimuth.cos() * elevation.cos(),
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
        );
        [right, back.cross(&right), back]
    }
}

/// How depth shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Near things are larger, as seen with a long lens.
    #[default]
    Perspective,
    /// Parallel lines stay parallel and lengths across the view are to scale.
    Parallel,
}

/// Half the vertical angle of view in perspective: a long lens, so shapes are little distorted.
const HALF_ANGLE_DEGREES: f64 = 12.0;

/// Share of the picture's half width and half height that framing fills; what is left above holds two lines of lettering.
const FILLED: f64 = 0.77;

/// A placed camera: what [`Camera::framing`] found for a view, a set of points and a picture's shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    axes: [Vec3; 3],
    /// Middle of the picture at unit magnification.
    target: Vec3,
    /// From the eye to the target; in parallel projection only used for the height of the picture.
    distance: f64,
    projection: Projection,
    /// Radius of a ball around the target that holds all points.
    reach: f64,
}

/// A point as seen: in pixels from the upper left corner, and its depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    /// Pixels to the right.
    pub x: f32,
    /// Pixels down.
    pub y: f32,
    /// Grows towards the viewer and is linear across a picture of a plane.
    pub nearness: f32,
}

impl Camera {
    /// The camera that looks along `view` and just holds all finite points in a picture of the given width divided
    /// by height.
    pub fn framing<'a>(
        view: View,
        projection: Projection,
        points: impl IntoIterator<Item = &'a Vec3>,
        aspect: f64,
    ) -> Self {
        let axes = view.axes();
        let seen: Vec<Vec3> = points
            .into_iter()
            .filter(|p| p.iter().all(|x| x.is_finite()))
            .map(|p| Vec3::new(p.dot(&axes[0]), p.dot(&axes[1]), p.dot(&axes[2])))
            .collect();
        let first = seen.first().copied().unwrap_or_else(Vec3::zeros);
        let (low, high) = seen
            .iter()
            .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
        let mut middle = (low + high) / 2.0;
        let tangent = HALF_ANGLE_DEGREES.to_radians().tan();
        let fill = [tangent * aspect * FILLED, tangent * FILLED];
        let mut distance = 0.0_f64;
        // A near part shifts the middle of the picture; three rounds settle it to a pixel.
        for _ in 0..3 {
            let level = middle.z;
            let depth = |p: &Vec3| match projection {
                Projection::Perspective => p.z - level,
                Projection::Parallel => 0.0,
            };
            distance = seen.iter().fold(0.0, |distance: f64, p| {
                let needed = |axis: usize| (p[axis] - middle[axis]).abs() / fill[axis] + depth(p);
                distance.max(needed(0)).max(needed(1))
            });
            if distance <= 0.0 {
                distance = 1.0;
            }
            for axis in 0..2 {
                let ends = seen
                    .iter()
                    .map(|p| (p[axis] - middle[axis]) / (distance - depth(p)).max(1e-9 * distance));
                let (least, most) =
                    ends.fold((f64::MAX, f64::MIN), |(l, m), x| (l.min(x), m.max(x)));
                if least <= most {
                    middle[axis] += (least + most) / 2.0 * distance;
                }
            }
        }
        distance = seen.iter().fold(distance, |distance, p| {
            let depth = if projection == Projection::Perspective {
                p.z - middle.z
            } else {
                0.0
            };
            let needed = |axis: usize| (p[axis] - middle[axis]).abs() / fill[axis] + depth;
            distance.max(needed(0)).max(needed(1))
        });
        Self {
            axes,
            target: axes[0] * middle.x + axes[1] * middle.y + axes[2] * middle.z,
            distance,
            projection,
            reach: seen.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max),
        }
    }

    /// Radius of a ball around the middle of the picture that holds everything framed, in the unit of the input.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Length of a pixel at the target, in the unit of the input, in a picture of the given height.
    pub fn pixel_size(&self, height: usize) -> f64 {
        2.0 * HALF_ANGLE_DEGREES.to_radians().tan() * self.distance / height as f64
    }

    /// Coordinates right, up and towards the viewer; the origin is the eye (in parallel projection a point as far
    /// from the target as the eye would be).
    pub(super) fn view_space(&self, point: &Vec3) -> Vec3 {
        let p = point - self.target;
        Vec3::new(
            p.dot(&self.axes[0]),
            p.dot(&self.axes[1]),
            p.dot(&self.axes[2]) - self.distance,
        )
    }

    /// A direction in the coordinates of [`Camera::view_space`].
    pub(super) fn turn(&self, direction: &Vec3) -> [f32; 3] {
        self.axes.map(|axis| direction.dot(&axis) as f32)
    }

    /// Whether a surface with this point and outward normal shows its outside.
    pub fn faces(&self, point: &Vec3, normal: &Vec3) -> bool {
        let towards = match self.projection {
            Projection::Perspective => self.target + self.axes[2] * self.distance - point,
            Projection::Parallel => self.axes[2],
        };
        towards.dot(normal) > 0.0
    }

    /// Where a point of view space is seen; `None` behind the eye or if it is not finite.
    pub(super) fn see(&self, p: &Vec3, width: usize, height: usize) -> Option<Seen> {
        let focal = height as f64 / (2.0 * HALF_ANGLE_DEGREES.to_radians().tan());
        let ahead = -p.z;
        let (scale, nearness) = match self.projection {
            Projection::Perspective => {
                if ahead.is_nan() || ahead < 1e-6 * self.distance {
                    return None;
                }
                (focal / ahead, self.distance / ahead)
            }
            Projection::Parallel => (focal / self.distance, 2.0 - ahead / self.distance),
        };
        let (x, y) = (
            width as f64 / 2.0 + p.x * scale,
            height as f64 / 2.0 - p.y * scale,
        );
        // Far outside the picture nothing is drawn, and numbers stay small.
        (x.abs() < 1e5 && y.abs() < 1e5 && nearness.is_finite()).then_some(Seen {
            x: x as f32,
            y: y as f32,
            nearness: nearness as f32,
        })
    }

    /// The weight that makes a value linear across a picture of a plane: see [`Seen`].
    pub(super) fn weight(&self, nearness: f32) -> f32 {
        match self.projection {
            Projection::Perspective => nearness,
            Projection::Parallel => 1.0,
        }
    }

    /// The point of view space seen at a place of the picture.
    pub(super) fn unsee(&self, seen: Seen, width: usize, height: usize) -> [f32; 3] {
        let focal = height as f32 / (2.0 * HALF_ANGLE_DEGREES.to_radians().tan()) as f32;
        let distance = self.distance as f32;
        let (x, y) = (seen.x - width as f32 / 2.0, height as f32 / 2.0 - seen.y);
        match self.projection {
            Projection::Perspective => {
                let ahead = distance / seen.nearness;
                [x * ahead / focal, y * ahead / focal, -ahead]
            }
            Projection::Parallel => {
                let ahead = (2.0 - seen.nearness) * distance;
                [x * distance / focal, y * distance / focal, -ahead]
            }
        }
    }

    /// Direction in view space from the viewer to the point of view space seen there.
    pub(super) fn gaze(&self, at: [f32; 3]) -> [f32; 3] {
        match self.projection {
            Projection::Perspective => at,
            Projection::Parallel => [0.0, 0.0, -1.0],
        }
    }

    /// A point of view space moved towards the viewer by `step`, seen at the same place.
    pub(super) fn nearer(&self, p: &Vec3, step: f64) -> Vec3 {
        match self.projection {
            Projection::Perspective => p * (1.0 - step / p.norm().max(2.0 * step)),
            Projection::Parallel => p + Vec3::new(0.0, 0.0, step),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn framed_points_fill_the_picture_and_stay_inside() {
        let points: Vec<Vec3> = (0..200)
            .map(|i| {
                let t = f64::from(i);
                Vec3::new(
                    3.0 * (t * 0.7).sin(),
                    (t * 1.3).cos() - 7.0,
                    0.5 * (t * 0.31).sin() * (t * 0.2).cos(),
                )
            })
            .collect();
        for projection in [Projection::Perspective, Projection::Parallel] {
            for azimuth in [-60.0, 0.0, 45.0, 170.0] {
                for elevation in [-90.0, 0.0, 25.0, 90.0] {
                    let view = View {
                        azimuth_degrees: azimuth,
                        elevation_degrees: elevation,
                    };
                    let camera = Camera::framing(view, projection, &points, 4.0 / 3.0);
                    let mut filled = 0.0_f32;
                    for p in &points {
                        let seen = camera.see(&camera.view_space(p), 800, 600).unwrap();
                        let off = ((seen.x - 400.0) / 400.0)
                            .abs()
                            .max(((seen.y - 300.0) / 300.0).abs());
                        assert!(f64::from(off) < FILLED + 0.01, "{off}");
                        filled = filled.max(off);
                        let back = camera.unsee(seen, 800, 600);
                        let there = camera.view_space(p);
                        assert!((0..3).all(|i| (f64::from(back[i]) - there[i]).abs() < 1e-4));
                    }
                    assert!(f64::from(filled) > FILLED - 0.02, "{filled}");
                }
            }
        }
    }

    #[test]
    fn views_are_read_and_refused() {
        let view: View = "30, -12.5".parse().unwrap();
        assert_eq!(
            view,
            View {
                azimuth_degrees: 30.0,
                elevation_degrees: -12.5
            }
        );
        for wrong in ["", "30", "a,b", "0,91", "nan,0", "1,2,3"] {
            assert!(wrong.parse::<View>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn nothing_to_frame_still_gives_a_camera() {
        let none: [Vec3; 0] = [];
        let camera = Camera::framing(View::default(), Projection::Perspective, &none, 1.0);
        assert!(camera.pixel_size(100) > 0.0);
        let one = [Vec3::new(1.0, 2.0, f64::NAN), Vec3::new(1.0, 2.0, 3.0)];
        let camera = Camera::framing(View::default(), Projection::Perspective, &one, 1.0);
        let seen = camera.see(&camera.view_space(&one[1]), 100, 100).unwrap();
        assert!((seen.x - 50.0).abs() < 1e-3 && (seen.y - 50.0).abs() < 1e-3);
    }
}
