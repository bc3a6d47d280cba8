//! Calibration tables: rows of joint positions and measured poses, without stamps.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use csv::{ReaderBuilder, Trim};

use super::{LogError, local};

/// Limits in bytes and rows.
const MAX_BYTES: u64 = 1 << 26;
const MAX_ROWS: usize = 100_000;

/// Table with named columns and numeric rows.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationTable {
    /// Column names.
    pub names: Vec<String>,
    /// Rows, each with one number per name.
    pub rows: Vec<Vec<f64>>,
    /// Line numbers of rows with non-finite cells.
    pub dropped: Vec<usize>,
    /// Position columns: x, y, z.
    pub position: [usize; 3],
    /// Rotation columns, if any.
    pub rotation: RotationColumns,
}

/// Columns of a rotation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RotationColumns {
    /// Quaternion: x, y, z, w.
    Quaternion([usize; 4]),
    /// Three numbers, any convention.
    Numbers([usize; 3]),
    /// No rotation.
    None,
}

/// Prefixes and suffixes of column names.
const POSITIONS: [&str; 13] = [
    "",
    "p",
    "p_",
    "pos_",
    "pos",
    "position_",
    "position.",
    "position.x.",
    "t",
    "t_",
    "tcp_",
    "tool_",
    "translation_",
];
const QUATERNIONS: [&str; 7] =
    ["q", "q_", "quat_", "quat", "orientation_", "orientation.", "rot_q"];
const NUMBERS: [&str; 10] =
    ["r", "r_", "rot_", "rot", "phi", "phi_", "euler_", "rotvec_", "o", "theta_"];
const TRIPLES: [[&str; 3]; 4] =
    [["roll", "pitch", "yaw"], ["a", "b", "c"], ["w", "p", "r"], ["alpha", "beta", "gamma"]];
const SUFFIXES: [&str; 5] = ["", "1", "_1", "_m", "_mm"];

