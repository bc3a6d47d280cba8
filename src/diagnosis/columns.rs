//! Which columns of a table are the joints of an arm and which the position of its tool.
//!
//! A point on the tool is linear in FK's position and rotation, whatever the frame, the unit and the tool:
//! `p = s·(R_b·(x + R·t)) + p_b`. So every block of columns that may be an arm's joints is held against all
//! other columns at once, by linear least squares. What comes near is then fitted as any stream is, with
//! latency, frame and tool free.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::PoseStream;
use super::model_fit::tool_fit;
use super::placement::metres_by_size;
use super::placing::spread;
use ground::geometry::{Convention, Rotation, Vec3, angle_between, rotation_from_xyzw};
use ground::robot::{Chain, JointKind};
use ground::stream::{JointTrack, Orientations, PoseTrack, sample_noise};

/// Rows that are looked at, and no more of them a second than this.
const MOST_ROWS: usize = 6000;
const MOST_HZ: f64 = 110.0;
/// Rows of the linear fits.
const FEW_ROWS: usize = 150;
/// Blocks that leave a larger share of the position's extent in the linear fit are not fitted.
const NEAR: f64 = 0.4;
/// Blocks that are fitted, and arms for each.
const MOST_FITS: usize = 12;
const MOST_ARMS: usize = 2;
/// Latencies at which blocks are sought, s: first without, then where nothing was near.
const LAGS_S: [&[f64]; 2] = [&[0.0], &[-0.4, -0.2, -0.1, 0.1, 0.2, 0.4]];
/// Arms of which a log may be that are also tried with latencies.
const FEW_ARMS: usize = 4;
/// Columns beyond these are not looked at.
const MOST_COLUMNS: usize = 128;
/// A position that a polynomial of time describes up to this share of its extent tells nothing: whatever moves
/// so smoothly follows anything.
const PLAIN: f64 = 0.05;
const DEGREE: i32 = 6;
/// Two turns: beyond them numbers are no rad, and beyond this many degrees no degrees.
const TWO_TURNS: f64 = 4.0 * PI;
/// A joint may stand so far beyond its limits, rad or m.
const BEYOND: f64 = 0.2;
/// A column moves that spreads by more, rad or m.
const MOVES: f64 = 0.01;
/// Joints of a block that must move.
const MOVING: usize = 3;
/// Noise from row to row beside the spread of a column that is a motion.
const NOISY: f64 = 0.2;
/// A position follows an arm where FK leaves no more, m, or this share of its extent.
const FITS_M: f64 = 3e-3;
const FITS_SHARE: f64 = 0.01;

/// The numbers of a table, by columns.
pub struct Sheet {
    t_s: Vec<f64>,
    columns: Vec<Vec<f64>>,
    /// The array that each column is of: no block reaches from one into another.
    homes: Vec<usize>,
}

/// What is sought.
pub struct Wanted<'a> {
    /// The arms that it may be.
    pub chains: &'a [&'a Chain],
    /// The columns of the joints as each of the arms has them, where they are known; these are rad.
    pub joints: Option<&'a [Vec<usize>]>,
    /// The columns of the position, where they are known.
    pub position: Option<[usize; 3]>,
    /// Columns that are something else.
    pub taken: &'a [usize],
    /// The longest latency, s.
    pub most_lag_s: f64,
}

/// A way to take columns for joints and position.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// The arm, by its place.
    pub arm: usize,
    /// The columns of its joints, from base to tip.
    pub joints: Vec<usize>,
    /// Whether these are degrees.
    pub degrees: bool,
    /// The columns of the position.
    pub position: [usize; 3],
    /// What FK leaves of the position, rms m, and how far that spreads.
    pub left_m: f64,
    /// Rms distance of the positions from their mean, m.
    pub spread_m: f64,
    /// How far the point is from the arm's tip, m.
    pub tool_m: f64,
    /// By how much the position is late, s.
    pub lag_s: f64,
}

impl Mapping {
    /// Whether FK and the position agree.
    pub fn fits(&self) -> bool {
        self.left_m <= FITS_M.max(FITS_SHARE * self.spread_m)
    }

