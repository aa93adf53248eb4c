//! Every fuzz target on its seeds, on the inputs that were kept, and on a fixed number of mutations of both.
//!
//! `tests/fuzz/run` looks for new inputs, guided by coverage. What it finds goes to `tests/fuzz/kept/TARGET/`, named
//! for what it did, and is run here from then on. `PALPUS_MUTATIONS=N` takes N times as many mutations.

use palpus_tests::fuzz::{TARGETS, Target, mutate};
use std::path::Path;

fn kept(target: &Target) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fuzz/kept")
        .join(target.name);
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut kept: Vec<(String, Vec<u8>)> = entries
        .map(|entry| {
            let entry = entry.expect("a readable folder");
            let name = entry.file_name().to_string_lossy().into_owned();
            (name, std::fs::read(entry.path()).expect("a readable file"))
        })
        .collect();
    kept.sort();
    kept
}

fn run(name: &str) {
    let target = palpus_tests::fuzz::find(name).expect("a target of that name");
    let mut inputs = (target.seeds)();
    assert!(!inputs.is_empty());
    for (number, seed) in inputs.iter().enumerate() {
        println!("{name}: seed {number}");
        assert!(
            seed.len() <= target.longest,
            "{name}: seed {number} is {} bytes",
            seed.len()
        );
        (target.run)(seed);
    }
    for (file, bytes) in kept(target) {
        println!("{name}: {file}");
        (target.run)(&bytes);
        inputs.push(bytes);
    }
    let times: u64 = std::env::var("PALPUS_MUTATIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(1);
    for seed in 0..target.mutations * times {
        let input = mutate(&inputs, target.longest, seed);
        let done = std::panic::catch_unwind(|| (target.run)(&input));
        assert!(done.is_ok(), "{name}: mutation {seed}: {:02x?}", input);
    }
}

macro_rules! each_target {
    ($($name:ident),* $(,)?) => {
        $(
            #[test]
            fn $name() {
                run(stringify!($name));
            }
        )*

        #[test]
        fn none_is_left_out() {
            let names = [$(stringify!($name)),*];
            assert_eq!(TARGETS.iter().map(|t| t.name).collect::<Vec<_>>(), names);
        }
    };
}

each_target!(
    frame_decoder,
    board_commands,
    run_reader,
    points_ply,
    points_text,
    points_pcd,
    mesh_ply,
    mesh_stl,
    mesh_obj,
    hand_urdf,
    hand_file,
    load_table,
    surface_file,
    reconstruction,
);
