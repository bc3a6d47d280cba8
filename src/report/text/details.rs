//! Every check, in verbose mode.

use std::io;

use anstyle::Style;

use super::TextReport;
use super::lines::Lines;
use crate::report::outline::AmountBound;
use crate::report::styles::{GOOD, LABEL_WIDTH, QUIET, WARNING};
use crate::report::{JointCoverage, WorkspaceRow, sanitize};

impl TextReport<'_> {
    /// Inconclusive, ignored, passed and skipped checks, unused topics and columns, and the workspace.
    pub(super) fn details(&self, out: &mut Lines<'_>) -> io::Result<()> {
        if self.report.checks.is_empty() {
            return Ok(());
        }
        let outline = &self.outline;
        let open = [outline.inconclusive_by_action(), outline.unobservable_parameters()].concat();
        block(out, WARNING, "inconclusive", open)?;
        block(out, WARNING, "to settle", outline.recommended_motion().into_iter().collect())?;
        outline.plan_commands().into_iter().try_for_each(|plan| out.call("", LABEL_WIDTH, plan))?;
        block(out, WARNING, "ignored", outline.ignored_findings())?;
        self.passed(out)?;
        let arms = self.report.workspace.iter().map(|arm| self.workspace(arm));
        block(out, QUIET, "workspace", arms.collect())?;
        block(out, QUIET, "unused", outline.unused_streams())?;
        block(out, QUIET, "skipped", outline.skipped_checks())?;
        out.blank()
    }

    fn passed(&self, out: &mut Lines<'_>) -> io::Result<()> {
        let passed = self.outline.passed_checks();
        let bounds: Vec<String> = passed.bounds.iter().map(AmountBound::sentence).collect();
        // Without wrapping, grep finds one line per item.
        let is_wrapped = out.columns.is_some();
        let bounds = if is_wrapped { join_to_width(out, &bounds, "; ") } else { bounds };
        let lists = bounds.into_iter().chain(join_to_width(out, &passed.whole, ", "));
        let lists = lists.chain(join_to_width(out, &passed.partial, "; "));
        let texts: Vec<String> = lists.chain(passed.remarks).collect();
        block(out, GOOD, "passed", texts)
    }

    fn workspace(&self, arm: &WorkspaceRow) -> String {
        let several = self.report.robots.len() > 1;
        let of = if several { format!("{}: ", arm.robot) } else { String::new() };
        let visited = |joint: &&JointCoverage| joint.visited.is_some();
        let share = |joint: &JointCoverage| joint.visited.unwrap_or(0.0);
        let mut joints: Vec<&JointCoverage> = arm.joints.iter().filter(visited).collect();
        joints.sort_by(|a, b| share(a).total_cmp(&share(b)));
        let [least_m, most_m] = arm.reach_m;
        let tip = format!(
            "tip {least_m:.2}–{most_m:.2} m from the base, which reaches {:.2} m",
            arm.max_reach_m
        );
        match joints.as_slice() {
            [least, .., most] => format!(
                "{of}joints moved over {:.0} % ({}) to {:.0} % ({}) of their ranges; {tip}",
                100.0 * share(least),
                least.joint,
                100.0 * share(most),
                most.joint
            ),
            _ => format!("{of}{tip}"),
        }
    }
}

/// A label on the first of the texts.
fn block(out: &mut Lines<'_>, style: Style, label: &str, texts: Vec<String>) -> io::Result<()> {
    let labels = [label].into_iter().chain(std::iter::repeat(""));
    labels.zip(&texts).try_for_each(|(label, text)| {
        let head = format!("{style}{label}{style:#}{}", " ".repeat(LABEL_WIDTH - label.len()));
        out.line(&head, LABEL_WIDTH, &sanitize(text))
    })
}

/// Joins items as long as they fit on a line.
fn join_to_width(out: &Lines<'_>, items: &[String], separator: &str) -> Vec<String> {
    let width = out.columns.unwrap_or(usize::MAX);
    let mut lines: Vec<String> = Vec::new();
    for item in items {
        match lines.last_mut() {
            Some(last)
                if LABEL_WIDTH + last.chars().count() + separator.len() + item.chars().count()
                    < width =>
            {
                last.push_str(separator);
                last.push_str(item);
            }
            _ => lines.push(item.clone()),
        }
    }
    lines
}
