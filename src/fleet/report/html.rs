//! Fleet report as an HTML page.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

use maud::{Markup, html};
use percent_encoding::utf8_percent_encode;
use serde_json::{Map, Value};

use super::text::{frequency_text, header_lines, totals_text};
use super::{DatasetRow, FindingRow, FleetReport, TrendKind, TrendPosition, TrendRow, calendar};
use crate::log::ESCAPED;
use crate::report::html::{Plot, PlotSeries, PlotStyle, SeriesRole, css_percent, page_shell};

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
    let (class, word) = if report.failing { ("fail", "FAIL") } else { ("pass", "PASS") };
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
                h2 #verdict { strong { (word) } " " span { (totals_text(report)) } }
            }
            noscript {
                p .note { "The plots need JavaScript; their values are in the tables under them." }
            }
            section #moves aria-labelledby="moves-title" {
                h2 #moves-title .quiet[found_trends.is_empty()] {
                    @if found_trends.is_empty() { "No trend found" } @else { "Trends found" }
                }
                @for (id, row, plot) in &found_trends { (trend_article(id, row, plot)) }
            }
            (datasets(report))
            (findings(report))
            (rule_matrix(report))
            (arms(report))
            (logs(report))
            (errors(report))
            (trends(report))
            @if !others.is_empty() {
                section #plots aria-labelledby="plots-title" {
                    h2 #plots-title { "Over time" }
                    div .proof {
                        @for (id, _, plot) in &others { (plot.markup(id, None, MAX_POINTS)) }
                    }
                }
            }
        }
    };
    page_shell(&format!("{word} · fleet of {} logs", report.logs.total), class, &body, plots)
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
    let line = row.line.filter(|_| row.kind != TrendKind::Stepped).map(|[from, to]| PlotSeries {
        label: "line".to_owned(),
        role: SeriesRole::Reference,
        values: x.iter().map(|day| (from + (to - from) * day / last) * factor).collect(),
        half_widths: Vec::new(),
    });
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
        style: PlotStyle::Curve,
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

fn findings(report: &FleetReport) -> Markup {
    let row = |row: &FindingRow| {
        html! {
            tr .(row.severity.name()) {
                th scope="row" { span .severity { (row.severity.name()) } " " code { (row.code) } }
                td { (row.subject.arm_label()) }
                td { (row.subject.part_label()) }
                td .words { (row.title) ", " (frequency_text(row)) }
                td .words {
                    @if let Some(worst) = &row.worst {
                        (worst.message) br; span .quiet { (worst.path) }
                    }
                }
                td .words { (row.message) br; span .quiet { (row.path) } }
            }
        }
    };
    table("findings", "Findings", &["", "arm", "of", "", "worst", "last"], &report.findings, row)
}

fn arms(report: &FleetReport) -> Markup {
    table("arms", "Arms", &["arm", "logs", "pass", "fail", "open", "rules"], &report.arms, |row| {
        let fails = row.fails.iter().map(|fail| format!("{} in {}", fail.code, fail.logs));
        html! {
            tr {
                th scope="row" { (row.subject.arm_label()) }
                td { (row.logs) }
                td { (row.verdicts.pass) }
                td { (row.verdicts.fail) }
                td { (row.verdicts.inconclusive) }
                td .words { (fails.collect::<Vec<_>>().join(", ")) }
            }
        }
    })
}

/// Logs with findings, per rule and arm.
fn rule_matrix(report: &FleetReport) -> Markup {
    let codes: BTreeSet<&str> =
        report.arms.iter().flat_map(|arm| &arm.fails).map(|fail| fail.code.as_str()).collect();
    if codes.is_empty() {
        return Markup::default();
    }
    let heads: Vec<&str> = std::iter::once("arm").chain(codes.iter().copied()).collect();
    table("matrix", "Arms and rules", &heads, &report.arms, |arm| {
        let logs =
            |code: &str| arm.fails.iter().find(|fail| fail.code == code).map(|fail| fail.logs);
        html! {
            tr {
                th scope="row" { (arm.subject.arm_label()) }
                @for code in &codes {
                    @match logs(code) {
                        Some(count) => {
                            td .cell style={ "--share:" (css_percent(count as f64 / arm.logs.max(1) as f64)) } {
                                (count) span .quiet { " of " (arm.logs) }
                            }
                        }
                        None => { td .quiet { "–" } }
                    }
                }
            }
        }
    })
}

