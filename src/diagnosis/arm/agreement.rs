//! How far a stream agrees with FK.

use crate::encodings::rotation::MAX_RESIDUAL_RAD as MAX_ROTATION_RESIDUAL_RAD;
use crate::joints::ResidualSize;
use crate::model::measurement::{MAX_EXPLAINED_M, MAX_EXPLAINED_RAD};
use crate::priors::LEVER_M;
use crate::selection::nominal_model::{is_calibratable, is_calibratable_frame};
use crate::{NotObservable, PoseDiagnosis};

/// Of rotations that do not follow the arm.
const UNREAD_RAD: f64 = 1.0;

impl PoseDiagnosis {
    /// Excess residual; 1 m and [`UNREAD_RAD`] if not decoded.
    pub(super) fn excess(&self) -> ResidualSize {
        let residual = self.residual.as_ref();
        let (undecoded_m, rad) = match &self.encoding {
            Ok(_) => (0.0, residual.map(|residual| residual.excess_rad.value).ok()),
            Err(NotObservable::DoesNotFollow(_)) => (1.0, Some(UNREAD_RAD)),
            Err(_) => (0.0, None),
        };
        // Positions may be valid although rotations do not follow, e.g. if the last joint's sign is wrong.
        let m = residual.map_or(undecoded_m, |residual| residual.excess_m.value);
        ResidualSize { m, rad }
    }

    /// Excess residual as one length.
    pub(super) fn combined_excess_m(&self) -> f64 {
        self.excess().combined_m(LEVER_M)
    }

    /// Whether causes leave an excess residual, which links may explain.
    pub(super) fn has_excess(&self) -> bool {
        let ResidualSize { m, rad } = self.excess();
        m > MAX_EXPLAINED_M || rad.is_some_and(|rad| rad > MAX_EXPLAINED_RAD)
    }

    /// Whether neither causes nor links explain its excess residual.
    pub(super) fn is_unexplained(&self) -> bool {
        // Links do not explain rotations that do not follow the arm.
        let by_links = self.is_nominal && self.excess().rad != Some(UNREAD_RAD);
        self.has_excess() && !by_links
    }

    /// Whether it agrees with FK without a frame error.
    pub(super) fn agrees_in_frame(&self) -> bool {
        let is_explained = self.residual.as_ref().is_ok_and(|residual| {
            residual.rms_m < MAX_EXPLAINED_M && residual.rms_rad < MAX_EXPLAINED_RAD
        });
        is_explained
            && self.encoding.is_ok()
            && is_calibratable_frame(&self.frame_correction.reference)
    }

    /// Whether it differs from FK by no more than a calibration does, without any correction.
    pub(super) fn is_near_as_logged(&self) -> bool {
        self.encoding.is_ok()
            && self
                .residual
                .as_ref()
                .is_ok_and(|residual| is_calibratable([residual.before_m, residual.before_rad]))
    }

    /// Whether the positions are close to FK's.
    pub(super) fn is_close_to_fk(&self) -> bool {
        /// Of the motion's extent, or m.
        const MAX_RESIDUAL_SHARE: f64 = 0.02;
        const MAX_RESIDUAL_M: f64 = 5e-3;
        let max_m = (MAX_RESIDUAL_SHARE * self.extent_m()).max(MAX_RESIDUAL_M);
        self.residual.as_ref().is_ok_and(|residual| residual.excess_m.value < max_m)
    }

    /// Whether rotations are in another encoding than the logged one.
    pub(crate) fn is_misread(&self) -> bool {
        self.encoding.as_ref().is_ok_and(|encoding| !encoding.best.is_as_logged())
    }

    /// The same, although joints that are off may explain the rotations as logged.
    pub(super) fn may_be_misread(&self) -> bool {
        let encoding = self.encoding.as_ref().ok();
        let as_logged_rad = encoding.and_then(|encoding| encoding.as_logged_rad);
        self.is_misread() && as_logged_rad.is_some_and(|rad| rad < MAX_ROTATION_RESIDUAL_RAD)
    }

    /// Whether the poses are inverse or in other axes.
    pub(super) fn is_otherwise_placed(&self) -> bool {
        self.is_inverted || matches!(self.axes, Ok(Some(_)))
    }
}
