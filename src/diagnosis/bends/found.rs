//! What is said of a joint that gives: play, sag, an eccentric gear.

use super::gravity::{Gravity, Postures};
use crate::AmountChange;
use ground::stats::Measured;
use ground::stream::JointTrack;
use std::sync::Arc;

/// What gears and links of a healthy arm have, rad: an arm of which no joint gives more does not give.
pub(super) const USUAL_RAD: f64 = 2.1e-3;

/// A joint whose link is not where its encoder says, by more in one posture or direction than in another:
/// `q_true = q_reported + bend`.
#[derive(Clone, Debug)]
pub struct JointBend {
    /// The joint's column.
    pub column: usize,
    /// How much, rad: the full play, negative where the link goes before its encoder; the largest sag
    /// over the run; the amplitude of the eccentricity.
    pub amount: Measured,
    /// How it goes.
    pub shape: BendShape,
    /// Its amount before and after a moment from which on it is another, as that of sag under another load,
    /// rad; the joint states' clock.
    pub change: Option<AmountChange>,
}

/// How the bend of a joint goes with its motion.
#[derive(Clone, Debug)]
pub enum BendShape {
    /// The link hangs back by half the play (hysteresis).
    Play(Crossing),
    /// It goes with the torque of gravity.
    Sag(Sag),
    /// It goes as `sin(order · q + phase)`.
    Eccentric {
        /// How often it comes again in a turn of the joint.
        order: u32,
        /// Where it begins, rad.
        phase_rad: f64,
    },
}

/// How a joint that turns back crosses its play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crossing {
    /// The link stays where it is until its encoder has moved by the play: it is held by friction.
    Gradual,
    /// The link goes from one end of the play to the other as soon as the joint turns back: it is
    /// pushed, as by another gear or a load.
    Sudden,
}

impl Crossing {
    /// How far the link of a joint with so much play is from its encoder, in plays from −½ to ½, at each of
    /// `rows` positions of the encoder, from the middle on.
    pub(super) fn behind(self, rows: usize, q: impl Fn(usize) -> f64, play_rad: f64) -> Vec<f64> {
        match self {
            Self::Gradual => play(rows, q, play_rad.abs()),
            Self::Sudden => ways(rows, q).into_iter().map(|way| -0.5 * way).collect(),
        }
    }
}

/// A joint that yields to the torque of gravity.
#[derive(Clone, Debug)]
pub struct Sag {
    pub(super) gravity: Arc<Gravity>,
    /// The torque under which it sags by the whole amount, in the unit that `gravity` has.
    pub(super) most_torque: f64,
}

impl JointBend {
    /// Whether it is play.
    pub fn is_play(&self) -> bool {
        matches!(self.shape, BendShape::Play(_))
    }

    /// Whether it is sag.
    pub fn is_sag(&self) -> bool {
        matches!(self.shape, BendShape::Sag(_))
    }

    /// Whether it is an eccentricity of more than gears and encoders usually have.
    pub fn is_eccentric(&self) -> bool {
        matches!(self.shape, BendShape::Eccentric { .. }) && self.amount.value > USUAL_RAD
    }
}

/// Adds to the positions of all joints what `bends` say of them, rad, and to the velocities how fast that
/// changes. All are reckoned on the positions as they come.
pub(crate) fn bend(joints: &mut JointTrack, bends: &[JointBend]) {
    let dof = joints.dof.max(1);
    let reported = joints.q.clone();
    let (mut torques, mut buffer) = (vec![0.0; dof], Postures::default());
    for JointBend { column, amount, shape, change } in bends {
        let (column, amount) = (*column, amount.value);
        let amount_at = |t_s: f64| match change {
            Some(change) if t_s < change.at_s => change.from,
            Some(change) => change.to,
            None => amount,
        };
        let q = |row: usize| reported[row * dof + column];
        match shape {
            BendShape::Play(crossing) => {
                let behind = crossing.behind(joints.len(), q, amount);
                for (row, behind) in behind.into_iter().enumerate() {
                    let at = row * dof + column;
                    joints.q[at] += behind * amount;
                    // In the middle of the play the link stands still.
                    if behind.abs() < 0.499 && amount > 0.0 && *crossing == Crossing::Gradual {
                        joints.qd[at] = 0.0;
                    }
                }
            }
            BendShape::Sag(Sag { gravity, most_torque }) => {
                for (row, positions) in reported.chunks_exact(dof).enumerate() {
                    gravity.torques(positions, &mut buffer, &mut torques);
                    let amount = amount_at(joints.t_s[row]);
                    joints.q[row * dof + column] += amount * torques[column] / most_torque;
                }
            }
            BendShape::Eccentric { order, phase_rad } => {
                let order = f64::from(*order);
                for row in 0..joints.len() {
                    let at = row * dof + column;
                    let (sin, cos) = (order * q(row) + phase_rad).sin_cos();
                    joints.q[at] += amount * sin;
                    joints.qd[at] *= 1.0 + amount * order * cos;
                }
            }
        }
    }
}

/// The way in which a joint moved last, 1 or −1, at each of `rows` positions; 0 before it moves.
pub(crate) fn ways(rows: usize, q: impl Fn(usize) -> f64) -> Vec<f64> {
    /// What a joint turns back by at least, beyond the noise of an encoder, rad.
    const LEAST_RAD: f64 = 3e-4;
    let (mut way, mut farthest) = (0.0, None);
    (0..rows)
        .map(|row| {
            let farthest = farthest.get_or_insert_with(|| q(row));
            let moved = q(row) - *farthest;
            if way * moved > 0.0 || moved.abs() > LEAST_RAD {
                (way, *farthest) = (moved.signum(), q(row));
            }
            way
        })
        .collect()
}

/// The play operator of hysteresis.
fn play(rows: usize, q: impl Fn(usize) -> f64, play: f64) -> Vec<f64> {
    let mut behind = 0.0;
    let width = play.max(f64::MIN_POSITIVE);
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
    fn a_link_with_play_follows_its_encoder_only_beyond_it() {
        let q = [0.0, 0.1, 0.2, 0.3, 0.25, 0.2, 0.1, 0.0];
        let behind = play(q.len(), |row| q[row], 0.1);
        let link: Vec<f64> = q.iter().zip(&behind).map(|(q, behind)| q + 0.1 * behind).collect();
        let expected = [0.0, 0.05, 0.15, 0.25, 0.25, 0.25, 0.15, 0.05];
        for (link, expected) in link.iter().zip(expected) {
            assert!((link - expected).abs() < 1e-12, "{link} {expected}");
        }
    }
}
