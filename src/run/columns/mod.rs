//! Identifies table columns by their numbers if names do not.
//!
//! Searches for joints and the tool pose, which FK relates, and for commands, which lead them. If several
//! mappings fit, asks a question with the config lines that answer it.

mod cells;
mod commands;
mod contradictions;
mod named_units;
mod roles;
mod row_layout;
mod shared;
mod tools;
mod topics;

use crate::diagnosis::{
    ColumnContent, ColumnMapping, JointColumns, JointValueUnit, MappingConstraints,
};
use crate::geometry::AngleUnit;
use crate::log::{Log, Note, TableCell, TableShape};
use crate::robot::{Chain, Robot, catalogue};

use super::RunOptions;
use super::role::{Role, array_role};
use super::{models, skeleton};
pub use cells::selectors;
use cells::{NumberKind, TableNumbers, is_unidentified};
pub(super) use named_units::named_units;
use roles::IdentifiedArm;
use row_layout::{Assignment, Content};
pub use shared::{SharedColumns, SharedMapping, SharedRow};

pub(super) struct ArmModel {
    name: String,
    pub chain: Chain,
}

/// Arms that numbered joints may belong to: those of the caller's robots or of the metadata, otherwise of `shared`,
/// otherwise of the catalogue.
pub(super) fn candidate_arms(
    options: &RunOptions,
    robot_type: Option<&str>,
    shared: Option<&SharedColumns>,
) -> Vec<ArmModel> {
    let given = models::read_given_or_shared(options).unwrap_or_default();
    let named = models::robots_for_numbered_joints(&given, robot_type);
    let robots: Vec<&Robot> = match shared {
        _ if !named.is_empty() => named.into_iter().map(|(robot, _)| robot).collect(),
        Some(shared) if shared.is_determined() => shared.robots(),
        _ => catalogue::entries().collect(),
    };
    let arms = robots.into_iter().flat_map(|robot| {
        arm_chains(robot).into_iter().map(|chain| ArmModel { name: robot.name.clone(), chain })
    });
    arms.collect()
}

/// Chains of a robot's arms.
fn arm_chains(robot: &Robot) -> Vec<Chain> {
    let paths = skeleton::find_arm_paths(robot, |_| true).into_iter();
    let chains = paths.filter_map(|path| {
        let tip = skeleton::select_tip(robot, path.end, robot.controller_tip.as_deref());
        let chain = robot.chain(path.base, tip).ok()?;
        (chain.joint_names() == path.joints).then_some(chain)
    });
    chains.collect()
}

#[derive(Default)]
struct IdentifiedColumns {
    arms: Vec<IdentifiedArm>,
    question: Option<ColumnQuestion>,
}

struct ColumnQuestion {
    text: String,
    /// The most likely answer, as a layout.
    proposal: Option<String>,
}

/// Minimum score difference between mappings: a likelihood ratio of e¹⁰.
const MIN_SCORE_DIFFERENCE: f64 = 20.0;
const MAX_ARMS: usize = 2;
/// Spread of the tool position, m. No arm reaches further.
const MIN_SPREAD_M: f64 = 0.02;
const MAX_SPREAD_M: f64 = 4.0;

/// Whether `other` excludes the choice of `best`. Two mappings with a free frame that both fit show that columns of
/// this table match FK by chance.
fn is_alternative(best: &ColumnMapping, other: &ColumnMapping) -> bool {
    other.score < best.score + MIN_SCORE_DIFFERENCE || (!best.is_at_base && other.fits())
}

/// Identifies unnamed columns as joints, poses and commands, and rewrites their topics. Returns the mapping
/// for other logs of the dataset.
pub fn identify_columns(log: &mut Log, options: &RunOptions) -> Option<SharedColumns> {
    let identified = identify_unnamed(log, options);
    row_layout::describe_tables(log);
    identified
}

