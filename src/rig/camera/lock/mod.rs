//! The exposure lock: goes through everything that must stand still while pairs are shot, sets what may be set,
//! reads it back, and says how each item stands. What to look for is in the makers' tables (`makers.json`).
//!
//! Reading back does not prove that a camera obeyed (libgphoto2 updates its own cache after a set); the EXIF of the
//! frames does, and is checked with every pair.

mod table;

use crate::rig::{LockItem, LockReport, LockState};
use crate::units::Seconds;
use table::{Item, Maker, Says, Severity, TABLES, XSync, number};

/// One setting as the camera tells it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reading {
    /// Its label.
    pub(super) value: String,
    /// The labels that it may take; empty for free text.
    pub(super) choices: Vec<String>,
    /// Only the camera changes it.
    pub(super) readonly: bool,
}

/// The settings of a camera by libgphoto2's names.
pub(super) trait Config {
    /// Why a setting could not be read or written.
    type Error;
    /// Reads a setting; `None` if the camera has none of that name.
    fn read(&mut self, name: &str) -> Result<Option<Reading>, Self::Error>;
    /// Writes one that it has.
    fn write(&mut self, name: &str, value: &str) -> Result<(), Self::Error>;
}

/// Goes through the table of `maker` (as the camera writes it) for a camera of `model`.
pub(super) fn go_through<C: Config>(
    config: &mut C,
    maker: &str,
    model: &str,
) -> Result<LockReport, C::Error> {
    let mut report = LockReport::default();
    let Some(table) = TABLES.of(maker) else { return Ok(report) };
    for item in &table.items {
        report.items.extend(look_at(config, item)?);
    }
    report.items.extend(warnings(&report, table, &TABLES.x_sync, model));
    report.x_sync = TABLES.x_sync.of(model).1.map(Seconds);
    Ok(report)
}

fn look_at<C: Config>(config: &mut C, item: &Item) -> Result<Option<LockItem>, C::Error> {
    for name in &item.config {
        let Some(reading) = config.read(name)? else { continue };
        return Ok(Some(match item.judge(&reading.value) {
            Says::Good => {
                let sentence = format!("{} stands on {}.", words(&item.name), reading.value);
                entry(item, LockState::Locked, &reading.value, sentence)
            }
            Says::Wrong => correct(config, item, name, &reading)?,
            Says::Nothing => match &item.ask {
                Some(question) => entry(item, LockState::Unreadable, "", question.clone()),
                None => entry(item, wrong(item), &reading.value, item.means.clone()),
            },
        }));
    }
    if item.optional {
        return Ok(None);
    }
    let question = item.ask.clone().unwrap_or_else(|| format!("The camera does not tell: {}", item.means));
    Ok(Some(entry(item, LockState::Unreadable, "", question)))
}

/// Sets what is wrong to what it should be, if that may be done from here.
fn correct<C: Config>(
    config: &mut C,
    item: &Item,
    name: &str,
    reading: &Reading,
) -> Result<LockItem, C::Error> {
    let found = &reading.value;
    let Some(wanted) = item.to_set(&reading.choices).filter(|_| !reading.readonly) else {
        let sentence = format!("{} stands on {found}. {}", words(&item.name), item.means);
        return Ok(entry(item, wrong(item), found, sentence));
    };
    // A camera that refuses to be set still tells how it stands; one that is lost fails here too.
    let refused = config.write(name, wanted).is_err();
    let now = config.read(name)?.map(|reading| reading.value).unwrap_or_default();
    Ok(if !refused && item.judge(&now) == Says::Good {
        let sentence = format!("{} stood on {found} and was set to {now}.", words(&item.name));
        entry(item, LockState::Corrected, &now, sentence)
    } else {
        let sentence = format!(
            "{} stands on {now}, and the camera does not take {wanted}. {}",
            words(&item.name),
            item.means
        );
        entry(item, wrong(item), &now, sentence)
    })
}

fn wrong(item: &Item) -> LockState {
    match item.severity {
        Severity::Spoils => LockState::Wrong,
        Severity::Warns => LockState::Warning,
    }
}

fn entry(item: &Item, state: LockState, value: &str, sentence: String) -> LockItem {
    LockItem { name: item.name.clone(), state, value: value.to_owned(), sentence }
}

/// `white_balance` as a sentence begins with it: "White balance".
fn words(name: &str) -> String {
    let spaced = name.replace('_', " ");
    let mut letters = spaced.chars();
    letters
        .next()
        .map(|first| first.to_uppercase().collect::<String>() + letters.as_str())
        .unwrap_or_default()
}

/// What follows from shutter and aperture together with the body.
fn warnings(report: &LockReport, table: &Maker, x_sync: &XSync, model: &str) -> Vec<LockItem> {
    let value =
        |name: &str| report.items.iter().find(|i| i.name == name).map(|i| i.value.as_str()).unwrap_or("");
    let warn = |name: &str, value: &str, sentence: String| LockItem {
        name: name.to_owned(),
        state: LockState::Warning,
        value: value.to_owned(),
        sentence,
    };
    let mut warnings = Vec::new();
    let (shutter, aperture) = (value("shutter"), value("aperture"));
    let (label, shortest) = x_sync.of(model);
    if let (Some(seconds), Some(shortest)) = (number(shutter), shortest)
        // Labels are rounded, neighbours are a third of a stop apart.
        && (shortest / seconds).log2() > 0.1
    {
        let sentence =
            format!("The shutter at {shutter} is faster than the X-sync time of {label}. {}", x_sync.means);
        warnings.push(warn("x_sync", shutter, sentence));
    }
    if let (Some(n), Some(wide)) = (number(aperture), &table.wide_aperture)
        && n < wide.limit
    {
        let sentence = format!("The aperture stands on f/{n}. {}", wide.means);
        warnings.push(warn("wide_aperture", aperture, sentence));
    }
    warnings
}

#[cfg(test)]
mod tests;
