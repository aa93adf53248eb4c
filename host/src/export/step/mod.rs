//! STEP (ISO 10303-21, AP214) for CAD: the surface itself, exactly, not an approximation.
//!
//! # How a triangle becomes a STEP surface
//! STEP has no triangular patches. A triangular patch of degree 5 is a part of a tensor-product patch of
//! degree (5, 5) over any quadrilateral of its parameter plane; control points by the blossom ([`tensor`]).
//! Three ways were weighed and tried in OpenCASCADE on a sphere, a torus and a cube:
//! - (a) three quadrilaterals corner, edge middle, centroid, edge middle: three faces per triangle;
//! - (b) one quadrilateral with an edge collapsed to a corner: one face, but no normal at that corner, and
//!   wrong closest points on stretched patches;
//! - (c) a parallelogram on one of the triangle's edges, trimmed to the triangle: one face, no singularity.
//!
//! Taken is (c), on the edge whose parallelogram stays farthest from folding; where all three fold outside
//! the triangle, (a) for that face only. A neighbour of such a face gets its edge in two halves.
//!
//! # What is promised
//! - Faces lie on the patches and edges on the patches' borders up to rounding (1e-14 of the size).
//! - Every surface and curve has the lowest degree that carries it (5, or a chart's), to 1e-13 of the size; equal points and
//!   parameter curves stand once.
//! - Every edge is one B-spline curve, shared by both faces, with its parameter curves in both: no
//!   sewing is needed. A closed component becomes a solid, one with a border an open shell.
//! - Creases need nothing: they are edges across which neighbouring faces happen to meet at an angle.
//! - Numbers have all digits it takes to read the same `f64`. No time stamp: same surface, same bytes.
//!
//! Not done: components are not nested into each other (a cavity inside a solid becomes a solid of its own).
//!
//! # Units
//! STEP has to state a unit. `mm`, `cm`, `m`, `um` and `in` are stated as such; where the unit is unknown (or
//! another), millimetres are.

mod part21;
pub mod tensor;

use super::ExportError;
use crate::Vec3;
use crate::mesh::{TriangleMesh, topology};
use crate::spline::bernstein::{DEGREE, edge_index};
use crate::spline::edges::EdgeTable;
use crate::spline::{Surface, SurfaceError};
use part21::{Part21, list};
use std::path::Path;
use tensor::TensorPatch;

/// Writes the surface as a STEP file.
///
/// # Errors
/// A surface that is no valid network, or a file that cannot be written.
pub fn write(path: &Path, surface: &Surface, units: Option<&str>) -> Result<(), ExportError> {
    let name = path
        .file_stem()
        .map(|s| s.to_string_lossy().into_owned())
        .unwrap_or_default();
    super::write_bytes(path, &encode(&name, surface, units)?)
}

/// The file's content. `name` is the product's name.
///
/// # Errors
/// A surface that is no valid network.
pub fn encode(name: &str, surface: &Surface, units: Option<&str>) -> Result<Vec<u8>, SurfaceError> {
    let table = surface.check()?;
    let mut shell = Shell::new(surface, &table);
    shell.write_surfaces();
    shell.write_edges();
    shell.write_inner_edges();
    let faces = shell.write_faces();
    let mut out = shell.out;
    let context = out.geometric_context(units, surface);
    let components = topology::face_components(&TriangleMesh {
        positions: surface.vertices.clone(),
        faces: surface.faces.clone(),
    });
    let count = components.iter().max().map_or(0, |last| *last as usize + 1);
    let mut open = vec![false; count];
    for edge in table.edges.iter().filter(|e| e.is_border()) {
        for side in edge.sides.iter().flatten() {
            open[components[side.face as usize] as usize] = true;
        }
    }
    let mut members = vec![Vec::new(); count];
    for (component, ids) in components.iter().zip(&faces) {
        members[*component as usize].extend(ids);
    }
    let shells: Vec<(u32, bool)> = members
        .iter()
        .zip(&open)
        .map(|(ids, open)| {
            let kind = if *open { "OPEN_SHELL" } else { "CLOSED_SHELL" };
            (out.add(&format!("{kind}('',{})", list(ids))), *open)
        })
        .collect();
    let origin = out.placement();
    let representation = if open.contains(&true) {
        let ids: Vec<u32> = shells.iter().map(|(id, _)| *id).collect();
        let model = out.add(&format!("SHELL_BASED_SURFACE_MODEL('',{})", list(&ids)));
        out.add(&format!(
            "MANIFOLD_SURFACE_SHAPE_REPRESENTATION('',(#{model},#{origin}),#{context})"
        ))
    } else {
        let mut items: Vec<u32> = shells
            .iter()
            .map(|(id, _)| out.add(&format!("MANIFOLD_SOLID_BREP('',#{id})")))
            .collect();
        items.push(origin);
        out.add(&format!(
            "ADVANCED_BREP_SHAPE_REPRESENTATION('',{},#{context})",
            list(&items)
        ))
    };
    out.product(name, representation);
    Ok(out.finish(name))
}

