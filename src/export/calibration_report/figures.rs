//! Figures of calibrations that are no charts: numbers over the frame, and colours beside each other.

use crate::codec::markup::escape;
use crate::export::report::put;

/// Numbers over the frame, each written in its place; tinted by size, so that patterns are seen.
pub struct Map {
    /// What they are, with the unit.
    pub caption: String,
    /// Row by row from the top; absent where nothing was measured.
    pub rows: Vec<Vec<Option<f64>>>,
    /// Digits behind the point.
    pub digits: usize,
    /// Size from which the tint is full.
    pub full: f64,
}

/// Colours of a chart, measured and meant.
pub struct Swatches {
    /// What they are.
    pub caption: String,
    /// Patches a row.
    pub columns: usize,
    /// Row by row.
    pub patches: Vec<Patch>,
}

/// One of them.
pub struct Patch {
    /// Its name.
    pub name: String,
    /// What was measured, sRGB.
    pub measured: [u8; 3],
    /// What it should be, sRGB.
    pub meant: [u8; 3],
    /// What is written under it.
    pub words: String,
}

const WIDTH: usize = 760;

/// Strongest tint: light enough to read on, on either ground.
const TINT: f64 = 0.45;

pub(super) fn map(map: &Map) -> String {
    let columns = map.rows.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let (width, height) = (WIDTH / columns, 26);
    let mut out = begun("map", (width * columns, height * map.rows.len()), &map.caption);
    for (r, row) in map.rows.iter().enumerate() {
        for (c, value) in row.iter().enumerate() {
            let (x, y) = (c * width, r * height);
            let (words, tint, colour) = match value {
                Some(v) => {
                    let tint = TINT * (v.abs() / map.full.max(f64::MIN_POSITIVE)).min(1.0);
                    let colour = if *v < 0.0 { "#4a6fa5" } else { "#c2703d" };
                    // A number so small that only its sign is left is a plain nought.
                    let words = format!("{v:+.*}", map.digits);
                    let nought = words.trim_start_matches(['+', '-']).chars().all(|c| "0.".contains(c));
                    (if nought { words[1..].to_owned() } else { words }, tint, colour)
                }
                None => ("-".to_owned(), 0.0, "none"),
            };
            put(
                &mut out,
                format_args!(
                    "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"{colour}\" fill-opacity=\"{tint:.2}\"/>\
                     <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{words}</text>\n",
                    x + width / 2,
                    y + 17
                ),
            );
        }
    }
    out.push_str("</svg>\n");
    out
}

pub(super) fn swatches(swatches: &Swatches) -> String {
    let columns = swatches.columns.max(1);
    let (width, height) = (WIDTH / columns, 84);
    let rows = swatches.patches.len().div_ceil(columns);
    let mut out = begun("swatches", (width * columns, height * rows), &swatches.caption);
    for (k, patch) in swatches.patches.iter().enumerate() {
        let (x, y) = (k % columns * width, k / columns * height);
        let half = (width - 8) / 2;
        let mut rect = |x: usize, [r, g, b]: [u8; 3]| {
            put(
                &mut out,
                format_args!(
                    "<rect x=\"{x}\" y=\"{y}\" width=\"{half}\" height=\"48\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>"
                ),
            );
        };
        rect(x, patch.measured);
        rect(x + half, patch.meant);
        put(
            &mut out,
            format_args!(
                "<text class=\"name\" x=\"{x}\" y=\"{}\">{}</text><text x=\"{x}\" y=\"{}\">{}</text>\n",
                y + 61,
                escape(&patch.name),
                y + 75,
                escape(&patch.words)
            ),
        );
    }
    out.push_str("</svg>\n");
    out
}

fn begun(class: &str, (width, height): (usize, usize), caption: &str) -> String {
    let caption = escape(caption);
    format!(
        "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{caption}\">\n"
    )
}
