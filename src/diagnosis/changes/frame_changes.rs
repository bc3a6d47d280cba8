//! Frames that step or drift at a constant rate: a slipped tool, a moved base, a tracker's or SLAM's world, a marker
//! that creeps.
//!
//! The changes of a stream's frames are fitted to the residual together with constant causes and link deviations. Their
//! effect is removed from the poses, and the run is diagnosed again.

use super::encoding_changes::keep_encoding;
use super::frame_columns::{Frame, FrameColumns, VariableColumns};
use super::jumps::Jump;
use super::step_test::{self, likeliest_change};
use super::{ChangePoint, FrameChange, with_poses};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::latency::compensation::with_tracks;
use crate::model::measurement::pose_of_twist;
use crate::priors::price;
use crate::residuals::comparison::{has_slow_residual, residual_m, restore_recorded};
use crate::solver::linear::Linear;
use crate::solver::robust::sandwich;
use crate::{ArmDiagnosis, FrameEstimate, PoseDiagnosis};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::stats::{Measured, MeasuredLength};
use ground::stream::PoseTrack;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Change of a stream's frame.
#[derive(Clone)]
struct Change {
    frame: Frame,
    /// Columns of its change.
    columns: Range<usize>,
    /// `None` for a drift over the whole run.
    step: Option<Jump>,
    /// Half of the change, as a twist.
    half: [f64; 6],
}

/// Joint fit of what remains of several changes. Directions that the motion does not show stay zero.
struct Fit {
    /// Half of each change in its columns.
    halves: Vec<DVector<f64>>,
    covariances: Vec<DMatrix<f64>>,
    dof: f64,
    /// Reduction of the cost beyond constant causes, minus the price of the changes.
    score: f64,
}

impl Fit {
    fn new(columns: &FrameColumns, changes: &[Change]) -> Self {
        let linear = linearize(columns, changes);
        let constant = columns.constant();
        let all: Vec<usize> = (0..linear.width).collect();
        let none = DVector::zeros(linear.width);
        let first = columns.fit(&linear, &linear.first_weights());
        let weights = linear.weights_after(first.as_slice());
        let normal = columns.normal_equations(&linear, &weights);
        let step = normal.step(&none, &all);
        let without = normal.step(&none, &all[..constant]);
        let times = changes.iter().filter(|change| change.step.is_some()).count();
        let price = price(normal.independent) * (linear.width - constant + times) as f64;
        let targets: Vec<Option<usize>> = all.into_iter().map(Some).collect();
        let mut information = DMatrix::zeros(linear.width, linear.width);
        let mut scores = information.clone();
        linear.accumulate_covariance(&weights, &targets, &mut information, &mut scores);
        for column in 0..constant {
            // The prior is as good as samples.
            information[(column, column)] += columns.prior_precision(column);
            scores[(column, column)] += columns.prior_precision(column);
        }
        let covariance = sandwich(&information, &scores);
        let mut first = constant;
        let (halves, covariances) = changes
            .iter()
            .map(|change| {
                let (from, count) = (first, change.columns.len());
                first += count;
                let own = covariance.view((from, from), (count, count)).into_owned();
                (step.rows(from, count).into_owned(), own)
            })
            .unzip();
        Self {
            halves,
            covariances,
            dof: (normal.independent - linear.width as f64).max(3.0),
            score: normal.cost_after(&without) - normal.cost_after(&step) - price,
        }
    }
}

fn linearize(columns: &FrameColumns, changes: &[Change]) -> Linear {
    let factors: Vec<_> =
        changes.iter().map(|change| |t_s: f64| change.part(columns, t_s)).collect();
    let variable: Vec<VariableColumns> = changes
        .iter()
        .zip(&factors)
        .map(|(change, factor)| VariableColumns { columns: change.columns.clone(), factor })
        .collect();
    columns.linearize(&variable)
}

impl Change {
    /// Index of its first column in the twist.
    fn first(&self) -> usize {
        self.columns.start - self.frame.columns().start
    }

