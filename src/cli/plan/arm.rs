//! The arm whose motion is planned.

use std::path::Path;

use poseaudit::log::{self, ReadOptions};
use poseaudit::report::Trouble;
use poseaudit::robot::{Chain, JointKind, Robot};
use poseaudit::run::{Run, RunOptions, load_robot};

use super::super::{fk, misuse};
use super::Args;

pub struct PlannedArm {
    pub robot: Robot,
    /// Chain from base to tip.
    pub chain: Chain,
}

impl PlannedArm {
    pub fn from_args(args: &Args) -> Result<Self, Trouble> {
        let unread = match load_robot(&args.robot) {
            Ok(robot) => {
                let chain = fk::chain(&robot, args.base.as_deref(), args.tip.as_deref())?;
                return Ok(Self { robot, chain });
            }
            Err(error) => Trouble { place: args.robot.clone(), ..Trouble::from(&error) },
        };
        let path = Path::new(&args.robot);
        let is_there = path.exists() || log::local(path).is_none();
        let opened = is_there.then(|| log::open(&[path.to_owned()], &ReadOptions::default()));
        match opened {
            Some(Ok(log)) => Self::from_log(log, args),
            _ => Err(unread),
        }
    }

    fn from_log(log: log::Log, args: &Args) -> Result<Self, Trouble> {
        let options =
            RunOptions { base: args.base.clone(), tip: args.tip.clone(), ..RunOptions::default() };
        let run = Run::complete(log, &options, |_| Ok::<_, Trouble>(()))?;
        if let Some(why) = &run.no_arm {
            return Err(why.into());
        }
        let names: Vec<&str> = run.arms.iter().map(|arm| arm.name.as_str()).collect();
        let listed = names.join(", ");
        let found = match (&args.arm, run.arms.as_slice()) {
            (None, [arm]) => Some(arm),
            (Some(name), arms) => arms.iter().find(|arm| arm.name == *name),
            _ => None,
        };
        let arm = found.ok_or_else(|| {
            misuse("--arm", format!("the log has the arms {listed}"), "name one of them")
        })?;
        Ok(Self { robot: arm.robot.clone(), chain: arm.chain.clone() })
    }

    pub fn is_prismatic(&self, at: usize) -> bool {
        self.chain.joint_kinds()[at] == JointKind::Prismatic
    }

    /// The configuration of `--around`, in SI units.
    pub fn around(&self, args: &Args) -> Result<Vec<f64>, Trouble> {
        fk::configuration(&self.chain, &args.around, args.deg, "--around")
    }
}
