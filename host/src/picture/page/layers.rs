//! What the page's view in space draws, as JSON with binary parts in base 64.

use super::super::colour::{Colour, ColourMap, Srgb};
use super::super::fields::{contact_errors, curvatures};
use super::super::stages::{CREASE, EDGE, Foot, NORMAL, edge_lines};
use super::super::web::{base64, colours, quantile};
use super::Page;
use crate::Vec3;
use crate::cloud::{Cloud, OrientedPoint};
use crate::mesh::TriangleMesh;
use crate::spline::SampledSurface;
use crate::spline::bernstein::{DEGREE, index};
use serde_json::{Value, json};

/// Colours of fingers: those of Okabe and Ito, which differ in every common form of colour blindness.
const FINGERS: [[u8; 3]; 6] = [
    [0, 114, 178],
    [230, 159, 0],
    [0, 158, 115],
    [204, 121, 167],
    [86, 180, 233],
    [213, 94, 0],
];
/// Contacts of one finger farther apart than so many times the median of such steps are not joined: it had let go.
const LET_GO: f64 = 8.0;

/// Numbers over the surface with the range of their colours.
struct Field {
    name: String,
    low: f64,
    high: f64,
    map: &'static str,
    values: Vec<f64>,
}

/// Lines that can be switched on and off; without a colour they take that of the page's edges.
struct LineLayer {
    name: String,
    on: bool,
    /// Whether they lie on the surface and are of no use over another body.
    of_surface: bool,
    width: f64,
    opacity: f64,
    colour: Option<Srgb>,
    segments: Vec<[Vec3; 2]>,
}

fn reals(values: impl Iterator<Item = f64>) -> String {
    base64(
        &values
            .flat_map(|x| (x as f32).to_le_bytes())
            .collect::<Vec<u8>>(),
    )
}

fn whole(values: impl Iterator<Item = u32>) -> String {
    base64(&values.flat_map(u32::to_le_bytes).collect::<Vec<u8>>())
}