    /// From −1 before it to 1 after it.
    fn part(&self, columns: &FrameColumns, t_s: f64) -> f64 {
        match self.step {
            Some(step) if t_s < step.at_s => -1.0,
            Some(_) => 1.0,
            None => columns.part(t_s),
        }
    }

    /// With half of the change in its columns.
    fn with_half(&self, half: &DVector<f64>) -> Self {
        let mut change = Self { half: [0.0; 6], ..self.clone() };
        change.half[self.first()..self.first() + half.len()].copy_from_slice(half.as_slice());
        change
    }

    /// The change as reported, including the state of the other changes at its time. Steps refer to the frame's origin,
    /// drifts to the middle of the motion.
    fn report(
        &self,
        found: &PoseDiagnosis,
        columns: &FrameColumns,
        (covariance, dof): (&DMatrix<f64>, f64),
        all: &[Change],
    ) -> FrameChange {
        let mut of_twist = DMatrix::zeros(6, 6);
        let first = self.first();
        of_twist.view_mut((first, first), covariance.shape()).copy_from(&(covariance * 4.0));
        let about = match (self.frame, self.step) {
            (Frame::Reference, Some(_)) => columns.centre,
            _ => Vec3::zeros(),
        };
        // A rotation about the middle of the motion moves the origin.
        let mut to_origin = DMatrix::identity(6, 6);
        to_origin.view_mut((0, 3), (3, 3)).copy_from(&about.cross_matrix());
        let of_twist = &to_origin * of_twist * to_origin.transpose();
        let total = to_origin * DVector::from_iterator(6, self.half.iter().map(|half| 2.0 * half));
        let length = |first: usize| {
            let own = of_twist.view((first, first), (3, 3)).into_owned();
            MeasuredLength::estimate(&total.as_slice()[first..first + 3], &own, dof)
        };
        let (shift, turn) = (length(0), length(3));
        let (at_s, within_s) = match self.step {
            Some(step) => (step.at_s, step.within_s),
            None => (columns.aligned.middle_s(), columns.half_span_s()),
        };
        let base = match self.frame {
            Frame::Reference => &found.reference,
            Frame::Tool => &found.tool,
        };
        let base = base.as_ref().ok().filter(|frame| frame.is_chosen);
        let base = base.map_or_else(Pose::identity, |frame| frame.pose);
        let others = all.iter().filter(|it| it.frame == self.frame && it.step != self.step);
        let mut of_others = [0.0; 6];
        for other in others {
            let part = other.part(columns, at_s);
            of_others.iter_mut().zip(other.half).for_each(|(sum, half)| *sum += part * half);
        }
        let about = Pose::from_parts(about.into(), Rotation::identity());
        let frame = |part: f64| {
            let twist: [f64; 6] = std::array::from_fn(|i| of_others[i] + part * self.half[i]);
            let change = about * pose_of_twist(&twist) * about.inverse();
            match self.frame {
                // From the stream to the reference.
                Frame::Reference => change.inverse(),
                Frame::Tool => change,
            }
        };
        let (from, to) = (frame(-1.0), frame(1.0));
        let change = from.inv_mul(&to);
        let exact = |value: f64, linear: Measured| Measured { value, ..linear };
        ChangePoint {
            at_s,
            within_s,
            is_gradual: self.step.is_none(),
            from: from * base,
            to: to * base,
            size: FrameEstimate {
                pose: change,
                translation_m: exact(change.translation.vector.norm(), shift.norm),
                rotation_rad: exact(change.rotation.angle(), turn.norm),
                p_value: shift.p_value.min(turn.p_value),
                is_chosen: true,
            },
        }
    }
}

/// Changes of one stream's frames.
struct ChangingStream<'a> {
    run: &'a ArmRun<'a>,
    stream: usize,
    changes: Vec<Change>,
}

