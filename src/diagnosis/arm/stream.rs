//! Diagnosis of one stream from a fit.

use super::align::{align, fk_at_latency};
use super::beside_links::BesideLinks;
use super::fit::{ArmFit, without_small_causes};
use crate::encodings::decoded_stream::DecodedStream;
use crate::encodings::position::PositionEncodingEstimate;
use crate::frames::constant_frames::with_frames_from_positions;
use crate::frames::with_links::frames_with_links;
use crate::latency::correlation::median_period_s;
use crate::latency::delay_jitter::{DelayJitter, estimate_delay_jitter};
use crate::latency::profile::latency_profile;
use crate::model::measurement::{StreamAt, StreamState, twist_of};
use crate::model::observability::Observability;
use crate::priors::MARKER_PRIOR_M;
use crate::residuals::excess::excess_residual;
use crate::samples::sampling::{MAX_SEARCH_SAMPLES, rest_speeds, value_range};
use crate::selection::held_out::HeldOut;
use crate::selection::model_selection::Cause;
use crate::selection::nominal_model::{Timing, is_unsteady_beside_links};
use crate::{
    AlignedSamples, AxesError, ConstantCoordinate, EncodingSpans, EstimateResult, FrameCorrection,
    FrameEstimate, HeldOutResidual, LatencyProfile, LatencyShape, LengthUnitError, Measured,
    NotObservable, PoseDiagnosis, PoseStream, StreamHeldOut, StreamResidual, UnitResiduals,
};
use ground::geometry::LengthScale;
use ground::stats::{MeasuredLength, joint_p_value, mean};
use ground::stream::JointTrack;
use std::f64::consts::PI;

/// Two latencies cannot be distinguished below it: rms rad, or m at an arm length of 1 m.
const MIN_DISTINGUISHABLE_RAD: f64 = 2e-5;

pub(super) fn no_diagnosis(why: NotObservable) -> PoseDiagnosis {
    let rests = || NotObservable::RestsOn("the rotation encoding");
    PoseDiagnosis {
        length_unit: Err(why.clone()),
        axes: Err(why.clone()),
        encoding: Err(why),
        is_inverted: false,
        constant_coordinates: Vec::new(),
        degrees: None,
        latency_s: Err(rests()),
        delay_jitter: None,
        skew: Err(rests()),
        is_skew_chosen: false,
        latency_profile: Err(rests()),
        unconfirmed_latency: None,
        radial_scale: Err(rests()),
        is_radial_scale_chosen: false,
        reference: Err(rests()),
        tool: Err(rests()),
        reference_changes: Vec::new(),
        tool_changes: Vec::new(),
        radial_scale_changes: Vec::new(),
        held_out: StreamHeldOut::default(),
        encoding_spans: EncodingSpans::default(),
        frame_correction: FrameCorrection::default(),
        residual: Err(rests()),
        is_nominal: false,
        is_derived: false,
        link_m: None,
        largest_displacement: None,
        observability: None,
        top_speed_m_s: 0.0,
        aligned: AlignedSamples::default(),
    }
}

impl PoseDiagnosis {
    /// Deselects causes that do not reduce the error on held-out samples.
    fn without_overfitted_causes(mut self) -> Self {
        let is_lower = |held_out: &Option<HeldOutResidual>| {
            held_out.is_none_or(|held_out| held_out.is_lower())
        };
        let StreamHeldOut { latency, skew, radial_scale, reference, tool } = &self.held_out;
        if let Ok(found) = &mut self.latency_s
            && !is_lower(latency)
        {
            // It imitates an error of the model.
            found.std_error = found.std_error.max(found.value.abs());
        }
        // Link deviations cause larger errors than small skews.
        self.is_skew_chosen &= self.is_nominal || is_lower(skew);
        self.is_radial_scale_chosen &= is_lower(radial_scale);
        for (frame, held_out) in [(&mut self.reference, reference), (&mut self.tool, tool)] {
            if let Ok(frame) = frame {
                frame.is_chosen &= is_lower(held_out);
            }
        }
        self
    }
}

/// One stream in the common fit of all.
pub(super) struct StreamFit<'a> {
    pub recorded: &'a JointTrack,
    pub stream: &'a PoseStream<'a>,
    pub position_encoding: &'a PositionEncodingEstimate,
    pub decoded: &'a DecodedStream<'a>,
    pub fitted: &'a ArmFit,
    pub held_out: &'a HeldOut<'a>,
    pub beside_links: &'a BesideLinks,
    /// Among the fitted streams.
    pub index: usize,
}

