//! Diagnoses streams with a variable latency after correcting their stamps.

use crate::arm::diagnose_arm;
use crate::arm_run::ArmRun;
use crate::changes::latency_steps;
use crate::imu::diagnose_converted_imu;
use crate::priors::price_of_cause;
use crate::residuals::cause_columns::CauseColumns;
use crate::residuals::comparison::{residual_m, residual_of_shares_m};
use crate::{
    ArmDiagnosis, CoarseLatencyChange, EstimateResult, ImuConventions, ImuDiagnosis, ImuStream,
    JointEncoding, LatencyProfile, LatencyRamp, PoseDiagnosis, PoseStream,
    detect_imu_latency_changes, detect_pose_latency_changes,
};
use ground::geometry::Pose;
use ground::stream::{DeclaredUnits, ImuTrack, JointTrack, Orientations, PoseTrack};
use rayon::prelude::*;

const MAX_REFINEMENTS: usize = 2;

/// Run with constant latencies.
pub(crate) struct CompensatedRun {
    /// Tracks with corrected stamps, per stream. `None` if the latency is constant.
    pub tracks: Vec<Option<PoseTrack>>,
    /// Latencies over the run.
    pub profiles: Vec<EstimateResult<LatencyProfile>>,
    /// With constant causes.
    pub diagnosis: ArmDiagnosis,
}

impl CompensatedRun {
    /// Compensates a variable latency, so its effects are not attributed to another cause.
    pub fn new(run: &ArmRun) -> Self {
        let ArmRun { joints, streams, is_prismatic, max_lag_s } = *run;
        let detect_changes = |joints: &JointTrack| -> Vec<Option<CoarseLatencyChange>> {
            streams
                .par_iter()
                .map(|stream| detect_pose_latency_changes(joints, stream, max_lag_s))
                .collect()
        };
        let mut changes = detect_changes(joints);
        let mut first = diagnose_without_coarse_changes(joints, streams, &changes, max_lag_s);
        let size_m = |diagnosis: &ArmDiagnosis, changes: &[Option<CoarseLatencyChange>]| {
            residual_of_shares_m(diagnosis, &compared_shares(joints, streams, changes))
        };
        if changes.iter().any(Option::is_some) {
            // Misread joints change the speeds as well.
            let none = vec![None; streams.len()];
            let as_logged = diagnose_without_coarse_changes(joints, streams, &none, max_lag_s);
            if size_m(&as_logged, &none) <= size_m(&first, &changes) {
                (changes, first) = (none, as_logged);
            }
        }
        let as_detected = changes.clone();
        let diagnose_without =
            |changes: &[Option<CoarseLatencyChange>]| match changes == as_detected {
                true => first.clone(),
                false => diagnose_without_coarse_changes(joints, streams, changes, max_lag_s),
            };
        let mut diagnosis = first.clone();
        let are_joints_misinterpreted =
            !diagnosis.joints.encoding.as_ref().is_ok_and(JointEncoding::is_as_logged);
        if are_joints_misinterpreted && changes.iter().all(Option::is_none) {
            // Misread joints and latency changes hide each other.
            let corrected = match &diagnosis.joints.encoding {
                Ok(_) => diagnosis.joints.corrected_joints(joints, is_prismatic),
                Err(_) => {
                    let mut radians = joints.clone();
                    radians.convert_from_degrees(is_prismatic);
                    radians
                }
            };
            let by_corrected = detect_changes(&corrected);
            if by_corrected.iter().any(Option::is_some) {
                let changed = diagnose_without(&by_corrected);
                if residual_m(&changed) < residual_m(&diagnosis) {
                    (changes, diagnosis) = (by_corrected, changed);
                }
            }
        }
        for _ in 0..MAX_REFINEMENTS {
            let both = changes.iter_mut().zip(&diagnosis.streams);
            if both
                .filter_map(|(change, diagnosis)| refine_ramp(change, &diagnosis.latency_profile))
                .count()
                == 0
            {
                break;
            }
            diagnosis = diagnose_without(&changes);
        }
        let steps_instead = changes.iter().map(|it| it.as_ref().map(CoarseLatencyChange::or_steps));
        let steps_instead: Vec<Option<CoarseLatencyChange>> = steps_instead.collect();
        if steps_instead != changes {
            let stepped = diagnose_without(&steps_instead);
            if size_m(&stepped, &steps_instead) < size_m(&diagnosis, &changes) {
                (changes, diagnosis) = (steps_instead, stepped);
            }
        }
        if changes.iter().all(Option::is_none)
            && let Some(profiles) = steps_beside_links(run, &diagnosis)
        {
            for (found, profile) in diagnosis.streams.iter_mut().zip(profiles) {
                found.latency_profile = profile.map_or(found.latency_profile.clone(), Ok);
            }
        }
        let steps: Vec<_> = changes
            .iter()
            .map(|change| change.as_ref().and_then(CoarseLatencyChange::steps))
            .collect();
        // Ramps stay in the estimated profile; only steps are removed.
        let step_free_tracks: Vec<Option<PoseTrack>> = streams
            .iter()
            .zip(&steps)
            .map(|(stream, steps)| {
                Some(with_stamps(stream, &(*steps)?.compensated(&stream.track.t_s)))
            })
            .collect();
        let streams = with_tracks(streams, &step_free_tracks);
        let mut tracks = Vec::new();
        let mut profiles = Vec::new();
        for ((stream, diagnosis), change) in streams.iter().zip(&diagnosis.streams).zip(&changes) {
            tracks.push(compensate_latency(stream, &diagnosis.latency_profile));
            profiles.push(match change.as_ref().and_then(CoarseLatencyChange::steps) {
                Some(steps) => Ok(steps.profile(&diagnosis.latency_profile)),
                None => diagnosis.latency_profile.clone(),
            });
        }
        let mut compensated = if tracks.iter().all(Option::is_none) {
            diagnosis
        } else {
            diagnose_arm(joints, &with_tracks(&streams, &tracks), max_lag_s)
        };
        // Profiles on stamps with large errors are approximate; refine once.
        let mut is_refined = false;
        for s in 0..streams.len() {
            if steps[s].is_some() || tracks[s].is_none() {
                continue;
            }
            let (Ok(profile), Ok(rest)) = (&profiles[s], &compensated.streams[s].latency_profile)
            else {
                continue;
            };
            let refined = profile.clone().combined_with(rest);
            if refined != *profile {
                let rows = refined.compensated(&streams[s].track.t_s);
                tracks[s] = Some(with_stamps(&streams[s], &rows));
                (profiles[s], is_refined) = (Ok(refined), true);
            }
        }
        if is_refined {
            compensated = diagnose_arm(joints, &with_tracks(&streams, &tracks), max_lag_s);
        }
        // Profiles of large steps are already relative to the lowest level.
        for ((profile, stream), steps) in profiles.iter_mut().zip(&streams).zip(&steps) {
            if let (Ok(unsteady), None) = (profile.as_mut(), steps)
                && unsteady.is_unsteady
            {
                *unsteady = unsteady.clone().relative_to_typical(&stream.track.t_s);
            }
        }
        for (track, step_free) in tracks.iter_mut().zip(&step_free_tracks) {
            *track = track.take().or_else(|| step_free.clone());
        }
        Self { tracks, profiles, diagnosis: compensated }
    }
}

