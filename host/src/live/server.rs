//! A small HTTP server for viewers: the page at `/`, what is new at `/events`.
//!
//! It answers GET only, reads no more than [`LONGEST_REQUEST`] bytes of a request within [`PATIENCE`], serves
//! [`MOST_VIEWERS`] at a time, and takes nothing a viewer says as an order. A request has to come under the address in
//! numbers or as `localhost`; a page from elsewhere that has its own name point here is refused.

use super::seen::Shared;
use super::stream;
use super::{DEFAULT_PORT, LiveError};
use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How long a viewer may take to ask, or to take what it is sent.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// Longest request, bytes.
const LONGEST_REQUEST: usize = 8 << 10;
/// Connections served at a time.
const MOST_VIEWERS: usize = 16;

/// The listening side.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
}

impl Server {
    /// Listens on `address`; where that is the default port and taken, on any free one.
    pub fn start(address: SocketAddr, shared: &Arc<Shared>) -> Result<Self, LiveError> {
        let refused = |source| LiveError::Listen { address, source };
        let listener = TcpListener::bind(address)
            .or_else(|error| {
                if address.port() == DEFAULT_PORT && error.kind() == ErrorKind::AddrInUse {
                    TcpListener::bind(SocketAddr::new(address.ip(), 0))
                } else {
                    Err(error)
                }
            })
            .map_err(refused)?;
        let address = listener.local_addr().map_err(refused)?;
        let shared = Arc::clone(shared);
        std::thread::spawn(move || {
            for connection in listener.incoming() {
                if shared.stop.load(Ordering::Relaxed) {
                    break;
                }
                let Ok(connection) = connection else {
                    // Out of handles, most likely: the capture needs them more.
                    std::thread::sleep(Duration::from_millis(100));
                    continue;
                };
                serve(connection, &shared, address.ip());
            }
        });
        Ok(Self { address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Lets the listening thread look at `Shared::stop`.
    pub fn wake(&self) {
        let _ = TcpStream::connect_timeout(&self.address, Duration::from_millis(100));
    }
}

/// Gives a connection a thread of its own, if there is room.
fn serve(mut connection: TcpStream, shared: &Arc<Shared>, own: IpAddr) {
    let timeouts = connection
        .set_write_timeout(Some(PATIENCE))
        .and(connection.set_read_timeout(Some(PATIENCE)))
        .and(connection.set_nodelay(true));
    if timeouts.is_err() {
        return;
    }
    if shared.viewers.fetch_add(1, Ordering::Relaxed) >= MOST_VIEWERS {
        let _ = answer(
            &mut connection,
            "503 Service Unavailable",
            "text/plain",
            "too many viewers; close one\n",
        );
        shared.viewers.fetch_sub(1, Ordering::Relaxed);
        return;
    }
    let shared = Arc::clone(shared);
    std::thread::spawn(move || {
        // A viewer that goes away is no fault of anyone.
        let _ = converse(&mut connection, &shared, own);
        shared.viewers.fetch_sub(1, Ordering::Relaxed);
    });
}

fn converse(connection: &mut TcpStream, shared: &Shared, own: IpAddr) -> std::io::Result<()> {
    let Some(head) = read_head(connection)? else {
        return answer(
            connection,
            "431 Request Header Fields Too Large",
            "text/plain",
            "too long\n",
        );
    };
    match judge(&head, own) {
        Asked::Page => answer(
            connection,
            "200 OK",
            "text/html; charset=utf-8",
            &stream::page(),
        ),
        Asked::Events => {
            connection.write_all(head_of("200 OK", "text/event-stream", None).as_bytes())?;
            stream::events(connection, shared)
        }
        Asked::Refused(status, why) => answer(connection, status, "text/plain", why),
    }
}

/// What a request asks for.
#[derive(Debug, PartialEq, Eq)]
enum Asked {
    Page,
    Events,
    Refused(&'static str, &'static str),
}

fn judge(head: &str, own: IpAddr) -> Asked {
    let mut lines = head.split("\r\n");
    let mut first = lines.next().unwrap_or("").split(' ');
    let (method, path) = (first.next().unwrap_or(""), first.next().unwrap_or(""));
    let mut hosts = lines.filter_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("host").then_some(value.trim())
    });
    let (host, second) = (hosts.next(), hosts.next());
    if second.is_some() || !host.is_some_and(|host| is_own(host, own)) {
        return Asked::Refused(
            "421 Misdirected Request",
            "ask by the address in numbers, as the program printed it\n",
        );
    }
    if method != "GET" {
        return Asked::Refused(
            "405 Method Not Allowed",
            "there is only something to look at\n",
        );
    }
    match path.split('?').next() {
        Some("/") => Asked::Page,
        Some("/events") => Asked::Events,
        _ => Asked::Refused("404 Not Found", "there is only /\n"),
    }
}

/// Whether a request under this `Host` was meant for us: an address in numbers (a loopback one if we listen there), or
/// `localhost`. A name that someone else owns can be made to point here; numbers cannot.
fn is_own(host: &str, own: IpAddr) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    if name.eq_ignore_ascii_case("localhost") {
        return true;
    }
    let bare = name.strip_prefix('[').and_then(|n| n.strip_suffix(']'));
    bare.unwrap_or(name)
        .parse::<IpAddr>()
        .is_ok_and(|ip| ip.is_loopback() || !own.is_loopback())
}