/// How a triangle is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// Parallelogram on this local edge, with the number of its surface.
    Trimmed { base: usize, surface: u32 },
    /// Three quadrilaterals, piece k at corner k, with the numbers of their surfaces.
    Pieces { surfaces: [u32; 3] },
}

/// An edge curve from a start to an end point, shared by the faces beside it.
#[derive(Clone, Copy, Debug, Default)]
struct Curve {
    /// Number of its EDGE_CURVE.
    id: u32,
}

struct Shell<'a> {
    surface: &'a Surface,
    table: &'a EdgeTable,
    out: Part21,
    forms: Vec<Form>,
    /// Per edge one curve, or two halves, from the lower to the higher vertex.
    edges: Vec<Vec<Curve>>,
    /// Per edge its middle point, where it is halved.
    middles: Vec<u32>,
    /// Per face in pieces the curves from the middle of local edge k to the centroid.
    inner: Vec<[Curve; 3]>,
    vertices: Vec<u32>,
}

/// A curve's image in the parameters of one surface.
struct Image {
    surface: u32,
    from: [f64; 2],
    to: [f64; 2],
}

impl<'a> Shell<'a> {
    fn new(surface: &'a Surface, table: &'a EdgeTable) -> Self {
        let mut out = Part21::new();
        let vertices = surface.vertices.iter().map(|v| out.vertex(v)).collect();
        Self {
            surface,
            table,
            out,
            forms: Vec::with_capacity(surface.faces.len()),
            edges: Vec::with_capacity(table.edges.len()),
            middles: vec![0; table.edges.len()],
            inner: vec![[Curve::default(); 3]; surface.faces.len()],
            vertices,
        }
    }

    fn write_surfaces(&mut self) {
        for points in &self.surface.control_points {
            let form = match tensor::best_base(points) {
                Some(base) => {
                    let patch = TensorPatch::parallelogram(points, base);
                    Form::Trimmed {
                        base,
                        surface: self.out.surface(&patch),
                    }
                }
                None => Form::Pieces {
                    surfaces: [0, 1, 2].map(|k| self.out.surface(&TensorPatch::piece(points, k))),
                },
            };
            self.forms.push(form);
        }
    }

    /// Where a corner, or the middle of the edge after it, lies in the parameters of a trimmed face.
    fn trimmed_uv(base: usize, corner: usize, middle: bool) -> [f64; 2] {
        const CORNERS: [[f64; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]];
        let here = CORNERS[(corner + 3 - base) % 3];
        if !middle {
            return here;
        }
        let next = CORNERS[(corner + 4 - base) % 3];
        [0.5 * (here[0] + next[0]), 0.5 * (here[1] + next[1])]
    }

    /// Image of one half of local edge `local` (`second`: the half at its end), or of all of it (`None`), as
    /// the face runs through it.
    fn image(&self, face: usize, local: usize, half: Option<bool>) -> Image {
        match self.forms[face] {
            Form::Trimmed { base, surface } => {
                let start = Self::trimmed_uv(base, local, false);
                let middle = Self::trimmed_uv(base, local, true);
                let end = Self::trimmed_uv(base, local + 1, false);
                let (from, to) = match half {
                    None => (start, end),
                    Some(false) => (start, middle),
                    Some(true) => (middle, end),
                };
                Image { surface, from, to }
            }
            Form::Pieces { surfaces } => match half {
                Some(true) => {
                    let surface = surfaces[(local + 1) % 3];
                    Image {
                        surface,
                        from: [0.0, 1.0],
                        to: [0.0, 0.0],
                    }
                }
                _ => Image {
                    surface: surfaces[local],
                    from: [0.0, 0.0],
                    to: [1.0, 0.0],
                },
            },
        }
    }

