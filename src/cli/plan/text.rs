//! Describes a motion for people.

use std::io::{self, Write};

use poseaudit::diagnosis::plan::{
    ExpectedPrecision, JointRange, LimitKind, MotionPlan, geometric_mean, joint_ranges,
};
use poseaudit::finding::Unit;
use poseaudit::report::sanitize_display;
use poseaudit::stream::JointTrack;

use super::super::output::table;
use super::arm::PlannedArm;
use super::labels::{self, QuantityLabel};
use super::setup::{MotionCheck, PlanTask};
use super::{COLLISION_WARNING, write};

/// A joint with less room on one side, relative to the other, barely moves.
const MIN_MARGIN_RATIO: f64 = 0.2;

pub fn write_plan(
    arm: &PlannedArm,
    task: &PlanTask,
    planned: &MotionPlan,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    write_heading(arm, task, motion, out)?;
    writeln!(out, "\n{COLLISION_WARNING}\n")?;
    let others = [
        ("random phases", planned.random_precision.as_slice()),
        ("one joint at a time", planned.one_by_one_precision.as_slice()),
    ];
    write_precision(arm, task, &planned.precision, &others, out)?;
    for (name, other) in others {
        if let Some(times) = geometric_mean(other, &planned.precision) {
            writeln!(out, "{name}: {times:.2} times this motion's uncertainty")?;
        }
    }
    writeln!(out)?;
    write_motion(arm, task, motion, out)?;
    if planned.share < 1.0 {
        let share = 100.0 * planned.share;
        writeln!(
            out,
            "the full --amplitude would bring the arm too close to itself, the floor or the edge of the \
             view: using {share:.0} % of it"
        )?;
    }
    write_clearances(arm, task, out)
}

pub fn write_check(
    arm: &PlannedArm,
    task: &PlanTask,
    checked: &MotionCheck,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    write_heading(arm, task, motion, out)?;
    writeln!(out, "\nno collision checking with obstacles around the arm\n")?;
    for violation in &checked.limit_violations {
        let unit = if arm.is_prismatic(violation.joint) { "m" } else { "rad" };
        let unit = match violation.bound {
            LimitKind::Lower | LimitKind::Upper => unit.to_owned(),
            LimitKind::Speed => format!("{unit}/s"),
            LimitKind::Acceleration => format!("{unit}/s²"),
        };
        let (name, what) =
            (&arm.chain.joint_names()[violation.joint], labels::limit_name(violation.bound));
        writeln!(
            out,
            "LIMIT EXCEEDED: {name} has a {what} of {:.4} {unit} at {:.2} s; the limit is {:.4} {unit}",
            violation.value, violation.t_s, violation.limit
        )?;
    }
    if let Some((t_s, violation)) = &checked.clearance_violation {
        writeln!(out, "TOO CLOSE: {} at {t_s:.2} s", task.violation_text(violation))?;
    }
    if !checked.is_within() {
        writeln!(out)?;
    }
    write_precision(arm, task, &checked.precision, &[], out)?;
    writeln!(out)?;
    write_motion(arm, task, motion, out)?;
    write_clearances(arm, task, out)
}

fn write_heading(
    arm: &PlannedArm,
    task: &PlanTask,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let PlannedArm { robot, chain } = arm;
    let (base, tip) = (chain.base_name(), chain.tip_name());
    let (first, last) = motion.span().unwrap_or_default();
    let purpose = task.purpose.name();
    let (name, base, tip) =
        (sanitize_display(&robot.name), sanitize_display(base), sanitize_display(tip));
    writeln!(out, "{name}: {base} → {tip}, {:.1} s, for {purpose}", last - first)
}

