//! Identifies which columns of a table are an arm's joints and which are the position of its tool.
//!
//! A point on the tool is linear in FK, for any frame, unit and tool: `p = s·(R_b·(x + R·t)) + p_b`. Linear
//! least squares compares each block of joint candidates with all other columns at once. The best are
//! fitted as pose streams, with latency, frame and tool free.

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::ops::RangeInclusive;

mod at_base;
mod content;
mod joint_value_unit;
mod least_squares;
mod rotation_columns;
mod tracks;

pub use content::{ColumnContent, GroupShift};
pub use joint_value_unit::JointValueUnit;

use least_squares::{centred, most_active_window, residual_squares};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::PoseStream;
use crate::distinct::distinct;
use crate::encodings::position::metres_by_size;
use crate::robot_models::ranking::{ScoredFit, extent, frame_price, tool_fit};
use crate::samples::sampling::range_of;
use ground::robot::{Chain, Limits};
use ground::stream::sample_noise;

const MAX_ROWS: usize = 6000;
const MAX_RATE_HZ: f64 = 110.0;
const LINEAR_FIT_ROWS: usize = 150;
/// Share of the position's extent. A fit to a few rows rejects poor candidates first.
const MAX_LINEAR_RESIDUAL_SHARE: f64 = 0.4;
const MAX_SCREENING_RESIDUAL_SHARE: f64 = 0.55;
const SCREENING_ROWS: usize = 50;
/// Joint and position candidates, and arms per candidate.
const MAX_CANDIDATES: usize = 12;
const MAX_ARMS: usize = 2;
/// Fitted first. If one is below `CLEAR_RESIDUAL_SHARE` of the extent, candidates above
/// `COMPETITOR_RESIDUAL_SHARE` in the linear fit are skipped.
const FIRST_CANDIDATES: usize = 4;
const CLEAR_RESIDUAL_SHARE: f64 = 0.005;
const COMPETITOR_RESIDUAL_SHARE: f64 = 0.25;
/// The others only if zero finds no match.
const LAGS_S: [&[f64]; 2] = [&[0.0], &[-0.4, -0.2, -0.1, 0.1, 0.2, 0.4]];
/// For the search over latencies.
const MAX_ARMS_FOR_LAGS: usize = 4;
/// Larger tables are not searched.
const MAX_COLUMNS: usize = 128;
/// Share of the extent: a position that a polynomial in time describes fits almost any arm.
const MIN_POLYNOMIAL_RESIDUAL_SHARE: f64 = 0.05;
const POLYNOMIAL_DEGREE: i32 = 6;
/// Larger values are not radians, nor degrees beyond this many.
const TWO_TURNS_RAD: f64 = 4.0 * PI;
/// Beyond the joint limits, rad or m.
const LIMIT_TOLERANCE: f64 = 0.2;
/// Multiple of the joint's limit or else the catalogue's highest.
const MAX_SPEED_RATIO: f64 = 3.0;
const DEFAULT_MAX_SPEED_RAD_S: f64 = 21.0;
/// For a column that moves, rad or m.
const MIN_COLUMN_RANGE: f64 = 0.01;
/// In a block.
const MIN_MOVING_JOINTS: usize = 3;
/// Sample-to-sample, of a moving column's range.
const MAX_NOISE_SHARE: f64 = 0.2;
/// Limits for a position against FK: m, or share of its extent.
const MAX_RESIDUAL_M: f64 = 3e-3;
const MAX_RESIDUAL_SHARE: f64 = 0.01;

/// Bounds the share even for short motions.
const MAX_RESIDUAL_SHARE_BOUND: f64 = 0.05;

/// In the base frame.
const MAX_TOOL_M: f64 = 0.5;

