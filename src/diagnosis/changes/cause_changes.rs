//! Causes that step or drift: a slipped tool, a moved base, a tracker's or SLAM's world, a marker that creeps, a joint zero
//! that is lost or warms up, a radial scale.
//!
//! All changes are fitted to the residuals of all streams, together with constant causes and link deviations. Their
//! effect is removed from joint states and poses, and the run is diagnosed again.

use super::encoding_changes::Segments;
use super::jumps::{Jump, jumps_in_joints, jumps_in_logged_path};
use super::large_steps::{LargeStep, StepSize, large_steps};
use super::patches::with_poses;
use super::profile::Profile;
use super::score_test::{ChangeKind, likeliest_change};
use super::split_run::SplitRun;
use super::{FrameChange, JointChange, JointParameter, JointPatch, ScalarChange};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::compliance::{apply_compliance, diagnose_with_compliance, has_unusual_compliance};
use crate::latency::compensation::with_tracks;
use crate::model::measurement::{pose_of_twist, twist_at, twist_lengths, twist_of};
use crate::priors::{
    FRAME_PRIOR_M, LEVER_M, MODEL_ERROR_M, MODEL_ERROR_RAD, RAD_PER_M, RADIAL_SCALE_PRIOR,
    TOOL_PRIOR_M, ZERO_PRIOR, price,
};
use crate::residuals::cause_columns::{
    CauseColumns, Frame, RADIAL_SCALE, VariableColumns, ZEROS, shared_equations,
};
use crate::residuals::comparison::{has_slow_residual, residual_m, restore_recorded};
use crate::selection::evidence::likeliest;
use crate::solver::linear::{Linear, Normal, SharedEquations, StreamEquations, Weight};
use crate::{
    AlignedSamples, ArmDiagnosis, Confounder, FrameCorrection, FrameEstimate, JointOffset,
    PoseDiagnosis, PoseStream,
};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::stats::Measured;
use ground::stream::{PoseTrack, encoder_tick};
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};
use std::borrow::Cow;
use std::ops::Range;

/// What changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Subject {
    Frame { stream: usize, frame: Frame },
    RadialScale { stream: usize },
    Zero { column: usize },
}

impl Subject {
    /// Stream that it affects. A joint zero affects every stream.
    fn stream(self) -> Option<usize> {
        match self {
            Self::Frame { stream, .. } | Self::RadialScale { stream } => Some(stream),
            Self::Zero { .. } => None,
        }
    }
}

#[derive(Clone)]
pub(super) struct Change {
    pub subject: Subject,
    /// Variable columns of its stream. Of a joint zero, one.
    pub columns: Range<usize>,
    /// By the stamps of its stream, or of the joints for a joint zero.
    pub profile: Profile,
    /// Half of the change in its columns.
    pub half: DVector<f64>,
}

impl Change {
    /// Parameters of its amount and of a gradual profile, which has no effect without an amount.
    fn width(&self) -> usize {
        let has_amount = self.half.iter().any(|value| *value != 0.0);
        self.columns.len() + if has_amount { self.profile.derivatives(0.0).len() } else { 0 }
    }

    fn without_amount(&self) -> Self {
        Self { half: DVector::zeros(self.half.len()), ..self.clone() }
    }

    /// Minus twice the logarithm of the prior probability of its amount: large opposite changes are improbable.
    fn prior_cost(&self) -> f64 {
        let size = |column: usize| match self.subject {
            Subject::Frame { frame: Frame::Tool, .. }
                if Frame::Tool.translation().contains(&column) =>
            {
                TOOL_PRIOR_M
            }
            Subject::Frame { frame, .. } if frame.translation().contains(&column) => FRAME_PRIOR_M,
            Subject::Frame { .. } => RAD_PER_M * FRAME_PRIOR_M,
            Subject::RadialScale { .. } => RADIAL_SCALE_PRIOR,
            Subject::Zero { .. } => ZERO_PRIOR,
        };
        let amounts = self.columns.clone().zip(&self.half);
        amounts.map(|(column, half)| (2.0 * half / size(column)).powi(2)).sum()
    }

    /// `part` times its half, as a twist of its frame. Zero unless a frame changes.
    fn twist(&self, part: f64) -> Vector6<f64> {
        let mut twist = Vector6::zeros();
        if let Subject::Frame { frame, .. } = self.subject {
            let first = self.columns.start - frame.columns().start;
            twist.rows_mut(first, self.half.len()).copy_from(&(&self.half * part));
        }
        twist
    }
}

/// Added to the profile of each change to remove the change. The state that remains is the middle of all states.
const TO_MIDDLE: f64 = 0.0;
/// The state that remains is the first one, because slips and collisions happen later.
const TO_START: f64 = 1.0;

/// A stream that follows FK, and what changes it.
struct Stream<'a> {
    columns: CauseColumns<'a>,
    found: &'a PoseDiagnosis,
    index: usize,
}

impl<'a> Stream<'a> {
    fn all(run: &ArmRun<'a>, diagnosis: &'a ArmDiagnosis) -> Vec<Self> {
        let stream = |(index, found): (usize, &'a PoseDiagnosis)| {
            found.residual.as_ref().ok()?;
            let columns = CauseColumns::new(found, &run.streams[index]).with_free_zeros();
            Some(Self { columns, found, index })
        };
        diagnosis.streams.iter().enumerate().filter_map(stream).collect()
    }

    fn latency_s(&self) -> f64 {
        self.found.latency_s.as_ref().map_or(0.0, |latency| latency.value)
    }

    /// The change in this stream's columns and stamps. `None` if it does not affect the stream.
    fn seen(&self, change: &Change) -> Option<Change> {
        let Subject::Zero { column } = change.subject else {
            return (change.subject.stream() == Some(self.index)).then(|| change.clone());
        };
        let columns = self.columns.zero(column)?;
        let profile = change.profile.later(self.latency_s());
        Some(Change { profile, columns, ..change.clone() })
    }

    fn all_seen(&self, changes: &[Change]) -> Vec<Change> {
        changes.iter().filter_map(|change| self.seen(change)).collect()
    }

