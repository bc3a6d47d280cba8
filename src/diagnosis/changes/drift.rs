//! Frames that drift at a constant rate: a tracker's or SLAM's world, a marker that creeps.
//!
//! The drift is fitted to the residual of a diagnosis with constant frames, its effect is removed from the poses, and
//! the run is diagnosed again.

use super::encoding_changes::keep_encoding;
use super::frame_columns::{CONSTANT, Frame, FrameColumns};
use super::{ChangePoint, with_poses};
use crate::arm::are_floating;
use crate::arm_run::ArmRun;
use crate::model::measurement::pose_of_twist;
use crate::priors::price;
use crate::residuals::comparison::{has_slow_residual, residual_m, restore_recorded};
use crate::selection::evidence::{likeliest, log_bayes_factor};
use crate::solver::linear::Normal;
use crate::solver::robust::sandwich;
use crate::{ArmDiagnosis, FrameEstimate, PoseDiagnosis, PoseStream};
use ground::geometry::{Pose, Rotation};
use ground::stats::MeasuredLength;
use ground::stream::PoseTrack;
use nalgebra::{DMatrix, DVector};

/// Columns of the fit: constant causes, then half of the drift over the run.
const WIDTH: usize = CONSTANT + 6;

/// Drift over the run, in addition to the drift already removed.
struct Drift {
    /// Half of the drift, as a twist.
    half: DVector<f64>,
    covariance: DMatrix<f64>,
    dof: f64,
    /// Reduction of the cost beyond constant causes, minus the price of the drift.
    score: f64,
}

struct DriftFit<'a> {
    columns: FrameColumns<'a>,
    frame: Frame,
}

impl<'a> DriftFit<'a> {
    fn new(diagnosis: &'a PoseDiagnosis, frame: Frame) -> Self {
        Self { columns: FrameColumns::new(diagnosis), frame }
    }

    /// Directions that the motion does not show stay zero.
    fn solve(&self) -> Drift {
        let linear = self
            .columns
            .linearize(WIDTH, |t_s| Some((self.frame.columns(), self.columns.part(t_s))));
        let all: Vec<usize> = (0..WIDTH).collect();
        let step_with = |weights: &[_]| {
            let mut normal = Normal::zeros(WIDTH);
            linear.accumulate(weights, &all, &mut normal);
            (normal.step(&DVector::zeros(WIDTH), &all), normal)
        };
        let (first, _) = step_with(&linear.first_weights());
        let weights = linear.weights_after(first.as_slice());
        let (step, normal) = step_with(&weights);
        let cost = normal.cost_after(&step);
        let constant: Vec<usize> = (0..CONSTANT).collect();
        let constant_cost = normal.cost_after(&normal.step(&DVector::zeros(WIDTH), &constant));
        let price = price(normal.independent) * (WIDTH - CONSTANT) as f64;
        let columns: Vec<Option<usize>> = all.into_iter().map(Some).collect();
        let mut information = DMatrix::zeros(WIDTH, WIDTH);
        let mut scores = information.clone();
        linear.accumulate_covariance(&weights, &columns, &mut information, &mut scores);
        let covariance = sandwich(&information, &scores);
        Drift {
            half: step.rows(CONSTANT, 6).into_owned(),
            covariance: covariance.view((CONSTANT, CONSTANT), (6, 6)).into_owned(),
            dof: (normal.independent - WIDTH as f64).max(3.0),
            score: constant_cost - cost - price,
        }
    }

    /// Change of the drifting frame at `t_s`, in the base or the tool.
    fn drift_at(&self, half: &[f64], t_s: f64) -> Pose {
        let part = self.columns.part(t_s);
        let twist: Vec<f64> = half.iter().map(|value| value * part).collect();
        let change = pose_of_twist(&twist);
        match self.frame {
            Frame::Reference => {
                let about = Pose::from_parts(self.columns.centre.into(), Rotation::identity());
                about * change * about.inverse()
            }
            Frame::Tool => change,
        }
    }

