use serde_json::{Value, json};

use crate::checks::{Case, Grade, Judged};
use crate::evidence::Of;
use crate::finding::{Cause, Evidence, Fault, Outcome, Severity, Sight, Unit};
use crate::run::WhyNot;

rule! {
    /// An arm or a pose stream is not audited, or not as what it says it is.
    ///
    /// ## What it means
    /// The log holds a stream that says it is a tool's pose, or joint states of an arm, and it cannot be
    /// taken at its word: its `frame_id` is the tool's own frame, in which the tool never moves; its
    /// orientations were never set; its pose never changes while the joints move the tool; some of its poses are in frames that
    /// nothing ties to the arm; the arm's base moves in its frame and no transform says how; it may
    /// be of either of two arms; no kinematics can be held against it; no model has its joints. What can
    /// be told without that is told all the same: positions are audited where orientations are not set,
    /// and poses in the tool's own frame as ones in an unknown frame.
    ///
    /// ## Why it matters
    /// What is not audited is not sound. A run that passes says nothing of such a stream, and a program
    /// that believes its frame or its orientation is wrong by all of it.
    ///
    /// ## Evidence
    /// `why` is `own-frame`, `no-orientation`, `never-changes`, `scene-objects`, `other-frames`, `base-moves`,
    /// `whose-arm`, `no-kinematics` or `no-model`; beside it stand the number of `samples` and how far the joints move the tool (`moved_m`), the `frame`, the `base` with how far it travels (`travel_m`) and turns
    /// (`turn_rad`), the `arms`, what is `missing`, or the `joints`.
    ///
    /// ## How to fix
    /// Write the frame that the numbers are in into `frame_id` (the base, not the tool). Set the
    /// orientation, or publish a point. Record the transform from the frame to the base that moves in it
    /// (odometry's, on /tf). Name topics after their arms. Record the description of every robot, or name
    /// it with `--robot PREFIX=FILE`.
    ///
    /// ## When it misleads
    /// Joint states of an arm that nobody wants to audit (a leader arm that is held by hand, an arm
    /// beside the cell) are said, too: ignore the rule for their topic. A gantry or a SCARA that never
    /// tilts its tool has an orientation that stays the same: only where the joints turn the tool that is
    /// said of it.
    FRM007 {
        name: "not-audited",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "no stream of tool poses or joint states that an arm is held against",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.unaudited.iter().flat_map(judge).collect()
}

fn judge(stream: &Of<Vec<WhyNot>>) -> Vec<Judged> {
    if stream.is_empty() {
        return vec![stream.judged(Outcome::sound())];
    }
    let of = |why: &WhyNot| {
        let Words { why: name, title, message, fix, evidence } = words(why);
        let severity = match why {
            WhyNot::SceneObjects { .. } => Severity::Info,
            _ => Severity::Warning,
        };
        let fault = Fault {
            cause: Cause::Seen(Sight::Stream),
            severity,
            title,
            message,
            evidence: Evidence::default(),
            fix,
        };
        evidence.into_iter().fold(
            stream.judged(Outcome::faulty(fault)).with_evidence("why", name),
            |judged, (key, value)| judged.with_evidence(key, value),
        )
    };
    stream.iter().map(of).collect()
}

struct Words {
    why: &'static str,
    title: &'static str,
    message: String,
    fix: String,
    evidence: Vec<(&'static str, Value)>,
}

fn words(why: &WhyNot) -> Words {
    match why {
        WhyNot::OwnFrame { frame } => Words {
            why: "own-frame",
            title: "frame_id is the tool's own frame",
            message: format!(
                "its frame_id '{frame}' is the tool's own frame, in which the tool does not move, and \
                 its poses do; they are audited as ones in an unknown frame"
            ),
            fix: "write the frame that the numbers are in (the arm's base) into frame_id"
                .to_owned(),
            evidence: vec![("frame", json!(frame))],
        },
        WhyNot::NoOrientation => Words {
            why: "no-orientation",
            title: "orientations were never set",
            message:
                "all its orientations are the same or none, while the joints turn the tool; only \
                      its positions are audited"
                    .to_owned(),
            fix: "set the orientation, or publish a point".to_owned(),
            evidence: Vec::new(),
        },
        WhyNot::OtherFrames { frames, samples, of } => Words {
            why: "other-frames",
            title: "a topic whose poses are in several frames",
            message: format!(
                "{samples} of its {of} poses are in other frames ({}), which nothing ties to the arm: where \
                 they should be is not known",
                few(frames)
            ),
            fix: "see who else sends on the topic, and give each source a topic, or record the transforms \
                  to these frames"
                .to_owned(),
            evidence: vec![("frames", json!(frames.len())), ("samples", json!(samples))],
        },
        WhyNot::NeverChanges { samples, moved_m } => Words {
            why: "never-changes",
            title: "poses that never change",
            message: format!(
                "all its {samples} poses are the same, while the joints move the tool by {}; nothing is \
                 held against them",
                Unit::Metre.show(*moved_m)
            ),
            fix: "look for what stopped it, and record it for as long as the arm moves".to_owned(),
            evidence: vec![("samples", json!(samples)), ("moved_m", json!(moved_m))],
        },
        WhyNot::SceneObjects { names } => Words {
            why: "scene-objects",
            title: "objects of the scene",
            message: format!(
                "{} bodies on it never move ({}): objects of the scene, not the tool",
                names.len(),
                few(names)
            ),
            fix: "nothing to fix; leave the topic out of the recording if nobody needs it".to_owned(),
            evidence: vec![("bodies", json!(names))],
        },
        WhyNot::BaseMoves { frame, base, travel_m, turn_rad } => Words {
            why: "base-moves",
            title: "the arm's base moves in the frame of the poses",
            message: format!(
                "'{base}' moves in its frame '{frame}', by {travel_m:.2} m and {:.0}°, and no transform \
                 in the log says how: the poses cannot be held against the joint states",
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
        WhyNot::WhoseArm { arms } => Words {
            why: "whose-arm",
            title: "nothing says which arm's pose it is",
            message: format!(
                "it may be the tool of {}: names and frames do not tell, and the motion does not either",
                arms.join(" or ")
            ),
            fix: "name the topic or its frames after the arm".to_owned(),
            evidence: vec![("arms", json!(arms))],
        },
        WhyNot::NoKinematics { what } => Words {
            why: "no-kinematics",
            title: "a tool's pose cannot be held against the arm",
            message: format!("its name or its frames say that it is a tool's pose, but {what}"),
            fix: "record what is missing, or name the frames with `frame` and `link` in the config"
                .to_owned(),
            evidence: vec![("missing", json!(what))],
        },
        WhyNot::NoModel { joints } => Words {
            why: "no-model",
            title: "joint states of an arm that no model has",
            message: format!(
                "{} joints move as an arm's ({}), and no model has them",
                joints.len(),
                few(joints)
            ),
            fix: "record the robot's description, or name it with --robot PREFIX=FILE".to_owned(),
            evidence: vec![("joints", json!(joints))],
        },
    }
}

/// The first of some names.
fn few(names: &[String]) -> String {
    const SHOWN: usize = 4;
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN { format!("{shown}, …") } else { shown }
}