    fn write_edges(&mut self) {
        for (number, edge) in self.table.edges.iter().enumerate() {
            let sides: Vec<(usize, usize)> = edge
                .sides
                .iter()
                .flatten()
                .map(|side| (side.face as usize, usize::from(side.local)))
                .collect();
            let Some(&(face, local)) = sides.first() else {
                continue;
            };
            let runs_up = |&(face, local): &(usize, usize)| {
                self.surface.faces[face][local] == edge.vertices[0]
            };
            let points: [Vec3; DEGREE + 1] = std::array::from_fn(|k| {
                let along = if runs_up(&(face, local)) {
                    k
                } else {
                    DEGREE - k
                };
                self.surface.control_points[face][edge_index(local, 0, along)]
            });
            let [low, high] = edge.vertices.map(|v| self.vertices[v as usize]);
            let halved = sides
                .iter()
                .any(|(f, _)| matches!(self.forms[*f], Form::Pieces { .. }));
            let parts: Vec<(Option<bool>, [Vec3; DEGREE + 1])> = if halved {
                let [first, second] = tensor::halves(&points);
                vec![(Some(false), first), (Some(true), second)]
            } else {
                vec![(None, points)]
            };
            if halved {
                self.middles[number] = self.out.vertex(&parts[1].1[0]);
            }
            let mut curves = Vec::with_capacity(parts.len());
            for (half, points) in &parts {
                let images: Vec<Image> = sides
                    .iter()
                    .map(|side| {
                        if runs_up(side) {
                            return self.image(side.0, side.1, *half);
                        }
                        let back = self.image(side.0, side.1, half.map(|second| !second));
                        Image {
                            surface: back.surface,
                            from: back.to,
                            to: back.from,
                        }
                    })
                    .collect();
                let (from, to) = match half {
                    None => (low, high),
                    Some(false) => (low, self.middles[number]),
                    Some(true) => (self.middles[number], high),
                };
                curves.push(self.write_curve(points, &images, from, to));
            }
            self.edges.push(curves);
        }
    }

    fn write_inner_edges(&mut self) {
        for face in 0..self.forms.len() {
            let Form::Pieces { surfaces } = self.forms[face] else {
                continue;
            };
            let points = &self.surface.control_points[face];
            let centroid = self.out.vertex(&tensor::centroid(points));
            for k in 0..3 {
                let images = [
                    Image {
                        surface: surfaces[k],
                        from: [1.0, 0.0],
                        to: [1.0, 1.0],
                    },
                    Image {
                        surface: surfaces[(k + 1) % 3],
                        from: [0.0, 1.0],
                        to: [1.0, 1.0],
                    },
                ];
                let curve = tensor::middle_to_centroid(points, k);
                let middle = self.middles[self.table.of_face[face][k] as usize];
                self.inner[face][k] = self.write_curve(&curve, &images, middle, centroid);
            }
        }
    }

    fn write_curve(
        &mut self,
        points: &[Vec3; DEGREE + 1],
        images: &[Image],
        from: u32,
        to: u32,
    ) -> Curve {
        let curve = self.out.curve(points);
        let images: Vec<u32> = images
            .iter()
            .map(|i| self.out.image(i.surface, i.from, i.to))
            .collect();
        let geometry = self.out.add(&format!(
            "SURFACE_CURVE('',#{curve},{},.CURVE_3D.)",
            list(&images)
        ));
        let id = self
            .out
            .add(&format!("EDGE_CURVE('',#{from},#{to},#{geometry},.T.)"));
        Curve { id }
    }

