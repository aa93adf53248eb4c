//! Inputs that reach deep into each target: one or more of each kind a user has.

use super::link::framed;
use super::points::USUAL;
use crate::patches::lumpy_sphere;
use palpus_host::Vec3;
use palpus_host::cloud::{self, Cloud, OrientedPoint};
use palpus_host::export::SurfaceFile;
use palpus_host::export::surface_file::Provenance;
use palpus_host::hand::Hand;
use palpus_host::link::clock::RoundTrip;
use palpus_host::reconstruct::{Options, reconstruct};
use palpus_host::run::writer::{RunStart, RunWriter};
use palpus_protocol::{
    Calibration, Command, Contact, ContactFlags, HostMessage, Identify, MAX_FRAME_BYTES,
    PROTOCOL_VERSION, Request, SCHEMA_TAG, Streams, TareRequest, TimeSyncRequest,
};
use std::collections::BTreeMap;
use std::fmt::Write as _;

fn contact(sequence: u32) -> Vec<u8> {
    let contact = Contact {
        sequence,
        board_time_us: 1_000_000 + 5_000 * u64::from(sequence),
        point_mm: [0.0, 12.0, 16.0],
        normal: [0.0, 0.6, 0.8],
        normal_force_n: 2.0,
        tangential_force_n: 0.5,
        spin_n_mm: 0.0,
        sigma_mm: 0.1,
        joint_angles_rad: [0.1, 0.5, -0.8],
        flags: ContactFlags::none(),
    };
    let mut out = [0; MAX_FRAME_BYTES];
    let message = palpus_protocol::BoardMessage::from(contact);
    let length = message.encode(&mut out).expect("room");
    out[..length].to_vec()
}

fn requests() -> Vec<Command> {
    let matrix: Vec<f32> = (0..36).map(|k| f32::from(u8::from(k % 7 == 0))).collect();
    let calibration = Calibration::sealed(5, 6, &matrix).expect("a plain matrix");
    vec![
        Command::Ping(9),
        Command::Start(Streams {
            contact_every: 1,
            raw_every: 3,
        }),
        Command::Stop,
        Command::Tare(TareRequest {
            samples: 20,
            force: true,
        }),
        Command::GetCalibration,
        Command::SetCalibration(calibration),
        Command::TimeSync(TimeSyncRequest { host_send_us: 77 }),
        Command::Statistics,
    ]
}

fn encoded(message: &HostMessage) -> Vec<u8> {
    let mut out = [0; MAX_FRAME_BYTES];
    let length = message.encode(&mut out).expect("room");
    out[..length].to_vec()
}

pub fn frames() -> Vec<Vec<u8>> {
    let mut stream = vec![0];
    let mut all = Vec::new();
    for (k, command) in (1..).zip(requests()) {
        let bytes = encoded(&HostMessage::from(Request {
            request_id: k,
            command,
        }));
        stream.extend(&bytes);
        all.push([&[0], &bytes[..]].concat());
    }
    stream.extend(contact(3));
    stream.extend(encoded(&HostMessage::from(Identify { request_id: 1 })));
    all.push(stream);
    all.push(vec![1, 0x81, 7]);
    all.push(vec![1, 0x82, 7, 0, 3]);
    all.push(
        [
            &[0],
            &framed(PROTOCOL_VERSION + 1, SCHEMA_TAG, 0x81, &[5, 6])[..],
        ]
        .concat(),
    );
    all
}

pub fn commands() -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    let mut session = Vec::new();
    for (k, command) in (1..).zip(requests()) {
        let bytes = encoded(&HostMessage::from(Request {
            request_id: k,
            command,
        }));
        session.extend([0, bytes.len() as u8]);
        session.extend(&bytes);
        session.extend([6, 30, 1]);
        session.extend([2, 0]);
        all.push(session.clone());
    }
    // Pressed, a long pause, other versions.
    all.push([&session[..], &[3, 1, 1, 4, 4, 0, 0, 0, 9, 6, 9, 1, 2, 0]].concat());
    all.push(vec![5, 3, 9, 0x81, 1, 1, 2, 0x81, 1, 2, 0]);
    all
}

pub fn run() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("seed.mcap");
    let start = RunStart {
        started_ns: 1_000_000_000,
        hand: vec![("hand.urdf".into(), Hand::THREE_FINGER_URDF.into())],
        fingers: vec!["index".into(), "thumb".into()],
        notes: BTreeMap::new(),
    };
    let write = |frames: u32| {
        let mut writer = RunWriter::create(&path, true, &start).expect("a writable folder");
        let about = BTreeMap::from([("finger".to_owned(), "index".to_owned())]);
        writer.identity(about).expect("room");
        for k in 0..frames {
            let at_ns = 1_000_000_000 + 5_000_000 * u64::from(k);
            let wire = contact(k);
            let finger = (k % 2) as usize;
            writer
                .frame(finger, at_ns, at_ns - 1_000, &wire[..wire.len() - 1])
                .expect("room");
        }
        let trip = RoundTrip {
            sent_us: 1,
            board_received_us: 2,
            board_sent_us: 3,
            received_us: 4,
        };
        writer.round_trip(0, trip).expect("room");
        writer.finish().expect("room");
        std::fs::read(&path).expect("what was written")
    };
    let whole = write(12);
    let cut = whole[..whole.len() / 2].to_vec();
    vec![whole, cut, write(0)]
}

