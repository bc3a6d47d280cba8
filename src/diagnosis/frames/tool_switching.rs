//! Tool switching: poses alternate between rigid bodies on one tool, as with a tracker that confuses
//! markers or a program that switches the TCP.
//!
//! `logged = world · FK · body`, with few values of `body`. A switch multiplies the pose on the right by
//! `body⁻¹ · other`, whatever the motion, and switching back by the inverse. Poses before and after each
//! interval are extrapolated to its middle, which removes smooth motion. A switch is a difference larger
//! than elsewhere and than FK's. Accumulated jumps identify the body.

use crate::compliance::motion_directions;
use crate::encodings::position::metres_by_size;
use crate::latency::correlation::median_period_s;
use crate::model::measurement::{pose_of_twist, twist_of};
use crate::samples::sampling::FkSequence;
use crate::{LengthUnitError, PoseDiagnosis, PoseSeries, PoseStream};
use ground::geometry::Pose;
use ground::stats::{Measured, quantile};
use ground::stream::JointTrack;
use nalgebra::Vector6;
use std::ops::Range;

const MIN_SAMPLES: usize = 60;
/// Shorter segments are outliers.
const MIN_SEGMENT_SAMPLES: usize = 4;
const MAX_BODIES: usize = 4;

/// Bodies between which poses alternate.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolSwitching {
    /// All but the usual one, which has most poses or comes first.
    pub others: Vec<SwitchedTool>,
    /// Total samples.
    pub samples: usize,
}

/// Body other than the usual one.
#[derive(Clone, Debug, PartialEq)]
pub struct SwitchedTool {
    /// `usual_from_other`.
    pub pose: Pose,
    /// Distance, m.
    pub length_m: Measured,
    /// Rotation, rad.
    pub angle_rad: Measured,
    /// Start and end, s.
    pub spans_s: Vec<[f64; 2]>,
    /// Samples of this body.
    pub samples: usize,
}

impl SwitchedTool {
    /// Whether its jumps are too inconsistent for a rigid body, as with stamp jitter.
    fn is_inconsistent(&self) -> bool {
        const MAX_RELATIVE_STD_ERROR: f64 = 0.1;
        let is_vague = |of: &Measured| of.std_error > MAX_RELATIVE_STD_ERROR * of.value;
        is_vague(&self.length_m) && is_vague(&self.angle_rad)
    }
}

impl ToolSwitching {
    /// Lengths in m for positions in another unit.
    pub fn converted_to_m(&self, found: &PoseDiagnosis) -> Self {
        let unit_error = found.length_unit.as_ref().ok().and_then(Option::as_ref);
        let factor = unit_error.map_or(1.0, LengthUnitError::factor);
        let mut scaled = self.clone();
        for other in &mut scaled.others {
            other.pose.translation.vector *= factor;
            other.length_m = other.length_m.scaled(factor);
        }
        scaled
    }
}

/// Detects switching. Returns the bodies, and all poses converted to the usual one. `None` if poses do not
/// alternate.
pub fn detect_tool_switching(
    joints: &JointTrack,
    stream: &PoseStream,
) -> Option<(ToolSwitching, Vec<Pose>)> {
    let track = stream.track;
    let poses = PoseSeries::from_track(track)?.poses;
    let period_s = median_period_s(&track.t_s);
    if poses.len() < MIN_SAMPLES || period_s <= 0.0 {
        return None;
    }
    let steps = pose_steps(&track.t_s, period_s, &poses);
    let limits = step_limits(joints, stream, period_s, &steps)?;
    let jumps = detect_jumps(&steps, limits);
    if jumps.len() < 2 || jumps.len() * MIN_SEGMENT_SAMPLES > poses.len() {
        return None;
    }
    let jumps_s: Vec<f64> = jumps.iter().map(|jump| track.t_s[jump.row]).collect();
    if is_backlash(joints, stream, &jumps_s) {
        return None;
    }
    let bodies = BodyAssignment::from_jumps(&jumps, poses.len(), limits)?;
    let usual = bodies.most_frequent();
    let (samples, mut corrected) = (poses.len(), poses);
    let mut others = Vec::new();
    for body in (0..bodies.poses.len()).filter(|body| *body != usual) {
        let mut other = bodies.switched_tool(body, usual);
        if other.is_inconsistent() {
            return None;
        }
        let other_from_usual = other.pose.inverse();
        for (rows, _) in bodies.segments.iter().filter(|(_, of)| *of == body) {
            other.spans_s.push([track.t_s[rows.start], track.t_s[rows.end - 1]]);
            other.samples += rows.len();
            corrected[rows.clone()].iter_mut().for_each(|pose| *pose *= other_from_usual);
        }
        others.push(other);
    }
    Some((ToolSwitching { others, samples }, corrected))
}

