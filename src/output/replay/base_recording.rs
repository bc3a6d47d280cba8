//! Reads the ids and timelines of a recording. An audit is added to it as a layer.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use re_chunk::external::arrow;
use re_log_encoding::{
    CachingApplicationIdInjector, CodecError, Decodable, Encodable, MessageHeader, MessageKind,
    RrdFooter, StreamHeader, ToApplication, ToTransport,
};
use re_log_types::{LogMsg, StoreId, StoreKind};

use super::timeline_writer::TimelineNames;
use crate::boundary::catch_panic;

type MessageFrame = Option<<LogMsg as ToTransport>::Output>;
type FooterMessage = <RrdFooter as ToTransport>::Output;

/// The messages that are read are small. Longer ones are damage.
const MAX_MESSAGE_BYTES: u64 = 1 << 28;

/// Identity of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaseRecording {
    /// Application id.
    pub application: String,
    /// Recording id.
    pub id: String,
    /// Names of its timelines; empty if the file has no footer.
    pub timelines: BTreeSet<String>,
}

/// Why a recording cannot be the base of a layer.
#[derive(Debug, thiserror::Error)]
pub enum BaseError {
    /// Not readable.
    #[error("cannot be read: {0}")]
    Read(#[from] io::Error),
    /// Not an RRD file.
    #[error("not a Rerun recording: {0}")]
    Decode(#[from] CodecError),
    /// Arrow panics on some damage.
    #[error("damaged footer: {0}")]
    Damage(String),
    /// A blueprint only, or empty.
    #[error("contains no recording")]
    NoRecording,
    /// A layer must belong to one recording.
    #[error("contains several recordings: {0}")]
    Several(String),
}

impl BaseRecording {
    /// Reads the messages that name recordings, and the footer. Skips all data.
    ///
    /// # Errors
    /// If the file is not a recording, or several.
    pub fn read(path: &Path) -> Result<Self, BaseError> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        Self::read_stream(&mut BufReader::new(file), length)
    }

    fn read_stream(file: &mut (impl Read + Seek), length: u64) -> Result<Self, BaseError> {
        let mut header = [0; StreamHeader::ENCODED_SIZE_BYTES];
        let filled = file.by_ref().take(header.len() as u64).read(&mut header)?;
        StreamHeader::from_rrd_bytes(&header[..filled])?.to_version_and_options()?;
        let mut stores = BTreeSet::new();
        let mut timelines = BTreeSet::new();
        while let Some(frame) = next_frame(file, length)? {
            match frame.kind {
                MessageKind::SetStoreInfo => stores.extend(recording_of(frame, file)?),
                MessageKind::End => {
                    let footer = payload(frame, file)?;
                    timelines =
                        catch_panic(|| timelines_of(&footer)).map_err(BaseError::Damage)??;
                    break;
                }
                _ => {
                    let skipped = i64::try_from(frame.len).unwrap_or(i64::MAX);
                    file.seek_relative(skipped)?;
                }
            }
        }
        let mut stores = stores.into_iter();
        match (stores.next(), stores.next()) {
            (None, _) => Err(BaseError::NoRecording),
            (Some(store), None) => Ok(Self {
                application: store.application_id().to_string(),
                id: store.recording_id().to_string(),
                timelines,
            }),
            (Some(first), Some(second)) => {
                let ids = [first, second].map(|store| store.recording_id().to_string());
                Err(BaseError::Several(ids.join(", ")))
            }
        }
    }

    /// Whether it has a timeline of a log read by the viewer.
    pub(super) fn has_log_timelines(&self) -> bool {
        let TimelineNames { stamp, log } = TimelineNames::VIEWER;
        self.shared_timeline().is_some_and(|name| [stamp, log].contains(&name))
    }

    /// Timeline whose cursor moves both the recording and an audit. Without a footer, a log's timeline.
    pub fn shared_timeline(&self) -> Option<&'static str> {
        let names = [TimelineNames::VIEWER, TimelineNames::STANDALONE];
        let mut names = names.into_iter().flat_map(|names| [names.stamp, names.log]);
        names.find(|name| self.timelines.is_empty() || self.timelines.contains(*name))
    }
}

