//! Thresholds and limits of rules, with overrides.

use super::{FrameThresholds, Rule, Threshold};
use crate::finding::Unit;

/// A further limit of a rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Config key in snake_case.
    pub key: &'static str,
    /// SI unit.
    pub unit: Unit,
    /// Default.
    pub value: f64,
    /// Clause that describes it.
    pub what: &'static str,
}

/// Overrides of thresholds and limits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Thresholds {
    thresholds: Vec<(&'static str, Threshold)>,
    limits: Vec<(&'static str, &'static str, f64)>,
}

impl Thresholds {
    /// Overrides the threshold in this unit.
    pub fn set(&mut self, rule: &Rule, threshold: Threshold) {
        self.thresholds.retain(|(code, set)| (*code, set.unit) != (rule.code, threshold.unit));
        self.thresholds.push((rule.code, threshold));
    }

    /// Overrides a limit.
    pub fn set_limit(&mut self, rule: &Rule, limit: &Limit, value: f64) {
        self.limits.retain(|(code, key, _)| (*code, *key) != (rule.code, limit.key));
        self.limits.push((rule.code, limit.key, value));
    }

    /// Threshold in the unit of `default`, the default.
    pub fn threshold(&self, rule: &Rule, default: Threshold) -> Threshold {
        let is_override =
            |(code, set): &&(&str, Threshold)| (*code, set.unit) == (rule.code, default.unit);
        self.thresholds.iter().find(is_override).map_or(default, |(_, set)| *set)
    }

    pub(super) fn frame_thresholds(
        &self,
        rule: &Rule,
        default: FrameThresholds,
    ) -> FrameThresholds {
        FrameThresholds {
            length: self.threshold(rule, default.length),
            angle: self.threshold(rule, default.angle),
        }
    }

    /// Value of a limit.
    pub fn limit(&self, rule: &Rule, limit: &Limit) -> f64 {
        let is_override =
            |(code, key, _): &&(&str, &str, f64)| (*code, *key) == (rule.code, limit.key);
        self.limits.iter().find(is_override).map_or(limit.value, |(_, _, value)| *value)
    }
}
