//! Files that correct the findings.

use std::path::Path;

use super::write_folder;
use crate::audit::Audited;
use crate::corrections::{CorrectionPlan, FIX_FILES, model_files};
use crate::places::PathRegistry;
use crate::report::Trouble;
use crate::run::RobotSource;

const OPTION: &str = "--fix";

/// Registers the files that may be written into `folder`, including patched copies of robot files.
pub fn register_outputs(folder: &Path, robots: &[RobotSource], places: &mut PathRegistry) {
    let patched = robots.iter().filter_map(RobotSource::file).flat_map(model_files);
    let names = FIX_FILES.iter().map(|&name| name.to_owned()).chain(patched);
    places.add_outputs_in(OPTION, folder, names);
}

impl Audited {
    /// Writes the files that correct the findings into `folder`, creating it. Each file is replaced as a
    /// whole.
    ///
    /// # Errors
    /// If a file cannot be written or would replace an input file; then nothing is written.
    pub fn write_fixes(&self, folder: &Path) -> Result<(), Trouble> {
        let Self { report, run, evidence, segment, .. } = self;
        let files = CorrectionPlan::from_findings(report, run, evidence, *segment).files();
        // A model in the log has no file name before the log is read.
        let names = files.iter().map(|(name, _)| name.clone());
        self.read.check_with(|places| places.add_outputs_in(OPTION, folder, names))?;
        write_folder(OPTION, folder, &files)
    }
}
