//! Separates measurements from commands and copies; adds rotation and velocity.

use serde::{Deserialize, Serialize};

use crate::diagnosis::{
    ColumnMapping, GroupShift, JointColumns, JointValueUnit, MappingConstraints,
};
use crate::finding::Unit;

use super::cells::NumberKind;
use super::{ColumnQuestion, ColumnSearch};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct IdentifiedArm {
    pub arm: String,
    pub mapping: ColumnMapping,
    pub joints_why: String,
    /// Position, then rotation.
    pub pose: Vec<usize>,
    pub pose_why: String,
    /// Whether the pose is a command.
    pub is_pose_command: bool,
    /// Columns of the joint velocities.
    #[serde(default)]
    pub velocities: Option<Vec<usize>>,
    pub joint_commands: Option<(Vec<usize>, String)>,
    pub pose_commands: Option<(Vec<usize>, String)>,
    pub others: Vec<(Vec<usize>, String)>,
}

impl IdentifiedArm {
    /// Whether all columns are among the first `count`.
    pub fn is_within(&self, count: usize) -> bool {
        self.all_columns().iter().chain(&self.mapping.position).all(|&at| at < count)
    }

    pub fn all_columns(&self) -> Vec<usize> {
        let commands = [&self.joint_commands, &self.pose_commands].into_iter().flatten();
        let further = commands.chain(&self.others).flat_map(|(columns, _)| columns.iter().copied());
        let own = self.mapping.joints.iter().chain(self.velocities.iter().flatten());
        own.chain(&self.pose).copied().chain(further).collect()
    }
}

/// Columns that match after a time shift.
struct MatchingColumns {
    columns: Vec<usize>,
    shift: GroupShift,
}

/// A position that matches after a time shift.
type MatchingPosition = ([usize; 3], GroupShift);

impl MatchingColumns {
    fn is_copy(&self) -> bool {
        self.shift.residual < 1e-9 && self.shift.delay_s == 0.0
    }
}

/// Residual of a desired position of the tool over that of the measured one. The search for encodings of joints uses the same.
const MIN_RESIDUAL_RATIO: f64 = 5.0;
/// Typical link deviations at the tip. Smaller residuals distinguish nothing.
const MIN_RESIDUAL_M: f64 = 1e-4;
/// Minimum lead of commands, s, if poses distinguish them.
const MIN_LEAD_S: f64 = 0.02;

