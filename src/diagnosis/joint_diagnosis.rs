//! Results for the joints, and joint states corrected by them.

use std::borrow::Cow;

use crate::compliance::apply_compliance;
use crate::joints::{add_zeros, correct_joints};
use crate::{
    EstimateResult, JointChange, JointDiagnosis, JointEncoding, JointOffset, JointParameter,
    JointScale, NotObservable, ScalarChange,
};
use ground::stream::JointTrack;

impl JointDiagnosis {
    /// Diagnosis of joints without changes and compliance.
    pub fn without_changes(
        encoding: EstimateResult<JointEncoding>,
        offsets: Vec<JointOffset>,
        scales: Vec<JointScale>,
    ) -> Self {
        Self {
            encoding,
            partial_encoding: None,
            offsets,
            scales,
            changes: Vec::new(),
            patches: Vec::new(),
            compliance: Vec::new(),
        }
    }

    /// Number of zeros in the model.
    pub(crate) fn chosen_zeros(&self) -> usize {
        self.offsets.iter().filter(|offset| offset.is_chosen).count()
    }

    /// Changes of a joint's zero.
    pub fn zero_changes(&self, column: usize) -> Vec<&ScalarChange> {
        self.changes_of(column, JointParameter::Zero)
    }

    /// Encoding to report; the wrong one, if it is wrong in a part of the run only.
    pub fn reported_encoding(&self) -> Result<&JointEncoding, &NotObservable> {
        match &self.partial_encoding {
            Some((encoding, _)) => Ok(encoding),
            None => self.encoding.as_ref(),
        }
    }

    /// Changes of a joint's scale.
    pub fn factor_changes(&self, column: usize) -> Vec<&ScalarChange> {
        self.changes_of(column, JointParameter::Factor)
    }

    fn changes_of(&self, column: usize, parameter: JointParameter) -> Vec<&ScalarChange> {
        let is_own = |it: &&JointChange| it.column == column && it.parameter == parameter;
        self.changes.iter().filter(is_own).map(|it| &it.change).collect()
    }

    /// Removes eccentricity above the usual level, which no rule reports.
    pub fn without_eccentricity(&self) -> Self {
        let mut reported = self.clone();
        reported.compliance.retain(|compliance| !compliance.is_eccentric());
        reported
    }

    /// Joint states in one encoding throughout the run.
    pub fn in_one_encoding<'a>(&self, joints: &'a JointTrack) -> Cow<'a, JointTrack> {
        match self.partial_encoding {
            Some(_) => self.patched(joints),
            None => Cow::Borrowed(joints),
        }
    }

    fn patched<'a>(&self, joints: &'a JointTrack) -> Cow<'a, JointTrack> {
        let mut patched = Cow::Borrowed(joints);
        self.patches.iter().for_each(|patch| patch.apply(patched.to_mut()));
        patched
    }

    /// Corrects change points, names and units, compliance, and the selected model's joint offsets.
    /// `prismatic` flags columns of `joints`.
    pub fn corrected_joints(&self, joints: &JointTrack, prismatic: &[bool]) -> JointTrack {
        let unchanged = self.patched(joints);
        let mut track = match &self.encoding {
            Ok(encoding) => correct_joints(&unchanged, encoding, prismatic),
            Err(_) => unchanged.into_owned(),
        };
        if !self.compliance.is_empty() {
            apply_compliance(&mut track, &self.compliance);
        }
        let mut offsets: Vec<f64> = self.offsets.iter().map(JointOffset::chosen).collect();
        for scale in self.scales.iter().filter(|scale| scale.is_coded()) {
            offsets[scale.column] = scale.offset;
        }
        add_zeros(&mut track, &offsets);
        track
    }
}
