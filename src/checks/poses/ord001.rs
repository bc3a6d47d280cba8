use crate::checks::reading::{self, Kind, Wording, read_as, read_as_misreading, words};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{Reading, ReadingEstimate};
use crate::finding::{Estimate, RunnerUp, Severity, Unit};
use crate::geometry::{Convention, Misreading, RotationSlip};

rule! {
    /// Rotation numbers of one convention are read as another.
    ///
    /// ## What it means
    /// Three numbers that mean one thing (say a rotation vector, as Universal Robots reports it)
    /// were turned into a rotation as if they meant another (say roll, pitch, yaw). The positions
    /// are right, the orientations are not, and every orientation is off by another amount.
    ///
    /// Names are `rotvec` and `euler:SEQ` with SciPy's letters: lower case turns about fixed axes,
    /// upper case about moving axes, the numbers in the order of the letters. ROS rpy is
    /// `euler:xyz`. `euler:SEQ@axes` are numbers labelled rx, ry, rz that are turned in the order
    /// SEQ.
    ///
    /// ## Why it matters
    /// Near the pose at which somebody tested, the two readings may almost agree. Elsewhere they
    /// part by tens of degrees: a grasp planned from these poses misses, and a hand-eye calibration
    /// on them converges to nonsense without a warning.
    ///
    /// ## Evidence
    /// The stream's orientations are compared with forward kinematics under every pair of
    /// conventions, on every branch that a pendant may show (wrapped angles, the second Euler
    /// solution, rotation vectors beyond 180°). The finding gives the residual as logged
    /// (`as_logged_rad`), under the best reading (`corrected_rad`) and the ratio of the next best
    /// to it. Pairs that are the same map on every rotation, and pairs that this motion cannot tell
    /// apart, stand in `equivalent`.
    ///
    /// ## How to fix
    /// Change the line that turns the numbers into a rotation; the finding spells it in SciPy's
    /// words. To repair a log: turn the logged rotation back into the numbers with `read_as`, then
    /// into a rotation with `is`.
    ///
    /// ## When it misleads
    /// Where the arm hardly turns, or about one axis only, many readings agree and the rule says
    /// so instead of choosing. Where the stream's reference frame is not tied to the robot (a
    /// tracker's world), some readings differ by a constant frame only; the most usual is named and
    /// the others are listed. A reading is named only where it leaves at most half of what every
    /// other leaves.
    ORD001 {
        name: "rotation-convention",
        grade: Grade::Fixed(Severity::Error),
        headline: true,
        needs_model: true,
        missing: "no stream with orientations beside the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    reading::judge(case, Kind::Convention, word)
}

fn word(estimate: &ReadingEstimate) -> Option<Wording> {
    let Reading::Misread(class) = estimate.best else { return None };
    let (named, same) = class.members.split_first()?;
    let same = same.iter().map(read_as_misreading);
    let others = estimate.equivalent.iter().map(read_as);
    let runner_up = estimate.runner_up.as_ref().map(|(runner_up, rad)| {
        let names = read_as(runner_up);
        let ratio = rad / estimate.best_rad.max(Unit::Radian.noise_floor());
        RunnerUp { is: names.is, read_as: names.read_as, ratio }
    });
    Some(Wording {
        title: "rotation numbers read in the wrong convention",
        what: format!("{} read as {}", words(named.is), words(named.read_as)),
        once: format!("read as {}", words(named.is)),
        fix: fix(named),
        slip: RotationSlip::Misread(*named),
        estimate: Estimate::Convention {
            name: "convention",
            is: named.is.to_string(),
            read_as: named.read_as.to_string(),
            equivalent: same.chain(others).collect(),
            runner_up,
        },
    })
}

/// The line to write and the line to replace, in SciPy's words.
fn fix(Misreading { is, read_as }: &Misreading) -> String {
    let by_axis = |convention: &Convention| {
        *convention == Convention::RotVec || convention.to_string().ends_with("@axes")
    };
    let labels = if by_axis(is) || by_axis(read_as) { ["rx", "ry", "rz"] } else { ["a", "b", "c"] };
    format!("{}, not {}", scipy_call(*is, labels), scipy_call(*read_as, labels))
}

/// SciPy's call that turns numbers with these `labels`, in the order of the log, into a rotation.
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
        Ok(fix(&Misreading { is: is.parse()?, read_as: read_as.parse()? }))
    }

    #[test]
    fn the_fix_is_a_line_of_code() -> Result<(), ConventionError> {
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
