//! Units of joint values.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::TWO_TURNS_RAD;
use ground::robot::{Chain, JointKind};

/// Unit of the values of revolute joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JointValueUnit {
    /// Radians.
    Radians,
    /// Degrees.
    Degrees,
    /// Encoder ticks.
    Ticks {
        /// Bits per turn.
        bits: u8,
        /// Whether mid-range is zero.
        centred: bool,
    },
    /// −100 … 100 across the range.
    Shares,
}

impl JointValueUnit {
    /// Maps logged numbers to joint positions.
    pub fn factor_and_offset(self, chain: &Chain, joint: usize) -> (f64, f64) {
        let limits = chain.limits()[joint];
        match (self, limits.lower.zip(limits.upper)) {
            _ if chain.joint_kinds()[joint] == JointKind::Prismatic => (1.0, 0.0),
            (Self::Degrees, _) => (1_f64.to_radians(), 0.0),
            (Self::Ticks { bits, centred }, _) => {
                let turn = f64::from(1_u32 << bits);
                (2.0 * PI / turn, if centred { -PI } else { 0.0 })
            }
            (Self::Shares, Some((low, high))) => ((high - low) / 200.0, 0.5 * (low + high)),
            (Self::Radians | Self::Shares, _) => (1.0, 0.0),
        }
    }

    /// Units for values up to `most`. Shares of the range only for a few candidate arms.
    pub(super) fn compatible_with(most: f64, are_few: bool) -> Vec<Self> {
        const SHARE: f64 = 100.5;
        const BITS: [u8; 5] = [10, 12, 13, 14, 16];
        if most <= TWO_TURNS_RAD {
            return vec![Self::Radians];
        }
        let mut units = vec![Self::Degrees];
        if most <= SHARE && are_few {
            units.push(Self::Shares);
        }
        if most > SHARE {
            let ticks = BITS
                .iter()
                .flat_map(|&bits| [true, false].map(|centred| Self::Ticks { bits, centred }));
            units.extend(ticks);
        }
        units
    }

    /// Name for messages.
    pub fn name(self) -> String {
        match self {
            Self::Radians => "rad".to_owned(),
            Self::Degrees => "degrees".to_owned(),
            Self::Ticks { bits, .. } => format!("ticks of {} a turn", 1_u32 << bits),
            Self::Shares => "-100 to 100 of the range".to_owned(),
        }
    }
}
