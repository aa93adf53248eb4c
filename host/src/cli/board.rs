//! `palpus board`: talks to one board.

use super::{Common, Exit, Failure, say};
use palpus_host::link::LinkError;
use palpus_host::link::board::{
    calibration, compare_clocks, mean_counts, ping, raw, statistics, store_calibration, tare,
};
use palpus_host::link::calibration::{
    AXES, CalibrateError, Estimate, Load, UNITS, estimate, read_loads,
};
use palpus_host::link::connection::{Connection, GIVE_UP_AFTER};
use palpus_host::link::host_clock::HostClock;
use palpus_host::link::port::{DEFAULT_BAUD, wire_time};
use palpus_protocol::{GaugeFlags, Identity, RawGauges, SCHEMA_HASH, StorePlace};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::{BufRead, IsTerminal, Write as _};
use std::path::PathBuf;
use std::time::Duration;

/// Ask one board, tare it, calibrate it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The board's port.
    port: String,
    /// Baud rate of the port (USB and pseudo-terminals ignore it).
    #[arg(long, value_name = "BD", default_value_t = DEFAULT_BAUD, global = true)]
    baud: u32,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Who the board is; works with any version of the firmware.
    Info,
    /// Measured rate, jitter, what each gauge read, queues, losses.
    Stats,
    /// Take the unloaded gauges as zero.
    Tare {
        /// Periods to average over.
        #[arg(long, value_name = "N", default_value_t = 200)]
        samples: u16,
        /// Even if the tip seems to be in contact.
        #[arg(long)]
        force: bool,
    },
    /// Print the gauges' counts, raw and tared.
    Raw {
        /// How many periods to print.
        #[arg(long, value_name = "N", default_value_t = 200)]
        count: usize,
        /// Only every N-th period.
        #[arg(long, value_name = "N", default_value_t = 1)]
        every: u8,
        /// Print only the mean and the standard deviation of each gauge's tared counts.
        #[arg(long)]
        mean: bool,
    },
    /// Estimate the calibration from known loads and store it; without a file, print the one in use.
    Calibrate {
        /// Loads (fx,fy,fz in N; mx,my,mz in N mm; at the sensor's origin) and tared counts (g1, g2, …). Without
        /// the counts each load is asked for and measured.
        #[arg(value_name = "LOADS.csv")]
        loads: Option<PathBuf>,
        /// Id of the new calibration; by default one above the old.
        #[arg(long, value_name = "ID")]
        id: Option<u32>,
        /// Print the result, but leave the board as it is.
        #[arg(long)]
        dry_run: bool,
        /// Periods to average over, where counts are measured.
        #[arg(long, value_name = "N", default_value_t = 400)]
        samples: usize,
    },
    /// Time from a question to its answer.
    Ping {
        /// How many.
        #[arg(long, value_name = "N", default_value_t = 10)]
        count: u32,
    },
    /// Compare the board's clock with this computer's.
    Time {
        /// How many comparisons.
        #[arg(long, value_name = "N", default_value_t = 40)]
        count: usize,
    },
}

fn link(error: LinkError) -> Failure {
    Failure::new(Exit::Device, error)
}

