use crate::checks::encoding::{self, EncodingFaultKind, EncodingReport, quaternion_orders};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{EncodingEstimate, PoseEncoding};
use crate::finding::{Estimate, Severity};
use crate::geometry::{QuaternionOrderError, RotationError};

rule! {
    /// Quaternion components are in the wrong order.
    ///
    /// ## What it means
    /// Components w, x, y, z were stored as x, y, z, w, or the reverse. ROS messages, SciPy and Eigen's
    /// storage use x, y, z, w; MuJoCo, transforms3d, ABB robtargets and most constructors w first.
    ///
    /// ## Why it matters
    /// It is still a unit quaternion, so nothing fails. Yaw often looks right over part of its range and
    /// then stops, as if drifting.
    ///
    /// ## Evidence
    /// The residual against FK as logged (`as_logged_rad`) and in the other order (`corrected_rad`).
    ///
    /// ## How to fix
    /// Write components by name, not by position. Pose messages have the fields x, y, z, w; `Quaternion(w,
    /// x, y, z)` is a constructor's order.
    ///
    /// ## When it misleads
    /// If the orientation changes by less than about 20°, or about one axis only, both orders may fit with
    /// a constant frame: inconclusive.
    ORD002 {
        name: "quaternion-order",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no stream with orientations to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    encoding::judge(case, EncodingFaultKind::QuaternionOrder, report)
}

fn report(estimate: &EncodingEstimate) -> Option<EncodingReport> {
    let PoseEncoding::QuaternionOrder(error) = estimate.best else { return None };
    let (is, read_as) = quaternion_orders(error);
    let (right, wrong, fix) = match error {
        QuaternionOrderError::WxyzReadAsXyzw => (
            "w, x, y, z",
            "x, y, z, w",
            "fill the fields by name: x = q[1], y = q[2], z = q[3], w = q[0]",
        ),
        QuaternionOrderError::XyzwReadAsWxyz => (
            "x, y, z, w",
            "w, x, y, z",
            "fill the fields by name: x = q[0], y = q[1], z = q[2], w = q[3]",
        ),
    };
    Some(EncodingReport {
        title: "quaternion components in the wrong order",
        what: format!("quaternion {right} read as {wrong}"),
        corrected_reading: format!("read as {right}"),
        fix: fix.to_owned(),
        error: RotationError::Quaternion(error),
        estimate: Estimate::misinterpretation("quaternion order", is, read_as),
    })
}
