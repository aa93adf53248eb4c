//! `palpus capture`: records all fingers into a run.

use super::live::{LiveArgs, Watch};
use super::{Common, Exit, Failure, interruption, outputs, say};
use palpus_host::hand::Hand;
use palpus_host::link::port::DEFAULT_BAUD;
use palpus_host::link::session::Weight;
use palpus_host::run::RunError;
use palpus_host::run::capture::{
    CaptureError, CaptureEvent, CaptureProgress, CaptureSettings, CaptureSummary, End, capture,
};
use palpus_protocol::Streams;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

/// Record all fingers into a run, until told to stop (Ctrl-C), or for a time, or for a number of points.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  palpus capture --finger index=/dev/ttyACM0 --hand hand.urdf -o run.mcap
      one finger, until Ctrl-C
  palpus capture --finger index=/dev/ttyACM0 --finger thumb=/dev/ttyACM1 --hand hand.urdf -o run.mcap --tare --live
      tare with free tips, then record two fingers and watch them in the browser
  palpus capture --finger index=/dev/ttyACM0 --hand hand.urdf -o run.mcap --points 5000 --json
      end by itself after 5000 valid contacts")]
pub struct Args {
    /// A finger and the port of its board, such as `index=/dev/ttyACM0`; once per finger.
    #[arg(long = "finger", value_name = "NAME=PORT", required = true, value_parser = name_and_port)]
    fingers: Vec<(String, String)>,
    /// The hand: a URDF, or a JSON that names one and its fingers. It is kept in the run.
    #[arg(long, value_name = "FILE")]
    hand: PathBuf,
    /// The run to write.
    #[arg(short, long, value_name = "RUN.mcap")]
    output: PathBuf,
    /// End after so many seconds.
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    duration: Option<f64>,
    /// End after so many valid contacts of all fingers together.
    #[arg(long, value_name = "N")]
    points: Option<u64>,
    /// Tare all boards first, over N periods (200 without N); the tips must be free.
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "200")]
    tare: Option<u16>,
    /// Replace an existing run.
    #[arg(long)]
    force: bool,
    /// Baud rate of the ports (USB and pseudo-terminals ignore it).
    #[arg(long, value_name = "BD", default_value_t = DEFAULT_BAUD)]
    baud: u32,
    /// Also record the raw gauges of every N-th period; mind the line's speed.
    #[arg(long, value_name = "N", default_value_t = 0)]
    raw_every: u8,
    #[command(flatten)]
    live: LiveArgs,
}

fn name_and_port(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, port))
            if !name.is_empty() && !port.is_empty() && !name.contains(['/', '\n']) =>
        {
            Ok((name.into(), port.into()))
        }
        _ => Err("give NAME=PORT, such as index=/dev/ttyACM0".into()),
    }
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err("give a number of seconds above 0".into()),
    }
}

/// Runs the command.
pub fn run(common: &Common, args: Args) -> Result<Exit, Failure> {
    outputs::check_file(&args.output)?;
    let hand = Hand::sources(&args.hand).map_err(|e| Failure::new(Exit::Input, e))?;
    let stop = interruption()?;
    let settings = CaptureSettings {
        replace: args.force,
        baud: args.baud,
        streams: Streams {
            contact_every: 1,
            raw_every: args.raw_every,
        },
        tare: args.tare,
        duration: args.duration.map(Duration::from_secs_f64),
        points: args.points,
        ..CaptureSettings::every_contact(args.fingers, hand, args.output)
    };
    let names: Vec<String> = settings
        .fingers
        .iter()
        .map(|(name, _)| name.clone())
        .collect();
    let watch = Watch::start(&args.live, &names, &settings.hand, &stop)?;
    let mut screen = Screen::new(common, &settings);
    let result = capture(&settings, &stop, &mut |event| {
        let on_screen = watch.as_ref().is_some_and(|watch| watch.show(&event));
        if !on_screen {
            screen.show(&event);
        }
    });
    screen.clear();
    if let Some(watch) = watch {
        watch.end(match &result {
            Ok(summary) => end_name(summary.end),
            Err(_) => "failed",
        });
    }
    let summary = result.map_err(|error| Failure::new(exit_of(&error), error))?;
    // A reader that has gone away is no fault of the capture.
    let _ = print_summary(common, &settings, &summary);
    Ok(match summary.end {
        End::Stopped => Exit::Interrupted,
        End::Duration | End::Points => Exit::Done,
    })
}

/// Which code a failed capture leaves with.
pub fn exit_of(error: &CaptureError) -> Exit {
    match error {
        CaptureError::Link { .. } | CaptureError::Swapped { .. } => Exit::Device,
        CaptureError::Run(RunError::Write { .. }) => Exit::Device,
        CaptureError::Run(_) | CaptureError::Hand(_) => Exit::Input,
        CaptureError::UnknownFinger { .. }
        | CaptureError::FingerName { .. }
        | CaptureError::Twice { .. }
        | CaptureError::NoFinger => Exit::Usage,
    }
}

/// Live counters, on a terminal only.
struct Screen {
    live: bool,
    notes: bool,
    lines: usize,
    previous: CaptureProgress,
    ticks: usize,
    rates: Vec<f64>,
    duration: Option<f64>,
    points: Option<u64>,
}

