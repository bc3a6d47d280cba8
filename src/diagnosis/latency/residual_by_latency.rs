//! Residual of a stream as a function of latency, around the estimate.

use crate::{PoseDiagnosis, PoseStream};
use ground::geometry::angle_between;
use ground::stream::JointTrack;

/// Residual at one latency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatencyResidual {
    /// s.
    pub latency_s: f64,
    /// Position residual, rms m.
    pub rms_m: f64,
    /// Rotation residual, rms rad.
    pub rms_rad: f64,
}

/// Residuals of `stream` against the corrected `joints`, at latencies around zero and the estimate in
/// `found`. Empty if no latency was estimated or too few samples have FK at all latencies.
pub fn residual_by_latency(
    joints: &JointTrack,
    stream: &PoseStream,
    found: &PoseDiagnosis,
) -> Vec<LatencyResidual> {
    const MAX_SAMPLES: usize = 400;
    const MIN_SAMPLES: usize = 20;
    let Ok(latency) = &found.latency_s else { return Vec::new() };
    let aligned = &found.aligned;
    let latencies_s = latencies_s(latency.value, latency.half_width(0.95));
    let skew = found.skew.as_ref().map_or(0.0, |skew| skew.value);
    let skew = if found.is_skew_chosen { skew } else { 0.0 };
    let middle_s = match aligned.t_s.as_slice() {
        [first, .., last] => 0.5 * (first + last),
        _ => 0.0,
    };
    let mut squares = vec![(0.0, 0.0); latencies_s.len()];
    let (mut compared, mut cursor) = (0, 0);
    let mut track = [vec![0.0; joints.dof], vec![0.0; joints.dof]];
    let mut q = vec![0.0; stream.columns.len()];
    let step = aligned.t_s.len().div_ceil(MAX_SAMPLES).max(1);
    for row in (0..aligned.t_s.len()).step_by(step) {
        let (stamp_s, corrected) = (aligned.t_s[row], &aligned.corrected[row]);
        let left: Option<Vec<(f64, f64)>> = latencies_s
            .iter()
            .map(|latency_s| {
                let truth_s = stamp_s - latency_s - skew * (stamp_s - middle_s);
                let [own, speeds] = &mut track;
                if !joints.at(truth_s, &mut cursor, own, speeds) {
                    return None;
                }
                q.iter_mut().zip(stream.columns).for_each(|(q, &column)| *q = own[column]);
                let fk = stream.chain.forward(&q);
                let apart_m = (fk.translation.vector - corrected.translation.vector).norm();
                Some((apart_m, angle_between(&fk.rotation, &corrected.rotation)))
            })
            .collect();
        let Some(left) = left else { continue };
        compared += 1;
        for (square, (m, rad)) in squares.iter_mut().zip(left) {
            *square = (square.0 + m * m, square.1 + rad * rad);
        }
    }
    if compared < MIN_SAMPLES {
        return Vec::new();
    }
    let rms = |square: f64| (square / compared as f64).sqrt();
    let valley = latencies_s.into_iter().zip(squares);
    valley
        .map(|(latency_s, (m, rad))| LatencyResidual {
            latency_s,
            rms_m: rms(m),
            rms_rad: rms(rad),
        })
        .collect()
}

/// Ascending, s. Extends beyond the estimate and zero; includes the estimate.
fn latencies_s(found_s: f64, half_width_s: f64) -> Vec<f64> {
    const STEPS: usize = 120;
    /// Beyond the estimate and zero.
    const MIN_MARGIN_S: f64 = 0.01;
    let beside_s = (0.6 * found_s.abs()).max(MIN_MARGIN_S).max(3.0 * half_width_s.min(1.0));
    let (low_s, high_s) = (found_s.min(0.0) - beside_s, found_s.max(0.0) + beside_s);
    let even = (0..=STEPS).map(|step| low_s + (high_s - low_s) * step as f64 / STEPS as f64);
    let mut latencies_s: Vec<f64> = even.chain([found_s]).collect();
    latencies_s.sort_by(f64::total_cmp);
    latencies_s.dedup();
    latencies_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latency_found_and_none_are_both_amid_those_tried() {
        for found_s in [-0.3, -1e-4, 0.0, 0.022, 1.7] {
            let tried = latencies_s(found_s, 1e-4);
            assert!(tried.is_sorted() && tried.contains(&found_s), "{found_s}: {tried:?}");
            let (first, last) = (tried[0], tried[tried.len() - 1]);
            assert!(first < found_s.min(0.0) && last > found_s.max(0.0), "{found_s}: {tried:?}");
        }
    }
}