    /// The change that is seen in these columns. `None` for a latency.
    fn change(&self, profile: Profile, columns: Range<usize>) -> Option<Change> {
        let (stream, half) = (self.index, DVector::zeros(columns.len()));
        let subject = match Frame::of(&columns) {
            Some(frame) => Subject::Frame { stream, frame },
            None if columns.start == RADIAL_SCALE => Subject::RadialScale { stream },
            None => Subject::Zero { column: self.columns.joint_column(columns.start)? },
        };
        // Joint zeros change by the joints' stamps.
        let late_s = if subject.stream().is_none() { self.latency_s() } else { 0.0 };
        Some(Change { subject, columns, profile: profile.later(-late_s), half })
    }

    /// Columns with a factor of each sample's time.
    fn variable(&self, columns: &Range<usize>, factor: impl Fn(f64) -> f64) -> VariableColumns {
        let t_s = self.columns.samples().map(|row| self.columns.aligned.t_s[row]);
        VariableColumns {
            columns: columns.clone(),
            factors: t_s.map(factor).collect(),
            along: None,
        }
    }

    /// Columns of the amount of a change, then of the parameters of its profile, each with its parameter. The first is
    /// `first`.
    fn columns_of(&self, change: &Change, first: usize) -> Vec<(usize, VariableColumns)> {
        let Some(Change { columns, profile, half, .. }) = self.seen(change) else {
            return Vec::new();
        };
        let of_amount = columns.len();
        let of_profile = (0..change.width() - of_amount).map(|parameter| {
            let variable = self.variable(&columns, |t_s| profile.derivatives(t_s)[parameter]);
            (
                first + of_amount + parameter,
                VariableColumns { along: Some(half.clone()), ..variable },
            )
        });
        let amount = (first, self.variable(&columns, |t_s| profile.factor(t_s)));
        std::iter::once(amount).chain(of_profile).collect()
    }

    /// The likeliest change in addition to these, with its score. `None` without one, or if another change, such as one of
    /// the latency, is likelier.
    fn next_change(
        &self,
        changes: &[Change],
        linear: &Linear,
        kind: ChangeKind,
    ) -> Option<(Change, f64)> {
        if !has_slow_residual(self.found) {
            return None;
        }
        let seen = self.all_seen(changes);
        let likeliest =
            |weights: &[Weight]| likeliest_change(&self.columns, &seen, (linear, weights), kind);
        let (mut profile, mut columns, mut score) = likeliest(&self.columns.local_weights(linear))?;
        if kind.with_drifts {
            // The residual after this change has the weights that resolve its shape.
            let beside =
                self.columns.linearize(&[self.variable(&columns, |t_s| profile.factor(t_s))]);
            (profile, columns, score) = likeliest(&self.columns.local_weights(&beside))?;
        }
        Some((self.change(profile, columns)?, score))
    }

    /// Removes these changes of frames and radial scales from a corrected pose, [`TO_MIDDLE`] or [`TO_START`]. `constant`
    /// are twists of the reference and the tool.
    fn steady_pose(
        &self,
        seen: &[Change],
        target: f64,
        constant: &[Vector6<f64>; 2],
        is: &Pose,
        t_s: f64,
    ) -> Pose {
        let mut twists = *constant;
        let mut scale = 0.0;
        for change in seen {
            let part = change.profile.factor(t_s) + target;
            match change.subject {
                Subject::Frame { frame, .. } => twists[frame as usize] += change.twist(part),
                Subject::RadialScale { .. } => scale += part * change.half[0],
                Subject::Zero { .. } => {}
            }
        }
        let [reference, tool] =
            Frame::BOTH.map(|frame| self.columns.motion(frame, &twists[frame as usize]).inverse());
        let mut pose = reference * is * tool;
        pose.translation.vector /= 1.0 + scale;
        pose
    }

    /// Decoded poses, with frames and radial scale as at the start.
    fn steady_track(&self, changes: &[Change]) -> PoseTrack {
        let seen = self.all_seen(changes);
        let AlignedSamples { corrected, t_s, .. } = &self.found.aligned;
        let steady = |(is, &t_s): (&Pose, &f64)| {
            let pose = self.steady_pose(&seen, TO_START, &[Vector6::zeros(); 2], is, t_s);
            self.found.frame_correction.invert(&pose)
        };
        with_poses(self.found, corrected.iter().zip(t_s).map(steady))
    }

    /// The stream without these changes and constant changes of its frames, in the samples that are fitted.
    fn without(&self, changes: &[Change], constant: &[Vector6<f64>; 2]) -> Self {
        let seen = self.all_seen(changes);
        let chain = self.columns.chain;
        let dof = chain.dof();
        let zeros: Vec<&Change> = seen.iter().filter(|it| it.subject.stream().is_none()).collect();
        let mut aligned = self.found.aligned.clone();
        for row in self.columns.rows() {
            let t_s = aligned.t_s[row];
            aligned.corrected[row] =
                self.steady_pose(&seen, TO_MIDDLE, constant, &aligned.corrected[row], t_s);
            if !zeros.is_empty() {
                let q = &mut aligned.q_at_truth[row * dof..(row + 1) * dof];
                for zero in &zeros {
                    q[zero.columns.start - ZEROS] += zero.profile.factor(t_s) * zero.half[0];
                }
                aligned.fk_at_truth[row] = chain.forward(q);
            }
        }
        let mut columns = self.columns.clone();
        columns.aligned = Cow::Owned(aligned);
        Self { columns, ..*self }
    }

