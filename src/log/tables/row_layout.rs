//! The `--columns` language: the meaning of each number in the rows of a table, in order.
//!
//! ```text
//! ROW  = ITEM {"," ITEM} ["@" RATE]
//! ITEM = [ARM "/"] ["cmd."] MEANING ["[" COUNT "]"] {":" UNIT}
//! ```
//!
//! | meaning | numbers | units (default first) |
//! |---|---|---|
//! | `_` | ignored | |
//! | `?` | identified by name or by motion | |
//! | `t` | time | `s`, `ms`, `us`, `ns` (from the numbers) |
//! | `s` and `ns` | whole seconds, and the nanoseconds after them | |
//! | `q`, `qd` | joint positions and velocities, in the order of the model's joints | `rad`, `deg` |
//! | `x`, `y`, `z`; `xyz` | tool position | `m`, `mm`, `cm`, `in`, … |
//! | `qx`, `qy`, `qz`, `qw` | components of a quaternion | |
//! | `quat:xyzw`, `quat:wxyz` | a quaternion | |
//! | `rotvec`, `euler:SEQ`, `rpy` | three rotation numbers | `rad`, `deg` |
//! | `rot[3]`, `rot[4]` | a rotation in a convention that the motion shows | |
//! | `matrix[9]`, `matrix[12]`, `matrix[16]` | a rotation matrix; 12 and 16 include the position | `m`, … |
//! | `kuka`, `ur`, `fanuc`, … | position and rotation as the maker writes them | those of the maker |
//!
//! `COUNT` repeats `_`, `?`, `q` and `qd`. `cmd.` marks commands, `ARM/` one of several arms or tools. `@RATE` gives
//! the rows per second of a table without times.

use std::fmt;
use std::str::FromStr;

use crate::contents::Log;
use ground::geometry::{AngleUnit, LengthScale, RotationEncoding, Units, vendors};

/// Columns in one item.
const MAX_COUNT: usize = 2000;

/// Meaning of one item.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Meaning {
    /// Not audited.
    Ignored,
    /// To be identified by name or motion.
    Open,
    /// Time.
    Time,
    /// Whole seconds of a stamp.
    Seconds,
    /// Nanoseconds of a stamp.
    Nanoseconds,
    /// Joint positions.
    Joints,
    /// Joint velocities.
    JointVelocities,
    /// Coordinate x, y or z, by index.
    Axis(usize),
    /// Quaternion component x, y, z or w, by index.
    QuaternionPart(usize),
    /// A whole rotation; `None` for an unknown convention.
    Rotation(Option<RotationEncoding>),
    /// A rotation matrix, with the position if it has 12 or 16 numbers.
    Matrix,
    /// Position and rotation, by the maker's name.
    Vendor(&'static str),
}

/// Meanings other than rotations in a known convention and makers.
const NAMES: [(&str, Meaning); 16] = [
    ("_", Meaning::Ignored),
    ("?", Meaning::Open),
    ("t", Meaning::Time),
    ("s", Meaning::Seconds),
    ("ns", Meaning::Nanoseconds),
    ("q", Meaning::Joints),
    ("qd", Meaning::JointVelocities),
    ("x", Meaning::Axis(0)),
    ("y", Meaning::Axis(1)),
    ("z", Meaning::Axis(2)),
    ("qx", Meaning::QuaternionPart(0)),
    ("qy", Meaning::QuaternionPart(1)),
    ("qz", Meaning::QuaternionPart(2)),
    ("qw", Meaning::QuaternionPart(3)),
    ("rot", Meaning::Rotation(None)),
    ("matrix", Meaning::Matrix),
];
const TIME_UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
const KNOWN: &str = "t, s, ns, q, qd, x, y, z, xyz, qx, qy, qz, qw, quat:xyzw, quat:wxyz, rotvec, rpy, \
     euler:SEQ, rot[3], rot[4], matrix[12], a maker such as kuka, ? to identify, _ to ignore";

impl Meaning {
    /// Whether it belongs to the row, not to an arm or its commands.
    fn is_of_row(self) -> bool {
        matches!(self, Self::Ignored | Self::Open | Self::Time | Self::Seconds | Self::Nanoseconds)
    }

    /// Whether it is a whole rotation, perhaps with the position.
    fn is_rotation(self) -> bool {
        matches!(self, Self::Rotation(_) | Self::Matrix | Self::Vendor(_))
    }

