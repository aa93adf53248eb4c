//! Properties of the wire: everything comes back, nothing damaged does, garbage costs one frame.

use heapless::{String, Vec};
use palpus_protocol::*;
use proptest::prelude::*;

fn encoded(message: &BoardMessage) -> std::vec::Vec<u8> {
    let mut out = [0; MAX_FRAME_BYTES];
    let length = message
        .encode(&mut out)
        .expect("MAX_FRAME_BYTES are enough");
    out[..length].to_vec()
}

fn encoded_request(message: &HostMessage) -> std::vec::Vec<u8> {
    let mut out = [0; MAX_FRAME_BYTES];
    let length = message
        .encode(&mut out)
        .expect("MAX_FRAME_BYTES are enough");
    out[..length].to_vec()
}

/// Everything the decoder makes of some bytes: bodies of frames, or the damage.
fn decode(
    decoder: &mut Decoder,
    bytes: &[u8],
) -> std::vec::Vec<Result<(u8, std::vec::Vec<u8>), FrameError>> {
    let mut found = std::vec::Vec::new();
    for &byte in bytes {
        if let Some(result) = decoder.push(byte) {
            found.push(result.map(|frame| (frame.kind, frame.body.to_vec())));
        }
    }
    found
}

fn decode_one<M: for<'a> TryFrom<Frame<'a>, Error = MessageError>>(bytes: &[u8]) -> M {
    let mut decoder = Decoder::new();
    let (last, rest) = bytes.split_last().expect("a frame");
    for &byte in rest {
        assert!(decoder.push(byte).is_none());
    }
    let frame = decoder
        .push(*last)
        .expect("the delimiter ends a frame")
        .expect("undamaged");
    M::try_from(frame).expect("readable")
}

fn blank() -> Contact {
    Contact {
        sequence: 0,
        board_time_us: 0,
        point_mm: [0.0; 3],
        normal: [0.0, 0.0, 1.0],
        normal_force_n: 0.0,
        tangential_force_n: 0.0,
        spin_n_mm: 0.0,
        sigma_mm: 0.0,
        joint_angles_rad: [0.0; 3],
        flags: ContactFlags::none(),
    }
}

fn unit_vector() -> impl Strategy<Value = [f32; 3]> {
    (-1.0f64..1.0, 0.0f64..std::f64::consts::TAU).prop_map(|(z, angle)| {
        let r = (1.0 - z * z).sqrt();
        [(r * angle.cos()) as f32, (r * angle.sin()) as f32, z as f32]
    })
}

prop_compose! {
    fn contact()(
        sequence in 0..CONTACT_SEQUENCE_MODULUS,
        board_time_us in 0..CONTACT_TIME_MODULUS_US,
        point_mm in [-65.5f32..65.5, -65.5f32..65.5, -65.5f32..65.5],
        normal in unit_vector(),
        normal_force_n in 0.0f32..65.5,
        tangential_force_n in 0.0f32..65.5,
        spin_n_mm in -327.0f32..327.0,
        sigma_mm in 0.0f32..65.5,
        joint_angles_rad in [-10.4f32..10.4, -10.4f32..10.4, -10.4f32..10.4],
        flags in 0u32..0x0100_0000,
    ) -> Contact {
        let flags = ContactFlags::from_bits(flags & !ContactFlags::CLIPPED.bits());
        Contact { sequence, board_time_us, point_mm, normal, normal_force_n, tangential_force_n, spin_n_mm, sigma_mm, joint_angles_rad, flags }
    }
}

fn calibration() -> impl Strategy<Value = Calibration> {
    (1u32.., 1u8..=8, proptest::collection::vec(-1e3f32..1e3, 48)).prop_map(
        |(id, gauges, values)| {
            Calibration::sealed(id, gauges, &values[..6 * usize::from(gauges)]).expect("sound")
        },
    )
}

