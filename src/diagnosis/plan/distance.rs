//! Clearances of a motion: self-collision, the floor, and the camera's field of view.

use ground::geometry::{Pose, Vec3};
use ground::robot::Chain;

/// Target visibility from a camera in the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetVisibility {
    /// Camera pose.
    pub hand_from_camera: Pose,
    /// Target in the base, m.
    pub target: Vec3,
    /// Maximum angle of the target to the camera's z axis.
    pub half_rad: f64,
}

/// Clearances to keep.
#[derive(Clone, Debug, PartialEq)]
pub struct Clearances {
    /// Per segment, from base to tip; one more than the joints. A segment is a capsule between consecutive joint origins.
    pub radius_m: Vec<f64>,
    /// Between surfaces.
    pub clear_m: f64,
    /// Floor height in the base.
    pub floor_m: Option<f64>,
    /// Visibility of the target, if any.
    pub view: Option<TargetVisibility>,
    /// Segments, with the minimum distance between surfaces, m.
    pairs: Vec<(usize, usize, f64)>,
    /// Minimum height per segment above the floor.
    heights: Vec<f64>,
}

/// Violation of a clearance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ClearanceViolation {
    /// Segments, from the base, and surface distance, m.
    Parts(usize, usize, f64),
    /// Segment and height above the floor, m.
    Floor(usize, f64),
    /// Angle of the target to the camera's z axis, rad.
    View(f64),
}

/// For segments already too close in the known free configuration.
const CONTACT_TOLERANCE_M: f64 = 5e-3;

impl Clearances {
    /// `free` is a collision-free configuration. Segments connected by a path shorter than twice their
    /// radii are not checked; segments closer than `clear_m` must keep about that distance.
    pub fn from_configuration(
        chain: &Chain,
        free: &[f64],
        radius_m: Vec<f64>,
        clear_m: f64,
        floor_m: Option<f64>,
        view: Option<TargetVisibility>,
    ) -> Self {
        let points = points(chain, free);
        let lengths: Vec<f64> = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        let mut keep =
            Self { radius_m, clear_m, floor_m, view, pairs: Vec::new(), heights: Vec::new() };
        for j in 2..lengths.len() {
            for i in 0..j - 1 {
                let path: f64 = lengths[i + 1..j].iter().sum();
                let thick = keep.radius_m[i] + keep.radius_m[j];
                if path > 2.0 * thick + clear_m {
                    let apart = keep.distance(&points, i, j);
                    keep.pairs.push((i, j, clear_m.min(apart - CONTACT_TOLERANCE_M)));
                }
            }
        }
        if let Some(floor_m) = floor_m {
            let height = |at: usize| keep.height(&points, at) - floor_m;
            let least = |at: usize| clear_m.min(height(at) - CONTACT_TOLERANCE_M).max(0.0);
            keep.heights = (0..lengths.len()).map(least).collect();
        }
        keep
    }

    /// Distance between the surfaces of two segments, m.
    fn distance(&self, points: &[Vec3], i: usize, j: usize) -> f64 {
        between(&points[i..i + 2], &points[j..j + 2]) - (self.radius_m[i] + self.radius_m[j])
    }

    /// Lowest point, m; infinite for the fixed first segment.
    fn height(&self, points: &[Vec3], at: usize) -> f64 {
        match at {
            0 => f64::INFINITY,
            _ => points[at].z.min(points[at + 1].z) - self.radius_m[at],
        }
    }

