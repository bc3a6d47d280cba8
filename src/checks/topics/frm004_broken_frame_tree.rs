use serde_json::{Value, json};

use crate::checks::{Case, Grade, SubjectResult};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::run::{PoseDistance, TfProblem, TfProblemKind};

rule! {
    /// The TF frames do not form a tree.
    ///
    /// ## What it means
    ///
    /// - A frame has two parents, or frames form a cycle.
    /// - A transform on /tf_static is published with different values.
    /// - Two nodes publish different values for one transform, or on one topic of poses or joint states.
    /// - No transforms connect a frame that an audited stream needs to the arm's base.
    ///
    /// ## Why it matters
    /// With two parents or publishers, tf2 lookups alternate between two answers without an error, because
    /// the latest message counts. With a cycle or a disconnected tree, they fail. A static transform is
    /// cached forever by whoever received it first.
    ///
    /// ## Evidence
    /// - `what`: `several-parents`, `cycle`, `static-moves`, `conflict`, `publishers` or `pieces`.
    /// - `frames`, `topics`: those involved.
    /// - `length_m`, `angle_rad`: difference of the values. The estimate is the length, otherwise the
    ///   angle.
    /// - For a conflict, `jumps` of `samples` differ from their neighbours.
    /// - For `publishers`, distinguished by their rates: `rates_hz` and `samples` of each. The other rules
    ///   use the publisher with more samples.
    ///
    /// ## How to fix
    /// Let one node publish each transform, and give each frame one parent: invert a transform, or rename
    /// the second publisher's frame. Publish moving frames on /tf. For disconnected frames, publish the
    /// transform between the roots.
    ///
    /// ## When it misleads
    /// - An object that is picked up and put down may change its parent: not counted.
    /// - Two publishers with equal values are `info`.
    /// - An encoder that flickers by a few ticks is no second publisher, and neither are irregular stamps.
    /// - A static transform recalibrated during the run did change.
    /// - A tracker's world frame needs no transform to the base: it is estimated.
    /// - Topics in different namespaces (`/left/tf`, `/right/tf`) are separate trees.
    FRM004 {
        name: "broken-frame-tree",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: false,
        missing: "no /tf or /tf_static in this log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let frames = &case.evidence.tf;
    let is_sound =
        |topic: &&String| !frames.problems.iter().any(|problem| problem.topics.contains(topic));
    let sound = frames.topics.iter().filter(is_sound).map(|topic| {
        let subject = Subject { topic: Some(topic.clone()), ..Subject::default() };
        SubjectResult::new(subject, Outcome::pass())
    });
    sound.chain(frames.problems.iter().map(judge)).collect()
}

fn judge(problem: &TfProblem) -> SubjectResult {
    let report = TfProblemReport::from_problem(problem);
    let subject = Subject {
        topic: problem.topics.first().cloned(),
        frame: report.frames.first().cloned(),
        ..Subject::default()
    };
    let fault = Fault {
        cause: Cause::FrameTree,
        severity: report.severity,
        title: report.title,
        message: report.message,
        evidence: Evidence::default(),
        fix: report.fix,
    };
    let mut judged = SubjectResult::new(subject, Outcome::fail(fault))
        .with_evidence("what", report.what)
        .with_evidence("frames", report.frames)
        .with_evidence("topics", problem.topics.clone());
    for (key, value) in report.numbers {
        judged = judged.with_evidence(key, value);
    }
    // A pure rotation is measured by its angle.
    let moved = report.by.map(|by| match by.length_m < 1e-6 && by.angle_rad > 0.0 {
        true => Estimate::exact("difference", "rad", by.angle_rad),
        false => Estimate::exact("difference", "m", by.length_m),
    });
    judged.estimated(moved)
}

struct TfProblemReport {
    severity: Severity,
    what: &'static str,
    title: &'static str,
    /// The affected frame first.
    frames: Vec<String>,
    by: Option<PoseDistance>,
    numbers: Vec<(&'static str, Value)>,
    message: String,
    fix: String,
}

impl TfProblemReport {
    fn from_problem(problem: &TfProblem) -> Self {
        let on = problem.topics.join(" and ");
        match &problem.kind {
            TfProblemKind::SeveralParents { child, parents } => Self {
                severity: Severity::Error,
                what: "several-parents",
                title: "a frame has several parents",
                frames: std::iter::once(child).chain(parents).cloned().collect(),
                by: None,
                numbers: Vec::new(),
                message: format!(
                    "frame '{child}' has two parents: '{}', on {on}",
                    parents.join("' and '")
                ),
                fix: format!(
                    "keep one of these transforms of '{child}'; invert or remove the others"
                ),
            },
            TfProblemKind::Cycle { frames } => Self {
                severity: Severity::Error,
                what: "cycle",
                title: "frames form a cycle",
                frames: frames.clone(),
                by: None,
                numbers: Vec::new(),
                message: match frames.as_slice() {
                    [only] => format!("frame '{only}' is its own parent, on {on}"),
                    several => {
                        format!("'{}' are each other's parents, on {on}", several.join("', '"))
                    }
                },
                fix: "invert or remove one of these transforms".to_owned(),
            },
            TfProblemKind::StaticMoves { edge, by } => Self {
                severity: Severity::Error,
                what: "static-moves",
                title: "a static frame moves",
                frames: vec![edge.child.clone(), edge.parent.clone()],
                by: Some(*by),
                numbers: distance_json(by).to_vec(),
                message: format!(
                    "static transform '{}' to '{}' on {on} has values that differ by {}",
                    edge.parent,
                    edge.child,
                    show_distance(by)
                ),
                fix: format!("publish '{}' on /tf, or only once", edge.child),
            },
            TfProblemKind::Conflict { edge, by, jumps, rows } => Self {
                severity: Severity::Error,
                what: "conflict",
                title: "two publishers of one transform",
                frames: vec![edge.child.clone(), edge.parent.clone()],
                by: Some(*by),
                numbers: [
                    &distance_json(by)[..],
                    &[("jumps", json!(jumps)), ("samples", json!(rows))],
                ]
                .concat(),
                message: format!(
                    "'{}' to '{}' on {on} jumps between values that differ by {}",
                    edge.parent,
                    edge.child,
                    show_distance(by)
                ),
                fix: format!("find the two nodes that publish '{}', and stop one", edge.child),
            },
            TfProblemKind::Publishers { edge, edges, by, rates_hz, rows, are_joints } => {
                let what = match (edge, edges) {
                    (Some(edge), 0 | 1) => format!("'{}' to '{}' on {on}", edge.parent, edge.child),
                    (Some(edge), edges) => format!(
                        "{edges} transforms on {on} (worst: '{}' to '{}')",
                        edge.parent, edge.child
                    ),
                    (None, _) => on.clone(),
                };
                let [a, b] = rates_hz.map(|rate_hz| format!("{rate_hz:.1} Hz"));
                let amount = |by: &PoseDistance| match are_joints {
                    true => format!("{} in a joint", Unit::Radian.show(by.angle_rad)),
                    false => show_distance(by),
                };
                let message = match by {
                    Some(by) => format!(
                        "two publishers of {what}, at {a} and {b}, differ by {}",
                        amount(by)
                    ),
                    None => {
                        format!("two publishers, at {a} and {b}, send the same values")
                    }
                };
                let frames = edge.iter().flat_map(|edge| [edge.child.clone(), edge.parent.clone()]);
                let severity = if by.is_some() { Severity::Error } else { Severity::Info };
                let mut evidence = by.as_ref().map_or(Vec::new(), |by| distance_json(by).to_vec());
                evidence.extend([("rates_hz", json!(rates_hz)), ("samples", json!(rows))]);
                Self {
                    severity,
                    what: "publishers",
                    title: match by {
                        Some(_) => "two publishers disagree",
                        None => "two publishers send the same",
                    },
                    frames: frames.collect(),
                    by: *by,
                    numbers: evidence,
                    message,
                    fix: format!("find the two nodes that publish {on}, and stop one"),
                }
            }
            TfProblemKind::Disconnected { needed_by, frame, base } => Self {
                severity: Severity::Error,
                what: "pieces",
                title: "the frame tree is disconnected",
                frames: vec![frame.clone(), base.clone()],
                by: None,
                numbers: vec![("needed_by", json!(needed_by))],
                message: format!(
                    "no transforms connect '{frame}', needed by {needed_by}, to '{base}'"
                ),
                fix: format!("publish the transform between '{frame}' and '{base}'"),
            },
        }
    }
}

fn distance_json(by: &PoseDistance) -> [(&'static str, Value); 2] {
    [("length_m", json!(by.length_m)), ("angle_rad", json!(by.angle_rad))]
}

fn show_distance(by: &PoseDistance) -> String {
    format!("{} and {}", Unit::Metre.show(by.length_m), Unit::Radian.show(by.angle_rad))
}
