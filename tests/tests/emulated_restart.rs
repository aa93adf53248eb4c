//! The image panics and faults, by a poke into its memory, and starts again by itself: it says why, on the probe's log and to the host, and
//! its contacts go on.

use palpus_protocol::{BoardMessage, Contact};
use palpus_tests::emulator::log::symbol_address;
use palpus_tests::emulator::{
    Bench, Board, Client, DefmtLog, HostLine, Memory, Motion, SlidingFinger, hand_file,
};
use std::time::Duration;

/// Real time after which a board that says nothing is taken for dead.
const DEAD: Duration = Duration::from_secs(120);

/// The vector table's offset register, and the vectors of this core.
const VTOR: u64 = 0xe000_ed08;
const VECTORS: u64 = 16 + 82;
const SYSTICK: u64 = 15;
const FLASH: u64 = 0x0800_0000;
/// RAM that the image does not use.
const SPARE: u64 = 0x2001_0000;

/// Waits until the board has said these words after `mark`, and then again who it is and what it feels.
fn starts_again(client: &mut Client, mark: usize, words: &str) {
    let seen = client.wait(DEAD, |messages| {
        messages[mark..]
            .iter()
            .any(|message| matches!(message, BoardMessage::Log(log) if log.text.contains(words)))
            .then_some(())
    });
    assert!(seen.is_some(), "the board never said {words:?}");
    let identity = client.identify().expect("an answer");
    assert_eq!(identity.finger_name.as_str(), "index");
    let mark = client.messages().len();
    client.start_contacts().expect("a stream");
    let contacts = client.wait(DEAD, |messages| {
        let contacts: Vec<Contact> = messages[mark..]
            .iter()
            .filter_map(|message| match message {
                BoardMessage::Contact(contact) => Some(*contact),
                _ => None,
            })
            .collect();
        (contacts.len() >= 100).then_some(contacts)
    });
    let contacts = contacts.expect("contacts after the restart");
    assert!(
        contacts
            .windows(2)
            .all(|pair| pair[1].lost_since(pair[0].sequence) == 0)
    );
    let statistics = client.statistics().expect("statistics");
    assert!(
        statistics.board_time_us < 60_000_000 && statistics.ticks >= 100,
        "{statistics:?}"
    );
}

#[test]
fn emulated_panic_and_fault_are_told_after_the_restart() {
    let hand = palpus_host::hand::Hand::read(&hand_file()).expect("the shipped hand");
    let (_, finger) = hand.finger("index").expect("its index finger");
    let world = SlidingFinger::new(finger.clone(), Motion::STANDARD);
    let mut board = Board::start(Bench::new(Box::new(world))).expect("the emulated board");
    let line =
        HostLine::new(board.take_host().expect("the host's socket")).expect("a pseudo-terminal");
    let mut memory = Memory::new(board.take_qtest().expect("a test socket"));
    let elf = std::fs::read(Board::image()).expect("the image");
    let mut client = Client::open(line.path()).expect("the line");
    client.identify().expect("a board");

    // Without its time base the clock divides by zero.
    let ticks_per_beat = symbol_address(&elf, "TICKS_PER_BEAT").expect("the time base");
    let mark = client.messages().len();
    memory.set_word(ticks_per_beat, 0).expect("a poke");
    starts_again(&mut client, mark, "restarted after a panic in source line");
    let log = DefmtLog::start(&Board::image(), memory).expect("the log");
    let (lines, mut memory) = log.finish().expect("the log");
    println!("{lines:#?}");
    assert!(lines.iter().any(|line| {
        line.level == "error"
            && line.message.starts_with("last words: time.rs:")
            && line.message.contains("divide by zero")
    }));
    assert!(lines.iter().all(|line| line.level != "malformed"));

    // A copy of the vectors, whose SysTick has an address that is no code's: bit 0 is not set.
    for vector in 0..VECTORS {
        let address = memory.word(FLASH + 4 * vector).expect("a vector");
        memory
            .set_word(SPARE + 4 * vector, address)
            .expect("a poke");
    }
    memory
        .set_word(SPARE + 4 * SYSTICK, FLASH as u32)
        .expect("a poke");
    let mark = client.messages().len();
    memory.set_word(VTOR, SPARE as u32).expect("a poke");
    starts_again(
        &mut client,
        mark,
        "restarted after a processor fault at 0x08000000",
    );

    // What was told once is not told again.
    let told = |client: &Client| {
        let messages = client.messages();
        messages
            .iter()
            .filter(|message| matches!(message, BoardMessage::Log(log) if log.text.contains("restarted")))
            .count()
    };
    assert_eq!(told(&client), 2);
}
