//! The report of a session's calibrations: a page that needs nothing else, on a screen and on A4 paper.
//!
//! Every row of a table names the shots that its figures come from, by the labels of the shots' own table, so that the
//! chain holds on paper too; on a screen they are links. No colour means anything that words or shapes do not say.

mod figures;
mod style;

pub use figures::{Map, Patch, Swatches};

use super::chart::{self, Plot};
use super::report::{self, Block, base64, begun, lay_out, put};
use crate::codec::markup::escape;
use style::STYLE;

/// The whole page.
pub struct CalibrationReport {
    /// Heading.
    pub title: String,
    /// The line under it.
    pub subtitle: String,
    /// Session and rig: names and values.
    pub facts: Vec<(String, String)>,
    /// Every calibration there can be, measured or not.
    pub summary: Vec<Line>,
    /// Those measured.
    pub parts: Vec<Part>,
}

/// What a calibration is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// It may be relied on.
    Good,
    /// It must not be.
    Bad,
    /// It was not made.
    Missing,
}

impl Mark {
    fn words(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Bad => "do not rely on it",
            Self::Missing => "not measured",
        }
    }

    fn class(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Bad => "bad",
            Self::Missing => "missing",
        }
    }
}

/// A calibration in the summary.
pub struct Line {
    /// What it measures.
    pub name: &'static str,
    /// The part that tells of it.
    pub part: Option<&'static str>,
    /// What it is worth.
    pub mark: Mark,
    /// Verdict, or what stands in for it.
    pub words: String,
    /// Of what it is true.
    pub valid_for: String,
    /// When it was measured.
    pub measured: String,
}

/// One calibration.
pub struct Part {
    /// Its name in links.
    pub id: &'static str,
    /// Letter of its shots' labels.
    pub letter: char,
    /// Heading.
    pub heading: &'static str,
    /// What it is worth.
    pub mark: Mark,
    /// Verdict in words, the most important sentence first.
    pub sentences: Vec<String>,
    /// What else is to be known: names and values.
    pub facts: Vec<(String, String)>,
    /// Figures and tables, in order.
    pub pieces: Vec<Piece>,
    /// Every shot that was given.
    pub shots: Vec<ShotRow>,
}

/// Something of a calibration to show.
pub enum Piece {
    /// What every report has.
    Block(Block),
    /// Points and curves.
    Plot(Plot),
    /// Numbers over the frame.
    Map(Map),
    /// Colours beside each other.
    Swatches(Swatches),
    /// Figures.
    Table(Table),
    /// A picture file, as it is.
    Picture {
        /// `image/png` or `image/svg+xml`.
        kind: &'static str,
        /// The file.
        bytes: Vec<u8>,
        /// What it shows.
        caption: String,
    },
}

/// Figures, each row with the shots it comes from.
pub struct Table {
    /// What they are.
    pub caption: String,
    /// Headings, with units.
    pub head: Vec<String>,
    /// Rows.
    pub rows: Vec<Row>,
}

/// A row of figures.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// As many as the table has headings.
    pub cells: Vec<String>,
    /// Places of the shots among the part's, from 0; ascending.
    pub from: Vec<usize>,
}

/// A shot.
pub struct ShotRow {
    /// Small JPEG; absent if the file cannot be shown.
    pub thumbnail: Option<Vec<u8>>,
    /// Path in the session.
    pub file: String,
    /// BLAKE3, hexadecimal.
    pub blake3: String,
    /// Shutter, aperture, ISO.
    pub exposure: String,
    /// What it was used for, or why it was not.
    pub role: String,
    /// Whether it was used.
    pub used: bool,
}

/// The page as HTML that is XML too.
pub fn html(report: &CalibrationReport) -> String {
    let mut out = begun(&report.title, &report.subtitle, STYLE);
    lay_out(&mut out, &Block::Facts(report.facts.clone()));
    summary(&mut out, &report.summary);
    report.parts.iter().for_each(|p| part(&mut out, p));
    out.push_str(report::END);
    out
}

/// Escaped text whose per cent signs stay with their numbers.
fn text(words: &str) -> String {
    escape(words).replace(" %", "\u{a0}%")
}

fn summary(out: &mut String, lines: &[Line]) {
    out.push_str("<section>\n<h2>Summary</h2>\n<div class=\"wide\"><table class=\"summary\">\n<thead><tr>");
    out.push_str(
        "<th>Calibration</th><th>Verdict</th><th>True of</th><th>Measured</th></tr></thead>\n<tbody>\n",
    );
    for line in lines {
        let name = escape(line.name);
        let name = match line.part {
            Some(id) => format!("<a href=\"#{id}\">{name}</a>"),
            None => name,
        };
        put(
            out,
            format_args!(
                "<tr class=\"{}\"><td>{name}</td><td><b>{}</b>: {}</td><td>{}</td><td class=\"short\">{}</td></tr>\n",
                line.mark.class(),
                line.mark.words(),
                text(&line.words),
                escape(&line.valid_for),
                escape(&line.measured)
            ),
        );
    }
    out.push_str("</tbody>\n</table></div>\n</section>\n");
}

fn part(out: &mut String, part: &Part) {
    let (id, mark) = (part.id, part.mark);
    put(out, format_args!("<section id=\"{id}\">\n<h2>{}</h2>\n", escape(part.heading)));
    put(out, format_args!("<p class=\"verdict {}\"><b>{}</b></p>\n", mark.class(), mark.words()));
    if !part.sentences.is_empty() {
        out.push_str("<ul>\n");
        part.sentences.iter().for_each(|s| put(out, format_args!("<li>{}</li>\n", text(s))));
        out.push_str("</ul>\n");
    }
    lay_out(out, &Block::Facts(part.facts.clone()));
    part.pieces.iter().for_each(|p| piece(out, p, part.letter));
    shots(out, part);
    out.push_str("</section>\n");
}

