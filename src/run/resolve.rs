//! Resolves by motion what names and frames leave open: a stream's arm, a moving base's pose, and whether a
//! stream follows the arm.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, HashSet};

use rayon::prelude::*;

use crate::diagnosis::{
    ArmDiagnosis, BaseMotion, LagPeak, PoseSeries, PoseStream, best_lag_peak, candidate_lags,
    detect_base_motion, detect_tool_switching, diagnose_imu, estimate_moving_base_lag,
    follows_as_logged, follows_with_other_encoding, is_seen_from_tool, position_misfit_m,
    rotation_lag_peaks,
};
use crate::run::{
    Arm, HandKind, HandSource, ImuSource, MIN_FOLLOWER_CORRELATION, NotAudited, NotAuditedReason,
    PoseSource, Role, Run, SharedStream, Stream, with_key,
};
use crate::stats::thin::thinned;
use crate::stream::{Orientations, PoseTrack};

use super::objects::MIN_MOTION_M;
use super::role::{role_outside_arm, tool_word};
use super::source_kind::names_tracker;
use super::stale_end::{moves_within, rows_at_rest};
use super::trajectory::{Trajectory, are_of_one_body};
use super::vibration::follow_recorded_positions;

pub(super) fn resolve(run: &mut Run, max_lag_s: f64) {
    follow_recorded_positions(run);
    resolve_tool_switching(run);
    align_moving_bases(run, max_lag_s);
    resolve_shared_transforms(run);
    resolve_shared_streams(run, max_lag_s);
    exclude_unmoved(run, max_lag_s);
    resolve_candidates(run, max_lag_s);
    exclude_moving_bases(run, max_lag_s);
    resolve_leading_arms(run, max_lag_s);
    remove_frozen_spans(run, max_lag_s);
    order_for_common_diagnosis(run);
    resolve_hands(run, max_lag_s);
}

/// Converts poses that alternate between rigid bodies on one tool to the main body.
fn resolve_tool_switching(run: &mut Run) {
    let all: Vec<(usize, usize)> = run
        .arms
        .iter()
        .enumerate()
        .flat_map(|(arm, of)| (0..of.poses.len()).map(move |source| (arm, source)))
        .collect();
    let of = |&(arm, source): &(usize, usize)| {
        let of = &run.arms[arm];
        let found = of.poses.get(source).filter(|found| found.moving_base.is_none())?;
        Some(((arm, source), detect_tool_switching(&of.joints, &run.pose_stream(found))?))
    };
    let found: Vec<_> = all.par_iter().filter_map(of).collect();
    for ((arm, source), (alternation, poses)) in found {
        let source = &mut run.arms[arm].poses[source];
        source.track.xyz = poses.iter().map(|pose| pose.translation.vector).collect();
        let rotations = poses.iter().map(|pose| pose.rotation).collect();
        source.track.orientation = Orientations::Rotations(rotations);
        if run.tool_switching.iter().all(|(stream, _)| *stream != source.stream) {
            run.tool_switching.push((source.stream, alternation));
        }
    }
}

/// Maximum number of pose streams diagnosed jointly for the encoding of the joint states; others follow one
/// by one.
const MAX_COMMON_STREAMS: usize = 6;

fn order_for_common_diagnosis(run: &mut Run) {
    for arm in &mut run.arms {
        let mut first: HashMap<u64, Vec<&PoseSource>> = HashMap::new();
        let is_copy = |source| {
            let alike = first.entry(PoseSource::content_hash(source)).or_default();
            let is_copy = alike.iter().any(|one| source.is_copy_of(one));
            alike.extend((!is_copy).then_some(source));
            is_copy
        };
        let copies: Vec<bool> = arm.poses.iter().map(is_copy).collect();
        if arm.poses.len() <= MAX_COMMON_STREAMS && !copies.contains(&true) {
            continue;
        }
        let mut ranked: Vec<(bool, PoseSource)> =
            copies.into_iter().zip(std::mem::take(&mut arm.poses)).collect();
        ranked.sort_by_key(|(is_copy, source)| (*is_copy, Reverse(source.track.t_s.len())));
        arm.poses = ranked.into_iter().map(|(_, source)| source).collect();
        for source in &arm.poses[common_diagnosis_count(arm)..] {
            let reason = &mut run.streams[source.stream].reason;
            *reason +=
                "; diagnosed separately, with joint states as determined from the other streams";
        }
    }
}

