//! 2-D plots of positions and directions as SVG, without a script.

use maud::{Markup, html};

use super::plot::SeriesRole;
use crate::finding::trimmed;

/// Equal scale on both axes.
#[derive(Clone, Debug, Default)]
pub struct Plane {
    pub title: String,
    /// One sentence, also the alternative text.
    pub caption: String,
    /// Names and units. Empty to draw none.
    pub axes: [&'static str; 2],
    pub dots: Vec<Dot>,
    pub arrows: Vec<Arrow>,
    /// Circle around the origin: radius in the axes' unit, and label.
    pub limit: Option<(f64, String)>,
}

#[derive(Clone, Debug)]
pub struct Dot {
    pub at: [f64; 2],
    /// 0 to 1.
    pub size: f64,
    pub role: SeriesRole,
}

#[derive(Clone, Debug)]
pub struct Arrow {
    pub from: [f64; 2],
    pub to: [f64; 2],
    pub label: String,
    pub role: SeriesRole,
}

const WIDTH_PX: f64 = 420.0;
const HEIGHT_PX: f64 = 320.0;
/// For axes and numbers: left, right, top and bottom.
const MARGINS_PX: [f64; 4] = [52.0, 14.0, 12.0, 40.0];
/// Width and height within the margins.
const INNER_PX: [f64; 2] =
    [WIDTH_PX - MARGINS_PX[0] - MARGINS_PX[1], HEIGHT_PX - MARGINS_PX[2] - MARGINS_PX[3]];

struct PlaneScale {
    middle: [f64; 2],
    per_unit: f64,
}

impl PlaneScale {
    fn fit(plane: &Plane) -> Option<Self> {
        let ends = plane.arrows.iter().flat_map(|arrow| [arrow.from, arrow.to]);
        let round = plane.limit.iter().flat_map(|(radius, _)| [[*radius; 2], [-radius; 2]]);
        let all = plane.dots.iter().map(|dot| dot.at).chain(ends);
        let drawn: Vec<[f64; 2]> = all.filter(|at| at.iter().all(|at| at.is_finite())).collect();
        let first = *drawn.first()?;
        let (low, high) = drawn.into_iter().chain(round).fold((first, first), |(low, high), at| {
            let both =
                |pick: fn(f64, f64) -> f64, a: [f64; 2]| [pick(a[0], at[0]), pick(a[1], at[1])];
            (both(f64::min, low), both(f64::max, high))
        });
        let spans = [high[0] - low[0], high[1] - low[1]];
        let per_unit = [0, 1].map(|axis| INNER_PX[axis] / (1.16 * spans[axis]).max(1e-12));
        let per_unit = per_unit[0].min(per_unit[1]);
        Some(Self { middle: [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])], per_unit })
    }

    fn to_px(&self, at: [f64; 2]) -> [f64; 2] {
        let centre = [MARGINS_PX[0] + 0.5 * INNER_PX[0], MARGINS_PX[2] + 0.5 * INNER_PX[1]];
        [
            centre[0] + (at[0] - self.middle[0]) * self.per_unit,
            centre[1] - (at[1] - self.middle[1]) * self.per_unit,
        ]
    }

    /// Round values within the picture.
    fn ticks(&self, axis: usize) -> Vec<f64> {
        let half = 0.5 * INNER_PX[axis] / self.per_unit;
        // About 70 px apart.
        let raw = 70.0 / self.per_unit;
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|times| times * power);
        let step = step.into_iter().find(|step| *step >= raw).unwrap_or(raw);
        let first = ((self.middle[axis] - half) / step).ceil() as i64;
        let last = ((self.middle[axis] + half) / step).floor() as i64;
        (first..=last).take(20).map(|at| at as f64 * step).collect()
    }
}

impl Plane {
    pub fn is_empty(&self) -> bool {
        self.dots.is_empty() && self.arrows.is_empty()
    }

    pub fn markup(&self) -> Markup {
        let Some(scale) = PlaneScale::fit(self) else { return Markup::default() };
        html! {
            figure .picture {
                figcaption { strong { (self.title) } span .says { (self.caption) } }
                svg .plane viewBox={ "0 0 " (WIDTH_PX) " " (HEIGHT_PX) } role="img"
                    aria-label={ (self.title) ". " (self.caption) } {
                    @if !self.axes[0].is_empty() { (self.grid(&scale)) }
                    @if let Some((radius, words)) = &self.limit {
                        @let [x, y] = scale.to_px([0.0, 0.0]);
                        circle .limit cx=(format_px(x)) cy=(format_px(y)) r=(format_px(radius * scale.per_unit)) {}
                        @let [x, y] = scale.to_px([0.0, *radius]);
                        text .limit x=(format_px(x)) y=(format_px(y - 4.0)) text-anchor="middle" { (words) }
                    }
                    @for dot in &self.dots {
                        @let [x, y] = scale.to_px(dot.at);
                        circle .dot .(dot.role.name()) cx=(format_px(x)) cy=(format_px(y)) r=(format_px(1.5 + 5.5 * dot.size)) {}
                    }
                    @for arrow in &self.arrows { (arrow.markup(&scale)) }
                }
            }
        }
    }

