//! Relations between columns: time-shifted copies and rates.

use super::{MIN_MOVING_JOINTS, NumericTable, tolerated_range};
use crate::samples::sampling::range_of;
use ground::robot::Chain;
use ground::stats::{mean, median, parabola_minimum};

/// Between a column and another's rate.
const MIN_RATE_CORRELATION: f64 = 0.95;

/// Rows of a table in which three columns do not correlate with the rates of three others by chance.
const MIN_RATE_ROWS: usize = 8;

/// Time shift between two column groups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupShift {
    /// Delay of the second group.
    pub delay_s: f64,
    /// Residual after it, of the spread.
    pub residual: f64,
}

/// A column that is neither joint nor pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ColumnContent {
    /// Never changes.
    Constant,
    /// Two values.
    TwoLevels,
    /// Shifted copy of that column.
    CopyOf(usize, GroupShift),
    /// Rate of that column.
    RateOf(usize),
    /// Unrelated.
    Independent,
}

impl NumericTable {
    /// Shift of `others` relative to `columns`. `None` if their content differs.
    pub fn group_shift(&self, columns: &[usize], others: &[usize]) -> Option<GroupShift> {
        let series = |columns: &[usize]| -> Vec<Vec<f64>> {
            columns.iter().map(|&column| self.minus(column, self.mean(column))).collect()
        };
        self.shift_of(&series(columns), &series(others))
    }

    /// Shift of columns that differ by `offset` at rest; on a line, an offset would pass as a delay.
    pub fn shift_with_offset(
        &self,
        column: usize,
        other: usize,
        offset: f64,
    ) -> Option<GroupShift> {
        let mean = self.mean(column);
        self.shift_of(&[self.minus(column, mean)], &[self.minus(other, mean - offset)])
    }

    /// Whether four adjacent columns are a unit quaternion in each row, and two of them move.
    pub fn hold_quaternion(&self, columns: &[usize]) -> bool {
        const MAX_NORM_DEVIATION: f64 = 1e-3;
        const MIN_MOVING: usize = 2;
        columns.windows(4).any(|four| {
            let norm_squared =
                |row: usize| four.iter().map(|&at| self.columns[at][row].powi(2)).sum::<f64>();
            let is_unit = |row: usize| (norm_squared(row) - 1.0).abs() < MAX_NORM_DEVIATION;
            four.iter().filter(|&&at| self.moves(at)).count() >= MIN_MOVING
                && (0..self.t_s.len()).all(is_unit)
        })
    }

    fn mean(&self, column: usize) -> f64 {
        mean(self.columns[column].iter().copied())
    }

    fn minus(&self, column: usize, by: f64) -> Vec<f64> {
        self.columns[column].iter().map(|value| value - by).collect()
    }

    fn shift_of(&self, ours: &[Vec<f64>], theirs: &[Vec<f64>]) -> Option<GroupShift> {
        /// The residual is a share of the spread.
        const MAX_SHIFT_S: f64 = 1.0;
        const MAX_RESIDUAL_SHARE: f64 = 0.2;
        let rows = self.t_s.len();
        let step_s = self.step_s();
        let max_shift = ((MAX_SHIFT_S / step_s) as usize).min(rows / 4) as i64;
        let power = |series: &[f64]| mean(series.iter().map(|value| value * value));
        let moving: Vec<usize> = (0..ours.len()).filter(|&at| power(&ours[at]) > 1e-8).collect();
        let residual = |by: i64| -> f64 {
            let share = |&at: &usize| {
                let (first, end) = (by.max(0) as usize, (rows as i64 + by.min(0)) as usize);
                let difference =
                    |row: usize| theirs[at][row] - ours[at][(row as i64 - by) as usize];
                mean((first..end).map(|row| difference(row).powi(2))) / power(&ours[at])
            };
            moving.iter().map(share).fold(0.0, f64::max)
        };
        let best = (-max_shift..=max_shift)
            .map(|by| (residual(by), by))
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        let (min_residual, by) = best;
        if moving.len() < MIN_MOVING_JOINTS.min(ours.len())
            || min_residual.sqrt() > MAX_RESIDUAL_SHARE
        {
            return None;
        }
        let between = parabola_minimum([residual(by - 1), min_residual, residual(by + 1)]);
        let between = if min_residual == 0.0 { 0.0 } else { between.clamp(-0.5, 0.5) };
        Some(GroupShift { delay_s: (by as f64 + between) * step_s, residual: min_residual.sqrt() })
    }

