//! Checks names and units of the joint states against pose positions, which no rotation convention affects.
//! A constant tool offset or a rotated reference frame is free.

mod corrected_joints;
mod encoding;
mod interpreted_poses;
mod map;
mod refinement;
mod search;
mod single_joint;
mod slow_samples;

use self::slow_samples::{JOINT_ENCODING_SAMPLES, rms_speeds, slow_simultaneous_samples};
use crate::frames::position_fit::spread;
use crate::latency::correlation::{joint_speed_lags, linear_speed};
use crate::model::measurement::PoseObservations;
use crate::samples::sampling::{check_sample_count, value_range};
use crate::{EstimateResult, NotObservable, PoseStream, UnitResiduals};
pub use encoding::{
    Confounder, JointCoupling, JointEncoding, JointOffset, JointScale, JointUnit, JointUnitError,
};
use ground::geometry::Vec3;
use ground::stats::{Measured, mean};
use ground::stream::{JointTrack, sample_noise};
use interpreted_poses::{ConstantFrames, FreeFrames, InterpretedPoses};
use map::{Coupling, JointMap};
use search::{InterpretationKind, JointInterpretation, SearchOutcome, search_kind};
use single_joint::SingleJoint;

pub(super) use corrected_joints::CorrectedJoints;
pub(super) use interpreted_poses::ResidualSize;
pub(super) use map::{half_turns, is_quarter_turn};
pub(super) use search::MIN_MOTION_RAD;

/// For an interpretation other than the logged one.
const MIN_RESIDUAL_RATIO: f64 = 5.0;
/// Share of the motion's extent, for joint states accepted as logged.
const MAX_LOGGED_RESIDUAL_SHARE: f64 = 0.05;
/// Stricter: reversed joint order moves an arm much like the inverse of an arm with rotated frames.
const MAX_LOGGED_RESIDUAL_SHARE_ROTATED: f64 = 0.005;
/// Residual over the noise of the positions, for a residual that is only noise: no interpretation has a smaller
/// one. Residuals of 60 samples scatter by 5 %.
const MAX_NOISE_RATIO: f64 = 1.5;
/// Limits for another interpretation at slow samples, before correcting latency and small causes.
const MAX_RESIDUAL_SHARE: f64 = 0.02;
const MAX_RESIDUAL_RAD: f64 = 0.03;
/// Share of the extent.
pub(super) const MAX_FOLLOWING_RESIDUAL_SHARE: f64 = 0.3;

/// Spread of the positions of a tip at rest.
const MAX_REST_SPREAD_M: f64 = 2e-3;
/// Between a resting tip and FK, of the arm's reach.
const MAX_REST_DISTANCE_SHARE: f64 = 0.03;

/// Uses the stream with the most joints and samples.
///
/// # Errors
/// If no stream overlaps the joint states, or the motion does not determine the encoding.
pub(super) fn estimate_joint_encoding(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    max_lag_s: f64,
) -> EstimateResult<JointEncoding> {
    let (stream, scale) =
        most_informative(streams, scales).ok_or(NotObservable::RestsOn("a pose of the tool"))?;
    let max_noise_m = |extent_m: f64| max_noise_m(stream, *scale, extent_m);
    let (mut as_logged, mut extent) = (f64::INFINITY, f64::INFINITY);
    let mut at_lags = Vec::new();
    for lag_s in latency_candidates(joints, stream, max_lag_s) {
        let samples = slow_simultaneous_samples(joints, stream, *scale, lag_s);
        check_sample_count(samples.len(), 6)?;
        if is_at_rest(&samples) {
            return encoding_at_rest(&samples, stream.reference_known);
        }
        let spread_m = spread(&samples.xyz);
        if spread_m < MAX_REST_SPREAD_M {
            // The joints move, the stream does not.
            return Err(NotObservable::NotExcited);
        }
        extent = spread_m.max(0.01).min(extent);
        let misfit_m = samples.least_misfit(FreeFrames::Both);
        if misfit_m <= (MAX_LOGGED_RESIDUAL_SHARE_ROTATED * extent).max(max_noise_m(spread_m))
            || samples.least_misfit(FreeFrames::Tool) <= MAX_LOGGED_RESIDUAL_SHARE * extent
        {
            return Ok(JointEncoding::default());
        }
        as_logged = misfit_m.min(as_logged);
        at_lags.push(samples.views());
    }
    let max_residual = ResidualSize {
        m: (MAX_RESIDUAL_SHARE * extent)
            .max(max_noise_m(extent))
            .min(as_logged / MIN_RESIDUAL_RATIO),
        rad: Some(MAX_RESIDUAL_RAD),
    };
    if at_lags.iter().any(|views| half_follows_as_logged(&views[0])) {
        return Ok(JointEncoding::default());
    }
    if let Some(found) = search_views(stream, &at_lags, max_residual, &InterpretationKind::ALL) {
        return Ok(to_encoding(joints.dof, stream, &found, as_logged));
    }
    if as_logged > MAX_FOLLOWING_RESIDUAL_SHARE * extent {
        // No encoding is clearly best.
        return Err(NotObservable::NotExcited);
    }
    Ok(JointEncoding::default())
}

