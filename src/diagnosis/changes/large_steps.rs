//! Steps of frames and joint zeros that turn a segment of the run so far that a linearisation at the other segments does not
//! show them. The diagnoses of the segments alone do.

use super::change::{Change, Subject};
use super::changing_stream::Stream;
use super::encoding_changes::{Segment, Segments};
use super::jumps::{Jump, jumps_in_joints};
use super::profile::Profile;
use super::removal::Removal;
use super::split_run::SplitRun;
use crate::model::measurement::twist_of;
use crate::residuals::cause_columns::Frame;
use crate::{ArmDiagnosis, FrameCorrection, JointOffset};
use ground::geometry::{Pose, Rotation};
use ground::stream::PoseTrack;
use nalgebra::DVector;

/// [`super::change_search`] finds smaller steps. The tests measure steps on both sides of it.
const MIN_STEP_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// A step of a stream's frame at a jump.
struct FrameStep {
    jump: Jump,
    stream: usize,
    frame: Frame,
    /// Turns of the logged poses before and after, from the left for the reference, from the right for the tool.
    turns: [Pose; 2],
}

/// Diagnoses the run without the large steps between its segments, and reports them. `None` without such steps.
pub(super) fn diagnose_with_large_steps(
    run: &SplitRun,
    segments: &Segments,
    jumps: &[Jump],
) -> Option<ArmDiagnosis> {
    let (frames, zeros, tracks) = large_steps(segments, jumps, run)?;
    let before = &segments.longest.found;
    let mut removal = Removal::new(&run.arm, before, tracks, zeros);
    let frames: Vec<Change> = {
        let streams = Stream::all(&run.arm, &removal.after);
        frames.iter().map(|step| step.change(run, &streams)).collect::<Option<_>>()?
    };
    removal.changes.splice(0..0, frames);
    removal.refined(&run.arm, before).reported(&run.arm, before)
}

impl FrameStep {
    /// `None` if its stream is not in `streams`.
    fn change(&self, run: &SplitRun, streams: &[Stream]) -> Option<Change> {
        let Self { jump, stream: index, frame, turns } = *self;
        let stream = streams.iter().find(|it| it.index == index)?;
        let FrameCorrection { reference, tool, .. } = &stream.found.frame_correction;
        let corrected = match frame {
            Frame::Reference => {
                reference * Pose::from_parts(stream.columns.centre.into(), Rotation::identity())
            }
            Frame::Tool => tool.inverse(),
        };
        // Twists of one frame are added.
        let [before, after] = turns.map(|turn| {
            DVector::from_row_slice(&twist_of(&(corrected.inverse() * turn * corrected)))
        });
        Some(Change {
            subject: Subject::Frame { stream: index, frame },
            columns: frame.columns(),
            profile: Profile::Step(jump).later(run.lags[index]),
            half: (after - before) * 0.5,
        })
    }
}

/// Frames of each stream, and the zero of each column, rad or m. If the positions do not jump, they hide no lost zero: then
/// the zero of an outer joint is a turn of the frame.
fn frames_and_zeros(
    run: &SplitRun,
    segment: &Segment,
    do_positions_jump: bool,
) -> (Vec<FrameCorrection>, Vec<f64>) {
    let ArmDiagnosis { streams, joints } = &segment.found;
    let mut frames: Vec<_> = streams.iter().map(|found| found.frame_correction).collect();
    let mut zeros: Vec<f64> = joints.offsets.iter().map(JointOffset::chosen).collect();
    for (stream, frames) in run.arm.streams.iter().zip(&mut frames).filter(|_| !do_positions_jump) {
        let last = stream.columns.len().saturating_sub(1);
        for (joint, frame) in [(0, Frame::Reference), (last, Frame::Tool)] {
            let zero = stream.columns.get(joint).and_then(|&column| zeros.get_mut(column));
            let Some(zero) = zero else { continue };
            let turned = |rad: f64| {
                let mut q = vec![0.0; stream.columns.len()];
                q[joint] = rad;
                stream.chain.forward(&q)
            };
            let (before, after) = (turned(0.0), turned(std::mem::take(zero)));
            match frame {
                Frame::Reference => frames.reference *= after * before.inverse(),
                Frame::Tool => frames.tool = before.inv_mul(&after) * frames.tool,
            }
        }
    }
    (frames, zeros)
}

/// Steps of frames, changes of joint zeros, and each stream's decoded poses without the steps of its frames.
type LargeSteps = (Vec<FrameStep>, Vec<Change>, Vec<Option<PoseTrack>>);

