//! The files that mend what was found.

use std::fs;
use std::path::Path;

use crate::audit::Audited;
use crate::corrections::{FIX_FILES, Mending, model_files};
use crate::places::Places;
use crate::report::{Trouble, write_whole};
use crate::run::RobotSource;

/// Enters the files that may be written into `folder`: of the robots that are files, patched copies.
pub fn enter(folder: &Path, robots: &[RobotSource], places: &mut Places) {
    let patched = robots.iter().filter_map(RobotSource::file).flat_map(model_files);
    let names = FIX_FILES.iter().map(|&name| name.to_owned()).chain(patched);
    places.writes_into("--fix", folder, names);
}

impl Audited {
    /// Writes what mends the findings into `folder`, which is made; each file whole.
    ///
    /// # Errors
    /// Where one cannot be written, or would take the place of a file that was read; of several none is then
    /// written.
    pub fn write_fixes(&self, folder: &Path) -> Result<(), Trouble> {
        let Self { report, run, evidence, segment, .. } = self;
        let files = Mending::of(report, run, evidence, *segment).files();
        let mut places = self.read.clone();
        // What a model is called that the log holds is not known before the log is read.
        places.writes_into("--fix", folder, files.iter().map(|(name, _)| name.clone()));
        places.check()?;
        let unwritable = |path: &Path, error: std::io::Error| {
            let what = format!("cannot be written: {error}");
            Trouble::unwritable(path, what, "name a folder that can be written to with --fix")
        };
        fs::create_dir_all(folder).map_err(|error| unwritable(folder, error))?;
        files.iter().try_for_each(|(name, text)| {
            let path = folder.join(name);
            write_whole(&path, |staged| fs::write(staged, text))
                .map_err(|error| unwritable(&path, error))
        })
    }
}
