//! Streams of a run: topics, or each pose of a topic with several.

use std::collections::{HashMap, HashSet};

use crate::geometry::{Convention, RotationEncoding, Units};
use crate::log::{RotationLabels, Topic};
use crate::stream::{Columns, PoseColumns, Times};
use crate::time::{Clock, Stamp};

use super::clock::{self, ClockSource, StreamClock};
use super::columns::named_units;
use super::role::{
    Role, documented_convention, named_encodings, role_by_content, role_by_name, split_words,
};
use super::rounded::RoundedStamps;
use super::rows::Rows;
use super::source_kind::PoseSourceKind;
use super::tf_tree::strip_slash;

/// A stream, its role, and the reason.
#[derive(Clone, Debug)]
pub struct Stream {
    /// Topic name.
    pub topic: String,
    /// Type name as in the log.
    pub type_name: String,
    /// Its role.
    pub role: Role,
    /// Reason for the role.
    pub reason: String,
    /// Index of the arm that it belongs to.
    pub arm: Option<usize>,
    /// Frame of its content; empty if absent or unset.
    pub frame_id: String,
    /// Frame whose pose it is; empty in the same cases.
    pub child_frame_id: String,
    /// Reference link of audited poses.
    pub reference: Option<String>,
    /// Link whose pose it is, or with the IMU.
    pub link: Option<String>,
    /// Source of its measurements; `None` if unused.
    pub source_kind: Option<PoseSourceKind>,
    /// Messages, or rows of one of several poses.
    pub count: u64,
    /// For one of the poses that each message lists: messages of the log that do not contain it.
    pub omitted: u64,
    /// Dropped ones: undecodable, wrong length, not finite, or unstamped.
    pub dropped: u64,
    /// Rate, Hz; a TF topic's most frequent transform.
    pub rate_hz: Option<f64>,
    /// Expected rate, Hz.
    pub expected_hz: Option<f64>,
    /// First row, on the audit's clock.
    pub start: Option<Stamp>,
    /// Last row.
    pub end: Option<Stamp>,
    /// Whether its topic has other streams too.
    pub shares_topic: bool,
    /// Whether it should be audited, but has no usable messages.
    pub is_empty: bool,
    /// How table columns were identified.
    pub read_as: Option<String>,
    /// Whether its rows are those of a table file.
    pub is_from_table: bool,
    /// Number of the file with all its messages, from 1; `None` if several have them.
    pub file: Option<usize>,
    /// Its table columns, in `[columns]` syntax.
    pub cells: Vec<String>,
    /// Units of poses by the names of their columns, except for numbers that the caller's layout converts.
    pub named_units: Units,
    /// Whether its receive times come from its motion.
    pub is_aligned_by_motion: bool,
    /// Rotation encoding by column names.
    pub labels: Option<RotationLabels>,
    /// Unidentified measured table columns.
    pub unidentified: Vec<String>,
    /// Its content, as logged.
    pub columns: Option<Columns>,
}

impl Stream {
    /// Times of its rows; one part per transform.
    pub fn times(&self) -> Vec<&Times> {
        self.columns.as_ref().map(Columns::times).unwrap_or_default()
    }

    /// Rows without usable numbers; values for joint states.
    pub fn unusable(&self) -> u64 {
        self.columns.as_ref().map_or(0, Columns::not_finite)
    }

    /// Child frame that its messages name, whatever link the caller names.
    pub fn logged_child_frame(&self) -> Option<&str> {
        let Some(Columns::Poses(poses)) = &self.columns else { return None };
        let child = strip_slash(&poses.first()?.child_frame_id);
        (!child.is_empty()).then_some(child)
    }

    /// Whether it has positions without rotation: points, or three columns of a table.
    pub fn lacks_rotation(&self) -> bool {
        self.is_of_points() || self.has_position_columns()
    }

    /// Whether its messages are points, such as those of a laser tracker.
    pub fn is_of_points(&self) -> bool {
        self.type_name.ends_with("/PointStamped")
    }

    fn has_position_columns(&self) -> bool {
        self.cells.len() == 3 && matches!(self.columns, Some(Columns::Poses(_)))
    }

    /// Whether its numbers lack unit and convention.
    pub fn lacks_encoding(&self) -> bool {
        matches!(self.columns, Some(Columns::Array(_))) || self.has_position_columns()
    }

    /// Convention of three rotation numbers that its driver documents, or that its column names state for `arm`.
    pub fn documented_convention(&self, arm: &str) -> Option<Convention> {
        let named = || match named_encodings(self.labels?, arm).first() {
            Some(RotationEncoding::Three(convention)) => Some(*convention),
            _ => None,
        };
        documented_convention(&self.topic).or_else(named)
    }

