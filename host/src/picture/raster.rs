//! From a scene to pixels: tiles with a depth buffer, each pixel sampled many times.
//!
//! The picture is cut into square tiles; each finds its visible triangles and balls at every sample, shades them,
//! draws the lines and averages its samples. Tiles share nothing, so they run in parallel and the bytes are the same on any number of
//! threads. Depth cues that look at a pixel's surroundings (ambient occlusion) come from a first pass with one sample per pixel.
//!
//! Two ways were weighed: shading all samples of the whole picture at once (simple, but 17 million samples of 30
//! bytes at 1200 x 900) and tiles (half a megabyte per thread). Tiles were taken.

use rayon::prelude::*;

use super::camera::{Camera, Seen};
use super::colour::{Colour, Srgb};
use super::image::Image;
use super::scene::{Paint, Scene};
use super::shade::{Occlusion, background, shade, shade_evenly, strip_lights};
use crate::Vec3;

/// Pixels along a tile's side.
const TILE: usize = 32;
/// Samples along a pixel's side of the final pass.
const SAMPLES: usize = 4;
/// Number of a sample that sees nothing.
const NOTHING: u32 = u32::MAX;

/// One vertex, ready to draw.
struct Vertex {
    seen: Option<Seen>,
    normal: [f32; 3],
    colour: Colour,
}

/// One triangle: its vertices, and its own normal if it is flat.
struct Facet {
    vertices: [u32; 3],
    flat: Option<[f32; 3]>,
    inside: Colour,
    light: Light,
}

/// In what light a triangle is seen.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Light {
    /// Lamps, as for a thing on a table.
    Lamps,
    /// Light that leaves colours that stand for numbers as they are, on either side.
    Even,
    /// Strip lights that are mirrored.
    Strips,
}

impl Light {
    fn of(paint: &Paint) -> Self {
        match paint {
            Paint::Scalar { .. } => Self::Even,
            Paint::Reflections => Self::Strips,
            Paint::Plain(_) | Paint::Each(_) => Self::Lamps,
        }
    }
}

struct Ball {
    seen: Seen,
    radius: f32,
    /// Gain of nearness per pixel of height above the picture plane.
    bulge: f32,
    colour: Colour,
}

struct Segment {
    ends: [Seen; 2],
    half_width: f32,
    colour: Colour,
    opacity: f32,
    group: u32,
}

/// A scene as seen by a camera: everything in pixels, sorted into tiles.
struct Prepared<'a> {
    camera: &'a Camera,
    width: usize,
    height: usize,
    columns: usize,
    vertices: Vec<Vertex>,
    facets: Vec<Facet>,
    balls: Vec<Ball>,
    segments: Vec<Segment>,
    facets_of_tile: Vec<Vec<u32>>,
    balls_of_tile: Vec<Vec<u32>>,
    segments_of_tile: Vec<Vec<u32>>,
}

/// What one pass saw in a tile, sample by sample.
struct Visible {
    nearness: Vec<f32>,
    /// Facet, or ball after the last facet.
    what: Vec<u32>,
}

impl Scene {
    /// Draws the scene.
    pub fn render(&self, camera: &Camera, width: usize, height: usize) -> Image {
        let prepared = Prepared::new(self, camera, width, height);
        let occlusion = prepared.occlusion();
        let tiles: Vec<Vec<[u8; 3]>> = (0..prepared.facets_of_tile.len())
            .into_par_iter()
            .map(|tile| prepared.draw(tile, &occlusion))
            .collect();
        let mut image = Image::blank(width, height, Srgb([255; 3]));
        for (tile, pixels) in tiles.iter().enumerate() {
            let (left, top) = prepared.corner(tile);
            for row in top..(top + TILE).min(height) {
                for column in left..(left + TILE).min(width) {
                    let at = 3 * (row * width + column);
                    image.rgb[at..at + 3]
                        .copy_from_slice(&pixels[(row - top) * TILE + column - left]);
                }
            }
        }
        image
    }
}

