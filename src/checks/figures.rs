//! The amounts that rules judge by: their own, unless the caller set others.

use super::{Figure, FrameFigures, Rule};
use crate::finding::Unit;

/// An amount beside its figures that a rule holds what it sees against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Its name in a config, in snake_case.
    pub key: &'static str,
    /// Its unit, in SI.
    pub unit: Unit,
    /// The amount that the rule itself takes.
    pub value: f64,
    /// What it is, in a clause.
    pub what: &'static str,
}

/// The figures and limits that the caller set instead of the rules' own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    figures: Vec<(&'static str, Figure)>,
    limits: Vec<(&'static str, &'static str, f64)>,
}

impl Figures {
    /// Sets the figure of `rule` that is in this unit.
    pub fn set(&mut self, rule: &Rule, figure: Figure) {
        self.figures.retain(|(code, set)| (*code, set.unit) != (rule.code, figure.unit));
        self.figures.push((rule.code, figure));
    }

    /// Sets a limit of `rule`.
    pub fn set_limit(&mut self, rule: &Rule, limit: &Limit, value: f64) {
        self.limits.retain(|(code, key, _)| (*code, *key) != (rule.code, limit.key));
        self.limits.push((rule.code, limit.key, value));
    }

    /// The figure of `rule` that is in the unit of `own`, which is what the rule itself takes.
    pub fn of(&self, rule: &Rule, own: Figure) -> Figure {
        let is_it = |(code, set): &&(&str, Figure)| (*code, set.unit) == (rule.code, own.unit);
        self.figures.iter().find(is_it).map_or(own, |(_, set)| *set)
    }

    /// The figures of a rule on frames, of which `own` are its own.
    pub(super) fn of_frames(&self, rule: &Rule, own: FrameFigures) -> FrameFigures {
        FrameFigures { length: self.of(rule, own.length), angle: self.of(rule, own.angle) }
    }

    /// The amount of a limit of `rule`.
    pub fn limit(&self, rule: &Rule, limit: &Limit) -> f64 {
        let is_it = |(code, key, _): &&(&str, &str, f64)| (*code, *key) == (rule.code, limit.key);
        self.limits.iter().find(is_it).map_or(limit.value, |(_, _, value)| *value)
    }
}
