//! The config file: which one, whether to trust it, and what it says.

use super::SettingsError;
use super::keys::{Key, Kind};
use super::layers::{Origin, Setting};
use std::ffi::{OsStr, OsString};
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use toml_edit::{Document, Item, Value};

/// Where a machine's own config file is.
const OF_THE_MACHINE: &str = "/etc/unlit/config.toml";
/// Keys that resemble a mistyped one less than this (Jaro) are not offered in its place.
const RESEMBLANCE: f64 = 0.8;

/// A config file as it was read.
#[derive(Clone, Debug)]
pub(in crate::cli) struct ConfigFile {
    pub(super) path: PathBuf,
    pub(super) text: String,
}

/// The file that was named, which must be there; else the first of the usual ones that is.
pub(super) fn find(
    named: Option<&OsStr>,
    environment: &[(OsString, OsString)],
) -> Result<Option<ConfigFile>, SettingsError> {
    if let Some(path) = named {
        return read(Path::new(path)).map(Some);
    }
    for path in usual_places(environment) {
        match read(&path) {
            Err(SettingsError::Unreadable { source, .. })
                if matches!(source.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {}
            other => return other.map(Some),
        }
    }
    Ok(None)
}

fn usual_places(environment: &[(OsString, OsString)]) -> Vec<PathBuf> {
    let absolute = |name: &str| {
        let (_, value) = environment.iter().find(|(n, _)| n == name)?;
        Some(PathBuf::from(value)).filter(|path| path.is_absolute())
    };
    let own = absolute("XDG_CONFIG_HOME").or_else(|| Some(absolute("HOME")?.join(".config")));
    own.map(|folder| folder.join("unlit/config.toml")).into_iter().chain([OF_THE_MACHINE.into()]).collect()
}

fn read(path: &Path) -> Result<ConfigFile, SettingsError> {
    let unreadable = |source| SettingsError::Unreadable { path: path.to_owned(), source };
    let about = std::fs::metadata(path).map_err(unreadable)?;
    // The file can open doors, so that nobody else may write it.
    if about.is_file() && about.mode() & 0o002 != 0 {
        return Err(SettingsError::AnybodyWrites { path: path.to_owned() });
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    Ok(ConfigFile { path: path.to_owned(), text })
}

/// What the file sets, each key being one of `known`.
pub(super) fn settings(file: &ConfigFile, known: &[Key]) -> Result<Vec<Setting>, SettingsError> {
    let line = |at: Option<std::ops::Range<usize>>| {
        let before = at.and_then(|at| file.text.get(..at.start)).unwrap_or("");
        1 + before.matches('\n').count()
    };
    let document = Document::parse(file.text.as_str()).map_err(|error| SettingsError::Syntax {
        path: file.path.clone(),
        line: line(error.span()),
        words: error.message().to_owned(),
    })?;
    let table = document.as_table();
    let mut settings = Vec::new();
    for (name, item) in table.iter() {
        let at = table.key(name).and_then(|key| key.span()).or_else(|| item.span());
        let origin = Origin::File { path: file.path.clone(), line: line(at) };
        let Some(key) = known.iter().find(|key| key.name == name) else {
            return Err(SettingsError::UnknownKey {
                origin,
                key: name.to_owned(),
                nearest: nearest(name, known.iter().map(|key| key.name.clone())),
                known: known.iter().map(|key| key.name.as_str()).collect::<Vec<_>>().join(", "),
            });
        };
        let values = values(key.kind, item).ok_or_else(|| SettingsError::WrongType {
            origin: origin.clone(),
            key: name.to_owned(),
            expected: match key.kind {
                Kind::Switch => "true or false",
                Kind::Value => "a text in quotes, or a number",
                Kind::List => "a list of texts in brackets",
            },
            found: item.type_name().to_owned(),
        })?;
        settings.push(Setting { name: name.to_owned(), kind: key.kind, values, origin });
    }
    Ok(settings)
}

/// The texts that the flag would be given; `None` if the file has something else there.
fn values(kind: Kind, item: &Item) -> Option<Vec<OsString>> {
    let text = |value: &Value| match value {
        Value::String(text) => Some(text.value().into()),
        Value::Integer(number) => Some(number.value().to_string().into()),
        Value::Float(number) => Some(number.value().to_string().into()),
        _ => None,
    };
    match kind {
        Kind::Switch => Some(vec![item.as_bool()?.to_string().into()]),
        Kind::Value => Some(vec![text(item.as_value()?)?]),
        Kind::List => item.as_array()?.iter().map(text).collect(),
    }
}

/// The name that was probably meant.
pub(super) fn nearest(name: &str, known: impl IntoIterator<Item = String>) -> Option<String> {
    let plain = |text: &str| text.to_lowercase().replace('_', "-");
    let resembling = known.into_iter().map(|k| (strsim::jaro(&plain(name), &plain(&k)), k));
    resembling.filter(|(r, _)| *r >= RESEMBLANCE).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
}