/// Runs the command.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    let clock = HostClock::start();
    let mut board = Connection::open(&args.port, args.baud, clock).map_err(link)?;
    let identity = board.identify(GIVE_UP_AFTER).map_err(link)?;
    if !matches!(args.action, Action::Info) {
        board.check_peer().map_err(link)?;
    }
    let (text, value) = match args.action {
        Action::Info => info(&board, &identity),
        Action::Stats => stats(&mut board)?,
        Action::Tare { samples, force } => {
            let tared = tare(&mut board, samples, force).map_err(link)?;
            let mut text = format!("tared over {} periods\n", tared.samples);
            for (k, (offset, noise)) in tared
                .offset_counts
                .iter()
                .zip(&tared.noise_counts)
                .enumerate()
            {
                let _ = writeln!(
                    text,
                    "gauge {}: offset {offset} counts, noise {noise:.1}",
                    k + 1
                );
            }
            let value = json!({
                "samples": tared.samples,
                "offset_counts": tared.offset_counts.as_slice(),
                "noise_counts": tared.noise_counts.as_slice(),
            });
            (text, value)
        }
        Action::Raw {
            mean: true, count, ..
        } => {
            let means = mean_counts(&mut board, count).map_err(link)?;
            let mut text = String::new();
            for (k, (mean, sigma)) in means.iter().enumerate() {
                let _ = writeln!(text, "gauge {}: {mean:.1} counts, sigma {sigma:.1}", k + 1);
            }
            let (means, sigmas): (Vec<f64>, Vec<f64>) = means.into_iter().unzip();
            (
                text,
                json!({"mean_tared_counts": means, "sigma_counts": sigmas}),
            )
        }
        Action::Raw { count, every, .. } => raw_lines(common, &mut board, count, every)?,
        Action::Calibrate {
            loads: Some(path),
            id,
            dry_run,
            samples,
        } => {
            let refused = |e: CalibrateError| Failure::new(Exit::Input, e);
            let mut loads = read_loads(&path).map_err(refused)?;
            if loads.iter().any(|load| load.counts.is_empty()) {
                measure(&mut board, &mut loads, samples)?;
            }
            let id = id.unwrap_or_else(|| identity.calibration_id.wrapping_add(1).max(1));
            let result = estimate(&loads, id).map_err(refused)?;
            let stored = if dry_run {
                None
            } else {
                Some(
                    store_calibration(&mut board, &result.calibration)
                        .map_err(link)?
                        .place,
                )
            };
            estimate_report(&result, stored)
        }
        Action::Calibrate { loads: None, .. } => current_calibration(&mut board)?,
        Action::Ping { count } => pings(&mut board, count)?,
        Action::Time { count } => {
            let wire = wire_time(&args.port, args.baud);
            let pause = Duration::from_millis(25);
            let (fit, trips) =
                compare_clocks(&mut board, clock, wire, count.max(1), pause).map_err(link)?;
            let quickest = trips
                .iter()
                .map(|t| (t.received_us - t.sent_us) - (t.board_sent_us - t.board_received_us))
                .min();
            let last = trips.last().map_or(0, |t| t.board_sent_us);
            let (offset_us, bound_us, drift_ppm) = fit.map_or((0, 0.0, 0.0), |fit| {
                (fit.offset_us(last), fit.bound_us, fit.drift * 1e6)
            });
            let text = format!(
                "offset {offset_us} us (+-{bound_us:.0}), drift {drift_ppm:.1} ppm over {:.1} s, quickest of {} round trips {} us\n",
                fit.map_or(0.0, |f| f.span_us as f64 * 1e-6),
                trips.len(),
                quickest.unwrap_or(0)
            );
            let value = json!({
                "offset_us": offset_us, "bound_us": bound_us, "drift_ppm": drift_ppm,
                "round_trips": trips.len(), "quickest_round_trip_us": quickest,
            });
            (text, value)
        }
    };
    let mut out = std::io::stdout().lock();
    let printed = if common.json {
        writeln!(out, "{value}")
    } else {
        write!(out, "{text}")
    };
    // A reader that has gone away is no fault of the board.
    drop(printed);
    Ok(Exit::Done)
}

fn info(board: &Connection, identity: &Identity) -> (String, Value) {
    let id: String = identity
        .board_id
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    let mismatch = board.check_peer().err().map(|e| e.to_string());
    let tip = &identity.tip;
    let mut text = format!(
        "board           {id}\nfinger          {} (number {})\nfirmware        {}\nprotocol        version {}, schema {:08x} (this program: version {}, schema {SCHEMA_HASH:08x})\nperiod          {} us\ngauges          {}\ntip semi-axes   {:?} mm\ntip centre      {:?} mm from the sensor's origin\ncalibration     {}\nrunning for     {:.3} s\n",
        identity.finger_name,
        identity.finger_number,
        identity.firmware_version,
        board.peer().map_or(0, |p| p.version),
        identity.schema_hash,
        palpus_protocol::PROTOCOL_VERSION,
        identity.period_us,
        identity.gauges,
        tip.semi_axes_mm,
        tip.centre_offset_mm,
        match identity.calibration_id {
            0 => "none".to_owned(),
            id => format!("id {id}"),
        },
        identity.board_time_us as f64 * 1e-6,
    );
    if let Some(mismatch) = &mismatch {
        let _ = writeln!(text, "{mismatch}");
    }
    let value = json!({
        "board_id": id, "finger_name": identity.finger_name.as_str(), "finger_number": identity.finger_number,
        "firmware_version": identity.firmware_version.as_str(),
        "protocol_version": board.peer().map(|p| p.version),
        "schema_hash": format!("{:08x}", identity.schema_hash),
        "period_us": identity.period_us, "gauges": identity.gauges,
        "tip_semi_axes_mm": tip.semi_axes_mm, "tip_centre_offset_mm": tip.centre_offset_mm,
        "calibration_id": identity.calibration_id, "board_time_us": identity.board_time_us,
        "mismatch": mismatch,
    });
    (text, value)
}

