//! Passed checks and the amounts that they bound.

use super::{Outline, code_ranges, group_by_key};
use crate::checks;
use crate::finding::{Amount, CheckRow, Status, Unit};
use crate::report::amounts::format_amount;

#[derive(Default)]
pub(crate) struct PassedChecks {
    pub bounds: Vec<AmountBound>,
    /// Rules without an amount that passed on all subjects, as ranges of codes.
    pub whole: Vec<String>,
    /// Rules that passed on some subjects.
    pub partial: Vec<String>,
    pub remarks: Vec<String>,
}

pub(crate) struct AmountBound {
    pub code: &'static str,
    pub name: &'static str,
    /// Largest amount, with its interval.
    pub amount: String,
    /// Empty if the rule has no threshold.
    pub limit: String,
    /// Number of amounts, if several.
    pub amounts: Option<usize>,
    /// Subjects, if not all passed.
    pub subjects: Option<String>,
}

impl AmountBound {
    /// `latency (LAT001, largest of 3)`.
    pub fn label(&self) -> String {
        let count = self.amounts.map_or(String::new(), |count| format!(", largest of {count}"));
        format!("{} ({}{count})", self.name, self.code)
    }

    /// `LAT001 latency on /tf: 0.01 ± 0.02 ms (largest of 2)`.
    pub fn sentence(&self) -> String {
        let on = self.subjects.as_ref().map_or(String::new(), |on| format!(" on {on}"));
        let of = self.amounts.map_or(String::new(), |count| format!(" (largest of {count})"));
        format!("{} {}{on} {}{of}", self.code, self.name, self.amount)
    }
}

impl PassedChecks {
    pub fn lines(self) -> Vec<String> {
        let bounds: Vec<String> = self.bounds.iter().map(AmountBound::sentence).collect();
        let lists = [self.whole.join(", "), self.partial.join("; ")].into_iter();
        let lists = lists.filter(|list| !list.is_empty());
        bounds.into_iter().chain(lists).chain(self.remarks).collect()
    }
}

impl Outline<'_> {
    /// Bounds of the headline rules, completed by other rules with a limit if there are few.
    pub fn key_bounds(&self) -> Vec<AmountBound> {
        const MIN_BOUNDS: usize = 4;
        const MAX_BOUNDS: usize = 6;
        let is_headline =
            |bound: &AmountBound| checks::find(bound.code).is_ok_and(|it| it.headline);
        let bounds = self.passed_checks().bounds.into_iter();
        let (mut bounds, others): (Vec<_>, Vec<_>) = bounds.partition(is_headline);
        let missing = MIN_BOUNDS.saturating_sub(bounds.len());
        bounds.extend(others.into_iter().filter(|bound| !bound.limit.is_empty()).take(missing));
        bounds.truncate(MAX_BOUNDS);
        bounds
    }

    /// Empty if the log could not be audited.
    pub fn passed_checks(&self) -> PassedChecks {
        let mut checks = PassedChecks::default();
        if self.report.error.is_some() {
            return checks;
        }
        let (mut whole, mut parts) = (Vec::new(), Vec::<(Vec<&str>, String)>::new());
        for (code, rows) in group_by_key(self.report.checks.iter(), |row| row.code) {
            let evaluated = rows.iter().filter(|row| row.status != Status::Skipped).count();
            let passed = rows.into_iter().filter(|row| row.status == Status::Pass);
            let (passed, with_remark): (Vec<&CheckRow>, Vec<&CheckRow>) =
                passed.partition(|row| row.reason.is_none());
            let (bounded, without_amount): (Vec<&CheckRow>, Vec<&CheckRow>) =
                passed.iter().copied().partition(|row| max_magnitude(row).is_some());
            let bound = self.bound(code, &bounded, evaluated);
            let unbounded = if bound.is_some() { without_amount } else { passed };
            checks.bounds.extend(bound);
            if unbounded.len() == evaluated && evaluated > 0 {
                whole.push(code);
            } else if !unbounded.is_empty() {
                let on = self.subject_suffix(&unbounded);
                match parts.last_mut().filter(|(_, known)| *known == on) {
                    Some((codes, _)) => codes.push(code),
                    None => parts.push((vec![code], on)),
                }
            }
            checks.remarks.extend(with_remark.iter().filter_map(|row| {
                Some(format!("{code}{}: {}", self.subject_suffix(&[*row]), row.reason.as_ref()?))
            }));
        }
        let parts =
            parts.into_iter().map(|(codes, on)| format!("{}{on}", code_ranges(&codes).join(", ")));
        checks.partial = parts.collect();
        checks.whole = code_ranges(&whole);
        checks
    }

    /// `evaluated` rows were evaluated. `None` if no row has an amount.
    fn bound(
        &self,
        code: &'static str,
        rows: &[&CheckRow],
        evaluated: usize,
    ) -> Option<AmountBound> {
        let sizes: Vec<(f64, Vec<Amount>)> = rows
            .iter()
            .filter_map(|row| Some((max_magnitude(row)?, row.estimate.as_ref()?.amounts())))
            .collect();
        let (_, largest) = sizes.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let rule = checks::find(code).ok();
        let limits = largest.iter().filter_map(|amount| {
            let unit = amount.unit()?;
            Some(unit.show(self.report.warning_threshold(rule?, unit)?))
        });
        Some(AmountBound {
            code,
            name: largest.first()?.name,
            amount: format_bound(largest)?,
            limit: limits.collect::<Vec<_>>().join(", "),
            amounts: (sizes.len() > 1).then_some(sizes.len()),
            subjects: (rows.len() < evaluated).then(|| self.subjects(rows)),
        })
    }
}

fn max_magnitude(row: &CheckRow) -> Option<f64> {
    let Amount { value, ci95, .. } = *row.estimate.as_ref()?.amounts().first()?;
    let ends = ci95.iter().flatten().map(|end| end.abs());
    Some(ends.fold(value.abs(), f64::max)).filter(|size| size.is_finite())
}

/// Does not show values below the noise floor as zero.
fn format_bound(amounts: &[Amount]) -> Option<String> {
    let shown = |amount: &Amount| {
        let unit = amount.unit()?;
        let floor = unit.noise_floor().max(if unit == Unit::One { 1e-4 } else { 0.0 });
        Some(match amount.ci95 {
            // Exactly zero, with unknown noise.
            None if amount.value == 0.0 => "none detected".to_owned(),
            None if amount.value.abs() < floor => format!("< {}", unit.show(floor)),
            _ => format_amount(amount),
        })
    };
    Some(amounts.iter().map(shown).collect::<Option<Vec<String>>>()?.join(", "))
}
