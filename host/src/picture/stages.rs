//! The figures of a reconstruction: one per stage, as in Figs. 5 to 10 of the paper, and maps of its quality.
//!
//! All are seen by one camera, framed on the final surface and the points (on whatever is there if those are
//! missing). Figures whose input is missing are left out.

use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::PictureError;
use super::camera::{Camera, Projection, View};
use super::colour::{Colour, ColourMap, Srgb};
use super::fields::curvatures;
use super::image::Image;
use super::legend::{Caption, Legend};
use super::lettering::short_number;
use super::scene::{Balls, Body, Lines, Paint, Scene};
use crate::Vec3;
use crate::cloud::{Cloud, OrientedPoint};
use crate::mesh::{AabbTree, TriangleMesh};
use crate::spline::edges::EdgeTable;
use crate::spline::{SampledSurface, Surface, angle_degrees};

const CLAY: Srgb = Colour::hex(0x9DB7CF);
const PALE: Srgb = Colour::hex(0xDDE2E7);
const MESH: Srgb = Colour::hex(0xC9D3DC);
pub(super) const EDGE: Srgb = Colour::hex(0x22303C);
const POINT: Srgb = Colour::hex(0x1F5C99);
const FAR_POINT: Srgb = Colour::hex(0xB4C3D1);
pub(super) const NORMAL: Srgb = Colour::hex(0xC8642B);
const FAR_NORMAL: Srgb = Colour::hex(0xE6CBB8);
pub(super) const CREASE: Srgb = Colour::hex(0xB3261E);

/// How figures are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct FigureOptions {
    /// Direction of view.
    pub view: View,
    /// How depth shows.
    pub projection: Projection,
    /// Pixels per row, 64 to 8192.
    pub width: usize,
    /// Rows, 64 to 8192.
    pub height: usize,
    /// Unit of lengths for labels; empty if unknown.
    pub unit: String,
    /// Pictures of an animated turn around the surface; 0 for none.
    pub turntable_frames: usize,
}

impl Default for FigureOptions {
    fn default() -> Self {
        Self {
            view: View::default(),
            projection: Projection::default(),
            width: 1200,
            height: 900,
            unit: String::new(),
            turntable_frames: 0,
        }
    }
}

/// What each stage left, as far as it is there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stages<'a> {
    /// The points used.
    pub cloud: Option<&'a Cloud>,
    /// Triangles of phase 1.
    pub extracted: Option<&'a TriangleMesh>,
    /// Triangles of phase 2.
    pub simplified: Option<&'a TriangleMesh>,
    /// Surface of phase 3.
    pub fitted: Option<&'a Surface>,
    /// Surface of phase 4.
    pub refined: Option<&'a Surface>,
}

/// One figure before it is drawn.
struct Figure {
    file: &'static str,
    scene: Scene,
    caption: Caption,
}