/// Numeric columns of a table.
pub struct NumericTable {
    t_s: Vec<f64>,
    columns: Vec<Vec<f64>>,
    /// Source array per column; blocks do not span arrays.
    homes: Vec<usize>,
    /// Lowest and highest value per column.
    ranges: Vec<[f64; 2]>,
    /// Standard deviation of the noise per column.
    noises: Vec<f64>,
    /// Per second, over a few rows.
    steepest: Vec<f64>,
    /// Whether each column is constant or has two levels, by all rows: rows of several streams alternate.
    levels: Vec<Option<ColumnContent>>,
}

/// Positions that a joint may have, rad or m.
fn tolerated_range(limits: &Limits) -> RangeInclusive<f64> {
    let low = limits.lower.unwrap_or(-TWO_TURNS_RAD) - LIMIT_TOLERANCE;
    low..=limits.upper.unwrap_or(TWO_TURNS_RAD) + LIMIT_TOLERANCE
}

fn span_s(t_s: &[f64]) -> f64 {
    t_s.last().zip(t_s.first()).map_or(0.0, |(last, first)| last - first)
}

fn step_s(t_s: &[f64]) -> f64 {
    span_s(t_s) / (t_s.len().max(2) - 1) as f64
}

/// Between rows. Ignores outliers and jumps by a whole turn.
fn max_change(values: &[f64]) -> f64 {
    const OUTLIER_ROWS: usize = 4;
    /// In rad and in degrees.
    const ONE_TURN: [f64; 2] = [2.0 * PI, 360.0];
    const TURN_TOLERANCE: f64 = 0.05;
    let is_turn = |by: f64| ONE_TURN.iter().any(|turn| (by / turn - 1.0).abs() < TURN_TOLERANCE);
    let change = |rows: &[f64]| {
        let by = rows[1..].iter().map(|value| (value - rows[0]).abs());
        by.fold(f64::INFINITY, f64::min)
    };
    let changes = values.windows(OUTLIER_ROWS).map(change);
    changes.filter(|by| !is_turn(*by)).fold(0.0, f64::max)
}

/// Constraints of the search.
#[derive(Default)]
pub struct MappingConstraints<'a> {
    /// Candidate arms.
    pub chains: &'a [&'a Chain],
    /// Per arm, in rad, if known.
    pub joints: Option<&'a [Vec<usize>]>,
    /// Position columns, if known.
    pub position: Option<[usize; 3]>,
    /// Used for other data.
    pub taken: &'a [usize],
    /// Longest latency.
    pub max_lag_s: f64,
}

/// Columns of joints and position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColumnMapping {
    /// Arm's index.
    pub arm: usize,
    /// Base to tip.
    pub joints: Vec<usize>,
    /// Unit of the joint values.
    pub unit: JointValueUnit,
    /// Position columns.
    pub position: [usize; 3],
    /// Position residual against FK, rms.
    #[serde(rename = "left_m")]
    pub residual_m: f64,
    /// Rms distance from their mean.
    pub spread_m: f64,
    /// Point's distance from the arm's tip.
    pub tool_m: f64,
    /// Position's latency.
    pub lag_s: f64,
    /// Whether it fits in the base frame with only a usual tool free.
    #[serde(default)]
    pub is_at_base: bool,
    /// `n ln σ²` of the residual plus penalties for frame and tool; lower is better.
    #[serde(default)]
    pub score: f64,
}

/// Threshold for a position with that extent.
fn limit_m(spread_m: f64) -> f64 {
    MAX_RESIDUAL_M.max(MAX_RESIDUAL_SHARE * spread_m)
}

impl ColumnMapping {
    /// FK and position agree.
    pub fn fits(&self) -> bool {
        self.residual_m <= limit_m(self.spread_m).min(MAX_RESIDUAL_SHARE_BOUND * self.spread_m)
    }

    fn block(&self) -> JointColumns {
        JointColumns { joints: self.joints.clone(), unit: self.unit, arm: self.arm }
    }

    /// Same columns and unit.
    pub fn is_same(&self, other: &Self) -> bool {
        (&self.joints, self.position, self.unit) == (&other.joints, other.position, other.unit)
    }
}

