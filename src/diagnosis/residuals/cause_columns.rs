//! Residual of a diagnosis, with its derivatives by small changes of the reference, the tool frame, the latency, the joint
//! zeros and the links.
//!
//! No arm is exactly its model. Tests of changes and compliance therefore include constant deviations of the links, with a
//! prior.

use crate::model::jacobian::link_derivatives;
use crate::model::measurement::{ExcludedComponents, FLOOR_M, FLOOR_RAD, pose_of_twist, stacked};
use crate::priors::{LEVER_M, LINK_PRIOR_M, LINK_PRIOR_RAD, RADIAL_SCALE_PRIOR};
use crate::residuals::comparison::{exceeds_noise, has_slow_means, minus_segment_means};
use crate::selection::nominal_model::rms_of_kinds;
use crate::solver::linear::{
    Linear, Normal, ReweightedFit, SharedEquations, StreamEquations, Weight,
};
use crate::{AlignedSamples, PoseDiagnosis, PoseStream};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::robot::{Chain, JointKind};
use nalgebra::{DMatrix, DVector, Vector6};
use std::borrow::Cow;
use std::ops::Range;

/// One of a stream's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Frame {
    Reference,
    Tool,
}

impl Frame {
    pub const BOTH: [Self; 2] = [Self::Reference, Self::Tool];

    /// Columns of its constant change, a twist.
    pub const fn columns(self) -> Range<usize> {
        match self {
            Self::Reference => 0..6,
            Self::Tool => 6..12,
        }
    }

    pub const fn translation(self) -> Range<usize> {
        let Range { start, .. } = self.columns();
        start..start + 3
    }

    pub const fn rotation(self) -> Range<usize> {
        let Range { start, end } = self.columns();
        start + 3..end
    }

    /// Of some of its columns.
    pub fn of(columns: &Range<usize>) -> Option<Self> {
        Self::BOTH.into_iter().find(|frame| frame.columns().contains(&columns.start))
    }
}

/// Columns of the latency, the radial scale, and the skew.
pub(crate) const LATENCY: usize = 12;
pub(crate) const RADIAL_SCALE: usize = LATENCY + 1;
/// Number of columns of constant causes besides the links.
const CAUSES: usize = RADIAL_SCALE + 2;
/// Variable column of the first joint's zero. Those before are constant columns.
pub(crate) const ZEROS: usize = RADIAL_SCALE + 1;

/// Columns with a factor for each sample: frames, latency and radial scale as the constant ones, then joint zeros.
pub(crate) struct VariableColumns {
    pub columns: Range<usize>,
    pub factors: Vec<f64>,
    /// Their combination to a single column. `None`: they stay apart.
    pub along: Option<DVector<f64>>,
}

impl VariableColumns {
    fn width(&self) -> usize {
        if self.along.is_some() { 1 } else { self.columns.len() }
    }
}

#[derive(Clone)]
pub(crate) struct CauseColumns<'a> {
    pub aligned: Cow<'a, AlignedSamples>,
    pub chain: &'a Chain,
    /// Columns of the joint track with the chain's joints.
    joint_columns: &'a [usize],
    /// Joints whose positions are known.
    joints: usize,
    /// Links before the last, whose deviation is a tool, and joints before the last, whose zero is one.
    links: usize,
    /// Of all joints, in the frames of their links.
    axes: Vec<Vec3>,
    /// Turn of the tool that equals one of the last joint.
    zero_as_tool: [f64; 6],
    excluded: ExcludedComponents,
    /// The reference turns about it, in the base.
    pub centre: Vec3,
    /// Whether constant joint zeros are free; else their prior is that of link deviations.
    has_free_zeros: bool,
}