/// Profiles of streams whose latency steps, if no other profile is unsteady. All streams must still follow FK, and steps
/// beside link deviations must be likelier than none.
fn steps_beside_links(
    run: &ArmRun,
    constant: &ArmDiagnosis,
) -> Option<Vec<Option<LatencyProfile>>> {
    let is_unsteady =
        |found: &PoseDiagnosis| found.latency_profile.as_ref().is_ok_and(|it| it.is_unsteady);
    if constant.streams.iter().any(is_unsteady) {
        return None;
    }
    let found = constant.streams.iter().zip(run.streams);
    let profiles: Vec<Option<LatencyProfile>> =
        found.map(|(found, stream)| latency_steps(found, stream.chain)).collect();
    let tracks: Vec<Option<PoseTrack>> = profiles
        .iter()
        .zip(run.streams)
        .map(|(profile, stream)| {
            let rows = profile.as_ref()?.compensated(&stream.track.t_s);
            Some(with_stamps(stream, &rows))
        })
        .collect();
    if tracks.iter().all(Option::is_none) {
        return None;
    }
    let stepped = diagnose_arm(run.joints, &with_tracks(run.streams, &tracks), run.max_lag_s);
    let follows = |found: &PoseDiagnosis| found.residual.is_ok() && !found.is_far_from_fk();
    let mut both = constant.streams.iter().zip(&stepped.streams);
    if both.any(|(before, after)| follows(before) && !follows(after)) {
        return None;
    }
    let worth = |s: usize| -> f64 {
        let [before, after] = [constant, &stepped].map(|diagnosis| {
            CauseColumns::new(&diagnosis.streams[s], run.streams[s].chain).unexplained_noise()
        });
        let gains = before.iter().zip(&after).map(|((before, _), (after, independent))| {
            2.0 * independent * (before.sigma / after.sigma).ln()
        });
        let steps = profiles[s].as_ref().map_or(0, |profile| profile.steps.len());
        let independent = after.iter().map(|(_, independent)| independent).sum();
        match steps {
            0 => gains.sum::<f64>(),
            steps => gains.sum::<f64>() - price_of_cause(2 * steps, independent),
        }
    };
    ((0..run.streams.len()).map(worth).sum::<f64>() > 0.0).then_some(profiles)
}

