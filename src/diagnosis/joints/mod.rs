//! Whether joint states carry the names and units that they claim.
//!
//! Positions of a pose stream depend on no rotation convention, so they judge the joint states
//! before anything else is known: each unit and each pairing of names is held against them, leaving
//! a constant tool offset or a turned reference frame free.

mod found;
mod lone;
mod map;
mod moments;
mod polish;
mod read;
mod search;
mod view;

use self::moments::{Moments, SAMPLES, evened, in_radians, slow_moments};
use super::latency::{joint_activity, linear_speed, peaks};
use super::model::Witness;
use super::placing::{Expected, spread};
use super::{PoseStream, Seen, UnitSlip, Unseen};
pub use found::{JointCoupling, JointOffset, JointReading, JointScale, JointSlip, JointUnit, Twin};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::robot::{Chain, JointKind};
use ground::stats::Measured;
use ground::stream::JointTrack;
use lone::Lone;
use map::{Coupling, JointMap};
use search::{Found, Kind, Search, search};
use std::borrow::Cow;
use view::{Frames, Freedom, TURNS, View};

pub(super) use map::{half_turns, is_quarter_turn};
pub(super) use read::Read;
pub(super) use view::Left;

/// Another reading must be better than the one as logged by this factor.
const BETTER: f64 = 5.0;
/// Residual below which the joint states are not questioned, as a share of the motion's extent.
const FINE: f64 = 0.05;
/// The same where the reference frame had to be turned: an arm whose joints are read from tip to
/// base moves much like the inverse of one whose frames are turned.
const FINE_TURNED: f64 = 0.005;
/// What another reading may leave at slow moments, before latency and small causes are taken off: a
/// share of the motion's extent, and an angle in rad.
const FITS: f64 = 0.02;
const FITS_RAD: f64 = 0.03;
/// Residual below which positions lie on the arm, as a share of their extent.
pub(super) const ON_ARM: f64 = 0.3;

/// A tip whose positions spread by less rests, m.
const AT_REST_M: f64 = 2e-3;
/// A resting tip is where the joint states say, up to this share of the arm's reach.
const THERE: f64 = 0.03;

/// Judges names and units of the joint states by the stream with the most samples.
///
/// # Errors
/// There is no stream that shares a time span with the joints.
pub(super) fn read_joints(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    most_lag_s: f64,
) -> Seen<JointReading> {
    let (stream, scale) = streams
        .iter()
        .zip(scales)
        .max_by_key(|(stream, _)| (stream.columns.len(), stream.track.t_s.len()))
        .ok_or(Unseen::NoOverlap)?;
    let chain = stream.chain;
    let (mut as_logged, mut extent) = (f64::INFINITY, f64::INFINITY);
    let mut at_lags = Vec::new();
    for lag_s in lags(joints, stream, most_lag_s) {
        let moments = slow_moments(joints, stream, *scale, lag_s);
        let have = moments.xyz.len();
        if have < 6 {
            return Err(Unseen::TooFewSamples { have, need: 6 });
        }
        if rests(chain, &moments) {
            return read_at_rest(chain, &moments, stream.reference_known);
        }
        if spread(&moments.xyz) < AT_REST_M {
            // The joints move and the stream does not: it tells nothing of their names and units.
            return Err(Unseen::NotExcited);
        }
        extent = spread(&moments.xyz).max(0.01).min(extent);
        let left = misfit(chain, &moments);
        if left <= FINE_TURNED * extent || unturned_misfit(chain, &moments) <= FINE * extent {
            return Ok(JointReading::default());
        }
        as_logged = left.min(as_logged);
        at_lags.push(moments);
    }
    let most = Left { m: (FITS * extent).min(as_logged / BETTER), rad: Some(FITS_RAD) };
    let views: Vec<Vec<View>> =
        at_lags.iter().map(|moments| views(joints, stream, moments)).collect();
    if let Some(found) = look(stream, &views, most, &Kind::ALL) {
        return Ok(reading(joints.dof, stream, &found, as_logged));
    }
    if as_logged > ON_ARM * extent {
        // Not as logged, and no one other reading stands out.
        return Err(Unseen::NotExcited);
    }
    Ok(JointReading::default())
}

