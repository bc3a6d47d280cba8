use super::*;

const PERIOD_S: f64 = 0.008;

/// Non-periodic.
fn motion(t: f64) -> f64 {
    (1.1 * t).sin() + 0.6 * (2.3 * t + 0.4).sin() + 0.3 * (4.7 * t).cos()
}

fn times() -> Vec<f64> {
    (0..2500).map(|row| f64::from(row) * PERIOD_S).collect()
}

fn followed(done: impl Fn(f64) -> f64) -> Result<Response, NotObservable> {
    let t_s = times();
    let command = TimeSeries::new(t_s.clone(), vec![t_s.iter().map(|&t| motion(t)).collect()]);
    let done: Vec<f64> = t_s.iter().map(|&t| done(t)).collect();
    ResponseChanges::from_windows(&t_s, &[done], (0.0, 20.0), 0.1).estimate_response(&command, 2.0)
}

#[test]
fn a_delay_is_estimated_with_its_sign_for_any_offset_and_gain() {
    for delay_s in [-0.1, 0.0, 0.003, 0.14, 0.3] {
        let found = followed(|t| 3.0 + 0.9 * motion(t - delay_s)).expect("it follows");
        assert!((found.delay_s.value - delay_s).abs() < 1e-4, "{delay_s}: {found:?}");
        assert!((found.gain - 0.9).abs() < 1e-3 && found.corner_hz().is_none(), "{found:?}");
    }
}

#[test]
fn a_low_pass_is_distinguished_from_a_delay() {
    let t_s = times();
    let command = TimeSeries::new(t_s.clone(), vec![t_s.iter().map(|&t| motion(t)).collect()]);
    for corner_hz in [1.0, 4.0] {
        let constant_s = 1.0 / (std::f64::consts::TAU * corner_hz);
        let done = command.filtered(constant_s).columns;
        let changes = ResponseChanges::from_windows(&t_s, &done, (0.0, 20.0), 0.1);
        let found = changes.estimate_response(&command, 2.0).expect("it follows");
        let hz = found.corner_hz().expect("a low-pass");
        assert!((hz - corner_hz).abs() < 0.05 * corner_hz, "{found:?}");
        assert!((found.delay_s.value - constant_s).abs() < 3e-3, "{found:?}");
    }
}

#[test]
fn periodic_and_unrelated_responses_give_a_reason() {
    let t_s = times();
    let wave = |t: f64| (6.0 * t).sin();
    let command = TimeSeries::new(t_s.clone(), vec![t_s.iter().map(|&t| wave(t)).collect()]);
    let done = vec![t_s.iter().map(|&t| wave(t - 0.1)).collect::<Vec<f64>>()];
    let found = ResponseChanges::from_windows(&t_s, &done, (0.0, 20.0), 0.1)
        .estimate_response(&command, 2.0);
    assert!(matches!(found, Err(NotObservable::Periodic(_))), "{found:?}");
    let found = followed(|t| (1.7 * t * t).sin());
    assert!(matches!(found, Err(NotObservable::DoesNotFollow(_))), "{found:?}");
}

#[test]
fn the_delay_of_a_vector_does_not_depend_on_its_axes() {
    let t_s = times();
    let column = |phase: f64, late_s: f64| -> Vec<f64> {
        t_s.iter().map(|&t| motion(1.3 * (t - late_s) + phase)).collect()
    };
    let command = TimeSeries::new(t_s.clone(), [0.0, 1.0, 2.0].map(|at| column(at, 0.0)).to_vec());
    let done = [2.0, 0.0, 1.0].map(|at| column(at, 0.05)).to_vec();
    let found = ResponseChanges::from_windows(&t_s, &done, (0.0, 20.0), 0.1)
        .estimate_response(&command, 2.0);
    assert!(found.as_ref().is_ok_and(|it| (it.delay_s.value - 0.05).abs() < 2e-4), "{found:?}");
}
