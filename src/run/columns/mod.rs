//! Identifies table columns by their numbers if names do not.
//!
//! Searches for joints and the tool pose, which FK relates, and for commands, which lead them. If several
//! mappings fit, asks a question with the config lines that answer it.

mod cells;
mod commands;
mod contradictions;
mod roles;
mod shared;
mod tools;
mod topics;

use crate::diagnosis::{ColumnMapping, JointColumns, MappingConstraints};
use crate::log::{Log, Note};
use crate::robot::{Chain, Robot, catalogue};

use super::RunOptions;
use super::role::{Role, array_role};
use super::{models, skeleton};
pub use cells::selectors;
use cells::{Cells, Known, is_open};
use roles::Taken;
pub use shared::{Shared, SharedColumns, SharedRow};

struct Candidate {
    name: String,
    chain: Chain,
}

#[derive(Default)]
struct Told {
    arms: Vec<Taken>,
    question: Option<String>,
}

/// Minimum score difference between mappings: a likelihood ratio of e¹⁰.
const APART: f64 = 20.0;
const MOST_ARMS: usize = 2;
/// Minimum spread of the tool position, m.
const MOVES_M: f64 = 0.02;

/// Identifies unnamed columns as joints, poses and commands, and rewrites their topics. Returns the mapping
/// for other logs of the dataset.
pub fn identify_columns(log: &mut Log, options: &RunOptions) -> Option<SharedColumns> {
    contradictions::find(log);
    commands::settle(log);
    tools::compare(log);
    if !log.topics.iter().any(is_open) {
        return None;
    }
    let Some(cells) = Cells::of(&log.topics).filter(Cells::is_asked) else {
        topics::leave_singles(log);
        return None;
    };
    let names = cells.names();
    let shared = options.shared.as_ref().and_then(|shared| shared.of(&names));
    let search = Search::new(&cells, options, log.robot_type.as_deref(), shared);
    let told = match shared {
        Some(shared) => search.shared(shared, log),
        None => search.told(log),
    };
    topics::rewrite(log, &search, &told);
    if let (Some(what), Some(file)) = (&told.question, log.files.first()) {
        log.notes.push(Note { file: file.path.clone(), what: what.clone() });
    }
    log.question.clone_from(&told.question);
    Some(SharedColumns::of(names, told))
}

struct Search<'a> {
    cells: &'a Cells,
    arms: Vec<Candidate>,
    max_lag_s: f64,
}

impl<'a> Search<'a> {
    fn new(
        cells: &'a Cells,
        options: &RunOptions,
        robot_type: Option<&str>,
        shared: Option<&SharedColumns>,
    ) -> Self {
        let given = models::given_or_shared(options).unwrap_or_default();
        let named: Vec<&Robot> =
            models::for_numbers(&given, robot_type).into_iter().map(|(robot, _)| robot).collect();
        let robots = match shared {
            _ if !named.is_empty() => named,
            Some(shared) if shared.is_told() => shared.robots(),
            _ => catalogue::entries().iter().collect(),
        };
        let arms = robots.into_iter().flat_map(|robot| {
            let paths = skeleton::arms(robot, |_| true).into_iter();
            paths.filter_map(|path| {
                let tip = skeleton::tip(robot, path.end, robot.controller_tip.as_deref());
                let chain = robot.chain(path.base, tip).ok()?;
                let is_whole = chain.joint_names() == path.joints;
                is_whole.then(|| Candidate { name: robot.name.clone(), chain })
            })
        });
        Self { cells, arms: arms.collect(), max_lag_s: options.max_latency_s.min(1.0) }
    }

    fn chains(&self) -> Vec<&Chain> {
        self.arms.iter().map(|arm| &arm.chain).collect()
    }

