//! A report as one HTML file that needs nothing else: no network, no script, light and dark.
//!
//! Takes headings, sentences, tables and pictures as they are to be shown and lays them out; what they say is the
//! caller's business. All text is escaped. Pictures go in as PNG bytes and are embedded as data URLs (RFC 2397,
//! RFC 4648).

use super::chart::{self, Chart, INK};
use crate::codec::markup::escape;
use std::fmt::Write as _;

/// A whole report.
pub struct Report<'a> {
    /// Heading of the page.
    pub title: &'a str,
    /// The line under it.
    pub subtitle: &'a str,
    /// What follows, in order.
    pub sections: Vec<Section>,
}

/// A part with a heading.
pub struct Section {
    /// Heading.
    pub heading: &'static str,
    /// What it shows.
    pub blocks: Vec<Block>,
}

/// Something to show.
pub enum Block {
    /// A paragraph.
    Text(String),
    /// Names and their values, one a line.
    Facts(Vec<(String, String)>),
    /// Columns under headings; figures stand right, first columns left.
    Table {
        /// Headings.
        head: Vec<&'static str>,
        /// Rows as long as `head`.
        rows: Vec<Vec<String>>,
    },
    /// Pictures side by side.
    Pictures(Vec<Picture>),
    /// Points over a running number.
    Chart(Chart),
}

/// A picture with its caption.
pub struct Picture {
    /// PNG file.
    pub png: Vec<u8>,
    /// What it shows, for those who cannot see it too.
    pub caption: String,
    /// Meaning of its colours, where they stand for numbers.
    pub scale: Option<Scale>,
}

/// A colour scale.
pub struct Scale {
    /// sRGB colours at equal steps from the lowest to the highest value.
    pub colours: Vec<[u8; 3]>,
    /// Lowest value.
    pub low: String,
    /// Highest value.
    pub high: String,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--ground:#fbfaf8;--text:#23221f;--dim:#6b6860;--line:#dedbd4}\
@media(prefers-color-scheme:dark){:root{--ground:#1b1b1b;--text:#dcdcdc;--dim:#a3a3a3;--line:#3b3b3b}}\
*{box-sizing:border-box}\
body{margin:0;background:var(--ground);color:var(--text);\
font:17px/1.55 system-ui,-apple-system,'Segoe UI','Noto Sans',sans-serif;font-variant-numeric:tabular-nums}\
main{max-width:62rem;margin:0 auto;padding:3rem 1.5rem 5rem}\
h1{font-size:1.9rem;font-weight:600;line-height:1.2;margin:0;overflow-wrap:anywhere}\
h1+p{color:var(--dim);margin:.4rem 0 0}\
h2{font-size:1.05rem;font-weight:600;margin:0 0 .8rem}\
section{margin-top:2.4rem;padding-top:1.4rem;border-top:1px solid var(--line)}\
section>p{max-width:42rem;margin:0 0 1rem}\
dl{display:grid;grid-template-columns:minmax(9rem,max-content) 1fr;gap:.25rem 1.6rem;margin:0 0 1rem}\
dt{color:var(--dim)}dd{margin:0;overflow-wrap:anywhere}\
.wide{overflow-x:auto;margin:0 0 1rem}\
table{border-collapse:collapse;font-size:.95em}\
th{font-weight:400;color:var(--dim);text-align:left}\
th,td{padding:.25rem 1.6rem .25rem 0;vertical-align:baseline}\
tr+tr td,thead+tbody td{border-top:1px solid var(--line)}\
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(15rem,1fr));gap:1.4rem}\
figure{margin:0}figcaption{color:var(--dim);font-size:.88em;line-height:1.45;margin-top:.5rem}\
img{display:block;width:100%;height:auto;border-radius:4px}\
.scale{display:flex;align-items:center;gap:.6rem;margin-top:.5rem;font-size:.88em;color:var(--dim)}\
.scale i{flex:1;height:.5rem;border-radius:2px}\
.chart{display:block;width:100%;height:auto;font-size:12px}.chart text{fill:var(--dim)}.chart .grid{stroke:var(--line)}\
.chart .zero{stroke:var(--dim)}\
@media(max-width:36rem){main{padding:2rem 1.1rem 3rem}dl{grid-template-columns:1fr;gap:0}dd{margin-bottom:.5rem}}\
@media print{section{break-inside:avoid}main{padding:0}}";

/// The report as HTML.
pub fn html(report: &Report<'_>) -> String {
    let mut out = begun(report.title, report.subtitle, "");
    for section in &report.sections {
        put(&mut out, format_args!("<section>\n<h2>{}</h2>\n", escape(section.heading)));
        section.blocks.iter().for_each(|block| lay_out(&mut out, block));
        out.push_str("</section>\n");
    }
    out.push_str(END);
    out
}

/// A page up to the line under its heading; [`END`] ends it. It is XML too, so that any reader of either can check it.
pub(super) fn begun(title: &str, subtitle: &str, more_style: &str) -> String {
    let mut out = String::new();
    let title = escape(title);
    out.push_str("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n");
    out.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n");
    put(&mut out, format_args!("<title>{title}</title>\n<style>{STYLE}{INK}{more_style}</style>\n"));
    put(&mut out, format_args!("</head>\n<body>\n<main>\n<h1>{title}</h1>\n<p>{}</p>\n", escape(subtitle)));
    out
}

/// What ends a page.
pub(super) const END: &str = "</main>\n</body>\n</html>\n";

/// Writing to a string cannot fail.
pub(super) fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    let _ = out.write_fmt(text);
}

