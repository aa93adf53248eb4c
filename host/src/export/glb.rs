//! Triangles as binary glTF 2.0 (GLB), for browsers and renderers.
//!
//! One mesh with `POSITION`, `NORMAL` and, where the surface knows its confidence, `_SIGMA` (standard deviation
//! of the position, in the unit of the surface) and `COLOR_0`: the same as a colour, from blue (0) over
//! pale grey to orange (the largest sigma present), which also the common colour-blind can tell apart.
//! Where the surface was asked for its curvature, `_MEAN_CURVATURE` and `_GAUSS_CURVATURE` stand beside, and `COLOR_0`
//! shows the mean curvature: orange where the surface bends outwards, blue inwards.
//! Points of a crease stand once per side, each with its own normal. Coordinates are those of the surface:
//! neither turned to glTF's y-up nor scaled to its metre.

use super::ExportError;
use super::colour::{curvature_shares, linear};
use crate::spline::SampledSurface;
use serde_json::{Value, json};

const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Buffer with its views and accessors, as they are filled.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends a table and returns the number of its accessor. `bytes` is a multiple of 4 long.
    fn add(&mut self, target: u32, bytes: Vec<u8>, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(), "target": target,
        }));
        self.bytes.extend(bytes);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// The file's content.
///
/// # Errors
/// A mesh without triangles (glTF has no empty mesh), or one of more than 4 GiB.
pub fn encode(sampled: &SampledSurface) -> Result<Vec<u8>, ExportError> {
    let too_large = || ExportError::TooLarge {
        file: "mesh".into(),
        what: format!("{} triangles", sampled.triangles.len()),
        format: "GLB",
    };
    let count = sampled.positions.len();
    let triangles: Vec<[u32; 3]> = sampled
        .triangles
        .iter()
        .copied()
        .filter(|t| t.iter().all(|v| (*v as usize) < count))
        .collect();
    let mut buffer = Buffer::default();
    let mut document = json!({
        "asset": {"version": "2.0", "generator": concat!("palpus ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
    });
    if count == 0 || triangles.is_empty() {
        // An empty scene is valid where an empty mesh is not.
        document["scenes"] = json!([{}]);
        return pack(&document, &[]).ok_or_else(too_large);
    }
    let positions: Vec<[f32; 3]> = sampled
        .positions
        .iter()
        .map(|p| [p.x, p.y, p.z].map(|c| c as f32 + 0.0))
        .collect();
    let mut low = positions[0];
    let mut high = positions[0];
    for axis in 0..3 {
        for p in &positions {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    let floats = |values: &mut dyn Iterator<Item = f32>| -> Vec<u8> {
        values.flat_map(f32::to_le_bytes).collect()
    };
    let position = buffer.add(
        ARRAY_BUFFER,
        floats(&mut positions.iter().flatten().copied()),
        json!({"componentType": FLOAT, "count": count, "type": "VEC3", "min": low, "max": high}),
    );
    let mut attributes = json!({"POSITION": position});
    if sampled.normals.len() == count {
        let mut values = sampled
            .normals
            .iter()
            .flat_map(|n| [n.x, n.y, n.z])
            .map(|c| c as f32);
        attributes["NORMAL"] = json!(buffer.add(
            ARRAY_BUFFER,
            floats(&mut values),
            json!({"componentType": FLOAT, "count": count, "type": "VEC3"}),
        ));
    }
    if sampled.sigma.len() == count {
        let sigma: Vec<f32> = sampled.sigma.iter().map(|s| *s as f32).collect();
        let largest = sigma.iter().copied().fold(0.0, f32::max);
        let share = |s: &f32| {
            if largest > 0.0 && s.is_finite() {
                s / largest
            } else {
                0.0
            }
        };
        let shares: Vec<f32> = sigma.iter().map(share).collect();
        attributes["_SIGMA"] = json!(buffer.add(
            ARRAY_BUFFER,
            floats(&mut sigma.iter().copied()),
            json!({"componentType": FLOAT, "count": count, "type": "SCALAR"}),
        ));
        if sampled.curvature.is_empty() {
            attributes["COLOR_0"] = json!(buffer.add(
                ARRAY_BUFFER,
                colours(&shares),
                json!({"componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4"}),
            ));
        }
    }
    if sampled.curvature.len() == count {
        for (name, part) in [("_MEAN_CURVATURE", 0), ("_GAUSS_CURVATURE", 1)] {
            let mut values = sampled.curvature.iter().map(|c| c[part] as f32);
            attributes[name] = json!(buffer.add(
                ARRAY_BUFFER,
                floats(&mut values),
                json!({"componentType": FLOAT, "count": count, "type": "SCALAR"}),
            ));
        }
        attributes["COLOR_0"] = json!(buffer.add(
            ARRAY_BUFFER,
            colours(&curvature_shares(sampled)),
            json!({"componentType": UNSIGNED_BYTE, "normalized": true, "count": count, "type": "VEC4"}),
        ));
    }
    let indices = buffer.add(
        ELEMENT_ARRAY_BUFFER,
        triangles
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect(),
        json!({"componentType": UNSIGNED_INT, "count": 3 * triangles.len(), "type": "SCALAR"}),
    );
    document["scenes"] = json!([{"nodes": [0]}]);
    document["nodes"] = json!([{"mesh": 0, "name": "surface"}]);
    document["meshes"] = json!([{"primitives": [
        {"attributes": attributes, "indices": indices, "material": 0, "mode": 4}
    ]}]);
    document["materials"] = json!([{
        "doubleSided": true,
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.7},
    }]);
    document["buffers"] = json!([{"byteLength": buffer.bytes.len()}]);
    document["bufferViews"] = Value::Array(buffer.views);
    document["accessors"] = Value::Array(buffer.accessors);
    pack(&document, &buffer.bytes).ok_or_else(too_large)
}

/// Colours with full opacity, as glTF wants them.
fn colours(shares: &[f32]) -> Vec<u8> {
    let opaque = |share: &f32| {
        let [red, green, blue] = linear(*share);
        [red, green, blue, 255]
    };
    shares.iter().flat_map(opaque).collect()
}

/// Header, JSON chunk, binary chunk.
fn pack(document: &Value, binary: &[u8]) -> Option<Vec<u8>> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let body = if binary.is_empty() {
        0
    } else {
        8 + binary.len()
    };
    let total = u32::try_from(12 + 8 + text.len() + body).ok()?;
    let mut out = Vec::with_capacity(total as usize);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend(total.to_le_bytes());
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(text);
    if !binary.is_empty() {
        out.extend((binary.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(binary);
    }
    Some(out)
}