/// Points of a ball.
fn ball(count: usize) -> Cloud {
    let points = (0..count).map(|k| {
        let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
        let turn = 2.399_963 * k as f64;
        let around = (1.0 - z * z).sqrt();
        let normal = Vec3::new(around * turn.cos(), around * turn.sin(), z);
        OrientedPoint {
            position: normal * 20.0,
            normal,
            sigma: Some(0.1),
            finger: Some(k as u16 % 3),
            time_us: Some(k as i64),
        }
    });
    Cloud {
        points: points.collect(),
        rejected: Vec::new(),
    }
}

fn rows(count: usize, between: &str) -> String {
    let mut text = String::new();
    for p in ball(count).points {
        let values: Vec<String> = p
            .position
            .iter()
            .chain(&p.normal)
            .map(f64::to_string)
            .collect();
        let _ = writeln!(text, "{}", values.join(between));
    }
    text
}

pub fn points_ply() -> Vec<Vec<u8>> {
    let mut binary = Vec::new();
    cloud::write_ply(&ball(6), &mut binary).expect("memory can be written");
    let header = "ply\nformat ascii 1.0\nobj_info x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty list uchar int more\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    let ascii = rows(4, " ").replace('\n', " 2 1 2\n");
    let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty double nx\nproperty double ny\nproperty double nz\nend_header\n".to_vec();
    for p in ball(2).points {
        big.extend(p.position.iter().flat_map(|v| (*v as f32).to_be_bytes()));
        big.extend(p.normal.iter().flat_map(|v| v.to_be_bytes()));
    }
    vec![binary, format!("{header}{ascii}3 0 1 2\n").into(), big]
}

pub fn points_text() -> Vec<Vec<u8>> {
    vec![
        format!(" {}", rows(5, " ")).into(),
        format!("!x,y,z,nx,ny,nz\n# a comment\n{}", rows(5, ",")).into(),
        format!(
            "!sigma;z;y;x;nz;ny;nx\n{}",
            rows(4, ";").replace('\n', ";1\n")
        )
        .into(),
        " // nothing\n1\t2\t3\t0\t0\t-2e0\n% end".into(),
    ]
}

pub fn points_pcd() -> Vec<Vec<u8>> {
    let header = |count: usize, data: &str| {
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z normal_x normal_y normal_z\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nCOUNT 1 1 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {data}\n"
        )
    };
    let values: Vec<[u8; 24]> = ball(4)
        .points
        .iter()
        .map(|p| {
            let mut row = [0; 24];
            for (place, v) in row
                .chunks_exact_mut(4)
                .zip(p.position.iter().chain(&p.normal))
            {
                place.copy_from_slice(&(*v as f32).to_le_bytes());
            }
            row
        })
        .collect();
    let binary = [header(4, "binary").as_bytes(), &values.concat()].concat();
    // Compressed: field by field, here in literal runs of 16 bytes.
    let mut packed = Vec::new();
    for field in 0..6 {
        packed.push(15);
        packed.extend(values.iter().flat_map(|row| &row[4 * field..4 * field + 4]));
    }
    let mut compressed = header(4, "binary_compressed").into_bytes();
    compressed.extend((packed.len() as u32).to_le_bytes());
    compressed.extend(96_u32.to_le_bytes());
    compressed.extend(packed);
    vec![
        format!("{}{}", header(4, "ascii"), rows(4, " ")).into(),
        binary,
        compressed,
    ]
}

pub fn mesh_ply() -> Vec<Vec<u8>> {
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let ascii = format!(
        "{}0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n4 0 1 2 3\n",
        head("ascii")
    );
    let mut binary = head("binary_little_endian").into_bytes();
    for v in [
        0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    ] {
        binary.extend(v.to_le_bytes());
    }
    for face in [[0_i32, 1, 2], [0, 2, 3]] {
        binary.push(3);
        binary.extend(face.iter().flat_map(|v| v.to_le_bytes()));
    }
    vec![ascii.into(), binary]
}

pub fn mesh_stl() -> Vec<Vec<u8>> {
    let ascii = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nfacet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 1 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid a\n";
    let mut binary = vec![b'x'; 80];
    binary.extend(2_u32.to_le_bytes());
    for k in 0..2 {
        for v in 0..12 {
            binary.extend(((v * (k + 1) % 5) as f32).to_le_bytes());
        }
        binary.extend([0, 0]);
    }
    vec![ascii.into(), binary]
}

pub fn mesh_obj() -> Vec<Vec<u8>> {
    vec![
        b"# a thing\nv 0 0 0\nv 1 0 0\nv 0 1 0 1.0\nv 0 0 1\nvn 0 0 1\nvt 0 0\nf 1 2 3\nf 1/1/1 3//1 -1/1 2\n".to_vec(),
        b"v 0 0 0\nv 1 0 0\nv 0 1 \\\n0\nf 1 2 \\\n3\n".to_vec(),
    ]
}

