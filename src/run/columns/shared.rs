//! What some logs of a dataset tell of all of them, so that it is sought once and only verified in the others.

use serde::{Deserialize, Serialize};

use crate::finding::Unit;
use crate::log::{Log, Note};
use crate::robot::{Robot, catalogue};

use super::{MOVES_M, Search, Taken, Told, selectors};

/// What some logs of a dataset tell of all of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shared {
    /// The logs that told it.
    pub from: Vec<String>,
    /// The arm of the catalogue that they are of.
    pub robot: Option<String>,
    /// What their columns hold, where names leave that open.
    pub columns: Option<SharedColumns>,
}

/// What the columns of a table hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharedColumns {
    /// The log that told it.
    pub from: String,
    /// All numbers of a row that were looked at, by their names.
    numbers: Vec<String>,
    arms: Vec<Taken>,
    question: Option<String>,
}

/// Some columns of a dataset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SharedRow {
    /// What they are.
    pub is: String,
    /// Which, as `[columns]` of a config names them.
    pub columns: Vec<String>,
    /// By what that was told.
    pub why: String,
}

impl Shared {
    /// What it says of a table with these numbers a row.
    pub(super) fn of(&self, numbers: &[String]) -> Option<&SharedColumns> {
        let are_within =
            |of: &SharedColumns| of.arms.iter().all(|arm| arm.is_within(numbers.len()));
        self.columns.as_ref().filter(|of| of.numbers == numbers && are_within(of))
    }
}

impl SharedColumns {
    pub(super) fn of(numbers: Vec<String>, told: Told) -> Self {
        Self { from: String::new(), numbers, arms: told.arms, question: told.question }
    }

    /// Whether it says what the columns are.
    pub fn is_told(&self) -> bool {
        !self.arms.is_empty() && self.question.is_none()
    }

    /// Whether it says the same as another.
    pub fn agrees(&self, other: &Self) -> bool {
        let of = |it: &Self| -> Vec<_> {
            let arm = |arm: &Taken| {
                let commands = [&arm.joint_commands, &arm.pose_commands];
                let commands = commands.map(|of| of.as_ref().map(|(columns, _)| columns.clone()));
                (arm.mapping.joints.clone(), arm.mapping.unit, arm.pose.clone(), commands)
            };
            it.arms.iter().map(arm).collect()
        };
        self.numbers == other.numbers && of(self) == of(other)
    }

    /// What they leave open.
    pub fn question(&self) -> Option<&str> {
        self.question.as_deref()
    }

    /// What its columns are, and why.
    pub fn rows(&self) -> Vec<SharedRow> {
        let row = |is: &str, columns: &[usize], why: &str| SharedRow {
            is: is.to_owned(),
            columns: selectors(
                &columns.iter().map(|&at| self.numbers[at].clone()).collect::<Vec<_>>(),
            ),
            why: why.to_owned(),
        };
        let of = |arm: &Taken| {
            let commands =
                [("joint commands", &arm.joint_commands), ("pose commands", &arm.pose_commands)];
            let commands = commands.into_iter().filter_map(|(is, of)| {
                let (columns, why) = of.as_ref()?;
                Some(row(is, columns, why))
            });
            let unit = arm.mapping.unit.words();
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

    /// The arms of the catalogue that it is of.
    pub(super) fn robots(&self) -> Vec<&'static Robot> {
        let mut robots: Vec<_> =
            self.arms.iter().filter_map(|arm| catalogue::find(&arm.arm)).collect();
        robots.dedup_by_key(|robot| &robot.name);
        robots
    }
}

impl Search<'_> {
    /// What `shared` says, verified here: where FK does not follow, the columns are sought anew, and what
    /// they are instead is a contradiction.
    pub(super) fn shared(&self, shared: &SharedColumns, log: &mut Log) -> Told {
        let from = &shared.from;
        let mut told = Told { arms: Vec::new(), question: shared.question.clone() };
        if let Some(question) = &mut told.question {
            *question += &format!(" (asked of {from}, not of each log)");
        }
        let mut unfit = None;
        for arm in &shared.arms {
            let found = self
                .chain_of(arm)
                .and_then(|chain| self.cells.sheet.again(&arm.mapping, chain, self.most_lag_s));
            let found = found.filter(|found| found.spread_m > MOVES_M);
            let (name, position) = (&arm.arm, self.said(&arm.mapping.position));
            let here = match &found {
                None => "too little moves here to verify it".to_owned(),
                Some(found) => {
                    let of = Unit::Metre.show(found.spread_m);
                    format!(
                        "here FK leaves {} of {of} of {position}",
                        Unit::Metre.show(found.left_m)
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
            told.arms.push(Taken {
                joints_why: why(&format!("joints of {name} in {}", arm.mapping.unit.words())),
                pose_why: why(&format!("a pose that FK of {name} follows")),
                joint_commands: commands(&arm.joint_commands, "joint commands"),
                pose_commands: commands(&arm.pose_commands, "pose commands"),
                ..arm.clone()
            });
        }
        let (Some(unfit), Some(file)) = (unfit, log.files.first().map(|file| file.path.clone()))
        else {
            return told;
        };
        let own = self.told(log);
        if own.arms.is_empty() {
            log.notes
                .push(Note { file, what: format!("the columns are taken as in {from}; {unfit}") });
            return told;
        }
        let ways: Vec<String> = own.arms.iter().map(|arm| self.lines(&arm.mapping)).collect();
        let what = format!(
            "its columns are others than in {from}: [columns] {}; {unfit}",
            ways.join("; ")
        );
        log.contradictions.get_or_insert_default().push(Note { file, what });
        own
    }

    /// The chain of an arm that another log told.
    pub(super) fn chain_of(&self, arm: &Taken) -> Option<&crate::robot::Chain> {
        let dof = arm.mapping.joints.len();
        let is_it = |own: &&super::Candidate| own.name == arm.arm && own.chain.dof() == dof;
        self.arms.iter().find(is_it).map(|own| &own.chain)
    }
}
