//! Describes a motion for people.

use std::io::{self, Write};

use poseaudit::diagnosis::plan::{
    ExpectedPrecision, JointRange, LimitKind, MotionPlan, geometric_mean, joint_ranges,
};
use poseaudit::finding::Unit;
use poseaudit::report::foreign;
use poseaudit::stream::JointTrack;

use super::super::output::table;
use super::arm::Planning;
use super::labels::{self, Label};
use super::setup::{Asked, Checked};
use super::{OBSTACLES, write};

/// A joint with less room on one side, relative to the other, barely moves.
const HARDLY: f64 = 0.2;

pub fn planned(
    planning: &Planning,
    asked: &Asked,
    planned: &MotionPlan,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    heading(planning, asked, motion, out)?;
    writeln!(out, "\n{OBSTACLES}\n")?;
    let others = [
        ("random phases", planned.random_precision.as_slice()),
        ("one joint at a time", planned.one_by_one_precision.as_slice()),
    ];
    promises(planning, asked, &planned.precision, &others, out)?;
    for (name, other) in others {
        if let Some(times) = geometric_mean(other, &planned.precision) {
            writeln!(out, "{name}: {times:.2} times this motion's uncertainty")?;
        }
    }
    writeln!(out)?;
    motions(planning, asked, motion, out)?;
    if planned.share < 1.0 {
        let share = 100.0 * planned.share;
        writeln!(
            out,
            "the full --amplitude would bring the arm too close to itself, the floor or the edge of the \
             view: using {share:.0} % of it"
        )?;
    }
    kept(planning, asked, out)
}

pub fn checked(
    planning: &Planning,
    asked: &Asked,
    checked: &Checked,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    heading(planning, asked, motion, out)?;
    writeln!(out, "\nno collision checking with obstacles around the arm\n")?;
    for found in &checked.beyond {
        let unit = if planning.slides(found.joint) { "m" } else { "rad" };
        let unit = match found.bound {
            LimitKind::Lower | LimitKind::Upper => unit.to_owned(),
            LimitKind::Speed => format!("{unit}/s"),
            LimitKind::Acceleration => format!("{unit}/s²"),
        };
        let (name, what) = (&planning.chain.joint_names()[found.joint], labels::bound(found.bound));
        writeln!(
            out,
            "LIMIT EXCEEDED: {name} has a {what} of {:.4} {unit} at {:.2} s; the limit is {:.4} {unit}",
            found.value, found.t_s, found.limit
        )?;
    }
    if let Some((t_s, near)) = &checked.near {
        writeln!(out, "TOO CLOSE: {} at {t_s:.2} s", asked.nearness(near))?;
    }
    if !checked.is_within() {
        writeln!(out)?;
    }
    promises(planning, asked, &checked.promises, &[], out)?;
    writeln!(out)?;
    motions(planning, asked, motion, out)?;
    kept(planning, asked, out)
}

fn heading(
    planning: &Planning,
    asked: &Asked,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let Planning { robot, chain } = planning;
    let (base, tip) = (chain.base_name(), chain.tip_name());
    let (first, last) = motion.span().unwrap_or_default();
    let purpose = asked.purpose.name();
    let (name, base, tip) = (foreign(&robot.name), foreign(base), foreign(tip));
    writeln!(out, "{name}: {base} → {tip}, {:.1} s, for {purpose}", last - first)
}

