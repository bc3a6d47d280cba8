//! A run whose joint states are in a given encoding, and its diagnosis.

use super::are_floating;
use super::beside_links::BesideLinks;
use super::fit::{fit, with_timings};
use super::stream::{StreamFit, no_diagnosis};
use super::zeros::{joint_gains, joint_offsets, unobservable_offsets};
use crate::arm_run::ArmRun;
use crate::encodings::decoded_stream::{DecodedStream, decode_stream};
use crate::encodings::position::PositionEncodingEstimate;
use crate::joints::CorrectedJoints;
use crate::model::measurement::PoseObservations;
use crate::selection::held_out::HeldOut;
use crate::{
    ArmDiagnosis, EstimateResult, JointDiagnosis, JointEncoding, NotObservable, PoseDiagnosis,
    PoseStream,
};

/// Joint states in an encoding, and the encodings of the streams' positions that they show.
pub(super) struct EncodedRun<'a> {
    pub run: ArmRun<'a>,
    pub corrected: CorrectedJoints,
    pub position_encodings: Vec<PositionEncodingEstimate>,
}

impl<'a> EncodedRun<'a> {
    /// `are_derived`: whether the streams are computed from the joint states.
    pub fn new(run: ArmRun<'a>, encoding: JointEncoding, are_derived: bool) -> Self {
        let corrected = CorrectedJoints::new(run.joints, encoding, run.is_prismatic.to_vec());
        let corrected = if are_derived { corrected.for_derived() } else { corrected };
        let track = corrected.approximate_track();
        let estimate =
            |stream: &PoseStream| PositionEncodingEstimate::estimate(track, stream, run.max_lag_s);
        let position_encodings = run.streams.iter().map(estimate).collect();
        Self { run, corrected, position_encodings }
    }

    pub fn diagnose(&self) -> ArmDiagnosis {
        self.diagnose_with(&self.position_encodings)
    }

    /// The same with other encodings of the positions.
    fn diagnose_with(&self, position_encodings: &[PositionEncodingEstimate]) -> ArmDiagnosis {
        let Self { run: ArmRun { joints: recorded, streams, .. }, corrected, .. } = self;
        let both = || streams.iter().zip(position_encodings);
        let decode = |(stream, position_encoding): (&PoseStream<'a>, _)| {
            decode_stream(corrected, stream, position_encoding)
        };
        let decoded: Vec<EstimateResult<DecodedStream>> = both().map(decode).collect();
        let usable: Vec<&DecodedStream> = decoded.iter().flatten().collect();
        let observations: Vec<&PoseObservations> =
            usable.iter().map(|decoded| &decoded.observations).collect();
        let has_zeros = !corrected.is_derived && !are_floating(streams);
        let encoding = Ok(corrected.encoding.clone());
        let mut joints = JointDiagnosis::without_changes(encoding, Vec::new(), Vec::new());
        let Some(fitted) = fit(&usable, &observations, corrected) else {
            let why: Vec<NotObservable> = decoded.into_iter().filter_map(Result::err).collect();
            if has_zeros {
                let first = why.first().unwrap_or(&NotObservable::NoOverlap);
                joints.offsets = unobservable_offsets(recorded.dof, first);
            }
            return ArmDiagnosis { joints, streams: why.into_iter().map(no_diagnosis).collect() };
        };
        let fitted = &with_timings(fitted, &observations);
        let held_out = &HeldOut::new(&observations, &fitted.model, &fitted.candidates);
        let beside_links = &match corrected.is_derived {
            false => BesideLinks::new(fitted, &usable),
            true => BesideLinks::default(),
        };
        if has_zeros {
            joints.offsets = joint_offsets(fitted, &usable, corrected, held_out, beside_links);
            let (scales, couplings) = joint_gains(fitted, corrected);
            joints.encoding = Ok(corrected.encoding.refined(&scales, couplings));
            joints.scales = scales;
        }
        let (mut diagnosed, mut index) = (Vec::new(), 0);
        for ((stream, position_encoding), decoded) in both().zip(&decoded) {
            let fit_of = |decoded| StreamFit {
                recorded,
                stream,
                position_encoding,
                decoded,
                fitted,
                held_out,
                beside_links,
                index,
            };
            diagnosed.push(match decoded {
                Ok(decoded) => fit_of(decoded).diagnose(),
                Err(why) => no_diagnosis(why.clone()),
            });
            index += usize::from(decoded.is_ok());
        }
        ArmDiagnosis { joints, streams: diagnosed }
    }

    /// With weak motion, a fault can look like mirrored axes, an inverse or another rotation convention. These are
    /// rejected if as few causes explain the poses as logged. Mirrored axes and an inverse are also rejected near FK.
    pub fn or_standard(&self, result: ArmDiagnosis) -> ArmDiagnosis {
        let are_otherwise_placed = result.streams.iter().any(PoseDiagnosis::is_otherwise_placed);
        if !are_otherwise_placed && !result.streams.iter().any(PoseDiagnosis::may_be_misread) {
            return result;
        }
        let standard: Vec<PositionEncodingEstimate> =
            self.position_encodings.iter().map(PositionEncodingEstimate::standard_only).collect();
        let standard = self.diagnose_with(&standard);
        let is_explained = standard.largest_unexplained().is_none()
            || standard.total_residual_m() <= result.total_residual_m();
        let is_sufficient = is_explained
            && standard.is_close_to_fk()
            && standard.parameter_count() <= result.parameter_count();
        // A small misreading is near FK, too.
        let is_near =
            are_otherwise_placed && standard.streams.iter().all(PoseDiagnosis::is_near_as_logged);
        match is_near || is_sufficient {
            true => ArmDiagnosis {
                joints: JointDiagnosis {
                    encoding: result.joints.encoding.and(standard.joints.encoding),
                    ..standard.joints
                },
                ..standard
            },
            false => result,
        }
    }
}