/// A reading of the joint states by which `stream` leaves far less than `as_logged` at latency `lag_s`;
/// `None` where no one reading stands out.
///
/// Only the simplest readings are tried where the stream is not far from the arm as logged.
pub(super) fn other_reading(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    lag_s: f64,
    as_logged: Left,
) -> Option<JointReading> {
    /// An angle that is far, rad.
    const FAR_RAD: f64 = 0.05;
    /// A length that is near, m.
    const NEAR_M: f64 = 5e-3;
    let moments = slow_moments(joints, stream, scale, lag_s);
    if moments.xyz.len() < 6 || rests(stream.chain, &moments) {
        return None;
    }
    // Where the rotations are what is wrong, the positions only have to stay as near as they are.
    let turns_only = as_logged.rad.is_some_and(|rad| rad > FAR_RAD) && as_logged.m < NEAR_M;
    let stay_m = if turns_only { 1.2 * unturned_misfit(stream.chain, &moments) } else { 0.0 };
    let better_m = (as_logged.m / BETTER).max(2e-4).max(stay_m);
    let most = Left {
        m: (FITS * spread(&moments.xyz).max(0.01)).min(better_m),
        rad: as_logged.rad.map(|rad| (rad / BETTER).clamp(1e-3, FITS_RAD)),
    };
    let is_far =
        as_logged.m > FINE * spread(&moments.xyz) || as_logged.rad.is_some_and(|rad| rad > FAR_RAD);
    let kinds = if is_far { &Kind::ALL[..] } else { &Kind::OF_NEAR[..] };
    let mut views = views(joints, stream, &moments);
    views.retain(|view| !turns_only || view.rotation.is_some());
    let found = look(stream, &[views], most, kinds)?;
    Some(reading(joints.dof, stream, &found, as_logged.m))
}

/// The simplest way of reading the joints that leaves no more than `most`, if one stands out: in the
/// views at the moments of one lag after the other.
fn look(stream: &PoseStream, views: &[Vec<View>], most: Left, kinds: &[Kind]) -> Option<Found> {
    /// Lags at which all is tried; at the others only what is simple.
    const LAGS: usize = 2;
    let both: &[Freedom] = match stream.reference_known {
        true => &[Freedom::Tool, Freedom::Both],
        false => &[Freedom::Both],
    };
    for &freedom in both {
        for &kind in kinds {
            let is_late = freedom != both[0] && kind > Kind::UnitAndOne;
            if is_late || (freedom == Freedom::Both && kind == Kind::OrderAndOne) {
                continue;
            }
            let lags = if kind == Kind::One { views.len() } else { LAGS };
            for view in views.iter().take(lags).flatten() {
                match search(view, kind, freedom, most) {
                    Search::Found(found) => {
                        return Some(Found { map: found.map.with_base_turned(), ..found });
                    }
                    Search::Ambiguous => return None,
                    Search::Nothing => {}
                }
            }
        }
    }
    None
}

/// A reading of the joint states that is likely though it leaves much beside it, and whether the numbers
/// themselves say so.
pub(super) struct Likely {
    pub reading: JointReading,
    /// The numbers are beyond the limits of the joints as radians and within them as degrees.
    pub by_range: bool,
}

