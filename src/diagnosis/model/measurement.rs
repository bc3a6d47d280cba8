//! Measurement model of a pose stream and its derivatives (see [`crate`]).
//!
//! Perturbations of `reference` multiply on the left, those of `tool` on the right. Residuals are in the
//! reference frame: position in m, and the rotation vector of `logged · predicted⁻¹` in rad.

use super::jacobian::{Derivative, PoseJacobian, pose_change};
use super::moving_frame::MovingFrame;
use crate::FrameCorrection;
use crate::solver::linear::Linear;
use ground::geometry::{Pose, Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use ground::robot::Chain;
use ground::stats::MeasuredLength;
use ground::stats::thin::thinned;
use ground::stream::{JointSequence, JointTrack};
use nalgebra::{DVector, Matrix6, Translation3};

/// Columns of a stream's parameters.
pub(crate) const LATENCY_COLUMN: usize = 0;
pub(crate) const SKEW_COLUMN: usize = 1;
pub(crate) const RADIAL_SCALE_COLUMN: usize = 2;
pub(crate) const REFERENCE_COLUMNS_START: usize = 3;
pub(crate) const TOOL_COLUMNS_START: usize = 9;
pub(crate) const STREAM_WIDTH: usize = 15;

/// Lower bounds of standard deviations.
pub(crate) const FLOOR_M: f64 = 1e-6;
pub(crate) const FLOOR_RAD: f64 = 1e-6;

/// Excess residual that counts as explained, rms: consistent with link deviations and calibration error.
pub(crate) const MAX_EXPLAINED_M: f64 = 1e-3;
pub(crate) const MAX_EXPLAINED_RAD: f64 = 1.75e-3;

/// Slower bases rest, m/s or rad/s. Assumed, not calibrated.
const MIN_BASE_SPEED: f64 = 0.01;

/// Components of a stream without information, excluded from every residual.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ExcludedComponents {
    /// In the stream's frame.
    pub position: [bool; 3],
    /// All three components.
    pub rotation: bool,
}

impl ExcludedComponents {
    /// Position and rotation with excluded components set to zero.
    pub fn mask(&self, [mut position, rotation]: Derivative) -> Derivative {
        for (part, blind) in position.iter_mut().zip(self.position) {
            *part *= f64::from(u8::from(!blind));
        }
        [position, if self.rotation { Vec3::zeros() } else { rotation }]
    }

    /// Copies excluded components from `expected`.
    pub fn fill(&self, pose: &mut Pose, expected: &Pose) {
        for (axis, _) in self.position.iter().enumerate().filter(|(_, blind)| **blind) {
            pose.translation.vector[axis] = expected.translation.vector[axis];
        }
        if self.rotation {
            pose.rotation = expected.rotation;
        }
    }
}

/// Decoded observations of one stream, ready for the fit.
#[derive(Clone)]
pub(crate) struct PoseObservations<'a> {
    pub joints: &'a JointTrack,
    pub chain: &'a Chain,
    pub columns: &'a [usize],
    /// Pairs of joints: the first's position contains an unknown share of the second's (coupling). A joint
    /// paired with itself has an unknown scale.
    pub gains: &'a [(usize, usize)],
    pub reference_known: bool,
    /// Per joint of the track; slower ones rest, rad/s or m/s.
    pub rest_speeds: &'a [f64],
    pub t_s: Vec<f64>,
    pub xyz: Vec<Vec3>,
    pub rotation: Vec<Rotation>,
    pub excluded: ExcludedComponents,
    /// Skew has no effect at this stamp, s.
    pub middle_s: f64,
    /// Frame of the logged poses, if it moves in the base. The poses are transformed to the base.
    pub moving_frame: Option<&'a MovingFrame>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct StreamState {
    pub latency_s: f64,
    pub skew: f64,
    pub radial_scale: f64,
    pub reference: Pose,
    pub tool: Pose,
    /// Part of `reference` that is a round slip (such as a quarter turn), not estimated.
    pub round_reference: Option<Pose>,
    /// Same for `tool`.
    pub round_tool: Option<Pose>,
    /// Whether the rotation of the tool is not estimated, without orientations.
    pub is_tool_point: bool,
}

