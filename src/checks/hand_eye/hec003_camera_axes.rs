use crate::checks::decision::DEGREE;
use crate::checks::hand_eye::chain::{mismatch_reason, not_observable};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::TargetEncoding;
use crate::evidence::HandEyeEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, rounded};
use crate::geometry::{Axes, Rotation, Vec3, angle_between, rotation_from_rpy};
use crate::run::CameraAxes;

rule! {
    /// Camera axes are swapped: optical (z forward) and body (z up).
    ///
    /// ## What it means
    /// An *optical* camera frame (REP 103) has z forward and x right; a body frame has x forward and z up.
    /// Poses of one kind are published in a frame of the other kind, or the positions follow one and the
    /// rotations the other.
    ///
    /// ## Why it matters
    /// A point ahead of the camera is interpreted as above it. If the whole pose is swapped, a calibration
    /// of this mount hides the error, but other users of the frame are affected.
    ///
    /// ## Evidence
    /// If positions and rotations have different axes, the chain does not close; `reading` closes it. A
    /// pose swapped as a whole is detected only with a reference for the camera's orientation: static
    /// transforms from the hand or base to the camera, or a frame called `optical` (or attached to one)
    /// whose target lies along x instead of z. `view` is the mean direction to the target in camera axes.
    ///
    /// ## How to fix
    /// Publish the target in the matching frame: `camera_link` is x forward, `camera_optical_frame` is z
    /// forward.
    ///
    /// ## When it misleads
    /// Without such frames, a pose swapped as a whole cannot be detected and the rule is skipped. A camera
    /// rotated by exactly this rotation relative to its frame looks the same.
    HEC003 {
        name: "camera-axes",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: false,
        missing: "hand-eye: no camera-to-target poses in this log",
        check: check,
    }
}

/// From the body–optical rotation, rad.
const MAX_SWAP_DEVIATION_RAD: f64 = 20.0 * DEGREE;
/// Between the view axis and the direction to the target, rad.
const MAX_VIEW_ANGLE_RAD: f64 = 35.0 * DEGREE;

pub(super) enum AxisSwap {
    /// Positions and rotations differ.
    Within(Axes),
    /// The whole pose has these axes, the frame name implies the others.
    Whole(CameraAxes),
}

pub(super) fn detect_swap(evidence: &HandEyeEvidence) -> Option<AxisSwap> {
    let found = &evidence.diagnosis;
    let encoding = found.alternative.as_ref().map(|solution| &solution.encoding);
    if let Some(TargetEncoding::Axes(axes)) = encoding {
        return Some(AxisSwap::Within(*axes));
    }
    let known = found.mount_error.as_ref().filter(|error| {
        // A less certain rotation could be either convention.
        error.rotation_rad.half_width(0.95) < MAX_SWAP_DEVIATION_RAD
    });
    let by_mount = known.and_then(|error| {
        let is_close =
            |turn: &Rotation| angle_between(turn, &error.pose.rotation) < MAX_SWAP_DEVIATION_RAD;
        let body_from_optical = body_from_optical();
        // `logged_from_solved`: the poses are expressed in the solved frame.
        match () {
            () if is_close(&body_from_optical) => Some(CameraAxes::Optical),
            () if is_close(&body_from_optical.inverse()) => Some(CameraAxes::Body),
            () => None,
        }
    });
    let by_view = || match (evidence.axes, axes_of_view(found.view)) {
        (Some(named), Some(seen)) if named != seen => Some(seen),
        _ => None,
    };
    let rotation_error = match known {
        Some(_) => by_mount,
        None => by_view(),
    };
    rotation_error.map(AxisSwap::Whole)
}

fn body_from_optical() -> Rotation {
    use std::f64::consts::FRAC_PI_2;
    rotation_from_rpy([-FRAC_PI_2, 0.0, -FRAC_PI_2])
}

/// Convention that puts a target in this direction ahead.
fn axes_of_view(view: [f64; 3]) -> Option<CameraAxes> {
    let view = Vec3::from(view);
    let along = |axis: Vec3| view.dot(&axis) > MAX_VIEW_ANGLE_RAD.cos() * view.norm().max(1e-9);
    match () {
        () if along(Vec3::z()) => Some(CameraAxes::Optical),
        () if along(Vec3::x()) => Some(CameraAxes::Body),
        () => None,
    }
}

/// For instance `(-y, -z, x)`.
pub(super) fn describe_axes(axes: Axes) -> String {
    format!("read as ({})", axes.standard_names(false).join(", "))
}

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.hand_eyes.iter().map(|one| judge(one).within(one.span)).collect()
}

