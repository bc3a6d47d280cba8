//! Slow samples used to determine the encoding of the joints.

use super::comparison::JointComparison;
use super::interpreted_poses::InterpretedPoses;
use crate::latency::correlation::combined_speed;
use crate::samples::sampling::{as_rotations, range_of};
use ground::stats::mean;
use ground::stream::JointTrack;

pub(super) const JOINT_ENCODING_SAMPLES: usize = 60;

/// Bounded below to allow division.
pub(super) fn rms_speeds(joints: &JointTrack) -> Vec<f64> {
    let square = |joint: usize| mean(joints.velocities_of(joint).map(|speed| speed * speed));
    (0..joints.dof).map(|joint| square(joint).sqrt().max(1e-4)).collect()
}

impl<'a> JointComparison<'a> {
    /// Spread over the run, see [`slow_rows`].
    pub(super) fn samples(&self, lag_s: f64) -> InterpretedPoses<'a> {
        let Self { joints, stream, metres, .. } = *self;
        let track = stream.track;
        let mut sequence = joints.sequence();
        let rms = rms_speeds(joints);
        let mut covered: Vec<(usize, f64, Vec<f64>)> = Vec::new();
        for (k, t_s) in track.t_s.iter().enumerate() {
            if let Some((q, qd)) = sequence.at(t_s - lag_s) {
                let speed = combined_speed(qd, &rms);
                covered.push((k, speed, stream.columns.iter().map(|&c| q[c]).collect()));
            }
        }
        let speeds: Vec<f64> = covered.iter().map(|(_, speed, _)| *speed).collect();
        let slow = slow_rows(&speeds);
        let rows = || slow.iter().map(|&at| covered[at].0);
        let xyz = rows().map(|row| track.xyz[row] * metres).collect();
        let rotation =
            as_rotations(&track.orientation).map(|all| rows().map(|row| all[row]).collect());
        let q = slow.iter().flat_map(|&at| &covered[at].2).copied().collect();
        let span = |&column: &usize| range_of(joints.positions_of(column));
        let spans = stream.columns.iter().map(span).collect();
        InterpretedPoses::new(stream.chain, xyz, rotation, q, spans)
    }
}

/// Rows of slow samples, ascending. The run is divided into stretches, equally by time and by path, so an arm that
/// dwells in one place is also seen elsewhere. The slowest row of each stretch is taken, and of these the slower
/// half.
fn slow_rows(speeds: &[f64]) -> Vec<usize> {
    const STRETCHES: f64 = 2.0 * JOINT_ENCODING_SAMPLES as f64;
    let total: f64 = speeds.iter().sum();
    let mean = (total / speeds.len().max(1) as f64).max(f64::MIN_POSITIVE);
    let length = total + mean * speeds.len() as f64;
    let mut reached = 0.0;
    let stretches = speeds.iter().map(|speed| {
        reached += speed + mean;
        (STRETCHES * reached / length) as usize
    });
    let rows: Vec<(usize, usize)> = stretches.enumerate().collect();
    let slower = |a: &usize, b: &usize| speeds[*a].total_cmp(&speeds[*b]);
    let slowest = rows.chunk_by(|a, b| a.1 == b.1);
    let mut slow: Vec<usize> =
        slowest.filter_map(|stretch| stretch.iter().map(|(row, _)| *row).min_by(slower)).collect();
    slow.sort_by(slower);
    slow.truncate(slow.len().div_ceil(2));
    slow.sort_unstable();
    slow
}
