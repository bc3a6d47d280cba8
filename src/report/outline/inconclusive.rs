//! Inconclusive checks, grouped by the action that would resolve them.

use super::finding_groups::plural_kind;
use super::{Outline, code_ranges, group_by_key, list_names};
use crate::checks::{self, motion_description, resolving_motion};
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Estimate, Status, Unit};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum ResolvingAction<'a> {
    /// Record another motion.
    Motion,
    /// Find the cause of MDL001's residual.
    Residual,
    /// Action that ends the check's reason.
    Stated(&'a str),
}

impl<'a> ResolvingAction<'a> {
    fn from_row(row: &'a CheckRow) -> Self {
        let reason = row.reason.as_deref().unwrap_or_default();
        if checks::is_blocked_by_residual(row) {
            ResolvingAction::Residual
        } else if row.subject.robot.is_some() && resolving_motion(row, false).is_some() {
            ResolvingAction::Motion
        } else {
            ResolvingAction::Stated(reason.rsplit_once("; ").map_or(reason, |(_, stated)| stated))
        }
    }

    /// Shared by all checks of the group, or empty.
    const fn description(self) -> &'static str {
        match self {
            ResolvingAction::Motion => "not observable in this motion",
            ResolvingAction::Residual => {
                "blocked by the unexplained residual (MDL001); fix that first"
            }
            ResolvingAction::Stated(_) => "",
        }
    }
}

/// Undecided checks in short.
#[derive(Default)]
pub(crate) struct OpenChecks {
    /// One line per action that would resolve them.
    pub untested: Vec<String>,
    /// How little the joints moved, one line per arm.
    pub because: Vec<String>,
    /// The next step, and its commands.
    pub next: Option<(String, Vec<String>)>,
}

