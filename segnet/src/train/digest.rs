//! Fingerprints of configurations, samples and trained networks.

use serde::Serialize;

/// FNV-1a with 64 bits (RFC 9923): not against forgery, but the same everywhere, and 64 bits do not meet by chance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fnv1a(u64);

impl Fnv1a {
    const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0100_0000_01b3;

    /// Of no bytes.
    pub(super) fn new() -> Self {
        Self(Self::OFFSET_BASIS)
    }

    /// Goes on where another one stood.
    pub(super) fn from_state(state: u64) -> Self {
        Self(state)
    }

    #[must_use]
    pub(super) fn and(self, bytes: &[u8]) -> Self {
        Self(bytes.iter().fold(self.0, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(Self::PRIME)))
    }

    /// A value by its JSON.
    #[must_use]
    pub(super) fn and_json(self, value: &impl Serialize) -> Self {
        match serde_json::to_vec(value) {
            Ok(json) => self.and(&json),
            Err(error) => self.and(error.to_string().as_bytes()),
        }
    }

    pub(super) fn value(self) -> u64 {
        self.0
    }

    /// 16 hexadecimal digits.
    pub(super) fn hex(self) -> String {
        format!("{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors of the authors' `test_fnv.c`.
    #[test]
    fn agrees_with_the_published_vectors() {
        for (text, hash) in [("", "cbf29ce484222325"), ("a", "af63dc4c8601ec8c"), ("foobar", "85944171f73967e8")] {
            assert_eq!(Fnv1a::new().and(text.as_bytes()).hex(), hash, "{text}");
        }
        let half = Fnv1a::new().and(b"foo");
        assert_eq!(Fnv1a::from_state(half.value()).and(b"bar"), Fnv1a::new().and(b"foobar"));
    }
}
