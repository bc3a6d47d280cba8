//! Search for the encoding of the joint states.

use super::MIN_IMPROVEMENT;
use super::encoded_run::EncodedRun;
use crate::arm_run::ArmRun;
use crate::encodings::decoded_stream::decode_stream;
use crate::encodings::orientation_samples::MAX_ENCODING_RESIDUAL_RAD;
use crate::encodings::position::{PositionEncodingEstimate, metres_by_reach};
use crate::joints::{JointComparison, LikelyEncoding};
use crate::latency::correlation::stream_lag_s;
use crate::model::measurement::FLOOR_M;
use crate::selection::evidence::log_bayes_factor;
use crate::{ArmDiagnosis, EstimateResult, JointEncoding, NotObservable, PoseEncoding, PoseStream};
use std::cell::OnceCell;

/// Residual as logged over that of degrees indicated by the range of values.
const MIN_IMPROVEMENT_BY_RANGE: f64 = 3.0;

pub(super) struct EncodingSearch<'a> {
    logged: EncodedRun<'a>,
    /// Unit of each stream's positions, in metres.
    metres: Vec<f64>,
    as_logged: OnceCell<ArmDiagnosis>,
    has_change: OnceCell<bool>,
}

impl<'a> EncodingSearch<'a> {
    pub fn new(run: ArmRun<'a>) -> Self {
        let logged = EncodedRun::new(run, JointEncoding::default(), false);
        let metres = logged.position_encodings.iter().map(PositionEncodingEstimate::metres);
        Self {
            metres: metres.collect(),
            logged,
            as_logged: OnceCell::new(),
            has_change: OnceCell::new(),
        }
    }

    /// Diagnosis in the encoding of the joint states that explains the streams. Another one than the logged replaces it if
    /// it is credible and keeps streams that already agree; finally it must be the likelier one.
    pub fn diagnose(mut self) -> ArmDiagnosis {
        let mut result = self.by_motion();
        let is_open = result.joints.encoding.is_err() || result.is_far_from_fk();
        if is_open && let Some(likely) = self.likely(&result) {
            result = likely;
        }
        if result.joints.encoding.is_ok()
            && let Some(other) = self.of_unexplained(&result)
        {
            result = other;
        }
        if result.is_in_other_encoding() {
            return self.likelier(result);
        }
        if result.joints.encoding.is_ok() && result.is_far_from_fk() {
            // No stream follows FK.
            result.joints.encoding = Err(NotObservable::NotExcited);
        }
        result.without_negligible_gains()
    }

    /// In the encoding by the motion if that is credible and keeps streams that agree, else as logged.
    fn by_motion(&mut self) -> ArmDiagnosis {
        let encoding = self.estimate();
        let result = match encoding {
            Ok(encoding) if encoding != JointEncoding::default() => {
                let result = self.diagnose_as(encoding);
                match result.is_credible() {
                    true => result,
                    false => self.as_logged_with(Err(NotObservable::NotExcited)),
                }
            }
            undetermined => self.as_logged_with(undetermined),
        };
        if !result.is_in_other_encoding() {
            self.logged.or_standard(result)
        } else if self.spoils_agreement(&result) {
            self.as_logged().clone()
        } else {
            result
        }
    }

    fn diagnose_as(&self, encoding: JointEncoding) -> ArmDiagnosis {
        EncodedRun::new(self.logged.run, encoding, false).diagnose()
    }

    /// Diagnosis as logged, with this result of the search.
    fn as_logged_with(&self, encoding: EstimateResult<JointEncoding>) -> ArmDiagnosis {
        let mut result = self.as_logged().clone();
        result.joints.encoding = encoding;
        result
    }

    fn as_logged(&self) -> &ArmDiagnosis {
        self.as_logged.get_or_init(|| self.logged.diagnose())
    }

    /// A stream that agrees with the joint states as logged must still do so.
    fn spoils_agreement(&self, result: &ArmDiagnosis) -> bool {
        self.logged.run.streams.len() > 1 && !result.preserves_agreement(self.as_logged())
    }

    fn has_change(&self) -> bool {
        let by_motion = || {
            let comparison = self.most_informative(&self.metres);
            comparison.is_some_and(|comparison| comparison.has_change_within_run())
        };
        *self.has_change.get_or_init(by_motion)
    }

