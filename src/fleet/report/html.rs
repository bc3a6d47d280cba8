//! Fleet report as an HTML page.

use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

use maud::{Markup, html};
use percent_encoding::utf8_percent_encode;
use serde_json::{Map, Value};

use super::text::{arm_counts, frequency_text, header_lines, totals_text};
use super::{
    DatasetRow, FindingRow, FleetReport, TrendKind, TrendPosition, TrendRow, calendar, trends,
};
use crate::checks::{self, Rule};
use crate::finding::Severity;
use crate::fleet::FailureGroup;
use crate::log::ESCAPED;
use crate::report::Verdict;
use crate::report::html::{
    Plot, PlotLimit, PlotSeries, PlotStyle, SeriesRole, css_percent, page_shell,
};

const MAX_PLOTS: usize = 100;

/// Limit per table; JSON contains all.
const MAX_ROWS: usize = 500;

/// Logs per plot.
const MAX_POINTS: usize = 1000;

/// The output is deterministic.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &FleetReport, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(page(report).into_string().as_bytes())
}

fn page(report: &FleetReport) -> Markup {
    let verdict = report.verdict();
    let class = match verdict {
        Verdict::Pass => "fleet pass",
        Verdict::Inconclusive => "fleet open",
        Verdict::Fail => "fleet fail",
    };
    let drawn: Vec<(String, &TrendRow, Plot)> = trend_plots(report);
    let plots: Map<String, Value> =
        drawn.iter().map(|(id, _, plot)| (id.clone(), plot.json(MAX_POINTS))).collect();
    let (found_trends, others): (Vec<_>, Vec<_>) =
        drawn.iter().partition(|(_, row, _)| row.kind.is_trend());
    let body = html! {
        a .skip href="#moves" { "Skip to trends" }
        header .page {
            p .tool { "poseaudit" }
            h1 { "Fleet" }
            dl .facts {
                @for (label, said) in header_lines(report) { dt { (label) } dd { (said) } }
            }
        }
        main {
            section .verdict aria-labelledby="verdict" {
                h2 #verdict { strong { (verdict) } " " span { (totals_text(report)) } }
            }
            noscript {
                p .note { "The plots need JavaScript; their values are in the tables under them." }
            }
            section #moves aria-labelledby="moves-title" {
                h2 #moves-title { "Trends" }
                p { (trends::counts_text(&report.trends)) }
                @for (id, row, plot) in &found_trends { (trend_article(id, row, plot)) }
            }
            (findings(report))
            (arms(report))
            (failures(report))
            (all_trends(report))
            (datasets(report))
            (logs(report))
            @if !others.is_empty() {
                section #plots aria-labelledby="plots-title" {
                    h2 #plots-title { "Over time" }
                    div .proof {
                        @for (id, _, plot) in &others { (plot.markup(id, None, MAX_POINTS)) }
                    }
                }
            }
        }
        footer {
            @for next in report.next_commands() {
                p { (next.purpose) }
                pre .call tabindex="0" { (next.command) }
            }
        }
    };
    page_shell(&format!("{verdict} · fleet of {} logs", report.logs.total), class, &body, plots)
}

/// Found trends first.
fn trend_plots(report: &FleetReport) -> Vec<(String, &TrendRow, Plot)> {
    let rows = report.trends.iter().filter(|row| row.level.is_some());
    let numbered = rows.take(MAX_PLOTS).enumerate();
    numbered.map(|(index, row)| (format!("trend-{}", index + 1), row, trend_plot(row))).collect()
}

/// Over days or episodes, with its line.
fn trend_plot(row: &TrendRow) -> Plot {
    let (factor, y_label) = display_factor(&row.unit);
    let first = row.points.first().map_or(TrendPosition::Episode(0), |first| first.at);
    let (per, x_label, origin) = match first {
        TrendPosition::Time(first_ns) => {
            (86_400.0, "days", format!("Day 0 is {}.", calendar::format_day(first_ns)))
        }
        TrendPosition::Episode(_) => {
            (1.0, "episodes", "Episodes are counted from the first.".to_owned())
        }
    };
    let x: Vec<f64> = row.points.iter().map(|point| point.at.elapsed_since(first) / per).collect();
    let half = |ci95: [f64; 2]| 0.5 * (ci95[1] - ci95[0]) * factor;
    let amounts = PlotSeries {
        label: row.name.clone(),
        role: SeriesRole::Amount,
        values: row.points.iter().map(|point| point.value * factor).collect(),
        half_widths: row.points.iter().map(|point| half(point.ci95)).collect(),
    };
    let last = x.last().copied().filter(|&last| last > 0.0).unwrap_or(1.0);
    // A line does not describe a step.
    let line = row.line.filter(|_| row.kind != TrendKind::Stepped).map(|[from, to]| {
        let values = x.iter().map(|day| (from + (to - from) * day / last) * factor);
        PlotSeries::new("fit", SeriesRole::Reference, values)
    });
    let limits = match amounts.values.iter().all(|&value| value >= 0.0) {
        true => PlotLimit::upper(row.threshold, row.display_unit(), factor),
        false => PlotLimit::signed(row.threshold, row.display_unit(), factor),
    };
    Plot {
        title: "Over time",
        robot: row.subject.robot.clone().unwrap_or_default(),
        stream: format!("{} {} {}", row.code, row.subject.arm_label(), row.subject.part_label()),
        caption: match row.kind.is_trend() {
            // The heading contains the summary.
            true => origin,
            false => format!("{}: {}. {origin}", row.kind.name(), row.summary()),
        },
        x,
        x_label,
        y_label,
        series: std::iter::once(amounts).chain(line).collect(),
        style: PlotStyle::AmountPoints,
        limits,
        shows_limits: true,
        ..Plot::default()
    }
}