/// `share` is the linear fit's residual, of the extent.
struct ColumnCandidate {
    block: JointColumns,
    position: [usize; 3],
    share: f64,
}

/// Column per joint, base to tip, in chain order and sorted by joint name (common in drivers).
fn usual_orders(chain: &Chain) -> Vec<Vec<usize>> {
    let names = chain.joint_names();
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort();
    let by_name = names.iter().filter_map(|name| sorted.iter().position(|other| *other == name));
    distinct([(0..names.len()).collect(), by_name.collect()], Vec::eq)
}

/// Candidate joints of an arm.
#[derive(Clone)]
pub struct JointColumns {
    /// Column indices.
    pub joints: Vec<usize>,
    /// Unit of the values.
    pub unit: JointValueUnit,
    /// Arm's index.
    pub arm: usize,
}

impl JointColumns {
    fn contain_any(&self, position: &[usize; 3]) -> bool {
        position.iter().any(|column| self.joints.contains(column))
    }
}

/// Choices of joints and position with the smallest of `shares` at any lag: at most the first number of choices of columns,
/// each with at most the second number of arms.
fn best_candidates(
    blocks: &[JointColumns],
    lags_s: &[f64],
    (max_candidates, max_arms): (usize, usize),
    shares: impl Fn(&JointColumns, f64) -> Vec<(f64, [usize; 3])> + Sync,
) -> Vec<ColumnCandidate> {
    let of_block = |block| {
        let all: Vec<(f64, [usize; 3])> =
            lags_s.iter().flat_map(|&lag_s| shares(block, lag_s)).collect();
        all.into_iter().map(move |(share, position)| (share, block, position))
    };
    let mut sorted: Vec<(f64, &JointColumns, [usize; 3])> =
        blocks.par_iter().flat_map_iter(of_block).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut retained: Vec<ColumnCandidate> = Vec::new();
    let mut count = 0;
    for (share, block, position) in sorted {
        let is_its = |other: &&ColumnCandidate| {
            other.block.joints == block.joints && other.position == position
        };
        let arms: Vec<usize> = retained.iter().filter(is_its).map(|it| it.block.arm).collect();
        let has_room = if arms.is_empty() { count < max_candidates } else { arms.len() < max_arms };
        if has_room && !arms.contains(&block.arm) {
            count += usize::from(arms.is_empty());
            retained.push(ColumnCandidate { block: block.clone(), position, share });
        }
    }
    retained
}

impl NumericTable {
    /// Takes rows at increasing times. Long tables are downsampled and cut to the most active window.
    pub fn new(t_s: Vec<f64>, columns: Vec<Vec<f64>>, homes: Vec<usize>) -> Self {
        let levels = columns.iter().map(|values| content::levels(values)).collect();
        let rate_hz = t_s.len() as f64 / span_s(&t_s).max(f64::MIN_POSITIVE);
        let step = (rate_hz / MAX_RATE_HZ).ceil().max(1.0) as usize;
        let rows: Vec<usize> = (0..t_s.len()).step_by(step).collect();
        let first = rows.len().saturating_sub(MAX_ROWS);
        let first = if first == 0 { 0 } else { most_active_window(&rows, &columns) };
        let rows = &rows[first..(first + MAX_ROWS).min(rows.len())];
        let pick = |values: &Vec<f64>| rows.iter().map(|&row| values[row]).collect();
        let (t_s, columns): (Vec<f64>, Vec<Vec<f64>>) =
            (pick(&t_s), columns.iter().map(pick).collect());
        let ranges = columns.iter().map(|values| range_of(values.iter().copied())).collect();
        let noises = columns.iter().map(|values| sample_noise(values)).collect();
        let steepest = columns.iter().map(|values| max_change(values) / step_s(&t_s)).collect();
        Self { t_s, columns, homes, ranges, noises, steepest, levels }
    }

    /// Mean time between rows.
    pub fn step_s(&self) -> f64 {
        step_s(&self.t_s)
    }

