//! Joint velocities in a separate table, assigned to the joints whose table has the same stamps.

use std::collections::BTreeMap;

use super::{TableStream, names};
use crate::TableCell;
use crate::contents::TABLE;
use crate::decode::Format;
use crate::intake::Intake;
use ground::geometry::AngleUnit;
use ground::stats::median;
use ground::stream::{Columns, usable_or_nan};

/// Maximum difference between the stamps of velocities and positions, as a share of the step between rows.
const MAX_STAMP_DEVIATION: f64 = 0.1;

/// Rows of joint velocities.
#[derive(Debug, Default)]
pub(crate) struct Velocities {
    /// ns.
    pub stamps: Vec<i64>,
    pub values: Vec<f64>,
    pub width: usize,
    /// Default: the unit of the positions.
    pub unit: Option<AngleUnit>,
}

pub(super) struct VelocityFile {
    pub topic: String,
    pub kind: String,
    pub why: String,
    pub cells: Vec<TableCell>,
    pub velocities: Velocities,
    /// Receive times, ns.
    pub span: [u64; 2],
}

impl VelocityFile {
    /// Fills the velocities of its joints, or adds a topic that is not used.
    pub fn add_to(self, streams: &mut BTreeMap<String, TableStream>, intake: &mut Intake) {
        let mut why_not = "but no joint positions have the same name";
        if let Some(stream) = self.joints_topic(streams).and_then(|topic| streams.get_mut(&topic)) {
            match self.velocities.fill(&mut stream.columns) {
                Ok(()) => return intake.add_velocities(stream.channel, &self.topic, self.cells),
                Err(why) => why_not = why,
            }
        }
        let Self { topic, kind, why, cells, velocities, span } = self;
        let format = Format::without_schema(TABLE, &kind);
        let Some(channel) = intake.channel(&topic, format) else { return };
        intake.count(channel, velocities.stamps.len() as u64, (span[0], span[1]));
        intake.read_as(channel, format!("{why}, {why_not}"), cells, Vec::new());
    }

    /// Joints without velocities whose topic has the same words. Declared velocities have no words: they belong to
    /// the only joints with as many columns.
    fn joints_topic(&self, streams: &BTreeMap<String, TableStream>) -> Option<String> {
        let words = |topic: &str| names::shared_words(&names::split_words(topic));
        let fits = |stream: &TableStream| match &stream.columns {
            Columns::Joints(joints) => {
                joints.joints.len() == self.velocities.width
                    && joints.joints.iter().all(|it| it.velocity.iter().all(|v| v.is_nan()))
                    && stream.episodes.len() == 1
            }
            _ => false,
        };
        let all: Vec<&String> =
            streams.iter().filter(|(_, it)| fits(it)).map(|(topic, _)| topic).collect();
        let own = words(&self.topic);
        let mut named = all.iter().filter(|topic| words(topic) == own);
        match (named.next(), all.as_slice()) {
            (Some(topic), _) => Some((*topic).clone()),
            (None, [only]) if own.is_empty() => Some((*only).clone()),
            _ => None,
        }
    }
}

impl Velocities {
    /// # Errors
    /// If most rows have no velocities, or the numbers are desired positions.
    fn fill(&self, columns: &mut Columns) -> Result<(), &'static str> {
        let other_stamps = "but their stamps are not those of the joint positions";
        let Columns::Joints(joints) = columns else { return Err(other_stamps) };
        let rows = self.values.chunks_exact(self.width);
        let mut rows: Vec<(i64, &[f64])> = self.stamps.iter().copied().zip(rows).collect();
        rows.sort_by_key(|(stamp, _)| *stamp);
        let mut steps: Vec<f64> =
            rows.windows(2).map(|pair| pair[1].0.saturating_sub(pair[0].0) as f64).collect();
        let step_ns = median(&mut steps).ok_or(other_stamps)?;
        let tolerance_ns = (MAX_STAMP_DEVIATION * step_ns) as u64;
        let row_at = |stamp: &i64| {
            let after = rows.partition_point(|(own, _)| own < stamp);
            let near = [after.checked_sub(1), Some(after)].into_iter().flatten();
            let near = near.filter_map(|at| rows.get(at));
            let (own, row) = near.min_by_key(|(own, _)| own.abs_diff(*stamp))?;
            (own.abs_diff(*stamp) <= tolerance_ns).then_some(*row)
        };
        let found: Vec<Option<&[f64]>> = joints.times.header.iter().map(row_at).collect();
        if 2 * found.iter().flatten().count() < found.len() {
            return Err(other_stamps);
        }
        let degree = AngleUnit::Degree.in_rad();
        let of_positions = || match joints.conversions.first() {
            Some([factor, _]) => *factor,
            None if joints.converted_from_degrees => degree,
            None => 1.0,
        };
        let factor = self.unit.map_or_else(of_positions, |unit| unit.in_rad());
        let velocities = |at: usize| -> Vec<f64> {
            let value = |row: &Option<&[f64]>| row.map_or(f64::NAN, |row| row[at] * factor);
            found.iter().map(value).map(usable_or_nan).collect()
        };
        let velocities: Vec<Vec<f64>> = (0..joints.joints.len()).map(velocities).collect();
        let stamp = |row: usize| joints.times.header.get(row).copied();
        let pair = |at: usize, row: usize| [joints.joints[at].position[row], velocities[at][row]];
        if follow_positions(found.len(), velocities.len(), stamp, pair) {
            return Err("but they follow the joint positions, not their rates");
        }
        for (joint, own) in joints.joints.iter_mut().zip(velocities) {
            joint.velocity = own.into();
        }
        Ok(())
    }
}

/// Whether numbers are much closer to joint positions than to their rates in either unit of angles, as desired positions
/// are. `pair` returns the position of a joint in a row, and the number.
pub(super) fn follow_positions(
    rows: usize,
    joints: usize,
    stamp: impl Fn(usize) -> Option<i64>,
    pair: impl Fn(usize, usize) -> [f64; 2],
) -> bool {
    const MAX_DISTANCE_RATIO: f64 = 0.5;
    let (mut to_positions, mut to_rates, mut to_radians) = (0.0, 0.0, 0.0);
    for row in 1..rows.saturating_sub(1) {
        let (Some(before), Some(after)) = (stamp(row - 1), stamp(row + 1)) else { continue };
        let step_s = after.saturating_sub(before) as f64 * 1e-9;
        for joint in 0..joints {
            let [[before, _], [position, number], [after, _]] =
                [row - 1, row, row + 1].map(|row| pair(joint, row));
            let rate = (after - before) / step_s;
            if step_s > 0.0 && rate.is_finite() && position.is_finite() && number.is_finite() {
                to_positions += (number - position).powi(2);
                to_rates += (number - rate).powi(2);
                to_radians += (number - rate.to_radians()).powi(2);
            }
        }
    }
    to_positions < MAX_DISTANCE_RATIO * MAX_DISTANCE_RATIO * f64::min(to_rates, to_radians)
}
