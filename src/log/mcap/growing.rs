use mcap::records::op;

use super::record::Broken;
use super::{Definitions, Reader, record};
use crate::ReadOptions;
use crate::chunk_pool;
use crate::intake::Intake;
use crate::losses::Losses;
use crate::ranges::Present;

/// Length of the complete records at the start of `bytes`, and whether the end of the data or an invalid
/// record was reached.
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

#[derive(Default)]
pub(crate) struct GrowingFile {
    definitions: Definitions,
}

impl GrowingFile {
    /// Reads further complete records. Offsets in `losses` refer to `bytes`.
    pub(crate) fn read(
        &mut self,
        bytes: &[u8],
        options: &ReadOptions,
        losses: &mut Losses,
        intake: &mut Intake,
    ) {
        chunk_pool::with_pool(|ahead| {
            let mut reader = Reader::new(bytes, &Present::Whole, options, losses, intake, ahead);
            reader.definitions = std::mem::take(&mut self.definitions);
            reader.walk();
            self.definitions = std::mem::take(&mut reader.definitions);
        });
    }
}