    /// Source array of a column.
    pub fn home(&self, column: usize) -> usize {
        self.homes[column]
    }

    /// Whether it moves enough for a joint.
    pub fn moves(&self, column: usize) -> bool {
        let [low, high] = self.ranges[column];
        high - low > MIN_COLUMN_RANGE
    }

    /// Whether each row has this value.
    pub fn is_always(&self, column: usize, value: f64) -> bool {
        self.columns[column].iter().all(|own| *own == value)
    }

    /// Assignments, best score first. Empty if none fits.
    pub fn mappings(&self, constraints: &MappingConstraints) -> Vec<ColumnMapping> {
        /// With a free joint zero, if none fits without.
        const MAX_REFITS_WITH_ZERO: usize = 4;
        for lags_s in &LAGS_S[..if constraints.chains.len() > MAX_ARMS_FOR_LAGS { 1 } else { 2 }] {
            let mut all = self.fits_at_lags(constraints, lags_s);
            let best = all.iter().min_by(|a, b| a.residual_m.total_cmp(&b.residual_m));
            // At a wrong latency many arms fit equally well, and the right one may not be fitted.
            if let Some(lag_s) = best.filter(|best| !best.fits()).map(|best| best.lag_s) {
                all.extend(self.fits_at_lags(constraints, &[lag_s]));
            }
            if !all.iter().any(ColumnMapping::fits) {
                all.sort_by(|a, b| a.residual_m.total_cmp(&b.residual_m));
                all.truncate(MAX_REFITS_WITH_ZERO);
                let anew =
                    |it: &ColumnMapping| self.fit(constraints, &it.block(), it.position, true);
                all = all.par_iter().filter_map(anew).collect();
            }
            all.sort_by(|a, b| a.score.total_cmp(&b.score));
            let mappings = distinct(all, ColumnMapping::is_same);
            if mappings.iter().any(ColumnMapping::fits) {
                return mappings;
            }
        }
        Vec::new()
    }

    /// Best candidates of the linear search.
    fn fits_at_lags(&self, constraints: &MappingConstraints, lags_s: &[f64]) -> Vec<ColumnMapping> {
        let of = |candidates: &ColumnCandidate| {
            self.fit(constraints, &candidates.block, candidates.position, false)
        };
        let rows = self.few_rows();
        if rows.len() < LINEAR_FIT_ROWS / 3 || self.columns.len() > MAX_COLUMNS {
            return Vec::new();
        }
        let mut candidates = self.candidates_at_base(constraints, lags_s, &rows);
        candidates.extend(self.linear_candidates(constraints, lags_s, &rows));
        let (first, others) = candidates.split_at(candidates.len().min(FIRST_CANDIDATES));
        let mut all: Vec<ColumnMapping> = first.par_iter().filter_map(of).collect();
        let is_clear = all.iter().any(|it| it.residual_m < CLEAR_RESIDUAL_SHARE * it.spread_m);
        let others = others
            .par_iter()
            .filter(|candidates| !is_clear || candidates.share < COMPETITOR_RESIDUAL_SHARE);
        all.extend(others.filter_map(of).collect::<Vec<_>>());
        all.retain(|mapping| !self.contains_own_rate(mapping));
        all
    }

    /// Rates of others cannot be joints or positions.
    fn contains_own_rate(&self, mapping: &ColumnMapping) -> bool {
        let all: Vec<usize> = mapping.joints.iter().chain(&mapping.position).copied().collect();
        let moving: Vec<usize> = all.into_iter().filter(|&at| self.moves(at)).collect();
        moving.iter().any(|&at| moving.iter().any(|&of| of != at && self.is_rate_of(at, of)))
    }

