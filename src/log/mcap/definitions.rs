use std::sync::Arc;

use mcap::records::op;

use super::record::{self, Frame};
use super::{Channel, Reader, Schema};
use crate::decode::{Format, excerpt};

impl<'a> Reader<'a, '_, '_> {
    /// `None` if it is malformed.
    pub(super) fn definition(&mut self, frame: &Frame<'_>) -> Option<()> {
        match frame.opcode {
            op::SCHEMA => self.schema(record::Schema::parse(frame.body)?),
            op::CHANNEL => self.channel(record::Channel::parse(frame.body)?),
            _ => {}
        }
        Some(())
    }

    pub(super) fn schema(&mut self, schema: record::Schema<'_>) {
        if self.definitions.has_schema(&schema) {
            return;
        }
        let new = Schema {
            name: schema.name.to_owned(),
            encoding: schema.encoding.to_owned(),
            data: schema.data.to_owned(),
        };
        let before = self.definitions.schemas.insert(schema.id, Arc::new(new));
        self.defined(before.is_some());
    }

    pub(super) fn channel(&mut self, channel: record::Channel<'_>) {
        if self.definitions.has_channel(&channel) {
            return;
        }
        let schema = self.definitions.schemas.get(&channel.schema_id);
        let format = Format {
            encoding: channel.encoding,
            type_name: schema.map_or("", |schema| &schema.name),
            schema_encoding: schema.map_or("", |schema| &schema.encoding),
            schema: schema.map_or(&[], |schema| &schema.data),
        };
        let new = Channel {
            id: self.intake.channel(channel.topic, format),
            schema_id: channel.schema_id,
            topic: channel.topic.to_owned(),
            encoding: channel.encoding.to_owned(),
        };
        let (index, channels) = (usize::from(channel.id), &mut self.definitions.channels);
        if index >= channels.len() {
            channels.resize_with(index + 1, || None);
        }
        let before = channels[index].replace(Arc::new(new));
        self.defined(before.is_some());
    }

    fn defined(&mut self, changed: bool) {
        self.table = None;
        self.definitions.changes += u64::from(changed);
    }

    pub(super) fn attachment(&mut self, frame: &Frame<'_>) {
        /// Larger attachments are verified on request only.
        const MAX_VERIFIED_BYTES: usize = 16 << 20;
        let Some(attachment) = record::Attachment::parse(frame.body) else {
            return self.record_lost_summary(
                frame.offset,
                "attachment is shorter than its declared length",
            );
        };
        let checked = self.options.verify || attachment.covered.len() <= MAX_VERIFIED_BYTES;
        if checked && attachment.crc != 0 && crc32fast::hash(attachment.covered) != attachment.crc {
            let what = format!("attachment `{}` fails its checksum", excerpt(attachment.name));
            return self.record_lost_summary(frame.offset, &what);
        }
        self.intake.text(attachment.name, attachment.data);
    }

    pub(super) fn metadata(&mut self, frame: &Frame<'_>) {
        let Some((name, pairs)) = record::metadata(frame.body) else {
            return self
                .record_lost_summary(frame.offset, "metadata is shorter than its declared length");
        };
        for (key, value) in pairs {
            self.intake.text(&format!("{name}/{key}"), value.as_bytes());
        }
    }
}
