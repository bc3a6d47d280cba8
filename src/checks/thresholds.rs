//! The amounts that rules judge by: their own, unless the caller set others.

use super::{FrameThresholds, Rule, Threshold};
use crate::finding::Unit;

/// An amount beside its thresholds that a rule holds what it sees against.
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

/// The thresholds and limits that the caller set instead of the rules' own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Thresholds {
    thresholds: Vec<(&'static str, Threshold)>,
    limits: Vec<(&'static str, &'static str, f64)>,
}

impl Thresholds {
    /// Sets the threshold of `rule` that is in this unit.
    pub fn set(&mut self, rule: &Rule, threshold: Threshold) {
        self.thresholds.retain(|(code, set)| (*code, set.unit) != (rule.code, threshold.unit));
        self.thresholds.push((rule.code, threshold));
    }

    /// Sets a limit of `rule`.
    pub fn set_limit(&mut self, rule: &Rule, limit: &Limit, value: f64) {
        self.limits.retain(|(code, key, _)| (*code, *key) != (rule.code, limit.key));
        self.limits.push((rule.code, limit.key, value));
    }

    /// The threshold of `rule` that is in the unit of `own`, which is what the rule itself takes.
    pub fn of(&self, rule: &Rule, own: Threshold) -> Threshold {
        let is_it = |(code, set): &&(&str, Threshold)| (*code, set.unit) == (rule.code, own.unit);
        self.thresholds.iter().find(is_it).map_or(own, |(_, set)| *set)
    }

    /// The thresholds of a rule on frames, of which `own` are its own.
    pub(super) fn of_frames(&self, rule: &Rule, own: FrameThresholds) -> FrameThresholds {
        FrameThresholds { length: self.of(rule, own.length), angle: self.of(rule, own.angle) }
    }

    /// The amount of a limit of `rule`.
    pub fn limit(&self, rule: &Rule, limit: &Limit) -> f64 {
        let is_it = |(code, key, _): &&(&str, &str, f64)| (*code, *key) == (rule.code, limit.key);
        self.limits.iter().find(is_it).map_or(limit.value, |(_, _, value)| *value)
    }
}
