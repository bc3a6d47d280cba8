//! Joint compliance: backlash, sag, eccentricity or late positions of one joint.

use super::gravity::GravityTorques;
use crate::{Course, ScalarChange};
use ground::stats::Measured;
use ground::stream::JointTrack;
use std::sync::Arc;

/// Healthy gears and links have it; smaller values are not reported.
pub(super) const USUAL_COMPLIANCE_RAD: f64 = 2.1e-3;

/// Largest credible size.
pub(super) const MAX_COMPLIANCE_RAD: f64 = 0.1;
/// Relative, of sag, due to the assumed link masses.
pub(super) const MASS_STD_ERROR: f64 = 0.07;

/// Deviation of a link from its encoder: `q_true = q_reported + bend`.
#[derive(Clone, Debug)]
pub struct JointCompliance {
    /// Joint's column.
    pub column: usize,
    /// Profile over the motion.
    pub shape: ComplianceShape,
    /// In rad: full backlash (negative if the link leads its encoder), largest sag over the run, before and after a load
    /// change, eccentricity's sine and cosine, or error of late positions at the highest speed.
    pub amounts: [f64; 2],
    /// Of the amounts, without that of the link masses.
    pub std_error: f64,
    /// Degrees of freedom of the amounts.
    pub dof: f64,
}

/// Profile of a joint's compliance.
#[derive(Clone, Debug)]
pub enum ComplianceShape {
    /// The link lags by half (hysteresis).
    Backlash(BacklashCrossing),
    /// Proportional to the gravity torque.
    Sag(JointSag),
    /// Sine and cosine of the angle times this number of cycles per turn.
    Eccentric(u32),
    /// Proportional to the joint's speed: its positions are late.
    Delay {
        /// Highest over the run, rad/s.
        max_speed: f64,
    },
}

/// Crossing after a reversal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BacklashCrossing {
    /// Friction holds the link until the backlash is crossed.
    Gradual,
    /// The link jumps at the reversal, pushed by a gear or load.
    Sudden,
}

impl BacklashCrossing {
    /// Link relative to encoder, from −½ to ½ of the backlash, per row. Starts in the middle.
    pub(super) fn link_offsets(
        self,
        rows: usize,
        q: impl Fn(usize) -> f64,
        backlash_rad: f64,
    ) -> Vec<f64> {
        match self {
            Self::Gradual => backlash_operator(rows, q, backlash_rad.abs()),
            Self::Sudden => {
                motion_directions(rows, q).into_iter().map(|direction| -0.5 * direction).collect()
            }
        }
    }
}

/// Sag under gravity torque.
#[derive(Clone, Debug)]
pub struct JointSag {
    pub(super) gravity: Arc<GravityTorques>,
    /// Torque of the full sag, in the unit of `gravity`.
    pub(super) max_torque: f64,
    /// Time of a load change on the joint states' clock, and half-width of its interval, s.
    pub(super) load_change_s: Option<(f64, f64)>,
}

impl JointSag {
    /// Index of the amount at this time.
    pub(super) fn amount_at(&self, t_s: f64) -> usize {
        usize::from(self.load_change_s.is_some_and(|(at_s, _)| t_s >= at_s))
    }
}

impl JointCompliance {
    /// Without an amount.
    pub(super) fn new(column: usize, shape: ComplianceShape) -> Self {
        Self { column, shape, amounts: [0.0; 2], std_error: 0.0, dof: 3.0 }
    }

    /// Number of amounts.
    pub(super) fn width(&self) -> usize {
        match &self.shape {
            ComplianceShape::Eccentric(_) => 2,
            ComplianceShape::Sag(sag) if sag.load_change_s.is_some() => 2,
            _ => 1,
        }
    }

    /// Number of fitted parameters.
    pub(crate) fn parameters(&self) -> usize {
        self.width() + usize::from(self.change().is_some())
    }

    /// Signed except for eccentricity, rad.
    pub(super) fn size(&self) -> f64 {
        let [first, second] = self.amounts;
        match self.shape {
            ComplianceShape::Eccentric(_) => first.hypot(second),
            _ if second.abs() > first.abs() => second,
            _ => first,
        }
    }

    /// Size in rad: full backlash (negative if the link leads its encoder), largest sag over the run, eccentricity's
    /// amplitude, or error of late positions at the highest speed.
    pub fn value(&self) -> Measured {
        self.measured(self.size())
    }

    /// Change, rad, such as sag after a load change. Times are on the joint states' clock.
    pub fn change(&self) -> Option<ScalarChange> {
        let ComplianceShape::Sag(JointSag { load_change_s: Some(change_s), .. }) = self.shape
        else {
            return None;
        };
        let ((at_s, within_s), [from, to]) = (change_s, self.amounts);
        let Measured { value, std_error, dof } = self.measured(to - from);
        let size = Measured { value, std_error: std::f64::consts::SQRT_2 * std_error, dof };
        Some(ScalarChange { at_s, within_s, course: Course::Step, from, to, size })
    }

    fn measured(&self, value: f64) -> Measured {
        let by_masses = if self.is_sag() { MASS_STD_ERROR * value } else { 0.0 };
        Measured { value, std_error: self.std_error.hypot(by_masses), dof: self.dof }
    }