    /// Whether `[COUNT]` repeats it.
    fn repeats(self) -> bool {
        matches!(self, Self::Ignored | Self::Open | Self::Joints | Self::JointVelocities)
    }

    /// Possible numbers; empty if any.
    fn counts(self) -> &'static [usize] {
        match self {
            _ if self.repeats() => &[],
            Self::Rotation(None) => &[3, 4],
            Self::Rotation(Some(RotationEncoding::Three(_))) => &[3],
            Self::Rotation(_) => &[4],
            Self::Matrix => &[9, 12, 16],
            Self::Vendor(name) => match vendors::find(name).map(|it| it.coding) {
                Some(RotationEncoding::Three(_)) => &[6],
                Some(coding) if coding.is_matrix() => &[16],
                _ => &[7],
            },
            _ => &[1],
        }
    }

    /// Whether its numbers are positions, and whether they are angles.
    fn has_units(self, count: usize) -> (bool, bool) {
        match self {
            Self::Joints | Self::JointVelocities => (false, true),
            Self::Axis(_) => (true, false),
            Self::Rotation(Some(RotationEncoding::Three(_)) | None) => (false, count == 3),
            Self::Matrix => (count > 9, false),
            Self::Vendor(_) => (true, count == 6),
            _ => (false, false),
        }
    }

    /// `None` if unknown. `euler` and `quat` include the part after the colon.
    fn parse(name: &str) -> Option<Self> {
        if let Some((_, meaning)) = NAMES.iter().find(|(own, _)| *own == name) {
            return Some(*meaning);
        }
        if name == "rpy" {
            return Some(Self::Rotation("euler:xyz".parse().ok()));
        }
        Some(match RotationEncoding::from_declared_name(name) {
            Ok(coding) => Self::Rotation(Some(coding)),
            Err(_) => Self::Vendor(vendors::names().find(|known| *known == name)?),
        })
    }
}

impl fmt::Display for Meaning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rotation(Some(coding)) => coding.fmt(f),
            Self::Vendor(name) => f.write_str(name),
            _ => {
                let known = NAMES.iter().find(|(_, meaning)| meaning == self);
                f.write_str(known.map_or("", |(name, _)| *name))
            }
        }
    }
}

/// Numbers with one meaning, next to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct LayoutItem {
    /// One of several arms or tools.
    pub arm: Option<String>,
    /// Whether they are commanded, not measured.
    pub is_command: bool,
    /// Their meaning.
    pub meaning: Meaning,
    /// Number of columns.
    pub count: usize,
    /// Unit of a time, s.
    pub time_unit_s: Option<f64>,
    /// Units of positions and angles.
    pub units: Units,
}

impl LayoutItem {
    /// Measured numbers without units.
    pub fn new(meaning: Meaning, count: usize) -> Self {
        Self {
            arm: None,
            is_command: false,
            meaning,
            count,
            time_unit_s: None,
            units: Units::default(),
        }
    }
}

impl fmt::Display for LayoutItem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(arm) = &self.arm {
            write!(f, "{arm}/")?;
        }
        if self.is_command {
            f.write_str("cmd.")?;
        }
        self.meaning.fmt(f)?;
        let shows_count = match self.meaning {
            meaning if meaning.repeats() => self.count > 1,
            meaning => meaning.counts().len() > 1,
        };
        if shows_count {
            write!(f, "[{}]", self.count)?;
        }
        let unit = TIME_UNITS.iter().find(|(_, unit)| Some(*unit) == self.time_unit_s);
        if let Some((name, _)) = unit {
            write!(f, ":{name}")?;
        }
        if let Some(length) = self.units.length {
            write!(f, ":{length}")?;
        }
        match self.units.angle {
            Some(angle) => write!(f, ":{}", angle.symbol()),
            None => Ok(()),
        }
    }
}

/// Meaning of the numbers of a row, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct RowLayout {
    items: Vec<LayoutItem>,
    rate_hz: Option<f64>,
}

/// Why a text is not a [`RowLayout`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("character {at}: {what}")]
pub struct LayoutError {
    /// Character, from 1.
    pub at: usize,
    /// The problem, and the possibilities.
    pub what: String,
}

