//! Calibration files.

mod json;
mod text;

use std::path::Path;

use super::write_folder;
use crate::audit::CalibrationResult;
use crate::places::PathRegistry;
use crate::report::Trouble;
use crate::robot::{Calibration, Robot, catalogue};

const OPTION: &str = "--out";

/// Model with the deviations.
const MODEL_FILE: &str = "robot.urdf";
/// File for `--calibration`.
const NUMBERS_FILE: &str = "calibration.json";
/// Format of `ur_calibration`.
const UR_FILE: &str = "calibration.yaml";
/// Format of `--robot`.
const DH_FILE: &str = "dh.toml";

/// Registers the files that may be written into `folder`.
pub fn register_outputs(folder: &Path, places: &mut PathRegistry) {
    places.add_outputs_in(
        OPTION,
        folder,
        [MODEL_FILE, NUMBERS_FILE, UR_FILE, DH_FILE].map(str::to_owned),
    );
}

impl CalibrationResult {
    /// Writes the calibration into `folder`, creating it, and returns the file names. Each file is replaced
    /// as a whole. Writes nothing if the logs do not support a calibration, or, unless `always`, if the arm
    /// equals its model.
    ///
    /// # Errors
    /// If a file cannot be written or would replace an input file.
    pub fn write(&self, folder: &Path, always: bool) -> Result<Vec<&'static str>, Trouble> {
        if self.rejection.is_some() || (self.equals_nominal && !always) {
            return Ok(Vec::new());
        }
        self.read.check_with(|places| register_outputs(folder, places))?;
        let files = self.files();
        write_folder(OPTION, folder, &files)?;
        Ok(files.into_iter().map(|(name, _)| name).collect())
    }

    fn files(&self) -> Vec<(&'static str, String)> {
        let mut files =
            vec![(MODEL_FILE, self.urdf()), (NUMBERS_FILE, format!("{:#}\n", self.json(true)))];
        files.extend(self.ur_yaml().map(|text| (UR_FILE, text)));
        files.extend(self.dh_table().map(|text| (DH_FILE, text)));
        files
    }

    /// The patched model, or a URDF of the kinematics only.
    fn urdf(&self) -> String {
        let robot = &self.calibration.robot;
        self.nominal.text_with_origins_of(robot).unwrap_or_else(|_| robot.to_urdf())
    }

    /// Joints with changed origins, in the robot's order.
    fn changed_joints(&self) -> impl Iterator<Item = &crate::robot::Joint> {
        let before = self.nominal.joints().iter();
        let both = self.calibration.robot.joints().iter().zip(before);
        both.filter(|(after, before)| after.parent_from_joint != before.parent_from_joint)
            .map(|(after, _)| after)
    }

    /// Only for a UR whose model has the frames of `ur_description`: the numbers refer to them.
    fn ur_yaml(&self) -> Option<String> {
        let prefix = self.joints.first()?.strip_suffix("shoulder_pan_joint")?;
        let text = self.nominal.ur_calibration(prefix, "")?;
        let own = Calibration::from_text(&text, "").ok()?;
        let parent = self.nominal.joint(self.joints.first()?)?.parent;
        let is_as_described = self.nominal.link_name(parent).ends_with("base_link_inertia")
            && catalogue::entries().any(|ur| ur.calibrated("", &own).is_ok());
        is_as_described.then(|| self.calibration.robot.ur_calibration(prefix, &self.hash()))?
    }

    /// In the format of a UR controller.
    fn hash(&self) -> String {
        let numbers = self.calibration.robot.joints().iter().flat_map(|joint| {
            let origin = joint.parent_from_joint;
            let [x, y, z] = crate::geometry::xyz_of(&origin);
            let [i, j, k, w] = crate::geometry::xyzw_from_rotation(&origin.rotation);
            [x, y, z, i, j, k, w].map(f64::to_le_bytes)
        });
        let mut hasher = blake3::Hasher::new();
        numbers.for_each(|bytes| {
            hasher.update(&bytes);
        });
        let bytes = hasher.finalize();
        let head: [u8; 8] = std::array::from_fn(|at| bytes.as_bytes()[at]);
        format!("poseaudit_{}", u64::from_le_bytes(head))
    }

    /// DH table, if the model is one.
    fn dh_table(&self) -> Option<String> {
        let convention = self.nominal.dh.as_ref()?.convention;
        let link = |name: &String| self.nominal.link(name);
        let stream = self.streams.first()?;
        let (base, tip) = (link(&stream.base)?, link(&stream.tip)?);
        Robot::to_dh(&self.calibration.robot, base, tip, convention)
    }
}
