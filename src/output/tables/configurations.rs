//! Joint positions from a file, and their FK poses.

use std::fs::File;
use std::path::Path;

use polars::prelude::{
    Column, DataFrame, DataType, ParquetReader, PolarsError, PolarsResult, SerReader,
};

use crate::geometry::Pose;
use crate::robot::{Chain, JointKind};

use super::{TableError, pose_columns};

/// Joint positions from a file, one configuration per row.
#[derive(Clone, Debug, PartialEq)]
pub struct Configurations {
    /// Row-major, rad or m.
    pub q: Vec<f64>,
    /// Number of rows.
    pub rows: usize,
}

impl Configurations {
    /// Reads the columns named after the joints of `chain`, optionally with the suffix `_rad`, `_deg` or
    /// `_m`, from a CSV or Parquet file. A CSV without such names is read by position if its number of
    /// columns is the number of joints. Columns of revolute joints are in degrees with the suffix `_deg`,
    /// or without suffix if `deg` is set.
    ///
    /// # Errors
    /// If the file cannot be read, a joint is missing, or a value is not a finite number.
    pub fn read(path: &Path, chain: &Chain, deg: bool) -> Result<Self, TableError> {
        let fault = |cause: String| TableError { path: path.to_owned(), cause };
        let head = std::fs::read(path).map_err(|error| fault(error.to_string()))?;
        if head.starts_with(b"PAR1") {
            return from_parquet(path, chain, deg).map_err(fault);
        }
        from_csv(&head, chain, deg).map_err(fault)
    }
}

/// Factor to rad or m.
fn unit_factor(column: &str, kind: JointKind, deg: bool) -> f64 {
    let column = column.trim();
    let is_deg = column.ends_with("_deg") || (deg && !column.ends_with("_rad"));
    if is_deg && kind != JointKind::Prismatic { 1_f64.to_radians() } else { 1.0 }
}

fn is_column_of(column: &str, joint: &str) -> bool {
    let rest = column.trim().strip_prefix(joint);
    rest.is_some_and(|rest| ["", "_rad", "_deg", "_m"].contains(&rest))
}

fn from_parquet(path: &Path, chain: &Chain, deg: bool) -> Result<Configurations, String> {
    let frame = File::open(path)
        .map_err(PolarsError::from)
        .and_then(|file| ParquetReader::new(file).finish())
        .map_err(|error| error.to_string())?;
    let rows = frame.height();
    let mut q = vec![0.0; rows * chain.dof()];
    for (joint, name) in chain.joint_names().iter().enumerate() {
        let column = frame.columns().iter().find(|column| is_column_of(column.name(), name));
        let column = column.ok_or_else(|| missing_column(name))?;
        let unit = unit_factor(column.name(), chain.joint_kinds()[joint], deg);
        let numbers = column.cast(&DataType::Float64).map_err(|error| error.to_string())?;
        let numbers = numbers.f64().map_err(|error| error.to_string())?;
        for (row, number) in (0..rows).map(|row| (row, numbers.get(row))) {
            let finite = number.filter(|number| number.is_finite());
            let number = finite
                .ok_or_else(|| format!("row {} of `{}` is not a number", row + 1, column.name()))?;
            q[row * chain.dof() + joint] = unit * number;
        }
    }
    Ok(Configurations { q, rows })
}

fn from_csv(text: &[u8], chain: &Chain, deg: bool) -> Result<Configurations, String> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .from_reader(text);
    let mut records = reader.records().peekable();
    let is_head =
        |record: &csv::StringRecord| record.iter().any(|cell| cell.parse::<f64>().is_err());
    let kinds = chain.joint_kinds().iter();
    let mut places: Vec<(usize, f64)> =
        kinds.enumerate().map(|(joint, kind)| (joint, unit_factor("", *kind, deg))).collect();
    let has_head = match records.peek() {
        Some(Ok(first)) => is_head(first),
        _ => false,
    };
    if has_head && let Some(Ok(head)) = records.next() {
        for (joint, name) in chain.joint_names().iter().enumerate() {
            let column = head.iter().position(|column| is_column_of(column, name));
            let column = column.ok_or_else(|| missing_column(name))?;
            places[joint] = (column, unit_factor(&head[column], chain.joint_kinds()[joint], deg));
        }
    }
    let (mut q, mut rows) = (Vec::new(), 0);
    for record in records {
        let record = record.map_err(|error| error.to_string())?;
        let line = record.position().map_or(0, csv::Position::line);
        if !has_head && record.len() != chain.dof() {
            let (found, wanted) = (record.len(), chain.dof());
            return Err(format!("line {line} has {found} numbers, the chain has {wanted} joints"));
        }
        for &(place, unit) in &places {
            let number = record.get(place).and_then(|cell| cell.parse::<f64>().ok());
            let number = number.filter(|number| number.is_finite());
            let number = number
                .ok_or_else(|| format!("line {line}, column {}: expected a number", place + 1))?;
            q.push(unit * number);
        }
        rows += 1;
    }
    Ok(Configurations { q, rows })
}

