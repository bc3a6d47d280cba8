//! Rotation encodings of vendors, libraries and formats, from `vendors.toml`.

use std::sync::LazyLock;

use serde::{Deserialize, Deserializer};

use super::{Convention, RotationEncoding, Units};

/// Rotation encoding of a vendor, library or format.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VendorUse {
    /// Vendor or library.
    pub who: String,
    /// Display, function or type.
    pub what: String,
    /// Encoding.
    #[serde(rename = "convention")]
    pub coding: RotationEncoding,
    /// Units, if determined.
    #[serde(default)]
    pub units: Units,
    /// Confirmed by a reliable source.
    #[serde(rename = "confidence", deserialize_with = "is_confirmed")]
    pub is_confirmed: bool,
    /// Checked by executing the library.
    #[serde(rename = "checked", default)]
    pub is_checked: bool,
    /// Frames of a controller's pose.
    pub pose: Option<String>,
    /// Source.
    pub source: String,
    id: Option<String>,
}

fn is_confirmed<'de, D: Deserializer<'de>>(from: D) -> Result<bool, D::Error> {
    String::deserialize(from).map(|grade| grade != "?")
}

impl VendorUse {
    /// Whether a confirmed arm controller reports it.
    pub fn is_vendor(&self) -> bool {
        /// Arm vendors precede it in the table.
        const FIRST_LIBRARY: &str = "ROS";
        let library = FACTS.uses.iter().position(|entry| entry.who == FIRST_LIBRARY);
        let own = FACTS.uses.iter().position(|entry| std::ptr::eq(entry, self));
        self.is_confirmed && own < library
    }

    /// Clause for the reason of a stream's role.
    pub fn description(&self) -> String {
        let Self { who, what, coding, units, .. } = self;
        let pose = self.pose.as_ref().map_or(String::new(), |pose| format!(": {pose}"));
        format!("of {who} ({what}, {coding}, {units}){pose}")
    }
}

/// Name of an Euler order in a library.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LibraryName {
    /// Library.
    pub who: String,
    /// Name of the order.
    pub name: String,
    /// Source.
    pub source: String,
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
struct Facts {
    #[serde(rename = "use")]
    uses: Vec<VendorUse>,
    naming: Vec<Naming>,
}

static FACTS: LazyLock<Facts> = LazyLock::new(|| {
    toml::from_str(include_str!("vendors.toml")).expect("the embedded table is valid")
});

/// All entries, arm vendors first.
pub fn uses() -> &'static [VendorUse] {
    &FACTS.uses
}

/// Names of vendors and formats, such as `kuka`.
pub fn names() -> impl Iterator<Item = &'static str> {
    uses().iter().filter_map(|entry| entry.id.as_deref())
}

/// Finds a vendor or format by name, ignoring case.
pub fn find(name: &str) -> Option<&'static VendorUse> {
    let normalized_name = name.trim().to_lowercase();
    uses().iter().find(|entry| entry.id.as_ref() == Some(&normalized_name))
}

/// Entries with this encoding.
pub fn uses_of(coding: RotationEncoding) -> impl Iterator<Item = &'static VendorUse> {
    uses().iter().filter(move |entry| entry.coding == coding)
}

/// Library names of an Euler order with numbers in the order of the turns.
pub fn library_names(coding: RotationEncoding) -> Vec<LibraryName> {
    let RotationEncoding::Three(Convention::Euler(order)) = coding else { return Vec::new() };
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
    fn the_vendor_table_is_complete_with_unique_names() {
        let names: Vec<&str> = names().collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(names.len(), unique.len());
        assert!(uses().iter().all(|entry| !entry.source.is_empty()));
    }

    #[test]
    fn libraries_name_the_orders_their_own_way() {
        let names = |form: &str| -> Vec<String> {
            library_names(form.parse().unwrap()).into_iter().map(|name| name.name).collect()
        };
        assert_eq!(names("euler:xyz"), ["\"xyz\"", "eulerseq \"XYZ\"", "\"sxyz\""]);
        assert_eq!(names("euler:XYZ"), ["\"XYZ\"", "eulerseq \"xyz\"", "\"rxyz\""]);
        assert!(names("rotvec").is_empty() && names("euler:zxy@axes").is_empty());
    }
}