/// Numbers of one arm or tool, by index in the row.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct LayoutGroup {
    pub arm: Option<String>,
    pub is_command: bool,
    pub joints: Vec<usize>,
    pub joint_unit: Option<AngleUnit>,
    pub velocities: Vec<usize>,
    pub velocity_unit: Option<AngleUnit>,
    /// x, y, z.
    pub position: Vec<usize>,
    /// In the order of the encoding. A matrix of 12 or 16 numbers includes the position.
    pub rotation: Vec<usize>,
    pub coding: Option<RotationEncoding>,
    pub units: Units,
}

impl LayoutGroup {
    /// Topic of its joints or poses.
    pub fn topic(&self, what: &str) -> String {
        let arm = self.arm.as_ref().map_or(String::new(), |arm| format!("{arm}/"));
        let end = match (what, self.is_command) {
            (what, false) => what,
            ("joints", true) => "joint_commands",
            _ => "pose_commands",
        };
        format!("{arm}{end}")
    }

    pub fn has_pose(&self) -> bool {
        self.position.len() + self.rotation.len() > 0
    }

    /// Indices of its pose; see [`pose_order`].
    pub fn pose(&self) -> Vec<usize> {
        pose_order(&self.position, &self.rotation)
    }
}

/// Position, then rotation. The rows of a matrix with nine elements end with their coordinate of the position.
pub(super) fn pose_order<T: Copy>(position: &[T], rotation: &[T]) -> Vec<T> {
    match (position, rotation.len()) {
        ([_, _, _], 9) => {
            let rows = rotation.chunks(3).zip(position);
            rows.flat_map(|(row, position)| row.iter().chain([position])).copied().collect()
        }
        _ => [position, rotation].concat(),
    }
}

/// Convention and units that a layout declares for the poses of one topic.
#[derive(Clone, Debug, PartialEq)]
pub struct DeclaredPose {
    /// The topic.
    pub topic: String,
    /// Whether they are commands.
    pub is_command: bool,
    /// Encoding of the rotation; `None` if the motion shows it.
    pub coding: Option<RotationEncoding>,
    /// Units.
    pub units: Units,
}

impl Log {
    /// The poses that the caller's layouts declare.
    pub fn declared_poses(&self) -> Vec<DeclaredPose> {
        let declared = self.topics.iter().filter_map(|topic| {
            let first = topic.cells.first()?;
            let table = &self.tables[first.table];
            let index = table.numbers.iter().position(|number| number.at == Some(first.at))?;
            let LayoutGroup { is_command, coding, units, .. } =
                table.given_layout.as_ref()?.pose_at(index)?;
            Some(DeclaredPose { topic: topic.name.clone(), is_command, coding, units })
        });
        declared.collect()
    }
}

/// Columns of the times in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum LayoutTime {
    Column {
        index: usize,
        unit_s: Option<f64>,
    },
    SecondsAndNanos([usize; 2]),
    Rate(f64),
    /// By name or by numbers.
    Open,
}

impl RowLayout {
    /// Checks that the items form joints and poses.
    ///
    /// # Errors
    /// The index of the first invalid item, and the problem.
    pub fn new(items: Vec<LayoutItem>, rate_hz: Option<f64>) -> Result<Self, (usize, String)> {
        let layout = Self { items, rate_hz };
        layout.check()?;
        Ok(layout)
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.items.iter().map(|item| item.count).sum()
    }

    /// The items, in order.
    pub fn items(&self) -> &[LayoutItem] {
        &self.items
    }

    /// Same with times in a column that it leaves out or open, in this unit. `None` if the column has another meaning.
    pub fn with_times(&self, index: usize, unit_s: f64) -> Option<Self> {
        let is_in =
            |(first, item): (usize, &LayoutItem)| (first..first + item.count).contains(&index);
        let at = self.places().position(is_in)?;
        let (first, item) = self.places().nth(at)?;
        if !matches!(item.meaning, Meaning::Ignored | Meaning::Open) {
            return None;
        }
        let part = |count: usize| LayoutItem { count, ..item.clone() };
        let time = LayoutItem { time_unit_s: Some(unit_s), ..LayoutItem::new(Meaning::Time, 1) };
        let parts = [part(index - first), time, part(first + item.count - index - 1)];
        let parts = parts.into_iter().filter(|part| part.count > 0);
        let (before, after) = (&self.items[..at], &self.items[at + 1..]);
        let items = before.iter().cloned().chain(parts).chain(after.iter().cloned());
        Self::new(items.collect(), None).ok()
    }

