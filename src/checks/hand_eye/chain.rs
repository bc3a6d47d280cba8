//! Shared by the hand-eye rules.

use serde_json::{Map, Value, json};

use crate::checks::decision::{DEGREE, FrameThresholds, Threshold};
use crate::checks::frames::pose_json;
use crate::checks::{Limit, SubjectResult};
use crate::diagnosis::{CameraMount, HandEyeDiagnosis, HandEyeSolution, NotObservable};
use crate::evidence::HandEyeEvidence;
use crate::finding::{Outcome, Unit};
use crate::run::CameraAxes;

/// For the closure residual and the camera mount error.
pub const THRESHOLDS: FrameThresholds = FrameThresholds {
    length: Threshold { unit: Unit::Metre, warning: 2e-3, error: 1e-2 },
    angle: Threshold { unit: Unit::Radian, warning: 0.2 * DEGREE, error: 1.0 * DEGREE },
};

/// Between two hand orientations; a limit of HEC002.
pub const MIN_ROTATION_SPAN: Limit = Limit {
    key: "span",
    unit: Unit::Radian,
    value: 30.0 * DEGREE,
    what: "minimum angle spanned by the hand's rotations",
};
pub const MIN_AXIS_SPREAD: Limit = Limit {
    key: "spread",
    unit: Unit::Radian,
    value: 10.0 * DEGREE,
    what: "minimum angle between the hand's rotation axes",
};

pub const SETTLE: &str =
    "rotate the hand by more than 30° about two or more axes while the camera sees the target";

/// The target does not follow the hand if the residual exceeds this fraction of the hand's rotation.
const MAX_RESIDUAL_RATIO: f64 = 0.5;
/// Minimum ratio of the two mounts' residuals that determines the mount.
const MIN_MOUNT_RATIO: f64 = 1.5;

pub fn describe_mount(mount: CameraMount) -> &'static str {
    match mount {
        CameraMount::InHand => "in the hand",
        CameraMount::InBase => "fixed to the base",
    }
}

impl CameraAxes {
    /// Axis convention, for messages.
    pub fn describe(self) -> &'static str {
        match self {
            CameraAxes::Optical => "z forward, x right",
            CameraAxes::Body => "x forward, z up",
        }
    }
}

pub fn is_mount_decided(solution: &HandEyeSolution) -> bool {
    solution.ratio >= MIN_MOUNT_RATIO
}

/// Reason why the residual does not apply to the chain: the target's rotation does not follow the hand's.
pub fn mismatch_reason(found: &HandEyeDiagnosis) -> Option<String> {
    let turning_rad = found.diversity.as_ref().map_or(0.0, |diversity| diversity.turning_rad);
    let residual_rad = found.best()?.closure.rms_rad;
    (residual_rad > MAX_RESIDUAL_RATIO * turning_rad).then(|| {
        format!(
            "target rotation does not match the hand's (residual {} of {}): the target moves, its rotations \
             are misread, or neither target nor camera is on this hand; {SETTLE}",
            Unit::Radian.show(residual_rad),
            Unit::Radian.show(turning_rad),
        )
    })
}

pub fn not_observable(why: &NotObservable) -> Outcome {
    Outcome::Inconclusive(match why {
        NotObservable::TooFewSamples { have, need } => {
            format!("only {have} target poses overlap with hand poses; {need} are needed")
        }
        NotObservable::NoOverlap => "target and hand poses do not overlap in time".to_owned(),
        _ => format!("the hand does not rotate while the target is visible; {SETTLE}"),
    })
}

pub fn with_solution(
    judged: SubjectResult,
    evidence: &HandEyeEvidence,
    solution: &HandEyeSolution,
) -> SubjectResult {
    let mut all = Map::new();
    let closure = &solution.closure;
    let mount = match (is_mount_decided(solution), solution.mount) {
        (false, _) => "undecided",
        (true, CameraMount::InHand) => "camera in hand",
        (true, CameraMount::InBase) => "camera fixed",
    };
    let camera = &solution.camera;
    let half_widths = |errors: [f64; 3]| -> Vec<Option<f64>> {
        let half = |error: f64| {
            let measured = crate::diagnosis::Measured { std_error: error, ..camera.distance_m };
            Some(measured.half_width(0.95)).filter(|half| half.is_finite())
        };
        errors.map(half).to_vec()
    };
    let equivalent = match solution.mount {
        CameraMount::InHand => "camera fixed, target poses inverted (parent and child swapped)",
        CameraMount::InBase => "camera in hand, target poses inverted (parent and child swapped)",
    };
    let ratio = Some(solution.ratio).filter(|ratio| ratio.is_finite());
    let offset = &solution.offset_s;
    all.insert("hand".to_owned(), evidence.hand.clone().into());
    all.insert("mount".to_owned(), mount.into());
    all.insert("mount_ratio".to_owned(), json!(ratio));
    if evidence.logged.is_none() {
        all.insert("equivalent".to_owned(), equivalent.into());
    }
    all.insert(
        "time_offset_s".to_owned(),
        json!({ "value": offset.value, "ci95": Unit::Second.interval95(offset) }),
    );
    let pose_in = match solution.mount {
        CameraMount::InHand => &evidence.hand,
        CameraMount::InBase => &evidence.base,
    };
    all.insert("pose_in".to_owned(), pose_in.clone().into());
    all.insert("pose".to_owned(), pose_json(&camera.pose));
    all.insert("pose_half_width_m".to_owned(), json!(half_widths(camera.translation_error_m)));
    all.insert("pose_half_width_rad".to_owned(), json!(half_widths(camera.rotation_error_rad)));
    all.insert("target_pose".to_owned(), pose_json(&solution.target));
    all.insert("poses".to_owned(), closure.poses.into());
    all.insert("outliers".to_owned(), closure.outliers.into());
    all.insert("rms_m".to_owned(), closure.rms_m.into());
    all.insert("rms_rad".to_owned(), closure.rms_rad.into());
    all.insert("median_m".to_owned(), closure.median_m.into());
    all.insert("median_rad".to_owned(), closure.median_rad.into());
    all.insert("each".to_owned(), closure_samples(solution));
    all.into_iter().fold(judged, |judged, (key, value)| judged.with_evidence(&key, value))
}

/// Residuals at evenly spaced poses.
fn closure_samples(solution: &HandEyeSolution) -> Value {
    const MAX_LISTED_SAMPLES: usize = 200;
    let all = &solution.closure.each;
    let step = all.len().div_ceil(MAX_LISTED_SAMPLES).max(1);
    let sampled = || all.iter().step_by(step);
    let micro = |value: f64| (value * 1e6).round() / 1e6;
    json!({
        "t_s": sampled().map(|one| micro(one.0)).collect::<Vec<f64>>(),
        "m": sampled().map(|one| micro(one.1)).collect::<Vec<f64>>(),
        "rad": sampled().map(|one| micro(one.2)).collect::<Vec<f64>>(),
    })
}
