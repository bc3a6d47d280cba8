//! Compares estimates with thresholds; no other module does.

use crate::diagnosis::{FrameEstimate, Measured, MeasuredLength, NotObservable};
use crate::finding::{Fault, Outcome, Severity, Unit, rounded};

/// The interval at this level must exclude zero for a rule to fail.
const FAIL_CONFIDENCE: f64 = 0.999;

/// The interval at this level is reported, and must be narrow for a rule to pass.
pub(in crate::checks) const PASS_CONFIDENCE: f64 = 0.95;

pub const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Smallest values that are a warning and an error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Threshold {
    /// SI unit.
    pub unit: Unit,
    /// Warning threshold.
    pub warning: f64,
    /// Error threshold.
    pub error: f64,
}

impl Threshold {
    /// `None` below the warning threshold.
    pub fn severity(&self, size: f64) -> Option<Severity> {
        if size >= self.error {
            Some(Severity::Error)
        } else if size >= self.warning {
            Some(Severity::Warning)
        } else {
            None
        }
    }
}

/// Decision on an estimate.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// Reaches the threshold and is significant.
    Fail(Severity),
    /// Below the threshold, with a narrow interval.
    Pass,
    /// Neither: actual and required uncertainty.
    Undecided(String),
}

/// Decides on an estimate, with Bonferroni correction for `subjects`.
///
/// Fails if |value| reaches the threshold and the 99.9 % interval excludes zero. Passes if |value| is below
/// the threshold and the half-width of the 95 % interval is at most the threshold. Intervals are at least
/// as wide as the unit's noise floor.
pub fn decide(measured: &Measured, threshold: &Threshold, subjects: usize) -> Decision {
    let size = measured.value.abs();
    let confidence = 1.0 - (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    let half = threshold.unit.half_width(measured, PASS_CONFIDENCE);
    match threshold.severity(size) {
        Some(severity) if size > threshold.unit.half_width(measured, confidence) => {
            Decision::Fail(severity)
        }
        None if size.is_finite() && half <= threshold.warning => Decision::Pass,
        _ => Decision::Undecided(undecided_reason(measured, threshold)),
    }
}

/// Fails if the components are jointly significant and the 95 % interval of the length excludes zero.
pub fn decide_length(length: &MeasuredLength, threshold: &Threshold, subjects: usize) -> Decision {
    let norm = &length.norm;
    let chance = (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    let is_significant =
        length.p_value <= chance && norm.value > threshold.unit.half_width(norm, PASS_CONFIDENCE);
    match threshold.severity(norm.value) {
        Some(severity) if is_significant => Decision::Fail(severity),
        Some(_) => Decision::Undecided(undecided_reason(norm, threshold)),
        None => decide(norm, threshold, subjects),
    }
}

impl Decision {
    /// Decision on two amounts; both must pass.
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Decision::Fail(a), Decision::Fail(b)) => Decision::Fail(a.max(b)),
            (fail @ Decision::Fail(_), _) | (_, fail @ Decision::Fail(_)) => fail,
            (undecided @ Decision::Undecided(_), _) | (_, undecided) => undecided,
        }
    }

    /// `settle` names the motion or topic that would resolve an undecided case.
    pub fn into_outcome(self, settle: &str, fault: impl FnOnce(Severity) -> Fault) -> Outcome {
        match self {
            Decision::Pass => Outcome::pass(),
            Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {settle}")),
            Decision::Fail(severity) => Outcome::fail(fault(severity)),
        }
    }
}

/// Decides on a frame error. Fails if a norm reaches its threshold, its 95 % interval excludes zero, and the six components
/// are jointly significant.
pub fn decide_frame(
    frame: &FrameEstimate,
    thresholds: &FrameThresholds,
    subjects: usize,
) -> Decision {
    let (length, angle) = (&frame.translation_m, &frame.rotation_rad);
    let norms = [(length, &thresholds.length), (angle, &thresholds.angle)];
    let is_beyond = norms.iter().any(|(norm, threshold)| threshold.severity(norm.value).is_some());
    let significant = norms
        .iter()
        .filter(|(norm, threshold)| norm.value > threshold.unit.half_width(norm, PASS_CONFIDENCE));
    let severity = significant.filter_map(|(norm, threshold)| threshold.severity(norm.value)).max();
    let chance = (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    match severity {
        Some(severity) if frame.p_value <= chance => Decision::Fail(severity),
        _ if is_beyond => Decision::Undecided("not significantly different from zero".to_owned()),
        _ => decide_both(length, angle, thresholds, subjects),
    }
}

/// Thresholds of a rule on frames; reaching one is a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameThresholds {
    /// Translation threshold.
    pub length: Threshold,
    /// Rotation threshold.
    pub angle: Threshold,
}

/// Decides on a length and an angle; both must pass.
pub fn decide_both(
    length: &Measured,
    angle: &Measured,
    thresholds: &FrameThresholds,
    subjects: usize,
) -> Decision {
    decide(length, &thresholds.length, subjects).and(decide(angle, &thresholds.angle, subjects))
}

fn undecided_reason(measured: &Measured, threshold: &Threshold) -> String {
    let unit = threshold.unit;
    let half = unit.half_width(measured, PASS_CONFIDENCE);
    if !half.is_finite() || !measured.value.is_finite() {
        return format!("uncertainty not bounded, limit ±{}", unit.show(threshold.warning));
    }
    too_uncertain(measured, threshold).unwrap_or_else(|| {
        format!("{} is not significantly different from zero", unit.show_measured(measured))
    })
}

