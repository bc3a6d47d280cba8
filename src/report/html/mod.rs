//! Report as one self-contained HTML page: verdict and findings first, each with its plots, then the rest.
//!
//! Names in the page come from the log and may be malicious: [`maud`] escapes text, data is JSON without
//! `<`, and the content security policy allows only the two scripts below, by their hashes.

mod bars;
mod finding_plots;
mod frames;
mod plane;
mod plot;
mod rule;
mod sections;
#[cfg(test)]
mod tests;
mod timeline;

use std::io::{self, Write};

use base64::prelude::{BASE64_STANDARD, Engine as _};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

pub(crate) use self::bars::css_percent;
use self::finding_plots::PagePlots;
pub(crate) use self::plot::{Plot, PlotLimit, PlotSeries, PlotStyle, SeriesRole};
use self::sections::PageSections;
use super::outline::Outline;
use super::{Report, Verdict};

/// uPlot 1.6.32, MIT licence, from the npm package `uplot`: see `uplot/LICENSE`.
const UPLOT: &str = include_str!("uplot/uPlot.iife.min.js");
const UPLOT_STYLE: &str = include_str!("uplot/uPlot.min.css");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Rows of all plots of a page.
const MAX_ROWS: usize = 45_000;
/// Minimum and maximum rows of one plot.
const MIN_MAX_ROWS_OF_PLOT: [usize; 2] = [300, 3_000];
const MAX_PLOTS: usize = 120;

/// Writes the report. All times and paths are from the log and the call, so equal reports have equal bytes.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    out.write_all(page(report).into_string().as_bytes())
}

fn page(report: &Report) -> Markup {
    let outline = Outline::new(report);
    let mut plots = PagePlots::new(report);
    let omitted_plots = plots.truncate(MAX_PLOTS);
    let [least, most] = MIN_MAX_ROWS_OF_PLOT;
    let rows = (MAX_ROWS / plots.line_plots().count().max(1)).clamp(least, most);
    let parts = PageSections { report, outline: &outline, plots: &plots, rows, omitted_plots };
    let title = format!("{} · {}", report.verdict, parts.name());
    let body = html! {
        a .skip href="#findings" { "Skip to the findings" }
        (parts.header())
        main {
            (parts.verdict())
            noscript {
                p .note { "The plots need JavaScript; their values are in the tables under them." }
            }
            (parts.findings())
            (parts.stream_errors())
            (parts.details())
        }
        (parts.footer())
    };
    page_shell(&title, verdict_class(report), &body, plot_data(&plots, rows))
}

/// Self-contained page. Only the scripts that draw `plots` may run; `plots` maps ids in the body to
/// [`Plot::json`].
pub(crate) fn page_shell(
    title: &str,
    class: &str,
    body: &Markup,
    plots: Map<String, Value>,
) -> Markup {
    let policy = format!(
        "default-src 'none'; style-src 'unsafe-inline'; script-src {} {}; base-uri 'none'; \
         form-action 'none'",
        script_hash(UPLOT),
        script_hash(SCRIPT)
    );
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta name="generator" content=(concat!("poseaudit ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                style { (PreEscaped(UPLOT_STYLE)) (PreEscaped(STYLE)) }
            }
            body .(class) {
                (body)
                script #data type="application/json" { (PreEscaped(embed_json(plots))) }
                script { (PreEscaped(UPLOT)) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
}

const fn verdict_class(report: &Report) -> &'static str {
    match (&report.error, report.verdict) {
        (Some(_), _) | (None, Verdict::Inconclusive) => "open",
        (None, Verdict::Pass) => "pass",
        (None, Verdict::Fail) => "fail",
    }
}

fn plot_data(plots: &PagePlots, rows: usize) -> Map<String, Value> {
    plots.line_plots().map(|(id, plot)| (id, plot.json(rows))).collect()
}

/// Escapes `<`, so that no name can end the script element.
fn embed_json(plots: Map<String, Value>) -> String {
    Value::Object(plots).to_string().replace('<', "\\u003c")
}

/// For the content security policy.
fn script_hash(script: &str) -> String {
    format!("'sha256-{}'", BASE64_STANDARD.encode(Sha256::digest(script)))
}
