//! A file that is read as it is written: whole records, as they come.

use mcap::records::op;

use super::record::Broken;
use super::{Definitions, Reader, record};
use crate::ReadOptions;
use crate::ahead;
use crate::intake::Intake;
use crate::losses::Losses;
use crate::ranges::Present;

/// How long the whole records are that `bytes` begin with, up to the record that closes the data; and whether that is
/// there, or something that is no record.
pub(crate) fn whole_records(bytes: &[u8]) -> (usize, bool) {
    let mut end = 0;
    for frame in record::frames(bytes, 0) {
        match frame {
            Ok(frame) if matches!(frame.opcode, op::DATA_END | op::FOOTER) => return (end, true),
            Ok(frame) => end = frame.end(),
            Err(Broken::Zero) => return (end, true),
            Err(Broken::Stub { .. } | Broken::Cut { .. }) => break,
        }
    }
    (end, false)
}

/// What is known of a file that is read as it is written.
#[derive(Default)]
pub(crate) struct Growing {
    definitions: Definitions,
}

impl Growing {
    /// Reads more whole records of the file, behind the bytes that a file begins with; offsets of `losses` are those in `bytes`.
    pub(crate) fn read(
        &mut self,
        bytes: &[u8],
        options: &ReadOptions,
        losses: &mut Losses,
        intake: &mut Intake,
    ) {
        ahead::with(|ahead| {
            let mut reader = Reader::new(bytes, &Present::Whole, options, losses, intake, ahead);
            reader.definitions = std::mem::take(&mut self.definitions);
            reader.walk();
            self.definitions = std::mem::take(&mut reader.definitions);
        });
    }
}
