//! Pins every byte of every message against `golden_bytes.txt`: a change there is a change of the
//! wire.
//!
//! Each line is a message's name and its body in hex; lines that begin with `frame` are whole
//! frames as they go over the wire.

use heapless::{String, Vec};
use palpus_protocol::*;

fn hex(bytes: &[u8]) -> std::string::String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Encodes, and takes the frame apart again: the body in hex, once the envelope is as it must be.
fn body(frame: &[u8], kind: u8) -> std::string::String {
    let (&DELIMITER, stuffed) = frame.split_last().expect("a frame") else {
        panic!("no delimiter")
    };
    let mut bytes = stuffed.to_vec();
    let frame = Frame::open(&mut bytes).expect("an undamaged frame");
    assert_eq!(
        (frame.version, frame.schema_tag, frame.kind),
        (PROTOCOL_VERSION, SCHEMA_TAG, kind)
    );
    hex(frame.body)
}

/// The lines of `golden_bytes.txt`, as this build would write them.
#[derive(Default)]
struct Lines(std::string::String);

impl Lines {
    fn add(&mut self, name: &str, value: &str) {
        self.0 += &format!("{name} {value}\n");
    }

    fn board(&mut self, name: &str, message: impl Into<BoardMessage>) {
        let message = message.into();
        let mut out = [0; MAX_FRAME_BYTES];
        let length = message.encode(&mut out).expect("room");
        self.add(name, &body(&out[..length], message.kind()));
    }

    fn host(&mut self, name: &str, message: impl Into<HostMessage>) {
        let message = message.into();
        let mut out = [0; MAX_FRAME_BYTES];
        let length = message.encode(&mut out).expect("room");
        self.add(name, &body(&out[..length], message.kind()));
    }

    fn request(&mut self, name: &str, command: Command) {
        self.host(
            name,
            Request {
                request_id: 300,
                command,
            },
        );
    }

    fn reply(&mut self, name: &str, outcome: Outcome) {
        self.board(
            name,
            Reply {
                request_id: 300,
                outcome,
            },
        );
    }
}

fn text<const N: usize>(text: &str) -> String<N> {
    String::try_from(text).expect("short enough")
}

fn calibration() -> Calibration {
    let matrix: std::vec::Vec<f32> = (0..12).map(|i| i as f32 - 5.5).collect();
    Calibration::sealed(77, 2, &matrix).expect("sound")
}

fn contact() -> Contact {
    Contact {
        sequence: 0x01_0203,
        board_time_us: 0x05_0403_0201,
        point_mm: [7.374, -8.788, 16.384],
        normal: [0.36868783, -0.43938504, 0.81915206],
        normal_force_n: 2.0,
        tangential_force_n: 0.6,
        spin_n_mm: -4.0,
        sigma_mm: 0.28,
        joint_angles_rad: [0.1, -1.5, 3.1],
        flags: ContactFlags::LOADED.union(ContactFlags::FRICTION_LIMIT),
    }
}

fn sizes_and_frames(lines: &mut Lines) {
    lines.add("schema-hash", &format!("{SCHEMA_HASH:08x}"));
    lines.add(
        "largest-body-raw-frame",
        &format!("{MAX_BODY_BYTES} {MAX_RAW_BYTES} {MAX_FRAME_BYTES}"),
    );
    for (name, body_bytes) in [
        ("identity", Identity::MAX_BYTES),
        ("contact", Contact::MAX_BYTES),
        ("raw-gauges", RawGauges::MAX_BYTES),
        ("statistics", Statistics::MAX_BYTES),
        ("gauge-statistics", GaugeStatistics::MAX_BYTES),
        ("log", Log::MAX_BYTES),
        ("reply", Reply::MAX_BYTES),
        ("identify", Identify::MAX_BYTES),
        ("request", Request::MAX_BYTES),
    ] {
        lines.add(
            &format!("largest-frame {name}"),
            &wire_bytes(body_bytes).to_string(),
        );
    }
    let mut out = [0; MAX_FRAME_BYTES];
    let length = HostMessage::from(Identify { request_id: 1 })
        .encode(&mut out)
        .expect("room");
    lines.add("frame-identify", &hex(&out[..length]));
    let length = BoardMessage::from(contact())
        .encode(&mut out)
        .expect("room");
    lines.add("frame-contact", &hex(&out[..length]));
    assert_eq!(length, 48);
}

