//! Estimates the encoding of the joint states from a pose stream.

use super::comparison::{
    JointComparison, MAX_FOLLOWING_RESIDUAL_SHARE, MAX_LOGGED_RESIDUAL_SHARE, MAX_RESIDUAL_RAD,
    MAX_REST_SPREAD_M, MIN_LAG_DIFFERENCE_S, MIN_SAMPLES,
};
use super::encoding::JointEncoding;
use super::interpretation::JointInterpretation;
use super::interpreted_poses::{FreeFrames, InterpretedPoses, ResidualSize};
use super::search::{InterpretationKind, SearchOutcome, likely_maps, search_kind};
use crate::frames::position_fit::spread;
use crate::samples::sampling::{check_sample_count, value_range};
use crate::{EstimateResult, NotObservable, UnitResiduals};
use ground::stats::mean;

/// For an interpretation other than the logged one.
const MIN_RESIDUAL_RATIO: f64 = 5.0;
/// Stricter than the usual share: reversed joint order moves an arm much like the inverse of an arm with rotated frames.
const MAX_LOGGED_RESIDUAL_SHARE_ROTATED: f64 = 0.005;
/// For another interpretation at slow samples, before correcting latency and small causes.
const MAX_RESIDUAL_SHARE: f64 = 0.02;

/// May have a large remaining residual.
pub(crate) struct LikelyEncoding {
    pub encoding: JointEncoding,
    /// The values exceed the joint limits as radians, not as degrees.
    pub by_range: bool,
}

