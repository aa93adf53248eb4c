//! The board's defmt log: read out of its RAM through the emulator's test socket, decoded with the ELF, as a probe would.

use defmt_decoder::{DecodeError, Table};
use object::{Object, ObjectSymbol};
use std::fmt;
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two looks at the buffer of 1 KiB.
const POLL: Duration = Duration::from_millis(20);

/// One line of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Board time as the board wrote it.
    pub timestamp: String,
    /// "info", "warn", "error"; empty for a plain print.
    pub level: String,
    /// The text.
    pub message: String,
}

/// Why there is no log.
#[derive(Debug)]
pub enum LogError {
    /// The ELF can't be read or has no log table or buffer.
    Elf(String),
    /// The emulator's socket failed.
    Io(io::Error),
}

impl fmt::Display for LogError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Elf(reason) => write!(
                f,
                "the image's log can't be read ({reason}): build it with firmware/build"
            ),
            Self::Io(error) => write!(f, "the emulator's test socket: {error}"),
        }
    }
}

impl std::error::Error for LogError {}

impl From<io::Error> for LogError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// The emulator's test socket: reads and writes the board's memory while it runs.
pub struct Memory {
    socket: BufReader<UnixStream>,
}

impl Memory {
    /// Over a socket from [`Board::take_qtest`](super::Board::take_qtest).
    pub fn new(socket: UnixStream) -> Self {
        Self {
            socket: BufReader::new(socket),
        }
    }

    fn ask(&mut self, question: &str) -> io::Result<String> {
        writeln!(self.socket.get_mut(), "{question}")?;
        loop {
            let mut line = String::new();
            if self.socket.read_line(&mut line)? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            // Lines of interrupts may come between.
            if let Some(answer) = line.strip_prefix("OK") {
                return Ok(answer.trim().to_owned());
            }
            if line.starts_with("FAIL") || line.starts_with("ERR") {
                return Err(io::Error::other(line));
            }
        }
    }

    /// A word.
    pub fn word(&mut self, address: u64) -> io::Result<u32> {
        let answer = self.ask(&format!("readl {address:#x}"))?;
        let digits = answer.trim_start_matches("0x");
        u64::from_str_radix(digits, 16)
            .map(|word| word as u32)
            .map_err(io::Error::other)
    }

    /// Writes a word.
    pub fn set_word(&mut self, address: u64, word: u32) -> io::Result<()> {
        self.ask(&format!("writel {address:#x} {word:#x}"))
            .map(drop)
    }

    /// Some bytes.
    pub fn bytes(&mut self, address: u64, count: usize) -> io::Result<Vec<u8>> {
        if count == 0 {
            return Ok(Vec::new());
        }
        let answer = self.ask(&format!("read {address:#x} {count:#x}"))?;
        let digits = answer.trim_start_matches("0x");
        (0..digits.len() / 2)
            .map(|i| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).map_err(io::Error::other))
            .collect()
    }
}

/// Address of a symbol of the image: one with this name, or the first whose mangled name holds it.
pub fn symbol_address(elf: &[u8], name: &str) -> Result<u64, LogError> {
    let file = object::File::parse(elf).map_err(|error| LogError::Elf(error.to_string()))?;
    let named = |fits: fn(&str, &str) -> bool| {
        file.symbols()
            .find(|symbol| symbol.name().is_ok_and(|own| fits(own, name)))
    };
    named(|own, name| own == name)
        .or_else(|| named(|own, name| own.contains(name)))
        .map(|symbol| symbol.address())
        .ok_or_else(|| LogError::Elf(format!("no symbol {name}")))
}

/// Collects the log of a running board.
pub struct DefmtLog {
    lines: Arc<Mutex<Vec<LogLine>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<Memory, LogError>>>,
}

impl DefmtLog {
    /// Begins to collect.
    pub fn start(image: &Path, memory: Memory) -> Result<Self, LogError> {
        let elf = std::fs::read(image)?;
        let table = Table::parse(&elf)
            .map_err(|error| LogError::Elf(error.to_string()))?
            .ok_or_else(|| LogError::Elf("no table of log lines".to_owned()))?;
        let block = symbol_address(&elf, "_SEGGER_RTT")?;
        let lines = Arc::new(Mutex::new(Vec::new()));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopped) = (Arc::clone(&lines), Arc::clone(&stop));
        let thread = std::thread::spawn(move || collect(&table, block, memory, &shared, &stopped));
        Ok(Self {
            lines,
            stop,
            thread: Some(thread),
        })
    }

    /// The lines so far.
    pub fn lines(&self) -> Vec<LogLine> {
        self.lines
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Reads what is left and ends.
    pub fn finish(mut self) -> Result<(Vec<LogLine>, Memory), LogError> {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self
            .thread
            .take()
            .ok_or_else(|| LogError::Elf("already finished".to_owned()))?;
        let memory = thread
            .join()
            .map_err(|_| LogError::Elf("the reader panicked".to_owned()))??;
        Ok((self.lines(), memory))
    }
}

