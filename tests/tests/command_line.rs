//! What the program answers to good and bad command lines and inputs: codes, messages, files left behind.

use palpus_tests::outcome::{Outcome, listing, palpus};
use serde_json::Value;
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use tempfile::{TempDir, tempdir};

/// Rows of a unit sphere, evenly spread, normals outward.
fn sphere_rows(count: usize) -> Vec<String> {
    let golden = PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|k| {
            let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
            let (r, a) = ((1.0 - z * z).sqrt(), golden * k as f64);
            let (x, y) = (r * a.cos(), r * a.sin());
            format!("{x} {y} {z} {x} {y} {z}")
        })
        .collect()
}

/// A folder that holds `name` with these rows and nothing else.
fn folder_with(name: &str, rows: &[String]) -> TempDir {
    let folder = tempdir().unwrap();
    fs::write(folder.path().join(name), rows.join("\n") + "\n").unwrap();
    folder
}

fn run(folder: &Path, line: &str) -> Outcome {
    palpus(folder, &line.split_whitespace().collect::<Vec<_>>())
}

/// The one JSON object that stdout holds.
fn only_object(outcome: &Outcome) -> Value {
    let value: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(value.is_object(), "{}", outcome.stdout);
    value
}

/// Checks that the input is refused with these words, that stdout stays empty and nothing is written.
fn refused(folder: &TempDir, line: &str, code: i32, words: &[&str]) {
    let before = listing(folder.path());
    let outcome = run(folder.path(), line);
    assert_eq!(outcome.code, code, "{line}: {outcome:?}");
    assert_eq!(outcome.stdout, "", "{line}");
    for word in words {
        assert!(
            outcome.stderr.contains(word),
            "{line}: no {word:?} in {}",
            outcome.stderr
        );
    }
    assert_eq!(listing(folder.path()), before, "{line}");
}

#[test]
fn unusable_inputs_are_refused_with_file_line_and_value() {
    let folder = tempdir().unwrap();
    let write = |name: &str, rows: &[String]| {
        fs::write(folder.path().join(name), rows.join("\n")).unwrap();
    };
    let good = sphere_rows(60);
    let spoilt = |normal: &str| -> Vec<String> {
        let mut rows = good.clone();
        for row in &mut rows[20..55] {
            let position: Vec<&str> = row.split(' ').take(3).collect();
            *row = format!("{} {normal}", position.join(" "));
        }
        rows
    };
    write("empty.xyz", &[]);
    write("nan.xyz", &spoilt("nan 0 1"));
    write("zero.xyz", &spoilt("0 0 0"));
    let mut cut = good.clone();
    cut[59] = "0.25 0.5".into();
    write("cut.xyz", &cut);
    cut[59] = "0.25 abc 1 0 0 1".into();
    write("word.xyz", &cut);
    write("model.stl", &good);
    write("head.ply", &good);
    write("two.xyz", &good[..2]);
    let mut few = good[..2].to_vec();
    few.push("1 nan 0 0 0 1".into());
    write("few.xyz", &few);
    write("same.xyz", &vec!["1 2 3 0 0 1".to_owned(); 50]);
    let line: Vec<String> = (0..50).map(|k| format!("{k} 0 0 0 0 1")).collect();
    write("line.xyz", &line);
    fs::create_dir(folder.path().join("sub")).unwrap();

    for (input, words) in [
        ("empty.xyz", &["empty.xyz", "no point"][..]),
        ("missing.xyz", &["missing.xyz", "check the path"]),
        ("sub", &["sub", "cannot be read"]),
        ("nan.xyz", &["nan.xyz", "35 of 60", "line 21", "nan"]),
        ("zero.xyz", &["zero.xyz", "35 of 60", "line 21", "0 0 0"]),
        ("cut.xyz", &["cut.xyz", "line 60", "2 values"]),
        ("word.xyz", &["word.xyz", "line 60", "abc"]),
        ("model.stl", &["model.stl", "mesh"]),
        ("head.ply", &["head.ply", "does not begin"]),
        ("two.xyz", &["2 usable contacts are too few"]),
        (
            "few.xyz",
            &["2 usable contacts are too few", "few.xyz:3:", "NaN"],
        ),
        ("same.xyz", &["50 points", "coincide"]),
        ("line.xyz", &["on a line"]),
    ] {
        let command = format!("reconstruct {input} -o s.json --mesh m.stl --report r.json --json");
        refused(&folder, &command, 3, words);
    }
}