    /// Refits a mapping of another table. Frees a joint zero if it does not fit without.
    pub fn refit(
        &self,
        mapping: &ColumnMapping,
        chain: &Chain,
        max_lag_s: f64,
    ) -> Option<ColumnMapping> {
        let constraints =
            MappingConstraints { chains: &[chain], max_lag_s, ..MappingConstraints::default() };
        let block = JointColumns { arm: 0, ..mapping.block() };
        let fit = |with_zero| self.fit(&constraints, &block, mapping.position, with_zero);
        let found = fit(false)?;
        let found = if found.fits() { found } else { fit(true)? };
        Some(ColumnMapping { arm: mapping.arm, ..found })
    }

    /// Smooth columns within an arm's limits.
    pub fn blocks(&self, constraints: &MappingConstraints, arm: usize) -> Vec<JointColumns> {
        self.blocks_that_move(constraints, arm, MIN_MOVING_JOINTS)
    }

    fn blocks_that_move(
        &self,
        constraints: &MappingConstraints,
        arm: usize,
        min_moving: usize,
    ) -> Vec<JointColumns> {
        let chain = constraints.chains[arm];
        let dof = chain.dof();
        let orders = usual_orders(chain);
        let are_few_arms = constraints.chains.len() <= MAX_ARMS_FOR_LAGS;
        let homes: BTreeSet<usize> = self.homes.iter().copied().collect();
        let mut blocks = Vec::new();
        for home in homes {
            let own: Vec<usize> =
                (0..self.columns.len()).filter(|&column| self.homes[column] == home).collect();
            // Positions may alternate with velocities and efforts.
            for stride in 1..=3 {
                let wide = (dof - 1) * stride + 1;
                let windows = own
                    .windows(wide)
                    .flat_map(|window| orders.iter().map(move |order| (window, order.as_slice())));
                for (window, order) in windows {
                    let joints: Vec<usize> = order.iter().map(|at| window[at * stride]).collect();
                    if joints.iter().any(|column| constraints.taken.contains(column)) {
                        continue;
                    }
                    let units =
                        JointValueUnit::compatible_with(self.max_abs(&joints), are_few_arms);
                    for unit in units {
                        if self.can_be_joints(&joints, unit, chain, min_moving) {
                            blocks.push(JointColumns { joints: joints.clone(), unit, arm });
                        }
                    }
                }
            }
        }
        blocks
    }

    fn max_abs(&self, columns: &[usize]) -> f64 {
        let ends = columns.iter().flat_map(|&column| self.ranges[column]);
        ends.map(f64::abs).fold(0.0, f64::max)
    }

    /// Whether they can in this unit, with at least `min_moving` moving.
    fn can_be_joints(
        &self,
        joints: &[usize],
        unit: JointValueUnit,
        chain: &Chain,
        min_moving: usize,
    ) -> bool {
        let mut moving = 0;
        for (at, &column) in joints.iter().enumerate() {
            let (factor, zero) = unit.factor_and_offset(chain, at);
            let [low, high] = self.ranges[column].map(|end| factor * end + zero);
            let limits = chain.limits()[at];
            let within = tolerated_range(&limits);
            let is_beyond = low < *within.start() || high > *within.end();
            // Joints do not jump; a rotation vector beyond 180° does.
            let fastest = MAX_SPEED_RATIO * limits.velocity.unwrap_or(DEFAULT_MAX_SPEED_RAD_S);
            let jumps = factor * self.steepest[column] > fastest;
            if is_beyond || jumps || !(high - low).is_finite() {
                return false;
            }
            if high - low > MIN_COLUMN_RANGE {
                moving += 1;
                if factor * self.noises[column] > MAX_NOISE_SHARE * (high - low) {
                    return false;
                }
            }
        }
        moving >= min_moving
    }

    /// Columns that may be a position.
    pub fn positions(&self, taken: &[usize]) -> Vec<[usize; 3]> {
        let count = self.columns.len();
        // Row-major 4×4 matrices have positions every fourth number.
        let triples = [1, 4].into_iter().flat_map(|stride| {
            (0..count.saturating_sub(2 * stride)).map(move |at| [at, at + stride, at + 2 * stride])
        });
        let fits = |triple: &[usize; 3]| {
            triple.iter().all(|column| !taken.contains(column))
                && self.homes[triple[0]] == self.homes[triple[2]]
                && (triple[0]..triple[2]).all(|at| self.homes[at] == self.homes[triple[0]])
        };
        triples.filter(fits).collect()
    }

