//! Aligned poses as TUM trajectories (`timestamp tx ty tz qx qy qz qw`), for evo and similar tools.

use std::collections::HashSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::{decimal_seconds, write_file};
use crate::Audited;
use crate::diagnosis::AlignedSamples;
use crate::geometry::{Pose, xyz_of, xyzw_from_rotation};
use crate::places::PathRegistry;
use crate::report::Trouble;
use crate::time::Stamp;

const OPTION: &str = "--tum";

/// Registers `folder`.
pub fn register_outputs(folder: &Path, places: &mut PathRegistry) {
    places.add_outputs_in(OPTION, folder, []);
}

impl Audited {
    /// Writes two files for each pose stream into `folder`, creating it: its poses with all findings corrected, and
    /// the poses of the reference (another stream, or forward kinematics) at the same times.
    ///
    /// # Errors
    /// If a file cannot be written or would replace an input file.
    pub fn write_tum(&self, folder: &Path) -> Result<(), Trouble> {
        let mut names = HashSet::new();
        let mut files: Vec<(PathBuf, String)> = Vec::new();
        for stream in self.evidence.robots.iter().flat_map(|arm| arm.poses_and_tf()) {
            let name = unique_name(stream.topic(), &mut names);
            let AlignedSamples { t_s, corrected, fk_at_truth, .. } = &stream.diagnosis.aligned;
            for (poses, suffix) in [(corrected, ""), (fk_at_truth, "-reference")] {
                let text = trajectory(t_s, poses, self.run.origin);
                files.push((folder.join(format!("{name}{suffix}.tum")), text));
            }
        }
        self.read.check_with(|places| {
            files.iter().for_each(|(path, _)| places.add_output(OPTION, path));
        })?;
        let remedy = "set --tum to a writable folder";
        files.iter().try_for_each(|(path, text)| write_file(path, text, remedy))
    }
}

/// Stamps in s with nine decimals.
fn trajectory(t_s: &[f64], poses: &[Pose], origin: Stamp) -> String {
    let mut text = "# timestamp tx ty tz qx qy qz qw\n".to_owned();
    for (t_s, pose) in t_s.iter().zip(poses) {
        text.push_str(&decimal_seconds(origin.shifted(*t_s)));
        for number in xyz_of(pose).into_iter().chain(xyzw_from_rotation(&pose.rotation)) {
            let _ = write!(text, " {number:.9}");
        }
        text.push('\n');
    }
    text
}

/// File name from a topic.
fn unique_name(topic: &str, names: &mut HashSet<String>) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || matches!(letter, '-' | '.' | '_');
    let plain: String = topic
        .trim_start_matches('/')
        .chars()
        .map(|letter| if is_plain(letter) { letter } else { '_' })
        .collect();
    let numbered = (2..).map(|number| format!("{plain}-{number}"));
    let mut candidates = std::iter::once(plain.clone()).chain(numbered);
    let name = candidates.find(|name| !names.contains(name)).unwrap_or(plain);
    names.insert(name.clone());
    name
}
