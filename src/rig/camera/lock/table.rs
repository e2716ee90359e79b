//! The makers' tables of the exposure lock: which settings must stand still, under which names libgphoto2 knows
//! them, which labels are good. The tables are data (`makers.json`); what is done with them is in [`super`].

use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// All tables.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tables {
    pub(super) x_sync: XSync,
    makers: Vec<Maker>,
}

/// The shortest exposure at which the whole frame lies open to the flash.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct XSync {
    default: String,
    pub(super) means: String,
    /// By the beginning or a part of the model's name.
    models: BTreeMap<String, String>,
}

/// One maker's table.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Maker {
    #[cfg_attr(not(test), expect(dead_code, reason = "for whoever reads the table"))]
    pub(super) name: String,
    recognised_by: Vec<String>,
    pub(super) wide_aperture: Option<WideAperture>,
    pub(super) items: Vec<Item>,
}

/// From which aperture on raw values cannot be compared.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WideAperture {
    pub(super) limit: f64,
    pub(super) means: String,
}

/// One setting that must stand still.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Item {
    /// Stable name.
    pub(super) name: String,
    /// Names of the setting in libgphoto2; the first that the camera has is read.
    pub(super) config: Vec<String>,
    /// Patterns of good labels; without any, every label is good that is not bad.
    #[serde(default)]
    good: Vec<String>,
    /// Patterns of bad labels.
    #[serde(default)]
    bad: Vec<String>,
    /// Patterns of labels that tell nothing.
    #[serde(default)]
    silent: Vec<String>,
    #[serde(default)]
    check: Check,
    /// Patterns of the labels that it may be set to, the best first; without any, it is left as it is.
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    pub(super) severity: Severity,
    /// Bodies without it need not be asked about.
    #[serde(default)]
    pub(super) optional: bool,
    /// What it means when it is wrong, and what to do.
    pub(super) means: String,
    /// What the operator is asked when the camera does not tell.
    #[serde(default)]
    pub(super) ask: Option<String>,
}

/// How a label is judged beyond the patterns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Check {
    /// By the patterns alone.
    #[default]
    Label,
    /// It must hold a number: a position of a dial, not "Auto" or "bulb".
    Number,
    /// A percentage must be at least this.
    Percent(u32),
}

/// What a wrong setting does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Severity {
    /// Pairs would be spoilt.
    #[default]
    Spoils,
    /// Pairs can be shot.
    Warns,
}

/// What a label says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Says {
    Good,
    Wrong,
    Nothing,
}

impl Item {
    /// Judges a label.
    pub(super) fn judge(&self, label: &str) -> Says {
        let among = |patterns: &[String]| patterns.iter().any(|p| matches(p, label));
        if label.is_empty() || among(&self.silent) {
            return Says::Nothing;
        }
        let checked = match self.check {
            Check::Label => true,
            Check::Number => number(label).is_some(),
            // A body that words its battery otherwise ("AC", "Full") has nothing to warn about.
            Check::Percent(least) => {
                label.strip_suffix('%').and_then(|n| n.trim().parse::<u32>().ok()).is_none_or(|n| n >= least)
            }
        };
        if checked && !among(&self.bad) && (self.good.is_empty() || among(&self.good)) {
            Says::Good
        } else {
            Says::Wrong
        }
    }

    /// The label to set, of those offered. A setting without a list takes the first as it is written.
    pub(super) fn to_set<'a>(&'a self, offered: &'a [String]) -> Option<&'a str> {
        if offered.is_empty() {
            return self.set.first().map(String::as_str);
        }
        self.set.iter().find_map(|p| offered.iter().find(|label| matches(p, label))).map(String::as_str)
    }
}

/// The number in a dial's label: `1/125`, `0.0080s`, `f/11`, `400`.
pub(super) fn number(label: &str) -> Option<f64> {
    let label = label.trim().trim_start_matches("f/");
    crate::rig::camera::labels::shutter(label).map(|seconds| seconds.0)
}

impl Tables {
    /// The table of a maker; the last one is for any.
    pub(super) fn of(&self, maker: &str) -> Option<&Maker> {
        self.makers.iter().find(|m| m.recognised_by.iter().any(|p| matches(p, maker)))
    }
}

impl XSync {
    /// X-sync time of a model in seconds, by the longest name that fits, and its label.
    pub(super) fn of(&self, model: &str) -> (&str, Option<f64>) {
        let fitting = self.models.iter().filter(|(name, _)| model.contains(name.as_str()));
        let label = fitting.max_by_key(|(name, _)| name.len()).map_or(&self.default, |(_, label)| label);
        (label, number(label))
    }
}

/// Whether `text` fits a pattern in which `*` stands for anything; upper and lower case are the same.
fn matches(pattern: &str, text: &str) -> bool {
    fn fits(pattern: &[u8], text: &[u8]) -> bool {
        match pattern.split_first() {
            None => text.is_empty(),
            Some((b'*', rest)) => (0..=text.len()).any(|skipped| fits(rest, &text[skipped..])),
            Some((first, rest)) => text.split_first().is_some_and(|(t, more)| t == first && fits(rest, more)),
        }
    }
    fits(pattern.to_lowercase().as_bytes(), text.to_lowercase().as_bytes())
}

/// The tables that are built in.
#[expect(clippy::expect_used, reason = "the file is part of the program, and a test reads it")]
pub(super) static TABLES: LazyLock<Tables> =
    LazyLock::new(|| serde_json::from_str(include_str!("makers.json")).expect("makers.json is well-formed"));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_maker_has_a_table_and_everybody_else_too() {
        for (maker, table) in [
            ("Canon Inc.", "Canon"),
            ("Nikon Corporation", "Nikon"),
            ("Sony Corporation", "Sony"),
            ("FUJIFILM", "any"),
        ] {
            assert_eq!(TABLES.of(maker).unwrap().name, table);
        }
    }

    #[test]
    fn an_item_says_what_it_wants_or_what_it_asks() {
        for item in TABLES.makers.iter().flat_map(|m| &m.items) {
            assert!(
                item.ask.is_some() || !item.config.is_empty(),
                "{} can neither be read nor asked",
                item.name
            );
            assert!(item.config.is_empty() || !item.means.is_empty(), "{} says nothing", item.name);
            for label in item.set.iter().filter(|label| !label.contains('*')) {
                assert_eq!(item.judge(label), Says::Good, "{} would be set to what is wrong", item.name);
            }
        }
    }

    #[test]
    fn patterns_know_stars_and_no_case() {
        assert!(matches("Manual*", "manual (fixed)") && matches("*canon*", "Canon Inc.") && matches("*", ""));
        assert!(!matches("raw", "RAW + Large Fine JPEG") && matches("raw + *", "RAW + Large Fine JPEG"));
    }

    #[test]
    fn the_longest_fitting_model_tells_the_x_sync_time() {
        assert_eq!(TABLES.x_sync.of("Canon EOS 6D Mark II").0, "1/180");
        assert_eq!(TABLES.x_sync.of("whatever"), ("1/200", Some(1.0 / 200.0)));
    }
}
