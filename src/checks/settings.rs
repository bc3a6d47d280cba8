//! Rule settings of the caller: selection, thresholds, severities and exemptions.

use std::cmp::Reverse;
use std::fmt;
use std::str::FromStr;

use super::{REGISTRY, Rule, Thresholds};
use crate::finding::{CheckRow, Finding, IgnoredFinding, Severity, Subject};

/// Which rules to evaluate, and how.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Empty for all.
    pub select: Vec<Selector>,
    /// Left out.
    pub ignore: Vec<Selector>,
    /// Rules that must be conclusive.
    pub required: Vec<Selector>,
    /// Overrides of thresholds.
    pub thresholds: Thresholds,
    /// Overrides of severities; `info` findings keep theirs.
    pub severities: Vec<(&'static str, Severity)>,
    /// Known findings that do not count.
    pub exemptions: Vec<Exemption>,
}

impl Settings {
    /// Whether `rule` is selected.
    pub fn selects(&self, rule: &Rule) -> bool {
        let named =
            |selectors: &[Selector]| selectors.iter().any(|selector| selector.matches(rule.code));
        (self.select.is_empty() || named(&self.select)) && !named(&self.ignore)
    }

    /// Severity of a fault graded `found`.
    pub(super) fn severity(&self, rule: &Rule, found: Severity) -> Severity {
        let set = self.severities.iter().find(|(code, _)| *code == rule.code);
        set.map_or(found, |(_, set)| if found == Severity::Info { found } else { *set })
    }

    pub(super) fn exemption(&self, row: &CheckRow) -> Option<&Exemption> {
        self.exemptions.iter().find(|exemption| exemption.covers(row))
    }

    /// Exemptions that cover no row.
    pub fn unused_exemptions<'a>(&'a self, rows: &[CheckRow]) -> Vec<&'a Exemption> {
        let is_unused = |exemption: &&Exemption| !rows.iter().any(|row| exemption.covers(row));
        self.exemptions.iter().filter(is_unused).collect()
    }

    /// Whether a selected rule needs a robot model.
    pub fn needs_model(&self) -> bool {
        REGISTRY.iter().any(|rule| rule.needs_model && self.selects(rule))
    }
}

/// A known finding that does not count.
#[derive(Clone, Debug, PartialEq)]
pub struct Exemption {
    /// Rules.
    pub rules: Selector,
    /// Missing parts match any. The leading `/` is optional.
    pub subject: Subject,
    /// Reason.
    pub reason: String,
    /// File and line.
    pub place: String,
}

impl Exemption {
    fn covers(&self, row: &CheckRow) -> bool {
        let matches_value =
            |required: &Option<String>, found: &Option<String>| match (required, found) {
                (None, _) => true,
                (Some(required), Some(found)) => {
                    required.trim_start_matches('/') == found.trim_start_matches('/')
                }
                (Some(_), None) => false,
            };
        let (required, found) = (&self.subject, &row.subject);
        self.rules.matches(row.code)
            && matches_value(&required.robot, &found.robot)
            && matches_value(&required.topic, &found.topic)
            && matches_value(&required.joint, &found.joint)
            && matches_value(&required.frame, &found.frame)
    }

    pub(super) fn reason_text(&self) -> String {
        format!("ignored: {} ({})", self.reason, self.place)
    }

    pub(super) fn ignored(&self, finding: Finding) -> IgnoredFinding {
        IgnoredFinding { finding, reason: self.reason.clone(), place: self.place.clone() }
    }
}

impl fmt::Display for Exemption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.rules)?;
        let Subject { robot, topic, joint, frame, reference: _ } = &self.subject;
        let parts: Vec<&str> =
            [topic, joint, frame, robot].into_iter().flatten().map(String::as_str).collect();
        if !parts.is_empty() {
            write!(f, " on {}", parts.join(", "))?;
        }
        Ok(())
    }
}

/// A code or the leading letters of several.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selector(String);

impl Selector {
    /// Whether it selects this code.
    pub fn matches(&self, code: &str) -> bool {
        code.starts_with(&self.0)
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for Selector {
    type Err = UnknownRule;

    fn from_str(text: &str) -> Result<Self, UnknownRule> {
        let prefix = text.trim().to_ascii_uppercase();
        let known =
            !prefix.is_empty() && REGISTRY.iter().any(|rule| rule.code.starts_with(&prefix));
        known.then_some(Selector(prefix)).ok_or_else(|| UnknownRule::new(text))
    }
}

/// No rule has this code.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no rule `{code}`; {}", self.remedy())]
pub struct UnknownRule {
    /// Requested code.
    pub code: String,
    /// Most similar codes, best first.
    pub nearest: Vec<&'static str>,
}

impl UnknownRule {
    pub(super) fn new(code: &str) -> Self {
        const MAX_SUGGESTIONS: usize = 3;
        const MIN_COMMON_LETTERS: usize = 3;
        let code = code.trim();
        let code_upper = code.to_ascii_uppercase();
        let common_letters =
            |known: &str| known.bytes().zip(code_upper.bytes()).filter(|(a, b)| a == b).count();
        let mut nearest: Vec<_> = REGISTRY.iter().map(|rule| rule.code).collect();
        nearest.retain(|known| common_letters(known) >= MIN_COMMON_LETTERS);
        nearest.sort_by_key(|known| Reverse(common_letters(known)));
        nearest.truncate(MAX_SUGGESTIONS);
        Self { code: code.to_owned(), nearest }
    }

    /// A suggestion for the user.
    pub fn remedy(&self) -> String {
        match self.nearest.as_slice() {
            [] => "`poseaudit rules` lists them all".to_owned(),
            nearest => format!("did you mean {}?", nearest.join(", ")),
        }
    }
}
