//! Findings of one cause on several subjects, as one block.

use std::collections::BTreeSet;

use super::{Outline, list_names};
use crate::checks;
use crate::finding::{Alternative, Cause, Estimate, Finding, Severity, Subject, Unit};

/// Statements that a block lists.
const MAX_LISTED: usize = 4;

/// Label of the recommended action.
pub(crate) const FIX: &str = "fix";

/// Replaces the name of a subject in a text that holds for several.
const EACH: &str = "each";

/// Findings with the same rule, severity and fix.
pub(crate) struct FindingGroup<'a> {
    /// In the order of the report; never empty.
    pub findings: Vec<&'a Finding>,
}

/// Labelled line below a finding.
pub(crate) struct FindingNote {
    pub label: &'static str,
    pub text: String,
}

impl FindingNote {
    fn new(label: &'static str, text: impl Into<String>) -> Self {
        Self { label, text: text.into() }
    }
}

impl FindingGroup<'_> {
    pub fn severity(&self) -> Severity {
        self.findings[0].severity
    }
}

impl<'a> Outline<'a> {
    /// In the order of their first findings.
    pub fn finding_groups(&self) -> Vec<FindingGroup<'a>> {
        let mut groups: Vec<(String, FindingGroup)> = Vec::new();
        for finding in &self.report.findings {
            let fix = without_subject(finding, &finding.fix);
            let is_same = |(known_fix, group): &&mut (String, FindingGroup)| {
                let first = group.findings[0];
                (first.code, first.severity, first.title)
                    == (finding.code, finding.severity, finding.title)
                    && *known_fix == fix
            };
            match groups.iter_mut().find(is_same) {
                Some((_, group)) => group.findings.push(finding),
                None => groups.push((fix, FindingGroup { findings: vec![finding] })),
            }
        }
        groups.into_iter().map(|(_, group)| group).collect()
    }

    /// Subjects and statement. Subjects with different values follow in [`Outline::group_lines`].
    pub fn group_title(&self, group: &FindingGroup) -> (String, String) {
        let first = group.findings[0];
        match self.common_message(group) {
            Some(message) => (self.group_subjects(group), message),
            None => {
                // One subject has a finding per segment.
                let subjects = group.findings.iter().map(|finding| &finding.subject);
                let names: BTreeSet<String> =
                    subjects.clone().map(|subject| self.subject(subject)).collect();
                let named = match names.len() {
                    1 => self.subject(&first.subject),
                    count => format!("{count} {}", plural_kind(subjects)),
                };
                (named, first.title.to_owned())
            }
        }
    }

    /// Statement on each subject, if they differ, and the number of subjects that are not listed.
    pub fn group_lines(&self, group: &FindingGroup) -> (Vec<(String, String)>, usize) {
        if self.common_message(group).is_some() {
            return (Vec::new(), 0);
        }
        let lines = group.findings.iter().take(MAX_LISTED);
        let lines = lines.map(|finding| {
            let label = self.subject(&finding.subject);
            let is_alike = |other: &&&Finding| self.subject(&other.subject) == label;
            let are_several = group.findings.iter().filter(is_alike).count() > 1;
            let frame =
                finding.subject.frame.as_ref().filter(|frame| are_several && **frame != label);
            let label = frame.map_or_else(|| label.clone(), |frame| format!("{label} {frame}"));
            (label, finding.message.clone())
        });
        (lines.collect(), group.findings.len().saturating_sub(MAX_LISTED))
    }

    /// Notes and fix of the whole group, with the effect on the worst subject.
    pub fn group_notes(&self, group: &FindingGroup) -> Vec<FindingNote> {
        let worst = group.findings[0];
        let mut notes = self.finding_notes(worst);
        let fix = match group.findings.len() {
            1 => worst.fix.clone(),
            _ => without_subject(worst, &worst.fix),
        };
        notes.push(FindingNote::new(FIX, fix));
        notes
    }

    /// `None` if the findings have different values.
    fn common_message(&self, group: &FindingGroup) -> Option<String> {
        let [first, others @ ..] = group.findings.as_slice() else { return None };
        let message = match others {
            [] => return Some(first.message.clone()),
            _ => without_subject(first, &first.message),
        };
        let is_same = |other: &&Finding| without_subject(other, &other.message) == message;
        others.iter().all(is_same).then_some(message)
    }

    fn group_subjects(&self, group: &FindingGroup) -> String {
        let names = group.findings.iter().map(|finding| self.subject(&finding.subject));
        list_names(&names.collect::<Vec<_>>())
    }

    /// Effect of the fault, error on held-out samples, observations that support it, meaning of the value, and confounders.
    pub fn finding_notes(&self, finding: &Finding) -> Vec<FindingNote> {
        let evidence = &finding.evidence;
        // For a misinterpretation it is the residual of the right encoding.
        let has_value = finding.estimate.as_ref().and_then(Estimate::value).is_some();
        let label = if has_value && evidence.effect_m.is_some() { "impact" } else { "note" };
        let effect = evidence.effect.iter().map(|effect| FindingNote::new(label, effect));
        let meaning = evidence.more.get("meaning").and_then(|it| it.as_str());
        let observations = self.report.checks.iter().filter(|row| checks::supports(row, finding));
        let observations = observations.filter_map(|row| row.reason.as_deref());
        let notes = observations.chain(meaning).map(|note| FindingNote::new("note", note));
        let others = self.confounder_text(&evidence.indistinguishable);
        let tested = held_out_text(finding).map(|text| FindingNote::new("tested", text));
        effect
            .chain(tested)
            .chain(notes)
            .chain(others.map(|others| FindingNote::new("or", others)))
            .collect()
    }

    /// [`Outline::finding_notes`] without labels.
    pub fn finding_lines(&self, finding: &Finding) -> Vec<String> {
        self.finding_notes(finding).into_iter().map(|note| note.text).collect()
    }

    fn confounder_text(&self, others: &[Alternative]) -> Option<String> {
        // Streams that share a fault are one alternative.
        let mut groups: Vec<(&str, String, Vec<String>)> = Vec::new();
        for other in others {
            let (amount, subject) = (alternative_amount(other), self.subject(&other.subject));
            match groups.iter_mut().find(|group| (group.0, &group.1) == (other.code, &amount)) {
                Some((_, _, subjects)) => subjects.push(subject),
                None => groups.push((other.code, amount, vec![subject])),
            }
        }
        let named = groups.into_iter().map(|(code, amount, subjects)| {
            let name =
                checks::find(code).map_or_else(|_| code.to_owned(), checks::Rule::plain_name);
            format!("{name} of {}{amount} ({code})", list_names(&subjects))
        });
        let named: Vec<String> = named.collect();
        (!named.is_empty())
            .then(|| format!("{}, would explain this log as well", named.join(", or ")))
    }
}

