//! Reads JSON messages field by field, without building a tree.
//!
//! ROS types are as rosbridge writes them; Foxglove types as in its schemas, or in the JSON mapping of
//! protocol buffers. A stamp is an object with seconds and nanoseconds, or a string. A number may be `null`
//! or a string. A missing field has its default.

mod values;

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use self::values::SlotVisitor;
use super::fault::{Append, DecodeError, JsonError};
use super::recipes::{Recipe, is_below};
use super::row::{Row, Slot};
use super::schema::excerpt;

/// Wanted fields as a tree.
#[derive(Debug)]
pub(crate) struct Plan {
    root: Branch,
    /// Reset before a message; `row_slots` before each row.
    slots: Vec<Slot>,
    row_slots: Vec<Slot>,
    has_rows: bool,
    /// Objects of a message and of a row.
    required: Marks,
    row_required: Marks,
}

/// Set of [`Branch::mark`]s.
type Marks = u64;

#[derive(Debug)]
struct Branch {
    /// Path from the root; empty for the root.
    path: String,
    /// Unique bit.
    mark: Marks,
    /// Its elements are rows.
    is_rows: bool,
    children: Vec<(&'static str, Child)>,
}

#[derive(Debug)]
enum Child {
    Leaf { slot: Slot, path: &'static str },
    Branch(Branch),
}

impl Plan {
    /// Collects the fields of all layouts; a message has one.
    pub(super) fn new(recipe: &Recipe) -> Self {
        let mut marks = 0;
        let mut root = Branch::new(String::new(), false, &mut marks);
        let mut plan_slots = Vec::new();
        for &(path, slot) in recipe.layouts.iter().copied().flatten() {
            root.insert(path, slot, recipe.row_list, &mut marks);
            plan_slots.push((path, slot));
        }
        let is_in_row =
            |path: &str| recipe.row_list.is_some_and(|rows| path == rows || is_below(path, rows));
        let in_all_layouts = |branch: &Branch| {
            let holds = |path: &str| is_below(path, &branch.path);
            recipe.layouts.iter().all(|fields| fields.iter().any(|(path, _)| holds(path)))
        };
        let (mut required, mut row_required) = (0, 0);
        root.visit(&mut |branch| {
            if branch.path.is_empty() || branch.is_rows || !in_all_layouts(branch) {
                return;
            }
            let marks = if is_in_row(&branch.path) { &mut row_required } else { &mut required };
            *marks |= branch.mark;
        });
        let slots = plan_slots.iter().map(|(_, slot)| *slot).collect();
        let in_row = plan_slots.iter().filter(|(path, _)| is_in_row(path));
        let row_slots = in_row.map(|(_, slot)| *slot).collect();
        Self { root, slots, row_slots, has_rows: recipe.row_list.is_some(), required, row_required }
    }

    pub(super) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        self.slots.iter().for_each(|&slot| row.reset(slot));
        // The rows may precede the fields they share.
        let found = self.walk(message, Pass::Shared, row, append)?;
        self.require(self.required, found)?;
        if self.has_rows {
            self.walk(message, Pass::Rows, row, append)?;
        } else {
            append(row)?;
        }
        Ok(())
    }

    fn walk(
        &self,
        message: &[u8],
        pass: Pass,
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<Marks, JsonError> {
        let mut walk = Walk { plan: self, pass, row, append, found: 0 };
        let mut deserializer = serde_json::Deserializer::from_slice(message);
        deserializer
            .deserialize_map(BranchVisitor { branch: &self.root, walk: &mut walk })
            .and_then(|()| deserializer.end())
            .map_err(|error| JsonError::Malformed { what: excerpt(&error.to_string()) })?;
        Ok(walk.found)
    }

    /// If an object is missing, its numbers would all be zero.
    fn require(&self, required: Marks, found: Marks) -> Result<(), JsonError> {
        let missing = required & !found;
        if missing == 0 {
            return Ok(());
        }
        let mut path = String::new();
        self.root.visit(&mut |branch| {
            if branch.mark & missing != 0 && path.is_empty() {
                path.clone_from(&branch.path);
            }
        });
        Err(JsonError::Missing { path })
    }
}

impl Branch {
    fn new(path: String, is_rows: bool, marks: &mut u32) -> Self {
        let mark = 1_u64.checked_shl(*marks).unwrap_or(0);
        *marks += 1;
        Self { path, mark, is_rows, children: Vec::new() }
    }