/// Difference of consecutive poses, both extrapolated to the middle of the interval.
#[derive(Clone, Copy)]
struct PoseStep {
    /// Later sample.
    row: usize,
    displacement: Pose,
    /// m, rad.
    sizes: [f64; 2],
    /// Interval over the shorter adjacent one. Noise grows linearly with it, motion quadratically.
    times: f64,
}

/// Limits without a switch, in the unit of the positions and rad.
#[derive(Clone, Copy)]
struct StepLimits {
    noise: [f64; 2],
    motion: [f64; 2],
}

impl StepLimits {
    /// Size relative to the limits at interval ratio `times`.
    fn relative_size(&self, sizes: [f64; 2], times: f64) -> f64 {
        let most = |kind: usize| (times * self.noise[kind]).max(times * times * self.motion[kind]);
        (0..2).map(|kind| sizes[kind] / most(kind)).fold(0.0, f64::max)
    }
}

fn pose_steps(t_s: &[f64], period_s: f64, poses: &[Pose]) -> Vec<PoseStep> {
    /// More distant poses are not comparable.
    const MAX_INTERVAL_PERIODS: f64 = 15.0;
    let twist = |a: usize, b: usize| twist_of(&(poses[a].inverse() * poses[b]));
    let of = |row: usize| {
        let before_s = t_s[row - 1] - t_s[row - 2];
        let (between_s, after_s) = (t_s[row] - t_s[row - 1], t_s[row + 1] - t_s[row]);
        let most_s = MAX_INTERVAL_PERIODS * period_s;
        if before_s > most_s || between_s > most_s || after_s > most_s {
            return None;
        }
        let part = |over_s: f64, sign: f64, twist: [f64; 6]| {
            pose_of_twist(&twist.map(|one| sign * 0.5 * between_s / over_s * one))
        };
        let from = poses[row - 1] * part(before_s, 1.0, twist(row - 2, row - 1));
        let to = poses[row] * part(after_s, -1.0, twist(row, row + 1));
        let by = from.inverse() * to;
        let times = (between_s / before_s.min(after_s)).max(1.0);
        let sizes = [by.translation.vector.norm(), by.rotation.angle()];
        Some(PoseStep { row, displacement: by, sizes, times })
    };
    (2..poses.len().saturating_sub(1)).filter_map(of).collect()
}