fn board_messages(lines: &mut Lines) {
    let tip = TipGeometry {
        semi_axes_mm: [20.0, 20.0, 25.0],
        centre_offset_mm: [0.0, 0.0, 35.0],
    };
    let identity = Identity {
        request_id: 1,
        board_id: *b"palpus-board",
        finger_number: 2,
        finger_name: text("thumb"),
        firmware_version: text("0.1.0"),
        schema_hash: 0x1234_5678,
        period_us: 5000,
        gauges: 6,
        tip,
        calibration_id: 77,
        board_time_us: 1_000_000,
    };
    lines.board("identity", identity);
    lines.board("contact", contact());
    let value = GaugeValue {
        counts: -8_388_608,
        tared_counts: 8_388_607,
        flags: GaugeFlags::SATURATED,
    };
    let gauges = Vec::from_slice(&[value; 2]).expect("two fit");
    lines.board(
        "raw-gauges",
        RawGauges {
            sequence: 9,
            board_time_us: 45_000,
            gauges,
        },
    );
    let statistics = Statistics {
        request_id: 300,
        board_time_us: 1,
        gauges: 2,
        ticks: 3,
        rate_millihertz: 4,
        jitter_rms_us: 5,
        jitter_max_us: 6,
        tick_max_us: 7,
        overruns: 8,
        late_ticks: 9,
        contacts: 10,
        contacts_valid: 11,
        contacts_dropped: 12,
        raw_dropped: 13,
        logs_dropped: 14,
        replies_dropped: 15,
        contact_queue_high_water: 16,
        raw_queue_high_water: 17,
        log_queue_high_water: 18,
        reply_queue_high_water: 19,
        bytes_received: 20,
        frames_received: 21,
        frames_bad: 22,
        frames_refused: 23,
        requests_repeated: 24,
        chip_resets: 25,
        joint_errors: 26,
        store_failures: 27,
    };
    lines.board("statistics", statistics);
    let gauge = GaugeCounts {
        good: 1,
        saturated: 2,
        open: 3,
        stuck: 4,
        missing: 5,
        late: 6,
        tare_counts: -7,
        drift_counts: 8,
    };
    let gauges = Vec::from_slice(&[gauge]).expect("one fits");
    lines.board(
        "gauge-statistics",
        GaugeStatistics {
            request_id: 300,
            first: 4,
            gauges,
        },
    );
    lines.board(
        "log",
        Log {
            board_time_us: 128,
            level: LogLevel::Warning,
            text: text("chip 2 reset"),
        },
    );
}

fn replies(lines: &mut Lines) {
    lines.reply("reply-done", Outcome::Done);
    lines.reply("reply-pong", Outcome::Pong(5));
    let tared = Tared {
        samples: 200,
        offset_counts: Vec::from_slice(&[-1, 64]).expect("two fit"),
        noise_counts: Vec::from_slice(&[0.5, 1.5]).expect("two fit"),
    };
    lines.reply("reply-tared", Outcome::Tared(tared));
    lines.reply("reply-calibration", Outcome::Calibration(calibration()));
    let stored = CalibrationStored {
        id: 77,
        place: StorePlace::Permanent,
    };
    lines.reply("reply-stored-permanent", Outcome::CalibrationStored(stored));
    let stored = CalibrationStored {
        id: 77,
        place: StorePlace::RamOnly,
    };
    lines.reply("reply-stored-ram", Outcome::CalibrationStored(stored));
    let time = TimeSyncAnswer {
        host_send_us: 1 << 40,
        board_receive_us: 1000,
        board_send_us: 1200,
    };
    lines.reply("reply-time", Outcome::Time(time));
    for (name, refusal) in [
        ("in-contact", Refusal::InContact),
        ("busy", Refusal::Busy),
        ("sample-count", Refusal::SampleCount),
        ("gauge-faulty", Refusal::GaugeFaulty(3)),
        ("unsettled", Refusal::Unsettled),
        ("no-calibration", Refusal::NoCalibration),
        ("calibration-crc", Refusal::CalibrationCrc),
        ("calibration-shape", Refusal::CalibrationShape(6)),
        ("calibration-value", Refusal::CalibrationValue),
        ("streaming", Refusal::Streaming),
    ] {
        lines.reply(&format!("refused-{name}"), Outcome::Refused(refusal));
    }
}

fn host_messages(lines: &mut Lines) {
    lines.host("identify", Identify { request_id: 1 });
    lines.request("ping", Command::Ping(5));
    lines.request(
        "start",
        Command::Start(Streams {
            contact_every: 1,
            raw_every: 20,
        }),
    );
    lines.request("stop", Command::Stop);
    lines.request(
        "tare",
        Command::Tare(TareRequest {
            samples: 200,
            force: true,
        }),
    );
    lines.request("get-calibration", Command::GetCalibration);
    lines.request("set-calibration", Command::SetCalibration(calibration()));
    lines.request(
        "time-sync",
        Command::TimeSync(TimeSyncRequest {
            host_send_us: 1 << 40,
        }),
    );
    lines.request("statistics-request", Command::Statistics);
}

#[test]
fn every_message_keeps_its_bytes() {
    let mut lines = Lines::default();
    sizes_and_frames(&mut lines);
    board_messages(&mut lines);
    replies(&mut lines);
    host_messages(&mut lines);
    let golden = include_str!("golden_bytes.txt");
    assert!(
        lines.0 == golden,
        "the wire has changed; golden_bytes.txt would now be:\n{}",
        lines.0
    );
}