impl<'a> Prepared<'a> {
    fn new(scene: &Scene, camera: &'a Camera, width: usize, height: usize) -> Self {
        let columns = width.div_ceil(TILE);
        let tiles = columns * height.div_ceil(TILE);
        let mut prepared = Self {
            camera,
            width,
            height,
            columns,
            vertices: Vec::new(),
            facets: Vec::new(),
            balls: Vec::new(),
            segments: Vec::new(),
            facets_of_tile: vec![Vec::new(); tiles],
            balls_of_tile: vec![Vec::new(); tiles],
            segments_of_tile: vec![Vec::new(); tiles],
        };
        let see = |p: &Vec3| camera.see(&camera.view_space(p), width, height);
        for body in &scene.bodies {
            let first = prepared.vertices.len() as u32;
            let colours = body.paint.colours(body.positions.len());
            let smooth = body.normals.len() == body.positions.len();
            prepared
                .vertices
                .par_extend(body.positions.par_iter().enumerate().map(|(i, p)| Vertex {
                    seen: see(p),
                    normal: if smooth {
                        camera.turn(&body.normals[i])
                    } else {
                        [0.0; 3]
                    },
                    colour: colours[i],
                }));
            let count = body.positions.len();
            for triangle in &body.triangles {
                if triangle.iter().any(|v| *v as usize >= count) {
                    continue;
                }
                let flat = (!smooth).then(|| {
                    let [a, b, c] = triangle.map(|v| body.positions[v as usize]);
                    let normal = (b - a)
                        .cross(&(c - a))
                        .try_normalize(0.0)
                        .unwrap_or_else(Vec3::zeros);
                    camera.turn(&normal)
                });
                prepared.facets.push(Facet {
                    vertices: triangle.map(|v| v + first),
                    flat,
                    inside: body.inside.into(),
                    light: Light::of(&body.paint),
                });
            }
        }
        // Widths are meant for a picture 900 pixels high.
        let scale = height as f32 / 900.0;
        for balls in &scene.balls {
            let colours = balls.paint.colours(balls.centres.len());
            for (centre, colour) in balls.centres.iter().zip(colours) {
                let lift = balls.lift * camera.reach();
                if let Some(seen) = see_nearer(camera, centre, lift, width, height) {
                    let step = camera.pixel_size(height);
                    let nearer =
                        see_nearer(camera, centre, lift + step, width, height).unwrap_or(seen);
                    prepared.balls.push(Ball {
                        seen,
                        radius: balls.radius * scale,
                        bulge: (nearer.nearness - seen.nearness).max(0.0),
                        colour,
                    });
                }
            }
        }
        for (group, lines) in scene.lines.iter().enumerate() {
            let lift = lines.lift * camera.reach();
            for ends in &lines.segments {
                let seen = ends.map(|end| see_nearer(camera, &end, lift, width, height));
                if let [Some(a), Some(b)] = seen {
                    prepared.segments.push(Segment {
                        ends: [a, b],
                        half_width: lines.width * scale / 2.0,
                        colour: lines.colour.into(),
                        opacity: lines.opacity,
                        group: group as u32,
                    });
                }
            }
        }
        prepared.sort_into_tiles();
        prepared
    }