    /// A frame's change as reported, including the state of the other changes at its time. Steps refer to the frame's origin,
    /// drifts to the middle of the motion.
    fn report_frame(
        &self,
        change: &Change,
        frame: Frame,
        (covariance, dof): (&DMatrix<f64>, f64),
        all: &[Change],
    ) -> FrameChange {
        let mut of_twist = Matrix6::zeros();
        let first = change.columns.start - frame.columns().start;
        of_twist.view_mut((first, first), covariance.shape()).copy_from(&(covariance * 4.0));
        let is_step = change.profile.step().is_some();
        let about = match frame {
            Frame::Reference if is_step => self.columns.centre,
            _ => Vec3::zeros(),
        };
        // A rotation about the middle of the motion moves the origin.
        let to_origin = twist_at(&-about);
        let of_twist = to_origin * of_twist * to_origin.transpose();
        let [shift, turn] = twist_lengths(&(to_origin * change.twist(2.0)).into(), &of_twist, dof);
        let (at_s, _) = change.profile.interval_s();
        let base = [&self.found.reference, &self.found.tool][frame as usize].as_ref().ok();
        let base = base.filter(|base| base.is_chosen).map_or_else(Pose::identity, |base| base.pose);
        let others =
            all.iter().filter(|it| it.subject == change.subject && it.profile != change.profile);
        let of_others: Vector6<f64> =
            others.map(|other| other.twist(other.profile.factor(at_s) + TO_START)).sum();
        let about = Pose::from_parts(about.into(), Rotation::identity());
        let frame = |part: f64| {
            let twist = of_others + change.twist(part);
            let changed = about * pose_of_twist(twist.as_slice()) * about.inverse();
            match frame {
                // From the stream to the reference.
                Frame::Reference => changed.inverse(),
                Frame::Tool => changed,
            }
        };
        let (from, to) = (frame(0.0), frame(2.0));
        let pose = from.inv_mul(&to);
        let exact = |value: f64, linear: Measured| Measured { value, ..linear };
        let size = FrameEstimate {
            pose,
            translation_m: exact(pose.translation.vector.norm(), shift.norm),
            rotation_rad: exact(pose.rotation.angle(), turn.norm),
            p_value: shift.p_value.min(turn.p_value),
            is_chosen: true,
        };
        change.profile.change_point(from * base, to * base, size)
    }
}

/// Of each kind of residuals of each stream.
type Weights = Vec<Vec<Weight>>;

/// Equations of several changes and the constant causes of all streams.
struct Equations {
    shared: SharedEquations,
    normal: Normal,
    /// Parameters of each change: of its amount, then of its profile.
    changes: Vec<Range<usize>>,
}

impl Equations {
    /// `streams` are without the changes so far. `noise` gives the weights of each stream's samples; without it, they are
    /// from the residuals.
    fn new(streams: &[Stream], changes: &[Change], noise: Option<&Weights>) -> Self {
        let mut width = 0;
        let parameters = |change: &Change| {
            width += change.width();
            width - change.width()..width
        };
        let of_changes: Vec<Range<usize>> = changes.iter().map(parameters).collect();
        let columns = streams.iter().map(|stream| {
            let all = changes.iter().zip(&of_changes);
            let variable = all.flat_map(|(change, own)| stream.columns_of(change, own.start));
            (&stream.columns, variable.collect())
        });
        let mut shared = shared_equations(width, columns);
        for (index, equations) in shared.streams.iter_mut().enumerate() {
            let StreamEquations { linear, weights, .. } = equations;
            *weights = match noise {
                Some(noise) => noise[index].clone(),
                None => streams[index].columns.fit(linear, 1).weights,
            };
        }
        Self { normal: shared.normal(), shared, changes: of_changes }
    }

    /// The change whose removal adds the least cost.
    fn least_needed(&self, changes: &[Change]) -> Option<usize> {
        let cost_without = |at: usize| {
            let own = &self.changes[at];
            let mut values = DVector::zeros(self.normal.right.len());
            let half = &changes[at].half;
            values.rows_mut(own.start, half.len()).copy_from(half);
            let others: Vec<usize> = (0..values.len()).filter(|it| !own.contains(it)).collect();
            self.normal.cost_after(&self.normal.step(&values, &others))
        };
        let costs = (0..changes.len()).map(|at| (at, cost_without(at)));
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at)
    }

    /// Twice the log likelihood, minus the price of the changes.
    fn score(&self, changes: &[Change]) -> f64 {
        let parameters = |change: &Change| change.columns.len() + change.profile.parameters();
        let count = changes.iter().map(parameters).sum::<usize>();
        let of_prior = changes.iter().map(Change::prior_cost).sum::<f64>();
        let cost = self.normal.cost_after(&self.normal.full_step());
        -cost - price(self.normal.independent) * count as f64 - of_prior
    }
}

/// Jumps of the recorded numbers, of the joint states and of each stream.
struct RecordedJumps {
    of_joints: Vec<Jump>,
    of_streams: Vec<Vec<Jump>>,
    /// Tick of each joint's encoder; 0 if it is too small to show.
    ticks: Vec<f64>,
}

impl RecordedJumps {
    fn new(run: &ArmRun) -> Self {
        /// Of numbers with seven digits.
        const ROUNDING_RAD: f64 = 1e-6;
        let joints = run.joints;
        let tick = |column: usize| {
            let q = |row: usize| joints.row(row)[column];
            let distance = |a: usize, b: usize| (q(a) - q(b)).abs();
            encoder_tick(joints.len(), distance, ROUNDING_RAD).unwrap_or(0.0)
        };
        let of_stream = |stream| jumps_in_logged_path(run.joints, stream);
        Self {
            of_joints: jumps_in_joints(run.joints),
            of_streams: run.streams.iter().map(of_stream).collect(),
            ticks: (0..run.joints.dof).map(tick).collect(),
        }
    }

    /// Whether a change is rounding: positions at rest keep their error, which differs by up to a tick.
    fn is_rounding(&self, change: &Change) -> bool {
        matches!(change.subject, Subject::Zero { column } if 2.0 * change.half[0].abs() < self.ticks[column])
    }

    /// Dates a step by the jump in its interval. If it is dated late, a few samples keep its whole error. Whether there is a jump.
    fn date(&self, Change { subject, profile, .. }: &mut Change) -> bool {
        let Profile::Step(step) = profile else { return false };
        let jumps = subject.stream().map_or(&self.of_joints, |stream| &self.of_streams[stream]);
        let is_within =
            |jump: &&Jump| (jump.at_s - step.at_s).abs() <= step.within_s + jump.within_s;
        let strongest =
            jumps.iter().filter(is_within).max_by(|a, b| a.strength.total_cmp(&b.strength));
        if let Some(&Jump { at_s, within_s, .. }) = strongest {
            *step = Jump { at_s, within_s, ..*step };
        }
        strongest.is_some()
    }
}

/// Several changes with their amounts. Unobservable directions stay zero.
#[derive(Clone)]
struct Candidate {
    changes: Vec<Change>,
    /// Constant changes of the reference and tool of each stream: twists.
    frames: Vec<[Vector6<f64>; 2]>,
}

