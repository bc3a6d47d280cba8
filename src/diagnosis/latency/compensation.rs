//! Diagnoses streams with a variable latency after correcting their stamps.

use crate::changes::{
    constant_frames_suffice, diagnose_with_changes, has_latency_steps, has_slow_residual,
};
use crate::compliance::{diagnose_with_compliance, prefers_compliance};
use crate::imu::diagnose_mended;
use crate::{
    ArmDiagnosis, CoarseLatencyChange, EstimateResult, ImuConventions, ImuDiagnosis, ImuStream,
    JointEncoding, LatencyProfile, LatencyRamp, PoseStream, detect_imu_latency_changes,
    detect_pose_latency_changes, diagnose_arm,
};
use ground::stream::{DeclaredUnits, ImuTrack, JointTrack, Orientations, PoseTrack};
use rayon::prelude::*;

const MAX_REFINEMENTS: usize = 2;

/// Diagnoses an arm's pose streams. Compensates a variable latency first, so its effects are not attributed
/// to another cause.
pub fn diagnose_with_latency_compensation(
    joints: &JointTrack,
    streams: &[PoseStream],
    slides: &[bool],
    most_lag_s: f64,
) -> ArmDiagnosis {
    let changes_by = |joints: &JointTrack| -> Vec<Option<CoarseLatencyChange>> {
        streams
            .par_iter()
            .map(|stream| detect_pose_latency_changes(joints, stream, most_lag_s))
            .collect()
    };
    let mut changes = changes_by(joints);
    let mut found = diagnose_without_coarse_changes(joints, streams, &changes, most_lag_s);
    let is_misread = !found.joints.encoding.as_ref().is_ok_and(JointEncoding::is_as_logged);
    if is_misread && changes.iter().all(Option::is_none) {
        // Misread joints and latency changes hide each other.
        let mended = match &found.joints.encoding {
            Ok(_) => found.joints.corrected_joints(joints, slides),
            Err(_) => {
                let mut radians = joints.clone();
                radians.convert_from_degrees(slides);
                radians
            }
        };
        changes = changes_by(&mended);
        if changes.iter().any(Option::is_some) {
            found = diagnose_without_coarse_changes(joints, streams, &changes, most_lag_s);
        }
    }
    for _ in 0..MAX_REFINEMENTS {
        let both = changes.iter_mut().zip(&found.streams);
        if both.filter_map(|(change, found)| refine_ramp(change, &found.latency_profile)).count()
            == 0
        {
            break;
        }
        found = diagnose_without_coarse_changes(joints, streams, &changes, most_lag_s);
    }
    let steps: Vec<_> =
        changes.iter().map(|change| change.as_ref().and_then(CoarseLatencyChange::steps)).collect();
    // Ramps stay in the estimated profile; only steps are removed.
    let unstepped: Vec<Option<PoseTrack>> = streams
        .iter()
        .zip(&steps)
        .map(|(stream, steps)| {
            Some(with_stamps(stream.track, &(*steps)?.compensated(&stream.track.t_s)))
        })
        .collect();
    let streams = with_tracks(streams, &unstepped);
    let mut tracks = Vec::new();
    let mut courses = Vec::new();
    for ((stream, found), change) in streams.iter().zip(&found.streams).zip(&changes) {
        tracks.push(compensate_latency(stream, &found.latency_profile));
        courses.push(match change.as_ref().and_then(CoarseLatencyChange::steps) {
            Some(steps) => Ok(steps.profile(&found.latency_profile)),
            None => found.latency_profile.clone(),
        });
    }
    let mut steady = if tracks.iter().all(Option::is_none) {
        found
    } else {
        diagnose_arm(joints, &with_tracks(&streams, &tracks), most_lag_s)
    };
    // Profiles on stamps with large errors are approximate; refine once.
    let mut is_bettered = false;
    for s in 0..streams.len() {
        if steps[s].is_some() || tracks[s].is_none() {
            continue;
        }
        let (Ok(course), Ok(rest)) = (&courses[s], &steady.streams[s].latency_profile) else {
            continue;
        };
        let better = course.clone().combined_with(rest);
        if better != *course {
            let track = streams[s].track;
            tracks[s] = Some(with_stamps(track, &better.compensated(&track.t_s)));
            (courses[s], is_bettered) = (Ok(better), true);
        }
    }
    if is_bettered {
        steady = diagnose_arm(joints, &with_tracks(&streams, &tracks), most_lag_s);
    }
    // Profiles of large steps are already relative to the lowest level.
    for ((course, stream), steps) in courses.iter_mut().zip(&streams).zip(&steps) {
        if let (Ok(unsteady), None) = (course.as_mut(), steps)
            && unsteady.is_unsteady
        {
            *unsteady = unsteady.clone().relative_to_typical(&stream.track.t_s);
        }
    }
    let unsteadied = with_tracks(&streams, &tracks);
    let is_within_links = constant_frames_suffice(&steady);
    let by_bend = diagnose_with_compliance(joints, &unsteadied, slides, &steady, most_lag_s);
    // Link deviations look like sag and eccentricity, not like backlash.
    let is_smooth =
        |bent: &ArmDiagnosis| bent.joints.compliance.iter().any(|bend| !bend.is_backlash());
    let by_bend = by_bend.filter(|bent| !is_within_links || !is_smooth(bent));
    let is_enough = |bent: &ArmDiagnosis| {
        !bent.joints.compliance.is_empty() && !bent.streams.iter().any(has_slow_residual)
    };
    // Backlash with few reversals resembles a changing zero or frame.
    let most = if by_bend.as_ref().is_some_and(is_enough) { 1 } else { usize::MAX };
    let by_change = match is_within_links {
        true => None,
        false => diagnose_with_changes(joints, &unsteadied, slides, &steady, most_lag_s, most),
    };
    let (changed, otherwise) = match (by_change, by_bend) {
        (Some(change), Some(bend)) => match prefers_compliance(&bend, &change) {
            true => (false, Some(bend)),
            false => (true, Some(change)),
        },
        (change, bend) => (change.is_some(), change.or(bend)),
    };
    if let Some(otherwise) = otherwise {
        steady = otherwise;
    }
    for (steady, course) in steady.streams.iter_mut().zip(courses) {
        if !changed || !has_latency_steps(steady) {
            steady.latency_profile = course;
        }
    }
    steady
}