/// Reads the table at `path`. `None` if it is a log or has no position columns.
///
/// # Errors
/// If the file cannot be opened.
pub fn read_calibration_table(path: &Path) -> Result<Option<CalibrationTable>, LogError> {
    let Some(path) = local(path).filter(|path| path.is_file()) else { return Ok(None) };
    let mut bytes = Vec::new();
    let read = File::open(&path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
    read.map_err(|source| LogError::Io { path, source })?;
    Ok(parse_table(&bytes))
}

fn parse_table(bytes: &[u8]) -> Option<CalibrationTable> {
    let is_text = std::str::from_utf8(bytes.get(..bytes.len().min(4096))?)
        .map_or_else(|error| error.error_len().is_none(), |_| true);
    if !is_text || bytes.len() as u64 > MAX_BYTES || super::looks_like_log(bytes) {
        return None;
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = bytes.split(|byte| *byte == b'\n').next()?;
    let count = |sign: u8| first.iter().filter(|byte| **byte == sign).count();
    let delimiter =
        [b',', b';', b'\t', b' '].into_iter().max_by_key(|&sign| (count(sign), sign != b' '))?;
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .trim(Trim::All)
        .flexible(true)
        .comment(Some(b'#'))
        .from_reader(bytes);
    let names: Vec<String> = reader.headers().ok()?.iter().map(str::to_owned).collect();
    let (position, rotation) = columns(&names)?;
    let (mut rows, mut dropped) = (Vec::new(), Vec::new());
    for (at, record) in reader.records().enumerate().take(MAX_ROWS) {
        let cells = record.ok().map(|record| -> Option<Vec<f64>> {
            let decimal = |cell: &str| match delimiter {
                b',' => cell.parse(),
                _ => cell.replace(',', ".").parse(),
            };
            record
                .iter()
                .map(|cell| decimal(cell).ok().filter(|value: &f64| value.is_finite()))
                .collect()
        });
        match cells.flatten().filter(|row| row.len() == names.len()) {
            Some(row) => rows.push(row),
            None => dropped.push(at + 2),
        }
    }
    Some(CalibrationTable { names, rows, dropped, position, rotation })
}

fn columns(names: &[String]) -> Option<([usize; 3], RotationColumns)> {
    let lower: Vec<String> = names.iter().map(|name| name.to_lowercase()).collect();
    let at = |name: String| lower.iter().position(|own| *own == name);
    let axes = |prefix: &str, suffix: &str| -> Option<[usize; 3]> {
        let [x, y, z] = ["x", "y", "z"].map(|axis| at(format!("{prefix}{axis}{suffix}")));
        Some([x?, y?, z?])
    };
    let with_suffix = |prefixes: &[&str]| {
        prefixes.iter().find_map(|prefix| SUFFIXES.iter().find_map(|suffix| axes(prefix, suffix)))
    };
    let position = with_suffix(&POSITIONS)?;
    let quaternion = QUATERNIONS.iter().find_map(|prefix| {
        SUFFIXES.iter().find_map(|suffix| {
            let [x, y, z] = axes(prefix, suffix)?;
            Some([x, y, z, at(format!("{prefix}w{suffix}"))?])
        })
    });
    let triple = || {
        let named = |names: &[&str; 3], ending: &str| -> Option<[usize; 3]> {
            let [a, b, c] = names.map(|name| at(format!("{name}{ending}")));
            Some([a?, b?, c?])
        };
        let endings = ["", "1", "_1", "_deg", "_rad"];
        let angles =
            NUMBERS.iter().find_map(|prefix| endings.iter().find_map(|end| axes(prefix, end)));
        angles.or_else(|| {
            TRIPLES.iter().find_map(|names| endings.iter().find_map(|end| named(names, end)))
        })
    };
    let rotation = match quaternion {
        Some(columns) => RotationColumns::Quaternion(columns),
        None => triple().map_or(RotationColumns::None, RotationColumns::Numbers),
    };
    Some((position, rotation))
}

impl CalibrationTable {
    /// Columns of the joints by these names, otherwise by number, from 0 or 1: `q1`, `joint_1`, `J1`.
    pub fn joints(&self, names: &[String]) -> Option<Vec<usize>> {
        const NUMBERED: [&str; 12] = [
            "q",
            "q_",
            "q[",
            "j",
            "j_",
            "joint",
            "joint_",
            "joint_position_",
            "theta",
            "theta_",
            "a",
            "axis",
        ];
        let lower: Vec<String> = self.names.iter().map(|name| name.to_lowercase()).collect();
        let all = |name: &dyn Fn(usize) -> String| -> Option<Vec<usize>> {
            (0..names.len()).map(|joint| lower.iter().position(|own| *own == name(joint))).collect()
        };
        let by_name = all(&|joint| names[joint].to_lowercase());
        let by_number = || {
            NUMBERED.iter().find_map(|stem| {
                [1, 0].iter().find_map(|first| {
                    ["", "_deg", "_rad", "]"]
                        .iter()
                        .find_map(|ending| all(&|joint| format!("{stem}{}{ending}", joint + first)))
                })
            })
        };
        by_name.or_else(by_number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(of: &[&str]) -> Vec<String> {
        of.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn columns_are_identified_by_name() {
        let table = parse_table(
            b"q1,q2,x,y,z,rx,ry,rz\n1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7\n1,2,3,nan,5,6,7,8\n",
        )
        .unwrap();
        assert_eq!(table.position, [2, 3, 4]);
        assert_eq!(table.rotation, RotationColumns::Numbers([5, 6, 7]));
        assert_eq!(table.joints(&names(&["shoulder", "elbow"])), Some(vec![0, 1]));
        assert_eq!((table.rows.len(), table.dropped.as_slice()), (1, [3, 4].as_slice()));
        let table = parse_table(b"X;Y;Z;qx;qy;qz;qw;elbow\n0,5;0;0;0;0;0;1;0,25\n").unwrap();
        assert_eq!(table.rotation, RotationColumns::Quaternion([3, 4, 5, 6]));
        assert_eq!(table.rows[0][7], 0.25);
        assert_eq!(table.joints(&names(&["elbow"])), Some(vec![7]));
        assert_eq!(table.joints(&names(&["elbow", "wrist"])), None);
    }

    #[test]
    fn other_files_are_no_table_of_configurations() {
        for text in ["", "a,b\n1,2\n", "1,2,3\n", "timestamp,actual_q_0,x,y,z\n1,2,3,4,5\n", "\0\0"]
        {
            assert_eq!(parse_table(text.as_bytes()), None, "{text:?}");
        }
    }
}