impl Candidate {
    fn new(changes: Vec<Change>, streams: &[Stream]) -> Self {
        Self { changes, frames: vec![[Vector6::zeros(); 2]; streams.len()] }
    }

    /// The streams without the changes.
    fn steady<'a>(&self, streams: &[Stream<'a>]) -> Vec<Stream<'a>> {
        let pairs = streams.iter().zip(&self.frames);
        pairs.map(|(stream, frames)| stream.without(&self.changes, frames)).collect()
    }

    /// Whatever their amounts.
    fn has_changes_of(&self, other: &Self) -> bool {
        let key = |it: &Change| (it.subject, it.columns.clone(), it.profile);
        self.changes.iter().map(key).eq(other.changes.iter().map(key))
    }

    fn fitted(mut self, streams: &[Stream]) -> Self {
        const MAX_STEPS: usize = 8;
        for _ in 0..MAX_STEPS {
            if self.step(&self.steady(streams)) {
                break;
            }
        }
        self
    }

    /// A step of the fit to the streams without the changes so far. Whether it is small.
    fn step(&mut self, steady: &[Stream]) -> bool {
        /// Of a profile, in parts of the run, and of an amount, relative to it.
        const MIN_PROFILE_STEP: f64 = 2e-3;
        const MIN_RELATIVE_STEP: f64 = 1e-3;
        let equations = Equations::new(steady, &self.changes, None);
        let step = equations.normal.full_step();
        for (frames, stream) in self.frames.iter_mut().zip(&equations.shared.streams) {
            let constant = stream.own_part(&step);
            for (twist, frame) in frames.iter_mut().zip(Frame::BOTH) {
                *twist += Vector6::from_column_slice(&constant[frame.columns()]);
            }
        }
        let mut is_small = true;
        for (change, own) in self.changes.iter_mut().zip(equations.changes) {
            let own = step.rows(own.start, own.len());
            let (half, profile) = own.as_slice().split_at(change.half.len());
            let half = DVector::from_column_slice(half);
            change.half += &half;
            change.profile = change.profile.stepped(profile);
            is_small &= half.norm() <= MIN_RELATIVE_STEP * change.half.norm()
                && profile.iter().all(|by| by.abs() < MIN_PROFILE_STEP);
        }
        is_small
    }

    /// With changes of tools in the place of those of references, which are rarer. `None` without such changes, or if a tool
    /// changes as well.
    fn with_tools(&self, streams: &[Stream]) -> Option<Self> {
        let mut other = self.clone();
        for Change { subject, columns, half, .. } in &mut other.changes {
            match subject {
                Subject::Frame { frame: Frame::Tool, .. } => return None,
                Subject::Frame { frame, .. } => *frame = Frame::Tool,
                _ => continue,
            }
            let first = columns.start + Frame::Tool.columns().start;
            *columns = first..first + columns.len();
            half.fill(0.0);
        }
        (!other.has_changes_of(self)).then(|| other.fitted(streams))
    }

    /// Weights of the residuals. Samples at a step do not count: their part of it is unknown.
    fn weights(&self, steady: &[Stream], equations: Equations) -> Weights {
        let of_stream = |(stream, equations): (&Stream, StreamEquations)| {
            let mut weights = equations.weights;
            let seen = stream.all_seen(&self.changes);
            let steps: Vec<Jump> = seen.iter().filter_map(|change| change.profile.step()).collect();
            for (sample, row) in stream.columns.samples().enumerate() {
                let t_s = stream.columns.aligned.t_s[row];
                if steps.iter().any(|step| (t_s - step.at_s).abs() <= step.within_s) {
                    weights.iter_mut().for_each(|weight| weight.leave_out(sample));
                }
            }
            weights
        };
        steady.iter().zip(equations.shared.streams).map(of_stream).collect()
    }

    fn score(&self, streams: &[Stream], noise: &Weights) -> f64 {
        Equations::new(&self.steady(streams), &self.changes, Some(noise)).score(&self.changes)
    }

    /// Without the change that is needed least, if that is likelier: later ones can explain the residual of an earlier one.
    fn reduced(&self, streams: &[Stream], noise: &Weights) -> Option<Self> {
        if self.changes.len() < 2 {
            return None;
        }
        let equations = Equations::new(&self.steady(streams), &self.changes, Some(noise));
        let mut fewer = self.clone();
        fewer.changes.remove(equations.least_needed(&self.changes)?);
        let fewer = fewer.fitted(streams);
        (fewer.score(streams, noise) > equations.score(&self.changes)).then_some(fewer)
    }
}

/// Of all residuals, m. Angles are weighted by 0.3 m.
fn sigma_m(weights: &Weights) -> f64 {
    let of_stream = |own: &Vec<Weight>| own[0].noise.sigma.hypot(LEVER_M * own[1].noise.sigma);
    weights.iter().map(of_stream).sum()
}

/// Adds the likeliest change until none is likely, and each number of changes to `found`. The search uses the noise within
/// tenths of the run, because the residual still contains the other changes.
fn search(
    streams: &[Stream],
    jumps: &RecordedJumps,
    kind: ChangeKind,
    found: &mut Vec<(Candidate, Weights)>,
) {
    const MAX_CHANGES: usize = 4;
    let mut current = Candidate::new(Vec::new(), streams);
    loop {
        let steady = current.steady(streams);
        let equations = Equations::new(&steady, &current.changes, None);
        let next = |(stream, equations): (&Stream, &StreamEquations)| {
            stream.next_change(&current.changes, &equations.linear, kind)
        };
        let can_grow = current.changes.len() < MAX_CHANGES * streams.len();
        let pairs = steady.iter().zip(&equations.shared.streams).filter(|_| can_grow);
        let next = pairs.filter_map(next).max_by(|a, b| a.1.total_cmp(&b.1));
        if !found.iter().any(|(known, _)| known.has_changes_of(&current)) {
            found.push((current.clone(), current.weights(&steady, equations)));
        }
        let Some((mut next, _)) = next else { break };
        let is_recorded = jumps.date(&mut next);
        // The joint states show a lost zero, and not a turn of the tool.
        let is_last = |stream: &Stream| {
            stream.seen(&next).is_none_or(|it| it.columns.start == stream.columns.last_zero())
        };
        if !is_recorded && next.subject.stream().is_none() && streams.iter().all(is_last) {
            break;
        }
        current.changes.push(next);
        current = match found.iter().find(|(known, _)| known.has_changes_of(&current)) {
            Some((known, _)) => known.clone(),
            None => current.fitted(streams),
        };
    }
}