/// Readings that may be a part of what is wrong, the likeliest first: degrees where the joints cannot be
/// where radians put them, then the unit and the order by which the positions are nearest to the arm.
pub(super) fn likely_readings(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    most_lag_s: f64,
) -> Vec<Likely> {
    let both = streams.iter().zip(scales);
    let Some((stream, scale)) = both.max_by_key(|(stream, _)| stream.track.t_s.len()) else {
        return Vec::new();
    };
    let lag_s = lags(joints, stream, most_lag_s).last().copied().unwrap_or(0.0);
    let moments = slow_moments(joints, stream, *scale, lag_s);
    let mut likely = Vec::new();
    let mut views = views(joints, stream, &moments);
    views.extend(views.last().map(View::mirrored));
    for view in views.iter().filter(|view| view.len() > 5) {
        for (map, by_range) in search::likely(view) {
            let fk = view.fk(&map);
            let left = view.left(&fk, &view.frames(&fk, Freedom::Both));
            let found = Found { map, left, runner_up_m: None };
            let reading = reading(joints.dof, stream, &found, misfit(stream.chain, &moments));
            likely.push(Likely { reading, by_range });
        }
    }
    likely.sort_by_key(|one| !one.by_range);
    let said = |one: &Likely| {
        let order = one.reading.permutation.as_ref().map(|(order, _)| order.clone());
        (one.reading.degrees.is_some(), order, one.reading.slips.clone())
    };
    likely.dedup_by(|a, b| said(a) == said(b));
    likely
}

/// The joints of the track, of which one with another zero would bring the poses of `witness` at
/// latency `lag_s` far nearer to the arm than they are at `offsets`; the two best, with those zeros.
pub(super) fn lone_zeros(witness: &Witness, lag_s: f64, offsets: &[f64]) -> Vec<(usize, f64)> {
    /// Zeros closer than this are found without, rad; and the share that may be left.
    const CLOSE: f64 = 0.1;
    const SHARE: f64 = 0.3;
    let chain = witness.chain;
    let Witness { joints, columns, .. } = *witness;
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let (mut xyz, mut rotation, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for k in (0..witness.len()).step_by(witness.len().div_ceil(SAMPLES).max(1)) {
        if joints.at(witness.t_s[k] - lag_s, &mut cursor, &mut q, &mut qd) {
            xyz.push(witness.xyz[k]);
            rotation.push(witness.rotation[k]);
            rows.extend(columns.iter().map(|&column| q[column]));
        }
    }
    let view = View {
        chain,
        xyz,
        rotation: Some(rotation),
        q: rows,
        spans: vec![[0.0; 2]; columns.len()],
        lever_m: (0.25 * chain.max_reach_m()).max(0.05),
        turns: TURNS,
    };
    let mut near = JointMap::as_logged(columns.len());
    near.zero = columns.iter().map(|&column| offsets[column]).collect();
    let named = Frames::default();
    let left = |map: &JointMap| view.left(&view.fk(map), &named).together(view.lever_m);
    let most = SHARE * left(&near);
    let turning = (0..columns.len()).filter(|&j| chain.joint_kinds()[j] != JointKind::Prismatic);
    let mut zeros: Vec<(f64, usize, f64)> = turning
        .filter_map(|joint| {
            let zero = Lone::of(&view, &near, &named, joint).zero(1.0).0;
            let left = left(&near.with(joint, 1.0, zero));
            let is_off = (zero - near.zero[joint]).abs() > CLOSE;
            (is_off && left < most).then_some((left, columns[joint], zero))
        })
        .collect();
    zeros.sort_by(|a, b| a.0.total_cmp(&b.0));
    zeros.into_iter().take(2).map(|(_, joint, zero)| (joint, zero)).collect()
}

/// The ways in which the poses at `moments` may be taken: as they are, inverted, and by the positions alone.
fn views<'a>(joints: &JointTrack, stream: &PoseStream<'a>, moments: &Moments) -> Vec<View<'a>> {
    let chain = stream.chain;
    let span = |&column: &usize| {
        let numbers = joints.q.iter().skip(column).step_by(joints.dof);
        numbers
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &q| [low.min(q), high.max(q)])
    };
    let positions = View {
        chain,
        xyz: moments.xyz.clone(),
        rotation: None,
        q: moments.q.clone(),
        spans: stream.columns.iter().map(span).collect(),
        lever_m: (0.25 * chain.max_reach_m()).max(0.05),
        turns: TURNS,
    };
    let mut views = Vec::new();
    if let (Some(rotation), Some(inverse)) = (&moments.rotation, &moments.inverse_xyz) {
        views.push(View { rotation: Some(rotation.clone()), ..positions.clone() });
        let turned = rotation.iter().map(Rotation::inverse).collect();
        views.push(View { xyz: inverse.clone(), rotation: Some(turned), ..positions.clone() });
    }
    views.push(positions);
    views
}