/// `joints`, `topics` or `subjects`.
pub(super) fn plural_kind<'a>(subjects: impl Iterator<Item = &'a Subject> + Clone) -> &'static str {
    if subjects.clone().all(|subject| subject.joint.is_some()) {
        "joints"
    } else if subjects.clone().all(|subject| subject.topic.is_some()) {
        "topics"
    } else {
        "subjects"
    }
}

/// Error on samples that were not fitted, without and with the correction. Numbers without a declared encoding have no
/// error without it.
fn held_out_text(finding: &Finding) -> Option<String> {
    let residual = finding.evidence.more.get(checks::HELD_OUT)?;
    let shown = |of: &str| {
        let number = |unit: &str| residual[of][unit].as_f64();
        Some(format!(
            "{} and {}",
            Unit::Metre.show(number("m")?),
            Unit::Radian.show(number("rad")?)
        ))
    };
    let after = shown("after")?;
    let error = match finding.cause {
        Cause::InferredEncoding { .. } => format!("is {after}"),
        _ => {
            let is_larger = |unit: &str| {
                let [before, after] = ["before", "after"].map(|of| residual[of][unit].as_f64());
                after > before
            };
            let verb = if is_larger("m") || is_larger("rad") { "changes" } else { "falls" };
            format!("{verb} from {} to {after}", shown("before")?)
        }
    };
    Some(format!("on samples that were not fitted, the error {error} rms"))
}

/// `, 0.6°`, or empty.
fn alternative_amount(other: &Alternative) -> String {
    let Some(Estimate::Scalar { value, unit, name, .. }) = &other.estimate else {
        return String::new();
    };
    Unit::from_symbol(unit, name).map_or(String::new(), |unit| format!(", {}", unit.show(*value)))
}

/// `text` with the most specific name of the subject replaced.
fn without_subject(finding: &Finding, text: &str) -> String {
    match finding.subject.label() {
        "" => text.to_owned(),
        label => text.replace(label, EACH),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::diagnosis::Measured;
    use crate::finding::Evidence;
    use crate::report::{LogSummary, Report};

    fn finding(subject: Subject, message: &str, evidence: Evidence) -> Finding {
        Finding {
            code: "LAT001",
            severity: Severity::Error,
            title: "stream is late",
            message: message.to_owned(),
            subject,
            cause: Cause::Latency(Measured { value: 0.01, std_error: 1e-5, dof: 1e3 }),
            segment: None,
            estimate: None,
            evidence,
            fix: String::new(),
            start_ns: None,
            end_ns: None,
        }
    }

    #[test]
    fn streams_of_one_topic_are_distinguished_by_their_frames() {
        let of_frame = |frame: &str, message: &str| {
            let subject = Subject {
                topic: Some("/balls".to_owned()),
                frame: Some(frame.to_owned()),
                ..Subject::default()
            };
            finding(subject, message, Evidence::default())
        };
        let mut report = Report::from_log(LogSummary::default(), Vec::new(), Vec::new());
        report.findings = vec![of_frame("[0]", "1 ms late"), of_frame("[1]", "2 ms late")];
        let outline = Outline::new(&report);
        let (lines, _) = outline.group_lines(&outline.finding_groups()[0]);
        let names: Vec<&str> = lines.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["/balls [0]", "/balls [1]"]);
    }

    #[test]
    fn the_error_on_held_out_samples_falls_only_if_it_is_smaller() {
        let text = |before: f64, after: f64| {
            let held_out = json!({
                "before": { "m": before, "rad": 0.0 }, "after": { "m": after, "rad": 0.0 }
            });
            let evidence = Evidence {
                more: [(checks::HELD_OUT.to_owned(), held_out)].into_iter().collect(),
                ..Evidence::default()
            };
            held_out_text(&finding(Subject::default(), "", evidence)).expect("a text")
        };
        assert!(text(2e-3, 1e-3).contains("the error falls from 2 mm"), "{}", text(2e-3, 1e-3));
        assert!(text(1e-3, 2e-3).contains("the error changes from 1 mm"), "{}", text(1e-3, 2e-3));
    }
}
