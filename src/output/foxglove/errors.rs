//! Errors of pose streams against FK as numbers, for plots.

use serde_json::json;

use super::{Message, time};
use crate::checks::MDL001;
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::finding::Unit;
use crate::report::Report;
use crate::stats::thin;
use crate::time::Stamp;

/// Messages per stream, with the extremes of each interval.
const MAX_MESSAGES: usize = 4_000;

/// Topic of a stream's errors: `/poseaudit/error/tcp/pose`.
pub fn error_topic(topic: &str) -> String {
    format!("/poseaudit/error/{}", topic.trim_start_matches('/'))
}

/// Without the logged errors if the log does not connect the stream's frame to the arm.
pub fn error_messages(
    robot: &str,
    stream: &StreamEvidence<PoseEvidence>,
    report: &Report,
    origin: Stamp,
) -> Vec<Message> {
    let aligned = &stream.diagnosis.aligned;
    let (before, after) = (aligned.before(), aligned.after());
    let limit = |unit| report.warning_threshold(&MDL001, unit);
    let position_limit_mm = limit(Unit::Metre).map(|limit| limit * 1e3);
    let rotation_limit_deg = limit(Unit::Radian).map(f64::to_degrees);
    let message = |row: usize| {
        let at = origin.shifted(aligned.t_s[row]);
        let mut content = json!({
            "timestamp": time(at),
            "robot": robot,
            "corrected_position_mm": after.m[row] * 1e3,
            "corrected_rotation_deg": after.rad[row].to_degrees(),
            "position_limit_mm": position_limit_mm,
            "rotation_limit_deg": rotation_limit_deg,
        });
        if stream.reference_known {
            content["position_mm"] = json!(before.m[row] * 1e3);
            content["rotation_deg"] = json!(before.rad[row].to_degrees());
        }
        Message { topic: error_topic(stream.topic()), schema: super::ERROR_SCHEMA, at, content }
    };
    let series: [&[f64]; 4] = [&before.m, &before.rad, &after.m, &after.rad];
    thin::extreme_rows(&series, MAX_MESSAGES).into_iter().map(message).collect()
}
