//! Reads pairs of poses from CSV.

use super::error::DeskError;
use super::parse::{PoseText, parse_pose};

/// Two poses that should agree.
#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    /// Pose from one source.
    pub pose_a: PoseText,
    /// Pose from the other source.
    pub pose_b: PoseText,
}

/// Reads two columns with a pose each, with or without a header, or one column per number with names that
/// start with `is` and `but`.
///
/// # Errors
/// If a row (counted from 1 with the header) is not a pair.
pub fn pairs_from_csv(text: &str) -> Result<Vec<Pair>, DeskError> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let mut sides: Option<[Vec<usize>; 2]> = None;
    let mut pairs = Vec::new();
    for (at, record) in reader.records().enumerate() {
        let row = at + 1;
        let of_row = |what: String| DeskError::Row { row, what };
        let record = record.map_err(|error| of_row(error.to_string()))?;
        if at == 0 {
            sides = header_columns(&record);
            if sides.is_some() {
                continue;
            }
        }
        let cells = match &sides {
            Some(sides) => sides.each_ref().map(|columns| {
                let cells: Vec<&str> = columns.iter().filter_map(|&at| record.get(at)).collect();
                cells.join(" ")
            }),
            None if record.len() == 2 => [0, 1].map(|at| record[at].to_owned()),
            None => return Err(of_row(format!("it has {} columns", record.len()))),
        };
        let [is, but] =
            cells.map(|cell| parse_pose(&cell).map_err(|error| of_row(error.to_string())));
        pairs.push(Pair { pose_a: is?, pose_b: but? });
    }
    match pairs.is_empty() {
        true => Err(DeskError::NoPairs),
        false => Ok(pairs),
    }
}

/// Columns of each side.
fn header_columns(record: &csv::StringRecord) -> Option<[Vec<usize>; 2]> {
    let of = |side: &str| -> Vec<usize> {
        let names = record.iter().map(str::to_ascii_lowercase).enumerate();
        names.filter(|(_, name)| name.starts_with(side)).map(|(at, _)| at).collect()
    };
    let sides = ["is", "but"].map(of);
    sides.iter().all(|columns| !columns.is_empty()).then_some(sides)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_two_cells_or_one_column_per_number() {
        let quoted = "\"0 0 1 0 0 0 1\",\"p[0, 0, 1, 0, 0, 0]\"\n";
        let columns = "is_x,is_y,is_z,is_qx,is_qy,is_qz,is_qw,but_x,but_y,but_z,but_rx,but_ry,but_rz\n\
                       0,0,1,0,0,0,1,0,0,1,0,0,0\n";
        let named = format!("is,but\n{quoted}");
        for text in [quoted, columns, &named] {
            let pairs = pairs_from_csv(text).unwrap();
            assert_eq!(pairs.len(), 1, "{text}");
            assert_eq!(pairs[0].pose_a.numbers, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
            assert_eq!(pairs[0].pose_b.numbers, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        }
    }

    #[test]
    fn an_invalid_row_is_named() {
        let error =
            pairs_from_csv("is,but\n\"1 2 3\",\"1 2 3\"\n\"1 2 3\",\"1 x 3\"\n").unwrap_err();
        assert_eq!(error.to_string(), "row 3: `x` is not a number");
        let error = pairs_from_csv("1,2,3\n").unwrap_err();
        assert_eq!(error.to_string(), "row 1: it has 3 columns");
        assert_eq!(pairs_from_csv("is,but\n"), Err(DeskError::NoPairs));
    }
}
