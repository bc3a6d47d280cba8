//! Inconclusive checks, grouped by the action that would resolve them.

use super::{Outline, grouped_by, ranges};
use crate::checks::{self, motion_description, resolving_motion};
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Estimate, Status, Unit};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Settles<'a> {
    /// Record another motion.
    Motion,
    /// Find the cause of MDL001's residual.
    Residual,
    /// Action that ends the check's reason.
    Said(&'a str),
}

impl<'a> Settles<'a> {
    fn of(row: &'a CheckRow) -> Self {
        let reason = row.reason.as_deref().unwrap_or_default();
        if checks::is_blocked_by_residual(row) {
            Settles::Residual
        } else if row.subject.robot.is_some() && resolving_motion(row, false).is_some() {
            Settles::Motion
        } else {
            Settles::Said(reason.rsplit_once("; ").map_or(reason, |(_, settle)| settle))
        }
    }

    /// Shared by all checks of the group, or empty.
    const fn words(self) -> &'static str {
        match self {
            Settles::Motion => "not observable in this motion",
            Settles::Residual => "blocked by the unexplained residual (MDL001); fix that first",
            Settles::Said(_) => "",
        }
    }
}

impl Outline<'_> {
    /// One line per action.
    pub fn could_not_tell(&self) -> Vec<String> {
        let groups = grouped_by(self.open(), Settles::of);
        let lines = groups.into_iter().map(|(settles, rows)| {
            let items = self.items(settles, &rows).join("; ");
            match settles {
                Settles::Said(settle) => format!("{items}; {settle}"),
                Settles::Motion | Settles::Residual => format!("{}: {items}", settles.words()),
            }
        });
        lines.collect()
    }

    /// One line per rule and reason.
    pub fn reasons(&self) -> Vec<String> {
        let groups = grouped_by(self.open(), |row| (row.code, row.reason.as_deref()));
        let lines = groups.into_iter().map(|((code, reason), rows)| {
            format!("{code}{}: {}", self.on(&rows), reason.unwrap_or_default())
        });
        lines.collect()
    }

    fn open(&self) -> impl Iterator<Item = &CheckRow> {
        self.report.checks.iter().filter(|row| row.status == Status::Inconclusive)
    }

    /// `LAT001–003 on /pose, /tf`: combines rules on the same subjects. Includes the reason if no motion
    /// resolves them.
    fn items(&self, settles: Settles<'_>, rows: &[&CheckRow]) -> Vec<String> {
        let by_rule = grouped_by(rows.iter().copied(), |row| (row.code, why(settles, row)));
        let mut items: Vec<(Vec<&str>, String, Option<&str>)> = Vec::new();
        for ((code, why), rows) in by_rule {
            let on = format!("{}{}", self.on(&rows), half_width(&rows));
            match items.iter_mut().find(|(_, known, said)| *known == on && *said == why) {
                Some((codes, ..)) => codes.push(code),
                None => items.push((vec![code], on, why)),
            }
        }
        let said = items.into_iter().map(|(codes, on, why)| {
            let why = why.map_or(String::new(), |why| format!(": {why}"));
            format!("{}{on}{why}", ranges(&codes).join(", "))
        });
        said.collect()
    }

    /// Checks, parameters that need other motions, and the recommended motion with its commands.
    pub fn open_lines(&self) -> Vec<String> {
        let plans = self.plans().into_iter().map(str::to_owned).collect();
        let recipe = self.recipe().into_iter().collect();
        [self.could_not_tell(), self.cannot_show(), recipe, plans].concat()
    }

    /// Motion that would resolve checks, as a sentence.
    pub fn recipe(&self) -> Option<String> {
        const SECONDS: u32 = 60;
        let plans = &self.report.plans;
        let named = |purpose: &Purpose| plans.iter().any(|plan| plan.purpose == purpose.name());
        let asked = |purpose: &Purpose| {
            let mut open = self.open().filter(|row| Settles::of(row) == Settles::Motion);
            open.any(|row| resolving_motion(row, false) == Some(*purpose))
        };
        let purposes = Purpose::ALL.into_iter();
        let purposes: Vec<Purpose> =
            purposes.filter(|it| if plans.is_empty() { asked(it) } else { named(it) }).collect();
        let parts: Vec<&str> =
            purposes.iter().map(|purpose| motion_description(*purpose)).collect();
        if parts.is_empty() {
            return None;
        }
        let or = match purposes.as_slice() {
            _ if plans.is_empty() => String::new(),
            [_] => ", or as planned:".to_owned(),
            [_, others @ ..] => {
                let others = others.iter().map(|purpose| format!("--for {}", purpose.name()));
                format!(", or as planned (then {}):", others.collect::<Vec<_>>().join(", "))
            }
            [] => String::new(),
        };
        Some(format!("record {SECONDS} s with {}{or}", parts.join("; ")))
    }

    /// One per arm.
    pub fn plans(&self) -> Vec<&str> {
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

/// `None` if the group states it.
fn why<'a>(settles: Settles<'_>, row: &'a CheckRow) -> Option<&'a str> {
    match settles {
        Settles::Motion | Settles::Residual => None,
        // A reason without a remedy is its own group.
        Settles::Said(settle) => {
            let reason = row.reason.as_deref()?;
            Some(reason.strip_suffix(settle)?.trim_end_matches("; ")).filter(|why| !why.is_empty())
        }
    }
}

fn half_width(rows: &[&CheckRow]) -> String {
    let [row] = rows else { return String::new() };
    let Some(Estimate::Scalar { name, unit, ci95: Some([low, high]), .. }) = &row.estimate else {
        return String::new();
    };
    match Unit::from_symbol(unit, name) {
        Some(unit) => format!(" (±{})", unit.show(0.5 * (high - low))),
        None => String::new(),
    }
}
