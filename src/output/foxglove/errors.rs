//! Errors of pose streams against FK as numbers, for plots.

use serde_json::json;

use super::{Message, time};
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::output::error_series::ErrorSeries;
use crate::report::Report;
use crate::time::Stamp;

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
    let series = ErrorSeries::new(stream, report, origin);
    let messages = series.rows.iter().map(|row| {
        let mut content = json!({
            "timestamp": time(row.at),
            "robot": robot,
            "corrected_position_mm": row.corrected.position_mm,
            "corrected_rotation_deg": row.corrected.rotation_deg,
            "position_limit_mm": series.position_limit_mm,
            "rotation_limit_deg": series.rotation_limit_deg,
        });
        if let Some(logged) = &row.logged {
            content["position_mm"] = json!(logged.position_mm);
            content["rotation_deg"] = json!(logged.rotation_deg);
        }
        let topic = error_topic(stream.topic());
        Message { topic, schema: super::ERROR_SCHEMA, at: row.at, content }
    });
    messages.collect()
}