pub(super) fn lay_out(out: &mut String, block: &Block) {
    match block {
        Block::Text(text) => put(out, format_args!("<p>{}</p>\n", escape(text))),
        Block::Facts(facts) => {
            out.push_str("<dl>\n");
            for (name, value) in facts {
                put(out, format_args!("<dt>{}</dt><dd>{}</dd>\n", escape(name), escape(value)));
            }
            out.push_str("</dl>\n");
        }
        Block::Table { head, rows } => {
            out.push_str("<div class=\"wide\"><table>\n<thead><tr>");
            for cell in head {
                put(out, format_args!("<th>{}</th>", escape(cell)));
            }
            out.push_str("</tr></thead>\n<tbody>\n");
            for row in rows {
                out.push_str("<tr>");
                for cell in row {
                    put(out, format_args!("<td>{}</td>", escape(cell)));
                }
                out.push_str("</tr>\n");
            }
            out.push_str("</tbody>\n</table></div>\n");
        }
        Block::Pictures(pictures) => {
            out.push_str("<div class=\"pictures\">\n");
            for picture in pictures {
                figure(out, picture);
            }
            out.push_str("</div>\n");
        }
        Block::Chart(chart) => {
            let caption = escape(&chart.caption);
            put(
                out,
                format_args!("<figure>{}<figcaption>{caption}</figcaption></figure>\n", chart::svg(chart)),
            );
        }
    }
}

fn figure(out: &mut String, picture: &Picture) {
    let caption = escape(&picture.caption);
    let data = base64(&picture.png);
    put(out, format_args!("<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"/>\n"));
    if let Some(scale) = &picture.scale {
        let colours: Vec<String> =
            scale.colours.iter().map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect();
        put(
            out,
            format_args!(
                "<div class=\"scale\">{}<i style=\"background:linear-gradient(90deg,{})\"></i>{}</div>\n",
                escape(&scale.low),
                colours.join(","),
                escape(&scale.high)
            ),
        );
    }
    put(out, format_args!("<figcaption>{caption}</figcaption></figure>\n"));
}

/// RFC 4648, section 4, with padding.
pub(super) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for place in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * place)) as usize & 63];
            out.push(if place > group.len() { '=' } else { char::from(digit) });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_gives_the_standards_own_examples() {
        let examples = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (text, code) in examples {
            assert_eq!(base64(text.as_bytes()), code);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    fn hostile() -> String {
        let evil = "\"><script>alert('x')</script>&\u{7}";
        html(&Report {
            title: evil,
            subtitle: evil,
            sections: vec![Section {
                heading: "Everything",
                blocks: vec![
                    Block::Text(evil.into()),
                    Block::Facts(vec![(evil.into(), evil.into())]),
                    Block::Table { head: vec!["name", "why"], rows: vec![vec![evil.into(), "b".into()]] },
                    Block::Pictures(vec![Picture {
                        png: vec![1, 2, 3, 4],
                        caption: evil.into(),
                        scale: Some(Scale {
                            colours: vec![[0, 0, 0], [255, 128, 0]],
                            low: evil.into(),
                            high: "1".into(),
                        }),
                    }]),
                ],
            }],
        })
    }

    /// Names of the elements; fails where a tag is not closed by its own kind.
    fn elements(html: &str) -> Vec<String> {
        const VOID: [&str; 3] = ["meta", "img", "!DOCTYPE"];
        let (mut open, mut all): (Vec<String>, Vec<String>) = (vec![], vec![]);
        for tag in html.split('<').skip(1) {
            let (inside, _) = tag.split_once('>').expect("every tag ends");
            let name = inside.split_whitespace().next().unwrap();
            if let Some(closed) = name.strip_prefix('/') {
                assert_eq!(open.pop().as_deref(), Some(closed));
            } else {
                all.push(name.to_owned());
                if !VOID.contains(&name) {
                    open.push(name.to_owned());
                }
            }
        }
        assert!(open.is_empty(), "never closed: {open:?}");
        all
    }

    #[test]
    fn hostile_text_is_shown_and_never_run() {
        let html = hostile();
        let elements = elements(&html);
        assert!(!elements.iter().any(|e| e == "script"), "{elements:?}");
        assert_eq!(html.matches("&lt;script&gt;").count(), 10, "{html}");
        assert!(!html.contains('\u{7}'));
    }

    #[test]
    fn every_block_is_laid_out_and_nothing_is_loaded_from_elsewhere() {
        let html = hostile();
        let elements = elements(&html);
        for name in ["title", "h1", "h2", "p", "dl", "dt", "dd", "table", "td", "figure", "img", "figcaption"]
        {
            assert!(elements.iter().any(|e| e == name), "no {name}");
        }
        assert!(html.contains("data:image/png;base64,AQIDBA=="));
        assert!(html.contains("linear-gradient(90deg,rgb(0,0,0),rgb(255,128,0))"));
        assert!(!html.contains("http") && !html.contains("url(") && !html.contains("@import"));
    }
}