impl Stages<'_> {
    /// Draws all figures into a folder (made if need be), a contact sheet of them and, if asked for, a
    /// turntable. Returns the files written.
    ///
    /// # Errors
    /// [`PictureError`] for a size that cannot be drawn, a surface that is no network or a file that cannot be
    /// written.
    pub fn draw(
        &self,
        folder: &Path,
        options: &FigureOptions,
    ) -> Result<Vec<PathBuf>, PictureError> {
        let (width, height) = (options.width, options.height);
        if !(64..=8192).contains(&width) || !(64..=8192).contains(&height) {
            return Err(PictureError::Size { width, height });
        }
        fs::create_dir_all(folder).map_err(|error| PictureError::Write {
            path: folder.to_owned(),
            reason: error.to_string(),
        })?;
        let camera = self.camera(options.view, options);
        let mut written = Vec::new();
        let mut images = Vec::new();
        for figure in self.figures(options)? {
            let mut image = figure.scene.render(&camera, width, height);
            figure.caption.write(&mut image, &camera);
            let path = folder.join(figure.file);
            image.write_png(&path)?;
            written.push(path);
            images.push(image.halved());
        }
        if !images.is_empty() {
            let path = folder.join("contact-sheet.png");
            contact_sheet(&images).write_png(&path)?;
            written.push(path);
        }
        if options.turntable_frames > 0 {
            let frames = self.turntable(options)?;
            if !frames.is_empty() {
                let path = folder.join("turntable.png");
                Image::write_animation(&frames, 20, &path)?;
                written.push(path);
            }
        }
        Ok(written)
    }

    /// The one camera of all figures. A strip at each side stays free for lettering.
    fn camera(&self, view: View, options: &FigureOptions) -> Camera {
        let aspect = 0.8 * options.width as f64 / options.height as f64;
        Camera::framing(view, options.projection, &self.framed(), aspect)
    }

    fn framed(&self) -> Vec<Vec3> {
        let mut points: Vec<Vec3> = self
            .cloud
            .iter()
            .flat_map(|cloud| &cloud.points)
            .map(|point| point.position)
            .collect();
        let surface = self.refined.or(self.fitted);
        if let Some(sampled) = surface.and_then(|surface| surface.sample_per_patch(3).ok()) {
            points.extend(sampled.positions);
        } else if let Some(mesh) = self.simplified.or(self.extracted) {
            points.extend(&mesh.positions);
        }
        points
    }

    fn figures(&self, options: &FigureOptions) -> Result<Vec<Figure>, PictureError> {
        let caption = |title: &str, text: String| Caption {
            title: title.to_owned(),
            text,
            legend: None,
            unit: options.unit.clone(),
        };
        let mut figures = Vec::new();
        if let Some(cloud) = self.cloud {
            figures.push(Figure {
                file: "01-points.png",
                scene: points_with_normals(cloud, &self.camera(options.view, options)),
                caption: caption(
                    "Points with normals",
                    format!("{} points as touched", cloud.points.len()),
                ),
            });
        }
        for (file, title, mesh, width) in [
            ("02-extracted.png", "Extracted mesh", self.extracted, 0.8),
            ("03-simplified.png", "Simplified mesh", self.simplified, 1.5),
        ] {
            if let Some(mesh) = mesh {
                figures.push(Figure {
                    file,
                    scene: mesh_with_edges(mesh, width),
                    caption: caption(title, format!("{} triangles", mesh.faces.len())),
                });
            }
        }
        for (file, title, surface) in [
            ("04-fitted.png", "Fitted patches", self.fitted),
            ("05-refined.png", "Refined patches", self.refined),
        ] {
            if let Some(surface) = surface {
                let sampled = surface.sample_per_patch(fineness(surface))?;
                let mut scene = Scene::default();
                scene
                    .bodies
                    .push(Body::smooth(&sampled, Paint::Plain(CLAY)));
                scene.lines.extend(patch_borders(surface));
                figures.push(Figure {
                    file,
                    scene,
                    caption: caption(
                        title,
                        format!("{} patches of degree 5", surface.faces.len()),
                    ),
                });
            }
        }
        if let Some(surface) = self.refined.or(self.fitted) {
            self.final_figures(surface, &caption, &mut figures)?;
        }
        Ok(figures)
    }

    /// The smooth surface and the maps of its quality.
    fn final_figures(
        &self,
        surface: &Surface,
        caption: &dyn Fn(&str, String) -> Caption,
        figures: &mut Vec<Figure>,
    ) -> Result<(), PictureError> {
        let sampled = surface.sample_per_patch(fineness(surface))?;
        let with = |paint: Paint| Scene {
            bodies: vec![Body::smooth(&sampled, paint)],
            ..Scene::default()
        };
        figures.push(Figure {
            file: "06-surface.png",
            scene: with(Paint::Plain(CLAY)),
            caption: caption(
                "Surface",
                format!("sampled as {} triangles", sampled.triangles.len()),
            ),
        });
        let measured = |label: &str| match caption("", String::new()).unit.as_str() {
            "" => label.to_owned(),
            unit => format!("{label}, {unit}"),
        };
        if let Some(cloud) = self.cloud.filter(|cloud| !cloud.points.is_empty()) {
            let centres: Vec<Vec3> = cloud.points.iter().map(|point| point.position).collect();
            let distances: Vec<f64> = feet_on_surface(&sampled, &cloud.points)
                .iter()
                .map(|foot| foot.distance)
                .collect();
            let rms =
                (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
            let most = distances.iter().copied().fold(0.0, f64::max);
            let high = quantile(&distances, 0.98);
            let mut scene = with(Paint::Plain(PALE));
            scene.balls.push(Balls {
                centres,
                radius: ball_radius(cloud.points.len()),
                paint: Paint::Scalar {
                    values: distances,
                    low: 0.0,
                    high,
                    map: ColourMap::Viridis,
                },
                lift: 0.012,
            });
            let mut caption = caption(
                "Distance of the points",
                format!("rms {}, largest {}", short_number(rms), short_number(most)),
            );
            caption.legend = Some(Legend {
                label: measured("distance to\nthe surface"),
                low: 0.0,
                high,
                map: ColourMap::Viridis,
            });
            figures.push(Figure {
                file: "07-error.png",
                scene,
                caption,
            });
        }
        if !sampled.sigma.is_empty() {
            let (low, high) = (
                quantile(&sampled.sigma, 0.0),
                quantile(&sampled.sigma, 0.99),
            );
            let mut caption = caption(
                "Confidence",
                "bright where the data hold the surface least".to_owned(),
            );
            caption.legend = Some(Legend {
                label: measured("standard\ndeviation"),
                low,
                high,
                map: ColourMap::Cividis,
            });
            figures.push(Figure {
                file: "08-confidence.png",
                scene: with(Paint::Scalar {
                    values: sampled.sigma.clone(),
                    low,
                    high,
                    map: ColourMap::Cividis,
                }),
                caption,
            });
        }
        let mean: Vec<f64> = curvatures(surface, &sampled)
            .into_iter()
            .map(|[mean, _]| mean)
            .collect();
        let sizes: Vec<f64> = mean
            .iter()
            .map(|h| h.abs())
            .filter(|h| h.is_finite())
            .collect();
        let high = quantile(&sizes, 0.95);
        let mut mapped = caption(
            "Mean curvature",
            "brown bends outwards, blue inwards; it jumps a little where patches meet".to_owned(),
        );
        mapped.legend = Some(Legend {
            label: match mapped.unit.as_str() {
                "" => "1 / length".to_owned(),
                unit => format!("1 / {unit}"),
            },
            low: -high,
            high,
            map: ColourMap::BlueBrown,
        });
        figures.push(Figure {
            file: "09-curvature.png",
            scene: with(Paint::Scalar {
                values: mean,
                low: -high,
                high,
                map: ColourMap::BlueBrown,
            }),
            caption: mapped,
        });
        figures.push(Figure {
            file: "10-reflections.png",
            scene: with(Paint::Reflections),
            caption: caption(
                "Reflection lines",
                "stripes break at creases and bend where curvature jumps".to_owned(),
            ),
        });
        Ok(())
    }

    /// The surface with its patch borders, once around.
    fn turntable(&self, options: &FigureOptions) -> Result<Vec<Image>, PictureError> {
        let Some(surface) = self.refined.or(self.fitted) else {
            return Ok(Vec::new());
        };
        let sampled = surface.sample_per_patch(fineness(surface).div_ceil(2))?;
        let mut scene = Scene::default();
        scene
            .bodies
            .push(Body::smooth(&sampled, Paint::Plain(CLAY)));
        scene.lines.extend(patch_borders(surface));
        // A ball around everything looks the same from all sides, so the size does not change on the way round.
        let framed = self.framed();
        let low = framed
            .iter()
            .fold(Vec3::repeat(f64::MAX), |low, p| low.inf(p));
        let high = framed
            .iter()
            .fold(Vec3::repeat(f64::MIN), |high, p| high.sup(p));
        let middle = (low + high) / 2.0;
        let reach = framed
            .iter()
            .map(|p| (p - middle).norm())
            .fold(0.0, f64::max);
        let ball: Vec<Vec3> = (0..400)
            .map(|i| {
                let z: f64 = 1.0 - (2.0 * f64::from(i) + 1.0) / 400.0;
                let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
                let round = (1.0 - z * z).sqrt();
                middle + Vec3::new(round * cos, round * sin, z) * reach
            })
            .collect();
        let (width, height) = (options.width.div_ceil(2), options.height.div_ceil(2));
        let frames = options.turntable_frames.min(360);
        Ok((0..frames)
            .map(|frame| {
                let view = View {
                    azimuth_degrees: options.view.azimuth_degrees
                        + 360.0 * frame as f64 / frames as f64,
                    ..options.view
                };
                let aspect = width as f64 / height as f64;
                let camera = Camera::framing(view, options.projection, &ball, aspect);
                scene.render(&camera, width, height)
            })
            .collect())
    }
}