fn stats(board: &mut Connection) -> Result<(String, Value), Failure> {
    let all = statistics(board).map_err(link)?;
    let s = &all.board;
    let counters = [
        ("ticks", s.ticks),
        ("jitter_rms_us", s.jitter_rms_us),
        ("jitter_max_us", s.jitter_max_us),
        ("tick_max_us", s.tick_max_us),
        ("overruns", s.overruns),
        ("late_ticks", s.late_ticks),
        ("contacts", s.contacts),
        ("contacts_valid", s.contacts_valid),
        ("contacts_dropped", s.contacts_dropped),
        ("raw_dropped", s.raw_dropped),
        ("logs_dropped", s.logs_dropped),
        ("replies_dropped", s.replies_dropped),
        (
            "contact_queue_high_water",
            u32::from(s.contact_queue_high_water),
        ),
        ("raw_queue_high_water", u32::from(s.raw_queue_high_water)),
        ("log_queue_high_water", u32::from(s.log_queue_high_water)),
        (
            "reply_queue_high_water",
            u32::from(s.reply_queue_high_water),
        ),
        ("bytes_received", s.bytes_received),
        ("frames_received", s.frames_received),
        ("frames_bad", s.frames_bad),
        ("frames_refused", s.frames_refused),
        ("requests_repeated", s.requests_repeated),
        ("chip_resets", s.chip_resets),
        ("joint_errors", s.joint_errors),
        ("store_failures", s.store_failures),
    ];
    let rate_hz = f64::from(s.rate_millihertz) * 1e-3;
    let mut text = format!("rate                      {rate_hz:.3} Hz\n");
    for (name, value) in counters {
        let _ = writeln!(text, "{:<25} {value}", name.replace('_', " "));
    }
    for (k, g) in all.gauges.iter().enumerate() {
        let _ = writeln!(
            text,
            "gauge {}: {} good, {} saturated, {} open, {} stuck, {} missing, {} late; tare {} counts, drifted {}",
            k + 1,
            g.good,
            g.saturated,
            g.open,
            g.stuck,
            g.missing,
            g.late,
            g.tare_counts,
            g.drift_counts
        );
    }
    let mut value: serde_json::Map<String, Value> = counters
        .iter()
        .map(|&(name, value)| (name.to_owned(), json!(value)))
        .collect();
    value.insert("rate_hz".into(), json!(rate_hz));
    value.insert("board_time_us".into(), json!(s.board_time_us));
    let gauges: Vec<Value> = all
        .gauges
        .iter()
        .map(|g| {
            json!({
                "good": g.good, "saturated": g.saturated, "open": g.open, "stuck": g.stuck,
                "missing": g.missing, "late": g.late, "tare_counts": g.tare_counts,
                "drift_counts": g.drift_counts,
            })
        })
        .collect();
    value.insert("gauges".into(), json!(gauges));
    Ok((text, Value::Object(value)))
}

fn raw_lines(
    common: &Common,
    board: &mut Connection,
    count: usize,
    every: u8,
) -> Result<(String, Value), Failure> {
    let mut out = std::io::stdout().lock();
    let mut kept = Vec::new();
    let mut taken = 0;
    raw(board, every, |gauges: &RawGauges| {
        taken += 1;
        if common.json {
            kept.push(json!({
                "sequence": gauges.sequence, "board_time_us": gauges.board_time_us,
                "counts": gauges.gauges.iter().map(|g| g.counts).collect::<Vec<_>>(),
                "tared_counts": gauges.gauges.iter().map(|g| g.tared_counts).collect::<Vec<_>>(),
                "flags": gauges.gauges.iter().map(|g| flag_names(g.flags)).collect::<Vec<_>>(),
            }));
            return taken < count;
        }
        let values: Vec<String> = gauges
            .gauges
            .iter()
            .map(|g| {
                format!(
                    "{} ({}) {}",
                    g.counts,
                    g.tared_counts,
                    flag_names(g.flags).join(" ")
                )
            })
            .collect();
        // A reader that has gone ends the stream.
        writeln!(out, "{} {}", gauges.sequence, values.join("  ")).is_ok() && taken < count
    })
    .map_err(link)?;
    Ok((String::new(), json!({"periods": kept})))
}

fn flag_names(flags: GaugeFlags) -> Vec<&'static str> {
    GaugeFlags::NAMES
        .iter()
        .filter(|(flag, _)| flags.contains(*flag))
        .map(|(_, name)| *name)
        .collect()
}

