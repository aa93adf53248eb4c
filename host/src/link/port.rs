//! Serial devices: opening one, and finding the names another may have come back under.
//!
//! A port is opened for this process alone (an exclusive lock; a second program is told that the port is
//! busy). The lock is given back when the port is dropped, so that a pseudo-terminal whose other end lives on
//! can be opened again.

use super::LinkError;
use super::clock::WireTime;
use serialport::{SerialPort, TTYPort};
use std::collections::BTreeSet;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Baud rate of the boards' UART.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Longest time a write may block before the line counts as stuck.
const WRITE_PATIENCE: Duration = Duration::from_millis(200);

/// A line of bytes to a board.
///
/// `read` returns as soon as there is anything, or fails with [`io::ErrorKind::TimedOut`] after the time set.
pub trait Port: Read + Write + Send {
    /// How long `read` waits.
    ///
    /// # Errors
    /// Those of the device.
    fn set_patience(&mut self, patience: Duration) -> io::Result<()>;
}

/// A serial device of this machine.
pub struct SerialDevice {
    port: TTYPort,
    patience: Duration,
}

impl SerialDevice {
    /// Opens `path` at `baud`, 8 data bits, no parity, 1 stop bit, no flow control.
    ///
    /// # Errors
    /// [`LinkError::Open`].
    pub fn open(path: &str, baud: u32) -> Result<Self, LinkError> {
        let patience = Duration::from_millis(20);
        let port = serialport::new(path, baud)
            .timeout(patience)
            .open_native()
            .map_err(|error| LinkError::Open {
                port: path.into(),
                reason: error.to_string(),
            })?;
        Ok(Self { port, patience })
    }
}

impl Drop for SerialDevice {
    fn drop(&mut self) {
        // A device that has gone can't be unlocked, and need not be.
        let _ = self.port.set_exclusive(false);
    }
}

impl Read for SerialDevice {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.port.read(buffer) {
            // A terminal that has been hung up reads as ended.
            Ok(0) if !buffer.is_empty() => Err(io::ErrorKind::BrokenPipe.into()),
            other => other,
        }
    }
}

impl Write for SerialDevice {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.set_timeout(WRITE_PATIENCE)?;
        let written = self.port.write(bytes);
        self.port.set_timeout(self.patience)?;
        written
    }

    fn flush(&mut self) -> io::Result<()> {
        // Draining blocks until the last bit is on the wire; nothing here depends on that.
        Ok(())
    }
}

impl Port for SerialDevice {
    fn set_patience(&mut self, patience: Duration) -> io::Result<()> {
        self.patience = patience;
        self.port.set_timeout(patience)?;
        Ok(())
    }
}

/// Whether bytes take their time on this device: a UART does, USB's own serial class and pseudo-terminals don't.
pub fn wire_time(path: &str, baud: u32) -> WireTime {
    let real = std::fs::canonicalize(path).unwrap_or_else(|_| PathBuf::from(path));
    let name = real.file_name().map(|n| n.to_string_lossy().into_owned());
    let in_pts = real.parent() == Some(Path::new("/dev/pts"));
    match name {
        Some(name) if !in_pts && !name.starts_with("ttyACM") => WireTime::Baud(baud),
        _ => WireTime::None,
    }
}

/// Names under which a device that was `path` may have come back: itself, its neighbours that differ only in the
/// number at the end (`/dev/ttyUSB0` and `/dev/ttyUSB3`), and the system's other serial ports of that kind.
///
/// Terminals are nobody's board: neighbours under `/dev/pts` and the consoles `/dev/tty0` and on are never named.
pub fn candidates(path: &str) -> Vec<String> {
    let mut found = BTreeSet::new();
    let stem = |name: &str| {
        name.trim_end_matches(|c: char| c.is_ascii_digit())
            .to_owned()
    };
    let wanted = stem(path);
    if !["/dev/pts/", "/dev/tty", ""].contains(&wanted.as_str()) {
        let folder = Path::new(path).parent().unwrap_or(Path::new(""));
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let neighbour = entry.path().to_string_lossy().into_owned();
            if stem(&neighbour) == wanted {
                found.insert(neighbour);
            }
        }
        for port in serialport::available_ports().unwrap_or_default() {
            if stem(&port.port_name) == wanted {
                found.insert(port.port_name);
            }
        }
    }
    found.remove(path);
    let mut names = vec![path.to_owned()];
    names.extend(found);
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_differ_in_the_number_only() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["board0", "board1", "board12", "other0", "board"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let path = folder.path().join("board1").to_string_lossy().into_owned();
        let names: Vec<String> = candidates(&path)
            .iter()
            .map(|p| {
                Path::new(p)
                    .file_name()
                    .unwrap()
                    .to_string_lossy()
                    .into_owned()
            })
            .collect();
        assert_eq!(names, ["board1", "board", "board0", "board12"]);
        for terminal in ["/dev/pts/0", "/dev/tty1"] {
            assert_eq!(candidates(terminal), [terminal]);
        }
    }

    #[test]
    fn a_device_that_is_not_there_is_an_error_with_its_name() {
        let error = SerialDevice::open("/dev/no-such-board", DEFAULT_BAUD)
            .err()
            .unwrap();
        assert!(error.to_string().contains("/dev/no-such-board"), "{error}");
    }

    #[test]
    fn only_a_uart_takes_its_time() {
        assert_eq!(wire_time("/dev/ttyUSB0", 9_600), WireTime::Baud(9_600));
        assert_eq!(wire_time("/dev/ttyACM0", 9_600), WireTime::None);
        assert_eq!(wire_time("/dev/pts/3", 9_600), WireTime::None);
    }
}
