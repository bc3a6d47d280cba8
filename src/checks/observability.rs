//! Which causes a log's motion does not observe, and which motion would.

use std::collections::HashMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::checks::{Case, find, residual_attribution};
use crate::diagnosis::{Observability, StreamParameter, WeakDirection};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{CheckRow, Status, Subject, Unit, deserialize_number};

/// A cause is observable if its rule's first threshold changes the log by this many standard deviations.
/// The half-width of its 95 % interval is then within the threshold.
const MIN_EFFECT_SIGMAS: f64 = 2.0;
/// Motion below which a joint's zero offset is barely observable, rad and m.
const MIN_TRAVEL_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
const MIN_TRAVEL_M: f64 = 0.1;

/// Reports a joint that moved too little to observe its zero offset (`moved` in rad or m).
pub(crate) fn unobservable_zero(
    joint: &str,
    unit: Unit,
    moved: f64,
    checks: &[CheckRow],
) -> Option<String> {
    let far = if unit == Unit::Metre { MIN_TRAVEL_M } else { MIN_TRAVEL_RAD };
    let is_open = |row: &CheckRow| {
        row.code == "ZER001"
            && row.status == Status::Inconclusive
            && row.subject.joint.as_deref() == Some(joint)
    };
    let is_unobservable = moved < far && checks.iter().any(is_open);
    is_unobservable
        .then(|| format!("{joint} moved only {}: its zero is not observable", unit.show(moved)))
}

/// Causes that one pose stream does not observe.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct StreamObservability {
    /// Name of the robot.
    pub robot: String,
    /// Topic of the stream.
    pub topic: String,
    /// Weakly observable directions in the space of the model's parameters; empty if the log shows all that
    /// any log can.
    pub directions: Vec<UnobservableDirection>,
    /// Directions that make a check inconclusive and combine several causes, which no single check reports.
    #[serde(skip)]
    pub combined: Vec<UnobservableDirection>,
}

/// Causes that this log cannot observe or separate.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Blind")]
pub struct UnobservableDirection {
    /// The causes involved, by decreasing weight.
    pub parameters: Vec<DirectionComponent>,
    /// Change of the log, in standard deviations of noise, if each cause has its weight times its rule's
    /// first threshold (divided by the norm of the weights).
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub singular_value: f64,
    /// Motion that would observe them.
    pub motion: String,
}

/// Contribution of one cause to a direction.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Part")]
pub struct DirectionComponent {
    /// Name of the cause.
    pub name: String,
    /// Weight, in units of the first threshold of its rule.
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub weight: f64,
    #[serde(skip)]
    cause: String,
    #[serde(skip)]
    code: &'static str,
    #[serde(skip)]
    joint: Option<String>,
}

impl UnobservableDirection {
    /// Causes and motion in one sentence.
    pub fn sentence(&self, topic: &str) -> String {
        let (causes, motion) = (self.causes(), &self.motion);
        match self.components_by_cause().len() {
            0 | 1 => format!("{causes} not observable in {topic}; {motion}"),
            _ => format!("this motion cannot separate {causes} in {topic}; {motion}"),
        }
    }

    /// `zeros of a and b, reference frame and tool frame`.
    fn causes(&self) -> String {
        let parts = self.components_by_cause();
        let joints: Vec<&str> = parts.iter().filter_map(|part| part.joint.as_deref()).collect();
        let zeros = match joints.len() {
            0 => None,
            1 => Some(format!("zero of {}", joints[0])),
            _ => Some(format!("zeros of {}", join_with_and(&joints))),
        };
        let others = parts.iter().filter(|part| part.joint.is_none());
        let mut others: Vec<&str> = others.map(|part| part.cause.as_str()).collect();
        others.sort_unstable();
        join_with_and(&zeros.as_deref().into_iter().chain(others).collect::<Vec<&str>>())
    }