    /// The pose whose first number is at `index` of a row.
    fn pose_at(&self, index: usize) -> Option<LayoutGroup> {
        self.groups().into_iter().find(|group| group.pose().first() == Some(&index))
    }

    /// Index of each item's first number, with the item.
    fn places(&self) -> impl Iterator<Item = (usize, &LayoutItem)> {
        self.items.iter().scan(0, |next, item| {
            let first = *next;
            *next += item.count;
            Some((first, item))
        })
    }

    /// Meaning of each number.
    pub(crate) fn meanings(&self) -> Vec<Meaning> {
        self.items.iter().flat_map(|item| std::iter::repeat_n(item.meaning, item.count)).collect()
    }

    /// Positions of the times in a row.
    pub(super) fn time_positions(&self) -> Vec<usize> {
        match self.time() {
            LayoutTime::Column { index, .. } => vec![index],
            LayoutTime::SecondsAndNanos(both) => both.to_vec(),
            LayoutTime::Rate(_) | LayoutTime::Open => Vec::new(),
        }
    }

    pub(crate) fn time(&self) -> LayoutTime {
        let find = |meaning: Meaning| self.places().find(|(_, item)| item.meaning == meaning);
        match (find(Meaning::Time), find(Meaning::Seconds), find(Meaning::Nanoseconds)) {
            (Some((index, item)), ..) => LayoutTime::Column { index, unit_s: item.time_unit_s },
            (None, Some((seconds, _)), Some((nanos, _))) => {
                LayoutTime::SecondsAndNanos([seconds, nanos])
            }
            _ => self.rate_hz.map_or(LayoutTime::Open, LayoutTime::Rate),
        }
    }

    /// Joints and poses of each arm.
    pub(crate) fn groups(&self) -> Vec<LayoutGroup> {
        let mut groups: Vec<LayoutGroup> = Vec::new();
        let mut quaternions: Vec<[Option<usize>; 4]> = Vec::new();
        let mut axes: Vec<[Option<usize>; 3]> = Vec::new();
        for (first, item) in self.places().filter(|(_, item)| !item.meaning.is_of_row()) {
            let is_it =
                |group: &LayoutGroup| group.arm == item.arm && group.is_command == item.is_command;
            let at = groups.iter().position(is_it).unwrap_or_else(|| {
                let (arm, is_command) = (item.arm.clone(), item.is_command);
                groups.push(LayoutGroup { arm, is_command, ..LayoutGroup::default() });
                quaternions.push([None; 4]);
                axes.push([None; 3]);
                groups.len() - 1
            });
            let group = &mut groups[at];
            let own = first..first + item.count;
            match item.meaning {
                Meaning::Joints => {
                    group.joints.extend(own);
                    group.joint_unit = group.joint_unit.or(item.units.angle);
                }
                Meaning::JointVelocities => {
                    group.velocities.extend(own);
                    group.velocity_unit = group.velocity_unit.or(item.units.angle);
                }
                Meaning::Axis(axis) => {
                    axes[at][axis] = Some(first);
                    group.units = group.units.or(item.units);
                }
                Meaning::QuaternionPart(part) => quaternions[at][part] = Some(first),
                Meaning::Rotation(coding) => {
                    group.rotation = own.collect();
                    group.coding = coding;
                    group.units = group.units.or(item.units);
                }
                Meaning::Matrix => {
                    group.rotation = own.collect();
                    group.units = group.units.or(item.units);
                }
                Meaning::Vendor(name) => {
                    let all: Vec<usize> = own.collect();
                    let vendor = vendors::find(name);
                    let known = vendor.map_or_else(Units::default, |vendor| vendor.units);
                    group.units = item.units.or(known);
                    group.coding =
                        vendor.map(|vendor| vendor.coding).filter(|coding| !coding.is_matrix());
                    match group.coding {
                        Some(_) => {
                            group.position = all[..3].to_vec();
                            group.rotation = all[3..].to_vec();
                        }
                        None => group.rotation = all,
                    }
                }
                _ => {}
            }
        }
        for ((group, quaternion), axes) in groups.iter_mut().zip(quaternions).zip(axes) {
            if axes.iter().any(Option::is_some) {
                group.position = axes.into_iter().flatten().collect();
            }
            if quaternion.iter().any(Option::is_some) {
                group.rotation = quaternion.into_iter().flatten().collect();
                group.coding = Some(RotationEncoding::Xyzw);
            }
        }
        groups
    }

