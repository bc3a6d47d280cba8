//! The result table, by target, scene, kind, magnitude and rule.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Write as _};

use crate::Options;
use crate::backgrounds::Background;
use crate::cases::{Case, MotionKind};
use crate::fault_kinds::{DEGREE, FaultKind, MAGNITUDES, MIN_MAGNITUDE_TO_FIND};
use crate::grading::{AuditFailure, CORE_FAMILIES, FaultOutcome, Grade, Interval, Outcome};

pub struct ResultTable {
    pub logs: usize,
    text: String,
}

impl fmt::Display for ResultTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

type Outcomes = [(Case, Outcome)];

impl ResultTable {
    pub fn new(options: &Options, outcomes: &Outcomes) -> Self {
        let mut text = String::new();
        write_tables(&mut text, options, outcomes).expect("text takes text");
        Self { logs: outcomes.len(), text }
    }
}

fn write_tables(t: &mut String, options: &Options, outcomes: &Outcomes) -> fmt::Result {
    let count = |few: usize, many: usize| {
        let of = |(case, _): &&(Case, _)| (few..=many).contains(&case.planted.len());
        outcomes.iter().filter(of).count()
    };
    writeln!(
        t,
        "{} logs, seed {}: {} clean, {} with one fault, {} with two, {} with more.",
        outcomes.len(),
        options.seed,
        count(0, 0),
        count(1, 1),
        count(2, 2),
        count(3, usize::MAX),
    )?;
    write_targets(t, outcomes)?;
    write_groups(t, outcomes)?;
    write_detection(t, outcomes)?;
    write_false_findings(t, outcomes)?;
    write_intervals(t, outcomes, options.verbose)?;
    if options.verbose {
        write_wrong_outcomes(t, outcomes)?;
    }
    Ok(())
}

/// The most important results, by severity.
fn write_first_rows(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let all = || graded(outcomes);
    let clean = || all().filter(|(case, _)| case.planted.is_empty());
    let faulty = || all().filter(|(case, _)| !case.planted.is_empty());
    let has_false_finding = |(_, verdict): &(&Case, &Grade)| !verdict.false_findings.is_empty();
    let wrong_passes = all().filter(|(_, verdict)| verdict.is_wrong_pass).count();
    writeln!(t, "| **wrong passes** | {} | 0 |", share(wrong_passes, all().count()))?;
    let panics = outcomes.iter().filter(|(_, one)| matches!(one, Err(AuditFailure::Panic))).count();
    writeln!(t, "| panics | {} | 0 |", share(panics, outcomes.len()))?;
    let refused = outcomes.len() - panics - all().count();
    writeln!(t, "| logs that were not audited | {} | 0 |", share(refused, outcomes.len()))?;
    writeln!(
        t,
        "| faulty logs with a wrong cause | {} | ≤ 1 % |",
        share(faulty().filter(has_false_finding).count(), faulty().count())
    )?;
    writeln!(
        t,
        "| clean logs with a false alarm of {} | {} | ≤ 0.5 % |",
        CORE_FAMILIES.join(", "),
        share(clean().filter(has_false_finding).count(), clean().count())
    )?;
    let is_without_change = |(case, _): &(&Case, &Grade)| {
        !case.planted.iter().any(|one| one.kind.starts_mid_run() || one.kind.is_within_run())
    };
    let without_change = || all().filter(is_without_change);
    writeln!(
        t,
        "| logs without a change, but with a change named | {} | ≤ 0.5 % |",
        share(
            without_change().filter(|(_, verdict)| verdict.has_false_change).count(),
            without_change().count()
        )
    )?;
    let must_find_any = |case: &Case| case.planted.iter().any(|planted| case.must_find(planted));
    let misses_fault = |(case, verdict): &(&Case, &Grade)| {
        case.planted
            .iter()
            .zip(&verdict.fault_outcomes)
            .any(|(one, fate)| case.must_find(one) && !fate.is_named())
    };
    let with_due_faults = || all().filter(|(case, _)| must_find_any(case));
    writeln!(
        t,
        "| logs with an unnamed fault that must be found | {} | ≤ 2 % |",
        share(with_due_faults().filter(misses_fault).count(), with_due_faults().count())
    )?;
    let fates = || {
        all().flat_map(|(case, verdict)| {
            let both = case.planted.iter().zip(&verdict.fault_outcomes);
            both.filter(|(one, _)| case.must_find(one)).map(|(_, fate)| *fate).collect::<Vec<_>>()
        })
    };
    let named = fates().filter(|fate| fate.is_named()).count();
    writeln!(t, "| faults that must be found: named | {} | ≥ 98 % |", share(named, fates().count()))
}

