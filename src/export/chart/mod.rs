//! Points with their 95 % intervals over a running number, as one inline SVG picture for a report.
//!
//! Takes values as they are and their names; scales the axes to round numbers. Colours are the page's own, so that
//! the picture follows light and dark.

mod axis;

use super::report::put;
use crate::codec::markup::escape;
use axis::Axis;

/// One set of points.
pub struct Series {
    /// What it is, for the legend.
    pub name: String,
    /// Place on the horizontal axis, value, and half of its 95 % interval (0: no bar is drawn).
    pub points: Vec<(f64, f64, f64)>,
}

/// A chart.
pub struct Chart {
    /// What it shows, for those who cannot see it too.
    pub caption: String,
    /// Name of the horizontal axis.
    pub across: String,
    /// Name of the vertical axis, with its unit.
    pub up: String,
    /// At most three can be told apart.
    pub series: Vec<Series>,
}

/// A chart with more to it: curves behind the points, joined points, axes of which either may be logarithmic.
pub struct Plot {
    /// The points.
    pub chart: Chart,
    /// Whether the horizontal and the vertical axis are logarithmic. What is not above 0 is then not drawn.
    pub logarithmic: [bool; 2],
    /// Whether a thin line joins the points of a series.
    pub joined: bool,
    /// Curves, dashed each in its own way.
    pub curves: Vec<Curve>,
}

/// A curve through points that are not shown themselves.
pub struct Curve {
    /// What it is, for the legend.
    pub name: String,
    /// Places on both axes.
    pub points: Vec<(f64, f64)>,
}

impl From<Chart> for Plot {
    fn from(chart: Chart) -> Self {
        Self { chart, logarithmic: [false; 2], joined: false, curves: vec![] }
    }
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 260.0;
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [64.0, 28.0, 12.0, 40.0];

/// The chart as an SVG file of its own, on white.
pub fn picture(chart: &Chart) -> String {
    const HEAD: &str =
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\"";
    let style = format!(
        "<style>svg{{background:#fff;font:12px sans-serif}}text{{fill:#555}}.grid{{stroke:#ddd}}.zero{{stroke:#999}}{INK}</style>\n"
    );
    Drawing { chart, logarithmic: [false; 2], joined: false, curves: &[] }.svg(HEAD, &style)
}

/// A chart as SVG, to stand in HTML.
pub(super) fn svg(chart: &Chart) -> String {
    Drawing { chart, logarithmic: [false; 2], joined: false, curves: &[] }.svg(HTML_HEAD, "")
}

/// A plot as SVG, to stand in HTML.
pub(super) fn plot_svg(plot: &Plot) -> String {
    let Plot { chart, logarithmic, joined, curves } = plot;
    Drawing { chart, logarithmic: *logarithmic, joined: *joined, curves }.svg(HTML_HEAD, "")
}

const HTML_HEAD: &str = "<svg class=\"chart\"";

/// Colours of series and curves. Those named after a colour wear it, whatever their place.
pub(super) const INK: &str = ".series,.series .bar{fill:#4a6fa5;stroke:#4a6fa5}.s1,.s1 .bar{fill:#c2703d;stroke:#c2703d}\
.s2,.s2 .bar{fill:#5e8c4a;stroke:#5e8c4a}.red,.red .bar{fill:#c0504a;stroke:#c0504a}.series text{stroke:none}\
.joint{fill:none;stroke-width:1;opacity:.6}.curve{fill:none;stroke:#888;stroke-width:1.4}";

/// Dashes of curves and joints by their number.
const DASHES: [&str; 3] = ["", "6 3", "2 3"];

struct Drawing<'a> {
    chart: &'a Chart,
    logarithmic: [bool; 2],
    joined: bool,
    curves: &'a [Curve],
}