/// Changes, and the run without them.
struct Removal {
    changes: Vec<Change>,
    /// Per stream, if it is affected.
    tracks: Vec<Option<PoseTrack>>,
    after: ArmDiagnosis,
}

/// `None` if the unexplained residual does not fall.
fn remove(run: &ArmRun, before: &ArmDiagnosis, changes: &[Change]) -> Option<Removal> {
    let none = changes.iter().map(Change::without_amount).collect();
    let tracks = vec![None; run.streams.len()];
    let nothing = Removal { changes: none, tracks, after: before.clone() };
    Some(nothing.with_more(run, before, changes)?.refined(run, before))
}

/// Value of a joint's zero or a radial scale relative to the start.
fn value_at<'a>(changes: impl Iterator<Item = &'a Change>, subject: Subject, t_s: f64) -> f64 {
    let own = changes.filter(|change| change.subject == subject);
    own.map(|change| (change.profile.factor(t_s) + TO_START) * change.half[0]).sum()
}

/// Spans between steps of a joint's zero, or in which it changes linearly.
fn zero_spans(changes: &[Change], column: usize) -> Vec<JointPatch> {
    let subject = Subject::Zero { column };
    let own = changes.iter().filter(|change| change.subject == subject);
    let mut knots: Vec<f64> = own.flat_map(|change| change.profile.knots_s()).collect();
    knots.sort_by(f64::total_cmp);
    let starts = std::iter::once(f64::NEG_INFINITY).chain(knots.iter().copied());
    let ends = knots.iter().copied().chain([f64::INFINITY]);
    let span = |(from_s, to_s): (f64, f64)| {
        // A step at the end belongs to the next span.
        let [offset, last] =
            [from_s, to_s.next_down()].map(|t_s| value_at(changes.iter(), subject, t_s));
        let span_s = to_s - from_s;
        let rate = if span_s.is_finite() && span_s > 0.0 { (last - offset) / span_s } else { 0.0 };
        JointPatch { offset, rate, ..JointPatch::unchanged(column, from_s, to_s) }
    };
    starts.zip(ends).map(span).collect()
}

impl Removal {
    /// `tracks` are without the changes of frames and radial scales.
    fn new(
        run: &ArmRun,
        before: &ArmDiagnosis,
        tracks: Vec<Option<PoseTrack>>,
        changes: Vec<Change>,
    ) -> Self {
        // Corrects joint zeros to the first one.
        let spans = (0..run.joints.dof).flat_map(|column| zero_spans(&changes, column));
        let patches: Vec<JointPatch> =
            spans.filter(|span| span.offset != 0.0 || span.rate != 0.0).collect();
        let mut joints = run.joints.clone();
        patches.iter().for_each(|patch| patch.apply(&mut joints));
        let streams = with_tracks(run.streams, &tracks);
        let mut after =
            ArmRun { joints: &joints, streams: &streams, ..*run }.diagnose_again(before);
        after.joints.patches = patches;
        Self { changes, tracks, after }
    }

    /// The changes, larger by `more`.
    fn changes_with(&self, more: &[Change]) -> Vec<Change> {
        let larger = |(change, more): (&Change, &Change)| Change {
            half: &change.half + &more.half,
            ..change.clone()
        };
        self.changes.iter().zip(more).map(larger).collect()
    }

    /// Also removes `more` of each change. `None` if a stream no longer follows FK, or the unexplained residual does not
    /// fall.
    fn with_more(&self, run: &ArmRun, before: &ArmDiagnosis, more: &[Change]) -> Option<Self> {
        let streams = Stream::all(run, &self.after);
        let mut tracks = self.tracks.clone();
        for stream in &streams {
            if more.iter().any(|change| change.subject.stream() == Some(stream.index)) {
                tracks[stream.index] = Some(stream.steady_track(more));
            }
        }
        let mut next = Self::new(run, before, tracks, self.changes_with(more));
        // Positions were divided by the radial scale so far: a tool that becomes longer looks like a scale.
        for Change { subject, columns, half, .. } in &mut next.changes {
            let Subject::Frame { stream, frame } = *subject else { continue };
            let [from, to] = [&self.after, &next.after]
                .map(|it| 1.0 + it.streams[stream].frame_correction.radial_scale);
            let lengths = columns.clone().zip(half.iter_mut());
            let lengths = lengths.filter(|(column, _)| frame.translation().contains(column));
            lengths.for_each(|(_, half)| *half *= from / to);
        }
        let after = Stream::all(run, &next.after);
        let [after_m, last_m] = [&after, &streams]
            .map(|all| all.iter().map(|stream| stream.columns.unexplained_m()).sum::<f64>());
        let explains_more = after.len() >= streams.len() && after_m < last_m;
        explains_more.then_some(next)
    }

    /// Refines the changes: the diagnosis without them shows the part that constant causes had absorbed.
    fn refined(mut self, run: &ArmRun, before: &ArmDiagnosis) -> Self {
        const MAX_ROUNDS: usize = 2;
        /// Relative to the changes so far; a larger step needs another diagnosis.
        const MIN_RELATIVE_STEP: f64 = 0.02;
        let norm = |changes: &[Change]| -> f64 {
            changes.iter().map(|change| change.half.norm_squared()).sum::<f64>().sqrt()
        };
        for _ in 0..MAX_ROUNDS {
            let steady = Stream::all(run, &self.after);
            let none = self.changes.iter().map(Change::without_amount).collect();
            let mut more = Candidate::new(none, &steady);
            more.step(&steady);
            let more = more.changes;
            if norm(&more) < MIN_RELATIVE_STEP * norm(&self.changes) {
                self.changes = self.changes_with(&more);
                break;
            }
            let Some(next) = self.with_more(run, before, &more) else { break };
            self = next;
        }
        self
    }

