//! Decides whether logs suffice to calibrate an arm.

use super::{Rule, find};
use crate::diagnosis::{ArmCalibration, StreamCalibration};
use crate::finding::Severity;
use crate::robot::{JointKind, Robot};

/// Minimum ratio of the expected FK error, nominal to calibrated, or of the usual link deviations to those of an arm that
/// equals its model.
const MIN_IMPROVEMENT_RATIO: f64 = 2.0;
/// Maximum ratio of the cross-validated residual to the nominal one.
const MAX_CROSS_VALIDATION_RATIO: f64 = 0.9;
/// Residuals up to this multiple of the noise need no improvement.
const MAX_NOISE_RATIO: f64 = 1.1;
/// Confidence that some deviation is real, over all parameters.
const DEVIATION_CONFIDENCE: f64 = 0.999;
/// Smaller deviations and residuals, m or rad, are numerical.
const MIN_DEVIATION: f64 = 1e-6;
/// Minimum ratio of the cross-validated residual to the nominal one if the models are equal.
const MIN_EQUAL_RATIO: f64 = 0.95;
/// Larger frame offsets are not link deviations, m. It is also the largest change of the tip by a calibration in an audit.
pub(crate) const MAX_DEVIATION_M: f64 = 10e-3;
/// Joints that move less than this (rad, m) are listed as unmoved.
const MIN_TRAVEL_RAD: f64 = 60.0 * std::f64::consts::PI / 180.0;
const MIN_TRAVEL_M: f64 = 0.1;
/// Rms distances of calibrated rows from their fixed point, m: rejected, and rejected if one jump explains it. Both
/// are at least this many times the median of the files.
const MAX_POINT_ERROR_M: f64 = 3e-3;
const MAX_JUMP_ERROR_M: f64 = 0.5e-3;
const MAX_POINT_ERROR_RATIO: f64 = 4.0;
/// Rows further from the point than this, and than this many times the median of their file, are outliers.
const MIN_ROW_ERROR_M: f64 = 1e-3;
const MAX_ROW_ERROR_RATIO: f64 = 6.0;

/// Whether a finding means that an arm's own calibration is missing.
pub(crate) fn suggests_calibration(code: &str, severity: Severity) -> bool {
    find(code).is_ok_and(Rule::is_residual_check) && severity == Severity::Info
}

/// A joint that moved too little for calibration.
#[derive(Clone, Debug)]
pub struct UnmovedJoint {
    /// Joint name.
    pub joint: String,
    /// Range of motion, rad or m.
    pub moved: f64,
    /// Prismatic.
    pub slides: bool,
}

pub(crate) fn unmoved_joints(
    robot: &Robot,
    joints: &[String],
    calibration: &ArmCalibration,
) -> Vec<UnmovedJoint> {
    let of = |(at, joint): (usize, &String)| {
        let moved = calibration
            .streams
            .iter()
            .filter_map(|stream| stream.spans.get(at))
            .fold(0.0, |a: f64, b| a.max(*b));
        let slides = robot.joint(joint).is_some_and(|joint| joint.kind == JointKind::Prismatic);
        let is_unmoved = moved < if slides { MIN_TRAVEL_M } else { MIN_TRAVEL_RAD };
        is_unmoved.then(|| UnmovedJoint { joint: joint.clone(), moved, slides })
    };
    joints.iter().enumerate().filter_map(of).collect()
}

/// Reason for rejecting the calibration.
pub(crate) fn rejection_reason(
    calibration: &ArmCalibration,
    unmoved: &[UnmovedJoint],
) -> Option<String> {
    let (known, nominal) =
        (calibration.calibrated_uncertainty.m, calibration.nominal_uncertainty.m);
    // Its nominal FK is as certain as a calibrated one.
    let is_nominal =
        calibration.excluded_ratio() >= MIN_IMPROVEMENT_RATIO && equals_nominal(calibration);
    if known.is_nan() || nominal == 0.0 || (known * MIN_IMPROVEMENT_RATIO > nominal && !is_nominal)
    {
        let moved = match unmoved {
            [] => String::new(),
            unmoved => {
                let names: Vec<&str> = unmoved.iter().map(|one| one.joint.as_str()).collect();
                format!("; {} moved too little", names.join(", "))
            }
        };
        return Some(format!(
            "expected FK error over the workspace: {:.3} mm rms calibrated, {:.3} mm nominal{moved}",
            1e3 * known,
            1e3 * nominal
        ));
    }
    calibration.streams.iter().find_map(|stream| match is_nominal {
        true => residual_rejection_reason(stream),
        false => stream_rejection_reason(stream),
    })
}

