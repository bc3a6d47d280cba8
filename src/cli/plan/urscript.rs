//! A motion as a URScript program.

use std::io::{self, Write};

use poseaudit::diagnosis::plan::FourierMotion;
use poseaudit::report::Trouble;
use poseaudit::report::sanitize_display;
use poseaudit::robot::{Chain, UR_JOINTS};

use super::super::misuse;
use super::COLLISION_WARNING;
use super::arm::PlannedArm;
use super::setup::PlanTask;

/// Between commands: a multiple of every controller's period.
const COMMAND_PERIOD_S: f64 = 0.008;

/// Fails unless the arm has a UR's joints.
pub fn check_is_ur(chain: &Chain) -> Result<(), Trouble> {
    let names = chain.joint_names();
    match names.len() == UR_JOINTS.len() && names.iter().zip(UR_JOINTS).all(|(a, b)| a.ends_with(b))
    {
        true => Ok(()),
        false => Err(misuse(
            "--format",
            "URScript runs only on Universal Robots, and this arm has different joints",
            "use csv, json or yaml",
        )),
    }
}

/// Evaluates the sine series at run time; starts only in the start configuration.
pub fn write_program(
    arm: &PlannedArm,
    task: &PlanTask,
    series: &FourierMotion,
    out: &mut dyn Write,
) -> io::Result<()> {
    let rate = std::f64::consts::TAU / series.seconds;
    let purpose = task.purpose.name();
    let around: Vec<String> = series.around.iter().map(|q| format!("{q:.9}")).collect();
    writeln!(
        out,
        "# poseaudit plan: {}, {:.1} s, for {purpose}",
        sanitize_display(&arm.robot.name),
        series.length_s()
    )?;
    writeln!(out, "# {COLLISION_WARNING}.")?;
    writeln!(out, "# Starts only if the arm is in the start configuration. Angles are in rad.")?;
    writeln!(out, "def poseaudit_plan():")?;
    writeln!(out, "  local first = [{}]", around.join(", "))?;
    writeln!(out, "  def posture(t):")?;
    for (joint, middle) in around.iter().enumerate() {
        let own = joint * series.harmonics..(joint + 1) * series.harmonics;
        let parts = series.sin[own.clone()].iter().zip(&series.cos[own]).enumerate();
        write!(out, "    local q{joint} = {middle}")?;
        for (k, (sin, cos)) in parts {
            let rate = (k + 1) as f64 * rate;
            write!(out, " {sin:+.9} * sin({rate:.9} * t) {cos:+.9} * cos({rate:.9} * t)")?;
        }
        writeln!(out)?;
    }
    writeln!(out, "    return [q0, q1, q2, q3, q4, q5]")?;
    writeln!(out, "  end")?;
    writeln!(out, "  local now = get_actual_joint_positions()")?;
    writeln!(out, "  local j = 0")?;
    writeln!(out, "  while (j < 6):")?;
    writeln!(out, "    if (norm(now[j] - first[j]) > 0.01):")?;
    writeln!(
        out,
        "      popup(\"Move the arm to the start configuration by hand: this program does not plan a path to \
         it.\", \"poseaudit plan\", False, True, blocking=True)"
    )?;
    writeln!(out, "      halt")?;
    writeln!(out, "    end")?;
    writeln!(out, "    j = j + 1")?;
    writeln!(out, "  end")?;
    writeln!(out, "  sleep({:.3})", series.rest_s)?;
    writeln!(out, "  local t = 0.0")?;
    writeln!(out, "  while (t < {:.3}):", series.seconds)?;
    writeln!(out, "    servoj(posture(t), t={COMMAND_PERIOD_S}, lookahead_time=0.1, gain=300)")?;
    writeln!(out, "    t = t + {COMMAND_PERIOD_S}")?;
    writeln!(out, "  end")?;
    writeln!(out, "  servoj(first, t=0.5, lookahead_time=0.1, gain=300)")?;
    writeln!(out, "  stopj(1.0)")?;
    writeln!(out, "  sleep({:.3})", series.rest_s)?;
    writeln!(out, "end")?;
    writeln!(out, "poseaudit_plan()")
}
