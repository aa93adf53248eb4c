//! What a viewer is sent: the page, then messages about what is new.
//!
//! | event | JSON |
//! |---|---|
//! | `state` | ten times a second: time, bytes, fingers with force, validity, counters and joints, notes, the end |
//! | `points` | contacts since the last such message: `epoch`, `from`, and base 64 of 29 bytes each: place (mm), normal, sigma (mm) as 7 little-endian `f32`, finger as `u8` |
//! | `surface` | a new surface: figures, and base 64 of places, normals, sigma (`f32`), triangles (`u32`), borders |
//!
//! A number that is not finite is `null`.

use super::refit::LiveSurface;
use super::seen::{FingerView, SeenPoint, Shared, View};
use crate::Vec3;
use crate::link::session::Weight;
use crate::picture::web;
use serde_json::{Value, json};
use std::io::Write;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Pause between two looks for what is new.
const EVERY: Duration = Duration::from_millis(100);
/// Points in one message.
const MOST_POINTS: usize = 4096;

/// The page.
pub fn page() -> String {
    let parts = [
        (
            "style",
            format!("{}{}", web::STYLE, include_str!("page/live.css")),
        ),
        (
            "map",
            web::base64(&web::colours(crate::picture::ColourMap::Cividis)),
        ),
        ("three", web::THREE.to_owned()),
        (
            "script",
            format!("{}{}", web::SPACE, include_str!("page/live.js")),
        ),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    web::filled(include_str!("page/live.html"), &parts)
}

/// Sends what is new until the viewer goes or the capture ends.
pub fn events(to: &mut impl Write, shared: &Shared) -> std::io::Result<()> {
    let mut epoch = None;
    let mut sent = 0;
    let mut noted = 0;
    let mut surface_number = 0;
    while !shared.stop.load(Ordering::Relaxed) {
        // The lock is held to copy, never while something is sent.
        let (view, now, points, surface, more) = {
            let seen = shared.lock();
            if epoch != Some(seen.epoch()) {
                (epoch, sent) = (Some(seen.epoch()), 0);
            }
            let all = seen.points();
            let until = all.len().min(sent + MOST_POINTS);
            let more = until < all.len();
            let points = all[sent..until].to_vec();
            (seen.view(), seen.epoch(), points, seen.surface(), more)
        };
        let mut text = message("state", &state(&view, noted));
        noted = view.notes.last().map_or(noted, |note| note.number);
        if !points.is_empty() {
            let data = web::base64(&packed(&points));
            text += &message("points", &json!({"epoch": now, "from": sent, "data": data}));
            sent += points.len();
        }
        if let Some(surface) = surface.filter(|s| s.number > surface_number) {
            surface_number = surface.number;
            text += &message("surface", &surface_message(&surface));
        }
        to.write_all(text.as_bytes())?;
        if view.ended.is_some() && !more {
            break;
        }
        if !more {
            std::thread::sleep(EVERY);
        }
    }
    Ok(())
}

fn message(kind: &str, data: &Value) -> String {
    format!("event: {kind}\ndata: {data}\n\n")
}

fn packed(points: &[SeenPoint]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(29 * points.len());
    for p in points {
        for x in p.position_mm.iter().chain(&p.normal).chain([&p.sigma_mm]) {
            bytes.extend(x.to_le_bytes());
        }
        bytes.push(p.finger);
    }
    bytes
}

fn place(v: &Vec3) -> [f64; 3] {
    [v.x, v.y, v.z]
}

fn state(view: &View, noted: u64) -> Value {
    let progress = &view.progress;
    let notes: Vec<Value> = view
        .notes
        .iter()
        .filter(|note| note.number > noted)
        .map(|note| {
            let weight = match note.weight {
                Weight::Info => "info",
                Weight::Warning => "warning",
                Weight::Error => "error",
            };
            json!({"number": note.number, "at": note.at.as_secs_f64(), "finger": note.finger, "weight": weight, "text": note.text})
        })
        .collect();
    json!({
        "seconds": progress.elapsed.as_secs_f64(),
        "points": progress.points,
        "bytes": progress.safe_bytes,
        "fingers": view.fingers.iter().map(finger).collect::<Vec<_>>(),
        "notes": notes,
        "no_surface": view.no_surface,
        "ended": view.ended,
    })
}

fn finger(view: &FingerView) -> Value {
    let s = &view.status;
    let last = view.last.map(|touch| {
        let contact = &touch.contact;
        json!({
            "force_n": contact.normal_force_n, "tangential_n": contact.tangential_force_n,
            "sigma_mm": contact.sigma_mm, "valid": contact.is_valid(),
            "reasons": view.reasons(),
            "at_mm": place(&touch.world.position_mm),
        })
    });
    json!({
        "name": view.name, "port": s.port, "connected": s.connected,
        "per_s": view.contacts_per_s, "valid_share": view.valid_share,
        "contacts": s.contacts, "valid": s.valid, "lost": s.lost + s.dropped_by_host,
        "bad": s.bad + s.unreadable, "reconnects": s.reconnects, "reboots": s.reboots,
        "clock_bound_us": s.clock_bound_us,
        "last": last, "chain_mm": view.chain_mm.iter().map(place).collect::<Vec<_>>(),
    })
}

fn surface_message(surface: &LiveSurface) -> Value {
    let sampled = &surface.sampled;
    let reals = |values: &mut dyn Iterator<Item = f64>| {
        web::base64(
            &values
                .flat_map(|x| (x as f32).to_le_bytes())
                .collect::<Vec<u8>>(),
        )
    };
    let places = |vectors: &mut dyn Iterator<Item = &Vec3>| reals(&mut vectors.flat_map(place));
    let triangles: Vec<u8> = sampled
        .triangles
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    json!({
        "number": surface.number, "points": surface.points, "seconds": surface.seconds,
        "patches": surface.patches, "pieces": surface.pieces, "handles": surface.handles,
        "openings": surface.openings, "rms_mm": surface.rms_mm,
        "low": web::quantile(&sampled.sigma, 0.02), "high": web::quantile(&sampled.sigma, 0.98),
        "positions": places(&mut sampled.positions.iter()),
        "normals": places(&mut sampled.normals.iter()),
        "sigma": reals(&mut sampled.sigma.iter().copied()),
        "triangles": web::base64(&triangles),
        "borders": places(&mut surface.borders.iter().flatten()),
    })
}
