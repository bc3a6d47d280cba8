use super::corrections_file::rounded;
use crate::diagnosis::PoseEncoding;
use crate::evidence::RunEvidence;
use crate::finding::{Estimate, Finding, Unit};
use crate::geometry::Convention;
use crate::report::{Report, StreamRow};
use crate::run::Run;
use crate::stats::Measured;

pub(super) struct CorrectionContext<'a> {
    pub report: &'a Report,
    pub run: &'a Run,
    pub evidence: &'a RunEvidence,
}

impl CorrectionContext<'_> {
    pub fn stream_row(&self, topic: &str) -> Option<&StreamRow> {
        self.report.streams.iter().find(|row| row.topic == topic)
    }

    /// Topic of a finding, if it holds a single stream.
    pub fn single_topic(&self, finding: &Finding) -> Result<String, String> {
        let topic = finding.subject.topic.clone().ok_or_else(no_value)?;
        match self.report.has_shared_topic(finding) {
            false => Ok(topic),
            true => Err(format!(
                "{topic} holds several streams, which a correction cannot address separately"
            )),
        }
    }

    /// Whether messages of the topic name the frame whose poses they are.
    pub fn has_child_frame(&self, topic: &str) -> bool {
        let mut streams = self.run.streams.iter().filter(|stream| stream.topic == topic);
        streams.any(|stream| stream.logged_child_frame().is_some())
    }

    /// If several robots have a joint of this name.
    pub fn robot_of(&self, finding: &Finding, joint: &str) -> Option<String> {
        let arms =
            self.run.arms.iter().filter(|arm| arm.joint_names.iter().any(|own| own == joint));
        finding.subject.robot.clone().filter(|_| arms.count() > 1)
    }

    pub fn is_tf(&self, topic: &str) -> bool {
        self.stream_row(topic).is_some_and(|row| row.role == "tf")
    }

    pub fn convention_of_numbers(&self, topic: &str) -> Option<Convention> {
        let (_, stream) = self.evidence.poses().find(|(_, stream)| stream.topic() == topic)?;
        match stream.diagnosis.encoding.as_ref().ok()?.best {
            PoseEncoding::Numbers(convention) if stream.has_bare_numbers => Some(convention),
            _ => None,
        }
    }
}

pub(super) fn finding_label(finding: &Finding) -> String {
    match finding.subject.label() {
        "" => finding.code.to_owned(),
        on => format!("{} on {on}", finding.code),
    }
}

pub(super) fn no_value() -> String {
    "the finding has no value that can be applied".to_owned()
}

pub(super) fn value_with_interval(
    unit: Unit,
    found: &Measured,
) -> Result<(f64, Option<[f64; 2]>), String> {
    match found.value.is_finite() {
        true => Ok((rounded(found.value), unit.interval95(found).map(|ends| ends.map(rounded)))),
        false => Err(no_value()),
    }
}

pub(super) fn misinterpretation_text(finding: &Finding) -> Result<String, String> {
    match &finding.estimate {
        Some(Estimate::Misinterpretation { is, read_as, .. }) => {
            Ok(format!("{is} read as {read_as}"))
        }
        _ => Err(no_value()),
    }
}
