//! Passed checks and the amounts that they bound.

use super::{Outcomes, Outline, ranges};
use crate::checks;
use crate::finding::{CheckRow, Estimate, Status, Unit};
use crate::report::amounts::of_unit;

#[derive(Default)]
pub(crate) struct Passed {
    pub bounds: Vec<Bound>,
    /// Rules without an amount that passed on all subjects, as ranges of codes.
    pub whole: Vec<String>,
    /// Rules that passed on some subjects.
    pub parts: Vec<String>,
    pub remarks: Vec<String>,
}

pub(crate) struct Bound {
    pub code: &'static str,
    pub name: &'static str,
    /// Largest amount, with its interval.
    pub amount: String,
    /// Empty if the rule has no threshold.
    pub limit: String,
    /// Number of amounts, if several.
    pub of: Option<usize>,
    /// Subjects, if not all passed.
    pub on: Option<String>,
}

impl Bound {
    /// `LAT001 latency on /tf: 0.01 ± 0.02 ms (largest of 2)`.
    pub fn sentence(&self) -> String {
        let on = self.on.as_ref().map_or(String::new(), |on| format!(" on {on}"));
        let of = self.of.map_or(String::new(), |count| format!(" (largest of {count})"));
        format!("{} {}{on} {}{of}", self.code, self.name, self.amount)
    }
}

impl Passed {
    pub fn lines(self) -> Vec<String> {
        let bounds: Vec<String> = self.bounds.iter().map(Bound::sentence).collect();
        let lists = [self.whole.join(", "), self.parts.join("; ")].into_iter();
        let lists = lists.filter(|list| !list.is_empty());
        bounds.into_iter().chain(lists).chain(self.remarks).collect()
    }
}

impl Outline<'_> {
    /// Empty if the log could not be audited.
    pub fn passed(&self) -> Passed {
        let mut said = Passed::default();
        if self.report.error.is_some() {
            return said;
        }
        let (mut whole, mut parts) = (Vec::new(), Vec::<(Vec<&str>, String)>::new());
        for code in self.codes() {
            let rows = Outcomes::of(self.rows(code));
            let (bounded, plain): (Vec<&CheckRow>, Vec<&CheckRow>) =
                rows.plain.iter().copied().partition(|row| size(row).is_some());
            let bound = self.bound(code, &bounded, rows.asked);
            let unbounded = if bound.is_some() { plain } else { rows.plain };
            said.bounds.extend(bound);
            if unbounded.len() == rows.asked && rows.asked > 0 {
                whole.push(code);
            } else if !unbounded.is_empty() {
                let on = self.on(&unbounded);
                match parts.last_mut().filter(|(_, known)| *known == on) {
                    Some((codes, _)) => codes.push(code),
                    None => parts.push((vec![code], on)),
                }
            }
            said.remarks.extend(rows.remarked.iter().filter_map(|row| {
                Some(format!("{code}{}: {}", self.on(&[*row]), row.reason.as_ref()?))
            }));
        }
        let parts =
            parts.into_iter().map(|(codes, on)| format!("{}{on}", ranges(&codes).join(", ")));
        said.parts = parts.collect();
        said.whole = ranges(&whole);
        said
    }

    /// `asked` rows were evaluated. `None` if no row has an amount.
    fn bound(&self, code: &'static str, rows: &[&CheckRow], asked: usize) -> Option<Bound> {
        let sizes: Vec<(f64, &Estimate)> =
            rows.iter().filter_map(|row| Some((size(row)?, row.estimate.as_ref()?))).collect();
        let (_, largest) = sizes.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let (name, units) = match largest {
            Estimate::Scalar { name, unit, .. } => (*name, vec![Unit::from_symbol(unit, name)?]),
            Estimate::Frame { name, .. } => (*name, vec![Unit::Metre, Unit::Radian]),
            _ => return None,
        };
        let limits = units.into_iter().filter_map(|unit| {
            Some(unit.show(self.report.warns_from(checks::find(code).ok()?, unit)?))
        });
        Some(Bound {
            code,
            name,
            amount: amount(largest)?,
            limit: limits.collect::<Vec<_>>().join(", "),
            of: (sizes.len() > 1).then_some(sizes.len()),
            on: (rows.len() < asked).then(|| self.subjects(rows)),
        })
    }
}

impl<'a> Outcomes<'a> {
    fn of(rows: impl Iterator<Item = &'a CheckRow>) -> Self {
        let asked: Vec<&CheckRow> = rows.filter(|row| row.status != Status::Skipped).collect();
        let passed = asked.iter().copied().filter(|row| row.status == Status::Pass);
        let (plain, remarked) = passed.partition(|row| row.reason.is_none());
        Self { plain, remarked, asked: asked.len() }
    }
}

fn size(row: &CheckRow) -> Option<f64> {
    let (value, ci95) = match row.estimate.as_ref()? {
        Estimate::Scalar { value, ci95, .. } | Estimate::Frame { value, ci95, .. } => {
            (*value, ci95)
        }
        _ => return None,
    };
    let ends = ci95.iter().flatten().map(|end| end.abs());
    Some(ends.fold(value.abs(), f64::max)).filter(|size| size.is_finite())
}

/// Does not show values below the noise floor as zero.
fn amount(estimate: &Estimate) -> Option<String> {
    let shown = |symbol: &'static str, name: &str, value: f64, ci95: Option<[f64; 2]>| {
        let unit = Unit::from_symbol(symbol, name)?;
        let floor = unit.noise_floor().max(if unit == Unit::One { 1e-4 } else { 0.0 });
        Some(match ci95 {
            // Exactly zero, with unknown noise.
            None if value == 0.0 => "none detected".to_owned(),
            None if value.abs() < floor => format!("< {}", unit.show(floor)),
            _ => of_unit(symbol, name, value, ci95),
        })
    };
    match estimate {
        Estimate::Scalar { name, value, unit, ci95, .. } => shown(unit, name, *value, *ci95),
        Estimate::Frame { name, value, unit, ci95, rotation, .. } => {
            let angle = shown(Unit::Radian.symbol(), name, rotation.value, rotation.ci95)?;
            Some(format!("{}, {angle}", shown(unit, name, *value, *ci95)?))
        }
        _ => None,
    }
}
