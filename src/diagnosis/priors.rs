//! Prior sizes and prices of causes. Log ratios are twice the natural logarithm of a likelihood ratio.

/// Price of a cause with one parameter: `ln n` of the Bayesian information criterion plus 8, which lowers the
/// probability of a false cause from about 1 % to about 0.01 %.
pub(crate) fn price(independent: f64) -> f64 {
    price_of_cause(1, independent)
}

/// The same with this number of parameters.
pub(crate) fn price_of_cause(parameters: usize, independent: f64) -> f64 {
    parameters as f64 * independent.max(2.0).ln() + 8.0
}

/// Prior on a link frame's deviation, per axis, as in UR's factory calibrations.
pub(crate) const LINK_PRIOR_M: f64 = 0.5e-3;
pub(crate) const LINK_PRIOR_RAD: f64 = 0.7e-3;
/// Angular to linear link deviations: 0.1° per mm.
pub(crate) const RAD_PER_M: f64 = 1.745;
/// Lever at which an angle counts as a length where both are combined. Assumed, not calibrated.
pub(crate) const LEVER_M: f64 = 0.3;
/// Typical link deviations at the tip. Smaller residuals distinguish no diagnoses.
pub(crate) const MODEL_ERROR_M: f64 = 1e-4;
pub(crate) const MODEL_ERROR_RAD: f64 = RAD_PER_M * MODEL_ERROR_M;
/// Prior on the flange deviation of a calibrated arm. Healthy UR5e of two public data sets deviate by 0.1
/// to 1.6 mm (docs/real-logs.md).
pub(crate) const FLANGE_PRIOR_M: f64 = 1e-3;
/// Prior on frames and times that are free without a cause; m, rad or s.
pub(crate) const FREE_PRIOR: f64 = 0.1;
/// Prior on a frame that is wrong: 20 mm and 2°.
pub(crate) const FRAME_PRIOR_M: f64 = 0.02;
/// Prior on the length of an unknown tool: grippers are 0.1 to 0.3 m long; a TCP beyond 0.5 m is rare.
pub(crate) const TOOL_PRIOR_M: f64 = 0.2;
/// Prior on the distance of an unknown marker or tool from the tip. It bounds unobservable directions.
pub(crate) const MARKER_PRIOR_M: f64 = 0.5;
/// Prior on a joint zero that is wrong, rad or m.
pub(crate) const ZERO_PRIOR: f64 = 0.02;
/// Priors on a radial scale error that is present or absent.
pub(crate) const RADIAL_SCALE_PRIOR: f64 = 0.01;
pub(crate) const ABSENT_RADIAL_SCALE_PRIOR: f64 = 1e-9;

/// Priors on a jump or heading error of an IMU's yaw, a slip of its mount, a step of a gyro's bias (0.3 °/s is common, 3 °/s
/// occurs), and its scale error.
pub(crate) const YAW_PRIOR_RAD: f64 = 0.3;
pub(crate) const MOUNT_PRIOR_RAD: f64 = 1.0;
pub(crate) const BIAS_PRIOR_RAD_S: f64 = 0.05;
pub(crate) const GYRO_SCALE_PRIOR: f64 = 0.05;

/// Log ratio of a joint zero beside link deviations (a likelihood ratio of about fifty).
pub(crate) const MIN_LOG_RATIO_OF_ZERO: f64 = 8.0;
/// Log ratio of sag in the place of a joint zero, which is the more common fault.
pub(crate) const MIN_LOG_RATIO_OF_SAG: f64 = 16.0;
/// Causes within this log ratio of the selected one are its confounders (a likelihood ratio of twenty).
pub(crate) const MAX_LOG_RATIO_OF_CONFOUNDER: f64 = 6.0;