    fn check(&self) -> Result<(), (usize, String)> {
        let last = self.items.len().saturating_sub(1);
        let index = |is_it: &dyn Fn(&LayoutItem) -> bool| self.items.iter().rposition(is_it);
        // Meanings that occur once for each arm, or once for the row.
        for (at, item) in self.items.iter().enumerate() {
            let is_same = |other: &&LayoutItem| {
                let is_arm = other.arm == item.arm && other.is_command == item.is_command;
                let is_pair = other.meaning == item.meaning && !item.meaning.repeats();
                let are_rotations = item.meaning.is_rotation() && other.meaning.is_rotation();
                is_arm && (is_pair || are_rotations)
            };
            if self.items[..at].iter().any(|other| is_same(&other)) {
                let hint = match item.meaning {
                    Meaning::Time => "; whole seconds and nanoseconds are `s` and `ns`",
                    _ => "",
                };
                return Err((at, format!("`{}` repeats a part of the row{hint}", item.meaning)));
            }
        }
        let has = |meaning: Meaning| index(&|item| item.meaning == meaning);
        let (time, seconds, nanos) =
            (has(Meaning::Time), has(Meaning::Seconds), has(Meaning::Nanoseconds));
        match (time, seconds, nanos) {
            (Some(at), ..) if seconds.or(nanos).is_some() => {
                return Err((at, "use either `t`, or `s` and `ns`".to_owned()));
            }
            (None, Some(at), None) | (None, None, Some(at)) => {
                return Err((
                    at,
                    "`s` and `ns` belong together; use `t` for one column".to_owned(),
                ));
            }
            _ => {}
        }
        if self.rate_hz.is_some() && time.or(seconds).is_some() {
            return Err((last, "use either a time column or `@RATE`".to_owned()));
        }
        for group in self.groups() {
            let of_group =
                |item: &LayoutItem| item.arm == group.arm && item.is_command == group.is_command;
            let of = |meanings: &dyn Fn(Meaning) -> bool| {
                index(&|item| of_group(item) && meanings(item.meaning)).unwrap_or(last)
            };
            let fail = |at: usize, what: String| Err((at, what));
            let (joints, velocities) = (group.joints.len(), group.velocities.len());
            // Another file may hold the joints.
            if velocities > 0 && joints > 0 && velocities != joints {
                let at = of(&|meaning| meaning == Meaning::JointVelocities);
                return fail(
                    at,
                    format!("{velocities} velocities (`qd`) for {joints} joints (`q`)"),
                );
            }
            let (position, rotation) = (group.position.len(), group.rotation.len());
            let is_axis = |meaning: Meaning| matches!(meaning, Meaning::Axis(_));
            let is_part = |meaning: Meaning| matches!(meaning, Meaning::QuaternionPart(_));
            let parts = self.items.iter().filter(|item| of_group(item) && is_part(item.meaning));
            let parts = parts.count();
            if parts > 0 && parts < 4 {
                return fail(of(&is_part), "a quaternion needs qx, qy, qz and qw".to_owned());
            }
            let is_rotation = |item: &LayoutItem| of_group(item) && item.meaning.is_rotation();
            if parts > 0 && self.items.iter().any(is_rotation) {
                return fail(of(&is_part), "a pose has one rotation".to_owned());
            }
            match (position, rotation) {
                (0, 0 | 12 | 16) | (3, 0 | 3 | 4 | 9) => {}
                (_, 12 | 16) => {
                    let what = "`matrix[12]` and `matrix[16]` include the position".to_owned();
                    return fail(of(&is_axis), what);
                }
                (0, _) => {
                    let at = of(&|meaning: Meaning| meaning.is_rotation() || is_part(meaning));
                    return fail(at, "a rotation needs the position x, y, z".to_owned());
                }
                _ => return fail(of(&is_axis), "a position needs x, y and z".to_owned()),
            }
        }
        let is_used =
            |item: &LayoutItem| !item.meaning.is_of_row() || item.meaning == Meaning::Open;
        match self.items.iter().any(is_used) {
            true => Ok(()),
            false => Err((last, format!("no joints and no pose are named; known are {KNOWN}"))),
        }
    }
}

impl fmt::Display for RowLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, item) in self.items.iter().enumerate() {
            if at > 0 {
                f.write_str(",")?;
            }
            item.fmt(f)?;
        }
        match self.rate_hz {
            Some(rate_hz) => write!(f, "@{rate_hz}"),
            None => Ok(()),
        }
    }
}