/// Refines a ramp with the profile of the compensated stream. If that is constant, the speeds differ for
/// another reason. `None` if nothing changes.
fn refine_ramp(
    change: &mut Option<CoarseLatencyChange>,
    course: &EstimateResult<LatencyProfile>,
) -> Option<()> {
    let Some(CoarseLatencyChange::Ramp(gradual, otherwise)) = change else { return None };
    match course.as_ref().ok().filter(|course| course.is_unsteady) {
        Some(course) => *gradual = LatencyRamp::from_profile(course)?,
        None => *change = otherwise.take().map(CoarseLatencyChange::Steps),
    }
    Some(())
}

fn diagnose_without_coarse_changes(
    joints: &JointTrack,
    streams: &[PoseStream],
    changes: &[Option<CoarseLatencyChange>],
    most_lag_s: f64,
) -> ArmDiagnosis {
    let of_stream = |(stream, change): (&PoseStream, &Option<CoarseLatencyChange>)| {
        let rows = change.as_ref()?.compensated(&stream.track.t_s);
        Some(with_stamps(stream.track, &rows))
    };
    let tracks: Vec<Option<PoseTrack>> = streams.iter().zip(changes).map(of_stream).collect();
    let mut streams = with_tracks(streams, &tracks);
    for (stream, change) in streams.iter_mut().zip(changes) {
        stream.removed_ramp = change.as_ref().and_then(CoarseLatencyChange::ramp);
    }
    diagnose_arm(joints, &streams, most_lag_s)
}

