use super::{Rotation, Vec3};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};

/// From a quaternion of any norm; `None` if it is zero, tiny or not finite.
pub fn rotation_from_xyzw(q_xyzw: [f64; 4]) -> Option<Rotation> {
    let [x, y, z, w] = q_xyzw;
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6).filter(|q| q.w.is_finite())
}

/// Components x, y, z, w, with w ≥ 0.
pub fn xyzw_from_rotation(rotation: &Rotation) -> [f64; 4] {
    let sign = if rotation.w < 0.0 { -1.0 } else { 1.0 };
    [rotation.i, rotation.j, rotation.k, rotation.w].map(|c| sign * c)
}

/// From axis times angle, rad: `exp([r]×)`.
pub fn rotation_from_rotvec(rotvec: Vec3) -> Rotation {
    Rotation::from_scaled_axis(rotvec)
}

/// Axis times angle, rad, with norm ≤ π.
///
/// Accurate for small angles: `2·atan2(|v|, w)` about `v` (Solà, "Quaternion kinematics for the error-state
/// Kalman filter", eq. 106).
pub fn rotvec_from_rotation(rotation: &Rotation) -> Vec3 {
    let [x, y, z, w] = xyzw_from_rotation(rotation);
    let v = Vec3::new(x, y, z);
    let norm = v.norm();
    if norm < 1e-12 {
        return v * 2.0;
    }
    v * (2.0 * norm.atan2(w) / norm)
}

/// From angles about fixed axes, rad, as in URDF and tf2: `Rz(yaw)·Ry(pitch)·Rx(roll)`.
pub fn rotation_from_rpy(rpy: [f64; 3]) -> Rotation {
    Rotation::from_euler_angles(rpy[0], rpy[1], rpy[2])
}

/// Closest rotation, and the matrix's largest deviation `max |RᵀR − I|`. `None` if it is not finite or not
/// close to a rotation (determinant ≤ 0 or deviation > 0.5).
pub fn rotation_from_matrix_rows(rows: [[f64; 3]; 3]) -> Option<(Rotation, f64)> {
    let matrix = Matrix3::from_fn(|r, c| rows[r][c]);
    let defect = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
    if !defect.is_finite() || defect > 0.5 || matrix.determinant() <= 0.0 {
        return None;
    }
    let svd = matrix.svd(true, true);
    let nearest = svd.u? * svd.v_t?;
    let rotation = Rotation3::from_matrix_unchecked(nearest);
    Some((UnitQuaternion::from_rotation_matrix(&rotation), defect))
}

/// Rotation `a_from_b` that best maps vectors b to vectors a, from `Σ a·bᵀ` (Wahba 1965, by SVD); the
/// identity if that fails.
pub fn rotation_by_wahba(correlation: &Matrix3<f64>) -> Rotation {
    let svd = correlation.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Rotation::identity();
    };
    let mut flip = Matrix3::identity();
    flip[(2, 2)] = (u * v_t).determinant().signum();
    Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t))
}

/// Angle from `a` to `b`, rad, in [0, π]; the measure of all orientation errors.
pub fn angle_between(a: &Rotation, b: &Rotation) -> f64 {
    rotvec_from_rotation(&(a.inverse() * b)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn q_and_minus_q_are_one_rotation() {
        let q_xyzw = [0.1, -0.2, 0.3, 0.9];
        let a = rotation_from_xyzw(q_xyzw).unwrap();
        let b = rotation_from_xyzw(q_xyzw.map(|c| -c)).unwrap();
        assert!(angle_between(&a, &b) < 1e-15);
        assert_eq!(rotvec_from_rotation(&a), rotvec_from_rotation(&b));
    }

    #[test]
    fn tiny_and_half_turn_rotation_vectors_survive_a_round_trip() {
        let half_turn = Vec3::new(0.0, std::f64::consts::PI - 1e-6, 0.0);
        for rotvec in [Vec3::new(1e-9, -2e-9, 0.0), half_turn, Vec3::zeros()] {
            let back = rotvec_from_rotation(&rotation_from_rotvec(rotvec));
            assert!(
                (back - rotvec).norm() < 1e-15 + 1e-9 * rotvec.norm(),
                "{rotvec} became {back}"
            );
        }
    }

    #[test]
    fn a_zero_quaternion_is_no_rotation() {
        assert_eq!(rotation_from_xyzw([0.0; 4]), None);
        assert_eq!(rotation_from_xyzw([f64::NAN, 0.0, 0.0, 1.0]), None);
    }
}
