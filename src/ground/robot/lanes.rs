//! SIMD forward kinematics.

use nalgebra::Matrix3;
use wide::f64x4;

use crate::geometry::{Pose, Vec3};

use super::chain::{Chain, Rigid};

pub(super) const LANES: usize = 4;

#[derive(Clone, Copy)]
struct Rigids {
    columns: [[f64x4; 3]; 3],
    translation: [f64x4; 3],
}

impl Chain {
    /// Computes `base_from_tip` for each row of `q_rows` (row-major).
    ///
    /// # Panics
    /// If the last row is incomplete.
    pub fn forward_batch(&self, q_rows: &[f64], out: &mut Vec<Pose>) {
        let dof = self.dof();
        assert_eq!(q_rows.len() % dof, 0, "one position per coordinate in each row");
        out.clear();
        out.reserve(q_rows.len() / dof);
        if self.is_floating() {
            out.extend(q_rows.chunks_exact(dof).map(|q| self.forward(q)));
            return;
        }
        let mut fours = q_rows.chunks_exact(LANES * dof);
        for four in &mut fours {
            let tips = self.walk_lanes(four);
            out.extend((0..LANES).map(|lane| tips.lane(lane).to_pose()));
        }
        out.extend(fours.remainder().chunks_exact(dof).map(|q| self.forward(q)));
    }

    fn walk_lanes(&self, four: &[f64]) -> Rigids {
        let dof = self.dof();
        let mut base_from_here = Rigids::IDENTITY;
        for step in self.steps() {
            let q = f64x4::new(std::array::from_fn(|lane| four[lane * dof + step.coordinate]));
            let motion = q * f64x4::splat(step.factor) + f64x4::splat(step.offset);
            let before = base_from_here.times(&step.previous_from_step);
            base_from_here = match step.slides {
                true => before.slid_along_z(motion),
                false => before.turned_about_z(motion),
            };
        }
        base_from_here.times(self.step_from_tip())
    }
}

impl Rigids {
    const IDENTITY: Self = {
        let (one, no) = (f64x4::ONE, f64x4::ZERO);
        Self { columns: [[one, no, no], [no, one, no], [no, no, one]], translation: [no; 3] }
    };

    #[inline]
    fn times(&self, constant: &Rigid) -> Self {
        let [x, y, z] = &self.columns;
        let along = |by: [f64; 3]| -> [f64x4; 3] {
            let [a, b, c] = by.map(f64x4::splat);
            std::array::from_fn(|i| x[i] * a + y[i] * b + z[i] * c)
        };
        let shift = along(constant.translation.into());
        Self {
            columns: std::array::from_fn(|j| {
                along(constant.rotation.column(j).into_owned().into())
            }),
            translation: std::array::from_fn(|i| self.translation[i] + shift[i]),
        }
    }

    #[inline]
    fn turned_about_z(self, angle_rad: f64x4) -> Self {
        let (sin, cos) = sin_cos(angle_rad);
        let [x, y, z] = self.columns;
        let turned_x = std::array::from_fn(|i| x[i] * cos + y[i] * sin);
        let turned_y = std::array::from_fn(|i| y[i] * cos - x[i] * sin);
        Self { columns: [turned_x, turned_y, z], ..self }
    }

    #[inline]
    fn slid_along_z(self, distance_m: f64x4) -> Self {
        let z = self.columns[2];
        let translation = std::array::from_fn(|i| self.translation[i] + z[i] * distance_m);
        Self { translation, ..self }
    }

    fn lane(&self, lane: usize) -> Rigid {
        Rigid {
            rotation: Matrix3::from_fn(|i, j| self.columns[j][i].as_array()[lane]),
            translation: Vec3::from_fn(|i, _| self.translation[i].as_array()[lane]),
        }
    }
}

