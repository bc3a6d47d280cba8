use super::*;
use ground::geometry::{pose, rotation_from_rotvec};

fn truth(t_s: f64) -> Pose {
    let swing = |rate: f64, phase: f64| (rate * t_s + phase).sin();
    pose(
        [0.3 * swing(1.7, 0.0), 0.25 * swing(2.3, 1.0), 0.2 * swing(1.1, 2.0)],
        rotation_from_rotvec(Vec3::new(0.4 * swing(1.9, 0.3), 0.3 * swing(1.3, 0.7), 0.0)),
    )
}

fn profile_at(aligned: &AlignedSamples) -> EstimateResult<LatencyProfile> {
    latency_profile(aligned, 0.0, None, |_| 1.0, |late_s| Some(fk(aligned, truth, late_s)))
}

fn fk(aligned: &AlignedSamples, path: Path, late_s: &dyn Fn(f64) -> f64) -> Vec<Option<Pose>> {
    aligned.t_s.iter().map(|t_s| Some(path(t_s - late_s(*t_s)))).collect()
}

type Path = fn(f64) -> Pose;

/// Tool speed, m/s.
fn speed(t_s: f64) -> f64 {
    let velocity = truth(t_s + 0.005).translation.vector - truth(t_s - 0.005).translation.vector;
    velocity.norm() / 0.01
}

fn with_speed(aligned: &AlignedSamples) -> EstimateResult<LatencyProfile> {
    latency_profile(aligned, 0.0, None, speed, |late_s| Some(fk(aligned, truth, late_s)))
}

/// 20 s at 50 Hz with latency `beyond_s` and model error `bent_m`.
fn aligned(beyond_s: impl Fn(f64) -> f64, noise_m: f64, bent_m: f64) -> AlignedSamples {
    let mut aligned = aligned_along(truth, (1000, 0.02), beyond_s, noise_m);
    for (logged, fk) in aligned.corrected.iter_mut().zip(&aligned.fk_at_truth) {
        logged.translation.vector += bent_m * fk.translation.vector.map(f64::sin);
    }
    aligned
}

fn aligned_along(
    path: Path,
    (rows, period_s): (u32, f64),
    beyond_s: impl Fn(f64) -> f64,
    noise_m: f64,
) -> AlignedSamples {
    let mut random = crate::test_random::Lcg::new();
    let mut aligned = AlignedSamples::default();
    for t_s in (0..rows).map(|row| f64::from(row) * period_s) {
        let mut logged = path(t_s - beyond_s(t_s));
        logged.translation.vector += Vec3::from(random.triple(noise_m));
        aligned.t_s.push(t_s);
        aligned.corrected.push(logged);
        aligned.fk_at_truth.push(path(t_s));
    }
    aligned
}

#[test]
fn a_latency_step_is_estimated_with_time_and_size() {
    for (at_s, size_s) in [(7.3, 0.012), (12.41, -0.03)] {
        let late = |t_s: f64| if t_s < at_s { 0.001 } else { 0.001 + size_s };
        let profile = profile_at(&aligned(late, 1e-4, 0.0)).expect("a profile");
        let [jump] = profile.steps.as_slice() else { panic!("{profile:?}") };
        // Linear in the latency.
        assert!((jump.size_s.value - size_s).abs() < 0.05 * size_s.abs(), "{jump:?}");
        assert!((jump.at_s - at_s).abs() < 0.2, "{jump:?}");
        let t_s = [1.0, 2.0, 18.0, 19.0];
        let straight = profile.compensated(&t_s);
        let apart = (straight[2].1 - straight[1].1) - (18.0 - 2.0);
        assert!((apart + size_s).abs() < 0.05 * size_s.abs(), "{straight:?}");
    }
}

#[test]
fn a_wandering_latency_is_measured_from_minimum_to_maximum() {
    let late = |t_s: f64| 0.01 * (0.6 * t_s).sin();
    let profile = profile_at(&aligned(late, 1e-4, 0.0)).expect("a profile");
    assert!(profile.is_unsteady, "{profile:?}");
    assert!((0.016..0.024).contains(&profile.swing_s.value.abs()), "{profile:?}");
}

