//! Fleet report as an HTML page.

use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::Path;

use maud::{Markup, html};
use percent_encoding::utf8_percent_encode;
use serde_json::{Map, Value};

use super::text::{head, how_often, totals};
use super::{At, Course, DatasetRow, FindingRow, FleetReport, TrendRow, calendar};
use crate::log::ESCAPED;
use crate::report::html::{Plot, PlotSeries, PlotStyle, SeriesRole, css_percent, page_shell};

const MOST_PLOTS: usize = 100;

/// Limit per table; JSON contains all.
const MOST_ROWS: usize = 500;

/// Logs per plot.
const MOST_POINTS: usize = 1000;

/// The output is deterministic.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &FleetReport, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(page(report).into_string().as_bytes())
}

fn page(report: &FleetReport) -> Markup {
    let (class, word) = if report.failing { ("fail", "FAIL") } else { ("pass", "PASS") };
    let drawn: Vec<(String, &TrendRow, Plot)> = drawn(report);
    let plots: Map<String, Value> =
        drawn.iter().map(|(id, _, plot)| (id.clone(), plot.json(MOST_POINTS))).collect();
    let (moving, others): (Vec<_>, Vec<_>) =
        drawn.iter().partition(|(_, row, _)| row.course.is_moving());
    let body = html! {
        a .skip href="#moves" { "Skip to trends" }
        header .page {
            p .tool { "poseaudit" }
            h1 { "Fleet" }
            dl .facts {
                @for (label, said) in head(report) { dt { (label) } dd { (said) } }
            }
        }
        main {
            section .verdict aria-labelledby="verdict" {
                h2 #verdict { strong { (word) } " " span { (totals(report)) } }
            }
            noscript {
                p .note { "The plots need JavaScript; their values are in the tables under them." }
            }
            section #moves aria-labelledby="moves-title" {
                h2 #moves-title .quiet[moving.is_empty()] {
                    @if moving.is_empty() { "No trend found" } @else { "Trends found" }
                }
                @for (id, row, plot) in &moving { (article(id, row, plot)) }
            }
            (datasets(report))
            (findings(report))
            (matrix(report))
            (arms(report))
            (logs(report))
            (errors(report))
            (trends(report))
            @if !others.is_empty() {
                section #plots aria-labelledby="plots-title" {
                    h2 #plots-title { "Over time" }
                    div .proof {
                        @for (id, _, plot) in &others { (plot.markup(id, None, MOST_POINTS)) }
                    }
                }
            }
        }
    };
    page_shell(&format!("{word} · fleet of {} logs", report.logs.total), class, &body, plots)
}

/// Found trends first.
fn drawn(report: &FleetReport) -> Vec<(String, &TrendRow, Plot)> {
    let rows = report.trends.iter().filter(|row| row.level.is_some());
    let numbered = rows.take(MOST_PLOTS).enumerate();
    numbered.map(|(index, row)| (format!("trend-{}", index + 1), row, plot(row))).collect()
}

/// Over days or episodes, with its line.
fn plot(row: &TrendRow) -> Plot {
    let (factor, y_label) = everyday(&row.unit);
    let first = row.points.first().map_or(At::Episode(0), |first| first.at);
    let (per, x_label, origin) = match first {
        At::Time(first_ns) => (86_400.0, "days", format!("Day 0 is {}.", calendar::day(first_ns))),
        At::Episode(_) => (1.0, "episodes", "Episodes are counted from the first.".to_owned()),
    };
    let x: Vec<f64> = row.points.iter().map(|point| point.at.since(first) / per).collect();
    let half = |ci95: [f64; 2]| 0.5 * (ci95[1] - ci95[0]) * factor;
    let amounts = PlotSeries {
        label: row.name.clone(),
        role: SeriesRole::Amount,
        values: row.points.iter().map(|point| point.value * factor).collect(),
        half_widths: row.points.iter().map(|point| half(point.ci95)).collect(),
    };
    let last = x.last().copied().filter(|&last| last > 0.0).unwrap_or(1.0);
    // A line does not describe a step.
    let line = row.line.filter(|_| row.course != Course::Stepped).map(|[from, to]| PlotSeries {
        label: "line".to_owned(),
        role: SeriesRole::Reference,
        values: x.iter().map(|day| (from + (to - from) * day / last) * factor).collect(),
        half_widths: Vec::new(),
    });
    Plot {
        title: "Over time",
        robot: row.whose.robot.clone().unwrap_or_default(),
        stream: format!("{} {} {}", row.code, row.whose.arm_label(), row.whose.part()),
        caption: match row.course.is_moving() {
            // The heading contains the summary.
            true => origin,
            false => format!("{}: {}. {origin}", row.course.name(), row.says()),
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
fn everyday(symbol: &str) -> (f64, &'static str) {
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

fn article(id: &str, row: &TrendRow, plot: &Plot) -> Markup {
    html! {
        article .finding .warning aria-labelledby={ (id) "-title" } {
            p .badge {
                span .severity { (row.course.name()) } " " code { (row.code) } " "
                span .kind { (row.name) }
            }
            h3 id={ (id) "-title" } {
                span .subject { (row.whose.arm_label()) " " (row.whose.part()) } " "
                span .message { (row.says()) }
            }
            div .proof { (plot.markup(id, Some(&plot.stream), MOST_POINTS)) }
        }
    }
}

fn findings(report: &FleetReport) -> Markup {
    let row = |row: &FindingRow| {
        html! {
            tr .(row.severity.name()) {
                th scope="row" { span .severity { (row.severity.name()) } " " code { (row.code) } }
                td { (row.whose.arm_label()) }
                td { (row.whose.part()) }
                td .words { (row.title) ", " (how_often(row)) }
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
                th scope="row" { (row.whose.arm_label()) }
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
fn matrix(report: &FleetReport) -> Markup {
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
                th scope="row" { (arm.whose.arm_label()) }
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
fn link(page: &Path) -> String {
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
                td { @if let Some(start_ns) = start_ns { (calendar::day(start_ns)) } }
                th scope="row" .words {
                    @match &row.page {
                        Some(page) => { a href=(link(page)) { (row.path) } }
                        None => { (row.path) }
                    }
                }
                td { (row.whose.arm_label()) }
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
        .flat_map(|of| {
            let robot = of
                .robot
                .iter()
                .map(move |robot| (of, "arm".to_owned(), robot.clone(), "all sampled logs agree"));
            let columns = of
                .columns
                .iter()
                .map(move |row| (of, row.is.clone(), row.columns.join(", "), row.why.as_str()));
            let open = of
                .open
                .iter()
                .map(move |open| (of, "open".to_owned(), String::new(), open.as_str()));
            robot.chain(columns).chain(open)
        })
        .collect();
    table("datasets", "Columns", &["dataset", "what", "columns", "by"], &rows, |row| {
        let (of, is, columns, why) = row;
        html! {
            tr {
                th scope="row" .words { (of.dataset) }
                td { (is) }
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
                td { (row.whose.arm_label()) }
                td { (row.whose.part()) }
                td { (row.course.name()) }
                td .words { (row.says()) }
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
                        tbody { @for one in rows.iter().take(MOST_ROWS) { (row(one)) } }
                    }
                }
                @if rows.len() > MOST_ROWS {
                    p .note { "and " (rows.len() - MOST_ROWS) " more, which the JSON report lists" }
                }
            }
        }
    }
}