    /// Encoding of the rotations, if they are matrices, or the driver or the names of the columns leave no choice.
    pub(super) fn stated_encoding(&self) -> Option<RotationEncoding> {
        use RotationLabels::{Quaternion, RotationVector, ScalarFirst};
        let Some(Columns::Array(array)) = &self.columns else { return None };
        let by_labels = || {
            let labels = self.labels?;
            let is_certain = matches!(labels, Quaternion | ScalarFirst | RotationVector);
            named_encodings(labels, "").first().copied().filter(|_| is_certain)
        };
        let by_driver = || Some(RotationEncoding::Three(documented_convention(&self.topic)?));
        match array.width {
            12 | 16 => Some(RotationEncoding::Rows),
            6 => by_labels().or_else(by_driver),
            _ => by_labels(),
        }
    }

    /// Whether each of its messages lists poses, of which some may be absent.
    pub fn lists_poses(&self) -> bool {
        ["PoseArray", "PosesInFrame"].iter().any(|name| self.type_name.ends_with(name))
    }

    fn mark_empty(&mut self) {
        let has_rows = |columns: &Columns| columns.times().iter().any(|times| !times.is_empty());
        let Some(columns) = self.columns.as_ref().filter(|columns| !has_rows(columns)) else {
            return;
        };
        // ING002 reports undecodable topics.
        if dropped_in(columns) > 0 && is_wanted(self, columns) {
            self.is_empty = true;
            self.reason = "none of its messages has finite numbers".to_owned();
        }
    }

    pub(super) fn with_single_pose(&self, poses: PoseColumns) -> Self {
        let (count, dropped) = (poses.times.len() as u64, poses.not_finite);
        Stream {
            frame_id: strip_slash(&poses.frame_id).to_owned(),
            child_frame_id: strip_slash(&poses.child_frame_id).to_owned(),
            count,
            dropped,
            columns: Some(Columns::Poses(vec![poses])),
            ..self.clone()
        }
    }
}

/// Elements with this key, in a slice sorted by key.
pub(crate) fn with_key<T, K: Ord>(sorted: &[T], key: K, key_of: impl Fn(&T) -> K) -> &[T] {
    let first = sorted.partition_point(|one| key_of(one) < key);
    let end = sorted.partition_point(|one| key_of(one) <= key);
    &sorted[first..end]
}

/// Sets [`Stream::shares_topic`] once all streams exist.
pub(super) fn mark_shared_topics(streams: &mut [Stream]) {
    let mut counts: HashMap<String, usize> = HashMap::new();
    for stream in &*streams {
        *counts.entry(stream.topic.clone()).or_default() += 1;
    }
    for stream in streams {
        stream.shares_topic = counts[&stream.topic] > 1;
    }
}

/// Topics of dynamic transforms.
pub(crate) fn tf_topics(streams: &[Stream]) -> HashSet<String> {
    let of_tf = streams.iter().filter(|stream| stream.role == Role::Tf);
    of_tf.map(|stream| stream.topic.clone()).collect()
}

/// Streams in topic order, with roles that need no robot.
pub(super) fn split(topics: Vec<Topic>) -> Vec<Stream> {
    let mut streams: Vec<Stream> = topics.into_iter().flat_map(streams_of_topic).collect();
    streams.iter_mut().for_each(Stream::mark_empty);
    ignore_unnamed_joints(&mut streams);
    demote_fake_controllers(&mut streams);
    streams
}

/// Ignores unnamed joint states if another topic has as many named joints, else the arm would appear twice.
fn ignore_unnamed_joints(streams: &mut [Stream]) {
    let joints = |stream: &Stream, unnamed: bool| match (stream.role, &stream.columns) {
        (Role::Joints, Some(Columns::Joints(joints))) if joints.unnamed == unnamed => {
            Some(joints.joints.len())
        }
        _ => None,
    };
    for index in 0..streams.len() {
        let Some(count) = joints(&streams[index], true) else { continue };
        if streams[index].read_as.is_some() {
            continue;
        }
        let named = streams.iter().find(|stream| joints(stream, false) >= Some(count));
        if let Some(topic) = named.map(|stream| stream.topic.clone()) {
            streams[index].role = Role::Ignored;
            streams[index].reason = format!("its joints have no names, unlike those on '{topic}'");
        }
    }
}