/// Whether half of the run follows FK as logged, and the whole run does not. No other encoding of the joints explains that.
pub(super) fn has_change_within_run(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    max_lag_s: f64,
) -> bool {
    most_informative(streams, scales).is_some_and(|(stream, scale)| {
        latency_candidates(joints, stream, max_lag_s).into_iter().any(|lag_s| {
            half_follows_as_logged(&slow_simultaneous_samples(joints, stream, *scale, lag_s))
        })
    })
}

/// The stream with the most joints and samples, with its scale.
fn most_informative<'a, 'b>(
    streams: &'a [PoseStream<'b>],
    scales: &'a [f64],
) -> Option<(&'a PoseStream<'b>, &'a f64)> {
    let both = streams.iter().zip(scales);
    both.max_by_key(|(stream, _)| (stream.columns.len(), stream.track.t_s.len()))
}

/// Whether consecutive samples, half of all, follow FK as logged far better than all do, up to constant frames. Every
/// joint must move in them about as far as in all: less motion fits other encodings, too.
fn half_follows_as_logged(view: &InterpretedPoses) -> bool {
    const MIN_SAMPLES: usize = 20;
    const MIN_MOTION_SHARE: f64 = 0.5;
    let (len, dof) = (view.len(), view.chain.dof());
    if len < 2 * MIN_SAMPLES {
        return false;
    }
    let residual =
        |view: &InterpretedPoses| view.fitted_residual(&view.as_logged(), FreeFrames::Both);
    let range = |view: &InterpretedPoses, joint: usize| {
        value_range(view.q.iter().skip(joint).step_by(dof).copied())
    };
    let whole_m = residual(view).combined_m(view.lever_m);
    [0, len / 4, len / 2].into_iter().any(|first| {
        let half = view.range(first..first + len / 2);
        let moves =
            (0..dof).all(|joint| range(&half, joint) >= MIN_MOTION_SHARE * range(view, joint));
        let is_within = |residual: ResidualSize| {
            residual.m < MAX_LOGGED_RESIDUAL_SHARE_ROTATED * spread(&half.xyz)
                && residual.rad.is_none_or(|rad| rad < MAX_LOGGED_RESIDUAL_SHARE_ROTATED)
                && MIN_RESIDUAL_RATIO * residual.combined_m(view.lever_m) < whole_m
        };
        moves && is_within(residual(&half))
    })
}