    /// Segment pairs, and segments above the floor, at less than the distance that `limit` returns for their minimum.
    fn closer_than<'a>(
        &'a self,
        points: &'a [Vec3],
        limit: impl Fn(f64) -> f64 + Copy + 'a,
    ) -> impl Iterator<Item = ClearanceViolation> + 'a {
        let pairs = self.pairs.iter().filter_map(move |&(i, j, least)| {
            let apart = self.distance(points, i, j);
            (apart < limit(least)).then_some(ClearanceViolation::Parts(i, j, apart))
        });
        let floor = self.heights.iter().enumerate().filter_map(move |(at, &least)| {
            let height = self.height(points, at) - self.floor_m?;
            (height < limit(least)).then_some(ClearanceViolation::Floor(at, height))
        });
        pairs.chain(floor)
    }

    /// First violation at `q`.
    pub fn first_violation(&self, chain: &Chain, q: &[f64]) -> Option<ClearanceViolation> {
        let view = || {
            let view = self.view?;
            let angle = view.angle(&chain.forward(q));
            (angle > view.half_rad).then_some(ClearanceViolation::View(angle))
        };
        self.closer_than(&points(chain, q), |least| least).next().or_else(view)
    }

    /// Segment pairs, and segments above the floor, closer than `clear_m` at `q`.
    pub fn close_pairs(&self, chain: &Chain, q: &[f64]) -> Vec<ClearanceViolation> {
        self.closer_than(&points(chain, q), |_| self.clear_m).collect()
    }

    /// Segment pairs checked.
    pub fn pairs(&self) -> usize {
        self.pairs.len()
    }
}

impl TargetVisibility {
    fn angle(&self, base_from_hand: &Pose) -> f64 {
        let camera = base_from_hand * self.hand_from_camera;
        let seen = camera.inverse() * nalgebra::Point3::from(self.target);
        seen.x.hypot(seen.y).atan2(seen.z)
    }
}

/// Base, joints and tip, m.
pub(super) fn points(chain: &Chain, q: &[f64]) -> Vec<Vec3> {
    let mut frames = Vec::new();
    chain.joint_frames(q, &mut frames);
    let joints = frames.iter().map(|frame| frame.translation.vector);
    let tip = chain.forward(q).translation.vector;
    std::iter::once(Vec3::zeros()).chain(joints).chain([tip]).collect()
}

/// Ericson, *Real-Time Collision Detection*, 2005, ch. 5.1.9.
fn between(one: &[Vec3], other: &[Vec3]) -> f64 {
    const MIN_SQUARED_LENGTH: f64 = 1e-12;
    let (d1, d2, r) = (one[1] - one[0], other[1] - other[0], one[0] - other[0]);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (b, c) = (d1.dot(&d2), d1.dot(&r));
    let share = |part: f64, whole: f64| (part / whole.max(MIN_SQUARED_LENGTH)).clamp(0.0, 1.0);
    let denominator = a * e - b * b;
    let s = match denominator > MIN_SQUARED_LENGTH * a * e {
        true => ((b * f - c * e) / denominator).clamp(0.0, 1.0),
        false => 0.0,
    };
    let t = share(b * s + f, e);
    // Differs from the first one if `t` is at an end.
    let s = share(b * t - c, a);
    (one[0] + d1 * s - other[0] - d2 * t).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_of_segments_is_that_of_their_nearest_points() {
        let x = [Vec3::zeros(), Vec3::x()];
        let cases = [
            ([Vec3::new(0.5, -1.0, 0.3), Vec3::new(0.5, 1.0, 0.3)], 0.3),
            ([Vec3::new(2.0, 0.0, 0.0), Vec3::new(3.0, 0.0, 0.0)], 1.0),
            ([Vec3::new(0.0, 0.2, 0.0), Vec3::new(1.0, 0.2, 0.0)], 0.2),
            ([Vec3::new(-3.0, 4.0, 0.0), Vec3::new(-3.0, 4.0, 0.0)], 5.0),
            ([Vec3::new(1.5, 1.0, 0.0), Vec3::new(1.5, 0.5, 0.0)], 0.5_f64.hypot(0.5)),
        ];
        for (other, apart) in cases {
            assert!((between(&x, &other) - apart).abs() < 1e-12, "{other:?}");
            assert!((between(&other, &x) - apart).abs() < 1e-12, "{other:?}");
        }
    }
}