    /// Writes the faces; per triangle the numbers of its one or three faces.
    fn write_faces(&mut self) -> Vec<Vec<u32>> {
        let mut all = Vec::with_capacity(self.forms.len());
        for face in 0..self.forms.len() {
            // The curves of local edge l as the face runs through it, and whether they run the same way.
            let around = [0, 1, 2].map(|local| {
                let number = self.table.of_face[face][local] as usize;
                let same = self.surface.faces[face][local] == self.table.edges[number].vertices[0];
                let mut curves: Vec<(Curve, bool)> = self.edges[number]
                    .iter()
                    .map(|curve| (*curve, same))
                    .collect();
                if !same {
                    curves.reverse();
                }
                curves
            });
            let written = match self.forms[face] {
                Form::Trimmed { surface, .. } => {
                    vec![self.out.face(
                        surface,
                        around.iter().flatten().map(|(c, same)| (c.id, *same)),
                    )]
                }
                Form::Pieces { surfaces } => (0..3)
                    .map(|k| {
                        let before = (k + 2) % 3;
                        let first = around[k].first().copied().unwrap_or_default();
                        let last = around[before].last().copied().unwrap_or_default();
                        let rim = [
                            first,
                            (self.inner[face][k], true),
                            (self.inner[face][before], false),
                            last,
                        ];
                        self.out
                            .face(surfaces[k], rim.into_iter().map(|(c, same)| (c.id, same)))
                    })
                    .collect(),
            };
            all.push(written);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shapes;
    use std::collections::{BTreeMap, BTreeSet};

    /// Entities by number, after checking that every reference has one and every number stands once.
    fn entities(text: &str) -> BTreeMap<u32, String> {
        let mut found = BTreeMap::new();
        for line in text.lines().filter(|line| line.starts_with('#')) {
            let (number, entity) = line[1..].split_once('=').unwrap();
            assert!(entity.ends_with(';'), "{line}");
            assert!(
                found
                    .insert(number.parse().unwrap(), entity.to_owned())
                    .is_none()
            );
        }
        let mut used = BTreeSet::new();
        for entity in found.values() {
            for reference in references(entity) {
                assert!(found.contains_key(&reference), "#{reference} in {entity}");
                used.insert(reference);
            }
        }
        found
    }

    fn references(entity: &str) -> Vec<u32> {
        entity
            .split('#')
            .skip(1)
            .map(|rest| {
                let end = rest
                    .find(|c: char| !c.is_ascii_digit())
                    .unwrap_or(rest.len());
                rest[..end].parse().unwrap()
            })
            .collect()
    }

    fn count(entities: &BTreeMap<u32, String>, kind: &str) -> usize {
        entities
            .values()
            .filter(|e| e.starts_with(&format!("{kind}(")))
            .count()
    }

    /// A closed surface with one patch that is regular but folds outside of its triangle on all sides.
    fn with_pieces() -> Surface {
        let mut surface = shapes::lumpy_sphere();
        let points = &mut surface.control_points[7];
        let inner = [4, 7, 8, 11, 12, 13];
        let middle = inner.iter().map(|k| points[*k]).sum::<Vec3>() / 6.0;
        for k in inner {
            points[k] = middle + (points[k] - middle) * 1.5;
        }
        surface
    }

    #[test]
    fn solids_and_shells_are_complete() {
        for (surface, shell) in [
            (shapes::torus(), "CLOSED_SHELL"),
            (shapes::cube(), "CLOSED_SHELL"),
            (shapes::sheet(), "OPEN_SHELL"),
        ] {
            let text = String::from_utf8(encode("part", &surface, Some("mm")).unwrap()).unwrap();
            let found = entities(&text);
            let edges = surface.check().unwrap().edges.len();
            assert_eq!(count(&found, "ADVANCED_FACE"), surface.faces.len());
            assert_eq!(count(&found, "EDGE_CURVE"), edges);
            assert_eq!(count(&found, "VERTEX_POINT"), surface.vertices.len());
            assert_eq!(count(&found, shell), 1);
            assert_eq!(
                count(&found, "MANIFOLD_SOLID_BREP"),
                usize::from(shell == "CLOSED_SHELL")
            );
            assert!(text.starts_with("ISO-10303-21;\n") && text.ends_with("END-ISO-10303-21;\n"));
        }
    }

    #[test]
    fn a_folding_face_is_written_in_pieces_and_its_edges_in_halves() {
        let surface = with_pieces();
        let in_pieces = surface
            .control_points
            .iter()
            .filter(|p| tensor::best_base(p).is_none());
        assert_eq!(in_pieces.count(), 1);
        let text = String::from_utf8(encode("part", &surface, None).unwrap()).unwrap();
        let found = entities(&text);
        assert_eq!(count(&found, "ADVANCED_FACE"), 80 + 2);
        assert_eq!(count(&found, "EDGE_CURVE"), 120 + 3 + 3);
        assert_eq!(count(&found, "VERTEX_POINT"), 42 + 3 + 1);
        // Every edge is used twice, once in each direction.
        let mut uses: BTreeMap<u32, Vec<bool>> = BTreeMap::new();
        for entity in found.values().filter(|e| e.starts_with("ORIENTED_EDGE(")) {
            uses.entry(references(entity)[0])
                .or_default()
                .push(entity.contains(".T."));
        }
        assert_eq!(uses.len(), 126);
        assert!(
            uses.values()
                .all(|ways| ways.len() == 2 && ways[0] != ways[1])
        );
        // Every loop is closed: each edge begins where the one before it ends.
        for entity in found.values().filter(|e| e.starts_with("EDGE_LOOP(")) {
            let ends: Vec<[u32; 2]> = references(entity)
                .iter()
                .map(|oriented| {
                    let oriented = &found[oriented];
                    let edge = references(&found[&references(oriented)[0]]);
                    if oriented.contains(".T.") {
                        [edge[0], edge[1]]
                    } else {
                        [edge[1], edge[0]]
                    }
                })
                .collect();
            for k in 0..ends.len() {
                assert_eq!(ends[k][1], ends[(k + 1) % ends.len()][0]);
            }
        }
    }

    #[test]
    fn same_surface_same_bytes_and_units_as_stated() {
        let surface = shapes::cube();
        let of = |units| String::from_utf8(encode("part", &surface, units).unwrap()).unwrap();
        assert_eq!(of(Some("mm")), of(None));
        assert!(of(Some("m")).contains("SI_UNIT($,.METRE.)"));
        assert!(of(Some("mm")).contains("SI_UNIT(.MILLI.,.METRE.)"));
        assert!(of(Some("in")).contains("CONVERSION_BASED_UNIT('INCH'"));
    }
}
