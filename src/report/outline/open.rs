//! What could not be decided, by what would settle it.

use super::{Outline, grouped_by, ranges};
use crate::checks::{self, recipe, settled_by};
use crate::diagnosis::plan::Purpose;
use crate::finding::{CheckRow, Estimate, Status, Unit};

/// What would settle a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Settles<'a> {
    /// Another motion of the arm.
    Motion,
    /// To find the cause of what MDL001 has left.
    Residual,
    /// What its reason ends in.
    Said(&'a str),
}

impl<'a> Settles<'a> {
    fn of(row: &'a CheckRow) -> Self {
        let reason = row.reason.as_deref().unwrap_or_default();
        if checks::is_behind_residual(row) {
            Settles::Residual
        } else if row.subject.robot.is_some() && settled_by(row, false).is_some() {
            Settles::Motion
        } else {
            Settles::Said(reason.rsplit_once("; ").map_or(reason, |(_, settle)| settle))
        }
    }

    /// Why what it settles is open, where that is one and the same.
    const fn words(self) -> &'static str {
        match self {
            Settles::Motion => "not observable in this motion",
            Settles::Residual => "blocked by the unexplained residual (MDL001); fix that first",
            Settles::Said(_) => "",
        }
    }
}

impl Outline<'_> {
    /// What could not be decided, a line for each thing that would settle it.
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

    /// The same with the reason of each, a line for each rule and reason.
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

    /// `LAT001–003 on /pose, /tf`: rules that are open on the same together. Of what no motion settles,
    /// with the reason.
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

    /// All of that, what only other motions would tell apart, and the motion with the calls that write it.
    pub fn open_lines(&self) -> Vec<String> {
        let plans = self.plans().into_iter().map(str::to_owned).collect();
        let recipe = self.recipe().into_iter().collect();
        [self.could_not_tell(), self.cannot_show(), recipe, plans].concat()
    }

    /// The motion that would settle what is open for want of one, in a sentence.
    pub fn recipe(&self) -> Option<String> {
        /// What `plan` writes by itself, s.
        const SECONDS: u32 = 60;
        let plans = &self.report.plans;
        let named = |purpose: &Purpose| plans.iter().any(|plan| plan.purpose == purpose.name());
        let asked = |purpose: &Purpose| {
            let mut open = self.open().filter(|row| Settles::of(row) == Settles::Motion);
            open.any(|row| settled_by(row, false) == Some(*purpose))
        };
        let purposes = Purpose::ALL.into_iter();
        let purposes: Vec<Purpose> =
            purposes.filter(|it| if plans.is_empty() { asked(it) } else { named(it) }).collect();
        let parts: Vec<&str> = purposes.iter().map(|purpose| recipe(*purpose)).collect();
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

    /// The calls that write that motion, for each arm one: as a shell takes them.
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

/// Why a check is open, where what would settle it does not say that.
fn why<'a>(settles: Settles<'_>, row: &'a CheckRow) -> Option<&'a str> {
    match settles {
        Settles::Motion | Settles::Residual => None,
        // What has no remedy of its own is its own.
        Settles::Said(settle) => {
            let reason = row.reason.as_deref()?;
            Some(reason.strip_suffix(settle)?.trim_end_matches("; ")).filter(|why| !why.is_empty())
        }
    }
}

/// How badly the amount of a single check is known, where it was estimated.
fn half_width(rows: &[&CheckRow]) -> String {
    let [row] = rows else { return String::new() };
    let Some(Estimate::Amount { name, unit, ci95: Some([low, high]), .. }) = &row.estimate else {
        return String::new();
    };
    match Unit::of(unit, name) {
        Some(unit) => format!(" (±{})", unit.show(0.5 * (high - low))),
        None => String::new(),
    }
}