fn outcome() -> impl Strategy<Value = Outcome> {
    prop_oneof![
        Just(Outcome::Done),
        any::<u32>().prop_map(Outcome::Pong),
        calibration().prop_map(Outcome::Calibration),
        (
            any::<u16>(),
            proptest::collection::vec((any::<i32>(), -1e9f32..1e9), 0..=8)
        )
            .prop_map(|(samples, gauges)| {
                Outcome::Tared(Tared {
                    samples,
                    offset_counts: gauges.iter().map(|g| g.0).collect(),
                    noise_counts: gauges.iter().map(|g| g.1).collect(),
                })
            }),
        any::<[u64; 3]>().prop_map(|[host_send_us, board_receive_us, board_send_us]| {
            Outcome::Time(TimeSyncAnswer {
                host_send_us,
                board_receive_us,
                board_send_us,
            })
        }),
        any::<u8>().prop_map(|gauge| Outcome::Refused(Refusal::GaugeFaulty(gauge))),
        any::<u32>().prop_map(|id| Outcome::CalibrationStored(CalibrationStored {
            id,
            place: StorePlace::RamOnly
        })),
    ]
}

fn board_message() -> impl Strategy<Value = BoardMessage> {
    prop_oneof![
        (
            any::<u32>(),
            any::<[u8; 12]>(),
            "[a-z]{0,16}",
            any::<[f32; 6]>().prop_filter("equality", |v| v.iter().all(|x| !x.is_nan())),
            any::<u64>()
        )
            .prop_map(|(number, board_id, name, axes, time)| {
                BoardMessage::Identity(Identity {
                    request_id: number,
                    board_id,
                    finger_number: number as u8,
                    finger_name: String::try_from(name.as_str()).expect("short"),
                    firmware_version: String::try_from("0.1.0").expect("short"),
                    schema_hash: number.wrapping_mul(3),
                    period_us: number,
                    gauges: 6,
                    tip: TipGeometry {
                        semi_axes_mm: [axes[0], axes[1], axes[2]],
                        centre_offset_mm: [axes[3], axes[4], axes[5]],
                    },
                    calibration_id: number,
                    board_time_us: time,
                })
            }),
        (
            any::<u32>(),
            any::<u64>(),
            proptest::collection::vec((any::<i32>(), any::<i32>(), any::<u8>()), 0..=8)
        )
            .prop_map(|(sequence, board_time_us, gauges)| {
                let gauges = gauges
                    .into_iter()
                    .map(|(counts, tared_counts, flags)| GaugeValue {
                        counts,
                        tared_counts,
                        flags: GaugeFlags::from_bits(flags),
                    })
                    .collect();
                BoardMessage::RawGauges(RawGauges {
                    sequence,
                    board_time_us,
                    gauges,
                })
            }),
        (any::<u32>(), any::<u64>(), any::<u16>()).prop_map(|(n, t, q)| {
            BoardMessage::Statistics(Statistics {
                request_id: n,
                board_time_us: t,
                ticks: n,
                contact_queue_high_water: q,
                store_failures: n,
                ..Statistics::default()
            })
        }),
        (
            any::<u32>(),
            proptest::collection::vec(any::<[u32; 6]>(), 0..=4)
        )
            .prop_map(|(request_id, gauges)| {
                let gauges: Vec<GaugeCounts, GAUGES_PER_PAGE> = gauges
                    .into_iter()
                    .map(
                        |[good, saturated, open, stuck, missing, late]| GaugeCounts {
                            good,
                            saturated,
                            open,
                            stuck,
                            missing,
                            late,
                            tare_counts: i32::MIN,
                            drift_counts: i32::MAX,
                        },
                    )
                    .collect();
                BoardMessage::GaugeStatistics(GaugeStatistics {
                    request_id,
                    first: 0,
                    gauges,
                })
            }),
        (any::<u64>(), "[ -~]{0,80}").prop_map(|(board_time_us, text)| {
            BoardMessage::Log(Log {
                board_time_us,
                level: LogLevel::Error,
                text: String::try_from(text.as_str()).expect("short"),
            })
        }),
        (any::<u32>(), outcome()).prop_map(|(request_id, outcome)| BoardMessage::Reply(Reply {
            request_id,
            outcome
        })),
    ]
}