pub(crate) fn common_diagnosis_count(arm: &Arm) -> usize {
    let is_copy =
        |index: &usize| arm.poses[..*index].iter().any(|one| arm.poses[*index].is_copy_of(one));
    (0..arm.poses.len().min(MAX_COMMON_STREAMS)).take_while(|index| !is_copy(index)).count()
}

/// Lags at which a stream with constant spans may follow the moving arm; empty if none.
fn likely_lags(run: &Run, arm: &Arm, source: &PoseSource, max_lag_s: f64) -> Vec<f64> {
    /// Minimum speed correlation to trust the lag.
    const MIN_CORRELATION: f64 = 0.3;
    /// Minimum correlation at other lags, as a share of the best.
    const MIN_CORRELATION_RATIO: f64 = 0.7;
    let track = source.track_without_jumps();
    let stream = PoseStream { track: &track, ..run.pose_stream(source) };
    let peaks = candidate_lags(&arm.joints, &stream, max_lag_s);
    let best = peaks.first().map_or(0.0, |peak| peak.correlation);
    let is_likely = |peak: &&LagPeak| {
        best >= MIN_CORRELATION && peak.correlation >= MIN_CORRELATION_RATIO * best
    };
    peaks.iter().filter(is_likely).map(|peak| peak.lag_s).collect()
}

/// Highest speed correlation of a stream with its arm, apart from spans in which the stream is stuck.
fn follower_peak(run: &Run, arm: &Arm, source: &PoseSource, max_lag_s: f64) -> Option<LagPeak> {
    let stream = run.pose_stream(source);
    let peak = best_lag_peak(&arm.joints, &stream, max_lag_s)?;
    if !source.has_constant_span() {
        return Some(peak);
    }
    let lags_s = likely_lags(run, arm, source, max_lag_s);
    let moving = source.track_without_stuck_spans(&arm.joints, &lags_s);
    let without_stuck = moving.and_then(|track| {
        best_lag_peak(&arm.joints, &PoseStream { track: &track, ..stream }, max_lag_s)
    });
    without_stuck.filter(|other| other.correlation > peak.correlation).or(Some(peak))
}

/// Removes repeated poses at the lags at which streams may follow the moving arm, and joint states that are stale to the end
/// while all streams in the base frame move on.
fn remove_frozen_spans(run: &mut Run, max_lag_s: f64) {
    for arm in 0..run.arms.len() {
        for source in 0..run.arms[arm].poses.len() {
            let of = &run.arms[arm];
            let found = &of.poses[source];
            if found.moving_base.is_some() || !found.has_constant_span() {
                continue;
            }
            let lags_s = likely_lags(run, of, found, max_lag_s);
            run.remove_frozen_at_lags(arm, source, &lags_s);
        }
        let of = &run.arms[arm];
        // The path of a body in the place of joint states may rest while another body moves.
        if of.trajectory.is_some() {
            continue;
        }
        let Some(rows) = rows_at_rest(&of.joints) else { continue };
        let span_s = [rows.start, rows.end - 1].map(|row| of.joints.t_s[row]);
        let in_base_frame = of
            .poses
            .iter()
            .filter(|source| source.reference_known && source.moving_base.is_none())
            .map(|source| (source, likely_lags(run, of, source, max_lag_s)))
            .filter(|(_, lags_s)| !lags_s.is_empty());
        let moves: Vec<bool> = in_base_frame
            .map(|(source, lags_s)| moves_within(&source.track, span_s, &lags_s))
            .collect();
        if moves.contains(&true) && !moves.contains(&false) {
            run.remove_stale_end(arm, rows);
        }
    }
}

/// Maximum ratio of the nearest arm's residual to the next.
const MAX_RESIDUAL_RATIO: f64 = 0.5;

