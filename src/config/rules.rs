//! Tables of rules: thresholds, limits and severities, as defined by each rule.

use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error as _, MapAccess, Visitor};
use serde_json::{Map, Value, json};

use super::quantity::Quantity;
use crate::checks::{self, Grade, Limit, Rule, Settings, Threshold};
use crate::finding::{Severity, Unit};

#[derive(Clone, Debug, Default)]
pub(super) struct Rules(Vec<RuleTable>);

#[derive(Clone, Debug)]
struct RuleTable {
    rule: &'static Rule,
    thresholds: Vec<Threshold>,
    limits: Vec<(&'static Limit, f64)>,
    severity: Option<Severity>,
}

impl Rules {
    pub fn apply(&self, settings: &mut Settings) {
        for table in &self.0 {
            for threshold in &table.thresholds {
                settings.thresholds.set(table.rule, *threshold);
            }
            for (limit, value) in &table.limits {
                settings.thresholds.set_limit(table.rule, limit, *value);
            }
            settings.severities.extend(table.severity.map(|severity| (table.rule.code, severity)));
        }
    }
}

impl<'de> Deserialize<'de> for Rules {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Tables;
        impl<'de> Visitor<'de> for Tables {
            type Value = Rules;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("tables of rules by code")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Rules, A::Error> {
                let mut tables = Vec::new();
                while let Some(Code(rule)) = map.next_key()? {
                    tables.push(map.next_value_seed(Table(rule))?);
                }
                Ok(Rules(tables))
            }
        }
        from.deserialize_map(Tables)
    }
}

