//! Wire types, framing and versions shared by the fingertip board and the host.
#![no_std]
