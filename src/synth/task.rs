//! Industrial tasks as sequences of tip poses.

use rand::RngExt;
use rand_pcg::Pcg64;

use crate::geometry::{Pose, Vec3, rotation_from_rotvec};

/// Task with straight tip paths. As in real cells, most keep the tool's z axis fixed or rotate it about one
/// axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Tool-down, with rotation about the vertical.
    Picking,
    /// Fills a grid from one place, without rotation.
    Palletising,
    /// Slow seams with a weave, at constant tilt.
    Welding,
    /// Parallel strokes, tilted at the ends.
    Spraying,
    /// Corners of a rectangle, with rotation about the tool's z axis.
    Screwdriving,
    /// Picks tilted, places level.
    BinPicking,
    /// Small moves in all directions.
    Teleoperation,
    /// Small corrections of position and angle.
    Servoing,
    /// Picks from a moving belt, places to the side.
    Conveyor,
    /// Along one line.
    Drawer,
    /// Tilts about a point and rests.
    Calibration,
}

/// Motion to one stop, relative to home.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    /// In the base, m.
    shift_m: Vec3,
    /// Rotation vector in the tool frame, rad.
    turn_rad: Vec3,
    /// Mean speed.
    pub(super) speed_m_s: f64,
    pub(super) rest_s: f64,
}

impl Leg {
    /// For a tip at `base_from_home` at home.
    pub(super) fn stop(&self, base_from_home: &Pose) -> Pose {
        let rotation = base_from_home.rotation * rotation_from_rotvec(self.turn_rad);
        Pose::from_parts((base_from_home.translation.vector + self.shift_m).into(), rotation)
    }
}

/// Descent, m.
const DESCENT_M: Vec3 = Vec3::new(0.0, 0.0, 0.08);

fn add_leg(legs: &mut Vec<Leg>, shift_m: Vec3, turn_rad: Vec3, speed_m_s: f64, rest_s: f64) {
    legs.push(Leg { shift_m, turn_rad, speed_m_s, rest_s });
}

/// Descends, rests and retracts.
fn add_visit(legs: &mut Vec<Leg>, speed_m_s: f64, at_m: Vec3, turn_rad: Vec3, rest_s: f64) {
    add_leg(legs, at_m + DESCENT_M, turn_rad, speed_m_s, 0.0);
    add_leg(legs, at_m, turn_rad, 0.5 * speed_m_s, rest_s);
    add_leg(legs, at_m + DESCENT_M, turn_rad, 0.5 * speed_m_s, 0.0);
}