/// Link relative to the page, or absolute.
fn page_link(page: &Path) -> String {
    let page = page.display().to_string();
    let path = utf8_percent_encode(&page, ESCAPED);
    if page.starts_with('/') { format!("file://{path}") } else { path.to_string() }
}

fn logs(report: &FleetReport) -> Markup {
    let heads = ["begins", "log", "arm", "", "found"];
    table("logs", "Logs", &heads, &report.rows, |row| {
        let start_ns = row.start_ns.as_ref().and_then(|start| start.parse().ok());
        html! {
            tr {
                td { @if let Some(start_ns) = start_ns { (calendar::format_day(start_ns)) } }
                th scope="row" .words {
                    @match &row.page {
                        Some(page) => { a href=(page_link(page)) { (row.path) } }
                        None => { (row.path) }
                    }
                }
                td { (row.subject.arm_label()) }
                td { @match row.verdict { Some(verdict) => { (verdict) } None => { (row.status.name()) } } }
                td { (row.codes.join(", ")) }
            }
        }
    })
}

/// Content of the columns.
fn datasets(report: &FleetReport) -> Markup {
    let rows: Vec<(&DatasetRow, String, String, &str)> = report
        .datasets
        .iter()
        .flat_map(|dataset| {
            let robot = dataset.robot.iter().map(move |robot| {
                (dataset, "arm".to_owned(), robot.clone(), "all sampled logs agree")
            });
            let columns = dataset.columns.iter().map(move |row| {
                (dataset, row.is.clone(), row.columns.join(", "), row.why.as_str())
            });
            let open = dataset
                .open_question
                .iter()
                .map(move |open| (dataset, "open".to_owned(), String::new(), open.as_str()));
            robot.chain(columns).chain(open)
        })
        .collect();
    table("datasets", "Columns", &["dataset", "what", "columns", "by"], &rows, |row| {
        let (dataset, cell, columns, why) = row;
        html! {
            tr {
                th scope="row" .words { (dataset.dataset) }
                td { (cell) }
                td .words { (columns) }
                td .words { (why) }
            }
        }
    })
}

fn errors(report: &FleetReport) -> Markup {
    table("errors", "Not audited", &["log", "", "what"], &report.errors, |row| {
        html! {
            tr {
                th scope="row" { (row.path) }
                td { (row.status.name()) }
                td .words { (row.what) "; " (row.remedy) }
            }
        }
    })
}

fn trends(report: &FleetReport) -> Markup {
    table("trends", "Trends", &["rule", "arm", "of", "", ""], &report.trends, |row| {
        html! {
            tr {
                th scope="row" { code { (row.code) } }
                td { (row.subject.arm_label()) }
                td { (row.subject.part_label()) }
                td { (row.kind.name()) }
                td .words { (row.summary()) }
            }
        }
    })
}

/// Empty without rows.
fn table<T>(
    id: &str,
    title: &str,
    heads: &[&str],
    rows: &[T],
    row: impl Fn(&T) -> Markup,
) -> Markup {
    html! {
        @if !rows.is_empty() {
            section id=(id) aria-labelledby={ (id) "-title" } {
                h2 id={ (id) "-title" } { (title) }
                div .scroll tabindex="0" role="region" aria-labelledby={ (id) "-title" } {
                    table {
                        thead { tr { @for head in heads { th scope="col" { (head) } } } }
                        tbody { @for one in rows.iter().take(MAX_ROWS) { (row(one)) } }
                    }
                }
                @if rows.len() > MAX_ROWS {
                    p .note { "and " (rows.len() - MAX_ROWS) " more, which the JSON report lists" }
                }
            }
        }
    }
}
