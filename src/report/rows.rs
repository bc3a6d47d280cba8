//! Rows that describe the log.

use std::collections::HashMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ColumnRow, TableRow};
use crate::finding::{Word, deserialize_optional_word, deserialize_word};
use crate::log::{Cell, Log, TableShape};
use crate::run::{Arm, PoseSourceKind, Run, selectors};
use crate::stream::Columns;
use crate::time::Stamp;

/// One arm.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct RobotRow {
    /// Name of the arm.
    pub name: String,
    /// Source of its model.
    pub source: String,
    /// First link of the chain.
    pub base: String,
    /// Last link of the chain.
    pub tip: String,
    /// Its joints, from base to tip.
    pub joints: Vec<String>,
}

/// One topic, or one pair of frames in it.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct StreamRow {
    /// Its topic.
    pub topic: String,
    /// Type as spelled in the log.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Role of the stream.
    #[serde(deserialize_with = "deserialize_word")]
    pub role: Word,
    /// Reason for the role.
    pub reason: String,
    /// The robot it belongs to.
    pub robot: Option<String>,
    /// Frame of its messages.
    pub frame_id: Option<String>,
    /// Child frame of its messages.
    pub child_frame_id: Option<String>,
    /// Link assumed as the reference of its poses.
    pub reference: Option<String>,
    /// Link whose poses it is assumed to contain.
    pub link: Option<String>,
    /// Source of its poses: `controller`, `external` or `unknown`.
    #[serde(default, rename = "witness", deserialize_with = "deserialize_optional_word")]
    pub source_kind: Option<Word>,
    /// Number of messages or samples.
    pub count: u64,
    /// Number of samples that could not be used.
    pub dropped: u64,
    /// Samples per second.
    pub rate_hz: Option<f64>,
    /// First stamp.
    #[schemars(with = "Option<String>")]
    pub start_ns: Option<Stamp>,
    /// Last stamp.
    #[schemars(with = "Option<String>")]
    pub end_ns: Option<Stamp>,
    /// Table columns that it is made of, as named in `[columns]` of a config.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub columns: Vec<String>,
    /// Factor and offset that convert each joint's numbers to rad, if they are neither rad nor degrees.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint_lines: Vec<[f64; 2]>,
}

/// One row per stream of all segments.
pub(crate) fn join_segments(rows: impl Iterator<Item = StreamRow>) -> Vec<StreamRow> {
    let mut joined: Vec<StreamRow> = Vec::new();
    let mut places: HashMap<_, usize> = HashMap::new();
    for row in rows {
        let StreamRow { topic, type_name, frame_id, child_frame_id, .. } = row.clone();
        let place = places.entry((topic, type_name, frame_id, child_frame_id));
        let place = *place.or_insert(joined.len());
        match joined.get_mut(place) {
            Some(known) => {
                known.count += row.count;
                known.dropped += row.dropped;
                known.rate_hz = known.rate_hz.or(row.rate_hz);
                known.start_ns = [known.start_ns, row.start_ns].into_iter().flatten().min();
                known.end_ns = known.end_ns.max(row.end_ns);
            }
            None => joined.push(row),
        }
    }
    joined
}

pub(crate) fn robot_rows(run: &Run) -> Vec<RobotRow> {
    let row = |arm: &Arm| RobotRow {
        name: arm.name.clone(),
        source: arm.identified_by.clone(),
        base: arm.chain.base_name().to_owned(),
        tip: arm.chain.tip_name().to_owned(),
        joints: arm.chain.joint_names().to_vec(),
    };
    run.arms.iter().filter(|arm| arm.trajectory.is_none()).map(row).collect()
}

/// The tables of a log whose columns are identified.
pub(crate) fn table_rows(log: &Log) -> Vec<TableRow> {
    let row = |(table, shape): (usize, &TableShape)| {
        let mut columns: Vec<(Vec<usize>, String)> = Vec::new();
        for at in 0..shape.numbers.len() {
            let read_as = reading(log, table, shape.numbers[at].at);
            match columns.last_mut() {
                Some((run, last)) if *last == read_as => run.push(at),
                _ => columns.push((vec![at], read_as)),
            }
        }
        let column = |(run, read_as): (Vec<usize>, String)| {
            let names: Vec<String> = run.iter().map(|&at| shape.numbers[at].name.clone()).collect();
            let (first, last) = (run[0] + 1, run[run.len() - 1] + 1);
            ColumnRow {
                numbers: if first == last { first.to_string() } else { format!("{first}-{last}") },
                names: selectors(&names).join(", "),
                read_as,
            }
        };
        let rate = if shape.lacks_times { "@RATE" } else { "" };
        TableRow {
            path: shape.file.clone(),
            width: shape.numbers.len(),
            layout: shape.layout.as_ref().map(|layout| format!("{layout}{rate}")),
            layout_reason: shape.layout_reason.clone(),
            columns: columns.into_iter().map(column).collect(),
        }
    };
    log.tables.iter().enumerate().map(row).collect()
}

/// Topic of a column, or why it has none.
fn reading(log: &Log, table: usize, at: Option<Cell>) -> String {
    let Some(at) = at else { return "text, not numbers".to_owned() };
    let shape = &log.tables[table];
    if [shape.time, shape.nanos].contains(&Some(at)) {
        return "stamps".to_owned();
    }
    let is_it = |cell: &crate::log::TableCell| cell.table == table && cell.at == at;
    // A long table has several streams in the same columns.
    let streams = log.topics.iter().filter(|topic| topic.cells.iter().any(is_it));
    let read = streams.filter(|topic| topic.columns.is_some() && !is_bare(topic));
    let names: Vec<&str> = read.map(|topic| topic.name.as_str()).collect();
    if names.len() > 1 {
        return names.join(", ");
    }
    for topic in &log.topics {
        if topic.cells.iter().any(is_it) {
            let why = topic.unusable.as_ref().or(topic.read_as.as_ref());
            return match (&topic.columns, why) {
                (Some(_), _) if !is_bare(topic) => topic.name.clone(),
                (_, Some(why)) => format!("not read: {why}"),
                (_, None) => "not read".to_owned(),
            };
        }
        if topic.velocity_cells.iter().any(is_it) {
            return format!("velocities of {}", topic.name);
        }
    }
    "not read".to_owned()
}

fn is_bare(topic: &crate::log::Topic) -> bool {
    matches!(&topic.columns, Some(Columns::Array(array)) if array.unnamed)
}

pub(crate) fn stream_rows(run: &Run) -> Vec<StreamRow> {
    let named = |text: &String| (!text.is_empty()).then(|| text.clone());
    let rows = run.streams.iter().map(|stream| StreamRow {
        topic: stream.topic.clone(),
        type_name: stream.type_name.clone(),
        role: stream.role.name(),
        reason: stream.reason.clone(),
        robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
        frame_id: named(&stream.frame_id),
        child_frame_id: named(&stream.child_frame_id),
        reference: stream.reference.clone(),
        link: stream.link.clone(),
        source_kind: stream.source_kind.map(PoseSourceKind::name),
        count: stream.count,
        dropped: stream.dropped,
        rate_hz: stream.rate_hz,
        start_ns: stream.start,
        end_ns: stream.end,
        columns: selectors(&stream.cells),
        joint_lines: match &stream.columns {
            Some(Columns::Joints(joints)) => joints.conversions.clone(),
            _ => Vec::new(),
        },
    });
    rows.collect()
}
