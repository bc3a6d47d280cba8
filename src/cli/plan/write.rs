//! Writes motions as CSV, JSON or JointTrajectory.

use std::io::{self, Write};

use poseaudit::diagnosis::plan::{
    ExpectedPrecision, FourierMotion, MotionPlan, geometric_mean, joint_ranges,
};
use poseaudit::report::sanitize_display;
use poseaudit::stream::JointTrack;
use serde_json::{Value, json};

use super::COLLISION_WARNING;
use super::arm::PlannedArm;
use super::labels::{self, QuantityLabel};
use super::setup::{MotionCheck, PlanTask};

/// Point rate of a JointTrajectory; controllers interpolate.
const POINT_RATE_HZ: f64 = 20.0;

/// Time, positions and speeds of each sample.
pub fn write_csv(arm: &PlannedArm, motion: &JointTrack, out: &mut dyn Write) -> io::Result<()> {
    let names = arm.chain.joint_names();
    let mut writer = csv::Writer::from_writer(out);
    let speeds = names.iter().map(|name| format!("{name}.velocity"));
    let header = std::iter::once("t_s".to_owned()).chain(names.iter().cloned()).chain(speeds);
    writer.write_record(header)?;
    for row in 0..motion.len() {
        let numbers = motion.row(row).iter().chain(motion.velocities(row));
        let time = std::iter::once(format!("{:.6}", motion.t_s[row]));
        writer.write_record(time.chain(numbers.map(|number| format!("{:.9}", number + 0.0))))?;
    }
    writer.flush()
}

pub fn write_json(
    arm: &PlannedArm,
    task: &PlanTask,
    planned: &MotionPlan,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let MotionPlan {
        series,
        share,
        precision,
        random_precision: random,
        one_by_one_precision: one_by_one,
    } = planned;
    let mut document = header_json(arm, task, motion);
    document["amplitude_share"] = json!(share);
    document["expected"] = precision_json(arm, task, precision);
    document["random_phases"] = precision_json(arm, task, random);
    document["one_joint_at_a_time"] = precision_json(arm, task, one_by_one);
    document["gain"] = json!({
        "over_random_phases": geometric_mean(random, precision),
        "over_one_joint_at_a_time": geometric_mean(one_by_one, precision),
    });
    let rows = |values: &[f64]| -> Vec<Vec<f64>> {
        values.chunks(series.harmonics).map(<[f64]>::to_vec).collect()
    };
    document["series"] = json!({
        "around": series.around, "seconds": series.seconds, "rest_s": series.rest_s,
        "sin": rows(&series.sin), "cos": rows(&series.cos),
    });
    document["trajectory"] = trajectory_json(motion);
    writeln!(out, "{document:#}")
}

pub fn write_check_json(
    arm: &PlannedArm,
    task: &PlanTask,
    checked: &MotionCheck,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let mut document = header_json(arm, task, motion);
    document["expected"] = precision_json(arm, task, &checked.precision);
    let violations = checked.limit_violations.iter().map(|it| {
        json!({
            "joint": arm.chain.joint_names()[it.joint], "what": labels::limit_name(it.bound),
            "t_s": it.t_s, "value": it.value, "limit": it.limit,
        })
    });
    document["beyond"] = violations.collect();
    let violation = checked.clearance_violation.as_ref();
    document["too_near"] = violation.map_or(
        Value::Null,
        |(t_s, violation)| json!({"t_s": t_s, "what": task.violation_text(violation)}),
    );
    writeln!(out, "{document:#}")
}

