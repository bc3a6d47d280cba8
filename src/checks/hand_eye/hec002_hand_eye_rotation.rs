use super::hec001_hand_eye_closure;
use crate::checks::decision::DEGREE;
use crate::checks::hand_eye::chain::{
    MIN_AXIS_SPREAD, MIN_ROTATION_SPAN, THRESHOLDS, mismatch_reason, not_observable,
};
use crate::checks::{Case, FrameThresholds, Grade, SubjectResult};
use crate::diagnosis::{CameraPose, Measured, RotationDiversity};
use crate::evidence::HandEyeEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};

rule! {
    /// The hand rotates too little for hand-eye calibration.
    ///
    /// ## What it means
    /// The hand's rotations reveal the camera's pose on the hand. If they span less than 30° or share one
    /// axis, part of that pose is undetermined: the camera may be anywhere along the common axis.
    ///
    /// ## Why it matters
    /// A calibration from such a run fits the run and is off by centimetres once the hand tilts
    /// differently.
    ///
    /// ## Evidence
    /// - `span_rad`: largest angle between two hand orientations with the target visible.
    /// - `spread_rad`: spread of the rotation axes. 95 % of the rotations have an axis within this angle of
    ///   the most common one, `axis_in_hand`.
    /// - `undetermined`: components of the camera pose with an uncertainty above 2 mm or 0.2°.
    ///
    /// ## How to fix
    /// Record poses with the hand tilted by 30° or more about two perpendicular axes and the target in
    /// view. The finding names an axis to add.
    ///
    /// ## When it misleads
    /// It describes the run, not a fault: a cell that works tool-down never tilts its hand. It is therefore
    /// `info`, or a warning if hand-eye calibration is required (`--require HEC`, or `require` in the
    /// config).
    HEC002 {
        limits: &[MIN_ROTATION_SPAN, MIN_AXIS_SPREAD],
        name: "hand-eye-rotation",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "hand-eye: no camera-to-target poses in this log",
        check: check,
    }
}

/// Minimum duration of a calibration attempt, s.
const MIN_DURATION_S: f64 = 3.0;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.hand_eyes.iter().map(|one| judge(case, one).within(one.span)).collect()
}

fn judge(case: &Case, evidence: &HandEyeEvidence) -> SubjectResult {
    let needed =
        [&MIN_ROTATION_SPAN, &MIN_AXIS_SPREAD].map(|limit| case.thresholds.limit(&HEC002, limit));
    let diagnosis = &evidence.diagnosis;
    let diversity = match &diagnosis.diversity {
        Ok(diversity) => diversity,
        Err(why) => return SubjectResult::new(evidence.subject(), not_observable(why)),
    };
    let undetermined = diagnosis
        .best()
        .map_or_else(Vec::new, |solution| undetermined_axes(case, &solution.camera));
    let observed_s = evidence.span.map_or(f64::INFINITY, |span| span.seconds());
    let has_enough_rotation = diversity.span_rad >= needed[0];
    let is_poor = !has_enough_rotation || diversity.spread_rad < needed[1];
    let outcome = match mismatch_reason(diagnosis) {
        Some(why) if has_enough_rotation && diagnosis.alternative.is_none() => {
            Outcome::Inconclusive(why)
        }
        _ if is_poor && observed_s < MIN_DURATION_S => Outcome::Inconclusive(format!(
            "the target is visible for only {observed_s:.1} s; record 10 s or more"
        )),
        _ if is_poor => Outcome::fail(fault(diversity, needed, &undetermined, severity(case))),
        _ => Outcome::pass_with_remark(format!(
            "the hand rotates by {}, with axes spread over {}{}",
            Unit::Radian.show(diversity.span_rad),
            Unit::Radian.show(diversity.spread_rad),
            match undetermined.as_slice() {
                [] => String::new(),
                some => format!(
                    "; with this target noise the camera is undetermined {}",
                    some.join(", ")
                ),
            }
        )),
    };
    let (name, value) = match has_enough_rotation {
        false => ("rotation span", diversity.span_rad),
        true => ("spread of axes", diversity.spread_rad),
    };
    SubjectResult::new(evidence.subject(), outcome)
        .estimated(Estimate::exact(name, Unit::Radian.symbol(), value))
        .with_evidence("span_rad", diversity.span_rad)
        .with_evidence("spread_rad", diversity.spread_rad)
        .with_evidence("axis_in_hand", diversity.axis_in_hand.to_vec())
        .with_evidence("undetermined", undetermined)
}