    /// Whether it takes the same columns for the same.
    pub fn is_same(&self, other: &Self) -> bool {
        let of = |it: &Self| (it.joints.clone(), it.degrees, it.position);
        of(self) == of(other)
    }
}

/// How some columns say what others do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// By how much they say it later, s.
    pub later_s: f64,
    /// What differs beside that, as a share of the spread.
    pub left: f64,
}

/// A block of columns that may be joints of an arm.
struct Block {
    joints: Vec<usize>,
    degrees: bool,
    arm: usize,
}

impl Sheet {
    /// Rows at times that rise; of many as many as tell, where they move most.
    pub fn new(t_s: Vec<f64>, columns: Vec<Vec<f64>>, homes: Vec<usize>) -> Self {
        let span_s = t_s.last().zip(t_s.first()).map_or(0.0, |(last, first)| last - first);
        let rate_hz = t_s.len() as f64 / span_s.max(f64::MIN_POSITIVE);
        let step = (rate_hz / MOST_HZ).ceil().max(1.0) as usize;
        let rows: Vec<usize> = (0..t_s.len()).step_by(step).collect();
        let first = rows.len().saturating_sub(MOST_ROWS);
        let first = if first == 0 { 0 } else { liveliest(&rows, &columns) };
        let rows = &rows[first..(first + MOST_ROWS).min(rows.len())];
        let pick = |values: &Vec<f64>| rows.iter().map(|&row| values[row]).collect();
        Self { t_s: pick(&t_s), columns: columns.iter().map(pick).collect(), homes }
    }

    /// The time between two rows, s.
    pub fn step_s(&self) -> f64 {
        let span_s =
            self.t_s.last().zip(self.t_s.first()).map_or(0.0, |(last, first)| last - first);
        span_s / (self.t_s.len().max(2) - 1) as f64
    }

    /// The array that a column is of.
    pub fn home(&self, column: usize) -> usize {
        self.homes[column]
    }

    /// Whether a column is that number in each row.
    pub fn is_always(&self, column: usize, value: f64) -> bool {
        self.columns[column].iter().all(|own| *own == value)
    }

    /// The ways to take columns for the joints of one of the arms and the position of its tool, of those that
    /// come nearest; what FK leaves least of first.
    pub fn mappings(&self, wanted: &Wanted) -> Vec<Mapping> {
        /// Ways that are tried with the zero of a joint, where none fits without.
        const WITH_ZERO: usize = 4;
        let of =
            |(block, position): &(Block, [usize; 3])| self.fit(wanted, block, *position, false);
        for lags_s in &LAGS_S[..if wanted.chains.len() > FEW_ARMS { 1 } else { 2 }] {
            let near = self.near(wanted, lags_s);
            let mut all: Vec<Mapping> = near.par_iter().filter_map(of).collect();
            if !all.iter().any(Mapping::fits) {
                all.sort_by(|a, b| a.left_m.total_cmp(&b.left_m));
                all.truncate(WITH_ZERO);
                let anew = |it: &Mapping| {
                    let block =
                        Block { joints: it.joints.clone(), degrees: it.degrees, arm: it.arm };
                    self.fit(wanted, &block, it.position, true)
                };
                all = all.par_iter().filter_map(anew).collect();
            }
            all.sort_by(|a, b| a.left_m.total_cmp(&b.left_m));
            let mut mappings: Vec<Mapping> = Vec::new();
            for mapping in all {
                if !mappings.iter().any(|other| other.is_same(&mapping)) {
                    mappings.push(mapping);
                }
            }
            if mappings.iter().any(Mapping::fits) {
                return mappings;
            }
        }
        Vec::new()
    }

    /// The blocks that may be joints of `arm` by their numbers: smooth, and within its limits.
    pub fn blocks(&self, chain: &Chain, taken: &[usize]) -> Vec<(Vec<usize>, bool)> {
        let dof = chain.dof();
        let mut homes: Vec<usize> = self.homes.clone();
        homes.sort_unstable();
        homes.dedup();
        let mut blocks = Vec::new();
        for home in homes {
            let own: Vec<usize> =
                (0..self.columns.len()).filter(|&column| self.homes[column] == home).collect();
            // Positions may stand beside their velocities and efforts, joint by joint.
            for stride in 1..=3 {
                let wide = (dof - 1) * stride + 1;
                for window in own.windows(wide) {
                    let joints: Vec<usize> = window.iter().copied().step_by(stride).collect();
                    if joints.iter().any(|column| taken.contains(column)) {
                        continue;
                    }
                    if let Some(degrees) = self.unit(&joints, chain) {
                        blocks.push((joints, degrees));
                    }
                }
            }
        }
        blocks
    }

