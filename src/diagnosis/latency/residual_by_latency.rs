//! Residual of a stream as a function of latency, around the estimate.

use crate::samples::sampling::FkSequence;
use crate::{PoseDiagnosis, PoseStream};
use ground::geometry::Vec3;
use ground::stats::mean;
use ground::stats::thin::thinned;
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
/// `diagnosis`. Empty if no latency was estimated or too few samples have FK at all latencies.
pub fn residual_by_latency(
    joints: &JointTrack,
    stream: &PoseStream,
    diagnosis: &PoseDiagnosis,
) -> Vec<LatencyResidual> {
    const MAX_SAMPLES: usize = 400;
    const MIN_SAMPLES: usize = 20;
    let Ok(latency) = &diagnosis.latency_s else { return Vec::new() };
    let aligned = &diagnosis.aligned;
    let latencies_s = latencies_s(latency.value, latency.half_width(0.95));
    let (skew, middle_s) = (diagnosis.chosen_skew(), aligned.middle_s());
    let mut sequence = FkSequence::new(joints, stream.chain, stream.columns);
    let of_row = |row: usize| -> Option<Vec<[Vec3; 2]>> {
        let stamp_s = aligned.t_s[row];
        let residual = |latency_s: &f64| {
            let fk = sequence.at(stamp_s - latency_s - skew * (stamp_s - middle_s))?;
            Some(aligned.residual(row, &fk))
        };
        latencies_s.iter().map(residual).collect()
    };
    let rows: Vec<_> = thinned(0..aligned.t_s.len(), MAX_SAMPLES).filter_map(of_row).collect();
    if rows.len() < MIN_SAMPLES {
        return Vec::new();
    }
    let at_latency = |(at, &latency_s): (usize, &f64)| {
        let rms = |kind: usize| mean(rows.iter().map(|row| row[at][kind].norm_squared())).sqrt();
        LatencyResidual { latency_s, rms_m: rms(0), rms_rad: rms(1) }
    };
    latencies_s.iter().enumerate().map(at_latency).collect()
}

/// Ascending, s. Extends beyond the estimate and zero; includes the estimate.
fn latencies_s(estimate_s: f64, half_width_s: f64) -> Vec<f64> {
    const STEPS: usize = 120;
    /// Beyond the estimate and zero.
    const MIN_MARGIN_S: f64 = 0.01;
    let margin_s = (0.6 * estimate_s.abs()).max(MIN_MARGIN_S).max(3.0 * half_width_s.min(1.0));
    let (low_s, high_s) = (estimate_s.min(0.0) - margin_s, estimate_s.max(0.0) + margin_s);
    let even = (0..=STEPS).map(|step| low_s + (high_s - low_s) * step as f64 / STEPS as f64);
    let mut latencies_s: Vec<f64> = even.chain([estimate_s]).collect();
    latencies_s.sort_by(f64::total_cmp);
    latencies_s.dedup();
    latencies_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_and_zero_are_inside_the_latency_range() {
        for estimate_s in [-0.3, -1e-4, 0.0, 0.022, 1.7] {
            let tried = latencies_s(estimate_s, 1e-4);
            assert!(tried.is_sorted() && tried.contains(&estimate_s), "{estimate_s}: {tried:?}");
            let (first, last) = (tried[0], tried[tried.len() - 1]);
            assert!(
                first < estimate_s.min(0.0) && last > estimate_s.max(0.0),
                "{estimate_s}: {tried:?}"
            );
        }
    }
}
