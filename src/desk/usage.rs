//! Who uses which convention, from `conventions.toml`.

use std::sync::LazyLock;

use serde::Deserialize;

use crate::geometry::{AngleUnit, LengthUnit, Pose};
use crate::robot::{catalogue, nearest};

use super::form::{Form, Style};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    r#use: Vec<Entry>,
    naming: Vec<Naming>,
    frames: Vec<Frames>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    id: Option<String>,
    who: String,
    what: String,
    convention: String,
    #[serde(default)]
    units: String,
    confidence: String,
    #[serde(default)]
    checked: bool,
    #[serde(default)]
    pose: Option<String>,
    source: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Naming {
    who: String,
    fixed: String,
    moving: String,
    source: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Frames {
    end: String,
    arm: String,
    arms: String,
    from: String,
    to: String,
}

/// Somebody who uses a form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Use {
    /// The maker or the library.
    pub who: String,
    /// What of it: a display, a function, a type.
    pub what: String,
    /// The form.
    pub form: Form,
    /// The units that it comes in, `mm, deg`; empty where that is left open.
    pub units: String,
    /// Whether the source is better than hearsay.
    pub is_confirmed: bool,
    /// Whether the library itself was executed.
    pub is_checked: bool,
    /// What its pose is of and in, where a controller gives it.
    pub pose: Option<String>,
    /// Where that is from.
    pub source: String,
    id: Option<String>,
    style: Style,
}

impl Use {
    /// Whether its angles are degrees.
    pub fn in_degrees(&self) -> bool {
        self.style.angle == Some(AngleUnit::Degree)
    }

    /// Whether its positions are millimetres.
    pub fn in_millimetres(&self) -> bool {
        self.style.length == Some(LengthUnit::Millimetre)
    }

    /// Whether it is what an arm's controller gives.
    pub fn is_maker(&self) -> bool {
        /// Makers of arms stand first in the table, the first of the libraries is this one.
        const FIRST_LIBRARY: &str = "ROS";
        let library = FACTS.uses.iter().position(|entry| entry.who == FIRST_LIBRARY);
        let own = FACTS.uses.iter().position(|entry| std::ptr::eq(entry, self));
        self.is_confirmed && own < library
    }

    /// Who gives what, and how: a clause for the reason of a stream.
    pub fn said(&self) -> String {
        let Self { who, what, form, units, .. } = self;
        let pose = self.pose.as_ref().map_or(String::new(), |pose| format!(": {pose}"));
        format!("of {who} ({what}, {form}, {units}){pose}")
    }
}

/// What a library calls a Euler order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LibraryName {
    /// The library.
    pub who: String,
    /// Its name of the order.
    pub name: String,
    /// Where that is from.
    pub source: String,
}

/// Two frames that stand fixed to each other at one end of usual arms.
#[derive(Clone, Debug)]
pub(super) struct FixedPair {
    pub is_base: bool,
    /// Whose arms have them.
    pub arms: String,
    pub from: String,
    pub to: String,
    pub from_to: Pose,
}

struct Facts {
    uses: Vec<Use>,
    naming: Vec<Naming>,
    pairs: Vec<FixedPair>,
}

static FACTS: LazyLock<Facts> = LazyLock::new(|| {
    let file: File =
        toml::from_str(include_str!("conventions.toml")).expect("the embedded table is valid");
    let uses = file.r#use.into_iter().map(|entry| {
        let form: Form = entry.convention.parse().expect("the embedded table names forms");
        let mut units = Style::default();
        if !entry.units.is_empty() {
            for unit in entry.units.split(", ") {
                units = units.or(unit_style(unit).expect("the embedded table names units"));
            }
        }
        Use {
            form,
            style: Style { form: Some(form), ..units },
            id: entry.id,
            who: entry.who,
            what: entry.what,
            units: entry.units,
            is_confirmed: entry.confidence != "?",
            is_checked: entry.checked,
            pose: entry.pose,
            source: entry.source,
        }
    });
    let pairs = file.frames.into_iter().map(|frames| {
        let arm = catalogue::find(&frames.arm).expect("the embedded table names arms");
        let link = |name: &str| arm.link(name).expect("the embedded table names links");
        let from_to = arm.fixed_transform(link(&frames.from), link(&frames.to));
        FixedPair {
            is_base: frames.end == "base",
            from_to: from_to.expect("the frames of the embedded table are fixed"),
            arms: frames.arms,
            from: frames.from,
            to: frames.to,
        }
    });
    Facts { uses: uses.collect(), pairs: pairs.collect(), naming: file.naming }
});