    /// Median offset of `column` from `other`, and the number of rows at rest. `None` if they rest or move
    /// too little.
    pub fn offset_at_rest(&self, column: usize, other: usize) -> Option<(f64, usize)> {
        /// Share of the range over this time.
        const MAX_REST_CHANGE: f64 = 1e-3;
        const MIN_REST_S: f64 = 0.5;
        /// A single step is no motion.
        const MIN_REST_ROWS: usize = 20;
        const MIN_MOTION_S: f64 = 2.0;
        let reach = (0.5 * MIN_REST_S / self.step_s()).ceil() as usize;
        let both = [column, other].map(|column_index| {
            let [low, high] = self.ranges[column_index];
            (&self.columns[column_index], MAX_REST_CHANGE * (high - low))
        });
        let is_still = |row: usize| {
            both.iter().all(|(values, most)| {
                let neighbours = &values[row - reach..=row + reach];
                neighbours.iter().all(|value| (value - values[row]).abs() <= *most)
            })
        };
        let rows = (reach..self.t_s.len().saturating_sub(reach)).filter(|row| is_still(*row));
        let mut difference: Vec<f64> =
            rows.map(|row| self.columns[column][row] - self.columns[other][row]).collect();
        let count = difference.len();
        let moves_s = (self.t_s.len() - count) as f64 * self.step_s();
        let tells = count >= MIN_REST_ROWS && moves_s >= MIN_MOTION_S;
        median(&mut difference).filter(|_| tells).map(|difference| (difference, count))
    }

    /// Relation to the columns `others`.
    pub fn content(&self, column: usize, others: &[usize]) -> ColumnContent {
        if let Some(levels) = self.levels[column] {
            return levels;
        }
        let copies = others
            .iter()
            .filter_map(|&other| Some((other, self.group_shift(&[other], &[column])?)));
        if let Some((other, shift)) = copies.min_by(|a, b| a.1.residual.total_cmp(&b.1.residual)) {
            return ColumnContent::CopyOf(other, shift);
        }
        let best = others.iter().map(|&other| (self.rate_correlation(column, other), other));
        match best.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((correlation, other)) if correlation > MIN_RATE_CORRELATION => {
                ColumnContent::RateOf(other)
            }
            _ => ColumnContent::Independent,
        }
    }

    /// Zero in a table with too few rows.
    fn rate_correlation(&self, column: usize, of: usize) -> f64 {
        if self.t_s.len() < MIN_RATE_ROWS {
            return 0.0;
        }
        let values = normalized(self.inner_values(column).collect());
        correlation(&values, &normalized(self.rates(of).collect()))
    }

    /// Compares in that column's unit per second.
    pub(super) fn is_rate_of(&self, column: usize, of: usize) -> bool {
        /// Share of the column's mean square.
        const MAX_DEVIATION_SHARE: f64 = 0.05;
        let pairs = self.inner_values(column).zip(self.rates(of));
        let (differing, square) = pairs.fold((0.0, 0.0), |(differing, square), (value, rate)| {
            (differing + (value - rate).powi(2), square + value * value)
        });
        differing < MAX_DEVIATION_SHARE * square
    }

    /// Values of all rows but the first and last.
    fn inner_values(&self, column: usize) -> impl Iterator<Item = f64> + '_ {
        let values = &self.columns[column];
        (1..values.len().saturating_sub(1)).map(|row| values[row])
    }

    /// Central differences per second, for the same rows.
    fn rates(&self, column: usize) -> impl Iterator<Item = f64> + '_ {
        let values = &self.columns[column];
        (1..values.len().saturating_sub(1)).map(|row| {
            (values[row + 1] - values[row - 1]) / (self.t_s[row + 1] - self.t_s[row - 1])
        })
    }

    /// Columns of the rates of `columns`, at one index offset. Only columns that move are compared.
    pub fn rates_of(&self, columns: &[usize]) -> Option<Vec<usize>> {
        let count = self.columns.len();
        let moving: Vec<usize> = columns.iter().copied().filter(|&at| self.moves(at)).collect();
        let shifted = |by: isize| -> Option<Vec<usize>> {
            let shift = |&at: &usize| at.checked_add_signed(by).filter(|&at| at < count);
            let own: Vec<usize> = columns.iter().map(shift).collect::<Option<_>>()?;
            let is_its = |(&rate, &of): (&usize, &usize)| {
                self.homes[rate] == self.homes[of] && !columns.contains(&rate)
            };
            own.iter().zip(columns).all(is_its).then_some(own)
        };
        let shifts = (1..count as isize).flat_map(|by| [by, -by]);
        let are_rates = |rates: &Vec<usize>| {
            let mut pairs = columns.iter().zip(rates).filter(|(at, _)| moving.contains(at));
            pairs.all(|(&at, &rate)| self.rate_correlation(rate, at) > MIN_RATE_CORRELATION)
        };
        shifts.filter(|_| !moving.is_empty()).filter_map(shifted).find(are_rates)
    }

    /// Whether the numbers of some columns, in rad or m, are within the limits of the chain's joints.
    pub fn is_within_limits(&self, columns: &[usize], chain: &Chain) -> bool {
        columns.iter().zip(chain.limits()).all(|(&at, limits)| {
            let within = tolerated_range(limits);
            self.columns[at].iter().all(|value| within.contains(value))
        })
    }

    /// Longest run of columns followed by their rates at a constant offset. It may include columns that do
    /// not move.
    pub fn with_rates(&self) -> Option<(Vec<usize>, Vec<usize>)> {
        if self.t_s.len() < MIN_RATE_ROWS {
            return None;
        }
        let count = self.columns.len();
        let moves: Vec<bool> = (0..count).map(|column| self.moves(column)).collect();
        let of_all = |series: &dyn Fn(usize) -> Vec<f64>| -> Vec<Vec<f64>> {
            (0..count).map(|column| normalized(series(column))).collect()
        };
        let values = of_all(&|column| self.inner_values(column).collect());
        let rates = of_all(&|column| self.rates(column).collect());
        let mut best: Option<(usize, std::ops::Range<usize>, usize)> = None;
        // Positions and velocities share an array.
        let widest = self.homes.chunk_by(|a, b| a == b).map(<[_]>::len).max().unwrap_or(0);
        for behind in MIN_MOVING_JOINTS..widest {
            let is_pair = |at: &usize| {
                self.homes[*at] == self.homes[at + behind]
                    && (!moves[*at]
                        || correlation(&values[at + behind], &rates[*at]) > MIN_RATE_CORRELATION)
            };
            let mut from = 0;
            while from + MIN_MOVING_JOINTS + behind <= count {
                // Long enough runs that begin before this column contain it.
                if !is_pair(&(from + MIN_MOVING_JOINTS - 1)) {
                    from += MIN_MOVING_JOINTS;
                    continue;
                }
                let end = from + (from..count - behind).take_while(is_pair).count();
                let moving = (from..end).filter(|&at| moves[at]).count();
                if moving >= MIN_MOVING_JOINTS && best.as_ref().is_none_or(|best| moving > best.0) {
                    // If velocities follow directly, the offset is the number of joints.
                    let first = (from..end).find(|&at| moves[at]).unwrap_or(from);
                    let first = first.min(end.saturating_sub(behind).max(from));
                    best = Some((moving, first..end.min(first + behind), behind));
                }
                from = end + 1;
            }
        }
        let (_, own, behind) = best?;
        Some((own.clone().collect(), own.map(|at| at + behind).collect()))
    }
}