#[test]
fn noise_skew_and_model_error_are_steady() {
    for noise_m in [1e-6, 1e-4, 2e-3] {
        let steady = profile_at(&aligned(|_| 0.0, noise_m, 0.0)).expect("a profile");
        assert!(!steady.is_unsteady, "{steady:?}");
    }
    let skewed = profile_at(&aligned(|t_s| 3e-4 * t_s, 1e-4, 0.0)).expect("a profile");
    assert!(!skewed.is_unsteady, "{skewed:?}");
    let bent = profile_at(&aligned(|_| 0.0, 1e-5, 0.01)).expect("a profile");
    assert!(!bent.is_unsteady, "{bent:?}");
}

#[test]
fn an_arm_at_rest_has_no_latency_profile() {
    let mut still = aligned(|_| 0.0, 0.0, 0.0);
    still.fk_at_truth.fill(truth(0.0));
    assert!(profile_at(&still).is_err());
    assert!(profile_at(&AlignedSamples::default()).is_err());
}

#[test]
fn a_ramp_is_estimated_with_its_ends() {
    let late = |t_s: f64| 0.02 * ((t_s - 6.0) / 7.0).clamp(0.0, 1.0);
    let found = profile_at(&aligned(late, 1e-4, 0.0)).expect("a profile");
    let LatencyShape::Ramp { from_s, to_s } = found.shape else { panic!("{:?}", found.shape) };
    assert!((from_s - 6.0).abs() < 1.0 && (to_s - 13.0).abs() < 1.0, "{from_s} {to_s}");
    assert!((found.swing_s.value - 0.02).abs() < 1e-3, "{:?}", found.swing_s);
    assert!(found.is_unsteady && found.steps.is_empty());
}

fn stop_and_go(t_s: f64) -> Pose {
    let (stop, part) = ((t_s / 2.0).floor(), (t_s / 2.0).fract());
    let u = (part / 0.7).min(1.0);
    let smooth = u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
    let at = |stop: f64, axis: f64| 0.4 * (2.3 * stop + 1.7 * axis).sin();
    let between = |axis: f64| at(stop, axis) + smooth * (at(stop + 1.0, axis) - at(stop, axis));
    let turn = Vec3::new(between(3.0), between(4.0), between(5.0));
    pose([between(0.0), between(1.0), between(2.0)], rotation_from_rotvec(turn))
}

#[test]
fn a_ramp_is_estimated_in_stop_and_go_motion() {
    let late = |t_s: f64| -0.015 + 0.025 * ((t_s - 12.0) / 8.0).clamp(0.0, 1.0);
    let found = aligned_along(stop_and_go, (3200, 0.01), late, 2e-5);
    let at = |late_s: &dyn Fn(f64) -> f64| Some(fk(&found, stop_and_go, late_s));
    let found = latency_profile(&found, 0.0, None, |_| 1.0, at).expect("a profile");
    let LatencyShape::Ramp { from_s, to_s } = found.shape else { panic!("{found:?}") };
    assert!((from_s - 12.0).abs() < 1.5 && (to_s - 20.0).abs() < 1.5, "{from_s} {to_s}");
    let off_s = (found.swing_s.value - 0.025).abs();
    assert!(off_s < 1e-3, "{:?}", found.swing_s);
}

#[test]
fn a_load_dependent_latency_is_estimated_with_its_range() {
    let most = (0..1000).map(|row| speed(f64::from(row) * 0.02)).fold(0.0, f64::max);
    let least = (0..1000).map(|row| speed(f64::from(row) * 0.02)).fold(f64::MAX, f64::min);
    let late = |t_s: f64| 0.004 + 0.015 * speed(t_s) / most;
    let found = with_speed(&aligned(late, 1e-4, 0.0)).expect("a profile");
    assert_eq!(found.shape, LatencyShape::WithLoad);
    let swing_s = 0.015 * (most - least) / most;
    assert!((found.swing_s.value - swing_s).abs() < 1e-3, "{:?} {swing_s}", found.swing_s);
    assert!(found.is_unsteady);
    let steady = with_speed(&aligned(|_| 0.006, 1e-4, 0.0)).expect("a profile");
    assert_eq!((steady.shape, steady.is_unsteady), (LatencyShape::Steady, false));
}