impl JointComparison<'_> {
    /// Encoding in which the stream follows the arm.
    ///
    /// # Errors
    /// If the stream does not overlap the joint states, or the motion does not determine the encoding.
    pub fn encoding(&self) -> EstimateResult<JointEncoding> {
        let (mut as_logged, mut extent) = (f64::INFINITY, f64::INFINITY);
        let mut at_lags = Vec::new();
        for lag_s in self.lags_s() {
            let samples = self.samples(lag_s);
            check_sample_count(samples.len(), MIN_SAMPLES)?;
            if is_at_rest(&samples) {
                return encoding_at_rest(&samples, self.stream.reference_known);
            }
            let spread_m = spread(&samples.xyz);
            if spread_m < MAX_REST_SPREAD_M {
                // The joints move, the stream does not.
                return Err(NotObservable::NotExcited);
            }
            extent = spread_m.max(0.01).min(extent);
            let misfit_m = samples.least_misfit(FreeFrames::Both);
            if misfit_m
                <= (MAX_LOGGED_RESIDUAL_SHARE_ROTATED * extent).max(self.max_noise_m(spread_m))
                || samples.least_misfit(FreeFrames::Tool) <= MAX_LOGGED_RESIDUAL_SHARE * extent
            {
                return Ok(JointEncoding::default());
            }
            as_logged = misfit_m.min(as_logged);
            at_lags.push(samples.views());
        }
        if at_lags.iter().any(|views| half_follows_as_logged(&views[0])) {
            return Ok(JointEncoding::default());
        }
        let max_residual = ResidualSize {
            m: self.max_residual_m(extent).min(as_logged / MIN_RESIDUAL_RATIO),
            rad: Some(MAX_RESIDUAL_RAD),
        };
        match self.simplest(&at_lags, max_residual, &InterpretationKind::ALL) {
            SearchOutcome::Found(found) => Ok(self.encoding_of(&found, as_logged)),
            // No encoding is clearly best.
            _ if as_logged > MAX_FOLLOWING_RESIDUAL_SHARE * extent => {
                Err(NotObservable::NotExcited)
            }
            _ => Ok(JointEncoding::default()),
        }
    }

    /// Whether half of the run follows FK as logged, and the whole run does not. No other encoding of the joints explains
    /// that.
    pub fn has_change_within_run(&self) -> bool {
        self.lags_s().into_iter().any(|lag_s| half_follows_as_logged(&self.samples(lag_s)))
    }

    /// Encoding with a residual far below `as_logged`, which is the one at `lag_s`. `None` if none is clearly best. Tries
    /// only the simplest if the stream is close to FK as logged.
    pub fn other_encoding(&self, lag_s: f64, as_logged: ResidualSize) -> Option<JointEncoding> {
        const MIN_LARGE_ROTATION_RESIDUAL_RAD: f64 = 0.05;
        const MAX_SMALL_POSITION_RESIDUAL_M: f64 = 5e-3;
        let samples = self.samples(lag_s);
        if samples.len() < MIN_SAMPLES || is_at_rest(&samples) {
            return None;
        }
        let are_turned = as_logged.rad.is_some_and(|rad| rad > MIN_LARGE_ROTATION_RESIDUAL_RAD);
        let turns_only = are_turned && as_logged.m < MAX_SMALL_POSITION_RESIDUAL_M;
        // If only rotations are wrong, positions must not get worse.
        let stay_m = if turns_only { 1.2 * samples.least_misfit(FreeFrames::Tool) } else { 0.0 };
        let better_m = (as_logged.m / MIN_RESIDUAL_RATIO).max(2e-4).max(stay_m);
        let extent_m = spread(&samples.xyz);
        let max_residual = ResidualSize {
            m: self.max_residual_m(extent_m.max(0.01)).min(better_m),
            rad: as_logged.rad.map(|rad| (rad / MIN_RESIDUAL_RATIO).clamp(1e-3, MAX_RESIDUAL_RAD)),
        };
        // Only the last joint does not move the positions.
        let is_far =
            !turns_only && (are_turned || as_logged.m > MAX_LOGGED_RESIDUAL_SHARE * extent_m);
        let kinds = match is_far {
            true => &InterpretationKind::ALL[..],
            false => &InterpretationKind::FOR_SMALL_RESIDUALS[..],
        };
        let is_used = |view: &InterpretedPoses| !turns_only || view.rotation.is_some();
        let mut views: Vec<Vec<InterpretedPoses>> =
            vec![samples.views().into_iter().filter(is_used).collect()];
        let mut outcome = self.simplest(&views, max_residual, kinds);
        if matches!(outcome, SearchOutcome::Ambiguous(_)) {
            // The latency of a wrong model may be wrong.
            let is_other = |other_s: &f64| (other_s - lag_s).abs() > MIN_LAG_DIFFERENCE_S;
            let others =
                self.lags_s().into_iter().filter(is_other).map(|lag_s| self.samples(lag_s));
            let others = others.filter(|samples| samples.len() >= MIN_SAMPLES);
            views.extend(others.map(|own| own.views().into_iter().filter(is_used).collect()));
            outcome = self.simplest(&views, max_residual, kinds);
        }
        let SearchOutcome::Found(found) = outcome else { return None };
        Some(self.encoding_of(&found, as_logged.m))
    }

    /// Most likely first: degrees if the values exceed the joint ranges as radians, then the unit and order
    /// with the smallest position residual.
    pub fn likely_encodings(&self) -> Vec<LikelyEncoding> {
        let samples = self.samples(self.lags_s().last().copied().unwrap_or(0.0));
        if samples.len() < MIN_SAMPLES {
            return Vec::new();
        }
        let as_logged_m = samples.least_misfit(FreeFrames::Both);
        let mut likely = Vec::new();
        for view in samples.views().into_iter().chain([samples.mirrored()]) {
            for (map, by_range) in likely_maps(&view) {
                let residual = view.fitted_residual(&map, FreeFrames::Both);
                let found = JointInterpretation { map, residual, runner_up_m: None };
                let encoding = self.encoding_of(&found, as_logged_m);
                likely.push(LikelyEncoding { encoding, by_range });
            }
        }
        likely.sort_by_key(|one| !one.by_range);
        likely.dedup_by(|a, b| a.encoding.is_same(&b.encoding));
        likely
    }

    /// For another interpretation of a motion of this extent.
    fn max_residual_m(&self, extent_m: f64) -> f64 {
        (MAX_RESIDUAL_SHARE * extent_m).max(self.max_noise_m(extent_m))
    }

    fn encoding_of(&self, found: &JointInterpretation, as_logged_m: f64) -> JointEncoding {
        found.encoding(self.joints.dof, self.stream, as_logged_m)
    }

    /// Simplest interpretation with a residual of at most `max_residual`, if one is clearly best. Views are per lag.
    fn simplest(
        &self,
        views: &[Vec<InterpretedPoses>],
        max_residual: ResidualSize,
        kinds: &[InterpretationKind],
    ) -> SearchOutcome {
        let freedoms: &[FreeFrames] = match self.stream.reference_known {
            true => &[FreeFrames::Tool, FreeFrames::Both],
            false => &[FreeFrames::Both],
        };
        for &freedom in freedoms {
            let is_first = freedom == freedoms[0];
            let is_tried = |kind: InterpretationKind| match kind {
                InterpretationKind::OrderAndOneJoint => is_first && freedom == FreeFrames::Tool,
                _ => is_first || kind <= InterpretationKind::UnitAndOneJoint,
            };
            for kind in kinds.iter().copied().filter(|kind| is_tried(*kind)) {
                match best_of_kind(views, kind, freedom, max_residual) {
                    SearchOutcome::Nothing => {}
                    outcome => return outcome,
                }
            }
        }
        SearchOutcome::Nothing
    }
}