    /// The diagnosis with the changes. `None` if one of them is not significant, or a residual remains that link deviations
    /// do not explain: unknown faults of joints can look like changes.
    fn reported(self, run: &ArmRun, before: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let Self { changes, mut after, .. } = self;
        let found = after.clone();
        let streams = Stream::all(run, &found);
        /// Share of the residual before, for changes under autocorrelated noise.
        const MAX_RESIDUAL_SHARE: f64 = 0.5;
        let is_explained = |stream: &Stream| {
            let seen = changes.iter().any(|change| stream.seen(change).is_some());
            let columns = CauseColumns::new(stream.found, &run.streams[stream.index]);
            !seen || !has_slow_residual(stream.found) || !columns.has_unexplained_residual()
        };
        let is_noise = || {
            residual_m(&found) < MAX_RESIDUAL_SHARE * residual_m(before)
                && !streams.iter().any(|stream| depends_on_configuration(stream.found))
        };
        let confidence = match are_floating(run.streams) || streams.iter().all(is_explained) {
            true => 0.95,
            false if is_noise() => NOISE_CONFIDENCE,
            false => return None,
        };
        let equations = Equations::new(&streams, &changes, None);
        let dof = equations.normal.dof(equations.normal.right.len());
        let covariance = equations.shared.covariance();
        for (change, own) in changes.iter().zip(&equations.changes) {
            // Of half of its amount.
            let amounts = (change.columns.len(), change.columns.len());
            let covariance = &covariance.view((own.start, own.start), amounts).into_owned();
            let std_error = 2.0 * covariance[(0, 0)].sqrt();
            let size = Measured { value: 2.0 * change.half[0], std_error, dof };
            let differs = |size: &Measured| size.value.abs() > size.half_width(confidence);
            let is_significant = match change.subject {
                Subject::Frame { stream, frame } => {
                    let stream = streams.iter().find(|it| it.index == stream)?;
                    let reported = stream.report_frame(change, frame, (covariance, dof), &changes);
                    let FrameEstimate { translation_m, rotation_rad, .. } = &reported.size;
                    if translation_m.value < MODEL_ERROR_M && rotation_rad.value < MODEL_ERROR_RAD {
                        continue;
                    }
                    let is_significant = differs(translation_m) || differs(rotation_rad);
                    let stream = &mut after.streams[stream.index];
                    match frame {
                        Frame::Reference => stream.reference_changes.push(reported),
                        Frame::Tool => stream.tool_changes.push(reported),
                    }
                    is_significant
                }
                Subject::RadialScale { stream } => {
                    let stream = &mut after.streams[stream];
                    let base = stream.radial_scale.as_ref().ok();
                    let base = base.filter(|_| stream.is_radial_scale_chosen);
                    let at_start = base.map_or(0.0, |base| base.value);
                    let reported = report_value(change, at_start, size, &changes);
                    stream.radial_scale_changes.push(reported);
                    differs(&size)
                }
                Subject::Zero { column } => {
                    let at_start =
                        after.joints.offsets.get(column).map_or(0.0, JointOffset::chosen);
                    let change = report_value(change, at_start, size, &changes);
                    let parameter = JointParameter::Zero;
                    after.joints.changes.push(JointChange { column, parameter, change });
                    differs(&size)
                }
            };
            if !is_significant {
                return None;
            }
        }
        for (s, stream) in after.streams.iter_mut().enumerate() {
            stream.reference_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            stream.tool_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            stream.radial_scale_changes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            let is_own = changes.iter().any(|change| change.subject.stream() == Some(s));
            if is_own {
                keep_encoding(&before.streams[s], stream);
            }
            if is_own || !after.joints.patches.is_empty() {
                restore_recorded(run.joints, &run.streams[s], stream);
            }
        }
        let is_reported = !after.joints.changes.is_empty()
            || after.streams.iter().any(PoseDiagnosis::has_changes);
        report_confounders(run.streams, &mut after);
        is_reported.then_some(after)
    }
}

/// Confidence of decisions under autocorrelated noise.
const NOISE_CONFIDENCE: f64 = 0.999;

/// Whether the residual repeats with the configuration, unlike autocorrelated noise.
fn depends_on_configuration(found: &PoseDiagnosis) -> bool {
    let exceeds = |excess: &Measured| excess.value > excess.half_width(NOISE_CONFIDENCE);
    found.residual.as_ref().is_ok_and(|it| exceeds(&it.excess_m) || exceeds(&it.excess_rad))
}

/// A change of a joint's zero or a radial scale as reported.
fn report_value(change: &Change, at_start: f64, size: Measured, all: &[Change]) -> ScalarChange {
    let (at_s, _) = change.profile.interval_s();
    let others = all.iter().filter(|other| other.profile != change.profile);
    let from = at_start + value_at(others, change.subject, at_s);
    change.profile.change_point(from, from + size.value, size)
}

/// Reports in `after`, the diagnosis of decoded poses, the encoding that they had.
fn keep_encoding(before: &PoseDiagnosis, after: &mut PoseDiagnosis) {
    after.encoding.clone_from(&before.encoding);
    after.is_inverted = before.is_inverted;
    after.degrees = before.degrees;
    after.length_unit.clone_from(&before.length_unit);
    after.axes.clone_from(&before.axes);
    after.constant_coordinates.clone_from(&before.constant_coordinates);
}

/// For a single stream, the first joint's zero is equivalent to a base rotation, the last joint's to a tool rotation.
fn report_confounders(streams: &[PoseStream], after: &mut ArmDiagnosis) {
    let [stream] = streams else { return };
    let joints = &mut after.joints;
    for JointChange { column, change, .. } in &joints.changes {
        let by = change.size.value.abs();
        let is_at = |end: Option<&usize>| end == Some(column);
        let base = is_at(stream.columns.first()).then_some(Confounder::Reference(0, by));
        let tool = is_at(stream.columns.last()).then_some(Confounder::Tool(0, by));
        if let Some(offset) = joints.offsets.get_mut(*column) {
            offset.confounders = base.into_iter().chain(tool).collect();
        }
    }
}

/// Diagnoses the run with the changes of its causes removed, and reports them, with joint compliance if that is likelier.
/// `diagnosis` is of the uncorrected run. `None` if nothing changes.
pub(crate) fn diagnose_with_cause_changes(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let changes = likeliest_changes(run, diagnosis)?;
    let alone = remove(run, diagnosis, &changes).and_then(|it| it.reported(run, diagnosis));
    likeliest(alone.into_iter().chain(diagnose_beside_compliance(run, diagnosis, changes)))
}