fn identify_unnamed(log: &mut Log, options: &RunOptions) -> Option<SharedColumns> {
    contradictions::report_contradictions(log);
    commands::identify_commands(log);
    tools::compare_commanded_position(log);
    if !log.topics.iter().any(is_unidentified) {
        return None;
    }
    let Some(cells) = TableNumbers::collect(&log.topics).filter(TableNumbers::needs_search) else {
        topics::exclude_singles(log);
        return None;
    };
    let names = cells.names();
    let shared = options.shared.as_ref().and_then(|shared| shared.columns_for(&names));
    let table = cells.numbers.first().map_or(0, |number| number.cell.table);
    let shape = log.tables.get(table).cloned();
    let search = ColumnSearch::new(&cells, options, log.robot_type.as_deref(), shared, shape);
    let identified = match shared {
        Some(shared) => search.verify_shared(shared, log),
        None => search.identify(log),
    };
    topics::rewrite(log, &search, &identified);
    log.question = identified.question.as_ref().map(|question| question.text.clone());
    if let (Some(what), Some(file)) = (&log.question, log.files.first()) {
        log.notes.push(Note { file: file.path.clone(), what: what.clone() });
    }
    let proposal = identified.question.as_ref().and_then(|question| question.proposal.as_ref());
    if let (Some(proposal), Some(shape)) = (proposal, log.tables.get_mut(table)) {
        shape.layout = Some(proposal.clone());
        shape.layout_reason.clone_from(&log.question);
    }
    Some(SharedColumns::new(names, identified))
}

struct ColumnSearch<'a> {
    cells: &'a TableNumbers,
    arms: Vec<ArmModel>,
    max_lag_s: f64,
    shape: Option<TableShape>,
}

/// An answer to a question about columns.
#[derive(PartialEq)]
struct Answer {
    /// As a value of `--columns`.
    layout: Option<String>,
    /// Lines for `[columns]` of the config, if no layout states it.
    lines: String,
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.layout {
            Some(layout) => write!(f, "--columns '{layout}'"),
            None => write!(f, "[columns] {}", self.lines),
        }
    }
}

impl<'a> ColumnSearch<'a> {
    fn new(
        cells: &'a TableNumbers,
        options: &RunOptions,
        robot_type: Option<&str>,
        shared: Option<&SharedColumns>,
        shape: Option<TableShape>,
    ) -> Self {
        let arms = candidate_arms(options, robot_type, shared);
        Self { cells, arms, max_lag_s: options.max_latency_s.min(1.0), shape }
    }

    fn chains(&self) -> Vec<&Chain> {
        self.arms.iter().map(|arm| &arm.chain).collect()
    }

