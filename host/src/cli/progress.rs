//! Progress of a reconstruction: on a terminal a line that lives, with `-v` elsewhere a line per phase, else nothing.

use super::{Common, say};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use palpus_host::reconstruct::Progress;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The phases, and how much of the time gone by at their beginning is usually still to come: the least and the most over
/// eight sets of 374 to 5000 contacts (mug, torus, bowl, cube, trilobe), a sphere, the demo and the kitten. What refinement
/// takes is not known before: nothing on ten of these, on the kitten as much as all before it, on a torus touched
/// halfway, which also went beyond the others' most, five times that.
const PHASES: [(&str, Option<[f64; 2]>); 4] = [
    ("extract", None),
    ("simplify", Some([0.2, 2.1])),
    ("fit", Some([0.2, 1.5])),
    ("refine", None),
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
                let gone = began.elapsed().as_secs_f64();
                let left = PHASES[number]
                    .1
                    .map(|range| range.map(|share| share * gone));
                let left = match left {
                    Some([_, most]) if most < 1.5 => String::new(),
                    Some([least, most]) => format!(", usually {least:.0} to {most:.0} s left"),
                    None => String::new(),
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
