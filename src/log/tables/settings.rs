//! What the caller says of the columns of tables.

/// What the caller says of the columns of tables. What is not said is told from names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColumnSettings {
    /// The column of the time.
    pub time: Option<String>,
    /// Rows a second, where no column holds a time.
    pub rate_hz: Option<f64>,
    /// Joint positions, in the order of the model's joints.
    pub joints: Vec<ColumnSelector>,
    /// Commanded joint positions, likewise.
    pub joint_commands: Vec<ColumnSelector>,
    /// Factors and offsets of the joints, where their numbers are no rad: rad = factor · number + offset.
    pub joint_factors: Vec<f64>,
    /// See `joint_factors`.
    pub joint_offsets: Vec<f64>,
    /// The measured pose of the tool: position, then rotation.
    pub pose: Vec<ColumnSelector>,
    /// The commanded pose of the tool.
    pub pose_commands: Vec<ColumnSelector>,
    /// The same of each arm by its name, where there are several. A time or rate is of the whole table.
    pub arms: Vec<(String, ColumnSettings)>,
}

impl ColumnSettings {
    /// Whether it says where joints and poses are, so that nothing is sought.
    pub(super) fn says_all(&self) -> bool {
        let says = |of: &Self| !of.joints.is_empty() && !of.pose.is_empty();
        says(self) || (!self.arms.is_empty() && self.arms.iter().all(|(_, arm)| says(arm)))
    }
}

/// Some numbers of one column: all, or those from `first` up to `end`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnSelector {
    /// The column's name.
    pub column: String,
    /// The first number, and the one after the last.
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
