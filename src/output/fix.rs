//! Files that correct the findings.

use std::fs;
use std::path::Path;

use crate::audit::Audited;
use crate::corrections::{CorrectionPlan, FIX_FILES, model_files};
use crate::places::PathRegistry;
use crate::report::{Trouble, write_whole};
use crate::run::RobotSource;

/// Registers the files that may be written into `folder`, including patched copies of robot files.
pub fn register_outputs(folder: &Path, robots: &[RobotSource], places: &mut PathRegistry) {
    let patched = robots.iter().filter_map(RobotSource::file).flat_map(model_files);
    let names = FIX_FILES.iter().map(|&name| name.to_owned()).chain(patched);
    places.add_outputs_in("--fix", folder, names);
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
        let mut places = self.read.clone();
        // A model in the log has no file name before the log is read.
        places.add_outputs_in("--fix", folder, files.iter().map(|(name, _)| name.clone()));
        places.check()?;
        let unwritable = |path: &Path, error: std::io::Error| {
            let what = format!("cannot be written: {error}");
            Trouble::unwritable(path, what, "set --fix to a writable folder")
        };
        fs::create_dir_all(folder).map_err(|error| unwritable(folder, error))?;
        files.iter().try_for_each(|(name, text)| {
            let path = folder.join(name);
            write_whole(&path, |staged| fs::write(staged, text))
                .map_err(|error| unwritable(&path, error))
        })
    }
}