    /// The known position, or columns that may be one.
    fn possible_positions(&self, constraints: &MappingConstraints) -> Vec<[usize; 3]> {
        let all = || self.positions(constraints.taken);
        constraints.position.map_or_else(all, |position| vec![position])
    }

    /// Small residual in the linear fit, best first.
    fn linear_candidates(
        &self,
        constraints: &MappingConstraints,
        lags_s: &[f64],
        rows: &[usize],
    ) -> Vec<ColumnCandidate> {
        let logged = self.at_rows(rows);
        let fewer: Vec<usize> =
            rows.iter().copied().step_by(rows.len().div_ceil(SCREENING_ROWS)).collect();
        let views = [
            (self.at_rows(&fewer), fewer, MAX_SCREENING_RESIDUAL_SHARE),
            (logged.clone(), rows.to_vec(), MAX_LINEAR_RESIDUAL_SHARE),
        ];
        let span_s = self.t_s[rows[rows.len() - 1]] - self.t_s[rows[0]];
        let plain = DMatrix::from_fn(rows.len(), POLYNOMIAL_DEGREE as usize, |row, power| {
            ((self.t_s[rows[row]] - self.t_s[rows[0]]) / span_s - 0.5).powi(1 + power as i32)
        });
        let plain = residual_squares(&centred(plain), &logged);
        let mut positions = self.possible_positions(constraints);
        positions.retain(|position| {
            let own: f64 = position.iter().map(|&c| logged.column(c).norm_squared()).sum();
            position.iter().map(|&c| plain[c]).sum::<f64>()
                > MIN_POLYNOMIAL_RESIDUAL_SHARE.powi(2) * own
        });
        let shares = |block: &JointColumns, lag_s: f64| {
            let chain = constraints.chains[block.arm];
            let free = positions.iter().filter(|position| !block.contain_any(position));
            let mut shares: Vec<(f64, [usize; 3])> =
                free.map(|position| (0.0, *position)).collect();
            for (logged, rows, most) in &views {
                if shares.is_empty() {
                    break;
                }
                let residuals = residual_squares(&self.design(block, chain, rows, lag_s), logged);
                shares.retain_mut(|(share, position)| {
                    let squares = position.map(|column| logged.column(column).norm_squared());
                    let own: f64 = squares.iter().sum();
                    let moving = squares.iter().filter(|square| **square > 1e-4 * own).count();
                    let residuals: f64 = position.iter().map(|&column| residuals[column]).sum();
                    *share = (residuals / own).max(0.0).sqrt();
                    own > 0.0 && moving > 1 && *share < *most
                });
            }
            shares
        };
        let blocks = self.candidate_blocks(constraints, MIN_MOVING_JOINTS);
        best_candidates(&blocks, lags_s, (MAX_CANDIDATES, MAX_ARMS), shares)
    }

    /// Blocks of all arms, or the known joints.
    fn candidate_blocks(
        &self,
        constraints: &MappingConstraints,
        min_moving: usize,
    ) -> Vec<JointColumns> {
        let of = |(arm, chain): (usize, &&Chain)| match constraints.joints {
            Some(joints) if joints[arm].len() == chain.dof() => {
                let (joints, unit) = (joints[arm].clone(), JointValueUnit::Radians);
                vec![JointColumns { joints, unit, arm }]
            }
            Some(_) => Vec::new(),
            None => self.blocks_that_move(constraints, arm, min_moving),
        };
        constraints.chains.iter().enumerate().flat_map(of).collect()
    }

    /// Centred columns at these rows.
    fn at_rows(&self, rows: &[usize]) -> DMatrix<f64> {
        centred(DMatrix::from_fn(rows.len(), self.columns.len(), |row, column| {
            self.columns[column][rows[row]]
        }))
    }

