//! Residual of a stream after correcting every reported cause. MDL001 judges it, and a pass requires it to
//! be small.

use std::collections::HashMap;

use crate::checks::decision::{Decision, decide_both};
use crate::checks::{Case, FrameThresholds, SubjectResult, find};
use crate::diagnosis::{
    ErrorMagnitude, ErrorSize, EstimateResult, FkError, FrameEstimate, JointCompliance,
    JointDiagnosis, NotObservable, PartError, PoseDiagnosis, ResidualCheck, StreamResidual,
};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Outcome, Ruling, Severity, Unit};
use crate::run::{PoseDistance, TfProblemKind};

/// Errors up to this multiple of the sample-to-sample noise are noise.
const MAX_NOISE_RATIO: f64 = 2.0;
/// Errors from this multiple on are significant: F = 9 has p = 0.001 for seven independent samples.
const MIN_SIGNIFICANT_NOISE_RATIO: f64 = 3.0;

/// Sag, backlash and encoder errors, each below its threshold, sum to at most this multiple at any sample.
const MAX_SUMMED_PEAK_RATIO: f64 = 2.0;
/// The same, rms over a tenth of the run.
const MAX_SUMMED_RMS_RATIO: f64 = 1.5;

/// On the distance between publishers, whose samples differ.
const PUBLISHER_DISTANCE_TOLERANCE: f64 = 1.2;
/// In rad.
const MAX_ROUNDING_RAD: f64 = 1e-3;

/// Robot, and topic or joint.
type RobotAndLabel = (Option<String>, String);

/// Outcomes of the rules on causes.
pub(super) struct CauseOutcomes {
    /// In the order of the rules.
    judged: HashMap<RobotAndLabel, Vec<(&'static str, Outcome)>>,
    /// Topics with two conflicting publishers, and the number of transforms.
    doubled: Vec<(String, PoseDistance, usize)>,
}

impl CauseOutcomes {
    pub fn evaluate(case: &Case) -> Self {
        const CODES: [&str; 19] = [
            "FRM001", "FRM002", "FRM003", "LAT001", "LAT002", "LAT003", "ORD001", "ORD002",
            "ORD003", "ORD004", "ORD005", "ORD008", "ORD009", "ORD010", "ORD011", "ZER001",
            "ZER002", "ZER003", "MOT006",
        ];
        let rules = CODES.into_iter().filter_map(|code| find(code).ok());
        let mut judged: HashMap<_, Vec<_>> = HashMap::new();
        for rule in rules {
            for SubjectResult { subject, outcome, .. } in (rule.check)(case) {
                let key = (subject.arm().cloned(), subject.label().to_owned());
                judged.entry(key).or_default().push((rule.code, outcome));
            }
        }
        let doubled = case.evidence.tf.problems.iter().filter_map(|problem| match &problem.kind {
            TfProblemKind::Publishers { by: Some(by), edges, .. } => {
                Some((problem.topics.first()?.clone(), *by, *edges))
            }
            _ => None,
        });
        Self { judged, doubled: doubled.collect() }
    }

    /// Outcomes of `codes` on a topic or joint of `arm`.
    fn on<'a>(
        &'a self,
        arm: &'a ArmEvidence,
        label: &'a str,
        codes: &'a [&str],
    ) -> impl Iterator<Item = (&'static str, &'a Outcome)> {
        let key = (Some(arm.name.clone()), label.to_owned());
        let judged = self.judged.get(&key).into_iter().flatten();
        judged.filter(|(code, _)| codes.contains(code)).map(|(code, outcome)| (*code, outcome))
    }

    /// Whether the residual of /tf is already reported: by FRM001, or by FRM004 as two publishers that are
    /// further apart.
    fn reports_tf_residual(
        &self,
        arm: &ArmEvidence,
        stream: &StreamEvidence<PoseEvidence>,
        residual: &ExceedingResidual,
    ) -> bool {
        let is_doubled = || {
            self.doubled.iter().any(|(topic, by, edges)| {
                let times = PUBLISHER_DISTANCE_TOLERANCE * *edges as f64;
                let (length_m, angle_rad) =
                    (times * (by.length_m + arm.reach_m * by.angle_rad), times * by.angle_rad);
                let angle = residual.error.angle.as_ref();
                topic == stream.topic()
                    && residual.error.length.whole.rms <= length_m
                    && angle.is_none_or(|angle| angle.whole.rms <= angle_rad.max(MAX_ROUNDING_RAD))
            })
        };
        is_tf(arm, stream)
            && (self.on(arm, stream.topic(), &["FRM001"]).any(|(_, outcome)| is_faulty(outcome))
                || is_doubled())
    }
}

