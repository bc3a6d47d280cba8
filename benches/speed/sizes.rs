//! Time over size: logs in which one quantity grows and all others stay as they are.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use poseaudit::synth::{JOINT_STATES, POSE, Scenario, TF};

use crate::process::{self, Cost};

/// Exponents up to this are linear.
const MAX_LINEAR_EXPONENT: f64 = 1.1;
/// Messages of each added topic with few messages.
const MESSAGES_PER_SMALL_TOPIC: usize = 5;
/// Messages of each added stream, 50 a second.
const MESSAGES_PER_STREAM: usize = 200;

/// Prints the CPU time of whole audits over the size, with the exponent of each doubling.
pub fn print_growth(folder: &Path) -> Result<()> {
    println!(
        "\nTime over size, whole audit (exponents of at most {MAX_LINEAR_EXPONENT} are linear):"
    );
    let base = BaseRun::new()?;
    let table = |rows: usize, columns: usize, size: usize| -> Result<(usize, PathBuf)> {
        let path = folder.join(format!("table-{rows}-{columns}.csv"));
        fs::write(&path, super::csv_table(rows, columns))?;
        Ok((size, path))
    };
    let log = |name: &str, size: usize, added: Vec<Message>| -> Result<(usize, PathBuf)> {
        let path = folder.join(format!("{name}-{size}.mcap"));
        fs::write(&path, base.log_with(added)?)?;
        Ok((size, path))
    };
    let rows = [60_000, 120_000, 240_000, 480_000].map(|size| table(size, 6, size));
    print_sizes("rows of a table", rows.into_iter().collect::<Result<_>>()?)?;
    let columns = [100, 200, 400, 800].map(|size| table(500, size, size));
    print_sizes("columns of a table", columns.into_iter().collect::<Result<_>>()?)?;
    let topics = [1000, 2000, 4000, 8000]
        .map(|size| log("topics", size, base.pose_topics(size, MESSAGES_PER_SMALL_TOPIC)));
    print_sizes("pose topics", topics.into_iter().collect::<Result<_>>()?)?;
    let frames = [800, 1600, 3200, 6400].map(|size| log("frames", size, base.frame_chain(size)));
    print_sizes("frames of a chain in /tf", frames.into_iter().collect::<Result<_>>()?)?;
    let joints =
        [500, 1000, 2000, 4000].map(|size| log("joints", size, base.wide_joint_states(size)));
    print_sizes("joints of a message", joints.into_iter().collect::<Result<_>>()?)?;
    let streams = [40, 80, 160, 320]
        .map(|size| log("streams", size, base.pose_topics(size, MESSAGES_PER_STREAM)));
    print_sizes("pose streams of a run", streams.into_iter().collect::<Result<_>>()?)
}

/// Prints a line for each size.
fn print_sizes(what: &str, logs: Vec<(usize, PathBuf)>) -> Result<()> {
    let mut last: Option<(usize, Cost)> = None;
    for (size, path) in logs {
        let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
        // Whether the arm is in a table does not matter here.
        let (cost, _) =
            process::measure_cost(command.args(["audit", "--robot", "ur5e"]).arg(&path))?;
        let exponent = last.map(|(before, cost_before)| {
            (cost.cpu_s / cost_before.cpu_s).ln() / (size as f64 / before as f64).ln()
        });
        let exponent = exponent.map_or(String::new(), |it| format!("exponent {it:.2}"));
        println!("{what:34} {size:>9} {:>8.2} s cpu  {exponent}", cost.cpu_s);
        last = Some((size, cost));
        fs::remove_file(path)?;
    }
    Ok(())
}

/// A message to be written.
#[derive(Clone)]
struct Message {
    topic: String,
    type_name: String,
    definition: Vec<u8>,
    log_ns: u64,
    cdr: Vec<u8>,
}

/// The run to which messages are added.
struct BaseRun {
    messages: Vec<Message>,
}

impl BaseRun {
    fn new() -> Result<Self> {
        let mut bytes = Vec::new();
        let run = Scenario { duration_s: 4.0, ..Scenario::ur5e() };
        run.write_mcap(Cursor::new(&mut bytes), None)?;
        let read = mcap::MessageStream::new(&bytes)?.map(|message| {
            let message = message?;
            let schema = message.channel.schema.clone().context("a schema")?;
            Ok(Message {
                topic: message.channel.topic.clone(),
                type_name: schema.name.clone(),
                definition: schema.data.to_vec(),
                log_ns: message.log_time,
                cdr: message.data.to_vec(),
            })
        });
        Ok(Self { messages: read.collect::<Result<_>>()? })
    }

