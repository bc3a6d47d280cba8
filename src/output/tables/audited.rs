use std::path::Path;

use super::{
    TableError, aligned_frames, checks_frame, findings_frame, joints_frame, workspace, write_table,
};
use crate::audit::Audited;
use crate::places::PathRegistry;
use crate::report::Trouble;
use crate::report::reached_workspaces;

const TABLE_NAMES: [&str; 6] =
    ["findings", "checks", "joints", "aligned", "reach_map", "reached_poses"];

/// Registers the files in `folder`.
pub fn register_outputs(folder: &Path, places: &mut PathRegistry) {
    places.add_outputs_in("--parquet", folder, TABLE_NAMES.map(|name| format!("{name}.parquet")));
}

impl Audited {
    /// Writes the tables of the run as Parquet into `folder`, creating it. Each file is replaced as a
    /// whole.
    ///
    /// # Errors
    /// If a table cannot be written or would replace an input file.
    pub fn write_tables(&self, folder: &Path) -> Result<(), Trouble> {
        self.read.check_with(|places| register_outputs(folder, places))?;
        let Self { report, run, evidence, .. } = self;
        let remedy = "set --parquet to a writable folder";
        let streams = evidence.robots.iter().flat_map(|arm| {
            let found = arm.poses_and_tf();
            found.map(move |of| (arm.name.as_str(), of.topic(), &of.diagnosis.aligned))
        });
        let arms = reached_workspaces(run, &report.findings);
        let frames = [
            findings_frame(&report.findings),
            checks_frame(&report.checks),
            joints_frame(&report.workspace),
            aligned_frames(streams, run.origin),
            workspace::reach_map_frame(&arms),
            workspace::reached_poses_frame(&arms, run.origin),
        ];
        for (name, frame) in TABLE_NAMES.into_iter().zip(frames) {
            let mut frame =
                frame.map_err(|error| Trouble::call(folder.display(), error, remedy))?;
            write_table(folder, name, &mut frame).map_err(|TableError { path, cause }| {
                Trouble::call(path.display(), cause, remedy)
            })?;
        }
        Ok(())
    }
}
