//! Starts the emulator with the image, connects everything, and ends it.

use super::chips::{self, Bench};
use std::io;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Where `firmware/build` puts the image, from the workspace's folder.
const IMAGE: &str = "target/board/thumbv7em-none-eabihf/board/palpus-olimex-h405";

/// How long the emulator may take to connect its sockets.
const START_LIMIT: Duration = Duration::from_secs(20);

/// What keeps the emulated board from starting.
#[derive(Debug)]
pub enum BoardError {
    /// The image is not there.
    NoImage(PathBuf),
    /// The emulator could not be started.
    NoEmulator(io::Error),
    /// The emulator ended or did not connect; with what it said.
    DidNotStart(String),
    /// A socket or folder could not be made.
    Io(io::Error),
}

impl std::fmt::Display for BoardError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoImage(path) => {
                write!(f, "{} is missing: run firmware/build first", path.display())
            }
            Self::NoEmulator(error) => {
                write!(
                    f,
                    "qemu-system-arm can't be started ({error}): run tests/setup, which installs version 10"
                )
            }
            Self::DidNotStart(said) => write!(
                f,
                "the emulator did not come up; it needs machine olimex-stm32-h405 of QEMU 10 (tests/setup installs it). It said: {said}"
            ),
            Self::Io(error) => write!(f, "the emulator's sockets can't be made: {error}"),
        }
    }
}

impl std::error::Error for BoardError {}

impl From<io::Error> for BoardError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A running emulated board.
pub struct Board {
    child: Child,
    bench: Arc<Mutex<Bench>>,
    host: Option<UnixStream>,
    qtest: Option<UnixStream>,
    _folder: TempDir,
}

impl Board {
    /// The image's path: `PALPUS_BOARD_ELF`, or where `firmware/build` puts it.
    pub fn image() -> PathBuf {
        std::env::var_os("PALPUS_BOARD_ELF").map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(IMAGE),
            PathBuf::from,
        )
    }

    /// Starts the board with these chips.
    pub fn start(bench: Bench) -> Result<Self, BoardError> {
        Self::start_with(bench, &[])
    }

    /// The same, with more options for the emulator.
    pub fn start_with(bench: Bench, options: &[&str]) -> Result<Self, BoardError> {
        let image = Self::image();
        if !image.is_file() {
            return Err(BoardError::NoImage(image));
        }
        let folder = tempfile::tempdir()?;
        let path = |name: &str| folder.path().join(name);
        let listen = |name: &str| -> io::Result<UnixListener> {
            let listener = UnixListener::bind(path(name))?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        // The n-th `-serial` is USART n; the fifth is not used.
        let ports = [
            "host",
            "converter0",
            "converter1",
            "encoders",
            "",
            "converter2",
        ];
        let mut listeners = Vec::new();
        let mut command = command();
        command.args([
            "-M",
            "olimex-stm32-h405",
            "-display",
            "none",
            "-monitor",
            "none",
            "-accel",
            "tcg",
        ]);
        for name in ports {
            if name.is_empty() {
                command.args(["-serial", "null"]);
            } else {
                command
                    .arg("-serial")
                    .arg(format!("unix:{}", path(name).display()));
                listeners.push(listen(name)?);
            }
        }
        let qtest = listen("qtest")?;
        command
            .arg("-qtest")
            .arg(format!("unix:{}", path("qtest").display()));
        command
            .args(["-qtest-log", "none"])
            .arg("-kernel")
            .arg(&image)
            .args(options);
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command.stderr(std::fs::File::create(path("errors"))?);
        let mut child = command.spawn().map_err(BoardError::NoEmulator)?;

        let deadline = Instant::now() + START_LIMIT;
        let mut accept = |listener: &UnixListener| -> Result<UnixStream, BoardError> {
            loop {
                match listener.accept() {
                    Ok((stream, _)) => {
                        stream.set_nonblocking(false)?;
                        return Ok(stream);
                    }
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                        if child.try_wait()?.is_some() || Instant::now() > deadline {
                            let _ = child.kill();
                            let said = std::fs::read_to_string(path("errors")).unwrap_or_default();
                            return Err(BoardError::DidNotStart(said));
                        }
                        std::thread::sleep(Duration::from_millis(2));
                    }
                    Err(error) => return Err(error.into()),
                }
            }
        };
        let streams: Vec<UnixStream> = listeners
            .iter()
            .map(&mut accept)
            .collect::<Result<_, _>>()?;
        let qtest = accept(&qtest)?;
        // The test shares locks with the chips and with what reads the line: were it to wait for its turn while it holds
        // one, they would wait with it, whatever their own priority.
        chips::hurry();
        let bench = Arc::new(Mutex::new(bench));
        let mut streams = streams.into_iter();
        let host = streams.next();
        for (line, stream) in [0, 1, 3, 2].into_iter().zip(streams) {
            chips::serve(line, stream, Arc::clone(&bench));
        }
        Ok(Self {
            child,
            bench,
            host,
            qtest: Some(qtest),
            _folder: folder,
        })
    }

    /// The chips and their world.
    pub fn bench(&self) -> MutexGuard<'_, Bench> {
        chips::lock(&self.bench)
    }

    /// Stops or continues the emulator: meanwhile the board's clock stands still and the host's goes on.
    pub fn freeze(&self, on: bool) {
        let signal = if on { "-STOP" } else { "-CONT" };
        let _ = Command::new("kill")
            .arg(signal)
            .arg(self.child.id().to_string())
            .status();
    }

    /// The board's side of the host line; can be taken once, and must then always be read.
    pub fn take_host(&mut self) -> Option<UnixStream> {
        self.host.take()
    }

    /// The emulator's test socket; can be taken once.
    pub fn take_qtest(&mut self) -> Option<UnixStream> {
        self.qtest.take()
    }
}

/// The emulator's command, with real-time priority where the system allows it: its chips answer over sockets, and on a
/// machine that is busy with other things their answers would come later than any chip's.
pub fn command() -> Command {
    const EMULATOR: &str = "qemu-system-arm";
    let allowed = Command::new("chrt")
        .args(["--rr", "1", "true"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if allowed {
        let mut command = Command::new("chrt");
        command.args(["--rr", "1", EMULATOR]);
        command
    } else {
        Command::new(EMULATOR)
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