fn is_tf(arm: &ArmEvidence, stream: &StreamEvidence<PoseEvidence>) -> bool {
    arm.tf.as_ref().is_some_and(|tf| std::ptr::eq(tf, stream))
}

fn is_faulty(outcome: &Outcome) -> bool {
    matches!(outcome, Outcome::Evaluated(Ruling::Fail(_)))
}

pub(super) enum Attribution {
    /// Below the thresholds as logged.
    BelowThresholds,
    WithinNoise,
    /// The residual is below the thresholds or noise. `is_reported` if a corrected cause is reported.
    Explained {
        is_reported: bool,
    },
    /// Below the thresholds in rms, slightly above in places: small errors of every joint add up.
    SmallErrors(ExceedingResidual),
    /// Small deviations of many kinematic parameters.
    NominalModel(FkError),
    /// The residual is significant.
    Unexplained(ExceedingResidual),
    /// Orientations follow the arm in no known encoding, but positions agree.
    UnreadOrientations(ExceedingResidual),
    /// The residual may be noise, or due to these inconclusive rules.
    Undetermined(ExceedingResidual, Vec<&'static str>),
}

pub(super) struct ExceedingResidual {
    pub severity: Severity,
    pub error: FkError,
    /// Part with the largest error.
    pub worst: PartError,
    /// Parts above the thresholds, in order of time.
    pub parts: Vec<PartError>,
}

/// Limits for a nominal model, rms: 0.3 mm and 0.03°.
const MIN_NOMINAL_RESIDUAL_M: f64 = 0.3e-3;
const MIN_NOMINAL_RESIDUAL_RAD: f64 = 0.5e-3;

/// `None` if the stream has no error estimate.
pub(super) fn attribute_residual(
    outcomes: &CauseOutcomes,
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    thresholds: &FrameThresholds,
    subjects: usize,
) -> Option<Attribution> {
    let diagnosis = &stream.diagnosis;
    let proof = stream.proof.as_ref().ok()?;
    let is_unread = stream.reference_known && !is_tf(arm, stream) && is_unread(diagnosis, proof);
    let corrected = proof.corrected.as_ref().unwrap_or(&proof.as_logged);
    // Orientations that do not follow the arm are not corrected.
    let angle = if is_unread { &proof.as_logged.angle } else { &corrected.angle };
    let explained = &FkError { length: corrected.length.clone(), angle: angle.clone() };
    // A stream computed from the joint states has no noise. One far from FK, and orientations that do not follow the arm,
    // do not vary by noise alone.
    let noise_multiple = match is_tf(arm, stream) || diagnosis.is_far_from_fk() || is_unread {
        true => 0.0,
        false => MAX_NOISE_RATIO,
    };
    let in_degrees = arm.diagnosis.encoding.as_ref().is_ok_and(|encoding| encoding.is_in_degrees);
    if is_tf(arm, stream)
        && in_degrees
        && is_degrees_artifact(explained, outcomes, stream, thresholds)
    {
        return Some(Attribution::WithinNoise);
    }
    let causes = InconclusiveCauses::collect(outcomes, arm, stream);
    let as_logged = || Some(&proof.as_logged);
    // Without the corrections of causes that no rule reports.
    let uncorrected = match (causes.joints.is_empty(), causes.poses.is_empty()) {
        (true, true) => None,
        (false, true) => proof.poses_corrected.as_ref().or_else(as_logged),
        (true, false) => proof.joints_corrected.as_ref().or_else(as_logged),
        (false, false) => as_logged(),
    };
    // Links can imitate an eccentric gear, by deviations that are too large for them.
    let is_eccentric = arm.diagnosis.compliance.iter().any(JointCompliance::is_eccentric);
    let is_nominal = diagnosis.is_nominal && !is_eccentric;
    if let Some(calibrated) = proof.calibrated.as_ref().filter(|_| is_nominal)
        && (explained.length.whole.rms > MIN_NOMINAL_RESIDUAL_M
            || explained.angle.as_ref().is_some_and(|it| it.whole.rms > MIN_NOMINAL_RESIDUAL_RAD))
        && ExceedingResidual::from_error(calibrated, thresholds, noise_multiple).is_none_or(
            |left| left.severity != Severity::Error && is_mostly_explained(calibrated, explained),
        )
    {
        let larger = uncorrected.filter(|error| !is_hardly_larger(error, explained));
        let larger = larger
            .and_then(|error| ExceedingResidual::from_error(error, thresholds, noise_multiple));
        return Some(match larger {
            // The rules wait for this one.
            Some(residual) if smallest_residual_m(arm) > MIN_UNEXPLAINED_M => {
                Attribution::Unexplained(residual)
            }
            Some(residual) => {
                Attribution::Undetermined(residual, [causes.joints, causes.poses].concat())
            }
            None => Attribution::NominalModel(explained.clone()),
        });
    }
    if ExceedingResidual::from_error(&proof.as_logged, thresholds, 0.0).is_none() {
        return Some(Attribution::BelowThresholds);
    }
    if ExceedingResidual::from_error(&proof.as_logged, thresholds, noise_multiple).is_none() {
        return Some(Attribution::WithinNoise);
    }
    let residual = match ExceedingResidual::from_error(explained, thresholds, noise_multiple) {
        Some(residual) if is_unread && explained.length.whole.rms < thresholds.length.warning => {
            return Some(Attribution::UnreadOrientations(residual));
        }
        Some(residual) if outcomes.reports_tf_residual(arm, stream, &residual) => {
            return Some(Attribution::Explained { is_reported: true });
        }
        // Without a reference frame, the error as logged is meaningless.
        Some(residual) if proof.corrected.is_none() && !stream.reference_known => {
            return Some(Attribution::Undetermined(residual, vec!["ORD001"]));
        }
        Some(residual)
            if residual.is_significant_over_run(thresholds)
                || repeats_with_configuration(diagnosis, thresholds, subjects) =>
        {
            return Some(Attribution::Unexplained(residual));
        }
        residual => residual,
    };
    Some(
        match uncorrected.map_or(residual, |error| {
            ExceedingResidual::from_error(error, thresholds, noise_multiple)
        }) {
            Some(residual)
                if noise_multiple > 0.0
                    && uncorrected.is_none()
                    && residual.is_sum_of_small_errors(thresholds) =>
            {
                Attribution::SmallErrors(residual)
            }
            Some(residual) => {
                Attribution::Undetermined(residual, [causes.joints, causes.poses].concat())
            }
            None => match unreported_pose_correction(proof, thresholds)
                .filter(|_| !causes.is_reported)
            {
                Some(residual) => Attribution::Undetermined(residual, Vec::new()),
                None => Attribution::Explained { is_reported: causes.is_reported },
            },
        },
    )
}

/// Whether orientations follow the arm in no known encoding.
fn is_unread(diagnosis: &PoseDiagnosis, proof: &ResidualCheck) -> bool {
    /// 20°: above it, no encoding is accepted.
    const MIN_ERROR_RAD: f64 = 0.35;
    let angle = proof.as_logged.angle.as_ref();
    matches!(diagnosis.encoding, Err(NotObservable::DoesNotFollow(_)))
        && angle.is_some_and(|angle| angle.whole.rms > MIN_ERROR_RAD)
}

/// Whether small changes of all links explain most of a residual.
fn is_mostly_explained(calibrated: &FkError, explained: &FkError) -> bool {
    /// Rms, of the residual.
    const MAX_REMAINING_SHARE: f64 = 1.0 / 3.0;
    let is_small =
        |left: &ErrorSize, of: &ErrorSize| left.whole.rms <= MAX_REMAINING_SHARE * of.whole.rms;
    let angles = calibrated.angle.as_ref().zip(explained.angle.as_ref());
    is_small(&calibrated.length, &explained.length)
        && angles.is_none_or(|(left, of)| is_small(left, of))
}

/// Whether corrections change a residual by no more than a nominal model may leave.
fn is_hardly_larger(uncorrected: &FkError, explained: &FkError) -> bool {
    let exceeds = |uncorrected: &ErrorSize, explained: &ErrorSize, limit: f64| {
        uncorrected.whole.rms > explained.whole.rms + limit
    };
    let angles = uncorrected.angle.as_ref().zip(explained.angle.as_ref());
    !exceeds(&uncorrected.length, &explained.length, MIN_NOMINAL_RESIDUAL_M)
        && !angles.is_some_and(|(one, other)| exceeds(one, other, MIN_NOMINAL_RESIDUAL_RAD))
}

/// Effect of correcting the poses alone, if too large for several causes below their thresholds. A rule
/// must report it.
fn unreported_pose_correction(
    proof: &ResidualCheck,
    thresholds: &FrameThresholds,
) -> Option<ExceedingResidual> {
    let residual = ExceedingResidual::from_error(
        proof.joints_corrected.as_ref()?,
        thresholds,
        MAX_NOISE_RATIO,
    )?;
    (residual.severity == Severity::Error).then_some(residual)
}

/// Degrees read as radians turn joints almost a full revolution between samples; conflicting publishers may
/// add to that.
fn is_degrees_artifact(
    error: &FkError,
    outcomes: &CauseOutcomes,
    stream: &StreamEvidence<PoseEvidence>,
    thresholds: &FrameThresholds,
) -> bool {
    /// Unit: thresholds.
    const MAX_RESIDUAL_RATIO: f64 = 5.0;
    let distance_of_publishers =
        outcomes.doubled.iter().filter(|(topic, ..)| topic == stream.topic());
    let (by_m, by_rad) = distance_of_publishers
        .map(|(_, by, edges)| (by.length_m * *edges as f64, by.angle_rad * *edges as f64))
        .fold((0.0, 0.0), |sum, by| (sum.0 + by.0, sum.1 + by.1));
    with_thresholds(error, thresholds).zip([by_m, by_rad]).all(|((size, threshold), by)| {
        size.whole.rms < MAX_RESIDUAL_RATIO * threshold.warning + PUBLISHER_DISTANCE_TOLERANCE * by
    })
}

/// Whether the residual repeats with the configuration, unlike noise.
fn repeats_with_configuration(
    diagnosis: &PoseDiagnosis,
    thresholds: &FrameThresholds,
    subjects: usize,
) -> bool {
    diagnosis.residual.as_ref().is_ok_and(|residual| {
        let StreamResidual { excess_m, excess_rad, .. } = residual;
        matches!(decide_both(excess_m, excess_rad, thresholds, subjects), Decision::Fail(_))
    })
}

impl ExceedingResidual {
    /// Parts that reach the thresholds and exceed `noise_multiple` times the noise. Noise that is itself an error hides
    /// nothing.
    fn from_error(
        error: &FkError,
        thresholds: &FrameThresholds,
        noise_multiple: f64,
    ) -> Option<Self> {
        let mut parts: Vec<(f64, Severity, PartError)> = Vec::new();
        for (size, threshold) in with_thresholds(error, thresholds) {
            parts.extend(size.parts.iter().filter_map(|part| {
                let ErrorMagnitude { quantile_95: most, noise, .. } = part.magnitude;
                let noise = noise.map_or(0.0, |noise| noise.quantile_95);
                let is_more = most > noise_multiple * noise || noise > threshold.error;
                let severity = threshold.severity(most).filter(|_| is_more)?;
                Some((most / threshold.warning, severity, *part))
            }));
        }
        let (_, _, worst) = *parts.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let severity = parts.iter().map(|(_, severity, _)| *severity).max()?;
        let mut parts: Vec<PartError> = parts.into_iter().map(|(_, _, part)| part).collect();
        parts.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        parts.dedup_by(|a, b| a.from_s == b.from_s);
        Some(Self { severity, error: error.clone(), worst, parts })
    }