impl Screen {
    fn new(common: &Common, settings: &CaptureSettings) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self {
            live: terminal,
            notes: terminal || common.verbose > 0,
            lines: 0,
            previous: CaptureProgress::default(),
            ticks: 0,
            rates: Vec::new(),
            duration: settings.duration.map(|d| d.as_secs_f64()),
            points: settings.points,
        }
    }

    fn show(&mut self, event: &CaptureEvent<'_>) {
        match event {
            CaptureEvent::Found {
                finger,
                port,
                identity,
            } => self.line(&format!(
                "{finger}: board `{}` on {port}, firmware {}, {} Hz, {}",
                identity.finger_name,
                identity.firmware_version,
                1_000_000 / identity.period_us.max(1),
                match identity.calibration_id {
                    0 => "NO CALIBRATION: no contact will be valid".to_owned(),
                    id => format!("calibration {id}"),
                }
            )),
            CaptureEvent::Note {
                finger,
                weight,
                text,
            } => {
                let mark = match weight {
                    Weight::Info => "",
                    Weight::Warning => "warning: ",
                    Weight::Error => "error: ",
                };
                self.line(&format!("{mark}{finger}: {text}"));
            }
            CaptureEvent::Touches(_) => {}
            CaptureEvent::Progress(progress) => self.progress(progress),
        }
    }

    fn line(&mut self, text: &str) {
        if self.notes {
            self.clear();
            say::err(text);
        }
    }

    fn progress(&mut self, progress: &CaptureProgress) {
        if !self.live {
            return;
        }
        // Rates over half a second, so that they can be read.
        if self.ticks.is_multiple_of(5) {
            let seconds = (progress.elapsed - self.previous.elapsed).as_secs_f64();
            self.rates = progress
                .fingers
                .iter()
                .enumerate()
                .map(|(k, (_, now))| {
                    let before = self.previous.fingers.get(k).map_or(0, |(_, s)| s.contacts);
                    now.contacts.saturating_sub(before) as f64 / seconds.max(1e-3)
                })
                .collect();
            self.previous.clone_from(progress);
            self.clear();
            let mut err = std::io::stderr().lock();
            for ((name, s), rate) in progress.fingers.iter().zip(&self.rates) {
                let state = if s.connected { "" } else { "  SEARCHING" };
                let valid = 100.0 * s.valid as f64 / s.contacts.max(1) as f64;
                // A terminal that has gone is no reason to stop recording.
                let _ = writeln!(
                    err,
                    "{name:>10} {rate:6.1} Hz  {:>9} contacts  {valid:5.1} % valid  {} lost  {} bad  clock +-{:.2} ms{state}",
                    s.contacts,
                    s.lost + s.dropped_by_host,
                    s.bad,
                    s.clock_bound_us * 1e-3,
                );
            }
            let rate: f64 = self.rates.iter().sum();
            let _ = writeln!(
                err,
                "{:>10} {:6.1} s   {:>9} points    {rate:.0} contacts/s  {:.1} MB safe{}",
                "all",
                progress.elapsed.as_secs_f64(),
                progress.points,
                progress.safe_bytes as f64 * 1e-6,
                self.left(progress)
            );
            self.lines = progress.fingers.len() + 1;
        }
        self.ticks += 1;
    }

    /// What is left until the time or the number of points that was asked for, whichever comes first.
    fn left(&self, progress: &CaptureProgress) -> String {
        let seconds = progress.elapsed.as_secs_f64();
        let rate = progress.points as f64 / seconds.max(1e-3);
        let by_points = self
            .points
            .map(|points| points.saturating_sub(progress.points) as f64 / rate.max(1e-3));
        let by_time = self.duration.map(|duration| duration - seconds);
        match by_points.into_iter().chain(by_time).reduce(f64::min) {
            Some(left) if left < 1e6 => format!("  {:.0} s left", left.max(0.0)),
            _ => String::new(),
        }
    }

    /// Takes the live lines away again.
    fn clear(&mut self) {
        if self.lines > 0 {
            let _ = write!(std::io::stderr().lock(), "\x1b[{}A\x1b[J", self.lines);
            self.lines = 0;
        }
    }
}

fn end_name(end: End) -> &'static str {
    match end {
        End::Duration => "duration",
        End::Points => "points",
        End::Stopped => "stopped",
    }
}

fn print_summary(
    common: &Common,
    settings: &CaptureSettings,
    summary: &CaptureSummary,
) -> std::io::Result<()> {
    let progress = &summary.progress;
    let mut out = std::io::stdout().lock();
    if common.json {
        let fingers: Vec<serde_json::Value> = progress
            .fingers
            .iter()
            .map(|(name, s)| {
                serde_json::json!({
                    "finger": name, "port": s.port, "connected": s.connected, "contacts": s.contacts,
                    "valid": s.valid, "lost": s.lost, "bad": s.bad, "unreadable": s.unreadable,
                    "duplicates": s.duplicates, "out_of_order": s.out_of_order,
                    "reconnects": s.reconnects, "reboots": s.reboots,
                    "dropped_by_host": s.dropped_by_host, "offset_us": s.offset_us,
                    "drift_ppm": s.drift * 1e6, "clock_bound_us": s.clock_bound_us,
                })
            })
            .collect();
        let end = end_name(summary.end);
        return writeln!(
            out,
            "{}",
            serde_json::json!({
                "output": settings.output, "end": end, "seconds": progress.elapsed.as_secs_f64(),
                "points": progress.points, "bytes": progress.safe_bytes, "fingers": fingers,
            })
        );
    }
    writeln!(
        out,
        "{}: {:.1} s, {} points, {:.2} MB",
        settings.output.display(),
        progress.elapsed.as_secs_f64(),
        progress.points,
        progress.safe_bytes as f64 * 1e-6
    )?;
    for (name, s) in &progress.fingers {
        writeln!(
            out,
            "{name}: {} contacts, {} valid; {} lost, {} damaged frames, {} dropped by this computer, {} reconnects, {} restarts",
            s.contacts, s.valid, s.lost, s.bad, s.dropped_by_host, s.reconnects, s.reboots
        )?;
    }
    Ok(())
}