impl Outline<'_> {
    /// Without checks that no such log can decide.
    pub fn open_checks(&self) -> OpenChecks {
        let rows = self.inconclusive_rows().filter(|row| !row.is_indistinguishable);
        let groups = group_by_key(rows, ResolvingAction::from_row);
        let is_of_joints = |row: &&CheckRow| {
            let purpose = resolving_motion(row, false);
            matches!(purpose, Some(Purpose::Zeros | Purpose::Calibration))
        };
        let motion = groups.iter().filter(|(action, _)| *action == ResolvingAction::Motion);
        let motion: Vec<&CheckRow> = motion.flat_map(|(_, rows)| rows.iter().copied()).collect();
        let needs_joints = motion.iter().any(is_of_joints);
        let lines = groups.iter().map(|(action, rows)| match action {
            ResolvingAction::Stated(stated) => {
                format!("{}; {stated}", self.items(*action, rows).join("; "))
            }
            _ => format!("{}: {}", action.description(), self.rule_names(rows)),
        });
        OpenChecks {
            untested: lines.collect(),
            because: if needs_joints { self.small_motions() } else { Vec::new() },
            next: if motion.is_empty() { None } else { self.next_step() },
        }
    }

    /// `joint zero (ZER001), latency of /imu/data (LAT001)`: headline rules first, and subjects only if others of
    /// the rule were decided.
    fn rule_names(&self, rows: &[&CheckRow]) -> String {
        let is_headline = |code: &str| checks::find(code).is_ok_and(|rule| rule.headline);
        let mut groups = group_by_key(rows.iter().copied(), |row| row.code);
        groups.sort_by_key(|(code, _)| !is_headline(code));
        let names = groups.into_iter().map(|(code, rows)| {
            let name =
                checks::find(code).map_or_else(|_| code.to_owned(), checks::Rule::plain_name);
            let evaluated = self
                .report
                .checks
                .iter()
                .filter(|row| row.code == code && row.status != Status::Skipped);
            let (open, all) = (rows.len(), evaluated.count());
            let kind = plural_kind(rows.iter().map(|row| &row.subject));
            match open {
                _ if open == all => format!("{name} ({code})"),
                1 => format!("{name} of {} ({code})", self.subject(&rows[0].subject)),
                _ => format!("{name} of {open} of {all} {kind} ({code})"),
            }
        });
        list_names(&names.collect::<Vec<_>>())
    }

    /// `elbow moved over 3 % of its range, and no joint over more than 17 %`, one line per arm.
    fn small_motions(&self) -> Vec<String> {
        let sentences = self.report.workspace.iter().filter_map(|arm| {
            let visited = arm.joints.iter().filter_map(|joint| Some((joint, joint.visited?)));
            let mut visited: Vec<_> = visited.collect();
            visited.sort_by(|a, b| a.1.total_cmp(&b.1));
            let ((least, least_share), (_, most_share)) = (visited.first()?, visited.last()?);
            let of =
                if self.has_several_robots { format!("{}: ", arm.robot) } else { String::new() };
            let [least_percent, most_percent] =
                [least_share, most_share].map(|share| format!("{:.0} %", 100.0 * share));
            Some(match least_percent == most_percent {
                true => format!("{of}no joint moved over more than {most_percent} of its range"),
                false => format!(
                    "{of}{} moved over {least_percent} of its range, and no joint over more than \
                     {most_percent}",
                    least.joint
                ),
            })
        });
        sentences.collect()
    }

    /// The planned motion if there is one.
    fn next_step(&self) -> Option<(String, Vec<String>)> {
        let commands: Vec<String> = self.plan_commands().into_iter().map(str::to_owned).collect();
        if commands.is_empty() {
            return Some((self.recommended_motion()?, commands));
        }
        let others = match self.recommended_purposes().as_slice() {
            [_, others @ ..] if !others.is_empty() => {
                format!(" (and again with {})", purpose_options(others))
            }
            _ => String::new(),
        };
        let text = format!("record the motion that this command plans{others}, then audit again:");
        Some((text, commands))
    }

    /// One line per action.
    pub fn inconclusive_by_action(&self) -> Vec<String> {
        let groups = group_by_key(self.inconclusive_rows(), ResolvingAction::from_row);
        let lines = groups.into_iter().map(|(action, rows)| {
            let items = self.items(action, &rows).join("; ");
            match action {
                ResolvingAction::Stated(stated) => format!("{items}; {stated}"),
                ResolvingAction::Motion | ResolvingAction::Residual => {
                    format!("{}: {items}", action.description())
                }
            }
        });
        lines.collect()
    }

    /// One line per rule and reason.
    pub fn inconclusive_by_reason(&self) -> Vec<String> {
        let groups =
            group_by_key(self.inconclusive_rows(), |row| (row.code, row.reason.as_deref()));
        let lines = groups.into_iter().map(|((code, reason), rows)| {
            format!("{code}{}: {}", self.subject_suffix(&rows), reason.unwrap_or_default())
        });
        lines.collect()
    }

    fn inconclusive_rows(&self) -> impl Iterator<Item = &CheckRow> {
        self.rows_of(Status::Inconclusive)
    }

    /// `LAT001–003 on /pose, /tf`: combines rules on the same subjects. Includes the reason if no motion
    /// resolves them.
    fn items(&self, action: ResolvingAction<'_>, rows: &[&CheckRow]) -> Vec<String> {
        let by_rule = group_by_key(rows.iter().copied(), |row| (row.code, own_reason(action, row)));
        let by_rule = by_rule.into_iter().map(|((code, why), rows)| {
            let on = format!("{}{}", self.subject_suffix(&rows), half_width_suffix(&rows));
            (code, on, why)
        });
        let by_rule: Vec<(&str, String, Option<&str>)> = by_rule.collect();
        let items = group_by_key(by_rule.iter(), |(_, on, why)| (on.as_str(), *why));
        let said = items.into_iter().map(|((on, why), rules)| {
            let codes: Vec<&str> = rules.into_iter().map(|(code, ..)| *code).collect();
            let why = why.map_or(String::new(), |why| format!(": {why}"));
            format!("{}{on}{why}", code_ranges(&codes).join(", "))
        });
        said.collect()
    }

    /// Checks, parameters that need other motions, and the recommended motion with its commands.
    pub fn inconclusive_lines(&self) -> Vec<String> {
        let plans = self.plan_commands().into_iter().map(str::to_owned).collect();
        let recipe = self.recommended_motion().into_iter().collect();
        [self.inconclusive_by_action(), self.unobservable_parameters(), recipe, plans].concat()
    }

    /// Purposes of motions that would resolve checks.
    fn recommended_purposes(&self) -> Vec<Purpose> {
        let plans = &self.report.plans;
        let is_planned =
            |purpose: &Purpose| plans.iter().any(|plan| plan.purpose == purpose.name());
        let is_needed = |purpose: &Purpose| {
            let mut open = self
                .inconclusive_rows()
                .filter(|row| ResolvingAction::from_row(row) == ResolvingAction::Motion);
            open.any(|row| resolving_motion(row, false) == Some(*purpose))
        };
        let purposes = Purpose::ALL.into_iter();
        purposes
            .filter(|it| if plans.is_empty() { is_needed(it) } else { is_planned(it) })
            .collect()
    }

    /// Motion that would resolve checks, as a sentence.
    pub fn recommended_motion(&self) -> Option<String> {
        const DURATION_S: u32 = 60;
        let purposes = self.recommended_purposes();
        let parts: Vec<&str> =
            purposes.iter().map(|purpose| motion_description(*purpose)).collect();
        if parts.is_empty() {
            return None;
        }
        let or = match purposes.as_slice() {
            _ if self.report.plans.is_empty() => String::new(),
            [_] => ", or as planned:".to_owned(),
            [_, others @ ..] => format!(", or as planned (then {}):", purpose_options(others)),
            [] => String::new(),
        };
        Some(format!("record {DURATION_S} s with {}{or}", parts.join("; ")))
    }

    /// One per arm.
    pub fn plan_commands(&self) -> Vec<&str> {
        let mut plans = Vec::new();
        let mut arms: Vec<&str> = Vec::new();
        for plan in &self.report.plans {
            if !arms.contains(&plan.robot.as_str()) {
                arms.push(&plan.robot);
                plans.push(plan.command.as_str());
            }
        }
        plans
    }
}

fn purpose_options(purposes: &[Purpose]) -> String {
    let options = purposes.iter().map(|purpose| format!("--for {}", purpose.name()));
    options.collect::<Vec<_>>().join(", ")
}

/// `None` if the group states it.
fn own_reason<'a>(action: ResolvingAction<'_>, row: &'a CheckRow) -> Option<&'a str> {
    match action {
        ResolvingAction::Motion | ResolvingAction::Residual => None,
        // A reason without a remedy is its own group.
        ResolvingAction::Stated(stated) => {
            let reason = row.reason.as_deref()?;
            Some(reason.strip_suffix(stated)?.trim_end_matches("; ")).filter(|why| !why.is_empty())
        }
    }
}

fn half_width_suffix(rows: &[&CheckRow]) -> String {
    let [row] = rows else { return String::new() };
    let Some(Estimate::Scalar { name, unit, ci95: Some([low, high]), .. }) = &row.estimate else {
        return String::new();
    };
    match Unit::from_symbol(unit, name) {
        Some(unit) => format!(" (±{})", unit.show(0.5 * (high - low))),
        None => String::new(),
    }
}
