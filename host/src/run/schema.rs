//! What the messages of a capture log look like, as protobuf types and as the self-contained schemas
//! that go into the file with them.
//!
//! Where a Foxglove schema fits, it is used, so that existing viewers show the data: `foxglove.PointCloud`
//! for contacts in the world, `foxglove.Log` for what happened. The rest is Palpus' own and just as
//! self-describing. Lengths in a `foxglove.PointCloud` are metres, as viewers take them; the untouched
//! wire frames stay in the board's units.
//!
//! Promise: every schema is a complete `FileDescriptorSet`; a test encodes one message of each type and
//! checks it, field by field, against its descriptor.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, Timestamp,
};

/// One frame as it came over the wire, without its delimiter.
#[derive(Clone, PartialEq, Message)]
pub struct WireFrame {
    /// The COBS-encoded bytes, untouched, so that a run can be decoded again later.
    #[prost(bytes = "vec", tag = "1")]
    pub frame: Vec<u8>,
}

/// A request for the board's time and its answer.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct RoundTrip {
    /// Host's clock before the request was written, microseconds since the Unix epoch.
    #[prost(sfixed64, tag = "1")]
    pub sent_us: i64,
    /// Board's clock when it had the request, microseconds.
    #[prost(sfixed64, tag = "2")]
    pub board_received_us: i64,
    /// Board's clock when it sent the answer, microseconds.
    #[prost(sfixed64, tag = "3")]
    pub board_sent_us: i64,
    /// Host's clock after the answer was read, microseconds since the Unix epoch.
    #[prost(sfixed64, tag = "4")]
    pub received_us: i64,
}

/// Counters and clock of one finger's link since the start of the run.
#[derive(Clone, PartialEq, Message)]
pub struct LinkState {
    /// Device the finger is, or was last, connected by.
    #[prost(string, tag = "1")]
    pub port: String,
    /// Whether the board answers.
    #[prost(bool, tag = "2")]
    pub connected: bool,
    /// Contact frames accepted.
    #[prost(uint64, tag = "3")]
    pub contacts: u64,
    /// Contact frames missing by their sequence numbers.
    #[prost(uint64, tag = "4")]
    pub lost: u64,
    /// Frames with a wrong check sum, encoding or content.
    #[prost(uint64, tag = "5")]
    pub bad: u64,
    /// Contact frames that came twice.
    #[prost(uint64, tag = "6")]
    pub duplicates: u64,
    /// Contact frames that came after a later one.
    #[prost(uint64, tag = "7")]
    pub out_of_order: u64,
    /// Contacts the board called valid.
    #[prost(uint64, tag = "8")]
    pub valid: u64,
    /// Times the port was opened again after it had failed.
    #[prost(uint64, tag = "9")]
    pub reconnects: u64,
    /// Times the board started anew.
    #[prost(uint64, tag = "10")]
    pub reboots: u64,
    /// Frames the host could not hand to the log because its queue was full.
    #[prost(uint64, tag = "11")]
    pub dropped_by_host: u64,
    /// Host's clock minus the board's, microseconds.
    #[prost(sint64, tag = "12")]
    pub offset_us: i64,
    /// How much faster the host's clock runs, parts per million.
    #[prost(double, tag = "13")]
    pub drift_ppm: f64,
    /// Half of the room the round trips leave the offset, microseconds.
    #[prost(double, tag = "14")]
    pub clock_bound_us: f64,
}

/// `foxglove.Vector3`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector3 {
    /// Along x.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// Along y.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Along z.
    #[prost(double, tag = "3")]
    pub z: f64,
}

/// `foxglove.Quaternion`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Quaternion {
    /// First imaginary part.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// Second imaginary part.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Third imaginary part.
    #[prost(double, tag = "3")]
    pub z: f64,
    /// Real part.
    #[prost(double, tag = "4")]
    pub w: f64,
}

/// `foxglove.Pose`.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Pose {
    /// Origin.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Vector3>,
    /// Orientation.
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<Quaternion>,
}

/// `foxglove.PackedElementField`.
#[derive(Clone, PartialEq, Message)]
pub struct PackedElementField {
    /// Name of the field.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Byte offset within a point.
    #[prost(fixed32, tag = "2")]
    pub offset: u32,
    /// Numeric type; [`FLOAT32`] for all fields Palpus writes.
    #[prost(int32, tag = "3")]
    pub r#type: i32,
}

/// `foxglove.PackedElementField.NumericType.FLOAT32`.
pub const FLOAT32: i32 = 7;