/// Larger steps are neither motion nor noise.
fn step_limits(
    joints: &JointTrack,
    stream: &PoseStream,
    period_s: f64,
    steps: &[PoseStep],
) -> Option<StepLimits> {
    /// Factor on the quantile of steps, the quantile, and factor on the largest FK step.
    const QUANTILE_FACTOR: f64 = 6.0;
    const STEP_QUANTILE: f64 = 0.85;
    const FK_STEP_FACTOR: f64 = 3.0;
    /// From the tip.
    const MAX_BODY_DISTANCE_M: f64 = 0.2;
    const MIN_JUMP_M_RAD: [f64; 2] = [5e-4, 3e-3];
    let mut fk = FkSequence::new(joints, stream.chain, stream.columns);
    // At the stream's stamps.
    let covered = stream.track.t_s.iter().filter_map(|&t_s| Some((t_s, fk.at(t_s)?)));
    let (t_s, fk): (Vec<f64>, Vec<Pose>) = covered.unzip();
    let by_fk = pose_steps(&t_s, period_s, &fk);
    let most = |kind: usize| {
        let sizes = by_fk.iter().map(|step| step.sizes[kind] / step.times.powi(2));
        FK_STEP_FACTOR * sizes.fold(0.0, f64::max)
    };
    let most_rad = most(1);
    let [min_jump_m, min_jump_rad] = MIN_JUMP_M_RAD;
    let unit_m = metres_by_size(joints, stream);
    let mut limits = StepLimits {
        noise: [min_jump_m / unit_m, min_jump_rad],
        motion: [(most(0) + MAX_BODY_DISTANCE_M * most_rad) / unit_m, most_rad],
    };
    for kind in 0..2 {
        let mut sizes: Vec<f64> = steps.iter().map(|step| step.sizes[kind] / step.times).collect();
        limits.noise[kind] =
            limits.noise[kind].max(QUANTILE_FACTOR * quantile(&mut sizes, STEP_QUANTILE)?);
    }
    Some(limits)
}

/// Local maxima beyond the limits.
fn detect_jumps(steps: &[PoseStep], limits: StepLimits) -> Vec<PoseStep> {
    /// Adjacent steps show a jump at half its size.
    const SPREAD_STEPS: usize = 2;
    let size = |step: &PoseStep| limits.relative_size(step.sizes, step.times);
    let is_jump = |at: &usize| {
        let about = at.saturating_sub(SPREAD_STEPS)..(at + SPREAD_STEPS + 1).min(steps.len());
        let own = size(&steps[*at]);
        own > 1.0 && about.filter(|other| other != at).all(|other| size(&steps[other]) < own)
    };
    (0..steps.len()).filter(is_jump).map(|at| steps[at]).collect()
}

/// Whether poses jump exactly at the reversals of one joint.
fn is_backlash(joints: &JointTrack, stream: &PoseStream, jumps_s: &[f64]) -> bool {
    /// The joint moves little in this time.
    const MAX_REVERSAL_DISTANCE_S: f64 = 0.3;
    let is_of = |&column: &usize| {
        let directions = motion_directions(joints.len(), |row| joints.row(row)[column]);
        let reversals =
            (1..directions.len()).filter(|&row| directions[row - 1] * directions[row] < 0.0);
        let reversal_s: Vec<f64> = reversals.map(|row| joints.t_s[row]).collect();
        let near = |a: &[f64], b: f64| a.iter().any(|a| (a - b).abs() < MAX_REVERSAL_DISTANCE_S);
        // The initial position in the backlash is unknown, so one jump may be unmatched.
        let missed = jumps_s.iter().filter(|at_s| !near(&reversal_s, **at_s)).count();
        let meet = reversal_s.iter().all(|at_s| near(jumps_s, *at_s));
        !reversal_s.is_empty() && missed <= 1 && meet
    };
    stream.columns.iter().any(is_of)
}

struct BodyAssignment {
    /// Samples and body, in order of time.
    segments: Vec<(Range<usize>, usize)>,
    /// `first_from_body`, and the largest interval ratio of its jumps. In the order of their first segments.
    poses: Vec<(Pose, f64)>,
    /// With the bodies before and after.
    jumps: Vec<(usize, usize, PoseStep)>,
}

