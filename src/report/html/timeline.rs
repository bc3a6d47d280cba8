//! Time spans and gaps of the streams.

use maud::{Markup, html};

use super::bars::css_percent;
use crate::report::figures::{Figures, StreamGap, TimelineRow};

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
                        @for row in &figures.timeline { (stream_row(row, whole)) }
                    }
                }
            }
        }
    }
}

fn stream_row(row: &TimelineRow, whole: f64) -> Markup {
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
                    "left:" (css_percent(place(start))) ";width:" (css_percent(place(end) - place(start)))
                } {}
                @for gap in &row.gaps {
                    i .gap title=(gap_text(gap)) style={
                        "left:" (css_percent(place(gap.span_s[0])))
                        ";width:" (css_percent(place(gap.span_s[1]) - place(gap.span_s[0])))
                    } {}
                }
            }
            td .number {
                @if let Some(rate_hz) = row.rate_hz { (format!("{rate_hz:.0} Hz")) " " }
                span .quiet { (row.count) @if row.count == 1 { " sample" } @else { " samples" } }
                @if row.dropped > 0 { " " strong { (row.dropped) " unusable" } }
                @let gaps = row.gaps.len() + row.omitted_gaps;
                @if let Some(longest) = longest_gap(&row.gaps) {
                    " " span .quiet {
                        (gaps) @if gaps == 1 { " gap" } @else { " gaps" }
                        ", longest " (format!("{:.2} s", longest.span_s[1] - longest.span_s[0]))
                        @if row.omitted_gaps > 0 {
                            ", the " (row.gaps.len()) " longest are drawn"
                        }
                    }
                }
            }
        }
    }
}

fn gap_text(gap: &StreamGap) -> String {
    let [start, end] = gap.span_s;
    format!("+{start:.2} s to +{end:.2} s: {} missing", gap.missing)
}

fn longest_gap(gaps: &[StreamGap]) -> Option<&StreamGap> {
    let length_s = |gap: &StreamGap| gap.span_s[1] - gap.span_s[0];
    gaps.iter().max_by(|a, b| length_s(a).total_cmp(&length_s(b)))
}
