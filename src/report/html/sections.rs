use std::iter::once;

use maud::{Markup, html};

use super::bars::css_percent;
use super::finding_plots::{FindingPlots, PagePlots, finding_plot_id, stream_plot_id};
use super::{frames, rule, timeline};
use crate::checks::{self, Rule};
use crate::finding::Finding;
use crate::report::outline::{AmountBound, Outline, PassedChecks};
use crate::report::{JointCoverage, Report, WorkspaceRow};

pub struct PageSections<'a> {
    pub report: &'a Report,
    pub outline: &'a Outline<'a>,
    pub plots: &'a PagePlots,
    pub rows: usize,
    pub omitted_plots: usize,
}

impl PageSections<'_> {
    pub fn name(&self) -> String {
        let files = &self.report.log.files;
        let name = |path: &std::path::Path| match path.file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => path.display().to_string(),
        };
        match files.as_slice() {
            [] => "no log".to_owned(),
            [only] => name(&only.path),
            [first, others @ ..] => format!("{} and {} more", name(&first.path), others.len()),
        }
    }

    pub fn header(&self) -> Markup {
        let log = &self.report.log;
        html! {
            header .page {
                p .tool { "poseaudit" }
                h1 { (self.name()) }
                dl .facts {
                    @for file in &log.files {
                        dt { "log" }
                        dd { (file.path.display()) @if let Some(fetched) = file.fetched() { ", " (fetched) } }
                    }
                    @if let Some(extent) = self.outline.extent() {
                        dt { "recording" }
                        dd { (extent) }
                    }
                    @for row in &self.report.comparisons {
                        dt { "comparison" }
                        dd { (row.topic) " with " (row.reference) @if let Some(errors) = row.errors() { ": " (errors) } }
                        dt { "reference" }
                        dd { (row.reference) ", " (row.reason) }
                    }
                    @for robot in &self.report.robots {
                        dt { "robot" }
                        dd { (robot.name) ", " (robot.base) " → " (robot.tip) ", from " (robot.source) }
                    }
                }
            }
        }
    }

    pub fn verdict(&self) -> Markup {
        html! {
            section .verdict aria-labelledby="verdict" {
                @match &self.report.error {
                    Some(trouble) => {
                        h2 #verdict { strong { "NO AUDIT" } " " span { (trouble.what) } }
                        p { (trouble.place) ": " (trouble.remedy) }
                    }
                    None => {
                        h2 #verdict {
                            strong { (self.report.verdict) } " " span { (self.outline.verdict_reason()) }
                        }
                    }
                }
                @if self.report.findings.len() > 1 {
                    ol .causes {
                        @for (index, finding) in self.report.findings.iter().enumerate() {
                            li .(finding.severity.name()) {
                                a href={ "#finding-" (index + 1) } {
                                    code { (finding.code) } " "
                                    span .cause {
                                        span .subject { (self.outline.subject(&finding.subject)) }
                                        " " span .message { (finding.message) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    pub fn findings(&self) -> Markup {
        html! {
            section #findings aria-labelledby="findings-title" {
                h2 #findings-title .quiet[self.report.findings.is_empty()] {
                    @if self.report.findings.is_empty() { "No findings" } @else { "Findings" }
                }
                @for (index, (finding, evidence)) in
                    self.report.findings.iter().zip(&self.plots.findings).enumerate()
                {
                    (self.finding(index, finding, evidence))
                }
                @if self.omitted_plots > 0 {
                    p .note {
                        (self.omitted_plots) " plots are omitted: a page draws at most "
                        (super::MAX_PLOTS) "."
                    }
                }
            }
        }
    }

    /// Streams whose errors no finding shows, each with its limit.
    pub fn stream_errors(&self) -> Markup {
        html! {
            @if !self.plots.streams.is_empty() {
                section #errors aria-labelledby="errors-title" {
                    h2 #errors-title { "Error of each stream and its limit" }
                    div .proof {
                        @for (stream, plot) in self.plots.streams.iter().enumerate() {
                            (plot.markup(&stream_plot_id(stream), None, self.rows))
                        }
                    }
                }
            }
        }
    }

    fn finding(&self, index: usize, finding: &Finding, evidence: &FindingPlots) -> Markup {
        let id = format!("finding-{}", index + 1);
        let subject = self.outline.subject(&finding.subject);
        html! {
            article id=(id) .finding .(finding.severity.name()) aria-labelledby={ (id) "-title" } {
                p .badge {
                    span .severity { (finding.severity.name()) } " " code { (finding.code) } " "
                    span .kind { (finding.title) }
                }
                h3 id={ (id) "-title" } {
                    @if !subject.is_empty() { span .subject { (subject) } " " }
                    span .message { (finding.message) }
                }
                @for line in self.outline.finding_lines(finding) { p .effect { (line) } }
                p .fix { strong { "Fix" } " " (finding.fix) }
                (self.evidence(index, evidence))
                @if let Some(rule) = self.rule_first_at(index) { (rule::rule_details(rule)) }
            }
        }
    }

    /// `None` unless it is the rule's first finding.
    fn rule_first_at(&self, index: usize) -> Option<&'static Rule> {
        let code = self.report.findings[index].code;
        let is_first = !self.report.findings[..index].iter().any(|other| other.code == code);
        checks::find(code).ok().filter(|_| is_first)
    }

    fn evidence(&self, index: usize, evidence: &FindingPlots) -> Markup {
        let topic = self.report.findings[index].subject.topic.as_deref();
        html! {
            @if !evidence.is_empty() {
                div .proof {
                    @for whiskers in &evidence.whiskers { (whiskers.markup()) }
                    @for (plot, drawn) in evidence.plots.iter().enumerate() {
                        (drawn.markup(&finding_plot_id(index, plot), topic, self.rows))
                    }
                    @for plane in &evidence.planes { (plane.markup()) }
                    @for bars in &evidence.bars { (bars.markup()) }
                }
            }
            @for (first, title) in &evidence.shown_by {
                p .note {
                    (title) ": under "
                    a href={ "#finding-" (first + 1) } { (self.report.findings[*first].code) }
                }
            }
            @match (&evidence.section, &self.report.figures) {
                (Some((part, what)), Some(_)) => {
                    p .note { "See " a href={ "#" (part) } { (what) } "." }
                }
                (None, Some(_)) if evidence.is_empty() => {
                    p .note { "No plot: the data of this rule are not stored as a series." }
                }
                _ => {}
            }
        }
    }

    pub fn details(&self) -> Markup {
        let figures = self.report.figures.as_ref();
        let notes = self.report.log.notes.iter();
        let mut notes: Vec<String> =
            notes.map(|note| format!("{}: {}", note.path.display(), note.note)).collect();
        if figures.is_some_and(|figures| figures.is_longest_segment) {
            notes.push("the pictures are of the longest segment".to_owned());
        }
        html! {
            (self.inconclusive())
            (section_list("ignored", "Ignored", &self.outline.ignored_findings()))
            (self.passed())
            (section_list("skipped", "Skipped", &self.outline.skipped_checks()))
            (self.workspace())
            @if let Some(figures) = figures {
                (timeline::section(figures))
                (frames::section(figures, &self.report.robots))
            }
            (self.streams())
            (section_list("notes", "Notes", &notes))
        }
    }

    fn inconclusive(&self) -> Markup {
        let groups = self.outline.inconclusive_by_action();
        html! {
            @if !groups.is_empty() {
                section #open .list aria-labelledby="open-title" {
                    h2 #open-title { "Inconclusive" }
                    ul {
                        @for line in groups.iter().chain(&self.outline.unobservable_parameters()) {
                            li { (highlight_codes(line)) }
                        }
                    }
                    @if let Some(recipe) = self.outline.recommended_motion() {
                        p .fix { strong { "To settle" } " " (recipe) }
                        @for plan in self.outline.plan_commands() { pre .call tabindex="0" { (plan) } }
                    }
                    details .values {
                        summary { "Reasons" }
                        ul { @for line in self.outline.inconclusive_by_reason() { li { (highlight_codes(&line)) } } }
                    }
                }
            }
        }
    }

    fn passed(&self) -> Markup {
        let PassedChecks { bounds, whole, partial: parts, remarks } = self.outline.passed_checks();
        let whole = whole.join(", ");
        let lines: Vec<String> = once(whole).chain(parts).chain(remarks).collect();
        html! {
            @if !bounds.is_empty() || lines.iter().any(|line| !line.is_empty()) {
                section #passed .list aria-labelledby="passed-title" {
                    h2 #passed-title { "Passed" }
                    @if !bounds.is_empty() {
                        div .scroll tabindex="0" role="region" aria-labelledby="passed-title" {
                            table {
                                thead {
                                    tr {
                                        th scope="col" { "rule" } th scope="col" { "what" }
                                        th scope="col" { "largest, ± 95 %" } th scope="col" { "limit" }
                                    }
                                }
                                tbody { @for bound in &bounds { (bound_row(bound)) } }
                            }
                        }
                    }
                    ul { @for line in &lines { @if !line.is_empty() { li { (highlight_codes(line)) } } } }
                }
            }
        }
    }

    fn workspace(&self) -> Markup {
        html! {
            @if !self.report.workspace.is_empty() {
                section #workspace aria-labelledby="workspace-title" {
                    h2 #workspace-title { "Workspace" }
                    @for arm in &self.report.workspace { (arm_coverage(arm)) }
                }
            }
        }
    }

    fn streams(&self) -> Markup {
        html! {
            @if !self.report.streams.is_empty() {
                section #streams aria-labelledby="streams-title" {
                    h2 #streams-title { "Streams" }
                    div .scroll tabindex="0" role="region" aria-labelledby="streams-title" {
                        table {
                            thead {
                                tr {
                                    th scope="col" { "topic" }
                                    th scope="col" { "role" }
                                    th scope="col" { "why" }
                                    th scope="col" { "frames" }
                                    th scope="col" { "type" }
                                }
                            }
                            tbody {
                                @for stream in &self.report.streams {
                                    tr {
                                        th scope="row" { (stream.topic) }
                                        td { (stream.role) }
                                        td .words { (stream.reason) }
                                        td { (frames::stream_frames(stream)) }
                                        td { code { (stream.type_name) } }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    pub fn footer(&self) -> Markup {
        let first = self.report.findings.first();
        html! {
            footer {
                @if let Some(first) = first {
                    p { "What " (first.code) " means, when it misleads:" }
                    pre .call tabindex="0" { "poseaudit explain " (first.code) }
                    p { "Replay it in the Rerun viewer:" }
                    pre .call tabindex="0" { (self.report.command_with("--rrd run.rrd")) }
                }
                p { "poseaudit " (env!("CARGO_PKG_VERSION")) ". Errors are against forward \
                     kinematics of the joint states; ± is half a 95 % interval." }
            }
        }
    }
}

fn bound_row(bound: &AmountBound) -> Markup {
    html! {
        tr {
            th scope="row" { code { (bound.code) } }
            td {
                (bound.name)
                @if let Some(on) = &bound.subjects { " " span .quiet { "on " (on) } }
                @if let Some(count) = bound.amounts { " " span .quiet { "of " (count) } }
            }
            td { (bound.amount) }
            td { (bound.limit) }
        }
    }
}

/// Empty without lines.
fn section_list(id: &str, title: &str, lines: &[String]) -> Markup {
    html! {
        @if !lines.is_empty() {
            section id=(id) .list aria-labelledby={ (id) "-title" } {
                h2 id={ (id) "-title" } { (title) }
                ul { @for line in lines { @if !line.is_empty() { li { (highlight_codes(line)) } } } }
            }
        }
    }
}

/// Highlights leading rule codes.
fn highlight_codes(line: &str) -> Markup {
    let is_code = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || "–, ".contains(c);
    let end = line.find(|c| !is_code(c)).unwrap_or(line.len());
    let (codes, rest) = match line[..end].trim_end() {
        codes if codes.len() >= 6 => line.split_at(codes.len()),
        _ => ("", line),
    };
    html! { @if !codes.is_empty() { code { (codes) } } (rest) }
}

fn arm_coverage(arm: &WorkspaceRow) -> Markup {
    let [least_m, most_m] = arm.reach_m;
    html! {
        h3 { (arm.robot) }
        p {
            "Tip " (format!("{least_m:.2}–{most_m:.2} m")) " from the base, which reaches "
            (format!("{:.2} m", arm.max_reach_m)) "."
        }
        table .bars .coverage {
            tbody { @for joint in &arm.joints { (joint_coverage(joint)) } }
        }
        @for hides in &arm.hides { p .note { (hides) } }
    }
}

fn joint_coverage(joint: &JointCoverage) -> Markup {
    let (factor, unit) = if joint.unit == "rad" { (1f64.to_degrees(), "°") } else { (1e3, " mm") };
    let range = |low: f64, high: f64| format!("{:.0} to {:.0}{unit}", low * factor, high * factor);
    let bar = joint.lower.zip(joint.upper).filter(|(lower, upper)| upper > lower);
    html! {
        tr {
            th scope="row" { (joint.joint) }
            td .bar {
                @if let Some((lower, upper)) = bar {
                    @let place = |at: f64| ((at - lower) / (upper - lower)).clamp(0.0, 1.0);
                    i .span style={
                        "left:" (css_percent(place(joint.lowest)))
                        ";width:" (css_percent(place(joint.highest) - place(joint.lowest)))
                    } {}
                }
            }
            td .number {
                (range(joint.lowest, joint.highest))
                @if let Some(visited) = joint.visited {
                    span .quiet { " " (format!("{:.0} %", 100.0 * visited)) }
                }
            }
        }
    }
}
