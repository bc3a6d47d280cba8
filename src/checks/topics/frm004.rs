use serde_json::{Value, json};

use crate::checks::{Case, Grade, Judged};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::run::{Apart, Flaw, FlawKind};

rule! {
    /// The frames of the log are no tree.
    ///
    /// ## What it means
    /// A frame hangs below two others at once, frames hang below each other in a ring, a transform
    /// of /tf_static is published with different values, two publishers give one transform or one topic
    /// of poses or joint states different values, or no transforms lead from a frame that an audited stream needs to the arm's base.
    ///
    /// ## Why it matters
    /// tf2 keeps whichever message came last: with two parents or two publishers a lookup gives one
    /// answer now and another a moment later, and neither is an error to its caller. A ring and a
    /// tree in pieces make lookups fail, and a static transform is cached for ever by whoever heard
    /// it first.
    ///
    /// ## Evidence
    /// `what` is `several-parents`, `cycle`, `static-moves`, `conflict` or `pieces`; `frames` the
    /// frames, `topics` the topics. Where values differ, `length_m` and `angle_rad` say by how much,
    /// and the estimate is the length, or the angle where there is no length. Of a conflict, `jumps` of
    /// `samples` are elsewhere than those beside them. `what` is `publishers` where two rhythms tell two
    /// publishers of a topic or a transform apart: `rates_hz` and `samples` are those of each. The other
    /// rules look at the one with more samples.
    ///
    /// ## How to fix
    /// Let one node publish each transform, and give each frame one parent: turn a transform round,
    /// or rename the frame of the second publisher. Publish what moves on /tf. For pieces, publish
    /// the transform that ties the two roots.
    ///
    /// ## When it misleads
    /// What is picked up and put down changes its parent now and then, which is no fault and not
    /// counted as one. Two publishers that say the same are told as `info`. A static transform that was calibrated anew during the run did move. Streams
    /// in the world of a tracker that no transform names need no tie: it is estimated. Topics in
    /// different namespaces (`/left/tf`, `/right/tf`) are trees of their own.
    FRM004 {
        name: "broken-frame-tree",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: false,
        missing: "no /tf or /tf_static in this log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let frames = &case.evidence.frames;
    let is_sound = |topic: &&String| !frames.flaws.iter().any(|flaw| flaw.topics.contains(topic));
    let sound = frames.topics.iter().filter(is_sound).map(|topic| {
        let subject = Subject { topic: Some(topic.clone()), ..Subject::default() };
        Judged::new(subject, Outcome::sound())
    });
    sound.chain(frames.flaws.iter().map(judge)).collect()
}

fn judge(flaw: &Flaw) -> Judged {
    let said = Said::of(flaw);
    let subject = Subject {
        topic: flaw.topics.first().cloned(),
        frame: said.frames.first().cloned(),
        ..Subject::default()
    };
    let fault = Fault {
        cause: Cause::Frames,
        severity: said.severity,
        title: said.title,
        message: said.message,
        evidence: Evidence::default(),
        fix: said.fix,
    };
    let mut judged = Judged::new(subject, Outcome::faulty(fault))
        .with_evidence("what", said.what)
        .with_evidence("frames", said.frames)
        .with_evidence("topics", flaw.topics.clone());
    for (key, value) in said.numbers {
        judged = judged.with_evidence(key, value);
    }
    // Of what turns only, by how much.
    let moved = said.by.map(|by| match by.length_m < 1e-6 && by.angle_rad > 0.0 {
        true => Estimate::counted("difference", "rad", by.angle_rad),
        false => Estimate::counted("difference", "m", by.length_m),
    });
    judged.estimated(moved)
}

/// A flaw in words.
struct Said {
    severity: Severity,
    what: &'static str,
    title: &'static str,
    /// The frames, that which is meant first.
    frames: Vec<String>,
    by: Option<Apart>,
    numbers: Vec<(&'static str, Value)>,
    message: String,
    fix: String,
}

impl Said {
    fn of(flaw: &Flaw) -> Self {
        let on = flaw.topics.join(" and ");
        match &flaw.kind {
            FlawKind::SeveralParents { child, parents } => Self {
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
                    "keep one of these transforms of '{child}'; publish the others inverted, or not at all"
                ),
            },
            FlawKind::Cycle { frames } => Self {
                severity: Severity::Error,
                what: "cycle",
                title: "frames form a ring",
                frames: frames.clone(),
                by: None,
                numbers: Vec::new(),
                message: match frames.as_slice() {
                    [only] => format!("frame '{only}' is its own parent, on {on}"),
                    several => {
                        format!("'{}' are each other's parents, on {on}", several.join("', '"))
                    }
                },
                fix: "publish one of these transforms the other way round, or not at all"
                    .to_owned(),
            },
            FlawKind::StaticMoves { edge, by } => Self {
                severity: Severity::Error,
                what: "static-moves",
                title: "a static frame moves",
                frames: vec![edge.child.clone(), edge.parent.clone()],
                by: Some(*by),
                numbers: numbers(by).to_vec(),
                message: format!(
                    "'{}' to '{}' on {on} is published with values that are {} apart",
                    edge.parent,
                    edge.child,
                    shown(by)
                ),
                fix: format!("publish '{}' on /tf, or once", edge.child),
            },
            FlawKind::Conflict { edge, by, jumps, rows } => Self {
                severity: Severity::Error,
                what: "conflict",
                title: "two publishers of one transform",
                frames: vec![edge.child.clone(), edge.parent.clone()],
                by: Some(*by),
                numbers: [&numbers(by)[..], &[("jumps", json!(jumps)), ("samples", json!(rows))]]
                    .concat(),
                message: format!(
                    "'{}' to '{}' on {on} jumps between values that are {} apart",
                    edge.parent,
                    edge.child,
                    shown(by)
                ),
                fix: format!("find the two nodes that publish '{}', and stop one", edge.child),
            },
            FlawKind::Publishers { edge, edges, by, rates_hz, rows, are_joints } => {
                let what = match (edge, edges) {
                    (Some(edge), 0 | 1) => format!("'{}' to '{}' on {on}", edge.parent, edge.child),
                    (Some(edge), edges) => format!(
                        "{edges} transforms on {on}, '{}' to '{}' above all,",
                        edge.parent, edge.child
                    ),
                    (None, _) => on.clone(),
                };
                let [a, b] = rates_hz.map(|rate_hz| format!("{rate_hz:.1} Hz"));
                let amount = |by: &Apart| match are_joints {
                    true => format!("{} in a joint", Unit::Radian.show(by.angle_rad)),
                    false => shown(by),
                };
                let message = match by {
                    Some(by) => format!(
                        "{what} is published twice, at {a} and at {b}, with values that are {} apart",
                        amount(by)
                    ),
                    None => {
                        format!("it is published twice, at {a} and at {b}, with the same values")
                    }
                };
                let frames = edge.iter().flat_map(|edge| [edge.child.clone(), edge.parent.clone()]);
                let severity = if by.is_some() { Severity::Error } else { Severity::Info };
                let mut told = by.as_ref().map_or(Vec::new(), |by| numbers(by).to_vec());
                told.extend([("rates_hz", json!(rates_hz)), ("samples", json!(rows))]);
                Self {
                    severity,
                    what: "publishers",
                    title: match by {
                        Some(_) => "two publishers disagree",
                        None => "two publishers say the same",
                    },
                    frames: frames.collect(),
                    by: *by,
                    numbers: told,
                    message,
                    fix: format!("find the two nodes that publish {on}, and stop one"),
                }
            }
            FlawKind::Pieces { needed_by, frame, base } => Self {
                severity: Severity::Error,
                what: "pieces",
                title: "the frames are in pieces",
                frames: vec![frame.clone(), base.clone()],
                by: None,
                numbers: vec![("needed_by", json!(needed_by))],
                message: format!(
                    "no transforms lead from '{frame}', which {needed_by} needs, to '{base}'"
                ),
                fix: format!("publish the transform that ties '{frame}' to '{base}'"),
            },
        }
    }
}

fn numbers(by: &Apart) -> [(&'static str, Value); 2] {
    [("length_m", json!(by.length_m)), ("angle_rad", json!(by.angle_rad))]
}

fn shown(by: &Apart) -> String {
    format!("{} and {}", Unit::Metre.show(by.length_m), Unit::Radian.show(by.angle_rad))
}