/// Assigns transforms of shared frames to the arm that they fit.
fn resolve_shared_transforms(run: &mut Run) {
    let frames = |arm: &Arm| {
        let source = arm.tf.as_ref().ok()?;
        Some((source.stream, arm.end_frames()))
    };
    for first in 0..run.arms.len() {
        let Some(own) = frames(&run.arms[first]) else { continue };
        let candidates: Vec<usize> = (0..run.arms.len())
            .filter(|&arm| frames(&run.arms[arm]).as_ref() == Some(&own))
            .collect();
        let misfit_m = |&index: &usize| {
            let arm = &run.arms[index];
            let stream = run.pose_stream(arm.tf.as_ref().ok()?);
            Some((position_misfit_m(&arm.joints, &stream, 1.0, 0.0)?, index))
        };
        let mut misfits: Vec<(f64, usize)> = candidates.iter().filter_map(misfit_m).collect();
        misfits.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let [(near_m, winner), (next_m, _), ..] = misfits.as_slice()
            && *near_m < MAX_RESIDUAL_RATIO * next_m
        {
            run.assign_shared_transforms(&candidates, *winner);
        }
    }
}

/// Turns joint states without measurement into commands if an arm with the same joints follows.
fn resolve_leading_arms(run: &mut Run, max_lag_s: f64) {
    let nothing_beside = |arm: &Arm| arm.poses.is_empty() && arm.imus.is_empty() && arm.tf.is_err();
    for index in (0..run.arms.len()).rev() {
        let arm = &run.arms[index];
        let mut followers = run.arms.iter().filter(|other| !nothing_beside(other));
        let led = followers.find_map(|other| {
            let is_alike = other.chain.joint_names() == arm.chain.joint_names();
            let lead_s = arm_lead_s(arm, other, max_lag_s).filter(|_| is_alike)?;
            Some((other.name.clone(), lead_s))
        });
        if let (true, Some((of, lead_s))) = (nothing_beside(arm), led) {
            run.resolve_leading_arm(index, &of, lead_s);
        }
    }
}

/// Lead over an arm of the same kind, s.
fn arm_lead_s(leader: &Arm, arm: &Arm, max_lag_s: f64) -> Option<f64> {
    const MAX_COMPARED_SAMPLES: usize = 20_000;
    let rows = || thinned(0..arm.joints.len(), MAX_COMPARED_SAMPLES);
    let poses = rows().map(|row| arm.chain.forward(&arm.joints.positions_at(row, &arm.columns)));
    let (xyz, rotations) = poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let track = PoseTrack {
        t_s: rows().map(|row| arm.joints.t_s[row]).collect(),
        xyz,
        orientation: Orientations::Rotations(rotations),
        declared: None,
    };
    let stream = PoseStream::new(&track, &leader.chain, &leader.columns);
    let peak = best_lag_peak(&leader.joints, &stream, max_lag_s)?;
    (peak.correlation >= MIN_LEAD_CORRELATION && peak.lag_s > MIN_LEAD_S).then_some(peak.lag_s)
}

/// Minimum lead, s; stamps, transport and filters cause shorter ones.
const MIN_LEAD_S: f64 = 0.04;
/// Minimum speed correlation, as for streams that follow.
const MIN_LEAD_CORRELATION: f64 = 0.7;
/// Minimum correlation at another lag of periodic motion, as a share of the best.
const MIN_REPEAT_CORRELATION_RATIO: f64 = 0.9;