    fn told(&self, log: &Log) -> Told {
        let mut told = Told::default();
        let joints = self.known_joints(log);
        let position = self.cells.of_kind(Known::Position);
        let position = <[usize; 3]>::try_from(position.get(..3).unwrap_or_default()).ok();
        let are_joints_known = !self.cells.of_kind(Known::Joint).is_empty();
        let mut taken: Vec<usize> =
            if are_joints_known { self.cells.of_kind(Known::Joint) } else { Vec::new() };
        while told.arms.len() < MOST_ARMS {
            let chains = self.chains();
            let wanted = MappingConstraints {
                chains: &chains,
                joints: joints.as_deref(),
                position,
                taken: &taken,
                max_lag_s: self.max_lag_s,
            };
            let mut mappings = self.cells.sheet.mappings(&wanted);
            mappings.retain(|mapping| self.takes_whole_arrays(mapping));
            // A second arm uses the same unit, and the base frame if the first does.
            if let Some(first) = told.arms.first().map(|arm| &arm.mapping) {
                mappings.retain(|it| it.unit == first.unit && it.is_at_base >= first.is_at_base);
            }
            // With a free frame and tool, other columns may fit by chance.
            let at_base: Vec<Vec<usize>> =
                mappings.iter().filter(|it| it.is_at_base).map(|it| it.joints.clone()).collect();
            if !at_base.is_empty() {
                mappings.retain(|mapping| at_base.contains(&mapping.joints));
            }
            let Some(best) = mappings.first().filter(|best| best.fits() && best.spread_m > MOVES_M)
            else {
                break;
            };
            // Prefer the point on the tool that is nearest to the tip.
            const NEARER_M: f64 = 0.01;
            let is_point = |other: &&ColumnMapping| {
                other.fits() && other.joints == best.joints && other.tool_m + NEARER_M < best.tool_m
            };
            let points = mappings.iter().filter(is_point);
            let best = points.min_by(|a, b| a.tool_m.total_cmp(&b.tool_m)).unwrap_or(best);
            let others = mappings.iter().filter(|other| !other.is_same(best));
            let rival = others.into_iter().find(|other| self.conflict(best, other));
            if let Some(rival) = rival.filter(|rival| rival.score < best.score + APART) {
                told.question = Some(self.either(best, rival));
                break;
            }
            match self.taken(best, rival, &mappings, &wanted) {
                Ok(arm) => {
                    taken.extend(arm.all());
                    told.arms.push(arm);
                }
                Err(question) => {
                    told.question = Some(question);
                    break;
                }
            }
            if are_joints_known || position.is_some() {
                break;
            }
        }
        if told.arms.is_empty() && told.question.is_none() && !are_joints_known {
            told.question = self.by_width(log);
        }
        told
    }

    /// Whether a mapping uses whole arrays, not part of one such as `position0` … `position6`. It may omit
    /// a gripper or one of two arms, or use an array that has the whole position.
    fn takes_whole_arrays(&self, mapping: &ColumnMapping) -> bool {
        let stem = |at: usize| -> &str {
            let name = self.cells.numbers[at].cell.name.as_str();
            name.trim_end_matches(']').trim_end_matches(|c: char| c.is_ascii_digit())
        };
        let Some(own) = mapping.joints.first().map(|&at| stem(at)) else { return false };
        if mapping.joints.iter().any(|&at| stem(at) != own) {
            return true;
        }
        let dof = mapping.joints.len();
        let count = (0..self.cells.numbers.len()).filter(|&at| stem(at) == own).count();
        match mapping.position.iter().filter(|&&at| stem(at) == own).count() {
            0 => count <= dof + 1 || count >= 2 * dof,
            inside => inside == mapping.position.len(),
        }
    }

    fn known_joints(&self, log: &Log) -> Option<Vec<Vec<usize>>> {
        let known = self.cells.of_kind(Known::Joint);
        let first = self.cells.numbers.get(*known.first()?)?.at.0;
        let Some(crate::stream::Columns::Joints(joints)) = &log.topics[first].columns else {
            return None;
        };
        let place = |part: usize| {
            known.iter().copied().find(|&at| self.cells.numbers[at].at == (first, part))
        };
        let of_arm = |arm: &Candidate| -> Vec<usize> {
            let names = arm.chain.joint_names();
            let part = |(at, name): (usize, &String)| match joints.unnamed {
                true => place(at),
                false => place(
                    joints.joints.iter().position(|joint| joint.name.ends_with(name.as_str()))?,
                ),
            };
            names.iter().enumerate().map(part).collect::<Option<_>>().unwrap_or_default()
        };
        Some(self.arms.iter().map(of_arm).collect())
    }

    /// Whether mappings share columns, and differ in more than the tool point or commanded versus measured
    /// joints.
    fn conflict(&self, one: &ColumnMapping, other: &ColumnMapping) -> bool {
        let share = |a: &[usize], b: &[usize]| a.iter().any(|at| b.contains(at));
        let is_one_arm = one.joints == other.joints || self.are_commands(one, other);
        let is_one_point = one.position == other.position;
        let all = |it: &ColumnMapping| [it.joints.as_slice(), &it.position].concat();
        share(&all(one), &all(other))
            && !(is_one_arm && (is_one_point || !share(&one.position, &other.position)))
    }