/// Whether all values are equal, or near one of two levels.
pub(super) fn levels(values: &[f64]) -> Option<ColumnContent> {
    /// Of their distance.
    const TOLERANCE: f64 = 0.02;
    let [low, high] = range_of(values.iter().copied());
    if low == high {
        return Some(ColumnContent::Constant);
    }
    let tolerance = TOLERANCE * (high - low);
    let are_two = values.iter().all(|value| value - low < tolerance || high - value < tolerance);
    are_two.then_some(ColumnContent::TwoLevels)
}

/// Without its mean, and of unit length; zero if it is constant or not finite.
fn normalized(mut series: Vec<f64>) -> Vec<f64> {
    let mean = mean(series.iter().copied());
    series.iter_mut().for_each(|value| *value -= mean);
    let length = series.iter().map(|value| value * value).sum::<f64>().sqrt();
    if length > 0.0 {
        series.iter_mut().for_each(|value| *value /= length);
    } else {
        series.fill(0.0);
    }
    series
}

/// Correlation of two normalized series.
fn correlation(values: &[f64], others: &[f64]) -> f64 {
    values.iter().zip(others).map(|(value, other)| value * other).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_alternates_with_the_rows_is_not_constant() {
        // Every second row of 200 Hz is left out.
        let rows = 0..2000;
        let columns = [
            rows.clone().map(|row| f64::from(2 + row % 2)).collect(),
            rows.clone().map(|_| 2.0).collect(),
            rows.clone().map(|row| f64::from(row % 3)).collect(),
        ];
        let t_s = rows.map(|row| 0.005 * f64::from(row)).collect();
        let table = NumericTable::new(t_s, columns.to_vec(), vec![0; 3]);
        let contents = [0, 1, 2].map(|column| table.content(column, &[]));
        let expected =
            [ColumnContent::TwoLevels, ColumnContent::Constant, ColumnContent::Independent];
        assert_eq!(contents, expected);
    }
}
