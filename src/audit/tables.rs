//! The tables of an audited run.

use std::path::Path;

use super::reached;
use crate::checks::Facts;
use crate::report::{Report, Trouble};
use crate::run::Run;
use crate::tables::{
    TABLE_FILES, TableError, aligned_frames, checks_frame, findings_frame, joints_frame,
    reach_map_frame, reached_poses_frame, write_table,
};

/// Writes the tables of an audited run into a folder.
pub(crate) fn write_tables(
    folder: &Path,
    run: &Run,
    facts: &Facts,
    report: &Report,
) -> Result<(), Trouble> {
    let remedy = "name a folder that can be written with --parquet";
    let trouble = |what| Trouble::unwritable(folder, what, remedy);
    let streams = facts.robots.iter().flat_map(|arm| {
        let found = arm.poses_and_tf();
        found.map(move |of| (arm.name.as_str(), of.topic(), &of.diagnosis.aligned))
    });
    let arms = reached(run, &report.findings);
    let frames = [
        findings_frame(&report.findings),
        checks_frame(&report.checks),
        joints_frame(&report.workspace),
        aligned_frames(streams, run.origin),
        reach_map_frame(&arms),
        reached_poses_frame(&arms, run.origin),
    ];
    for (name, frame) in TABLE_FILES.into_iter().zip(frames) {
        let mut frame = frame.map_err(|error| trouble(error.to_string()))?;
        write_table(folder, name, &mut frame).map_err(|TableError { path, cause }| Trouble {
            place: path.display().to_string(),
            ..trouble(cause)
        })?;
    }
    Ok(())
}