    /// Also adds the branches leading to it.
    fn insert(
        &mut self,
        path: &'static str,
        slot: Slot,
        each: Option<&'static str>,
        marks: &mut u32,
    ) {
        let own = if self.path.is_empty() { path } else { &path[self.path.len() + 1..] };
        let Some((name, _)) = own.split_once('.') else {
            let is_new = self.children.iter().all(|(child, _)| *child != own);
            if is_new {
                self.children.push((own, Child::Leaf { slot, path }));
            }
            return;
        };
        let index = self.children.iter().position(|(child, _)| *child == name);
        let index = index.unwrap_or_else(|| {
            let branch_path = path[..path.len() - own.len() + name.len()].to_owned();
            let is_rows = each == Some(branch_path.as_str());
            self.children.push((name, Child::Branch(Self::new(branch_path, is_rows, marks))));
            self.children.len() - 1
        });
        if let Child::Branch(branch) = &mut self.children[index].1 {
            branch.insert(path, slot, each, marks);
        }
    }

    /// Includes all branches below.
    fn visit(&self, see: &mut dyn FnMut(&Branch)) {
        see(self);
        for (_, child) in &self.children {
            if let Child::Branch(branch) = child {
                branch.visit(see);
            }
        }
    }

    fn leads_to_rows(&self) -> bool {
        let mut leads = false;
        self.visit(&mut |branch| leads |= branch.is_rows);
        leads
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Pass {
    /// Outside rows.
    Shared,
    Rows,
    /// Within one row.
    Row,
}

struct Walk<'w, 'f> {
    plan: &'w Plan,
    pass: Pass,
    row: &'w mut Row,
    append: &'w mut Append<'f>,
    found: Marks,
}

struct BranchVisitor<'v, 'w, 'f> {
    branch: &'v Branch,
    walk: &'v mut Walk<'w, 'f>,
}

impl<'de> Visitor<'de> for BranchVisitor<'_, '_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.branch.path.as_str() {
            "" => f.write_str("an object"),
            path => write!(f, "an object in field `{path}`"),
        }
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { branch, walk } = self;
        walk.found |= branch.mark;
        while let Some(child) = map.next_key_seed(Key(&branch.children))? {
            match child {
                Some(Child::Leaf { slot, path }) if walk.pass != Pass::Rows => {
                    map.next_value_seed(SlotVisitor { slot: *slot, path, row: walk.row })?;
                }
                Some(Child::Branch(branch)) if walk.enters(branch) => {
                    map.next_value_seed(BranchSeed { branch, walk: &mut *walk })?;
                }
                _ => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }
}

impl Walk<'_, '_> {
    fn enters(&self, branch: &Branch) -> bool {
        match self.pass {
            Pass::Shared => !branch.is_rows,
            Pass::Rows => branch.leads_to_rows(),
            Pass::Row => true,
        }
    }
}

struct BranchSeed<'v, 'w, 'f> {
    branch: &'v Branch,
    walk: &'v mut Walk<'w, 'f>,
}

impl<'de> DeserializeSeed<'de> for BranchSeed<'_, '_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let Self { branch, walk } = self;
        if branch.is_rows && walk.pass == Pass::Rows {
            deserializer.deserialize_any(RowsVisitor { branch, walk })
        } else {
            deserializer.deserialize_any(BranchVisitor { branch, walk })
        }
    }
}

struct RowsVisitor<'v, 'w, 'f> {
    branch: &'v Branch,
    walk: &'v mut Walk<'w, 'f>,
}

impl<'de> Visitor<'de> for RowsVisitor<'_, '_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array in field `{}`", self.branch.path)
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut rows: A) -> Result<(), A::Error> {
        let Self { branch, walk } = self;
        let plan = walk.plan;
        walk.pass = Pass::Row;
        for index in 0.. {
            plan.row_slots.iter().for_each(|&slot| walk.row.reset(slot));
            walk.found = 0;
            if rows.next_element_seed(BranchSeed { branch, walk: &mut *walk })?.is_none() {
                break;
            }
            plan.require(plan.row_required, walk.found).map_err(A::Error::custom)?;
            walk.row.index = index;
            (walk.append)(walk.row).map_err(A::Error::custom)?;
        }
        walk.pass = Pass::Rows;
        Ok(())
    }
}

struct Key<'v>(&'v [(&'static str, Child)]);

impl<'de, 'v> DeserializeSeed<'de> for Key<'v> {
    type Value = Option<&'v Child>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl<'v> Visitor<'_> for Key<'v> {
    type Value = Option<&'v Child>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<Self::Value, E> {
        Ok(self.0.iter().find(|(name, _)| is_named(name, key)).map(|(_, child)| child))
    }
}

/// Also accepts the lowerCamelCase of protocol buffers' JSON mapping.
fn is_named(name: &str, key: &str) -> bool {
    let mut raised = false;
    let camel = name.chars().filter_map(|letter| {
        let raise = std::mem::replace(&mut raised, letter == '_');
        match letter {
            '_' => None,
            letter if raise => Some(letter.to_ascii_uppercase()),
            letter => Some(letter),
        }
    });
    name == key || camel.eq(key.chars())
}