fn host_message() -> impl Strategy<Value = HostMessage> {
    let command = prop_oneof![
        any::<u32>().prop_map(Command::Ping),
        any::<[u8; 2]>().prop_map(|[contact_every, raw_every]| Command::Start(Streams {
            contact_every,
            raw_every
        })),
        Just(Command::Stop),
        any::<(u16, bool)>()
            .prop_map(|(samples, force)| Command::Tare(TareRequest { samples, force })),
        Just(Command::GetCalibration),
        calibration().prop_map(Command::SetCalibration),
        any::<u64>().prop_map(|host_send_us| Command::TimeSync(TimeSyncRequest { host_send_us })),
        Just(Command::Statistics),
    ];
    prop_oneof![
        any::<u32>().prop_map(|request_id| HostMessage::Identify(Identify { request_id })),
        (any::<u32>(), command).prop_map(|(request_id, command)| HostMessage::Request(Request {
            request_id,
            command
        })),
    ]
}

fn degrees_between(a: [f32; 3], b: [f32; 3]) -> f64 {
    // By the chord: the arc cosine has no digits left at small angles.
    let chord = a
        .iter()
        .zip(b)
        .map(|(x, y)| (f64::from(*x) - f64::from(y)).powi(2))
        .sum::<f64>()
        .sqrt();
    (2.0 * (chord / 2.0).min(1.0).asin()).to_degrees()
}