/// `None` if no step is large.
fn large_steps(segments: &Segments, jumps: &[Jump], run: &SplitRun) -> Option<LargeSteps> {
    let of_joints = jumps_in_joints(run.arm.joints);
    let streams = 0..run.arm.streams.len();
    let (mut frame_steps, mut zero_changes) = (Vec::new(), Vec::new());
    // Per segment and stream, from the left and the right.
    let mut turns = vec![vec![[Pose::identity(); 2]; streams.len()]];
    for (at, pair) in segments.all().windows(2).enumerate() {
        let jump = *jumps.iter().find(|jump| jump.at_s == pair[1].span.0)?;
        let do_positions_jump = of_joints.iter().any(|own| own.overlaps(&jump));
        let causes = |segment| frames_and_zeros(run, segment, do_positions_jump);
        let ((frames, zeros), (frames_after, zeros_after)) = (causes(pair[0]), causes(pair[1]));
        let mut turned = turns[at].clone();
        for (s, (before, after)) in frames.iter().zip(&frames_after).enumerate() {
            let reference = after.reference * before.reference.inverse();
            let tool = before.tool.inv_mul(&after.tool);
            for (frame, by) in [(Frame::Reference, reference), (Frame::Tool, tool)] {
                if by.rotation.angle() > MIN_STEP_RAD {
                    let turn = &mut turned[s][frame as usize];
                    let before = *turn;
                    *turn = match frame {
                        Frame::Reference => by * before,
                        Frame::Tool => before * by,
                    };
                    let turns = [before, *turn];
                    frame_steps.push(FrameStep { jump, stream: s, frame, turns });
                }
            }
        }
        turns.push(turned);
        for (column, (before, after)) in zeros.iter().zip(&zeros_after).enumerate() {
            let by = after - before;
            if !run.arm.is_prismatic[column] && by.abs() > MIN_STEP_RAD {
                zero_changes.push(Change {
                    subject: Subject::Zero { column },
                    columns: 0..1,
                    profile: Profile::Step(jump),
                    half: DVector::from_element(1, 0.5 * by),
                });
            }
        }
    }
    let track =
        |s: usize| Some(segments.decoded_track(s, |at| turns[at][s].map(|turn| turn.inverse())));
    let is_any = !frame_steps.is_empty() || !zero_changes.is_empty();
    is_any.then(|| (frame_steps, zero_changes, streams.map(track).collect()))
}

#[cfg(test)]
mod tests {
    use crate::test_motion::{arm, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, diagnose_run};
    use ground::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
    use std::ops::Range;

    /// Diagnosis of an arm that deviates by 0.1 mm. Its base, its tool and a joint zero turn in mid-run.
    fn diagnosed(base: Pose, tool: Pose, zero_rad: f64) -> ArmDiagnosis {
        diagnosed_within(9.0..f64::INFINITY, base, tool, zero_rad)
    }

    fn diagnosed_within(span_s: Range<f64>, base: Pose, tool: Pose, zero_rad: f64) -> ArmDiagnosis {
        const JOINT: usize = 3;
        let (mut joints, chain) = arm();
        let deviating = deviating_chain(1e-4);
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
            let fk = deviating.forward(q);
            let turned = if span_s.contains(&t_s) { base * fk * tool } else { fk };
            (turned.translation.vector + Vec3::from(random.triple(2e-5)), turned.rotation)
        });
        let track = pose_track(&joints.t_s, poses);
        for (q, t_s) in joints.q.chunks_mut(6).zip(&joints.t_s) {
            q[JOINT] -= if span_s.contains(t_s) { zero_rad } else { 0.0 };
        }
        diagnose_run(&joints, &[tip_stream(&track, &chain)], &[false; 6], 1.0)
    }

    #[test]
    fn a_tool_that_turns_and_returns_has_two_steps() {
        let tool = pose([0.03, 0.0, -0.02], rotation_from_rotvec(Vec3::new(0.0, 1.2, 0.6)));
        let found = diagnosed_within(6.0..13.0, Pose::identity(), tool, 0.0);
        let changes = &found.streams[0].tool_changes;
        let sizes: Vec<Pose> = changes.iter().map(|change| change.size.pose).collect();
        let [away, back] = sizes.as_slice() else { panic!("{changes:?}") };
        for (found, truth) in [(away, tool), (back, tool.inverse())] {
            let off = found.inv_mul(&truth);
            assert!(off.translation.vector.norm() < 1e-3, "{changes:?}");
            assert!(off.rotation.angle() < 2e-3, "{changes:?}");
        }
    }

    #[test]
    fn a_base_a_tool_or_a_zero_that_turns_by_any_angle_is_measured() {
        let turn = |rad: f64| {
            let axis = Vec3::new(0.48, -0.6, 0.64);
            pose([0.02, -0.05, 0.01], rotation_from_rotvec(axis * rad))
        };
        let none = Pose::identity();
        for rad in [8.0_f64, 15.0, 60.0, 170.0].map(f64::to_radians) {
            let base = diagnosed(turn(rad), none, 0.0);
            let [change] = base.streams[0].reference_changes.as_slice() else {
                panic!("{rad}: {:?}", base.streams[0])
            };
            let off = change.size.pose * turn(rad);
            assert!(off.translation.vector.norm() < 5e-4, "{rad}: {change:?}");
            assert!(off.rotation.angle() < 1e-3, "{rad}: {change:?}");

            let tool = diagnosed(none, turn(rad), 0.0);
            let [change] = tool.streams[0].tool_changes.as_slice() else {
                panic!("{rad}: {:?}", tool.streams[0])
            };
            let off = change.size.pose.inv_mul(&turn(rad));
            assert!(off.translation.vector.norm() < 5e-4, "{rad}: {change:?}");
            assert!(off.rotation.angle() < 1e-3, "{rad}: {change:?}");

            let zero = diagnosed(none, none, rad).joints;
            let [change] = zero.changes.as_slice() else { panic!("{rad}: {:?}", zero.changes) };
            let size = &change.change.size;
            assert_eq!(change.column, 3);
            assert!((size.value - rad).abs() < 1e-3, "{rad}: {size:?}");
        }
    }
}
