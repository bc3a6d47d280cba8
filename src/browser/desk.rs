//! Converts and compares pasted poses.

use std::io;

use poseaudit::desk::{
    DeskError, FrameCandidates, FrameNames, KnownEncoding, Pair, PoseText, ReconcileInput,
    ReconcileVerdict, conversions_as_json, convert, parse_pose, reconcile, reconciliation_as_json,
    write_conversions, write_reconciliation,
};
use poseaudit::report::Trouble;
use poseaudit::run::load_robot;
use serde::Deserialize;

use crate::Answer;

/// Request with pasted poses.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseRequest {
    pose: String,
    /// Unset parts are inferred.
    coded: Option<String>,
    /// Should agree with A.
    other: Option<String>,
    other_coded: Option<String>,
    /// Catalogue arm whose fixed frames may lie between them.
    robot: Option<String>,
}

pub fn answer(request: &PoseRequest) -> Result<Answer, Trouble> {
    let style = |text: &Option<String>, place| {
        let style: Option<Result<KnownEncoding, DeskError>> = text.as_deref().map(str::parse);
        style.transpose().map(Option::unwrap_or_default).map_err(trouble(place))
    };
    let coded = style(&request.coded, "how A is coded")?;
    let a = parse_pose(&request.pose).map_err(trouble("pose A"))?;
    let Some(other) = &request.other else {
        let conversions = convert(&a, coded).map_err(trouble("pose A"))?;
        let shown = write_text(|out| write_conversions(&conversions, &a, out));
        return Ok(Answer {
            json: format!("{:#}", conversions_as_json(&conversions)),
            shown,
            ..Answer::default()
        });
    };
    let b = parse_pose(other).map_err(trouble("pose B"))?;
    let robot = request.robot.as_deref().map(load_robot).transpose()?;
    let names = |of: &PoseText| FrameNames { parent: of.parent.clone(), child: of.child.clone() };
    let question = ReconcileInput {
        encoding_a: coded,
        encoding_b: style(&request.other_coded, "how B is coded")?,
        frames: FrameCandidates::from_robot(robot.as_ref(), &names(&a), &names(&b)),
        pairs: vec![Pair { pose_a: a, pose_b: b }],
    };
    let answer = reconcile(&question).map_err(trouble("the poses"))?;
    Ok(Answer {
        status: u8::from(answer.verdict == ReconcileVerdict::Unexplained),
        error: None,
        json: format!("{:#}", reconciliation_as_json(&answer, 1)),
        shown: write_text(|out| write_reconciliation(&answer, 1, out)),
    })
}

fn trouble(place: &str) -> impl Fn(DeskError) -> Trouble + '_ {
    move |error| Trouble::call(place, &error, error.remedy())
}

fn write_text(write: impl FnOnce(&mut dyn io::Write) -> io::Result<()>) -> String {
    let mut bytes = Vec::new();
    let done = write(&mut bytes);
    debug_assert!(done.is_ok(), "memory takes every text");
    String::from_utf8_lossy(&bytes).into_owned()
}