    pub(super) fn is_significant(&self) -> bool {
        const MIN_STD_ERRORS: f64 = 4.0;
        let size = self.size();
        let is_signed = self.is_backlash() || self.delay_s().is_some();
        (size > 0.0 || is_signed)
            && size.abs() > MIN_STD_ERRORS * self.std_error
            && size.abs() < MAX_COMPLIANCE_RAD
    }

    /// Whether this is backlash.
    pub fn is_backlash(&self) -> bool {
        matches!(self.shape, ComplianceShape::Backlash(_))
    }

    /// Whether this is sag.
    pub fn is_sag(&self) -> bool {
        matches!(self.shape, ComplianceShape::Sag(_))
    }

    /// Latency of the joint's positions relative to the other joints', s.
    pub fn delay_s(&self) -> Option<Measured> {
        match self.shape {
            ComplianceShape::Delay { max_speed } => Some(self.value().scaled(1.0 / max_speed)),
            _ => None,
        }
    }

    /// Above the usual level of gears and encoders.
    pub fn is_eccentric(&self) -> bool {
        matches!(self.shape, ComplianceShape::Eccentric(_)) && self.size() > USUAL_COMPLIANCE_RAD
    }
}

/// Adds `compliances` to positions, rad, and their derivatives to velocities, all from the reported positions.
pub(crate) fn apply_compliance(joints: &mut JointTrack, compliances: &[JointCompliance]) {
    let dof = joints.dof.max(1);
    let reported = joints.q.clone();
    for JointCompliance { column, shape, amounts, .. } in compliances {
        let (column, amount) = (*column, amounts[0]);
        let q = |row: usize| reported[row * dof + column];
        match shape {
            ComplianceShape::Backlash(crossing) => {
                let link_offset = crossing.link_offsets(joints.len(), q, amount);
                for (row, link_offset) in link_offset.into_iter().enumerate() {
                    let at = row * dof + column;
                    joints.q[at] += link_offset * amount;
                    // The link rests while the joint crosses.
                    if link_offset.abs() < 0.499
                        && amount > 0.0
                        && *crossing == BacklashCrossing::Gradual
                    {
                        joints.qd[at] = 0.0;
                    }
                }
            }
            ComplianceShape::Sag(sag) => {
                for (row, positions) in reported.chunks_exact(dof).enumerate() {
                    let torque = sag.gravity.torques(positions)[column];
                    let amount = amounts[sag.amount_at(joints.t_s[row])];
                    joints.q[row * dof + column] += amount * torque / sag.max_torque;
                }
            }
            ComplianceShape::Eccentric(order) => {
                let order = f64::from(*order);
                for row in 0..joints.len() {
                    let at = row * dof + column;
                    let (sin, cos) = (order * q(row)).sin_cos();
                    joints.q[at] += amounts[0] * sin + amounts[1] * cos;
                    joints.qd[at] *= 1.0 + order * (amounts[0] * cos - amounts[1] * sin);
                }
            }
            ComplianceShape::Delay { max_speed } => {
                let delay_s = amount / max_speed;
                let late = joints.clone();
                let mut sequence = late.sequence();
                let mut later = (late.q[column], late.qd[column]);
                for row in 0..joints.len() {
                    let at = row * dof + column;
                    // Beyond the ends, the first or last positions stay.
                    if let Some((q, qd)) = sequence.at(late.t_s[row] + delay_s) {
                        later = (q[column], qd[column]);
                    }
                    (joints.q[at], joints.qd[at]) = later;
                }
            }
        }
    }
}

/// Last motion per row: 1 or −1; 0 before it moves.
pub(crate) fn motion_directions(rows: usize, q: impl Fn(usize) -> f64) -> Vec<f64> {
    /// Above encoder noise.
    const MIN_REVERSAL_RAD: f64 = 3e-4;
    let (mut direction, mut farthest) = (0.0, None);
    (0..rows)
        .map(|row| {
            let farthest = farthest.get_or_insert_with(|| q(row));
            let moved = q(row) - *farthest;
            if direction * moved > 0.0 || moved.abs() > MIN_REVERSAL_RAD {
                (direction, *farthest) = (moved.signum(), q(row));
            }
            direction
        })
        .collect()
}

fn backlash_operator(rows: usize, q: impl Fn(usize) -> f64, backlash_rad: f64) -> Vec<f64> {
    let mut behind = 0.0;
    let width = backlash_rad.max(f64::MIN_POSITIVE);
    (0..rows)
        .map(|row| {
            let moved = if row == 0 { 0.0 } else { q(row) - q(row - 1) };
            behind = f64::clamp(behind - moved / width, -0.5, 0.5);
            behind
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_follows_its_encoder_only_beyond_the_backlash() {
        let q = [0.0, 0.1, 0.2, 0.3, 0.25, 0.2, 0.1, 0.0];
        let behind = backlash_operator(q.len(), |row| q[row], 0.1);
        let link: Vec<f64> = q.iter().zip(&behind).map(|(q, behind)| q + 0.1 * behind).collect();
        let expected = [0.0, 0.05, 0.15, 0.25, 0.25, 0.25, 0.15, 0.05];
        for (link, expected) in link.iter().zip(expected) {
            assert!((link - expected).abs() < 1e-12, "{link} {expected}");
        }
    }
}
