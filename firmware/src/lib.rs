//! Contact sensing, sampling and commands of the fingertip board.
#![no_std]