impl<'a> CauseColumns<'a> {
    pub fn new(diagnosis: &'a PoseDiagnosis, stream: &PoseStream<'a>) -> Self {
        let PoseStream { chain, columns: joint_columns, .. } = *stream;
        let aligned = Cow::Borrowed(&diagnosis.aligned);
        let sum: Vec3 = aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).sum();
        let centre = sum / aligned.fk_at_truth.len().max(1) as f64;
        let has_joints = !chain.is_floating() && !aligned.q_at_truth.is_empty();
        let joints = if has_joints { chain.dof() } else { 0 };
        let axes = chain.joint_axes();
        Self {
            aligned,
            chain,
            joint_columns,
            joints,
            links: joints.saturating_sub(1),
            zero_as_tool: if has_joints { zero_as_tool(chain, &axes) } else { [0.0; 6] },
            axes,
            excluded: ExcludedComponents {
                rotation: diagnosis.encoding.is_err(),
                ..Default::default()
            },
            centre,
            has_free_zeros: false,
        }
    }

    /// For tests of changes: constant joint zeros of any size are no changes.
    pub fn with_free_zeros(self) -> Self {
        Self { has_free_zeros: true, ..self }
    }

    /// Motion of a frame by a twist in its columns.
    pub fn motion(&self, frame: Frame, twist: &Vector6<f64>) -> Pose {
        let motion = pose_of_twist(twist.as_slice());
        match frame {
            Frame::Reference => {
                let centre = Pose::from_parts(self.centre.into(), Rotation::identity());
                centre * motion * centre.inverse()
            }
            Frame::Tool => motion,
        }
    }

    /// First column of a joint zero's axis.
    fn axis_column(&self, joint: usize) -> usize {
        let is_rotary = self.chain.joint_kinds()[joint] != JointKind::Prismatic;
        CAUSES + 6 * joint + if is_rotary { 3 } else { 0 }
    }

    /// Variable column of the last joint's zero, which equals a turn of the tool.
    pub fn last_zero(&self) -> usize {
        ZEROS + self.links
    }

    /// Variable columns of all joint zeros.
    pub fn zeros(&self) -> Range<usize> {
        ZEROS..ZEROS + self.joints
    }

    /// Variable column of the zero of the joint in this column of the joint track.
    pub fn zero(&self, joint_column: usize) -> Option<Range<usize>> {
        let zero = ZEROS + self.joint_columns.iter().position(|own| *own == joint_column)?;
        self.zeros().contains(&zero).then_some(zero..zero + 1)
    }

    /// Column of the joint track with the joint of this variable column. `None` if that is no joint zero.
    pub fn joint_column(&self, zero: usize) -> Option<usize> {
        Some(self.joint_columns[zero.checked_sub(ZEROS)?])
    }

    /// Derivatives by the variable columns, from those by the constant ones in a row. The last is the last joint's zero.
    pub fn variable_row(&self, row: &[f64]) -> DVector<f64> {
        let along = |axis: &[f64], derivatives: &[f64]| -> f64 {
            axis.iter().zip(derivatives).map(|(axis, value)| axis * value).sum()
        };
        DVector::from_fn(self.last_zero() + 1, |column, _| match column.checked_sub(ZEROS) {
            None => row[column],
            Some(joint) if joint < self.links => {
                along(self.axes[joint].as_slice(), &row[self.axis_column(joint)..])
            }
            Some(_) => along(&self.zero_as_tool, &row[Frame::Tool.columns()]),
        })
    }

    /// Number of columns of constant causes.
    pub fn constant(&self) -> usize {
        CAUSES + 6 * self.links
    }

    /// Adds the prior on the links to equations of a linearisation.
    pub fn add_prior(&self, normal: &mut Normal) {
        let constant = self.constant();
        let mut own = normal.matrix.view_mut((0, 0), (constant, constant));
        own += self.prior();
    }

    /// Precision of the constant columns' prior. 0 for those that are free.
    pub fn prior(&self) -> DMatrix<f64> {
        let diagonal = |column: usize| match column.checked_sub(CAUSES).map(|own| own % 6) {
            None if column == RADIAL_SCALE => RADIAL_SCALE_PRIOR.powi(-2),
            None => 0.0,
            Some(0..3) => LINK_PRIOR_M.powi(-2),
            Some(_) => LINK_PRIOR_RAD.powi(-2),
        };
        let mut prior = DMatrix::from_diagonal(&DVector::from_fn(self.constant(), |column, _| {
            diagonal(column)
        }));
        for joint in (0..self.links).filter(|_| self.has_free_zeros) {
            let (first, axis) = (self.axis_column(joint), self.axes[joint]);
            let precision = diagonal(first);
            let mut own = prior.fixed_view_mut::<3, 3>(first, first);
            own -= precision * axis * axis.transpose();
        }
        prior
    }

    /// Rows of up to about 2000 samples.
    pub fn samples(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.aligned.t_s.len()).step_by(self.stride())
    }

    fn stride(&self) -> usize {
        const MAX_SAMPLES: usize = 2000;
        self.aligned.t_s.len().div_ceil(MAX_SAMPLES).max(1)
    }

    /// Rows of the samples and their neighbours, which give the velocities.
    pub fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        let stride = self.stride();
        (0..self.aligned.t_s.len())
            .filter(move |row| row % stride <= 1 || row % stride == stride - 1)
    }

    /// Residuals in m and rad, and their derivatives by the constant causes, then by these variable ones.
    pub fn linearize(&self, variable: &[VariableColumns]) -> Linear {
        let width = self.constant() + variable.iter().map(VariableColumns::width).sum::<usize>();
        let mut linear = Linear::new(width, &[FLOOR_M, FLOOR_RAD]);
        let AlignedSamples { t_s, fk_at_truth, q_at_truth, .. } = &*self.aligned;
        let middle_s = self.aligned.middle_s();
        let half_span_s = t_s.last().map_or(0.0, |last| last - middle_s).max(f64::MIN_POSITIVE);
        let centre = Pose::from_parts(self.centre.into(), Rotation::identity());
        let (dof, mut links) = (self.chain.dof(), Vec::new());
        for row in self.samples() {
            let fk = &fk_at_truth[row];
            let mut rows = linear.push(&self.excluded.mask(self.aligned.residual(row, fk)));
            let tip = fk.translation.vector;
            let late = self.aligned.velocity(row).map(|part| -part);
            let part = (t_s[row] - middle_s) / half_span_s;
            if self.links > 0 {
                self.chain.joint_frames(&q_at_truth[row * dof..(row + 1) * dof], &mut links);
            }
            let of_frame = |frame: &Pose| link_derivatives(frame, &tip);
            let [reference, tool] = [&centre, fk].map(of_frame);
            let others = [late, [tip, Vec3::zeros()], late.map(|late| late * part)];
            let constant = reference.into_iter().chain(tool).chain(others);
            let of_links = links.iter().take(self.links).flat_map(of_frame);
            for (column, derivative) in constant.chain(of_links).enumerate() {
                rows.set_all(column, self.excluded.mask(derivative));
            }
        }
        self.add_variable(&mut linear, variable);
        linear
    }

    /// Appends variable columns.
    fn add_variable(&self, linear: &mut Linear, variable: &[VariableColumns]) {
        for (sample, row) in (0..linear.len()).flat_map(|it| (0..6).map(move |row| (it, row))) {
            let derivatives = self.variable_row(linear.row(sample, row));
            let values = variable.iter().flat_map(|VariableColumns { columns, factors, along }| {
                let own = derivatives.rows(columns.start, columns.len()) * factors[sample];
                along.as_ref().map_or_else(|| own.as_slice().to_vec(), |it| vec![it.dot(&own)])
            });
            for (at, value) in values.enumerate() {
                linear.set(sample, row, self.constant() + at, value);
            }
        }
    }

    /// Weights from the noise within tenths of the run, whose means further changes may explain.
    pub fn local_weights(&self, linear: &Linear) -> Vec<Weight> {
        let residuals = self.fit(linear, 1).residuals;
        let local: Vec<_> = residuals.iter().map(|kind| minus_segment_means(kind)).collect();
        linear.weights_of(&local)
    }

    /// Whether constant causes and link deviations leave a residual beyond the noise.
    pub fn has_unexplained_residual(&self) -> bool {
        let residuals = self.constant_fit().1.residuals;
        exceeds_noise(&residuals) || has_slow_means(residuals)
    }

    /// Residual that constant causes and link deviations leave, rms m. Angles are weighted by 0.3 m.
    pub fn unexplained_m(&self) -> f64 {
        let [m, rad] = rms_of_kinds(&self.constant_fit().1.residuals);
        m.hypot(LEVER_M * rad)
    }

    pub fn constant_fit(&self) -> (Linear, ReweightedFit) {
        let linear = self.linearize(&[]);
        let fit = self.fit(&linear, 2);
        (linear, fit)
    }

    pub fn fit(&self, linear: &Linear, rounds: usize) -> ReweightedFit {
        linear.reweighted_fit(rounds, |normal| {
            self.add_prior(normal);
            normal.full_step()
        })
    }
}

