//! Writes motions as CSV, JSON or JointTrajectory.

use std::io::{self, Write};

use poseaudit::diagnosis::plan::{
    ExpectedPrecision, FourierMotion, MotionPlan, geometric_mean, joint_ranges,
};
use poseaudit::report::foreign;
use poseaudit::stream::JointTrack;
use serde_json::{Value, json};

use super::OBSTACLES;
use super::arm::Planning;
use super::labels::{self, Label};
use super::setup::{Asked, Checked};

/// Point rate of a JointTrajectory; controllers interpolate.
const POINTS_HZ: f64 = 20.0;

/// Time, positions and speeds of each sample.
pub fn csv(planning: &Planning, motion: &JointTrack, out: &mut dyn Write) -> io::Result<()> {
    let names = planning.chain.joint_names();
    let mut writer = csv::Writer::from_writer(out);
    let speeds = names.iter().map(|name| format!("{name}.velocity"));
    let header = std::iter::once("t_s".to_owned()).chain(names.iter().cloned()).chain(speeds);
    writer.write_record(header)?;
    for row in 0..motion.len() {
        let own = row * motion.dof..(row + 1) * motion.dof;
        let numbers = motion.q[own.clone()].iter().chain(&motion.qd[own]);
        let time = std::iter::once(format!("{:.6}", motion.t_s[row]));
        writer.write_record(time.chain(numbers.map(|number| format!("{:.9}", number + 0.0))))?;
    }
    writer.flush()
}

pub fn json(
    planning: &Planning,
    asked: &Asked,
    planned: &MotionPlan,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let MotionPlan {
        series,
        share,
        precision: promises,
        random_precision: random,
        one_by_one_precision: one_by_one,
    } = planned;
    let mut said = head(planning, asked, motion);
    said["amplitude_share"] = json!(share);
    said["expected"] = expected(planning, asked, promises);
    said["random_phases"] = expected(planning, asked, random);
    said["one_joint_at_a_time"] = expected(planning, asked, one_by_one);
    said["gain"] = json!({
        "over_random_phases": geometric_mean(random, promises),
        "over_one_joint_at_a_time": geometric_mean(one_by_one, promises),
    });
    let rows = |values: &[f64]| -> Vec<Vec<f64>> {
        values.chunks(series.harmonics).map(<[f64]>::to_vec).collect()
    };
    said["series"] = json!({
        "around": series.around, "seconds": series.seconds, "rest_s": series.rest_s,
        "sin": rows(&series.sin), "cos": rows(&series.cos),
    });
    said["trajectory"] = trajectory(motion);
    writeln!(out, "{said:#}")
}

pub fn checked_json(
    planning: &Planning,
    asked: &Asked,
    checked: &Checked,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let mut said = head(planning, asked, motion);
    said["expected"] = expected(planning, asked, &checked.promises);
    let beyond = checked.beyond.iter().map(|it| {
        json!({
            "joint": planning.chain.joint_names()[it.joint], "what": labels::bound(it.bound),
            "t_s": it.t_s, "value": it.value, "limit": it.limit,
        })
    });
    said["beyond"] = beyond.collect();
    let near = checked.near.as_ref();
    said["too_near"] =
        near.map_or(Value::Null, |(t_s, near)| json!({"t_s": t_s, "what": asked.nearness(near)}));
    writeln!(out, "{said:#}")
}

fn head(planning: &Planning, asked: &Asked, motion: &JointTrack) -> Value {
    let Planning { robot, chain } = planning;
    let joints = joint_ranges(motion).into_iter().enumerate().map(|(joint, it)| {
        let (room, limits) = (asked.rooms[joint], chain.limits()[joint]);
        json!({
            "name": chain.joint_names()[joint], "lowest": it.low, "highest": it.high,
            "speed": it.speed, "acceleration": it.acceleration,
            "limits": {
                "lower": limits.lower, "upper": limits.upper,
                "speed": room.velocity, "acceleration": room.acceleration,
            },
        })
    });
    let [low, high] = tip_box(planning, motion);
    let sensing = &asked.sensing;
    json!({
        "schema": "poseaudit.plan/1", "robot": robot.name, "base": chain.base_name(),
        "tip": chain.tip_name(), "for": asked.purpose.name(), "around": asked.around,
        "warning": OBSTACLES,
        "noise": {
            "m": sensing.noise_m, "rad": sensing.noise_rad, "rate_hz": sensing.rate_hz,
            "outside": sensing.outside, "links_m": sensing.link_m,
        },
        "joints": joints.collect::<Vec<_>>(),
        "radius_m": asked.keep.body.radius_m, "clear_m": asked.keep.clear_m,
        "floor_m": asked.keep.floor_m, "tip_box": {"low": low, "high": high},
    })
}

fn expected(planning: &Planning, asked: &Asked, promises: &[ExpectedPrecision]) -> Value {
    let rows = promises.iter().map(|promise| {
        let label = Label::of(planning, asked, promise.quantity);
        let half = promise.half_width.is_finite().then_some(promise.half_width);
        json!({"name": label.name, "of": label.of, "half_95": half, "unit": label.unit.symbol()})
    });
    rows.collect()
}

fn trajectory(motion: &JointTrack) -> Value {
    let rows = |values: &[f64]| -> Vec<Vec<f64>> {
        values.chunks(motion.dof).map(<[f64]>::to_vec).collect()
    };
    json!({"t_s": motion.t_s, "q": rows(&motion.q), "qd": rows(&motion.qd)})
}

pub fn yaml(planning: &Planning, series: &FourierMotion, out: &mut dyn Write) -> io::Result<()> {
    let listed = |numbers: &[f64]| {
        let numbers = numbers.iter().map(|number| format!("{:.9}", number + 0.0));
        numbers.collect::<Vec<_>>().join(", ")
    };
    let quoted = |name: &String| Value::from(name.as_str()).to_string();
    let names: Vec<String> = planning.chain.joint_names().iter().map(quoted).collect();
    writeln!(
        out,
        "# trajectory_msgs/JointTrajectory of poseaudit plan, for {}",
        foreign(&planning.robot.name)
    )?;
    writeln!(out, "# {OBSTACLES}")?;
    writeln!(out, "# The arm must be in the start configuration at the beginning.")?;
    writeln!(out, "header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: ''}}")?;
    writeln!(out, "joint_names: [{}]", names.join(", "))?;
    writeln!(out, "points:")?;
    let last = (series.length_s() * POINTS_HZ).ceil() as usize;
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
pub fn tip_box(planning: &Planning, motion: &JointTrack) -> [[f64; 3]; 2] {
    let tips =
        (0..motion.len()).map(|row| planning.chain.forward(motion.row(row)).translation.vector);
    tips.fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], |[low, high], tip| {
        [
            std::array::from_fn(|axis| low[axis].min(tip[axis])),
            std::array::from_fn(|axis| high[axis].max(tip[axis])),
        ]
    })
}