#[test]
fn wrong_usage_is_refused_before_any_work() {
    let folder = folder_with("a.xyz", &sphere_rows(60));
    for (options, words) in [
        ("--tolerance -1", &["-1"][..]),
        ("--tolerance=-1", &["tolerance", "-1", "above 0"]),
        ("--tolerance nan", &["tolerance", "NaN"]),
        ("--tolerance 0", &["tolerance", "above 0"]),
        ("--tolerance much", &["much"]),
        ("--lambda=-1", &["lambda", "-1"]),
        ("--max-patches 0", &["max-patches"]),
        ("--mesh m.foo", &["m.foo", ".stl"]),
        ("--mesh m.stl --mesh-step 0", &["--mesh-step"]),
        ("--mesh m.stl --mesh-step nan", &["--mesh-step"]),
        ("--stop-after extract -o s.json", &["--stop-after"]),
        ("--stop-after simplify --step s.step", &["--stop-after"]),
        ("--stop-after lunch", &["extract", "simplify", "fit"]),
        ("--no-such-option", &["--no-such-option"]),
    ] {
        refused(&folder, &format!("reconstruct a.xyz {options}"), 2, words);
    }
    refused(&folder, "reconstruct", 2, &["INPUT"]);
    refused(&folder, "recnstruct a.xyz", 2, &["reconstruct"]);
    for command in [
        "simulate --object torsu --points 9 -o p.ply",
        "demo --object torsu --out d",
    ] {
        refused(&folder, command, 2, &["torsu", "two-holed-torus"]);
    }
    refused(
        &folder,
        "simulate --object torus --points 9 -o p.ply --longest-side=-1",
        2,
        &["--longest-side"],
    );
}

#[test]
fn a_message_says_nothing_twice() {
    let folder = folder_with("two.xyz", &sphere_rows(2));
    let outcome = run(folder.path(), "reconstruct two.xyz");
    assert_eq!(outcome.stderr.matches("too few").count(), 1, "{outcome:?}");
}

#[test]
fn some_bad_rows_are_dropped_and_named() {
    let mut rows = sphere_rows(600);
    rows[6] = "nan 0 1 0 0 1".into();
    rows[40] = "0 0 1 0 0 0".into();
    let folder = folder_with("a.xyz", &rows);
    let outcome = run(
        folder.path(),
        "reconstruct a.xyz --stop-after extract --report r.json --json",
    );
    assert_eq!(outcome.code, 0, "{outcome:?}");
    let report = only_object(&outcome);
    let input = &report["input"];
    assert_eq!(
        (&input["points"], &input["used"]),
        (&600.into(), &598.into())
    );
    assert_eq!(input["rejected"], 2);
    let named = input["rejected_rows"].to_string();
    assert!(
        named.contains("a.xyz:7:") && named.contains("a.xyz:41:"),
        "{named}"
    );
    assert_eq!(listing(folder.path()), ["a.xyz", "r.json"]);
    let written: Value =
        serde_json::from_slice(&fs::read(folder.path().join("r.json")).unwrap()).unwrap();
    assert_eq!(written, report);
}

#[test]
fn several_inputs_are_joined_and_only_what_was_asked_is_written() {
    let rows = sphere_rows(600);
    let folder = folder_with("upper.xyz", &rows[..300]);
    let lower = rows[300..].iter().fold(String::new(), |mut text, row| {
        let _ = writeln!(text, "{}", row.replace(' ', ","));
        text
    });
    fs::write(folder.path().join("lower.csv"), lower).unwrap();
    let outcome = run(folder.path(), "reconstruct upper.xyz lower.csv --json");
    assert_eq!(outcome.code, 0, "{outcome:?}");
    assert_eq!(outcome.stderr, "");
    let report = only_object(&outcome);
    assert_eq!(report["input"]["points"], 600);
    assert_eq!(report["surface"]["borders"], 0, "{report}");
    assert_eq!(report["surface"]["genus"], 0);
    assert_eq!(listing(folder.path()), ["lower.csv", "upper.xyz"]);
}

