//! What the motion of a log cannot show, in words: which causes, and the motion that would show
//! them.

use serde::Serialize;
use serde_json::{Value, json};

use crate::checks::{ArmFacts, Facts, Grade, find};
use crate::diagnosis::{BlindDirection, Observability, Parameter};
use crate::finding::{CheckRow, Status, Subject, Unit};

/// A cause of the size of its rule's first figure is seen where it moves the log by this many
/// standard deviations or more: then the half-width of its 95 % interval is within the figure.
const SEEN: f64 = 2.0;
/// A joint that turns or slides by less hardly shows its zero, rad and m.
const FAR_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
const FAR_M: f64 = 0.1;

/// What one pose stream cannot show.
#[derive(Clone, Debug, Serialize)]
pub struct StreamObservability {
    /// Name of the robot.
    pub robot: String,
    /// Topic of the stream.
    pub topic: String,
    /// The changes of the model's parameters that this log hardly shows; none where it shows all
    /// that any log can.
    pub directions: Vec<Blind>,
}

/// Causes that this log does not show, or does not tell apart.
#[derive(Clone, Debug, Serialize)]
pub struct Blind {
    /// The causes that take part, the greatest weight first.
    pub parameters: Vec<Part>,
    /// By how many standard deviations of noise the log moves where each cause is of its weight
    /// times its rule's first figure (over the norm of the weights).
    pub singular_value: f64,
    /// The motion that would show them.
    pub motion: String,
    /// Whether a check of one of these causes could not decide.
    #[serde(skip)]
    pub left_open: bool,
}

/// One cause's part in a direction.
#[derive(Clone, Debug, Serialize)]
pub struct Part {
    /// The cause.
    pub name: String,
    /// Its weight, in units of its rule's first figure.
    pub weight: f64,
    /// The cause without its axis.
    #[serde(skip)]
    cause: String,
    /// The rule that judges it.
    #[serde(skip)]
    code: &'static str,
    /// The joint, where it is one's.
    #[serde(skip)]
    joint: Option<String>,
}

impl Blind {
    /// The causes and the motion, as one sentence.
    pub fn sentence(&self) -> String {
        let causes = self.causes();
        let blind = if causes.len() > 1 { "are not told apart" } else { "is not seen" };
        format!("{} {blind}; {}", listed(&causes), self.motion)
    }

    /// The causes that take part, without their axes, each once.
    pub fn causes(&self) -> Vec<&str> {
        let mut causes: Vec<&str> = Vec::new();
        for part in &self.parameters {
            if !causes.contains(&part.cause.as_str()) {
                causes.push(&part.cause);
            }
        }
        causes
    }

    fn concerns(&self, code: &str, subject: &Subject) -> bool {
        self.parameters
            .iter()
            .any(|part| part.code == code && (part.joint.is_none() || part.joint == subject.joint))
    }
}

