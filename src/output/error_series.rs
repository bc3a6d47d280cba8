//! Errors of a pose stream against FK and their limits, for plots in other programs.

use crate::checks::MDL001;
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::finding::Unit;
use crate::report::Report;
use crate::stats::thin;
use crate::time::Stamp;

/// Rows per stream, with the extremes of each interval.
const MAX_ROWS: usize = 4_000;

pub(super) struct ErrorSeries {
    pub rows: Vec<ErrorRow>,
    /// MDL001's warning threshold.
    pub position_limit_mm: Option<f64>,
    pub rotation_limit_deg: Option<f64>,
}

pub(super) struct ErrorRow {
    pub at: Stamp,
    /// `None` if the log does not connect the stream's frame to the arm.
    pub logged: Option<ErrorSize>,
    /// After correcting every finding.
    pub corrected: ErrorSize,
}

pub(super) struct ErrorSize {
    pub position_mm: f64,
    pub rotation_deg: f64,
}

impl ErrorSeries {
    pub fn new(stream: &StreamEvidence<PoseEvidence>, report: &Report, origin: Stamp) -> Self {
        let aligned = &stream.diagnosis.aligned;
        let (before, after) = (aligned.before(), aligned.after());
        let size =
            |m: f64, rad: f64| ErrorSize { position_mm: m * 1e3, rotation_deg: rad.to_degrees() };
        let row = |row: usize| ErrorRow {
            at: origin.shifted(aligned.t_s[row]),
            logged: stream.reference_known.then(|| size(before.m[row], before.rad[row])),
            corrected: size(after.m[row], after.rad[row]),
        };
        let series: [&[f64]; 4] = [&before.m, &before.rad, &after.m, &after.rad];
        let limit = |unit| report.warning_threshold(&MDL001, unit);
        Self {
            rows: thin::extreme_rows(&series, MAX_ROWS).into_iter().map(row).collect(),
            position_limit_mm: limit(Unit::Metre).map(|limit| limit * 1e3),
            rotation_limit_deg: limit(Unit::Radian).map(f64::to_degrees),
        }
    }
}