impl StreamState {
    pub fn at_latency(latency_s: f64) -> Self {
        Self { latency_s, ..Self::default() }
    }

    /// Pose correction by these parameters.
    pub fn frame_correction(&self) -> FrameCorrection {
        FrameCorrection {
            reference: self.reference,
            tool: self.tool,
            radial_scale: self.radial_scale,
        }
    }

    /// Zero means that the cause is absent.
    fn values(&self) -> [f64; STREAM_WIDTH] {
        let mut values = [0.0; STREAM_WIDTH];
        values[LATENCY_COLUMN] = self.latency_s;
        values[SKEW_COLUMN] = self.skew;
        values[RADIAL_SCALE_COLUMN] = self.radial_scale;
        let reference = self.reference * self.round_reference.unwrap_or_default().inverse();
        let tool = self.round_tool.unwrap_or_default().inverse() * self.tool;
        values[REFERENCE_COLUMNS_START..TOOL_COLUMNS_START].copy_from_slice(&twist_of(&reference));
        values[TOOL_COLUMNS_START..].copy_from_slice(&twist_of(&tool));
        values
    }

    fn step(&mut self, delta: &[f64]) {
        self.latency_s += delta[LATENCY_COLUMN];
        self.skew += delta[SKEW_COLUMN];
        self.radial_scale += delta[RADIAL_SCALE_COLUMN];
        self.reference =
            pose_of_twist(&delta[REFERENCE_COLUMNS_START..TOOL_COLUMNS_START]) * self.reference;
        self.tool *= pose_of_twist(&delta[TOOL_COLUMNS_START..]);
    }
}

/// Translation and rotation vector.
pub(crate) fn twist_of(pose: &Pose) -> [f64; 6] {
    stacked([pose.translation.vector, rotvec_from_rotation(&pose.rotation)])
}

/// Moves a twist to a point at `lever`.
pub(crate) fn twist_at(lever: &Vec3) -> Matrix6<f64> {
    let mut moved = Matrix6::identity();
    moved.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever.cross_matrix());
    moved
}

/// Lengths of a twist's translation and rotation, with `dof` degrees of freedom.
pub(crate) fn twist_lengths(
    twist: &[f64; 6],
    covariance: &Matrix6<f64>,
    dof: f64,
) -> [MeasuredLength; 2] {
    [0, 3].map(|first| {
        let own = covariance.view((first, first), (3, 3)).into_owned();
        MeasuredLength::estimate(&twist[first..first + 3], &own, dof)
    })
}

