//! Catalogue arms that fit the poses of a calibration far better than the named arm.

use super::tables::chain_ends;
use crate::checks::MAX_DEVIATION_M;
use crate::diagnosis::{FitHypotheses, HypothesisFit, PoseStream, fit_model};
use crate::finding::Unit;
use crate::robot::{Chain, JointKind, catalogue};
use crate::run::{MAX_TOOL_M, MIN_RESIDUAL_RATIO, RunOptions};
use crate::stream::{JointTrack, PoseTrack};

/// Positions of the tip, and the joint positions at their times.
pub(super) struct CalibrationPositions<'a> {
    pub joints: &'a JointTrack,
    /// Column per joint, from base to tip.
    pub columns: &'a [usize],
    pub track: &'a PoseTrack,
    /// Maximum latency, s; 0 of rows at rest.
    pub max_lag_s: f64,
}

/// A catalogue arm and its residual with nominal links.
pub(super) struct CompetingArm {
    pub name: String,
    pub residual_m: f64,
    /// Residual of the named arm.
    pub named_residual_m: f64,
}

impl CompetingArm {
    /// A clause that names it.
    pub fn describe(&self, named: &str) -> String {
        let [own, other] = [self.named_residual_m, self.residual_m].map(|it| Unit::Metre.show(it));
        format!(
            "nominal links of {} fit the positions within {other} rms, {named} within {own}",
            self.name
        )
    }

    /// Remedy for the user.
    pub fn remedy(&self) -> String {
        format!("if it is that arm, use --robot {}", self.name)
    }
}

impl CalibrationPositions<'_> {
    /// Catalogue arm with the same kinds of joints that fits best, if a calibration may remove its residual and that of
    /// the arm `named` is much larger. The frame of the positions and the tool are free.
    pub fn competing_arm(&self, named: &str, chain: &Chain) -> Option<CompetingArm> {
        let named_residual_m = self.fit(chain).map_or(f64::INFINITY, |fit| fit.residual_m);
        let options = RunOptions::default();
        let slides = |chain: &Chain| {
            let kinds = chain.joint_kinds().iter();
            kinds.map(|kind| *kind == JointKind::Prismatic).collect::<Vec<bool>>()
        };
        let others = catalogue::entries().filter(|other| other.name != named);
        let fits = others.filter_map(|other| {
            let (base, tip) = chain_ends(other, &options).ok()?;
            let other_chain = other.chain(base, tip).ok()?;
            let is_alike = slides(&other_chain) == slides(chain);
            let fit = is_alike.then(|| self.fit(&other_chain)).flatten()?;
            (fit.tool_m.norm() < MAX_TOOL_M).then(|| (other.name.clone(), fit.residual_m))
        });
        let (name, residual_m) = fits.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let is_better =
            residual_m <= MAX_DEVIATION_M && MIN_RESIDUAL_RATIO * residual_m < named_residual_m;
        is_better.then_some(CompetingArm { name, residual_m, named_residual_m })
    }

    fn fit(&self, chain: &Chain) -> Option<HypothesisFit> {
        let stream = PoseStream {
            reference_known: false,
            stamps_copied: true,
            ..PoseStream::new(self.track, chain, self.columns)
        };
        let fit = fit_model(self.joints, &stream, self.max_lag_s, FitHypotheses::Faultless)?;
        fit.best().map(|best| best.fit)
    }
}