#[derive(Deserialize)]
#[serde(try_from = "String")]
struct Code(&'static Rule);

impl TryFrom<String> for Code {
    type Error = checks::UnknownRule;

    fn try_from(code: String) -> Result<Self, Self::Error> {
        checks::find(&code).map(Self)
    }
}

enum Key {
    Threshold(Level),
    Severity,
    Limit(&'static Limit),
}

#[derive(Clone, Copy)]
enum Level {
    Warning,
    Error,
}

fn keys(rule: &Rule) -> Vec<&'static str> {
    let thresholds: &[&str] = match rule.grade {
        Grade::From(_) => &["warning", "error"],
        Grade::Fixed(_) => &[],
    };
    let limits = rule.limits.iter().map(|limit| limit.key);
    thresholds.iter().copied().chain(["severity"]).chain(limits).collect()
}

struct KeyOf(&'static Rule);

impl<'de> DeserializeSeed<'de> for KeyOf {
    type Value = Key;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Key, D::Error> {
        let key = String::deserialize(from)?;
        let has_thresholds = matches!(self.0.grade, Grade::From(_));
        let limit = self.0.limits.iter().find(|limit| limit.key == key);
        match (key.as_str(), limit) {
            ("warning", _) if has_thresholds => Ok(Key::Threshold(Level::Warning)),
            ("error", _) if has_thresholds => Ok(Key::Threshold(Level::Error)),
            ("severity", _) => Ok(Key::Severity),
            (_, Some(limit)) => Ok(Key::Limit(limit)),
            (key, None) => {
                let known: Vec<String> =
                    keys(self.0).iter().map(|known| format!("`{known}`")).collect();
                let known = known.join(", ");
                Err(D::Error::custom(format!("unknown field `{key}`, expected one of {known}")))
            }
        }
    }
}

struct Table(&'static Rule);

impl<'de> DeserializeSeed<'de> for Table {
    type Value = RuleTable;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<RuleTable, D::Error> {
        from.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Table {
    type Value = RuleTable;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a table for {}", self.0.code)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RuleTable, A::Error> {
        let rule = self.0;
        let mut table =
            RuleTable { rule, thresholds: Vec::new(), limits: Vec::new(), severity: None };
        while let Some(key) = map.next_key_seed(KeyOf(rule))? {
            match key {
                Key::Threshold(level) => {
                    for (unit, amount) in map.next_value_seed(AmountsOf(rule))? {
                        table.set(level, unit, amount);
                    }
                }
                Key::Severity => {
                    table.severity = Some(map.next_value()?);
                }
                Key::Limit(limit) => {
                    table.limits.push((limit, map.next_value_seed(LimitOf(limit))?));
                }
            }
        }
        match table.thresholds.iter().find(|threshold| threshold.warning > threshold.error) {
            None => Ok(table),
            Some(Threshold { unit, warning, error }) => Err(A::Error::custom(format!(
                "{}: the warning ({}) must not exceed the error ({})",
                rule.code,
                unit.show(*warning),
                unit.show(*error)
            ))),
        }
    }
}

impl RuleTable {
    fn set(&mut self, level: Level, unit: Unit, amount: f64) {
        let own = self.rule.grade.thresholds().iter().find(|own| own.unit == unit);
        let known = self.thresholds.iter().position(|threshold| threshold.unit == unit);
        let at = known.or_else(|| {
            self.thresholds.push(*own?);
            Some(self.thresholds.len() - 1)
        });
        let Some(threshold) = at.and_then(|at| self.thresholds.get_mut(at)) else { return };
        match level {
            Level::Warning => threshold.warning = amount,
            Level::Error => threshold.error = amount,
        }
    }
}

/// One value per unit.
struct AmountsOf(&'static Rule);

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected a value with its unit, as in \"2 ms\", or a list of such values"
)]
enum OneOrMore {
    One(Quantity),
    More(Vec<Quantity>),
}

impl<'de> DeserializeSeed<'de> for AmountsOf {
    type Value = Vec<(Unit, f64)>;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<Self::Value, D::Error> {
        let amounts = match OneOrMore::deserialize(from)? {
            OneOrMore::One(one) => vec![one],
            OneOrMore::More(more) => more,
        };
        let units: Vec<Unit> =
            self.0.grade.thresholds().iter().map(|threshold| threshold.unit).collect();
        let read = |quantity: &Quantity| quantity.one_of(&units).map_err(D::Error::custom);
        amounts.iter().map(read).collect()
    }
}

struct LimitOf(&'static Limit);

impl<'de> DeserializeSeed<'de> for LimitOf {
    type Value = f64;

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<f64, D::Error> {
        Quantity::deserialize(from)?.amount(self.0.unit).map_err(D::Error::custom)
    }
}

impl JsonSchema for Rules {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Rules".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let amount = |unit: Unit| match unit {
            Unit::One => json!(["number", "string"]),
            _ => json!("string"),
        };
        let table = |rule: &&'static Rule| {
            let mut keys = Map::new();
            let severity = json!({
                "description": "Severity of all findings of the rule, except those that are `info`",
                "enum": ["info", "warning", "error"],
            });
            let thresholds = rule.grade.thresholds();
            if let Some(first) = thresholds.first() {
                let own = |of: fn(&Threshold) -> f64| -> Value {
                    let shown =
                        thresholds.iter().map(|threshold| threshold.unit.show(of(threshold)));
                    match shown.collect::<Vec<_>>().as_slice() {
                        [one] => json!(one),
                        more => json!(more),
                    }
                };
                let one = json!({ "type": amount(first.unit) });
                for (key, what, default) in [
                    (
                        "warning",
                        "Smallest value that is a warning",
                        own(|threshold| threshold.warning),
                    ),
                    ("error", "Smallest value that is an error", own(|threshold| threshold.error)),
                ] {
                    let several = json!({ "type": "array", "items": one });
                    let schema = json!({
                        "description": what, "default": default, "anyOf": [one, several],
                    });
                    keys.insert(key.to_owned(), schema);
                }
            }
            keys.insert("severity".to_owned(), severity);
            for limit in rule.limits {
                let schema = json!({
                    "description": limit.what,
                    "default": limit.unit.show(limit.value),
                    "type": amount(limit.unit),
                });
                keys.insert(limit.key.to_owned(), schema);
            }
            let table = json!({
                "type": "object",
                "description": rule.summary(),
                "properties": keys,
                "additionalProperties": false,
            });
            (rule.code.to_owned(), table)
        };
        let tables: Map<String, Value> = checks::registry().iter().map(table).collect();
        json_schema!({ "type": "object", "properties": tables, "additionalProperties": false })
    }
}