impl ChangingStream<'_> {
    fn columns<'a>(&'a self, diagnosis: &'a ArmDiagnosis) -> FrameColumns<'a> {
        let chain = self.run.streams[self.stream].chain;
        FrameColumns::new(&diagnosis.streams[self.stream], chain)
    }

    /// Adds the likeliest change until none is likely, and returns the likeliest number of them. The search uses the noise
    /// within tenths of the run, because the residual still contains the other changes.
    fn find(&self, diagnosis: &ArmDiagnosis) -> Vec<Change> {
        const MAX_CHANGES: usize = 4;
        let found = &diagnosis.streams[self.stream];
        let is_open = found.residual.is_ok() && !found.is_far_from_fk() && has_slow_residual(found);
        if !is_open {
            return Vec::new();
        }
        let columns = self.columns(diagnosis);
        let (mut changes, mut likeliest) = (Vec::new(), (0.0, 0));
        while changes.len() < MAX_CHANGES {
            let Some(change) = next_change(&columns, &changes) else { break };
            changes.push(change);
            let score = Fit::new(&columns, &changes).score;
            if score > likeliest.0 {
                likeliest = (score, changes.len());
            }
        }
        changes.truncate(likeliest.1);
        changes
    }

    /// Diagnoses the run without the changes. `None` if the residual does not fall.
    fn remove(
        &mut self,
        tracks: &mut Vec<Option<PoseTrack>>,
        before: &ArmDiagnosis,
    ) -> Option<ArmDiagnosis> {
        /// The later ones remove what constant causes had absorbed.
        const MAX_ROUNDS: usize = 3;
        /// Of the changes so far, for another round.
        const MIN_RELATIVE_STEP: f64 = 0.02;
        let mut after: Option<ArmDiagnosis> = None;
        for _ in 0..MAX_ROUNDS {
            let current = after.as_ref().unwrap_or(before);
            let halves = Fit::new(&self.columns(current), &self.changes).halves;
            let more: Vec<Change> =
                self.changes.iter().zip(&halves).map(|it| it.0.with_half(it.1)).collect();
            let norm = |changes: &[Change]| -> f64 {
                changes.iter().flat_map(|change| change.half).map(|half| half * half).sum()
            };
            if norm(&more).sqrt() < MIN_RELATIVE_STEP * norm(&self.changes).sqrt() {
                break;
            }
            let steady = self.steady_track(current, &more);
            let mut next_tracks = tracks.clone();
            next_tracks[self.stream] = Some(steady);
            let streams = with_tracks(self.run.streams, &next_tracks);
            let next = ArmRun { streams: &streams, ..*self.run }.diagnose();
            if residual_m(&next) >= residual_m(current) {
                break;
            }
            for (change, more) in self.changes.iter_mut().zip(&more) {
                change.half.iter_mut().zip(more.half).for_each(|(half, more)| *half += more);
            }
            *tracks = next_tracks;
            after = Some(next);
        }
        after
    }

    /// Decoded poses of the stream without these changes.
    fn steady_track(&self, diagnosis: &ArmDiagnosis, changes: &[Change]) -> PoseTrack {
        let (found, columns) = (&diagnosis.streams[self.stream], self.columns(diagnosis));
        let about = Pose::from_parts(columns.centre.into(), Rotation::identity());
        let steady = |(is, &t_s): (&Pose, &f64)| {
            let change = |frame: Frame| {
                let own = changes.iter().filter(|change| change.frame == frame);
                let mut twist = [0.0; 6];
                for change in own {
                    let part = change.part(&columns, t_s);
                    twist.iter_mut().zip(change.half).for_each(|(sum, half)| *sum += part * half);
                }
                pose_of_twist(&twist).inverse()
            };
            let (reference, tool) = (change(Frame::Reference), change(Frame::Tool));
            found.frame_correction.invert(&(about * reference * about.inverse() * is * tool))
        };
        let samples = columns.aligned.corrected.iter().zip(&columns.aligned.t_s);
        with_poses(found, samples.map(steady))
    }

    /// The changes as reported, in order of time. `after` is the diagnosis without them.
    fn reported(&self, after: &ArmDiagnosis) -> Vec<(Frame, FrameChange)> {
        let (columns, found) = (self.columns(after), &after.streams[self.stream]);
        let Fit { covariances, dof, .. } = Fit::new(&columns, &self.changes);
        let report = |(change, covariance): (&Change, &DMatrix<f64>)| {
            (change.frame, change.report(found, &columns, (covariance, dof), &self.changes))
        };
        let mut reported: Vec<(Frame, FrameChange)> =
            self.changes.iter().zip(&covariances).map(report).collect();
        reported.sort_by(|a, b| a.1.at_s.total_cmp(&b.1.at_s));
        reported
    }
}

