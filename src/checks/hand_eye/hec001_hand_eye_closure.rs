use super::{hec002_hand_eye_rotation, hec003_camera_axes};
use crate::checks::decision::{Decision, decide_both, decide_frame};
use crate::checks::frames::{show, show_pose};
use crate::checks::hand_eye::chain::{
    MIN_ROTATION_SPAN, SETTLE, THRESHOLDS, describe_mount, is_mount_decided, mismatch_reason,
    not_observable, with_solution,
};
use crate::checks::{Case, FrameThresholds, Grade, SubjectResult, decide, residual_attribution};
use crate::diagnosis::{
    CameraMount, HandEyeSolution, Measured, PoseEncoding, TargetEncoding, TargetScaleError,
};
use crate::evidence::{ArmEvidence, HandEyeEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};

rule! {
    /// A hand-eye chain does not close.
    ///
    /// ## What it means
    /// With the camera in the hand, the target is fixed in the base. With the camera fixed, the target is
    /// fixed in the hand. Either no camera pose and time offset make the recorded poses consistent with this.
    /// Or the camera pose that does differs from the one in the log's frames.
    ///
    /// ## Why it matters
    /// The robot misses what the camera sees by about the closure residual.
    ///
    /// ## Evidence
    /// - `pose`: camera pose in the frame `pose_in` (hand or base, by `mount`). `pose_half_width_m` and
    ///   `pose_half_width_rad`: 95 % half-widths along and about the camera's axes; null if not observable.
    /// - `mount_ratio`: residual of the other mount divided by that of `mount`. `equivalent`: the setup
    ///   that no such log can distinguish from `mount`.
    /// - `target_pose`: constant target pose on the other side of the chain.
    /// - `time_offset_s`: compensated latency of the target's stamps relative to the hand's.
    /// - The estimate is the distance from the camera pose in the log's frames (`mount error`), or else the
    ///   rms residual beyond pose-to-pose noise (`closure`).
    /// - `rms_m`, `rms_rad`, `median_m`, `median_rad`: residual including noise; `closure_samples`: pose by pose.
    /// - `scale`: factor by which target positions are too long (wrong tag size or unit). `depth_scale`:
    ///   the same for depth alone (wrong focal length). Only one is given if it closes the chain as well as
    ///   both.
    /// - `reading`: how the target poses must be read for the chain to close, if known.
    ///
    /// If the distance to the target barely changes, the camera pose absorbs a scale error. A pass
    /// therefore requires the scale to be known to within the warning threshold at the mean distance. The
    /// chain is solved with Park and Martin (1994) and refined by robust Gauss–Newton.
    ///
    /// ## How to fix
    /// Correct what `reading` names. Otherwise calibrate the lens, give the detector the true target size,
    /// check that nothing slips, and repeat the hand-eye calibration.
    ///
    /// ## When it misleads
    /// Detector errors depend on the view and do not average out: a few millimetres at one metre are
    /// normal. A loose or moved target opens the chain. A camera in the hand with inverted poses (parent
    /// and child swapped) is indistinguishable from a fixed camera.
    HEC001 {
        name: "hand-eye-closure",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: false,
        missing: "hand-eye: no camera-to-target poses in this log",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let judged = case.evidence.hand_eyes.iter().map(|one| {
        let arm = case.evidence.robots.iter().find(|arm| Some(&arm.name) == one.robot.as_ref());
        judge(case, arm, one).within(one.span)
    });
    judged.collect()
}

fn judge(case: &Case, arm: Option<&ArmEvidence>, evidence: &HandEyeEvidence) -> SubjectResult {
    let (thresholds, subjects) =
        (case.thresholds.frame_thresholds(&HEC001, THRESHOLDS), case.evidence.subjects());
    let diagnosis = &evidence.diagnosis;
    let as_logged = match &diagnosis.solution {
        Ok(solution) => solution,
        Err(why) => return SubjectResult::new(evidence.subject(), not_observable(why)),
    };
    let best = diagnosis.best().unwrap_or(as_logged);
    let by_mount = match hec003_camera_axes::detect_swap(evidence) {
        None => diagnosis.mount_error.as_ref(),
        Some(_) => None,
    };
    let closure = |solution: &HandEyeSolution| {
        Estimate::frame("closure", &solution.closure.excess_m, &solution.closure.excess_rad)
    };
    let open = decide_both(&best.closure.excess_m, &best.closure.excess_rad, &thresholds, subjects);
    let reading = diagnosis.alternative.as_ref().map(|solution| &solution.encoding);
    let scaled = match reading {
        Some(TargetEncoding::Scaled(_)) => as_logged,
        _ => best,
    };
    let scale = decide(&scaled.scale.effect_m(), &thresholds.length, subjects);
    let span_rad = diagnosis.diversity.as_ref().map_or(0.0, |diversity| diversity.span_rad);
    let (outcome, estimate) = match (reading, open) {
        _ if span_rad
            < case.thresholds.limit(&hec002_hand_eye_rotation::HEC002, &MIN_ROTATION_SPAN) =>
        {
            let why = format!("too little rotation to solve it (HEC002); {SETTLE}");
            (Outcome::Inconclusive(why), closure(best))
        }
        (Some(reading), _) if is_fault(reading, as_logged, &thresholds) => {
            let fault = misinterpreted(reading, as_logged, &thresholds);
            (Outcome::fail(fault), closure(as_logged))
        }
        (_, Decision::Fail(severity)) => {
            let doubt = || model_doubt(arm?, best.closure.excess_m.value);
            let outcome = match mismatch_reason(diagnosis).or_else(doubt) {
                Some(why) => Outcome::Inconclusive(why),
                None => Outcome::fail(open_chain(evidence, best, severity)),
            };
            (outcome, closure(best))
        }
        (_, Decision::Undecided(why)) => {
            (Outcome::Inconclusive(format!("{why}; {SETTLE}")), closure(best))
        }
        (_, Decision::Pass) => match (evidence.logged, by_mount) {
            (Some(logged), _) if logged != best.mount && is_mount_decided(best) => {
                (Outcome::fail(other_mount(logged)), closure(best))
            }
            _ if !matches!(scale, Decision::Pass) => {
                let outcome =
                    scale.into_outcome(SETTLE_SCALE, |severity| stretched(scaled, severity));
                (outcome, closure(best))
            }
            (_, Some(error)) => {
                let estimate =
                    Estimate::frame("mount error", &error.translation_m, &error.rotation_rad);
                let outcome = match decide_frame(error, &thresholds, subjects) {
                    Decision::Pass => closed_chain(evidence, best),
                    Decision::Undecided(why) => {
                        Outcome::Inconclusive(format!("camera mount: {why}; {SETTLE}"))
                    }
                    Decision::Fail(severity) => Outcome::fail(Fault {
                        severity,
                        cause: Cause::CameraMount {
                            in_hand: is_mount_decided(best)
                                .then_some(best.mount == CameraMount::InHand),
                            parent: evidence.parent_of(best.mount),
                            pose: best.camera.pose,
                        },
                        title: "camera mount error",
                        message: format!(
                            "the camera is {} from its pose in the log's frames",
                            show(error)
                        ),
                        evidence: Evidence {
                            effect_m: Some(error.translation_m.value),
                            ..Evidence::default()
                        },
                        fix: format!(
                            "set the camera's static transform{} to {}",
                            evidence
                                .parent_of(best.mount)
                                .map_or(String::new(), |parent| format!(" in {parent}")),
                            show_pose(&best.camera.pose)
                        ),
                    }),
                };
                (outcome, estimate)
            }
            _ => (closed_chain(evidence, best), closure(best)),
        },
    };
    let judged = SubjectResult::new(evidence.subject(), outcome).estimated(estimate);
    let judged = with_solution(judged, evidence, best);
    let judged = match reading {
        Some(reading) => judged.with_evidence("reading", describe_encoding(reading)),
        None => judged,
    };
    let Some(TargetEncoding::Scaled(stretch)) = reading else { return judged };
    let factors = [("scale", &stretch.size), ("depth_scale", &stretch.depth)];
    factors.into_iter().fold(judged, |judged, (key, factor)| match factor {
        Some(one) => {
            let ci95 = Unit::One.interval95(one);
            judged.with_evidence(key, serde_json::json!({ "value": one.value, "ci95": ci95 }))
        }
        None => judged,
    })
}

/// Reason why an open chain may not be a hand-eye error: the arm's model, whose FK is the hand pose, is too
/// inaccurate.
fn model_doubt(arm: &ArmEvidence, open_m: f64) -> Option<String> {
    let left = |stream: &StreamEvidence<PoseEvidence>| {
        stream.diagnosis.residual.as_ref().ok().map(|residual| residual.excess_m.value)
    };
    let nominal_m = arm.poses.iter().filter(|stream| stream.diagnosis.is_nominal).filter_map(left);
    let nominal_m: f64 = nominal_m.fold(0.0, f64::max);
    if nominal_m > 0.0 && open_m < 3.0 * nominal_m {
        let left = Unit::Metre.show(nominal_m);
        return Some(format!(
            "nominal model against a calibrated arm: {left} residual (MDL001); use the arm's own \
             calibration"
        ));
    }
    residual_attribution::model_doubt(arm, open_m)
}

fn closed_chain(evidence: &HandEyeEvidence, solution: &HandEyeSolution) -> Outcome {
    let closure = &solution.closure;
    let (m, rad) = (Unit::Metre.show(closure.rms_m), Unit::Radian.show(closure.rms_rad));
    let camera = describe_camera(evidence, solution);
    Outcome::pass_with_remark(format!(
        "closes to {m} and {rad} rms ({}); {camera}",
        describe_setup(solution)
    ))
}

/// Camera pose with its 95 % interval.
fn describe_camera(evidence: &HandEyeEvidence, solution: &HandEyeSolution) -> String {
    let camera = &solution.camera;
    let parent = evidence.parent_of(solution.mount).unwrap_or_else(|| match solution.mount {
        CameraMount::InHand => "hand".to_owned(),
        CameraMount::InBase => "base".to_owned(),
    });
    let half = |unit: Unit, amount: &Measured, errors: [f64; 3]| {
        let std_error = errors.into_iter().fold(0.0, f64::max);
        match unit.half_width(&Measured { std_error, ..*amount }, 0.95) {
            half if half.is_finite() => format!("±{}", unit.show(half)),
            _ => "not bounded".to_owned(),
        }
    };
    let length = half(Unit::Metre, &camera.distance_m, camera.translation_error_m);
    let angle = half(Unit::Radian, &camera.angle_rad, camera.rotation_error_rad);
    format!("{parent}→camera: {} ({length}, {angle})", show_pose(&camera.pose))
}

fn describe_setup(solution: &HandEyeSolution) -> String {
    let mount = match is_mount_decided(solution) {
        true => match solution.mount {
            CameraMount::InHand => "eye-in-hand".to_owned(),
            CameraMount::InBase => "eye-to-hand".to_owned(),
        },
        false => "eye-in-hand or eye-to-hand, not observable in this motion".to_owned(),
    };
    let offset = &solution.offset_s;
    let [low_s, high_s] = offset.interval(0.95);
    if low_s > 0.0 || high_s < 0.0 {
        return format!("{mount}, target {} late", Unit::Second.show_signed(offset));
    }
    format!("{mount}, time offset < {}", Unit::Second.show(high_s.max(-low_s)))
}

fn open_chain(evidence: &HandEyeEvidence, solution: &HandEyeSolution, severity: Severity) -> Fault {
    let closure = &solution.closure;
    let m = Unit::Metre.show_measured(&closure.excess_m);
    let rad = Unit::Radian.show_measured(&closure.excess_rad);
    Fault {
        severity,
        cause: Cause::Pictured(Picture::HandEye),
        title: "hand-eye chain does not close",
        message: format!(
            "hand-eye residual {m} and {rad} rms beyond noise after the best fit ({}); {}",
            describe_setup(solution),
            describe_camera(evidence, solution),
        ),
        evidence: Evidence { effect_m: Some(closure.excess_m.value), ..Evidence::default() },
        fix:
            "check lens calibration, target size and anything that may slip, then repeat the hand-eye \
             calibration"
                .to_owned(),
    }
}

fn misinterpreted(
    encoding: &TargetEncoding,
    as_logged: &HandEyeSolution,
    thresholds: &FrameThresholds,
) -> Fault {
    let closure = &as_logged.closure;
    let (m, rad) = (Unit::Metre.show(closure.rms_m), Unit::Radian.show(closure.rms_rad));
    let description = describe_encoding(encoding);
    let severity = thresholds
        .length
        .severity(closure.excess_m.value)
        .max(thresholds.angle.severity(closure.excess_rad.value));
    Fault {
        severity: severity.unwrap_or(Severity::Warning),
        cause: Cause::Pictured(Picture::HandEye),
        title: "target poses misread",
        message: format!(
            "hand-eye residual {m} and {rad} rms as logged; it closes if {description}"
        ),
        evidence: Evidence { effect_m: Some(closure.rms_m), ..Evidence::default() },
        fix: match encoding {
            TargetEncoding::Scaled(stretch) => stretch_fix(stretch),
            _ => "correct the rotation encoding of the detector".to_owned(),
        },
    }
}

fn other_mount(logged: CameraMount) -> Fault {
    let other = match logged {
        CameraMount::InHand => CameraMount::InBase,
        CameraMount::InBase => CameraMount::InHand,
    };
    Fault {
        severity: Severity::Error,
        cause: Cause::Pictured(Picture::HandEye),
        title: "camera mount differs from the frames",
        message: format!(
            "in the log's frames the camera is {}, but the chain closes only if it is {} or if the target \
             poses are inverted",
            describe_mount(logged),
            describe_mount(other),
        ),
        evidence: Evidence::default(),
        fix:
            "invert the target poses (parent and child are swapped), or correct the camera's frame"
                .to_owned(),
    }
}

fn describe_encoding(encoding: &TargetEncoding) -> String {
    match encoding {
        TargetEncoding::Axes(axes) => {
            format!("target positions are {}", hec003_camera_axes::describe_axes(*axes))
        }
        TargetEncoding::Scaled(stretch) => describe_stretch(stretch),
        TargetEncoding::Rotations(encoding) => match encoding {
            PoseEncoding::AsLogged | PoseEncoding::Numbers(_) => "read as logged".to_owned(),
            PoseEncoding::Transposed | PoseEncoding::Inverted => {
                "target rotations are transposed".to_owned()
            }
            PoseEncoding::QuaternionOrder(_) => {
                "target quaternion components are reordered".to_owned()
            }
            PoseEncoding::Misinterpreted(class) => match class.members.first() {
                Some(one) => format!("target rotations are {}, not {}", one.is, one.read_as),
                None => "target rotations follow a different convention".to_owned(),
            },
        },
    }
}

/// HEC003 reports wrong axes. A wrong scale counts from the thresholds on.
fn is_fault(
    encoding: &TargetEncoding,
    as_logged: &HandEyeSolution,
    thresholds: &FrameThresholds,
) -> bool {
    match encoding {
        TargetEncoding::Axes(_) => false,
        TargetEncoding::Scaled(_) => {
            thresholds.length.severity(as_logged.closure.excess_m.value).is_some()
        }
        _ => true,
    }
}

const SETTLE_SCALE: &str = "the scale of the target positions (lens, target size) is undetermined: view the \
    target at distances that differ by a third";

/// Fault of a chain that closes because the camera pose absorbs a wrong scale.
fn stretched(solution: &HandEyeSolution, severity: Severity) -> Fault {
    /// Minimum ratio of significances for interchangeable factors.
    const MIN_SIGNIFICANCE_RATIO: f64 = 0.7;
    let scale = &solution.scale;
    let surely = |of: &Measured| ((of.value - 1.0) / of.std_error).abs();
    let [size, depth] = [&scale.size, &scale.depth].map(surely);
    let is_size = size > depth;
    let stretch = TargetScaleError {
        size: Some(scale.size).filter(|_| is_size),
        depth: Some(scale.depth).filter(|_| !is_size),
        along: scale.along,
        is_either: size.min(depth) > MIN_SIGNIFICANCE_RATIO * size.max(depth),
    };
    let effect = Unit::Metre.show(scale.effect_m().value.abs());
    Fault {
        severity,
        cause: Cause::Pictured(Picture::HandEye),
        title: "target positions have a wrong scale",
        message: format!(
            "best fit if {}; otherwise the camera is off by {effect} along its view axis ({})",
            describe_stretch(&stretch),
            describe_setup(solution)
        ),
        evidence: Evidence { effect_m: Some(scale.effect_m().value.abs()), ..Evidence::default() },
        fix: stretch_fix(&stretch),
    }
}

/// Example in the fix, mm.
const MIN_SHOWN_MM: f64 = 40.0;

fn describe_stretch(TargetScaleError { size, depth, .. }: &TargetScaleError) -> String {
    let factor = |of: &Measured| format!("{:.4} ± {:.4}", of.value, of.half_width(0.95));
    let size =
        size.as_ref().map(|size| format!("target positions are divided by {}", factor(size)));
    let depth =
        depth.as_ref().map(|depth| format!("target depth alone is divided by {}", factor(depth)));
    size.into_iter().chain(depth).collect::<Vec<String>>().join(" and ")
}

/// Setting of the detector or lens to correct.
fn stretch_fix(TargetScaleError { size, depth, is_either, .. }: &TargetScaleError) -> String {
    let size_fix = size.as_ref().map(|size| match size.value {
        value if (value / 1e3 - 1.0).abs() < 0.02 => "publish positions in metres, not millimetres".to_owned(),
        value => format!(
            "set the true target size in the detector: a target configured as {MIN_SHOWN_MM:.0} mm measures {:.1} \
             mm",
            MIN_SHOWN_MM / value
        ),
    });
    let depth_fix = depth.as_ref().map(|depth| {
        let (off, side) = (depth.value - 1.0, if depth.value < 1.0 { "small" } else { "large" });
        format!(
            "calibrate the lens: fx and fy are {:.1} % too {side}, so depth is {:.3} times too long",
            100.0 * off.abs(),
            depth.value,
        )
    });
    let both = size_fix.into_iter().chain(depth_fix).collect::<Vec<String>>().join("; ");
    match (is_either, size) {
        (false, _) => both,
        (true, Some(_)) => {
            format!("{both}; or calibrate the lens: a wrong focal length has the same effect here")
        }
        (true, None) => {
            format!("{both}; or measure the target: a wrong size has the same effect here")
        }
    }
}
