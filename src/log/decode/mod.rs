//! Decodes message bytes into rows of columns.
//!
//! [`recipes`] map the fields of a type to the slots of a [`Row`]. A [`Plan`] reads these fields from the
//! wire according to the schema in the log. A [`Builder`] appends rows to the columns. A new message type
//! needs a recipe; a new encoding needs another way to fill a `Row`.

mod builder;
mod cursor;
mod fault;
mod idl;
mod json;
mod msg;
mod plan;
mod protobuf;
mod recipes;
mod row;
mod schema;
mod steps;
#[cfg(test)]
pub(super) mod tests;

use self::recipes::Fields;
use self::schema::{Schema, SchemaError};
use self::steps::Serialization;

pub(super) use self::builder::{Builder, MAX_FRAMES};
pub(super) use self::plan::Plan;
pub(super) use self::protobuf::{Reader, Value, WireError};
pub(super) use self::recipes::Recipe;
pub(super) use self::row::{Row, RowTimes};
pub(super) use self::schema::{bounded, canonical, excerpt};

/// Message format as declared in the log.
#[derive(Clone, Copy, Debug)]
pub(super) struct Format<'a> {
    /// Encoding, such as `cdr`.
    pub(super) encoding: &'a str,
    pub(super) type_name: &'a str,
    /// Such as `ros2msg`; empty without a schema.
    pub(super) schema_encoding: &'a str,
    pub(super) schema: &'a [u8],
}

/// Applies to all messages of a channel.
#[derive(Debug, thiserror::Error)]
pub(super) enum FormatError {
    #[error("messages are encoded as `{found}`, expected `cdr`, `ros1`, `json` or `protobuf`")]
    Encoding { found: String },
    /// Unsupported language.
    #[error("schema is written in `{found}`, expected {expected}")]
    SchemaEncoding { expected: &'static str, found: String },
    #[error("the log has no schema for `{type_name}`")]
    NoSchema { type_name: String },
    /// Invalid, or without a required field.
    #[error("schema of `{type_name}`: {source}")]
    Schema { type_name: String, source: SchemaError },
}

impl<'a> Format<'a> {
    /// Format of columns of a table, which have no schema.
    pub(super) fn without_schema(encoding: &'a str, type_name: &'a str) -> Self {
        Self { encoding, type_name, schema_encoding: "", schema: &[] }
    }
}

impl Format<'_> {
    pub(super) fn plan(self, recipe: &Recipe) -> Result<Plan, FormatError> {
        match self.encoding {
            "cdr" => self.steps(recipe, Serialization::Cdr),
            "ros1" => self.steps(recipe, Serialization::Ros1),
            "protobuf" => self.protobuf(recipe),
            // The fields of `recipe` and the messages suffice.
            "json" => Ok(Plan::Json(json::Plan::new(recipe))),
            other => Err(FormatError::Encoding { found: excerpt(other) }),
        }
    }

    fn steps(self, recipe: &Recipe, serialization: Serialization) -> Result<Plan, FormatError> {
        let schema = self.message_schema(serialization)?;
        let compile =
            |fields| steps::Plan::compile(&schema, fields, recipe.row_list, serialization);
        self.first_layout(recipe, compile).map(Plan::Steps)
    }

    fn message_schema(self, serialization: Serialization) -> Result<Schema, FormatError> {
        let Format { type_name, schema, .. } = self;
        let parsed = match (serialization, self.schema_encoding) {
            (Serialization::Cdr, _) if schema.is_empty() => {
                return msg::common(type_name).ok_or_else(|| self.no_schema());
            }
            (Serialization::Ros1, _) if schema.is_empty() => return Err(self.no_schema()),
            (Serialization::Cdr, "ros2msg") => msg::parse(type_name, schema, msg::Dialect::Ros2),
            (Serialization::Cdr, "ros2idl" | "omgidl") => idl::parse(type_name, schema),
            (Serialization::Ros1, "ros1msg") => msg::parse(type_name, schema, msg::Dialect::Ros1),
            (Serialization::Cdr, _) => return Err(self.other_schema("`ros2msg` or `ros2idl`")),
            (Serialization::Ros1, _) => return Err(self.other_schema("`ros1msg`")),
        };
        parsed.map_err(|source| self.broken(source))
    }

    fn protobuf(self, recipe: &Recipe) -> Result<Plan, FormatError> {
        if self.schema.is_empty() {
            return Err(self.no_schema());
        }
        if self.schema_encoding != "protobuf" {
            return Err(self.other_schema("`protobuf`"));
        }
        let types = protobuf::Types::parse(self.schema).map_err(|source| self.broken(source))?;
        let compile =
            |fields| protobuf::Plan::compile(&types, self.type_name, fields, recipe.row_list);
        self.first_layout(recipe, compile).map(Plan::Protobuf)
    }

    /// The first layout that the schema supports.
    fn first_layout<P>(
        self,
        recipe: &Recipe,
        compile: impl Fn(Fields) -> Result<P, SchemaError>,
    ) -> Result<P, FormatError> {
        let mut refusal = None;
        for fields in recipe.layouts {
            match compile(fields) {
                Ok(plan) => return Ok(plan),
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        Err(refusal.map_or_else(|| self.no_schema(), |source| self.broken(source)))
    }

    fn no_schema(self) -> FormatError {
        FormatError::NoSchema { type_name: excerpt(self.type_name) }
    }

    fn other_schema(self, expected: &'static str) -> FormatError {
        FormatError::SchemaEncoding { expected, found: excerpt(self.schema_encoding) }
    }

    fn broken(self, source: SchemaError) -> FormatError {
        FormatError::Schema { type_name: excerpt(self.type_name), source }
    }
}