/// Whether its size differs from zero.
fn is_significant(change: &FrameChange) -> bool {
    let FrameEstimate { translation_m, rotation_rad, .. } = &change.size;
    [translation_m, rotation_rad].into_iter().any(|size| size.value > size.half_width(0.95))
}

/// The likeliest change of a frame in addition to these. `None` without one, or if another change, such as one of the
/// latency, is likelier.
fn next_change(columns: &FrameColumns, changes: &[Change]) -> Option<Change> {
    let linear = linearize(columns, changes);
    let found = likeliest_change(columns, &linear, &columns.local_weights(&linear))?;
    let frame = Frame::of(&found.columns)?;
    Some(Change { frame, columns: found.columns, step: found.step, half: [0.0; 6] })
}

/// Score of a single change, with the noise after correcting it.
pub(super) fn score_alone(columns: &FrameColumns, found: &step_test::Change) -> f64 {
    let frame = Frame::of(&found.columns).unwrap_or(Frame::Tool);
    let (columns_of, step) = (found.columns.clone(), found.step);
    let change = Change { frame, columns: columns_of, step, half: [0.0; 6] };
    Fit::new(columns, &[change]).score
}

/// Diagnoses the run with the changes of its frames removed, and reports them. `diagnosis` is of the run as it is.
/// `None` if no frame changes.
pub(crate) fn diagnose_with_frame_changes(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let mut streams = Vec::new();
    let mut tracks: Vec<Option<PoseTrack>> = vec![None; run.streams.len()];
    let mut after: Option<ArmDiagnosis> = None;
    for stream in 0..run.streams.len() {
        let mut changing = ChangingStream { run, stream, changes: Vec::new() };
        let current = after.as_ref().unwrap_or(diagnosis);
        changing.changes = changing.find(current);
        if changing.changes.is_empty() {
            continue;
        }
        if let Some(next) = changing.remove(&mut tracks, current) {
            after = Some(next);
            streams.push(changing);
        }
    }
    let mut after = after?;
    // Unknown faults of joints can look like changes, but leave a residual that link deviations do not explain.
    let is_explained = |stream: &ChangingStream| {
        !has_slow_residual(&after.streams[stream.stream])
            || !stream.columns(&after).has_unexplained_residual()
    };
    if !are_floating(run.streams) && !streams.iter().all(is_explained) {
        return None;
    }
    let reported: Vec<_> = streams.iter().map(|stream| stream.reported(&after)).collect();
    // The last diagnosis may explain a change by constant causes.
    if !reported.iter().flatten().all(|(_, change)| is_significant(change)) {
        return None;
    }
    for (ChangingStream { stream, .. }, reported) in streams.iter().zip(reported) {
        let found = &mut after.streams[*stream];
        for (frame, change) in reported {
            match frame {
                Frame::Reference => found.reference_changes.push(change),
                Frame::Tool => found.tool_changes.push(change),
            }
        }
        keep_encoding(&diagnosis.streams[*stream], found);
        restore_recorded(run.joints, &run.streams[*stream], found);
    }
    Some(after)
}