    /// First component of each cause.
    fn components_by_cause(&self) -> Vec<&DirectionComponent> {
        let mut causes: Vec<&DirectionComponent> = Vec::new();
        for part in &self.parameters {
            if !causes.iter().any(|known| known.cause == part.cause) {
                causes.push(part);
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

fn join_with_and(items: &[&str]) -> String {
    match items {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}

/// Finds the unobservable directions of each pose stream and adds them to the checks that they block.
pub(super) fn observability(case: &Case, checks: &mut [CheckRow]) -> Vec<StreamObservability> {
    let mut streams = Vec::new();
    // A log may have thousands of streams.
    let mut rows_of: HashMap<Option<String>, Vec<usize>> = HashMap::new();
    let mut residuals: HashMap<Subject, bool> = HashMap::new();
    for (index, row) in checks.iter().enumerate() {
        rows_of.entry(row.subject.topic.clone()).or_default().push(index);
        if row.code == "MDL001" {
            *residuals.entry(row.subject.clone()).or_insert(true) &= row.status == Status::Pass;
        }
    }
    let rows_without_topic = rows_of.remove(&None).unwrap_or_default();
    for arm in &case.evidence.robots {
        let is_model_doubtful = residual_attribution::model_doubt(arm, 0.0).is_some();
        for stream in &arm.poses {
            let Some(observability) = &stream.diagnosis.observability else { continue };
            let is_noise = residuals.get(&stream.subject).copied().unwrap_or(true);
            let found = observability
                .weak_directions(|parameter| threshold(case, arm, parameter), MIN_EFFECT_SIGMAS);
            let directions: Vec<UnobservableDirection> = found
                .iter()
                .map(|one| unobservable_direction(arm, observability, one, is_noise))
                .collect();
            let mut leaves_open = vec![false; directions.len()];
            let of_topic = rows_of.get(&stream.subject.topic).into_iter().flatten();
            for &row in rows_without_topic.iter().chain(of_topic) {
                let row = &mut checks[row];
                if !is_resolvable_by_motion(row, arm, stream, is_model_doubtful) {
                    continue;
                }
                let concerned: Vec<usize> = (0..directions.len())
                    .filter(|&one| directions[one].concerns(row.code, &row.subject))
                    .collect();
                if concerned.is_empty() {
                    continue;
                }
                let list: Vec<Value> =
                    concerned.iter().map(|&one| json!(directions[one])).collect();
                concerned.into_iter().for_each(|one| leaves_open[one] = true);
                row.evidence.insert("blind".to_owned(), list.into());
            }
            let open = found.iter().zip(leaves_open).filter(|(_, open)| *open).map(|(one, _)| one);
            let groups = merge_by_cause(open.cloned().collect());
            streams.push(StreamObservability {
                robot: arm.name.clone(),
                topic: stream.topic().to_owned(),
                // A single cause is reported by its own check.
                combined: groups
                    .iter()
                    .map(|group| unobservable_direction(arm, observability, group, is_noise))
                    .filter(|group| group.components_by_cause().len() > 1)
                    .collect(),
                directions,
            });
        }
    }
    streams
}

/// Motion does not resolve a nominal or wrong model.
fn is_resolvable_by_motion(
    row: &CheckRow,
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    is_model_doubtful: bool,
) -> bool {
    let Subject { robot, topic, .. } = &row.subject;
    row.status == Status::Inconclusive
        && !row.is_indistinguishable
        && robot.as_ref() == Some(&arm.name)
        && topic.as_ref().is_none_or(|topic| topic == stream.topic())
        && (row.code.starts_with("LAT") || !stream.diagnosis.is_nominal && !is_model_doubtful)
}

/// Merges directions that share a cause; only combinations of causes are observable.
fn merge_by_cause(directions: Vec<WeakDirection>) -> Vec<WeakDirection> {
    let mut groups: Vec<WeakDirection> = Vec::new();
    for direction in directions {
        let shares = |group: &WeakDirection| {
            let of =
                |one: &WeakDirection| one.parameters.iter().map(|(p, _)| cause_of(*p)).collect();
            let (a, b): (Vec<_>, Vec<_>) = (of(group), of(&direction));
            a.iter().any(|cause| b.contains(cause))
        };
        let (mut same, other): (Vec<_>, Vec<_>) = groups.into_iter().partition(shares);
        same.push(direction);
        let singular_value =
            same.iter().map(|one| one.singular_value).fold(f64::INFINITY, f64::min);
        let mut parameters: Vec<(StreamParameter, f64)> = Vec::new();
        for (parameter, weight) in same.into_iter().flat_map(|one| one.parameters) {
            if !parameters.iter().any(|(known, _)| *known == parameter) {
                parameters.push((parameter, weight));
            }
        }
        parameters.sort_by_key(|(parameter, _)| match parameter {
            StreamParameter::JointZero(joint) => *joint,
            _ => usize::MAX,
        });
        groups = other;
        groups.push(WeakDirection { parameters, singular_value });
    }
    groups
}

/// Maps the axes of a frame to one parameter.
fn cause_of(parameter: StreamParameter) -> StreamParameter {
    match parameter {
        StreamParameter::ReferenceShift(_) | StreamParameter::ReferenceTurn(_) => {
            StreamParameter::ReferenceShift(0)
        }
        StreamParameter::ToolShift(_) | StreamParameter::ToolTurn(_) => {
            StreamParameter::ToolShift(0)
        }
        other => other,
    }
}

fn threshold(case: &Case, arm: &ArmEvidence, parameter: StreamParameter) -> f64 {
    let (code, unit) = match parameter {
        StreamParameter::JointZero(joint) => ("ZER001", arm.joint_unit(joint)),
        StreamParameter::Latency => ("LAT001", Unit::Second),
        StreamParameter::Skew => ("LAT002", Unit::SecondPerSecond),
        StreamParameter::RadialScale => ("ZER002", Unit::MetrePerMetre),
        StreamParameter::ReferenceShift(_) => ("FRM002", Unit::Metre),
        StreamParameter::ReferenceTurn(_) => ("FRM002", Unit::Radian),
        StreamParameter::ToolShift(_) => ("FRM003", Unit::Metre),
        StreamParameter::ToolTurn(_) => ("FRM003", Unit::Radian),
    };
    let Ok(rule) = find(code) else { return 1.0 };
    let own = rule.grade.thresholds().iter().find(|threshold| threshold.unit == unit);
    own.map_or(1.0, |own| case.thresholds.threshold(rule, *own).warning)
}

fn unobservable_direction(
    arm: &ArmEvidence,
    observability: &Observability,
    direction: &WeakDirection,
    is_noise: bool,
) -> UnobservableDirection {
    let parameters = direction.parameters.iter();
    UnobservableDirection {
        parameters: parameters
            .map(|&(parameter, weight)| direction_component(arm, parameter, weight))
            .collect(),
        singular_value: direction.singular_value,
        motion: motion(arm, observability, direction, is_noise),
    }
}

fn direction_component(
    arm: &ArmEvidence,
    parameter: StreamParameter,
    weight: f64,
) -> DirectionComponent {
    let along = |what: &str, axis: usize| format!(" {what} {}", ["x", "y", "z"][axis % 3]);
    let (cause, axis, code) = match parameter {
        StreamParameter::JointZero(joint) => {
            let name = arm.joints.get(joint).map(|joint| joint.name.clone());
            let cause = format!("zero of {}", name.as_deref().unwrap_or("a joint"));
            return DirectionComponent {
                name: cause.clone(),
                weight,
                cause,
                code: "ZER001",
                joint: name,
            };
        }
        StreamParameter::Latency => ("latency", String::new(), "LAT001"),
        StreamParameter::Skew => ("clock skew", String::new(), "LAT002"),
        StreamParameter::RadialScale => ("growth with reach", String::new(), "ZER002"),
        StreamParameter::ReferenceShift(axis) => {
            ("reference frame", along("along", axis), "FRM002")
        }
        StreamParameter::ReferenceTurn(axis) => ("reference frame", along("about", axis), "FRM002"),
        StreamParameter::ToolShift(axis) => ("tool frame", along("along", axis), "FRM003"),
        StreamParameter::ToolTurn(axis) => ("tool frame", along("about", axis), "FRM003"),
    };
    DirectionComponent {
        name: format!("{cause}{axis}"),
        weight,
        cause: cause.to_owned(),
        code,
        joint: None,
    }
}

/// `is_noise`: the residual of the poses is noise.
fn motion(
    arm: &ArmEvidence,
    observability: &Observability,
    direction: &WeakDirection,
    is_noise: bool,
) -> String {
    let is_timing = |one: &(StreamParameter, f64)| {
        matches!(one.0, StreamParameter::Latency | StreamParameter::Skew)
    };
    let is_at_rest = |joint: usize| {
        let far = if arm.joint_unit(joint) == Unit::Metre { MIN_TRAVEL_M } else { MIN_TRAVEL_RAD };
        observability.travel.get(joint).is_some_and(|&travel| travel < far)
    };
    let still: Vec<usize> = observability.joints().filter(|&joint| is_at_rest(joint)).collect();
    if still.len() == observability.joints().count() && !arm.is_trajectory {
        return "move every joint by more than 30°, faster than 0.2 rad/s".to_owned();
    }
    if direction.parameters.iter().all(is_timing) {
        let skew = direction.parameters.iter().any(|one| one.0 == StreamParameter::Skew);
        return match skew {
            true => "record at least a minute, with the arm moving from start to end".to_owned(),
            false => "move the arm faster than 0.2 rad/s".to_owned(),
        };
    }
    let is_involved = |&joint: &usize| {
        direction.parameters.iter().any(|one| one.0 == StreamParameter::JointZero(joint))
    };
    let own: Vec<usize> = still.iter().copied().filter(is_involved).collect();
    let joints = if own.is_empty() { still } else { own };
    if joints.is_empty() {
        let what = if is_noise { "its noise" } else { "its residual" };
        return format!("record longer and in more configurations: {what} hides this");
    }
    let slides = joints.iter().any(|&joint| arm.joint_unit(joint) == Unit::Metre);
    let names: Vec<&str> = joints.iter().map(|&joint| arm.joints[joint].name.as_str()).collect();
    let far = if slides { "30° (100 mm if prismatic)" } else { "30°" };
    match names.as_slice() {
        [name] => format!(
            "move {name} by more than {far}, with the other joints in two different \
            configurations"
        ),
        names => {
            format!("move {} by more than {far} each, at different times", join_with_and(names))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::clean_run;

    fn direction(parameters: &[StreamParameter]) -> WeakDirection {
        let parameters = parameters.iter().map(|&parameter| (parameter, 1.0)).collect();
        WeakDirection { parameters, singular_value: 0.1 }
    }

    fn sentence(travel: [f64; 3], parameters: &[StreamParameter]) -> String {
        let run = clean_run();
        let observability = Observability::from_travel(travel.to_vec());
        unobservable_direction(&run.robots[0], &observability, &direction(parameters), true)
            .sentence("/pose")
    }

    #[test]
    fn a_joint_at_rest_is_recommended_to_move() {
        assert_eq!(
            sentence([1.0, 0.01, 1.0], &[StreamParameter::JointZero(1)]),
            "zero of lift not observable in /pose; move lift by more than 30°, with the other joints in two \
             different configurations"
        );
        let two = [StreamParameter::JointZero(0), StreamParameter::JointZero(1)];
        assert_eq!(
            sentence([0.02, 0.01, 1.0], &two),
            "this motion cannot separate zeros of pan and lift in /pose; move pan and lift by more than 30° each, at different times"
        );
    }

    #[test]
    fn axes_of_one_frame_are_one_parameter() {
        let parameters = [
            StreamParameter::ToolTurn(0),
            StreamParameter::ToolShift(2),
            StreamParameter::JointZero(2),
        ];
        let said = sentence([1.0; 3], &parameters);
        assert!(
            said.starts_with("this motion cannot separate zero of elbow and tool frame in /pose"),
            "{said}"
        );
    }

    #[test]
    fn a_resting_run_needs_motion_and_a_short_run_needs_length() {
        assert!(sentence([0.0; 3], &[StreamParameter::Latency]).contains("move every joint"));
        let said = sentence([1.0; 3], &[StreamParameter::Skew]);
        assert!(said.ends_with("at least a minute, with the arm moving from start to end"));
    }

    #[test]
    fn directions_that_share_a_cause_are_merged() {
        use StreamParameter::{JointZero, RadialScale, ToolShift, ToolTurn};
        let groups = merge_by_cause(vec![
            direction(&[JointZero(0), ToolTurn(1)]),
            direction(&[JointZero(1), JointZero(2)]),
            direction(&[ToolShift(0), RadialScale]),
        ]);
        let said: Vec<usize> = groups.iter().map(|group| group.parameters.len()).collect();
        assert_eq!(said, [2, 4]);
    }
}
