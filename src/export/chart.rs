//! Points with their errors over a running number, as one inline SVG picture for a report.
//!
//! Takes values as they are and their names; scales the axes to round numbers. Colours are the page's own, so that
//! the picture follows light and dark.

use super::report::put;
use crate::codec::markup::escape;

/// One set of points.
pub struct Series {
    /// What it is, for the legend.
    pub name: String,
    /// Place on the horizontal axis, value, and its standard deviation (0: no bar is drawn).
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

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 260.0;
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [64.0, 28.0, 12.0, 40.0];

/// Round values across a range, four to eight of them, with their decimals.
fn ticks(low: f64, high: f64) -> (Vec<f64>, usize) {
    let span = (high - low).max(1e-12);
    let power = 10f64.powf((span / 5.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| span / s <= 7.0);
    let step = step.unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    ((first..=last).map(|k| k as f64 * step).collect(), decimals)
}

/// Lowest and highest of some values, a little apart even if they are equal.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    let air = (0.06 * (high - low)).max(1e-9 * high.abs()).max(1e-12);
    (low - air, high + air)
}

/// The chart as an SVG file of its own, on white.
pub fn picture(chart: &Chart) -> String {
    const HEAD: &str =
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\"";
    const STYLE: &str = "svg{background:#fff;font:12px sans-serif}text{fill:#555}.grid{stroke:#ddd}\
.series,.series .bar{fill:#4a6fa5;stroke:#4a6fa5}.s1,.s1 .bar{fill:#c2703d;stroke:#c2703d}.s2,.s2 .bar{fill:#5e8c4a;stroke:#5e8c4a}\
.series circle,.series path{stroke-width:1}.series text{stroke:none}";
    draw(chart, HEAD, &format!("<style>{STYLE}</style>\n"))
}

/// The chart as SVG, to stand in HTML.
pub(super) fn svg(chart: &Chart) -> String {
    draw(chart, "<svg class=\"chart\"", "")
}

fn draw(chart: &Chart, head: &str, style: &str) -> String {
    let points = || chart.series.iter().flat_map(|s| &s.points);
    let (x0, x1) = range(points().map(|p| p.0));
    let (y0, y1) = range(points().flat_map(|p| [p.1 - p.2, p.1 + p.2]));
    let [left, top, right, bottom] = MARGIN;
    let x = |v: f64| left + (v - x0) / (x1 - x0) * (WIDTH - left - right);
    let y = |v: f64| HEIGHT - bottom - (v - y0) / (y1 - y0) * (HEIGHT - top - bottom);
    let mut out = format!(
        "{head} viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n{style}",
        escape(&chart.caption)
    );
    let (values, decimals) = ticks(y0, y1);
    for v in values {
        let at = y(v);
        put(&mut out, format_args!("<path class=\"grid\" d=\"M{left} {at:.1}H{}\"/>", WIDTH - right));
        put(
            &mut out,
            format_args!(
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{v:.decimals$}</text>\n",
                left - 8.0,
                at + 4.0
            ),
        );
    }
    let (values, decimals) = ticks(x0, x1);
    for v in values {
        put(
            &mut out,
            format_args!(
                "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{v:.decimals$}</text>\n",
                x(v),
                HEIGHT - bottom + 16.0
            ),
        );
    }
    put(
        &mut out,
        format_args!(
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\n<text x=\"4\" y=\"14\">{}</text>\n",
            WIDTH - right,
            HEIGHT - 6.0,
            escape(&chart.across),
            escape(&chart.up)
        ),
    );
    let mut legend = WIDTH - right;
    for (k, series) in chart.series.iter().enumerate() {
        let shape = |px: f64, py: f64| match k {
            0 => format!("<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"3\"/>"),
            1 => format!("<path d=\"M{:.1} {py:.1}l3.4 -3.4 3.4 3.4 -3.4 3.4z\"/>", px - 3.4),
            _ => format!("<path d=\"M{:.1} {:.1}h5v5h-5z\"/>", px - 2.5, py - 2.5),
        };
        put(&mut out, format_args!("<g class=\"series s{k}\">\n"));
        for &(px, py, error) in &series.points {
            if error > 0.0 {
                put(
                    &mut out,
                    format_args!(
                        "<path class=\"bar\" d=\"M{:.1} {:.1}V{:.1}\"/>",
                        x(px),
                        y(py - error),
                        y(py + error)
                    ),
                );
            }
            put(&mut out, format_args!("{}\n", shape(x(px), y(py))));
        }
        if chart.series.len() > 1 {
            put(
                &mut out,
                format_args!(
                    "<text x=\"{legend}\" y=\"14\" text-anchor=\"end\">{}</text>",
                    escape(&series.name)
                ),
            );
            legend -= 7.2 * series.name.chars().count() as f64 + 10.0;
            put(&mut out, format_args!("{}\n", shape(legend, 10.0)));
            legend -= 20.0;
        }
        put(&mut out, format_args!("</g>\n"));
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(ticks(0.0, 10.0), (vec![0.0, 2.0, 4.0, 6.0, 8.0, 10.0], 0));
        let (values, decimals) = ticks(0.9941, 1.0062);
        assert_eq!(decimals, 3);
        assert!((4..=8).contains(&values.len()), "{values:?}");
        assert!(values.iter().all(|v| (v * 500.0 - (v * 500.0).round()).abs() < 1e-6), "{values:?}");
    }

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
            assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            for cx in svg.split("cx=\"").skip(1) {
                let value: f64 = cx.split('"').next().unwrap().parse().unwrap();
                assert!((MARGIN[0]..WIDTH).contains(&value), "{svg}");
            }
        }
    }
}
