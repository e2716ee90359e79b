//! Which part of a file a request wants, and whether it wants any (RFC 9110, sections 13 and 14). Pure.

use axum::http::{HeaderMap, HeaderName, header};
use std::ops::Range;

/// What to answer to a request for a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// All of it.
    Whole,
    /// These bytes.
    Part(Range<u64>),
    /// The client has it already.
    NotModified,
    /// It is not the file any more that the client means.
    Changed,
    /// There are no such bytes.
    NoSuchPart,
}

/// What to answer to `headers` of a GET for a file of `bytes` whose strong entity tag is `tag`, quotes included.
pub(super) fn answer(headers: &HeaderMap, tag: &str, bytes: u64) -> Answer {
    let names = |name: HeaderName, weakly: bool| {
        let values: Vec<&str> =
            headers.get_all(name).iter().filter_map(|value| value.to_str().ok()).collect();
        let same = |t: &str| t == "*" || t == tag || (weakly && t.strip_prefix("W/") == Some(tag));
        (!values.is_empty()).then(|| values.iter().flat_map(|list| list.split(',')).any(|t| same(t.trim())))
    };
    if names(header::IF_MATCH, false) == Some(false) {
        return Answer::Changed;
    }
    if names(header::IF_NONE_MATCH, true) == Some(true) {
        return Answer::NotModified;
    }
    // A date would do, too, but we give none by which a client could tell two versions apart.
    let still_the_same = headers.get(header::IF_RANGE).is_none_or(|known| known.as_bytes() == tag.as_bytes());
    match headers.get(header::RANGE).and_then(|range| range.to_str().ok()) {
        Some(range) if still_the_same => part(range, bytes),
        _ => Answer::Whole,
    }
}

/// One range of bytes. What is no such range, or several, is answered with the whole, as the standard allows.
fn part(range: &str, bytes: u64) -> Answer {
    let Some((first, last)) = range.strip_prefix("bytes=").and_then(|set| set.trim().split_once('-')) else {
        return Answer::Whole;
    };
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        // A number that does not fit lies behind the end of every file.
        digits.then(|| text.parse().unwrap_or(u64::MAX))
    };
    let wanted = match (number(first), number(last)) {
        (Some(first), None) if last.is_empty() => first..bytes,
        (Some(first), Some(last)) if first <= last => first..last.saturating_add(1).min(bytes),
        (None, Some(count)) if first.is_empty() => {
            if count == 0 {
                return Answer::NoSuchPart;
            }
            bytes.saturating_sub(count)..bytes
        }
        _ => return Answer::Whole,
    };
    if wanted.start < bytes { Answer::Part(wanted) } else { Answer::NoSuchPart }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use proptest::prelude::*;

    const TAG: &str = "\"abc\"";

    fn asked(pairs: &[(HeaderName, &str)], bytes: u64) -> Answer {
        let headers = pairs.iter().map(|(n, v)| (n.clone(), HeaderValue::from_str(v).unwrap())).collect();
        answer(&headers, TAG, bytes)
    }

    #[test]
    fn one_range_is_a_part_and_everything_odd_is_the_whole() {
        let range = |text: &str| asked(&[(header::RANGE, text)], 100);
        for (text, expected) in [
            ("bytes=0-9", 0..10),
            ("bytes=90-", 90..100),
            ("bytes=-10", 90..100),
            ("bytes=-1000", 0..100),
            ("bytes=50-1000", 50..100),
            ("bytes=99-99999999999999999999999", 99..100),
        ] {
            assert_eq!(range(text), Answer::Part(expected), "{text}");
        }
        for text in
            ["bytes=9-1", "bytes=0-1,5-6", "bytes=", "bytes=-", "bytes=a-b", "lines=0-1", "0-1", "bytes=+1-2"]
        {
            assert_eq!(range(text), Answer::Whole, "{text}");
        }
        for text in ["bytes=100-", "bytes=100-200", "bytes=-0", "bytes=99999999999999999999999-"] {
            assert_eq!(range(text), Answer::NoSuchPart, "{text}");
        }
        assert_eq!(asked(&[(header::RANGE, "bytes=0-")], 0), Answer::NoSuchPart);
    }

    #[test]
    fn tags_decide_whether_anything_is_sent_and_whether_a_part_fits_the_rest() {
        let part = (header::RANGE, "bytes=0-9");
        for tags in [TAG, "W/\"abc\"", "\"x\", \"abc\"", "*"] {
            assert_eq!(
                asked(&[(header::IF_NONE_MATCH, tags), part.clone()], 100),
                Answer::NotModified,
                "{tags}"
            );
        }
        assert_eq!(asked(&[(header::IF_NONE_MATCH, "\"x\"")], 100), Answer::Whole);
        assert_eq!(asked(&[(header::IF_RANGE, TAG), part.clone()], 100), Answer::Part(0..10));
        assert_eq!(asked(&[(header::IF_RANGE, "\"x\""), part.clone()], 100), Answer::Whole);
        assert_eq!(asked(&[(header::IF_RANGE, "W/\"abc\""), part.clone()], 100), Answer::Whole);
        assert_eq!(asked(&[(header::IF_MATCH, "W/\"abc\"")], 100), Answer::Changed);
        assert_eq!(asked(&[(header::IF_MATCH, TAG), part], 100), Answer::Part(0..10));
    }

    proptest! {
        #[test]
        fn no_range_reaches_beyond_the_file(text in "bytes=[0-9]{0,22}-[0-9]{0,22}", bytes in 0u64..1000) {
            if let Answer::Part(part) = asked(&[(header::RANGE, &text)], bytes) {
                prop_assert!(part.start < part.end && part.end <= bytes, "{part:?}");
            }
        }
    }
}
