//! What every container hands its content to.

use std::collections::HashMap;
use std::fmt;

use super::decode::{self, Builder, Format, Plan, Recipe, Row, RowTimes};
use super::losses::Losses;
use super::{Description, Log, LogFile, Loss, Topic, Undecodable};
use crate::time::Stamp;

/// Longest robot description taken from an attachment or metadata, in bytes.
const MAX_DESCRIPTION_BYTES: usize = 16 << 20;

/// Collects topics, messages and damage over all files of a run.
#[derive(Default)]
pub(super) struct Intake {
    topics: Vec<TopicIntake>,
    by_name: HashMap<(String, String), usize>,
    channels: Vec<Channel>,
    messages: u64,
    descriptions: Vec<Description>,
    losses: Vec<Loss>,
}

/// A channel that an [`Intake`] knows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct ChannelId(usize);

/// One message as a container holds it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message<'a> {
    /// When the recorder received it, in nanoseconds.
    pub(super) log_time: u64,
    /// When the sender published it, in nanoseconds.
    pub(super) publish_time: u64,
    /// The encoded message.
    pub(super) data: &'a [u8],
    /// Where in the file it is, or the chunk that holds it.
    pub(super) offset: u64,
}

/// Where messages of one channel go and how they are decoded.
struct Channel {
    topic: usize,
    decoding: Decoding,
}

enum Decoding {
    /// No audit uses the type.
    Ignored,
    By {
        plan: Plan,
        /// Of the channel's own, so that no slot holds what another type left there.
        row: Box<Row>,
    },
    Impossible {
        cause: String,
    },
}

struct TopicIntake {
    name: String,
    type_name: String,
    encoding: String,
    messages: u64,
    builder: Option<Builder>,
    undecodable: Option<Undecodable>,
    span: Option<(Stamp, Stamp)>,
}

impl TopicIntake {
    fn undecodable(&mut self, offset: u64, cause: &dyn fmt::Display) {
        let undecodable = self.undecodable.get_or_insert_with(|| Undecodable {
            messages: 0,
            first: format!("{cause} (record at byte {offset} of the file)"),
        });
        undecodable.messages += 1;
    }

    fn finish(self) -> Topic {
        Topic {
            name: self.name,
            type_name: self.type_name,
            encoding: self.encoding,
            messages: self.messages,
            columns: self.builder.map(Builder::finalize),
            undecodable: self.undecodable,
            span: self.span,
        }
    }
}

impl Intake {
    /// Takes up a channel; one of the same topic and type goes on where the last one stopped.
    pub(super) fn channel(&mut self, topic: &str, format: Format<'_>) -> ChannelId {
        let recipe = Recipe::of(format.type_name);
        let decoding = match recipe.map(|recipe| recipe.plan(format)) {
            None => Decoding::Ignored,
            Some(Ok(plan)) => Decoding::By { plan, row: Box::default() },
            Some(Err(error)) => Decoding::Impossible { cause: error.to_string() },
        };
        let key = (topic.to_owned(), decode::canonical(format.type_name).into_owned());
        let index = *self.by_name.entry(key).or_insert_with(|| {
            self.topics.push(TopicIntake {
                name: topic.to_owned(),
                type_name: format.type_name.to_owned(),
                encoding: format.encoding.to_owned(),
                messages: 0,
                builder: None,
                undecodable: None,
                span: None,
            });
            self.topics.len() - 1
        });
        if let (Some(recipe), Decoding::By { .. }) = (recipe, &decoding) {
            self.topics[index].builder.get_or_insert_with(recipe.builder);
        }
        self.channels.push(Channel { topic: index, decoding });
        ChannelId(self.channels.len() - 1)
    }

    /// Counts a message, and appends its rows where the channel has columns.
    pub(super) fn message(&mut self, channel: ChannelId, message: Message<'_>) {
        let Channel { topic, decoding } = &mut self.channels[channel.0];
        let topic = &mut self.topics[*topic];
        let times = RowTimes {
            log: saturating(message.log_time),
            publish: saturating(message.publish_time),
        };
        self.messages += 1;
        topic.messages += 1;
        let at = Stamp::from_nanos(times.log);
        topic.span = join(topic.span, Some((at, at)));
        match (decoding, &mut topic.builder) {
            (Decoding::By { plan, row }, Some(builder)) => {
                let mut append = |row: &Row| builder.append(row, times);
                if let Err(error) = plan.decode(message.data, row, &mut append) {
                    topic.undecodable(message.offset, &error);
                }
            }
            (Decoding::Impossible { cause }, _) => topic.undecodable(message.offset, cause),
            (Decoding::By { .. } | Decoding::Ignored, _) => {}
        }
    }

    /// Messages taken so far.
    pub(super) fn messages(&self) -> u64 {
        self.messages
    }

    /// Keeps a text from beside the messages if it is a robot description.
    pub(super) fn text(&mut self, name: &str, text: &[u8]) {
        if text.len() > MAX_DESCRIPTION_BYTES {
            return;
        }
        let Ok(text) = std::str::from_utf8(text) else {
            return;
        };
        let text = text.trim_start_matches('\u{feff}').trim();
        if !text.starts_with('<') || !text.contains("<robot") {
            return;
        }
        let description = Description { name: name.to_owned(), text: text.to_owned() };
        if !self.descriptions.contains(&description) {
            self.descriptions.push(description);
        }
    }

    /// Takes down the damage to a file.
    pub(super) fn losses(&mut self, losses: Losses) {
        self.losses.extend(losses.finish());
    }

    /// The log of all that was taken.
    pub(super) fn finish(self, files: Vec<LogFile>) -> Log {
        let mut topics: Vec<Topic> = self.topics.into_iter().map(TopicIntake::finish).collect();
        topics.sort_by(|a, b| (&a.name, &a.type_name).cmp(&(&b.name, &b.type_name)));
        Log {
            files,
            span: topics.iter().map(|topic| topic.span).fold(None, join),
            topics,
            descriptions: self.descriptions,
            messages: self.messages,
            losses: self.losses,
        }
    }
}

fn saturating(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX)
}

/// The span that covers both.
fn join(a: Option<(Stamp, Stamp)>, b: Option<(Stamp, Stamp)>) -> Option<(Stamp, Stamp)> {
    match (a, b) {
        (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
        (a, b) => a.or(b),
    }
}
