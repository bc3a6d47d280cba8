//! Encodes messages in the ROS 2 wire format.

use crate::time::{NANOS_PER_SECOND, Stamp};

/// Little-endian CDR. Numbers are aligned to their size from the end of the four-byte encapsulation header.
pub(super) struct CdrWriter(Vec<u8>);

impl CdrWriter {
    const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

    pub(super) fn new() -> Self {
        Self(Self::ENCAPSULATION.to_vec())
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.push_aligned(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.push_aligned(value.to_le_bytes());
    }

    /// Array of fixed length, or consecutive fields.
    pub(super) fn f64_array<const N: usize>(&mut self, values: [f64; N]) {
        for value in values {
            self.f64(value);
        }
    }

    pub(super) fn f64_sequence(&mut self, values: &[f64]) {
        self.sequence_length(values.len());
        for &value in values {
            self.f64(value);
        }
    }

    pub(super) fn string(&mut self, text: &str) {
        self.sequence_length(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    pub(super) fn sequence_length(&mut self, count: usize) {
        self.u32(u32::try_from(count).expect("a message has fewer than 2^32 elements"));
    }

    pub(super) fn header(&mut self, stamp: Stamp, frame_id: &str) {
        let seconds = stamp.nanos().div_euclid(NANOS_PER_SECOND);
        let nanos = stamp.nanos().rem_euclid(NANOS_PER_SECOND);
        // int32 overflows in 2038.
        self.u32(i32::try_from(seconds).expect("stamps end in 2038").cast_unsigned());
        self.u32(u32::try_from(nanos).expect("fewer nanoseconds than a second has"));
        self.string(frame_id);
    }

    fn push_aligned<const N: usize>(&mut self, bytes: [u8; N]) {
        let body = self.0.len() - Self::ENCAPSULATION.len();
        self.0.resize(Self::ENCAPSULATION.len() + body.next_multiple_of(N), 0);
        self.0.extend(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_to_their_size() {
        let mut cdr = CdrWriter::new();
        cdr.string("ab");
        cdr.u32(7);
        cdr.f64_sequence(&[1.0]);
        #[rustfmt::skip]
        let expected = [
            0, 1, 0, 0,
            3, 0, 0, 0, b'a', b'b', 0, 0,
            7, 0, 0, 0, 1, 0, 0, 0,
            0, 0, 0, 0, 0, 0, 0xf0, 0x3f,
        ];
        assert_eq!(cdr.finish(), expected);
    }

    #[test]
    fn an_empty_sequence_is_only_its_length() {
        let mut cdr = CdrWriter::new();
        cdr.f64_sequence(&[]);
        cdr.f64_sequence(&[]);
        assert_eq!(cdr.finish(), [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    }
}
