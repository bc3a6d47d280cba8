//! Hand-eye calibration on synthetic poses.

use super::*;
use crate::PoseEncoding;
use ground::geometry::{Axes, Vec3, pose, rotation_from_rotvec};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Rotations and translations of different frequencies.
fn hand_at(t_s: f64, axes: usize) -> Pose {
    let wave = |rate: f64, phase: f64| (rate * t_s + phase).sin();
    let turn = Vec3::new(
        0.5 * wave(1.1, 0.0) + 0.2 * wave(2.3, 1.0),
        if axes > 1 { 0.45 * wave(0.7, 2.0) + 0.15 * wave(1.9, 0.4) } else { 0.0 },
        if axes > 1 { 0.4 * wave(0.9, 0.8) } else { 0.0 },
    );
    let shift = [0.4 + 0.1 * wave(0.6, 0.3), 0.12 * wave(0.8, 1.3), 0.5 + 0.1 * wave(1.3, 0.7)];
    pose(shift, rotation_from_rotvec(Vec3::new(0.0, 3.0, 0.2)) * rotation_from_rotvec(turn))
}

#[derive(Clone, Copy)]
struct Planted {
    mount: CameraMount,
    camera: Pose,
    constant: Pose,
    offset_s: f64,
    sigma: [f64; 2],
    outliers: f64,
    axes: usize,
    seed: u64,
}

impl Planted {
    fn new(mount: CameraMount) -> Self {
        let camera = pose([0.05, -0.02, 0.07], rotation_from_rotvec(Vec3::new(0.2, -0.3, 1.4)));
        let constant = pose([0.3, 0.1, 0.02], rotation_from_rotvec(Vec3::new(2.9, 0.3, 0.1)));
        let (sigma, outliers) = ([5e-4, 1e-3], 0.0);
        Self { mount, camera, constant, offset_s: 0.03, sigma, outliers, axes: 3, seed: 1 }
    }

    fn seen_at(&self, t_s: f64) -> Pose {
        let hand = hand_at(t_s, self.axes);
        let carrier_pose = match self.mount {
            CameraMount::InHand => hand,
            CameraMount::InBase => hand.inverse(),
        };
        (carrier_pose * self.camera).inverse() * self.constant
    }