    fn sort_into_tiles(&mut self) {
        let (columns, rows) = (self.columns, self.height.div_ceil(TILE));
        let (width, height) = (self.width as f32, self.height as f32);
        let tiles = |low: [f32; 2], high: [f32; 2]| {
            let outside = high[0] < 0.0 || high[1] < 0.0 || low[0] > width || low[1] > height;
            let cell =
                |value: f32, count: usize| ((value.max(0.0) / TILE as f32) as usize).min(count - 1);
            let (left, right) = (cell(low[0], columns), cell(high[0], columns));
            let (top, bottom) = (cell(low[1], rows), cell(high[1], rows));
            let bottom = if outside { top } else { bottom + 1 };
            (top..bottom)
                .flat_map(move |row| (left..=right).map(move |column| row * columns + column))
        };
        if columns == 0 || rows == 0 {
            return;
        }
        for (number, facet) in self.facets.iter().enumerate() {
            let Some([a, b, c]) = self.corners(facet) else {
                continue;
            };
            let low = [a.x.min(b.x).min(c.x), a.y.min(b.y).min(c.y)];
            let high = [a.x.max(b.x).max(c.x), a.y.max(b.y).max(c.y)];
            for tile in tiles(low, high) {
                self.facets_of_tile[tile].push(number as u32);
            }
        }
        for (number, ball) in self.balls.iter().enumerate() {
            let (x, y, r) = (ball.seen.x, ball.seen.y, ball.radius);
            for tile in tiles([x - r, y - r], [x + r, y + r]) {
                self.balls_of_tile[tile].push(number as u32);
            }
        }
        for (number, segment) in self.segments.iter().enumerate() {
            let ([a, b], r) = (segment.ends, segment.half_width);
            let low = [a.x.min(b.x) - r, a.y.min(b.y) - r];
            let high = [a.x.max(b.x) + r, a.y.max(b.y) + r];
            for tile in tiles(low, high) {
                self.segments_of_tile[tile].push(number as u32);
            }
        }
    }

    fn corners(&self, facet: &Facet) -> Option<[Seen; 3]> {
        let [a, b, c] = facet.vertices.map(|v| self.vertices[v as usize].seen);
        Some([a?, b?, c?])
    }

    /// Left and top pixel of a tile.
    fn corner(&self, tile: usize) -> (usize, usize) {
        (tile % self.columns * TILE, tile / self.columns * TILE)
    }