    /// Decoded poses of the stream without the drift.
    fn steady_track(&self, diagnosis: &PoseDiagnosis, half: &[f64]) -> PoseTrack {
        let steady = |(is, &t_s): (&Pose, &f64)| {
            let drift = self.drift_at(half, t_s).inverse();
            let steady = match self.frame {
                Frame::Reference => drift * is,
                Frame::Tool => is * drift,
            };
            diagnosis.frame_correction.invert(&steady)
        };
        let samples = self.columns.aligned.corrected.iter().zip(&self.columns.aligned.t_s);
        with_poses(diagnosis, samples.map(steady))
    }
}

/// Diagnoses the run with the drift of a stream's frame removed, and reports it. `None` if no frame drifts.
pub(crate) fn diagnose_with_drift(run: &ArmRun, diagnosis: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    let slow = (0..run.streams.len()).filter(|&s| {
        let stream = &diagnosis.streams[s];
        stream.residual.is_ok() && !stream.is_far_from_fk() && has_slow_residual(stream)
    });
    let by_stream = slow.filter_map(|s| {
        let fits =
            Frame::BOTH.map(|frame| (frame, DriftFit::new(&diagnosis.streams[s], frame).solve()));
        let (frame, fit) = fits.into_iter().max_by(|a, b| a.1.score.total_cmp(&b.1.score))?;
        let is_likely = fit.score > 0.0;
        is_likely.then(|| diagnose_one(run, diagnosis, (s, frame)))?
    });
    likeliest(by_stream)
}

fn diagnose_one(
    run: &ArmRun,
    before: &ArmDiagnosis,
    (s, frame): (usize, Frame),
) -> Option<ArmDiagnosis> {
    /// The later ones remove what constant frames had absorbed.
    const MAX_ROUNDS: usize = 3;
    /// Of the drift so far, for another round.
    const MIN_RELATIVE_STEP: f64 = 0.02;
    let mut half = DVector::zeros(6);
    let mut after = before.clone();
    for _ in 0..MAX_ROUNDS {
        let found = &after.streams[s];
        let fit = DriftFit::new(found, frame);
        let more = fit.solve().half;
        if more.norm() < MIN_RELATIVE_STEP * half.norm() {
            break;
        }
        let track = fit.steady_track(found, more.as_slice());
        let mut steady = run.streams.to_vec();
        steady[s] = PoseStream { track: &track, ..run.streams[s] };
        let next = ArmRun { streams: &steady, ..*run }.diagnose();
        if residual_m(&next) >= residual_m(&after) {
            break;
        }
        half += more;
        after = next;
    }
    // Unknown faults of joints can look like a drift, but a part of the residual remains.
    if has_slow_residual(&after.streams[s]) && !are_floating(run.streams) {
        return None;
    }
    let found = &after.streams[s];
    let fit = DriftFit::new(found, frame);
    let Drift { covariance, dof, .. } = fit.solve();
    let total: Vec<f64> = half.iter().map(|value| 2.0 * value).collect();
    let covariance = covariance * 4.0;
    let length = |first: usize| {
        let own = covariance.view((first, first), (3, 3)).into_owned();
        MeasuredLength::estimate(&total[first..first + 3], &own, dof)
    };
    let (shift, turn) = (length(0), length(3));
    let base = match frame {
        Frame::Reference => &found.reference,
        Frame::Tool => &found.tool,
    };
    let base = base.as_ref().ok().filter(|frame| frame.is_chosen);
    let base = base.map_or_else(Pose::identity, |frame| frame.pose);
    let change = ChangePoint {
        at_s: fit.columns.aligned.middle_s(),
        within_s: fit.columns.half_span_s(),
        is_gradual: true,
        from: pose_of_twist(&total.iter().map(|value| -0.5 * value).collect::<Vec<f64>>()) * base,
        to: pose_of_twist(&total.iter().map(|value| 0.5 * value).collect::<Vec<f64>>()) * base,
        size: FrameEstimate {
            pose: pose_of_twist(&total),
            translation_m: shift.norm,
            rotation_rad: turn.norm,
            p_value: shift.p_value.min(turn.p_value),
            is_chosen: true,
        },
    };
    let after_stream = &mut after.streams[s];
    match frame {
        Frame::Reference => after_stream.reference_changes.push(change),
        Frame::Tool => after_stream.tool_changes.push(change),
    }
    keep_encoding(&before.streams[s], after_stream);
    restore_recorded(run.joints, &run.streams[s], after_stream);
    (log_bayes_factor(&after, before) > 0.0).then_some(after)
}
