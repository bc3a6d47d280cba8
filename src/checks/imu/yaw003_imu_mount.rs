use super::{AXES, signed_axis, unless_fk_is_wrong};
use crate::checks::decision::{DEGREE, Decision, Threshold, decide_length, not_observable};
use crate::checks::{CONTRADICTION, Case, Grade, SubjectResult};
use crate::diagnosis::{ImuMountChange, MeasuredLength};
use crate::evidence::{ArmEvidence, ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Change, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::geometry::{Rotation, Vec3, angle_between, xyzw_from_rotation};
use serde_json::{Value, json};
use std::f64::consts::PI;

rule! {
    /// IMU mount differs from the log's frames.
    ///
    /// ## What it means
    /// The orientation follows the arm only with another rotation between link and IMU than in the log's
    /// transforms.
    ///
    /// ## Why it matters
    /// Rates and accelerations appear on the wrong axes: at 90°, roll becomes pitch.
    ///
    /// ## Evidence
    /// The angle between the best-fitting mount and the one in the log.
    ///
    /// - `link_from_imu`: the best-fitting mount as a quaternion x, y, z, w.
    /// - `direction_cosines`: the same as a matrix, with one column per IMU axis and one row per link axis.
    /// - `axes`: the direction of each IMU axis in words.
    /// - `logged_direction_cosines`, `logged_axes`: for the mount in the log's frames.
    /// - `contradiction`: the motion does not show the mount, and the logged mount puts gravity off the base's vertical. The
    ///   run does not pass.
    /// - If the IMU slips within the run, `value` is the angle of the slip and `change_ns` its time.
    ///   `from`, `to`: angles to the logged mount before and after; `link_from_imu_after`: the mount after.
    ///
    /// Without a frame for the IMU, the rule is skipped and the mount is evidence only. Permuted or
    /// reversed axes are named, for instance forward-right-down (FRD) in a forward-left-up frame. A gyro
    /// with left-handed axes, or axes other than the orientation's, is also reported.
    ///
    /// ## How to fix
    /// Correct the static transform of the IMU's frame, or the axes that its driver reports.
    ///
    /// ## When it misleads
    /// A wrong static transform and a wrongly mounted sensor look the same. Zero offsets of the wrist
    /// joints also rotate the mount; the offsets found are corrected first.
    YAW003 {
        name: "imu-mount",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no IMU on the arm",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::Radian, warning: 1.0 * DEGREE, error: 5.0 * DEGREE };

const SETTLE: &str = "rotate the IMU through 60° about two axes";

fn check(case: &Case) -> Vec<SubjectResult> {
    let imus = || case.evidence.imus();
    let axes = imus().filter_map(|(_, imu)| judge_axes(case, imu));
    imus().map(|(arm, imu)| judge(case, arm, imu)).chain(axes).collect()
}

/// Gyro axes must be right-handed and match the orientation's; `None` if they do.
fn judge_axes(case: &Case, imu: &StreamEvidence<ImuEvidence>) -> Option<SubjectResult> {
    let fault = |severity, message: String, fix: String| Fault {
        severity,
        cause: Cause::Pictured(Picture::ImuAxes),
        title: "gyro axes do not match the IMU's",
        message,
        evidence: Evidence::default(),
        fix,
    };
    if let Some(axis) = imu.diagnosis.conventions.mirrored_axis {
        let axis = AXES[axis];
        let message = format!("the gyro's axes are left-handed: {axis} is reversed");
        let fix =
            format!("negate {axis} of the angular velocity, or check which axes the driver swaps");
        let outcome = Outcome::fail(fault(Severity::Error, message, fix));
        let half = Estimate::exact("mount error", THRESHOLD.unit.symbol(), PI);
        return Some(imu.judged(outcome).estimated(half));
    }
    let rotation = imu.diagnosis.axes_rotation.as_ref()?;
    // Orientation filters deviate slightly from their own gyro, so the error threshold applies.
    let threshold = case.thresholds.threshold(&YAW003, THRESHOLD);
    // Rotation about one axis leaves one direction unobservable.
    if rotation.size_rad.norm.half_width(0.95) > threshold.error {
        return None;
    }
    let coarse = Threshold { warning: threshold.error, ..threshold };
    let decision = decide_length(&rotation.size_rad, &coarse, case.evidence.subjects());
    let Decision::Fail(severity) = decision else { return None };
    let size = THRESHOLD.unit.show_measured(&rotation.size_rad.norm);
    let what = match rotation.with_accel {
        true => "gyro and accelerometer axes",
        false => "gyro axes",
    };
    let order = permuted(&rotation.imu_from_gyro)
        .map_or(String::new(), |order| format!(": its x, y, z are the orientation's {order}"));
    let message = format!("{what} are {size} off the orientation's axes{order}");
    let fix = "publish gyro, accelerometer and orientation in the same axes (REP 145)".to_owned();
    let estimate = Estimate::length("mount error", THRESHOLD.unit, &rotation.size_rad);
    Some(imu.judged(Outcome::fail(fault(severity, message, fix))).estimated(estimate))
}

fn judge(case: &Case, arm: &ArmEvidence, imu: &StreamEvidence<ImuEvidence>) -> SubjectResult {
    let threshold = case.thresholds.threshold(&YAW003, THRESHOLD);
    let slips = imu.diagnosis.mount_change.as_ref().and_then(|change| {
        let decision = decide_length(&change.size_rad, &threshold, case.evidence.subjects());
        let is_vague = change.size_rad.norm.half_width(0.95) > threshold.error;
        (matches!(decision, Decision::Fail(_)) && !is_vague).then_some((decision, change))
    });
    let judged = match (&imu.diagnosis.mount_rad, slips) {
        (_, Some((decision, change))) => {
            let when = Change {
                from: angle_to_mount_rad(imu, imu.diagnosis.link_from_imu),
                to: angle_to_mount_rad(imu, Some(change.link_from_imu)),
                change_ns: case.evidence.origin.shifted(change.at_s),
                change_ci95_ns: Some(
                    change.interval_s.map(|end_s| case.evidence.origin.shifted(end_s)),
                ),
            };
            let outcome = decision
                .into_outcome(SETTLE, |severity| slipped(case, imu, change, &when, severity));
            let outcome = unless_fk_is_wrong(outcome, arm, change.size_rad.norm.value);
            let estimate = Estimate::length("mount error", THRESHOLD.unit, &change.size_rad);
            imu.judged(outcome).estimated(estimate.with_change(when)).with_evidence(
                "link_from_imu_after",
                xyzw_from_rotation(&change.link_from_imu).to_vec(),
            )
        }
        (Err(why), None) => match gravity_error(imu).filter(|tilt| *tilt > threshold.error) {
            Some(tilt_rad) => imu
                .judged(Outcome::Inconclusive(format!(
                    "gravity is {} off the base's vertical: the mount is wrong, or the base is tilted; {SETTLE}",
                    THRESHOLD.unit.show(tilt_rad)
                )))
                .with_evidence(CONTRADICTION, true),
            None => imu.judged(not_observable(why, SETTLE)),
        },
        (Ok(mount), None) => {
            let decision = decide_length(mount, &threshold, case.evidence.subjects());
            // Too uncertain for a finding.
            let is_vague = mount.norm.half_width(0.95) > threshold.error;
            let outcome = match decision {
                Decision::Fail(_) if is_vague => {
                    let shown = THRESHOLD.unit.show_measured(&mount.norm);
                    Outcome::Inconclusive(format!("{shown} is too uncertain; {SETTLE}"))
                }
                decision => decision.into_outcome(SETTLE, |severity| fault(mount, imu, severity)),
            };
            let outcome = unless_fk_is_wrong(outcome, arm, mount.norm.value);
            let estimate = Estimate::length("mount error", THRESHOLD.unit, mount);
            imu.judged(outcome).estimated(estimate)
        }
    };
    let link = &imu.link;
    let Some(mount) = imu.diagnosis.link_from_imu else { return judged };
    let judged = judged
        .with_evidence("link_from_imu", xyzw_from_rotation(&mount).to_vec())
        .with_evidence("direction_cosines", direction_cosines(&mount, link))
        .with_evidence("axes", sentences(&mount, link));
    match &imu.link_from_imu {
        Some(logged) => judged
            .with_evidence("logged_direction_cosines", direction_cosines(logged, link))
            .with_evidence("logged_axes", sentences(logged, link)),
        None => judged,
    }
}

/// Tilt of a base that stands or hangs, by the accelerometer, FK and the logged mount: a 95 % lower bound.
fn gravity_error(imu: &StreamEvidence<ImuEvidence>) -> Option<f64> {
    let (up, logged) = (imu.diagnosis.up?, imu.link_from_imu?);
    let assumed = imu.diagnosis.link_from_imu?;
    let [low, high] = up.base_tilt_rad.norm.interval(0.95);
    (angle_between(&logged, &assumed) < f64::EPSILON.sqrt()).then(|| low.min(PI - high))
}

const MAX_AXIS_ANGLE_RAD: f64 = 10.0 * DEGREE;

fn direction_cosines(mount: &Rotation, link: &str) -> Value {
    let columns = [0, 1, 2].map(|axis| mount * Vec3::ith(axis, 1.0));
    let rows = [0, 1, 2].map(|row| columns.map(|column| column[row]));
    json!({
        "rows": AXES.map(|axis| format!("{link} {axis}")),
        "columns": AXES.map(|axis| format!("imu {axis}")),
        "matrix": rows,
    })
}

fn sentences(mount: &Rotation, link: &str) -> Vec<String> {
    let sentence = |axis| format!("imu {} points {}", AXES[axis], direction(mount, axis, link));
    (0..AXES.len()).map(sentence).collect()
}

/// `along tool0 -y`, or by how much it is off the nearest link axis.
fn direction(mount: &Rotation, axis: usize, link: &str) -> String {
    let cosines = mount * Vec3::ith(axis, 1.0);
    let mut nearest = [0, 1, 2];
    nearest.sort_by(|&a, &b| cosines[b].abs().total_cmp(&cosines[a].abs()));
    let [first, second, _] =
        nearest.map(|along| format!("{link} {}", signed_axis(along, cosines[along])));
    let deviation_rad = cosines[nearest[0]].abs().min(1.0).acos();
    if deviation_rad < THRESHOLD.warning {
        return format!("along {first}");
    }
    format!("{:.0}° off {first} towards {second}", deviation_rad.to_degrees())
}

/// Angle to the logged mount; to the mount at the start if the log has none.
fn angle_to_mount_rad(imu: &StreamEvidence<ImuEvidence>, mount: Option<Rotation>) -> f64 {
    let of = imu.link_from_imu.or(imu.diagnosis.link_from_imu);
    of.zip(mount).map_or(0.0, |(of, mount)| angle_between(&of, &mount))
}

/// The directions of x, y and z if `error` permutes or reverses axes, otherwise `None`.
fn permuted(error: &Rotation) -> Option<String> {
    let axes = [0, 1, 2].map(|axis| {
        let points = error * Vec3::ith(axis, 1.0);
        let along = points.iamax();
        (along, points[along])
    });
    let is_permutation = axes.iter().all(|(_, cosine)| cosine.abs() >= MAX_AXIS_ANGLE_RAD.cos());
    let is_same =
        axes.iter().enumerate().all(|(axis, (along, cosine))| axis == *along && *cosine > 0.0);
    if !is_permutation || is_same {
        return None;
    }
    let order = axes.map(|(along, cosine)| signed_axis(along, cosine)).join(", ");
    let known = match order.as_str() {
        "x, -y, -z" => " (FRD, as with NED: z points down)",
        "y, x, -z" => " (NED for ENU: z points down)",
        other if other.ends_with("-z") => " (z points down)",
        _ => "",
    };
    Some(format!("{order}{known}"))
}

fn slipped(
    case: &Case,
    imu: &StreamEvidence<ImuEvidence>,
    change: &ImuMountChange,
    when: &Change,
    severity: Severity,
) -> Fault {
    let size = THRESHOLD.unit.show_measured(&change.size_rad.norm);
    let at = case.evidence.moment(when.change_ns);
    let against = match imu.link_from_imu {
        Some(_) => {
            let [from, to] = [when.from, when.to].map(|shown_angle| Unit::Radian.show(shown_angle));
            format!(": {from} off the log's frames before, {to} after")
        }
        None => String::new(),
    };
    Fault {
        severity,
        cause: Cause::Pictured(Picture::ImuAxes),
        title: "IMU slips in its mount",
        message: format!("the IMU's mount turns by {size} at {at}{against}"),
        evidence: Evidence::default(),
        fix: format!("fasten the IMU; recalibrate its mount for data recorded after {at}"),
    }
}

fn fault(mount: &MeasuredLength, imu: &StreamEvidence<ImuEvidence>, severity: Severity) -> Fault {
    let link_from_imu = imu.diagnosis.link_from_imu;
    let shown = THRESHOLD.unit.show_measured(&mount.norm);
    let axes = link_from_imu.map_or(String::new(), |link_from_imu| {
        let [x, y, z] = [0, 1, 2].map(|axis| direction(&link_from_imu, axis, &imu.link));
        format!(": imu x points {x}; y {y}; z {z}")
    });
    let both = imu.link_from_imu.zip(link_from_imu);
    let permuted = both
        .and_then(|(logged, found)| permuted(&(logged.inverse() * found)))
        .map_or(String::new(), |order| format!(": the IMU's x, y, z are the frame's {order}"));
    Fault {
        severity,
        cause: link_from_imu.map_or(Cause::Pictured(Picture::ImuAxes), Cause::ImuMount),
        title: "IMU mount differs",
        message: format!("mount differs from the log's frames by {shown}{permuted}{axes}"),
        evidence: Evidence::default(),
        fix: "correct the IMU's static transform, or its driver's axes".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, length};
    use crate::diagnosis::NotObservable;
    use crate::finding::Status;
    use crate::geometry::rotation_from_rpy;

    fn mount(rpy_degrees: [f64; 3]) -> Rotation {
        rotation_from_rpy(rpy_degrees.map(f64::to_radians))
    }

    #[test]
    fn axes_are_described_by_direction() {
        let quarter = sentences(&mount([0.0, 0.0, -90.0]), "tool0");
        assert_eq!(
            quarter,
            [
                "imu x points along tool0 -y",
                "imu y points along tool0 x",
                "imu z points along tool0 z"
            ]
        );
        let tilted = sentences(&mount([0.0, 32.0, 0.0]), "tool0");
        assert_eq!(tilted[0], "imu x points 32° off tool0 x towards tool0 -z");
        assert_eq!(tilted[1], "imu y points along tool0 y");
        let slightly = |degrees: f64| sentences(&mount([0.0, 0.0, degrees]), "tool0").remove(0);
        assert_eq!(slightly(8.0), "imu x points 8° off tool0 x towards tool0 y");
        assert_eq!(slightly(0.4), "imu x points along tool0 x");
    }

    #[test]
    fn columns_of_the_direction_cosines_are_imu_axes() {
        let cosines = direction_cosines(&mount([0.0, 0.0, 90.0]), "tool0");
        assert_eq!(cosines["rows"][1], "tool0 y");
        assert_eq!(cosines["columns"][0], "imu x");
        // IMU x points along link y.
        assert!((cosines["matrix"][1][0].as_f64().unwrap() - 1.0).abs() < 1e-12);
        assert!((cosines["matrix"][0][1].as_f64().unwrap() + 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_rotated_mount_is_an_error_and_a_missing_frame_is_skipped() {
        let mut run = clean_run();
        let imu = &mut run.robots[0].imus[0].diagnosis;
        imu.mount_rad = Ok(length(90.0 * DEGREE));
        imu.link_from_imu = Some(mount([0.0, 0.0, 90.0]));
        let (_, findings) = evaluate_rule(&YAW003, &run);
        assert_eq!(findings[0].severity, Severity::Error);
        let said = &findings[0].message;
        assert!(said.ends_with("imu x points along tool0 y; y along tool0 -x; z along tool0 z"));
        run.robots[0].imus[0].diagnosis.mount_rad = Err(NotObservable::NoFrame);
        let (rows, _) = evaluate_rule(&YAW003, &run);
        assert_eq!(rows[0].status, Status::Skipped);
    }
}
