//! The clear text encoding of ISO 10303-21: numbered entities, reals, strings, and the entities every
//! surface needs.

use super::tensor::{self, TensorPatch};
use crate::Vec3;
use crate::spline::Surface;
use crate::spline::bernstein::DEGREE;
use std::collections::HashMap;

/// A file as it is written.
pub(super) struct Part21 {
    text: String,
    last: u32,
    /// Entities that may be referred to from several places, by their text.
    shared: HashMap<String, u32>,
    /// Context of parameter curves.
    plane: u32,
}

/// A real with all its digits; the decimal point has to be there.
pub(super) fn real(value: f64) -> String {
    let value = value + 0.0;
    let small = value != 0.0 && !(1e-4..1e15).contains(&value.abs());
    let mut text = if small {
        format!("{value:E}")
    } else {
        format!("{value}")
    };
    if !text.contains('.') {
        let at = text.find('E').unwrap_or(text.len());
        text.insert(at, '.');
    }
    text
}

/// A list of references.
pub(super) fn list(ids: &[u32]) -> String {
    let ids: Vec<String> = ids.iter().map(|id| format!("#{id}")).collect();
    format!("({})", ids.join(","))
}

/// A string: quotes doubled, everything beyond printable ASCII as the standard encodes it.
fn string(text: &str) -> String {
    let mut out = String::from("'");
    for c in text.chars() {
        match c {
            '\'' => out.push_str("''"),
            '\\' => out.push_str("\\\\"),
            ' '..='~' => out.push(c),
            _ => out.push_str(&format!("\\X4\\{:08X}\\X0\\", u32::from(c))),
        }
    }
    out.push('\'');
    out
}

/// Multiplicities of the clamped knots of one Bézier segment.
fn clamped(degree: usize) -> String {
    format!("({0},{0})", degree + 1)
}

impl Part21 {
    /// An empty file with the context of parameter curves.
    pub fn new() -> Self {
        let mut out = Self {
            text: String::new(),
            last: 0,
            shared: HashMap::new(),
            plane: 0,
        };
        out.plane = out.add(
            "(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('2D SPACE',''))",
        );
        out
    }

    /// Appends an entity and returns its number.
    pub fn add(&mut self, entity: &str) -> u32 {
        self.last += 1;
        self.text.push_str(&format!("#{}={entity};\n", self.last));
        self.last
    }

    /// The number of an entity that stands once however often it is asked for.
    fn share(&mut self, entity: String) -> u32 {
        if let Some(known) = self.shared.get(&entity) {
            return *known;
        }
        let id = self.add(&entity);
        self.shared.insert(entity, id);
        id
    }

    fn point(&mut self, p: &Vec3) -> u32 {
        self.share(format!(
            "CARTESIAN_POINT('',({},{},{}))",
            real(p.x),
            real(p.y),
            real(p.z)
        ))
    }

    fn plane_point(&mut self, p: [f64; 2]) -> u32 {
        self.share(format!(
            "CARTESIAN_POINT('',({},{}))",
            real(p[0]),
            real(p[1])
        ))
    }

    /// A vertex.
    pub fn vertex(&mut self, p: &Vec3) -> u32 {
        let point = self.point(p);
        self.add(&format!("VERTEX_POINT('',#{point})"))
    }

    /// A tensor-product patch.
    pub fn surface(&mut self, patch: &TensorPatch) -> u32 {
        let points = patch.lowered();
        let (u, v) = (points.len() - 1, points[0].len() - 1);
        let rows: Vec<String> = points
            .iter()
            .map(|row| {
                let ids: Vec<u32> = row.iter().map(|p| self.point(p)).collect();
                list(&ids)
            })
            .collect();
        self.add(&format!(
            "B_SPLINE_SURFACE_WITH_KNOTS('',{u},{v},({}),.UNSPECIFIED.,.F.,.F.,.F.,{},{},(0.,1.),(0.,1.),.UNSPECIFIED.)",
            rows.join(","),
            clamped(u),
            clamped(v)
        ))
    }

    /// A Bézier curve.
    pub fn curve(&mut self, points: &[Vec3; DEGREE + 1]) -> u32 {
        let points = tensor::lowered(points);
        let ids: Vec<u32> = points.iter().map(|p| self.point(p)).collect();
        let degree = points.len() - 1;
        self.add(&format!(
            "B_SPLINE_CURVE_WITH_KNOTS('',{degree},{},.UNSPECIFIED.,.F.,.F.,{},(0.,1.),.UNSPECIFIED.)",
            list(&ids),
            clamped(degree)
        ))
    }

    /// A curve's image in a surface's parameters. A LINE would have the length of the image as its parameter range
    /// where the curve has 1; a B-spline of degree 1 has the same range as the curve.
    pub fn image(&mut self, surface: u32, from: [f64; 2], to: [f64; 2]) -> u32 {
        let ends = [self.plane_point(from), self.plane_point(to)];
        let line = self.share(format!(
            "B_SPLINE_CURVE_WITH_KNOTS('',1,{},.UNSPECIFIED.,.F.,.F.,(2,2),(0.,1.),.UNSPECIFIED.)",
            list(&ends)
        ));
        let plane = self.plane;
        let definition = self.share(format!(
            "DEFINITIONAL_REPRESENTATION('',(#{line}),#{plane})"
        ));
        self.add(&format!("PCURVE('',#{surface},#{definition})"))
    }