    /// What each sample of a tile sees, with `samples` squared samples per pixel.
    fn visible(&self, tile: usize, samples: usize) -> Visible {
        let side = TILE * samples;
        let (left, top) = self.corner(tile);
        let per = samples as f32;
        let mut visible = Visible {
            nearness: vec![f32::MIN; side * side],
            what: vec![NOTHING; side * side],
        };
        // First and one past the last sample whose middle may lie between two places.
        let range = |low: f32, high: f32, corner: usize| {
            let place = |x: f32| (x - corner as f32) * per - 0.5;
            let first = place(low).ceil().clamp(0.0, side as f32) as usize;
            let end = (place(high).floor() + 1.0).clamp(first as f32, side as f32) as usize;
            first..end
        };
        for &number in &self.facets_of_tile[tile] {
            let Some([a, b, c]) = self.corners(&self.facets[number as usize]) else {
                continue;
            };
            let Some(plane) = Plane::new([a, b, c]) else {
                continue;
            };
            let columns = range(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x), left);
            for row in range(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), top) {
                let y = top as f32 + (row as f32 + 0.5) / per;
                for column in columns.clone() {
                    let x = left as f32 + (column as f32 + 0.5) / per;
                    let shares = plane.shares(x, y);
                    if shares[0] < 0.0 || shares[1] < 0.0 || shares[2] < 0.0 {
                        continue;
                    }
                    let nearness =
                        shares[0] * a.nearness + shares[1] * b.nearness + shares[2] * c.nearness;
                    let sample = row * side + column;
                    if nearness > visible.nearness[sample] {
                        visible.nearness[sample] = nearness;
                        visible.what[sample] = number;
                    }
                }
            }
        }
        for &number in &self.balls_of_tile[tile] {
            let ball = &self.balls[number as usize];
            let (x, y, r) = (ball.seen.x, ball.seen.y, ball.radius);
            for row in range(y - r, y + r, top) {
                for column in range(x - r, x + r, left) {
                    let dx = left as f32 + (column as f32 + 0.5) / per - x;
                    let dy = top as f32 + (row as f32 + 0.5) / per - y;
                    let rest = r * r - dx * dx - dy * dy;
                    if rest < 0.0 {
                        continue;
                    }
                    let nearness = ball.seen.nearness + rest.sqrt() * ball.bulge;
                    let sample = row * side + column;
                    if nearness > visible.nearness[sample] {
                        visible.nearness[sample] = nearness;
                        visible.what[sample] = self.facets.len() as u32 + number;
                    }
                }
            }
        }
        visible
    }

    /// Normal (facing the viewer) and colour of what is seen at a place.
    fn surface_at(&self, what: u32, x: f32, y: f32) -> ([f32; 3], Colour) {
        let number = what as usize;
        let Some(facet) = self.facets.get(number) else {
            let ball = &self.balls[number - self.facets.len()];
            let (dx, dy) = (
                (x - ball.seen.x) / ball.radius,
                (y - ball.seen.y) / ball.radius,
            );
            let out = (1.0 - dx * dx - dy * dy).max(0.0).sqrt();
            return ([dx, -dy, out], ball.colour);
        };
        let vertices = facet.vertices.map(|v| &self.vertices[v as usize]);
        let plane = self
            .corners(facet)
            .and_then(|corners| Some((Plane::new(corners)?, corners)));
        let Some((plane, corners)) = plane else {
            return ([0.0, 0.0, 1.0], vertices[0].colour);
        };
        let mut shares = plane.shares(x, y);
        for (share, corner) in shares.iter_mut().zip(&corners) {
            *share = share.max(0.0) * self.camera.weight(corner.nearness);
        }
        let sum: f32 = shares.iter().sum();
        let blend = |of: &dyn Fn(&Vertex) -> f32| {
            (0..3).map(|i| shares[i] * of(vertices[i])).sum::<f32>() / sum
        };
        let normal = facet
            .flat
            .unwrap_or_else(|| [0, 1, 2].map(|i| blend(&|v| v.normal[i])));
        // The facet's own winding tells which side is seen; the normal then faces the viewer.
        let from_outside = plane.counter_clockwise;
        let colour = if from_outside || facet.light == Light::Even {
            Colour([0, 1, 2].map(|i| blend(&|v| v.colour.0[i])))
        } else {
            facet.inside
        };
        let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
        let sign = if from_outside { 1.0 } else { -1.0 };
        if length > 0.0 {
            (normal.map(|x| sign * x / length), colour)
        } else {
            ([0.0, 0.0, 1.0], colour)
        }
    }

    /// The first pass: depth and normal of every pixel, and from them how hidden each is from ambient light.
    fn occlusion(&self) -> Occlusion {
        let tiles: Vec<(Visible, Vec<[f32; 3]>)> = (0..self.facets_of_tile.len())
            .into_par_iter()
            .map(|tile| {
                let visible = self.visible(tile, 1);
                let (left, top) = self.corner(tile);
                let normals = (0..TILE * TILE)
                    .map(|pixel| match visible.what[pixel] {
                        NOTHING => [0.0; 3],
                        what => {
                            let (x, y) = (left + pixel % TILE, top + pixel / TILE);
                            self.surface_at(what, x as f32 + 0.5, y as f32 + 0.5).0
                        }
                    })
                    .collect();
                (visible, normals)
            })
            .collect();
        let pixels = self.width * self.height;
        let (mut nearness, mut normals) = (vec![f32::MIN; pixels], vec![[0.0; 3]; pixels]);
        for (tile, (visible, of_tile)) in tiles.iter().enumerate() {
            let (left, top) = self.corner(tile);
            for row in top..(top + TILE).min(self.height) {
                for column in left..(left + TILE).min(self.width) {
                    let (to, from) = (
                        row * self.width + column,
                        (row - top) * TILE + column - left,
                    );
                    nearness[to] = visible.nearness[from];
                    normals[to] = of_tile[from];
                }
            }
        }
        Occlusion::new(self.camera, self.width, self.height, nearness, &normals)
    }

    /// The final pass for one tile: pixels in rows, sRGB.
    fn draw(&self, tile: usize, occlusion: &Occlusion) -> Vec<[u8; 3]> {
        let visible = self.visible(tile, SAMPLES);
        let side = TILE * SAMPLES;
        let (left, top) = self.corner(tile);
        let per = SAMPLES as f32;
        let place = |row: usize, column: usize| {
            (
                left as f32 + (column as f32 + 0.5) / per,
                top as f32 + (row as f32 + 0.5) / per,
            )
        };
        let mut colours = vec![Colour([0.0; 3]); side * side];
        for row in (0..side).step_by(2) {
            let ground = background((top as f32 + row as f32 / per) / self.height as f32);
            for column in (0..side).step_by(2) {
                // Samples of a 2 x 2 block that see the same thing are shaded once.
                let mut last = (NOTHING, ground);
                for (dy, dx) in [(0, 0), (0, 1), (1, 1), (1, 0)] {
                    let sample = (row + dy) * side + column + dx;
                    let what = visible.what[sample];
                    if what == NOTHING {
                        colours[sample] = ground;
                        continue;
                    }
                    let light = self
                        .facets
                        .get(what as usize)
                        .map_or(Light::Lamps, |facet| facet.light);
                    let reflects = light == Light::Strips;
                    // Stripes have edges within a facet, so each sample asks anew.
                    if what != last.0 || reflects {
                        let (x, y) = place(row + dy, column + dx);
                        let nearness = visible.nearness[sample];
                        let (normal, mut colour) = self.surface_at(what, x, y);
                        if reflects {
                            let at =
                                self.camera
                                    .unsee(Seen { x, y, nearness }, self.width, self.height);
                            colour = strip_lights(normal, self.camera.gaze(at), colour);
                        }
                        let open = occlusion.open_at(x, y, nearness);
                        let lit = match light {
                            Light::Even => shade_evenly(normal, colour, open),
                            Light::Lamps | Light::Strips => shade(normal, colour, open),
                        };
                        last = (what, lit);
                    }
                    colours[sample] = last.1;
                }
            }
        }
        self.draw_lines(tile, &visible, &mut colours);
        let mut pixels = Vec::with_capacity(TILE * TILE);
        for row in 0..TILE {
            for column in 0..TILE {
                let mut sum = [0.0_f32; 3];
                for dy in 0..SAMPLES {
                    for dx in 0..SAMPLES {
                        let part = colours[(row * SAMPLES + dy) * side + column * SAMPLES + dx].0;
                        for i in 0..3 {
                            sum[i] += part[i].min(1.0);
                        }
                    }
                }
                pixels.push(Colour(sum.map(|x| x / (SAMPLES * SAMPLES) as f32)).to_srgb());
            }
        }
        pixels
    }

    fn draw_lines(&self, tile: usize, visible: &Visible, colours: &mut [Colour]) {
        let side = TILE * SAMPLES;
        let (left, top) = self.corner(tile);
        let per = SAMPLES as f32;
        // A group covers each sample once, so that translucent lines do not darken where segments meet.
        let mut drawn = vec![NOTHING; side * side];
        for &number in &self.segments_of_tile[tile] {
            let segment = &self.segments[number as usize];
            let ([a, b], r) = (segment.ends, segment.half_width);
            let range = |low: f32, high: f32, corner: usize| {
                let first = ((low - corner as f32) * per - 0.5)
                    .ceil()
                    .clamp(0.0, side as f32) as usize;
                let end = (((high - corner as f32) * per - 0.5).floor() + 1.0)
                    .clamp(first as f32, side as f32) as usize;
                first..end
            };
            let along = [b.x - a.x, b.y - a.y];
            let length = along[0] * along[0] + along[1] * along[1];
            let columns = range(a.x.min(b.x) - r, a.x.max(b.x) + r, left);
            for row in range(a.y.min(b.y) - r, a.y.max(b.y) + r, top) {
                for column in columns.clone() {
                    let to = [
                        left as f32 + (column as f32 + 0.5) / per - a.x,
                        top as f32 + (row as f32 + 0.5) / per - a.y,
                    ];
                    let t = if length > 0.0 {
                        ((to[0] * along[0] + to[1] * along[1]) / length).clamp(0.0, 1.0)
                    } else {
                        0.0
                    };
                    let (dx, dy) = (to[0] - t * along[0], to[1] - t * along[1]);
                    let sample = row * side + column;
                    let nearness = a.nearness + t * (b.nearness - a.nearness);
                    if dx * dx + dy * dy <= r * r
                        && nearness >= visible.nearness[sample]
                        && drawn[sample] != segment.group
                    {
                        drawn[sample] = segment.group;
                        colours[sample] = colours[sample].mix(segment.colour, segment.opacity);
                    }
                }
            }
        }
    }
}