    pub fn from_error_above_noise(error: &FkError, thresholds: &FrameThresholds) -> Option<Self> {
        Self::from_error(error, thresholds, MAX_NOISE_RATIO)
    }

    /// Whether errors of every joint, each below its threshold, can sum to it.
    fn is_sum_of_small_errors(&self, thresholds: &FrameThresholds) -> bool {
        let is_small = |amount: &ErrorMagnitude, warning: f64| {
            amount.rms < MAX_SUMMED_RMS_RATIO * warning
                && amount.quantile_95 < MAX_SUMMED_PEAK_RATIO * warning
        };
        with_thresholds(&self.error, thresholds).all(|(size, threshold)| {
            let are_parts_small =
                size.parts.iter().all(|part| is_small(&part.magnitude, threshold.warning));
            size.whole.rms < threshold.warning && are_parts_small
        })
    }

    pub fn is_significant(&self) -> bool {
        self.worst.magnitude.noise.is_some_and(|noise| {
            self.worst.magnitude.rms >= MIN_SIGNIFICANT_NOISE_RATIO * noise.rms
        })
    }

    /// Whether the rms over the run reaches its threshold and a part is significant.
    fn is_significant_over_run(&self, thresholds: &FrameThresholds) -> bool {
        let is_significant_part = |part: &PartError| {
            let ErrorMagnitude { rms, noise, .. } = part.magnitude;
            noise.is_some_and(|noise| rms >= MIN_SIGNIFICANT_NOISE_RATIO * noise.rms)
        };
        with_thresholds(&self.error, thresholds).any(|(size, threshold)| {
            size.whole.rms >= threshold.warning && size.parts.iter().any(is_significant_part)
        })
    }

