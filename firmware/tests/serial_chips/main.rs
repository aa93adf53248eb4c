//! The drivers of the ADS122U04 and the AMT21 against register-level models of the chips, in virtual time: lines of 115 200 Bd, a beat
//! every 0.1 ms, a period of 5 ms, as on the board.

mod bridges;
mod encoders;
mod line;
mod rig;

#[path = "../../../tests/src/emulator/ads122u04.rs"]
mod ads122u04;
#[path = "../../../tests/src/emulator/amt21.rs"]
#[allow(dead_code)]
mod amt21;
