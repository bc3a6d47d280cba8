//! Tables of one run whose clocks start at different times, such as 0 in one file and 1970 in another. Without common
//! times, clocks start at different times as well.
//!
//! The speeds of joints and tool agree best at the offset of their clocks. Delays between such tables remain unknown.

use crate::diagnosis::{LagPeak, PoseStream, candidate_lags};
use crate::geometry::Vec3;
use crate::log::{Log, Note, Topic};
use crate::robot::Chain;
use crate::stats::thin::thinned;
use crate::stream::{Columns, JointColumns, JointTrack, Orientations, PoseTrack, Times};
use crate::time::{Stamp, nanos, seconds};

use super::RunOptions;
use super::columns::{ArmModel, candidate_arms};
use super::error::RunError;
use super::role::{Role, role_by_content, role_outside_arm};

/// Clocks with the same epoch differ by less: 3 years, s.
const MIN_EPOCH_DIFFERENCE_S: f64 = 1e8;
/// Correlation of the speeds of joints and tool at the offset.
const MIN_CORRELATION: f64 = 0.8;
/// Largest correlation at another offset, relative to the best, and the distance of other offsets, s.
const MAX_COMPETITOR_SHARE: f64 = 0.95;
const MIN_COMPETITOR_DISTANCE_S: f64 = 1.0;
const MAX_ROWS: usize = 20_000;

/// Topics on one clock.
struct ClockGroup {
    topics: Vec<usize>,
    span: (i64, i64),
}

impl ClockGroup {
    fn overlaps(&self, other: &Self) -> bool {
        self.span.0 <= other.span.1 && other.span.0 <= self.span.1
    }
}

/// Aligns tables with different time origins by motion.
///
/// # Errors
/// If the motion does not show the offset.
pub fn align_table_clocks(log: &mut Log, options: &RunOptions) -> Result<(), RunError> {
    if log.files.len() < 2 || !log.topics.iter().all(Topic::is_from_table) {
        return Ok(());
    }
    let groups = clock_groups(&log.topics);
    let is_state = |topic: &Topic| {
        let columns = topic.columns.as_ref();
        columns.is_some_and(|it| {
            matches!(it, Columns::Joints(_))
                && role_by_content(&topic.name, it).map(|(role, _)| role) == Some(Role::Joints)
        })
    };
    let with_joints =
        |group: &&ClockGroup| group.topics.iter().any(|&at| is_state(&log.topics[at]));
    let Some(reference) = groups.iter().find(with_joints) else { return Ok(()) };
    let joints = reference.topics.iter().copied().find(|&at| is_state(&log.topics[at]));
    let Some(joints) = joints else { return Ok(()) };
    let mut offsets: Vec<(Vec<usize>, i64)> = Vec::new();
    for group in &groups {
        let apart_s = seconds(group.span.0.saturating_sub(reference.span.0)).abs();
        let (is_same_epoch, overlap) =
            (apart_s < MIN_EPOCH_DIFFERENCE_S, group.overlaps(reference));
        if is_same_epoch && overlap {
            continue;
        }
        let (topic, offset) = match group_offset(log, options, joints, group) {
            Ok(found) => found,
            // Recordings of one clock may follow each other.
            Err(_) if is_same_epoch => continue,
            Err(refusal) => return Err(refusal),
        };
        let what = format!(
            "'{}' begins at {} and '{}' at {}, so their clocks differ: aligned by motion, and delays between them \
             are unknown",
            log.topics[topic].name,
            shown(group.span.0),
            log.topics[joints].name,
            shown(reference.span.0),
        );
        let file = log.files.first().map(|file| file.path.clone()).unwrap_or_default();
        log.notes.push(Note { file, what });
        offsets.push((group.topics.clone(), offset));
    }
    for (topics, offset) in offsets {
        for at in topics {
            shift_receive_times(&mut log.topics[at], offset);
        }
    }
    let spans = log.topics.iter().filter_map(|topic| topic.span);
    log.span = spans.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    Ok(())
}

