//! Distance between poses of the same frames.

use crate::stream::PoseColumns;

/// Distance between two poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseDistance {
    /// Distance between the origins, m.
    pub length_m: f64,
    /// Angle between the orientations, rad.
    pub angle_rad: f64,
}

impl PoseDistance {
    /// Distance between row `b` of some poses and row `a` of others. Ignores quaternion norms and signs;
    /// the angle is zero if one is unset.
    pub(super) fn between(a: (&PoseColumns, usize), b: (&PoseColumns, usize)) -> Self {
        let of = |(poses, row): (&PoseColumns, usize)| (poses.xyz[row], poses.q_xyzw[row]);
        Self::new(of(a), of(b))
    }

    pub(super) fn new(a: ([f64; 3], [f64; 4]), b: ([f64; 3], [f64; 4])) -> Self {
        let (xyz, p, q) = ([a.0, b.0], a.1, b.1);
        let dot = |p: [f64; 4], q: [f64; 4]| p.iter().zip(q).map(|(a, b)| a * b).sum::<f64>();
        let sign = if dot(p, q) < 0.0 { -1.0 } else { 1.0 };
        let [norm_p, norm_q] = [p, q].map(|q| dot(q, q).sqrt());
        let (to_p, to_q) = (1.0 / norm_p, sign / norm_q);
        // The chord resolves small angles better than the cosine (angle = 4 asin(chord / 2)).
        let chord: f64 = (0..4).map(|i| (p[i] * to_p - q[i] * to_q).powi(2)).sum::<f64>().sqrt();
        let angle_rad = 4.0 * arc_sine((chord / 2.0).min(1.0));
        let squares: f64 = xyz[0].iter().zip(xyz[1]).map(|(a, b)| (a - b).powi(2)).sum();
        let are_set = norm_p > 0.0 && norm_q > 0.0;
        let angle_rad = if are_set { angle_rad } else { 0.0 };
        Self { length_m: squares.sqrt(), angle_rad }
    }

    /// Whether two rotations are less than `limit_rad` apart. Avoids square roots; may miss some.
    pub(super) fn is_rotation_certainly_below(p: [f64; 4], q: [f64; 4], limit_rad: f64) -> bool {
        let dot = |p: [f64; 4], q: [f64; 4]| p.iter().zip(q).map(|(a, b)| a * b).sum::<f64>();
        let sign = if dot(p, q) < 0.0 { -1.0 } else { 1.0 };
        let square: f64 = (0..4).map(|i| (p[i] - sign * q[i]).powi(2)).sum();
        // For norms of at least 1/2, the chord is at most doubled, and the angle 2.1 times that.
        dot(p, p) >= 0.25 && dot(q, q) >= 0.25 && 18.0 * square <= (limit_rad * limit_rad).min(4.0)
    }

    /// Displacement at the end of a 1 m lever, m.
    pub(super) fn size_m(self) -> f64 {
        self.length_m + self.angle_rad
    }
}

/// `asin(x)`, by a series for small values, which are usual: exact to rounding.
fn arc_sine(x: f64) -> f64 {
    if x < 1e-4 { x * (1.0 + x * x / 6.0) } else { x.asin() }
}
