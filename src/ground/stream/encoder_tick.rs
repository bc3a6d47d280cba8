//! Resolution of encoders, from the steps between successive values.

/// Maximum deviation of a step from whole ticks, in ticks: rounding of the published numbers, and the difference of
/// chord and arc.
const MAX_DEVIATION_TICKS: f64 = 0.25;

/// Tick of values that move only by whole ticks. Steps up to `rounding` do not count. `None` if they move otherwise, or
/// if every value differs from the last: motion at constant speed has equal steps, too.
pub fn tick_of_steps(steps: impl Iterator<Item = f64>, rounding: f64) -> Option<f64> {
    /// Larger steps would show the error of the least, not whether they are whole.
    const MAX_TICKS: f64 = 4.25;
    let all: Vec<f64> = steps.collect();
    let moving = || all.iter().copied().filter(|step| *step > rounding);
    let tick = moving().reduce(f64::min)?;
    let mut few = moving().filter(|step| *step < MAX_TICKS * tick);
    let rests = moving().count() < all.len();
    (rests && few.all(|step| is_whole(step / tick))).then_some(tick)
}

/// Whether it is an integer, within the error of steps.
pub fn is_whole(ticks: f64) -> bool {
    (ticks - ticks.round()).abs() < MAX_DEVIATION_TICKS
}
