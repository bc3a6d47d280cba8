//! Diagnoses streams with a variable latency after correcting their stamps.

use crate::arm::diagnose_arm;
use crate::arm_run::ArmRun;
use crate::imu::diagnose_converted_imu;
use crate::residuals::comparison::residual_of_shares_m;
use crate::{
    ArmDiagnosis, CoarseLatencyChange, EstimateResult, ImuConventions, ImuDiagnosis, ImuStream,
    JointDiagnosis, LatencyProfile, PiecewiseLatency, PoseStream, detect_imu_latency_changes,
    detect_pose_latency_changes,
};
use ground::geometry::Pose;
use ground::stream::{ImuTrack, JointTrack, Orientations, PoseTrack};
use rayon::prelude::*;

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
        let (changes, diagnosis) = refine_changes(
            likeliest_changes(run),
            |changes| diagnose_without(run, changes),
            |diagnosis| diagnosis.streams.iter().map(|found| &found.latency_profile).collect(),
        );
        let steps = changes.iter().map(|it| it.as_ref().filter(|it| it.has_steps()));
        let steps: Vec<Option<&CoarseLatencyChange>> = steps.collect();
        // Ramps stay in the estimated profile; only steps are removed.
        let step_free = tracks_with_stamps(run.streams, |s, t_s| Some(steps[s]?.compensated(t_s)));
        let streams = with_tracks(run.streams, &step_free);
        let found = streams.iter().zip(&diagnosis.streams);
        let tracks: Vec<Option<PoseTrack>> = found
            .map(|(stream, found)| compensate_latency(stream, &found.latency_profile))
            .collect();
        let profile = |s: usize| {
            let found = &diagnosis.streams[s].latency_profile;
            reported_profile(found, steps[s], &streams[s].track.t_s)
        };
        let profiles = (0..streams.len()).map(profile).collect();
        let diagnosis = match tracks.iter().all(Option::is_none) {
            true => diagnosis,
            false => diagnose_arm(run.joints, &with_tracks(&streams, &tracks), run.max_lag_s),
        };
        let tracks =
            tracks.into_iter().zip(step_free).map(|(track, step_free)| track.or(step_free));
        Self { tracks: tracks.collect(), profiles, diagnosis }
    }
}

/// Large changes of latencies, per stream.
type Changes = Vec<Option<CoarseLatencyChange>>;

/// Diagnosis of the run without these changes.
fn diagnose_without(run: &ArmRun, changes: &Changes) -> ArmDiagnosis {
    let tracks =
        tracks_with_stamps(run.streams, |s, t_s| Some(changes[s].as_ref()?.compensated(t_s)));
    let mut streams = with_tracks(run.streams, &tracks);
    for (stream, change) in streams.iter_mut().zip(changes) {
        stream.removed_ramp = removed_ramp(change);
    }
    diagnose_arm(run.joints, &streams, run.max_lag_s)
}

/// The likeliest changes by speeds, and the diagnosis without them.
fn likeliest_changes(run: &ArmRun) -> (Changes, ArmDiagnosis) {
    let detect = |joints: &JointTrack| -> Changes {
        let streams = run.streams.par_iter();
        streams.map(|stream| detect_pose_latency_changes(joints, stream, run.max_lag_s)).collect()
    };
    let without = |changes: Changes| {
        let diagnosis = diagnose_without(run, &changes);
        (changes, diagnosis)
    };
    let residual_m = |(changes, diagnosis): &(Changes, ArmDiagnosis)| {
        residual_of_shares_m(diagnosis, &compared_shares(run.joints, run.streams, changes))
    };
    // The second one if its residual is smaller.
    let better = |one, other| if residual_m(&other) < residual_m(&one) { other } else { one };
    let none = vec![None; run.streams.len()];
    let mut likeliest = without(detect(run.joints));
    if likeliest.0 != none {
        // Misread joints change the speeds as well.
        likeliest = better(without(none.clone()), likeliest);
    }
    if likeliest.0 == none
        && let Some(joints) = corrected_joints(run, &likeliest.1.joints)
    {
        // Misread joints and latency changes hide each other.
        let changes = detect(&joints);
        if changes != none {
            likeliest = better(likeliest, without(changes));
        }
    }
    likeliest
}

/// `None` if the joint states are as logged.
fn corrected_joints(run: &ArmRun, found: &JointDiagnosis) -> Option<JointTrack> {
    match &found.encoding {
        Ok(encoding) if encoding.is_as_logged() => None,
        Ok(_) => Some(found.corrected_joints(run.joints, run.is_prismatic)),
        Err(_) => {
            let mut radians = run.joints.clone();
            radians.convert_from_degrees(run.is_prismatic);
            Some(radians)
        }
    }
}

/// Changes that the latencies of the diagnosis without them confirm and refine, and the diagnosis without the refined ones.
fn refine_changes<D>(
    (mut changes, mut diagnosis): (Changes, D),
    diagnose_without: impl Fn(&Changes) -> D,
    profiles: impl Fn(&D) -> Vec<&EstimateResult<LatencyProfile>>,
) -> (Changes, D) {
    // A profile is accurate once its effects on other causes are removed.
    for refined in [confirmed, with_profile, confirmed] {
        let both = changes.iter().zip(profiles(&diagnosis));
        let better: Changes = both.map(|(change, profile)| refined(change, profile)).collect();
        if better != changes {
            diagnosis = diagnose_without(&better);
            changes = better;
        }
    }
    (changes, diagnosis)
}