/// Replaces the given tracks.
fn with_tracks<'a>(
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
    most_lag_s: f64,
) -> ImuDiagnosis {
    let numbers = ImuConventions::detect(joints, &stream, most_lag_s);
    let mended = numbers.convert(stream.track);
    let stream = ImuStream { track: &mended, ..stream };
    let of_rows = |rows: &[(usize, f64)]| ImuTrack {
        t_s: rows.iter().map(|&(_, t_s)| t_s).collect(),
        orientation: rows
            .iter()
            .filter_map(|&(row, _)| stream.track.orientation.get(row).copied())
            .collect(),
        gyro: rows.iter().map(|&(row, _)| stream.track.gyro[row]).collect(),
        accel: rows.iter().map(|&(row, _)| stream.track.accel[row]).collect(),
    };
    let diagnosed = |track: &ImuTrack, taken_off: Option<&LatencyRamp>| {
        let stream = ImuStream { track, removed_ramp: taken_off, ..stream };
        diagnose_mended(joints, &stream, &numbers, most_lag_s)
    };
    let t_s = &stream.track.t_s;
    let unchanged = |change: &Option<CoarseLatencyChange>| match change {
        Some(change) => diagnosed(&of_rows(&change.compensated(t_s)), change.ramp()),
        None => diagnosed(stream.track, None),
    };
    let mut change = detect_imu_latency_changes(joints, &stream, most_lag_s);
    let mut found = unchanged(&change);
    let small = found.latency_profile.as_ref().ok().filter(|course| course.is_unsteady);
    let small =
        small.and_then(LatencyRamp::from_profile).map(|it| CoarseLatencyChange::Ramp(it, None));
    change = change.or(small);
    for _ in 0..MAX_REFINEMENTS {
        if refine_ramp(&mut change, &found.latency_profile).is_none() {
            break;
        }
        found = unchanged(&change);
    }
    // See above: only steps are removed.
    let steps = change.as_ref().and_then(CoarseLatencyChange::steps);
    let stepping = steps.map(|steps| steps.profile(&found.latency_profile));
    let unsteady = found.latency_profile.as_ref().ok().filter(|course| course.is_unsteady);
    let Some(course) = unsteady else {
        let latency_course = stepping.map_or(found.latency_profile.clone(), Ok);
        return ImuDiagnosis { latency_profile: latency_course, ..found };
    };
    let unstepped = steps.map(|steps| steps.compensated(t_s));
    let rows = match &unstepped {
        None => course.compensated(t_s),
        // The profile refers to unstepped stamps.
        Some(rows) => {
            let unstepped_s: Vec<f64> = rows.iter().map(|&(_, t_s)| t_s).collect();
            let straight = course.compensated(&unstepped_s).into_iter();
            straight.map(|(at, t_s)| (rows[at].0, t_s)).collect()
        }
    };
    let steady = diagnosed(&of_rows(&rows), None);
    let told = stepping.unwrap_or_else(|| {
        let finer =
            steady.latency_profile.as_ref().ok().map(|rest| course.clone().combined_with(rest));
        finer.unwrap_or_else(|| course.clone()).relative_to_typical(t_s)
    });
    ImuDiagnosis { latency_profile: Ok(told), ..steady }
}

/// Poses with stamps corrected to a constant latency. `None` if it is constant.
pub fn compensate_latency(
    stream: &PoseStream,
    course: &EstimateResult<LatencyProfile>,
) -> Option<PoseTrack> {
    let course = course.as_ref().ok().filter(|course| course.is_unsteady)?;
    Some(with_stamps(stream.track, &course.compensated(&stream.track.t_s)))
}

/// Selects rows and replaces their stamps.
pub(crate) fn with_stamps(track: &PoseTrack, rows: &[(usize, f64)]) -> PoseTrack {
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
