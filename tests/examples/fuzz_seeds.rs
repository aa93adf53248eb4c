//! Writes the seeds of all fuzz targets as files: `FOLDER/TARGET/seed-N`, and lists the targets.
//!
//! `cargo run --release -p palpus-tests --example fuzz_seeds -- FOLDER`

use palpus_tests::fuzz::TARGETS;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("give a folder")?);
    for target in TARGETS {
        let folder = folder.join(target.name);
        std::fs::create_dir_all(&folder)?;
        for (number, seed) in (target.seeds)().iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{number}")), seed)?;
        }
        println!("{} {}", target.name, target.longest);
    }
    Ok(())
}
