//! LZF, the compression of `DATA binary_compressed` (M. Lehmann's libLZF): runs of literal bytes, and copies of
//! earlier output.
//!
//! A byte below 32 is followed by that many bytes plus one, to be taken as they are. Any other byte is a copy: its
//! upper three bits are the length minus 2, where 7 means that a further byte is added; its lower five bits and the
//! byte after are the distance minus 1.

/// Why a stream cannot be unpacked, and how many of its bytes were read before.
#[derive(Debug, PartialEq)]
pub(super) struct Broken {
    pub(super) at: usize,
    pub(super) what: &'static str,
}

/// The longest copy: 2 + 7 + 255 bytes.
const LONGEST: usize = 264;

/// Most bytes that a stream can unpack to, by its length: three bytes stand for the longest copy.
pub(super) fn most_unpacked(packed: usize) -> u64 {
    packed as u64 * (LONGEST as u64).div_ceil(3)
}

/// The farthest copy.
const WINDOW: usize = 1 << 13;

/// Unpacks exactly `size` bytes. Memory grows with what is unpacked, not with `size`.
pub(super) fn unpack(packed: &[u8], size: usize) -> Result<Vec<u8>, Broken> {
    let mut out = Vec::with_capacity(size.min(packed.len().saturating_mul(4)));
    let mut at = 0;
    let mut next = |count: usize| {
        let broken = Broken { at, what: "it ends within a run or copy" };
        let bytes = packed.get(at..at.saturating_add(count)).ok_or(broken)?;
        at += count;
        Ok((bytes, at))
    };
    while out.len() < size {
        let (control, before) = next(1).map(|(bytes, at)| (usize::from(bytes[0]), at - 1))?;
        let room = size - out.len();
        let too_long = Broken { at: before, what: "it unpacks to more than stated" };
        if control < 32 {
            if control + 1 > room {
                return Err(too_long);
            }
            out.extend_from_slice(next(control + 1)?.0);
            continue;
        }
        let mut length = (control >> 5) + 2;
        if length == 9 {
            length += usize::from(next(1)?.0[0]);
        }
        let distance = ((control & 31) << 8) + usize::from(next(1)?.0[0]) + 1;
        if length > room {
            return Err(too_long);
        }
        let start = out.len().checked_sub(distance);
        let start = start.ok_or(Broken { at: before, what: "a copy reaches before the start" })?;
        copy_within(&mut out, start, length);
    }
    match packed.len() - at {
        0 => Ok(out),
        _ => Err(Broken { at, what: "it goes on after the last byte" }),
    }
}

/// Appends `length` bytes from `start` on, which may run into those just appended.
fn copy_within(out: &mut Vec<u8>, start: usize, length: usize) {
    if start + length <= out.len() {
        out.extend_from_within(start..start + length);
    } else {
        for place in start..start + length {
            out.push(out[place]);
        }
    }
}

/// Packs `bytes`. Of equal threes only the last one is remembered, as in libLZF.
pub(super) fn pack(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len() / 2);
    let mut last_seen = vec![usize::MAX; 1 << 14];
    let (mut literals, mut at) = (0, 0);
    while let Some(three) = bytes.get(at..at + 3) {
        let slot = &mut last_seen[slot_of(three)];
        let candidate = std::mem::replace(slot, at);
        let is_copy = candidate != usize::MAX && at - candidate <= WINDOW && bytes[candidate..candidate + 3] == *three;
        if !is_copy {
            at += 1;
            continue;
        }
        put_literals(&bytes[literals..at], &mut out);
        let ahead = bytes[at..].iter().take(LONGEST);
        let length = ahead.zip(&bytes[candidate..]).take_while(|(one, other)| one == other).count();
        put_copy(length, at - candidate, &mut out);
        at += length;
        literals = at;
    }
    put_literals(&bytes[literals..], &mut out);
    out
}

fn slot_of(three: &[u8]) -> usize {
    let value = u32::from_le_bytes([three[0], three[1], three[2], 0]);
    (value.wrapping_mul(0x9E37_79B1) >> 18) as usize
}

fn put_literals(bytes: &[u8], out: &mut Vec<u8>) {
    for run in bytes.chunks(32) {
        out.push(run.len() as u8 - 1);
        out.extend_from_slice(run);
    }
}

fn put_copy(length: usize, distance: usize, out: &mut Vec<u8>) {
    let (short, far) = (length - 2, distance - 1);
    out.push(((short.min(7) << 5) | (far >> 8)) as u8);
    if short >= 7 {
        out.push((short - 7) as u8);
    }
    out.push((far & 255) as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_and_copies_unpack_as_written() {
        // "abc", then 4 bytes from 3 back, then 2 + 7 + 1 bytes from 1 back.
        let packed = [2, b'a', b'b', b'c', 2 << 5, 2, 7 << 5, 1, 0];
        assert_eq!(unpack(&packed, 17).unwrap(), b"abcabcaaaaaaaaaaa");
        for length in 0..packed.len() {
            assert!(unpack(&packed[..length], 17).is_err());
        }
        assert_eq!(unpack(&packed, 16), Err(Broken { at: 6, what: "it unpacks to more than stated" }));
        assert_eq!(unpack(&packed, 7), Err(Broken { at: 6, what: "it goes on after the last byte" }));
        assert_eq!(unpack(&packed, 18), Err(Broken { at: 9, what: "it ends within a run or copy" }));
        assert_eq!(unpack(&[0, b'a', 1 << 5, 1], 4), Err(Broken { at: 2, what: "a copy reaches before the start" }));
    }

    #[test]
    fn what_is_packed_unpacks() {
        let noise = (0..70_000_u32).map(|i| (i.wrapping_mul(0x9E37_79B1) >> 24) as u8);
        for bytes in [vec![], vec![7], vec![1, 2], vec![0; 100_000], noise.collect(), b"ab".repeat(5000)] {
            let packed = pack(&bytes);
            assert_eq!(unpack(&packed, bytes.len()).unwrap(), bytes);
            assert!(bytes.len() as u64 <= most_unpacked(packed.len()));
        }
        assert!(pack(&vec![0; 26_400]).len() <= 3 * 101 + 2);
    }
}