/// Asks for each load in turn and measures it.
fn measure(board: &mut Connection, loads: &mut [Load], samples: usize) -> Result<(), Failure> {
    let stdin = std::io::stdin();
    if !stdin.is_terminal() {
        return Err(Failure::new(
            Exit::Input,
            anyhow::anyhow!(
                "the loads hold no counts (columns g1, g2, …) and there is no terminal to ask for each load; add the counts or run this in a terminal"
            ),
        ));
    }
    let total = loads.len();
    for (k, load) in loads.iter_mut().enumerate() {
        let parts: Vec<String> = AXES
            .iter()
            .zip(&load.wrench)
            .zip(UNITS)
            .filter(|((_, value), _)| **value != 0.0)
            .map(|((axis, value), unit)| format!("{axis} {value} {unit}"))
            .collect();
        let what = if parts.is_empty() {
            "no load".into()
        } else {
            parts.join(", ")
        };
        say::err(&format!(
            "load {} of {total}: {what}; press Enter when it is on and still",
            k + 1
        ));
        let mut line = String::new();
        stdin
            .lock()
            .read_line(&mut line)
            .map_err(|e| Failure::new(Exit::Device, e))?;
        let counts = mean_counts(board, samples).map_err(link)?;
        load.counts = counts.into_iter().map(|(mean, _)| mean).collect();
    }
    Ok(())
}

fn estimate_report(result: &Estimate, stored: Option<StorePlace>) -> (String, Value) {
    let mut text = format!(
        "{} loads, condition number {:.1}, spread {:.3}\naxis   residual rms   residual max   largest load\n",
        result.loads, result.condition, result.spread
    );
    for axis in 0..AXES.len() {
        let _ = writeln!(
            text,
            "{}   {:12.4}   {:12.4}   {:12.3}  {}",
            AXES[axis],
            result.residual_rms[axis],
            result.residual_max[axis],
            result.load_max[axis],
            UNITS[axis]
        );
    }
    let place = stored.map(|place| match place {
        StorePlace::Permanent => "permanent",
        StorePlace::RamOnly => "ram",
    });
    let _ = match place {
        Some("permanent") => writeln!(
            text,
            "stored on the board as id {}, read back and equal",
            result.calibration.id
        ),
        Some(_) => writeln!(
            text,
            "in use as id {}, but only in RAM: the board could not write its store, and forgets it with the power",
            result.calibration.id
        ),
        None => writeln!(text, "not stored (dry run)"),
    };
    let value = json!({
        "id": result.calibration.id, "loads": result.loads, "condition": result.condition,
        "spread": result.spread, "residual_rms": result.residual_rms, "residual_max": result.residual_max,
        "load_max": result.load_max, "gauges": result.calibration.gauges,
        "matrix": result.calibration.matrix.as_slice(), "stored": place,
    });
    (text, value)
}

fn current_calibration(board: &mut Connection) -> Result<(String, Value), Failure> {
    let Some(found) = calibration(board).map_err(link)? else {
        return Ok(("the board has no calibration\n".into(), json!({"id": 0})));
    };
    let gauges = usize::from(found.gauges).max(1);
    let mut text = format!(
        "calibration id {}, {} gauges (N and N mm per count)\n",
        found.id, found.gauges
    );
    for (axis, row) in AXES.iter().zip(found.matrix.chunks(gauges)) {
        let row: Vec<String> = row.iter().map(|v| format!("{v:13.6e}")).collect();
        let _ = writeln!(text, "{axis}  {}", row.join(" "));
    }
    let value = json!({"id": found.id, "gauges": found.gauges, "matrix": found.matrix.as_slice()});
    Ok((text, value))
}

fn pings(board: &mut Connection, count: u32) -> Result<(String, Value), Failure> {
    let mut times_ms = Vec::new();
    for number in 0..count.max(1) {
        times_ms.push(ping(board, number).map_err(link)?.as_secs_f64() * 1e3);
    }
    let least = times_ms.iter().copied().fold(f64::INFINITY, f64::min);
    let most = times_ms.iter().copied().fold(0.0, f64::max);
    let mean = times_ms.iter().sum::<f64>() / times_ms.len() as f64;
    let text = format!(
        "{} answers, {least:.3} / {mean:.3} / {most:.3} ms (least, mean, most)\n",
        times_ms.len()
    );
    Ok((
        text,
        json!({"answers": times_ms.len(), "least_ms": least, "mean_ms": mean, "most_ms": most}),
    ))
}