/// Where a point stands relative to a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// Distance from the surface, in the unit of the input; NaN without a surface.
    pub distance: f64,
    /// Angle between the measured normal and the surface's, in degrees.
    pub angle_degrees: f64,
}

/// Where each point stands, from its foot on the sampled triangles, each bent to its exact normals: half of what the
/// vertices' tangent planes lie above the triangle, which is exact for a parabola (error of fourth order in the
/// triangles' size). Points are held to faces whose normal agrees with theirs where there is one.
pub fn feet_on_surface(sampled: &SampledSurface, points: &[OrientedPoint]) -> Vec<Foot> {
    let mesh = TriangleMesh {
        positions: sampled.positions.clone(),
        faces: sampled.triangles.clone(),
    };
    let tree = AabbTree::new(&mesh);
    points
        .par_iter()
        .map(|point| {
            let at = point.position;
            let agrees = |face: u32| mesh.area_vector(face).dot(&point.normal) > 0.0;
            let foot = tree.closest_where(&mesh, &at, f64::INFINITY, agrees);
            let Some(foot) = foot.or_else(|| tree.closest(&mesh, &at)) else {
                return Foot {
                    distance: f64::NAN,
                    angle_degrees: f64::NAN,
                };
            };
            let corners = mesh.faces[foot.face as usize].map(|v| v as usize);
            let (mut bulge, mut normal) = (Vec3::zeros(), Vec3::zeros());
            for (corner, share) in corners.into_iter().zip(foot.barycentric) {
                let (p, n) = (sampled.positions[corner], sampled.normals[corner]);
                bulge += n * (0.5 * share * n.dot(&(p - foot.position)));
                normal += n * share;
            }
            Foot {
                distance: (at - foot.position - bulge).norm(),
                angle_degrees: angle_degrees(
                    normal.try_normalize(0.0).unwrap_or(point.normal),
                    point.normal,
                ),
            }
        })
        .collect()
}