impl Page<'_> {
    /// Everything the script draws. Places are relative to `centre`, so that `f32` is enough for them.
    pub(super) fn scene(&self, sampled: &SampledSurface, feet: &[Foot]) -> String {
        let (centre, radius) = ball_around(&sampled.positions);
        let around = |points: &mut dyn Iterator<Item = Vec3>| {
            reals(points.flat_map(|p| <[f64; 3]>::from(p - centre)))
        };
        let normals: Vec<u8> = sampled
            .normals
            .iter()
            .flat_map(|n| n.data.0[0].map(|x| ((x * 32767.0).round() as i16).to_le_bytes()))
            .flatten()
            .collect();
        let cloud = self.cloud.map_or(&[][..], |cloud| &cloud.points);
        let fields: Vec<Value> = self
            .fields(sampled, cloud, feet)
            .into_iter()
            .map(|field| {
                json!({"name": field.name, "low": field.low, "high": field.high, "map": field.map,
                       "values": reals(field.values.into_iter())})
            })
            .collect();
        let lines: Vec<Value> = self
            .lines(radius)
            .into_iter()
            .map(|layer| {
                let colour = layer.colour.map(|Srgb(rgb)| rgb.map(|x| f64::from(x) / 255.0));
                json!({"name": layer.name, "on": layer.on, "of_surface": layer.of_surface, "width": layer.width, "opacity": layer.opacity,
                       "colour": colour, "segments": around(&mut layer.segments.into_iter().flatten())})
            })
            .collect();
        let meshes: Vec<Value> = [
            ("simplified mesh", self.simplified),
            ("extracted mesh", self.extracted),
        ]
        .into_iter()
        .filter_map(|(name, mesh)| {
            let mesh = mesh.filter(|mesh| whole_mesh(mesh))?;
            Some(
                json!({"name": name, "positions": around(&mut mesh.positions.iter().copied()),
                        "triangles": whole(mesh.faces.iter().flatten().copied())}),
            )
        })
        .collect();
        let maps: serde_json::Map<String, Value> = MAPS
            .iter()
            .map(|(name, map)| ((*name).to_owned(), base64(&colours(*map)).into()))
            .collect();
        let mut scene = json!({
            "unit": self.file.units,
            "centre": <[f64; 3]>::from(centre),
            "radius": radius,
            "patches": self.file.surface.faces.len(),
            "surface": {
                "positions": around(&mut sampled.positions.iter().copied()),
                "normals": base64(&normals),
                "triangles": whole(sampled.triangles.iter().flatten().copied()),
                "patches": whole(sampled.patches.iter().copied()),
            },
            "meshes": meshes,
            "maps": maps,
            "fields": fields,
            "lines": lines,
            "finger_colours": FINGERS,
        });
        if !cloud.is_empty() && cloud.len() == feet.len() {
            scene["points"] = points(cloud, feet, &around);
        }
        // Nothing in it can end the script element it stands in.
        scene.to_string().replace('<', "\\u003c")
    }

    /// Numbers that colour the surface.
    fn fields(
        &self,
        sampled: &SampledSurface,
        cloud: &[OrientedPoint],
        feet: &[Foot],
    ) -> Vec<Field> {
        let mut fields = Vec::new();
        let with_unit = |name: &str, power: &str| match self.unit() {
            "" => name.to_owned(),
            unit => format!("{name}, {power}{unit}"),
        };
        if !cloud.is_empty() {
            let values = contact_errors(sampled, cloud, feet);
            fields.push(Field {
                name: with_unit("error (distance of the contacts around)", ""),
                low: 0.0,
                high: quantile(&values, 0.98),
                map: "viridis",
                values,
            });
        }
        if !sampled.sigma.is_empty() {
            fields.push(Field {
                name: with_unit("confidence (standard deviation)", ""),
                low: quantile(&sampled.sigma, 0.0),
                high: quantile(&sampled.sigma, 0.99),
                map: "cividis",
                values: sampled.sigma.clone(),
            });
        }
        let curvatures = curvatures(&self.file.surface, sampled);
        for (number, name) in ["mean curvature", "Gaussian curvature"]
            .into_iter()
            .enumerate()
        {
            let values: Vec<f64> = curvatures.iter().map(|c| c[number]).collect();
            let sizes: Vec<f64> = values.iter().map(|x| x.abs()).collect();
            let high = quantile(&sizes, 0.95);
            fields.push(Field {
                name: with_unit(name, if number == 0 { "1/" } else { "1/square " }),
                low: -high,
                high,
                map: "blue-brown",
                values,
            });
        }
        for field in &mut fields {
            let widest = field.low.abs().max(field.high.abs()).max(1e-12);
            if field.high - field.low < 1e-9 * widest {
                field.high = field.low + 1e-3 * widest;
            }
        }
        fields
    }

    /// Lines over the surface.
    fn lines(&self, radius: f64) -> Vec<LineLayer> {
        let surface = &self.file.surface;
        let edges = edge_lines(surface);
        let layer = |name: &str, width, colour, segments| LineLayer {
            name: name.to_owned(),
            on: false,
            of_surface: false,
            width,
            opacity: 0.85,
            colour,
            segments,
        };
        let net = surface.control_points.iter().flat_map(|points| {
            let at = |i: usize, j: usize, k: usize| points[index([i as u8, j as u8, k as u8])];
            (0..DEGREE).flat_map(move |i| {
                (0..DEGREE - i).flat_map(move |j| {
                    let k = DEGREE - 1 - i - j;
                    let [a, b, c] = [at(i + 1, j, k), at(i, j + 1, k), at(i, j, k + 1)];
                    [[a, b], [b, c], [c, a]]
                })
            })
        });
        let mut layers = vec![
            LineLayer {
                on: true,
                of_surface: true,
                ..layer("patch borders", 1.5, None, edges.inner)
            },
            LineLayer {
                on: true,
                ..layer("open border", 3.0, Some(EDGE), edges.open)
            },
            LineLayer {
                on: true,
                ..layer("creases", 2.6, Some(CREASE), edges.creases)
            },
            layer(
                "control net",
                0.9,
                Some(Colour::hex(0x8A5FA8)),
                net.collect(),
            ),
        ];
        if let Some(cloud) = self.cloud {
            let normal = |p: &OrientedPoint| [p.position, p.position + p.normal * (0.055 * radius)];
            let normals = cloud.points.iter().map(normal).collect();
            layers.push(layer("measured normals", 1.2, Some(NORMAL), normals));
            for (finger, segments) in tracks(cloud) {
                let colour = Srgb(FINGERS[usize::from(finger) % FINGERS.len()]);
                let name = format!("track of finger {}", u32::from(finger) + 1);
                layers.push(layer(&name, 1.8, Some(colour), segments));
            }
        }
        layers.retain(|layer| !layer.segments.is_empty());
        layers
    }
}

