//! Resolution of encoders, from the values that they send.

/// Maximum deviation of a step from whole ticks, in ticks: rounding of the published numbers, and the difference of
/// chord and arc.
const MAX_DEVIATION_TICKS: f64 = 0.25;

/// Tick of a joint that moves over several ticks, and only by whole ones. `distance` is between two of `count` values;
/// steps up to `rounding` do not count. `None` also if every value differs from the last: motion at constant speed has
/// equal steps, too.
pub fn encoder_tick(
    count: usize,
    distance: impl Fn(usize, usize) -> f64,
    rounding: f64,
) -> Option<f64> {
    /// Larger steps would show the error of the least, not whether they are whole.
    const MAX_STEP_TICKS: f64 = 4.25;
    /// Noise at rest, and two publishers that differ, have fewer.
    const MIN_MOTION_TICKS: f64 = 4.0;
    let steps = || (1..count).map(|at| distance(at - 1, at));
    let moving = || steps().filter(|step| *step > rounding);
    let tick = moving().reduce(f64::min)?;
    let motion = (1..count).map(|at| distance(0, at)).fold(0.0, f64::max);
    let rests = steps().any(|step| step <= rounding);
    let mut few = moving().filter(|step| *step < MAX_STEP_TICKS * tick);
    (rests && motion > MIN_MOTION_TICKS * tick && few.all(|step| is_whole(step / tick)))
        .then_some(tick)
}

/// Whether it is an integer, within the error of steps.
pub fn is_whole(ticks: f64) -> bool {
    (ticks - ticks.round()).abs() < MAX_DEVIATION_TICKS
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: f64 = 1.5e-3;

    fn tick_of(values: &[f64]) -> Option<f64> {
        encoder_tick(values.len(), |a, b| (values[a] - values[b]).abs(), 1e-6)
    }

    fn rounded(motion: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..400).map(|row| (motion(f64::from(row) * 0.01) / TICK).round() * TICK).collect()
    }

    #[test]
    fn rounded_motion_shows_the_tick() {
        let found = tick_of(&rounded(|t_s| 0.05 * t_s.sin())).expect("a tick");
        assert!((found - TICK).abs() < 1e-9, "{found}");
    }

    #[test]
    fn motion_without_rounding_and_a_joint_that_flickers_have_no_tick() {
        let steady: Vec<f64> = (0..400).map(|row| f64::from(row) * 1e-3).collect();
        assert_eq!(tick_of(&steady), None);
        let sine: Vec<f64> = (0..400).map(|row| 0.05 * (f64::from(row) * 0.01).sin()).collect();
        assert_eq!(tick_of(&sine), None);
        let flicker: Vec<f64> = (0..400).map(|row| f64::from(row % 3 % 2) * TICK).collect();
        assert_eq!(tick_of(&flicker), None);
    }
}