/// Expected uncertainties of this and other motions.
fn write_precision(
    arm: &PlannedArm,
    task: &PlanTask,
    own: &[ExpectedPrecision],
    others: &[(&str, &[ExpectedPrecision])],
    out: &mut dyn Write,
) -> io::Result<()> {
    let header = ["expected ± (95 %)", "this motion"].into_iter();
    let mut rows = table(header.chain(others.iter().map(|(name, _)| *name)));
    let mut is_undetermined = false;
    for (at, expected) in own.iter().enumerate() {
        let label = QuantityLabel::new(arm, task, expected.quantity);
        let mut shown = |half: f64| match half.is_finite() {
            true => label.unit.show(half),
            false => {
                is_undetermined = true;
                "undetermined".to_owned()
            }
        };
        let mut row = vec![label.full_text(), shown(expected.half_width)];
        row.extend(
            others
                .iter()
                .map(|(_, other)| other.get(at).map_or(String::new(), |it| shown(it.half_width))),
        );
        rows.add_row(row);
    }
    writeln!(out, "{}", rows.trim_fmt())?;
    if is_undetermined && task.sensing.outside {
        writeln!(
            out,
            "undetermined: indistinguishable from the unknown tracker frame or marker offset in any motion"
        )?;
    } else if is_undetermined {
        writeln!(out, "undetermined: not observable in this motion")?;
    }
    let sensing = &task.sensing;
    let known = if sensing.outside { "unknown" } else { "known" };
    writeln!(
        out,
        "with poses at {:.0} Hz, white noise of {} and {} on each axis, and a {known} frame",
        sensing.rate_hz,
        Unit::Metre.show(sensing.noise_m),
        Unit::Radian.show(sensing.noise_rad)
    )
}

/// Motion of the joints, range of the tip.
fn write_motion(
    arm: &PlannedArm,
    task: &PlanTask,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let chain = &arm.chain;
    let mut rows = table([
        "joint", "from", "to", "speed", "limit", "acceleration", "limit", "position limits",
    ]);
    for (joint, extent) in joint_ranges(motion).into_iter().enumerate() {
        let JointRange { low, high, speed, acceleration } = extent;
        let unit = if arm.is_prismatic(joint) { "m" } else { "rad" };
        let (margin, limits) = (task.margins[joint], chain.limits()[joint]);
        let limit = |limit: Option<f64>| limit.map_or("none".to_owned(), |it| format!("{it:.2}"));
        rows.add_row([
            chain.joint_names()[joint].clone(),
            format!("{low:.3}"),
            format!("{high:.3} {unit}"),
            format!("{speed:.2}"),
            format!("{:.2} {unit}/s", margin.velocity),
            format!("{acceleration:.2}"),
            format!("{:.2} {unit}/s²", margin.acceleration),
            format!("{} to {} {unit}", limit(limits.lower), limit(limits.upper)),
        ]);
    }
    writeln!(out, "{}", rows.trim_fmt())?;
    let [low, high] = write::tip_box(arm, motion);
    let listed = |xyz: [f64; 3]| xyz.map(|it| format!("{it:.3}")).join(", ");
    writeln!(
        out,
        "the tip stays between ({}) and ({}) m in {}",
        listed(low),
        listed(high),
        chain.base_name()
    )
}

fn write_clearances(arm: &PlannedArm, task: &PlanTask, out: &mut dyn Write) -> io::Result<()> {
    let clearances = &task.clearances;
    let radii = &clearances.radius_m;
    let (low, high) =
        radii.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), r| (low.min(*r), high.max(*r)));
    let radius_source = match task.has_model_radius.iter().filter(|from_model| **from_model).count()
    {
        0 => "6 % of the reach; none in the model",
        from_model if from_model + 1 == radii.len() => "from the model's collision shapes",
        _ => "from the model's collision shapes, otherwise 6 % of the reach",
    };
    let radius = match Unit::Metre.show(low) == Unit::Metre.show(high) {
        true => Unit::Metre.show(low),
        false => format!("{} to {}", Unit::Metre.show(low), Unit::Metre.show(high)),
    };
    writeln!(
        out,
        "arm model: straight segments between joints, {radius} radius ({radius_source}); {} pairs are kept {} apart",
        clearances.pairs(),
        Unit::Metre.show(clearances.clear_m)
    )?;
    match clearances.floor_m {
        Some(floor_m) => {
            writeln!(out, "floor: kept {} above {floor_m} m", Unit::Metre.show(clearances.clear_m))?
        }
        None => writeln!(out, "floor: none given (--floor)")?,
    }
    for violation in clearances.close_pairs(&arm.chain, &task.around) {
        writeln!(
            out,
            "too close for these radii at the start: {}",
            task.violation_text(&violation)
        )?;
    }
    for (joint, margin) in task.margins.iter().enumerate() {
        if margin.below.min(margin.above) < MIN_MARGIN_RATIO * margin.below.max(margin.above) {
            let name = &arm.chain.joint_names()[joint];
            writeln!(
                out,
                "{name} barely moves: it starts at a limit; a configuration farther from it would show more"
            )?;
        }
    }
    if !task.unlimited.is_empty() {
        writeln!(
            out,
            "no speed limit in the model for {}: using 1 rad/s",
            task.unlimited.join(", ")
        )?;
    }
    Ok(())
}