/// Encoding with a residual against `stream` far below `as_logged`. `None` if none is clearly best. Tries
/// only the simplest if the stream is close to FK as logged.
pub(super) fn other_encoding(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    (lag_s, max_lag_s): (f64, f64),
    as_logged: ResidualSize,
) -> Option<JointEncoding> {
    const MIN_LARGE_ROTATION_RESIDUAL_RAD: f64 = 0.05;
    const MAX_SMALL_POSITION_RESIDUAL_M: f64 = 5e-3;
    let samples = slow_simultaneous_samples(joints, stream, scale, lag_s);
    if samples.len() < 6 || is_at_rest(&samples) {
        return None;
    }
    // If only rotations are wrong, positions must not get worse.
    let turns_only = as_logged.rad.is_some_and(|rad| rad > MIN_LARGE_ROTATION_RESIDUAL_RAD)
        && as_logged.m < MAX_SMALL_POSITION_RESIDUAL_M;
    let stay_m = if turns_only { 1.2 * samples.least_misfit(FreeFrames::Tool) } else { 0.0 };
    let better_m = (as_logged.m / MIN_RESIDUAL_RATIO).max(2e-4).max(stay_m);
    let extent_m = spread(&samples.xyz).max(0.01);
    let max_residual = ResidualSize {
        m: (MAX_RESIDUAL_SHARE * extent_m).max(max_noise_m(stream, scale, extent_m)).min(better_m),
        rad: as_logged.rad.map(|rad| (rad / MIN_RESIDUAL_RATIO).clamp(1e-3, MAX_RESIDUAL_RAD)),
    };
    // Only the last joint does not move the positions.
    let is_far = !turns_only
        && (as_logged.m > MAX_LOGGED_RESIDUAL_SHARE * spread(&samples.xyz)
            || as_logged.rad.is_some_and(|rad| rad > MIN_LARGE_ROTATION_RESIDUAL_RAD));
    let kinds = if is_far {
        &InterpretationKind::ALL[..]
    } else {
        &InterpretationKind::FOR_SMALL_RESIDUALS[..]
    };
    // The latency of a wrong model may be wrong.
    let at_lag = |lag_s: f64| slow_simultaneous_samples(joints, stream, scale, lag_s);
    let others = latency_candidates(joints, stream, max_lag_s).into_iter().map(at_lag);
    let views: Vec<Vec<InterpretedPoses>> = std::iter::once(samples)
        .chain(others.filter(|samples| samples.len() >= 6))
        .map(|samples| {
            let mut views = samples.views();
            views.retain(|view| !turns_only || view.rotation.is_some());
            views
        })
        .collect();
    let found = search_views(stream, &views, max_residual, kinds)?;
    Some(to_encoding(joints.dof, stream, &found, as_logged.m))
}

/// Simplest interpretation with a residual of at most `max_residual`, if one is clearly best. Views are per lag.
fn search_views(
    stream: &PoseStream,
    views: &[Vec<InterpretedPoses>],
    max_residual: ResidualSize,
    kinds: &[InterpretationKind],
) -> Option<JointInterpretation> {
    /// Other lags are tried only for the simplest kind.
    const LAGS_FOR_ALL_KINDS: usize = 2;
    let both: &[FreeFrames] = match stream.reference_known {
        true => &[FreeFrames::Tool, FreeFrames::Both],
        false => &[FreeFrames::Both],
    };
    for &freedom in both {
        for &kind in kinds {
            let is_skipped = freedom != both[0] && kind > InterpretationKind::UnitAndOneJoint;
            if is_skipped
                || (freedom == FreeFrames::Both && kind == InterpretationKind::OrderAndOneJoint)
            {
                continue;
            }
            let lags =
                if kind == InterpretationKind::OneJoint { views.len() } else { LAGS_FOR_ALL_KINDS };
            let mut ambiguous_m = f64::INFINITY;
            for view in views.iter().take(lags).flatten() {
                match search_kind(view, kind, freedom, max_residual) {
                    SearchOutcome::Found(found)
                        if found.residual.combined_m(view.lever_m) < ambiguous_m =>
                    {
                        let map = found.map.with_base_turned();
                        return Some(JointInterpretation { map, ..found });
                    }
                    // At another lag, one may clearly be best.
                    SearchOutcome::Ambiguous(residual_m) => {
                        ambiguous_m = ambiguous_m.min(residual_m / MIN_RESIDUAL_RATIO);
                    }
                    SearchOutcome::Found(_) | SearchOutcome::Nothing => {}
                }
            }
            if ambiguous_m.is_finite() {
                return None;
            }
        }
    }
    None
}