/// Equations of several streams: of `shared` parameters without a prior, then of the constant causes of each stream. A
/// stream depends on shared parameters by variable columns, each with its first parameter. The weights assume white noise.
pub(crate) fn shared_equations<'a>(
    shared: usize,
    streams: impl Iterator<Item = (&'a CauseColumns<'a>, Vec<(usize, VariableColumns)>)>,
) -> SharedEquations {
    let mut prior = DMatrix::zeros(shared, shared);
    let equations = |(columns, variable): (&CauseColumns, Vec<(usize, VariableColumns)>)| {
        let (first, own) = (prior.nrows(), columns.constant());
        prior.resize_mut(first + own, first + own, 0.0);
        prior.view_mut((first, first), (own, own)).copy_from(&columns.prior());
        let constant = first..first + own;
        let of_variable = variable.iter().flat_map(|(first, it)| *first..first + it.width());
        let parameters = constant.chain(of_variable).collect();
        let variable: Vec<VariableColumns> = variable.into_iter().map(|it| it.1).collect();
        let linear = columns.linearize(&variable);
        StreamEquations { weights: linear.first_weights(), linear, parameters }
    };
    let streams = streams.map(equations).collect();
    SharedEquations { streams, prior }
}

/// Change of the tool, a twist, that equals a small motion of the last joint.
fn zero_as_tool(chain: &Chain, axes: &[Vec3]) -> [f64; 6] {
    let Some(axis) = axes.last() else { return [0.0; 6] };
    let last_from_tip = chain.last_from_tip();
    let in_tip = |vector: Vec3| last_from_tip.rotation.inverse() * vector;
    stacked(match chain.joint_kinds().last() {
        Some(JointKind::Prismatic) => [in_tip(*axis), Vec3::zeros()],
        _ => [in_tip(axis.cross(&last_from_tip.translation.vector)), in_tip(*axis)],
    })
}
