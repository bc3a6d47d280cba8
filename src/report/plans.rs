//! Suggests `poseaudit plan` commands whose motions would resolve inconclusive checks.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sanitize::quote_for_shell;
use super::workspace::arms_with_readable_joints;
use crate::checks::resolving_motion;
use crate::diagnosis::plan::Purpose;
use crate::evidence::{ArmEvidence, RunEvidence};
use crate::finding::{CheckRow, Finding, Word, deserialize_word, trimmed};
use crate::robot::{Chain, JointKind, Robot};
use crate::run::{Arm, PoseSourceKind, Run, RunOptions, load_robot};
use crate::stream::JointTrack;

/// Motion that would resolve inconclusive checks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PlanRow {
    /// The arm to move.
    pub robot: String,
    /// Purpose of the motion: `zeros`, `calibration`, `latency`, `hand-eye` or `yaw`.
    #[serde(deserialize_with = "deserialize_word")]
    pub purpose: Word,
    /// Rules that it would resolve.
    pub codes: Vec<String>,
    /// Command that generates it, around a configuration that this log visited.
    pub command: String,
}

/// One per arm and purpose. `logs` are the files of the run.
pub(crate) fn plans(
    run: &Run,
    evidence: &RunEvidence,
    checks: &[CheckRow],
    findings: &[Finding],
    options: &RunOptions,
    logs: &[PathBuf],
) -> Vec<PlanRow> {
    let mut plans: Vec<PlanRow> = Vec::new();
    for arm in arms_with_readable_joints(run, findings) {
        let own = evidence.robots.iter().find(|own| own.name == arm.name);
        let is_nominal = own.is_some_and(|own| own.poses.iter().any(|it| it.diagnosis.is_nominal));
        let needs_calibration = |finding: &Finding| {
            finding.suggests_calibration() && finding.subject.robot.as_ref() == Some(&arm.name)
        };
        let is_drawing = is_nominal || findings.iter().any(needs_calibration);
        let own_witness = own.map(ArmEvidence::pose_source_kind);
        let is_its = |row: &&CheckRow| match &row.subject.robot {
            Some(robot) => *robot == arm.name,
            None => run.arms.len() == 1,
        };
        let open = checks.iter().filter(is_its);
        let open = open.filter_map(|row| Some((row.code, resolving_motion(row, is_drawing)?)));
        let open: Vec<(&'static str, Purpose)> = open.collect();
        if open.is_empty() {
            continue;
        }
        let Some(call) = plan_call(run, arm, options, logs) else { continue };
        for purpose in Purpose::ALL {
            let own = open.iter().filter(|(_, settles)| *settles == purpose);
            let mut codes: Vec<String> = own.map(|(code, _)| (*code).to_owned()).collect();
            codes.dedup();
            if !codes.is_empty() {
                let (robot, name) = (arm.name.clone(), purpose.name());
                // The frame and the point of an independent reference are unknown.
                let is_outside =
                    own_witness == Some(PoseSourceKind::External) && purpose.is_of_poses();
                let outside = if is_outside { " --outside" } else { "" };
                let command = format!("{call} --for {name}{outside}");
                plans.push(PlanRow { robot, purpose: name, codes, command });
            }
        }
    }
    plans
}

/// Without the purpose. `None` if no readable source has the arm's model, or if the log has no
/// configuration within the limits.
fn plan_call(run: &Run, arm: &Arm, options: &RunOptions, logs: &[PathBuf]) -> Option<String> {
    let own = |name: &str, given: &Option<String>| {
        given.as_ref().map_or(String::new(), |given| format_option(name, given))
    };
    let (base, tip) = (own("base", &options.base), own("tip", &options.tip));
    let which = if run.arms.len() > 1 { format_option("arm", &arm.name) } else { String::new() };
    let inputs = PlanInputs {
        robot: &arm.robot,
        chain: &arm.chain,
        joints: &arm.joints,
        columns: &arm.columns,
        model: model(arm, options),
        log: logs.first()?,
        log_options: format!("{which}{base}{tip}"),
    };
    plan_command(&inputs).filter(|_| inputs.model.is_some() || logs.len() == 1)
}

pub(crate) struct PlanInputs<'a> {
    pub robot: &'a Robot,
    pub chain: &'a Chain,
    pub joints: &'a JointTrack,
    pub columns: &'a [usize],
    /// Name or file for `plan`, and the model. `None` to use the log.
    pub model: Option<(String, Robot)>,
    pub log: &'a Path,
    pub log_options: String,
}

