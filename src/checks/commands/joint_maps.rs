//! Joints whose state differs from its command by a constant map: reversed, scaled or off by a constant.

use std::f64::consts::{FRAC_PI_2, PI};

use serde_json::{Value, json};

use crate::diagnosis::{CommandDelay, JointMap, Measured, RestError};
use crate::finding::Unit;
use crate::run::is_outside_arm;

/// No controller keeps a steady-state error above this, rad or m.
const MIN_OFFSET: f64 = 0.35;

/// Reversed, scaled or displaced joint.
pub struct MappedJoint<'a> {
    /// Column.
    pub joint: usize,
    pub name: &'a str,
    /// From its command to its state.
    pub map: &'a JointMap,
    pub unit: Unit,
    /// Whether the unit is inferred only from the size of the positions, which were read as degrees.
    pub is_unit_undetermined: bool,
}

impl<'a> MappedJoint<'a> {
    /// `None` if the map may be of a controller that yields to loads, or of a gripper, whose command and state often have
    /// different scales.
    pub fn new(
        delay: &'a CommandDelay,
        joint: impl Fn(usize) -> Option<(&'a str, Unit)>,
        is_unit_undetermined: bool,
    ) -> Option<Self> {
        let (column, map) = (delay.joint?, delay.map.as_ref()?);
        let (name, unit) = joint(column).filter(|(name, _)| !is_outside_arm(name))?;
        let mapped = Self { joint: column, name, map, unit, is_unit_undetermined };
        let is_mapped = mapped.is_scaled() || mapped.is_reversed() || mapped.is_displaced();
        is_mapped.then_some(mapped)
    }

    fn is_reversed(&self) -> bool {
        self.map.gain.value < 0.0
    }

    fn is_scaled(&self) -> bool {
        /// A compliant controller loses a smaller share of the motion.
        const MAX_GAIN_DEVIATION: f64 = 0.2;
        (self.map.gain.value.abs() - 1.0).abs() > MAX_GAIN_DEVIATION
    }

    fn is_displaced(&self) -> bool {
        let offset = self.map.offset;
        offset.value.abs() > MIN_OFFSET.max(self.unit.half_width(&offset, 0.999))
    }

    /// Whether the map is that of a joint zero, `q_true = q_reported + zero`, in the state.
    pub fn is_zero(&self, zero: &Measured) -> bool {
        let is_offset = !self.is_reversed() && !self.is_scaled();
        is_offset && (self.map.offset.value + zero.value).abs() < MIN_OFFSET
    }

    /// Quarter turns in the offset; 0 if it is no multiple of them.
    fn quarter_turns(&self) -> i64 {
        /// By which zeros are set wrong in addition.
        const TOLERANCE_RAD: f64 = 5.0 * PI / 180.0;
        let turns = (self.map.offset.value / FRAC_PI_2).round();
        let is_multiple = (self.map.offset.value - turns * FRAC_PI_2).abs() < TOLERANCE_RAD;
        if self.unit == Unit::Radian && is_multiple { turns as i64 } else { 0 }
    }

    /// Whether the joint is in the same place, whole turns away.
    pub fn is_whole_turns(&self) -> bool {
        let turns = self.quarter_turns();
        !self.is_scaled() && !self.is_reversed() && turns != 0 && turns % 4 == 0
    }

    /// `rests` show whether the offset is the same at all of them.
    pub fn describe(&self, rests: &[RestError]) -> String {
        let mut clauses = Vec::new();
        if self.is_reversed() {
            clauses.push("moves the other way".to_owned());
        }
        if self.is_scaled() {
            let gain = Unit::One.show_measured(&self.map.gain.abs());
            clauses.push(match self.is_reversed() {
                true => format!("{gain} times as far"),
                false => format!("moves {gain} times as far as commanded"),
            });
        }
        if self.is_displaced() {
            let place = match () {
                () if self.is_reversed() || self.is_scaled() => " at a command of zero",
                () if self.is_equal_at(rests) => " at every rest",
                () => "",
            };
            clauses.push(format!("is off by {}{place}", self.offset_shown()));
        }
        format!("{} {}", self.name, clauses.join(" and "))
    }

    fn offset_shown(&self) -> String {
        let offset = &self.map.offset;
        let turns = self.quarter_turns();
        let turns_shown = match turns.abs() {
            0 => None,
            1 => Some("a quarter turn".to_owned()),
            2 => Some("half a turn".to_owned()),
            4 => Some("a whole turn".to_owned()),
            quarters => Some(format!("{} turns", quarters as f64 / 4.0)),
        };
        if self.is_unit_undetermined {
            let in_degrees = turns_shown
                .map_or(String::new(), |turns| format!(" ({turns}, if they are degrees)"));
            let logged = offset.value.to_degrees();
            return format!("{logged:+.2} in logged units{in_degrees}");
        }
        let turns_shown = turns_shown.map_or(String::new(), |turns| format!(" ({turns})"));
        format!("{}{turns_shown}", self.unit.show_signed(offset))
    }

    fn is_equal_at(&self, rests: &[RestError]) -> bool {
        /// Of the offset.
        const MAX_DEVIATION: f64 = 0.05;
        let offset = self.map.offset.value;
        let errors = rests.iter().flat_map(|rest| &rest.joints);
        let mut own = errors.filter(|(joint, _)| *joint == self.joint).peekable();
        own.peek().is_some()
            && own.all(|(_, error)| (error.value - offset).abs() <= MAX_DEVIATION * offset.abs())
    }

    fn fix(&self) -> Vec<&'static str> {
        let mut fixes = Vec::new();
        if self.is_reversed() {
            fixes.push("reverse its direction");
        }
        if self.is_scaled() {
            fixes.push("correct its gear ratio or encoder resolution");
        }
        if self.is_whole_turns() {
            fixes.push("re-home it, because its encoder counts another turn");
        } else if self.is_displaced() {
            fixes.push("set its zero again");
        }
        fixes
    }

    /// For the report.
    pub fn json(&self) -> Value {
        json!({
            "joint": self.name,
            "gain": self.map.gain.value,
            "gain_ci95": Unit::One.interval95(&self.map.gain),
            "offset": self.map.offset.value,
            "offset_ci95": self.unit.interval95(&self.map.offset),
            "unit": self.unit.symbol(),
        })
    }
}

/// One clause per joint.
pub fn describe(mapped: &[MappedJoint<'_>], rests: &[RestError]) -> String {
    let clauses: Vec<String> = mapped.iter().map(|joint| joint.describe(rests)).collect();
    clauses.join(", ")
}

/// What to correct in the commands of `topic` or in the joint states.
pub fn fix(mapped: &[MappedJoint<'_>], topic: &str) -> String {
    let mut fixes: Vec<(Vec<&str>, Vec<&str>)> = Vec::new();
    for joint in mapped {
        let fix = joint.fix();
        match fixes.iter_mut().find(|(other, _)| *other == fix) {
            Some((_, names)) => names.push(joint.name),
            None => fixes.push((fix, vec![joint.name])),
        }
    }
    let fixes =
        fixes.iter().map(|(fix, names)| format!("{}: {}", names.join(", "), fix.join(" and ")));
    format!(
        "{}, in the commands ({topic}, the leader) or in the joint states (the follower)",
        fixes.collect::<Vec<_>>().join("; ")
    )
}
