//! How the numbers of joints may be read.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::TWO_TURNS;
use ground::robot::{Chain, JointKind};

/// How the numbers of joints that turn may be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JointNumbers {
    /// As they are.
    Radians,
    /// As degrees.
    Degrees,
    /// As steps of an encoder with so many bits a turn, from 0 or from the middle.
    Ticks {
        /// Bits of the encoder.
        bits: u8,
        /// Whether the middle is zero.
        centred: bool,
    },
    /// As −100 … 100 of the joint's range.
    Shares,
}

impl JointNumbers {
    /// Factor and offset that make a joint's position of its number.
    pub fn read(self, chain: &Chain, joint: usize) -> (f64, f64) {
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

    /// Those that numbers up to `most` may be; shares only of one of a few arms.
    pub(super) fn of_size(most: f64, are_few: bool) -> Vec<Self> {
        const SHARE: f64 = 100.5;
        const BITS: [u8; 5] = [10, 12, 13, 14, 16];
        if most <= TWO_TURNS {
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

    /// What the numbers are, in words.
    pub fn words(self) -> String {
        match self {
            Self::Radians => "rad".to_owned(),
            Self::Degrees => "degrees".to_owned(),
            Self::Ticks { bits, .. } => format!("ticks of {} a turn", 1_u32 << bits),
            Self::Shares => "-100 to 100 of the range".to_owned(),
        }
    }
}
