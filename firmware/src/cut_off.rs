//! Texts into too little room.

use core::fmt::Write;
use heapless::String;

/// Writes as much of a text as there is room for, in whole characters.
pub(crate) struct CutOff<'a, const N: usize>(pub &'a mut String<N>);

impl<const N: usize> Write for CutOff<'_, N> {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        text.chars()
            .try_for_each(|character| self.0.push(character).map_err(|_| core::fmt::Error))
    }
}
