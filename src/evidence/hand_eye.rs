//! What cameras see, each held against a hand.

use crate::diagnosis::{
    HandEyeDiagnosis, HandEyeStreams, Mount, PoseSeries, diagnose_hand_eye, turning_peaks,
};
use crate::finding::{Span, Subject};
use crate::run::{CameraAxes, HandKind, HandSource, Run, TargetSource};
use crate::stream::JointTrack;

/// A target that a camera sees, and a hand.
#[derive(Clone, Debug)]
pub struct HandEyeEvidence {
    /// Name of the robot whose hand it is, where there is one.
    pub robot: Option<String>,
    /// Topic of the target.
    pub topic: String,
    /// The camera's frame.
    pub camera: String,
    /// The target's frame; empty where the log names none.
    pub target: String,
    /// First and last stamp of the target.
    pub span: Option<Span>,
    /// The hand in words: a topic, or a link and what its poses are computed from.
    pub hand: String,
    /// Whether its poses are FK of the joint states of `robot`, and so of their stamps.
    pub hand_is_of_joints: bool,
    /// The frame of the hand; empty where the log names none.
    pub hand_frame: String,
    /// The frame of the base that the hand's poses are in; empty where the log names none.
    pub base: String,
    /// Which way the camera's axes should point, where the log's frames say.
    pub axes: Option<CameraAxes>,
    /// Where the log's frames have the camera.
    pub logged: Option<Mount>,
    /// What was estimated.
    pub diagnosis: HandEyeDiagnosis,
}

impl HandEyeEvidence {
    /// The frame that a camera on this mount is in, where the log names it.
    pub fn parent_of(&self, mount: Mount) -> Option<String> {
        let frame = match mount {
            Mount::InHand => &self.hand_frame,
            Mount::InBase => &self.base,
        };
        Some(frame.clone()).filter(|frame| !frame.is_empty())
    }

    /// The target as a subject.
    pub fn subject(&self) -> Subject {
        Subject {
            robot: self.robot.clone(),
            topic: Some(self.topic.clone()),
            frame: Some(self.target.clone()).filter(|frame| !frame.is_empty()),
            joint: None,
        }
    }
}

/// Diagnoses every target against its hand. `joints` are those of each arm, corrected by what was
/// found on them; `None` where they cannot be read.
pub(super) fn hand_eyes(
    run: &Run,
    joints: impl Fn(usize) -> Option<JointTrack>,
    most_lag_s: f64,
) -> Vec<HandEyeEvidence> {
    let facts = run.targets.iter().filter_map(|target| {
        let series = PoseSeries::of_track(&target.track)?;
        let (source, hand) = best_hand(target, &series, &joints, most_lag_s)?;
        let in_hand = source.hand_from_camera.map(|pose| (Mount::InHand, pose));
        let in_base = source.base_from_camera.map(|pose| (Mount::InBase, pose));
        let streams = HandEyeStreams {
            hand: &hand,
            target: &series,
            stamp_error_s: source.stamp_error_s,
            logged: in_hand.or(in_base),
        };
        let stream = &run.streams[target.stream];
        let robot = match &source.kind {
            HandKind::Joints { arm, .. } => Some(run.arms[*arm].name.clone()),
            _ => None,
        };
        Some(HandEyeEvidence {
            robot,
            topic: stream.topic.clone(),
            camera: stream.frame_id.clone(),
            target: stream.child_frame_id.clone(),
            span: stream.start.zip(stream.end).map(|(start, end)| Span { start, end }),
            hand: name_of(run, &source.kind),
            hand_is_of_joints: matches!(source.kind, HandKind::Joints { .. }),
            hand_frame: hand_frame_of(run, &source.kind),
            base: base_of(run, &source.kind),
            axes: target.axes,
            logged: streams.logged.map(|(mount, _)| mount),
            diagnosis: diagnose_hand_eye(&streams, most_lag_s),
        })
    });
    facts.collect()
}

/// The hand that a target turns most like, with its poses; the first where none turns.
fn best_hand<'a>(
    target: &'a TargetSource,
    series: &PoseSeries,
    joints: &impl Fn(usize) -> Option<JointTrack>,
    most_lag_s: f64,
) -> Option<(&'a HandSource, PoseSeries)> {
    let hands = target.hands.iter().filter_map(|source| {
        let poses = match &source.kind {
            HandKind::Joints { arm, chain, columns } => {
                PoseSeries::by_kinematics(&joints(*arm)?, chain, columns)
            }
            HandKind::Stream { track, .. } | HandKind::Transforms { track, .. } => {
                PoseSeries::of_track(track)?
            }
        };
        Some((source, poses))
    });
    let alike = |hand: &PoseSeries| {
        turning_peaks(hand, series, most_lag_s).first().map_or(0.0, |peak| peak.correlation)
    };
    let mut hands: Vec<(&HandSource, PoseSeries)> = hands.collect();
    if hands.len() < 2 {
        return hands.pop();
    }
    // Of equals the last counts as the greatest, and the first is wanted.
    hands.into_iter().rev().max_by(|a, b| alike(&a.1).total_cmp(&alike(&b.1)))
}

/// The frame of the base.
fn base_of(run: &Run, kind: &HandKind) -> String {
    match kind {
        HandKind::Joints { chain, .. } => chain.base_name().to_owned(),
        HandKind::Stream { stream, .. } => run.streams[*stream].frame_id.clone(),
        HandKind::Transforms { base, .. } => base.clone(),
    }
}

/// The frame of the hand.
fn hand_frame_of(run: &Run, kind: &HandKind) -> String {
    match kind {
        HandKind::Joints { chain, .. } => chain.tip_name().to_owned(),
        HandKind::Stream { stream, .. } => run.streams[*stream].child_frame_id.clone(),
        HandKind::Transforms { frame, .. } => frame.clone(),
    }
}

/// The hand in words.
fn name_of(run: &Run, kind: &HandKind) -> String {
    match kind {
        HandKind::Joints { chain, .. } => format!("{} by FK", chain.tip_name()),
        HandKind::Stream { stream, .. } => run.streams[*stream].topic.clone(),
        HandKind::Transforms { frame, .. } => format!("{frame} by /tf"),
    }
}