/// `foxglove.PointCloud`.
#[derive(Clone, PartialEq, Message)]
pub struct PointCloud {
    /// When the first point was measured.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Frame of reference.
    #[prost(string, tag = "2")]
    pub frame_id: String,
    /// Pose of the cloud in its frame.
    #[prost(message, optional, tag = "3")]
    pub pose: Option<Pose>,
    /// Bytes from one point to the next.
    #[prost(fixed32, tag = "4")]
    pub point_stride: u32,
    /// What a point consists of.
    #[prost(message, repeated, tag = "5")]
    pub fields: Vec<PackedElementField>,
    /// The points, little endian.
    #[prost(bytes = "vec", tag = "6")]
    pub data: Vec<u8>,
}

/// `foxglove.Log`.
#[derive(Clone, PartialEq, Message)]
pub struct Log {
    /// When it happened.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// How grave it is, see [`Level`].
    #[prost(int32, tag = "2")]
    pub level: i32,
    /// What happened.
    #[prost(string, tag = "3")]
    pub message: String,
    /// Who says so: a finger, or the host.
    #[prost(string, tag = "4")]
    pub name: String,
    /// Source file, unused.
    #[prost(string, tag = "5")]
    pub file: String,
    /// Source line, unused.
    #[prost(fixed32, tag = "6")]
    pub line: u32,
}

/// `foxglove.LogLevel`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Level {
    /// For the curious.
    Debug = 1,
    /// As expected.
    Info = 2,
    /// Something is missing or was repaired.
    Warning = 3,
    /// Something failed.
    Error = 4,
}

/// The timestamp of a point in time given in nanoseconds since the Unix epoch.
pub fn timestamp(time_ns: u64) -> Timestamp {
    Timestamp {
        seconds: (time_ns / 1_000_000_000) as i64,
        nanos: (time_ns % 1_000_000_000) as i32,
    }
}

/// A schema as it goes into the file: name and serialized `FileDescriptorSet`.
pub struct Schema {
    /// Full name of the message type.
    pub name: &'static str,
    /// The message type and all it refers to.
    pub descriptor: FileDescriptorSet,
}

impl Schema {
    /// `palpus.WireFrame`.
    pub fn wire_frame() -> Self {
        Self::palpus("palpus.WireFrame")
    }

    /// `palpus.RoundTrip`.
    pub fn round_trip() -> Self {
        Self::palpus("palpus.RoundTrip")
    }

    /// `palpus.LinkState`.
    pub fn link_state() -> Self {
        Self::palpus("palpus.LinkState")
    }

    /// `foxglove.PointCloud`.
    pub fn point_cloud() -> Self {
        Self {
            name: "foxglove.PointCloud",
            descriptor: FileDescriptorSet {
                file: vec![timestamp_file(), point_cloud_file()],
            },
        }
    }

    /// `foxglove.Log`.
    pub fn log() -> Self {
        Self {
            name: "foxglove.Log",
            descriptor: FileDescriptorSet {
                file: vec![timestamp_file(), log_file()],
            },
        }
    }

    fn palpus(name: &'static str) -> Self {
        Self {
            name,
            descriptor: FileDescriptorSet {
                file: vec![palpus_file()],
            },
        }
    }
}

fn field(name: &str, number: i32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(Label::Optional as i32),
        r#type: Some(kind as i32),
        ..Default::default()
    }
}

fn of_type(name: &str, number: i32, kind: Type, type_name: &str) -> FieldDescriptorProto {
    FieldDescriptorProto {
        type_name: Some(type_name.into()),
        ..field(name, number, kind)
    }
}

fn message(name: &str, fields: Vec<FieldDescriptorProto>) -> DescriptorProto {
    DescriptorProto {
        name: Some(name.into()),
        field: fields,
        ..Default::default()
    }
}

fn enumeration(name: &str, values: &[&str]) -> EnumDescriptorProto {
    EnumDescriptorProto {
        name: Some(name.into()),
        value: values
            .iter()
            .zip(0..)
            .map(|(value, number)| EnumValueDescriptorProto {
                name: Some((*value).into()),
                number: Some(number),
                options: None,
            })
            .collect(),
        ..Default::default()
    }
}

fn file(name: &str, package: &str, depends_on: &[&str]) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        dependency: depends_on.iter().map(|d| (*d).into()).collect(),
        syntax: Some("proto3".into()),
        ..Default::default()
    }
}

