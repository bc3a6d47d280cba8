//! `poseaudit robots`.

use poseaudit::report::Trouble;
use poseaudit::robot::{Robot, catalogue};
use serde_json::{Value, json};

use super::output::Format;
use super::{Outcome, misuse, output};

/// List the arms of the built-in catalogue, or one of them with its joints
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit robots
  poseaudit robots ur5e")]
pub struct Args {
    /// An arm, by its name or an alias
    #[arg(value_name = "NAME")]
    name: Option<String>,

    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let robots: Vec<&Robot> = match &args.name {
        Some(name) => vec![find(name)?],
        None => catalogue::entries().collect(),
    };
    output::emit(None, |out| match (args.format, args.name.is_some()) {
        (Format::Json, _) => {
            let robots: Vec<Value> = robots.iter().map(|robot| as_json(robot)).collect();
            output::write_json(out, &robots)
        }
        (Format::Text, false) => writeln!(out, "{}", robot_table(&robots).trim_fmt()),
        (Format::Text, true) => robots.iter().try_for_each(|robot| {
            writeln!(out, "{}\n", robot_table(&[robot]).trim_fmt())?;
            if let Some(provenance) = &robot.provenance {
                writeln!(out, "parameters by {} ({})\n", provenance.source, provenance.licence)?;
            }
            writeln!(out, "{}", joint_table(robot).trim_fmt())
        }),
    })?;
    Ok(Outcome::Clean)
}

fn find(name: &str) -> Result<&'static Robot, Trouble> {
    catalogue::find(name).ok_or_else(|| {
        let nearest = catalogue::nearest_names(name);
        let remedy = match nearest.as_slice() {
            [] => "see `poseaudit robots` for all of them".to_owned(),
            near => format!("is it {}?", near.join(", ")),
        };
        misuse("robots", format!("unknown arm `{name}`"), remedy)
    })
}

fn robot_table(robots: &[&Robot]) -> comfy_table::Table {
    let mut table = output::table(["name", "arm", "joints", "base → tip", "reach m", "also"]);
    for robot in robots {
        let maker = robot.provenance.as_ref();
        let arm = maker.map_or(String::new(), |maker| format!("{} {}", maker.vendor, maker.model));
        let moving = robot.joints().iter().filter(|joint| joint.kind.has_position()).count();
        let [base, tip] = base_and_tip(robot);
        let reach = reach_m(robot).map_or(String::new(), |reach_m| format!("{reach_m:.3}"));
        table.add_row([
            robot.name.clone(),
            arm,
            moving.to_string(),
            format!("{base} → {tip}"),
            reach,
            robot.aliases.join(", "),
        ]);
    }
    table
}

fn base_and_tip(robot: &Robot) -> [&str; 2] {
    let named = |end: &Option<String>| robot.link(end.as_deref()?);
    let base = named(&robot.default_base).unwrap_or_else(|| robot.root());
    let tip = named(&robot.default_tip).or_else(|| robot.leaf_links().last());
    [robot.link_name(base), tip.map_or("", |tip| robot.link_name(tip))]
}

fn reach_m(robot: &Robot) -> Option<f64> {
    let [base, tip] = base_and_tip(robot);
    let chain = robot.chain(robot.link(base)?, robot.link(tip)?).ok()?;
    Some(chain.max_reach_m())
}

fn joint_table(robot: &Robot) -> comfy_table::Table {
    let mut table = output::table(["joint", "kind", "parent → child", "lower", "upper", "speed"]);
    for joint in robot.joints() {
        let limit = |limit: Option<f64>| limit.map_or(String::new(), |limit| format!("{limit:.4}"));
        table.add_row([
            joint.name.clone(),
            joint.kind.name().to_owned(),
            format!("{} → {}", robot.link_name(joint.parent), robot.link_name(joint.child)),
            limit(joint.limits.lower),
            limit(joint.limits.upper),
            limit(joint.limits.velocity),
        ]);
    }
    table
}

fn as_json(robot: &Robot) -> Value {
    let [base, tip] = base_and_tip(robot);
    let maker = robot.provenance.as_ref();
    let joints = robot.joints().iter().map(|joint| {
        json!({
            "name": joint.name,
            "kind": joint.kind.name(),
            "parent": robot.link_name(joint.parent),
            "child": robot.link_name(joint.child),
            "lower": joint.limits.lower,
            "upper": joint.limits.upper,
            "velocity": joint.limits.velocity,
        })
    });
    json!({
        "name": robot.name,
        "vendor": maker.map(|maker| &maker.vendor),
        "model": maker.map(|maker| &maker.model),
        "source": maker.map(|maker| &maker.source),
        "licence": maker.map(|maker| &maker.licence),
        "aliases": robot.aliases,
        "base": base,
        "tip": tip,
        "controller_base": robot.controller_base,
        "controller_tip": robot.controller_tip,
        "max_reach_m": reach_m(robot),
        "joints": joints.collect::<Vec<_>>(),
    })
}
