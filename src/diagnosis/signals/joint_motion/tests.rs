use super::*;
use crate::test_motion::noise;

const RATE_HZ: f64 = 125.0;

fn times() -> Vec<f64> {
    (0..1000).map(|row| row as f64 / RATE_HZ).collect()
}

/// Position and velocity at 1 rad/s, braking at t = 4 s.
fn stop(t: f64, acceleration: f64) -> (f64, f64) {
    let (end, length) = (4.0, 1.0 / acceleration);
    match t - end {
        past if past <= 0.0 => (t, 1.0),
        past if past < length => {
            (end + past - 0.5 * acceleration * past * past, 1.0 - acceleration * past)
        }
        _ => (end + 0.5 * length, 0.0),
    }
}

#[test]
fn a_stop_is_detected_in_positions_and_velocities() {
    let t_s = times();
    let (q, qd): (Vec<f64>, Vec<f64>) = t_s.iter().map(|&t| stop(t, 25.0)).unzip();
    for (values, series) in [(q, JointSampleKind::Positions), (qd, JointSampleKind::Velocities)] {
        let found = peak_acceleration(&t_s, &values, series, 0.0).expect("even samples");
        assert!((found.acceleration - 25.0).abs() < 0.5, "{series:?}: {found:?}");
        assert!((found.at_s - 4.02).abs() < 0.05 && found.jerk > 100.0, "{found:?}");
    }
}

#[test]
fn noise_is_no_stop() {
    let t_s = times();
    for size in [1e-5, 1e-2] {
        let at = |row: usize| (0.5 * t_s[row]).sin() + size * noise(row);
        let q: Vec<f64> = (0..t_s.len()).map(at).collect();
        let found =
            peak_acceleration(&t_s, &q, JointSampleKind::Positions, 0.0).expect("even samples");
        assert!(found.acceleration - found.noise < 0.5, "{size}: {found:?}");
        // At 125 Hz, 1e-2/√3 rad hides 20 rad/s² over 0.1 s.
        assert_eq!(found.resolved < 20.0, size < 1e-4, "{found:?}");
    }
}

#[test]
fn encoder_steps_are_no_stop() {
    let (t_s, step) = (times(), 6e-3);
    let swing = |t: f64| 0.3 * (-(t - 10.0).powi(2)).exp();
    let q: Vec<f64> = t_s.iter().map(|t| (swing(*t) / step).round() * step).collect();
    let found = |step: f64| {
        peak_acceleration(&t_s, &q, JointSampleKind::Positions, step).expect("even samples")
    };
    let excess = |step: f64| found(step).acceleration - found(step).noise;
    assert!(excess(step) < 20.0 && excess(0.0) < 20.0, "{} {}", excess(step), excess(0.0));
}

#[test]
fn speed_dependent_noise_is_no_stop() {
    // Stamps up to 0.2 ms off, one fast swing.
    let t_s: Vec<f64> = (0..12_500).map(|row| row as f64 / 500.0).collect();
    let angle =
        |t: f64| 1.2 * (2.0 * t).sin() + 0.2 * (-(t - 12.0).powi(2)).exp() * (8.0 * t).sin();
    let q: Vec<f64> = t_s.iter().enumerate().map(|(row, t)| angle(t + 2e-4 * noise(row))).collect();
    let found = peak_acceleration(&t_s, &q, JointSampleKind::Positions, 0.0).expect("even samples");
    assert!(found.acceleration - found.noise < 20.0, "{found:?}");
}

/// A missed cycle at 1 kHz, amid a smooth acceleration of 9 rad/s².
#[test]
fn a_velocity_that_dips_and_returns_is_no_stop() {
    let t_s: Vec<f64> = (0..3000).map(|row| row as f64 / 1000.0).collect();
    let ripple = |row: usize| match row {
        1500 => -0.08,
        1501 => 0.1,
        _ => 1e-3 * noise(row),
    };
    let qd: Vec<f64> =
        t_s.iter().enumerate().map(|(row, t)| 3.0 * (3.0 * t).sin() + ripple(row)).collect();
    let found =
        peak_acceleration(&t_s, &qd, JointSampleKind::Velocities, 0.0).expect("even samples");
    assert!(found.acceleration < 20.0, "{found:?}");
}

