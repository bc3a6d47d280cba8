//! What a motion keeps off: the arm itself, a floor, and the edge of what a camera sees.

use ground::geometry::{Pose, Vec3};
use ground::robot::Chain;

/// An arm as capsules: a straight from each joint's origin to the next one's, base first and tip last,
/// with a radius each.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// The radius of each straight, m: one more than there are joints.
    pub radius_m: Vec<f64>,
}

/// What a camera in the hand must see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The camera.
    pub hand_from_camera: Pose,
    /// The target in the base, m.
    pub target: Vec3,
    /// The largest angle between the camera's z axis and the direction to the target, rad.
    pub half_rad: f64,
}

/// What a motion keeps off, and by how much.
#[derive(Clone, Debug, PartialEq)]
pub struct Keep {
    /// The arm.
    pub body: Body,
    /// The least distance between surfaces, m.
    pub clear_m: f64,
    /// Height in the base that nothing of the moving arm may be below, m.
    pub floor_m: Option<f64>,
    /// What the camera must see.
    pub view: Option<View>,
    /// Pairs of straights that are held apart, with the least distance between their surfaces, m.
    pairs: Vec<(usize, usize, f64)>,
    /// The least height over the floor of each straight, m.
    heights: Vec<f64>,
}

/// Two parts that come near each other, or one that comes near the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Nearness {
    /// Two straights of the arm, counted from the base, with the distance between their surfaces, m.
    Parts(usize, usize, f64),
    /// A straight and the floor, m.
    Floor(usize, f64),
    /// The target leaves the camera's view: the angle to the camera's z axis, rad.
    View(f64),
}

/// What is nearer than wanted in a posture that is known to be free may come this much nearer, m.
const YIELD_M: f64 = 5e-3;

impl Keep {
    /// Of an arm whose posture `free` touches nothing. Parts that are joined by less of the arm than twice
    /// their radii are neighbours, which no capsule tells apart; parts that are nearer than `clear_m` there
    /// already stay about as near.
    pub fn around(
        chain: &Chain,
        free: &[f64],
        body: Body,
        clear_m: f64,
        floor_m: Option<f64>,
        view: Option<View>,
    ) -> Self {
        let points = points(chain, free);
        let lengths: Vec<f64> = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
        let mut pairs = Vec::new();
        for j in 2..lengths.len() {
            for i in 0..j - 1 {
                let path: f64 = lengths[i + 1..j].iter().sum();
                let thick = body.radius_m[i] + body.radius_m[j];
                if path > 2.0 * thick + clear_m {
                    let apart = between(&points[i..i + 2], &points[j..j + 2]) - thick;
                    pairs.push((i, j, clear_m.min(apart - YIELD_M)));
                }
            }
        }
        let mut keep = Self { body, clear_m, floor_m, view, pairs, heights: Vec::new() };
        if let Some(floor_m) = floor_m {
            let height = |at: usize| keep.height(&points, at) - floor_m;
            keep.heights =
                (0..lengths.len()).map(|at| clear_m.min(height(at) - YIELD_M).max(0.0)).collect();
        }
        keep
    }

    /// The height of the lowest point of a straight, m; of one whose ends do not move none.
    fn height(&self, points: &[Vec3], at: usize) -> f64 {
        match at {
            0 => f64::INFINITY,
            _ => points[at].z.min(points[at + 1].z) - self.body.radius_m[at],
        }
    }

    /// What comes too near in posture `q`.
    pub fn offence(&self, chain: &Chain, q: &[f64]) -> Option<Nearness> {
        let points = points(chain, q);
        let parts = self.pairs.iter().find_map(|&(i, j, least)| {
            let thick = self.body.radius_m[i] + self.body.radius_m[j];
            let apart = between(&points[i..i + 2], &points[j..j + 2]) - thick;
            (apart < least).then_some(Nearness::Parts(i, j, apart))
        });
        let floor = || {
            let floor_m = self.floor_m?;
            self.heights.iter().enumerate().find_map(|(at, &least)| {
                let height = self.height(&points, at) - floor_m;
                (height < least).then_some(Nearness::Floor(at, height))
            })
        };
        let view = || {
            let view = self.view?;
            let angle = view.angle(&chain.forward(q));
            (angle > view.half_rad).then_some(Nearness::View(angle))
        };
        parts.or_else(floor).or_else(view)
    }

    /// What is nearer than wanted in posture `q` all the same: pairs of parts, and parts over the floor.
    pub fn near(&self, chain: &Chain, q: &[f64]) -> Vec<Nearness> {
        let points = points(chain, q);
        let pairs = self.pairs.iter().filter_map(|&(i, j, _)| {
            let thick = self.body.radius_m[i] + self.body.radius_m[j];
            let apart = between(&points[i..i + 2], &points[j..j + 2]) - thick;
            (apart < self.clear_m).then_some(Nearness::Parts(i, j, apart))
        });
        let floor = (0..self.heights.len()).filter_map(|at| {
            let height = self.height(&points, at) - self.floor_m?;
            (height < self.clear_m).then_some(Nearness::Floor(at, height))
        });
        pairs.chain(floor).collect()
    }

    /// How many pairs of parts are held apart.
    pub fn pairs(&self) -> usize {
        self.pairs.len()
    }
}

impl View {
    /// The angle between the camera's z axis and the direction to the target, rad.
    fn angle(&self, base_from_hand: &Pose) -> f64 {
        let camera = base_from_hand * self.hand_from_camera;
        let seen = camera.inverse() * nalgebra::Point3::from(self.target);
        seen.x.hypot(seen.y).atan2(seen.z)
    }
}

/// The origins of the base, the joints and the tip, m.
pub(super) fn points(chain: &Chain, q: &[f64]) -> Vec<Vec3> {
    let mut frames = Vec::new();
    chain.joint_frames(q, &mut frames);
    let joints = frames.iter().map(|frame| frame.translation.vector);
    let tip = chain.forward(q).translation.vector;
    std::iter::once(Vec3::zeros()).chain(joints).chain([tip]).collect()
}

/// The distance between two straights, m (Ericson, *Real-Time Collision Detection*, 2005, ch. 5.1.9).
fn between(one: &[Vec3], other: &[Vec3]) -> f64 {
    const NONE: f64 = 1e-12;
    let (d1, d2, r) = (one[1] - one[0], other[1] - other[0], one[0] - other[0]);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let (s, t) = if a <= NONE && e <= NONE {
        (0.0, 0.0)
    } else if a <= NONE {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else {
        let c = d1.dot(&r);
        if e <= NONE {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else {
            let b = d1.dot(&d2);
            let denominator = a * e - b * b;
            let s = match denominator > NONE * a * e {
                true => ((b * f - c * e) / denominator).clamp(0.0, 1.0),
                false => 0.0,
            };
            match (b * s + f) / e {
                t if t < 0.0 => ((-c / a).clamp(0.0, 1.0), 0.0),
                t if t > 1.0 => (((b - c) / a).clamp(0.0, 1.0), 1.0),
                t => (s, t),
            }
        }
    };
    (one[0] + d1 * s - other[0] - d2 * t).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straights_are_as_far_apart_as_their_nearest_points() {
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