impl BodyAssignment {
    /// `None` if no body recurs.
    fn from_jumps(jumps: &[PoseStep], samples: usize, limits: StepLimits) -> Option<Self> {
        /// In limits.
        const MAX_SAME_BODY_DISTANCE: f64 = 1.0;
        let mut bodies =
            Self { segments: Vec::new(), poses: vec![(Pose::identity(), 1.0)], jumps: Vec::new() };
        let (mut from, mut body) = (0, 0);
        for jump in jumps {
            if jump.row < from + MIN_SEGMENT_SAMPLES {
                return None;
            }
            bodies.segments.push((from..jump.row, body));
            let (here, times) = bodies.poses[body];
            let (there, times) = (here * jump.displacement, times.max(jump.times));
            let distance = |(own, own_times): &(Pose, f64)| {
                let difference = own.inverse() * there;
                let sizes = [difference.translation.vector.norm(), difference.rotation.angle()];
                limits.relative_size(sizes, times.max(*own_times))
            };
            let near = bodies.poses.iter().map(distance).enumerate();
            let nearest = near
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .filter(|(_, far)| *far < MAX_SAME_BODY_DISTANCE);
            let next = match nearest {
                Some((known, _)) => known,
                None => {
                    bodies.poses.push((there, times));
                    bodies.poses.len() - 1
                }
            };
            bodies.jumps.push((body, next, *jump));
            (from, body) = (jump.row, next);
        }
        bodies.segments.push((from..samples, body));
        // Without recurrence nothing switches. Many bodies indicate another problem.
        let recurs = bodies.segments.len() > bodies.poses.len();
        let is_short = samples - from < MIN_SEGMENT_SAMPLES;
        (recurs && !is_short && (2..=MAX_BODIES).contains(&bodies.poses.len())).then_some(bodies)
    }

    /// The first body if it has nearly as many samples.
    fn most_frequent(&self) -> usize {
        const MIN_FIRST_BODY_SHARE: f64 = 0.8;
        let samples = |body: usize| {
            let own = self.segments.iter().filter(|(_, of)| *of == body);
            own.map(|(rows, _)| rows.len()).sum::<usize>()
        };
        let most = (0..self.poses.len()).max_by_key(|&body| samples(body)).unwrap_or(0);
        let is_first = samples(0) as f64 >= MIN_FIRST_BODY_SHARE * samples(most) as f64;
        if is_first { 0 } else { most }
    }