/// Refines a ramp with the profile of the compensated stream. If that is constant, the speeds differ for
/// another reason. `None` if nothing changes.
fn refine_ramp(
    change: &mut Option<CoarseLatencyChange>,
    profile: &EstimateResult<LatencyProfile>,
) -> Option<()> {
    let Some(CoarseLatencyChange::Ramp(ramp, steps)) = change else { return None };
    match profile.as_ref().ok().filter(|profile| profile.is_unsteady) {
        Some(profile) => *ramp = LatencyRamp::from_profile(profile)?,
        None => *change = steps.take().map(CoarseLatencyChange::Steps),
    }
    Some(())
}

fn diagnose_without_coarse_changes(
    joints: &JointTrack,
    streams: &[PoseStream],
    changes: &[Option<CoarseLatencyChange>],
    max_lag_s: f64,
) -> ArmDiagnosis {
    let of_stream = |(stream, change): (&PoseStream, &Option<CoarseLatencyChange>)| {
        let rows = change.as_ref()?.compensated(&stream.track.t_s);
        Some(with_stamps(stream, &rows))
    };
    let tracks: Vec<Option<PoseTrack>> = streams.iter().zip(changes).map(of_stream).collect();
    let mut streams = with_tracks(streams, &tracks);
    for (stream, change) in streams.iter_mut().zip(changes) {
        stream.removed_ramp = change.as_ref().and_then(CoarseLatencyChange::ramp);
    }
    diagnose_arm(joints, &streams, max_lag_s)
}

/// Shares of the rows of streams that are within the times of the joint states.
fn compared_shares(
    joints: &JointTrack,
    streams: &[PoseStream],
    changes: &[Option<CoarseLatencyChange>],
) -> Vec<f64> {
    let (Some(&first_s), Some(&last_s)) = (joints.t_s.first(), joints.t_s.last()) else {
        return vec![0.0; streams.len()];
    };
    let share = |(stream, change): (&PoseStream, &Option<CoarseLatencyChange>)| {
        let t_s = &stream.track.t_s;
        let is_compared = |t_s: &f64| (first_s..=last_s).contains(t_s);
        let compared = match change {
            Some(change) => {
                change.compensated(t_s).iter().filter(|row| is_compared(&row.1)).count()
            }
            None => t_s.iter().filter(|t_s| is_compared(t_s)).count(),
        };
        compared as f64 / t_s.len().max(1) as f64
    };
    streams.iter().zip(changes).map(share).collect()
}

/// Streams with other tracks, if there are any.
pub(crate) fn with_tracks<'a>(
    streams: &[PoseStream<'a>],
    tracks: &'a [Option<PoseTrack>],
) -> Vec<PoseStream<'a>> {
    let with = |(stream, track): (&PoseStream<'a>, &'a Option<PoseTrack>)| PoseStream {
        track: track.as_ref().unwrap_or(stream.track),
        ..*stream
    };
    streams.iter().zip(tracks).map(with).collect()
}