/// The request up to its empty line; `None` if it is too long, an error if it comes too slowly.
fn read_head(connection: &mut TcpStream) -> std::io::Result<Option<String>> {
    let until = Instant::now() + PATIENCE;
    let mut bytes = Vec::new();
    let mut some = [0; 1024];
    loop {
        let count = connection.read(&mut some)?;
        if count == 0 || Instant::now() > until {
            return Err(ErrorKind::TimedOut.into());
        }
        bytes.extend_from_slice(&some[..count]);
        if let Some(end) = bytes.windows(4).position(|w| w == b"\r\n\r\n") {
            return Ok(Some(String::from_utf8_lossy(&bytes[..end]).into_owned()));
        }
        if bytes.len() > LONGEST_REQUEST {
            return Ok(None);
        }
    }
}

fn head_of(status: &str, kind: &str, length: Option<usize>) -> String {
    let length = length.map_or(String::new(), |n| format!("Content-Length: {n}\r\n"));
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{length}Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         X-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\nConnection: close\r\n\r\n"
    )
}

fn answer(connection: &mut TcpStream, status: &str, kind: &str, body: &str) -> std::io::Result<()> {
    connection.write_all(head_of(status, kind, Some(body.len())).as_bytes())?;
    connection.write_all(body.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(request: &str, own: &str) -> Asked {
        judge(&request.replace('\n', "\r\n"), own.parse().unwrap())
    }

    #[test]
    fn only_own_names_are_answered() {
        for host in [
            "127.0.0.1:7257",
            "localhost:7257",
            "LOCALHOST",
            "[::1]:80",
            "127.0.0.2",
        ] {
            assert_eq!(
                asked(&format!("GET / HTTP/1.1\nHost: {host}"), "127.0.0.1"),
                Asked::Page,
                "{host}"
            );
        }
        for head in [
            "GET / HTTP/1.1",
            "GET / HTTP/1.1\nHost: evil.example",
            "GET / HTTP/1.1\nHost: localhost.evil.example:7257",
            "GET / HTTP/1.1\nHost: 127.0.0.1.evil.example",
            "GET / HTTP/1.1\nHost: 192.168.1.7",
            "GET / HTTP/1.1\nHost: 127.0.0.1\nHost: evil.example",
            "GET / HTTP/1.1\nHost:",
        ] {
            assert!(
                matches!(
                    asked(head, "127.0.0.1"),
                    Asked::Refused("421 Misdirected Request", _)
                ),
                "{head}"
            );
        }
        assert_eq!(
            asked("GET / HTTP/1.1\nHost: 192.168.1.7:80", "0.0.0.0"),
            Asked::Page
        );
        assert!(matches!(
            asked("GET / HTTP/1.1\nHost: evil.example", "0.0.0.0"),
            Asked::Refused(..)
        ));
    }

    #[test]
    fn there_is_only_something_to_look_at() {
        let local = "Host: localhost";
        let own = "127.0.0.1";
        assert_eq!(
            asked(&format!("GET /events?x HTTP/1.1\n{local}"), own),
            Asked::Events
        );
        for (line, status) in [
            ("POST / HTTP/1.1", "405 Method Not Allowed"),
            ("GET /../etc/passwd HTTP/1.1", "404 Not Found"),
            ("", "405 Method Not Allowed"),
        ] {
            let got = asked(&format!("{line}\n{local}"), own);
            assert!(
                matches!(got, Asked::Refused(s, _) if s == status),
                "{line}: {got:?}"
            );
        }
    }
}
