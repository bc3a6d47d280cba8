use super::*;
use ground::geometry::{pose, rotation_from_rotvec};

fn arm() -> Vec<Pose> {
    let at = |i: i32| {
        let t = f64::from(i) * 0.2;
        let turn = rotation_from_rotvec(Vec3::new(t.sin(), (0.7 * t).cos(), 0.5 * t.cos()));
        pose([0.5 * t.cos(), 0.4 * (1.3 * t).sin(), 0.3 + 0.2 * (0.6 * t).sin()], turn)
    };
    (0..60).map(at).collect()
}

fn first(
    fk: &[Pose],
    xyz: &[Vec3],
    reference_known: bool,
    constant: Option<usize>,
) -> PositionEncoding {
    let written = StreamPositions { xyz, constant, read_as_m: 1.0, reference_known };
    candidate_encodings(fk, 1.0, &written).into_iter().next().expect("the tip moves")
}

fn xyz(poses: impl Iterator<Item = Pose>) -> Vec<Vec3> {
    poses.map(|pose| pose.translation.vector).collect()
}

#[test]
fn unit_axes_and_inversion_are_identified() {
    let fk = arm();
    let tool = pose([0.02, 0.01, 0.15], rotation_from_rotvec(Vec3::new(0.1, 0.0, 0.4)));
    for (k, &axes) in Axes::all().iter().enumerate() {
        for (unit, inverted) in [(1.0, false), (0.01, false), (0.0254, true), (1e-4, true)] {
            let logged = fk.iter().map(|fk| {
                let pose = fk * tool;
                if inverted { pose.inverse() } else { pose }
            });
            // An inverted pose's tool absorbs axis conventions.
            let axes = if inverted { Axes::all()[0] } else { axes };
            if inverted && k > 0 {
                continue;
            }
            let logged: Vec<Vec3> =
                xyz(logged).iter().map(|p| axes.convert_from_standard(*p) / unit).collect();
            let found = first(&fk, &logged, true, None);
            assert!((found.metres / unit - 1.0).abs() < 1e-9, "{axes} {unit}: {found:?}");
            assert_eq!(found.is_inverted, inverted, "{axes} {unit}");
            assert!(inverted || found.axes == Some(axes), "{axes} {unit}: {found:?}");
            assert!(found.residual_m < 1e-4, "{found:?}");
        }
    }
}

#[test]
fn an_unknown_world_frame_can_be_mirrored_or_scaled_but_not_rotated() {
    let fk = arm();
    let world = pose([3.0, -1.0, 0.5], rotation_from_rotvec(Vec3::new(0.3, -0.2, 2.0)));
    let turned = xyz(fk.iter().map(|fk| world * fk));
    let found = first(&fk, &turned, false, None);
    assert!(found.is_standard() && found.residual_m < 1e-4, "{found:?}");
    let mirrored: Vec<Vec3> =
        turned.iter().map(|p| Axes::UNITY.convert_from_standard(*p) * 100.0).collect();
    let found = first(&fk, &mirrored, false, None);
    assert!(found.is_mirrored() && !found.is_inverted, "{found:?}");
    assert!((found.metres - 0.01).abs() < 1e-12, "{found:?}");
}

#[test]
fn radial_scale_is_no_unit_and_another_arm_does_not_fit() {
    let fk = arm();
    let grown: Vec<Vec3> = xyz(fk.iter().copied()).iter().map(|p| p * 1.01).collect();
    assert!(first(&fk, &grown, true, None).is_standard());
    let other = |p: &Vec3| Vec3::new(90.0 * p.y * p.y, 80.0 * p.z, 100.0 * p.x.abs());
    let other: Vec<Vec3> = xyz(fk.iter().copied()).iter().map(other).collect();
    assert!(first(&fk, &other, true, None).is_standard());
}

#[test]
fn constant_coordinates_are_ignored() {
    let fk = arm();
    for constant in 0..3 {
        let mut logged: Vec<Vec3> = xyz(fk.iter().copied()).iter().map(|p| p * 1000.0).collect();
        logged.iter_mut().for_each(|p| p[constant] = 7.0);
        let found = first(&fk, &logged, true, Some(constant));
        assert_eq!((found.axes, found.metres), (Some(Axes::STANDARD), 1e-3));
        assert!(found.residual_m < 1e-6, "{found:?}");
    }
}

/// The tip stays where it is and rotates, as in a reorientation or a motion of the elbow.
#[test]
fn inverse_poses_of_a_tip_that_only_rotates_are_identified() {
    let fk: Vec<Pose> = arm().iter().map(|fk| pose([0.4, 0.1, 0.3], fk.rotation)).collect();
    let inverse = xyz(fk.iter().map(Pose::inverse));
    let found = first(&fk, &inverse, true, None);
    assert!(found.is_inverted && found.metres == 1.0, "{found:?}");
    assert!(found.residual_m < 1e-4, "{found:?}");
    let as_logged = xyz(fk.iter().copied());
    let written =
        StreamPositions { xyz: &as_logged, constant: None, read_as_m: 1.0, reference_known: true };
    assert!(candidate_encodings(&fk, 1.0, &written).is_empty());
}