/// Same for an IMU.
pub fn diagnose_imu_with_latency_compensation(
    joints: &JointTrack,
    stream: ImuStream,
    max_lag_s: f64,
) -> ImuDiagnosis {
    let conventions = ImuConventions::detect(joints, &stream, max_lag_s);
    let corrected = conventions.convert(stream.track);
    let stream = ImuStream { track: &corrected, ..stream };
    let of_rows = |rows: &[(usize, f64)]| ImuTrack {
        t_s: rows.iter().map(|&(_, t_s)| t_s).collect(),
        orientation: rows
            .iter()
            .filter_map(|&(row, _)| stream.track.orientation.get(row).copied())
            .collect(),
        gyro: rows.iter().map(|&(row, _)| stream.track.gyro[row]).collect(),
        accel: rows.iter().map(|&(row, _)| stream.track.accel[row]).collect(),
    };
    let diagnosed = |track: &ImuTrack, removed_ramp: Option<&LatencyRamp>| {
        let stream = ImuStream { track, removed_ramp, ..stream };
        diagnose_converted_imu(joints, &stream, &conventions, max_lag_s)
    };
    let t_s = &stream.track.t_s;
    let diagnose_with = |change: &Option<CoarseLatencyChange>| match change {
        Some(change) => diagnosed(&of_rows(&change.compensated(t_s)), change.ramp()),
        None => diagnosed(stream.track, None),
    };
    let mut change = detect_imu_latency_changes(joints, &stream, max_lag_s);
    let mut diagnosis = diagnose_with(&change);
    let small_ramp = diagnosis.latency_profile.as_ref().ok().filter(|profile| profile.is_unsteady);
    let small_ramp = small_ramp
        .and_then(LatencyRamp::from_profile)
        .map(|it| CoarseLatencyChange::Ramp(it, None));
    change = change.or(small_ramp);
    for _ in 0..MAX_REFINEMENTS {
        if refine_ramp(&mut change, &diagnosis.latency_profile).is_none() {
            break;
        }
        diagnosis = diagnose_with(&change);
    }
    // See above: only steps are removed.
    let steps = change.as_ref().and_then(CoarseLatencyChange::steps);
    let step_profile = steps.map(|steps| steps.profile(&diagnosis.latency_profile));
    let unsteady = diagnosis.latency_profile.as_ref().ok().filter(|profile| profile.is_unsteady);
    let Some(profile) = unsteady else {
        let latency_profile = step_profile.map_or(diagnosis.latency_profile.clone(), Ok);
        return ImuDiagnosis { latency_profile, ..diagnosis };
    };
    let step_free = steps.map(|steps| steps.compensated(t_s));
    let rows = match &step_free {
        None => profile.compensated(t_s),
        // The profile refers to unstepped stamps.
        Some(rows) => {
            let unstepped_s: Vec<f64> = rows.iter().map(|&(_, t_s)| t_s).collect();
            let compensated = profile.compensated(&unstepped_s).into_iter();
            compensated.map(|(at, t_s)| (rows[at].0, t_s)).collect()
        }
    };
    let steady = diagnosed(&of_rows(&rows), None);
    let final_profile = step_profile.unwrap_or_else(|| {
        let finer =
            steady.latency_profile.as_ref().ok().map(|rest| profile.clone().combined_with(rest));
        finer.unwrap_or_else(|| profile.clone()).relative_to_typical(t_s)
    });
    ImuDiagnosis { latency_profile: Ok(final_profile), ..steady }
}

/// Poses with stamps corrected to a constant latency. `None` if it is constant.
pub fn compensate_latency(
    stream: &PoseStream,
    profile: &EstimateResult<LatencyProfile>,
) -> Option<PoseTrack> {
    let profile = profile.as_ref().ok().filter(|profile| profile.is_unsteady)?;
    Some(with_stamps(stream, &profile.compensated(&stream.track.t_s)))
}

/// These rows of a stream with other stamps. Poses in a moving frame are transformed to the base at these; rows without a
/// transform are dropped.
pub(crate) fn with_stamps(stream: &PoseStream, rows: &[(usize, f64)]) -> PoseTrack {
    let PoseStream { track, moving_frame, .. } = *stream;
    let Some(frame) = moving_frame else { return with_rows(track, rows) };
    let moved = rows.iter().filter_map(|&(row, t_s)| {
        Some(((row, t_s), frame.base_at(t_s, track.t_s[row] - frame.lag_s)?))
    });
    let (rows, bases): (Vec<_>, Vec<Pose>) = moved.unzip();
    let mut track = with_rows(track, &rows);
    for (xyz, base) in track.xyz.iter_mut().zip(&bases) {
        *xyz = base.rotation * *xyz + base.translation.vector;
    }
    if let Orientations::Rotations(rotations) = &mut track.orientation {
        rotations.iter_mut().zip(&bases).for_each(|(own, base)| *own = base.rotation * *own);
    }
    track
}

fn with_rows(track: &PoseTrack, rows: &[(usize, f64)]) -> PoseTrack {
    let declared = track.declared.as_ref().map(|declared| DeclaredUnits {
        in_other_angles: declared
            .in_other_angles
            .as_ref()
            .map(|all| rows.iter().map(|&(row, _)| all[row]).collect()),
        ..*declared
    });
    let orientation = match &track.orientation {
        Orientations::Rotations(all) => {
            Orientations::Rotations(rows.iter().map(|&(row, _)| all[row]).collect())
        }
        Orientations::Numbers(all) => {
            Orientations::Numbers(rows.iter().map(|&(row, _)| all[row]).collect())
        }
        Orientations::Unset(_) => Orientations::Unset(rows.len()),
    };
    PoseTrack {
        t_s: rows.iter().map(|&(_, t_s)| t_s).collect(),
        xyz: rows.iter().map(|&(row, _)| track.xyz[row]).collect(),
        orientation,
        declared,
    }
}