/// Results by scene, background and kind of fault.
fn write_groups(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let row = |t: &mut String, name: &str, kind: Option<FaultKind>, of: &dyn Fn(&Case) -> bool| {
        let here: Vec<&(Case, Outcome)> = outcomes.iter().filter(|(case, _)| of(case)).collect();
        let judged = || here.iter().filter_map(|(case, one)| Some((case, one.as_ref().ok()?)));
        let wrong_passes = judged().filter(|(_, verdict)| verdict.is_wrong_pass).count();
        let false_finding_logs =
            judged().filter(|(_, verdict)| !verdict.false_findings.is_empty()).count();
        let due: Vec<bool> = judged()
            .flat_map(|(case, verdict)| {
                let both = case.planted.iter().zip(&verdict.fault_outcomes);
                let both = both.filter(|(one, _)| kind.is_none_or(|kind| one.kind == kind));
                both.filter(|(one, _)| case.must_find(one)).map(|(_, fate)| fate.is_named())
            })
            .collect();
        let named = due.iter().filter(|named| **named).count();
        let not_audited = here.len() - judged().count();
        let is_its = |one: &&Interval| kind.is_none() || one.planted == kind;
        let intervals: Vec<&Interval> =
            judged().flat_map(|(_, verdict)| &verdict.intervals).filter(is_its).collect();
        let covered = intervals.iter().filter(|one| one.is_covered).count();
        writeln!(
            t,
            "| {name} | {} | {wrong_passes} | {false_finding_logs} | {not_audited} | {} | {} |",
            here.len(),
            share(named, due.len()),
            share(covered, intervals.len())
        )
    };
    let head = "| logs | wrong passes | wrong causes, false alarms | not audited | named | covered |\n\
                |---|---|---|---|---|---|---|";
    writeln!(t, "\n## By scene\n\n| scene {head}")?;
    let names: BTreeSet<&str> = outcomes.iter().map(|(case, _)| case.scene.name()).collect();
    for name in names {
        row(t, name, None, &|case| case.scene.name() == name)?;
    }
    writeln!(t, "\n## By motion\n\n| motion {head}")?;
    for kind in MotionKind::ALL {
        row(t, kind.name(), None, &|case| case.motion_kind == kind)?;
        let is_clean = |case: &Case| case.motion_kind == kind && case.planted.is_empty();
        row(t, &format!("{}, nothing planted", kind.name()), None, &is_clean)?;
    }
    let weak = |case: &Case| case.motion_kind != MotionKind::Usual;
    let motions: BTreeSet<(&str, &str)> = outcomes
        .iter()
        .filter(|(case, _)| weak(case))
        .map(|(case, _)| (case.motion_kind.name(), case.motion))
        .collect();
    for (kind, motion) in motions {
        let is_its = |case: &Case| case.motion_kind.name() == kind && case.motion == motion;
        row(t, &format!("{kind}: {motion}"), None, &is_its)?;
    }
    writeln!(t, "\n## By background\n\n| background {head}")?;
    for background in Background::ALL {
        let name = background.name();
        row(t, name, None, &|case| case.background == background)?;
        let is_clean = |case: &Case| case.background == background && case.planted.is_empty();
        row(t, &format!("{name}, nothing planted"), None, &is_clean)?;
    }
    writeln!(t, "\n## By kind of fault\n\n| kind {head}")?;
    let kinds: BTreeSet<FaultKind> =
        outcomes.iter().flat_map(|(case, _)| case.planted.iter().map(|one| one.kind)).collect();
    for kind in kinds {
        let has = |case: &Case| case.planted.iter().any(|one| one.kind == kind);
        row(t, &format!("{kind:?}"), Some(kind), &has)?;
    }
    Ok(())
}

