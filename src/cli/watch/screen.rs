//! Where it is drawn what an audit found.

use std::path::PathBuf;

use poseaudit::Audited;
use poseaudit::output::replay::Recording;
use poseaudit::report::Trouble;

use super::super::output;
use super::super::view::LiveViewer;

/// Where.
pub enum Screen {
    Nowhere,
    File(Recording),
    Viewer(LiveViewer),
}

impl Screen {
    /// A file, or the viewer that listens at a port.
    pub fn of(file: Option<PathBuf>, port: Option<u16>) -> Result<Self, Trouble> {
        let viewer = port.map(|port| LiveViewer::at("--rrd-connect", port)).transpose()?;
        let file = file.map(Recording::from).map(Self::File);
        Ok(viewer.map(Self::Viewer).or(file).unwrap_or(Self::Nowhere))
    }

    /// Draws it. A viewer that was closed is said once, and ends no watch.
    pub fn draw(&mut self, audited: &mut Audited) -> Result<(), Trouble> {
        match self {
            Self::Nowhere => Ok(()),
            Self::File(recording) => audited.record(recording),
            Self::Viewer(viewer) => {
                audited.record(&Recording::from(viewer.next().to_owned()))?;
                if let Err(trouble) = viewer.show() {
                    output::warning(&trouble);
                    *self = Self::Nowhere;
                }
                Ok(())
            }
        }
    }
}
