//! Everything that takes bytes from outside, as functions of bytes that must not panic.
//!
//! A [`Target`] takes any bytes and fails by a panic: its own (a promise that does not hold) or that of the code under
//! it. The same functions are called from three places: `tests/fuzz` (cargo-fuzz, coverage-guided, needs nightly
//! Rust; `tests/fuzz/run` runs all for a while), `tests/tests/fuzz_targets.rs` (stable Rust, in every test run: all
//! seeds, all inputs kept in `tests/fuzz/kept`, and so many [`mutate`]d ones, always the same), and whoever wants to
//! look at one input.
//!
//! Two ways were weighed. *A target's code in the cargo-fuzz crate*, as its template has it, can't run where there is
//! no nightly compiler, and so not with the other tests. *Plain functions here* cost one line per target there.

mod files;
mod link;
mod mutate;
mod points;
mod seeds;

pub use link::framed;
pub use mutate::mutate;

/// Something to throw bytes at.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name, that of its folder of inputs and of its cargo-fuzz target.
    pub name: &'static str,
    /// Takes any bytes; panics when a promise is broken.
    pub run: fn(&[u8]),
    /// Inputs that reach deep.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Longest input worth trying, bytes.
    pub longest: usize,
    /// Mutated inputs in every test run.
    pub mutations: u64,
}

/// All targets.
pub const TARGETS: &[Target] = &[
    target("frame_decoder", link::frames, seeds::frames, 1_000, 20_000),
    target(
        "board_commands",
        link::commands,
        seeds::commands,
        2_000,
        1_000,
    ),
    target("run_reader", files::run, seeds::run, 32_000, 1_000),
    target(
        "points_ply",
        files::points_ply,
        seeds::points_ply,
        2_000,
        10_000,
    ),
    target(
        "points_text",
        files::points_text,
        seeds::points_text,
        2_000,
        10_000,
    ),
    target(
        "points_pcd",
        files::points_pcd,
        seeds::points_pcd,
        2_000,
        10_000,
    ),
    target("mesh_ply", files::mesh_ply, seeds::mesh_ply, 2_000, 10_000),
    target("mesh_stl", files::mesh_stl, seeds::mesh_stl, 2_000, 10_000),
    target("mesh_obj", files::mesh_obj, seeds::mesh_obj, 2_000, 10_000),
    target(
        "hand_urdf",
        files::hand_urdf,
        seeds::hand_urdf,
        6_000,
        1_000,
    ),
    target(
        "hand_file",
        files::hand_file,
        seeds::hand_file,
        1_000,
        1_000,
    ),
    target(
        "load_table",
        files::load_table,
        seeds::load_table,
        2_000,
        2_000,
    ),
    target(
        "surface_file",
        files::surface,
        seeds::surface,
        40_000,
        1_000,
    ),
    target(
        "reconstruction",
        points::reconstruction,
        seeds::points,
        9_700,
        60,
    ),
];

const fn target(
    name: &'static str,
    run: fn(&[u8]),
    seeds: fn() -> Vec<Vec<u8>>,
    longest: usize,
    mutations: u64,
) -> Target {
    Target {
        name,
        run,
        seeds,
        longest,
        mutations,
    }
}

/// The target of that name.
pub fn find(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|t| t.name == name)
}