/// Within two units in the last place. Subtracts the nearest multiple of π/2 in three parts, then uses the
/// polynomials of Cephes (Moshier, `sin.c`).
#[inline]
pub(super) fn sin_cos(angle_rad: f64x4) -> (f64x4, f64x4) {
    /// Adding and subtracting it rounds to an integer, which is in the last bits of the sum.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    /// Above this, rad, the reduction loses digits.
    const MAX_ANGLE_RAD: f64 = 1e5;
    const HALF_PI: [f64; 3] =
        [1.570_796_310_901_641_8, 1.589_325_471_229_585_7e-8, 6.123_233_995_736_766e-17];
    const SIN: [f64; 6] = [
        1.589_623_015_765_465_6e-10, -2.505_074_776_285_780_7e-8, 2.755_731_362_138_572_2e-6,
        -1.984_126_982_958_954e-4, 8.333_333_333_322_118e-3, -1.666_666_666_666_663e-1,
    ];
    const COS: [f64; 6] = [
        -1.135_853_652_138_768_2e-11, 2.087_570_084_197_473e-9, -2.755_731_417_929_674e-7,
        2.480_158_728_885_170_4e-5, -1.388_888_888_887_305_6e-3, 4.166_666_666_666_659_5e-2,
    ];
    if angle_rad.as_array().iter().any(|angle| angle.abs() > MAX_ANGLE_RAD) {
        let both = angle_rad.as_array().map(f64::sin_cos);
        return (f64x4::new(both.map(|both| both.0)), f64x4::new(both.map(|both| both.1)));
    }
    let shifted = angle_rad * f64x4::splat(std::f64::consts::FRAC_2_PI) + f64x4::splat(WHOLE);
    let quarters = shifted - f64x4::splat(WHOLE);
    let x = HALF_PI.iter().fold(angle_rad, |x, part| x - quarters * f64x4::splat(*part));
    let square = x * x;
    let sum = |by: [f64; 6]| {
        by[1..].iter().fold(f64x4::splat(by[0]), |sum, by| sum * square + f64x4::splat(*by))
    };
    let sin = x + x * square * sum(SIN);
    let cos = f64x4::ONE - square * f64x4::HALF + square * square * sum(COS);
    let (sin, cos) = (sin.to_array().map(f64::to_bits), cos.to_array().map(f64::to_bits));
    let quarter = shifted.to_array().map(f64::to_bits);
    // Odd quadrants exchange sine and cosine. The sine is negative in the last two, the cosine in the
    // middle two.
    let either = |own: [u64; 4], other: [u64; 4], from: u64| {
        f64x4::new(std::array::from_fn(|lane| {
            let odd = 0_u64.wrapping_sub(quarter[lane] & 1);
            let sign = (quarter[lane].wrapping_add(from) & 2) << 62;
            f64::from_bits(((own[lane] & !odd) | (other[lane] & odd)) ^ sign)
        }))
    };
    (either(sin, cos, 0), either(cos, sin, 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::angle_between;
    use crate::robot::catalogue;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn sines_match_the_standard_library() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
        let edges = [0.0, -0.0, std::f64::consts::FRAC_PI_2, std::f64::consts::PI, 1e5, 2e5];
        let random = (0..4000).map(|at| rng.random_range(-1.0..1.0) * 10_f64.powi(at % 6));
        for angle in edges.into_iter().chain(random) {
            let (sin, cos) = sin_cos(f64x4::new([angle, 0.3, -angle, -0.3]));
            for (lane, angle) in [(0, angle), (2, -angle)] {
                let error = [sin, cos].map(|of| of.as_array()[lane]);
                let error = [error[0] - angle.sin(), error[1] - angle.cos()].map(f64::abs);
                assert!(error[0] < 3e-16 && error[1] < 3e-16, "{angle}: {error:?}");
            }
        }
        let (sin, cos) = sin_cos(f64x4::new([f64::NAN, f64::INFINITY, 0.0, 1.0]));
        assert!([sin, cos].iter().all(|of| of.as_array()[..2].iter().all(|one| one.is_nan())));
    }

    /// Up to rounding.
    #[test]
    fn a_batch_matches_single_evaluations() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(7);
        for robot in catalogue::entries() {
            let link = |name: &Option<String>| robot.link(name.as_deref().expect("it has one"));
            let ends = link(&robot.default_base).zip(link(&robot.default_tip));
            let (base, tip) = ends.expect("they are there");
            let chain = robot.chain(base, tip).expect("it moves");
            for rows in [0, 1, 3, 4, 9] {
                let q: Vec<f64> =
                    (0..rows * chain.dof()).map(|_| rng.random_range(-7.0..7.0)).collect();
                let mut poses = Vec::new();
                chain.forward_batch(&q, &mut poses);
                assert_eq!(poses.len(), rows);
                for (q, pose) in q.chunks_exact(chain.dof()).zip(&poses) {
                    let one = chain.forward(q);
                    let error_m = (one.translation.vector - pose.translation.vector).norm();
                    let error_rad = angle_between(&one.rotation, &pose.rotation);
                    assert!(
                        error_m < 1e-13 && error_rad < 1e-7,
                        "{}: {error_m} {error_rad}",
                        robot.name
                    );
                }
            }
        }
    }
}