fn resolve_candidates(run: &mut Run, max_lag_s: f64) {
    let candidates: Vec<usize> = run.candidates().collect();
    // Arm and place of the first source of each stream.
    let mut places: HashMap<usize, (usize, usize)> = HashMap::new();
    for (arm, of) in run.arms.iter().enumerate() {
        for (place, source) in of.poses.iter().enumerate() {
            places.entry(source.stream).or_insert((arm, place));
        }
    }
    let lag_of = |&candidate: &usize| {
        let (arm, source) = pose_source(run, &places, candidate)?;
        Some((candidate, follower_peak(run, arm, source, max_lag_s)))
    };
    let poses = candidates.par_iter().filter_map(lag_of).collect();
    let mut lags = LagCache { max_lag_s, poses, imus: BTreeMap::new() };
    let mut unlike: Vec<(NotAudited, bool)> = Vec::new();
    let is_own_frame =
        |found: &&NotAudited| matches!(found.reason, NotAuditedReason::OwnFrame { .. });
    let of_own_frame = run.not_audited.iter().filter(is_own_frame);
    let of_own_frame: HashSet<usize> = of_own_frame.map(|found| found.stream).collect();
    for &candidate in &candidates {
        let found = pose_source(run, &places, candidate);
        let peak = found.and_then(|(arm, source)| lags.pose_peak(run, arm, source));
        let is_of_own_frame = of_own_frame.contains(&candidate);
        let is_seen = found.zip(peak).is_some_and(|((arm, source), peak)| {
            is_seen_from_tool(&arm.joints, &run.pose_stream(source), peak.lag_s)
        });
        // A tracker's pose moves like that if it is inverted.
        let is_tracker = names_tracker(&run.streams[candidate]);
        let is_target = role_outside_arm(&run.streams[candidate].topic) == Role::Target;
        if is_seen && (is_of_own_frame || is_target && !is_tracker) {
            let reason = "it moves like a fixed object seen from the tool".to_owned();
            match is_of_own_frame {
                true => run.clear_role(candidate, reason),
                false => run.assign_role_by_name(candidate, reason),
            }
            continue;
        }
        let lead_s = found
            .zip(peak)
            .and_then(|((arm, source), peak)| stream_lead_s(run, arm, source, peak, &mut lags));
        // Joint states with a wrong sign, unit or order move otherwise.
        let is_doubtful = lead_s.is_some()
            || peak.is_some_and(|peak| peak.correlation < MIN_FOLLOWER_CORRELATION);
        let follows_otherwise = is_doubtful
            && found.is_some_and(|(arm, source)| {
                (source.stamps_copied || is_tracker)
                    && follows_with_other_encoding(&arm.joints, &run.pose_stream(source), max_lag_s)
            });
        match lead_s {
            Some(lead_s) if !follows_otherwise => run.resolve_leader(candidate, lead_s),
            _ => {
                let correlation = peak.map(|peak| peak.correlation);
                let is_moved = found
                    .is_some_and(|(arm, source)| source.fk_motion_m(&arm.joints) > MIN_MOTION_M);
                let is_presumed = run.streams[candidate].role == Role::Candidate { presumed: true };
                let changes = found.is_some_and(|(_, source)| source.track.changes());
                let trajectory = found.and_then(|(arm, _)| arm.trajectory.as_ref());
                // Of two streams that move differently, either may be of another body.
                let is_of_body = trajectory.is_some_and(|Trajectory { stream, others, .. }| {
                    others.len() > 1 && are_of_one_body(&run.streams, [*stream, candidate])
                });
                let reference = trajectory.map(|one| run.streams[one.stream].topic.clone());
                run.resolve_candidate(candidate, correlation, follows_otherwise);
                let Stream { role, topic, .. } = &run.streams[candidate];
                let is_named = is_of_body || tool_word(topic).is_some();
                if *role == Role::Unassigned && is_moved && (is_named || is_presumed) {
                    let reason =
                        NotAuditedReason::DoesNotFollow { correlation, is_named, reference };
                    unlike.push((NotAudited { stream: candidate, reason }, changes));
                }
            }
        }
    }
    run.remove_rejected(&candidates);
    // Next to the tool's pose, a constant one is an offset, such as the TCP in the flange.
    let has_pose = run.arms.iter().any(|arm| !arm.poses.is_empty());
    let unlike = unlike.into_iter().filter(|(_, changes)| *changes || !has_pose);
    run.not_audited.extend(unlike.map(|(unlike, _)| unlike));
}

/// Lead over the arm, s.
///
/// A measurement is received after the motion. If only stamps are ahead, messages arrive with the others;
/// if joint states are late, all streams appear early.
fn stream_lead_s(
    run: &Run,
    arm: &Arm,
    source: &PoseSource,
    peak: LagPeak,
    lags: &mut LagCache,
) -> Option<f64> {
    let joints = arm.joint_sources.first()?.stream;
    let delay_s = |stream: usize| {
        let clock = run.clocks_of(stream).first();
        clock.and_then(|clock| clock.log_minus_header_s).unwrap_or(0.0)
    };
    let received_s = peak.lag_s + delay_s(source.stream) - delay_s(joints);
    if peak.correlation < MIN_LEAD_CORRELATION
        || peak.lag_s > -MIN_LEAD_S
        || received_s > -MIN_LEAD_S
    {
        return None;
    }
    // Periodic motion also matches near zero lag.
    let peaks = candidate_lags(&arm.joints, &run.pose_stream(source), lags.max_lag_s);
    let is_now = |other: &LagPeak| {
        other.correlation
            > MIN_LEAD_CORRELATION.max(MIN_REPEAT_CORRELATION_RATIO * peak.correlation)
            && other.lag_s > -MIN_LEAD_S
    };
    if peaks.iter().any(is_now) {
        return None;
    }
    let is_as_early = |lag_s: f64| lag_s < 0.5 * peak.lag_s;
    let mut poses = arm.poses.iter().filter(|other| run.streams[other.stream].role == Role::Pose);
    let agrees =
        poses.any(|other| {
            let other = lags.pose_peak(run, arm, other);
            other.is_some_and(|other| {
                other.correlation >= MIN_LEAD_CORRELATION && is_as_early(other.lag_s)
            })
        }) || arm.imus.iter().any(|imu| lags.imu_latency_s(arm, imu).is_some_and(is_as_early));
    (!agrees).then_some(-received_s)
}

