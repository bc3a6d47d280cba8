//! Suggests `poseaudit plan` commands whose motions would resolve inconclusive checks.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::tame::shell_word;
use super::workspace::is_misread;
use crate::checks::resolving_motion;
use crate::diagnosis::plan::Purpose;
use crate::evidence::{ArmEvidence, RunEvidence};
use crate::finding::{CheckRow, Finding, Word, word};
use crate::robot::{Chain, JointKind, Robot};
use crate::run::{Arm, PoseSourceKind, Run, RunOptions, robot_of};
use crate::stream::JointTrack;

/// Motion that would resolve inconclusive checks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PlanRow {
    /// The arm to move.
    pub robot: String,
    /// Purpose of the motion: `zeros`, `calibration`, `latency`, `hand-eye` or `yaw`.
    #[serde(deserialize_with = "word")]
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
    for arm in run.arms.iter().filter(|arm| !is_misread(arm, findings)) {
        let own = evidence.robots.iter().find(|own| own.name == arm.name);
        let is_drawing = own.is_some_and(|own| own.poses.iter().any(|it| it.diagnosis.is_nominal));
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
        let Some(call) = call(run, arm, options, logs) else { continue };
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
fn call(run: &Run, arm: &Arm, options: &RunOptions, logs: &[PathBuf]) -> Option<String> {
    let own = |name: &str, given: &Option<String>| {
        given.as_ref().map_or(String::new(), |given| option(name, given))
    };
    let (base, tip) = (own("base", &options.base), own("tip", &options.tip));
    let which = if run.arms.len() > 1 { option("arm", &arm.name) } else { String::new() };
    let of = PlanOf {
        robot: &arm.robot,
        chain: &arm.chain,
        joints: &arm.joints,
        columns: &arm.columns,
        model: model(arm, options),
        log: logs.first()?,
        in_log: format!("{which}{base}{tip}"),
    };
    plan_around(&of).filter(|_| of.model.is_some() || logs.len() == 1)
}

pub(crate) struct PlanOf<'a> {
    pub robot: &'a Robot,
    pub chain: &'a Chain,
    pub joints: &'a JointTrack,
    pub columns: &'a [usize],
    /// Name or file for `plan`, and the model. `None` to use the log.
    pub model: Option<(String, Robot)>,
    pub log: &'a Path,
    pub in_log: String,
}

/// Around a configuration in the joint states. `None` if none is within the limits.
pub(crate) fn plan_around(of: &PlanOf<'_>) -> Option<String> {
    let around: Vec<String> =
        posture(of.joints, of.columns, of.chain)?.iter().map(|q| shown(*q)).collect();
    let around = around.join(",");
    let Some((model, robot)) = &of.model else {
        let log = shell_word(&of.log.display().to_string());
        return Some(format!("poseaudit plan {log}{} --around={around}", of.in_log));
    };
    // Names are the log's; the order is the model's.
    let named = |name: &str| Some(robot.link_name(of.robot.link(name)?).to_owned());
    let (base, tip) = (named(of.chain.base_name())?, named(of.chain.tip_name())?);
    let usual_base = robot.default_base.as_deref().and_then(|name| robot.link(name));
    let usual_base = robot.link_name(usual_base.unwrap_or_else(|| robot.root()));
    let usual_tip = robot.default_tip.as_deref().and_then(|name| robot.link(name));
    let usual_tip = usual_tip.or_else(|| robot.leaf_links().last());
    let base = if base == usual_base { String::new() } else { option("base", &base) };
    let is_usual = usual_tip.is_some_and(|usual| robot.link_name(usual) == tip);
    let tip = if is_usual { String::new() } else { option("tip", &tip) };
    Some(format!("poseaudit plan {}{base}{tip} --around={around}", shell_word(model)))
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
            Some((arm.robot.name.clone(), robot_of(&arm.robot.name).ok()?))
        }
        None => None,
    }
}

/// Closest to the middle of each joint's positions, within the limits. Removes whole turns that the limits
/// do not allow.
fn posture(joints: &JointTrack, columns: &[usize], chain: &Chain) -> Option<Vec<f64>> {
    const ENOUGH: usize = 20_000;
    let rows = || (0..joints.len()).step_by(joints.len().div_ceil(ENOUGH).max(1));
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
    let q: Vec<f64> = columns.iter().map(|&at| joints.row(nearest)[at]).collect();
    within(chain, q)
}

fn within(chain: &Chain, mut q: Vec<f64>) -> Option<Vec<f64>> {
    use std::f64::consts::TAU;
    /// Rounding of displayed values.
    const ROUNDING: f64 = 1e-3;
    for ((q, kind), limits) in q.iter_mut().zip(chain.joint_kinds()).zip(chain.limits()) {
        let low = limits.lower.unwrap_or(f64::NEG_INFINITY) + ROUNDING;
        let high = limits.upper.unwrap_or(f64::INFINITY) - ROUNDING;
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

fn shown(q: f64) -> String {
    let text = format!("{:.3}", q);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn option(name: &str, value: &str) -> String {
    format!(" --{name} {}", shell_word(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::catalogue;
    use std::f64::consts::TAU;

    #[test]
    fn a_posture_beyond_its_limits_is_turned_back_or_none() {
        let robot = catalogue::find("ur5e").expect("it is in the catalogue");
        let link = |name| robot.link(name).expect("a link");
        let chain = robot.chain(link("base"), link("tool0")).expect("a chain");
        let q = vec![TAU + 0.5, -1.0, 1.0, 0.0, 0.0, -TAU - 0.25];
        let turned = within(&chain, q).expect("a posture");
        assert!((turned[0] - 0.5).abs() < 1e-12 && (turned[5] + 0.25).abs() < 1e-12, "{turned:?}");
        // The elbow's range is less than a turn: slightly more than half a turn is equivalent to the other
        // side.
        let folded = within(&chain, vec![0.0, 0.0, 3.5, 0.0, 0.0, 0.0]).expect("a posture");
        assert!((folded[2] - 3.5 + TAU).abs() < 1e-12, "{folded:?}");
        let at_its_end = vec![0.0, 0.0, std::f64::consts::PI, 0.0, 0.0, 0.0];
        assert_eq!(within(&chain, at_its_end), None);
    }

    #[test]
    fn numbers_are_short_and_words_are_one_to_a_shell() {
        assert_eq!([0.0, -0.0001, 1.5, -1.5706, 2.0].map(shown), ["0", "0", "1.5", "-1.571", "2"]);
        let quoted = ["run.mcap", "my run.mcap", "it's", "$(x)", ""].map(shell_word);
        assert_eq!(quoted, ["run.mcap", "'my run.mcap'", "'it'\\''s'", "'$(x)'", "''"]);
    }
}
