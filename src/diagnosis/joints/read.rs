//! The joint states under one reading.

use super::super::sampling::still_speeds;
use super::found::{JointCoupling, JointReading, JointUnit, is_coded};
use super::{corrected, moved};
use ground::stream::JointTrack;

/// The joint states as they are read.
pub(in super::super) struct Read {
    /// With the names and units that they should have.
    pub track: JointTrack,
    /// The same with the zeros added that are off by much, where some are.
    near: Option<JointTrack>,
    /// Those zeros, by joint of the track, and no gain yet for each of `gained`.
    pub offsets: Vec<f64>,
    /// The joints whose scale is to be found, each with itself, and coupled joints, each with the one
    /// that drives it.
    pub gained: Vec<(usize, usize)>,
    /// Couplings with their approximate factors, which `track` contains already.
    pub couplings: Vec<JointCoupling>,
    /// The joints' scales about, by joint of the track.
    pub factors: Vec<f64>,
    /// Joint speeds that are no motion, by joint of the track.
    pub still: Vec<f64>,
}

impl Read {
    pub fn by(joints: &JointTrack, reading: &JointReading, prismatic: &[bool]) -> Self {
        let track = corrected(joints, reading, prismatic);
        let is_off = reading.zeros.iter().any(|zero| *zero != 0.0);
        let near = is_off.then(|| moved(&track, &reading.zeros));
        let scaled = reading.slips.iter().filter(|slip| slip.unit == JointUnit::Scaled);
        let coupled = reading.couplings.iter().map(|coupling| (coupling.column, coupling.by));
        let gained: Vec<(usize, usize)> =
            scaled.map(|slip| (slip.column, slip.column)).chain(coupled).collect();
        let mut factors = vec![1.0; joints.dof];
        reading.slips.iter().for_each(|slip| factors[slip.column] = slip.factor);
        let mut offsets = reading.zeros.clone();
        offsets.resize(joints.dof, 0.0);
        offsets.resize(joints.dof + gained.len(), 0.0);
        let still = still_speeds(&track);
        Self { track, near, offsets, gained, couplings: reading.couplings.clone(), factors, still }
    }

    /// The same for a stream that is computed from the joints: as they are, but for names and units.
    pub fn for_derived(self) -> Self {
        let offsets = vec![0.0; self.track.dof];
        Self { near: None, offsets, gained: Vec::new(), ..self }
    }

    /// Whether a joint's numbers are of another kind than rad or m and have a zero of their own.
    pub fn has_zero_of_code(&self, joint: usize) -> bool {
        self.gained.contains(&(joint, joint))
            && is_coded(self.factors[joint])
            && self.offsets[joint] != 0.0
    }

    /// The joint states near to the truth.
    pub fn near(&self) -> &JointTrack {
        self.near.as_ref().unwrap_or(&self.track)
    }
}
