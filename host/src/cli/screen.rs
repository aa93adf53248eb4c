//! The live view in a terminal: contacts from above and from the front, a line per finger, the last notes.
//!
//! Drawn by a thread of its own ten times a second: a terminal that stalls holds up nothing else. `q` or Ctrl-C ends the
//! capture. The terminal is given back whatever happens.

use palpus_host::link::session::Weight;
use palpus_host::live::{FingerView, Live, View};
use ratatui::Frame;
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::crossterm::{cursor, execute};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Line as Stroke, Points};
use ratatui::widgets::{Block, Paragraph, Wrap};
use std::io::{Stderr, stderr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Pause between two pictures.
const EVERY: Duration = Duration::from_millis(100);
/// Points drawn at most: more than a terminal has dots.
const MOST_POINTS: usize = 6000;
/// Force at the end of a bar, N.
const FULL_FORCE_N: f32 = 6.0;
/// Colours of the fingers; the terminal's own, so they suit its background.
const FINGERS: [Color; 3] = [Color::Blue, Color::Yellow, Color::Magenta];

/// The terminal while it shows a capture.
pub struct Screen {
    leave: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Screen {
    /// Takes the terminal.
    ///
    /// # Errors
    /// The terminal's own.
    pub fn start(live: &Arc<Live>, stop: &Arc<AtomicBool>) -> std::io::Result<Self> {
        enable_raw_mode()?;
        execute!(stderr(), EnterAlternateScreen, cursor::Hide)?;
        let leave = Arc::new(AtomicBool::new(false));
        let (live, stop, left) = (Arc::clone(live), Arc::clone(stop), Arc::clone(&leave));
        let thread = std::thread::spawn(move || {
            // A terminal that has gone is no reason to stop recording.
            let _ = show(&live, &stop, &left);
            let _ = execute!(stderr(), LeaveAlternateScreen, cursor::Show);
            let _ = disable_raw_mode();
        });
        Ok(Self {
            leave,
            thread: Some(thread),
        })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.leave.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn show(live: &Live, stop: &AtomicBool, leave: &AtomicBool) -> std::io::Result<()> {
    let mut terminal: Terminal<CrosstermBackend<Stderr>> =
        Terminal::new(CrosstermBackend::new(stderr()))?;
    let address = live.address().map(|a| format!("http://{a}/"));
    while !leave.load(Ordering::Relaxed) {
        let view = live.view();
        let points = live.some_points(MOST_POINTS);
        let surface = live.surface().map(|s| {
            format!(
                "surface {}: {} patches, rms {:.3} mm, {} piece(s), {} opening(s), {} handle(s)",
                s.number, s.patches, s.rms_mm, s.pieces, s.openings, s.handles
            )
        });
        terminal.draw(|frame| {
            draw(
                frame,
                &view,
                &points,
                surface.as_deref(),
                address.as_deref(),
            );
        })?;
        if event::poll(EVERY)?
            && let Event::Key(key) = event::read()?
            && key.kind == KeyEventKind::Press
        {
            let control_c =
                key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if control_c || key.code == KeyCode::Char('q') {
                stop.store(true, Ordering::Relaxed);
            }
        }
    }
    Ok(())
}

fn draw(
    frame: &mut Frame<'_>,
    view: &View,
    points: &[([f32; 3], u8)],
    surface: Option<&str>,
    address: Option<&str>,
) {
    let fingers = view.fingers.len() as u16;
    let [head, middle, cards, foot] = Layout::vertical([
        Constraint::Length(2),
        Constraint::Fill(1),
        Constraint::Length(2 * fingers + 2),
        Constraint::Length(5),
    ])
    .areas(frame.area());
    let progress = &view.progress;
    let title = format!(
        "Palpus  {:.1} s  {} points  {:.1} MB safe",
        progress.elapsed.as_secs_f64(),
        progress.points,
        progress.safe_bytes as f64 * 1e-6
    );
    let hint = format!("{}  q ends", address.unwrap_or_default());
    let why = view.no_surface.as_deref();
    let below = surface.map_or_else(
        || {
            why.map_or_else(
                || "no surface yet".to_owned(),
                |w| format!("no surface yet: {w}"),
            )
        },
        str::to_owned,
    );
    let bold = Style::new().add_modifier(Modifier::BOLD);
    frame.render_widget(
        Paragraph::new(vec![
            Line::from(vec![
                Span::styled(title, bold),
                Span::raw("   "),
                Span::raw(hint),
            ]),
            Line::raw(below),
        ]),
        head,
    );
    let [left, right] = Layout::horizontal([Constraint::Fill(1); 2]).areas(middle);
    projection(frame, left, " from above ", [0, 1], view, points);
    projection(frame, right, " from the front ", [0, 2], view, points);
    let block = Block::bordered().title(" fingers ");
    let inner = block.inner(cards);
    frame.render_widget(block, cards);
    let lines: Vec<Line<'_>> = view
        .fingers
        .iter()
        .enumerate()
        .flat_map(|(k, finger)| finger_lines(finger, FINGERS[k % FINGERS.len()], inner.width))
        .collect();
    frame.render_widget(Paragraph::new(lines), inner);
    let block = Block::bordered().title(" what happened ");
    let room = block.inner(foot).height as usize;
    let notes: Vec<Line<'_>> = view
        .notes
        .iter()
        .rev()
        .take(room)
        .map(|note| {
            let style = match note.weight {
                Weight::Info => Style::new(),
                Weight::Warning => Style::new().fg(Color::Yellow),
                Weight::Error => Style::new().fg(Color::Red),
            };
            let text = format!(
                "{:7.1} s  {}: {}",
                note.at.as_secs_f64(),
                note.finger,
                note.text
            );
            Line::styled(text, style)
        })
        .collect();
    let notes = Paragraph::new(notes).wrap(Wrap { trim: false });
    frame.render_widget(notes.block(block), foot);
}

/// Contacts and fingers along two axes of the world, to one scale.
fn projection(
    frame: &mut Frame<'_>,
    area: Rect,
    title: &str,
    axes: [usize; 2],
    view: &View,
    points: &[([f32; 3], u8)],
) {
    let at = |p: &[f32; 3]| (f64::from(p[axes[0]]), f64::from(p[axes[1]]));
    let tips = view.fingers.iter().filter_map(|f| f.chain_mm.last());
    let places: Vec<(f64, f64)> = points
        .iter()
        .map(|(p, _)| at(p))
        .chain(tips.map(|tip| (tip[axes[0]], tip[axes[1]])))
        .collect();
    let first = places.first().copied().unwrap_or((0.0, 0.0));
    let (low, high) = places.iter().fold((first, first), |(low, high), p| {
        (
            (low.0.min(p.0), low.1.min(p.1)),
            (high.0.max(p.0), high.1.max(p.1)),
        )
    });
    let middle = ((low.0 + high.0) / 2.0, (low.1 + high.1) / 2.0);
    // A cell is two dots wide and four high, each dot about square.
    let (wide, tall) = (
        f64::from(area.width.max(3) - 2) * 2.0,
        f64::from(area.height.max(3) - 2) * 4.0,
    );
    let scale = ((high.0 - low.0) / wide)
        .max((high.1 - low.1) / tall)
        .max(0.1)
        * 0.55;
    let canvas = Canvas::default()
        .block(Block::bordered().title(title.to_owned()))
        .marker(Marker::Braille)
        .x_bounds([middle.0 - scale * wide, middle.0 + scale * wide])
        .y_bounds([middle.1 - scale * tall, middle.1 + scale * tall])
        .paint(|context| {
            for (k, finger) in view.fingers.iter().enumerate() {
                let color = FINGERS[k % FINGERS.len()];
                let coords: Vec<(f64, f64)> = points
                    .iter()
                    .filter(|(_, f)| usize::from(*f) == k)
                    .map(|(p, _)| at(p))
                    .collect();
                context.draw(&Points {
                    coords: &coords,
                    color,
                });
                for ends in finger.chain_mm.windows(2) {
                    context.draw(&Stroke {
                        x1: ends[0][axes[0]],
                        y1: ends[0][axes[1]],
                        x2: ends[1][axes[0]],
                        y2: ends[1][axes[1]],
                        color,
                    });
                }
            }
        });
    frame.render_widget(canvas, area);
}

/// The parts with commas between, in so many letters; if they are too long, as many as fit and how many more there are.
fn fitting(parts: &[String], room: usize) -> String {
    let whole = parts.join(", ");
    if whole.chars().count() <= room {
        return whole;
    }
    (1..parts.len())
        .rev()
        .map(|kept| format!("{}, +{} more", parts[..kept].join(", "), parts.len() - kept))
        .find(|text| text.chars().count() <= room)
        .unwrap_or_else(|| {
            let cut: String = whole.chars().take(room.saturating_sub(1)).collect();
            cut + "…"
        })
}

/// Force as a bar and validity, then the link's counters.
fn finger_lines(finger: &FingerView, color: Color, width: u16) -> [Line<'static>; 2] {
    let status = &finger.status;
    let name = format!("{:>10} ", finger.name);
    let touch = finger.last.filter(|_| status.connected);
    let force = touch.map_or(0.0, |touch| touch.contact.normal_force_n);
    let wide = usize::from(width.saturating_sub(60)).clamp(8, 30);
    let full = ((force / FULL_FORCE_N).clamp(0.0, 1.0) * wide as f32).round() as usize;
    let bar = format!("{}{}", "█".repeat(full), "░".repeat(wide - full));
    let force = format!("{force:5.2} N {bar} ");
    let room = |before: [&str; 2]| {
        let taken: usize = before.iter().map(|part| part.chars().count()).sum();
        usize::from(width).saturating_sub(taken)
    };
    let (state, style) = match touch {
        _ if !status.connected => (
            "SEARCHING for its board".to_owned(),
            Style::new().fg(Color::Red),
        ),
        Some(touch) if touch.contact.is_valid() => {
            ("valid".to_owned(), Style::new().fg(Color::Green))
        }
        Some(_) => {
            let reasons: Vec<String> = finger.reasons().into_iter().map(str::to_owned).collect();
            (fitting(&reasons, room([&name, &force])), Style::new())
        }
        None => ("nothing yet".to_owned(), Style::new()),
    };
    let share = if finger.valid_share.is_finite() {
        format!("{:4.0} % valid", 100.0 * finger.valid_share)
    } else {
        String::new()
    };
    let rate = format!("{:5.0} Hz {share}  ", finger.contacts_per_s);
    let indent = " ".repeat(name.chars().count());
    let mut counters = vec![
        format!("{} contacts", status.contacts),
        format!("{} lost", status.lost + status.dropped_by_host),
        format!("{} damaged", status.bad + status.unreadable),
    ];
    // Most fingers never have any.
    for (count, what) in [
        (status.reconnects, "reconnects"),
        (status.reboots, "restarts"),
    ] {
        if count > 0 {
            counters.push(format!("{count} {what}"));
        }
    }
    let counters = fitting(&counters, room([&indent, &rate]));
    [
        Line::from(vec![
            Span::styled(name, Style::new().fg(color)),
            Span::raw(force),
            Span::styled(state, style),
        ]),
        Line::raw(indent + &rate + &counters),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::backend::TestBackend;

    #[test]
    fn long_lists_say_how_much_more_there_is() {
        let reasons = ["force below limit", "spin moment above limit", "tare stale"];
        let reasons = reasons.map(str::to_owned);
        for (room, text) in [
            (80, "force below limit, spin moment above limit, tare stale"),
            (53, "force below limit, spin moment above limit, +1 more"),
            (50, "force below limit, +2 more"),
            (20, "force below limit, …"),
            (1, "…"),
        ] {
            assert_eq!(fitting(&reasons, room), text);
        }
        assert_eq!(fitting(&[], 5), "");
    }

    #[test]
    fn any_size_of_terminal_and_a_failed_finger_can_be_drawn() {
        let mut view = View::default();
        for (name, connected) in [("index", true), ("middle", false)] {
            let mut finger = FingerView {
                name: name.to_owned(),
                ..FingerView::default()
            };
            finger.status.connected = connected;
            view.fingers.push(finger);
        }
        let points = [([1.0, 2.0, 3.0], 0), ([f32::MAX, -2.0, 3.0], 1)];
        for (width, height) in [(1, 1), (20, 8), (80, 24), (200, 60)] {
            let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
            terminal
                .draw(|frame| draw(frame, &view, &points, None, Some("http://127.0.0.1:1/")))
                .unwrap();
            let text: String = terminal
                .backend()
                .buffer()
                .content()
                .iter()
                .map(ratatui::buffer::Cell::symbol)
                .collect();
            if width >= 80 {
                assert!(
                    text.contains("SEARCHING") && text.contains("no surface yet"),
                    "{text}"
                );
                assert!(text.contains("http://127.0.0.1:1/"));
            }
        }
    }
}
