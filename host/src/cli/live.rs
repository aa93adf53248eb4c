//! `--live`: the capture as it is seen while it runs, for `capture` and `demo`.

use super::screen::Screen;
use super::{Exit, Failure, say};
use anyhow::anyhow;
use palpus_host::live::{DEFAULT_PORT, Live, LiveOptions};
use palpus_host::run::capture::CaptureEvent;
use std::io::IsTerminal;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Pause between the beginnings of two background fits.
const REFIT_EVERY: Duration = Duration::from_secs(1);

/// Options of `--live`.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Watching")]
pub struct LiveArgs {
    /// Show hand, contacts, forces, links and a surface that is fitted again every second: on a page for the browser,
    /// and full-screen in this terminal where there is no display; or on one of them only.
    #[arg(long, value_name = "WHERE", value_enum, num_args = 0..=1, default_missing_value = "auto")]
    live: Option<Where>,
    /// Address to serve the page on. Anyone who reaches it can look [default: 127.0.0.1:7257, or a free port].
    #[arg(long, value_name = "ADDRESS:PORT", requires = "live")]
    listen: Option<SocketAddr>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Where {
    /// A page, and this terminal too where there is no display.
    #[value(hide = true)]
    Auto,
    /// A page for the browser.
    Page,
    /// This terminal.
    Terminal,
}

/// A capture being watched.
pub struct Watch {
    live: Arc<Live>,
    screen: Option<Screen>,
}

impl Watch {
    /// Starts what was asked for, if it was; `stop` is set by whoever ends the capture from the screen.
    pub fn start(
        args: &LiveArgs,
        fingers: &[String],
        hand: &[(String, String)],
        stop: &Arc<AtomicBool>,
    ) -> Result<Option<Self>, Failure> {
        let Some(place) = args.live else {
            return Ok(None);
        };
        let terminal = std::io::stderr().is_terminal();
        if place == Where::Terminal && !terminal {
            let error = anyhow!(
                "--live terminal: there is no terminal to draw on; use --live page, or run it in a terminal"
            );
            return Err(Failure::new(Exit::Usage, error));
        }
        let has_display = cfg!(not(target_os = "linux"))
            || ["DISPLAY", "WAYLAND_DISPLAY"]
                .iter()
                .any(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()));
        let own = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), DEFAULT_PORT);
        let options = LiveOptions {
            listen: (place != Where::Terminal).then_some(args.listen.unwrap_or(own)),
            refit_every: REFIT_EVERY,
        };
        let live =
            Live::start(fingers, hand, &options).map_err(|e| Failure::new(Exit::Usage, e))?;
        let live = Arc::new(live);
        if let Some(address) = live.address() {
            say::err(&format!("live page: http://{address}/"));
            if !address.ip().is_loopback() {
                say::err(&format!(
                    "warning: everyone in the network who reaches {address} can look"
                ));
            }
        }
        let on_screen = place == Where::Terminal || (place == Where::Auto && !has_display);
        let screen = (on_screen && terminal)
            .then(|| Screen::start(&live, stop))
            .transpose()
            .map_err(|e| Failure::new(Exit::Device, e))?;
        Ok(Some(Self { live, screen }))
    }

    /// Takes in what the capture tells; whether it is on the screen, so that nothing else should be written there.
    pub fn show(&self, event: &CaptureEvent<'_>) -> bool {
        self.live.show(event);
        self.on_screen()
    }

    /// Whether it has the terminal.
    pub fn on_screen(&self) -> bool {
        self.screen.is_some()
    }

    /// Ends the show and gives the terminal back.
    pub fn end(mut self, why: &str) {
        drop(self.screen.take());
        self.live.end(why);
    }
}
