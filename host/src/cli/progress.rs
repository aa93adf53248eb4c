//! Progress of a reconstruction: on a terminal a line that lives, with `-v` elsewhere a line per phase, else nothing.

use super::{Common, say};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use palpus_host::reconstruct::Progress;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The phases and the share of the time that each takes, as measured on the demo (6800 contacts) and on a mug (1229):
/// 0.73, 0.19, 0.07, 0.01 and 0.6, 0.1, 0.1, 0.2. Good for "about" only.
const PHASES: [(&str, f64); 4] = [
    ("extract", 0.66),
    ("simplify", 0.15),
    ("fit", 0.09),
    ("refine", 0.1),
];

/// Where a reconstruction is.
pub struct PhaseLine {
    bar: Option<ProgressBar>,
    lines: bool,
    began: Mutex<Option<Instant>>,
}

impl PhaseLine {
    /// On a terminal, or in lines with `-v`.
    pub fn new(common: &Common) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = terminal.then(|| {
            let bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} ({elapsed})") {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(120));
            bar
        });
        Self {
            lines: !terminal && common.verbose > 0,
            bar,
            began: Mutex::new(None),
        }
    }

    /// Takes in what the reconstruction tells.
    pub fn show(&self, progress: Progress) {
        match progress {
            Progress::Phase(name) => {
                let mut began = self.began.lock().unwrap_or_else(PoisonError::into_inner);
                let began = *began.get_or_insert_with(Instant::now);
                let Some(number) = PHASES.iter().position(|(phase, _)| *phase == name) else {
                    return self.say(format!("{name} …"));
                };
                let done: f64 = PHASES[..number].iter().map(|(_, share)| share).sum();
                let left = began.elapsed().as_secs_f64() * (1.0 - done) / done.max(0.01);
                let left = match number {
                    0 => String::new(),
                    _ => format!(", about {left:.0} s left"),
                };
                self.say(format!("phase {} of 4: {name}{left}", number + 1));
            }
            Progress::Level(level, patches) => {
                self.say(format!("phase 4 of 4: level {level}, {patches} patches"));
            }
        }
    }

    /// Leaves the terminal to someone else, or takes it again.
    pub fn hide(&self, hidden: bool) {
        if let Some(bar) = &self.bar {
            bar.set_draw_target(if hidden {
                ProgressDrawTarget::hidden()
            } else {
                ProgressDrawTarget::stderr()
            });
        }
    }

    /// A line that stays, above the one that lives.
    pub fn note(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| say::err(text)),
            None if self.lines => say::err(text),
            None => {}
        }
    }

    /// Says it on a terminal only: it comes too often for lines.
    pub fn live(&self, text: String) {
        if let Some(bar) = &self.bar {
            bar.set_message(text);
        }
    }

    /// Says what is done instead, such as writing.
    pub fn say(&self, text: String) {
        if let Some(bar) = &self.bar {
            bar.set_message(text);
        } else if self.lines {
            say::err(&text);
        }
    }
}

impl Drop for PhaseLine {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