fn piece(out: &mut String, piece: &Piece, letter: char) {
    match piece {
        Piece::Block(block) => lay_out(out, block),
        Piece::Plot(plot) => figure(out, &chart::plot_svg(plot), &plot.chart.caption),
        Piece::Map(map) => figure(out, &figures::map(map), &map.caption),
        Piece::Swatches(swatches) => figure(out, &figures::swatches(swatches), &swatches.caption),
        Piece::Table(table) => figures_table(out, table, letter),
        Piece::Picture { kind, bytes, caption } => {
            let alt = escape(caption);
            figure(
                out,
                &format!("<img alt=\"{alt}\" src=\"data:{kind};base64,{}\"/>", base64(bytes)),
                caption,
            );
        }
    }
}

/// A drawing that a narrow screen scrolls rather than shrinks until nobody can read it.
fn figure(out: &mut String, drawing: &str, caption: &str) {
    put(
        out,
        format_args!(
            "<figure><div class=\"wide\">{drawing}</div><figcaption>{}</figcaption></figure>\n",
            text(caption)
        ),
    );
}

/// Rows above which a table may be cut between two pages.
const LONG: usize = 24;

/// Begins a table under its caption, which may be wider than the table.
fn begin_table(out: &mut String, caption: &str, rows: usize, class: &str) {
    let long = if rows > LONG { " long" } else { "" };
    let caption = text(caption);
    put(
        out,
        format_args!("<div class=\"wide{long}\"><h3>{caption}</h3>\n<table class=\"{class}\">\n<thead><tr>"),
    );
}

const END_OF_TABLE: &str = "</tbody>\n</table></div>\n";

/// Characters up to which a cell is not broken into lines.
const SHORT: usize = 24;

fn figures_table(out: &mut String, table: &Table, letter: char) {
    let class = |k: usize| {
        let mut cells = table.rows.iter().filter_map(|row| row.cells.get(k));
        if k > 0 && cells.clone().all(|cell| is_figure(cell)) {
            " class=\"n\""
        } else if cells.all(|cell| cell.chars().count() <= SHORT) {
            " class=\"short\""
        } else {
            " class=\"words\""
        }
    };
    let classes: Vec<&str> = (0..table.head.len()).map(class).collect();
    let from = table.rows.iter().any(|row| !row.from.is_empty());
    begin_table(out, &table.caption, table.rows.len(), "figures");
    for (cell, class) in table.head.iter().zip(&classes) {
        put(out, format_args!("<th{class}>{}</th>", text(cell)));
    }
    out.push_str(if from {
        "<th>From shots</th></tr></thead>\n<tbody>\n"
    } else {
        "</tr></thead>\n<tbody>\n"
    });
    for row in &table.rows {
        out.push_str("<tr>");
        for (cell, class) in row.cells.iter().zip(&classes) {
            put(out, format_args!("<td{class}>{}</td>", text(cell)));
        }
        if from {
            put(out, format_args!("<td class=\"from\">{}</td>", links(&row.from, letter)));
        }
        out.push_str("</tr>\n");
    }
    out.push_str(END_OF_TABLE);
}

/// Whether a cell holds a number, or a dash in place of one.
fn is_figure(cell: &str) -> bool {
    let mut letters = cell.trim_start_matches(['+', '-', '\u{b1}', '\u{2212}']).chars();
    letters.next().is_none_or(|first| first.is_ascii_digit())
}

/// Links to shots, runs of three or more as first and last.
fn links(from: &[usize], letter: char) -> String {
    let link = |shot: usize| format!("<a href=\"#{letter}{0}\">{letter}{0}</a>", shot + 1);
    let mut runs: Vec<(usize, usize)> = vec![];
    for &shot in from {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == shot => *last = shot,
            _ => runs.push((shot, shot)),
        }
    }
    let words = runs.into_iter().map(|(first, last)| match last - first {
        0 => link(first),
        1 => format!("{}, {}", link(first), link(last)),
        _ => format!("{} to {}", link(first), link(last)),
    });
    words.collect::<Vec<_>>().join(", ")
}

fn shots(out: &mut String, part: &Part) {
    if part.shots.is_empty() {
        return;
    }
    begin_table(out, "Shots", part.shots.len(), "shots");
    out.push_str("<th></th><th></th><th>File in the session</th><th>BLAKE3</th>");
    out.push_str("<th>Exposure</th><th>Use</th></tr></thead>\n<tbody>\n");
    for (k, shot) in part.shots.iter().enumerate() {
        let label = format!("{}{}", part.letter, k + 1);
        let picture = match &shot.thumbnail {
            Some(jpeg) => {
                format!(
                    "<img class=\"thumb\" alt=\"shot {label}\" src=\"data:image/jpeg;base64,{}\"/>",
                    base64(jpeg)
                )
            }
            None => "-".to_owned(),
        };
        let short = shot.blake3.get(..12).unwrap_or(&shot.blake3);
        let class = if shot.used { "used" } else { "out" };
        let file = if shot.file.chars().count() <= 2 * SHORT { "short" } else { "file" };
        put(
            out,
            format_args!(
                "<tr id=\"{label}\" class=\"{class}\"><td><b>{label}</b></td><td>{picture}</td><td class=\"{file}\">{}</td>\
                 <td><code title=\"{}\">{}</code></td><td class=\"short\">{}</td><td class=\"words\">{}</td></tr>\n",
                escape(&shot.file),
                escape(&shot.blake3),
                escape(short),
                escape(&shot.exposure),
                text(&shot.role)
            ),
        );
    }
    out.push_str(END_OF_TABLE);
}

#[cfg(test)]
mod tests;
