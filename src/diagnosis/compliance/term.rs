//! Terms of the compliance model.

use super::shapes::BacklashCrossing;

const MIN_STD_ERRORS: f64 = 4.0;
pub(super) const MAX_COMPLIANCE_RAD: f64 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ComplianceKind {
    Backlash(BacklashCrossing),
    Sag,
    /// Changes at this time, s (load change).
    LoadedSag(f64),
    Eccentric(u32),
    Delay,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ComplianceTerm {
    pub column: usize,
    pub kind: ComplianceKind,
    /// Eccentricity: sine and cosine. Sag with a load change: before and after.
    pub amount: [f64; 2],
    pub std_error: f64,
    pub dof: f64,
}

impl ComplianceTerm {
    pub fn new(column: usize, kind: ComplianceKind) -> Self {
        Self { column, kind, amount: [0.0; 2], std_error: 0.0, dof: 3.0 }
    }

    pub fn width(&self) -> usize {
        match self.kind {
            ComplianceKind::Backlash(_) | ComplianceKind::Sag | ComplianceKind::Delay => 1,
            ComplianceKind::LoadedSag(_) | ComplianceKind::Eccentric(_) => 2,
        }
    }

    /// Size in rad, signed except for eccentricity.
    pub fn size(&self) -> f64 {
        let [first, second] = self.amount;
        match self.kind {
            ComplianceKind::Eccentric(_) => first.hypot(second),
            _ if second.abs() > first.abs() => second,
            _ => first,
        }
    }

    pub fn is_significant(&self) -> bool {
        let size = self.size();
        let is_signed = matches!(self.kind, ComplianceKind::Backlash(_) | ComplianceKind::Delay);
        let is_plausible = size > 0.0 || is_signed;
        is_plausible
            && size.abs() > MIN_STD_ERRORS * self.std_error
            && size.abs() < MAX_COMPLIANCE_RAD
    }
}