/// Factor and symbol of the display unit.
fn display_factor(symbol: &str) -> (f64, &'static str) {
    match symbol {
        "m" => (1e3, "mm"),
        "rad" => (1f64.to_degrees(), "°"),
        "s" => (1e3, "ms"),
        "rad/s" => (60.0 * 1f64.to_degrees(), "°/min"),
        "s/s" => (1e6, "ppm"),
        "m/m" => (1e3, "mm/m"),
        "rad/s²" => (1.0, "rad/s²"),
        "m/s²" => (1.0, "m/s²"),
        _ => (1.0, ""),
    }
}

fn trend_article(id: &str, row: &TrendRow, plot: &Plot) -> Markup {
    html! {
        article .finding .warning aria-labelledby={ (id) "-title" } {
            p .badge {
                span .severity { (row.kind.name()) } " " code { (row.code) } " "
                span .kind { (row.name) }
            }
            h3 id={ (id) "-title" } {
                span .subject { (row.subject.arm_label()) " " (row.subject.part_label()) } " "
                span .message { (row.summary()) }
            }
            div .proof { (plot.markup(id, Some(&plot.stream), MAX_POINTS)) }
        }
    }
}

/// One table per rule, the rule with the most findings first.
fn findings(report: &FleetReport) -> Markup {
    let mut rules: Vec<(&str, Vec<&FindingRow>)> = Vec::new();
    for row in &report.findings {
        match rules.iter_mut().find(|(code, _)| *code == row.code) {
            Some((_, rows)) => rows.push(row),
            None => rules.push((&row.code, vec![row])),
        }
    }
    rules.sort_by_key(|(_, rows)| {
        let severity = rows.iter().map(|row| row.severity).max();
        Reverse((severity, rows.iter().map(|row| row.logs).sum::<usize>()))
    });
    html! {
        @if !rules.is_empty() {
            section #findings aria-labelledby="findings-title" {
                h2 #findings-title { "Findings" }
                @for (code, rows) in &rules { (rule_findings(code, rows)) }
            }
        }
    }
}

fn rule_findings(code: &str, rows: &[&FindingRow]) -> Markup {
    let severity = rows.iter().map(|row| row.severity).max().unwrap_or(Severity::Info).name();
    let arms: BTreeSet<String> = rows.iter().map(|row| row.subject.arm_label()).collect();
    let summary = checks::find(code).map_or("", Rule::summary);
    let id = format!("rule-{code}");
    html! {
        article .finding .(severity) aria-labelledby=(id) {
            p .badge { span .severity { (severity) } " " code { (code) } }
            h3 id=(id) { (summary) }
            p .note { (counted(arms.len(), "arm")) ", " (counted(rows.len(), "subject")) }
            (table(&id, &["arm", "subject", "found", "worst", "last"], rows, |row| {
                let place = |message: &str, path: &str| {
                    html! { (message) " " span .quiet { (path) } }
                };
                vec![
                    html! { (row.subject.arm_label()) },
                    html! { (row.subject.part_label()) },
                    html! { (row.title) ", " (frequency_text(row)) },
                    match &row.worst {
                        Some(worst) => place(&worst.message, &worst.path),
                        None => Markup::default(),
                    },
                    place(&row.message, &row.path),
                ]
            }))
        }
    }
}

/// `1 arm`, `2 arms`.
fn counted(count: usize, name: &str) -> String {
    format!("{count} {name}{}", if count == 1 { "" } else { "s" })
}

fn arms(report: &FleetReport) -> Markup {
    section("arms", "Arms", &["arm", "logs", "rules"], &report.arms, |arm| {
        let share = |logs: usize| css_percent(logs as f64 / arm.logs.max(1) as f64);
        let rules = html! {
            @for fail in &arm.fails {
                span .cell style={ "--share:" (share(fail.logs)) } {
                    code { (fail.code) } " " (fail.logs) span .quiet { " of " (arm.logs) }
                } " "
            }
        };
        vec![html! { (arm.subject.arm_label()) }, html! { (arm_counts(arm)) }, rules]
    })
}

