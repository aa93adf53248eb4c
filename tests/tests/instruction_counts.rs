//! What a tick costs, in instructions, counted by the emulator: the same number in every run, so a benchmark that can fail. And what the
//! image takes.

use object::{Object, ObjectSection};
use palpus_tests::emulator::{Board, command};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

/// SysTicks of the emulated core (168 MHz) to instructions at 1 ns each.
fn instructions(systicks: f64) -> f64 {
    systicks * 1e9 / 168e6
}

/// Ended with the test, however the test ends.
struct Emulator(Child);

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Mean and largest instructions per part.
fn count() -> BTreeMap<String, (f64, f64)> {
    let image = Board::image().with_file_name("palpus-tick-cost");
    assert!(
        image.is_file(),
        "{} is missing: run firmware/build first",
        image.display()
    );
    let mut emulator = Emulator(
        command()
            .args([
                "-M",
                "olimex-stm32-h405",
                "-display",
                "none",
                "-monitor",
                "none",
                "-serial",
                "stdio",
            ])
            .args(["-icount", "shift=0,sleep=off", "-kernel"])
            .arg(&image)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("qemu-system-arm: run tests/setup first"),
    );
    let output = BufReader::new(emulator.0.stdout.take().expect("its output"));
    let mut counts = BTreeMap::new();
    for line in output.lines() {
        let line = line.expect("text");
        let fields: Vec<&str> = line.split_whitespace().collect();
        let [name, mean, largest] = fields[..] else {
            panic!("{line}")
        };
        if name == "end" {
            break;
        }
        let number = |text: &str| text.parse::<f64>().unwrap_or_else(|_| panic!("{line}"));
        counts.insert(
            name.to_owned(),
            (
                instructions(number(mean) / 100.0),
                instructions(number(largest)),
            ),
        );
    }
    counts
}

/// Bytes of the image's sections from an address on, within so many.
fn bytes_within(image: &[u8], from: u64, length: u64) -> u64 {
    let file = object::File::parse(image).expect("an ELF");
    file.sections()
        .filter(|section| (from..from + length).contains(&section.address()))
        .map(|section| section.size())
        .sum()
}

#[test]
fn emulated_image_is_small() {
    let image = std::fs::read(Board::image()).expect("the image: run firmware/build first");
    let ram = bytes_within(&image, 0x2000_0000, 128 << 10);
    let data = {
        let file = object::File::parse(&image[..]).expect("an ELF");
        file.section_by_name(".data").map_or(0, |data| data.size())
    };
    let flash = bytes_within(&image, 0x0800_0000, 768 << 10) + data;
    println!("{flash} bytes of flash, {ram} bytes of RAM");
    // Room for twice of each in the smallest relative of this chip, with 256 KiB and 64 KiB.
    assert!((10_000..128 << 10).contains(&flash), "{flash}");
    assert!((1_000..32 << 10).contains(&ram), "{ram}");
}

#[test]
fn emulated_tick_stays_within_its_instructions() {
    let counts = count();
    // What measuring itself costs is part of each figure.
    for (name, (mean, largest)) in &counts {
        println!("{name}: {mean:.0} instructions, {largest:.0} at most");
    }
    let largest = |name: &str| counts[name].1;
    assert!(largest("solve") < 2_000.0);
    // A whole tick with the chips' drivers, their interrupts' work and the frame's way out.
    let serial = largest("read_serial") + largest("board_tick") + largest("take_frame");
    assert!(serial < 30_000.0, "{serial}");
    // 1 kHz with the SPI converter: a tenth of the 168 000 cycles of a period, at one and a half cycles an instruction.
    let spi = largest("read_spi") + largest("board_tick") + largest("take_frame");
    assert!(spi * 1.5 < 16_800.0, "{spi}");
    assert!(
        counts["valid"].0 > instructions(3.0),
        "the counted contacts are not valid ones"
    );
    // Nothing depends on the machine.
    assert_eq!(counts, count());
}