    /// Whether one mapping's joints are a delayed copy of the other's.
    fn are_commands(&self, one: &ColumnMapping, other: &ColumnMapping) -> bool {
        let apart = one.joints.iter().all(|at| !other.joints.contains(at));
        apart
            && one.unit == other.unit
            && one.joints.len() == other.joints.len()
            && self.cells.sheet.group_shift(&one.joints, &other.joints).is_some()
    }

    fn names(&self, columns: &[usize]) -> Vec<String> {
        let names: Vec<String> =
            columns.iter().map(|&at| self.cells.numbers[at].cell.name.clone()).collect();
        selectors(&names)
    }

    fn said(&self, columns: &[usize]) -> String {
        match self.names(columns).as_slice() {
            [only] => only.clone(),
            [first, .., last] => format!("{first}…{last}"),
            [] => String::new(),
        }
    }

    fn line(&self, key: &str, columns: &[usize]) -> String {
        let quoted: Vec<String> =
            self.names(columns).iter().map(|name| format!("\"{name}\"")).collect();
        match quoted.as_slice() {
            [only] => format!("{key} = {only}"),
            several => format!("{key} = [{}]", several.join(", ")),
        }
    }

    fn lines(&self, mapping: &ColumnMapping) -> String {
        let (joints, pose) =
            (self.line("joints", &mapping.joints), self.line("pose", &mapping.position));
        format!("{joints}; {pose}")
    }

    fn either(&self, best: &ColumnMapping, rival: &ColumnMapping) -> String {
        let way = |it: &ColumnMapping| {
            format!(
                "{} as joints of {}, residual {} in {} ([columns] {})",
                self.said(&it.joints),
                self.arms[it.arm].name,
                crate::finding::Unit::Metre.show(it.residual_m),
                self.said(&it.position),
                self.lines(it)
            )
        };
        format!("ambiguous columns: {}, or {}", way(best), way(rival))
    }

    /// Asks which numbers are the joints if no position identifies them. Suggests arrays as wide as one or
    /// two arms, with or without grippers, but no commands.
    fn by_width(&self, log: &Log) -> Option<String> {
        let sheet = &self.cells.sheet;
        let chains = self.chains();
        let wanted = MappingConstraints {
            chains: &chains,
            joints: None,
            position: None,
            taken: &[],
            max_lag_s: self.max_lag_s,
        };
        let mut ways: Vec<String> = Vec::new();
        let mut first = 0;
        while first < self.cells.numbers.len() && ways.is_empty() {
            let home = sheet.home(first);
            let width =
                (first..self.cells.numbers.len()).take_while(|&at| sheet.home(at) == home).count();
            let topic = &log.topics[self.cells.numbers[first].at.0];
            let is_command = array_role(&topic.name, width, false).0 == Role::Reference;
            for (arm, chain) in chains.iter().enumerate().filter(|_| !is_command) {
                let dof = chain.dof();
                let blocks = || -> Vec<JointColumns> { sheet.blocks(&wanted, arm) };
                let is_block = |blocks: &[JointColumns], from: usize| {
                    blocks.iter().any(|block| block.joints.iter().copied().eq(from..from + dof))
                };
                let each = match width {
                    width if width == dof || width == dof + 1 => vec![first],
                    width if width == 2 * dof => vec![first, first + dof],
                    width if width == 2 * (dof + 1) => vec![first, first + dof + 1],
                    _ => continue,
                };
                let blocks = blocks();
                if !each.iter().all(|&from| is_block(&blocks, from)) {
                    continue;
                }
                let line =
                    |from: usize| self.line("joints", &(from..from + dof).collect::<Vec<usize>>());
                let way = match each.as_slice() {
                    [only] => format!("[columns] {}", line(*only)),
                    [left, right, ..] => format!(
                        "[columns.arm.left] {} and [columns.arm.right] {}",
                        line(*left),
                        line(*right)
                    ),
                    [] => continue,
                };
                if !ways.contains(&way) {
                    ways.push(way);
                }
            }
            first += width;
        }
        if ways.is_empty() {
            let (own, rates) = sheet.with_rates()?;
            return Some(format!(
                "{} are the rates of {}, but no columns are a pose that matches FK, so the joints cannot be \
                 confirmed: if these are the joints, set [columns] {}, and name the arm with --robot",
                self.said(&rates),
                self.said(&own),
                self.line("joints", &own)
            ));
        }
        let ways = ways.join(", or ");
        Some(format!(
            "no columns are a pose that matches FK of the others, so the joints cannot be identified: if you \
             know them, set {ways}"
        ))
    }
}
