//! Encodes a recording as RRD: stream header, messages, and a footer with one manifest per store. The
//! footer lets readers fetch single chunks, and `rerun rrd verify` requires it.
//!
//! `re_log_encoding::Encoder` writes manifests and their schemas in hash-map order. Here both are sorted, so
//! that equal messages give equal bytes.

use std::collections::{BTreeMap, HashMap};

use re_chunk::Span;
use re_log_encoding::{
    CodecError, CrateVersion, Encodable, EncodingOptions, MessageHeader, MessageKind, RRD_FOURCC,
    RrdFooter, RrdManifestBuilder, StreamFooter, StreamHeader, ToTransport,
};
use re_log_types::{LogMsg, StoreId};

/// # Errors
/// If a message cannot be encoded.
pub(super) fn encode(messages: &[LogMsg]) -> Result<Vec<u8>, CodecError> {
    let options = EncodingOptions::PROTOBUF_COMPRESSED;
    let version = CrateVersion::LOCAL.to_bytes();
    let mut bytes = Vec::new();
    StreamHeader { fourcc: RRD_FOURCC, version, options }.to_rrd_bytes(&mut bytes)?;
    let mut manifests: BTreeMap<&StoreId, RrdManifestBuilder> = BTreeMap::new();
    for message in messages {
        let transport = message.to_transport(options.compression)?;
        let start = bytes.len() + MessageHeader::ENCODED_SIZE_BYTES;
        transport.to_rrd_bytes(&mut bytes)?;
        if let LogMsg::ArrowMsg(store, chunk) = message {
            let span = Span::from_start_end(start as u64, bytes.len() as u64);
            let manifest = manifests.entry(store).or_default();
            manifest.append(
                &(&chunk.batch).try_into()?,
                span,
                transport.byte_size_uncompressed(),
            )?;
        }
    }
    write_footer(manifests, &mut bytes)?;
    Ok(bytes)
}

fn write_footer(
    manifests: BTreeMap<&StoreId, RrdManifestBuilder>,
    bytes: &mut Vec<u8>,
) -> Result<(), CodecError> {
    let mut footer = RrdFooter { manifests: HashMap::new() }.to_transport(())?;
    for (store, builder) in manifests {
        let mut manifest = builder.build(store.clone())?;
        let schema = &mut manifest.sorbet_schema;
        let mut fields = schema.fields.to_vec();
        fields.sort_by(|a, b| a.name().cmp(b.name()));
        schema.fields = fields.into();
        footer.manifests.push(manifest.to_transport(())?);
    }
    let mut payload = Vec::new();
    footer.to_rrd_bytes(&mut payload)?;
    MessageHeader { kind: MessageKind::End, len: payload.len() as u64 }.to_rrd_bytes(bytes)?;
    let start = bytes.len() as u64;
    bytes.extend_from_slice(&payload);
    StreamFooter::from_rrd_footer_bytes(start, &payload).to_rrd_bytes(bytes)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use re_chunk::{Chunk, ChunkId, RowId, TimePoint};
    use re_log_encoding::{Decodable, ToApplication};
    use re_log_types::{ArrowMsg, StoreKind};
    use re_sdk_types::archetypes::TextDocument;

    use super::*;

    type Failure = Box<dyn std::error::Error>;
    type FooterMessage = <RrdFooter as ToTransport>::Output;
    type ChunkMessage = <ArrowMsg as ToTransport>::Output;

    fn stores() -> [StoreId; 2] {
        [StoreKind::Recording, StoreKind::Blueprint]
            .map(|kind| StoreId::new(kind, "poseaudit", "run"))
    }

    /// Chunks of several entities, in the two stores alternately.
    fn messages() -> Result<Vec<LogMsg>, Failure> {
        let stores = stores();
        let message = |index: usize| -> Result<LogMsg, Failure> {
            let text = TextDocument::new(format!("text {index}"));
            let id = ChunkId::from_u128(1 + index as u128);
            let chunk = Chunk::builder_with_id(id, format!("/entity_{index}"))
                .with_archetype(RowId::ZERO, TimePoint::default(), &text)
                .build()?;
            Ok(LogMsg::ArrowMsg(stores[index % 2].clone(), chunk.to_arrow_msg()?))
        };
        (0..20).map(message).collect()
    }

    #[test]
    fn the_footer_lists_each_chunk_at_its_bytes() -> Result<(), Failure> {
        let messages = messages()?;
        let bytes = encode(&messages)?;
        let end = StreamFooter::from_rrd_bytes(&bytes)?;
        assert_eq!(end.entries.len(), 1);
        let at = |span: Span<u64>| &bytes[span.start as usize..span.end() as usize];
        let payload = at(end.entries[0].rrd_footer_byte_span_from_start_excluding_header);
        assert_eq!(StreamFooter::compute_crc(payload), end.entries[0].crc_excluding_header);
        let footer = FooterMessage::from_rrd_bytes(payload)?.to_application(())?;
        assert_eq!(footer.manifests.len(), 2);
        for store in stores() {
            let manifest = &footer.manifests[&store];
            manifest.sanity_check_heavy()?;
            let written = messages.iter().filter_map(|message| match message {
                LogMsg::ArrowMsg(its, chunk) if *its == store => Some(chunk.chunk_id),
                _ => None,
            });
            let written: Vec<ChunkId> = written.map(ChunkId::from_tuid).collect();
            assert_eq!(manifest.col_chunk_id()?.collect::<Vec<_>>(), written);
            let spans = manifest.col_chunk_byte_offset()?.zip(manifest.col_chunk_byte_size()?);
            for ((start, len), id) in spans.zip(written) {
                let message = ChunkMessage::from_rrd_bytes(at(Span { start, len }))?;
                assert_eq!(ChunkId::from_tuid(message.to_application(())?.chunk_id), id);
            }
        }
        Ok(())
    }

    #[test]
    fn equal_messages_give_equal_bytes() -> Result<(), Failure> {
        let first = encode(&messages()?)?;
        for _ in 0..8 {
            assert!(encode(&messages()?)? == first);
        }
        Ok(())
    }
}