/// A way that was found, in the columns of the joint track.
fn reading(dof: usize, stream: &PoseStream, found: &Found, as_logged: f64) -> JointReading {
    let (map, kinds, columns) = (&found.map, stream.chain.joint_kinds(), stream.columns);
    let slip = UnitSlip { as_logged, corrected: found.left.m };
    let degree = 1f64.to_radians();
    let slides = |joint: usize| kinds[joint] == JointKind::Prismatic;
    /// A scale that is found is known to this share of itself.
    const KNOWN: f64 = 1e-3;
    let in_degrees = |joint: usize| (map.factor[joint] / degree - 1.0).abs() < KNOWN;
    let turning: Vec<usize> = (0..map.from.len()).filter(|&joint| !slides(joint)).collect();
    let all_in_degrees = turning.len() > 1 && turning.iter().all(|&joint| in_degrees(joint));
    let slips = (0..map.from.len()).filter_map(|joint| {
        let unit = match map.factor[joint] {
            1.0 => return None,
            _ if !slides(joint) && in_degrees(joint) && all_in_degrees => return None,
            _ if !slides(joint) && in_degrees(joint) => JointUnit::Degrees,
            1e-3 if slides(joint) => JointUnit::Millimetres,
            1e-2 if slides(joint) => JointUnit::Centimetres,
            _ => JointUnit::Scaled,
        };
        let factor = if unit == JointUnit::Degrees { degree } else { map.factor[joint] };
        Some(JointSlip { column: columns[joint], unit, factor })
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
    JointReading {
        degrees: all_in_degrees.then_some(slip),
        permutation: (!is_in_order).then_some((permutation, slip)),
        slips: slips.collect(),
        couplings: map.coupling.map(in_track).into_iter().collect(),
        zeros,
        left: Some(slip),
        runner_up_m: found.runner_up_m,
    }
}

/// Whether neither the stream nor FK moves the tip, whatever unit the joints are in.
fn rests(chain: &Chain, moments: &Moments) -> bool {
    let radians = in_radians(chain, moments);
    let fk = |moments: &Moments| -> Vec<Vec3> {
        let rows = moments.q.chunks_exact(chain.dof());
        rows.map(|q| chain.forward(q).translation.vector).collect()
    };
    [&moments.xyz, &fk(moments), &fk(&radians)].into_iter().all(|xyz| spread(xyz) < AT_REST_M)
}

/// Judges names and units at rest: a tip that is where the joint states put it speaks for them, as no
/// frame needs to be anything but what its name says. One that is elsewhere tells nothing.
fn read_at_rest(chain: &Chain, moments: &Moments, reference_known: bool) -> Seen<JointReading> {
    let off = |moments: &Moments| -> f64 {
        let rows = moments.q.chunks_exact(chain.dof()).zip(&moments.xyz);
        let squares =
            rows.map(|(q, xyz)| (chain.forward(q).translation.vector - xyz).norm_squared());
        (squares.sum::<f64>() / moments.xyz.len().max(1) as f64).sqrt()
    };
    let (as_logged, corrected) = (off(moments), off(&in_radians(chain, moments)));
    let is_there = |off: f64, other: f64| off < THERE * chain.max_reach_m() && off * BETTER < other;
    let degrees = match reference_known {
        true if is_there(as_logged, corrected) => None,
        true if is_there(corrected, as_logged) => Some(UnitSlip { as_logged, corrected }),
        _ => return Err(Unseen::AtRest),
    };
    Ok(JointReading { degrees, ..JointReading::default() })
}

/// The joint track as it should have been recorded, but for the zeros.
pub(super) fn corrected(
    joints: &JointTrack,
    reading: &JointReading,
    prismatic: &[bool],
) -> JointTrack {
    let mut track = joints.clone();
    if reading.degrees.is_some() {
        track.take_for_degrees(prismatic);
    }
    if let Some((permutation, _)) = &reading.permutation {
        let named = track.clone();
        for (to, from) in [(&mut track.q, &named.q), (&mut track.qd, &named.qd)] {
            for (row, source) in to.chunks_exact_mut(joints.dof).zip(from.chunks_exact(joints.dof))
            {
                for (named, &really) in permutation.iter().enumerate() {
                    row[really] = source[named];
                }
            }
        }
    }
    for slip in &reading.slips {
        for values in [&mut track.q, &mut track.qd] {
            let own = values.iter_mut().skip(slip.column).step_by(joints.dof);
            own.for_each(|value| *value *= slip.factor);
        }
    }
    for JointCoupling { column, by, factor } in &reading.couplings {
        for values in [&mut track.q, &mut track.qd] {
            let rows = values.chunks_exact_mut(joints.dof);
            rows.for_each(|row| row[*column] += factor.value * row[*by]);
        }
    }
    track
}

/// `track` with `zeros` added to its positions.
fn moved(track: &JointTrack, zeros: &[f64]) -> JointTrack {
    let mut moved = track.clone();
    for row in moved.q.chunks_exact_mut(track.dof.max(1)) {
        row.iter_mut().zip(zeros).for_each(|(q, zero)| *q += zero);
    }
    moved
}

/// Whether a stream's positions lie on the arm at latency `lag_s`, up to a tool offset or a turned
/// reference frame.
pub(super) fn lies_on_arm(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    lag_s: f64,
) -> bool {
    let moments = slow_moments(joints, stream, scale, lag_s);
    moments.xyz.len() >= 6 && misfit(stream.chain, &moments) < ON_ARM * spread(&moments.xyz)
}

/// Latencies at which the stream moves as the joints do, and none: what is left of the latency
/// hardly matters at slow moments, but a wrong one does.
fn lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let mut lags = vec![0.0];
    // By the numbers as they are, and as if all joints moved as much.
    for joints in [Cow::Borrowed(joints), Cow::Owned(evened(joints))] {
        let peaks = peaks(&joint_activity(&joints), &speed, most_lag_s);
        for peak in peaks.iter().filter(|peak| peak.correlation > 0.4).take(2) {
            if lags.iter().all(|lag_s| (peak.lag_s - lag_s).abs() > 0.01) {
                lags.push(peak.lag_s);
            }
        }
    }
    lags
}

/// What is left of the positions, rms m, when a constant tool offset is taken off.
fn unturned_misfit(chain: &Chain, moments: &Moments) -> f64 {
    let poses: Vec<Pose> = moments.q.chunks_exact(chain.dof()).map(|q| chain.forward(q)).collect();
    let expected = Expected::of(&poses);
    let plain = expected.tool_misfit(&moments.xyz);
    moments.inverse_xyz.as_ref().map_or(plain, |xyz| plain.min(expected.tool_misfit(xyz)))
}

/// What is left of the positions, rms m, when constant frames are taken off.
fn misfit(chain: &Chain, moments: &Moments) -> f64 {
    let poses: Vec<Pose> = moments.q.chunks_exact(chain.dof()).map(|q| chain.forward(q)).collect();
    let expected = Expected::of(&poses);
    let plain = expected.misfit(&moments.xyz);
    // An inverted stream's positions lie on the arm once they are inverted.
    moments.inverse_xyz.as_ref().map_or(plain, |inverse| plain.min(expected.misfit(inverse)))
}

#[cfg(test)]
mod tests;