fn missing_column(joint: &str) -> String {
    format!("it has no column `{joint}`")
}

/// Joint positions and their poses: `{joint}_rad` (`_m`), `x_m` … `qw`.
///
/// # Errors
/// If the numbers of poses and rows differ.
pub fn kinematics_frame(chain: &Chain, q: &[f64], poses: &[Pose]) -> PolarsResult<DataFrame> {
    let dof = chain.dof();
    let mut columns: Vec<Column> = super::workspace::joint_columns(chain)
        .enumerate()
        .map(|(joint, name)| {
            let positions: Vec<f64> = q.iter().skip(joint).step_by(dof).copied().collect();
            Column::new(name.as_str().into(), positions)
        })
        .collect();
    columns.extend(pose_columns("", poses));
    DataFrame::new(poses.len(), columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::catalogue;

    fn chain() -> Chain {
        let robot = catalogue::find("ur5e").expect("the catalogue has a UR5e");
        let link = |name: &str| robot.link(name).expect("a UR5e has that link");
        robot.chain(link("base_link"), link("tool0")).expect("they are joined")
    }

    #[test]
    fn columns_are_matched_by_name_in_any_order() {
        let chain = chain();
        let names = chain.joint_names();
        let mut head: Vec<String> = names.iter().map(|name| format!("{name}_rad")).collect();
        head.reverse();
        let text = format!("t,{}\n0,6,5,4,3,2,1\n", head.join(","));
        let read = from_csv(text.as_bytes(), &chain, false).unwrap();
        assert_eq!((read.rows, read.q), (1, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    }

    #[test]
    fn a_column_name_states_its_unit() {
        let chain = chain();
        let names = chain.joint_names();
        let head: Vec<String> = names.iter().map(|name| format!("{name}_deg")).collect();
        let text = format!("{}\n90,0,0,0,0,0\n", head.join(","));
        let read = from_csv(text.as_bytes(), &chain, false).unwrap();
        assert!((read.q[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        let read = from_csv(b"90,0,0,0,0,0\n", &chain, true).unwrap();
        assert!((read.q[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    }

    #[test]
    fn without_names_the_number_of_columns_must_fit() {
        let chain = chain();
        let read = from_csv(b"# home\n0,1,2,3,4,5\n1 , 2,3,4,5,6\n", &chain, false).unwrap();
        assert_eq!(read.rows, 2);
        assert!(from_csv(b"0,1,2\n", &chain, false).unwrap_err().contains("6 joints"));
        assert!(
            from_csv(b"0,1,2,3,4,inf\n", &chain, false).unwrap_err().contains("expected a number")
        );
        assert!(from_csv(b"a,b\n1,2\n", &chain, false).unwrap_err().contains("shoulder_pan_joint"));
    }

    #[test]
    fn written_tables_are_read_back() {
        let chain = chain();
        let q: Vec<f64> = (0..12).map(|k| f64::from(k) * 0.1).collect();
        let mut poses = Vec::new();
        chain.forward_batch(&q, &mut poses);
        let mut frame = kinematics_frame(&chain, &q, &poses).unwrap();
        assert_eq!(frame.shape(), (2, 13));
        let folder = tempfile::tempdir().unwrap();
        super::super::write_table(folder.path(), "poses", &mut frame).unwrap();
        let read =
            Configurations::read(&folder.path().join("poses.parquet"), &chain, true).unwrap();
        assert_eq!(read, Configurations { q, rows: 2 });
    }
}
