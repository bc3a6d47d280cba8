//! Robot and columns shared by a dataset: determined on some logs, verified in the others.

use serde::{Deserialize, Serialize};

use crate::finding::Unit;
use crate::log::{Log, Note};
use crate::robot::{Robot, catalogue};

use super::{
    ColumnQuestion, ColumnSearch, IdentifiedArm, IdentifiedColumns, MIN_SPREAD_M, selectors,
};

/// Robot and columns shared by a dataset.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SharedMapping {
    /// Names of the source logs.
    pub from: Vec<String>,
    /// Catalogue name of the arm.
    pub robot: Option<String>,
    /// Columns, if names do not identify them.
    pub columns: Option<SharedColumns>,
}

/// Column mapping of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharedColumns {
    /// Name of the source log.
    pub from: String,
    numbers: Vec<String>,
    arms: Vec<IdentifiedArm>,
    question: Option<String>,
}

/// One identified group of columns.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SharedRow {
    /// Meaning of the columns.
    pub is: String,
    /// The columns, in `[columns]` syntax.
    pub columns: Vec<String>,
    /// How they were identified.
    pub why: String,
}

impl SharedMapping {
    pub(super) fn columns_for(&self, numbers: &[String]) -> Option<&SharedColumns> {
        let are_within =
            |of: &SharedColumns| of.arms.iter().all(|arm| arm.is_within(numbers.len()));
        self.columns.as_ref().filter(|of| of.numbers == numbers && are_within(of))
    }
}

impl SharedColumns {
    pub(super) fn new(numbers: Vec<String>, identified: IdentifiedColumns) -> Self {
        let question = identified.question.map(|question| question.text);
        Self { from: String::new(), numbers, arms: identified.arms, question }
    }

    /// Whether the columns are fully identified.
    pub fn is_determined(&self) -> bool {
        !self.arms.is_empty() && self.question.is_none()
    }

    /// Whether both use the same columns for the same purpose.
    pub fn agrees(&self, other: &Self) -> bool {
        let of = |it: &Self| -> Vec<_> {
            let arm = |arm: &IdentifiedArm| {
                let commands = [&arm.joint_commands, &arm.pose_commands];
                let commands = commands.map(|of| of.as_ref().map(|(columns, _)| columns.clone()));
                (arm.mapping.joints.clone(), arm.mapping.unit, arm.pose.clone(), commands)
            };
            it.arms.iter().map(arm).collect()
        };
        self.numbers == other.numbers && of(self) == of(other)
    }

    /// Remaining ambiguity, as a question.
    pub fn question(&self) -> Option<&str> {
        self.question.as_deref()
    }

    /// The identified columns, with the reasons.
    pub fn rows(&self) -> Vec<SharedRow> {
        let row = |is: &str, columns: &[usize], why: &str| SharedRow {
            is: is.to_owned(),
            columns: selectors(
                &columns.iter().map(|&at| self.numbers[at].clone()).collect::<Vec<_>>(),
            ),
            why: why.to_owned(),
        };
        let of = |arm: &IdentifiedArm| {
            let commands =
                [("joint commands", &arm.joint_commands), ("pose commands", &arm.pose_commands)];
            let commands = commands.into_iter().filter_map(|(is, of)| {
                let (columns, why) = of.as_ref()?;
                Some(row(is, columns, why))
            });
            let unit = arm.mapping.unit.name();
            let joints = format!("joints of {}, {unit}", arm.arm);
            let own = [
                row(&joints, &arm.mapping.joints, &arm.joints_why),
                row("pose", &arm.pose, &arm.pose_why),
            ];
            own.into_iter().chain(commands).collect::<Vec<_>>()
        };
        let arms = self.arms.iter().filter(|arm| arm.is_within(self.numbers.len()));
        arms.flat_map(of).collect()
    }

    pub(super) fn robots(&self) -> Vec<&'static Robot> {
        let mut robots: Vec<_> =
            self.arms.iter().filter_map(|arm| catalogue::find(&arm.arm)).collect();
        robots.dedup_by_key(|robot| &robot.name);
        robots
    }
}

impl ColumnSearch<'_> {
    /// Verifies the shared mapping. If FK does not match, searches again and reports a different result as
    /// a contradiction.
    pub(super) fn verify_shared(&self, shared: &SharedColumns, log: &mut Log) -> IdentifiedColumns {
        let from = &shared.from;
        let question = shared.question.as_ref().map(|question| ColumnQuestion {
            text: format!("{question} (asked once, for {from})"),
            proposal: None,
        });
        let mut identified = IdentifiedColumns { question, arms: Vec::new() };
        let mut unfit = None;
        for arm in &shared.arms {
            let found = self
                .chain_of(arm)
                .and_then(|chain| self.cells.table.refit(&arm.mapping, chain, self.max_lag_s));
            let found = found.filter(|found| found.spread_m > MIN_SPREAD_M);
            let (name, position) = (&arm.arm, self.label(&arm.mapping.position));
            let here = match &found {
                None => "too little motion in this log to verify it".to_owned(),
                Some(found) => {
                    let of = Unit::Metre.show(found.spread_m);
                    format!(
                        "here FK has a residual of {} in {of} of motion in {position}",
                        Unit::Metre.show(found.residual_m)
                    )
                }
            };
            if found.is_some_and(|found| !found.fits()) {
                unfit = Some(format!("{here}, with {name} and the columns of {from}"));
            }
            let why = |what: &str| format!("{what} as in {from}: {here}");
            let commands = |of: &Option<(Vec<usize>, String)>, what: &str| {
                of.as_ref().map(|(columns, _)| (columns.clone(), format!("{what}, as in {from}")))
            };
            identified.arms.push(IdentifiedArm {
                joints_why: why(&format!("joints of {name} in {}", arm.mapping.unit.name())),
                pose_why: why(&format!("a pose that matches FK of {name}")),
                joint_commands: commands(&arm.joint_commands, "joint commands"),
                pose_commands: commands(&arm.pose_commands, "pose commands"),
                ..arm.clone()
            });
        }
        let (Some(unfit), Some(file)) = (unfit, log.files.first().map(|file| file.path.clone()))
        else {
            return identified;
        };
        let own = self.identify(log);
        if own.arms.is_empty() {
            log.notes.push(Note { file, what: format!("columns mapped as in {from}; {unfit}") });
            return identified;
        }
        let mappings: Vec<String> =
            own.arms.iter().map(|arm| self.config_lines(&arm.mapping)).collect();
        let what =
            format!("its columns differ from {from}: [columns] {}; {unfit}", mappings.join("; "));
        log.contradictions.get_or_insert_default().push(Note { file, what });
        own
    }

    pub(super) fn chain_of(&self, arm: &IdentifiedArm) -> Option<&crate::robot::Chain> {
        let dof = arm.mapping.joints.len();
        let is_it = |own: &&super::ArmModel| own.name == arm.arm && own.chain.dof() == dof;
        self.arms.iter().find(is_it).map(|own| &own.chain)
    }
}