fn unit_style(unit: &str) -> Option<Style> {
    Some(match unit {
        "m" => Style { length: Some(LengthUnit::Metre), ..Style::default() },
        "mm" => Style { length: Some(LengthUnit::Millimetre), ..Style::default() },
        "rad" => Style { angle: Some(AngleUnit::Radian), ..Style::default() },
        "deg" => Style { angle: Some(AngleUnit::Degree), ..Style::default() },
        _ => return None,
    })
}

/// Everybody who uses a form, makers of arms first.
pub fn uses() -> &'static [Use] {
    &FACTS.uses
}

/// The names that stand for a maker's or a format's convention, as `kuka`.
pub fn maker_names() -> impl Iterator<Item = &'static str> {
    uses().iter().filter_map(|entry| entry.id.as_deref())
}

/// The maker or format of that name, in whatever case.
///
/// # Errors
/// Where there is none: the nearest name.
pub fn maker(name: &str) -> Result<&'static Use, String> {
    let wanted = name.trim().to_lowercase();
    let found = uses().iter().find(|entry| entry.id.as_ref() == Some(&wanted));
    found.ok_or_else(|| match nearest(&wanted, maker_names()).first() {
        Some(near) => format!("no maker `{name}` is known: did you mean `{near}`?"),
        None => {
            let known: Vec<&str> = maker_names().collect();
            format!("no maker `{name}` is known: there are {}", known.join(", "))
        }
    })
}

/// Those who use `form`.
pub fn uses_of(form: Form) -> impl Iterator<Item = &'static Use> {
    uses().iter().filter(move |entry| entry.form == form)
}

/// What libraries call `form`, where it is a Euler order whose numbers go by turn.
pub fn library_names(form: Form) -> Vec<LibraryName> {
    let name = form.to_string();
    let Some(letters) = name.strip_prefix("euler:").filter(|letters| letters.len() == 3) else {
        return Vec::new();
    };
    let is_fixed = letters.starts_with(|letter: char| letter.is_ascii_lowercase());
    let (lower, upper) = (letters.to_ascii_lowercase(), letters.to_ascii_uppercase());
    let named = FACTS.naming.iter().map(|naming| {
        let pattern = if is_fixed { &naming.fixed } else { &naming.moving };
        LibraryName {
            who: naming.who.clone(),
            name: pattern.replace("{lower}", &lower).replace("{UPPER}", &upper),
            source: naming.source.clone(),
        }
    });
    named.collect()
}

/// The style of the maker or format of that name.
pub(super) fn style_of(name: &str) -> Option<Style> {
    let name = name.to_ascii_lowercase();
    uses().iter().find(|entry| entry.id.as_ref() == Some(&name)).map(|entry| entry.style)
}

/// The fixed pairs of frames of usual arms.
pub(super) fn fixed_pairs() -> &'static [FixedPair] {
    &FACTS.pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desk::{AngleUnit, LengthUnit};

    #[test]
    fn the_table_is_whole_and_its_names_are_unique() {
        let names: Vec<&str> = maker_names().collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(names.len(), unique.len());
        assert!(uses().iter().all(|entry| !entry.source.is_empty()));
        assert_eq!(fixed_pairs().iter().filter(|pair| pair.is_base).count(), 1);
    }

    #[test]
    fn a_makers_name_stands_for_its_form_and_units() {
        let kuka: Style = "kuka".parse().unwrap();
        assert_eq!(kuka.form.map(|form| form.to_string()).as_deref(), Some("euler:ZYX"));
        assert_eq!(
            (kuka.length, kuka.angle),
            (Some(LengthUnit::Millimetre), Some(AngleUnit::Degree))
        );
        assert!("kuka,rad,deg".parse::<Style>().is_err());
        let in_radians: Style = "kuka,rad".parse().unwrap();
        assert_eq!(in_radians.angle, Some(AngleUnit::Radian));
        assert_eq!(in_radians.length, Some(LengthUnit::Millimetre));
    }

    #[test]
    fn libraries_name_the_orders_each_in_its_way() {
        let names = |form: &str| -> Vec<String> {
            library_names(form.parse().unwrap()).into_iter().map(|name| name.name).collect()
        };
        assert_eq!(names("euler:xyz"), ["\"xyz\"", "eulerseq \"XYZ\"", "\"sxyz\""]);
        assert_eq!(names("euler:XYZ"), ["\"XYZ\"", "eulerseq \"xyz\"", "\"rxyz\""]);
        assert!(names("rotvec").is_empty() && names("euler:zxy@axes").is_empty());
    }
}
