//! Units in the names of columns.

use crate::geometry::{AngleUnit, LengthScale, Units};

/// Units that all names of the positions or of three angles end in, such as `x_mm` and `A [°]`.
pub fn named_units(columns: &[String]) -> Units {
    const LENGTHS: [(&[&str], f64); 3] = [
        (&["m", "meter", "meters", "metre", "metres"], 1.0),
        (&["mm", "millimeter", "millimeters", "millimetre", "millimetres"], 1e-3),
        (&["cm", "centimeter", "centimeters"], 1e-2),
    ];
    const ANGLES: [(&[&str], AngleUnit); 2] = [
        (&["rad", "rads", "radian", "radians"], AngleUnit::Radian),
        (&["deg", "degs", "degree", "degrees", "grad", "grados"], AngleUnit::Degree),
    ];
    let last_word = |name: &str| {
        let mut words = without_index(name)
            .split(|c: char| !c.is_alphanumeric())
            .filter(|word| !word.is_empty());
        words.next_back().unwrap_or_default().to_lowercase()
    };
    let length = |name: &String| {
        let word = last_word(name);
        LENGTHS.iter().find(|(words, _)| words.contains(&word.as_str())).map(|(_, metres)| *metres)
    };
    let angle = |name: &String| {
        let word = last_word(name);
        let named = ANGLES.iter().find(|(words, _)| words.contains(&word.as_str()));
        named.map(|(_, unit)| *unit).or(name.contains('°').then_some(AngleUnit::Degree))
    };
    let (position, rotation) = columns.split_at(columns.len().min(3));
    Units {
        length: common(position.iter().map(length)).map(LengthScale::from_m),
        angle: common(rotation.iter().map(angle)).filter(|_| rotation.len() == 3),
    }
}

/// Without the index of a number in a list.
fn without_index(name: &str) -> &str {
    let split = name.strip_suffix(']').and_then(|name| name.rsplit_once('['));
    let is_index = |index: &str| index.bytes().all(|byte| byte.is_ascii_digit());
    split.filter(|(_, index)| is_index(index)).map_or(name, |(name, _)| name)
}

/// The value that all share.
fn common<T: PartialEq>(mut all: impl Iterator<Item = Option<T>>) -> Option<T> {
    let first = all.next()??;
    all.all(|other| other.as_ref() == Some(&first)).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_the_ends_of_all_names() {
        for (names, length, angle) in [
            (
                ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"],
                Some(1e-3),
                Some(AngleUnit::Degree),
            ),
            (
                ["X (m)", "Y (m)", "Z (m)", "A [°]", "B [°]", "C [°]"],
                Some(1.0),
                Some(AngleUnit::Degree),
            ),
            (["x_mm", "y_m", "z", "rx", "ry", "rz_rad"], None, None),
            (["p_mm[0]", "p_mm[1]", "p_mm[2]", "r[0]", "r[1]", "r[2]"], Some(1e-3), None),
        ] {
            let units = named_units(&names.map(str::to_owned));
            assert_eq!(
                (units.length, units.angle),
                (length.map(LengthScale::from_m), angle),
                "{names:?}"
            );
        }
    }
}
