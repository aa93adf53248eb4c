//! The documentation's code blocks are run: what is printed in it works, and prints what it says.
//!
//! | block | what is done with it |
//! |---|---|
//! | `sh` | run by bash in a folder that all blocks of a page share; has to succeed |
//! | `sh board` | needs a board: only its options are checked, by adding `--help` |
//! | `python` | run in the same folder with numpy alone |
//! | `console` | commands after `$ `, each followed by what it prints on both streams, letter by letter |
//! | `text` | nothing |
//!
//! `PALPUS_TEST_BLESS=1` writes what the commands print into the `console` blocks.

use palpus_tests::{program, python, script};
use std::path::{Path, PathBuf};
use std::process::Command;

/// One fenced block: the words after the fence, its text, and where the text begins in the page.
struct Block {
    kind: String,
    text: String,
    start: usize,
}

fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    let mut at = 0;
    for line in page.split_inclusive('\n') {
        at += line.len();
        match (&mut open, line.strip_prefix("```")) {
            (None, Some(kind)) => {
                open = Some(Block {
                    kind: kind.trim().to_owned(),
                    text: String::new(),
                    start: at,
                });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (Some(block), None) => block.text.push_str(line),
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block is not closed");
    blocks
}

/// Bash in `folder`, with `palpus` in the path; `cargo run --release --` of the README is the same program.
fn bash(folder: &Path, text: &str) -> Command {
    let own = program::palpus().parent().unwrap().display().to_string();
    let path = std::env::var("PATH").unwrap_or_default();
    let cargo =
        "cargo() { [ \"$1 $2 $3\" = 'run --release --' ] || return 1; shift 3; palpus \"$@\"; }";
    let mut command = Command::new("bash");
    command
        .current_dir(folder)
        .env("PATH", format!("{own}:{path}"))
        .env("LC_ALL", "C.UTF-8")
        .args(["-euo", "pipefail", "-c", &format!("{cargo}\n{text}")]);
    command
}

/// What the commands of a console block print, in the form of the block.
fn transcript(folder: &Path, block: &str) -> String {
    let mut out = String::new();
    for line in block.lines().filter(|line| line.starts_with("$ ")) {
        let command = format!("{{ {}; }} 2>&1", &line[2..]);
        let printed = bash(folder, &command).output().expect("bash");
        out.push_str(line);
        out.push('\n');
        out.push_str(&String::from_utf8_lossy(&printed.stdout));
        if let Some(code) = printed.status.code().filter(|code| *code != 0) {
            out.push_str(&format!("[exit code {code}]\n"));
        }
    }
    out
}

fn check(path: &Path) {
    let name = path.display();
    let mut page = std::fs::read_to_string(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let bless = std::env::var_os("PALPUS_TEST_BLESS").is_some();
    let mut blessed: Vec<(Block, String)> = Vec::new();
    for block in blocks(&page) {
        match block.kind.as_str() {
            "sh" => {
                script::run(&mut bash(folder.path(), &block.text), "bash");
            }
            "sh board" => {
                for line in block
                    .text
                    .lines()
                    .filter(|line| line.starts_with("palpus "))
                {
                    script::run(&mut bash(folder.path(), &format!("{line} --help")), "bash");
                }
            }
            "python" => {
                let mut command = Command::new(python::interpreter());
                command.current_dir(folder.path()).args(["-c", &block.text]);
                script::run(&mut command, "Python with the tests' packages");
            }
            "console" => {
                let printed = transcript(folder.path(), &block.text);
                if bless {
                    blessed.push((block, printed));
                } else {
                    assert_eq!(block.text, printed, "{name}: run with PALPUS_TEST_BLESS=1");
                }
            }
            "text" => {}
            other => panic!("{name}: a block of kind `{other}`: sh, python, console or text?"),
        }
    }
    for (block, printed) in blessed.into_iter().rev() {
        page.replace_range(block.start..block.start + block.text.len(), &printed);
    }
    if bless {
        std::fs::write(path, page).unwrap();
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn the_readme_works() {
    check(&root().join("README.md"));
}

#[test]
fn the_guide_works() {
    check(&root().join("host/docs/guide.md"));
    check(&root().join("host/docs/how-it-works.md"));
}

#[test]
fn the_pages_of_the_formats_work() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("host/docs/formats")).unwrap() {
        check(&entry.unwrap().path());
        count += 1;
    }
    assert!(count >= 5);
}

#[test]
fn mistakes_get_the_answers_that_are_printed() {
    check(&root().join("host/docs/mistakes.md"));
}

/// Every relative link and picture of the pages leads somewhere.
#[test]
fn links_lead_somewhere() {
    let mut pages = vec![root().join("README.md"), root().join("firmware/README.md")];
    for folder in ["host/docs", "host/docs/formats"] {
        let entries = std::fs::read_dir(root().join(folder)).unwrap();
        pages.extend(entries.map(|entry| entry.unwrap().path()));
    }
    let mut links = 0;
    for page in pages
        .iter()
        .filter(|p| p.extension().is_some_and(|e| e == "md"))
    {
        let text = std::fs::read_to_string(page).unwrap();
        for part in text.split("](").skip(1) {
            let target = part.split([')', '#']).next().unwrap_or_default();
            if target.is_empty() || target.contains("://") || target.contains(char::is_whitespace) {
                continue;
            }
            let place = page.parent().unwrap().join(target);
            assert!(place.exists(), "{}: {target} is not there", page.display());
            links += 1;
        }
    }
    assert!(links > 10);
}