    /// Comparison with the stream of the most joints and samples.
    fn most_informative(&self, metres: &[f64]) -> Option<JointComparison<'a>> {
        let streams = self.logged.run.streams;
        let size = |&index: &usize| (streams[index].columns.len(), streams[index].track.t_s.len());
        let index = (0..streams.len()).max_by_key(size)?;
        Some(self.comparison_with(index, metres[index]))
    }

    fn comparison_with(&self, index: usize, metres: f64) -> JointComparison<'a> {
        let ArmRun { joints, streams, max_lag_s, .. } = self.logged.run;
        JointComparison { joints, stream: &streams[index], metres, max_lag_s }
    }

    /// Encoding by the motion. Sets the unit of each stream's positions.
    fn estimate(&mut self) -> EstimateResult<JointEncoding> {
        let EncodedRun { run: ArmRun { streams, .. }, corrected, position_encodings } =
            &self.logged;
        let is_confirmed = |(stream, encoding): (&PoseStream, &PositionEncodingEstimate)| {
            encoding.needs_correction()
                && decode_stream(corrected, stream, encoding).is_ok_and(|it| it.is_confirmed())
        };
        if streams.iter().zip(position_encodings).any(is_confirmed) {
            // The joint states need no other encoding.
            return Ok(JointEncoding::default());
        }
        let no_pose = NotObservable::RestsOn("a pose of the tool");
        let estimate =
            |metres: &[f64]| self.most_informative(metres).ok_or(no_pose.clone())?.encoding();
        let encoding = estimate(&self.metres);
        if encoding.is_ok() {
            return encoding;
        }
        // Wrong joint encodings can imitate another unit.
        for other in [vec![1.0; streams.len()], streams.iter().map(metres_by_reach).collect()] {
            if other != self.metres
                && let Ok(encoding) = estimate(&other)
                && !encoding.is_as_logged()
            {
                self.metres = other;
                return Ok(encoding);
            }
        }
        encoding
    }

    /// Likely encoding that explains far more than `result`, where other faults hid the encoding.
    fn likely(&self, result: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let before_m = result.total_residual_m();
        if before_m <= FLOOR_M || self.has_change() {
            return None;
        }
        let streams = self.logged.run.streams;
        let longest = (0..streams.len()).max_by_key(|&index| streams[index].track.t_s.len())?;
        let all = self.comparison_with(longest, self.metres[longest]).likely_encodings();
        let explains = |LikelyEncoding { encoding, by_range }: LikelyEncoding| {
            let by_likely = self.diagnose_as(encoding);
            let after_m = by_likely.total_residual_m();
            let is_better = (by_range && after_m * MIN_IMPROVEMENT_BY_RANGE < before_m)
                || (by_likely.is_credible() && after_m * MIN_IMPROVEMENT < before_m);
            (is_better && !self.spoils_agreement(&by_likely)).then_some(by_likely)
        };
        all.into_iter().find_map(explains)
    }

    /// Encoding that explains the stream with the largest residual, if it explains far more than `result`.
    fn of_unexplained(&self, result: &ArmDiagnosis) -> Option<ArmDiagnosis> {
        let (index, residual) = result.largest_unexplained()?;
        let ArmRun { joints, streams, max_lag_s, .. } = self.logged.run;
        let (stream, found) = (&streams[index], &result.streams[index]);
        let lag_s = match &found.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(joints, stream, max_lag_s),
        };
        // Rotations in an unknown convention show whether the last joint is reversed, positions do not.
        let is_unread = match &found.encoding {
            Ok(encoding) => {
                matches!(encoding.best, PoseEncoding::Numbers(_))
                    && encoding.best_rad > MAX_ENCODING_RESIDUAL_RAD
            }
            Err(why) => matches!(why, NotObservable::DoesNotFollow(_)),
        };
        let comparison = self.comparison_with(index, self.metres[index]);
        let by_residual = match self.has_change() {
            false => comparison.other_encoding(lag_s, residual),
            true => None,
        };
        let last = stream.columns.last().filter(|_| is_unread);
        let other =
            by_residual.or_else(|| last.map(|&last| JointEncoding::reversed(last, residual.m)))?;
        let by_other = self.diagnose_as(other);
        let is_better = by_other.is_credible()
            && by_other.total_residual_m() * MIN_IMPROVEMENT < result.total_residual_m()
            && !self.spoils_agreement(&by_other);
        is_better.then_some(by_other)
    }

    /// The likelier of `result` and the logged encoding: where joints hardly move, other encodings fit as well as
    /// calibrations.
    fn likelier(&self, result: ArmDiagnosis) -> ArmDiagnosis {
        let is_far = result.joints.encoding.as_ref().is_ok_and(JointEncoding::is_far_from_logged);
        let is_plausible = is_far && self.as_logged().is_plausible_for(self.logged.run.streams);
        let otherwise = result.without_negligible_gains();
        let as_logged =
            self.logged.or_standard(self.as_logged().clone()).without_negligible_gains();
        match !is_plausible && log_bayes_factor(&otherwise, &as_logged) > 0.0 {
            true => otherwise,
            false => as_logged,
        }
    }
}