/// Link relative to the page, or absolute.
fn page_link(page: &Path) -> String {
    let page = page.display().to_string();
    let path = utf8_percent_encode(&page, ESCAPED);
    if page.starts_with('/') { format!("file://{path}") } else { path.to_string() }
}

fn logs(report: &FleetReport) -> Markup {
    let heads = ["log", "begins", "arm", "result", "found"];
    section("logs", "Logs", &heads, &report.rows, |row| {
        let start_ns = row.start_ns.as_ref().and_then(|start| start.parse().ok());
        vec![
            match &row.page {
                Some(page) => html! { a href=(page_link(page)) { (row.path) } },
                None => html! { (row.path) },
            },
            html! { @if let Some(start_ns) = start_ns { (calendar::format_day(start_ns)) } },
            html! { (row.subject.arm_label()) },
            match row.verdict {
                Some(verdict) => html! { (verdict) },
                None => html! { (row.status.name().replace('_', " ")) },
            },
            html! { (row.codes.join(", ")) },
        ]
    })
}

/// Content of the columns.
fn datasets(report: &FleetReport) -> Markup {
    let rows: Vec<[String; 4]> = report.datasets.iter().flat_map(dataset_rows).collect();
    section("datasets", "Columns", &["dataset", "content", "columns", "by"], &rows, |row| {
        row.iter().map(|cell| html! { (cell) }).collect()
    })
}

fn dataset_rows(dataset: &DatasetRow) -> Vec<[String; 4]> {
    let row = |content: &str, columns: String, why: &str| {
        [dataset.dataset.clone(), content.to_owned(), columns, why.to_owned()]
    };
    let robot =
        dataset.robot.iter().map(|robot| row("arm", robot.clone(), "all sampled logs agree"));
    let columns = dataset.columns.iter().map(|of| row(&of.is, of.columns.join(", "), &of.why));
    let open = dataset.open_question.iter().map(|open| row("open", String::new(), open));
    robot.chain(columns).chain(open).collect()
}

fn failures(report: &FleetReport) -> Markup {
    let groups = FailureGroup::group(&report.errors);
    section("errors", "Not audited", &["reason", "logs", "what to do"], &groups, |group| {
        let [what, paths, _] = group.lines();
        vec![html! { (what) }, html! { (paths) }, html! { (group.remedy) }]
    })
}

/// Determined trends one by one, the others by rule.
fn all_trends(report: &FleetReport) -> Markup {
    let is_determined = |row: &&TrendRow| row.kind != TrendKind::Undetermined;
    let determined: Vec<&TrendRow> = report.trends.iter().filter(is_determined).collect();
    let undetermined: Vec<_> = trends::undetermined_by_rule(&report.trends).into_iter().collect();
    let heads = ["rule", "arm", "subject", "trend", "change"];
    html! {
        (section("trends", "All trends", &heads, &determined, |row| vec![
            html! { code { (row.code) } },
            html! { (row.subject.arm_label()) },
            html! { (row.subject.part_label()) },
            html! { (row.kind.name()) },
            html! { (row.summary()) },
        ]))
        (section("undetermined", "Trends not determined", &["rule", "estimates"], &undetermined, |row| {
            let (code, counts) = row;
            vec![html! { code { (code) } }, html! { (trends::undetermined_text(*counts)) }]
        }))
    }
}

/// Empty without rows.
fn section<T>(
    id: &str,
    title: &str,
    heads: &[&str],
    rows: &[T],
    cells: impl Fn(&T) -> Vec<Markup>,
) -> Markup {
    html! {
        @if !rows.is_empty() {
            section id=(id) aria-labelledby={ (id) "-title" } {
                h2 id={ (id) "-title" } { (title) }
                (table(&format!("{id}-title"), heads, rows, cells))
            }
        }
    }
}

/// Each row becomes a block on a narrow screen, where every cell names its column. The first cell is the
/// heading of its row.
fn table<T>(
    title_id: &str,
    heads: &[&str],
    rows: &[T],
    cells: impl Fn(&T) -> Vec<Markup>,
) -> Markup {
    html! {
        table .stack aria-labelledby=(title_id) {
            thead { tr { @for head in heads { th scope="col" { (head) } } } }
            tbody {
                @for row in rows.iter().take(MAX_ROWS) {
                    tr {
                        @for (index, (head, cell)) in heads.iter().zip(cells(row)).enumerate() {
                            @if index == 0 {
                                th scope="row" { (cell) }
                            } @else {
                                td data-head=(head) { (cell) }
                            }
                        }
                    }
                }
            }
        }
        @if rows.len() > MAX_ROWS {
            p .note { "and " (rows.len() - MAX_ROWS) " more, which the JSON report lists" }
        }
    }
}