pub(crate) fn stacked([linear, angular]: [Vec3; 2]) -> [f64; 6] {
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

pub(crate) fn pose_of_twist(twist: &[f64]) -> Pose {
    Pose::from_parts(
        Translation3::new(twist[0], twist[1], twist[2]),
        rotation_from_rotvec(Vec3::new(twist[3], twist[4], twist[5])),
    )
}

/// Joint offsets, joint gains, then the parameters of each stream.
#[derive(Clone, Debug)]
pub(crate) struct State {
    /// Offset of each joint, rad or m, then the share of each pair in [`PoseObservations::gains`].
    pub offsets: Vec<f64>,
    pub streams: Vec<StreamState>,
}

impl State {
    pub fn width(&self) -> usize {
        self.offsets.len() + self.streams.len() * STREAM_WIDTH
    }

    /// Index of a stream's parameter.
    pub fn index(&self, stream: usize, parameter: usize) -> usize {
        self.offsets.len() + stream * STREAM_WIDTH + parameter
    }

    /// Damping scales (Levenberg 1944). They barely affect observable parameters; unobservable ones keep
    /// their value.
    pub fn scales(&self) -> Vec<f64> {
        let mut stream = [0.02; STREAM_WIDTH];
        stream[SKEW_COLUMN] = 1e-4;
        let joints = std::iter::repeat_n(0.02, self.offsets.len());
        joints.chain(self.streams.iter().flat_map(|_| stream)).collect()
    }

    pub fn values(&self) -> DVector<f64> {
        let streams = self.streams.iter().flat_map(StreamState::values);
        DVector::from_iterator(self.width(), self.offsets.iter().copied().chain(streams))
    }

    /// Round reference and tool of each stream.
    pub fn round_frames(&self) -> impl Iterator<Item = Option<&Pose>> {
        let streams = self.streams.iter();
        streams.flat_map(|s| [s.round_reference.as_ref(), s.round_tool.as_ref()])
    }

    pub fn step(&mut self, delta: &DVector<f64>) {
        let joints = self.offsets.len();
        for (offset, change) in self.offsets.iter_mut().zip(delta.iter()) {
            *offset += change;
        }
        for (s, stream) in self.streams.iter_mut().enumerate() {
            let start = joints + s * STREAM_WIDTH;
            stream.step(&delta.as_slice()[start..start + STREAM_WIDTH]);
        }
    }
}

/// Observations of a stream with the state in which they are predicted.
#[derive(Clone, Copy)]
pub(crate) struct StreamAt<'a> {
    pub observations: &'a PoseObservations<'a>,
    pub state: &'a StreamState,
    /// Those of [`State`].
    pub offsets: &'a [f64],
}

/// Predicts samples of a stream in one state; fastest in their order.
pub(crate) struct Predictor<'a> {
    stream: StreamAt<'a>,
    joints: JointSequence<'a>,
    q: Vec<f64>,
    /// Per joint, then 1 for a moving base.
    qd: Vec<f64>,
    /// Per joint, then the velocity by a moving base.
    jacobian: Vec<[f64; 6]>,
}

/// Prediction of one sample with its derivatives.
pub(crate) struct Prediction<'a> {
    pub jacobian: PoseJacobian<'a>,
    /// Joint positions, and velocities as the columns of `jacobian`, in chain order.
    pub q: &'a [f64],
    pub qd: &'a [f64],
    /// Positions of all joints of the track.
    track_q: &'a [f64],
    /// Position in the base, scaled.
    in_base: Vec3,
    /// Whether a joint or the base moves. At rest, the latency has no effect.
    is_moving: bool,
}

impl<'a> Predictor<'a> {
    /// `None` if joint states or transforms do not cover sample `k`.
    pub fn at(&mut self, k: usize) -> Option<Prediction<'_>> {
        let Self { stream: StreamAt { observations, state, offsets }, joints, q, qd, jacobian } =
            self;
        let stamp = observations.t_s[k];
        let truth = stamp - state.latency_s - state.skew * (stamp - observations.middle_s);
        let (track_q, track_qd) = joints.at(truth)?;
        let mut is_moving = false;
        for (i, &column) in observations.columns.iter().enumerate() {
            (q[i], qd[i]) = (track_q[column] + offsets[column], track_qd[column]);
            for (at, by) in observations.gains_of(column) {
                let gain = offsets.get(at).unwrap_or(&0.0);
                q[i] += gain * track_q[by];
                qd[i] += gain * track_qd[by];
            }
            is_moving |= qd[i].abs() > observations.rest_speeds[column];
        }
        let (of_joints, of_base) = jacobian.split_at_mut(q.len());
        let mut base_from_link = observations.chain.forward_with_jacobian(q, of_joints);
        if let Some(frame) = observations.moving_frame {
            let base = frame.base_at(stamp, truth)?;
            let [linear, angular] = frame.base_velocity(truth)?;
            is_moving |= linear.norm().max(angular.norm()) > MIN_BASE_SPEED;
            let linear = linear + angular.cross(&base_from_link.translation.vector);
            of_base.fill(stacked([linear, angular]));
            for column in jacobian.iter_mut() {
                let parts = [0, 3].map(|part| Vec3::from_column_slice(&column[part..part + 3]));
                *column = stacked(parts.map(|part| base.rotation * part));
            }
            base_from_link = base * base_from_link;
        }
        let mut in_base = base_from_link * state.tool;
        in_base.translation.vector *= 1.0 + state.radial_scale;
        let mut jacobian =
            PoseJacobian::new(jacobian, &state.reference, &base_from_link, &state.tool);
        jacobian.pose = state.reference * in_base;
        let in_base = in_base.translation.vector;
        Some(Prediction { jacobian, q, qd, track_q, in_base, is_moving })
    }

    /// `reference_from_tip · tool`.
    pub fn pose_at(&mut self, k: usize) -> Option<Pose> {
        self.at(k).map(|predicted| predicted.jacobian.pose)
    }
}