impl ColumnSearch<'_> {
    /// Completes `best` with commands, velocities, rotation and copies. `next_best` is the next best mapping of
    /// the same columns.
    ///
    /// # Errors
    /// A question if the measured columns cannot be determined.
    pub(super) fn complete_mapping(
        &self,
        best: &ColumnMapping,
        next_best: Option<&ColumnMapping>,
        mappings: &[ColumnMapping],
        wanted: &MappingConstraints,
    ) -> Result<IdentifiedArm, ColumnQuestion> {
        let table = &self.cells.table;
        let mut others = Vec::new();
        let mut family: Vec<MatchingColumns> = Vec::new();
        if wanted.joints.is_none() {
            for JointColumns { joints: columns, unit, .. } in table.blocks(wanted, best.arm) {
                let is_apart = |joints: &[usize]| columns.iter().all(|at| !joints.contains(at));
                if !is_apart(&best.joints) || !family.iter().all(|same| is_apart(&same.columns)) {
                    continue;
                }
                let shift = table.group_shift(&best.joints, &columns).filter(|_| unit == best.unit);
                family.extend(shift.map(|shift| MatchingColumns { columns, shift }));
            }
        }
        let name = |columns: &[usize]| self.label(columns);
        let mut mapping = best.clone();
        let (copies, family): (Vec<_>, Vec<_>) =
            family.into_iter().partition(MatchingColumns::is_copy);
        for copy in copies {
            others.push((copy.columns, format!("the same numbers as {}", name(&best.joints))));
        }
        // The latest matching column is the measurement.
        let min_lead_s = MIN_LEAD_S.max(0.3 * table.step_s());
        let mut ends: Vec<(f64, Vec<usize>)> = family
            .into_iter()
            .map(|same| (same.shift.delay_s, same.columns))
            .chain([(0.0, best.joints.clone())])
            .collect();
        ends.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (last_s, joints) = ends[0].clone();
        if let Some((next_s, next)) = ends.get(1).filter(|next| last_s - next.0 < min_lead_s) {
            let with = |joints: &[usize]| {
                let mapping = ColumnMapping { joints: joints.to_vec(), ..best.clone() };
                self.answer_with(&mapping, wanted)
            };
            let (first, second) = (with(&joints), with(next));
            let text = format!(
                "{} and {} match within {:.0} ms, so the measured one is unknown: use {first}, or {second}",
                name(&joints),
                name(next),
                1e3 * (last_s - next_s).max(0.001),
            );
            return Err(ColumnQuestion { text, proposal: first.layout });
        }
        let lead_s = ends.iter().map(|end| last_s - end.0).fold(0.0, f64::max);
        let joint_commands = ends.pop().filter(|_| !ends.is_empty()).map(|(at_s, columns)| {
            let why = format!(
                "joint commands: they match {}, {:.0} ms earlier",
                name(&joints),
                1e3 * (last_s - at_s)
            );
            (columns, why)
        });
        if joints != mapping.joints {
            mapping = self.refit(&joints, best.position, best, wanted).unwrap_or(mapping);
            mapping.joints = joints;
            mapping.lag_s = best.lag_s - last_s;
        }
        for (_, columns) in ends.into_iter().skip(1) {
            others.push((columns, format!("they match {}, earlier", name(&mapping.joints))));
        }
        let mut pose_commands = None;
        let (mut position, mut lag_s) = (mapping.position, mapping.lag_s);
        let (same, points) = match wanted.position {
            Some(_) => Default::default(),
            None => self.further_positions((best, &mapping), mappings, wanted),
        };
        for (other, shift) in same {
            match shift {
                shift if shift.residual < 1e-9 && shift.delay_s == 0.0 => {
                    others
                        .push((other.to_vec(), format!("the same numbers as {}", name(&position))));
                }
                shift if shift.delay_s > min_lead_s => {
                    pose_commands = Some((position, shift.delay_s));
                    (position, lag_s) = (other, lag_s + shift.delay_s);
                }
                shift if shift.delay_s < -min_lead_s => {
                    pose_commands = Some((other, -shift.delay_s));
                }
                _ => {
                    let refit =
                        |position: [usize; 3]| self.refit(&mapping.joints, position, best, wanted);
                    if let Some((own, of_other)) = refit(position).zip(refit(other)) {
                        let is_nearer = |one: &ColumnMapping, than: &ColumnMapping| {
                            than.residual_m
                                > MIN_RESIDUAL_M.max(MIN_RESIDUAL_RATIO * one.residual_m)
                        };
                        let why = || "the same position, further from FK".to_owned();
                        if is_nearer(&own, &of_other) {
                            others.push((other.to_vec(), why()));
                            continue;
                        }
                        if is_nearer(&of_other, &own) {
                            others.push((position.to_vec(), why()));
                            position = other;
                            mapping = of_other;
                            continue;
                        }
                    }
                    let with = |position: [usize; 3]| {
                        self.answer_with(&ColumnMapping { position, ..mapping.clone() }, wanted)
                    };
                    let (first, second) = (with(position), with(other));
                    let text = format!(
                        "{} and {} are the same position, and the measured one is unknown: use {first}, or \
                         {second}",
                        name(&position),
                        name(&other),
                    );
                    return Err(ColumnQuestion { text, proposal: first.layout });
                }
            }
        }
        for other in points {
            let why =
                "the position of another point on the tool, which also follows the arm".to_owned();
            others.push((other.to_vec(), why));
        }
        mapping.position = position;
        mapping.lag_s = lag_s;
        let is_pose_command = pose_commands.is_none()
            && joint_commands.is_some()
            && lag_s < -MIN_LEAD_S
            && (lag_s + lead_s).abs() < 0.25 * lead_s;
        let (pose, rotation) = self.with_rotation(&mapping, wanted);
        let pose_commands = pose_commands.map(|(position, lead_s)| {
            let command =
                ColumnMapping { position, lag_s: mapping.lag_s - lead_s, ..mapping.clone() };
            let why = format!(
                "pose commands: they match {}, {:.0} ms earlier",
                name(&mapping.position),
                1e3 * lead_s
            );
            (self.with_rotation(&command, wanted).0, why)
        });
        let arm = &self.arms[best.arm].name;
        let unit = mapping.unit.name();
        let next = next_best.map_or(String::new(), |next_best| {
            format!(
                "; the next best mapping, {} with {}, matches within {}",
                name(&next_best.joints),
                name(&next_best.position),
                Unit::Metre.show(next_best.residual_m)
            )
        });
        let fits = format!(
            "FK of {arm} with {} in {unit} matches {} within {}, for {} of motion{next}",
            name(&mapping.joints),
            name(&mapping.position),
            Unit::Metre.show(mapping.residual_m),
            Unit::Metre.show(mapping.spread_m)
        );
        let velocities = table.rates_of(&mapping.joints);
        let joints_why = match &velocities {
            Some(rates) => format!("{fits}; their velocities are in {}", name(rates)),
            None => fits.clone(),
        };
        Ok(IdentifiedArm {
            arm: arm.clone(),
            joints_why,
            velocities,
            pose,
            pose_why: format!("{fits}; {rotation}"),
            is_pose_command,
            joint_commands,
            pose_commands,
            others,
            mapping,
        })
    }

    fn further_positions(
        &self,
        (best, mapping): (&ColumnMapping, &ColumnMapping),
        mappings: &[ColumnMapping],
        wanted: &MappingConstraints,
    ) -> (Vec<MatchingPosition>, Vec<[usize; 3]>) {
        let table = &self.cells.table;
        let mut known: Vec<usize> = [mapping.joints.as_slice(), &mapping.position].concat();
        known.extend(wanted.taken);
        let mut same = Vec::new();
        for other in table.positions(&known) {
            let is_new = other.iter().all(|at| !known.contains(at));
            let shift = table.group_shift(&mapping.position, &other);
            if let Some(shift) = shift.filter(|_| is_new) {
                known.extend(other);
                same.push((other, shift));
            }
        }
        let mut points = Vec::new();
        for other in mappings.iter().filter(|other| other.fits() && other.joints == best.joints) {
            if other.position.iter().all(|at| !known.contains(at)) {
                known.extend(other.position);
                points.push(other.position);
            }
        }
        (same, points)
    }

    fn refit(
        &self,
        joints: &[usize],
        position: [usize; 3],
        best: &ColumnMapping,
        wanted: &MappingConstraints,
    ) -> Option<ColumnMapping> {
        if best.unit != JointValueUnit::Radians {
            return None;
        }
        let joints = [joints.to_vec()];
        let wanted = MappingConstraints {
            chains: &wanted.chains[best.arm..=best.arm],
            joints: Some(&joints),
            position: Some(position),
            taken: &[],
            max_lag_s: wanted.max_lag_s,
        };
        let found = self.cells.table.mappings(&wanted).into_iter().next()?;
        Some(ColumnMapping { arm: best.arm, ..found })
    }

    pub(super) fn with_rotation(
        &self,
        mapping: &ColumnMapping,
        wanted: &MappingConstraints,
    ) -> (Vec<usize>, String) {
        let numbers = &self.cells.numbers;
        let [x, y, z] = mapping.position;
        let home = self.cells.table.home(x);
        let is_free = |at: usize| {
            self.cells.table.home(at) == home
                && !mapping.joints.contains(&at)
                && !wanted.taken.contains(&at)
        };
        let block = |from: isize, columns: &[usize]| -> Option<Vec<usize>> {
            let from = usize::try_from(from).ok()?;
            let all: Vec<usize> = columns.iter().map(|at| from + at).collect();
            all.iter().all(|at| *at < numbers.len() && is_free(*at)).then_some(all)
        };
        let table = &self.cells.table;
        let turns = |columns: &[usize]| {
            table.is_tool_rotation(mapping, wanted.chains[mapping.arm], columns)
        };
        let first = x as isize;
        let sixteen: [usize; 16] = std::array::from_fn(|at| at);
        if y == x + 4 || y == x + 1 {
            // A matrix by rows or columns, with or without its last row.
            let by_rows = y == x + 4;
            let from = if by_rows { first - 3 } else { first - 12 };
            let rotation = [0, 1, 2, 4, 5, 6, 8, 9, 10];
            let counts: &[usize] = if by_rows { &[16, 12] } else { &[16] };
            let whole = counts.iter().find_map(|&count| {
                let all = usize::try_from(from).ok()?..usize::try_from(from).ok()? + count;
                let fits = all.clone().all(|at| at < numbers.len() && table.home(at) == home);
                let is_last =
                    || count == 12 || self.is_last_row(&all.clone().collect::<Vec<_>>(), by_rows);
                (fits && is_last() && !all.clone().any(|at| mapping.joints.contains(&at)))
                    .then(|| all.collect::<Vec<usize>>())
            });
            if let Some(whole) = whole
                && let Some(columns) = block(from, &rotation)
                && turns(&columns) == Some(true)
            {
                return (whole, "a matrix whose rotation matches FK".to_owned());
            }
        }
        if y != x + 1 || z != x + 2 {
            return (mapping.position.to_vec(), "no adjacent rotation".to_owned());
        }
        let mut is_at_rest = false;
        // Another array, such as `rotation` next to `position`.
        let arrays = || {
            let all: Vec<usize> = (0..numbers.len()).collect();
            let whole = all.chunk_by(|&one, &other| table.home(one) == table.home(other));
            let is_other = |own: &&[usize]| {
                matches!(own.len(), 3 | 4 | 9)
                    && table.home(own[0]) != home
                    && own.iter().all(|at| {
                        let is_open = numbers[*at].kind == NumberKind::Unidentified;
                        is_open && !mapping.joints.contains(at) && !wanted.taken.contains(at)
                    })
            };
            whole.filter(is_other).map(<[usize]>::to_vec).collect::<Vec<_>>()
        };
        let with_position = |columns: &[usize]| -> (Vec<usize>, String) {
            let pose = match columns {
                nine @ [_, _, _, _, _, _, _, _, _] => {
                    let rows = nine.chunks(3).zip(mapping.position);
                    rows.flat_map(|(row, position)| row.iter().copied().chain([position])).collect()
                }
                _ => [mapping.position.as_slice(), columns].concat(),
            };
            (pose, format!("{} match FK's rotation", self.label(columns)))
        };
        for count in [4, 3, 9] {
            for from in [first + 3, first - count as isize] {
                let Some(columns) = block(from, &sixteen[..count]) else { continue };
                match turns(&columns) {
                    Some(true) => return with_position(&columns),
                    Some(false) => {}
                    None => is_at_rest = true,
                }
            }
        }
        if let Some(columns) = arrays().into_iter().find(|own| turns(own) == Some(true)) {
            return with_position(&columns);
        }
        let reason = match is_at_rest {
            true => "the tool rotates too little to identify its rotation",
            false => "no columns match FK's rotation",
        };
        (mapping.position.to_vec(), reason.to_owned())
    }

    fn is_last_row(&self, all: &[usize], by_rows: bool) -> bool {
        let at = if by_rows { [12, 13, 14, 15] } else { [3, 7, 11, 15] };
        let wanted = [0.0, 0.0, 0.0, 1.0];
        at.iter().zip(wanted).all(|(&at, value)| self.cells.table.is_always(all[at], value))
    }
}