/// Why the calibrated links are not those of the named arm: the largest deviation is beyond what a manufactured arm has.
pub(crate) fn implausible_links(calibration: &ArmCalibration) -> Option<String> {
    let far = |&at: &usize| {
        let ends = calibration.value(at).interval(0.95);
        ends.iter().all(|end| *end > MAX_DEVIATION_M)
            || ends.iter().all(|end| *end < -MAX_DEVIATION_M)
    };
    let lengths = calibration.parameters.iter().zip(0..).filter(|(one, _)| !one.is_rotation);
    let largest = lengths
        .map(|(_, at)| at)
        .filter(far)
        .max_by(|a, b| calibration.values[*a].abs().total_cmp(&calibration.values[*b].abs()));
    if let Some(at) = largest {
        return Some(format!(
            "{} would be {:.1} mm from its place, but links of one model differ by less than {:.0} mm",
            calibration.links[calibration.parameters[at].link],
            1e3 * calibration.values[at].abs(),
            1e3 * MAX_DEVIATION_M
        ));
    }
    calibration.is_link_size_at_bound().then(|| {
        format!(
            "links would deviate by {:.1} mm and {:.1}° per axis or more, the largest deviations tried",
            1e3 * calibration.link_m,
            (0.1 / 1e-3) * calibration.link_m
        )
    })
}

/// Whether every parameter agrees with the nominal model within its uncertainty, and together they do not
/// predict unseen poses better: correlated parameters may each be insignificant.
pub(crate) fn equals_nominal(calibration: &ArmCalibration) -> bool {
    let predicts_better = |stream: &StreamCalibration| {
        let (before, after) = (&stream.held_out_before, &stream.held_out_after);
        [(before.m, after.m), (before.rad, after.rad)]
            .iter()
            .any(|(before, after)| *before > MIN_DEVIATION && *after < MIN_EQUAL_RATIO * before)
    };
    if calibration.streams.iter().any(predicts_better) {
        return false;
    }
    let count = calibration.values.len();
    let confidence = 1.0 - (1.0 - DEVIATION_CONFIDENCE) / count.max(1) as f64;
    (0..count).all(|at| {
        let value = calibration.value(at);
        let [low, high] = value.interval(confidence);
        value.value.abs() < MIN_DEVIATION || (low <= 0.0 && high >= 0.0)
    })
}

/// Reason why a stream contradicts the calibration.
pub(crate) fn stream_rejection_reason(stream: &StreamCalibration) -> Option<String> {
    if let Some(reason) = residual_rejection_reason(stream) {
        return Some(reason);
    }
    let (before, after) = (stream.held_out_before.m, stream.held_out_after.m);
    (after > MAX_CROSS_VALIDATION_RATIO * before && before > max_noise_m(stream)).then(|| {
        format!(
            "cross-validated residual of {:.3} mm rms does not improve on the nominal residual of {:.3} mm",
            1e3 * after,
            1e3 * before
        )
    })
}

/// Reason why the calibrated links fit a stream worse than the nominal ones. Those of an arm that equals its model need not
/// fit better.
fn residual_rejection_reason(stream: &StreamCalibration) -> Option<String> {
    (stream.after.m > stream.before.m.max(max_noise_m(stream))).then(|| {
        format!(
            "calibrated residual of {:.3} mm rms exceeds the nominal residual of {:.3} mm",
            1e3 * stream.after.m,
            1e3 * stream.before.m
        )
    })
}

/// Residual that noise alone explains, m.
fn max_noise_m(stream: &StreamCalibration) -> f64 {
    (MAX_NOISE_RATIO * 3f64.sqrt() * stream.noise[0]).max(MIN_DEVIATION)
}