/// Makes a fake controller's joint states (MoveIt's demo execution) commands if another topic has the same
/// joints.
fn demote_fake_controllers(streams: &mut [Stream]) {
    let joints = |stream: &Stream| -> Option<HashSet<String>> {
        match (stream.role, &stream.columns) {
            (Role::Joints, Some(Columns::Joints(columns))) => {
                Some(columns.joints.iter().map(|joint| joint.name.clone()).collect())
            }
            _ => None,
        }
    };
    let is_fake = |stream: &Stream| split_words(&stream.topic).iter().any(|word| word == "fake");
    for index in 0..streams.len() {
        let Some(own) = joints(&streams[index]).filter(|_| is_fake(&streams[index])) else {
            continue;
        };
        let has_them = |stream: &&Stream| {
            !is_fake(stream) && joints(stream).is_some_and(|other| own.is_subset(&other))
        };
        if let Some(topic) = streams.iter().find(has_them).map(|stream| stream.topic.clone()) {
            streams[index].role = Role::Reference;
            streams[index].reason =
                format!("commands to a fake controller; the joint states are on '{topic}'");
        }
    }
}

fn streams_of_topic(topic: Topic) -> Vec<Stream> {
    let undecodable = topic.undecodable.as_ref().map_or(0, |undecodable| undecodable.messages);
    let kind = if topic.type_name.is_empty() { "column" } else { "type" };
    let is_from_table = topic.is_from_table();
    let cells: Vec<String> = topic.cells.iter().map(|cell| cell.name.clone()).collect();
    let mut stream = Stream {
        is_from_table,
        file: topic.file,
        topic: topic.name,
        type_name: topic.type_name,
        role: Role::Ignored,
        reason: format!("the audit does not use this {kind}"),
        arm: None,
        frame_id: String::new(),
        child_frame_id: String::new(),
        reference: None,
        link: None,
        source_kind: None,
        count: topic.messages,
        omitted: 0,
        dropped: undecodable,
        rate_hz: None,
        expected_hz: None,
        start: topic.span.map(|(start, _)| start),
        end: topic.span.map(|(_, end)| end),
        shares_topic: false,
        is_empty: false,
        read_as: topic.read_as,
        labels: topic.cells.iter().find_map(|cell| cell.labels),
        unidentified: topic
            .cells
            .iter()
            .filter(|cell| cell.is_unidentified)
            .map(|cell| cell.name.clone())
            .collect(),
        named_units: named_units(&cells),
        cells,
        is_aligned_by_motion: topic.is_aligned_by_motion,
        columns: None,
    };
    let is_wanted_and_empty = |held: &Columns| {
        held.times().iter().all(|times| times.is_empty()) && is_wanted(&stream, held)
    };
    if topic.messages == 0 && topic.columns.as_ref().is_some_and(is_wanted_and_empty) {
        stream.is_empty = true;
        stream.reason = "it has no messages".to_owned();
    }
    let has_rows = |columns: &Columns| !columns.times().is_empty();
    let Some(columns) = topic.columns.filter(has_rows) else {
        if let Some(undecodable) = topic.undecodable {
            stream.reason = format!("it cannot be decoded: {}", undecodable.first);
        } else if let Some(useless) = topic.unusable {
            stream.reason = useless;
        }
        return vec![stream];
    };
    if let Columns::Poses(poses) = columns {
        (stream.role, stream.reason) = (Role::Unassigned, "it matches no arm".to_owned());
        let mut streams: Vec<Stream> =
            poses.into_iter().map(|poses| stream.with_single_pose(poses)).collect();
        if stream.lists_poses() {
            let decoded = stream.count.saturating_sub(undecodable);
            for listed in &mut streams {
                listed.omitted = decoded.saturating_sub(listed.count + listed.dropped);
            }
        }
        if let Some(first) = streams.first_mut() {
            first.dropped += undecodable;
        }
        if let [only] = streams.as_mut_slice() {
            only.count = stream.count;
        }
        return streams;
    }
    (stream.role, stream.reason) = role_by_content(&stream.topic, &columns)
        .unwrap_or_else(|| (Role::Unassigned, "it matches no arm".to_owned()));
    stream.frame_id = match &columns {
        Columns::Joints(joints) => strip_slash(&joints.frame_id).to_owned(),
        Columns::Imu(imu) => strip_slash(&imu.frame_id).to_owned(),
        _ => String::new(),
    };
    stream.dropped += dropped_in(&columns);
    stream.columns = Some(columns);
    vec![stream]
}

fn is_wanted(stream: &Stream, columns: &Columns) -> bool {
    let role = match columns {
        Columns::Poses(_) => Some(role_by_name(&stream.topic)),
        columns => role_by_content(&stream.topic, columns).map(|(role, _)| role),
    };
    matches!(role, Some(Role::Joints | Role::Pose | Role::Tf | Role::Imu))
}