/// Around a configuration in the joint states. `None` if none is within the limits.
pub(crate) fn plan_command(inputs: &PlanInputs<'_>) -> Option<String> {
    let around: Vec<String> = start_configuration(inputs.joints, inputs.columns, inputs.chain)?
        .iter()
        .map(|q| trimmed(*q, 3))
        .collect();
    let around = around.join(",");
    let Some((model, robot)) = &inputs.model else {
        let log = quote_for_shell(&inputs.log.display().to_string());
        return Some(format!("poseaudit plan {log}{} --around={around}", inputs.log_options));
    };
    // Names are the log's; the order is the model's.
    let named = |name: &str| Some(robot.link_name(inputs.robot.link(name)?).to_owned());
    let (base, tip) = (named(inputs.chain.base_name())?, named(inputs.chain.tip_name())?);
    let default_base_link = robot.default_base.as_deref().and_then(|name| robot.link(name));
    let default_base_link = robot.link_name(default_base_link.unwrap_or_else(|| robot.root()));
    let default_tip_link = robot.default_tip.as_deref().and_then(|name| robot.link(name));
    let default_tip_link = default_tip_link.or_else(|| robot.leaf_links().last());
    let base = if base == default_base_link { String::new() } else { format_option("base", &base) };
    let is_default_tip = default_tip_link.is_some_and(|link| robot.link_name(link) == tip);
    let tip = if is_default_tip { String::new() } else { format_option("tip", &tip) };
    Some(format!("poseaudit plan {}{base}{tip} --around={around}", quote_for_shell(model)))
}

/// Model by name or file, if the log does not contain it.
fn model(arm: &Arm, options: &RunOptions) -> Option<(String, Robot)> {
    let given = options.robots.iter().find(|source| {
        let is_its = |prefix: &String| arm.joint_names.iter().any(|name| name.starts_with(prefix));
        source.prefix.as_ref().is_none_or(is_its)
    });
    match given {
        Some(given) => Some((given.model.clone(), given.robot().ok()?)),
        None if arm.robot.text().is_none() => {
            Some((arm.robot.name.clone(), load_robot(&arm.robot.name).ok()?))
        }
        None => None,
    }
}

/// Closest to the middle of each joint's positions, within the limits. Removes whole turns that the limits
/// do not allow.
fn start_configuration(joints: &JointTrack, columns: &[usize], chain: &Chain) -> Option<Vec<f64>> {
    const MAX_ROWS: usize = 20_000;
    let rows = || (0..joints.len()).step_by(joints.len().div_ceil(MAX_ROWS).max(1));
    let middle = |&at: &usize| {
        let mut own: Vec<f64> = rows().map(|row| joints.row(row)[at]).collect();
        crate::stats::median(&mut own)
    };
    let middle: Vec<f64> = columns.iter().map(middle).collect::<Option<_>>()?;
    let off = |row: usize| -> f64 {
        let row = joints.row(row);
        columns.iter().zip(&middle).map(|(&at, middle)| (row[at] - middle).powi(2)).sum()
    };
    let nearest = rows().min_by(|&a, &b| off(a).total_cmp(&off(b)))?;
    unwrap_into_limits(chain, joints.positions_at(nearest, columns))
}

fn unwrap_into_limits(chain: &Chain, mut q: Vec<f64>) -> Option<Vec<f64>> {
    use std::f64::consts::TAU;
    /// Rounding of displayed values.
    const ROUNDING_RAD: f64 = 1e-3;
    for ((q, kind), limits) in q.iter_mut().zip(chain.joint_kinds()).zip(chain.limits()) {
        let low = limits.lower.unwrap_or(f64::NEG_INFINITY) + ROUNDING_RAD;
        let high = limits.upper.unwrap_or(f64::INFINITY) - ROUNDING_RAD;
        if *kind != JointKind::Prismatic && *q > high {
            *q -= TAU * ((*q - high) / TAU).ceil();
        } else if *kind != JointKind::Prismatic && *q < low {
            *q += TAU * ((low - *q) / TAU).ceil();
        }
        if !(low..=high).contains(q) {
            return None;
        }
    }
    Some(q)
}

fn format_option(name: &str, value: &str) -> String {
    format!(" --{name} {}", quote_for_shell(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::catalogue;
    use std::f64::consts::TAU;

    #[test]
    fn a_configuration_beyond_limits_is_unwrapped_or_rejected() {
        let robot = catalogue::find("ur5e").expect("it is in the catalogue");
        let link = |name| robot.link(name).expect("a link");
        let chain = robot.chain(link("base"), link("tool0")).expect("a chain");
        let q = vec![TAU + 0.5, -1.0, 1.0, 0.0, 0.0, -TAU - 0.25];
        let turned = unwrap_into_limits(&chain, q).expect("a posture");
        assert!((turned[0] - 0.5).abs() < 1e-12 && (turned[5] + 0.25).abs() < 1e-12, "{turned:?}");
        // The elbow's range is less than a turn: slightly more than half a turn is equivalent to the other
        // side.
        let folded =
            unwrap_into_limits(&chain, vec![0.0, 0.0, 3.5, 0.0, 0.0, 0.0]).expect("a posture");
        assert!((folded[2] - 3.5 + TAU).abs() < 1e-12, "{folded:?}");
        let at_its_end = vec![0.0, 0.0, std::f64::consts::PI, 0.0, 0.0, 0.0];
        assert_eq!(unwrap_into_limits(&chain, at_its_end), None);
    }

    #[test]
    fn numbers_are_short_and_words_are_quoted_for_the_shell() {
        assert_eq!(
            [0.0, -0.0001, 1.5, -1.5706, 2.0].map(|q| trimmed(q, 3)),
            ["0", "0", "1.5", "-1.571", "2"]
        );
        let quoted = ["run.mcap", "my run.mcap", "it's", "$(x)", ""].map(quote_for_shell);
        assert_eq!(quoted, ["run.mcap", "'my run.mcap'", "'it'\\''s'", "'$(x)'", "''"]);
    }
}