/// A warning only if the pose is required.
fn severity(case: &Case) -> Severity {
    let required =
        [&hec001_hand_eye_closure::HEC001, &HEC002].into_iter().any(|rule| case.requires(rule));
    if required { Severity::Warning } else { Severity::Info }
}

fn fault(
    diversity: &RotationDiversity,
    needed: [f64; 2],
    undetermined: &[String],
    severity: Severity,
) -> Fault {
    let [least_span, least_spread] = needed.map(|angle| Unit::Radian.show(angle));
    let span = Unit::Radian.show(diversity.span_rad);
    let message = if diversity.span_rad < needed[0] {
        format!("the hand rotates by only {span} (need {least_span})")
    } else {
        let spread = Unit::Radian.show(diversity.spread_rad);
        format!("all rotations of the hand share one axis (spread {spread}, need {least_spread})")
    };
    let limits = match undetermined {
        [] => String::new(),
        some => format!("; the camera is undetermined {}", some.join(", ")),
    };
    Fault {
        cause: Cause::Pictured(Picture::HandEye),
        severity,
        title: "hand-eye is not observable",
        message: message + &limits,
        evidence: Evidence::default(),
        fix: describe_motion(diversity, needed),
    }
}

/// Motion to add.
fn describe_motion(diversity: &RotationDiversity, [least_span, least_spread]: [f64; 2]) -> String {
    /// For a good calibration, rad, even if the limits are lower.
    const MIN_RECOMMENDED_RAD: f64 = 30.0 * DEGREE;
    let rotation = Unit::Radian.show(least_span.max(least_spread).max(MIN_RECOMMENDED_RAD));
    if diversity.span_rad < 2.0 * DEGREE {
        return format!(
            "rotate the hand by {rotation} or more about two axes, with the target in view"
        );
    }
    let [across, other] = perpendicular_axes(diversity.axis_in_hand);
    match diversity.spread_rad < least_spread {
        true => {
            format!("add poses tilted by {rotation} or more about {across} or {other} of the hand")
        }
        false => format!("add poses tilted by {rotation} or more, with the target in view"),
    }
}

/// The two axes of the hand closest to perpendicular to `axis`.
fn perpendicular_axes(axis: [f64; 3]) -> [&'static str; 2] {
    let mut named = [("x", axis[0].abs()), ("y", axis[1].abs()), ("z", axis[2].abs())];
    named.sort_by(|a, b| a.1.total_cmp(&b.1));
    [named[0].0, named[1].0]
}

/// Camera axes whose uncertainty exceeds the thresholds of HEC001.
fn undetermined_axes(case: &Case, camera: &CameraPose) -> Vec<String> {
    let axes = ["x", "y", "z"];
    let half = |error: f64| Measured { std_error: error, ..camera.distance_m }.half_width(0.95);
    let listed = |how: &str, unit: Unit, errors: [f64; 3], needed: f64| -> Vec<String> {
        let wide = axes.into_iter().zip(errors.map(half)).filter(|(_, half)| *half > needed);
        wide.map(|(axis, half)| match half.is_finite() {
            true => format!("{how} {axis} (±{})", unit.show(half)),
            false => format!("{how} {axis}"),
        })
        .collect()
    };
    let FrameThresholds { length, angle } =
        case.thresholds.frame_thresholds(&hec001_hand_eye_closure::HEC001, THRESHOLDS);
    let mut all = listed("along", Unit::Metre, camera.translation_error_m, length.warning);
    all.extend(listed("about", Unit::Radian, camera.rotation_error_rad, angle.warning));
    all
}