fn timestamp_file() -> FileDescriptorProto {
    FileDescriptorProto {
        message_type: vec![message(
            "Timestamp",
            vec![
                field("seconds", 1, Type::Int64),
                field("nanos", 2, Type::Int32),
            ],
        )],
        ..file("google/protobuf/timestamp.proto", "google.protobuf", &[])
    }
}

fn point_cloud_file() -> FileDescriptorProto {
    let xyz = || {
        vec![
            field("x", 1, Type::Double),
            field("y", 2, Type::Double),
            field("z", 3, Type::Double),
        ]
    };
    let mut quaternion = xyz();
    quaternion.push(field("w", 4, Type::Double));
    let mut packed = message(
        "PackedElementField",
        vec![
            field("name", 1, Type::String),
            field("offset", 2, Type::Fixed32),
            of_type(
                "type",
                3,
                Type::Enum,
                ".foxglove.PackedElementField.NumericType",
            ),
        ],
    );
    packed.enum_type.push(enumeration(
        "NumericType",
        &[
            "UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64",
        ],
    ));
    let mut fields = of_type("fields", 5, Type::Message, ".foxglove.PackedElementField");
    fields.label = Some(Label::Repeated as i32);
    FileDescriptorProto {
        message_type: vec![
            message("Vector3", xyz()),
            message("Quaternion", quaternion),
            message(
                "Pose",
                vec![
                    of_type("position", 1, Type::Message, ".foxglove.Vector3"),
                    of_type("orientation", 2, Type::Message, ".foxglove.Quaternion"),
                ],
            ),
            packed,
            message(
                "PointCloud",
                vec![
                    of_type("timestamp", 1, Type::Message, ".google.protobuf.Timestamp"),
                    field("frame_id", 2, Type::String),
                    of_type("pose", 3, Type::Message, ".foxglove.Pose"),
                    field("point_stride", 4, Type::Fixed32),
                    fields,
                    field("data", 6, Type::Bytes),
                ],
            ),
        ],
        ..file(
            "foxglove/PointCloud.proto",
            "foxglove",
            &["google/protobuf/timestamp.proto"],
        )
    }
}

fn log_file() -> FileDescriptorProto {
    FileDescriptorProto {
        message_type: vec![message(
            "Log",
            vec![
                of_type("timestamp", 1, Type::Message, ".google.protobuf.Timestamp"),
                of_type("level", 2, Type::Enum, ".foxglove.LogLevel"),
                field("message", 3, Type::String),
                field("name", 4, Type::String),
                field("file", 5, Type::String),
                field("line", 6, Type::Fixed32),
            ],
        )],
        enum_type: vec![enumeration(
            "LogLevel",
            &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"],
        )],
        ..file(
            "foxglove/Log.proto",
            "foxglove",
            &["google/protobuf/timestamp.proto"],
        )
    }
}