fn judge(evidence: &HandEyeEvidence) -> SubjectResult {
    let diagnosis = &evidence.diagnosis;
    if let Err(why) = &diagnosis.solution {
        return SubjectResult::new(evidence.subject(), not_observable(why));
    }
    let Some(swap) = detect_swap(evidence) else {
        return SubjectResult::new(evidence.subject(), no_swap_outcome(evidence))
            .with_evidence("view", diagnosis.view.to_vec());
    };
    if let (AxisSwap::Whole(_), Some(why)) = (&swap, mismatch_reason(diagnosis)) {
        return SubjectResult::new(evidence.subject(), Outcome::Inconclusive(why));
    }
    let (is, read_as) = axes_names(&swap);
    let judged = SubjectResult::new(evidence.subject(), Outcome::fail(fault(evidence, &swap)))
        .estimated(Estimate::misinterpretation("camera axes", is, read_as))
        .with_evidence("view", diagnosis.view.to_vec());
    match swap {
        AxisSwap::Within(axes) => judged.with_evidence("reading", describe_axes(axes)),
        AxisSwap::Whole(_) => judged,
    }
}

fn no_swap_outcome(evidence: &HandEyeEvidence) -> Outcome {
    let found = &evidence.diagnosis;
    if let Some(why) = mismatch_reason(found) {
        return Outcome::Inconclusive(why);
    }
    match (&found.mount_error, evidence.axes, axes_of_view(found.view)) {
        (Some(_), _, _) => Outcome::pass_with_remark("the camera axes agree with the log's frames"),
        (None, Some(named), Some(_)) => {
            Outcome::pass_with_remark(format!("the target is ahead of the camera ({})", named.describe()))
        }
        (None, Some(named), None) => {
            let view = found.view.map(|part| rounded(part, 2)).join(", ");
            Outcome::Inconclusive(format!(
                "the target is neither along z nor along x but at ({view}), in a frame that should have {}; \
                 move the target to the image centre",
                named.describe()
            ))
        }
        (None, None, _) => Outcome::Skipped(
            "camera axis convention unknown: the log has no static transform to the camera, and its frame \
             name does not contain `optical`"
                .to_owned(),
        ),
    }
}

/// Actual and assumed axes.
fn axes_names(swap: &AxisSwap) -> (&'static str, &'static str) {
    let (optical, body) = (CameraAxes::Optical.describe(), CameraAxes::Body.describe());
    match swap {
        AxisSwap::Whole(CameraAxes::Optical) => (optical, body),
        AxisSwap::Whole(CameraAxes::Body) => (body, optical),
        AxisSwap::Within(axes) if *axes == Axes::OPTICAL => (optical, body),
        AxisSwap::Within(axes) if *axes == Axes::OPTICAL.inverse() => (body, optical),
        AxisSwap::Within(_) => ("other axes", "the rotation's axes"),
    }
}

fn fault(evidence: &HandEyeEvidence, swap: &AxisSwap) -> Fault {
    let (is, read_as) = axes_names(swap);
    let camera = &evidence.camera;
    let (message, fix) = match swap {
        AxisSwap::Within(axes) => (
            format!(
                "positions and rotations have different axes: the chain closes if positions are {}",
                describe_axes(*axes)
            ),
            "publish position and rotation of the target in one frame".to_owned(),
        ),
        AxisSwap::Whole(seen) if evidence.axes == Some(*seen) => (
            format!(
                "poses have {is}, as the name of frame '{camera}' says, but its transform in the log has {read_as}"
            ),
            format!(
                "correct the transform of '{camera}': an optical frame is turned by roll -90°, pitch 0°, yaw -90° \
                 against its body frame"
            ),
        ),
        AxisSwap::Whole(_) => (
            format!("poses have {is}, but frame '{camera}' should have {read_as}"),
            "use the frame that matches the poses: optical is z forward, body is x forward"
                .to_owned(),
        ),
    };
    Fault {
        cause: Cause::Pictured(Picture::HandEye),
        severity: Severity::Error,
        title: "camera axes are swapped",
        message,
        evidence: Evidence::default(),
        fix,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_view_direction_determines_the_axes() {
        assert_eq!(axes_of_view([0.2, -0.1, 0.9]), Some(CameraAxes::Optical));
        assert_eq!(axes_of_view([0.8, 0.1, 0.0]), Some(CameraAxes::Body));
        assert_eq!(axes_of_view([0.5, 0.0, 0.5]), None);
        assert_eq!(axes_of_view([0.0; 3]), None);
    }

    #[test]
    fn swaps_match_the_rotation_between_optical_and_body_axes() {
        let swap = |turn: Rotation| {
            let logged = Vec3::new(1.0, 2.0, 3.0);
            let is_equal = |axes: &&Axes| (axes.to_standard(logged) - turn * logged).norm() < 1e-9;
            let axes = Axes::all().iter().find(is_equal).expect("a quarter turn");
            axes_names(&AxisSwap::Within(*axes)).0
        };
        assert_eq!(swap(body_from_optical().inverse()), CameraAxes::Body.describe());
        assert_eq!(swap(body_from_optical()), CameraAxes::Optical.describe());
    }
}