/// With joint compliance, which resembles changes of joint zeros. Removes the changes of frames and radial scales to
/// estimate compliance, then removes compliance to estimate all changes. `None` without compliance or without such changes.
fn diagnose_beside_compliance(
    run: &ArmRun,
    diagnosis: &ArmDiagnosis,
    mut changes: Vec<Change>,
) -> Option<ArmDiagnosis> {
    const ROUNDS: usize = 2;
    for round in 1.. {
        let (of_streams, of_joints): (Vec<Change>, Vec<Change>) =
            changes.into_iter().partition(|change| change.subject.stream().is_some());
        if of_streams.is_empty() {
            break;
        }
        let Removal { tracks, after, .. } = remove(run, diagnosis, &of_streams)?;
        let streams = with_tracks(run.streams, &tracks);
        let steady = ArmRun { streams: &streams, ..*run };
        let with = diagnose_with_compliance(&steady, &after, has_unusual_compliance)?;
        let compliance = with.joints.compliance;
        let mut joints = run.joints.clone();
        apply_compliance(&mut joints, &compliance);
        let rigid = ArmRun { joints: &joints, ..*run };
        let constant = rigid.diagnose_again(diagnosis);
        changes = likeliest_changes(&rigid, &constant)?;
        if of_joints.is_empty() || round == ROUNDS {
            let mut found = remove(&rigid, &constant, &changes)?.reported(&rigid, &constant)?;
            found.joints.compliance = compliance;
            let streams = run.streams.iter().zip(&mut found.streams);
            streams.for_each(|(stream, found)| restore_recorded(run.joints, stream, found));
            return Some(found);
        }
    }
    None
}

fn likeliest_changes(run: &ArmRun, diagnosis: &ArmDiagnosis) -> Option<Vec<Change>> {
    let streams = Stream::all(run, diagnosis);
    if !streams.iter().any(|stream| has_slow_residual(stream.found)) {
        return None;
    }
    let jumps = RecordedJumps::new(run);
    let mut found = Vec::new();
    ChangeKind::ALL.into_iter().for_each(|kind| search(&streams, &jumps, kind, &mut found));
    found.retain(|(it, _)| !it.changes.iter().any(|change| jumps.is_rounding(change)));
    // With its own noise, a candidate that leaves a correlated residual would score less than one that leaves a larger
    // white residual.
    let weights = found.iter().map(|(_, weights)| weights);
    let noise = weights.min_by(|a, b| sigma_m(a).total_cmp(&sigma_m(b)))?.clone();
    let scored =
        found.into_iter().map(|(candidate, _)| (candidate.score(&streams, &noise), candidate));
    let (_, mut changed) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    while let Some(fewer) = changed.reduced(&streams, &noise) {
        changed = fewer;
    }
    if let Some(other) = changed.with_tools(&streams)
        && other.score(&streams, &noise) > changed.score(&streams, &noise)
    {
        changed = other;
    }
    (!changed.changes.is_empty()).then_some(changed.changes)
}

/// Diagnoses the run without the large steps between its segments, and reports them. `None` without such steps.
pub(super) fn diagnose_with_large_steps(
    run: &SplitRun,
    segments: &Segments,
    jumps: &[Jump],
) -> Option<ArmDiagnosis> {
    let (steps, tracks) = large_steps(segments, jumps, run)?;
    let before = &segments.longest.found;
    let zeros = steps.iter().filter_map(|it| it.change(run, &[])).collect();
    let removal = Removal::new(&run.arm, before, tracks, zeros);
    let changes = {
        let streams = Stream::all(&run.arm, &removal.after);
        steps.iter().map(|it| it.change(run, &streams)).collect::<Option<_>>()?
    };
    let removal = Removal { changes, ..removal };
    removal.refined(&run.arm, before).reported(&run.arm, before)
}