fn shown(nanos: i64) -> String {
    format!("{:.3} s", seconds(nanos))
}

/// Sets receive times on the clock of the joints. The stream's stamps then belong to another clock.
fn shift_receive_times(topic: &mut Topic, offset: i64) {
    for times in topic.columns.as_mut().map(Columns::times_mut).into_iter().flatten() {
        let stamps = times.header.iter();
        times.log = stamps.map(|stamp| stamp.saturating_add(offset)).collect();
    }
    topic.is_aligned_by_motion = true;
    let shift = |stamp: Stamp| Stamp::from_nanos(stamp.nanos().saturating_add(offset));
    topic.span = topic.span.map(|(first, last)| (shift(first), shift(last)));
}

/// Topics whose spans of stamps have the same epoch.
fn clock_groups(topics: &[Topic]) -> Vec<ClockGroup> {
    let mut groups: Vec<ClockGroup> = Vec::new();
    for (at, topic) in topics.iter().enumerate() {
        let times = topic.columns.as_ref().map(Columns::times).unwrap_or_default();
        let stamps = || times.iter().flat_map(|times| &times.header).copied();
        let (Some(first), Some(last)) = (stamps().min(), stamps().max()) else { continue };
        let own = ClockGroup { topics: vec![at], span: (first, last) };
        let is_near = |group: &&mut ClockGroup| {
            let apart_s = seconds(group.span.0.saturating_sub(first)).abs();
            apart_s < MIN_EPOCH_DIFFERENCE_S && group.overlaps(&own)
        };
        match groups.iter_mut().find(is_near) {
            Some(group) => {
                group.topics.push(at);
                group.span = (group.span.0.min(first), group.span.1.max(last));
            }
            None => groups.push(own),
        }
    }
    groups
}

/// A pose of the group, and the offset from the group's clock to the joints' clock, ns.
fn group_offset(
    log: &Log,
    options: &RunOptions,
    joints: usize,
    group: &ClockGroup,
) -> Result<(usize, i64), RunError> {
    let first = group.topics.first().copied().unwrap_or_default();
    let refuse = |why: &str| {
        let (own, other) = (&log.topics[first].name, &log.topics[joints].name);
        RunError::TimeOrigins {
            what: format!(
                "'{own}' begins at {}, '{other}' at another time origin, and {why}",
                shown(group.span.0)
            ),
        }
    };
    let positions = group.topics.iter().find_map(|&at| {
        let topic = &log.topics[at];
        let is_measured = role_outside_arm(&topic.name) == Role::Unassigned;
        let track = position_track(topic.columns.as_ref()?).filter(|_| is_measured)?;
        Some((at, track))
    });
    let Some((pose, (origin, track))) = positions else {
        return Err(refuse("it holds no tool positions to compare with the joints"));
    };
    let Some(Columns::Joints(columns)) = &log.topics[joints].columns else {
        return Err(refuse("the log lacks joint states"));
    };
    let (joint_origin, joint_track) = joint_track(columns);
    let span_s = |t_s: &[f64]| t_s.last().copied().unwrap_or_default();
    let max_lag_s = span_s(&track.t_s).max(span_s(&joint_track.t_s));
    let mut best: Option<Vec<LagPeak>> = None;
    for ArmModel { chain, .. } in candidate_arms(options, log.robot_type.as_deref(), None) {
        let Some(order) = joint_order(&chain, columns) else { continue };
        let stream =
            PoseStream { reference_known: false, ..PoseStream::new(&track, &chain, &order) };
        let peaks = candidate_lags(&joint_track, &stream, max_lag_s);
        let height = |peaks: &[LagPeak]| peaks.first().map_or(f64::MIN, |peak| peak.correlation);
        if best.as_deref().is_none_or(|best| height(best) < height(&peaks)) {
            best = Some(peaks);
        }
    }
    let peaks = best.unwrap_or_default();
    let top = peaks.first().filter(|peak| peak.correlation >= MIN_CORRELATION);
    let Some(top) = top else {
        return Err(refuse("no offset makes the tool move as the joints do"));
    };
    let is_rival = |peak: &LagPeak| {
        (peak.lag_s - top.lag_s).abs() > MIN_COMPETITOR_DISTANCE_S
            && peak.correlation > MAX_COMPETITOR_SHARE * top.correlation
    };
    if peaks.iter().any(is_rival) {
        return Err(refuse("the motion repeats, so several offsets fit"));
    }
    Ok((pose, joint_origin.saturating_sub(origin).saturating_sub(nanos(top.lag_s))))
}

