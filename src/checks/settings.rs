//! What the caller says of the rules: which are asked, by which thresholds, and what is known already.

use std::cmp::Reverse;
use std::fmt;
use std::str::FromStr;

use super::{REGISTRY, Rule, Thresholds};
use crate::finding::{CheckRow, Finding, Ignored, Severity, Subject};

/// Which rules to ask.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Only these; all where there is none.
    pub select: Vec<Selector>,
    /// None of these.
    pub ignore: Vec<Selector>,
    /// Rules that must conclude.
    pub required: Vec<Selector>,
    /// The thresholds that the caller set instead of the rules' own.
    pub thresholds: Thresholds,
    /// The severity of all that a rule finds wrong, where the caller set one; what is `info` stays so.
    pub severities: Vec<(&'static str, Severity)>,
    /// What is known, and not to be counted.
    pub exemptions: Vec<Exemption>,
}

impl Settings {
    /// Whether `rule` is to be asked.
    pub fn asks(&self, rule: &Rule) -> bool {
        let named =
            |selectors: &[Selector]| selectors.iter().any(|selector| selector.names(rule.code));
        (self.select.is_empty() || named(&self.select)) && !named(&self.ignore)
    }

    /// The severity of a fault that the rule itself calls `found`.
    pub(super) fn severity(&self, rule: &Rule, found: Severity) -> Severity {
        let set = self.severities.iter().find(|(code, _)| *code == rule.code);
        set.map_or(found, |(_, set)| if found == Severity::Info { found } else { *set })
    }

    /// What exempts a row, where something does.
    pub(super) fn exemption(&self, row: &CheckRow) -> Option<&Exemption> {
        self.exemptions.iter().find(|exemption| exemption.covers(row))
    }

    /// The exemptions that cover nothing of what was asked.
    pub fn unused<'a>(&'a self, rows: &[CheckRow]) -> Vec<&'a Exemption> {
        let is_unused = |exemption: &&Exemption| !rows.iter().any(|row| exemption.covers(row));
        self.exemptions.iter().filter(is_unused).collect()
    }

    /// Whether any rule to be asked needs a model of the robot.
    pub fn need_model(&self) -> bool {
        REGISTRY.iter().any(|rule| rule.needs_model && self.asks(rule))
    }
}

/// Something that is known, so that it does not count; why, and where that is said.
#[derive(Clone, Debug, PartialEq)]
pub struct Exemption {
    /// The rules.
    pub rules: Selector,
    /// The subject; of what it leaves out any. A topic or a frame may lack its leading `/`.
    pub subject: Subject,
    /// Why.
    pub reason: String,
    /// Where that is said.
    pub place: String,
}

impl Exemption {
    /// Whether it is about this row.
    fn covers(&self, row: &CheckRow) -> bool {
        let is = |wanted: &Option<String>, found: &Option<String>| match (wanted, found) {
            (None, _) => true,
            (Some(wanted), Some(found)) => {
                wanted.trim_start_matches('/') == found.trim_start_matches('/')
            }
            (Some(_), None) => false,
        };
        let (wanted, found) = (&self.subject, &row.subject);
        self.rules.names(row.code)
            && is(&wanted.robot, &found.robot)
            && is(&wanted.topic, &found.topic)
            && is(&wanted.joint, &found.joint)
            && is(&wanted.frame, &found.frame)
    }

    pub(super) fn said(&self) -> String {
        format!("ignored: {} ({})", self.reason, self.place)
    }

    pub(super) fn ignored(&self, finding: Finding) -> Ignored {
        Ignored { finding, reason: self.reason.clone(), place: self.place.clone() }
    }
}

impl fmt::Display for Exemption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.rules)?;
        let Subject { robot, topic, joint, frame } = &self.subject;
        let parts: Vec<&str> =
            [topic, joint, frame, robot].into_iter().flatten().map(String::as_str).collect();
        if !parts.is_empty() {
            write!(f, " on {}", parts.join(", "))?;
        }
        Ok(())
    }
}

/// A rule's code, or the letters that a family of codes begins with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selector(String);

impl Selector {
    /// Whether it names the rule with this code.
    pub fn names(&self, code: &str) -> bool {
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

/// There is no rule with this code.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no rule `{code}`; {}", self.remedy())]
pub struct UnknownRule {
    /// What was asked for.
    pub code: String,
    /// The codes most like it, the nearest first.
    pub nearest: Vec<&'static str>,
}

impl UnknownRule {
    pub(super) fn new(code: &str) -> Self {
        const NEAREST: usize = 3;
        const ALIKE: usize = 3;
        let code = code.trim();
        let wanted = code.to_ascii_uppercase();
        let likeness =
            |known: &str| known.bytes().zip(wanted.bytes()).filter(|(a, b)| a == b).count();
        let mut nearest: Vec<_> = REGISTRY.iter().map(|rule| rule.code).collect();
        nearest.retain(|known| likeness(known) >= ALIKE);
        nearest.sort_by_key(|known| Reverse(likeness(known)));
        nearest.truncate(NEAREST);
        Self { code: code.to_owned(), nearest }
    }

    /// What the reader can do.
    pub fn remedy(&self) -> String {
        match self.nearest.as_slice() {
            [] => "`poseaudit rules` lists them all".to_owned(),
            nearest => format!("did you mean {}?", nearest.join(", ")),
        }
    }
}