/// Whether rows with calibrated distances of `rms_m` do not share a fixed point. Files usually leave `typical_m`;
/// `jumps` returns whether one jump of the point explains the distances.
pub(crate) fn is_point_moved(rms_m: f64, typical_m: f64, jumps: impl FnOnce() -> bool) -> bool {
    let least_m = MAX_POINT_ERROR_RATIO * typical_m;
    let is_far = typical_m > MAX_POINT_ERROR_M || rms_m > least_m.max(MAX_POINT_ERROR_M);
    is_far || (rms_m > least_m.max(MAX_JUMP_ERROR_M) && jumps())
}

/// Distance from the fixed point beyond which a row is an outlier. Rows of its file usually leave `typical_m`.
pub(crate) fn max_row_error_m(typical_m: f64) -> f64 {
    (MAX_ROW_ERROR_RATIO * typical_m).max(MIN_ROW_ERROR_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{CalibrationResidual, LinkParameter};
    use crate::robot::catalogue;

    /// Residuals in m: \[nominal, calibrated\], on training data and on held-out segments. The nominal
    /// model has an expected error of 1 mm.
    fn calibration_with(
        expected_m: f64,
        [before, after]: [f64; 2],
        [held_out_before, held_out_after]: [f64; 2],
    ) -> ArmCalibration {
        let residual = |m: f64| CalibrationResidual { m, rad: m };
        let stream = StreamCalibration {
            samples: 1000,
            latency_s: None,
            reference: None,
            tool: None,
            before: residual(before),
            after: residual(after),
            held_out_before: residual(held_out_before),
            held_out_after: residual(held_out_after),
            noise: [1e-5, 1e-5],
            inflation: [1.0, 1.0],
            spans: vec![2.0, 2.0, 2.0, 0.1, 2.0, 2.0],
            errors_m: Vec::new(),
        };
        ArmCalibration {
            robot: catalogue::find("ur5e").expect("it is in the catalogue").clone(),
            links: Vec::new(),
            deviations: Vec::new(),
            link_m: 3e-4,
            max_link_m: 4e-4,
            remaining_step: None,
            parameters: Vec::new(),
            zeros: Vec::new(),
            values: Vec::new(),
            covariance: Default::default(),
            dof: 1000.0,
            streams: vec![stream],
            distances_m: Vec::new(),
            undetermined: Vec::new(),
            calibrated_uncertainty: residual(expected_m),
            nominal_uncertainty: residual(1e-3),
        }
    }

    #[test]
    fn a_calibration_no_better_than_the_nominal_model_is_refused() {
        let good = calibration_with(1e-5, [1e-3, 2e-5], [1e-3, 2e-5]);
        assert_eq!(rejection_reason(&good, &[]), None);
        // The nominal model already fits to within the noise.
        assert_eq!(
            rejection_reason(&calibration_with(1e-5, [1.8e-5, 1.7e-5], [1.8e-5, 1.9e-5]), &[]),
            None
        );
        for (bad, why) in [
            (calibration_with(7e-4, [1e-3, 2e-5], [1e-3, 2e-5]), "0.700 mm rms calibrated"),
            (calibration_with(f64::NAN, [1e-3, 2e-5], [1e-3, 2e-5]), "rms calibrated"),
            (calibration_with(1e-5, [1e-3, 2e-5], [1e-3, 9.5e-4]), "cross-validated residual"),
            (calibration_with(1e-5, [1e-3, 2e-3], [1e-3, 2e-5]), "exceeds the nominal residual"),
        ] {
            let refused = rejection_reason(&bad, &[]).unwrap_or_default();
            assert!(refused.contains(why), "{refused}");
        }
    }

    #[test]
    fn an_arm_equals_its_model_if_nothing_deviates_beyond_the_uncertainty() {
        let with_held_out = |values: &[f64], std_error: f64, held_out: [f64; 2]| {
            let variances = vec![std_error * std_error; values.len()];
            equals_nominal(&ArmCalibration {
                values: values.to_vec(),
                covariance: nalgebra::DMatrix::from_diagonal(&variances.into()),
                ..calibration_with(1e-5, [1e-5, 1e-5], held_out)
            })
        };
        let with =
            |values: &[f64], std_error: f64| with_held_out(values, std_error, [2e-5, 2.1e-5]);
        assert!(with(&[1e-5, -2e-5, 3e-5, 0.0], 1e-5));
        assert!(!with(&[1e-5, -2e-5, 1e-4, 0.0], 1e-5));
        // Insignificant one by one, but not together.
        assert!(!with_held_out(&[1e-5, -2e-5, 3e-5, 0.0], 1e-5, [1e-3, 2e-5]));
        // A log without noise.
        assert!(with(&[1e-9, -2e-9], 1e-12));
    }

    #[test]
    fn an_arm_that_equals_its_model_is_accepted_if_usual_deviations_are_excluded() {
        let refused = |max_link_m: f64, held_out: [f64; 2]| {
            let equal = calibration_with(7e-4, [1e-9, 2e-9], held_out);
            rejection_reason(&ArmCalibration { max_link_m, ..equal }, &[]).is_some()
        };
        assert!(!refused(2e-5, [1e-9, 2e-9]));
        assert!(refused(4e-4, [1e-9, 2e-9]), "too few poses");
        assert!(refused(2e-5, [1e-3, 2e-5]), "it deviates");
    }

    #[test]
    fn an_arm_that_equals_its_model_need_not_predict_held_out_poses_better() {
        let equal = calibration_with(7e-4, [1.45e-4, 1.43e-4], [1.736e-4, 1.740e-4]);
        let few_rows = ArmCalibration { max_link_m: 2.6e-5, ..equal };
        assert!(stream_rejection_reason(&few_rows.streams[0]).is_some());
        assert_eq!(rejection_reason(&few_rows, &[]), None);
    }

    #[test]
    fn links_of_another_arm_are_implausible() {
        let with = |value: f64, is_rotation: bool, link_m: f64| {
            implausible_links(&ArmCalibration {
                links: vec!["forearm_link".to_owned()],
                parameters: vec![LinkParameter {
                    link: 0,
                    is_rotation,
                    direction: [1.0, 0.0, 0.0],
                }],
                values: vec![value],
                covariance: nalgebra::DMatrix::from_element(1, 1, 1e-6),
                link_m,
                ..calibration_with(1e-5, [1e-3, 2e-5], [1e-3, 2e-5])
            })
        };
        let reason = with(-0.07, false, 5e-3).unwrap_or_default();
        assert!(reason.starts_with("forearm_link would be 70.0 mm from its place"), "{reason}");
        // An arm whose elbow is off by 2°, and a length that may be below the limit.
        assert_eq!(with(0.035, true, 7e-3), None);
        assert_eq!(with(0.011, false, 7e-3), None);
        let at_bound = with(0.0, false, 11.53e-3).unwrap_or_default();
        assert!(at_bound.contains("11.5 mm and 1.2° per axis or more"), "{at_bound}");
    }

    #[test]
    fn a_stream_without_improvement_over_the_nominal_model_is_reported() {
        let gains = |left: [f64; 2], unseen: [f64; 2]| {
            stream_rejection_reason(&calibration_with(1e-5, left, unseen).streams[0]).is_none()
        };
        assert!(gains([1e-3, 2e-5], [1e-3, 2e-5]));
        assert!(!gains([1e-3, 2e-3], [1e-3, 2e-5]));
        assert!(!gains([1e-3, 2e-5], [1e-3, 9.5e-4]));
    }

    #[test]
    fn a_point_moved_if_its_rows_leave_more_than_others_or_one_jump_explains_them() {
        assert!(!is_point_moved(2.5e-3, 0.5e-3, || false));
        assert!(is_point_moved(3.5e-3, 0.5e-3, || false));
        assert!(!is_point_moved(3.5e-3, 1e-3, || false), "less than four times the median");
        assert!(is_point_moved(0.6e-3, 0.1e-3, || true));
        assert!(!is_point_moved(0.4e-3, 0.05e-3, || true), "too small for a jump");
        assert!(is_point_moved(4e-3, 4e-3, || false), "all files are bad");
    }

    #[test]
    fn joints_with_little_motion_are_listed() {
        let calibration_with = calibration_with(7e-4, [1e-3, 2e-5], [1e-3, 2e-5]);
        let joints = ["a", "b", "c", "d", "e", "f"].map(str::to_owned);
        let unmoved = unmoved_joints(&calibration_with.robot, &joints, &calibration_with);
        assert_eq!(unmoved.iter().map(|one| one.joint.as_str()).collect::<Vec<_>>(), ["d"]);
        assert!(
            rejection_reason(&calibration_with, &unmoved)
                .is_some_and(|why| why.contains("d moved too little"))
        );
    }
}
