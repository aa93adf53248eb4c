//! Decoder of the LZF compression in which PCD stores `binary_compressed` data.
//!
//! A control byte below 32 begins a run of literal bytes, one more than its value; any other is a copy of
//! 3 to 264 bytes from up to 8192 bytes back.

/// Unpacks `packed` into exactly `length` bytes.
///
/// Memory grows with what has been unpacked, so a false `length` costs at most 132 bytes per byte read.
///
/// # Errors
/// The byte of `packed` at which decoding cannot go on, and why.
pub(super) fn decode(packed: &[u8], length: usize) -> Result<Vec<u8>, (usize, &'static str)> {
    let mut out = Vec::with_capacity(length.min(packed.len().saturating_mul(4)));
    let mut at = 0;
    let byte = |at: usize| packed.get(at).copied().ok_or((at, "ends inside a copy"));
    while at < packed.len() {
        let start = at;
        let control = usize::from(packed[at]);
        at += 1;
        if control < 32 {
            let run = packed
                .get(at..at + control + 1)
                .ok_or((start, "ends inside a literal run"))?;
            out.extend_from_slice(run);
            at += run.len();
        } else {
            let mut count = control >> 5;
            if count == 7 {
                count += usize::from(byte(at)?);
                at += 1;
            }
            let back = ((control & 31) << 8) + usize::from(byte(at)?) + 1;
            at += 1;
            let from = out
                .len()
                .checked_sub(back)
                .ok_or((start, "copies from before the beginning"))?;
            for k in from..from + count + 2 {
                out.push(out[k]);
            }
        }
        if out.len() > length {
            return Err((start, "unpacks to more than its declared size"));
        }
    }
    if out.len() == length {
        Ok(out)
    } else {
        Err((at, "unpacks to less than its declared size"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_copies_and_overlaps() {
        // "ab", then 5 bytes from 2 back (overlapping), then a long copy: 7 + 1 + 2 = 10 bytes from 1 back.
        let packed = [1, b'a', b'b', 3 << 5, 1, 7 << 5, 1, 0];
        let text = decode(&packed, 17).unwrap();
        assert_eq!(text, b"abababaaaaaaaaaaa");
        assert!(decode(&packed, 16).is_err());
        assert!(decode(&packed, 18).is_err());
    }

    #[test]
    fn damage_is_an_error() {
        assert_eq!(decode(&[5, 1], 6).unwrap_err().0, 0);
        assert_eq!(decode(&[0, 1, 2 << 5, 9], 5).unwrap_err().0, 2);
        assert!(decode(&[0, 1, 7 << 5], 5).is_err());
        assert_eq!(decode(&[], 0), Ok(Vec::new()));
    }
}