/// The edges of a network as segments, by kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct EdgeLines {
    /// Between two patches that go on smoothly.
    pub inner: Vec<[Vec3; 2]>,
    /// With a patch on one side only.
    pub open: Vec<[Vec3; 2]>,
    /// Between two patches that meet in a crease.
    pub creases: Vec<[Vec3; 2]>,
}

/// The edges of all patches; nothing if the network's indices are wrong.
pub(super) fn edge_lines(surface: &Surface) -> EdgeLines {
    let mut lines = EdgeLines::default();
    let Ok(table) = EdgeTable::new(surface.vertices.len(), &surface.faces) else {
        return lines;
    };
    for edge in &table.edges {
        let kind = match edge {
            edge if edge.is_border() => &mut lines.open,
            edge if surface.is_crease(edge.vertices[0], edge.vertices[1]) => &mut lines.creases,
            _ => &mut lines.inner,
        };
        let Some(side) = edge.sides.iter().flatten().next() else {
            continue;
        };
        if surface.control_points.len() <= side.face as usize {
            continue;
        }
        let local = usize::from(side.local);
        let points: Vec<Vec3> = (0..=16_u8)
            .map(|step| {
                let t = f64::from(step) / 16.0;
                let mut at = [0.0; 3];
                at[local] = 1.0 - t;
                at[(local + 1) % 3] = t;
                surface.point(side.face as usize, at)
            })
            .collect();
        kind.extend(points.windows(2).map(|ends| [ends[0], ends[1]]));
    }
    lines
}

/// Segments along the open borders of a surface.
pub fn open_borders(surface: &Surface) -> Vec<[Vec3; 2]> {
    edge_lines(surface).open
}

/// Lines along the borders of all patches, and along creases and open borders in their own style.
pub fn patch_borders(surface: &Surface) -> Vec<Lines> {
    let edges = edge_lines(surface);
    [
        (edges.inner, EDGE, 1.5),
        (edges.open, EDGE, 2.6),
        (edges.creases, CREASE, 2.6),
    ]
    .into_iter()
    .filter(|(segments, ..)| !segments.is_empty())
    .map(|(segments, colour, width)| Lines {
        segments,
        width,
        colour,
        opacity: 0.85,
        lift: 0.002,
    })
    .collect()
}