#[test]
fn repeated_values_are_no_stops() {
    let t_s: Vec<f64> = (0..4000).map(|row| row as f64 / 500.0).collect();
    let at = |t: f64| ((t * RATE_HZ).floor() / RATE_HZ * 2.0).sin();
    let qd: Vec<f64> = t_s.iter().map(|&t| at(t + 1e-6)).collect();
    let found =
        peak_acceleration(&t_s, &qd, JointSampleKind::Velocities, 0.0).expect("even samples");
    assert!(found.acceleration < 2.1, "{found:?}");
}

#[test]
fn a_gap_is_no_stop_and_few_samples_give_no_result() {
    let mut t_s = times();
    t_s[500..].iter_mut().for_each(|t| *t += 0.5);
    let qd: Vec<f64> = t_s.iter().map(|&t| if t < 4.2 { 1.0 } else { 0.0 }).collect();
    let found =
        peak_acceleration(&t_s, &qd, JointSampleKind::Velocities, 0.0).expect("even samples");
    assert!(found.acceleration < 1e-9, "{found:?}");
    assert_eq!(peak_acceleration(&t_s[..5], &qd[..5], JointSampleKind::Velocities, 0.0), None);
    assert_eq!(peak_acceleration(&[], &[], JointSampleKind::Positions, 0.0), None);
}

#[test]
fn the_duration_beyond_either_limit_is_measured() {
    let t_s: Vec<f64> = (0..100).map(|row| row as f64 * 0.1).collect();
    let q: Vec<f64> = t_s.iter().map(|t| 2.0 * (t - 5.0).clamp(-2.0, 1.0)).collect();
    let limits = Limits { lower: Some(-3.5), upper: Some(1.9), velocity: None };
    let found = position_violation(&t_s, &q, &limits).expect("both are exceeded");
    assert_eq!((found.limit, found.value, found.at_s), (-3.5, -4.0, 0.0));
    assert!((found.seconds - 3.3).abs() < 1e-9, "{found:?}");
    let wide = Limits { lower: Some(-4.0), upper: None, velocity: None };
    assert_eq!(position_violation(&t_s, &q, &wide), None);
    assert_eq!(position_violation(&t_s, &[f64::NAN; 100], &limits), None);
}

#[test]
fn rates_of_a_line_are_exact_up_to_its_ends() {
    let t_s: Vec<f64> = (0..500).map(|row| f64::from(row) * 0.002).collect();
    let step = 6e-3;
    let q: Vec<f64> = t_s.iter().map(|t| (0.7 * t / step).round() * step).collect();
    let rates = rates(&t_s, &q, 0.1);
    assert_eq!(rates.len(), q.len());
    assert!(rates[25..475].iter().all(|rate| (rate - 0.7).abs() < 0.07), "{rates:?}");
    assert!(rates.iter().all(|rate| rate.abs() < 1.0));
    assert!(super::rates(&[], &[], 0.1).is_empty());
}

#[test]
fn a_single_wrong_speed_sample_is_no_violation() {
    let t_s: Vec<f64> = (0..10).map(|row| row as f64 * 0.1).collect();
    let limits = Limits { velocity: Some(2.0), ..Limits::default() };
    let mut qd = vec![0.5; 10];
    qd[4] = -9.0;
    assert_eq!(speed_violation(&t_s, &qd, &limits), None);
    qd[5] = -2.2;
    let found = speed_violation(&t_s, &qd, &limits).expect("two in a row");
    assert!((found.excess() - 0.2).abs() < 1e-12 && found.at_s == t_s[4], "{found:?}");
}
