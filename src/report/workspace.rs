//! Workspace covered by the arms of a run.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Evaluation, unobservable_zero};
use rayon::prelude::*;

use crate::diagnosis::{JointSpan, Workspace, reach_m};
use crate::finding::{Cause, CheckRow, Finding, Unit, Word, deserialize_word};
use crate::robot::{Chain, JointKind};
use crate::run::{Arm, JointSamples, Run};

/// Part of its ranges that one arm covered.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct WorkspaceRow {
    /// The arm.
    pub robot: String,
    /// Its joints, from base to tip.
    pub joints: Vec<JointCoverage>,
    /// Smallest and largest distance of its tip from its base, m.
    pub reach_m: [f64; 2],
    /// Largest possible distance of the tip, m.
    pub max_reach_m: f64,
    /// Conclusions that were not possible because a joint moved too little, one sentence each.
    pub hides: Vec<String>,
}

/// Part of its range that one joint covered.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct JointCoverage {
    /// The joint.
    pub joint: String,
    /// Unit of the positions: `rad` or `m`.
    #[serde(deserialize_with = "deserialize_word")]
    pub unit: Word,
    /// Lowest position.
    pub lowest: f64,
    /// Highest position.
    pub highest: f64,
    /// Lower limit.
    pub lower: Option<f64>,
    /// Upper limit.
    pub upper: Option<f64>,
    /// Fraction of the range between its limits that was covered. Fraction of a turn for a revolute joint
    /// without limits.
    pub visited: Option<f64>,
}

pub(crate) struct ArmWorkspace<'a> {
    pub robot: &'a str,
    pub chain: &'a Chain,
    pub workspace: Workspace,
}

/// Also names inconclusive checks due to too little motion. Excludes arms with misinterpreted joint states.
pub(crate) fn workspace_coverage(run: &Run, judged: &Evaluation) -> Vec<WorkspaceRow> {
    let arms = arms_with_readable_joints(run, &judged.findings);
    arms.filter_map(|arm| arm_coverage(run, arm, &judged.checks)).collect()
}

pub(super) fn arms_with_readable_joints<'a>(
    run: &'a Run,
    findings: &[Finding],
) -> impl Iterator<Item = &'a Arm> {
    let is_readable =
        |arm: &&Arm| arm.trajectory.is_none() && !has_misinterpreted_joints(arm, findings);
    run.arms.iter().filter(is_readable)
}

/// From all samples of the joint states.
pub(crate) fn reached_workspaces<'a>(run: &'a Run, findings: &[Finding]) -> Vec<ArmWorkspace<'a>> {
    let arms = arms_with_readable_joints(run, findings);
    let reached = arms.map(|arm| {
        let rows = JointRows::new(run, arm);
        let workspace = Workspace::from_samples(
            &arm.chain,
            (0..rows.len()).map(|row| rows.time_and_positions(row)),
        );
        ArmWorkspace { robot: &arm.name, chain: &arm.chain, workspace }
    });
    reached.collect()
}

/// Unit or order of its joint states.
fn has_misinterpreted_joints(arm: &Arm, findings: &[Finding]) -> bool {
    let is_of_arm = |found: &&Finding| found.subject.arm().is_none_or(|robot| *robot == arm.name);
    findings.iter().filter(is_of_arm).any(|found| {
        matches!(found.cause, Cause::AngleUnit(_) | Cause::JointUnit(_) | Cause::JointOrder { .. })
    })
}

fn arm_coverage(run: &Run, arm: &Arm, checks: &[CheckRow]) -> Option<WorkspaceRow> {
    const MAX_ROWS: usize = 20_000;
    let rows = JointRows::new(run, arm);
    let some = (0..rows.len()).step_by(rows.len().div_ceil(MAX_ROWS).max(1));
    let (least, most) = reach_m(&arm.chain, some.map(|row| rows.time_and_positions(row).1))?;
    let of_joint = |(joint, &column): (usize, &usize)| {
        let (name, kind) =
            (arm.chain.joint_names().get(joint)?, arm.chain.joint_kinds().get(joint)?);
        let limits = arm.chain.limits().get(joint).copied().unwrap_or_default();
        let span = JointSpan::from_positions(&rows.samples.get(column)?.position, *kind, &limits)?;
        let unit = match kind {
            JointKind::Prismatic => Unit::Metre,
            _ => Unit::Radian,
        };
        let coverage = JointCoverage {
            joint: name.clone(),
            unit: unit.symbol(),
            lowest: span.lowest,
            highest: span.highest,
            lower: limits.lower,
            upper: limits.upper,
            visited: span.visited,
        };
        Some((unobservable_zero(name, unit, span.width(), checks), coverage))
    };
    let found: Vec<_> = arm.columns.par_iter().enumerate().filter_map(of_joint).collect();
    let (hides, joints): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    Some(WorkspaceRow {
        robot: arm.name.clone(),
        joints,
        hides: hides.into_iter().flatten().collect(),
        reach_m: [least, most],
        max_reach_m: arm.chain.max_reach_m(),
    })
}

/// All recorded samples if the joints share their messages, else the resampled track.
struct JointRows<'a> {
    arm: &'a Arm,
    samples: Vec<JointSamples<'a>>,
    /// If the joints share their messages.
    t_s: Option<Arc<[f64]>>,
}

impl<'a> JointRows<'a> {
    fn new(run: &'a Run, arm: &'a Arm) -> Self {
        let samples = run.joint_samples(&arm.joint_sources);
        let t_s = JointSamples::common_times(&samples).cloned();
        Self { arm, samples, t_s }
    }

    fn len(&self) -> usize {
        self.t_s.as_ref().map_or(self.arm.joints.len(), |t_s| t_s.len())
    }

    /// Time in s from the run's origin, and the chain's joints.
    fn time_and_positions(&self, row: usize) -> (f64, Vec<f64>) {
        match &self.t_s {
            Some(t_s) => {
                let position = |&column: &usize| self.samples[column].position[row];
                (t_s[row], self.arm.columns.iter().map(position).collect())
            }
            None => {
                let joints = &self.arm.joints;
                (joints.t_s[row], joints.positions_at(row, &self.arm.columns))
            }
        }
    }
}