    fn identify(&self, log: &Log) -> IdentifiedColumns {
        let mut identified = IdentifiedColumns::default();
        let joints = self.known_joints(log);
        // Of each pose that is known by name; a rotation may be named like a position.
        let known = self.cells.columns_of_kind(NumberKind::Position);
        let positions: Vec<[usize; 3]> =
            known.chunks_exact(3).map(|own| [own[0], own[1], own[2]]).collect();
        let mut taken = self.cells.columns_of_kind(NumberKind::Joint);
        let are_joints_known = !taken.is_empty();
        while identified.arms.len() < MAX_ARMS {
            let chains = self.chains();
            let mut wanted = MappingConstraints {
                chains: &chains,
                joints: joints.as_deref(),
                position: positions.first().copied(),
                taken: &taken,
                max_lag_s: self.max_lag_s,
            };
            let mut mappings = self.cells.table.mappings(&wanted);
            for other in positions.iter().skip(1) {
                let wanted = MappingConstraints { position: Some(*other), ..wanted };
                mappings.extend(self.cells.table.mappings(&wanted));
                mappings.sort_by(|a, b| a.score.total_cmp(&b.score));
            }
            if let (Some(best), [_, _, ..]) = (mappings.first(), positions.as_slice()) {
                wanted.position = Some(best.position);
            }
            mappings.retain(|mapping| {
                self.uses_whole_arrays(mapping) && mapping.spread_m < MAX_SPREAD_M
            });
            // A second arm uses the same unit, and the base frame if the first does.
            if let Some(first) = identified.arms.first().map(|arm| &arm.mapping) {
                mappings.retain(|it| it.unit == first.unit && it.is_at_base >= first.is_at_base);
            }
            // With a free frame and tool, other columns may fit by chance.
            let at_base: Vec<Vec<usize>> =
                mappings.iter().filter(|it| it.is_at_base).map(|it| it.joints.clone()).collect();
            if !at_base.is_empty() {
                mappings.retain(|mapping| at_base.contains(&mapping.joints));
            }
            let Some(best) =
                mappings.first().filter(|best| best.fits() && best.spread_m > MIN_SPREAD_M)
            else {
                break;
            };
            // Prefer the point on the tool that is nearest to the tip.
            const MIN_TOOL_DIFFERENCE_M: f64 = 0.01;
            let is_point = |other: &&ColumnMapping| {
                other.fits()
                    && other.joints == best.joints
                    && other.tool_m + MIN_TOOL_DIFFERENCE_M < best.tool_m
            };
            let points = mappings.iter().filter(is_point);
            let best = points.min_by(|a, b| a.tool_m.total_cmp(&b.tool_m)).unwrap_or(best);
            let others = mappings.iter().filter(|other| !other.is_same(best));
            let next_best = others.into_iter().find(|other| self.are_in_conflict(best, other));
            if let Some(next_best) = next_best.filter(|other| is_alternative(best, other)) {
                let other_evidence = || self.question_without_pose(&wanted);
                let is_by_chance = !best.is_at_base && best.joints != next_best.joints;
                let question = is_by_chance.then(other_evidence).flatten();
                let ambiguity = || self.ambiguity_question(best, next_best, &wanted);
                identified.question = Some(question.unwrap_or_else(ambiguity));
                break;
            }
            match self.complete_mapping(best, next_best, &mappings, &wanted) {
                Ok(arm) => {
                    taken.extend(arm.all_columns());
                    identified.arms.push(arm);
                }
                Err(question) => {
                    identified.question = Some(question);
                    break;
                }
            }
            if are_joints_known || !positions.is_empty() {
                break;
            }
        }
        let is_open = identified.arms.is_empty() && identified.question.is_none();
        if is_open && !are_joints_known {
            identified.question = self.question_by_width(log);
        }
        identified
    }