fn header_json(arm: &PlannedArm, task: &PlanTask, motion: &JointTrack) -> Value {
    let PlannedArm { robot, chain } = arm;
    let joints = joint_ranges(motion).into_iter().enumerate().map(|(joint, it)| {
        let (margin, limits) = (task.margins[joint], chain.limits()[joint]);
        json!({
            "name": chain.joint_names()[joint], "lowest": it.low, "highest": it.high,
            "speed": it.speed, "acceleration": it.acceleration,
            "limits": {
                "lower": limits.lower, "upper": limits.upper,
                "speed": margin.velocity, "acceleration": margin.acceleration,
            },
        })
    });
    let [low, high] = tip_box(arm, motion);
    let sensing = &task.sensing;
    json!({
        "schema": "poseaudit.plan/1", "robot": robot.name, "base": chain.base_name(),
        "tip": chain.tip_name(), "for": task.purpose.name(), "around": task.around,
        "warning": COLLISION_WARNING,
        "noise": {
            "m": sensing.noise_m, "rad": sensing.noise_rad, "rate_hz": sensing.rate_hz,
            "outside": sensing.outside, "links_m": sensing.link_m,
        },
        "joints": joints.collect::<Vec<_>>(),
        "radius_m": task.clearances.radius_m, "clear_m": task.clearances.clear_m,
        "floor_m": task.clearances.floor_m, "tip_box": {"low": low, "high": high},
    })
}

fn precision_json(arm: &PlannedArm, task: &PlanTask, precision: &[ExpectedPrecision]) -> Value {
    let rows = precision.iter().map(|expected| {
        let label = QuantityLabel::new(arm, task, expected.quantity);
        let half = expected.half_width.is_finite().then_some(expected.half_width);
        json!({"name": label.key, "of": label.axis_or_joint, "half_95": half, "unit": label.unit.symbol()})
    });
    rows.collect()
}

fn trajectory_json(motion: &JointTrack) -> Value {
    let rows = |values: &[f64]| -> Vec<Vec<f64>> {
        values.chunks(motion.dof).map(<[f64]>::to_vec).collect()
    };
    json!({"t_s": motion.t_s, "q": rows(&motion.q), "qd": rows(&motion.qd)})
}

pub fn write_yaml(arm: &PlannedArm, series: &FourierMotion, out: &mut dyn Write) -> io::Result<()> {
    let listed = |numbers: &[f64]| {
        let numbers = numbers.iter().map(|number| format!("{:.9}", number + 0.0));
        numbers.collect::<Vec<_>>().join(", ")
    };
    let quoted = |name: &String| Value::from(name.as_str()).to_string();
    let names: Vec<String> = arm.chain.joint_names().iter().map(quoted).collect();
    writeln!(
        out,
        "# trajectory_msgs/JointTrajectory of poseaudit plan, for {}",
        sanitize_display(&arm.robot.name)
    )?;
    writeln!(out, "# {COLLISION_WARNING}")?;
    writeln!(out, "# The arm must be in the start configuration at the beginning.")?;
    writeln!(out, "header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: ''}}")?;
    writeln!(out, "joint_names: [{}]", names.join(", "))?;
    writeln!(out, "points:")?;
    let last = (series.length_s() * POINT_RATE_HZ).ceil() as usize;
    for row in 0..=last {
        let t_s = series.length_s() * row as f64 / last as f64;
        let joints: Vec<[f64; 3]> = (0..series.dof()).map(|joint| series.at(joint, t_s)).collect();
        let part = |at: usize| listed(&joints.iter().map(|it| it[at]).collect::<Vec<_>>());
        let nanos = (t_s * 1e9).round() as u64;
        let (sec, nanosec) = (nanos / 1_000_000_000, nanos % 1_000_000_000);
        writeln!(out, "- positions: [{}]", part(0))?;
        writeln!(out, "  velocities: [{}]", part(1))?;
        writeln!(out, "  accelerations: [{}]", part(2))?;
        writeln!(out, "  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")?;
    }
    Ok(())
}

/// Lower and upper corner, m.
pub fn tip_box(arm: &PlannedArm, motion: &JointTrack) -> [[f64; 3]; 2] {
    let tips = (0..motion.len()).map(|row| arm.chain.forward(motion.row(row)).translation.vector);
    tips.fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], |[low, high], tip| {
        [
            std::array::from_fn(|axis| low[axis].min(tip[axis])),
            std::array::from_fn(|axis| high[axis].max(tip[axis])),
        ]
    })
}