/// Header of the next message. `None` at the end, also of a file that is still being written.
fn next_frame(file: &mut impl Read, length: u64) -> Result<Option<MessageHeader>, BaseError> {
    let mut bytes = [0; MessageHeader::ENCODED_SIZE_BYTES];
    match file.read_exact(&mut bytes) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let frame = MessageHeader::from_rrd_bytes(&bytes)?;
    Ok(Some(frame).filter(|frame| frame.len <= length))
}

fn payload(frame: MessageHeader, file: &mut impl Read) -> Result<Vec<u8>, BaseError> {
    let mut bytes = Vec::new();
    file.take(frame.len.min(MAX_MESSAGE_BYTES)).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// `None` for a blueprint.
fn recording_of(frame: MessageHeader, file: &mut impl Read) -> Result<Option<StoreId>, BaseError> {
    let mut bytes = Vec::new();
    frame.to_rrd_bytes(&mut bytes)?;
    bytes.extend(payload(frame, file)?);
    let Some(message) = MessageFrame::from_rrd_bytes(&bytes)? else { return Ok(None) };
    let mut applications = CachingApplicationIdInjector::default();
    match message.to_application((&mut applications, None))? {
        LogMsg::SetStoreInfo(set) if set.info.store_id.kind() == StoreKind::Recording => {
            Ok(Some(set.info.store_id))
        }
        _ => Ok(None),
    }
}

/// Timelines of all recordings in the footer, from their schemas.
///
/// The tables of chunks beside them are not decoded: Arrow allocates whatever length a damaged one states.
fn timelines_of(footer: &[u8]) -> Result<BTreeSet<String>, BaseError> {
    let footer = FooterMessage::from_rrd_bytes(footer)?;
    let mut timelines = BTreeSet::new();
    for manifest in footer.manifests {
        let store = manifest.store_id.and_then(|store| StoreId::try_from(store).ok());
        if store.is_none_or(|store| store.kind() != StoreKind::Recording) {
            continue;
        }
        let Some(schema) = manifest.sorbet_schema.and_then(|schema| schema.arrow_schema) else {
            continue;
        };
        let schema = arrow::ipc::convert::try_schema_from_ipc_buffer(&schema)
            .map_err(CodecError::ArrowDeserialization)?;
        let names =
            schema.fields().iter().filter_map(|field| field.metadata().get("rerun:index_name"));
        timelines.extend(names.cloned());
    }
    Ok(timelines)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;
    use re_chunk::{Chunk, ChunkId, RowId, TimePoint};
    use re_log_types::{SetStoreInfo, StoreInfo, StoreSource, Timeline};
    use re_sdk_types::archetypes::TextDocument;

    use super::*;
    use crate::output::replay::encoder;

    type Failure = Box<dyn std::error::Error>;

    fn store(kind: StoreKind, id: &str) -> StoreId {
        StoreId::new(kind, "an-app", id)
    }

    /// A recording with one row on this timeline.
    fn recording(
        kind: StoreKind,
        id: &str,
        timeline: &'static str,
    ) -> Result<Vec<LogMsg>, Failure> {
        let store = store(kind, id);
        let info = StoreInfo::new(store.clone(), StoreSource::Unknown);
        let row_id = re_log_types::external::re_tuid::Tuid::from_u128(1);
        let time = TimePoint::default().with(Timeline::new_sequence(timeline), 3);
        let chunk = Chunk::builder_with_id(ChunkId::from_u128(1), "/entity")
            .with_archetype(RowId::ZERO, time, &TextDocument::new("text"))
            .build()?;
        Ok(vec![
            LogMsg::SetStoreInfo(SetStoreInfo { row_id, info }),
            LogMsg::ArrowMsg(store, chunk.to_arrow_msg()?),
        ])
    }

    fn read(bytes: &[u8]) -> Result<BaseRecording, BaseError> {
        BaseRecording::read_stream(&mut Cursor::new(bytes), bytes.len() as u64)
    }

    #[test]
    fn ids_and_timelines_of_the_only_recording_are_read() -> Result<(), Failure> {
        let mut messages = recording(StoreKind::Blueprint, "layout", "blueprint")?;
        messages.extend(recording(StoreKind::Recording, "rec-1", "message_log_time")?);
        let bytes = encoder::encode(&messages)?;
        let base = read(&bytes)?;
        assert_eq!((base.application.as_str(), base.id.as_str()), ("an-app", "rec-1"));
        assert_eq!(base.timelines, BTreeSet::from(["message_log_time".to_owned()]));
        assert_eq!(base.shared_timeline(), Some("message_log_time"));
        // The recorder still writes, so the footer is missing.
        let unfinished = &encoder::encode(&messages[2..])?;
        let end = unfinished.len() / 2;
        let base = read(&unfinished[..end])?;
        assert_eq!((base.id.as_str(), base.timelines.len()), ("rec-1", 0));
        assert!(base.has_log_timelines());
        assert_eq!(base.shared_timeline(), Some("ros2_timestamp"));
        Ok(())
    }

    #[test]
    fn other_timelines_share_no_cursor() -> Result<(), Failure> {
        let read_with = |timeline: &'static str| -> Result<BaseRecording, Failure> {
            let messages = recording(StoreKind::Recording, "rec-1", timeline)?;
            Ok(read(&encoder::encode(&messages)?)?)
        };
        let of_program = read_with("log_time")?;
        assert!(!of_program.has_log_timelines());
        assert_eq!(of_program.shared_timeline(), Some("log_time"));
        assert_eq!(read_with("frame")?.shared_timeline(), None);
        Ok(())
    }

    #[test]
    fn a_base_is_one_recording() -> Result<(), Failure> {
        let layout = recording(StoreKind::Blueprint, "layout", "blueprint")?;
        assert!(matches!(read(&encoder::encode(&layout)?), Err(BaseError::NoRecording)));
        let mut two = recording(StoreKind::Recording, "rec-1", "log_time")?;
        two.extend(recording(StoreKind::Recording, "rec-2", "log_time")?);
        let refused = read(&encoder::encode(&two)?).map_err(|error| error.to_string());
        assert_eq!(refused, Err("contains several recordings: rec-1, rec-2".to_owned()));
        assert!(matches!(read(b"time,x\n0,1\n"), Err(BaseError::Decode(_))));
        assert!(matches!(read(b""), Err(BaseError::Decode(_))));
        Ok(())
    }

    proptest! {
        #[test]
        fn damage_is_an_error_or_reads_on(
            cut in 0_usize..4096,
            changes in prop::collection::vec((0_usize..4096, any::<u8>()), 0..8),
        ) {
            let messages = recording(StoreKind::Recording, "rec-1", "log_time").expect("a recording");
            let mut bytes = encoder::encode(&messages).expect("bytes");
            for (at, value) in changes {
                let length = bytes.len();
                bytes[at % length] = value;
            }
            bytes.truncate(bytes.len().saturating_sub(cut % 512));
            let _ = read(&bytes);
        }
    }

    #[test]
    fn one_damaged_byte_is_an_error_or_reads_on() -> Result<(), Failure> {
        let messages = recording(StoreKind::Recording, "rec-1", "log_time")?;
        let bytes = encoder::encode(&messages)?;
        for at in 0..bytes.len() {
            for value in [0, 1, 64, 127, 128, 255] {
                let mut damaged = bytes.clone();
                damaged[at] = value;
                let _ = read(&damaged);
            }
        }
        Ok(())
    }
}