fn dropped_in(columns: &Columns) -> u64 {
    let wrong_length = match columns {
        Columns::Joints(joints) => joints.wrong_length,
        Columns::Array(array) => array.wrong_length,
        _ => 0,
    };
    wrong_length + columns.not_finite()
}

pub(super) struct StreamClocks {
    pub all: Vec<StreamClock>,
    /// Clock index per stream and part.
    index_of_part: Vec<Vec<usize>>,
    /// Parts with rounded stamps.
    pub rounded: Vec<RoundedStamps>,
    /// Ticks of the clocks of parts with rounded stamps, restored or not, s, per stream and part.
    pub ticks_s: HashMap<(usize, usize), f64>,
}

impl StreamClocks {
    /// Selects the clock of every stamped stream.
    pub fn select(streams: &[Stream], wanted: Clock, max_latency_s: f64) -> Self {
        let mut sources = Vec::new();
        let mut of: Vec<Vec<usize>> = vec![Vec::new(); streams.len()];
        for (index, stream) in streams.iter().enumerate() {
            match &stream.columns {
                Some(Columns::Transforms(transforms)) if stream.role == Role::Tf => {
                    let pieces = transforms
                        .iter()
                        .map(|poses| (poses.child_frame_id.as_str(), &*poses.times));
                    of[index] = vec![0; transforms.len()];
                    for (source, members) in clock::group_by_clock(index, pieces, max_latency_s) {
                        for member in members {
                            of[index][member] = sources.len();
                        }
                        sources.push(source);
                    }
                }
                Some(Columns::Transforms(_) | Columns::Text(_)) | None => {}
                Some(_) => {
                    of[index] = vec![sources.len()];
                    sources.push(ClockSource {
                        stream: index,
                        frame: None,
                        times: stream.times(),
                        has_header: stream.times().iter().any(|times| !times.unstamped),
                        is_joints: stream.role == Role::Joints,
                        is_aligned_by_motion: stream.is_aligned_by_motion,
                    });
                }
            }
        }
        Self {
            all: clock::select_clocks(&sources, wanted, max_latency_s),
            index_of_part: of,
            rounded: Vec::new(),
            ticks_s: HashMap::new(),
        }
    }

    /// Clock of a part; `None` for static data.
    pub fn clock(&self, stream: usize, piece: usize) -> Option<&StreamClock> {
        self.all.get(self.index(stream, piece)?)
    }

    pub fn index(&self, stream: usize, piece: usize) -> Option<usize> {
        self.index_of_part.get(stream)?.get(piece).copied()
    }

    /// Stamped rows of a part.
    pub fn rows(&self, streams: &[Stream], stream: usize, piece: usize) -> Rows {
        let times = streams[stream].times();
        let mut rows = Rows::new();
        if let Some((clock, times)) = self.clock(stream, piece).zip(times.get(piece)) {
            rows.reserve_exact(times.len());
            rows.extend(clock.rows_of(times));
        }
        rows
    }

    /// The same, filtered by stamp.
    pub fn rows_where(
        &self,
        streams: &[Stream],
        stream: usize,
        piece: usize,
        mut keep: impl FnMut(Stamp) -> bool,
    ) -> Rows {
        let times = streams[stream].times();
        match (self.clock(stream, piece), times.get(piece)) {
            (Some(clock), Some(times)) => {
                clock.rows_of(times).filter(|(stamp, _)| keep(*stamp)).collect()
            }
            _ => Rows::new(),
        }
    }

    /// Shares a part's clock with a new stream.
    pub fn share(&mut self, stream: usize, piece: usize) {
        let to = self.index_of_part.len();
        let shared = self.rounded_stamps(stream, piece).cloned();
        self.rounded.extend(shared.map(|shared| RoundedStamps { stream: to, piece: 0, ..shared }));
        self.index_of_part.push(vec![self.index_of_part[stream][piece]]);
    }

    pub fn streams(&self) -> usize {
        self.index_of_part.len()
    }

    /// Rounding of a part's stamps, if rounded.
    pub fn rounded_stamps(&self, stream: usize, piece: usize) -> Option<&RoundedStamps> {
        with_key(&self.rounded, (stream, piece), |own| (own.stream, own.piece)).first()
    }

    /// Standard error between two streams by clock alignment and rounding, s.
    pub fn alignment_error_s(&self, a: (usize, usize), b: (usize, usize)) -> f64 {
        let spread = |(stream, piece)| {
            let alignment = self.clock(stream, piece).and_then(|clock| clock.alignment);
            alignment.map_or(0.0, |alignment| alignment.spread_s)
        };
        f64::hypot(spread(a), spread(b)).hypot(self.rounding_error_s(a, b))
    }

