//! Error on one half of the run in the constant frames fitted to the other half.

use crate::frames::constant_frames::{fit_frames, misfit_in_frames};
use crate::samples::sampling::rows_of_half;
use crate::selection::held_out::HeldOutResidual;
use crate::{AlignedSamples, PoseDiagnosis};
use ground::geometry::Pose;

/// Per half.
const MAX_SAMPLES: usize = 120;

impl PoseDiagnosis {
    /// Residuals as logged and as decoded. An encoding has no amount to fit.
    pub fn held_out_encoding(&self) -> Option<HeldOutResidual> {
        let AlignedSamples { logged, fk, corrected, fk_at_truth, .. } = &self.aligned;
        let without = held_out_misfit(fk, logged)?;
        let with = held_out_misfit(fk_at_truth, corrected)?;
        Some(HeldOutResidual { without, with })
    }
}

/// Rms m and rad. `None` for too few samples.
fn held_out_misfit(fk: &[Pose], poses: &[Pose]) -> Option<[f64; 2]> {
    let half = |half: usize, of: &[Pose]| -> Vec<Pose> {
        rows_of_half(of.len(), half, MAX_SAMPLES).into_iter().map(|row| of[row]).collect()
    };
    let [first, second] = [0, 1].map(|which| (half(which, fk), half(which, poses)));
    if first.0.len().min(second.0.len()) < 3 {
        return None;
    }
    let squares = [(&first, &second), (&second, &first)].map(|(fitted, held_out)| {
        let frames = fit_frames(&fitted.0, &fitted.1);
        misfit_in_frames(&held_out.0, &held_out.1, &frames).map(|rms| rms * rms)
    });
    Some([0, 1].map(|kind| (0.5 * (squares[0][kind] + squares[1][kind])).sqrt()))
}