#[test]
fn every_stage_can_be_looked_at() {
    let folder = folder_with("a.xyz", &sphere_rows(600));
    let mut phases = Vec::new();
    for stage in ["extract", "simplify", "fit"] {
        phases.push(stage);
        let outcome = run(
            folder.path(),
            &format!("reconstruct a.xyz --stop-after {stage} --mesh {stage}.obj --json"),
        );
        assert_eq!(outcome.code, 0, "{outcome:?}");
        let report = only_object(&outcome);
        let ran = report["phases"].as_array().unwrap();
        let ran: Vec<&str> = ran.iter().map(|p| p["name"].as_str().unwrap()).collect();
        assert_eq!(ran, phases);
        assert_eq!(report["surface"].is_object(), stage == "fit");
        let mesh = fs::read_to_string(folder.path().join(format!("{stage}.obj"))).unwrap();
        let faces = mesh.lines().filter(|l| l.starts_with("f ")).count();
        if stage != "fit" {
            assert_eq!(
                report["phases"][phases.len() - 1]["triangles"],
                faces,
                "{stage}"
            );
        }
        assert!(faces > 3, "{stage}");
    }
    assert_eq!(
        listing(folder.path()),
        ["a.xyz", "extract.obj", "fit.obj", "simplify.obj"]
    );
}

#[test]
fn strict_leaves_with_4_when_the_tolerance_cannot_be_met() {
    let folder = folder_with("a.xyz", &sphere_rows(600));
    let line = "reconstruct a.xyz --tolerance 1e-6 --max-patches 1 --rounds 1 -o s.json --json";
    let outcome = run(folder.path(), line);
    assert_eq!(outcome.code, 0, "{outcome:?}");
    let error = &only_object(&outcome)["error"];
    assert_eq!(error["met"], false);
    assert!(!error["reason"].as_str().unwrap().is_empty());
    let strict = run(folder.path(), &format!("{line} --strict"));
    assert_eq!(strict.code, 4, "{strict:?}");
    // What was reached is written all the same.
    assert_eq!(listing(folder.path()), ["a.xyz", "s.json"]);
}

#[test]
fn contacts_in_one_plane_give_a_sheet() {
    let rows: Vec<String> = (0..400)
        .map(|k| format!("{} {} 0 0 0 1", k % 20, k / 20))
        .collect();
    let folder = folder_with("a.xyz", &rows);
    let outcome = run(folder.path(), "reconstruct a.xyz --json");
    assert_eq!(outcome.code, 0, "{outcome:?}");
    let report = only_object(&outcome);
    assert_eq!(report["surface"]["borders"], 1);
    assert_eq!(report["surface"]["components"], 1);
    // The square's corners are rounded off within a spacing of the contacts, and the report says what that does
    // to the tolerance.
    assert!(report["error"]["max"].as_f64().unwrap() < 1.0);
    assert!(!report["error"]["reason"].as_str().unwrap().is_empty());
}

#[test]
fn absurd_inputs_end_in_a_clear_answer() {
    let ball = sphere_rows(200);
    let line = |k: i32| {
        format!(
            "{} {} {} 0 0 1",
            0.01 * f64::from(k),
            0.02 * f64::from(k),
            0.7
        )
    };
    let skew: Vec<String> = (0..300).map(line).collect();
    let same = vec!["1 2 3 0 0 1".to_owned(); 100_000];
    let beside: Vec<String> = [&ball[..], &ball[7..8], &ball[7..8], &ball[7..8]].concat();
    let mut state = 1_u64;
    let mut any = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    let random: Vec<String> = (0..800)
        .map(|_| {
            (0..6)
                .map(|_| any().to_string())
                .collect::<Vec<_>>()
                .join(" ")
        })
        .collect();
    for (rows, words) in [
        (&skew, "lie on a line"),
        (&same, "no extent"),
        (&random, "fit no common surface"),
    ] {
        let folder = folder_with("p.xyz", rows);
        refused(&folder, "reconstruct p.xyz", 3, &[words]);
    }
    let folder = folder_with("p.xyz", &ball);
    refused(
        &folder,
        "reconstruct p.xyz --threads 100000",
        2,
        &["threads", "512"],
    );
    refused(
        &folder,
        "reconstruct p.xyz --max-memory 0",
        3,
        &["more than the 0 allowed"],
    );

    // What repeats exactly is counted once, and said.
    let folder = folder_with("p.xyz", &beside);
    let report = only_object(&run(folder.path(), "reconstruct p.xyz --json"));
    assert_eq!(report["input"]["points"], 203);
    assert_eq!(report["input"]["used"], 203);
    let notes = report["notes"].to_string();
    assert!(
        notes.contains("3 contacts repeat another exactly"),
        "{notes}"
    );
}