impl<'a> PoseObservations<'a> {
    /// Whole poses in a known reference that does not move in the base.
    pub fn new(
        joints: &'a JointTrack,
        chain: &'a Chain,
        columns: &'a [usize],
        rest_speeds: &'a [f64],
        t_s: &[f64],
        poses: &[Pose],
    ) -> Self {
        let ends = t_s.first().zip(t_s.last());
        Self {
            joints,
            chain,
            columns,
            gains: &[],
            reference_known: true,
            rest_speeds,
            t_s: t_s.to_vec(),
            xyz: poses.iter().map(|pose| pose.translation.vector).collect(),
            rotation: poses.iter().map(|pose| pose.rotation).collect(),
            excluded: ExcludedComponents::default(),
            middle_s: ends.map_or(0.0, |(first, last)| 0.5 * (first + last)),
            moving_frame: None,
        }
    }
}

impl PoseObservations<'_> {
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Rows of up to `most` evenly chosen samples.
    pub fn rows(&self, most: usize) -> impl ExactSizeIterator<Item = usize> + use<> {
        thinned(0..self.len(), most)
    }

    /// The same poses with other stamps.
    pub fn with_stamps(&self, stamp: impl Fn(f64) -> f64) -> Self {
        let mut restamped = self.clone();
        for (row, t_s) in restamped.t_s.iter_mut().enumerate() {
            let logged_s = std::mem::replace(t_s, stamp(*t_s));
            let moved = self.moving_frame.and_then(|it| it.base_at(*t_s, logged_s - it.lag_s));
            if let Some(base) = moved {
                restamped.xyz[row] = base.rotation * self.xyz[row] + base.translation.vector;
                restamped.rotation[row] = base.rotation * self.rotation[row];
            }
        }
        restamped
    }

    /// Index among the offsets and multiplied joint, for each gain of a joint.
    fn gains_of(&self, column: usize) -> impl Iterator<Item = (usize, usize)> {
        let gained = self.gains.iter().enumerate();
        gained.filter_map(move |(at, &(own, by))| {
            (own == column).then_some((self.joints.dof + at, by))
        })
    }

    /// The same in a state.
    pub fn at<'a>(&'a self, state: &'a StreamState, offsets: &'a [f64]) -> StreamAt<'a> {
        StreamAt { observations: self, state, offsets }
    }

    /// The same in a state of all streams, of which this is stream `s`.
    pub fn in_state<'a>(&'a self, state: &'a State, s: usize) -> StreamAt<'a> {
        self.at(&state.streams[s], &state.offsets)
    }

    /// Number of samples, out of about `most`, while a joint moves.
    pub fn moving_samples(&self, latency_s: f64, most: usize) -> usize {
        let (state, offsets) = (StreamState::at_latency(latency_s), vec![0.0; self.joints.dof]);
        let mut predictor = self.at(&state, &offsets).predictor();
        self.rows(most).filter(|k| predictor.at(*k).is_some_and(|it| it.is_moving)).count()
    }

    /// Logged minus predicted: m, rotation vector in rad.
    pub fn residual(&self, k: usize, predicted: &Pose) -> [Vec3; 2] {
        let logged = Pose::from_parts(self.xyz[k].into(), self.rotation[k]);
        self.excluded.mask(pose_change(predicted, &logged))
    }
}