proptest! {
    #[test]
    fn contacts_come_back_within_their_resolution(contact in contact()) {
        let bytes = encoded(&BoardMessage::Contact(contact));
        // Size does not depend on the values: 254 bytes or fewer always need exactly one stuffing
        // byte.
        prop_assert_eq!(bytes.len(), CONTACT_FRAME_BYTES);
        let BoardMessage::Contact(back) = decode_one::<BoardMessage>(&bytes) else { panic!("a contact") };
        prop_assert_eq!((back.sequence, back.board_time_us, back.flags), (contact.sequence, contact.board_time_us, contact.flags));
        for axis in 0..3 {
            // Half a step, and the rounding of f32 at 65 mm and (twice) at 10 rad.
            prop_assert!((back.point_mm[axis] - contact.point_mm[axis]).abs() <= 0.001 + 8e-6);
            prop_assert!((back.joint_angles_rad[axis] - contact.joint_angles_rad[axis]).abs() <= 5e-6 + 2e-6);
        }
        prop_assert!(degrees_between(back.normal, contact.normal) <= 0.005);
        prop_assert!((back.normal_force_n - contact.normal_force_n).abs() <= 0.5e-3 + 8e-6);
        prop_assert!((back.tangential_force_n - contact.tangential_force_n).abs() <= 0.5e-3 + 8e-6);
        prop_assert!((back.spin_n_mm - contact.spin_n_mm).abs() <= 0.005 + 4e-5);
        prop_assert!((back.sigma_mm - contact.sigma_mm).abs() <= 0.5e-3 + 8e-6);
    }

    #[test]
    fn packing_is_idempotent(contact in contact()) {
        let first = PackedContact::from(&contact);
        let again = PackedContact::from(&Contact::from(first));
        // The normal's fold may move by one step where the sphere's scaling rounds; everything else
        // is exact.
        prop_assert!(degrees_between(Contact::from(first).normal, Contact::from(again).normal) <= 0.005);
        let strip = |packed: PackedContact| Contact { normal: [0.0, 0.0, 1.0], ..Contact::from(packed) };
        prop_assert_eq!(strip(first), strip(again));
    }

    #[test]
    fn any_floats_make_a_contact_that_is_finite_and_marked(values in any::<[f32; 13]>()) {
        let [px, py, pz, nx, ny, nz, fnorm, ft, spin, sigma, a, b, c] = values;
        let contact = Contact {
            sequence: 0, board_time_us: 0, point_mm: [px, py, pz], normal: [nx, ny, nz], normal_force_n: fnorm,
            tangential_force_n: ft, spin_n_mm: spin, sigma_mm: sigma, joint_angles_rad: [a, b, c], flags: ContactFlags::none(),
        };
        let BoardMessage::Contact(back) = decode_one::<BoardMessage>(&encoded(&BoardMessage::Contact(contact))) else { panic!("a contact") };
        let length: f32 = back.normal.iter().map(|x| x * x).sum();
        prop_assert!((length - 1.0).abs() < 1e-5);
        prop_assert!(back.point_mm.iter().chain(&back.joint_angles_rad).all(|x| x.is_finite()));
        if values.iter().any(|x| !x.is_finite()) || px.abs() > 65.6 || !(-0.01..=65.6).contains(&fnorm) {
            prop_assert!(back.flags.contains(ContactFlags::CLIPPED) && !back.is_valid());
        }
    }

    #[test]
    fn board_messages_come_back(message in board_message()) {
        prop_assert_eq!(decode_one::<BoardMessage>(&encoded(&message)), message);
    }

    #[test]
    fn host_messages_come_back(message in host_message()) {
        prop_assert_eq!(decode_one::<HostMessage>(&encoded_request(&message)), message);
    }

    #[test]
    fn garbage_costs_at_most_the_frame_it_runs_into(
        garbage in proptest::collection::vec(any::<u8>(), 0..600),
        frames in proptest::collection::vec(board_message(), 2..5),
    ) {
        let mut decoder = Decoder::new();
        decode(&mut decoder, &garbage);
        let mut found = std::vec::Vec::new();
        for frame in &frames {
            found.extend(decode(&mut decoder, &encoded(frame)));
        }
        // The last n - 1 frames are whole, in order, whatever came before.
        prop_assert!(found.len() >= frames.len());
        for (message, result) in frames.iter().rev().zip(found.iter().rev()).take(frames.len() - 1) {
            let (kind, body) = result.as_ref().expect("undamaged");
            let bytes = encoded(message);
            let mut stuffed = bytes[..bytes.len() - 1].to_vec();
            let expected = Frame::open(&mut stuffed).expect("undamaged");
            prop_assert_eq!((*kind, &body[..]), (expected.kind, expected.body));
        }
    }

    #[test]
    fn damaged_frames_are_refused_and_counted(
        message in board_message(),
        flips in proptest::collection::vec((any::<proptest::sample::Index>(), 1u8..), 1..8),
    ) {
        let clean = encoded(&message);
        let mut bytes = clean.clone();
        for (place, mask) in &flips {
            let place = place.index(bytes.len());
            bytes[place] ^= mask;
        }
        prop_assume!(bytes != clean);
        let mut decoder = Decoder::new();
        let mut found = decode(&mut decoder, &bytes);
        found.extend(decode(&mut decoder, &[DELIMITER]));
        prop_assert!(found.iter().all(Result::is_err), "{:?}", found);
        prop_assert_eq!(decoder.counters().bad() as usize, found.len());
        prop_assert_eq!(decoder.counters().frames, 0);
    }

    #[test]
    fn any_body_under_a_good_check_sum_is_read_or_refused(kind in any::<u8>(), body in proptest::collection::vec(any::<u8>(), 0..240)) {
        let [low, high] = SCHEMA_TAG.to_le_bytes();
        let mut raw = vec![MAGIC, PROTOCOL_VERSION, low, high, kind];
        raw.extend(&body);
        let crc = CRC.checksum(&raw);
        raw.extend(crc.to_le_bytes());
        let mut stuffed = vec![0; raw.len() + 4];
        let length = cobs::encode(&raw, &mut stuffed);
        let frame = Frame::open(&mut stuffed[..length]).expect("undamaged");
        // Either may refuse; neither may panic, and no kind is of both directions.
        let as_board = BoardMessage::try_from(frame);
        let as_host = HostMessage::try_from(frame);
        prop_assert!(as_board.is_err() || as_host.is_err());
    }

    #[test]
    fn times_widen_to_the_nearest(reference in 0u64..1 << 50, ahead in prop_oneof![-(1i64 << 39)..1 << 39, Just(-(1i64 << 39)), Just((1i64 << 39) - 1)]) {
        let time = reference.saturating_add_signed(ahead);
        let contact = Contact { board_time_us: time % CONTACT_TIME_MODULUS_US, ..blank() };
        prop_assert_eq!(contact.widen_time_us(reference), time);
    }

    #[test]
    fn lost_contacts_are_counted_over_the_wrap(previous in 0..CONTACT_SEQUENCE_MODULUS, lost in 0..CONTACT_SEQUENCE_MODULUS - 1) {
        let sequence = (previous + lost + 1) % CONTACT_SEQUENCE_MODULUS;
        let contact = Contact { sequence, ..blank() };
        prop_assert_eq!(contact.lost_since(previous), lost);
    }
}