    /// Whether its worst part overlaps one of `other`.
    pub fn overlaps(&self, other: &ExceedingResidual) -> bool {
        let meets = |a: &PartError, b: &PartError| a.from_s < b.to_s && b.from_s < a.to_s;
        other.parts.iter().any(|part| meets(part, &self.worst))
    }
}

fn with_thresholds<'a>(
    error: &'a FkError,
    thresholds: &'a FrameThresholds,
) -> impl Iterator<Item = (&'a ErrorSize, &'a super::Threshold)> {
    let angle = error.angle.as_ref().map(|angle| (angle, &thresholds.angle));
    std::iter::once((&error.length, &thresholds.length)).chain(angle)
}

/// Inconclusive rules on a stream's causes.
struct InconclusiveCauses {
    joints: Vec<&'static str>,
    poses: Vec<&'static str>,
    is_reported: bool,
}

impl InconclusiveCauses {
    fn collect(
        outcomes: &CauseOutcomes,
        arm: &ArmEvidence,
        stream: &StreamEvidence<PoseEvidence>,
    ) -> Self {
        let diagnosis = &stream.diagnosis;
        let if_selected = |is: bool, code: &'static str| is.then_some(code);
        let unsteady = diagnosis.latency_profile.as_ref().is_ok_and(|profile| profile.is_unsteady);
        let times: Vec<&str> = [
            Some("LAT001"),
            if_selected(diagnosis.is_skew_chosen, "LAT002"),
            if_selected(unsteady, "LAT003"),
        ]
        .into_iter()
        .flatten()
        .collect();
        let frame = |frame: &EstimateResult<FrameEstimate>| {
            frame.as_ref().is_ok_and(|frame| frame.is_chosen)
        };
        // An orientation whose encoding is undetermined is not accounted for.
        let has_angle = stream.proof.as_ref().is_ok_and(|proof| proof.as_logged.angle.is_some());
        let encoding = match &diagnosis.encoding {
            Ok(encoding) => encoding.is_inverted || !encoding.best.is_as_logged(),
            Err(_) => has_angle,
        };
        let poses: Vec<&str> = [
            if_selected(frame(&diagnosis.reference) || frame(&diagnosis.tool), "FRM001"),
            if_selected(frame(&diagnosis.reference) && stream.reference_known, "FRM002"),
            if_selected(!diagnosis.reference_changes.is_empty(), "FRM002"),
            if_selected(frame(&diagnosis.tool) || !diagnosis.tool_changes.is_empty(), "FRM003"),
            if_selected(encoding, "ORD001"),
            if_selected(encoding, "ORD002"),
            if_selected(encoding, "ORD003"),
            if_selected(diagnosis.degrees.is_some(), "ORD004"),
            if_selected(matches!(diagnosis.length_unit, Ok(Some(_))), stream.unit_rule()),
            if_selected(matches!(diagnosis.axes, Ok(Some(_))), "ORD010"),
            if_selected(!diagnosis.constant_coordinates.is_empty(), "ORD011"),
            if_selected(
                diagnosis.is_radial_scale_chosen || !diagnosis.radial_scale_changes.is_empty(),
                "ZER002",
            ),
        ]
        .into_iter()
        .flatten()
        .collect();
        let on_joint = |column: usize, codes: &'static [&'static str]| {
            let joint = arm.joints.get(column).into_iter();
            joint.flat_map(move |joint| outcomes.on(arm, &joint.name, codes))
        };
        let JointDiagnosis { offsets, changes, compliance, encoding, .. } = &arm.diagnosis;
        let zeros = offsets.iter().enumerate().filter(|(_, offset)| offset.is_chosen);
        let unit_errors = encoding.iter().flat_map(|encoding| &encoding.unit_errors);
        let of_joints: Vec<_> = outcomes
            .on(arm, stream.topic(), &times)
            .chain(outcomes.on(arm, &arm.joints_topic, &["LAT001", "ORD004", "ORD005", "ORD009"]))
            .chain(zeros.flat_map(|(column, _)| on_joint(column, &["ZER001"])))
            .chain(changes.iter().flat_map(|one| on_joint(one.column, &["ORD009", "ZER001"])))
            .chain(compliance.iter().flat_map(|one| on_joint(one.column, &["MOT006", "ZER003"])))
            .chain(
                unit_errors.flat_map(|one| on_joint(one.column, &["ORD004", "ORD008", "ORD009"])),
            )
            .collect();
        let of_poses: Vec<_> = outcomes.on(arm, stream.topic(), &poses).collect();
        let is_reported = |(_, outcome): &(&str, &Outcome)| is_faulty(outcome);
        let open = |of: &[(&'static str, &Outcome)]| -> Vec<&'static str> {
            let mut open: Vec<&str> = of
                .iter()
                .filter(|(_, outcome)| matches!(outcome, Outcome::Inconclusive(_)))
                .map(|(code, _)| *code)
                .collect();
            open.dedup();
            open
        };
        Self {
            is_reported: !stream.reference_known
                || stream.has_bare_numbers
                || of_joints.iter().chain(&of_poses).any(is_reported),
            joints: open(&of_joints),
            poses: open(&of_poses),
        }
    }
}

/// From this residual on, the model may be of a different arm, rms m.
const MIN_UNEXPLAINED_M: f64 = 5e-3;
/// A cause is reported despite the residual if its effect is this multiple of it.
const MIN_EFFECT_RATIO: f64 = 10.0;

/// Residual of a stream, rms m; 0 if unknown.
pub(super) fn residual_m(stream: &StreamEvidence<PoseEvidence>) -> f64 {
    stream.diagnosis.residual.as_ref().map_or(0.0, |residual| residual.excess_m.value)
}

/// Smallest residual of the pose streams that are not computed from the joint states, rms m: if one follows FK, the model is
/// right.
fn smallest_residual_m(arm: &ArmEvidence) -> f64 {
    let known = |stream: &&StreamEvidence<PoseEvidence>| {
        !stream.diagnosis.is_derived && stream.diagnosis.residual.is_ok()
    };
    arm.poses.iter().filter(known).map(residual_m).reduce(f64::min).unwrap_or(0.0)
}

/// Reason for not reporting a cause of this effect: an unexplained residual of the model could produce it.
pub(super) fn model_doubt(arm: &ArmEvidence, effect_m: f64) -> Option<String> {
    residual_doubt(smallest_residual_m(arm), effect_m)
}

/// The same for a joint zero of this size, rad. Rotations show a zero whatever the lengths of the links.
pub(super) fn zero_doubt(arm: &ArmEvidence, zero_rad: f64) -> Option<String> {
    model_doubt(arm, 0.0).filter(|_| !rotations_show_zero(arm, zero_rad))
}

/// Whether the angle that remains in some stream is small relative to a joint zero.
pub(super) fn rotations_show_zero(arm: &ArmEvidence, zero_rad: f64) -> bool {
    arm.poses.iter().map(|stream| &stream.diagnosis).any(|found| {
        let is_small = |residual: &StreamResidual| {
            MIN_EFFECT_RATIO * residual.excess_rad.value < zero_rad.abs()
        };
        !found.is_derived && found.encoding.is_ok() && found.residual.as_ref().is_ok_and(is_small)
    })
}

/// The same, from the residual.
pub(super) fn residual_doubt(residual_m: f64, effect_m: f64) -> Option<String> {
    (residual_m > MIN_UNEXPLAINED_M && effect_m < MIN_EFFECT_RATIO * residual_m).then(|| {
        let residual = Unit::Metre.show(residual_m);
        format!("unexplained residual of {residual} (MDL001); check the model")
    })
}
