//! Foxglove data loader: opens the logs and tables that poseaudit reads, with their topics and the audit as channels
//! and the findings as problems. Foxglove loads it as a WebAssembly module (`.ci/wasm`).
#![warn(missing_docs, clippy::unwrap_used)]

mod messages;
mod recording;

use std::io::Read;
use std::panic;
use std::path::PathBuf;
use std::rc::Rc;

use bytes::Bytes;
use foxglove::Schema;
use foxglove_data_loader::{
    BackfillArgs, DataLoader, DataLoaderArgs, Initialization, Message, MessageIteratorArgs,
    Problem, Severity, console, reader,
};
use poseaudit::finding;
use poseaudit::output::foxglove as output;
use poseaudit::report::Trouble;

use messages::Messages;
use recording::Recording;

/// One data source: files of one run.
pub struct Loader {
    paths: Vec<String>,
    recording: Rc<Recording>,
}

impl DataLoader for Loader {
    type MessageIterator = Messages;
    type Error = Trouble;

    fn new(DataLoaderArgs { paths }: DataLoaderArgs) -> Self {
        Self { paths, recording: Rc::default() }
    }

    fn initialize(&mut self) -> Result<Initialization, Trouble> {
        panic::set_hook(Box::new(|info| console::error(&format!("internal error: {info}"))));
        let logs: Result<_, Trouble> =
            self.paths.iter().map(|path| Ok((PathBuf::from(path), read(path)?))).collect();
        let (recording, problems) = Recording::open(logs?)?;
        self.recording = Rc::new(recording);
        Ok(summarize(&self.recording, problems))
    }

    fn create_iter(&mut self, args: MessageIteratorArgs) -> Result<Messages, Trouble> {
        Ok(Messages::new(Rc::clone(&self.recording), &args))
    }

    fn get_backfill(&mut self, args: BackfillArgs) -> Result<Vec<Message>, Trouble> {
        let BackfillArgs { time, channels } = args;
        Ok(channels.into_iter().filter_map(|id| self.recording.last_message(id, time)).collect())
    }
}

foxglove_data_loader::export!(Loader);

/// Reads a whole file: the readers of most tables need all of it.
fn read(path: &str) -> Result<Bytes, Trouble> {
    let trouble = |what: String, remedy: &str| Trouble::log(path, what, remedy);
    let mut reader = reader::open(path);
    let size = reader.size();
    let mut content = Vec::new();
    let capacity = usize::try_from(size).unwrap_or(usize::MAX);
    content.try_reserve_exact(capacity).map_err(|_| {
        trouble(
            format!("{size} bytes do not fit into the memory of a data loader"),
            "audit it with the program, or split it",
        )
    })?;
    reader
        .read_to_end(&mut content)
        .map_err(|error| trouble(error.to_string(), "open it again"))?;
    Ok(content.into())
}

/// Channels with the ids of [`Recording`], and their schemas.
fn summarize(recording: &Recording, problems: Vec<output::Problem>) -> Initialization {
    let mut summary = Initialization::builder();
    let mut schemas = Vec::new();
    for (id, channel) in recording.channels() {
        let key = (channel.schema_name, channel.schema.to_string());
        let known = schemas.iter().find(|(known, _)| *known == key).map(|(_, schema)| schema);
        let schema = known.cloned().unwrap_or_else(|| {
            let schema = Schema::new(key.0, "jsonschema", key.1.clone().into_bytes());
            let schema = summary.add_schema(schema).message_encoding("json");
            schemas.push((key, schema.clone()));
            schema
        });
        if let Some(added) = schema.add_channel_with_id(id, &channel.topic) {
            added.message_count(channel.message_count() as u64);
        }
    }
    let (start, end) = recording.time_range();
    let summary = summary.start_time(start).end_time(end);
    problems
        .into_iter()
        .fold(summary, |summary, problem| summary.add_problem(shown(problem)))
        .build()
}

fn shown(problem: output::Problem) -> Problem {
    let output::Problem { severity, message, tip } = problem;
    let severity = match severity {
        finding::Severity::Info => Severity::Info,
        finding::Severity::Warning => Severity::Warn,
        finding::Severity::Error => Severity::Error,
    };
    let problem = Problem::new(severity, message);
    match tip {
        Some(tip) => problem.tip(tip),
        None => problem,
    }
}