struct LagCache {
    max_lag_s: f64,
    poses: BTreeMap<usize, Option<LagPeak>>,
    imus: BTreeMap<usize, Option<f64>>,
}

impl LagCache {
    fn pose_peak(&mut self, run: &Run, arm: &Arm, source: &PoseSource) -> Option<LagPeak> {
        let lag = || best_lag_peak(&arm.joints, &run.pose_stream(source), self.max_lag_s);
        *self.poses.entry(source.stream).or_insert_with(lag)
    }

    fn imu_latency_s(&mut self, arm: &Arm, imu: &ImuSource) -> Option<f64> {
        let latency_s = || {
            let found = diagnose_imu(&arm.joints, &imu.as_stream(), self.max_lag_s);
            found.latency_s.ok().map(|latency| latency.value)
        };
        *self.imus.entry(imu.stream).or_insert_with(latency_s)
    }
}

fn pose_source<'a>(
    run: &'a Run,
    places: &HashMap<usize, (usize, usize)>,
    stream: usize,
) -> Option<(&'a Arm, &'a PoseSource)> {
    let &(arm, place) = places.get(&stream)?;
    let arm = &run.arms[arm];
    Some((arm, &arm.poses[place]))
}

fn align_moving_bases(run: &mut Run, max_lag_s: f64) {
    for arm in 0..run.arms.len() {
        for source in 0..run.arms[arm].poses.len() {
            let of = &run.arms[arm];
            let stream = run.pose_stream(&of.poses[source]);
            let Some(lag) = estimate_moving_base_lag(&of.joints, &stream, max_lag_s) else {
                continue;
            };
            let source = &mut run.arms[arm].poses[source];
            let Some(base) = &mut source.moving_base else { continue };
            base.latency_s = lag.transform_latency_s;
            let late_s = lag.transform_latency_s.map_or(0.0, |latency| latency.value);
            base.motion.t_s.iter_mut().for_each(|t_s| *t_s -= late_s);
            source.retransform(lag.latency_s);
        }
    }
}

/// Transforms again if the latencies in `found` differ from those assumed. Returns whether any did.
pub(crate) fn realign_moving_bases(run: &mut Run, arm: usize, found: &ArmDiagnosis) -> bool {
    /// Maximum latency difference to ignore, s.
    const MAX_LATENCY_DIFFERENCE_S: f64 = 3e-4;
    let mut has_changed = false;
    for (source, found) in run.arms[arm].poses.iter_mut().zip(&found.streams) {
        let (Some(base), Ok(latency)) = (&source.moving_base, &found.latency_s) else { continue };
        if (latency.value - base.motion.lag_s).abs() > MAX_LATENCY_DIFFERENCE_S {
            source.retransform(latency.value);
            has_changed = true;
        }
    }
    has_changed
}

