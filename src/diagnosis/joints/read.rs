//! Joint states decoded with one encoding.

use super::super::sampling::still_speeds;
use super::found::{JointCoupling, JointEncoding, JointUnit, is_coded};
use super::{corrected, moved};
use ground::stream::JointTrack;

/// Decoded joint states.
pub(in super::super) struct Read {
    /// Joint track with corrected names and units.
    pub track: JointTrack,
    /// The same track with large zeros added, if there are any.
    near: Option<JointTrack>,
    /// Zeros added to `near`, per joint of the track, followed by a zero for each of `gained`.
    pub offsets: Vec<f64>,
    /// Gains to estimate: scaled joints (paired with themselves) and coupled joints (paired with the
    /// driving joint).
    pub gained: Vec<(usize, usize)>,
    /// Couplings with approximate factors, already applied to `track`.
    pub couplings: Vec<JointCoupling>,
    /// Approximate scale of each joint of the track.
    pub factors: Vec<f64>,
    /// Maximum speed at rest of each joint of the track.
    pub still: Vec<f64>,
}

impl Read {
    pub fn by(joints: &JointTrack, reading: &JointEncoding, prismatic: &[bool]) -> Self {
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

    /// For a stream computed from the joint states: corrects names and units only.
    pub fn for_derived(self) -> Self {
        let offsets = vec![0.0; self.track.dof];
        Self { near: None, offsets, gained: Vec::new(), ..self }
    }

    /// Whether a joint's values are not angles or lengths and their encoding has a zero.
    pub fn has_zero_of_code(&self, joint: usize) -> bool {
        self.gained.contains(&(joint, joint))
            && is_coded(self.factors[joint])
            && self.offsets[joint] != 0.0
    }

    /// Joint states with approximate zeros corrected.
    pub fn near(&self) -> &JointTrack {
        self.near.as_ref().unwrap_or(&self.track)
    }
}
