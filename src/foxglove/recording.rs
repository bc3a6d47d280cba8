use std::path::PathBuf;

use bytes::Bytes;
use foxglove_data_loader::{ChannelId, Message};
use poseaudit::finding::Severity;
use poseaudit::output::foxglove::{Channel, Problem, channels, problems};
use poseaudit::report::Trouble;
use poseaudit::{Options, audit_prepared, log, prepare};

/// Foxglove's ids have 16 bits.
const MAX_CHANNELS: usize = 60_000;

/// Channels of a log and of its audit. The id of a channel is its index.
#[derive(Debug, Default)]
pub struct Recording {
    channels: Vec<Channel>,
}

impl Recording {
    /// Reads and audits the files of one run. A log that cannot be audited has channels and a problem.
    ///
    /// # Errors
    /// If the log cannot be read.
    pub fn open(logs: Vec<(PathBuf, Bytes)>) -> Result<(Self, Vec<Problem>), Trouble> {
        let mut options = Options::default().with_given(logs)?;
        let mut log = log::open(&options.logs, &options.read)?;
        // Frees the files before the audit.
        options.read.given.clear();
        prepare(&mut log, &options.run)?;
        let topics = log.topics.clone();
        let audited = audit_prepared(log, &options);
        let mut channels = channels(topics, audited.as_ref().ok());
        let mut problems = match &audited {
            Ok(audited) => problems(&audited.report),
            Err(trouble) => vec![trouble.into()],
        };
        let hidden = channels.len().saturating_sub(MAX_CHANNELS);
        channels.truncate(MAX_CHANNELS);
        let hidden = (hidden > 0).then(|| {
            warning(
                format!("{hidden} topics are not shown: a data source has at most {MAX_CHANNELS}"),
                "open fewer files at once",
            )
        });
        let untimed = channels.iter().filter(|channel| channel.untimed > 0).map(|channel| {
            let Channel { topic, untimed, .. } = channel;
            warning(
                format!("{topic}: {untimed} rows before 1970 are not shown"),
                "shift the stamps: Foxglove has no negative times",
            )
        });
        problems.extend(hidden.into_iter().chain(untimed));
        Ok((Self { channels }, problems))
    }

    /// Channels with their ids.
    pub fn channels(&self) -> impl Iterator<Item = (ChannelId, &Channel)> {
        (0..).zip(&self.channels)
    }

    pub fn channel(&self, id: ChannelId) -> Option<&Channel> {
        self.channels.get(usize::from(id))
    }

    /// First and last log time, ns.
    pub fn time_range(&self) -> (u64, u64) {
        let ends = self.channels.iter().filter_map(|channel| {
            Some((channel.log_time(0)?, channel.log_time(channel.message_count().checked_sub(1)?)?))
        });
        let range = ends.reduce(|(start, end), (first, last)| (start.min(first), end.max(last)));
        range.unwrap_or_default()
    }

    pub fn message(&self, id: ChannelId, position: usize) -> Option<Message> {
        let message = self.channel(id)?.message(position)?;
        Some(Message {
            channel_id: id,
            log_time: message.log_time,
            publish_time: message.publish_time,
            data: message.data,
        })
    }

    /// The last message of a channel at or before `time`, ns.
    pub fn last_message(&self, id: ChannelId, time: u64) -> Option<Message> {
        let count = self.channel(id)?.count_while(|log_time| log_time <= time);
        self.message(id, count.checked_sub(1)?)
    }
}

fn warning(message: String, tip: &str) -> Problem {
    Problem { severity: Severity::Warning, message, tip: Some(tip.to_owned()) }
}
