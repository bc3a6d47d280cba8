//! Seams: another recording follows in a table without times, or rows are missing.
//!
//! The stamps are generated, so the joints jump within one row, and that looks like a motion.

use std::ops::Range;

use crate::log::{Log, Topic};
use crate::stats::quantile;
use crate::stream::{Columns, JointColumn, JointColumns};

/// Receive times of the rows before and after each seam, in the order of the rows.
pub(super) fn seams(log: &Log) -> Vec<[i64; 2]> {
    let has_generated_stamps = |topic: &&Topic| {
        let mut tables = topic.cells.iter().filter_map(|cell| log.tables.get(cell.table));
        tables.any(|table| table.lacks_times || table.rate_hz.is_some())
    };
    let joints = log.topics.iter().filter(has_generated_stamps);
    let joints = joints.filter_map(|topic| match &topic.columns {
        Some(Columns::Joints(joints)) => Some(joints),
        _ => None,
    });
    joints.map(seams_of_joints).max_by_key(Vec::len).unwrap_or_default()
}

/// Half of the moving joints jump at a seam, at least two, and both parts are recordings. After rows that repeat exactly, a
/// driver that had stopped continues.
fn seams_of_joints(joints: &JointColumns) -> Vec<[i64; 2]> {
    let rows = joints.times.len();
    let mut jumping = vec![0_usize; rows];
    let mut moving = 0;
    for joint in &joints.joints {
        if let Some(jumps) = jumps(joint) {
            moving += 1;
            jumps.into_iter().for_each(|row| jumping[row] += 1);
        }
    }
    let repeats = |row: usize| {
        let mut joints = joints.joints.iter();
        joints.all(|joint| joint.position[row] == joint.position[row - 1])
    };
    // Samples of another kind, such as zeros, may take the place of a few rows.
    let is_recording = |part: Range<usize>| {
        part.len() >= MIN_STEPS && (part.start + 1..part.end).any(|row| !repeats(row))
    };
    let jumps: Vec<usize> = (1..rows).filter(|row| jumping[*row] >= 2.max(moving / 2)).collect();
    let is_seam = |at: &usize| {
        let row = jumps[*at];
        let before = at.checked_sub(1).map_or(0, |before| jumps[before])..row;
        let after = row..jumps.get(at + 1).copied().unwrap_or(rows);
        !repeats(row - 1) && is_recording(before) && is_recording(after)
    };
    let received = &joints.times.log;
    let seams = (0..jumps.len()).filter(is_seam).map(|at| jumps[at]);
    seams.map(|row| [received[row - 1], received[row]]).collect()
}

/// Rows of a recording, and steps of a motion; not calibrated, as the ratios below.
const MIN_STEPS: usize = 50;

/// The row after each jump of a joint. `None` if it moves little.
fn jumps(joint: &JointColumn) -> Option<Vec<usize>> {
    /// Of the steps of a motion.
    const USUAL_QUANTILE: f64 = 0.99;
    /// To the usual step. A seam joins any two positions.
    const MIN_RATIO: f64 = 10.0;
    /// To the steps before and after. Fast motion accelerates over several rows.
    const MIN_RATIO_TO_NEIGHBOURS: f64 = 4.0;
    let steps: Vec<f64> = joint.position.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let mut moved: Vec<f64> = steps.iter().copied().filter(|step| *step > 0.0).collect();
    if moved.len() < MIN_STEPS {
        return None;
    }
    let usual = quantile(&mut moved, USUAL_QUANTILE)?;
    let is_jump = |at: &usize| {
        let (step, near) = (steps[*at], steps[at - 1].max(steps[at + 1]));
        step > MIN_RATIO * usual && step > MIN_RATIO_TO_NEIGHBOURS * near
    };
    Some((1..steps.len() - 1).filter(is_jump).map(|at| at + 1).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two joints at 100 Hz, with these positions of a row.
    fn joints(rows: i64, position: impl Fn(f64) -> [f64; 2]) -> JointColumns {
        let mut joints = JointColumns::default();
        let rows: Vec<[f64; 2]> = (0..rows)
            .map(|row| {
                joints.times.push(row * 10_000_000, row * 10_000_000, 0);
                position(row as f64 * 0.01)
            })
            .collect();
        let joint = |at: usize| {
            let positions = rows.iter().map(|row| row[at]).collect();
            JointColumn::from_positions(format!("q{at}"), positions)
        };
        joints.joints = vec![joint(0), joint(1)];
        joints
    }

    fn motion(t_s: f64) -> [f64; 2] {
        [(0.8 * t_s).sin(), 0.5 * (1.3 * t_s).cos()]
    }

    #[test]
    fn two_recordings_in_one_table_have_one_seam() {
        let glued = |t_s: f64| if t_s < 7.995 { motion(t_s) } else { motion(t_s + 1.7) };
        let row = |row: i64| row * 10_000_000;
        assert_eq!(seams_of_joints(&joints(1500, glued)), [[row(799), row(800)]]);
    }

    #[test]
    fn one_recording_has_none() {
        assert_eq!(seams_of_joints(&joints(600, motion)), [[0; 2]; 0]);
        // A lost zero, and a spike.
        let stepped = |t_s: f64| [motion(t_s)[0], motion(t_s)[1] + f64::from(t_s > 3.0)];
        assert_eq!(seams_of_joints(&joints(600, stepped)), [[0; 2]; 0]);
        let stopped = |t_s: f64| motion(if (2.0..4.0).contains(&t_s) { 2.0 } else { t_s });
        assert_eq!(seams_of_joints(&joints(600, stopped)), [[0; 2]; 0]);
        // Zeros in the place of a few samples, and of many.
        for end_s in [3.2, 5.0] {
            let lost = |t_s: f64| if (3.0..end_s).contains(&t_s) { [0.0; 2] } else { motion(t_s) };
            assert_eq!(seams_of_joints(&joints(600, lost)), [[0; 2]; 0]);
        }
        let spiked = |t_s: f64| motion(t_s).map(|q| if t_s == 3.0 { q + 1.0 } else { q });
        assert_eq!(seams_of_joints(&joints(600, spiked)), [[0; 2]; 0]);
    }
}
