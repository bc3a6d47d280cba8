//! Constant maps from a joint's command to its state: direction, scale and offset.

use crate::samples::sampling::range_of;
use ground::stats::{Measured, mean, quantile};

/// Line `state = gain · command + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMap {
    /// Motion of the state per motion of the command. Exactly 1 or −1 if that fits as well.
    pub gain: Measured,
    /// State at a command of zero, rad or m.
    pub offset: Measured,
}

/// A command and the state that it caused.
#[derive(Clone, Copy, Debug)]
pub(super) struct CommandedState {
    pub t_s: f64,
    pub command: f64,
    pub state: f64,
}

/// Share of the samples that a line must describe. The rest may be pauses, contacts and outliers.
const DESCRIBED_SHARE: f64 = 0.9;

#[derive(Clone, Copy)]
struct Line {
    gain: f64,
    offset: f64,
}

impl Line {
    fn residual(&self, sample: &CommandedState) -> f64 {
        sample.state - self.gain * sample.command - self.offset
    }

    /// Largest residual of the samples that it describes.
    fn misfit(&self, samples: &[CommandedState]) -> f64 {
        let mut sizes: Vec<f64> =
            samples.iter().map(|sample| self.residual(sample).abs()).collect();
        quantile(&mut sizes, DESCRIBED_SHARE).unwrap_or(f64::INFINITY)
    }

    /// Least trimmed squares, by concentration steps (Rousseeuw and Van Driessen 2006). The gain is free unless given.
    fn fit(samples: &[CommandedState], gain: Option<f64>) -> Self {
        const CONCENTRATION_STEPS: usize = 5;
        let mut line = Self::least_squares(samples, gain);
        for _ in 0..CONCENTRATION_STEPS {
            let limit = line.misfit(samples);
            let is_described = |sample: &&CommandedState| line.residual(sample).abs() <= limit;
            let described: Vec<CommandedState> =
                samples.iter().filter(is_described).copied().collect();
            line = Self::least_squares(&described, gain);
        }
        line
    }

    fn least_squares(samples: &[CommandedState], gain: Option<f64>) -> Self {
        let (command, state) = means(samples);
        let gain = gain.unwrap_or_else(|| {
            let product = |sample: &CommandedState| {
                let from_mean = sample.command - command;
                [from_mean * (sample.state - state), from_mean * from_mean]
            };
            let [joint, square] = samples
                .iter()
                .map(product)
                .fold([0.0; 2], |sum, next| [sum[0] + next[0], sum[1] + next[1]]);
            joint / square.max(f64::MIN_POSITIVE)
        });
        Self { gain, offset: state - gain * command }
    }
}

fn means(samples: &[CommandedState]) -> (f64, f64) {
    let of = |value: fn(&CommandedState) -> f64| mean(samples.iter().map(value));
    (of(|sample| sample.command), of(|sample| sample.state))
}

impl JointMap {
    /// `None` if the command itself describes the state about as well as a line, or if no line describes it.
    pub(super) fn fit(samples: &[CommandedState]) -> Option<Self> {
        /// Two are needed for a line, and the others must confirm it.
        const FEWEST: usize = 5;
        /// Share of the error of the command itself that a line may leave.
        const MAX_MISFIT_SHARE: f64 = 0.2;
        /// From the specification: 1 µrad and 1 µm.
        const NOISE_FLOOR: f64 = 1e-6;
        /// A gain this close to 1 or −1 is a controller's stiffness, not a scale.
        const MAX_UNIT_GAIN_DEVIATION: f64 = 0.02;
        /// Misfit relative to that of a free gain, up to which a gain of 1 or −1 fits as well.
        const MAX_UNIT_MISFIT_RATIO: f64 = 1.5;
        let [low, high] = range_of(samples.iter().map(|sample| sample.command));
        if samples.len() < FEWEST || low >= high {
            return None;
        }
        let free = Line::fit(samples, None);
        let unit = Line::fit(samples, Some(1.0_f64.copysign(free.gain)));
        let is_unit = (free.gain - unit.gain).abs() <= MAX_UNIT_GAIN_DEVIATION
            || unit.misfit(samples) <= MAX_UNIT_MISFIT_RATIO * free.misfit(samples);
        let line = if is_unit { unit } else { free };
        let command_misfit = Line { gain: 1.0, offset: 0.0 }.misfit(samples);
        let is_described = line.misfit(samples) < MAX_MISFIT_SHARE * command_misfit;
        if command_misfit < NOISE_FLOOR || !is_described {
            return None;
        }
        let [gain, offset] = line.uncertainty(samples, !is_unit);
        Some(Self { gain, offset })
    }
}