/// Why the interval is too wide for a pass; `None` if it is narrow enough.
pub fn too_uncertain(measured: &Measured, threshold: &Threshold) -> Option<String> {
    let unit = threshold.unit;
    let half = unit.half_width(measured, PASS_CONFIDENCE);
    (half > threshold.warning).then(|| {
        let (half, needed) = (unit.show(half), unit.show(threshold.warning));
        format!("uncertainty ±{half} exceeds the limit of ±{needed}")
    })
}

/// Begins the reason of a check that another one must resolve first.
pub const BLOCKED: &str = "blocked: ";

/// Outcome without an estimate. `settle` names the motion or topic that would make it observable.
pub fn not_observable(why: &NotObservable, settle: &str) -> Outcome {
    let why = match why {
        NotObservable::TooFewSamples { have, need } => {
            format!("only {have} samples overlap the joint states, {need} are needed")
        }
        NotObservable::NoOverlap => {
            "its times do not overlap with those of the stream that it is compared with".to_owned()
        }
        NotObservable::AtRest => "the arm barely moves".to_owned(),
        NotObservable::NeverRests => "the arm never rests".to_owned(),
        NotObservable::Periodic(lags) => {
            const MAX_SHOWN: usize = 4;
            let mut shown: Vec<String> =
                lags.iter().take(MAX_SHOWN).map(|&lag| Unit::Second.show(lag)).collect();
            if lags.len() > MAX_SHOWN {
                shown.push(format!("{} more", lags.len() - MAX_SHOWN));
            }
            format!("the motion is periodic, so several lags fit ({})", shown.join(", "))
        }
        NotObservable::DoesNotFollow(peak) => {
            format!("does not follow the arm (peak correlation {})", rounded(*peak, 2))
        }
        NotObservable::LittleRotation(span) => {
            format!("its orientation spans only {}", Unit::Radian.show(*span))
        }
        NotObservable::NotExcited => "not observable in this motion".to_owned(),
        NotObservable::NoGyro => return Outcome::Skipped("it has no angular velocity".to_owned()),
        NotObservable::NoOrientation => {
            return Outcome::Skipped("it has no orientation".to_owned());
        }
        NotObservable::OrientationNotSet => {
            return Outcome::Inconclusive(
                "its orientation was never set: it stays constant while the arm turns; set it where the pose \
                 is written"
                    .to_owned(),
            );
        }
        NotObservable::NoGravity => {
            return Outcome::Inconclusive(format!(
                "{BLOCKED}its accelerations contain no gravity; publish the specific force, which is 9.81 m/s² \
                 at rest (REP 145)"
            ));
        }
        NotObservable::NoFrame => {
            return Outcome::Skipped("no transform from the arm to the IMU in the log".to_owned());
        }
        NotObservable::NominalKinematics => {
            return Outcome::Inconclusive(
                "nominal model against a calibrated arm: causes this small are within manufacturing \
                 tolerance; use the arm's own calibration"
                    .to_owned(),
            );
        }
        NotObservable::RestsOn(what) => {
            format!("{BLOCKED}{what} must be known first, and this log does not determine it")
        }
    };
    Outcome::Inconclusive(format!("{why}; {settle}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const THRESHOLD: Threshold = Threshold { unit: Unit::Second, warning: 2e-3, error: 1e-2 };

    fn measured(value: f64, std_error: f64) -> Measured {
        Measured { value, std_error, dof: 1e3 }
    }

    #[test]
    fn a_size_above_the_threshold_fails_only_if_significant() {
        assert_eq!(decide(&measured(-0.022, 1e-4), &THRESHOLD, 1), Decision::Fail(Severity::Error));
        assert_eq!(
            decide(&measured(0.002, 1e-4), &THRESHOLD, 1),
            Decision::Fail(Severity::Warning)
        );
        assert!(matches!(decide(&measured(0.022, 1e-2), &THRESHOLD, 1), Decision::Undecided(_)));
    }

    #[test]
    fn more_subjects_require_more_confidence() {
        let borderline = measured(3.5e-3, 1e-3);
        assert!(matches!(decide(&borderline, &THRESHOLD, 1), Decision::Fail(_)));
        assert!(matches!(decide(&borderline, &THRESHOLD, 20), Decision::Undecided(_)));
    }

    #[test]
    fn a_wide_interval_never_passes() {
        assert_eq!(decide(&measured(1e-3, 5e-4), &THRESHOLD, 1), Decision::Pass);
        for vague in [measured(0.0, 2e-3), measured(0.0, f64::INFINITY), measured(f64::NAN, 0.0)] {
            assert!(matches!(decide(&vague, &THRESHOLD, 1), Decision::Undecided(_)), "{vague:?}");
        }
    }

    #[test]
    fn a_length_fails_only_if_its_vector_is_significant() {
        let length = |value, std_error, p_value| MeasuredLength {
            norm: measured(value, std_error),
            p_value,
        };
        let decide = |length| decide_length(&length, &THRESHOLD, 1);
        assert_eq!(decide(length(0.022, 8e-3, 1e-5)), Decision::Fail(Severity::Error));
        assert!(matches!(decide(length(0.022, 8e-3, 1e-2)), Decision::Undecided(_)));
        assert!(matches!(decide(length(0.022, 2e-2, 1e-5)), Decision::Undecided(_)));
        assert_eq!(decide(length(1e-3, 5e-4, 1e-9)), Decision::Pass);
        assert!(matches!(decide(length(f64::NAN, 1e-3, f64::NAN)), Decision::Undecided(_)));
    }

    #[test]
    fn a_zero_interval_is_widened_to_the_noise_floor() {
        let fine = Threshold { unit: Unit::Metre, warning: 1e-7, error: 1.0 };
        assert!(matches!(decide(&measured(5e-7, 0.0), &fine, 1), Decision::Undecided(_)));
    }
}