/// May have a large remaining residual.
pub(super) struct LikelyEncoding {
    pub encoding: JointEncoding,
    /// The values exceed the joint limits as radians, not as degrees.
    pub by_range: bool,
}

/// Most likely first: degrees if the values exceed the joint ranges as radians, then the unit and order
/// with the smallest position residual.
pub(super) fn likely_encodings(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    max_lag_s: f64,
) -> Vec<LikelyEncoding> {
    let both = streams.iter().zip(scales);
    let Some((stream, scale)) = both.max_by_key(|(stream, _)| stream.track.t_s.len()) else {
        return Vec::new();
    };
    let lag_s = latency_candidates(joints, stream, max_lag_s).last().copied().unwrap_or(0.0);
    let samples = slow_simultaneous_samples(joints, stream, *scale, lag_s);
    if samples.len() < 6 {
        return Vec::new();
    }
    let as_logged_m = samples.least_misfit(FreeFrames::Both);
    let mut likely = Vec::new();
    for view in samples.views().into_iter().chain([samples.mirrored()]) {
        for (map, by_range) in search::likely_maps(&view) {
            let residual = view.fitted_residual(&map, FreeFrames::Both);
            let found = JointInterpretation { map, residual, runner_up_m: None };
            let encoding = to_encoding(joints.dof, stream, &found, as_logged_m);
            likely.push(LikelyEncoding { encoding, by_range });
        }
    }
    likely.sort_by_key(|one| !one.by_range);
    likely.dedup_by(|a, b| a.encoding.is_same(&b.encoding));
    likely
}