/// Points as balls and normals as short lines; those that face away are pale.
fn points_with_normals(cloud: &Cloud, camera: &Camera) -> Scene {
    let length = 0.055 * camera.reach();
    let mut normals = [FAR_NORMAL, NORMAL].map(|colour| Lines {
        segments: Vec::new(),
        width: 1.3,
        colour,
        opacity: 1.0,
        lift: 0.0,
    });
    let mut colours = Vec::with_capacity(cloud.points.len());
    for point in &cloud.points {
        let towards = camera.faces(&point.position, &point.normal);
        colours.push(if towards { POINT } else { FAR_POINT });
        normals[usize::from(towards)]
            .segments
            .push([point.position, point.position + point.normal * length]);
    }
    Scene {
        balls: vec![Balls {
            centres: cloud.points.iter().map(|point| point.position).collect(),
            radius: ball_radius(cloud.points.len()),
            paint: Paint::Each(colours),
            lift: 0.0,
        }],
        lines: normals.into_iter().collect(),
        ..Scene::default()
    }
}

fn mesh_with_edges(mesh: &TriangleMesh, width: f32) -> Scene {
    let mut edges: Vec<[u32; 2]> = mesh
        .faces
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .filter(|edge| (edge[1] as usize) < mesh.positions.len())
        .collect();
    edges.sort_unstable();
    edges.dedup();
    // Fine meshes would drown in their edges.
    let thin = (3000.0 / edges.len().max(1) as f32).sqrt().clamp(0.3, 1.0);
    Scene {
        bodies: vec![Body::flat(mesh, Paint::Plain(MESH))],
        lines: vec![Lines {
            segments: edges
                .iter()
                .map(|edge| edge.map(|v| mesh.positions[v as usize]))
                .collect(),
            width: (width * thin).max(0.6),
            colour: EDGE,
            opacity: (0.8 * thin).max(0.35),
            lift: 0.002,
        }],
        ..Scene::default()
    }
}

/// Segments per patch side that give about 150 000 triangles in all, and smooth outlines on few patches.
fn fineness(surface: &Surface) -> usize {
    let per_patch = 150_000 / surface.faces.len().max(1);
    per_patch.isqrt().clamp(4, 40)
}

/// Smaller balls for more points.
fn ball_radius(points: usize) -> f32 {
    (3.6 * (1200.0 / points.max(1) as f32).sqrt()).clamp(1.3, 5.0)
}

/// The value below which the given share of the numbers lies; 0 without numbers.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let place = (share * sorted.len() as f64) as usize;
    sorted
        .get(place.min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(0.0)
}