/// A frame as another build would send it.
fn foreign(version: u8, tag: u16, kind: u8, body: &[u8]) -> std::vec::Vec<u8> {
    let [low, high] = tag.to_le_bytes();
    let mut raw = vec![MAGIC, version, low, high, kind];
    raw.extend(body);
    let crc = CRC.checksum(&raw);
    raw.extend(crc.to_le_bytes());
    let mut stuffed = vec![0; raw.len() + 4];
    let length = cobs::encode(&raw, &mut stuffed);
    stuffed.truncate(length);
    stuffed
}

#[test]
fn a_mismatch_names_both_sides() {
    let mut bytes = foreign(9, SCHEMA_TAG, 0x02, &[0; 37]);
    let error = BoardMessage::try_from(Frame::open(&mut bytes).expect("undamaged"))
        .expect_err("another version");
    assert_eq!(
        error,
        MessageError::Version {
            ours: PROTOCOL_VERSION,
            theirs: 9
        }
    );
    let mut bytes = foreign(PROTOCOL_VERSION, !SCHEMA_TAG, 0x02, &[0; 37]);
    let error = BoardMessage::try_from(Frame::open(&mut bytes).expect("undamaged"))
        .expect_err("another schema");
    assert_eq!(
        error,
        MessageError::Schema {
            ours: SCHEMA_TAG,
            theirs: !SCHEMA_TAG
        }
    );
    // A kind of a later version is blamed on the version.
    let mut bytes = foreign(9, SCHEMA_TAG, 0x3f, &[]);
    let error = BoardMessage::try_from(Frame::open(&mut bytes).expect("undamaged"))
        .expect_err("another version");
    assert_eq!(
        error,
        MessageError::Version {
            ours: PROTOCOL_VERSION,
            theirs: 9
        }
    );
}

#[test]
fn identify_is_understood_across_versions_and_with_appended_fields() {
    let mut bytes = foreign(9, !SCHEMA_TAG, 0x81, &[5, 1, 2, 3]);
    let message =
        HostMessage::try_from(Frame::open(&mut bytes).expect("undamaged")).expect("frozen");
    assert_eq!(message, HostMessage::Identify(Identify { request_id: 5 }));
    // Bytes to spare in any other message are an error.
    let mut bytes = foreign(PROTOCOL_VERSION, SCHEMA_TAG, 0x82, &[5, 2, 9]);
    let error = HostMessage::try_from(Frame::open(&mut bytes).expect("undamaged"))
        .expect_err("a byte too many");
    assert_eq!(error, MessageError::Body { kind: 0x82 });
}

#[test]
fn the_octahedral_fold_stays_within_its_stated_error() {
    // A dense sweep of directions, both hemispheres, poles, seams and equator included.
    let mut worst = 0.0f64;
    for i in 0..=400 {
        for j in 0..800 {
            let polar = std::f64::consts::PI * f64::from(i) / 400.0;
            let turn = std::f64::consts::TAU * f64::from(j) / 800.0;
            let normal = [
                (polar.sin() * turn.cos()) as f32,
                (polar.sin() * turn.sin()) as f32,
                polar.cos() as f32,
            ];
            let contact = Contact { normal, ..blank() };
            worst = worst.max(degrees_between(
                Contact::from(PackedContact::from(&contact)).normal,
                normal,
            ));
        }
    }
    assert!(worst <= 0.004, "{worst}");
}

#[test]
fn a_buffer_that_is_too_small_is_refused_at_every_length() {
    let message = BoardMessage::Log(Log {
        board_time_us: 0,
        level: LogLevel::Info,
        text: String::try_from("a line of text").expect("short"),
    });
    let whole = encoded(&message);
    for room in 0..whole.len() {
        assert_eq!(
            message.encode(&mut vec![0; room]),
            Err(EncodeError::BufferTooSmall)
        );
    }
    assert_eq!(message.encode(&mut vec![0; whole.len()]), Ok(whole.len()));
}

#[test]
fn a_stream_of_anything_but_delimiters_is_one_long_frame() {
    let mut decoder = Decoder::new();
    assert!(decode(&mut decoder, &[0x55; 10_000]).is_empty());
    assert_eq!(
        decode(&mut decoder, &[DELIMITER]),
        [Err(FrameError::TooLong)]
    );
    assert_eq!(decode(&mut decoder, &[DELIMITER; 5]), []);
    let counters = decoder.counters();
    assert_eq!(
        (counters.bytes, counters.too_long, counters.bad()),
        (10_006, 1, 1)
    );
}
