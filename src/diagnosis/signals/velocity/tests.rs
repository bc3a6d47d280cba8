use super::*;

fn position(joint: usize, t: f64) -> f64 {
    let rate = 1.0 + 0.37 * joint as f64;
    (rate * t).sin() + 0.5 * (2.1 * rate * t + 0.3).sin()
}

fn rate(joint: usize, t: f64) -> f64 {
    (position(joint, t + 1e-4) - position(joint, t - 1e-4)) / 2e-4
}

/// First of two joints, with positions quantised to `quantum`.
fn diagnosis(quantum: f64, velocity: impl Fn(f64) -> f64) -> VelocityDiagnosis {
    let t_s: Vec<f64> = (0..2000).map(|row| f64::from(row) * 0.01).collect();
    let stepped = |q: f64| if quantum > 0.0 { (q / quantum).round() * quantum } else { q };
    let of = |joint: usize| t_s.iter().map(|&t| stepped(position(joint, t))).collect::<Vec<f64>>();
    let positions = [of(0), of(1)];
    let own: Vec<f64> = t_s.iter().map(|&t| velocity(t)).collect();
    let joint = |at: usize| VelocitySamples {
        t_s: &t_s,
        position: &positions[at],
        velocity: &own,
        breaks: &[],
    };
    diagnose_velocity(&[joint(0), joint(1)], 0).expect("it moves")
}

#[test]
fn velocities_match_positions_at_any_encoder_resolution() {
    for bits in [0.0, 14.0, 12.0, 10.0] {
        let quantum = if bits > 0.0 { std::f64::consts::TAU / f64::exp2(bits) } else { 0.0 };
        let diagnosis = diagnosis(quantum, |t| rate(0, t));
        assert!(
            diagnosis.error.value < 0.02 && diagnosis.error.half_width(0.95) < 0.05,
            "{bits}: {diagnosis:?}"
        );
        assert_eq!(diagnosis.shape, VelocityShape::Rates);
    }
}

#[test]
fn each_velocity_fault_is_classified_with_its_size() {
    let degrees = diagnosis(0.0, |t| rate(0, t).to_degrees());
    assert!(matches!(degrees.shape, VelocityShape::Scaled(by) if (by - 57.296).abs() < 0.1));
    assert!((degrees.error.value - 56.296).abs() < 0.1, "{degrees:?}");
    let turned = diagnosis(0.0015, |t| -rate(0, t));
    assert!(matches!(turned.shape, VelocityShape::Scaled(by) if (by + 1.0).abs() < 0.02));
    assert_eq!(diagnosis(0.0, |_| 0.0).shape, VelocityShape::Zero);
    assert_eq!(diagnosis(0.0, |_| 0.3).shape, VelocityShape::Constant(0.3));
    let radians = diagnosis(0.0, |t| rate(0, t).to_radians());
    let small = 1f64.to_radians();
    assert!(matches!(radians.shape, VelocityShape::Scaled(by) if (by / small - 1.0).abs() < 0.01));
    let swapped = diagnosis(0.0, |t| rate(1, t));
    assert!(matches!(swapped.shape, VelocityShape::OfJoint(1, by) if (by - 1.0).abs() < 0.02));
    assert_eq!(diagnosis(0.0, |t| (40.0 * t * t).sin()).shape, VelocityShape::Unrelated);
    let late = diagnosis(0.0, |t| rate(0, t - 0.06));
    let VelocityShape::Filtered(response) = late.shape else { panic!("{late:?}") };
    assert!((response.delay_s.value - 0.06).abs() < 1e-3, "{response:?}");
}

/// A reproducible pseudo-random number in ±1.
fn pseudo_random(seed: u64) -> f64 {
    let mut state = (seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    state = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    state ^= state >> 27;
    (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

#[test]
fn a_factor_that_leaves_much_of_the_velocities_is_no_cause() {
    let scaled_with = |noise_size: f64| {
        let at =
            |t: f64| 0.46 * rate(0, t) + noise_size * pseudo_random((t * 100.0).round() as u64);
        diagnosis(0.0, at).shape
    };
    assert!(matches!(scaled_with(0.5), VelocityShape::Scaled(by) if (by - 0.46).abs() < 0.05));
    assert_eq!(scaled_with(4.5), VelocityShape::Unrelated);
}

#[test]
fn a_difference_of_two_samples_is_a_rate() {
    let backward = diagnosis(0.0, |t| (position(0, t) - position(0, t - 0.01)) / 0.01);
    assert_eq!(backward.shape, VelocityShape::Rates, "{backward:?}");
}

#[test]
fn windows_with_a_gap_are_skipped() {
    // Small, fast motion needs long windows.
    let at = |t: f64| 0.02 * (9.0 * t).sin();
    let t_s: Vec<f64> = (0..1500).map(|row| f64::from(row) * 0.02).collect();
    let t_s: Vec<f64> = t_s.into_iter().filter(|t| !(9.9..10.4).contains(t)).collect();
    let q: Vec<f64> = t_s.iter().map(|&t| (at(t) / 5e-4).round() * 5e-4).collect();
    let v: Vec<f64> = t_s.iter().map(|&t| 0.18 * (9.0 * t).cos()).collect();
    let joint = VelocitySamples { t_s: &t_s, position: &q, velocity: &v, breaks: &[] };
    let windows = VelocityWindows::from_samples(&joint).expect("it moves");
    assert!(windows.changes.windows.iter().all(|(from, to)| *to < 9.95 || *from > 10.3));
    let diagnosis = diagnose_velocity(&[joint], 0).expect("it moves");
    assert_eq!(diagnosis.shape, VelocityShape::Rates, "{diagnosis:?}");
}

#[test]
fn the_encoder_step_is_detected_and_noise_has_none() {
    let smooth: Vec<f64> = (0..3000).map(|row| position(0, f64::from(row) * 0.004)).collect();
    let step = std::f64::consts::TAU / 1024.0;
    let stepped: Vec<f64> = smooth.iter().map(|q| (q / step).round() * step).collect();
    assert!((encoder_step(&stepped) - step).abs() < 1e-9);
    assert_eq!(encoder_step(&smooth), 0.0);
    assert_eq!(encoder_step(&[]), 0.0);
}