    /// Messages of a topic of the run, spread over it.
    fn spread_messages(&self, topic: &str, count: usize) -> Vec<&Message> {
        let own: Vec<&Message> =
            self.messages.iter().filter(|message| message.topic == topic).collect();
        let step = (own.len() / count).max(1);
        own.into_iter().step_by(step).take(count).collect()
    }

    /// More topics of poses, each with some messages of the tool's.
    fn pose_topics(&self, count: usize, messages: usize) -> Vec<Message> {
        let edited = |number: usize| {
            self.spread_messages(POSE, messages).into_iter().map(move |message| {
                let mut message = Message { topic: format!("/pose_{number}"), ..message.clone() };
                // Each has other numbers: the last byte of x, behind the header.
                if let Some(byte) = message.cdr.get_mut(24) {
                    *byte = byte.wrapping_add(number as u8);
                }
                message
            })
        };
        (0..count).flat_map(edited).collect()
    }

    /// A chain of frames in a topic of transforms.
    fn frame_chain(&self, count: usize) -> Vec<Message> {
        let edited = |message: &Message| {
            let mut cdr = Cdr::new();
            cdr.u32(count as u32);
            for frame in 0..count {
                cdr.stamp(message.log_ns);
                cdr.text(&format!("frame_{frame}"));
                cdr.text(&format!("frame_{}", frame + 1));
                [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0].into_iter().for_each(|value| cdr.f64(value));
            }
            Message { cdr: cdr.0, ..message.clone() }
        };
        self.spread_messages(TF, MESSAGES_PER_SMALL_TOPIC).into_iter().map(edited).collect()
    }

    /// Joint states with many joints.
    fn wide_joint_states(&self, count: usize) -> Vec<Message> {
        let edited = |(row, message): (usize, &Message)| {
            let mut cdr = Cdr::new();
            cdr.stamp(message.log_ns);
            cdr.text("");
            cdr.u32(count as u32);
            (0..count).for_each(|joint| cdr.text(&format!("other_{joint}")));
            cdr.u32(count as u32);
            (0..count).for_each(|joint| cdr.f64((0.02 * row as f64 + joint as f64).sin()));
            cdr.u32(0);
            cdr.u32(0);
            Message { topic: "/other/joint_states".to_owned(), cdr: cdr.0, ..message.clone() }
        };
        self.spread_messages(JOINT_STATES, MESSAGES_PER_STREAM)
            .into_iter()
            .enumerate()
            .map(edited)
            .collect()
    }

    /// The run with more messages, as a log.
    fn log_with(&self, added: Vec<Message>) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let options = WriteOptions::new().compression(None).compression_threads(0);
        let mut writer = options.create(Cursor::new(&mut bytes))?;
        let mut channels: BTreeMap<String, u16> = BTreeMap::new();
        let mut messages: Vec<&Message> = self.messages.iter().chain(&added).collect();
        messages.sort_by_key(|message| message.log_ns);
        for (sequence, message) in (1..).zip(messages) {
            let channel_id = match channels.get(&message.topic) {
                Some(channel) => *channel,
                None => {
                    let schema =
                        writer.add_schema(&message.type_name, "ros2msg", &message.definition)?;
                    let channel =
                        writer.add_channel(schema, &message.topic, "cdr", &BTreeMap::new())?;
                    channels.insert(message.topic.clone(), channel);
                    channel
                }
            };
            let (log_time, publish_time) = (message.log_ns, message.log_ns);
            let header = MessageHeader { channel_id, sequence, log_time, publish_time };
            writer.write_to_known_channel(&header, &message.cdr)?;
        }
        writer.finish()?;
        drop(writer);
        Ok(bytes)
    }
}

/// A message in CDR, little-endian.
struct Cdr(Vec<u8>);

impl Cdr {
    const HEADER: usize = 4;

    fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn align(&mut self, to: usize) {
        let length = (self.0.len() - Self::HEADER).next_multiple_of(to);
        self.0.resize(Self::HEADER + length, 0);
    }

    fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.bytes().chain([0]));
    }

    fn stamp(&mut self, nanos: u64) {
        self.u32((nanos / 1_000_000_000) as u32);
        self.u32((nanos % 1_000_000_000) as u32);
    }
}