    /// Evenly spaced, far enough from both ends for every latency.
    fn few_rows(&self) -> Vec<usize> {
        let longest_s = LAGS_S[1].iter().copied().fold(0.0, f64::max);
        let (Some(first), Some(last)) = (self.t_s.first(), self.t_s.last()) else {
            return Vec::new();
        };
        let margin_s = longest_s.min(0.1 * (last - first));
        let inner = self.t_s.iter().enumerate();
        let inner = inner.filter(|(_, t_s)| (first + margin_s..last - margin_s).contains(t_s));
        let inner: Vec<usize> = inner.map(|(row, _)| row).collect();
        let count = LINEAR_FIT_ROWS.min(inner.len());
        (0..count).map(|at| inner[at * inner.len() / count]).collect()
    }

    /// FK position and rotation, centred.
    fn design(
        &self,
        block: &JointColumns,
        chain: &Chain,
        rows: &[usize],
        lag_s: f64,
    ) -> DMatrix<f64> {
        const FK_NUMBERS: usize = 12;
        let mut design = DMatrix::zeros(rows.len(), FK_NUMBERS);
        for (at, pose) in self.poses_at(block, chain, rows, lag_s).iter().enumerate() {
            let turn = pose.rotation.to_rotation_matrix();
            let numbers = pose.translation.vector.iter().chain(turn.matrix().iter());
            numbers.enumerate().for_each(|(column, number)| design[(at, column)] = *number);
        }
        centred(design)
    }

    /// Interpolated linearly.
    fn joints_at(&self, block: &JointColumns, chain: &Chain, t_s: f64) -> Vec<f64> {
        let after = self.t_s.partition_point(|t| *t < t_s).clamp(1, self.t_s.len() - 1);
        let (before_s, after_s) = (self.t_s[after - 1], self.t_s[after]);
        let share = ((t_s - before_s) / (after_s - before_s)).clamp(0.0, 1.0);
        let at = |(joint, &column): (usize, &usize)| {
            let values = &self.columns[column];
            let q = values[after - 1] + share * (values[after] - values[after - 1]);
            let (factor, zero) = block.unit.factor_and_offset(chain, joint);
            factor * q + zero
        };
        block.joints.iter().enumerate().map(at).collect()
    }

    /// Latency, tool and (if needed) frame.
    fn fit(
        &self,
        constraints: &MappingConstraints,
        block: &JointColumns,
        position: [usize; 3],
        with_zero: bool,
    ) -> Option<ColumnMapping> {
        let chain = constraints.chains[block.arm];
        let joints = self.track(block, chain);
        let track = self.position(position);
        let columns: Vec<usize> = (0..chain.dof()).collect();
        let in_base = PoseStream::new(&track, chain, &columns);
        let stream = PoseStream { reference_known: false, ..in_base };
        let spread_m = metres_by_size(&joints, &stream) * extent(&track.xyz);
        let fit = |stream| tool_fit(&joints, stream, constraints.max_lag_s, with_zero);
        let at_base = fit(&in_base).filter(|it| {
            let most_m = MAX_RESIDUAL_M.min(MAX_RESIDUAL_SHARE_BOUND * spread_m);
            it.fit.residual_m <= most_m
                && it.fit.tool_m.norm() < MAX_TOOL_M
                && (with_zero || self.agrees_at_base(block, chain, position, it.fit.lag_s))
        });
        let (is_at_base, ScoredFit { fit: way, score }) = match at_base {
            Some(fit) => (true, fit),
            None => {
                let found = fit(&stream)?;
                (false, ScoredFit { score: found.score + frame_price(track.xyz.len()), ..found })
            }
        };
        Some(ColumnMapping {
            arm: block.arm,
            joints: block.joints.clone(),
            unit: block.unit,
            position,
            residual_m: way.residual_m,
            spread_m,
            is_at_base,
            score,
            tool_m: way.tool_m.norm(),
            lag_s: way.lag_s,
        })
    }
}