impl StreamFit<'_> {
    pub fn diagnose(&self) -> PoseDiagnosis {
        let Self { stream, position_encoding, decoded, fitted, index, .. } = *self;
        let ArmFit { model, deviations, .. } = fitted;
        let state = self.at().state;
        let is_chosen = |cause: Cause| model.causes.contains(&cause);
        let scale = Cause::RadialScale(index);
        let aligned = align(self);
        let (latency_s, delay_jitter) = self.latency(&aligned);
        let (latency_profile, unconfirmed_latency) = match &latency_s {
            Ok(_) => self.latency_profile(&aligned),
            Err(why) => (Err(why.clone()), None),
        };
        let residual = excess_residual(&aligned, self.at());
        let mut encoding = decoded.encoding.clone();
        if let (Ok(encoding), Ok(residual)) = (&mut encoding, &residual) {
            // Latency, offsets and frames are now corrected.
            encoding.best_rad = encoding.best_rad.min(residual.rms_rad);
        }
        let information = model.linear.information_of(index);
        let found = PoseDiagnosis {
            encoding,
            length_unit: self.length_unit_error(&residual),
            axes: Ok(decoded.axes),
            is_inverted: decoded.is_inverted,
            constant_coordinates: self.constant_coordinates(&aligned),
            degrees: decoded.degrees,
            latency_s,
            delay_jitter,
            skew: self.skew(),
            is_skew_chosen: is_chosen(Cause::Skew(index)),
            latency_profile,
            unconfirmed_latency,
            radial_scale: self.estimate(scale).map(|it| self.beside_links.widen(scale, it)),
            is_radial_scale_chosen: is_chosen(scale),
            reference: self.frame(Cause::Reference(index)),
            tool: self.frame(Cause::Tool(index)),
            frame_correction: state.frame_correction(),
            residual,
            is_nominal: deviations.is_some(),
            link_m: deviations.as_ref().map(|deviations| deviations.link_m),
            largest_displacement: deviations
                .as_ref()
                .and_then(|deviations| deviations.largest_displacement),
            observability: Some(Observability::new(self.at(), &information)),
            top_speed_m_s: position_encoding.top_speed_m_s,
            aligned,
            held_out: self.held_out.of_stream(index),
            // Changes follow.
            ..no_diagnosis(NotObservable::NotExcited)
        };
        let free = [Cause::Reference(index), Cause::Tool(index)].map(|cause| fitted.is_free(cause));
        let with_links = deviations.as_ref().and_then(|_| frames_with_links(&found, stream, free));
        let [reference, tool] = with_links.unwrap_or_default();
        PoseDiagnosis {
            reference: reference.map_or(found.reference, Ok),
            tool: tool.map_or(found.tool, Ok),
            ..found
        }
        .without_overfitted_causes()
    }

    pub fn at(&self) -> StreamAt<'_> {
        self.decoded.observations.in_state(&self.fitted.model.state, self.index)
    }

    /// Detected unit, if it differs from the assumed one.
    fn length_unit_error(
        &self,
        residual: &EstimateResult<StreamResidual>,
    ) -> EstimateResult<Option<LengthUnitError>> {
        self.position_encoding.metres.as_ref().map_err(NotObservable::clone)?;
        if self.decoded.metres == 1.0 {
            return Ok(None);
        }
        let declared = self.stream.track.declared.as_ref();
        let read_as = declared.map_or(LengthScale::METRE, |declared| declared.length);
        let is = LengthScale::from_m(self.decoded.metres * read_as.in_m());
        let residual = residual.as_ref().ok();
        let corrected = residual.map_or(0.0, |residual| residual.rms_m);
        let as_logged = residual.map_or(0.0, |residual| residual.before_m);
        Ok(Some(LengthUnitError { is, read_as, residual: UnitResiduals { as_logged, corrected } }))
    }

    /// Coordinates with their range by FK.
    fn constant_coordinates(&self, aligned: &AlignedSamples) -> Vec<ConstantCoordinate> {
        let Self { stream, decoded, .. } = self;
        let axes = decoded.axes.unwrap_or(AxesError::NONE).positions;
        let coordinates = ['x', 'y', 'z'].into_iter().enumerate();
        let constant = coordinates.filter(|&(axis, _)| decoded.constant[axis]);
        let part = |(axis, coordinate): (usize, char)| {
            let fk = aligned.fk.iter().map(|fk| fk.translation.vector);
            let along = fk.map(|fk| axes.convert_from_standard(fk)[axis]);
            let value = mean(stream.track.xyz.iter().map(|xyz| xyz[axis]));
            ConstantCoordinate { coordinate, value, moved_m: value_range(along).max(0.0) }
        };
        constant.map(part).collect()
    }

    /// The chosen causes and this one.
    fn causes_with(&self, cause: Cause) -> Vec<Cause> {
        let mut causes = self.fitted.model.causes.clone();
        causes.extend((!self.fitted.is_free(cause)).then_some(cause));
        causes
    }

    fn is_candidate(&self, cause: Cause) -> bool {
        self.fitted.candidates.all().contains(&cause)
    }

    /// Amount of a cause, fitted together with the chosen ones.
    fn estimate(&self, cause: Cause) -> EstimateResult<Measured> {
        let ArmFit { model, deviations, .. } = self.fitted;
        let is_nominal = deviations.is_some() && !model.causes.contains(&cause);
        if is_nominal && matches!(cause, Cause::RadialScale(_)) {
            Err(NotObservable::NominalKinematics)
        } else if self.is_hidden(cause) {
            Err(NotObservable::NotExcited)
        } else if self.is_candidate(cause) {
            self.fitted.measured(&self.causes_with(cause), cause)
        } else {
            Err(NotObservable::AtRest)
        }
    }

    /// Error of a frame, fitted together with the chosen causes.
    fn frame(&self, cause: Cause) -> EstimateResult<FrameEstimate> {
        let ArmFit { model, candidates, deviations, .. } = self.fitted;
        if deviations.is_some() && !self.is_candidate(cause) {
            return Err(NotObservable::NominalKinematics);
        }
        if self.is_hidden(cause) {
            return Err(NotObservable::NotExcited);
        }
        let (state, linear) = (&model.state, &model.linear);
        let parameters = candidates.free_parameters(&self.causes_with(cause), state);
        let own = cause.parameters(state);
        let width = own.len();
        let first = parameters.binary_search(&own.start).map_err(|_| NotObservable::NotExcited)?;
        let covariance = match candidates.may_confound_frames {
            // The motion may not separate the frames, but no tool is as long as a base can be away.
            true => linear.covariance_with_prior(&parameters, |parameter| {
                let tool = Cause::Tool(self.index).parameters(state);
                [MARKER_PRIOR_M, PI].get(parameter.checked_sub(tool.start)? / 3).copied()
            }),
            false => linear.covariance(&parameters),
        };
        let block = covariance.view((first, first), (width, width)).into_owned();
        if !block.diagonal().iter().all(|variance| variance.is_finite()) {
            return Err(NotObservable::NotExcited);
        }
        let mut moved = state.clone();
        moved.step(&linear.step(&parameters));
        let stream = &moved.streams[self.index];
        // The model maps base coordinates to the stream's; the reported error is the inverse.
        let (frame, round, pose) = match cause {
            Cause::Tool(_) => (stream.tool, stream.round_tool, stream.tool),
            _ => (stream.reference, stream.round_reference, stream.reference.inverse()),
        };
        let twist = twist_of(&frame);
        let dof = linear.normal.dof(parameters.len());
        let length = |first: usize| {
            if first >= width {
                // The rotation is not observable.
                return Measured { value: 0.0, std_error: PI, dof };
            }
            let own = block.view((first, first), (3, 3)).into_owned();
            MeasuredLength::estimate(&twist[first..first + 3], &own, dof).norm
        };
        let tuned = moved.values().rows(own.start, width).into_owned();
        let found = FrameEstimate {
            pose,
            translation_m: length(0),
            rotation_rad: length(3),
            p_value: round.map_or_else(|| joint_p_value(&tuned, &block, f64::INFINITY), |_| 0.0),
            is_chosen: round.is_some() || model.causes.contains(&cause),
        };
        Ok(self.beside_links.widen_frame(cause, found))
    }

    /// Latency, and the jitter of the delays if they are measured one by one.
    fn latency(&self, aligned: &AlignedSamples) -> (EstimateResult<Measured>, Option<DelayJitter>) {
        if let Some(lags) = self.aliases() {
            return (Err(NotObservable::Periodic(lags)), None);
        }
        let fitted = match (self.timing(), self.estimate(Cause::Latency(self.index))) {
            (Some(timing), _) => timing.latency_s,
            (None, Ok(latency)) => latency,
            (None, Err(why)) => return (Err(why), None),
        };
        let delays = estimate_delay_jitter(aligned, self.at().state.latency_s);
        let latency = delays.as_ref().map_or(fitted, |delays| delays.median_s);
        (Ok(latency.with_error(self.stream.stamp_error_s)), delays)
    }

    fn skew(&self) -> EstimateResult<Measured> {
        let skew = match self.timing().and_then(|timing| timing.skew) {
            Some(skew) => skew,
            None => self.estimate(Cause::Skew(self.index))?,
        };
        let t_s = &self.decoded.observations.t_s;
        let span_s = (t_s[t_s.len() - 1] - t_s[0]).max(f64::MIN_POSITIVE);
        // Stamp errors at both ends look like skew.
        Ok(skew.with_error(2.0 * self.stream.stamp_error_s / span_s))
    }

    /// Latency and skew, fitted together with link deviations.
    fn timing(&self) -> Option<Timing> {
        self.fitted.timings.get(self.index).copied().flatten()
    }

    /// Latency over the run, and its likeliest variation if it is not confirmed. Link deviations are fitted before it counts
    /// as unsteady.
    fn latency_profile(
        &self,
        aligned: &AlignedSamples,
    ) -> (EstimateResult<LatencyProfile>, Option<LatencyProfile>) {
        let Self { recorded, stream, .. } = *self;
        let StreamAt { observations, state, offsets } = self.at();
        let rest_speeds = rest_speeds(recorded);
        let speed = |t_s: f64| joint_speed(recorded, &rest_speeds, t_s - state.latency_s);
        // In a moving frame, the corrected poses also depend on the latency.
        let fk_at = |late_s: &dyn Fn(f64) -> f64| {
            let is_fixed = stream.moving_frame.is_none();
            is_fixed.then(|| fk_at_latency(self, aligned, late_s))
        };
        let removed = stream.removed_ramp;
        let profile = match latency_profile(aligned, state.skew, removed, speed, fk_at) {
            Ok(profile) if profile.shape != LatencyShape::Steady => profile,
            steady => return (steady, None),
        };
        let state = without_small_causes(state);
        let beside_links =
            is_unsteady_beside_links(observations.at(&state, offsets), &profile, removed);
        let is_unsteady = beside_links.unwrap_or(profile.is_unsteady);
        let unconfirmed = (!is_unsteady).then(|| profile.clone());
        match profile.is_unsteady && !is_unsteady {
            true => (Err(NotObservable::NotExcited), unconfirmed),
            false => (Ok(LatencyProfile { is_unsteady, ..profile }), unconfirmed),
        }
    }

    /// Whether another error would compensate this one. At rest, only their sum is observable.
    fn is_hidden(&self, cause: Cause) -> bool {
        let ArmFit { model, candidates, .. } = self.fitted;
        let (index, stream_state) = (self.index, self.at().state);
        let is_round = match cause {
            Cause::Reference(_) => stream_state.round_reference.is_some(),
            Cause::Tool(_) => stream_state.round_tool.is_some(),
            Cause::RadialScale(_) => false,
            Cause::Zero(_) | Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => {
                return false;
            }
        };
        if is_round || model.causes.contains(&cause) || !candidates.optional.contains(&cause) {
            return false;
        }
        let nearby_causes =
            [Cause::Reference(index), Cause::Tool(index), Cause::RadialScale(index)];
        nearby_causes.iter().any(|&other| {
            other != cause
                && candidates.optional.contains(&other)
                && self.fitted.are_collinear(cause, other)
        })
    }

    /// Lags that match FK equally well in repetitive motion, if any.
    fn aliases(&self) -> Option<Vec<f64>> {
        let StreamAt { observations, state: stream_state, offsets } = self.at();
        let at = |latency_s: f64| {
            let mut state = StreamState { latency_s, ..stream_state.clone() };
            if !observations.reference_known {
                // Another lag may need another world frame, e.g. by one line of a raster.
                state = with_frames_from_positions(observations.at(&state, offsets));
            }
            observations.at(&state, offsets).residual_at_latency(MAX_SEARCH_SAMPLES)
        };
        let (best, _) = at(stream_state.latency_s);
        let min_separation_s = 4.0 * median_period_s(&observations.t_s).max(0.02);
        let mut lags: Vec<f64> = self
            .decoded
            .peaks
            .iter()
            .take(6)
            .map(|peak| peak.lag_s)
            .chain([0.0])
            .filter(|lag_s| (lag_s - stream_state.latency_s).abs() > min_separation_s)
            .filter_map(|lag_s| {
                let converged_s = (0..4).fold(lag_s, |lag_s, _| lag_s + at(lag_s).1);
                let is_same_lag = (converged_s - stream_state.latency_s).abs() < min_separation_s;
                (!is_same_lag && at(converged_s).0 < 2.0 * best.max(MIN_DISTINGUISHABLE_RAD))
                    .then_some(converged_s)
            })
            .collect();
        if lags.is_empty() {
            return None;
        }
        lags.push(stream_state.latency_s);
        lags.sort_by(f64::total_cmp);
        lags.dedup_by(|a, b| (*a - *b).abs() < min_separation_s);
        Some(lags)
    }
}

/// Speed at the sample before, rad/s. 0 if all joints rest.
fn joint_speed(joints: &JointTrack, rest_speeds: &[f64], t_s: f64) -> f64 {
    let row = joints.t_s.partition_point(|at_s| *at_s <= t_s).saturating_sub(1);
    let rates = joints.qd.chunks_exact(joints.dof.max(1)).nth(row).unwrap_or_default();
    if rates.iter().zip(rest_speeds).all(|(rate, rest)| rate.abs() <= *rest) {
        return 0.0;
    }
    rates.iter().map(|rate| rate * rate).sum::<f64>().sqrt()
}