const MAPS: [(&str, ColourMap); 3] = [
    ("viridis", ColourMap::Viridis),
    ("cividis", ColourMap::Cividis),
    ("blue-brown", ColourMap::BlueBrown),
];

/// Middle of the box around the finite ones, and the farthest distance from there; at least something.
fn ball_around(positions: &[Vec3]) -> (Vec3, f64) {
    let finite = || positions.iter().filter(|p| p.iter().all(|x| x.is_finite()));
    let (low, high) = finite().fold(
        (Vec3::repeat(f64::MAX), Vec3::repeat(f64::MIN)),
        |(low, high), p| (low.inf(p), high.sup(p)),
    );
    if low.x > high.x {
        return (Vec3::zeros(), 1.0);
    }
    let centre = (low + high) / 2.0;
    let radius = finite().map(|p| (p - centre).norm()).fold(0.0, f64::max);
    (centre, if radius > 0.0 { radius } else { 1.0 })
}

/// Whether every triangle has its corners.
fn whole_mesh(mesh: &TriangleMesh) -> bool {
    let count = mesh.positions.len();
    mesh.faces.iter().flatten().all(|v| (*v as usize) < count)
}

fn points(
    cloud: &[OrientedPoint],
    feet: &[Foot],
    around: &dyn Fn(&mut dyn Iterator<Item = Vec3>) -> String,
) -> Value {
    let distances: Vec<f64> = feet.iter().map(|foot| foot.distance).collect();
    let angles: Vec<f64> = feet.iter().map(|foot| foot.angle_degrees).collect();
    let high = |values: &[f64]| {
        let high = quantile(values, 0.98);
        if high > 0.0 { high } else { 1.0 }
    };
    let fingers = cloud.iter().any(|p| p.finger.is_some()).then(|| {
        let numbers = cloud
            .iter()
            .map(|p| p.finger.map_or(255, |f| f.min(254) as u8));
        base64(&numbers.collect::<Vec<u8>>())
    });
    json!({
        "positions": around(&mut cloud.iter().map(|p| p.position)),
        "high": high(&distances),
        "high_angle": high(&angles),
        "distances": reals(distances.into_iter()),
        "angles": reals(angles.into_iter()),
        "fingers": fingers,
        "radius": (3.4 * (1200.0 / feet.len() as f64).sqrt()).clamp(1.4, 4.5),
    })
}

/// For every known finger the way its contacts went, in the order they are in, broken where it had let go.
fn tracks(cloud: &Cloud) -> Vec<(u16, Vec<[Vec3; 2]>)> {
    let mut fingers: Vec<u16> = cloud.points.iter().filter_map(|p| p.finger).collect();
    fingers.sort_unstable();
    fingers.dedup();
    fingers
        .into_iter()
        .map(|finger| {
            let own: Vec<Vec3> = cloud
                .points
                .iter()
                .filter(|p| p.finger == Some(finger))
                .map(|p| p.position)
                .collect();
            let steps: Vec<f64> = own.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
            let longest = LET_GO * quantile(&steps, 0.5);
            let joined = own.windows(2).zip(&steps);
            let joined = joined.filter(|(_, step)| **step > 0.0 && **step <= longest);
            (finger, joined.map(|(w, _)| [w[0], w[1]]).collect())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_follow_each_finger_and_break_where_it_let_go() {
        let point = |x: f64, finger: u16| OrientedPoint {
            position: Vec3::new(x, 0.0, 0.0),
            normal: Vec3::z(),
            sigma: None,
            finger: Some(finger),
            time_us: None,
        };
        let mut cloud = Cloud::default();
        for k in 0..10 {
            cloud.points.push(point(f64::from(k), 2));
            cloud.points.push(point(-0.1 * f64::from(k), 0));
        }
        cloud.points.push(point(1000.0, 2));
        cloud.points.push(point(1001.0, 2));
        let tracks = tracks(&cloud);
        let lengths: Vec<(u16, usize)> = tracks.iter().map(|(f, t)| (*f, t.len())).collect();
        assert_eq!(lengths, [(0, 9), (2, 10)]);
    }
}