/// Columns of the chain's joints, by name, or in order if the names are generated.
fn joint_order(chain: &Chain, columns: &JointColumns) -> Option<Vec<usize>> {
    let names = chain.joint_names();
    let place =
        |name: &String| columns.joints.iter().position(|joint| joint.name.ends_with(name.as_str()));
    let by_name: Option<Vec<usize>> = names.iter().map(place).collect();
    let in_order = || (columns.joints.len() == names.len()).then(|| (0..names.len()).collect());
    by_name.or_else(in_order)
}

/// Rows at increasing times, with times from the first one, s.
fn rows_of(times: &Times) -> (i64, Vec<usize>, Vec<f64>) {
    let origin = times.header.first().copied().unwrap_or_default();
    let (mut rows, mut t_s) = (Vec::new(), Vec::new());
    for (row, stamp) in thinned(times.header.iter().enumerate(), MAX_ROWS) {
        let at_s = seconds(stamp.saturating_sub(origin));
        if t_s.last().is_none_or(|last| at_s > *last) {
            rows.push(row);
            t_s.push(at_s);
        }
    }
    (origin, rows, t_s)
}

fn joint_track(columns: &JointColumns) -> (i64, JointTrack) {
    let (origin, rows, t_s) = rows_of(&columns.times);
    let is_whole = |row: usize| columns.joints.iter().all(|it| it.position[row].is_finite());
    let (rows, t_s): (Vec<usize>, Vec<f64>) =
        rows.into_iter().zip(t_s).filter(|(row, _)| is_whole(*row)).unzip();
    let dof = columns.joints.len();
    let position = |at: usize, joint: usize| columns.joints[joint].position[rows[at]];
    let last = rows.len().saturating_sub(1);
    let (mut q, mut qd) = (Vec::new(), Vec::new());
    for at in 0..rows.len() {
        let (before, after) = (at.saturating_sub(1), (at + 1).min(last));
        let step_s = (t_s[after] - t_s[before]).max(f64::MIN_POSITIVE);
        for joint in 0..dof {
            q.push(position(at, joint));
            qd.push((position(after, joint) - position(before, joint)) / step_s);
        }
    }
    (origin, JointTrack { t_s, dof, q, qd, noise: Vec::new() })
}

fn position_track(columns: &Columns) -> Option<(i64, PoseTrack)> {
    let (times, at): (&Times, Box<dyn Fn(usize) -> Vec3>) = match columns {
        Columns::Poses(poses) => {
            let [poses] = poses.as_slice() else { return None };
            (&poses.times, Box::new(|row| Vec3::from(poses.xyz[row])))
        }
        Columns::Array(array) if array.width >= 3 && !array.unnamed => {
            let xyz = |row: usize| Vec3::from_column_slice(&array.row(row)[..3]);
            (&array.times, Box::new(xyz))
        }
        _ => return None,
    };
    let (origin, rows, t_s) = rows_of(times);
    let xyz: Vec<Vec3> = rows.iter().map(|&row| at(row)).collect();
    let orientation = Orientations::Unset(xyz.len());
    (xyz.len() > 1).then_some((origin, PoseTrack { t_s, xyz, orientation, declared: None }))
}