    /// Whether a mapping uses whole arrays, not part of one such as `position0` … `position6`. It may omit
    /// a gripper or one of two arms, or use an array that has the whole position.
    fn uses_whole_arrays(&self, mapping: &ColumnMapping) -> bool {
        let stem = |at: usize| self.stem(at);
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

    /// Name of a number without its index.
    fn stem(&self, at: usize) -> &str {
        let name = self.cells.numbers[at].cell.name.as_str();
        name.trim_end_matches(']').trim_end_matches(|c: char| c.is_ascii_digit())
    }

    /// Whether the names of these columns differ only in numbers. Other names would say that they are joints.
    fn are_alike(&self, columns: &[usize]) -> bool {
        columns.windows(2).all(|pair| self.stem(pair[0]) == self.stem(pair[1]))
    }

    fn known_joints(&self, log: &Log) -> Option<Vec<Vec<usize>>> {
        let known = self.cells.columns_of_kind(NumberKind::Joint);
        let first = self.cells.numbers.get(*known.first()?)?.at.0;
        let Some(crate::stream::Columns::Joints(joints)) = &log.topics[first].columns else {
            return None;
        };
        let place = |part: usize| {
            known.iter().copied().find(|&at| self.cells.numbers[at].at == (first, part))
        };
        let of_arm = |arm: &ArmModel| -> Vec<usize> {
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
    fn are_in_conflict(&self, one: &ColumnMapping, other: &ColumnMapping) -> bool {
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
            && self.cells.table.group_shift(&one.joints, &other.joints).is_some()
    }

    fn names(&self, columns: &[usize]) -> Vec<String> {
        let names: Vec<String> =
            columns.iter().map(|&at| self.cells.numbers[at].cell.name.clone()).collect();
        selectors(&names)
    }

    fn label(&self, columns: &[usize]) -> String {
        match self.names(columns).as_slice() {
            [only] => only.clone(),
            [first, .., last] => format!("{first}…{last}"),
            [] => String::new(),
        }
    }

    fn config_line(&self, key: &str, columns: &[usize]) -> String {
        let quoted: Vec<String> =
            self.names(columns).iter().map(|name| format!("\"{name}\"")).collect();
        match quoted.as_slice() {
            [only] => format!("{key} = {only}"),
            several => format!("{key} = [{}]", several.join(", ")),
        }
    }

    fn config_lines(&self, mapping: &ColumnMapping) -> String {
        let (joints, pose) = (
            self.config_line("joints", &mapping.joints),
            self.config_line("pose", &mapping.position),
        );
        format!("{joints}; {pose}")
    }

    /// A layout with these columns, besides those known by name, or else lines for the config.
    fn answer(&self, groups: &[(Option<&str>, Content, &[usize])]) -> Answer {
        let cells = |columns: &[usize]| -> Vec<TableCell> {
            columns.iter().map(|&at| self.cells.numbers[at].cell.clone()).collect()
        };
        let assignment = |(arm, content, columns): &(Option<&str>, Content, &[usize])| Assignment {
            arm: arm.map(str::to_owned),
            is_command: false,
            content: *content,
            cells: cells(columns),
        };
        let mut assigned: Vec<Assignment> = groups.iter().map(assignment).collect();
        let is_asked = |content: fn(&Content) -> bool| {
            groups.iter().any(|(_, own, columns)| content(own) && !columns.is_empty())
        };
        let joints = self.cells.columns_of_kind(NumberKind::Joint);
        if !joints.is_empty() && !is_asked(|own| matches!(own, Content::Joints(_))) {
            assigned.push(assignment(&(None, Content::Joints(None), &joints)));
        }
        // Velocities that are known by name.
        if !is_asked(|own| matches!(own, Content::Velocities))
            && let Some(shape) = &self.shape
        {
            let of_joints = assigned.iter().filter(|own| matches!(own.content, Content::Joints(_)));
            let velocities = of_joints.map(|joints| Assignment {
                arm: joints.arm.clone(),
                is_command: false,
                content: Content::Velocities,
                cells: shape.velocities_of(&joints.cells),
            });
            assigned.extend(velocities.collect::<Vec<_>>());
        }
        let table = self.cells.numbers.first().map_or(0, |number| number.cell.table);
        let shape = self.shape.as_ref();
        match shape.and_then(|shape| row_layout::layout(shape, table, &assigned)) {
            Some(layout) => Answer { layout: Some(layout.to_string()), lines: String::new() },
            None => {
                let line = |(arm, content, columns): &(Option<&str>, Content, &[usize])| {
                    let key = match content {
                        Content::Joints(_) => "joints",
                        Content::Velocities => return None,
                        Content::Pose(_) => "pose",
                    };
                    let table = arm.map_or(String::new(), |arm| format!("arm.{arm}."));
                    Some(self.config_line(&format!("{table}{key}"), columns))
                };
                let lines: Vec<String> = groups.iter().filter_map(line).collect();
                Answer { layout: None, lines: lines.join("; ") }
            }
        }
    }

    fn answer_with(&self, mapping: &ColumnMapping, wanted: &MappingConstraints<'_>) -> Answer {
        let velocities = self.cells.table.rates_of(&mapping.joints).unwrap_or_default();
        let (pose, _) = self.with_rotation(mapping, wanted);
        let unit = match mapping.unit {
            JointValueUnit::Radians => None,
            JointValueUnit::Degrees => Some(AngleUnit::Degree),
            JointValueUnit::Ticks { .. } | JointValueUnit::Shares => {
                return Answer { layout: None, lines: self.config_lines(mapping) };
            }
        };
        self.answer(&[
            (None, Content::Joints(unit), &mapping.joints),
            (None, Content::Velocities, &velocities),
            (None, Content::Pose(None), &pose),
        ])
    }

    fn ambiguity_question(
        &self,
        best: &ColumnMapping,
        next_best: &ColumnMapping,
        wanted: &MappingConstraints<'_>,
    ) -> ColumnQuestion {
        let describe = |it: &ColumnMapping| {
            format!(
                "{} as joints of {}, residual {} in {} ({})",
                self.label(&it.joints),
                self.arms[it.arm].name,
                crate::finding::Unit::Metre.show(it.residual_m),
                self.label(&it.position),
                self.answer_with(it, wanted)
            )
        };
        let text = format!("ambiguous columns: {}, or {}", describe(best), describe(next_best));
        ColumnQuestion { text, proposal: self.answer_with(best, wanted).layout }
    }

    /// Asks which numbers are the joints if no position identifies them. Suggests arrays as wide as one or
    /// two arms, with or without grippers, but no commands.
    fn question_by_width(&self, log: &Log) -> Option<ColumnQuestion> {
        let table = &self.cells.table;
        let chains = self.chains();
        let max_lag_s = self.max_lag_s;
        let wanted = MappingConstraints { chains: &chains, max_lag_s, ..Default::default() };
        let mut suggestions: Vec<Answer> = Vec::new();
        let mut first = 0;
        while first < self.cells.numbers.len() && suggestions.is_empty() {
            let home = table.home(first);
            let is_next = |at: usize| table.home(at) == home && self.are_alike(&[first, at]);
            let width = (first..self.cells.numbers.len()).take_while(|&at| is_next(at)).count();
            let topic = &log.topics[self.cells.numbers[first].at.0];
            let is_command = array_role(&topic.name, width, false).0 == Role::Reference;
            let may_be_joints = !is_command && !self.is_pose_array(first);
            for (arm, chain) in chains.iter().enumerate().filter(|_| may_be_joints) {
                let dof = chain.dof();
                let blocks = || -> Vec<JointColumns> { table.blocks(&wanted, arm) };
                let unit_of = |blocks: &[JointColumns], from: usize| {
                    let is_it = |block: &&JointColumns| {
                        block.joints.iter().copied().eq(from..from + dof)
                            && !matches!(block.unit, JointValueUnit::Ticks { .. })
                    };
                    blocks.iter().find(is_it).map(|block| block.unit)
                };
                // The one number more is the gripper, last or first.
                let is_gripper_first = || {
                    let is_moving = |at: usize| table.content(at, &[]) != ColumnContent::Constant;
                    !is_moving(first) && is_moving(first + dof)
                };
                let each = match width {
                    width if width == dof + 1 && is_gripper_first() => vec![first + 1],
                    width if width == dof || width == dof + 1 => vec![first],
                    width if width == 2 * dof => vec![first, first + dof],
                    width if width == 2 * (dof + 1) => vec![first, first + dof + 1],
                    _ => continue,
                };
                let blocks = blocks();
                let Some(units) =
                    each.iter().map(|&from| unit_of(&blocks, from)).collect::<Option<Vec<_>>>()
                else {
                    continue;
                };
                // Torques behind the joints have other units than a second arm.
                let is_single = units.len() > 1 && units.windows(2).any(|pair| pair[0] != pair[1]);
                let each = if is_single { &each[..1] } else { &each[..] };
                let joints = |from: usize| (from..from + dof).collect::<Vec<usize>>();
                let content = Content::Joints(None);
                let suggestion = match each {
                    [only] => self.answer_with_joints(&joints(*only)),
                    [left, right, ..] => self.answer(&[
                        (Some("left"), content, &joints(*left)),
                        (Some("right"), content, &joints(*right)),
                    ]),
                    [] => continue,
                };
                if !suggestions.contains(&suggestion) {
                    suggestions.push(suggestion);
                }
            }
            first += width;
        }
        if suggestions.is_empty() {
            return self
                .question_without_pose(&wanted)
                .or_else(|| self.question_at_rest(log))
                .or_else(|| self.question_by_order());
        }
        let texts: Vec<String> = suggestions.iter().map(Answer::to_string).collect();
        let text = format!(
            "no columns are a pose that matches FK of the others, so the joints cannot be identified: if you \
             know them, use {}",
            texts.join(", or ")
        );
        Some(ColumnQuestion { text, proposal: suggestions.swap_remove(0).layout })
    }

    /// Whether the array of a number is a pose: few numbers with a unit quaternion.
    fn is_pose_array(&self, at: usize) -> bool {
        const MAX_WIDTH: usize = 8;
        let table = &self.cells.table;
        let numbers = 0..self.cells.numbers.len();
        let own: Vec<usize> =
            numbers.filter(|&other| table.home(other) == table.home(at)).collect();
        own.len() <= MAX_WIDTH && table.hold_quaternion(&own)
    }

    fn answer_with_joints(&self, joints: &[usize]) -> Answer {
        let velocities = self.cells.table.rates_of(joints).unwrap_or_default();
        self.answer(&[
            (None, Content::Joints(None), joints),
            (None, Content::Velocities, &velocities),
        ])
    }

    /// Suggests joints by evidence other than FK.
    fn question_without_pose(&self, wanted: &MappingConstraints<'_>) -> Option<ColumnQuestion> {
        self.question_by_rates()
            .or_else(|| self.question_by_motion(wanted))
            .or_else(|| self.question_by_blocks())
    }

    /// Suggests columns whose rates are also in the table.
    fn question_by_rates(&self) -> Option<ColumnQuestion> {
        let (own, rates) = self.cells.table.with_rates()?;
        let content = (Content::Joints(None), Content::Velocities);
        let answer = self.answer(&[(None, content.0, &own), (None, content.1, &rates)]);
        let text = format!(
            "{} are the rates of {}, but no pose that matches FK confirms the joints: if these are the joints, use \
             {answer}, and name the arm with --robot",
            self.label(&rates),
            self.label(&own),
        );
        Some(ColumnQuestion { text, proposal: answer.layout })
    }

    /// Suggests a block of columns followed by the block of their rates, as wide as a candidate arm has joints. One
    /// moving joint is enough, if blocks of that width fill the table from its first column.
    fn question_by_blocks(&self) -> Option<ColumnQuestion> {
        let table = &self.cells.table;
        let count = self.cells.numbers.len();
        let mut widths: Vec<usize> = self.arms.iter().map(|arm| arm.chain.dof()).collect();
        widths.sort_unstable();
        widths.dedup();
        let first = |at: usize| (0..count).find(|&other| table.home(other) == table.home(at));
        let joints = widths.into_iter().find_map(|dof| {
            let starts =
                (0..count).filter(|&at| first(at).is_some_and(|first| (at - first) % dof == 0));
            let blocks = starts.filter(|at| at + 2 * dof <= count);
            let is_followed_by_rates = |own: &Vec<usize>| {
                let rates = table.rates_of(own);
                rates.is_some_and(|rates| rates.into_iter().eq(own.iter().map(|at| at + dof)))
            };
            blocks.map(|at| (at..at + dof).collect::<Vec<usize>>()).find(is_followed_by_rates)
        })?;
        let answer = self.answer_with_joints(&joints);
        let moving: Vec<usize> = joints.iter().copied().filter(|&at| table.moves(at)).collect();
        let text = format!(
            "{} and {} are {} columns apart, but no pose that matches FK confirms the joints: if {} are the \
             joints, use {answer}, and name the arm with --robot",
            self.label(&moving),
            if moving.len() == 1 { "its rate" } else { "their rates" },
            joints.len(),
            self.label(&joints),
        );
        Some(ColumnQuestion { text, proposal: answer.layout })
    }

    /// Suggests columns that never change, as many as an arm has joints with its gripper.
    fn question_at_rest(&self, log: &Log) -> Option<ColumnQuestion> {
        let table = &self.cells.table;
        let all: Vec<usize> = (0..self.cells.numbers.len()).collect();
        let mut alike = all.chunk_by(|&one, &other| self.are_alike(&[one, other]));
        let dofs = || self.arms.iter().map(|arm| arm.chain.dof());
        let is_constant = |at: usize| table.content(at, &[]) == ColumnContent::Constant;
        // The last one may be a gripper.
        let state = |columns: &'_ [usize]| -> Option<Vec<usize>> {
            let topic = &log.topics[self.cells.numbers[columns[0]].at.0];
            let count = columns.len();
            let dof = dofs().find(|dof| (*dof..=dof + 1).contains(&count))?;
            let joints = &columns[..dof];
            let is_it = array_role(&topic.name, count, false).0 != Role::Reference
                && joints.iter().all(|&at| is_constant(at))
                && joints.iter().any(|&at| !table.is_always(at, 0.0));
            is_it.then(|| joints.to_vec())
        };
        let joints = alike.find_map(state)?;
        let joints = joints.as_slice();
        let answer = self.answer(&[(None, Content::Joints(None), joints)]);
        let text = format!(
            "{} never change: the arm rests, or the recorder repeats one state; if these are the joints, use {answer}",
            self.label(joints),
        );
        Some(ColumnQuestion { text, proposal: answer.layout })
    }

    /// Suggests the first columns within the joint limits, as many as the only arm has joints; those followed by
    /// their rates come first.
    fn question_by_order(&self) -> Option<ColumnQuestion> {
        let arm = self.arms.first().filter(|_| self.arms.len() <= MAX_ARMS)?;
        let (table, dof) = (&self.cells.table, arm.chain.dof());
        let starts = 0..(self.cells.numbers.len() + 1).saturating_sub(dof);
        let blocks = starts.map(|from| (from..from + dof).collect::<Vec<usize>>());
        let fits = |block: &Vec<usize>| {
            block.iter().all(|&at| table.home(at) == table.home(block[0]))
                && !self.is_pose_array(block[0])
                && self.are_alike(block)
                && table.is_within_limits(block, &arm.chain)
        };
        let blocks: Vec<Vec<usize>> = blocks.filter(fits).collect();
        let with_rates = blocks.iter().find(|block| table.rates_of(block).is_some());
        let joints = with_rates.or(blocks.first())?;
        let answer = self.answer_with_joints(joints);
        let text = format!(
            "{} are the first columns within the joint limits of {}, but the motion does not confirm that they are \
             joints: if they are, use {answer}",
            self.label(joints),
            arm.name,
        );
        Some(ColumnQuestion { text, proposal: answer.layout })
    }

    /// Suggests neighbouring measured columns, as many as a candidate arm has joints, within its limits.
    fn question_by_motion(&self, wanted: &MappingConstraints<'_>) -> Option<ColumnQuestion> {
        let numbers = &self.cells.numbers;
        let table = &self.cells.table;
        let mut runs: Vec<Vec<usize>> = Vec::new();
        for (at, number) in numbers.iter().enumerate().filter(|(_, it)| it.cell.is_unidentified) {
            let is_next = |last: usize| {
                let (other, own) = (numbers[last].cell.at, number.cell.at);
                last + 1 == at
                    && (other.column != own.column || other.part + 1 == own.part)
                    && self.are_alike(&[last, at])
            };
            match runs.last_mut() {
                Some(run) if run.last().is_some_and(|&last| is_next(last)) => run.push(at),
                _ => runs.push(vec![at]),
            }
        }
        runs.retain(|run| !self.is_pose_array(run[0]));
        let (arm, joints) = runs.into_iter().find_map(|run| {
            let is_it = |block: &JointColumns| {
                block.joints == run && !matches!(block.unit, JointValueUnit::Ticks { .. })
            };
            let mut arms = 0..self.arms.len();
            let arm = arms.find(|&arm| {
                wanted.chains[arm].dof() == run.len() && table.blocks(wanted, arm).iter().any(is_it)
            })?;
            Some((arm, run))
        })?;
        let answer = self.answer_with_joints(&joints);
        let text = format!(
            "{} move within the joint limits of {}, but no pose that matches FK confirms the joints: if these are \
             the joints, use {answer}, and name the arm with --robot",
            self.label(&joints),
            self.arms[arm].name,
        );
        Some(ColumnQuestion { text, proposal: answer.layout })
    }
}
