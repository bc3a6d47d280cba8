//! Joint ranges, and the cells and poses that the tip reached.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use crate::samples::sampling::range_of;
use ground::geometry::{Pose, Vec3, angle_between};
use ground::robot::{Chain, JointKind, Limits};

/// Edge of a cell, m.
pub const CELL_SIZE_M: f64 = 0.02;
/// Angle between distinct orientations, rad.
pub const MIN_ORIENTATION_DIFFERENCE_RAD: f64 = 15.0 * PI / 180.0;
/// Joint difference of distinct configurations, rad or m.
pub const MIN_CONFIGURATION_DIFFERENCE: f64 = 0.35;
const RANGE_BINS: usize = 72;
const MAX_SAMPLE_S: f64 = 1.0;

/// Range of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpan {
    /// rad or m.
    pub lowest: f64,
    /// rad or m.
    pub highest: f64,
    /// Visited share of the limits, or of a full turn without limits. `None` for a prismatic joint without
    /// limits.
    pub visited: Option<f64>,
}

impl JointSpan {
    /// Span of positions, rad or m. `None` if none is finite.
    pub fn from_positions(positions: &[f64], kind: JointKind, limits: &Limits) -> Option<Self> {
        let finite = || positions.iter().copied().filter(|position| position.is_finite());
        let [lowest, highest] = range_of(finite());
        if lowest > highest {
            return None;
        }
        let range = match (limits.lower, limits.upper, kind) {
            (Some(lower), Some(upper), _) if upper > lower => Some((lower, upper - lower, false)),
            (_, _, JointKind::Prismatic) => None,
            _ => Some((0.0, TAU, true)),
        };
        let visited = range.map(|(lower, width, wraps)| {
            let mut visited = [false; RANGE_BINS];
            for position in finite() {
                let share = (position - lower) / width;
                let share = match wraps {
                    // Avoids the slow remainder.
                    true if (0.0..1.0).contains(&share) => share,
                    true if (-1.0..0.0).contains(&share) => share + 1.0,
                    true => share.rem_euclid(1.0),
                    false => share.clamp(0.0, 1.0),
                };
                visited[((share * RANGE_BINS as f64) as usize).min(RANGE_BINS - 1)] = true;
            }
            visited.iter().filter(|visited| **visited).count() as f64 / RANGE_BINS as f64
        });
        Some(Self { lowest, highest, visited })
    }

    /// rad or m.
    pub fn width(&self) -> f64 {
        self.highest - self.lowest
    }
}

/// Cell of the reach map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReachCell {
    /// Samples.
    pub samples: usize,
    /// Dwell time, s.
    pub dwell_s: f64,
    /// Orientations at least [`MIN_ORIENTATION_DIFFERENCE_RAD`] apart.
    pub orientations: usize,
    /// Indices into [`Workspace::poses`].
    pub poses: Vec<usize>,
}

/// Tip pose when first reached.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachedPose {
    /// s from the run's origin.
    pub t_s: f64,
    /// `base_from_tip` by recorded FK.
    pub base_from_tip: Pose,
    /// Chain positions, rad or m.
    pub q: Vec<f64>,
    /// Samples of this pose and configuration.
    pub samples: usize,
}

/// Cells and poses that a tip reached.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Workspace {
    /// Keyed by index along x, y, z of the base. Cell `i` extends from `i · CELL_SIZE_M` to `(i + 1) ·
    /// CELL_SIZE_M`.
    pub cells: BTreeMap<[i32; 3], ReachCell>,
    /// Distinct poses in time order. Within a cell they differ by [`MIN_ORIENTATION_DIFFERENCE_RAD`] or by
    /// [`MIN_CONFIGURATION_DIFFERENCE`] in a joint.
    pub poses: Vec<ReachedPose>,
}

impl Workspace {
    /// From times, s, and joint positions, rad or m. Skips samples that are not finite.
    pub fn from_samples(chain: &Chain, samples: impl Iterator<Item = (f64, Vec<f64>)>) -> Self {
        let mut workspace = Self::default();
        let mut last: Option<(f64, [i32; 3])> = None;
        for (t_s, q) in samples {
            if let Some((before_s, cell)) = last
                && let Some(place) = workspace.cells.get_mut(&cell)
            {
                place.dwell_s += (t_s - before_s).clamp(0.0, MAX_SAMPLE_S);
            }
            let base_from_tip = chain.forward(&q);
            let xyz = base_from_tip.translation.vector;
            if !xyz.iter().all(|part| part.is_finite()) {
                last = None;
                continue;
            }
            let cell = cell_of(xyz);
            workspace.add(cell, ReachedPose { t_s, base_from_tip, q, samples: 1 });
            last = Some((t_s, cell));
        }
        workspace
    }

