//! Applies the caller's calibrations, or those in the log.

use crate::robot::Calibration;

use super::declaration::CalibrationSource;
use super::error::RunError;
use super::model::{LogModel, ModelClues};

/// A calibration, and its arm's joint name prefix.
pub(super) struct GivenCalibration {
    pub(super) calibration: Calibration,
    pub(super) prefix: Option<String>,
}

/// # Errors
/// If a file is not a calibration.
pub(super) fn given(sources: &[CalibrationSource]) -> Result<Vec<GivenCalibration>, RunError> {
    let read = |source: &CalibrationSource| {
        let calibration = Calibration::from_file(&source.file).map_err(RunError::Calibration)?;
        Ok(GivenCalibration { calibration, prefix: source.prefix.clone() })
    };
    sources.iter().map(read).collect()
}

/// Applies the caller's calibrations; without any, those in the log.
///
/// # Errors
/// If one of the caller's matches no arm, or several. One in the log is then skipped with a remark.
pub(super) fn overlay_all(
    models: &mut [LogModel],
    given: &[GivenCalibration],
    clues: &ModelClues<'_>,
) -> Result<(), RunError> {
    for GivenCalibration { calibration, prefix } in given {
        overlay(models, calibration, prefix.as_deref())?;
    }
    if !given.is_empty() {
        return Ok(());
    }
    for (place, text) in clues.calibrations {
        let read = Calibration::from_text(text, place).map_err(RunError::Calibration);
        if let Err(error) = read.and_then(|calibration| overlay(models, &calibration, None)) {
            for model in models.iter_mut() {
                model.identified_by +=
                    &format!("; a calibration in the log was skipped: {}", error.what());
            }
        }
    }
    Ok(())
}

/// Applies `calibration` to the only arm with its joints and `prefix`.
fn overlay(
    models: &mut [LogModel],
    calibration: &Calibration,
    prefix: Option<&str>,
) -> Result<(), RunError> {
    let urs = models.iter().enumerate().flat_map(|(model, of)| {
        of.robot.prefixes_of(calibration).into_iter().map(move |prefix| (model, prefix))
    });
    let meant = |(_, of): &(usize, String)| prefix.is_none_or(|prefix| of.starts_with(prefix));
    let urs: Vec<(usize, String)> = urs.filter(meant).collect();
    let [(model, prefix)] = urs.as_slice() else {
        return Err(RunError::CalibrationOf {
            source: calibration.source.clone(),
            prefixes: urs.into_iter().map(|(_, prefix)| prefix).collect(),
        });
    };
    let model = &mut models[*model];
    model.robot = model.robot.calibrated(prefix, calibration).map_err(RunError::Calibration)?;
    model.identified_by += &format!(", with the calibration {}", calibration.label());
    Ok(())
}