/// Assigns contested streams to the arm with the smallest residual; if similar, to that with the highest
/// correlation.
fn resolve_shared_streams(run: &mut Run, max_lag_s: f64) {
    /// Minimum correlation margin over the next arm.
    const MIN_CORRELATION_MARGIN: f64 = 0.1;
    let (named, shared): (Vec<_>, Vec<_>) =
        std::mem::take(&mut run.shared_streams).into_iter().partition(|shared| shared.is_named);
    let mut decided = exchanged_streams(run, named);
    for shared in shared {
        let mut scores: Vec<(usize, f64, f64)> = Vec::new();
        for candidate in &shared.candidates {
            let Some(arm) = run.arms.get(candidate.arm) else { continue };
            // Sources are in the order of the streams until the common diagnosis.
            let sources = with_key(&arm.poses, shared.stream, |source| source.stream);
            let Some(source) = sources.first() else { continue };
            let stream = run.pose_stream(source);
            let peak = best_lag_peak(&arm.joints, &stream, max_lag_s);
            let lag_s = peak.map_or(0.0, |peak| peak.lag_s);
            let misfits_m =
                [1.0, 1e-3].map(|scale| position_misfit_m(&arm.joints, &stream, scale, lag_s));
            let misfit_m = misfits_m.into_iter().flatten().fold(f64::INFINITY, f64::min);
            scores.push((candidate.arm, misfit_m, peak.map_or(0.0, |peak| peak.correlation)));
        }
        scores.sort_by(|a, b| a.1.total_cmp(&b.1));
        let nearest = match scores.as_slice() {
            [(arm, ..)] => Some(*arm),
            [(arm, near_m, _), (_, next_m, _), ..] if *near_m < MAX_RESIDUAL_RATIO * next_m => {
                Some(*arm)
            }
            _ => None,
        };
        scores.sort_by(|a, b| b.2.total_cmp(&a.2));
        let follower = match scores.as_slice() {
            [(arm, _, most), (_, _, next), ..] if most - next > MIN_CORRELATION_MARGIN => {
                Some(*arm)
            }
            _ => None,
        };
        decided.push((shared, nearest.or(follower)));
    }
    run.assign_shared_streams(&decided);
}

/// Arms of streams that names or frames assign to one arm, but that may follow another. A resting arm follows
/// anything, so a constant stream belongs to it if its own stream follows the arm that the stream is named
/// after.
fn exchanged_streams(run: &Run, named: Vec<SharedStream>) -> Vec<(SharedStream, Option<usize>)> {
    let named_arm = |shared: &SharedStream| shared.candidates.first().map(|one| one.arm);
    let followed: Vec<Option<usize>> =
        named.iter().map(|shared| arm_followed(run, &named, shared)).collect();
    let arm_of = |shared: &SharedStream, followed: Option<usize>, all: &[(usize, usize)]| {
        let named = named_arm(shared);
        let rests_with = |arm: usize| {
            let arm = run.arms.get(arm)?;
            let source = arm.poses.iter().find(|source| source.stream == shared.stream)?;
            source.rests_with(&arm.joints)
        };
        let moves = || named.and_then(rests_with) == Some(false);
        let mut resting = all
            .iter()
            .filter(|(_, followed)| Some(*followed) == named)
            .map(|(from, _)| *from)
            .filter(|&arm| rests_with(arm) == Some(true));
        followed.or_else(|| resting.next().filter(|_| moves())).or(named)
    };
    let all: Vec<(usize, usize)> = named
        .iter()
        .zip(&followed)
        .filter_map(|(shared, followed)| Some((named_arm(shared)?, (*followed)?)))
        .collect();
    let arms: Vec<Option<usize>> = named
        .iter()
        .zip(followed)
        .map(|(shared, followed)| arm_of(shared, followed, &all))
        .collect();
    named.into_iter().zip(arms).collect()
}

/// The only other arm that a stream follows. Arms may move alike, so that arm must have poses, too, and they
/// must not follow it.
fn arm_followed(run: &Run, named: &[SharedStream], shared: &SharedStream) -> Option<usize> {
    let follows = |arm: usize, is_wanted: &dyn Fn(&PoseSource) -> bool| {
        let Some(arm) = run.arms.get(arm) else { return false };
        let mut sources = arm.poses.iter().filter(|source| is_wanted(source));
        sources.any(|source| follows_as_logged(&arm.joints, &run.pose_stream(source)) == Some(true))
    };
    let is_own = |source: &PoseSource| source.stream == shared.stream;
    let followed = shared.candidates.iter().map(|one| one.arm).filter(|&arm| follows(arm, &is_own));
    let [arm] = <[usize; 1]>::try_from(followed.collect::<Vec<_>>()).ok()?;
    let is_named_after = |source: &PoseSource| {
        let other = named.iter().find(|other| other.stream == source.stream);
        other.is_none_or(|other| other.candidates.first().is_some_and(|first| first.arm == arm))
    };
    let has_streams = run.arms.get(arm)?.poses.iter().any(is_named_after);
    (has_streams && !follows(arm, &is_named_after)).then_some(arm)
}