/// Searches all views for interpretations of one kind.
fn best_of_kind(
    views: &[Vec<InterpretedPoses>],
    kind: InterpretationKind,
    freedom: FreeFrames,
    max_residual: ResidualSize,
) -> SearchOutcome {
    /// Other lags are tried only for the simplest kind.
    const LAGS_FOR_ALL_KINDS: usize = 2;
    let lags = if kind == InterpretationKind::OneJoint { views.len() } else { LAGS_FOR_ALL_KINDS };
    // Residual below which another lag is clearly better, and whether rotations are ambiguous.
    let (mut max_m, mut are_turns_ambiguous) = (f64::INFINITY, false);
    for view in views.iter().take(lags).flatten() {
        match search_kind(view, kind, freedom, max_residual) {
            SearchOutcome::Found(found)
                if found.residual.combined_m(view.lever_m) < max_m
                    && (view.rotation.is_some() || !are_turns_ambiguous) =>
            {
                return SearchOutcome::Found(found);
            }
            SearchOutcome::Ambiguous(residual_m) => {
                max_m = max_m.min(residual_m / MIN_RESIDUAL_RATIO);
                are_turns_ambiguous |= view.rotation.is_some();
            }
            SearchOutcome::Found(_) | SearchOutcome::Nothing => {}
        }
    }
    match max_m.is_finite() {
        true => SearchOutcome::Ambiguous(MIN_RESIDUAL_RATIO * max_m),
        false => SearchOutcome::Nothing,
    }
}

/// Whether consecutive samples, half of all, follow FK as logged far better than all do, up to constant frames. Every
/// joint must move in them about as far as in all: less motion fits other encodings, too.
pub(super) fn half_follows_as_logged(view: &InterpretedPoses) -> bool {
    const MIN_HALF: usize = 20;
    const MIN_MOTION_SHARE: f64 = 0.5;
    let (len, dof) = (view.len(), view.chain.dof());
    if len < 2 * MIN_HALF {
        return false;
    }
    let residual =
        |view: &InterpretedPoses| view.fitted_residual(&view.as_logged(), FreeFrames::Both);
    let range = |view: &InterpretedPoses, joint: usize| {
        value_range(view.q.iter().skip(joint).step_by(dof).copied())
    };
    let whole_m = residual(view).combined_m(view.lever_m);
    [0, len / 4, len / 2].into_iter().any(|first| {
        let half = view.at_rows(first..first + len / 2);
        let moves =
            (0..dof).all(|joint| range(&half, joint) >= MIN_MOTION_SHARE * range(view, joint));
        let is_within = |residual: ResidualSize| {
            residual.m < MAX_LOGGED_RESIDUAL_SHARE_ROTATED * spread(&half.xyz)
                && residual.rad.is_none_or(|rad| rad < MAX_LOGGED_RESIDUAL_SHARE_ROTATED)
                && MIN_RESIDUAL_RATIO * residual.combined_m(view.lever_m) < whole_m
        };
        moves && is_within(residual(&half))
    })
}

/// Radians and degrees.
const UNITS: [f64; 2] = [1.0, std::f64::consts::PI / 180.0];

/// Neither stream nor FK move the tip, in radians or degrees.
fn is_at_rest(samples: &InterpretedPoses) -> bool {
    let in_units = UNITS.map(|unit| samples.fk_positions(unit));
    in_units.iter().chain([&samples.xyz]).all(|xyz| spread(xyz) < MAX_REST_SPREAD_M)
}

/// A tip at the position given by FK confirms names and unit without any free frame; elsewhere it is
/// inconclusive.
fn encoding_at_rest(
    samples: &InterpretedPoses,
    reference_known: bool,
) -> EstimateResult<JointEncoding> {
    /// Between a resting tip and FK, of the arm's reach.
    const MAX_DISTANCE_SHARE: f64 = 0.03;
    let [as_logged, corrected] = UNITS.map(|unit| {
        let fk = samples.fk_positions(unit);
        let squares = fk.iter().zip(&samples.xyz).map(|(fk, xyz)| (fk - xyz).norm_squared());
        mean(squares).sqrt()
    });
    let is_plausible = |distance: f64, other: f64| {
        distance < MAX_DISTANCE_SHARE * samples.chain.max_reach_m()
            && distance * MIN_RESIDUAL_RATIO < other
    };
    match reference_known {
        true if is_plausible(as_logged, corrected) => Ok(JointEncoding::default()),
        true if is_plausible(corrected, as_logged) => {
            let residual = Some(UnitResiduals { as_logged, corrected });
            Ok(JointEncoding { is_in_degrees: true, residual, ..JointEncoding::default() })
        }
        _ => Err(NotObservable::AtRest),
    }
}