fn see_nearer(camera: &Camera, p: &Vec3, step: f64, width: usize, height: usize) -> Option<Seen> {
    camera.see(&camera.nearer(&camera.view_space(p), step), width, height)
}

/// Barycentric coordinates of a triangle on the picture as functions of the place.
struct Plane {
    origin: [f32; 2],
    gradients: [[f32; 2]; 2],
    counter_clockwise: bool,
}

impl Plane {
    /// `None` for a triangle seen edge-on.
    fn new([a, b, c]: [Seen; 3]) -> Option<Self> {
        let (b, c) = ([b.x - a.x, b.y - a.y], [c.x - a.x, c.y - a.y]);
        let area = b[0] * c[1] - b[1] * c[0];
        (area != 0.0 && area.is_finite()).then(|| Self {
            origin: [a.x, a.y],
            gradients: [[c[1] / area, -c[0] / area], [-b[1] / area, b[0] / area]],
            // Rows run downwards, so a positive area is clockwise to the eye.
            counter_clockwise: area < 0.0,
        })
    }

    fn shares(&self, x: f32, y: f32) -> [f32; 3] {
        let (x, y) = (x - self.origin[0], y - self.origin[1]);
        let [second, third] = self.gradients.map(|g| g[0] * x + g[1] * y);
        [1.0 - second - third, second, third]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriangleMesh;
    use crate::mesh::shapes::icosphere;
    use crate::picture::{Balls, Body, Lines, Paint, Projection, View};

    const RED: Srgb = Colour::hex(0xD02020);
    const GREEN: Srgb = Colour::hex(0x20A020);

    fn is_red(pixel: [u8; 3]) -> bool {
        i16::from(pixel[0]) > i16::from(pixel[1]) + 40
    }

    fn is_green(pixel: [u8; 3]) -> bool {
        i16::from(pixel[1]) > i16::from(pixel[0]) + 40
    }

    fn ball(radius: f64, middle: Vec3, colour: Srgb) -> Body {
        let mut mesh = icosphere(3);
        let normals = mesh.positions.clone();
        for p in &mut mesh.positions {
            *p = *p * radius + middle;
        }
        Body {
            normals,
            ..Body::flat(&mesh, Paint::Plain(colour))
        }
    }

    #[test]
    fn a_ball_covers_the_area_of_its_circle_and_is_lit_from_above_left() {
        let scene = Scene {
            bodies: vec![ball(1.0, Vec3::new(5.0, -2.0, 1.0), RED)],
            ..Scene::default()
        };
        let camera = Camera::framing(
            View::default(),
            Projection::Parallel,
            scene.positions(),
            1.0,
        );
        let image = scene.render(&camera, 200, 200);
        let covered = (0..200 * 200)
            .filter(|i| is_red(image.pixel(i % 200, i / 200)))
            .count() as f64;
        let radius = 1.0 / camera.pixel_size(200);
        let expected = std::f64::consts::PI * radius * radius;
        assert!(
            (covered / expected - 1.0).abs() < 0.03,
            "{covered} {expected}"
        );
        assert!(image.pixel(70, 60)[0] > image.pixel(130, 140)[0] + 30);
    }

    #[test]
    fn nearer_things_hide_farther_ones() {
        let view = View {
            azimuth_degrees: 0.0,
            elevation_degrees: 0.0,
        };
        let scene = Scene {
            bodies: vec![
                ball(1.0, Vec3::zeros(), RED),
                ball(0.5, Vec3::new(2.0, 0.0, 0.0), GREEN),
            ],
            balls: vec![Balls {
                centres: vec![Vec3::new(-2.0, 0.0, 0.8), Vec3::new(2.0, 0.9, 0.0)],
                radius: 20.0,
                paint: Paint::Plain(GREEN),
                lift: 0.0,
            }],
            lines: vec![Lines {
                segments: vec![[Vec3::new(-1.5, -3.0, -0.7), Vec3::new(-1.5, 3.0, -0.7)]],
                width: 30.0,
                colour: GREEN,
                opacity: 1.0,
                lift: 0.0,
            }],
        };
        let camera = Camera::framing(view, Projection::Parallel, scene.positions(), 1.0);
        let image = scene.render(&camera, 300, 300);
        let at = |y: f64, z: f64| {
            let seen = camera
                .see(&camera.view_space(&Vec3::new(0.0, y, z)), 300, 300)
                .unwrap();
            image.pixel(seen.x as usize, seen.y as usize)
        };
        assert!(is_green(at(0.0, 0.0)), "the near body hides the far one");
        assert!(is_red(at(0.0, 0.75)), "a ball behind is hidden");
        assert!(is_green(at(0.9, 0.0)), "a ball in front is seen");
        assert!(is_red(at(0.0, -0.7)), "the line passes behind");
        assert!(is_green(at(2.0, -0.7)), "and goes on beside");
    }

    #[test]
    fn bad_geometry_is_left_out() {
        let bad = TriangleMesh {
            positions: vec![
                Vec3::zeros(),
                Vec3::new(f64::NAN, 0.0, 0.0),
                Vec3::new(1.0, f64::INFINITY, 0.0),
                Vec3::new(1e300, -1e300, 0.0),
                Vec3::x(),
            ],
            faces: vec![[0, 1, 4], [0, 2, 4], [0, 3, 4], [0, 4, 77], [4, 4, 4]],
        };
        let scene = Scene {
            bodies: vec![
                Body::flat(&bad, Paint::Plain(RED)),
                Body::flat(
                    &bad,
                    Paint::Scalar {
                        values: vec![f64::NAN],
                        low: 0.0,
                        high: 0.0,
                        map: crate::picture::ColourMap::Viridis,
                    },
                ),
            ],
            balls: vec![Balls {
                centres: bad.positions.clone(),
                radius: f32::NAN,
                paint: Paint::Each(Vec::new()),
                lift: f64::NAN,
            }],
            lines: vec![Lines {
                segments: vec![
                    [bad.positions[0], bad.positions[1]],
                    [bad.positions[3], bad.positions[4]],
                ],
                width: 1e9,
                colour: RED,
                opacity: 1.0,
                lift: 0.0,
            }],
        };
        for projection in [Projection::Perspective, Projection::Parallel] {
            let camera = Camera::framing(View::default(), projection, scene.positions(), 1.0);
            for (width, height) in [(50, 40), (1, 1), (0, 0), (33, 0)] {
                let image = scene.render(&camera, width, height);
                assert_eq!((image.width, image.height), (width, height));
            }
        }
    }

    #[test]
    fn pictures_survive_the_way_to_a_file_and_back() {
        let scene = Scene {
            bodies: vec![ball(1.0, Vec3::zeros(), GREEN)],
            ..Scene::default()
        };
        let camera = Camera::framing(
            View::default(),
            Projection::Perspective,
            scene.positions(),
            1.0,
        );
        let image = scene.render(&camera, 70, 50);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ball.png");
        image.write_png(&path).unwrap();
        let decoder =
            png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!((info.width, info.height), (70, 50));
        assert!(rgb == image.rgb);
        let nowhere = folder.path().join("no/such/folder.png");
        assert!(matches!(
            image.write_png(&nowhere),
            Err(crate::picture::PictureError::Write { .. })
        ));
    }
}