impl Task {
    pub(super) fn legs(self, random: &mut Pcg64, count: usize) -> Vec<Leg> {
        /// Half width, m.
        const WIDTH_M: f64 = 0.1;
        let mut legs: Vec<Leg> = Vec::new();
        let level = |random: &mut Pcg64, size: f64| {
            Vec3::new(random.random_range(-size..size), random.random_range(-size..size), 0.0)
        };
        let heading: f64 = random.random_range(-0.8..0.8);
        let along = Vec3::new(heading.cos(), heading.sin(), 0.0);
        let across = Vec3::new(-along.y, along.x, 0.0);
        let tilt = random.random_range(0.1..0.4) * Vec3::x();
        let speed_m_s = random.random_range(0.1..0.25);
        // Half of the picking cells rotate the part.
        let yaw_rad = if random.random_bool(0.5) { 0.6 } else { 1e-9 };
        let (start, level_turn) = (Vec3::zeros(), Vec3::zeros());
        add_leg(&mut legs, start, if self == Task::Welding { tilt } else { level_turn }, 0.1, 0.4);
        let mut cycle = 0;
        while legs.len() < count {
            match self {
                Task::Picking => {
                    let turn = random.random_range(-yaw_rad..yaw_rad) * Vec3::z();
                    add_visit(
                        &mut legs,
                        speed_m_s,
                        level(random, WIDTH_M),
                        turn,
                        random.random_range(0.2..0.6),
                    );
                }
                Task::Palletising => {
                    let place = [cycle % 3, cycle / 3 % 3, cycle / 9 % 3].map(f64::from);
                    let place = Vec3::new(0.05 * place[0], 0.05 * place[1], 0.02 * place[2]);
                    add_visit(&mut legs, speed_m_s, -WIDTH_M * across, level_turn, 0.4);
                    add_visit(&mut legs, speed_m_s, place, level_turn, 0.3);
                }
                Task::Welding => {
                    let seam = level(random, 0.5 * WIDTH_M);
                    add_leg(&mut legs, seam + 0.5 * DESCENT_M, tilt, speed_m_s, 0.0);
                    for step in 0..16 {
                        let weave_m = if step % 2 == 0 { 0.003 } else { -0.003 };
                        let at = seam + 0.005 * f64::from(step) * along + weave_m * across;
                        add_leg(&mut legs, at, tilt, 0.02, 0.0);
                    }
                    add_leg(&mut legs, seam + 0.08 * along + 0.5 * DESCENT_M, tilt, speed_m_s, 0.0);
                }
                Task::Spraying => {
                    let side = if cycle % 2 == 0 { 1.0 } else { -1.0 };
                    let lane = f64::from(cycle % 8 - 4) * 0.02 * across;
                    add_leg(&mut legs, lane - side * WIDTH_M * along, side * tilt, speed_m_s, 0.0);
                    add_leg(&mut legs, lane + side * WIDTH_M * along, -side * tilt, speed_m_s, 0.0);
                }
                Task::Screwdriving => {
                    let [x, y] = [cycle % 2, cycle / 2 % 2].map(|side| f64::from(2 * side - 1));
                    let hole = 0.8 * WIDTH_M * (x * along + y * across);
                    add_visit(&mut legs, speed_m_s, hole, level_turn, 0.0);
                    add_leg(&mut legs, hole, level_turn, speed_m_s, 0.0);
                    add_leg(&mut legs, hole - 0.05 * DESCENT_M, 1.2 * Vec3::z(), 0.1, 0.3);
                    add_leg(&mut legs, hole + DESCENT_M, level_turn, speed_m_s, 0.0);
                }
                Task::BinPicking => {
                    let turn = level(random, 0.4) + random.random_range(-0.6..0.6) * Vec3::z();
                    add_visit(&mut legs, speed_m_s, level(random, WIDTH_M), turn, 0.4);
                    add_visit(&mut legs, speed_m_s, WIDTH_M * across, level_turn, 0.3);
                }
                Task::Teleoperation => {
                    let up = random.random_range(-0.04..0.04) * Vec3::z();
                    let turn = level(random, 0.06) + random.random_range(-0.15..0.15) * Vec3::z();
                    let rest_s =
                        if random.random_bool(0.2) { random.random_range(0.2..1.0) } else { 0.0 };
                    add_leg(&mut legs, level(random, 0.05) + up, turn, 0.5 * speed_m_s, rest_s);
                }
                Task::Servoing => {
                    let up = random.random_range(-0.03..0.03) * Vec3::z();
                    let turn = level(random, 0.03) + random.random_range(-0.06..0.06) * Vec3::z();
                    add_leg(
                        &mut legs,
                        level(random, 0.06) + up,
                        turn,
                        0.5 * speed_m_s,
                        random.random_range(0.5..1.5),
                    );
                }
                Task::Conveyor => {
                    let lane = random.random_range(-0.04..0.04) * across;
                    let turn = random.random_range(-0.4..0.4) * Vec3::z();
                    let belt = |part: f64| lane + 0.05 * part * along;
                    add_leg(&mut legs, belt(-1.0) + DESCENT_M, turn, speed_m_s, 0.0);
                    add_leg(&mut legs, belt(0.0), turn, 0.08, 0.0);
                    add_leg(&mut legs, belt(0.5), turn, 0.08, 0.0);
                    add_leg(&mut legs, belt(1.5) + DESCENT_M, turn, 0.08, 0.0);
                    add_visit(&mut legs, speed_m_s, WIDTH_M * across, level_turn, 0.3);
                }
                Task::Drawer => {
                    let rest_s = random.random_range(0.3..0.8);
                    add_leg(&mut legs, -0.7 * WIDTH_M * along, level_turn, 0.5 * speed_m_s, rest_s);
                    add_leg(&mut legs, 0.7 * WIDTH_M * along, level_turn, 0.5 * speed_m_s, rest_s);
                }
                Task::Calibration => {
                    let turn = level(random, 0.45) + random.random_range(-0.8..0.8) * Vec3::z();
                    add_leg(
                        &mut legs,
                        level(random, 0.6 * WIDTH_M),
                        turn,
                        speed_m_s,
                        random.random_range(0.5..1.0),
                    );
                }
            }
            cycle += 1;
        }
        legs
    }
}
