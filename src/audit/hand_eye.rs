//! What joins the cameras of a run to the diagnosis of hand and eye, and that to facts.

use crate::checks::HandEyeFacts;
use crate::diagnosis::{HandEyeStreams, Mount, PoseSeries, diagnose_hand_eye, turning_peaks};
use crate::finding::Span;
use crate::run::{HandKind, HandSource, Run, TargetSource};
use crate::stream::JointTrack;

/// Correlation of angular speeds from which a stream of poses is the hand that a target is held
/// against.
const FOLLOWS: f64 = 0.7;

/// Settles in a log without an arm which streams are hands, by whether targets turn as they do.
pub(crate) fn settle_hands(run: &mut Run, most_lag_s: f64) {
    let mut found = Vec::new();
    for target in &run.targets {
        let Some(series) = PoseSeries::of_track(&target.track) else { continue };
        let turns_alike = |hand: &HandSource| {
            let HandKind::Stream { stream, track } = &hand.kind else { return None };
            let peaks = turning_peaks(&PoseSeries::of_track(track)?, &series, most_lag_s);
            Some((*stream, peaks.first()?.correlation))
        };
        let best = target.hands.iter().filter_map(turns_alike).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((hand, correlation)) = best.filter(|best| best.1 >= FOLLOWS) {
            found.push((hand, run.streams[target.stream].topic.clone(), correlation));
        }
    }
    for (hand, topic, correlation) in found {
        run.settle_hand(hand, &topic, correlation);
    }
}

/// Diagnoses every target against its hand. `joints` are those of each arm, corrected by what was
/// found on them; `None` where they cannot be read.
pub(crate) fn hand_eyes(
    run: &Run,
    joints: impl Fn(usize) -> Option<JointTrack>,
    most_lag_s: f64,
) -> Vec<HandEyeFacts> {
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
        Some(HandEyeFacts {
            robot,
            topic: stream.topic.clone(),
            camera: stream.frame_id.clone(),
            target: stream.child_frame_id.clone(),
            span: stream.start.zip(stream.end).map(|(start, end)| Span { start, end }),
            hand: name_of(run, &source.kind),
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