/// Excludes streams with a pose that rests while the joints move the tool. Without a name of the tool, they are of objects. A
/// single value throughout, if not of one of several bodies, may also be the last of a publisher that stopped.
fn exclude_unmoved(run: &mut Run, max_lag_s: f64) {
    // A simulator's topic has all bodies of its world.
    let mut bodies: HashMap<&str, HashSet<&str>> = HashMap::new();
    for Stream { topic, child_frame_id, .. } in &run.streams {
        bodies.entry(topic).or_default().insert(child_frame_id);
    }
    let (mut objects, mut unmoved) = (Vec::new(), Vec::new());
    for arm in &run.arms {
        for source in &arm.poses {
            let Some(Stream { topic, role, .. }) = run.streams.get(source.stream) else { continue };
            let may_be_object = matches!(role, Role::Candidate { .. })
                && tool_word(topic).is_none()
                && source.moving_base.is_none()
                && arm.trajectory.is_none();
            let may_stop = match role {
                Role::Pose => true,
                Role::Candidate { presumed } => *presumed && bodies[topic.as_str()].len() == 1,
                _ => false,
            };
            let single = source.motion_at_single_value_m(&arm.joints).filter(|_| may_stop);
            if let Some(moved_m) = single {
                let samples = source.track.t_s.len();
                let reason = NotAuditedReason::NeverChanges { samples, moved_m };
                let why = "all its poses are the same while the joints move the tool".to_owned();
                unmoved.push((NotAudited { stream: source.stream, reason }, why));
            } else if may_be_object {
                let moved_m = run.motion_during_rests_m(arm, source, max_lag_s);
                objects.extend(moved_m.map(|moved_m| (source.stream, moved_m)));
            }
        }
    }
    run.exclude_objects(&objects);
    run.exclude(unmoved);
}

/// Excludes streams in whose frame the base moves unpredictably: constant causes cannot be estimated.
fn exclude_moving_bases(run: &mut Run, max_lag_s: f64) {
    let is_of_unknown_frame = |source: &&PoseSource| {
        let is_pose = run.streams.get(source.stream).is_some_and(|one| one.role == Role::Pose);
        is_pose && !source.reference_known && source.moving_base.is_none()
    };
    let mut moving: Vec<(usize, String, BaseMotion)> = Vec::new();
    for arm in &run.arms {
        for source in arm.poses.iter().filter(is_of_unknown_frame) {
            let travel = detect_base_motion(&arm.joints, &run.pose_stream(source), max_lag_s);
            let base = source.chain.base_name().to_owned();
            moving.extend(travel.map(|travel| (source.stream, base, travel)));
        }
    }
    let excluded = moving.into_iter().map(|(stream, base, BaseMotion { travel_m, turn_rad })| {
        let frame = run.streams.get(stream).map_or_else(String::new, |one| one.frame_id.clone());
        let reason =
            format!("'{base}' moves in its frame '{frame}', and the log has no transforms for it");
        let why = NotAuditedReason::BaseMoves { frame, base, travel_m, turn_rad };
        (NotAudited { stream, reason: why }, reason)
    });
    let excluded = excluded.collect();
    run.exclude(excluded);
}

/// Minimum correlation of angular speeds of target and hand.
const MIN_ROTATION_CORRELATION: f64 = 0.7;

/// Without an arm, selects the hands that rotate with a target.
fn resolve_hands(run: &mut Run, max_lag_s: f64) {
    let mut found = Vec::new();
    for target in &run.targets {
        let Some(series) = PoseSeries::from_track(&target.track) else { continue };
        let turns_alike = |hand: &HandSource| {
            let HandKind::Stream { stream, track } = &hand.kind else { return None };
            let peaks = rotation_lag_peaks(&PoseSeries::from_track(track)?, &series, max_lag_s);
            Some((*stream, peaks.first()?.correlation))
        };
        let best = target.hands.iter().filter_map(turns_alike).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((hand, correlation)) = best.filter(|best| best.1 >= MIN_ROTATION_CORRELATION) {
            found.push((hand, run.streams[target.stream].topic.clone(), correlation));
        }
    }
    for (hand, topic, correlation) in found {
        run.resolve_hand(hand, &topic, correlation);
    }
}
