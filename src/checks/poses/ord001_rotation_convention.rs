use crate::checks::encoding::{
    self, EncodingFaultKind, EncodingReport, convention_names, describe_convention, encoding_names,
};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{EncodingEstimate, PoseEncoding};
use crate::finding::{Estimate, RunnerUp, Severity, Unit};
use crate::geometry::{Convention, Misinterpretation, RotationError};

rule! {
    /// Rotation numbers of one convention are read as another.
    ///
    /// ## What it means
    /// Three numbers in one convention (a UR's rotation vector) were converted in another (roll, pitch,
    /// yaw). Positions are right; orientations are wrong, differently at every pose.
    ///
    /// Conventions: `rotvec`, and `euler:SEQ` with SciPy's letters in the order of the numbers: lower case
    /// for fixed axes, upper case for moving axes. ROS rpy is `euler:xyz`. `euler:SEQ@axes` are numbers
    /// labelled rx, ry, rz, applied in the order SEQ.
    ///
    /// ## Why it matters
    /// Both may almost agree near the pose used for testing, and differ by tens of degrees elsewhere.
    /// Grasps miss, and hand-eye calibration silently converges to a wrong result.
    ///
    /// ## Evidence
    /// Orientations are compared with FK under every pair of conventions, on every branch that a pendant
    /// may show (wrapped angles, the second Euler solution, rotation vectors beyond 180°).
    ///
    /// - `as_logged_rad`, `corrected_rad`: residual as logged and under the best pair; also the next best's
    ///   ratio to it.
    /// - `equivalent`: pairs that are the same map or that this motion cannot separate.
    ///
    /// ## How to fix
    /// Change the line that converts the numbers; the finding gives the SciPy call. To repair a log,
    /// convert rotations back to numbers with `read_as`, then to rotations with `is`.
    ///
    /// ## When it misleads
    /// With little rotation, or about one axis only, many conventions agree: inconclusive. If the reference
    /// frame is not fixed to the robot (a tracker's world), some differ only by a constant frame. The most
    /// common is reported, the others are listed. A convention is reported only if its residual is at most
    /// half of every other's.
    ORD001 {
        name: "rotation-convention",
        grade: Grade::Fixed(Severity::Error),
        headline: true,
        needs_model: true,
        missing: "no stream with orientations to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    encoding::judge(case, EncodingFaultKind::Convention, report)
}

fn report(estimate: &EncodingEstimate) -> Option<EncodingReport> {
    let PoseEncoding::Misinterpreted(class) = estimate.best else { return None };
    let (named, same) = class.members.split_first()?;
    let same = same.iter().map(convention_names);
    let others = estimate.equivalent.iter().map(encoding_names);
    let runner_up = estimate.runner_up.as_ref().map(|(runner_up, rad)| {
        let names = encoding_names(runner_up);
        let ratio = rad / estimate.best_rad.max(Unit::Radian.noise_floor());
        RunnerUp { is: names.is, read_as: names.read_as, ratio }
    });
    Some(EncodingReport {
        title: "rotation numbers read in the wrong convention",
        what: format!(
            "{} read as {}",
            describe_convention(named.is),
            describe_convention(named.read_as)
        ),
        corrected_reading: format!("read as {}", describe_convention(named.is)),
        fix: fix(named),
        error: RotationError::Misread(*named),
        estimate: Estimate::Convention {
            name: "convention",
            is: named.is.to_string(),
            read_as: named.read_as.to_string(),
            equivalent: same.chain(others).collect(),
            runner_up,
        },
    })
}

fn fix(Misinterpretation { is, read_as }: &Misinterpretation) -> String {
    let by_axis = |convention: &Convention| {
        *convention == Convention::RotVec || convention.to_string().ends_with("@axes")
    };
    let labels = if by_axis(is) || by_axis(read_as) { ["rx", "ry", "rz"] } else { ["a", "b", "c"] };
    format!("{}, not {}", scipy_call(*is, labels), scipy_call(*read_as, labels))
}

/// Converts numbers with these `labels`, in log order, to a rotation.
fn scipy_call(convention: Convention, labels: [&str; 3]) -> String {
    let name = convention.to_string();
    let Some(order) = name.strip_prefix("euler:") else {
        return format!("Rotation.from_rotvec([{}])", labels.join(", "));
    };
    let (letters, numbers) = match order.strip_suffix("@axes") {
        Some(letters) => (letters, letters.chars().map(|axis| format!("r{axis}")).collect()),
        None => (order, labels.map(str::to_owned).to_vec()),
    };
    format!("Rotation.from_euler(\"{letters}\", [{}])", numbers.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::ConventionError;

    fn fix_of(is: &str, read_as: &str) -> Result<String, ConventionError> {
        Ok(fix(&Misinterpretation { is: is.parse()?, read_as: read_as.parse()? }))
    }

    #[test]
    fn the_fix_is_one_line_of_code() -> Result<(), ConventionError> {
        assert_eq!(
            fix_of("rotvec", "euler:xyz")?,
            r#"Rotation.from_rotvec([rx, ry, rz]), not Rotation.from_euler("xyz", [rx, ry, rz])"#
        );
        assert_eq!(
            fix_of("euler:ZYZ", "euler:XYZ")?,
            r#"Rotation.from_euler("ZYZ", [a, b, c]), not Rotation.from_euler("XYZ", [a, b, c])"#
        );
        assert_eq!(
            fix_of("euler:xzy@axes", "euler:xyz")?,
            r#"Rotation.from_euler("xzy", [rx, rz, ry]), not Rotation.from_euler("xyz", [rx, ry, rz])"#
        );
        Ok(())
    }
}