#[cfg(test)]
mod tests {
    use crate::test_motion;
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, PoseStream, diagnose_run};
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};
    use ground::robot::{Chain, catalogue};
    use ground::stream::{Orientations, PoseTrack};

    /// The test arm, with links that deviate by this much, m, and 0.1° per mm.
    fn deviating_chain(link_m: f64) -> Chain {
        let robot = catalogue::find("ur5e").expect("it is in the catalogue");
        let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
        let path = robot.link_path(base, tip).expect("a serial arm");
        let mut random = Lcg::new();
        let deviations: Vec<Pose> = (0..7)
            .map(|_| {
                let [shift, turn] = [link_m, 1.745 * link_m].map(|size| random.triple(size));
                pose(shift, rotation_from_rotvec(turn.into()))
            })
            .collect();
        let robot = robot.with_deviations(&path, &deviations, &[]);
        let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
        robot.chain(base, tip).expect("a chain")
    }

    /// Diagnosis of poses of the deviating arm in a world and a marker frame that are unknown, with 0.1 mm of noise.
    fn diagnosed(link_m: f64, changes: impl Fn(f64) -> [Vec3; 2]) -> ArmDiagnosis {
        let (joints, chain) = test_motion::arm();
        let deviating = deviating_chain(link_m);
        let world = pose([0.4, -1.1, 0.7], rotation_from_rotvec(Vec3::new(0.1, 0.2, 1.3)));
        let marker = pose([0.02, 0.01, 0.06], rotation_from_rotvec(Vec3::new(0.3, -0.2, 0.5)));
        let shift = |by: Vec3| Pose::from_parts(by.into(), Rotation::identity());
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
            let [of_base, of_tool] = changes(t_s).map(shift);
            let mut logged = world * of_base * deviating.forward(q) * marker * of_tool;
            logged.translation.vector += Vec3::from(random.triple(1e-4));
            (logged.translation.vector, logged.rotation)
        });
        let (xyz, rotations) = poses.unzip();
        let track = PoseTrack {
            t_s: joints.t_s.clone(),
            xyz,
            orientation: Orientations::Rotations(rotations),
            declared: None,
        };
        let stream =
            PoseStream { reference_known: false, ..test_motion::tip_stream(&track, &chain) };
        diagnose_run(&joints, &[stream], &[false; 6], 1.0)
    }

    const LINK_M: [f64; 3] = [0.0, 1e-4, 3e-4];

    #[test]
    fn constant_frames_of_a_deviating_arm_do_not_change() {
        for link_m in LINK_M {
            let found = diagnosed(link_m, |_| [Vec3::zeros(); 2]);
            assert!(!found.streams[0].has_changes(), "{link_m}: {:?}", found.streams[0]);
        }
    }

    #[test]
    fn a_slip_of_a_deviating_arms_tool_is_measured() {
        let slip = Vec3::new(1.2e-3, 0.0, -1.6e-3);
        for link_m in LINK_M {
            let found = diagnosed(link_m, |t_s| {
                [Vec3::zeros(), if t_s < 9.0 { Vec3::zeros() } else { slip }]
            });
            let found = &found.streams[0];
            let [change] = found.tool_changes.as_slice() else {
                panic!("{link_m}: {:?} {:?}", found.tool_changes, found.reference_changes)
            };
            assert!((change.at_s - 9.0).abs() < 0.1, "{link_m}: {change:?}");
            let size = &change.size.translation_m;
            assert!((size.value - 2e-3).abs() < 1e-4, "{link_m}: {size:?}");
            assert!((size.value - 2e-3).abs() < 2.0 * size.half_width(0.95), "{link_m}: {size:?}");
            assert!(found.reference_changes.is_empty(), "{link_m}");
        }
    }

    #[test]
    fn a_base_that_moves_and_returns_has_two_steps() {
        for link_m in LINK_M {
            let found = diagnosed(link_m, |t_s| {
                let is_away = (6.0..13.0).contains(&t_s);
                [if is_away { Vec3::new(0.0, 4e-3, 0.0) } else { Vec3::zeros() }, Vec3::zeros()]
            });
            let changes = &found.streams[0].reference_changes;
            let at_s: Vec<f64> = changes.iter().map(|change| change.at_s).collect();
            let is_dated =
                at_s.len() == 2 && (at_s[0] - 6.0).abs() < 0.1 && (at_s[1] - 13.0).abs() < 0.1;
            assert!(is_dated, "{link_m}: {changes:?}");
            for change in changes {
                let size_m = change.size.translation_m.value;
                assert!((size_m - 4e-3).abs() < 2e-4, "{link_m}: {change:?}");
            }
        }
    }
}