impl FromStr for RowLayout {
    type Err = LayoutError;

    fn from_str(text: &str) -> Result<Self, LayoutError> {
        let character = |byte: usize| text[..byte].chars().count() + 1;
        let (row, rate_hz) = match text.rsplit_once('@') {
            None => (text, None),
            Some((row, rate)) => {
                let known = rate.trim().trim_end_matches("Hz").trim_end().parse::<f64>().ok();
                let known = known.filter(super::is_rate).ok_or_else(|| LayoutError {
                    at: character(row.len() + 1),
                    what: format!("`@{rate}` is not a rate in rows per second, as in `@50`"),
                })?;
                (row, Some(known))
            }
        };
        let (mut items, mut places) = (Vec::new(), Vec::new());
        let mut at = 0;
        for part in row.split(',') {
            let place = character(at + part.len() - part.trim_start().len());
            let parsed = parse_item(part.trim()).map_err(|what| LayoutError { at: place, what })?;
            places.extend(std::iter::repeat_n(place, parsed.len()));
            items.extend(parsed);
            at += part.len() + 1;
        }
        Self::new(items, rate_hz).map_err(|(item, what)| LayoutError {
            at: places.get(item).copied().unwrap_or(1),
            what,
        })
    }
}

/// Several items for `xyz`.
fn parse_item(text: &str) -> Result<Vec<LayoutItem>, String> {
    let (arm, rest) = match text.split_once('/') {
        Some((arm, rest)) if !arm.trim().is_empty() => (Some(arm.trim().to_owned()), rest),
        Some(_) => return Err("the name before `/` is empty".to_owned()),
        None => (None, text),
    };
    let (is_command, rest) = match rest.strip_prefix("cmd.") {
        Some(rest) => (true, rest),
        None => (false, rest),
    };
    let mut words = rest.split(':').map(str::trim);
    let head = words.next().unwrap_or_default();
    let head = match head {
        "quat" | "euler" => match words.next() {
            Some(order) => format!("{head}:{order}"),
            None => {
                return Err(format!("`{head}` needs an order, as in `quat:xyzw` or `euler:zyx`"));
            }
        },
        head => head.to_owned(),
    };
    let (name, count) = match head.strip_suffix(']').and_then(|head| head.rsplit_once('[')) {
        None => (head.as_str(), None),
        Some((name, count)) => {
            let known =
                count.trim().parse::<usize>().ok().filter(|own| (1..=MAX_COUNT).contains(own));
            let count = known.ok_or_else(|| {
                format!("`[{count}]` is not a number of columns from 1 to {MAX_COUNT}")
            })?;
            (name, Some(count))
        }
    };
    if name.is_empty() {
        return Err(format!("a column has no meaning; known are {KNOWN}"));
    }
    let (meanings, count) = match name {
        "xyz" if count.is_none_or(|count| count == 3) => {
            ((0..3).map(Meaning::Axis).collect(), Some(1))
        }
        "xyz" => return Err("`xyz` has 3 columns".to_owned()),
        name => match Meaning::parse(name) {
            Some(meaning) => (vec![meaning], count),
            None => return Err(format!("`{name}` has no known meaning; known are {KNOWN}")),
        },
    };
    let meaning = meanings[0];
    if meaning.is_of_row() && (arm.is_some() || is_command) {
        return Err(format!("`{name}` cannot belong to an arm or be a command"));
    }
    let counts = meaning.counts();
    let count = match (count, counts) {
        (count, []) => count.unwrap_or(1),
        (None, [only]) => *only,
        (Some(count), counts) if counts.contains(&count) => count,
        (_, counts) => {
            let counts: Vec<String> = counts.iter().map(ToString::to_string).collect();
            return Err(format!("`{name}` has {} columns", counts.join(" or ")));
        }
    };
    let (has_length, has_angle) = meaning.has_units(count);
    let (mut units, mut time_unit_s) = (Units::default(), None);
    for word in words {
        let time = TIME_UNITS
            .iter()
            .find(|(symbol, _)| *symbol == word || (word == "µs" && *symbol == "us"));
        let is_angle = word == AngleUnit::Radian.symbol() || word == AngleUnit::Degree.symbol();
        let is_length = LengthScale::common().any(|unit| unit.to_string() == word);
        let set = match (meaning, time) {
            (Meaning::Time, Some((_, unit))) => *time_unit_s.get_or_insert(*unit) == *unit,
            _ if (has_angle && is_angle) || (has_length && is_length) => {
                units.set_symbol(word).is_ok()
            }
            _ => {
                let allowed = match () {
                    () if meaning == Meaning::Time => "s, ms, us or ns",
                    () if has_length && has_angle => "m or mm, and rad or deg",
                    () if has_length => "m, mm, cm or in",
                    () if has_angle => "rad or deg",
                    () => "none",
                };
                return Err(format!("`{word}` is not a unit of `{name}`; possible: {allowed}"));
            }
        };
        if !set {
            return Err(format!("`{word}` contradicts another unit"));
        }
    }
    let item = |meaning: Meaning| LayoutItem {
        arm: arm.clone(),
        is_command,
        meaning,
        count,
        time_unit_s,
        units,
    };
    Ok(meanings.into_iter().map(item).collect())
}

