//! Printing that a reader who has gone away (a closed pipe, a closed terminal) does not turn into a failure.

use std::io::Write;

/// Prints on stdout.
pub fn out(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Prints a line on stderr.
pub fn err(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