impl LargeStep {
    /// `None` for a frame of a stream that is not in `streams`.
    fn change(&self, run: &SplitRun, streams: &[Stream]) -> Option<Change> {
        match self.size {
            StepSize::Zero(column, by) => Some(Change {
                subject: Subject::Zero { column },
                columns: 0..1,
                profile: Profile::Step(self.jump),
                half: DVector::from_element(1, 0.5 * by),
            }),
            StepSize::Frame(index, frame, turns) => {
                let stream = streams.iter().find(|it| it.index == index)?;
                let FrameCorrection { reference, tool, .. } = &stream.found.frame_correction;
                let about = Pose::from_parts(stream.columns.centre.into(), Rotation::identity());
                let corrected = match frame {
                    Frame::Reference => reference * about,
                    Frame::Tool => tool.inverse(),
                };
                // Twists of one frame are added.
                let [before, after] = turns.map(|turn| {
                    DVector::from_row_slice(&twist_of(&(corrected.inverse() * turn * corrected)))
                });
                let half = (after - before) * 0.5;
                Some(Change {
                    subject: Subject::Frame { stream: index, frame },
                    columns: frame.columns(),
                    profile: Profile::Step(self.jump).later(run.lags[index]),
                    half,
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::test_motion;
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, Confounder, Course, PoseStream, diagnose_run};
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};

    /// Diagnosis of poses of the deviating arm in a world and a marker frame that are unknown, with 0.1 mm of noise.
    fn diagnosed(link_m: f64, changes: impl Fn(f64) -> [Vec3; 2]) -> ArmDiagnosis {
        let (joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(link_m);
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
        let track = test_motion::pose_track(&joints.t_s, poses);
        let stream =
            PoseStream { reference_known: false, ..test_motion::tip_stream(&track, &chain) };
        diagnose_run(&joints, &[stream], &[false; 6], 1.0)
    }

    /// Diagnosis of the deviating arm's poses, whose joints report less by this many degrees.
    fn diagnosed_zeros(link_m: f64, missing: impl Fn(f64, usize) -> f64) -> ArmDiagnosis {
        let (mut joints, chain) = test_motion::arm();
        let deviating = test_motion::deviating_chain(link_m);
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| deviating.forward(q));
        let poses = poses.map(|pose| {
            let [shift, turn] = [2e-5, 2e-5].map(|size| random.triple(size));
            let turn = rotation_from_rotvec(turn.into());
            (pose.translation.vector + Vec3::from(shift), turn * pose.rotation)
        });
        let track = test_motion::pose_track(&joints.t_s, poses);
        for (row, q) in joints.q.chunks_mut(6).enumerate() {
            let t_s = joints.t_s[row];
            q.iter_mut().enumerate().for_each(|(joint, q)| *q -= missing(t_s, joint).to_radians());
        }
        diagnose_run(&joints, &[test_motion::tip_stream(&track, &chain)], &[false; 6], 1.0)
    }

    #[test]
    fn a_long_tool_in_mid_run_is_no_scale() {
        let (joints, chain) = test_motion::arm();
        for at_s in [6.0, 9.0, 14.0] {
            let poses = joints.q.chunks(6).zip(&joints.t_s).map(|(q, &t_s)| {
                let tool = Vec3::new(0.0, 0.0, if t_s > at_s { 0.12 } else { 0.0 });
                let pose = chain.forward(q) * Pose::from_parts(tool.into(), Rotation::identity());
                (pose.translation.vector, pose.rotation)
            });
            let track = test_motion::pose_track(&joints.t_s, poses);
            let stream = test_motion::tip_stream(&track, &chain);
            let found = diagnose_run(&joints, &[stream], &[false; 6], 1.0);
            let [change] = found.streams[0].tool_changes.as_slice() else {
                panic!("{at_s}: {:?}", found.streams[0])
            };
            let size = &change.size.translation_m;
            assert!((size.value - 0.12).abs() < 1e-4, "{at_s}: {size:?}");
        }
    }

    #[test]
    fn a_small_step_of_a_joint_zero_is_measured() {
        for link_m in LINK_M {
            let step = |t_s: f64, joint| if joint == 2 && t_s > 11.0 { 0.15 } else { 0.0 };
            let found = diagnosed_zeros(link_m, step).joints;
            let [change] = found.changes.as_slice() else {
                panic!("{link_m}: {:?}", found.changes)
            };
            let zero = &change.change;
            let is_right = (zero.size.value.to_degrees() - 0.15).abs() < 0.01
                && change.column == 2
                && (zero.at_s - 11.0).abs() < 0.1;
            assert!(is_right, "{link_m}: {change:?}");
        }
    }

    #[test]
    fn a_step_of_the_last_zero_that_joint_states_show_is_no_turn_of_the_tool() {
        for link_m in LINK_M {
            let found = diagnosed_zeros(
                link_m,
                |t_s, joint| if joint == 5 && t_s > 11.0 { 0.7 } else { 0.0 },
            );
            let [change] = found.joints.changes.as_slice() else {
                panic!("{link_m}: {:?} {:?}", found.joints.changes, found.streams[0].tool_changes)
            };
            let zero = &change.change;
            let is_right = change.column == 5
                && (zero.size.value.to_degrees() - 0.7).abs() < 0.01
                && (zero.from, zero.to) == (0.0, zero.size.value);
            assert!(is_right, "{link_m}: {change:?}");
            assert!(found.streams[0].tool_changes.is_empty(), "{link_m}");
            let twins = &found.joints.offsets[5].confounders;
            assert!(matches!(twins.as_slice(), [Confounder::Tool(0, _)]), "{link_m}: {twins:?}");
        }
    }

    #[test]
    fn a_joint_zero_that_warms_up_is_measured() {
        let settling = |t_s: f64, tau_s: f64| 1.0 - (-t_s / tau_s).exp();
        for link_m in LINK_M {
            for tau_s in [4.0, 9.0] {
                let drift = |t_s, joint| if joint == 3 { 0.4 * settling(t_s, tau_s) } else { 0.0 };
                let found = diagnosed_zeros(link_m, drift).joints;
                let [change] = found.changes.as_slice() else {
                    panic!("{link_m} {tau_s}: {:?}", found.changes)
                };
                let zero = &change.change;
                let span_s = zero.at_s + zero.within_s;
                let is_right = change.column == 3
                    && (zero.size.value.to_degrees() - 0.4 * settling(span_s, tau_s)).abs() < 0.02
                    && matches!(zero.course, Course::Settling(found_s) if (found_s / tau_s - 1.0).abs() < 0.15);
                assert!(is_right, "{link_m} {tau_s}: {change:?}");
            }
        }
    }

    #[test]
    fn a_tool_that_slips_gradually_is_measured() {
        for link_m in LINK_M {
            let slip = |t_s: f64| Vec3::new(0.0, 4e-3, 3e-3) * ((t_s - 6.0) / 5.0).clamp(0.0, 1.0);
            let found = diagnosed(link_m, |t_s| [Vec3::zeros(), slip(t_s)]);
            let [change] = found.streams[0].tool_changes.as_slice() else {
                panic!("{link_m}: {:?}", found.streams[0].tool_changes)
            };
            let is_right = change.course == Course::Ramp
                && (change.size.translation_m.value - 5e-3).abs() < 2e-4
                && (change.at_s - 8.5).abs() < 0.2
                && (change.within_s - 2.5).abs() < 0.2;
            assert!(is_right, "{link_m}: {change:?}");
        }
    }

    #[test]
    fn three_zeros_lost_at_once_are_measured() {
        let lost = [0.0, 1.2, 1.4, 0.0, -1.1, 0.0];
        let step = |t_s: f64, joint: usize| if t_s > 8.0 { lost[joint] } else { 0.0 };
        for link_m in [0.0, 1e-4] {
            let found = diagnosed_zeros(link_m, step);
            let mut changes: Vec<(usize, f64)> = Vec::new();
            for change in &found.joints.changes {
                let zero = &change.change;
                changes.push((change.column, zero.size.value.to_degrees()));
            }
            changes.sort_by_key(|change| change.0);
            let is_near = changes.len() == 3
                && changes.iter().all(|(column, size)| (size - lost[*column]).abs() < 0.02);
            assert!(is_near, "{link_m}: {changes:?}");
            let stream = &found.streams[0];
            let frames = (&stream.reference_changes, &stream.tool_changes);
            assert!(!stream.has_changes(), "{link_m}: {frames:?} {:?}", stream.encoding_spans);
        }
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