    fn streams(&self) -> (PoseSeries, PoseSeries) {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(self.seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let t_s: Vec<f64> = (0..2000).map(|i| i as f64 * 0.01).collect();
        let hand =
            PoseSeries { poses: t_s.iter().map(|&t_s| hand_at(t_s, self.axes)).collect(), t_s };
        let t_s: Vec<f64> = (0..580).map(|i| 0.2 + i as f64 / 30.0).collect();
        let every = (1.0 / self.outliers.max(1e-9)) as usize;
        let observed = t_s.iter().enumerate().map(|(i, &t_s)| {
            let mut noise = || Vec3::new(normal(), normal(), normal());
            let mut observed = self.seen_at(t_s - self.offset_s);
            observed.translation.vector += self.sigma[0] * noise();
            observed.rotation *= rotation_from_rotvec(self.sigma[1] * noise());
            if i % every == every / 2 {
                observed.translation.vector += 0.2 * noise();
                observed.rotation *= rotation_from_rotvec(0.6 * noise());
            }
            observed
        });
        let poses = observed.collect();
        (hand, PoseSeries { t_s, poses })
    }
}

fn diagnosed(hand: &PoseSeries, target: &PoseSeries) -> HandEyeDiagnosis {
    let streams = HandEyeStreams { hand, target, stamp_error_s: 0.0, logged: None };
    diagnose_hand_eye(&streams, 2.0)
}

fn diagnosis(planted: &Planted) -> HandEyeDiagnosis {
    let (hand, target) = planted.streams();
    diagnosed(&hand, &target)
}

#[track_caller]
fn assert_near(found: &Pose, planted: &Pose, m: f64, rad: f64) {
    let off_m = (found.translation.vector - planted.translation.vector).norm();
    let off_rad = angle_between(&found.rotation, &planted.rotation);
    assert!(off_m < m && off_rad < rad, "{off_m} m, {off_rad} rad apart");
}

#[test]
fn camera_target_mount_and_time_offset_are_recovered() {
    for mount in CameraMount::ALL {
        for offset_s in [-0.4, 0.0, 0.03] {
            let planted = Planted { offset_s, ..Planted::new(mount) };
            let solution = diagnosis(&planted).solution.expect("it can be solved");
            assert_eq!(solution.mount, mount);
            assert!(solution.ratio > 5.0, "{}", solution.ratio);
            let off_s = (solution.offset_s.value - offset_s).abs();
            assert!(off_s < 4.0 * solution.offset_s.std_error.max(1e-5), "{off_s}");
            assert!(solution.offset_s.std_error < 1e-3);
            assert_near(&solution.camera.pose, &planted.camera, 1e-3, 1e-3);
            assert_near(&solution.target, &planted.constant, 1e-3, 1e-3);
            let closure = &solution.closure;
            assert!((closure.rms_m / (5e-4 * 3f64.sqrt()) - 1.0).abs() < 0.1, "{closure:?}");
            assert!((closure.rms_rad / (1e-3 * 3f64.sqrt()) - 1.0).abs() < 0.1, "{closure:?}");
            assert!(closure.excess_m.value < 4e-4 && closure.excess_rad.value < 8e-4);
        }
    }
}

#[test]
fn without_noise_the_residual_is_zero() {
    let planted = Planted { sigma: [0.0; 2], ..Planted::new(CameraMount::InHand) };
    let solution = diagnosis(&planted).solution.expect("it can be solved");
    // The hand is interpolated between samples.
    assert!(solution.closure.rms_m < 3e-5 && solution.closure.rms_rad < 3e-5);
    assert_near(&solution.camera.pose, &planted.camera, 2e-5, 2e-5);
}

#[test]
fn camera_standard_errors_match_the_scatter() {
    let runs = 16;
    let mut covered = 0;
    for seed in 0..runs {
        let planted = Planted { seed, ..Planted::new(CameraMount::InHand) };
        let camera = diagnosis(&planted).solution.expect("it can be solved").camera;
        let deviation = planted.camera.inverse() * camera.pose;
        let shift = deviation.translation.vector;
        covered +=
            (0..3).filter(|&i| shift[i].abs() < 1.96 * camera.translation_error_m[i]).count();
    }
    assert!((3 * runs * 85 / 100..).contains(&(covered as u64)), "{covered}");
}

#[test]
fn a_fifth_of_false_detections_is_tolerated() {
    for mount in CameraMount::ALL {
        let planted = Planted { outliers: 0.2, ..Planted::new(mount) };
        let found = diagnosis(&planted);
        let solution = found.solution.expect("it can be solved");
        assert_near(&solution.camera.pose, &planted.camera, 1.5e-3, 1.5e-3);
        assert!((90..=140).contains(&solution.closure.outliers), "{}", solution.closure.outliers);
        assert!(solution.closure.excess_m.value < 1e-3 && found.alternative.is_none());
    }
}

#[test]
fn base_and_target_frames_do_not_change_the_camera_pose() {
    let planted = Planted::new(CameraMount::InHand);
    let (mut hand, mut target) = planted.streams();
    let plain = diagnosed(&hand, &target).solution.expect("it can be solved").camera.pose;
    let world_from_base = pose([3.0, -2.0, 0.4], rotation_from_rotvec(Vec3::new(0.0, 0.4, 2.0)));
    let target_from_other = pose([0.1, 0.0, 0.0], rotation_from_rotvec(Vec3::new(0.0, 1.0, 0.0)));
    hand.poses.iter_mut().for_each(|hand| *hand = world_from_base * *hand);
    target.poses.iter_mut().for_each(|target| *target *= target_from_other);
    let moved = diagnosed(&hand, &target).solution.expect("it can be solved").camera.pose;
    assert_near(&moved, &plain, 3e-4, 3e-4);
}

#[test]
fn one_rotation_axis_leaves_the_camera_undetermined_along_it() {
    let planted = Planted { axes: 1, ..Planted::new(CameraMount::InHand) };
    let found = diagnosis(&planted);
    let diversity = found.diversity.as_ref().expect("the hand turns");
    assert!(diversity.span_rad > 1.0 && diversity.spread_rad < 0.05, "{diversity:?}");
    assert!(diversity.axis_in_hand[0].abs() > 0.99);
    let solution = found.solution.expect("it can be solved");
    assert!(solution.closure.excess_m.value < 1e-3, "{:?}", solution.closure.excess_m);
    let along = planted.camera.rotation.inverse() * Vec3::x();
    let most = (0..3).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs())).expect("three");
    assert!(solution.camera.translation_error_m[most] > 0.05);
}