/// `a, b and c`.
pub fn listed(items: &[&str]) -> String {
    match items {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

/// What each pose stream cannot show. The checks that it leaves open get it as evidence.
pub(super) fn observability(facts: &Facts, checks: &mut [CheckRow]) -> Vec<StreamObservability> {
    let mut streams = Vec::new();
    for arm in &facts.robots {
        for (stream, diagnosis) in arm.poses() {
            let Some(seen) = &diagnosis.observability else { continue };
            let mut directions: Vec<Blind> = seen
                .blind(|parameter| figure(arm, parameter), SEEN)
                .into_iter()
                .map(|direction| blind(arm, seen, direction))
                .collect();
            let is_meant = |row: &&mut CheckRow| {
                let Subject { robot, topic, .. } = &row.subject;
                row.status == Status::Inconclusive
                    && !row.indistinguishable
                    && robot.as_ref() == Some(&arm.name)
                    && topic.as_ref().is_none_or(|topic| *topic == stream.topic)
            };
            for row in checks.iter_mut().filter(is_meant) {
                let concerned: Vec<&mut Blind> = directions
                    .iter_mut()
                    .filter(|direction| direction.concerns(row.code, &row.subject))
                    .collect();
                if concerned.is_empty() {
                    continue;
                }
                let list: Vec<Value> = concerned.iter().map(|one| json!(one)).collect();
                concerned.into_iter().for_each(|one| one.left_open = true);
                row.evidence.insert("blind".to_owned(), list.into());
            }
            streams.push(StreamObservability {
                robot: arm.name.clone(),
                topic: stream.topic.clone(),
                directions,
            });
        }
    }
    streams
}

/// The first figure of the rule that judges a parameter.
fn figure(arm: &ArmFacts, parameter: Parameter) -> f64 {
    let (code, unit) = match parameter {
        Parameter::JointZero(joint) => ("ZER001", arm.joint_unit(joint)),
        Parameter::Latency => ("LAT001", Unit::Second),
        Parameter::Skew => ("LAT002", Unit::SecondPerSecond),
        Parameter::Growth => ("ZER002", Unit::MetrePerMetre),
        Parameter::ReferenceShift(_) => ("FRM002", Unit::Metre),
        Parameter::ReferenceTurn(_) => ("FRM002", Unit::Radian),
        Parameter::ToolShift(_) => ("FRM003", Unit::Metre),
        Parameter::ToolTurn(_) => ("FRM003", Unit::Radian),
    };
    let figures = match find(code).map(|rule| rule.grade) {
        Ok(Grade::From(figures)) => figures,
        _ => &[],
    };
    figures.iter().find(|figure| figure.unit == unit).map_or(1.0, |figure| figure.warning)
}

fn blind(arm: &ArmFacts, seen: &Observability, direction: BlindDirection) -> Blind {
    let motion = motion(arm, seen, &direction);
    let parameters = direction.parameters.into_iter();
    Blind {
        parameters: parameters.map(|(parameter, weight)| part(arm, parameter, weight)).collect(),
        singular_value: direction.singular_value,
        motion,
        left_open: false,
    }
}

fn part(arm: &ArmFacts, parameter: Parameter, weight: f64) -> Part {
    let along = |what: &str, axis: usize| format!(" {what} {}", ["x", "y", "z"][axis % 3]);
    let (cause, axis, code) = match parameter {
        Parameter::JointZero(joint) => {
            let name = arm.joints.get(joint).map(|joint| joint.name.clone());
            let cause = format!("zero of {}", name.as_deref().unwrap_or("a joint"));
            return Part { name: cause.clone(), weight, cause, code: "ZER001", joint: name };
        }
        Parameter::Latency => ("latency", String::new(), "LAT001"),
        Parameter::Skew => ("clock skew", String::new(), "LAT002"),
        Parameter::Growth => ("growth with reach", String::new(), "ZER002"),
        Parameter::ReferenceShift(axis) => ("reference frame", along("along", axis), "FRM002"),
        Parameter::ReferenceTurn(axis) => ("reference frame", along("about", axis), "FRM002"),
        Parameter::ToolShift(axis) => ("tool frame", along("along", axis), "FRM003"),
        Parameter::ToolTurn(axis) => ("tool frame", along("about", axis), "FRM003"),
    };
    Part { name: format!("{cause}{axis}"), weight, cause: cause.to_owned(), code, joint: None }
}

/// The motion that would show a direction.
fn motion(arm: &ArmFacts, seen: &Observability, direction: &BlindDirection) -> String {
    let is_timing = |one: &(Parameter, f64)| matches!(one.0, Parameter::Latency | Parameter::Skew);
    let stays = |joint: usize| {
        let far = if arm.joint_unit(joint) == Unit::Metre { FAR_M } else { FAR_RAD };
        seen.travel.get(joint).is_some_and(|&travel| travel < far)
    };
    let still: Vec<usize> = seen.joints().filter(|&joint| stays(joint)).collect();
    if still.len() == seen.joints().count() {
        return "move every joint by more than 30°, faster than 0.2 rad/s".to_owned();
    }
    if direction.parameters.iter().all(is_timing) {
        let skew = direction.parameters.iter().any(|one| one.0 == Parameter::Skew);
        return match skew {
            true => "record a minute or more in which the arm moves from first to last".to_owned(),
            false => "move with the arm faster than 0.2 rad/s".to_owned(),
        };
    }
    let takes_part = |&joint: &usize| {
        direction.parameters.iter().any(|one| one.0 == Parameter::JointZero(joint))
    };
    let own: Vec<usize> = still.iter().copied().filter(takes_part).collect();
    let (joints, poses) = match own.is_empty() {
        false => (own, ", with the other joints in two different poses"),
        true => (still, ""),
    };
    if joints.is_empty() {
        return "come to several places with the wrist turned through 60° about two axes"
            .to_owned();
    }
    let slides = joints.iter().any(|&joint| arm.joint_unit(joint) == Unit::Metre);
    let names: Vec<&str> = joints.iter().map(|&joint| arm.joints[joint].name.as_str()).collect();
    let far = if slides { "30° (100 mm where it slides)" } else { "30°" };
    format!("move {} by more than {far}{poses}", listed(&names))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::clean_run;

    fn direction(parameters: &[Parameter]) -> BlindDirection {
        let parameters = parameters.iter().map(|&parameter| (parameter, 1.0)).collect();
        BlindDirection { parameters, singular_value: 0.1 }
    }

    fn sentence(travel: [f64; 3], parameters: &[Parameter]) -> String {
        let facts = clean_run();
        let seen = Observability::of_travel(travel.to_vec());
        blind(&facts.robots[0], &seen, direction(parameters)).sentence()
    }

    #[test]
    fn a_joint_that_stays_is_asked_to_move() {
        assert_eq!(
            sentence([1.0, 0.01, 1.0], &[Parameter::JointZero(1)]),
            "zero of lift is not seen; move lift by more than 30°, with the other joints in two \
             different poses"
        );
    }

    #[test]
    fn axes_of_one_frame_are_one_cause() {
        let parameters = [Parameter::ToolTurn(0), Parameter::ToolShift(2), Parameter::JointZero(2)];
        let said = sentence([1.0; 3], &parameters);
        assert!(said.starts_with("tool frame and zero of elbow are not told apart;"), "{said}");
    }

    #[test]
    fn rest_asks_for_motion_and_a_short_run_for_length() {
        assert!(sentence([0.0; 3], &[Parameter::Latency]).contains("move every joint"));
        let said = sentence([1.0; 3], &[Parameter::Skew]);
        assert_eq!(
            said,
            "clock skew is not seen; record a minute or more in which the arm moves from first to \
             last"
        );
    }
}