    fn add(&mut self, cell: [i32; 3], reached: ReachedPose) {
        let place = self.cells.entry(cell).or_default();
        place.samples += 1;
        let is_oriented = |known: &ReachedPose| {
            let (a, b) = (&known.base_from_tip.rotation, &reached.base_from_tip.rotation);
            angle_between(a, b) < MIN_ORIENTATION_DIFFERENCE_RAD
        };
        let is_same_configuration = |known: &ReachedPose| {
            let mut joints = known.q.iter().zip(&reached.q);
            joints.all(|(a, b)| (a - b).abs() < MIN_CONFIGURATION_DIFFERENCE)
        };
        let mut oriented =
            place.poses.iter().filter(|at| is_oriented(&self.poses[**at])).peekable();
        let is_new_orientation = oriented.peek().is_none();
        match oriented.find(|at| is_same_configuration(&self.poses[**at])) {
            Some(&known) => self.poses[known].samples += 1,
            None => {
                place.orientations += usize::from(is_new_orientation);
                place.poses.push(self.poses.len());
                self.poses.push(reached);
            }
        }
    }
}

fn cell_of(xyz: Vec3) -> [i32; 3] {
    // `as` saturates beyond the range of `i32`.
    [xyz.x, xyz.y, xyz.z].map(|part| (part / CELL_SIZE_M).floor() as i32)
}

/// Centre in the base, m.
pub fn cell_centre_m(cell: [i32; 3]) -> [f64; 3] {
    cell.map(|number| (f64::from(number) + 0.5) * CELL_SIZE_M)
}

/// Smallest and largest tip distance from the base, m. `None` without positions.
pub fn reach_m(chain: &Chain, rows: impl Iterator<Item = Vec<f64>>) -> Option<(f64, f64)> {
    let distances = rows.map(|q| chain.forward(&q).translation.vector.norm());
    let [min_m, max_m] = range_of(distances.filter(|distance| distance.is_finite()));
    (min_m <= max_m).then_some((min_m, max_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::robot::catalogue;

    fn limits(lower: f64, upper: f64) -> Limits {
        Limits { lower: Some(lower), upper: Some(upper), velocity: None }
    }

    #[test]
    fn the_visited_range_is_a_share_of_the_limits_or_of_a_turn() {
        let sweep: Vec<f64> = (0..=1000).map(|k| -0.5 + f64::from(k) * 1e-3).collect();
        let span =
            JointSpan::from_positions(&sweep, JointKind::Revolute, &limits(-1.0, 1.0)).unwrap();
        assert!((span.width() - 1.0).abs() < 1e-12 && (span.lowest + 0.5).abs() < 1e-12);
        assert!((span.visited.unwrap() - 0.5).abs() < 2.0 / RANGE_BINS as f64, "{span:?}");
        let turns: Vec<f64> = (0..3000).map(|k| f64::from(k) * 3.0 * TAU / 3000.0).collect();
        let span =
            JointSpan::from_positions(&turns, JointKind::Continuous, &Limits::default()).unwrap();
        assert_eq!(span.visited, Some(1.0));
        let slides =
            JointSpan::from_positions(&sweep, JointKind::Prismatic, &Limits::default()).unwrap();
        assert_eq!(slides.visited, None);
        assert_eq!(
            JointSpan::from_positions(&[f64::NAN], JointKind::Revolute, &limits(-1.0, 1.0)),
            None
        );
    }

    #[test]
    fn orientations_and_configurations_per_cell_are_counted() {
        let robot = catalogue::find("ur5e").expect("the catalogue has a UR5e");
        let link = |name: &str| robot.link(name).expect("a UR5e has that link");
        let chain = robot.chain(link("base_link"), link("tool0")).expect("they are joined");
        let home = vec![0.2, -1.2, 1.4, -1.0, -1.5, 0.3];
        let turned = |joint: usize, by: f64| {
            let mut q = home.clone();
            q[joint] += by;
            q
        };
        // The last joint turns the tip in place; a full turn is another configuration.
        let samples = [
            (0.0, home.clone()),
            (0.5, turned(5, 0.01)),
            (1.0, turned(5, 1.0)),
            (1.5, turned(5, TAU)),
            (9.0, turned(0, 1.0)),
        ];
        let workspace = Workspace::from_samples(&chain, samples.into_iter());
        assert_eq!((workspace.cells.len(), workspace.poses.len()), (2, 4));
        let tip = chain.forward(&home).translation.vector;
        let place = &workspace.cells[&cell_of(tip)];
        assert_eq!((place.samples, place.orientations, place.poses.len()), (4, 2, 3));
        // The last sample lasts at most 1 s.
        assert!((place.dwell_s - 2.5).abs() < 1e-12);
        assert_eq!(workspace.poses[0].samples, 2);
        let centre = cell_centre_m(cell_of(tip));
        assert!((0..3).all(|axis| (centre[axis] - tip[axis]).abs() <= CELL_SIZE_M / 2.0));
        let (least, most) = reach_m(&chain, [home].into_iter()).unwrap();
        assert!((least - tip.norm()).abs() < 1e-12 && least == most);
    }
}
