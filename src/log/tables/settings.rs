//! Configured columns of tables.

use std::path::Path;

use super::Table;
use super::row_layout::{FileLayout, RowLayout};

/// Configured columns. Others are identified by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColumnSettings {
    /// Stamps.
    pub time: Option<String>,
    /// Used if no column holds times.
    pub rate_hz: Option<f64>,
    /// Used if the times of the rows are unknown, to identify the columns. Otherwise such a table is refused.
    pub assumed_rate_hz: Option<f64>,
    /// In the order of the model's joints.
    pub joints: Vec<ColumnSelector>,
    /// Commands in the same order.
    pub joint_commands: Vec<ColumnSelector>,
    /// rad = factor · number + offset.
    pub joint_factors: Vec<f64>,
    /// rad.
    pub joint_offsets: Vec<f64>,
    /// Measured tool pose: position, then rotation.
    pub pose: Vec<ColumnSelector>,
    /// Commanded tool pose.
    pub pose_commands: Vec<ColumnSelector>,
    /// Names and settings, if there are several arms. Time and rate apply to the whole table.
    pub arms: Vec<(String, ColumnSettings)>,
    /// Meaning of every column, by position. Replaces all other settings of its tables.
    pub layouts: Vec<FileLayout>,
}

impl ColumnSettings {
    /// Without the columns that `table` lacks but another table of its episode has, by the names in `others`.
    pub(super) fn without(&self, others: &[&String], table: &Table) -> Self {
        let is_own = |name: &str| {
            let is_it = |other: &&&String| {
                **other == name || other.split_once(" [").is_some_and(|(bare, _)| bare == name)
            };
            table.column(name).is_some() || !others.iter().any(|other| is_it(&other))
        };
        let mut own = self.clone();
        own.time = own.time.filter(|name| is_own(name.split('[').next().unwrap_or(name)));
        for selectors in
            [&mut own.joints, &mut own.joint_commands, &mut own.pose, &mut own.pose_commands]
        {
            selectors.retain(|selector| is_own(&selector.column));
        }
        own.arms.iter_mut().for_each(|(_, arm)| *arm = arm.without(others, table));
        own
    }

    /// Whether a setting names the column or some of its numbers.
    pub(super) fn has_column(&self, name: &str) -> bool {
        let selectors =
            [&self.joints, &self.joint_commands, &self.pose, &self.pose_commands].into_iter();
        let time = self.time.as_deref().map(|time| time.split('[').next().unwrap_or(time));
        time == Some(name)
            || selectors.flatten().any(|selector| selector.column == name)
            || self.arms.iter().any(|(_, arm)| arm.has_column(name))
    }

    /// If so, no other columns are searched.
    pub(super) fn declares_all(&self) -> bool {
        let says = |of: &Self| !of.joints.is_empty() && !of.pose.is_empty();
        says(self) || (!self.arms.is_empty() && self.arms.iter().all(|(_, arm)| says(arm)))
    }

    /// The layout that names the file, otherwise the one for all files.
    pub(crate) fn layout_of(&self, path: &Path) -> Option<&RowLayout> {
        let names = |own: &&FileLayout| own.file.as_ref().is_some_and(|file| path.ends_with(file));
        let of_all = || self.layouts.iter().find(|own| own.file.is_none());
        self.layouts.iter().find(names).or_else(of_all).map(|own| &own.layout)
    }
}

/// A range of numbers of one column, or all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnSelector {
    /// Name of the column.
    pub column: String,
    /// First index and end (exclusive); `None` for all.
    pub range: Option<(usize, usize)>,
}

impl std::str::FromStr for ColumnSelector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let whole = || Self { column: text.to_owned(), range: None };
        let Some((column, range)) = text.strip_suffix(']').and_then(|text| text.rsplit_once('['))
        else {
            return Ok(whole());
        };
        let number = |text: &str| text.trim().parse::<usize>().ok();
        let range = match range.split_once(':') {
            Some((first, end)) => number(first).zip(number(end)),
            None => number(range).map(|at| (at, at + 1)),
        };
        match range {
            Some((first, end)) if first < end => {
                Ok(Self { column: column.to_owned(), range: Some((first, end)) })
            }
            Some(_) => Err(format!("`{text}` selects nothing; write NAME[FIRST:END]")),
            None => Ok(whole()),
        }
    }
}