    /// Standard error between two streams of one clock by rounding, s.
    pub fn rounding_error_s(&self, a: (usize, usize), b: (usize, usize)) -> f64 {
        // Standard deviation of a uniform error. Rows of one table share theirs. A clock may round to the nearest tick or
        // down, so the offset is unknown by half a tick.
        let rounding = |part: (usize, usize)| {
            let (resolution_s, tick_s) = match self.rounded_stamps(part.0, part.1) {
                Some(own) => (own.resolution_s, own.tick_s),
                None => (0.0, self.ticks_s.get(&part).copied().unwrap_or(0.0)),
            };
            (resolution_s + 0.5 * tick_s) / 3_f64.sqrt()
        };
        match (self.rounded_stamps(a.0, a.1), self.rounded_stamps(b.0, b.1)) {
            (Some(one), Some(other)) if one.group == other.group => {
                let are_tables = one.is_of_table && other.is_of_table;
                match are_tables && one.file.is_some() && one.file == other.file {
                    true => 0.0,
                    // Both clocks round alike, but equal stamps do not show equal times.
                    false => f64::hypot(one.resolution_s, other.resolution_s) / 3_f64.sqrt(),
                }
            }
            _ => f64::hypot(rounding(a), rounding(b)),
        }
    }

    /// Sets time range and rate of streams, and counts unstamped rows.
    pub fn measure(&self, streams: &mut [Stream]) {
        for (index, stream) in streams.iter_mut().enumerate() {
            let pieces = self.index_of_part[index].len();
            let (mut rate_hz, mut bounds, mut unstamped) = (None, None, 0);
            for piece in 0..pieces {
                let times = stream.times();
                let (Some(clock), Some(times)) = (self.clock(index, piece), times.get(piece))
                else {
                    continue;
                };
                let (mut known, mut ends) = (0, None);
                for stamp in (0..times.len()).filter_map(|row| clock.stamp_of(times, row)) {
                    known += 1;
                    let (first, last) = ends.unwrap_or((stamp, stamp));
                    ends = Some((stamp.min(first), stamp.max(last)));
                }
                unstamped += times.len() - known;
                let Some((first, last)) = ends else { continue };
                let (start, end) = bounds.unwrap_or((first, last));
                bounds = Some((first.min(start), last.max(end)));
                let span_s = last.seconds_since(first);
                if span_s > 0.0 {
                    let rate = (known - 1) as f64 / span_s;
                    rate_hz = Some(rate_hz.map_or(rate, |other: f64| rate.max(other)));
                }
            }
            stream.dropped += unstamped as u64;
            if let Some((start, end)) = bounds {
                (stream.start, stream.end, stream.rate_hz) = (Some(start), Some(end), rate_hz);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::clock::{Alignment, Epoch, HeaderStamps};

    /// Two tables with the same stamps, rounded and aligned to the clock of others, in these files.
    fn clocks(files: [usize; 2]) -> StreamClocks {
        let alignment = Alignment { offset_nanos: 0, spread_s: 0.5, is_by_motion: false };
        let clock = |stream| StreamClock {
            stream,
            frame: None,
            clock: Clock::Header,
            stamps: HeaderStamps::Sound,
            rows: 100,
            zero: 0,
            begins_at_zero: false,
            valid_range: 0..=i64::MAX,
            out_of_range: 0,
            log_minus_header_s: None,
            soonest_s: None,
            epoch: Epoch::Foreign,
            alignment: Some(alignment),
        };
        let rounded = |stream| RoundedStamps {
            stream,
            tick_s: 0.01,
            shared_rows: 0,
            resolution_s: 0.001,
            is_of_table: true,
            file: Some(files[stream]),
            piece: 0,
            group: 0,
        };
        StreamClocks {
            all: vec![clock(0), clock(1)],
            index_of_part: vec![vec![0], vec![1]],
            rounded: vec![rounded(0), rounded(1)],
            ticks_s: HashMap::new(),
        }
    }

    #[test]
    fn the_error_of_rounding_excludes_that_of_the_alignment() {
        let clocks = clocks([1, 2]);
        assert!(clocks.rounding_error_s((0, 0), (1, 0)) < 0.001);
        assert!(clocks.alignment_error_s((0, 0), (1, 0)) > 0.5);
    }

    #[test]
    fn only_columns_of_one_table_share_their_times() {
        let error_s = |files| clocks(files).rounding_error_s((0, 0), (1, 0));
        assert_eq!(error_s([1, 1]), 0.0);
        assert!(error_s([1, 2]) > 0.0);
    }
}