    /// Mean of jumps to and from the usual body, weighted by inverse variance.
    fn switched_tool(&self, body: usize, usual: usize) -> SwitchedTool {
        let first = self.poses[usual].0.inverse() * self.poses[body].0;
        let between = self.jumps.iter().filter_map(
            |&(from, to, PoseStep { displacement: by, times, .. })| {
                let by = match (from, to) {
                    _ if (from, to) == (usual, body) => by,
                    _ if (from, to) == (body, usual) => by.inverse(),
                    _ => return None,
                };
                Some((Vector6::from(twist_of(&(first.inverse() * by))), times.powi(-2)))
            },
        );
        let mut about: Vec<(Vector6<f64>, f64)> = between.collect();
        if about.is_empty() {
            // No direct jump.
            about.push((Vector6::zeros(), 1.0));
        }
        let n = about.len() as f64;
        let total: f64 = about.iter().map(|(_, weight)| weight).sum();
        let mean = about.iter().map(|(one, weight)| one * *weight).sum::<Vector6<f64>>() / total;
        let pose = first * pose_of_twist(mean.as_slice());
        let error = |first: usize| {
            let squares = about
                .iter()
                .map(|(one, weight)| weight * (one - mean).fixed_rows::<3>(first).norm_squared());
            match about.len() {
                1 => f64::INFINITY,
                _ => (squares.sum::<f64>() / 3.0 / (n - 1.0) / total).sqrt(),
            }
        };
        let measured = |value: f64, first: usize| Measured {
            value,
            std_error: error(first),
            dof: (3.0 * (n - 1.0)).max(1.0),
        };
        SwitchedTool {
            length_m: measured(pose.translation.vector.norm(), 0),
            angle_rad: measured(pose.rotation.angle(), 3),
            pose,
            spans_s: Vec::new(),
            samples: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_motion::{arm, pose_track, tip_stream};
    use ground::geometry::{angle_between, rotation_from_rpy};

    /// Tracker poses with another body at some times, in a possibly moving world.
    fn found(
        other: &dyn Fn(f64) -> Option<Pose>,
        world: &dyn Fn(f64) -> Pose,
    ) -> Option<(ToolSwitching, Vec<Pose>, Vec<Pose>)> {
        let (joints, chain) = arm();
        let body = Pose::from_parts([0.03, 0.0, 0.06].into(), rotation_from_rpy([0.7, 0.3, -1.1]));
        let (mut t_s, mut usual, mut logged) = (Vec::new(), Vec::new(), Vec::new());
        let mut sequence = joints.sequence();
        for row in 10..1900 {
            let stamp = f64::from(row) * 0.01 + 0.003;
            let (q, _) = sequence.at(stamp).expect("joint states");
            let pose = world(stamp) * chain.forward(q) * body;
            t_s.push(stamp);
            usual.push(pose);
            let pose = pose * other(stamp).unwrap_or_default();
            logged.push((pose.translation.vector, pose.rotation));
        }
        let track = pose_track(&t_s, logged);
        let stream = PoseStream { reference_known: false, ..tip_stream(&track, &chain) };
        let (alternation, corrected) = detect_tool_switching(&joints, &stream)?;
        Some((alternation, corrected, usual))
    }

    fn still(_: f64) -> Pose {
        Pose::from_parts([1.0, 0.2, 0.4].into(), rotation_from_rpy([0.1, -0.2, 2.1]))
    }

    #[test]
    fn alternating_bodies_are_identified_and_corrected() {
        let [one, two] =
            [([0.005, 0.0, 0.0], [0.0, 0.0, 2.0]), ([0.0, 0.06, 0.0], [0.0, 0.4, 0.0])]
                .map(|(xyz, rpy)| Pose::from_parts(xyz.into(), rotation_from_rpy(rpy)));
        let other = |t_s: f64| match t_s {
            4.0..6.0 | 9.0..9.3 => Some(one),
            7.0..8.0 | 14.0..16.0 => Some(two),
            _ => None,
        };
        let (alternation, mended, usual) = found(&other, &still).expect("it alternates");
        assert_eq!(alternation.others.len(), 2);
        for (other, planted) in alternation.others.iter().zip([one, two]) {
            let off = other.pose.inverse() * planted;
            assert!(off.translation.vector.norm() < 1e-3 && off.rotation.angle() < 3e-3, "{off}");
            assert_eq!(other.spans_s.len(), 2);
        }
        for (mended, usual) in mended.iter().zip(&usual) {
            let off_m = (mended.translation.vector - usual.translation.vector).norm();
            assert!(off_m < 1e-3 && angle_between(&mended.rotation, &usual.rotation) < 3e-3);
        }
    }

    #[test]
    fn a_single_change_motion_or_world_jump_is_no_tool_switching() {
        let body = Pose::from_parts([0.05, 0.0, 0.0].into(), rotation_from_rpy([0.0, 0.0, 1.0]));
        assert!(found(&|_| None, &still).is_none());
        assert!(found(&|t_s| (t_s > 8.0).then_some(body), &still).is_none());
        let jumps =
            |t_s: f64| if (5.0..9.0).contains(&t_s) { body * still(t_s) } else { still(t_s) };
        assert!(found(&|_| None, &jumps).is_none());
    }

    #[test]
    fn limits_are_in_the_unit_of_the_positions() {
        let (joints, chain) = arm();
        let limits = [1.0, 1e-3].map(|unit_m: f64| {
            let poses: Vec<Pose> = joints.q.chunks(6).map(|q| chain.forward(q)).collect();
            let logged = poses.iter().map(|pose| (pose.translation.vector / unit_m, pose.rotation));
            let track = pose_track(&joints.t_s, logged);
            let stream = tip_stream(&track, &chain);
            let period_s = median_period_s(&joints.t_s);
            step_limits(&joints, &stream, period_s, &pose_steps(&joints.t_s, period_s, &poses))
                .expect("the arm moves")
        });
        let [metres, millimetres] = limits.map(|limits| [limits.noise[0], limits.motion[0]]);
        for (metres, millimetres) in metres.into_iter().zip(millimetres) {
            assert!((millimetres / metres - 1000.0).abs() < 1e-6, "{metres} m, {millimetres} mm");
        }
    }
}