/// Pictures of one size side by side, three to five in a row: whichever leaves the fewest places empty.
fn contact_sheet(images: &[Image]) -> Image {
    let (width, height) = (images[0].width, images[0].height);
    let columns = (3..=5)
        .min_by_key(|columns| (columns - images.len() % columns) % columns)
        .unwrap_or(3)
        .min(images.len());
    let rows = images.len().div_ceil(columns);
    let mut sheet = Image::blank(columns * width, rows * height, Srgb([255; 3]));
    for (number, image) in images.iter().enumerate() {
        sheet.paste(image, number % columns * width, number / columns * height);
    }
    sheet
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::mesh::shapes::icosphere;
    use crate::spline::bernstein::EXPONENTS;

    /// Flat patches on an icosphere, with its vertices as cloud.
    pub(in crate::picture) fn faceted_ball() -> (Cloud, TriangleMesh, Surface) {
        let mesh = icosphere(1);
        let cloud = Cloud {
            points: mesh
                .positions
                .iter()
                .map(|p| OrientedPoint {
                    position: *p * 1.01,
                    normal: *p,
                    sigma: None,
                    finger: None,
                    time_us: None,
                })
                .collect(),
            rejected: Vec::new(),
        };
        let surface = Surface {
            vertices: mesh.positions.clone(),
            faces: mesh.faces.clone(),
            control_points: mesh
                .faces
                .iter()
                .map(|face| {
                    EXPONENTS.map(|e| {
                        // Vertices in rising order, so that shared control points have the same bits.
                        let mut terms: Vec<(u32, u8)> = (0..3).map(|m| (face[m], e[m])).collect();
                        terms.sort_unstable();
                        terms
                            .iter()
                            .filter(|(_, times)| *times > 0)
                            .map(|(v, times)| {
                                mesh.positions[*v as usize] * (f64::from(*times) / 5.0)
                            })
                            .sum()
                    })
                })
                .collect(),
            sigma: mesh.positions.iter().map(|p| 0.01 + 0.001 * p.x).collect(),
            ..Surface::default()
        };
        (cloud, mesh, surface)
    }

    #[test]
    fn all_figures_are_written_and_the_same_on_any_number_of_threads() {
        let (cloud, mesh, surface) = faceted_ball();
        let stages = Stages {
            cloud: Some(&cloud),
            extracted: Some(&mesh),
            simplified: Some(&mesh),
            fitted: Some(&surface),
            refined: Some(&surface),
        };
        let options = FigureOptions {
            width: 160,
            height: 120,
            unit: "mm".to_owned(),
            turntable_frames: 2,
            ..FigureOptions::default()
        };
        let draw = |threads: usize| -> Vec<(String, Vec<u8>)> {
            let folder = tempfile::tempdir().unwrap();
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let files = pool
                .install(|| stages.draw(folder.path(), &options))
                .unwrap();
            files
                .iter()
                .map(|path| {
                    (
                        path.file_name().unwrap().to_string_lossy().into_owned(),
                        fs::read(path).unwrap(),
                    )
                })
                .collect()
        };
        let files = draw(1);
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(
            names,
            [
                "01-points.png",
                "02-extracted.png",
                "03-simplified.png",
                "04-fitted.png",
                "05-refined.png",
                "06-surface.png",
                "07-error.png",
                "08-confidence.png",
                "09-curvature.png",
                "10-reflections.png",
                "contact-sheet.png",
                "turntable.png"
            ]
        );
        assert!(files == draw(3));
    }

    #[test]
    fn missing_stages_leave_their_figures_out() {
        let folder = tempfile::tempdir().unwrap();
        let nothing = Stages::default()
            .draw(folder.path(), &FigureOptions::default())
            .unwrap();
        assert!(nothing.is_empty());
        let (_, mesh, _) = faceted_ball();
        let stages = Stages {
            simplified: Some(&mesh),
            ..Stages::default()
        };
        let options = FigureOptions {
            width: 64,
            height: 64,
            ..FigureOptions::default()
        };
        assert_eq!(stages.draw(folder.path(), &options).unwrap().len(), 2);
        let wrong = FigureOptions {
            width: 0,
            ..FigureOptions::default()
        };
        assert!(matches!(
            stages.draw(folder.path(), &wrong),
            Err(PictureError::Size { .. })
        ));
    }

    #[test]
    fn distances_err_by_the_fourth_order_of_the_triangles_size() {
        let coarse = icosphere(1);
        let points: Vec<OrientedPoint> = coarse
            .faces
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|v| coarse.positions[v as usize]);
                let normal = (a * 0.5 + b * 0.3 + c * 0.2).normalize();
                OrientedPoint {
                    position: normal * 1.02,
                    normal,
                    sigma: None,
                    finger: None,
                    time_us: None,
                }
            })
            .collect();
        let worst = |levels: usize| {
            let mesh = icosphere(levels);
            let sampled = SampledSurface {
                positions: mesh.positions.clone(),
                normals: mesh.positions.clone(),
                triangles: mesh.faces.clone(),
                ..SampledSurface::default()
            };
            let feet = feet_on_surface(&sampled, &points);
            assert!(feet.iter().all(|foot| foot.angle_degrees < 0.2));
            feet.iter()
                .map(|foot| (foot.distance - 0.02).abs())
                .fold(0.0, f64::max)
        };
        // Half the size: a sixteenth of the error. The flat triangles of level 3 alone are off by 3e-3.
        let (coarse, fine) = (worst(3), worst(4));
        assert!(coarse < 1e-4 && fine < coarse / 8.0, "{coarse} {fine}");
    }
}
