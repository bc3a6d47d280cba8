//! Who codes rotations how, from `vendors.toml`: vendors of arms, libraries and formats.

use std::sync::LazyLock;

use serde::{Deserialize, Deserializer};

use super::{Coding, Convention, Units};

/// A vendor, a library or a format, and how its rotations are coded.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Use {
    /// The vendor or the library.
    pub who: String,
    /// What of it: a display, a function, a type.
    pub what: String,
    /// How its numbers code a rotation.
    #[serde(rename = "convention")]
    pub coding: Coding,
    /// The units that they come in, as far as these are settled.
    #[serde(default)]
    pub units: Units,
    /// Whether the source is better than hearsay.
    #[serde(rename = "confidence", deserialize_with = "is_confirmed")]
    pub is_confirmed: bool,
    /// Whether the library itself was executed.
    #[serde(rename = "checked", default)]
    pub is_checked: bool,
    /// What its pose is of and in, where a controller gives it.
    pub pose: Option<String>,
    /// Where that is from.
    pub source: String,
    id: Option<String>,
}

fn is_confirmed<'de, D: Deserializer<'de>>(from: D) -> Result<bool, D::Error> {
    String::deserialize(from).map(|grade| grade != "?")
}

impl Use {
    /// Whether it is what an arm's controller gives.
    pub fn is_vendor(&self) -> bool {
        /// Vendors of arms stand first in the table, the first of the libraries is this one.
        const FIRST_LIBRARY: &str = "ROS";
        let library = FACTS.uses.iter().position(|entry| entry.who == FIRST_LIBRARY);
        let own = FACTS.uses.iter().position(|entry| std::ptr::eq(entry, self));
        self.is_confirmed && own < library
    }

    /// Who gives what, and how: a clause for the reason of a stream.
    pub fn said(&self) -> String {
        let Self { who, what, coding, units, .. } = self;
        let pose = self.pose.as_ref().map_or(String::new(), |pose| format!(": {pose}"));
        format!("of {who} ({what}, {coding}, {units}){pose}")
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

/// How a library names orders.
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
struct Facts {
    #[serde(rename = "use")]
    uses: Vec<Use>,
    naming: Vec<Naming>,
}

static FACTS: LazyLock<Facts> = LazyLock::new(|| {
    toml::from_str(include_str!("vendors.toml")).expect("the embedded table is valid")
});

/// Everybody in the table, vendors of arms first.
pub fn uses() -> &'static [Use] {
    &FACTS.uses
}

/// The names that stand for a vendor's or a format's convention, as `kuka`.
pub fn names() -> impl Iterator<Item = &'static str> {
    uses().iter().filter_map(|entry| entry.id.as_deref())
}

/// The vendor or format of that name, in whatever case.
pub fn find(name: &str) -> Option<&'static Use> {
    let wanted = name.trim().to_lowercase();
    uses().iter().find(|entry| entry.id.as_ref() == Some(&wanted))
}

/// Those whose rotations are coded so.
pub fn uses_of(coding: Coding) -> impl Iterator<Item = &'static Use> {
    uses().iter().filter(move |entry| entry.coding == coding)
}

/// What libraries call `coding`, where it is a Euler order whose numbers go by turn.
pub fn library_names(coding: Coding) -> Vec<LibraryName> {
    let Coding::Three(Convention::Euler(order)) = coding else { return Vec::new() };
    if order.is_labelled_by_axis() {
        return Vec::new();
    }
    let lower: String = order.lettered().iter().map(|(axis, _)| axis).collect();
    let upper = lower.to_ascii_uppercase();
    let named = FACTS.naming.iter().map(|naming| {
        let pattern = if order.is_about_fixed_axes() { &naming.fixed } else { &naming.moving };
        LibraryName {
            who: naming.who.clone(),
            name: pattern.replace("{lower}", &lower).replace("{UPPER}", &upper),
            source: naming.source.clone(),
        }
    });
    named.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_whole_and_its_names_are_unique() {
        let names: Vec<&str> = names().collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(names.len(), unique.len());
        assert!(uses().iter().all(|entry| !entry.source.is_empty()));
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