/// Best two joints whose zero alone would greatly reduce the residual, with their offsets. `offsets` is the
/// reference.
pub(super) fn single_zeros(
    observations: &PoseObservations,
    lag_s: f64,
    offsets: &[f64],
) -> Vec<(usize, f64)> {
    /// Gauss–Newton finds smaller ones.
    const MIN_ZERO_CHANGE_RAD: f64 = 0.1;
    const MAX_ZERO_RESIDUAL_RATIO: f64 = 0.3;
    let chain = observations.chain;
    let PoseObservations { joints, columns, .. } = *observations;
    let mut sequence = joints.sequence();
    let (mut xyz, mut rotation, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for k in observations.rows(JOINT_ENCODING_SAMPLES) {
        if let Some((q, _)) = sequence.at(observations.t_s[k] - lag_s) {
            xyz.push(observations.xyz[k]);
            rotation.push(observations.rotation[k]);
            rows.extend(columns.iter().map(|&column| q[column]));
        }
    }
    let spans = vec![[0.0; 2]; columns.len()];
    let view = InterpretedPoses::new(chain, xyz, Some(rotation), rows, spans);
    let mut nearest_zeros = JointMap::as_logged(columns.len());
    nearest_zeros.zero = columns.iter().map(|&column| offsets[column]).collect();
    let named = ConstantFrames::default();
    let residual_of =
        |map: &JointMap| view.residual_against(&view.fk(map), &named).combined_m(view.lever_m);
    let max_residual = MAX_ZERO_RESIDUAL_RATIO * residual_of(&nearest_zeros);
    let mut zeros: Vec<(f64, usize, f64)> = chain
        .turning_joints()
        .filter_map(|joint| {
            let zero =
                SingleJoint::new(&view, &nearest_zeros, &named, joint).best_zero(1.0, true).0;
            let residual_of = residual_of(&nearest_zeros.with(joint, 1.0, zero));
            let is_off = (zero - nearest_zeros.zero[joint]).abs() > MIN_ZERO_CHANGE_RAD;
            (is_off && residual_of < max_residual).then_some((residual_of, columns[joint], zero))
        })
        .collect();
    zeros.sort_by(|a, b| a.0.total_cmp(&b.0));
    zeros.into_iter().take(2).map(|(_, joint, zero)| (joint, zero)).collect()
}

/// Converts a map to columns of the joint track.
fn to_encoding(
    dof: usize,
    stream: &PoseStream,
    found: &JointInterpretation,
    as_logged: f64,
) -> JointEncoding {
    let PoseStream { chain, columns, .. } = *stream;
    let map = &found.map;
    let degree = 1f64.to_radians();
    /// Relative.
    const SCALE_PRECISION: f64 = 1e-3;
    let is_degree = |factor: f64| (factor / degree - 1.0).abs() < SCALE_PRECISION;
    // Also if some are reversed.
    let all_in_degrees = chain.turning_joints().count() > 1
        && chain.turning_joints().all(|joint| is_degree(map.factor[joint].abs()));
    let unit_errors = (0..map.from.len()).filter_map(|joint| {
        let slides = chain.slides(joint);
        let is_common = all_in_degrees && !slides;
        let factor = map.factor[joint] / if is_common { degree } else { 1.0 };
        let unit = match factor {
            1.0 => return None,
            _ if is_common && (factor - 1.0).abs() < SCALE_PRECISION => return None,
            _ if !slides && is_degree(factor) => JointUnit::Degrees,
            1e-3 if slides => JointUnit::Millimetres,
            1e-2 if slides => JointUnit::Centimetres,
            _ => JointUnit::Scaled,
        };
        let factor = if unit == JointUnit::Degrees { degree } else { factor };
        Some(JointUnitError { column: columns[joint], unit, factor })
    });
    let mut zeros = vec![0.0; dof];
    for (&column, zero) in columns.iter().zip(&map.zero) {
        zeros[column] = *zero;
    }
    let in_track = |coupling: Coupling| JointCoupling {
        column: columns[coupling.joint],
        by: columns[coupling.by],
        factor: Measured { value: coupling.factor, std_error: 0.0, dof: 1.0 },
    };
    let is_in_order = map.from.iter().enumerate().all(|(joint, &from)| joint == from);
    let mut permutation: Vec<usize> = (0..dof).collect();
    for (joint, &from) in map.from.iter().enumerate() {
        permutation[columns[from]] = columns[joint];
    }
    JointEncoding {
        is_in_degrees: all_in_degrees,
        permutation: (!is_in_order).then_some(permutation),
        unit_errors: unit_errors.collect(),
        couplings: map.coupling.map(in_track).into_iter().collect(),
        zeros,
        residual: Some(UnitResiduals { as_logged, corrected: found.residual.m }),
        runner_up_m: found.runner_up_m,
    }
}

/// Radians and degrees.
const UNITS: [f64; 2] = [1.0, std::f64::consts::PI / 180.0];

/// Neither stream nor FK move the tip, in radians or degrees.
fn is_at_rest(samples: &InterpretedPoses) -> bool {
    let in_units = UNITS.map(|unit| samples.fk_positions(unit));
    in_units.iter().chain([&samples.xyz]).all(|xyz| spread(xyz) < MAX_REST_SPREAD_M)
}

/// A tip at the position given by FK confirms names and unit without any free frame; elsewhere it is
/// inconclusive.
fn encoding_at_rest(
    samples: &InterpretedPoses,
    reference_known: bool,
) -> EstimateResult<JointEncoding> {
    let [as_logged, corrected] = UNITS.map(|unit| {
        let fk = samples.fk_positions(unit);
        let squares = fk.iter().zip(&samples.xyz).map(|(fk, xyz)| (fk - xyz).norm_squared());
        mean(squares).sqrt()
    });
    let is_plausible = |distance: f64, other: f64| {
        distance < MAX_REST_DISTANCE_SHARE * samples.chain.max_reach_m()
            && distance * MIN_RESIDUAL_RATIO < other
    };
    match reference_known {
        true if is_plausible(as_logged, corrected) => Ok(JointEncoding::default()),
        true if is_plausible(corrected, as_logged) => {
            let residual = Some(UnitResiduals { as_logged, corrected });
            Ok(JointEncoding { is_in_degrees: true, residual, ..JointEncoding::default() })
        }
        _ => Err(NotObservable::AtRest),
    }
}

/// Names, units and couplings, but not the zeros.
pub(super) fn correct_joints(
    joints: &JointTrack,
    encoding: &JointEncoding,
    prismatic: &[bool],
) -> JointTrack {
    let mut track = joints.clone();
    if encoding.is_in_degrees {
        track.convert_from_degrees(prismatic);
    }
    let mut named = vec![0.0; joints.dof];
    for values in [&mut track.q, &mut track.qd] {
        for row in values.chunks_exact_mut(joints.dof.max(1)) {
            if let Some(permutation) = &encoding.permutation {
                named.copy_from_slice(row);
                permutation.iter().zip(&named).for_each(|(&really, value)| row[really] = *value);
            }
            for JointUnitError { column, factor, .. } in &encoding.unit_errors {
                row[*column] *= factor;
            }
            for JointCoupling { column, by, factor } in &encoding.couplings {
                row[*column] += factor.value * row[*by];
            }
        }
    }
    track
}

fn with_zeros(track: &JointTrack, zeros: &[f64]) -> JointTrack {
    let mut moved = track.clone();
    for row in moved.q.chunks_exact_mut(track.dof.max(1)) {
        row.iter_mut().zip(zeros).for_each(|(q, zero)| *q += zero);
    }
    moved
}

/// Up to a tool offset or a rotated reference frame.
pub(super) fn follows_arm(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    lag_s: f64,
) -> bool {
    let samples = slow_simultaneous_samples(joints, stream, scale, lag_s);
    samples.len() >= 6
        && samples.least_misfit(FreeFrames::Both)
            < MAX_FOLLOWING_RESIDUAL_SHARE * spread(&samples.xyz)
}

/// Whether the poses follow FK as logged, up to constant frames. `None` if a resting tip or few samples do not
/// tell.
pub fn follows_as_logged(joints: &JointTrack, stream: &PoseStream) -> Option<bool> {
    let samples = slow_simultaneous_samples(joints, stream, 1.0, 0.0);
    let extent = spread(&samples.xyz);
    let residual = samples.fitted_residual(&samples.as_logged(), FreeFrames::Both);
    (samples.len() >= 6 && extent > MAX_REST_SPREAD_M).then(|| {
        residual.m < MAX_LOGGED_RESIDUAL_SHARE * extent
            && residual.rad.is_none_or(|rad| rad < MAX_RESIDUAL_RAD)
    })
}

/// Zero and peaks of the speed correlation. At slow samples a remaining error has little effect, a wrong
/// candidate has.
fn latency_candidates(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let mut lags = vec![0.0];
    // Speeds as logged, and normalised per joint.
    for units in [vec![1.0; joints.dof], rms_speeds(joints)] {
        for lag_s in joint_speed_lags(joints, &units, &speed, max_lag_s) {
            if lags.iter().all(|other_s| (lag_s - other_s).abs() > 0.01) {
                lags.push(lag_s);
            }
        }
    }
    lags
}

/// Largest position residual that counts as noise, m. `scale` converts the stream's positions to metres.
fn max_noise_m(stream: &PoseStream, scale: f64, extent_m: f64) -> f64 {
    let along = |axis: usize| {
        sample_noise(&stream.track.xyz.iter().map(|xyz| xyz[axis]).collect::<Vec<f64>>())
    };
    // Rms distance of a position from the mean, due to noise.
    let noise_m = scale * Vec3::from([0, 1, 2].map(along)).norm();
    (MAX_NOISE_RATIO * noise_m).min(MAX_LOGGED_RESIDUAL_SHARE * extent_m)
}

#[cfg(test)]
mod tests;