#[test]
fn other_target_encodings_are_identified() {
    let read = |mount: CameraMount, write: &dyn Fn(&Pose) -> Pose| {
        let (hand, mut target) = Planted::new(mount).streams();
        target.poses.iter_mut().for_each(|pose| *pose = write(pose));
        let found = diagnosed(&hand, &target);
        let solution = found.alternative.expect("another reading closes");
        assert!(solution.closure.excess_m.value < 1e-3, "{:?}", solution.closure.excess_m);
        assert_eq!(solution.mount, mount);
        solution.encoding
    };
    for mount in CameraMount::ALL {
        let turned = read(mount, &|observed| {
            pose(
                [observed.translation.z, -observed.translation.x, -observed.translation.y],
                observed.rotation,
            )
        });
        let TargetEncoding::Axes(axes) = turned else { panic!("{turned:?}") };
        assert_eq!(axes, Axes::OPTICAL.inverse());
        let transposed = read(mount, &|observed| {
            Pose::from_parts(observed.translation, observed.rotation.inverse())
        });
        assert!(
            matches!(transposed, TargetEncoding::Rotations(PoseEncoding::Transposed)),
            "{transposed:?}"
        );
        let small = read(mount, &|observed| {
            pose((observed.translation.vector * 0.9).into(), observed.rotation)
        });
        let TargetEncoding::Scaled(TargetScaleError { size: Some(size), depth: None, .. }) = small
        else {
            panic!("{small:?}")
        };
        assert!((size.value - 0.9).abs() < 0.01, "{size:?}");
        let shallow = read(mount, &|observed| {
            pose(
                [observed.translation.x, observed.translation.y, 0.9 * observed.translation.z],
                observed.rotation,
            )
        });
        let TargetEncoding::Scaled(TargetScaleError { size: None, depth: Some(depth), .. }) =
            shallow
        else {
            panic!("{shallow:?}")
        };
        assert!((depth.value - 0.9).abs() < 0.01, "{depth:?}");
    }
}

#[test]
fn an_independently_moving_target_does_not_close_the_chain() {
    let (hand, _) = Planted::new(CameraMount::InHand).streams();
    let (_, mut target) = Planted { seed: 5, ..Planted::new(CameraMount::InBase) }.streams();
    target.poses.reverse();
    let found = diagnosed(&hand, &target);
    assert!(found.alternative.is_none());
    let solution = found.solution.expect("it can be solved");
    assert!(solution.closure.excess_m.value > 0.02, "{:?}", solution.closure.excess_m);
}

#[test]
fn missing_detections_give_a_reason_and_no_value() {
    let still = PoseSeries {
        t_s: (0..200).map(|i| f64::from(i) * 0.02).collect(),
        poses: vec![Pose::translation(0.3, 0.0, 0.5); 200],
    };
    let few = PoseSeries { t_s: vec![0.1, 0.2, 0.3], poses: vec![Pose::identity(); 3] };
    let later = PoseSeries { t_s: vec![90.0, 91.0], poses: vec![Pose::identity(); 2] };
    let nothing = PoseSeries::default();
    assert_eq!(diagnosed(&still, &still).solution.err(), Some(NotObservable::NotExcited));
    let short = diagnosed(&still, &few).solution.err();
    assert_eq!(short, Some(NotObservable::TooFewSamples { have: 3, need: MIN_POSES }));
    for other in [&later, &nothing] {
        assert_eq!(diagnosed(&still, other).solution.err(), Some(NotObservable::NoOverlap));
        assert_eq!(diagnosed(other, &still).solution.err(), Some(NotObservable::NoOverlap));
    }
}

#[test]
fn a_camera_mount_error_is_measured() {
    let planted = Planted::new(CameraMount::InBase);
    let (hand, target) = planted.streams();
    let deviation = pose([0.0, 0.006, 0.0], rotation_from_rotvec(Vec3::new(0.0, 0.0, 0.02)));
    let logged = Some((CameraMount::InBase, planted.camera * deviation.inverse()));
    let streams = HandEyeStreams { hand: &hand, target: &target, stamp_error_s: 0.0, logged };
    let error = diagnose_hand_eye(&streams, 2.0).mount_error.expect("a logged camera pose");
    assert!((error.translation_m.value - 0.006).abs() < 5e-4, "{error:?}");
    assert!((error.rotation_rad.value - 0.02).abs() < 1e-3, "{error:?}");
    assert!(error.p_value < 1e-6);
    let other = HandEyeStreams { logged: Some((CameraMount::InHand, deviation)), ..streams };
    assert!(diagnose_hand_eye(&other, 2.0).mount_error.is_none());
}

#[test]
fn a_wrong_focal_length_shows_in_the_depth_scale() {
    for factor in [1.0, 1.03, 0.97] {
        let (hand, mut target) = Planted::new(CameraMount::InHand).streams();
        let along = Vec3::from(series::mean_direction(&target)).iamax();
        target.poses.iter_mut().for_each(|observed| observed.translation.vector[along] *= factor);
        let scale = diagnosed(&hand, &target).solution.expect("it can be solved").scale;
        assert_eq!(scale.along, along);
        let depth = scale.depth;
        assert!((depth.value - factor).abs() < 5e-3, "{factor}: {depth:?}");
        assert!(depth.half_width(0.95) < 5e-3, "{factor}: {depth:?}");
    }
}