/// Expected uncertainties of this and other motions.
fn promises(
    planning: &Planning,
    asked: &Asked,
    own: &[ExpectedPrecision],
    others: &[(&str, &[ExpectedPrecision])],
    out: &mut dyn Write,
) -> io::Result<()> {
    let header = ["expected ± (95 %)", "this motion"].into_iter();
    let mut rows = table(header.chain(others.iter().map(|(name, _)| *name)));
    let mut is_hidden = false;
    for (at, promise) in own.iter().enumerate() {
        let label = Label::of(planning, asked, promise.quantity);
        let mut shown = |half: f64| match half.is_finite() {
            true => label.unit.show(half),
            false => {
                is_hidden = true;
                "undetermined".to_owned()
            }
        };
        let mut row = vec![label.whole(), shown(promise.half_width)];
        row.extend(
            others
                .iter()
                .map(|(_, other)| other.get(at).map_or(String::new(), |it| shown(it.half_width))),
        );
        rows.add_row(row);
    }
    writeln!(out, "{}", rows.trim_fmt())?;
    if is_hidden && asked.sensing.outside {
        writeln!(
            out,
            "undetermined: indistinguishable from the unknown tracker frame or marker offset in any motion"
        )?;
    } else if is_hidden {
        writeln!(out, "undetermined: not observable in this motion")?;
    }
    let sensing = &asked.sensing;
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
fn motions(
    planning: &Planning,
    asked: &Asked,
    motion: &JointTrack,
    out: &mut dyn Write,
) -> io::Result<()> {
    let chain = &planning.chain;
    let mut rows = table([
        "joint",
        "from",
        "to",
        "speed",
        "limit",
        "acceleration",
        "limit",
        "position limits",
    ]);
    for (joint, extent) in joint_ranges(motion).into_iter().enumerate() {
        let JointRange { low, high, speed, acceleration } = extent;
        let unit = if planning.slides(joint) { "m" } else { "rad" };
        let (room, limits) = (asked.rooms[joint], chain.limits()[joint]);
        let limit = |limit: Option<f64>| limit.map_or("none".to_owned(), |it| format!("{it:.2}"));
        rows.add_row([
            chain.joint_names()[joint].clone(),
            format!("{low:.3}"),
            format!("{high:.3} {unit}"),
            format!("{speed:.2}"),
            format!("{:.2} {unit}/s", room.velocity),
            format!("{acceleration:.2}"),
            format!("{:.2} {unit}/s²", room.acceleration),
            format!("{} to {} {unit}", limit(limits.lower), limit(limits.upper)),
        ]);
    }
    writeln!(out, "{}", rows.trim_fmt())?;
    let [low, high] = write::tip_box(planning, motion);
    let listed = |xyz: [f64; 3]| xyz.map(|it| format!("{it:.3}")).join(", ");
    writeln!(
        out,
        "the tip stays between ({}) and ({}) m in {}",
        listed(low),
        listed(high),
        chain.base_name()
    )
}

fn kept(planning: &Planning, asked: &Asked, out: &mut dyn Write) -> io::Result<()> {
    let keep = &asked.keep;
    let radii = &keep.body.radius_m;
    let (low, high) =
        radii.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), r| (low.min(*r), high.max(*r)));
    let whence = match asked.told.iter().filter(|told| **told).count() {
        0 => "6 % of the reach; none in the model",
        told if told + 1 == radii.len() => "from the model's collision shapes",
        _ => "from the model's collision shapes, otherwise 6 % of the reach",
    };
    let radius = match Unit::Metre.show(low) == Unit::Metre.show(high) {
        true => Unit::Metre.show(low),
        false => format!("{} to {}", Unit::Metre.show(low), Unit::Metre.show(high)),
    };
    writeln!(
        out,
        "arm model: straight segments between joints, {radius} radius ({whence}); {} pairs are kept {} apart",
        keep.pairs(),
        Unit::Metre.show(keep.clear_m)
    )?;
    match keep.floor_m {
        Some(floor_m) => {
            writeln!(out, "floor: kept {} above {floor_m} m", Unit::Metre.show(keep.clear_m))?
        }
        None => writeln!(out, "floor: none given (--floor)")?,
    }
    for near in keep.close_pairs(&planning.chain, &asked.around) {
        writeln!(out, "too close for these radii at the start: {}", asked.nearness(&near))?;
    }
    for (joint, room) in asked.rooms.iter().enumerate() {
        if room.below.min(room.above) < HARDLY * room.below.max(room.above) {
            let name = &planning.chain.joint_names()[joint];
            writeln!(
                out,
                "{name} barely moves: it starts at a limit; a configuration farther from it would show more"
            )?;
        }
    }
    if !asked.unlimited.is_empty() {
        writeln!(
            out,
            "no speed limit in the model for {}: using 1 rad/s",
            asked.unlimited.join(", ")
        )?;
    }
    Ok(())
}
