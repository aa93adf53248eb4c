//! The capture as it is seen while it runs: hand, contacts, links, and a surface that is fitted again and again.
//!
//! | file | holds |
//! |---|---|
//! | `seen` | all that has been seen so far, behind one lock |
//! | `refit` | the thread that makes a surface of it, over and over |
//! | `server` | HTTP on an address of this computer: the page, and a stream of what is new |
//! | `stream` | what a viewer is sent |
//! | `page/` | the page itself |
//!
//! **Never in the way of the capture.** [`Live::show`] is called by the thread that tells of the progress, not by
//! those that read and write contacts, and only appends under a lock that no viewer holds while it sends. There are
//! no queues to viewers: each has a thread that knows what it has sent and takes what is new when the last
//! message has gone out. A slow browser so gets larger strides and misses states in between, never contacts; one that
//! takes nothing for [`PATIENCE`] is let go and may come back. Two ways were weighed: WebSockets (two
//! ways, but a handshake with a hash and framing of their own, for a page that only looks) and server-sent events
//! (plain HTTP, and browsers reconnect by themselves); so the latter.
//!
//! **Who may look.** The server listens on the loopback address unless told otherwise, refuses requests under a foreign
//! name (`Host`), so that no page from elsewhere reads it by a forged name, and obeys no command: it only shows.

mod refit;
mod seen;
mod server;
mod stream;

pub use refit::LiveSurface;
pub use seen::{FingerView, Note, View};
pub use server::PATIENCE;

use crate::hand::{Finger, Hand, HandError};
use crate::run::capture::CaptureEvent;
use seen::Shared;
use server::Server;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Where the page is served unless told otherwise; if the port is taken, any free one.
pub const DEFAULT_PORT: u16 = 7257;

/// How a capture is shown.
#[derive(Clone, Debug)]
pub struct LiveOptions {
    /// Address to serve the page on; `None` serves no page. Port 0 takes any free one.
    pub listen: Option<SocketAddr>,
    /// Pause between the beginnings of two fits at least.
    pub refit_every: Duration,
}

/// Why nothing can be shown.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The address can't be listened on.
    #[error(
        "{address}: cannot be listened on ({source}); choose another with --listen ADDRESS:PORT"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The hand can't be used.
    #[error(transparent)]
    Hand(#[from] HandError),
}

/// A capture being shown.
#[derive(Debug)]
pub struct Live {
    shared: Arc<Shared>,
    server: Option<Server>,
}

impl Live {
    /// Starts to serve and to fit. `fingers` are the capture's, in its order; `hand` as [`Hand::sources`] reads it.
    /// Fingers that the hand does not have are shown without their links.
    ///
    /// # Errors
    /// [`LiveError`].
    pub fn start(
        fingers: &[String],
        hand: &[(String, String)],
        options: &LiveOptions,
    ) -> Result<Self, LiveError> {
        let hand = Hand::from_sources(hand)?;
        let geometry: Vec<(String, Option<Finger>)> = fingers
            .iter()
            .map(|name| (name.clone(), hand.finger(name).map(|(_, f)| f.clone())))
            .collect();
        let shared = Arc::new(Shared::new(geometry));
        let server = match options.listen {
            Some(address) => Some(Server::start(address, &shared)?),
            None => None,
        };
        refit::start(Arc::clone(&shared), options.refit_every);
        Ok(Self { shared, server })
    }

    /// Where the page is; `None` if there is none.
    pub fn address(&self) -> Option<SocketAddr> {
        self.server.as_ref().map(Server::address)
    }

    /// Takes in what a capture tells.
    pub fn show(&self, event: &CaptureEvent<'_>) {
        self.shared.lock().take_in(event);
    }

    /// All that is to be seen now, but for the points.
    pub fn view(&self) -> View {
        self.shared.lock().view()
    }

    /// Places of up to `most` of the points, mm, evenly picked, each with its finger.
    pub fn some_points(&self, most: usize) -> Vec<([f32; 3], u8)> {
        self.shared.lock().some_points(most)
    }

    /// The last surface.
    pub fn surface(&self) -> Option<Arc<LiveSurface>> {
        self.shared.lock().surface()
    }

    /// Says that the capture has ended, and why; viewers get a moment to hear it.
    pub fn end(&self, why: &str) {
        self.shared.lock().end(why);
        let patience = Instant::now() + Duration::from_millis(700);
        while self.shared.viewers.load(Ordering::Relaxed) > 0 && Instant::now() < patience {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(server) = &self.server {
            server.wake();
        }
    }
}
