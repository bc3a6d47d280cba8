//! Joint states decoded in an encoding.

use super::encoding::{JointCoupling, JointEncoding, JointUnit, JointUnitError, is_coded};
use crate::samples::sampling::rest_speeds;
use ground::stream::JointTrack;

/// Decoded joint states.
pub(crate) struct CorrectedJoints {
    /// Encoding of the recorded joint states.
    pub encoding: JointEncoding,
    /// Track with corrected names, units and couplings.
    pub track: JointTrack,
    /// Same with large zeros added, if any.
    approximate_track: Option<JointTrack>,
    /// Added to `approximate_track`, per joint, followed by a zero per gain.
    pub offsets: Vec<f64>,
    /// Gains to estimate: joint and driving joint (itself if scaled).
    pub gains: Vec<(usize, usize)>,
    /// Maximum speed at rest per joint.
    pub rest_speeds: Vec<f64>,
    /// Per joint.
    pub is_prismatic: Vec<bool>,
    /// Whether the streams are computed from the joint states, so zeros and frames have no errors.
    pub is_derived: bool,
}

impl CorrectedJoints {
    pub fn new(joints: &JointTrack, encoding: JointEncoding, is_prismatic: Vec<bool>) -> Self {
        let track = correct_joints(joints, &encoding, &is_prismatic);
        let JointEncoding { unit_errors, couplings, zeros, .. } = &encoding;
        let is_off = zeros.iter().any(|zero| *zero != 0.0);
        let scaled = unit_errors.iter().filter(|error| error.unit == JointUnit::Scaled);
        let coupled = couplings.iter().map(|coupling| (coupling.column, coupling.by));
        let gains: Vec<(usize, usize)> =
            scaled.map(|error| (error.column, error.column)).chain(coupled).collect();
        let mut offsets = zeros.clone();
        offsets.resize(joints.dof + gains.len(), 0.0);
        Self {
            approximate_track: is_off.then(|| {
                let mut moved = track.clone();
                add_zeros(&mut moved, zeros);
                moved
            }),
            rest_speeds: rest_speeds(&track),
            encoding,
            track,
            offsets,
            gains,
            is_prismatic,
            is_derived: false,
        }
    }

    /// Corrects only names and units, for a stream computed from the joint states.
    pub fn for_derived(self) -> Self {
        let offsets = vec![0.0; self.track.dof];
        Self { approximate_track: None, offsets, gains: Vec::new(), is_derived: true, ..self }
    }

    /// Whether the values are neither angles nor lengths, with a zero in their encoding.
    pub fn has_encoded_zero(&self, joint: usize) -> bool {
        self.gains.contains(&(joint, joint))
            && is_coded(self.encoding.factor(joint))
            && self.offsets[joint] != 0.0
    }

    /// Track with approximate zeros corrected.
    pub fn approximate_track(&self) -> &JointTrack {
        self.approximate_track.as_ref().unwrap_or(&self.track)
    }
}

/// Names, units and couplings, but not the zeros.
pub(crate) fn correct_joints(
    joints: &JointTrack,
    encoding: &JointEncoding,
    prismatic: &[bool],
) -> JointTrack {
    let mut track = joints.clone();
    if encoding.is_in_degrees {
        track.convert_from_degrees(prismatic);
    }
    let mut named = vec![0.0; joints.dof];
    for values in [&mut track.q, &mut track.qd] {
        for row in values.chunks_exact_mut(joints.dof.max(1)) {
            if let Some(permutation) = &encoding.permutation {
                named.copy_from_slice(row);
                permutation.iter().zip(&named).for_each(|(&really, value)| row[really] = *value);
            }
            for JointUnitError { column, factor, .. } in &encoding.unit_errors {
                row[*column] *= factor;
            }
            for JointCoupling { column, by, factor } in &encoding.couplings {
                row[*column] += factor.value * row[*by];
            }
        }
    }
    track
}

/// Adds a zero to the positions of each joint.
pub(crate) fn add_zeros(track: &mut JointTrack, zeros: &[f64]) {
    for row in track.q.chunks_exact_mut(track.dof.max(1)) {
        row.iter_mut().zip(zeros).for_each(|(q, zero)| *q += zero);
    }
}