/// A layout, of one file if there are several.
#[derive(Clone, Debug, PartialEq)]
pub struct FileLayout {
    /// Name of the file, or the end of its path.
    pub file: Option<String>,
    /// The layout.
    pub layout: RowLayout,
}

impl FromStr for FileLayout {
    type Err = LayoutError;

    fn from_str(text: &str) -> Result<Self, LayoutError> {
        match text.rsplit_once('=') {
            None => Ok(Self { file: None, layout: text.parse()? }),
            Some((file, layout)) => {
                let shift = text[..file.len() + 1].chars().count();
                let layout = layout
                    .parse()
                    .map_err(|LayoutError { at, what }| LayoutError { at: at + shift, what })?;
                Ok(Self { file: Some(file.to_owned()), layout })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn error(text: &str) -> String {
        text.parse::<RowLayout>().unwrap_err().to_string()
    }

    #[test]
    fn a_row_has_the_meaning_of_each_column() {
        let layout: RowLayout = "t:ms, q[2]:deg, qd[2], _[3], x:mm,y,z, rotvec[3]".parse().unwrap();
        assert_eq!(layout.width(), 14);
        assert_eq!(layout.time(), LayoutTime::Column { index: 0, unit_s: Some(1e-3) });
        let [group] = layout.groups().try_into().unwrap();
        assert_eq!((group.joints.clone(), group.joint_unit), (vec![1, 2], Some(AngleUnit::Degree)));
        assert_eq!((group.velocities.clone(), group.velocity_unit), (vec![3, 4], None));
        assert_eq!(group.pose(), [8, 9, 10, 11, 12, 13]);
        assert_eq!(group.units.length, Some(LengthScale::MILLIMETRE));
        assert_eq!(layout.to_string(), "t:ms,q[2]:deg,qd[2],_[3],x:mm,y,z,rotvec");
    }

    #[test]
    fn arms_commands_and_makers_have_their_own_poses() {
        let layout: RowLayout =
            "s,ns,left/q[6],right/q[6],right/cmd.kuka,left/qw,left/qx,left/qy,left/qz,left/xyz"
                .parse()
                .unwrap();
        assert_eq!(layout.time(), LayoutTime::SecondsAndNanos([0, 1]));
        let groups = layout.groups();
        let poses: Vec<&LayoutGroup> = groups.iter().filter(|group| group.has_pose()).collect();
        let names: Vec<String> = poses.iter().map(|pose| pose.topic("pose")).collect();
        assert_eq!(names, ["left/pose", "right/pose_commands"]);
        assert_eq!(poses[0].coding, Some(RotationEncoding::Xyzw));
        assert_eq!(poses[1].coding, Some("euler:ZYX".parse().unwrap()));
        assert_eq!(poses[1].units.to_string(), "mm, deg");
        let left = layout.groups().into_iter().next().unwrap();
        assert_eq!(left.pose(), [24, 25, 26, 21, 22, 23, 20]);
        let franka: RowLayout = "q[7],franka@1000".parse().unwrap();
        assert_eq!((franka.width(), franka.time()), (23, LayoutTime::Rate(1000.0)));
    }

    #[test]
    fn an_error_names_the_character_and_what_is_possible() {
        for (text, part) in [
            ("t,q[6],tau[6]", "character 8: `tau` has no known meaning; known are t, s, ns"),
            ("t,q[0]", "character 3: `[0]` is not a number of columns"),
            ("t,q[6]:mm", "character 3: `mm` is not a unit of `q`; possible: rad or deg"),
            ("t,rot,x,y,z", "character 3: `rot` has 3 or 4 columns"),
            ("t,quat,x", "character 3: `quat` needs an order"),
            ("t,x,y", "character 5: a position needs x, y and z"),
            ("t,rotvec", "character 3: a rotation needs the position"),
            ("t,x,y,z,qx,qy,qz", "character 15: a quaternion needs"),
            ("t,x,y,z,rotvec,rpy", "character 16: `euler:xyz` repeats a part"),
            (
                "t:s,t:ns,q[6]",
                "character 5: `t` repeats a part of the row; whole seconds and nanoseconds",
            ),
            ("s,q[6]", "character 1: `s` and `ns` belong together"),
            ("q[6],qd[5]", "character 6: 5 velocities"),
            ("t,q[6]@50", "character 3: use either"),
            ("q[6]@fast", "character 6: `@fast` is not a rate"),
            ("t,_[4]", "character 3: no joints and no pose"),
            ("t,,q", "character 3: a column has no meaning"),
            ("t,cmd._", "character 3: `_` cannot belong to an arm"),
            ("é,q", "character 1: `é` has no known meaning"),
            ("", "character 1: a column has no meaning"),
        ] {
            let line = error(text);
            assert!(line.starts_with(part), "{text}: {line}");
        }
        let of_file = "a.csv=t,p".parse::<FileLayout>().unwrap_err();
        assert_eq!(of_file.at, 9);
    }

    fn item() -> impl Strategy<Value = LayoutItem> {
        let codings = ["rotvec", "euler:ZYX", "euler:xyz", "quat:xyzw", "quat:wxyz"];
        let coding = proptest::sample::select(codings.to_vec());
        let makers: Vec<&'static str> = vendors::names().collect();
        let meaning = prop_oneof![
            Just(Meaning::Ignored),
            Just(Meaning::Open),
            Just(Meaning::Time),
            Just(Meaning::Seconds),
            Just(Meaning::Nanoseconds),
            Just(Meaning::Joints),
            Just(Meaning::JointVelocities),
            (0_usize..3).prop_map(Meaning::Axis),
            (0_usize..4).prop_map(Meaning::QuaternionPart),
            Just(Meaning::Rotation(None)),
            coding.prop_map(|name| Meaning::Rotation(name.parse().ok())),
            Just(Meaning::Matrix),
            proptest::sample::select(makers).prop_map(Meaning::Vendor),
        ];
        let lengths: Vec<LengthScale> = LengthScale::common().collect();
        let length = proptest::option::of(proptest::sample::select(lengths));
        let angle =
            proptest::option::of(prop_oneof![Just(AngleUnit::Radian), Just(AngleUnit::Degree)]);
        let time = proptest::option::of(proptest::sample::select(TIME_UNITS.to_vec()));
        let arm = proptest::option::of("[a-z]{1,5}");
        (meaning, 1_usize..20, length, angle, time, arm, any::<bool>()).prop_map(
            |(meaning, count, length, angle, time, arm, is_command)| {
                let counts = meaning.counts();
                let count = if counts.is_empty() { count } else { counts[count % counts.len()] };
                let (has_length, has_angle) = meaning.has_units(count);
                let is_of_row = meaning.is_of_row();
                LayoutItem {
                    arm: arm.filter(|_| !is_of_row),
                    is_command: is_command && !is_of_row,
                    meaning,
                    count,
                    time_unit_s: time.filter(|_| meaning == Meaning::Time).map(|(_, unit)| unit),
                    units: Units {
                        length: length.filter(|_| has_length),
                        angle: angle.filter(|_| has_angle),
                    },
                }
            },
        )
    }

    proptest! {
        #[test]
        fn a_layout_is_read_back_as_written(
            items in proptest::collection::vec(item(), 1..8),
            rate_hz in proptest::option::of(1.0..1e4_f64),
        ) {
            // Items alone, then the whole row if it is one.
            for item in &items {
                prop_assert_eq!(parse_item(&item.to_string()), Ok(vec![item.clone()]));
            }
            if let Ok(layout) = RowLayout::new(items, rate_hz) {
                prop_assert_eq!(layout.to_string().parse(), Ok(layout));
            }
        }

        #[test]
        fn no_text_panics(text in "[a-z_?@:,/.=\\[\\]0-9 µ]{0,40}") {
            let _ = text.parse::<FileLayout>();
        }
    }
}