/// The change, unless it is a ramp of a stream whose latency is constant: its speeds differ for another reason.
fn confirmed(
    change: &Option<CoarseLatencyChange>,
    profile: &EstimateResult<LatencyProfile>,
) -> Option<CoarseLatencyChange> {
    let varies = profile.as_ref().is_ok_and(|profile| profile.is_unsteady);
    change.clone().filter(|change| change.has_steps() || varies)
}

/// The estimated latency, unless the change has steps.
fn with_profile(
    change: &Option<CoarseLatencyChange>,
    profile: &EstimateResult<LatencyProfile>,
) -> Option<CoarseLatencyChange> {
    let varies = |it: &&LatencyProfile| it.is_unsteady && it.levels.knots.len() > 1;
    let profile = profile.as_ref().ok().filter(varies);
    let has_steps = change.as_ref().is_some_and(CoarseLatencyChange::has_steps);
    let profile = profile.filter(|_| !has_steps);
    let ramp = profile.map(|profile| CoarseLatencyChange::ramp(profile.levels.clone()));
    ramp.or_else(|| change.clone())
}

/// The latency, unless it steps.
fn removed_ramp(change: &Option<CoarseLatencyChange>) -> Option<&PiecewiseLatency> {
    Some(&change.as_ref().filter(|it| !it.has_steps())?.latency)
}

/// Profile with the removed steps, or relative to the typical latency at the stamps.
fn reported_profile(
    found: &EstimateResult<LatencyProfile>,
    steps: Option<&CoarseLatencyChange>,
    t_s: &[f64],
) -> EstimateResult<LatencyProfile> {
    match (found, steps) {
        // Already relative to the lowest level.
        (found, Some(steps)) => Ok(steps.profile(found)),
        (Ok(unsteady), None) if unsteady.is_unsteady => {
            Ok(unsteady.clone().relative_to_typical(t_s))
        }
        (found, None) => found.clone(),
    }
}

/// Shares of the rows of streams that are within the times of the joint states.
fn compared_shares(
    joints: &JointTrack,
    streams: &[PoseStream],
    changes: &[Option<CoarseLatencyChange>],
) -> Vec<f64> {
    let Some((first_s, last_s)) = joints.span() else { return vec![0.0; streams.len()] };
    let share = |(stream, change): (&PoseStream, &Option<CoarseLatencyChange>)| {
        let stamps = &stream.track.t_s;
        let all = || stamps.iter().copied().enumerate().collect();
        let rows = change.as_ref().map_or_else(all, |it| it.compensated(stamps));
        let compared = rows.iter().filter(|(_, t_s)| (first_s..=last_s).contains(t_s)).count();
        compared as f64 / stamps.len().max(1) as f64
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
    let diagnosed = |track: &ImuTrack, removed_ramp: Option<&PiecewiseLatency>| {
        let stream = ImuStream { track, removed_ramp, ..stream };
        diagnose_converted_imu(joints, &stream, &conventions, max_lag_s)
    };
    let t_s = &stream.track.t_s;
    let diagnose_with = |change: &Option<CoarseLatencyChange>| match change {
        Some(it) => {
            diagnosed(&imu_with_rows(stream.track, &it.compensated(t_s)), removed_ramp(change))
        }
        None => diagnosed(stream.track, None),
    };
    let detected = detect_imu_latency_changes(joints, &stream, max_lag_s);
    let first = diagnose_with(&detected);
    let (changes, diagnosis) = refine_changes(
        (vec![detected], first),
        |changes| diagnose_with(&changes[0]),
        |diagnosis| vec![&diagnosis.latency_profile],
    );
    // As for poses, only steps are removed.
    let steps = changes[0].as_ref().filter(|it| it.has_steps());
    let latency_profile = reported_profile(&diagnosis.latency_profile, steps, t_s);
    let unsteady = diagnosis.latency_profile.as_ref().ok().filter(|profile| profile.is_unsteady);
    let Some(unsteady) = unsteady else {
        return ImuDiagnosis { latency_profile, ..diagnosis };
    };
    let step_free = steps.map(|steps| imu_with_rows(stream.track, &steps.compensated(t_s)));
    let track = step_free.as_ref().unwrap_or(stream.track);
    let steady = diagnosed(&imu_with_rows(track, &unsteady.compensated(&track.t_s)), None);
    ImuDiagnosis { latency_profile, ..steady }
}

/// Poses with stamps corrected to a constant latency. `None` if it is constant.
pub fn compensate_latency(
    stream: &PoseStream,
    profile: &EstimateResult<LatencyProfile>,
) -> Option<PoseTrack> {
    let profile = profile.as_ref().ok().filter(|profile| profile.is_unsteady)?;
    Some(with_stamps(stream, &profile.compensated(&stream.track.t_s)))
}

/// Streams in some rows with other stamps, which depend on the stream's index and stamps. `None` as logged.
pub(crate) fn tracks_with_stamps(
    streams: &[PoseStream],
    rows: impl Fn(usize, &[f64]) -> Option<Vec<(usize, f64)>>,
) -> Vec<Option<PoseTrack>> {
    let track =
        |(s, stream): (usize, &PoseStream)| Some(with_stamps(stream, &rows(s, &stream.track.t_s)?));
    streams.iter().enumerate().map(track).collect()
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
    let (rows, t_s): (Vec<usize>, Vec<f64>) = rows.iter().copied().unzip();
    PoseTrack { t_s, ..track.at_rows(&rows) }
}

fn imu_with_rows(track: &ImuTrack, rows: &[(usize, f64)]) -> ImuTrack {
    let (rows, t_s): (Vec<usize>, Vec<f64>) = rows.iter().copied().unzip();
    ImuTrack { t_s, ..track.at_rows(&rows) }
}