    /// Whether columns are degrees, as joints of an arm; `None` where they are no joints of it.
    fn unit(&self, joints: &[usize], chain: &Chain) -> Option<bool> {
        let turning =
            || (0..joints.len()).filter(|&at| chain.joint_kinds()[at] != JointKind::Prismatic);
        let most = turning()
            .map(|at| self.range(joints[at]))
            .fold(0.0, |most: f64, [low, high]| most.max(low.abs()).max(high.abs()));
        let degrees = most > TWO_TURNS;
        let mut moving = 0;
        for (at, &column) in joints.iter().enumerate() {
            let slides = chain.joint_kinds()[at] == JointKind::Prismatic;
            let factor = if degrees && !slides { 1_f64.to_radians() } else { 1.0 };
            let [low, high] = self.range(column).map(|end| factor * end);
            let limits = chain.limits()[at];
            let is_beyond = low < limits.lower.unwrap_or(-TWO_TURNS) - BEYOND
                || high > limits.upper.unwrap_or(TWO_TURNS) + BEYOND;
            if is_beyond || !(high - low).is_finite() {
                return None;
            }
            if high - low > MOVES {
                moving += 1;
                if factor * sample_noise(&self.columns[column]) > NOISY * (high - low) {
                    return None;
                }
            }
        }
        (moving >= MOVING).then_some(degrees)
    }

    fn range(&self, column: usize) -> [f64; 2] {
        let ends = [f64::INFINITY, f64::NEG_INFINITY];
        self.columns[column].iter().fold(ends, |[low, high], &q| [low.min(q), high.max(q)])
    }

