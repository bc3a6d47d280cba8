//! Time spans and gaps of the streams.

use maud::{Markup, html};

use super::bars::percent;
use crate::report::figures::{Figures, Silence, TimelineRow};

pub fn section(figures: &Figures) -> Markup {
    // Streams on another clock are elsewhere in time.
    let whole = figures.duration_s.max(f64::MIN_POSITIVE);
    html! {
        @if !figures.timeline.is_empty() {
            section #timeline aria-labelledby="timeline-title" {
                h2 #timeline-title { "Timeline" }
                p .says {
                    "From the first to the last sample of each stream, 0 to "
                    (format!("{:.1} s", figures.duration_s))
                    "; gaps are missing samples."
                }
                table .bars .timeline {
                    thead .visually-hidden {
                        tr {
                            th scope="col" { "stream" } th scope="col" { "time" }
                            th scope="col" { "rate, samples, missing" }
                        }
                    }
                    tbody {
                        @for row in &figures.timeline { (line(row, whole)) }
                    }
                }
            }
        }
    }
}

fn line(row: &TimelineRow, whole: f64) -> Markup {
    let [start, end] = row.span_s;
    let place = |at: f64| (at / whole).clamp(0.0, 1.0);
    html! {
        tr {
            th scope="row" {
                (row.topic)
                @if let Some(frame) = &row.frame { " " span .quiet { (frame) } }
            }
            td .bar {
                i .span style={
                    "left:" (percent(place(start))) ";width:" (percent(place(end) - place(start)))
                } {}
                @for silence in &row.silences {
                    i .gap title=(gap(silence)) style={
                        "left:" (percent(place(silence.span_s[0])))
                        ";width:" (percent(place(silence.span_s[1]) - place(silence.span_s[0])))
                    } {}
                }
            }
            td .number {
                @if let Some(rate_hz) = row.rate_hz { (format!("{rate_hz:.0} Hz")) " " }
                span .quiet { (row.count) @if row.count == 1 { " sample" } @else { " samples" } }
                @if row.dropped > 0 { " " strong { (row.dropped) " unusable" } }
                @let silences = row.silences.len() + row.silences_left_out;
                @if let Some(longest) = longest(&row.silences) {
                    " " span .quiet {
                        (silences) @if silences == 1 { " gap" } @else { " gaps" }
                        ", longest " (format!("{:.2} s", longest.span_s[1] - longest.span_s[0]))
                        @if row.silences_left_out > 0 {
                            ", the " (row.silences.len()) " longest are drawn"
                        }
                    }
                }
            }
        }
    }
}

fn gap(silence: &Silence) -> String {
    let [start, end] = silence.span_s;
    format!("+{start:.2} s to +{end:.2} s: {} missing", silence.missing)
}

fn longest(silences: &[Silence]) -> Option<&Silence> {
    let length_s = |silence: &Silence| silence.span_s[1] - silence.span_s[0];
    silences.iter().max_by(|a, b| length_s(a).total_cmp(&length_s(b)))
}