    fn grid(&self, scale: &PlaneScale) -> Markup {
        let bottom = HEIGHT_PX - MARGINS_PX[3];
        html! {
            @for tick in scale.ticks(0) {
                @let [x, _] = scale.to_px([tick, 0.0]);
                line .grid x1=(format_px(x)) x2=(format_px(x)) y1=(format_px(MARGINS_PX[2])) y2=(format_px(bottom)) {}
                text x=(format_px(x)) y=(format_px(bottom + 14.0)) text-anchor="middle" { (trimmed(tick, 4)) }
            }
            @for tick in scale.ticks(1) {
                @let [_, y] = scale.to_px([0.0, tick]);
                line .grid x1=(format_px(MARGINS_PX[0])) x2=(format_px(WIDTH_PX - MARGINS_PX[1])) y1=(format_px(y)) y2=(format_px(y)) {}
                text x=(format_px(MARGINS_PX[0] - 5.0)) y=(format_px(y + 4.0)) text-anchor="end" { (trimmed(tick, 4)) }
            }
            text x=(format_px(0.5 * (MARGINS_PX[0] + WIDTH_PX - MARGINS_PX[1]))) y=(format_px(HEIGHT_PX - 6.0)) text-anchor="middle" {
                (self.axes[0])
            }
            text text-anchor="middle" transform={
                "translate(12 " (format_px(0.5 * (MARGINS_PX[2] + bottom))) ") rotate(-90)"
            } { (self.axes[1]) }
        }
    }
}

impl Arrow {
    fn markup(&self, scale: &PlaneScale) -> Markup {
        let (from, to) = (scale.to_px(self.from), scale.to_px(self.to));
        let along = [to[0] - from[0], to[1] - from[1]];
        let length = along[0].hypot(along[1]).max(1e-9);
        let unit = along.map(|part| part / length);
        let head = 7.0_f64.min(0.4 * length);
        let wing = |side: f64| {
            let x = to[0] - head * (unit[0] - side * 0.5 * unit[1]);
            let y = to[1] - head * (unit[1] + side * 0.5 * unit[0]);
            format!("{},{}", format_px(x), format_px(y))
        };
        // Labels next to the tips of overlapping arrows stay readable.
        let is_left = unit[0] < -0.3;
        let beyond = [to[0] + if is_left { -8.0 } else { 8.0 }, to[1] + 9.0 * unit[1] + 4.0];
        let anchor = if is_left { "end" } else { "start" };
        html! {
            g .(self.role.name()) {
                line .arrow x1=(format_px(from[0])) y1=(format_px(from[1])) x2=(format_px(to[0])) y2=(format_px(to[1])) {}
                polygon points={ (format_px(to[0])) "," (format_px(to[1])) " " (wing(1.0)) " " (wing(-1.0)) } {}
                @if !self.label.is_empty() {
                    text x=(format_px(beyond[0])) y=(format_px(beyond[1])) text-anchor=(anchor) { (self.label) }
                }
            }
        }
    }
}

fn format_px(at: f64) -> String {
    format!("{at:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_fits_its_picture_at_one_scale() {
        let dot = |x: f64, y: f64| Dot { at: [x, y], size: 1.0, role: SeriesRole::Amount };
        let plane = Plane {
            dots: vec![dot(-400.0, 3.0), dot(900.0, 80.0), dot(0.0, -20.0)],
            limit: Some((100.0, "limit".to_owned())),
            axes: ["x, mm", "y, mm"],
            ..Plane::default()
        };
        let scale = PlaneScale::fit(&plane).expect("a scale");
        for at in plane.dots.iter().map(|dot| dot.at).chain([[0.0, 100.0], [0.0, -100.0]]) {
            let [x, y] = scale.to_px(at);
            assert!((MARGINS_PX[0]..=WIDTH_PX - MARGINS_PX[1]).contains(&x), "{x}");
            assert!((MARGINS_PX[2]..=HEIGHT_PX - MARGINS_PX[3]).contains(&y), "{y}");
        }
        let [a, b] = [scale.to_px([0.0, 0.0]), scale.to_px([10.0, 10.0])];
        assert!(((b[0] - a[0]) - (a[1] - b[1])).abs() < 1e-9);
        assert!((2..=9).contains(&scale.ticks(0).len()), "{:?}", scale.ticks(0));
        assert!(Plane::default().markup().into_string().is_empty());
    }

    #[test]
    fn numbers_on_axes_are_short() {
        assert_eq!(
            [0.5, -0.0, 200.0, 0.25].map(|tick| trimmed(tick, 4)),
            ["0.5", "0", "200", "0.25"]
        );
    }
}