fn palpus_file() -> FileDescriptorProto {
    let counters = [
        "contacts",
        "lost",
        "bad",
        "duplicates",
        "out_of_order",
        "valid",
        "reconnects",
        "reboots",
        "dropped_by_host",
    ];
    let mut state = vec![
        field("port", 1, Type::String),
        field("connected", 2, Type::Bool),
    ];
    state.extend(
        counters
            .iter()
            .zip(3..)
            .map(|(name, number)| field(name, number, Type::Uint64)),
    );
    state.extend([
        field("offset_us", 12, Type::Sint64),
        field("drift_ppm", 13, Type::Double),
        field("clock_bound_us", 14, Type::Double),
    ]);
    FileDescriptorProto {
        message_type: vec![
            message("WireFrame", vec![field("frame", 1, Type::Bytes)]),
            message(
                "RoundTrip",
                vec![
                    field("sent_us", 1, Type::Sfixed64),
                    field("board_received_us", 2, Type::Sfixed64),
                    field("board_sent_us", 3, Type::Sfixed64),
                    field("received_us", 4, Type::Sfixed64),
                ],
            ),
            message("LinkState", state),
        ],
        ..file("palpus.proto", "palpus", &[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Field numbers and wire types of an encoded message, nested ones by descriptor.
    fn check(bytes: &[u8], type_name: &str, schema: &Schema) -> usize {
        let types: BTreeMap<String, &DescriptorProto> = schema
            .descriptor
            .file
            .iter()
            .flat_map(|f| {
                f.message_type
                    .iter()
                    .map(move |m| (format!("{}.{}", f.package(), m.name()), m))
            })
            .collect();
        let descriptor = types[type_name];
        let mut rest = bytes;
        let mut seen = 0;
        while !rest.is_empty() {
            let key = prost::encoding::decode_varint(&mut rest).unwrap();
            let (number, wire) = ((key >> 3) as i32, key & 7);
            let field = descriptor
                .field
                .iter()
                .find(|f| f.number() == number)
                .unwrap_or_else(|| panic!("{type_name} has no field {number}"));
            seen += 1;
            let expected = match field.r#type() {
                Type::Double | Type::Sfixed64 => 1,
                Type::String | Type::Bytes | Type::Message => 2,
                Type::Fixed32 => 5,
                _ => 0,
            };
            assert_eq!(wire, expected, "{type_name}.{}", field.name());
            match wire {
                0 => drop(prost::encoding::decode_varint(&mut rest).unwrap()),
                1 => rest = &rest[8..],
                5 => rest = &rest[4..],
                _ => {
                    let length = prost::encoding::decode_varint(&mut rest).unwrap() as usize;
                    let (inner, after) = rest.split_at(length);
                    if field.r#type() == Type::Message {
                        seen += check(inner, &field.type_name()[1..], schema);
                    }
                    rest = after;
                }
            }
        }
        seen
    }

    #[test]
    fn every_message_matches_its_descriptor() {
        let frame = WireFrame { frame: vec![1] };
        let seen = check(
            &frame.encode_to_vec(),
            "palpus.WireFrame",
            &Schema::wire_frame(),
        );
        assert_eq!(seen, 1);
        let trip = RoundTrip {
            sent_us: 1,
            board_received_us: 2,
            board_sent_us: 3,
            received_us: 4,
        };
        let seen = check(
            &trip.encode_to_vec(),
            "palpus.RoundTrip",
            &Schema::round_trip(),
        );
        assert_eq!(seen, 4);
        let state = LinkState {
            port: "p".into(),
            connected: true,
            contacts: 1,
            lost: 1,
            bad: 1,
            duplicates: 1,
            out_of_order: 1,
            valid: 1,
            reconnects: 1,
            reboots: 1,
            dropped_by_host: 1,
            offset_us: -1,
            drift_ppm: 1.0,
            clock_bound_us: 1.0,
        };
        let seen = check(
            &state.encode_to_vec(),
            "palpus.LinkState",
            &Schema::link_state(),
        );
        assert_eq!(seen, 14);
        let cloud = PointCloud {
            timestamp: Some(timestamp(1_000_000_001)),
            frame_id: "world".into(),
            pose: Some(Pose {
                position: Some(Vector3 {
                    x: 1.0,
                    y: 1.0,
                    z: 1.0,
                }),
                orientation: Some(Quaternion {
                    x: 1.0,
                    y: 1.0,
                    z: 1.0,
                    w: 1.0,
                }),
            }),
            point_stride: 4,
            fields: vec![PackedElementField {
                name: "x".into(),
                offset: 4,
                r#type: FLOAT32,
            }],
            data: vec![0; 4],
        };
        let seen = check(
            &cloud.encode_to_vec(),
            "foxglove.PointCloud",
            &Schema::point_cloud(),
        );
        assert_eq!(seen, 6 + 2 + 2 + 7 + 3);
        let log = Log {
            timestamp: Some(timestamp(1_000_000_001)),
            level: Level::Warning as i32,
            message: "m".into(),
            name: "n".into(),
            file: "f".into(),
            line: 1,
        };
        let seen = check(&log.encode_to_vec(), "foxglove.Log", &Schema::log());
        assert_eq!(seen, 6 + 2);
    }

    #[test]
    fn every_type_a_schema_refers_to_is_in_it() {
        for schema in [
            Schema::wire_frame(),
            Schema::round_trip(),
            Schema::link_state(),
            Schema::point_cloud(),
            Schema::log(),
        ] {
            let files = &schema.descriptor.file;
            let mut names = Vec::new();
            for f in files {
                for m in &f.message_type {
                    names.push(format!(".{}.{}", f.package(), m.name()));
                    names.extend(
                        m.enum_type
                            .iter()
                            .map(|e| format!(".{}.{}.{}", f.package(), m.name(), e.name())),
                    );
                }
                names.extend(
                    f.enum_type
                        .iter()
                        .map(|e| format!(".{}.{}", f.package(), e.name())),
                );
            }
            assert!(names.contains(&format!(".{}", schema.name)));
            for field in files
                .iter()
                .flat_map(|f| &f.message_type)
                .flat_map(|m| &m.field)
            {
                if let Some(type_name) = &field.type_name {
                    assert!(names.contains(type_name), "{type_name} in {}", schema.name);
                }
            }
        }
    }
}