/// The audited logs, with their verdicts.
fn graded(outcomes: &Outcomes) -> impl Iterator<Item = (&Case, &Grade)> {
    outcomes.iter().filter_map(|(case, outcome)| Some((case, outcome.as_ref().ok()?)))
}

fn write_targets(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    writeln!(t, "\n## Targets\n\n| what | reached | target |\n|---|---|---|")?;
    write_first_rows(t, outcomes)?;

    let has_only_clear_faults = |case: &Case| {
        !case.planted.is_empty()
            && case.is_excited
            && case.planted.iter().all(|planted| planted.magnitude >= MIN_MAGNITUDE_TO_FIND)
    };
    let fates = |min_faults: usize, max_faults: usize| {
        graded(outcomes).filter(move |(case, _)| {
            has_only_clear_faults(case) && (min_faults..=max_faults).contains(&case.planted.len())
        })
    };
    for (min_faults, max_faults, what) in
        [(1, 1, "one fault"), (2, 2, "two faults"), (3, usize::MAX, "four faults")]
    {
        let faults =
            || fates(min_faults, max_faults).flat_map(|(_, verdict)| &verdict.fault_outcomes);
        let named = faults().filter(|fate| fate.is_named()).count();
        let target = if max_faults == 1 { "≥ 99 %" } else { "≥ 98 %" };
        writeln!(
            t,
            "| {what}, each at twice its threshold or more: named | {} | {target} |",
            share(named, faults().count())
        )?;
        let right = |(_, verdict): &(&Case, &Grade)| {
            verdict.fault_outcomes.iter().all(|fate| fate.is_named())
                && verdict.false_findings.is_empty()
        };
        let logs = fates(min_faults, max_faults).count();
        writeln!(
            t,
            "| {what}: logs with exactly these named | {} | |",
            share(fates(min_faults, max_faults).filter(right).count(), logs)
        )?;
    }

    let conventions: Vec<bool> = graded(outcomes)
        .flat_map(|(_, verdict)| verdict.conventions_right.iter().copied())
        .collect();
    let right = conventions.iter().filter(|&&right| right).count();
    writeln!(
        t,
        "| convention right where the motion dwells | {} | 100 % |",
        share(right, conventions.len())
    )?;

    for (noise, latency, zero) in
        [("white", "≤ 20 µs", "≤ 0.001°"), ("coloured", "≤ 0.2 ms", "≤ 0.01°")]
    {
        let errors = |code: &'static str| {
            let cases = graded(outcomes).filter(move |(case, _)| {
                case.noise == noise && case.is_at_125_hz() && case.is_excited
            });
            cases.flat_map(|(_, verdict)| &verdict.intervals).filter(move |one| one.code == code)
        };
        let absolute = |code| median(errors(code).map(|one| one.error.abs()).collect());
        let format_value = |value: Option<f64>, show: &dyn Fn(f64) -> String| {
            value.map_or_else(|| "no such log".to_owned(), show)
        };
        writeln!(
            t,
            "| median latency error at 125 Hz, {noise} noise | {} | {latency} |",
            format_value(absolute("LAT001"), &|s| format!("{:.1} µs", s * 1e6))
        )?;
        writeln!(
            t,
            "| median joint zero error at 125 Hz, {noise} noise | {} | {zero} |",
            format_value(absolute("ZER001"), &|rad| format!("{:.5}°", rad / DEGREE))
        )?;
        let drifting = errors("YAW001").filter(|one| one.planted.is_some());
        let relative = median(drifting.map(|one| (one.error / one.truth).abs()).collect());
        writeln!(
            t,
            "| median drift rate error at 125 Hz, {noise} noise | {} | ≤ 1 % |",
            format_value(relative, &|share| format!("{:.2} %", 100.0 * share))
        )?;
    }

    let covered = |norms: bool, model_error: bool| {
        let all: Vec<&Interval> = graded(outcomes)
            .filter(|(case, _)| case.background.has_model_error() == model_error)
            .flat_map(|(_, verdict)| &verdict.intervals)
            .filter(|one| one.is_norm == norms)
            .collect();
        share(all.iter().filter(|one| one.is_covered).count(), all.len())
    };
    for (what, norms) in [("amounts", false), ("norms", true)] {
        for (how, model_error) in [("", false), (", with model error", true)] {
            let covered = covered(norms, model_error);
            writeln!(t, "| coverage of the 95 % intervals of {what}{how} | {covered} | 92–98 % |")?;
        }
    }
    write_link_rows(t, outcomes)
}

