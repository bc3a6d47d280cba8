//! Comparison of diagnoses with different references.

use super::MIN_IMPROVEMENT;
use crate::{ArmDiagnosis, PoseDiagnosis, PoseEncoding};
use ground::geometry::{Convention, QuaternionOrderError};

impl ArmDiagnosis {
    /// Whether other frames, encodings or latencies than those found might explain more.
    pub fn is_unexplained(&self) -> bool {
        self.streams.iter().any(PoseDiagnosis::has_excess)
    }

    /// Whether a rotation is read in the opposite of the usual way, for example `euler:xyz` as a rotation vector, or
    /// positions are in a unit above the metre. The usual error of the reference has the same effect, for rotations
    /// if the frames are equal.
    pub fn has_unusual_misinterpretation(&self) -> bool {
        let is_large = |stream: &PoseDiagnosis| matches!(stream.length_unit, Ok(Some(error)) if error.factor() > 1.0);
        let encodings = self.streams.iter().filter_map(|stream| stream.encoding.as_ref().ok());
        self.streams.iter().any(is_large)
            || encodings.into_iter().any(|encoding| match encoding.best {
                PoseEncoding::Misinterpreted(class) => {
                    class.members.first().is_some_and(|one| one.read_as != Convention::RPY)
                }
                PoseEncoding::QuaternionOrder(error) => {
                    error == QuaternionOrderError::XyzwReadAsWxyz
                }
                _ => false,
            })
    }

    /// Number of streams that differ from the reference by more than constant frames.
    pub fn deviating_streams(&self) -> usize {
        /// Usual delays of drivers, s.
        const MAX_USUAL_LATENCY_S: f64 = 2e-3;
        let is_late = |stream: &PoseDiagnosis| {
            stream.latency_s.as_ref().is_ok_and(|latency| {
                latency.value.abs() > MAX_USUAL_LATENCY_S.max(3.0 * latency.std_error)
            })
        };
        let is_unsteady = |stream: &PoseDiagnosis| {
            stream.latency_profile.as_ref().is_ok_and(|profile| profile.is_unsteady)
        };
        let deviates = |stream: &&PoseDiagnosis| {
            is_late(stream)
                || stream.is_otherwise_placed()
                || matches!(stream.length_unit, Ok(Some(_)))
                || stream.is_misread()
                || is_unsteady(stream)
                || stream.is_skew_chosen
                || stream.has_changes()
        };
        self.streams.iter().filter(deviates).count()
    }

    /// Residual relative to the motion, so it does not depend on the unit of the reference.
    fn relative_residual(&self) -> f64 {
        let of_stream = |stream: &PoseDiagnosis| {
            let Some(residual) = stream.followed_residual() else { return 1.0 };
            let length = residual.rms_m / stream.extent_m().max(f64::MIN_POSITIVE);
            length.hypot(residual.rms_rad).min(1.0)
        };
        self.streams.iter().map(of_stream).sum()
    }

    /// Whether it leaves far less unexplained than `other`, with another reference.
    pub fn is_far_better_than(&self, other: &Self) -> bool {
        self.relative_residual() * MIN_IMPROVEMENT < other.relative_residual()
    }

    /// Whether it fits about as well as `other`, with another reference.
    pub fn is_as_good_as(&self, other: &Self) -> bool {
        const TOLERANCE: f64 = 1.2;
        self.relative_residual() < TOLERANCE * other.relative_residual()
    }
}
