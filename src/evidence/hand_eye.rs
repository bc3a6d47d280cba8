use super::stream_span;
use crate::diagnosis::{
    CameraMount, HandEyeDiagnosis, HandEyeStreams, PoseSeries, diagnose_hand_eye,
    rotation_lag_peaks,
};
use crate::finding::{Span, Subject};
use crate::run::{CameraAxes, HandKind, HandSource, Run, TargetSource};
use crate::stream::JointTrack;

/// Target seen by a camera, compared with a hand.
#[derive(Clone, Debug)]
pub struct HandEyeEvidence {
    /// Robot of the hand, if any.
    pub robot: Option<String>,
    /// Topic of the target.
    pub topic: String,
    /// Camera frame.
    pub camera: String,
    /// Target frame; empty if undeclared.
    pub target: String,
    /// First and last stamp of the target.
    pub span: Option<Span>,
    /// Topic of the hand, or link and source of its poses.
    pub hand: String,
    /// The hand's poses are FK of the joint states, with their stamps.
    pub hand_is_of_joints: bool,
    /// Hand frame; empty if undeclared.
    pub hand_frame: String,
    /// Base frame; empty if undeclared.
    pub base: String,
    /// Camera axes according to the log's frames.
    pub axes: Option<CameraAxes>,
    /// Mount according to the log's frames.
    pub logged: Option<CameraMount>,
    /// Diagnosis.
    pub diagnosis: HandEyeDiagnosis,
}

impl HandEyeEvidence {
    /// Parent frame of a camera on this mount, if declared.
    pub fn parent_of(&self, mount: CameraMount) -> Option<String> {
        let frame = match mount {
            CameraMount::InHand => &self.hand_frame,
            CameraMount::InBase => &self.base,
        };
        Some(frame.clone()).filter(|frame| !frame.is_empty())
    }

    /// The target as a subject.
    pub fn subject(&self) -> Subject {
        Subject {
            robot: self.robot.clone(),
            topic: Some(self.topic.clone()),
            frame: Some(self.target.clone()).filter(|frame| !frame.is_empty()),
            ..Subject::default()
        }
    }
}

/// Diagnoses every target. `joints` returns corrected joint states, or `None` if they cannot be
/// interpreted.
pub(super) fn hand_eyes(
    run: &Run,
    joints: impl Fn(usize) -> Option<JointTrack>,
    max_lag_s: f64,
) -> Vec<HandEyeEvidence> {
    let facts = run.targets.iter().filter_map(|target| {
        let series = PoseSeries::from_track(&target.track)?;
        let (source, hand) = best_hand(target, &series, &joints, max_lag_s)?;
        let in_hand = source.hand_from_camera.map(|pose| (CameraMount::InHand, pose));
        let in_base = source.base_from_camera.map(|pose| (CameraMount::InBase, pose));
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
        let [hand_name, hand_frame, base] = hand_names(run, &source.kind);
        Some(HandEyeEvidence {
            robot,
            topic: stream.topic.clone(),
            camera: stream.frame_id.clone(),
            target: stream.child_frame_id.clone(),
            span: stream_span(run, target.stream),
            hand: hand_name,
            hand_is_of_joints: matches!(source.kind, HandKind::Joints { .. }),
            hand_frame,
            base,
            axes: target.axes,
            logged: streams.logged.map(|(mount, _)| mount),
            diagnosis: diagnose_hand_eye(&streams, max_lag_s),
        })
    });
    facts.collect()
}

/// Hand whose rotation correlates best with the target's; the first if none rotates.
fn best_hand<'a>(
    target: &'a TargetSource,
    series: &PoseSeries,
    joints: &impl Fn(usize) -> Option<JointTrack>,
    max_lag_s: f64,
) -> Option<(&'a HandSource, PoseSeries)> {
    let hands = target.hands.iter().filter_map(|source| {
        let poses = match &source.kind {
            HandKind::Joints { arm, chain, columns } => {
                PoseSeries::from_joints(&joints(*arm)?, chain, columns)
            }
            HandKind::Stream { track, .. } | HandKind::Transforms { track, .. } => {
                PoseSeries::from_track(track)?
            }
        };
        Some((source, poses))
    });
    let rotation_correlation = |hand: &PoseSeries| {
        rotation_lag_peaks(hand, series, max_lag_s).first().map_or(0.0, |peak| peak.correlation)
    };
    let mut hands: Vec<(&HandSource, PoseSeries)> = hands.collect();
    if hands.len() < 2 {
        return hands.pop();
    }
    // `max_by` returns the last of equals.
    hands
        .into_iter()
        .rev()
        .max_by(|a, b| rotation_correlation(&a.1).total_cmp(&rotation_correlation(&b.1)))
}

/// Name of the hand, its frame and its base.
fn hand_names(run: &Run, kind: &HandKind) -> [String; 3] {
    match kind {
        HandKind::Joints { chain, .. } => {
            let (base, tip) = (chain.base_name(), chain.tip_name());
            [format!("{tip} by FK"), tip.to_owned(), base.to_owned()]
        }
        HandKind::Stream { stream, .. } => {
            let stream = &run.streams[*stream];
            [&stream.topic, &stream.child_frame_id, &stream.frame_id].map(String::clone)
        }
        HandKind::Transforms { base, frame, .. } => {
            [format!("{frame} by /tf"), frame.clone(), base.clone()]
        }
    }
}