    /// The triples of columns that may be a position.
    pub fn positions(&self, taken: &[usize]) -> Vec<[usize; 3]> {
        let count = self.columns.len();
        // Of a matrix, row by row, every fourth number is of the position.
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

    /// Blocks and positions that come near by a linear fit, the nearest first.
    fn near(&self, wanted: &Wanted, lags_s: &[f64]) -> Vec<(Block, [usize; 3])> {
        let rows = self.few_rows();
        if rows.len() < FEW_ROWS / 3 || self.columns.len() > MOST_COLUMNS {
            return Vec::new();
        }
        let logged = DMatrix::from_fn(rows.len(), self.columns.len(), |row, column| {
            self.columns[column][rows[row]]
        });
        let logged = centred(logged);
        let span_s = self.t_s[rows[rows.len() - 1]] - self.t_s[rows[0]];
        let plain = DMatrix::from_fn(rows.len(), DEGREE as usize, |row, power| {
            ((self.t_s[rows[row]] - self.t_s[rows[0]]) / span_s - 0.5).powi(1 + power as i32)
        });
        let plain = left_of(&centred(plain), &logged);
        let mut positions = match wanted.position {
            Some(position) => vec![position],
            None => self.positions(wanted.taken),
        };
        positions.retain(|position| {
            let own: f64 = position.iter().map(|&c| logged.column(c).norm_squared()).sum();
            position.iter().map(|&c| plain[c]).sum::<f64>() > PLAIN.powi(2) * own
        });
        let blocks: Vec<Block> = wanted
            .chains
            .iter()
            .enumerate()
            .flat_map(|(arm, chain)| {
                let blocks = match wanted.joints {
                    Some(joints) if joints[arm].len() == chain.dof() => {
                        vec![(joints[arm].clone(), false)]
                    }
                    Some(_) => Vec::new(),
                    None => self.blocks(chain, wanted.taken),
                };
                blocks.into_iter().map(move |(joints, degrees)| Block { joints, degrees, arm })
            })
            .collect();
        let tried: Vec<(&Block, f64)> = blocks
            .iter()
            .flat_map(|block| lags_s.iter().map(move |&lag_s| (block, lag_s)))
            .collect();
        let of = |(at, &(block, lag_s)): (usize, &(&Block, f64))| {
            let chain = wanted.chains[block.arm];
            let design = self.design(block, chain, &rows, lag_s);
            let left = left_of(&design, &logged);
            let shares = positions.iter().filter_map(|position| {
                if position.iter().any(|column| block.joints.contains(column)) {
                    return None;
                }
                let own: f64 = position.iter().map(|&c| logged.column(c).norm_squared()).sum();
                let left: f64 = position.iter().map(|&c| left[c]).sum();
                let moving = position
                    .iter()
                    .filter(|&&c| logged.column(c).norm_squared() > 1e-4 * own)
                    .count();
                let share = (left / own).max(0.0).sqrt();
                (own > 0.0 && moving > 1 && share < NEAR).then_some((share, at, *position))
            });
            shares.collect::<Vec<_>>()
        };
        let mut near: Vec<(f64, usize, [usize; 3])> =
            tried.par_iter().enumerate().flat_map_iter(of).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut kept: Vec<(Block, [usize; 3])> = Vec::new();
        let (mut ways, mut counts): (Vec<(&[usize], [usize; 3])>, Vec<usize>) =
            (Vec::new(), Vec::new());
        for (_, at, position) in near {
            let block = tried[at].0;
            let way = (block.joints.as_slice(), position);
            let known = ways.iter().position(|other| *other == way);
            let way = match known {
                Some(way) => way,
                None if ways.len() == MOST_FITS => continue,
                None => {
                    ways.push(way);
                    counts.push(0);
                    ways.len() - 1
                }
            };
            let is_new = |(kept, at): &(Block, [usize; 3])| {
                kept.arm != block.arm || kept.joints != block.joints || *at != position
            };
            if counts[way] < MOST_ARMS && kept.iter().all(is_new) {
                counts[way] += 1;
                let (joints, degrees, arm) = (block.joints.clone(), block.degrees, block.arm);
                kept.push((Block { joints, degrees, arm }, position));
            }
        }
        kept
    }

    /// Some rows, none so near to an end that a latency leads beyond it.
    fn few_rows(&self) -> Vec<usize> {
        let longest_s = LAGS_S[1].iter().copied().fold(0.0, f64::max);
        let (Some(first), Some(last)) = (self.t_s.first(), self.t_s.last()) else {
            return Vec::new();
        };
        let margin_s = longest_s.min(0.1 * (last - first));
        let inner = self.t_s.iter().enumerate();
        let inner = inner.filter(|(_, t_s)| (first + margin_s..last - margin_s).contains(t_s));
        let inner: Vec<usize> = inner.map(|(row, _)| row).collect();
        let count = FEW_ROWS.min(inner.len());
        (0..count).map(|at| inner[at * inner.len() / count]).collect()
    }

    /// FK's position and rotation at some rows, centred.
    fn design(&self, block: &Block, chain: &Chain, rows: &[usize], lag_s: f64) -> DMatrix<f64> {
        const NUMBERS: usize = 12;
        let mut design = DMatrix::zeros(rows.len(), NUMBERS);
        for (at, &row) in rows.iter().enumerate() {
            let pose = chain.forward(&self.joints_at(block, chain, self.t_s[row] - lag_s));
            let turn = pose.rotation.to_rotation_matrix();
            let numbers = pose.translation.vector.iter().chain(turn.matrix().iter());
            numbers.enumerate().for_each(|(column, number)| design[(at, column)] = *number);
        }
        centred(design)
    }

    /// Positions of the joints at a time, between rows along a line.
    fn joints_at(&self, block: &Block, chain: &Chain, t_s: f64) -> Vec<f64> {
        let after = self.t_s.partition_point(|t| *t < t_s).clamp(1, self.t_s.len() - 1);
        let (before_s, after_s) = (self.t_s[after - 1], self.t_s[after]);
        let share = ((t_s - before_s) / (after_s - before_s)).clamp(0.0, 1.0);
        let at = |(joint, &column): (usize, &usize)| {
            let values = &self.columns[column];
            let q = values[after - 1] + share * (values[after] - values[after - 1]);
            factor(block.degrees, chain.joint_kinds()[joint]) * q
        };
        block.joints.iter().enumerate().map(at).collect()
    }

    /// The block as joints of its arm, and the position as that of its tool.
    fn fit(
        &self,
        wanted: &Wanted,
        block: &Block,
        position: [usize; 3],
        with_zero: bool,
    ) -> Option<Mapping> {
        let chain = wanted.chains[block.arm];
        let joints = self.track(block, chain);
        let track = self.position(position);
        let columns: Vec<usize> = (0..chain.dof()).collect();
        let stream = PoseStream {
            track: &track,
            chain,
            columns: &columns,
            reference_known: false,
            stamp_error_s: 0.0,
            stamps_copied: false,
        };
        let way = tool_fit(&joints, &stream, wanted.most_lag_s, with_zero)?;
        let metres = metres_by_size(&joints, &stream);
        Some(Mapping {
            arm: block.arm,
            joints: block.joints.clone(),
            degrees: block.degrees,
            position,
            left_m: way.left_m,
            spread_m: metres * spread(&track.xyz),
            tool_m: way.tool_m.norm(),
            lag_s: way.lag_s,
        })
    }

    fn position(&self, columns: [usize; 3]) -> PoseTrack {
        let xyz = |row: usize| Vec3::from(columns.map(|column| self.columns[column][row]));
        PoseTrack {
            t_s: self.t_s.clone(),
            xyz: (0..self.t_s.len()).map(xyz).collect(),
            orientation: Orientations::Unset(self.t_s.len()),
            declared: None,
        }
    }

    fn track(&self, block: &Block, chain: &Chain) -> JointTrack {
        let rows = self.t_s.len();
        let dof = block.joints.len();
        let (mut q, mut qd) = (vec![0.0; rows * dof], vec![0.0; rows * dof]);
        for (joint, &column) in block.joints.iter().enumerate() {
            let values = &self.columns[column];
            let factor = factor(block.degrees, chain.joint_kinds()[joint]);
            for row in 0..rows {
                let (before, after) = (row.saturating_sub(1), (row + 1).min(rows - 1));
                let h = self.t_s[after] - self.t_s[before];
                q[row * dof + joint] = factor * values[row];
                qd[row * dof + joint] = factor * (values[after] - values[before]) / h;
            }
        }
        JointTrack { t_s: self.t_s.clone(), dof, q, qd }
    }

    /// How `others` say what `columns` do, where they do: each is multiplied by its factor.
    pub fn shift(&self, columns: (&[usize], f64), others: (&[usize], f64)) -> Option<Shift> {
        /// The longest, s, and what differs of columns that are the same, as a share of the spread.
        const LONGEST_S: f64 = 1.0;
        const SAME: f64 = 0.2;
        let rows = self.t_s.len();
        let step_s = (self.t_s.last()? - self.t_s.first()?) / (rows.max(2) - 1) as f64;
        let most = ((LONGEST_S / step_s) as usize).min(rows / 4) as i64;
        let series = |(columns, factor): (&[usize], f64)| -> Vec<Vec<f64>> {
            let own = columns.iter().map(|&column| {
                let values = &self.columns[column];
                let mean = values.iter().sum::<f64>() / rows as f64;
                values.iter().map(|value| factor * (value - mean)).collect()
            });
            own.collect()
        };
        let (these, those) = (series(columns), series(others));
        let power =
            |series: &[f64]| series.iter().map(|value| value * value).sum::<f64>() / rows as f64;
        let moving: Vec<usize> = (0..these.len()).filter(|&at| power(&these[at]) > 1e-8).collect();
        let left = |by: i64| -> f64 {
            let share = |&at: &usize| {
                let (first, end) = (by.max(0) as usize, (rows as i64 + by.min(0)) as usize);
                let apart = (first..end)
                    .map(|row| (those[at][row] - these[at][(row as i64 - by) as usize]).powi(2));
                apart.sum::<f64>() / (end - first) as f64 / power(&these[at])
            };
            moving.iter().map(share).fold(0.0, f64::max)
        };
        let best = (-most..=most).map(|by| (left(by), by)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (least, by) = best;
        if moving.len() < MOVING.min(columns.0.len()) || least.sqrt() > SAME {
            return None;
        }
        let (before, after) = (left(by - 1), left(by + 1));
        let bend = before - 2.0 * least + after;
        let between = if bend > 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
        let between = if least == 0.0 { 0.0 } else { between.clamp(-0.5, 0.5) };
        Some(Shift { later_s: (by as f64 + between) * step_s, left: least.sqrt() })
    }

    /// Whether columns are the rotation of the tool: 3 numbers by some convention, 4 of a quaternion in any
    /// order, or 9 of a matrix. `None` where the tool hardly turns. Angles between poses tell it, which depend
    /// on no frame, no tool and no order of components.
    pub fn turns_with(&self, mapping: &Mapping, chain: &Chain, columns: &[usize]) -> Option<bool> {
        /// Rows that are compared, what may differ, rad, and how far the tool must turn, rad.
        const ROWS: usize = 60;
        const APART_RAD: f64 = 0.05;
        const TURNS_RAD: f64 = 0.2;
        let all = self.few_rows();
        let rows: Vec<usize> =
            all.iter().copied().step_by(all.len().div_ceil(ROWS).max(1)).collect();
        let (joints, degrees, arm) = (mapping.joints.clone(), mapping.degrees, mapping.arm);
        let block = Block { joints, degrees, arm };
        let fk: Vec<Rotation> = rows
            .iter()
            .map(|&row| {
                let q = self.joints_at(&block, chain, self.t_s[row] - mapping.lag_s);
                chain.forward(&q).rotation
            })
            .collect();
        let pairs: Vec<(usize, usize)> =
            (1..rows.len()).flat_map(|at| [(0, at), (at - 1, at), (at / 2, at)]).collect();
        let rms = |angle: &dyn Fn(usize, usize) -> f64, other: &dyn Fn(usize, usize) -> f64| {
            let apart = pairs.iter().map(|&(a, b)| (angle(a, b) - other(a, b)).powi(2));
            (apart.sum::<f64>() / pairs.len().max(1) as f64).sqrt()
        };
        let expected = |a: usize, b: usize| angle_between(&fk[a], &fk[b]);
        let turns_rad = rms(&expected, &|_, _| 0.0);
        if turns_rad < TURNS_RAD {
            return None;
        }
        let number = |row: usize, at: usize| self.columns[columns[at]][rows[row]];
        let most = APART_RAD.min(0.15 * turns_rad);
        let is_it = |all: Option<Vec<Rotation>>| {
            all.is_some_and(|all| rms(&expected, &|a, b| angle_between(&all[a], &all[b])) < most)
        };
        let norms_are_one = |of: usize| {
            let norm =
                |row: usize| (0..columns.len()).map(|at| number(row, at).powi(2)).sum::<f64>();
            (0..rows.len()).all(|row| (norm(row) / of as f64 - 1.0).abs() < 0.02)
        };
        Some(match columns.len() {
            3 => [1.0, 1_f64.to_radians()].into_iter().any(|unit| {
                Convention::all().iter().any(|convention| {
                    let read =
                        |row| convention.rotation([0, 1, 2].map(|at| unit * number(row, at)));
                    is_it(Some((0..rows.len()).map(read).collect()))
                })
            }),
            4 if norms_are_one(1) => {
                let read = |row| rotation_from_xyzw([0, 1, 2, 3].map(|at| number(row, at)));
                is_it((0..rows.len()).map(read).collect())
            }
            9 if norms_are_one(3) => {
                let angle = |a: usize, b: usize| {
                    let trace: f64 = (0..9).map(|at| number(a, at) * number(b, at)).sum();
                    (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos()
                };
                rms(&expected, &angle) < most
            }
            _ => false,
        })
    }
}

fn factor(degrees: bool, kind: JointKind) -> f64 {
    if degrees && kind != JointKind::Prismatic { 1_f64.to_radians() } else { 1.0 }
}

/// Where the rows begin that move most.
fn liveliest(rows: &[usize], columns: &[Vec<f64>]) -> usize {
    let spreads: Vec<f64> = columns
        .iter()
        .map(|values| {
            let (low, high) = values
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
            high - low
        })
        .collect();
    let step = |pair: &[usize]| -> f64 {
        let of = |(values, spread): (&Vec<f64>, &f64)| {
            let step = (values[pair[1]] - values[pair[0]]).abs() / spread;
            if step.is_finite() { step } else { 0.0 }
        };
        columns.iter().zip(&spreads).map(of).sum()
    };
    let mut sums = vec![0.0];
    for pair in rows.windows(2) {
        sums.push(sums.last().copied().unwrap_or(0.0) + step(pair));
    }
    let starts = (0..rows.len() - MOST_ROWS).step_by(MOST_ROWS / 10);
    let moved = |start: &usize| sums[start + MOST_ROWS - 1] - sums[*start];
    starts.max_by(|a, b| moved(a).total_cmp(&moved(b))).unwrap_or(0)
}

fn centred(mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in matrix.column_iter_mut() {
        let mean = column.mean();
        column.add_scalar_mut(-mean);
    }
    matrix
}

/// The squares that `design` leaves of each column of `logged`, as of so many rows as are not fitted.
fn left_of(design: &DMatrix<f64>, logged: &DMatrix<f64>) -> DVector<f64> {
    const RIDGE: f64 = 1e-9;
    let mut normal = design.transpose() * design;
    let ridge = RIDGE * normal.trace().max(f64::MIN_POSITIVE);
    (0..normal.nrows()).for_each(|at| normal[(at, at)] += ridge);
    let right = design.transpose() * logged;
    let own = |column: usize| logged.column(column).norm_squared();
    let free = (logged.nrows() as f64 / (logged.nrows() as f64 - 13.0)).max(1.0);
    match normal.cholesky() {
        Some(factor) => {
            let solved = factor.l().solve_lower_triangular(&right).unwrap_or(right * 0.0);
            DVector::from_fn(logged.ncols(), |column, _| {
                free * (own(column) - solved.column(column).norm_squared()).max(0.0)
            })
        }
        None => DVector::from_fn(logged.ncols(), |column, _| own(column)),
    }
}

/// What a column that is neither joint nor pose does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Conduct {
    /// It never changes.
    Constant,
    /// It takes two values.
    TwoLevels,
    /// It says what that column says, by a shift.
    As(usize, Shift),
    /// It is the rate of that column.
    RateOf(usize),
    /// It follows none.
    Own,
}

impl Sheet {
    /// What a column does beside some others.
    pub fn conduct(&self, column: usize, beside: &[usize]) -> Conduct {
        /// Rates correlate by this at least.
        const RATE: f64 = 0.95;
        let values = &self.columns[column];
        let [low, high] = self.range(column);
        if low == high {
            return Conduct::Constant;
        }
        let near = 0.02 * (high - low);
        if values.iter().all(|value| value - low < near || high - value < near) {
            return Conduct::TwoLevels;
        }
        let same = beside
            .iter()
            .filter_map(|&other| Some((other, self.shift((&[other], 1.0), (&[column], 1.0))?)));
        if let Some((other, shift)) = same.min_by(|a, b| a.1.left.total_cmp(&b.1.left)) {
            return Conduct::As(other, shift);
        }
        let rate = |other: usize| -> f64 {
            let own = &self.columns[other];
            let rows = 1..own.len().saturating_sub(1);
            let pairs = rows.map(|row| {
                let h = self.t_s[row + 1] - self.t_s[row - 1];
                (values[row], (own[row + 1] - own[row - 1]) / h)
            });
            correlation(&pairs.collect::<Vec<_>>())
        };
        let best = beside.iter().map(|&other| (rate(other), other));
        match best.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((correlation, other)) if correlation > RATE => Conduct::RateOf(other),
            _ => Conduct::Own,
        }
    }
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len().max(1) as f64;
    let (a, b) = pairs.iter().fold((0.0, 0.0), |(a, b), pair| (a + pair.0 / n, b + pair.1 / n));
    let sums = pairs.iter().fold([0.0; 3], |[aa, bb, ab], pair| {
        let (x, y) = (pair.0 - a, pair.1 - b);
        [aa + x * x, bb + y * y, ab + x * y]
    });
    let size = (sums[0] * sums[1]).sqrt();
    if size > 0.0 { sums[2] / size } else { 0.0 }
}
