use std::collections::{HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::decode::{self, Format, Recipe};
use super::losses::Losses;
use super::part::{ChannelSnapshot, PartContent};
use super::spans::{Span, gaps, join, overlaps};
use super::topic::{
    ChannelDecoder, Decoding, Message, TopicContent, TopicIntake, record_undecodable,
    saturating_nanos,
};
use super::unpack::{UnpackBudget, Unpacker};
use super::{Description, Extent, Log, LogFile, Loss, Note, Repeat, TableCell, TableShape, Topic};
use ground::stream::Columns;
use ground::time::Stamp;

/// Maximum length of a robot description, in bytes.
const MAX_DESCRIPTION_BYTES: usize = 16 << 20;

/// Maximum number of distinct channels. The largest recordings have a few thousand; MCAP supports half as
/// many.
const MAX_CHANNELS: usize = 1 << 17;

/// Maximum total size of the schemas of used channels, in bytes. Their compiled form takes several times as
/// much.
const MAX_SCHEMA_BYTES: usize = 32 << 20;

const MAX_DESCRIPTIONS: usize = 64;

const MAX_NOTES: usize = 100;

/// Three years; stamps that are further apart have different epochs.
const MAX_EPOCH_GAP_S: f64 = 1e8;

pub(super) const MAX_BATCH_MESSAGES: usize = 1 << 14;

/// Collects topics, messages and damage over all files of a run.
#[derive(Default)]
pub(super) struct Intake {
    topics: Vec<TopicIntake>,
    by_name: HashMap<(String, String), usize>,
    channels: Vec<ChannelLocation>,
    by_format: HashMap<FormatKey, ChannelId>,
    is_full: bool,
    /// Total schema size of used channels, bytes.
    schema_bytes: usize,
    messages: u64,
    descriptions: Vec<Description>,
    losses: Vec<Loss>,
    notes: Vec<Note>,
    contradictions: Option<Vec<Note>>,
    repeats: Option<Vec<Repeat>>,
    robot_type: Option<String>,
    time_column: Option<String>,
    tables: Vec<TableShape>,
    files: Vec<PathBuf>,
    pub(super) unpack_budget: UnpackBudget,
    unpacker: Unpacker,
}

/// Topic, encoding, type and schema hash.
type FormatKey = (String, String, String, u64);

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ChannelId(pub(super) usize);

#[derive(Clone, Copy)]
pub(super) struct ChannelLocation {
    pub(super) topic: usize,
    pub(super) place: usize,
}

impl Intake {
    /// Starts the next file, with its size in bytes.
    pub(super) fn begin_file(&mut self, path: &Path, bytes: u64) {
        self.files.push(path.to_owned());
        self.unpack_budget = UnpackBudget::for_file(bytes, None);
    }

    /// Adds a channel, or returns the existing one with the same topic and type. `None` beyond the limit.
    pub(super) fn channel(&mut self, topic: &str, format: Format<'_>) -> Option<ChannelId> {
        let key = format_key(topic, format);
        if let Some(&known) = self.by_format.get(&key) {
            return Some(known);
        }
        if self.channels.len() == MAX_CHANNELS {
            self.is_full = true;
            return None;
        }
        let recipe = Recipe::for_type(format.type_name);
        if recipe.is_some() {
            self.schema_bytes = self.schema_bytes.saturating_add(format.schema.len());
        }
        let decoding = match recipe.map(|recipe| format.plan(recipe)) {
            Some(_) if self.schema_bytes > MAX_SCHEMA_BYTES => {
                let cause = format!("preceding schemas exceed {MAX_SCHEMA_BYTES} bytes");
                Decoding::Impossible { cause }
            }
            None => Decoding::Ignored,
            Some(Ok(plan)) => Decoding::By(plan),
            Some(Err(error)) => Decoding::Impossible { cause: error.to_string() },
        };
        let index = self.topic(topic, format);
        let taken = &mut self.topics[index].content;
        if let (Some(recipe), Decoding::By(_)) = (recipe, &decoding) {
            taken.builder.get_or_insert_with(|| recipe.builder());
        }
        let id = ChannelId(self.channels.len());
        self.channels.push(ChannelLocation { topic: index, place: taken.channels.len() });
        taken.channels.push(ChannelDecoder::new(Arc::new(decoding), format.encoding == "cdr"));
        self.by_format.insert(key, id);
        Some(id)
    }

    pub(super) fn missing_channel_reason(&self) -> (Extent, String) {
        match self.is_full {
            true => (Extent::Unread, format!("beyond the limit of {MAX_CHANNELS}")),
            false => (Extent::Messages, "without a describing record".to_owned()),
        }
    }

    fn topic(&mut self, topic: &str, format: Format<'_>) -> usize {
        let key = (topic.to_owned(), decode::canonical(format.type_name).into_owned());
        *self.by_name.entry(key).or_insert_with(|| {
            let topic = Topic {
                name: decode::bounded(topic).into_owned(),
                type_name: decode::bounded(format.type_name).into_owned(),
                encoding: decode::bounded(format.encoding).into_owned(),
                ..Topic::default()
            };
            self.topics.push(TopicIntake { topic, ..TopicIntake::default() });
            self.topics.len() - 1
        })
    }

    /// Counts a message, and appends its rows if the channel has columns.
    pub(super) fn message(&mut self, channel: ChannelId, message: Message<'_>) {
        let ChannelLocation { topic, place } = self.channels[channel.0];
        let topic = &mut self.topics[topic].content;
        self.messages += 1;
        let mut message = message;
        if topic.channels[place].is_packed(message.data) {
            match self.unpacker.message(message.data, &mut self.unpack_budget) {
                Ok(unpacked) => message.data = unpacked,
                Err(error) => {
                    topic.messages += 1;
                    topic.record_span(
                        self.files.len(),
                        Stamp::from_nanos(saturating_nanos(message.log_time)),
                    );
                    return record_undecodable(&mut topic.undecodable, message.place, &error);
                }
            }
        }
        topic.message(place, &message, self.files.len());
    }

    /// Processes `batch` in order, like [`Intake::message`], with topics in parallel.
    pub(super) fn batch(&mut self, batch: &mut Vec<(ChannelId, Message<'_>)>) {
        /// Fewer messages are faster on one thread.
        const MIN_PARALLEL_MESSAGES: usize = 256;
        let is_packed = |(channel, message): &(ChannelId, Message<'_>)| {
            let ChannelLocation { topic, place } = self.channels[channel.0];
            self.topics[topic].content.channels[place].is_packed(message.data)
        };
        // The allowance for compressed messages is charged in their order.
        if batch.len() < MIN_PARALLEL_MESSAGES || batch.iter().any(is_packed) {
            return batch.drain(..).for_each(|(channel, message)| self.message(channel, message));
        }
        self.messages += batch.len() as u64;
        for (index, (channel, _)) in batch.iter().enumerate() {
            let ChannelLocation { topic, place } = self.channels[channel.0];
            self.topics[topic].waiting.push((place, index));
        }
        let file = self.files.len();
        self.topics.par_iter_mut().with_max_len(1).for_each(|topic| {
            let mut waiting = std::mem::take(&mut topic.waiting);
            for (place, index) in waiting.drain(..) {
                topic.content.message(place, &batch[index].1, file);
            }
            topic.waiting = waiting;
        });
        batch.clear();
    }

    /// Data for reading messages in another thread. `None` if there are very many channels.
    pub(super) fn known(&self) -> Option<ChannelSnapshot> {
        /// With more channels, this copy takes longer than reading a small chunk.
        const MAX_SNAPSHOT_CHANNELS: usize = 1 << 9;
        (self.channels.len() <= MAX_SNAPSHOT_CHANNELS).then(|| ChannelSnapshot {
            topics: self.topics.iter().map(|topic| topic.content.template()).collect(),
            channels: self.channels.clone(),
            file: self.files.len(),
        })
    }

    /// Adds a part read in another thread. Returns false and adds nothing if that is not possible.
    pub(super) fn join(&mut self, part: PartContent) -> bool {
        let fits =
            |(index, taken): &(usize, TopicContent)| self.topics[*index].content.can_join(taken);
        if !part.topics.iter().all(fits) {
            return false;
        }
        for (index, taken) in part.topics {
            self.messages += taken.messages;
            self.topics[index].content.join(taken);
        }
        true
    }

    /// Whether messages of a channel are only counted.
    pub(super) fn ignores(&self, channel: ChannelId) -> bool {
        let ChannelLocation { topic, place } = self.channels[channel.0];
        matches!(*self.topics[topic].content.channels[place].decoding, Decoding::Ignored)
    }

    /// Counts messages of a channel that [`Intake::ignores`], with their first and last log time, ns.
    pub(super) fn count(&mut self, channel: ChannelId, messages: u64, (first, last): (u64, u64)) {
        let topic = &mut self.topics[self.channels[channel.0].topic].content;
        self.messages += messages;
        topic.messages += messages;
        for time in [first, last] {
            topic.record_span(self.files.len(), Stamp::from_nanos(saturating_nanos(time)));
        }
    }

    fn topic_of(&mut self, channel: ChannelId) -> &mut Topic {
        &mut self.topics[self.channels[channel.0].topic].topic
    }

    pub(super) fn columns(&mut self, channel: ChannelId, columns: Columns) {
        self.topic_of(channel).columns = Some(columns);
    }

    pub(super) fn read_as(
        &mut self,
        channel: ChannelId,
        how: String,
        cells: Vec<TableCell>,
        velocity_cells: Vec<TableCell>,
    ) {
        let topic = self.topic_of(channel);
        topic.read_as = Some(how);
        (topic.cells, topic.velocity_cells) = (cells, velocity_cells);
    }

    /// Adds columns of another table that hold the velocities of a channel's joints.
    pub(super) fn add_velocities(&mut self, channel: ChannelId, name: &str, cells: Vec<TableCell>) {
        let topic = self.topic_of(channel);
        if let Some(how) = &mut topic.read_as {
            *how += &format!("; velocities in {name}");
        }
        topic.velocity_cells = cells;
    }

    /// Index of the table; episodes with the same columns are one.
    pub(super) fn table(&mut self, shape: TableShape) -> usize {
        let is_same =
            |own: &TableShape| own == &TableShape { file: own.file.clone(), ..shape.clone() };
        self.tables.iter().position(is_same).unwrap_or_else(|| {
            self.tables.push(shape);
            self.tables.len() - 1
        })
    }

    /// Once for all episodes.
    pub(super) fn contradiction(&mut self, file: &Path, what: String) {
        let known = self.contradictions.get_or_insert_default();
        if known.len() < MAX_NOTES && known.iter().all(|known| known.what != what) {
            known.push(Note { file: file.to_owned(), what });
        }
    }

    pub(super) fn repeats(&mut self, found: Vec<Repeat>) {
        self.repeats.get_or_insert_default().extend(found);
    }

    pub(super) fn declare_metadata(&mut self, robot: Option<&str>) {
        self.contradictions.get_or_insert_default();
        self.robot_type = self.robot_type.take().or_else(|| robot.map(str::to_owned));
    }

    pub fn set_time_column(&mut self, column: Option<&str>) {
        self.time_column = self.time_column.take().or_else(|| column.map(str::to_owned));
    }

    pub(super) fn messages(&self) -> u64 {
        self.messages
    }

    /// Keeps a robot description or UR calibration from outside messages.
    pub(super) fn text(&mut self, name: &str, text: &[u8]) {
        if text.len() > MAX_DESCRIPTION_BYTES {
            return;
        }
        let Ok(text) = std::str::from_utf8(text) else {
            return;
        };
        let text = text.trim_start_matches('\u{feff}').trim();
        let is_urdf = text.starts_with('<') && text.contains("<robot");
        let is_calibration = text.contains("kinematics:") && text.contains("upper_arm:");
        if !is_urdf && !is_calibration {
            return;
        }
        let description =
            Description { name: decode::bounded(name).into_owned(), text: text.to_owned() };
        if self.descriptions.len() < MAX_DESCRIPTIONS && !self.descriptions.contains(&description) {
            self.descriptions.push(description);
        }
    }

    pub(super) fn note(&mut self, file: &Path, what: String) {
        if self.notes.len() < MAX_NOTES {
            self.notes.push(Note { file: file.to_owned(), what });
        }
    }

    pub(super) fn losses(&mut self, losses: Losses) {
        self.losses.extend(losses.finish());
    }

    pub(super) fn snapshot(&self, files: Vec<LogFile>) -> Log {
        let copy = Self {
            topics: self.topics.iter().map(TopicIntake::snapshot).collect(),
            messages: self.messages,
            descriptions: self.descriptions.clone(),
            losses: self.losses.clone(),
            notes: self.notes.clone(),
            files: self.files.clone(),
            ..Self::default()
        };
        copy.finish(files)
    }

    pub(super) fn finish(mut self, files: Vec<LogFile>) -> Log {
        self.note_unrelated_files();
        let mut topics: Vec<Topic> =
            self.topics.into_iter().flat_map(TopicIntake::finish).collect();
        topics.sort_by(|a, b| (&a.name, &a.type_name).cmp(&(&b.name, &b.type_name)));
        Log {
            files,
            span: topics.iter().filter_map(|topic| topic.span).reduce(join),
            topics,
            descriptions: self.descriptions,
            messages: self.messages,
            losses: self.losses,
            notes: self.notes,
            contradictions: self.contradictions,
            repeats: self.repeats,
            robot_type: self.robot_type,
            time_column: self.time_column,
            tables: self.tables,
            question: None,
        }
    }

    fn note_unrelated_files(&mut self) {
        let mut notes: Vec<(usize, String)> = Vec::new();
        let mut reported = HashSet::new();
        for topic in &self.topics {
            for (earlier, later, shared_s) in overlaps(&topic.content.spans) {
                if reported.insert((earlier, later)) {
                    let (name, other) = (&topic.topic.name, self.file(earlier).display());
                    notes.push((
                        later,
                        format!(
                            "{shared_s:.1} s of `{name}` are also in {other}: \
                             are they recordings of the same run?"
                        ),
                    ));
                }
            }
        }
        // Tables with another time origin are aligned by motion, or refused.
        let are_tables = self.topics.iter().all(|topic| topic.topic.is_from_table());
        for (earlier, later, apart_s) in gaps(&self.file_spans()) {
            if are_tables && apart_s > MAX_EPOCH_GAP_S {
                continue;
            }
            let (hours, other) = (apart_s / 3600.0, self.file(earlier).display());
            let what = format!(
                "it begins {hours:.1} h after {other} ends: does it belong to the same run?"
            );
            notes.push((later, what));
        }
        notes.sort_by_key(|(number, _)| *number);
        for (number, what) in notes {
            let file = self.file(number).to_owned();
            self.note(&file, what);
        }
    }

    /// `number` counts from 1.
    fn file(&self, number: usize) -> &Path {
        number.checked_sub(1).and_then(|index| self.files.get(index)).map_or(Path::new(""), |p| p)
    }

    fn file_spans(&self) -> Vec<(usize, Span)> {
        let mut spans: Vec<(usize, Span)> =
            self.topics.iter().flat_map(|topic| &topic.content.spans).copied().collect();
        spans.sort_by_key(|&(number, _)| number);
        spans.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 = join(kept.1, next.1);
            }
            same
        });
        spans
    }
}

fn format_key(topic: &str, format: Format<'_>) -> FormatKey {
    let mut hasher = DefaultHasher::new();
    (format.schema_encoding, format.schema).hash(&mut hasher);
    let Format { encoding, type_name, .. } = format;
    (topic.to_owned(), encoding.to_owned(), type_name.to_owned(), hasher.finish())
}

#[cfg(test)]
mod tests;