pub fn hand_urdf() -> Vec<Vec<u8>> {
    vec![
        Hand::THREE_FINGER_URDF.as_bytes().to_vec(),
        b"<robot name=\"r\"><link name=\"base\"/><link name=\"a_tip\"/><joint name=\"j\" type=\"revolute\"><parent link=\"base\"/><child link=\"a_tip\"/><origin xyz=\"0 0 0.1\" rpy=\"0 1.5707963 0\"/><axis xyz=\"0 1 0\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint></robot>".to_vec(),
    ]
}

pub fn hand_file() -> Vec<Vec<u8>> {
    vec![
        br#"{"urdf":"hand.urdf","fingers":[{"name":"a","tip_link":"index_tip"},{"name":"b","tip_link":"thumb_tip","sensor_link":"thumb_distal"}]}"#.to_vec(),
    ]
}

pub fn load_table() -> Vec<Vec<u8>> {
    let mut text = "fx,fy,fz,mx,my,mz,g1,g2,g3,g4,g5,g6\n# a comment\n".to_owned();
    for k in 0..6 {
        let row: Vec<String> = (0..12)
            .map(|c| match c {
                c if c == k => "5".into(),
                c if c == k + 6 => "12345".into(),
                c if c > 6 => format!("{}", 10 * c * k % 7),
                _ => "0".into(),
            })
            .collect();
        let _ = writeln!(text, "{}", row.join(","));
    }
    let only_loads = "mz,my,mx,fz,fy,fx,note\n1,0,0,0,0,0,x\n0,1,0,0,0,0,y\n";
    vec![text.into(), only_loads.into()]
}

pub fn surface() -> Vec<Vec<u8>> {
    let written = |file: SurfaceFile| file.to_bytes().expect("a sound surface");
    let file = SurfaceFile {
        surface: lumpy_sphere(0),
        chart: None,
        units: Some("mm".into()),
        provenance: Provenance::default(),
        error: None,
    };
    // A touched cap as one chart.
    let mut cap = ball(120);
    cap.points.retain(|p| p.normal.z > 0.4);
    let options = Options {
        chart: Some(2),
        threads: Some(1),
        max_patches: 8,
        ..Options::default()
    };
    let made = reconstruct(&cap, &options, &|_| {}).expect("a cap is a disk");
    let chart = SurfaceFile {
        surface: Default::default(),
        chart: made.chart,
        units: None,
        provenance: Provenance::default(),
        error: made.report.error,
    };
    vec![written(file), written(chart)]
}

pub fn points() -> Vec<Vec<u8>> {
    let doubles = |kind: u8, cloud: &Cloud| {
        let mut bytes = vec![kind << 2];
        for p in &cloud.points {
            let values = p.position.iter().chain(&p.normal);
            bytes.extend(values.flat_map(|v| v.to_le_bytes()));
        }
        bytes
    };
    let small = |kind: u8, values: &[[i8; 6]]| {
        let mut bytes = vec![kind << 2 | 2];
        bytes.extend(values.iter().flatten().map(|v| *v as u8));
        bytes
    };
    let lattice = |at: fn(i8, i8) -> [i8; 6]| -> Vec<[i8; 6]> {
        (-3..4)
            .flat_map(|a| (-3..4).map(move |b| at(a, b)))
            .collect()
    };
    let plane = lattice(|a, b| [a, b, 0, 0, 0, 1]);
    let step = lattice(|a, b| [a, b, if a > 0 { 3 } else { 0 }, 0, 0, 1]);
    let line = lattice(|a, b| [a + 7 * b, 0, 0, 0, 0, 1]);
    let torn = lattice(|a, b| [a, b, 0, 0, 0, if (a + b) % 2 == 0 { 1 } else { -1 }]);
    let box_sides: Vec<[i8; 6]> = lattice(|a, b| [9 * a, 9 * b, 30, 0, 0, 1])
        .into_iter()
        .flat_map(|[a, b, c, ..]| {
            [
                [a, b, c, 0, 0, 1],
                [a, b, -c, 0, 0, -1],
                [c, a, b, 1, 0, 0],
                [-c, a, b, -1, 0, 0],
            ]
        })
        .collect();
    let mut all = vec![
        small(0, &plane),
        small(0, &step),
        small(0, &line),
        small(0, &torn),
        small(0, &box_sides),
        small(2, &box_sides),
        small(1, &plane),
        small(0, &[[1, 2, 3, 0, 0, 1]; 9]),
    ];
    all.extend((0..8).map(|kind| doubles(kind, &ball(40 + 10 * usize::from(kind)))));
    // All with little to do, and some as a user would have them.
    let usual = [0, 1, 2, 8, 9, 10].map(|n: usize| {
        let mut seed = all[n].clone();
        seed[0] |= USUAL;
        seed
    });
    all.extend(usual);
    all
}