impl<'a> StreamAt<'a> {
    pub fn predictor(self) -> Predictor<'a> {
        let PoseObservations { joints, columns, moving_frame, .. } = self.observations;
        let dof = columns.len();
        let width = dof + usize::from(moving_frame.is_some());
        Predictor {
            stream: self,
            joints: joints.sequence(),
            q: vec![0.0; dof],
            qd: vec![1.0; width],
            jacobian: vec![[0.0; 6]; width],
        }
    }

    /// Rms residual over about `most` samples (m and rad combined), and the latency change that reduces it
    /// most, s.
    pub fn residual_at_latency(self, most: usize) -> (f64, f64) {
        let observations = self.observations;
        let mut predictor = self.predictor();
        let (mut samples, mut square) = (0, 0.0);
        let (mut along, mut steep) = (0.0, f64::MIN_POSITIVE);
        for k in observations.rows(most) {
            let Some(Prediction { jacobian, qd, is_moving, .. }) = predictor.at(k) else {
                continue;
            };
            let velocity = if is_moving { jacobian.velocity(qd) } else { [Vec3::zeros(); 2] };
            let by_latency = observations.excluded.mask(velocity.map(|part| -part));
            let residuals = observations.residual(k, &jacobian.pose);
            for (slope, residual) in by_latency.iter().zip(residuals) {
                square += residual.norm_squared();
                along += slope.dot(&residual);
                steep += slope.norm_squared();
            }
            samples += 1;
        }
        ((square / f64::from(samples.max(1))).sqrt(), along / steep)
    }

    /// Linearises up to `most` samples that joint states cover.
    pub fn linearize(self, most: usize) -> Linear {
        let Self { observations, offsets, .. } = self;
        let joints = offsets.len();
        let mut predictor = self.predictor();
        let mut linear = Linear::new(joints + STREAM_WIDTH, &[FLOOR_M, FLOOR_RAD]);
        let rows = observations.rows(most);
        linear.reserve(rows.len());
        for k in rows {
            let Some(Prediction { jacobian, q, qd, track_q, in_base, is_moving, .. }) =
                predictor.at(k)
            else {
                continue;
            };
            linear.places.push(q);
            let mut rows = linear.push(&observations.residual(k, &jacobian.pose));
            let mut set = |column: usize, derivative: Derivative| {
                rows.set_all(column, observations.excluded.mask(derivative));
            };
            let scaled = |derivative: Derivative, factor: f64| derivative.map(|part| part * factor);
            for (i, &column) in observations.columns.iter().enumerate() {
                let derivative = jacobian.joint(i);
                set(column, derivative);
                for (gain, by) in observations.gains_of(column).filter(|(gain, _)| *gain < joints) {
                    set(gain, scaled(derivative, track_q[by]));
                }
            }
            if is_moving {
                let by_latency = scaled(jacobian.velocity(qd), -1.0);
                set(joints + LATENCY_COLUMN, by_latency);
                set(
                    joints + SKEW_COLUMN,
                    scaled(by_latency, observations.t_s[k] - observations.middle_s),
                );
            }
            set(joints + RADIAL_SCALE_COLUMN, [jacobian.reference * in_base, Vec3::zeros()]);
            for axis in 0..6 {
                set(joints + REFERENCE_COLUMNS_START + axis, jacobian.reference(axis));
                set(joints + TOOL_COLUMNS_START + axis, jacobian.tool(axis));
            }
        }
        linear
    }
}
