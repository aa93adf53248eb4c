//! The report page and the live page in a real browser: every layer clicked through, points picked, viewers that are
//! slow or go away.

use palpus_tests::browser;
use palpus_tests::outcome::palpus;
use palpus_tests::program;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

#[test]
fn report_page_can_be_clicked_through() {
    let folder = tempfile::tempdir().unwrap();
    let run = |line: &str| {
        let outcome = palpus(folder.path(), &line.split_whitespace().collect::<Vec<_>>());
        assert_eq!(outcome.code, 0, "{line}: {outcome:?}");
    };
    run("simulate --object cylinder --points 700 -o points.ply");
    run("reconstruct points.ply --page page.html --units mm --threads 2");
    // PALPUS_TEST_SCREENSHOTS=FOLDER keeps what the browser showed.
    let mut arguments = vec![folder.path().join("page.html")];
    arguments.extend(std::env::var_os("PALPUS_TEST_SCREENSHOTS").map(Into::into));
    let seen = browser::run("check_report.js", &arguments);
    let charts = seen["charts"].to_string();
    for chart in [
        "Distances of the points: 700 values",
        "Angles between normals",
        "Error from phase to phase: extract",
        "Error from level to level: level 0 with",
        "Time per phase",
    ] {
        assert!(charts.contains(chart), "{chart}: {charts}");
    }
    let layers = seen["layers"].to_string();
    for layer in [
        "extracted mesh",
        "simplified mesh",
        "error (",
        "mean curvature",
        "Gaussian curvature",
        "reflection lines",
        "patch borders",
        "creases",
        "control net",
        "measured normals",
    ] {
        assert!(layers.contains(layer), "{layer}: {layers}");
    }
}

/// A program that is ended when this is dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(folder: &Path, arguments: &[&str]) -> Running {
    let child = Command::new(program::palpus())
        .current_dir(folder)
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    Running(child.expect("palpus starts"))
}

#[test]
fn live_page_shows_a_capture_and_never_holds_it_up() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = [
        "simulate",
        "--object",
        "sphere",
        "--write-hand",
        "hand.urdf",
        "--json",
    ];
    let mut boards = start(folder.path(), &simulate);
    let mut said = String::new();
    let mut lines = BufReader::new(boards.0.stdout.take().unwrap());
    lines.read_line(&mut said).unwrap();
    let ports: Value = serde_json::from_str(&said).unwrap();
    let mut line: Vec<String> =
        "capture --hand hand.urdf -o run.mcap --json --live page --listen 127.0.0.1:0"
            .split(' ')
            .map(str::to_owned)
            .collect();
    for finger in ports["fingers"].as_array().unwrap() {
        let text = |key: &str| finger[key].as_str().unwrap().to_owned();
        line.extend([
            "--finger".to_owned(),
            format!("{}={}", text("finger"), text("port")),
        ]);
    }
    let arguments: Vec<&str> = line.iter().map(String::as_str).collect();
    let mut capture = start(folder.path(), &arguments);
    let mut said = String::new();
    BufReader::new(capture.0.stderr.take().unwrap())
        .read_line(&mut said)
        .unwrap();
    let url = said.trim().strip_prefix("live page: ").unwrap().to_owned();
    let address = url.trim_start_matches("http://").trim_end_matches('/');

    // One who asks and never reads, one who goes away at once, one who never finishes asking.
    let ask = |text: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(text.as_bytes()).unwrap();
        stream
    };
    let events = format!("GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n");
    let slow = ask(&events);
    drop(ask(&events));
    let unfinished = ask("GET /events HTTP/1.1\r\n");
    // One who comes under a foreign name.
    let mut answer = String::new();
    ask("GET / HTTP/1.1\r\nHost: elsewhere.example\r\n\r\n")
        .read_to_string(&mut answer)
        .unwrap();
    assert!(answer.starts_with("HTTP/1.1 421"), "{answer}");

    let mut arguments = vec![url.clone()];
    if let Ok(shots) = std::env::var("PALPUS_TEST_SCREENSHOTS") {
        arguments.push(format!("{shots}/live.png"));
    }
    let seen = browser::run("check_live.js", &arguments);
    assert_eq!(
        seen["fingers"],
        serde_json::json!(["index", "middle", "thumb"]),
        "{seen}"
    );

    let told = Command::new("kill")
        .args(["-INT", &capture.0.id().to_string()])
        .status();
    assert!(told.unwrap().success());
    let mut summary = String::new();
    let mut out = capture.0.stdout.take().unwrap();
    out.read_to_string(&mut summary).unwrap();
    assert_eq!(capture.0.wait().unwrap().code(), Some(130));
    let summary: Value = serde_json::from_str(&summary).unwrap();
    for finger in summary["fingers"].as_array().unwrap() {
        assert_eq!(finger["dropped_by_host"], 0, "{finger}");
        assert_eq!(finger["bad"], 0, "{finger}");
        assert!(finger["contacts"].as_u64() > Some(300), "{finger}");
    }
    drop((slow, unfinished));
}
