//! Text inside of XML and HTML.

/// Text as XML 1.0 and HTML show it, in elements and in quoted attributes. Control characters other than tab and
/// line feed, most of which they have no way to write (XML 1.0, section 2.2), become the replacement character.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {
                out.push(char::REPLACEMENT_CHARACTER)
            }
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::escape;

    #[test]
    fn text_stays_text() {
        assert_eq!(escape("<a href=\"x\">R&B's</a>"), "&lt;a href=&quot;x&quot;&gt;R&amp;B&#39;s&lt;/a&gt;");
        assert_eq!(
            escape("a\tb\nc\u{0}d\u{1b}e\u{ffff}f\u{85}ü🙂"),
            "a\tb\nc\u{fffd}d\u{fffd}e\u{fffd}f\u{fffd}ü🙂"
        );
    }
}