/// Zero offsets on arms with link deviations.
fn write_link_rows(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let on = |background: Background| {
        graded(outcomes).filter(move |(case, _)| case.background == background)
    };
    let zeros: Vec<bool> = on(Background::Links)
        .flat_map(|(case, verdict)| {
            let both = case.planted.iter().zip(&verdict.fault_outcomes);
            let due = both.filter(|(one, _)| one.kind == FaultKind::Zero && case.must_find(one));
            due.map(|(_, fate)| fate.is_named())
        })
        .collect();
    writeln!(
        t,
        "| joint zeros that must be found, links off by 0.05–0.2 mm: named | {} | ≥ 98 % |",
        share(zeros.iter().filter(|named| **named).count(), zeros.len())
    )?;
    let falsely = on(Background::CoarseLinks)
        .filter(|(_, verdict)| verdict.false_findings.contains(&"ZER001"));
    writeln!(
        t,
        "| logs with a false joint zero, links off by 1 mm | {} | ≤ 0.5 % |",
        share(falsely.count(), on(Background::CoarseLinks).count())
    )?;
    let of_zeros: Vec<&Interval> = on(Background::Links)
        .chain(on(Background::CoarseLinks))
        .flat_map(|(_, verdict)| &verdict.intervals)
        .filter(|one| one.code == "ZER001")
        .collect();
    writeln!(
        t,
        "| coverage of the 95 % intervals of joint zeros, links off | {} | 92–98 % |",
        share(of_zeros.iter().filter(|one| one.is_covered).count(), of_zeros.len())
    )
}

/// Each rule's detection rate by magnitude.
fn write_detection(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    writeln!(
        t,
        "\n## Detection by amount, in units of the first threshold\n\nShare of planted faults that are \
         named, in logs with one or more faults; *other* are faults without an amount or with a different \
         one. Motions of less than 0.2 rad are listed separately. Unnamed faults are undecided (`?`) or \
         passed (`!`).\n"
    )?;
    let no_magnitude = f64::INFINITY;
    let columns: Vec<f64> = MAGNITUDES.into_iter().chain([no_magnitude]).collect();
    write!(t, "| rule |")?;
    for times in &columns {
        if *times == no_magnitude { write!(t, " other |")? } else { write!(t, " ×{times} |")? }
    }
    writeln!(t, "\n|---|{}", "---|".repeat(columns.len()))?;
    let mut codes: Vec<(&str, FaultKind, bool)> = graded(outcomes)
        .flat_map(|(case, _)| {
            case.planted.iter().map(|planted| (planted.codes[0], planted.kind, !case.is_excited))
        })
        .collect();
    codes.sort_unstable();
    codes.dedup();
    for (code, kind, small) in codes {
        write!(t, "| {code} {kind:?}{} |", if small { ", small motion" } else { "" })?;
        for &times in &columns {
            let fates: Vec<FaultOutcome> = graded(outcomes)
                .filter(|(case, _)| case.is_excited != small)
                .flat_map(|(case, verdict)| case.planted.iter().zip(&verdict.fault_outcomes))
                .filter(|(planted, _)| planted.kind == kind)
                .filter(|(planted, _)| {
                    planted.magnitude == times
                        || (times == no_magnitude && !MAGNITUDES.contains(&planted.magnitude))
                })
                .map(|(_, fate)| *fate)
                .collect();
            let named = fates.iter().filter(|fate| fate.is_named()).count();
            let undecided =
                fates.iter().filter(|&&fate| fate == FaultOutcome::Inconclusive).count();
            let passed = fates.len() - named - undecided;
            if fates.is_empty() {
                write!(t, " |")?;
                continue;
            }
            write!(t, " {:.0} % of {}", percent(named, fates.len()), fates.len())?;
            if undecided > 0 {
                write!(t, " {undecided}?")?;
            }
            if passed > 0 {
                write!(t, " {passed}!")?;
            }
            write!(t, " |")?;
        }
        writeln!(t)?;
    }
    Ok(())
}

