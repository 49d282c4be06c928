/// FNV-1a over 64-bit words: tells inputs apart, protects against nothing.
pub(crate) struct Digest(u64);

impl Digest {
    pub(crate) fn new(format: &str) -> Self {
        let mut digest = Self(0xcbf2_9ce4_8422_2325);
        digest.bytes(format.as_bytes());
        digest
    }

    fn word(&mut self, word: u64) {
        // The rotation lets high bits reach low ones, which the bytewise original does by its order.
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
    }

    /// Bytes with their length, so that neighbouring fields cannot run into each other.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.word(bytes.len() as u64);
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.word(u64::from_le_bytes(word));
        }
    }

    pub(crate) fn number(&mut self, number: u64) {
        self.word(number);
    }

    pub(crate) fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}
