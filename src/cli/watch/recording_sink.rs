//! Destination of a watch's recordings.

use std::path::PathBuf;

use poseaudit::Audited;
use poseaudit::output::replay::Recording;
use poseaudit::report::Trouble;

use super::super::output;
use super::super::view::LiveViewer;

pub enum RecordingSink {
    Discarded,
    File(Recording),
    Viewer(LiveViewer),
}

impl RecordingSink {
    pub fn new(file: Option<PathBuf>, port: Option<u16>) -> Result<Self, Trouble> {
        let viewer = port.map(|port| LiveViewer::start("--rrd-connect", port)).transpose()?;
        let file = file.map(Recording::from).map(Self::File);
        Ok(viewer.map(Self::Viewer).or(file).unwrap_or(Self::Discarded))
    }

    /// A closed viewer is reported once and does not end the watch.
    pub fn write(&mut self, audited: &mut Audited) -> Result<(), Trouble> {
        match self {
            Self::Discarded => Ok(()),
            Self::File(recording) => audited.record(recording),
            Self::Viewer(viewer) => {
                audited.record(&Recording::from(viewer.recording().to_owned()))?;
                if let Err(trouble) = viewer.show() {
                    output::warning(&trouble);
                    *self = Self::Discarded;
                }
                Ok(())
            }
        }
    }
}
