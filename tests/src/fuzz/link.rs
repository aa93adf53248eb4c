//! The link's two ends: the host's and board's decoder, and the board's command handler.

use crate::bench_board::{BenchSettings, FirmwareBoard, firmware};
use palpus_protocol::{
    BoardMessage, CRC, DELIMITER, Decoder, Frame, HostMessage, Identify, MAX_BODY_BYTES,
    MAX_FRAME_BYTES, PROTOCOL_VERSION, SCHEMA_TAG,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A frame with a right check sum around any body: what damage makes once in 4 billion times.
pub fn framed(version: u8, tag: u16, kind: u8, body: &[u8]) -> Vec<u8> {
    let mut raw = vec![b'P', version, tag as u8, (tag >> 8) as u8, kind];
    raw.extend(&body[..body.len().min(MAX_BODY_BYTES)]);
    raw.extend(CRC.checksum(&raw).to_le_bytes());
    let mut out = vec![0];
    let mut distance_at = 0;
    for byte in raw {
        if byte == DELIMITER {
            out[distance_at] = (out.len() - distance_at) as u8;
            distance_at = out.len();
        }
        out.push(byte);
    }
    out[distance_at] = (out.len() - distance_at) as u8;
    out.push(DELIMITER);
    out
}

/// The first byte 0: the rest as a stream. Else the second is a kind, the rest a body in a frame of its own.
pub fn frames(bytes: &[u8]) {
    let stream = match bytes {
        [0, rest @ ..] => rest.to_vec(),
        [versions, kind, body @ ..] => {
            let version = PROTOCOL_VERSION.wrapping_add(versions >> 6);
            framed(
                version,
                SCHEMA_TAG ^ u16::from(versions >> 5 & 1),
                *kind,
                body,
            )
        }
        _ => return,
    };
    let mut decoder = Decoder::new();
    let mut ended = 0;
    for &byte in &stream {
        if let Some(result) = decoder.push(byte) {
            ended += 1;
            if let Ok(frame) = result {
                read_back(frame);
            }
        }
    }
    let counters = decoder.counters();
    assert_eq!(counters.frames + counters.bad(), ended);
    assert_eq!(counters.bytes as usize, stream.len());
    // Whatever came before: the first frame behind a delimiter is read.
    decoder.push(DELIMITER);
    let mut out = [0; MAX_FRAME_BYTES];
    let identify = HostMessage::from(Identify { request_id: 7 });
    let length = identify.encode(&mut out).expect("room");
    let mut read = None;
    for &byte in &out[..length] {
        if let Some(Ok(frame)) = decoder.push(byte) {
            read = HostMessage::try_from(frame).ok();
        }
    }
    assert_eq!(read, Some(identify));
}

/// A message that is read can be sent on, and is then the same frame but for what a later version appended.
fn read_back(frame: Frame<'_>) {
    let mut out = [0; MAX_FRAME_BYTES];
    let kind = frame.kind;
    let _ = frame.check_version();
    let length = match (BoardMessage::try_from(frame), HostMessage::try_from(frame)) {
        (Ok(_), Ok(_)) => panic!("kind {kind} is read in both directions"),
        (Ok(message), _) => message.encode(&mut out),
        (_, Ok(message)) => message.encode(&mut out),
        (Err(board), Err(host)) => {
            assert!(!board.to_string().is_empty() && !host.to_string().is_empty());
            return;
        }
    };
    let length = length.expect("what was read has room");
    let again = Frame::open(&mut out[..length - 1]).expect("a frame");
    assert_eq!(again.kind, kind);
}

/// What happens to a board: pieces of an operation, a length and so many bytes for it.
pub fn commands(bytes: &[u8]) {
    let loaded = Arc::new(AtomicBool::new(false));
    let settings = BenchSettings::new("index", 3);
    let mut now_us = settings.start_us;
    let mut board = firmware(&settings, now_us, &loaded);
    let mut rest = bytes;
    while let [operation, length, tail @ ..] = rest {
        let (data, after) = tail.split_at(tail.len().min(usize::from(*length)));
        rest = after;
        match (operation % 8, data) {
            (0, _) => board.receive(data, now_us),
            (1, [kind, body @ ..]) => {
                board.receive(&framed(PROTOCOL_VERSION, SCHEMA_TAG, *kind, body), now_us);
            }
            (2, _) => drop(listen(&mut board, now_us)),
            (3, [first, ..]) => loaded.store(first & 1 == 1, Ordering::Relaxed),
            (4, [a, b, c, d, ..]) => {
                now_us = now_us.saturating_add(u64::from(u32::from_le_bytes([*a, *b, *c, *d])));
                tick(&mut board, now_us);
            }
            (5, [version, kind, body @ ..]) => {
                board.receive(&framed(*version, SCHEMA_TAG ^ 1, *kind, body), now_us);
            }
            _ => {
                for _ in 0..data.len().clamp(1, 64) {
                    now_us = now_us.saturating_add(u64::from(settings.period_us));
                    tick(&mut board, now_us);
                }
            }
        }
    }
    board.receive(&[DELIMITER], now_us);
    listen(&mut board, now_us);
    board.receive(
        &framed(PROTOCOL_VERSION, SCHEMA_TAG, identify_kind(), &[77]),
        now_us,
    );
    let answers = listen(&mut board, now_us);
    let answered = answers
        .iter()
        .any(|m| matches!(m, BoardMessage::Identity(identity) if identity.request_id == 77));
    assert!(answered, "the board no longer says who it is: {answers:?}");
}

fn identify_kind() -> u8 {
    HostMessage::from(Identify { request_id: 0 }).kind()
}

fn tick(board: &mut FirmwareBoard, now_us: u64) {
    board.tick(now_us);
    board.tick_ended(now_us);
    while board.take_event().is_some() {}
}

/// All the board has to say; every frame has to be whole and readable.
fn listen(board: &mut FirmwareBoard, now_us: u64) -> Vec<BoardMessage> {
    let mut heard = Vec::new();
    while let Some(wire) = board.take_frame(now_us) {
        let (delimiter, frame) = wire.split_last().expect("no empty frame");
        assert_eq!(*delimiter, DELIMITER);
        let mut frame = frame.to_vec();
        let frame = Frame::open(&mut frame).expect("an undamaged frame");
        heard.push(BoardMessage::try_from(frame).expect("a readable message"));
    }
    heard
}