impl Line {
    /// Gain and offset with standard errors for any correlation within blocks (Liang and Zeger 1986). An offset that
    /// changes between rests therefore widens them.
    fn uncertainty(&self, samples: &[CommandedState], is_gain_free: bool) -> [Measured; 2] {
        const MAX_BLOCKS: f64 = 40.0;
        const MIN_BLOCK_S: f64 = 0.5;
        let (mean_command, _) = means(samples);
        let count = samples.len() as f64;
        let from_mean = |sample: &CommandedState| sample.command - mean_command;
        let square: f64 = samples.iter().map(|sample| from_mean(sample).powi(2)).sum();
        let [first_s, last_s] = range_of(samples.iter().map(|sample| sample.t_s));
        let block_s = ((last_s - first_s) / MAX_BLOCKS).max(MIN_BLOCK_S);
        let mut blocks = std::collections::BTreeMap::new();
        for sample in samples {
            let residual = self.residual(sample);
            let gain = match is_gain_free {
                true => from_mean(sample) * residual / square.max(f64::MIN_POSITIVE),
                false => 0.0,
            };
            let block = ((sample.t_s - first_s) / block_s) as u64;
            let sums: &mut [f64; 2] = blocks.entry(block).or_default();
            sums[0] += gain;
            sums[1] += residual / count - mean_command * gain;
        }
        let used = blocks.len() as f64;
        let std_error = |at: usize| {
            let square: f64 = blocks.values().map(|sums| sums[at] * sums[at]).sum();
            (square * used / (used - 1.0)).sqrt()
        };
        let dof = used - 1.0;
        let measured = |value, at| Measured { value, std_error: std_error(at), dof };
        match used < 2.0 {
            true => [self.gain, self.offset].map(|value| Measured {
                value,
                std_error: f64::INFINITY,
                dof: 1.0,
            }),
            false => [measured(self.gain, 0), measured(self.offset, 1)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_motion::noise;

    fn mapped(state_of: impl Fn(usize, f64) -> f64) -> Option<JointMap> {
        let sample = |row: usize| {
            let t_s = 0.02 * row as f64;
            let command = 0.4 + 0.5 * (1.1 * t_s).sin() + 0.3 * (2.3 * t_s).sin();
            CommandedState { t_s, command, state: state_of(row, command) + 1e-3 * noise(row) }
        };
        JointMap::fit(&(0..1000).map(sample).collect::<Vec<_>>())
    }

    #[test]
    fn direction_scale_and_offset_are_estimated_with_outliers() {
        for (gain, offset) in [(-1.0, 0.0), (1.0, 1.57), (-1.0, -1.57), (2.0, 0.0), (0.5, 0.3)] {
            let outlier = |row: usize| if row.is_multiple_of(20) { 2.0 } else { 0.0 };
            let found = mapped(|row, command| gain * command + offset + outlier(row));
            let found = found.unwrap_or_else(|| panic!("{gain} {offset}"));
            assert!((found.gain.value - gain).abs() < 2e-3, "{found:?}");
            assert!((found.offset.value - offset).abs() < 2e-3, "{found:?}");
            assert_eq!(found.gain.std_error == 0.0, f64::abs(gain) == 1.0, "{found:?}");
        }
    }

    #[test]
    fn a_state_at_its_command_or_with_a_changing_offset_has_no_map() {
        assert_eq!(mapped(|_, command| command), None);
        let changing = |row: usize| if row < 500 { 0.2 } else { 1.2 };
        assert_eq!(mapped(|row, command| command + changing(row)), None);
        assert_eq!(mapped(|row, _| noise(7 * row)), None);
    }

    #[test]
    fn an_offset_that_changes_a_little_has_a_wide_interval() {
        let changing = |row: usize| if row < 500 { 1.4 } else { 1.6 };
        let found = mapped(|row, command| command + changing(row)).expect("an offset");
        assert!(found.offset.half_width(0.95) > 0.02, "{found:?}");
    }
}
