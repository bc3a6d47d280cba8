//! Tables that serve as plots.

use maud::{Markup, html};

use crate::finding::Unit;

#[derive(Clone, Debug)]
pub struct Bars {
    pub title: String,
    /// One sentence.
    pub caption: String,
    pub bars: Vec<Bar>,
}

#[derive(Clone, Debug)]
pub struct Bar {
    pub label: String,
    pub value: f64,
    /// Formatted value.
    pub text: String,
    /// Selected by the audit.
    pub is_best: bool,
}

impl Bars {
    pub fn markup(&self) -> Markup {
        let most = self.bars.iter().map(|bar| bar.value).fold(f64::MIN_POSITIVE, f64::max);
        html! {
            figure .picture {
                figcaption { strong { (self.title) } span .says { (self.caption) } }
                table .bars {
                    tbody {
                        @for bar in &self.bars {
                            tr .best[bar.is_best] {
                                th scope="row" { (bar.label) }
                                td .bar { span style={ "width:" (css_percent(bar.value / most)) } {} }
                                td .number { (bar.text) }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Amounts on one axis through zero.
#[derive(Clone, Debug)]
pub struct Whiskers {
    pub title: String,
    /// One sentence.
    pub caption: String,
    pub rows: Vec<Whisker>,
}

#[derive(Clone, Debug)]
pub struct Whisker {
    pub label: String,
    /// With its interval, SI units. `None` if not determined.
    pub amount: Option<(f64, Option<[f64; 2]>, Unit)>,
    /// It is a finding.
    pub is_fault: bool,
    /// Threshold in the unit of the amount.
    pub limit: Option<f64>,
}

impl Whiskers {
    pub fn markup(&self) -> Markup {
        html! {
            figure .picture {
                figcaption { strong { (self.title) } span .says { (self.caption) } }
                table .bars .whiskers {
                    tbody {
                        @for row in &self.rows {
                            tr .fault[row.is_fault] {
                                th scope="row" { (row.label) }
                                @match row.amount {
                                    Some((value, interval, unit)) => {
                                        td .bar { (self.track(row, value, interval, unit)) }
                                        td .number { (unit.show_signed_within(value, interval)) }
                                    }
                                    None => { td .bar {} td .number { "not told" } }
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    fn track(&self, row: &Whisker, value: f64, interval: Option<[f64; 2]>, unit: Unit) -> Markup {
        let full = self.half_axis(unit);
        let place = |at: f64| css_percent(0.5 + 0.5 * (at / full).clamp(-1.0, 1.0));
        let [low, high] = interval.unwrap_or([value, value]);
        let width = 0.5 * ((high / full).clamp(-1.0, 1.0) - (low / full).clamp(-1.0, 1.0));
        html! {
            i .zero {}
            @for at in row.limit.iter().flat_map(|limit| [-limit, *limit]).filter(|at| at.abs() <= full) {
                i .limit title={ "limit " (unit.show(at.abs())) } style={ "left:" (place(at)) } {}
            }
            i .whisker style={ "left:" (place(low)) ";width:" (css_percent(width)) } {}
            i .dot style={ "left:" (place(value)) } {}
        }
    }

    /// Half the axis. Contains every amount, and the intervals unless they would make the amounts too
    /// small.
    fn half_axis(&self, unit: Unit) -> f64 {
        /// Maximum ratio of the half axis to the largest amount.
        const MAX_INTERVAL_RATIO: f64 = 3.0;
        let alike = self.rows.iter().filter_map(|row| row.amount).filter(|(.., own)| *own == unit);
        let most = alike.clone().map(|(value, ..)| value.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let ends = alike.filter_map(|(_, interval, _)| interval).flatten().map(f64::abs);
        1.08 * ends.fold(most, f64::max).min(MAX_INTERVAL_RATIO * most)
    }
}

/// 0 if not finite.
pub fn css_percent(share: f64) -> String {
    let share = if share.is_finite() { share } else { 0.0 };
    format!("{:.2}%", 100.0 * share)
}
