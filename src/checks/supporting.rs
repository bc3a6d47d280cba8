//! Observations that support a finding of another rule.

use super::latency;
use super::stamps::tim003_foreign_clock::TIM003;
use crate::finding::{CheckRow, Finding, Status};

/// Whether the remark of a passed row is evidence for `finding`: messages that arrive before their own stamps,
/// for the latency of their topic.
pub(crate) fn supports(row: &CheckRow, finding: &Finding) -> bool {
    row.code == TIM003.code
        && row.status == Status::Pass
        && latency::FAMILY.rules.iter().any(|rule| rule.code == finding.code)
        && row.subject.topic.is_some()
        && row.subject.topic == finding.subject.topic
}