    /// A face with one loop of edges and the directions in which it runs through them.
    pub fn face(&mut self, surface: u32, rim: impl Iterator<Item = (u32, bool)>) -> u32 {
        let oriented: Vec<u32> = rim
            .map(|(edge, same)| {
                let way = if same { 'T' } else { 'F' };
                self.add(&format!("ORIENTED_EDGE('',*,*,#{edge},.{way}.)"))
            })
            .collect();
        let rim = self.add(&format!("EDGE_LOOP('',{})", list(&oriented)));
        let bound = self.add(&format!("FACE_OUTER_BOUND('',#{rim},.T.)"));
        self.add(&format!("ADVANCED_FACE('',(#{bound}),#{surface},.T.)"))
    }

    /// The coordinate system every representation holds.
    pub fn placement(&mut self) -> u32 {
        let origin = self.point(&Vec3::zeros());
        let up = self.add("DIRECTION('',(0.,0.,1.))");
        let right = self.add("DIRECTION('',(1.,0.,0.))");
        self.add(&format!("AXIS2_PLACEMENT_3D('',#{origin},#{up},#{right})"))
    }

    /// Units and the accuracy of the geometry.
    pub fn geometric_context(&mut self, units: Option<&str>, surface: &Surface) -> u32 {
        let si = |prefix: &str| format!("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({prefix},.METRE.))");
        let length = match units {
            Some("m") => self.add(&si("$")),
            Some("cm") => self.add(&si(".CENTI.")),
            Some("um" | "µm") => self.add(&si(".MICRO.")),
            Some("in" | "inch") => {
                let millimetre = self.add(&si(".MILLI."));
                let inch = self.add(&format!(
                    "LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#{millimetre})"
                ));
                let dimensions = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)");
                self.add(&format!(
                    "(CONVERSION_BASED_UNIT('INCH',#{inch})LENGTH_UNIT()NAMED_UNIT(#{dimensions}))"
                ))
            }
            _ => self.add(&si(".MILLI.")),
        };
        let angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))");
        let solid = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())");
        let diagonal = surface
            .bounding_box()
            .map_or(1.0, |(low, high)| (high - low).norm());
        // Faces and edges agree to rounding; readers take this as the least tolerance they may use.
        let accuracy = 10f64.powi((1e-10 * diagonal.max(1e-290)).log10().ceil() as i32);
        let accuracy = self.add(&format!(
            "UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({}),#{length},'distance_accuracy_value','')",
            real(accuracy)
        ));
        self.add(&format!(
            "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{accuracy}))GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid}))REPRESENTATION_CONTEXT('',''))"
        ))
    }

    /// The product whose shape the representation is: without it some readers open nothing and do not say so.
    pub fn product(&mut self, name: &str, representation: u32) {
        let name = string(name);
        let context =
            self.add("APPLICATION_CONTEXT('core data for automotive mechanical design processes')");
        self.add(&format!(
            "APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#{context})"
        ));
        let product_context = self.add(&format!("PRODUCT_CONTEXT('',#{context},'mechanical')"));
        let product = self.add(&format!("PRODUCT({name},{name},'',(#{product_context}))"));
        self.add(&format!(
            "PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))"
        ));
        let formation = self.add(&format!("PRODUCT_DEFINITION_FORMATION('','',#{product})"));
        let definition_context = self.add(&format!(
            "PRODUCT_DEFINITION_CONTEXT('part definition',#{context},'design')"
        ));
        let definition = self.add(&format!(
            "PRODUCT_DEFINITION('design','',#{formation},#{definition_context})"
        ));
        let shape = self.add(&format!("PRODUCT_DEFINITION_SHAPE('','',#{definition})"));
        self.add(&format!(
            "SHAPE_DEFINITION_REPRESENTATION(#{shape},#{representation})"
        ));
    }

    /// The whole file.
    pub fn finish(self, name: &str) -> Vec<u8> {
        // No time: the same surface gives the same bytes.
        let header = format!(
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION(('smooth surface from contact points'),'2;1');\n\
             FILE_NAME({},'1970-01-01T00:00:00',(''),(''),'palpus {}','palpus','');\n\
             FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));\nENDSEC;\nDATA;\n",
            string(name),
            env!("CARGO_PKG_VERSION"),
        );
        let mut bytes = header.into_bytes();
        bytes.extend(self.text.into_bytes());
        bytes.extend(b"ENDSEC;\nEND-ISO-10303-21;\n");
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reals_read_back_and_have_their_point() {
        for value in [
            0.0,
            -0.0,
            1.0,
            -2.5,
            1e-5,
            1.0 / 3.0,
            6.02e23,
            -1e-300,
            123456789.0,
            1e15,
        ] {
            let text = real(value);
            assert!(text.contains('.'), "{text}");
            assert_eq!(text.parse::<f64>().unwrap(), value);
            assert!(!text.contains('e') && !text.starts_with("-0."), "{text}");
        }
        assert_eq!(real(1e-5), "1.E-5");
        assert_eq!(real(3.0), "3.");
    }

    #[test]
    fn strings_are_escaped() {
        assert_eq!(string("it's µ\\"), "'it''s \\X4\\000000B5\\X0\\\\\\'");
    }
}
