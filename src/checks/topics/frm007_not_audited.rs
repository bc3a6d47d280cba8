use serde_json::{Value, json};

use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::StreamEvidence;
use crate::finding::{Cause, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::run::NotAuditedReason;

rule! {
    /// An arm or a pose stream is not audited, or not as declared.
    ///
    /// ## What it means
    /// The metadata of a tool pose stream, or of an arm's joint states, cannot be trusted. `why` names the
    /// reason:
    ///
    /// - `own-frame`: its `frame_id` is the tool's frame, in which the tool cannot move.
    /// - `no-orientation`: its orientations were never set.
    /// - `never-set`: all joint positions are exactly 0 throughout. It is `info` if the joints' limits allow it.
    /// - `never-changes`: its pose is constant while the joints move the tool.
    /// - `scene-objects`: it rests while the joints move the tool, and moves with the tool otherwise, if at all. It is the
    ///   pose of an object (info).
    /// - `does-not-follow`: it is named as the tool, or is in a frame of the robot (info), but moves otherwise, or too
    ///   briefly to tell. MDL001 is then inconclusive. In a log without joint states: it moves otherwise than the `reference`
    ///   stream. That is a warning if other streams move like the reference, and the child frames are equal, or each
    ///   stream has a file of its own.
    /// - `other-frames`: some poses are in frames without a transform to the arm.
    /// - `base-moves`: the arm's base moves in its frame, and no transform describes how.
    /// - `other-arm`: its name or frames are one arm's, but its poses follow another (an error).
    /// - `whose-arm`: it may belong to either of two arms.
    /// - `no-kinematics`: no kinematics can be compared with it.
    /// - `no-model`: no model has its joints.
    ///
    /// Everything else is still audited: positions without orientations, and poses of another arm against
    /// that arm. Poses in the tool's own frame count as poses in an unknown frame.
    ///
    /// ## Why it matters
    /// An unaudited stream may be wrong even if the run passes, and programs that trust its frame or
    /// orientation are off by the full error.
    ///
    /// ## Evidence
    /// `why`, and depending on it: the number of `samples`, the tool's travel by the joints (`moved_m`),
    /// a joint that cannot be at 0 (`impossible`), the `frame`, the `base` with its travel (`travel_m`) and rotation (`turn_rad`), the `arms`, the arm
    /// by name (`named`) and by motion (`arm`), the `correlation` of its speed with the tool's, the
    /// topic of the `reference`, the `frames`, the `bodies`, `missing` kinematics, or the `joints`.
    ///
    /// ## How to fix
    /// Set `frame_id` to the frame of the poses (the base, not the tool). Set the orientation, or publish a
    /// point. Record the transform to a moving base (odometry, on /tf). Name topics after their arms.
    /// Record every robot's description, or name it with `--robot PREFIX=FILE`.
    ///
    /// ## When it misleads
    /// Set the role of a person or another body that moves in a frame of the robot to `ignored`, and leave out files of other
    /// bodies. Joint states of an arm that need not be audited, such as a leader arm or a neighbour of the cell, are
    /// also reported. Ignore the rule for their topic. A constant orientation, as of a gantry or SCARA that
    /// never tilts its tool, is reported only if the joints rotate the tool.
    FRM007 {
        name: "not-audited",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "no stream of tool poses or joint states of an arm",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.not_audited.iter().flat_map(judge).collect()
}

fn judge(stream: &StreamEvidence<Vec<NotAuditedReason>>) -> Vec<SubjectResult> {
    if stream.is_empty() {
        return vec![stream.judged(Outcome::pass())];
    }
    let of = |why: &NotAuditedReason| {
        let NotAuditedReport { why: name, title, message, fix, evidence } = report(why);
        let severity = match why {
            NotAuditedReason::SceneObjects { .. }
            | NotAuditedReason::NeverSet { impossible: None, .. }
            | NotAuditedReason::DoesNotFollow { is_named: false, .. } => Severity::Info,
            NotAuditedReason::OtherArm { .. } => Severity::Error,
            _ => Severity::Warning,
        };
        let fault = Fault {
            cause: Cause::Pictured(Picture::Stream),
            severity,
            title,
            message,
            evidence: Evidence::default(),
            fix,
        };
        evidence.into_iter().fold(
            stream.judged(Outcome::fail(fault)).with_evidence("why", name),
            |judged, (key, value)| judged.with_evidence(key, value),
        )
    };
    stream.iter().map(of).collect()
}

struct NotAuditedReport {
    why: &'static str,
    title: &'static str,
    message: String,
    fix: String,
    evidence: Vec<(&'static str, Value)>,
}

fn report(why: &NotAuditedReason) -> NotAuditedReport {
    match why {
        NotAuditedReason::OwnFrame { frame } => NotAuditedReport {
            why: "own-frame",
            title: "frame_id is the tool's own frame",
            message: format!(
                "frame_id is '{frame}', the tool's own frame, yet the pose moves; audited as poses in an \
                 unknown frame"
            ),
            fix: "set frame_id to the frame of the poses (the arm's base)"
                .to_owned(),
            evidence: vec![("frame", json!(frame))],
        },
        NotAuditedReason::NoOrientation => NotAuditedReport {
            why: "no-orientation",
            title: "orientations were never set",
            message:
                "all orientations are equal or unset while the joints rotate the tool; only positions are \
                 audited"
                    .to_owned(),
            fix: "set the orientation, or publish a point".to_owned(),
            evidence: Vec::new(),
        },
        NotAuditedReason::NeverSet { samples, impossible } => NotAuditedReport {
            why: "never-set",
            title: "joint positions are always zero",
            message: {
                let cause = match impossible {
                    Some(joint) => format!(", which the limits of {joint} exclude: they were never set"),
                    None => ": they were never set, or a simulated arm rests".to_owned(),
                };
                format!("all joint positions are exactly 0 in all {samples} samples{cause}")
            },
            fix: "check that the driver is connected to the arm, and record while the joints move".to_owned(),
            evidence: vec![("samples", json!(samples)), ("impossible", json!(impossible))],
        },
        NotAuditedReason::OtherFrames { frames, samples, of } => NotAuditedReport {
            why: "other-frames",
            title: "topic has poses in several frames",
            message: format!(
                "{samples} of {of} poses are in other frames ({}) without a transform to the arm; not \
                 audited",
                list_names(frames)
            ),
            fix: "check which other nodes publish on the topic and separate the sources, or record the \
                transforms to these frames"
                .to_owned(),
            evidence: vec![("frames", json!(frames.len())), ("samples", json!(samples))],
        },
        NotAuditedReason::NeverChanges { samples, moved_m } => NotAuditedReport {
            why: "never-changes",
            title: "pose never changes",
            message: format!(
                "all {samples} poses are equal while the arm or body moves by {}; not audited",
                Unit::Metre.show(*moved_m)
            ),
            fix: "check why it stopped, and record it while the arm moves; if it is of an object, set its role in the config \
                  file to 'ignored'"
                .to_owned(),
            evidence: vec![("samples", json!(samples)), ("moved_m", json!(moved_m))],
        },
        NotAuditedReason::SceneObjects { bodies, moved_m } => NotAuditedReport {
            why: "scene-objects",
            title: "pose of an object",
            message: {
                let moved = Unit::Metre.show(*moved_m);
                match bodies.as_slice() {
                    [] | [_] => format!(
                        "rests while the joints move the tool by {moved}: an object, not the tool; not audited"
                    ),
                    all => format!(
                        "{} bodies rest while the joints move the tool by {moved} ({}): objects, not the tool; \
                         not audited",
                        all.len(),
                        list_names(all)
                    ),
                }
            },
            fix: "no action needed; if it is the tool's pose, declare it in the config file, and check why it stopped"
                .to_owned(),
            evidence: vec![("bodies", json!(bodies)), ("moved_m", json!(moved_m))],
        },
        NotAuditedReason::DoesNotFollow { correlation, reference, .. } => NotAuditedReport {
            why: "does-not-follow",
            title: match reference {
                Some(_) => "pose does not follow the reference",
                None => "pose does not follow the arm",
            },
            message: {
                let topic = reference.as_ref().map(|topic| format!("'{topic}'"));
                match correlation {
                    Some(correlation) => format!(
                        "does not move like {} (speed correlation {correlation:.2}); not audited",
                        topic.as_deref().unwrap_or("the tool by FK")
                    ),
                    None => format!(
                        "the motion does not show whether it follows {}; not audited",
                        topic.as_deref().unwrap_or("the arm")
                    ),
                }
            },
            fix: match reference {
                Some(_) => "check its stamps, and whether it froze or lost track; if it is of another body, set its role in the \
                            config file to 'ignored'",
                None => "check that it is of this arm, and of the same time as the joint states; if it is not of the tool, set \
                         its role in the config file to 'ignored'",
            }
            .to_owned(),
            evidence: std::iter::once(("correlation", json!(correlation)))
                .chain(reference.as_ref().map(|topic| ("reference", json!(topic))))
                .collect(),
        },
        NotAuditedReason::BaseMoves { frame, base, travel_m, turn_rad } => NotAuditedReport {
            why: "base-moves",
            title: "arm base moves in the frame of the poses",
            message: format!(
                "'{base}' moves in its frame '{frame}' by {travel_m:.2} m and {:.0}° without a transform in \
                 the log: poses cannot be compared with the joint states",
                turn_rad.to_degrees()
            ),
            fix: format!("record the transforms from '{frame}' to '{base}' (/tf, or odometry)"),
            evidence: vec![
                ("frame", json!(frame)),
                ("base", json!(base)),
                ("travel_m", json!(travel_m)),
                ("turn_rad", json!(turn_rad)),
            ],
        },
        NotAuditedReason::OtherArm { named, arm } => NotAuditedReport {
            why: "other-arm",
            title: "poses of another arm",
            message: format!(
                "its name or frame is that of {named}, but its poses follow {arm}; audited against {arm}"
            ),
            fix: format!("check which controller publishes it, and exchange the names of {named} and {arm}"),
            evidence: vec![("named", json!(named)), ("arm", json!(arm))],
        },
        NotAuditedReason::WhoseArm { arms } => NotAuditedReport {
            why: "whose-arm",
            title: "pose stream of an unknown arm",
            message: format!(
                "it may be the tool of {}: neither names, frames nor motion identify the arm",
                arms.join(" or ")
            ),
            fix: "name the topic or its frames after the arm".to_owned(),
            evidence: vec![("arms", json!(arms))],
        },
        NotAuditedReason::NoKinematics { what } => NotAuditedReport {
            why: "no-kinematics",
            title: "tool pose cannot be compared with the arm",
            message: format!("a tool pose by its name or frames, but {what}"),
            fix: "record what is missing, or name the frames with `frame` and `link` in the config"
                .to_owned(),
            evidence: vec![("missing", json!(what))],
        },
        NotAuditedReason::NoModel { joints } => NotAuditedReport {
            why: "no-model",
            title: "joint states of an arm without a model",
            message: format!(
                "{} joints move like an arm ({}), but no model has them",
                joints.len(),
                list_names(joints)
            ),
            fix: "record the robot description, or pass it with --robot PREFIX=FILE".to_owned(),
            evidence: vec![("joints", json!(joints))],
        },
    }
}

fn list_names(names: &[String]) -> String {
    const MAX_LISTED_NAMES: usize = 4;
    let shown = names.iter().take(MAX_LISTED_NAMES).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > MAX_LISTED_NAMES { format!("{shown}, …") } else { shown }
}
