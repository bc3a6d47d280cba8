//! The one place where a number meets a figure.

use crate::diagnosis::{FrameEstimate, Length, Measured, Unseen};
use crate::finding::{Fault, Outcome, Severity, Unit, rounded};

/// Confidence of the interval that must exclude zero before a rule fails.
const FAIL_CONFIDENCE: f64 = 0.999;

/// Confidence of the interval that must be narrow before a rule passes, and that reports show.
const PASS_CONFIDENCE: f64 = 0.95;

/// One degree, in rad.
pub const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// The amounts from which a rule speaks up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// Their unit, in SI.
    pub unit: Unit,
    /// A warning from here.
    pub warning: f64,
    /// An error from here.
    pub error: f64,
}

impl Figure {
    /// The severity of an amount of this size, `None` below the first figure.
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

/// What the decision rule makes of an amount.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// At or beyond the figure, and surely not zero.
    Fail(Severity),
    /// Below the figure, and known well enough to say so.
    Pass,
    /// Neither; how well it is known against what is needed.
    Undecided(String),
}

/// Decides on one amount in a run of `subjects` subjects (Bonferroni's correction).
///
/// Fails where |value| reaches the figure and the interval at 99.9 % excludes zero; passes where it
/// does not reach it and the half-width of the 95 % interval is within the figure. The noise floor
/// holds before either.
pub fn decide(measured: &Measured, figure: &Figure, subjects: usize) -> Decision {
    let size = measured.value.abs();
    let confidence = 1.0 - (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    let half = figure.unit.half_width(measured, PASS_CONFIDENCE);
    match figure.severity(size) {
        Some(severity) if size > figure.unit.half_width(measured, confidence) => {
            Decision::Fail(severity)
        }
        None if size.is_finite() && half <= figure.warning => Decision::Pass,
        _ => Decision::Undecided(unsettled(measured, figure)),
    }
}

/// Decides on the length of a vector: it fails where the vector's components together are surely not
/// zero and the length's 95 % interval agrees.
pub fn decide_length(length: &Length, figure: &Figure, subjects: usize) -> Decision {
    let norm = &length.norm;
    let chance = (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    let is_sure =
        length.p_value <= chance && norm.value > figure.unit.half_width(norm, PASS_CONFIDENCE);
    match figure.severity(norm.value) {
        Some(severity) if is_sure => Decision::Fail(severity),
        Some(_) => Decision::Undecided(unsettled(norm, figure)),
        None => decide(norm, figure, subjects),
    }
}

impl Decision {
    /// The outcome of a rule that this decides: its fault where it fails, and what would settle it
    /// where it is open.
    pub fn into_outcome(self, settle: &str, fault: impl FnOnce(Severity) -> Fault) -> Outcome {
        match self {
            Decision::Pass => Outcome::sound(),
            Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {settle}")),
            Decision::Fail(severity) => Outcome::faulty(fault(severity)),
        }
    }
}

/// Decides on a frame error: one of its two norms reaches its figure and the six numbers together
/// are surely not zero, or both are below and known well enough.
pub fn decide_frame(frame: &FrameEstimate, figures: &FrameFigures, subjects: usize) -> Decision {
    let (length, angle) = (&frame.translation_m, &frame.rotation_rad);
    let by_length = figures.length.severity(length.value);
    let severity = by_length.max(figures.angle.severity(angle.value));
    let chance = (1.0 - FAIL_CONFIDENCE) / subjects.max(1) as f64;
    match severity {
        Some(severity) if frame.p_value <= chance => Decision::Fail(severity),
        Some(_) => Decision::Undecided("it may as well be zero".to_owned()),
        None => decide_both(length, angle, figures, subjects),
    }
}

/// The figures of a rule on frames: any one of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameFigures {
    /// For the translation.
    pub length: Figure,
    /// For the rotation.
    pub angle: Figure,
}

/// Decides on a length and an angle that must both be in order.
pub fn decide_both(
    length: &Measured,
    angle: &Measured,
    figures: &FrameFigures,
    subjects: usize,
) -> Decision {
    let by_length = decide(length, &figures.length, subjects);
    match (by_length, decide(angle, &figures.angle, subjects)) {
        (Decision::Fail(a), Decision::Fail(b)) => Decision::Fail(a.max(b)),
        (fail @ Decision::Fail(_), _) | (_, fail @ Decision::Fail(_)) => fail,
        (undecided @ Decision::Undecided(_), _) | (_, undecided) => undecided,
    }
}

fn unsettled(measured: &Measured, figure: &Figure) -> String {
    let unit = figure.unit;
    let half = unit.half_width(measured, PASS_CONFIDENCE);
    if !half.is_finite() || !measured.value.is_finite() {
        return format!("it is not bounded, and ±{} is needed", unit.show(figure.warning));
    }
    if half > figure.warning {
        let (half, needed) = (unit.show(half), unit.show(figure.warning));
        return format!("it is known to ±{half} only, and ±{needed} is needed");
    }
    format!("{} cannot be told from zero for sure", unit.show_measured(measured))
}

/// The outcome where there is no estimate. `settle` names the motion or topic that would tell.
pub fn unseen(unseen: &Unseen, settle: &str) -> Outcome {
    let why = match unseen {
        Unseen::TooFewSamples { have, need } => {
            format!("only {have} samples overlap the joint states, {need} are needed")
        }
        Unseen::NoOverlap => "it shares no time with the joint states".to_owned(),
        Unseen::AtRest => "the arm hardly moves".to_owned(),
        Unseen::NeverRests => "the arm never rests".to_owned(),
        Unseen::Periodic(lags) => {
            let lags: Vec<String> = lags.iter().map(|&lag| Unit::Second.show(lag)).collect();
            format!("the motion repeats itself, so that several lags fit ({})", lags.join(", "))
        }
        Unseen::DoesNotFollow(peak) => {
            format!("it does not follow the arm (correlation {} at best)", rounded(*peak, 2))
        }
        Unseen::LittleRotation(span) => {
            format!("its orientation spans {} only", Unit::Radian.show(*span))
        }
        Unseen::NotExcited => "this motion does not show it".to_owned(),
        Unseen::NoOrientation => return Outcome::Skipped("it carries no orientation".to_owned()),
        Unseen::OrientationNotSet => {
            return Outcome::Inconclusive(
                "its orientation was never set: it stays as it is while the arm turns; fill it where \
                 the pose is written"
                    .to_owned(),
            );
        }
        Unseen::NoFrame => {
            return Outcome::Skipped("the log has no frame of the IMU on the arm".to_owned());
        }
        Unseen::NominalKinematics => {
            return Outcome::Inconclusive(
                "the model is a drawing held against a calibrated arm, and causes this small cannot \
                 be told from that; use the arm's own calibration"
                    .to_owned(),
            );
        }
        Unseen::RestsOn(what) => format!("it rests on {what}, which this log does not tell"),
    };
    Outcome::Inconclusive(format!("{why}; {settle}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIGURE: Figure = Figure { unit: Unit::Second, warning: 2e-3, error: 1e-2 };

    fn measured(value: f64, std_error: f64) -> Measured {
        Measured { value, std_error, dof: 1e3 }
    }

    #[test]
    fn an_amount_beyond_the_figure_fails_only_where_it_is_surely_not_zero() {
        assert_eq!(decide(&measured(-0.022, 1e-4), &FIGURE, 1), Decision::Fail(Severity::Error));
        assert_eq!(decide(&measured(0.002, 1e-4), &FIGURE, 1), Decision::Fail(Severity::Warning));
        assert!(matches!(decide(&measured(0.022, 1e-2), &FIGURE, 1), Decision::Undecided(_)));
    }

    #[test]
    fn more_subjects_ask_for_more_certainty() {
        let borderline = measured(3.5e-3, 1e-3);
        assert!(matches!(decide(&borderline, &FIGURE, 1), Decision::Fail(_)));
        assert!(matches!(decide(&borderline, &FIGURE, 20), Decision::Undecided(_)));
    }

    #[test]
    fn what_is_not_known_well_enough_never_passes() {
        assert_eq!(decide(&measured(1e-3, 5e-4), &FIGURE, 1), Decision::Pass);
        for vague in [measured(0.0, 2e-3), measured(0.0, f64::INFINITY), measured(f64::NAN, 0.0)] {
            assert!(matches!(decide(&vague, &FIGURE, 1), Decision::Undecided(_)), "{vague:?}");
        }
    }

    #[test]
    fn a_length_needs_its_vector_to_be_surely_there() {
        let length =
            |value, std_error, p_value| Length { norm: measured(value, std_error), p_value };
        let decide = |length| decide_length(&length, &FIGURE, 1);
        assert_eq!(decide(length(0.022, 8e-3, 1e-5)), Decision::Fail(Severity::Error));
        assert!(matches!(decide(length(0.022, 8e-3, 1e-2)), Decision::Undecided(_)));
        assert!(matches!(decide(length(0.022, 2e-2, 1e-5)), Decision::Undecided(_)));
        assert_eq!(decide(length(1e-3, 5e-4, 1e-9)), Decision::Pass);
        assert!(matches!(decide(length(f64::NAN, 1e-3, f64::NAN)), Decision::Undecided(_)));
    }

    #[test]
    fn an_interval_of_no_width_is_that_of_the_noise_floor() {
        let fine = Figure { unit: Unit::Metre, warning: 1e-7, error: 1.0 };
        assert!(matches!(decide(&measured(5e-7, 0.0), &fine, 1), Decision::Undecided(_)));
    }
}