/// False findings, by rule.
fn write_false_findings(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let clean = graded(outcomes).filter(|(case, _)| case.planted.is_empty()).count();
    let faulty = graded(outcomes).count() - clean;
    writeln!(
        t,
        "\n## False findings, in 1000 logs\n\n| rule | clean ({clean}) | faulty ({faulty}) |\n|---|---|---|"
    )?;
    let mut logs: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for (case, verdict) in graded(outcomes) {
        let mut codes: Vec<&str> =
            verdict.false_findings.iter().chain(&verdict.other_false_findings).copied().collect();
        codes.sort_unstable();
        codes.dedup();
        for code in codes {
            logs.entry(code).or_default()[usize::from(!case.planted.is_empty())] += 1;
        }
    }
    for (code, [alarms, misattributions]) in logs {
        writeln!(
            t,
            "| {code} | {:.1} | {:.1} |",
            10.0 * percent(alarms, clean),
            10.0 * percent(misattributions, faulty)
        )?;
    }
    Ok(())
}

/// Coverage and errors by rule; if verbose, also by noise, motion, velocities and topic.
fn write_intervals(t: &mut String, outcomes: &Outcomes, verbose: bool) -> fmt::Result {
    writeln!(
        t,
        "\n## Intervals at 95 %\n\nFaults that are not planted, and those at twice the threshold or more; \
         SI units.\n\n\
         | rule | planted | estimates | covered | bias | median error |\n|---|---|---|---|---|---|"
    )?;
    let mut rows: BTreeMap<(String, String), Vec<&Interval>> = BTreeMap::new();
    for (case, verdict) in graded(outcomes) {
        for one in &verdict.intervals {
            let planted = one.planted.map_or("nothing".to_owned(), |kind| format!("{kind:?}"));
            let how = if case.background.has_model_error() { ", model error" } else { "" };
            rows.entry((format!("{}{how}", one.code), planted.clone())).or_default().push(one);
            if verbose {
                let velocity = case.scenario.joints.has_velocity;
                let velocity = if velocity { "with" } else { "without" };
                for detail in [
                    format!("{}, {} noise", one.code, case.noise),
                    format!("{}, {} motion", one.code, case.motion),
                    format!("{}, {velocity} velocities", one.code),
                    format!("{}, {}", one.code, one.topic),
                ] {
                    rows.entry((detail, planted.clone())).or_default().push(one);
                }
            }
        }
    }
    for ((row, planted), of) in rows {
        let covered = of.iter().filter(|one| one.is_covered).count();
        let bias = of.iter().map(|one| one.error).sum::<f64>() / of.len() as f64;
        let error = median(of.iter().map(|one| one.error.abs()).collect()).unwrap_or_default();
        writeln!(
            t,
            "| {row} | {planted} | {} | {:.1} % | {bias:+.1e} | {error:.1e} |",
            of.len(),
            percent(covered, of.len())
        )?;
    }
    Ok(())
}

/// Every wrong outcome, with the arguments that reproduce its log.
fn write_wrong_outcomes(t: &mut String, outcomes: &Outcomes) -> fmt::Result {
    let mut groups: BTreeMap<&str, Vec<(&Case, &str)>> = BTreeMap::new();
    for (case, outcome) in outcomes {
        match outcome {
            Ok(verdict) => {
                for (kind, what) in &verdict.wrong_outcomes {
                    groups.entry(kind).or_default().push((case, what));
                }
            }
            Err(AuditFailure::Panic) => groups.entry("panic").or_default().push((case, "")),
            Err(AuditFailure::Refused(what)) => {
                groups.entry("not audited").or_default().push((case, what))
            }
        }
    }
    writeln!(t, "\n## Wrong outcomes")?;
    for (kind, cases) in groups {
        writeln!(t, "\n### {kind}: {}\n", cases.len())?;
        for (case, what) in cases {
            writeln!(t, "- {case}\n  {what}")?;
        }
    }
    Ok(())
}

fn share(part: usize, whole: usize) -> String {
    match whole {
        0 => "no such log".to_owned(),
        _ => format!("{:.1} % ({part} of {whole})", percent(part, whole)),
    }
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