impl Drawing<'_> {
    fn svg(&self, head: &str, style: &str) -> String {
        let Self { chart, curves, .. } = self;
        let [left, top, right, bottom] = MARGIN;
        let (right, bottom) = (WIDTH - right, HEIGHT - bottom);
        let points = || chart.series.iter().flat_map(|s| &s.points);
        let curve = || curves.iter().flat_map(|c| &c.points);
        let across = points().map(|p| p.0).chain(curve().map(|p| p.0));
        // A bar may reach below what a logarithmic axis can show; it must not stretch it.
        let lower = |p: &(f64, f64, f64)| if self.logarithmic[1] { p.1 } else { p.1 - p.2 };
        let up = points().flat_map(|p| [lower(p), p.1 + p.2]).chain(curve().map(|p| p.1));
        let x = Axis::over(across, self.logarithmic[0], [left, right]);
        let y = Axis::over(up, self.logarithmic[1], [bottom, top]);
        let barred = points().any(|p| p.2 > 0.0);
        let caption = escape(&chart.caption);
        let mut out = format!(
            "{head} viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{caption}\">\n{style}"
        );
        for (value, word) in y.ticks() {
            let Some(at) = y.at(value) else { continue };
            let class = if value == 0.0 { "grid zero" } else { "grid" };
            put(&mut out, format_args!("<path class=\"{class}\" d=\"M{left} {at:.1}H{right}\"/>"));
            text(&mut out, (left - 8.0, at + 4.0), "end", &word);
        }
        for (value, word) in x.ticks() {
            let Some(at) = x.at(value) else { continue };
            text(&mut out, (at, bottom + 16.0), "middle", &word);
        }
        text(&mut out, (right, HEIGHT - 6.0), "end", &chart.across);
        text(&mut out, (4.0, 14.0), "start", &chart.up);
        if barred {
            text(&mut out, (4.0, HEIGHT - 6.0), "start", "bars: 95 % intervals");
        }
        let mut legend = right;
        for (k, curve) in curves.iter().enumerate() {
            let dashes = DASHES[k % DASHES.len()];
            let path = path(curve.points.iter().filter_map(|p| Some((x.at(p.0)?, y.at(p.1)?))));
            put(
                &mut out,
                format_args!("<path class=\"curve\" stroke-dasharray=\"{dashes}\" d=\"{path}\"/>\n"),
            );
            name(&mut out, &mut legend, &curve.name);
            put(
                &mut out,
                format_args!(
                    "<path class=\"curve\" stroke-dasharray=\"{dashes}\" d=\"M{:.1} 10h18\"/>\n",
                    legend - 18.0
                ),
            );
            legend -= 34.0;
        }
        for (k, series) in chart.series.iter().enumerate() {
            put(&mut out, format_args!("<g class=\"series {}\">\n", class(&series.name, k)));
            if self.joined {
                let path = path(series.points.iter().filter_map(|p| Some((x.at(p.0)?, y.at(p.1)?))));
                let dashes = DASHES[k % DASHES.len()];
                put(
                    &mut out,
                    format_args!("<path class=\"joint\" stroke-dasharray=\"{dashes}\" d=\"{path}\"/>\n"),
                );
            }
            for &(px, py, error) in &series.points {
                let (Some(at_x), Some(at_y)) = (x.at(px), y.at(py)) else { continue };
                if error > 0.0
                    && let (Some(low), Some(high)) = (y.at_or_low(py - error), y.at(py + error))
                {
                    put(&mut out, format_args!("<path class=\"bar\" d=\"M{at_x:.1} {low:.1}V{high:.1}\"/>"));
                }
                put(&mut out, format_args!("{}\n", marker(k, at_x, at_y)));
            }
            if chart.series.len() + curves.len() > 1 {
                name(&mut out, &mut legend, &series.name);
                put(&mut out, format_args!("{}\n", marker(k, legend - 4.0, 10.0)));
                legend -= 24.0;
            }
            put(&mut out, format_args!("</g>\n"));
        }
        out.push_str("</svg>\n");
        out
    }
}

fn text(out: &mut String, (x, y): (f64, f64), anchor: &str, words: &str) {
    put(
        out,
        format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>\n", escape(words)),
    );
}

/// A name in the legend, which grows to the left.
fn name(out: &mut String, legend: &mut f64, words: &str) {
    text(out, (*legend, 14.0), "end", words);
    *legend -= 6.6 * words.chars().count() as f64 + 6.0;
}

fn class(name: &str, number: usize) -> &'static str {
    match (name, number) {
        ("red", _) => "red",
        ("green", _) => "s2",
        ("blue", _) => "s0",
        (_, 1) => "s1",
        (_, 2) => "s2",
        _ => "s0",
    }
}

/// A shape of its own for each series, so that they can be told apart in grey.
fn marker(number: usize, x: f64, y: f64) -> String {
    match number {
        0 => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>"),
        1 => format!("<path d=\"M{:.1} {y:.1}l3.4 -3.4 3.4 3.4 -3.4 3.4z\"/>", x - 3.4),
        _ => format!("<path d=\"M{:.1} {:.1}h5v5h-5z\"/>", x - 2.5, y - 2.5),
    }
}

fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    let mut path = String::new();
    for (k, (x, y)) in points.enumerate() {
        put(&mut path, format_args!("{}{x:.1} {y:.1}", if k == 0 { 'M' } else { 'L' }));
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_inside_the_picture_and_one_value_alone_does_not_break_it() {
        for points in [vec![(1.0, 5.0, 0.0)], vec![(1.0, 0.99, 0.01), (40.0, 1.02, 0.002)], vec![]] {
            let count = points.len();
            let chart = Chart {
                caption: "a < b".into(),
                across: "pair".into(),
                up: "gain".into(),
                series: vec![Series { name: "only".into(), points }],
            };
            let svg = svg(&chart);
            assert_eq!(svg.matches("<circle").count(), count);
            assert_eq!(svg.contains("bars: 95 % intervals"), svg.contains("class=\"bar\""), "{svg}");
            assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            for cx in svg.split("cx=\"").skip(1) {
                let value: f64 = cx.split('"').next().unwrap().parse().unwrap();
                assert!((MARGIN[0]..WIDTH).contains(&value), "{svg}");
            }
        }
    }

    #[test]
    fn a_plot_draws_its_curves_and_leaves_out_what_a_logarithm_cannot_show() {
        let series =
            |name: &str| Series { name: name.into(), points: vec![(0.0, 1.0, 0.1), (10.0, 5.0, 9.0)] };
        let plot = Plot {
            chart: Chart {
                caption: "c".into(),
                across: "x".into(),
                up: "y".into(),
                series: vec![series("red"), series("other")],
            },
            logarithmic: [true, true],
            joined: true,
            curves: vec![Curve { name: "law".into(), points: vec![(0.0, 0.0), (1.0, 1.0), (100.0, 100.0)] }],
        };
        let svg = plot_svg(&plot);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        // One point of the first series, and its mark in the legend.
        assert_eq!(svg.matches("<circle").count(), 2, "{svg}");
        assert_eq!(svg.matches("class=\"curve\"").count(), 2);
        assert_eq!(svg.matches("class=\"joint\"").count(), 2);
        assert!(svg.contains("series red") && svg.contains(">law<"));
    }
}