/// What the first channel of the RTT control block holds unread, and marks it read; empty before the board has started. The block is 24 bytes
/// of header, then name, buffer, size, write and read positions.
///
/// The board runs on between these looks, and its start-up fills the block. The write position is read first: once it is no zero, the rest is
/// there. Read after an address that still was zero, it would have the first lines read out of the flash.
fn unread(memory: &mut Memory, block: u64) -> io::Result<Vec<u8>> {
    let write = memory.word(block + 36)? as usize;
    let read = memory.word(block + 40)? as usize;
    let size = memory.word(block + 32)? as usize;
    let buffer = u64::from(memory.word(block + 28)?);
    if write == read || write.max(read) >= size {
        return Ok(Vec::new());
    }
    let bytes = if write > read {
        memory.bytes(buffer + read as u64, write - read)?
    } else {
        let mut bytes = memory.bytes(buffer + read as u64, size - read)?;
        bytes.extend(memory.bytes(buffer, write)?);
        bytes
    };
    memory.set_word(block + 40, write as u32)?;
    Ok(bytes)
}

/// Decodes what the board logs until it is told to stop, and what is left then.
fn collect(
    table: &Table,
    block: u64,
    mut memory: Memory,
    lines: &Mutex<Vec<LogLine>>,
    stop: &AtomicBool,
) -> Result<Memory, LogError> {
    let mut decoder = table.new_stream_decoder();
    loop {
        let last = stop.load(Ordering::Relaxed);
        decoder.received(&unread(&mut memory, block)?);
        loop {
            let line = match decoder.decode() {
                Ok(frame) => LogLine {
                    timestamp: frame
                        .display_timestamp()
                        .map(|time| time.to_string())
                        .unwrap_or_default(),
                    level: frame
                        .level()
                        .map(|level| level.as_str().to_owned())
                        .unwrap_or_default(),
                    message: frame.display_message().to_string(),
                },
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => LogLine {
                    timestamp: String::new(),
                    level: "malformed".to_owned(),
                    message: String::new(),
                },
            };
            lines
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(line);
        }
        if last {
            return Ok(memory);
        }
        std::thread::sleep(POLL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: u64 = 0x2000_0000;
    const BUFFER: u64 = 0x2000_0100;

    /// An emulator whose board fills the block, and logs "lines", once it has answered so many questions; all else it reads as zero, as the
    /// memory before the start is, and the flash as 0xff.
    fn starting_after(answers: usize) -> Memory {
        let (ours, theirs) = UnixStream::pair().expect("sockets");
        std::thread::spawn(move || {
            let mut writer = theirs.try_clone().expect("a socket");
            for (number, question) in BufReader::new(theirs).lines().enumerate() {
                let question = question.expect("a question");
                let words: Vec<&str> = question.split_whitespace().collect();
                let address =
                    u64::from_str_radix(words[1].trim_start_matches("0x"), 16).expect("an address");
                let word = match address {
                    _ if number < answers => 0,
                    address if address == BLOCK + 28 => BUFFER,
                    address if address == BLOCK + 32 => 1024,
                    address if address == BLOCK + 36 => 5,
                    _ => 0,
                };
                let answer = match words[0] {
                    "readl" => format!("OK {word:#018x}"),
                    "read" if address == BUFFER => "OK 0x6c696e6573".to_owned(),
                    "read" => "OK 0xffffffffff".to_owned(),
                    _ => "OK".to_owned(),
                };
                writeln!(writer, "{answer}").expect("an answer");
            }
        });
        Memory::new(ours)
    }

    #[test]
    fn the_first_lines_survive_a_look_during_the_start() {
        for answers in 0..8 {
            let mut memory = starting_after(answers);
            let looks: Vec<u8> = (0..8)
                .map(|_| unread(&mut memory, BLOCK).expect("an answer"))
                .find(|bytes| !bytes.is_empty())
                .expect("the lines");
            assert_eq!(looks, b"lines", "the board started after {answers} answers");
        }
    }
}
