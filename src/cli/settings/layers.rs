//! Config file < environment < flags: what each says, and what is in force.

use super::SettingsError;
use super::file::{self, ConfigFile};
use super::keys::{CONFIG, Key, Kind, OWNER, PREFIX, keys, variable};
use clap::parser::ValueSource;
use clap::{ArgMatches, Command, Id, error::ErrorKind};
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;

/// Variables that are ours and no settings.
const OTHER_VARIABLES: [&str; 2] = ["UNLIT_LOG", "UNLIT_CONFIG"];

/// Where a setting comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::cli) enum Origin {
    /// Nobody set it.
    Default,
    /// The config file.
    File {
        /// Which.
        path: PathBuf,
        /// Where in it, from 1.
        line: usize,
    },
    /// This variable.
    Environment(String),
    /// The command line.
    Flag,
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Origin::Default => write!(f, "default"),
            Origin::File { path, line } => write!(f, "{}, line {line}", path.display()),
            Origin::Environment(variable) => write!(f, "{variable} in the environment"),
            Origin::Flag => write!(f, "flag"),
        }
    }
}

/// A setting as one layer has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Setting {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// As the flag would be given them; none where nobody set it and there is no default.
    pub(super) values: Vec<OsString>,
    pub(super) origin: Origin,
}

impl Setting {
    fn flags(&self) -> impl Iterator<Item = OsString> {
        self.values.iter().map(|value| {
            let mut flag = OsString::from(format!("--{}=", self.name));
            flag.push(value);
            flag
        })
    }
}

/// What is in force.
#[derive(Clone, Debug, Default)]
pub(in crate::cli) struct Settled {
    /// The command line with everything on it.
    pub(super) arguments: Vec<OsString>,
    /// Every setting of the command, in the order of its flags.
    pub(super) settings: Vec<Setting>,
    /// The config file that was read.
    pub(super) file: Option<PathBuf>,
    /// Variables that look mistyped, in sentences.
    pub(super) doubts: Vec<String>,
}

/// A command line whose command takes settings from file and environment.
pub(super) struct Asked<'a> {
    arguments: &'a [OsString],
    /// How many of them name the command.
    depth: usize,
    command: &'a Command,
    owner: &'a Command,
    /// What the flags alone say, wrong ones left out: clap complains of them later.
    flags: ArgMatches,
}

impl<'a> Asked<'a> {
    /// `None` if the command takes no settings.
    pub(super) fn new(root: &'a Command, arguments: &'a [OsString]) -> Option<Self> {
        let (mut command, mut depth) = (root, 1);
        while let Some(sub) = arguments.get(depth).and_then(|word| command.find_subcommand(word)) {
            command = sub;
            depth += 1;
        }
        command.get_arguments().find(|flag| flag.get_id() == CONFIG)?;
        let words =
            std::iter::once(OsStr::new("unlit")).chain(arguments[depth..].iter().map(OsString::as_os_str));
        let flags = command.clone().ignore_errors(true).try_get_matches_from(words).ok()?;
        Some(Self { arguments, depth, command, owner: root.find_subcommand(OWNER)?, flags })
    }

    /// The config file that somebody named.
    pub(super) fn named_file(&self, environment: &[(OsString, OsString)]) -> Option<OsString> {
        let flag = self.flags.get_raw(CONFIG).and_then(|mut values| values.next()).map(OsStr::to_owned);
        flag.or_else(|| said(environment, &variable(CONFIG)))
    }

    /// Puts the layers on top of each other. A higher one takes the place of a lower one key by key, and puts aside what it
    /// cannot be used together with.
    pub(super) fn settle(
        &self,
        file: Option<&ConfigFile>,
        environment: &[(OsString, OsString)],
    ) -> Result<Settled, SettingsError> {
        let known = keys(self.owner);
        let own = keys(self.command);
        let from_file = file.map_or(Ok(Vec::new()), |file| file::settings(file, &known))?;
        let mut taken: Vec<Id> = self.flags.ids().filter(|id| self.said_by_flag(id)).cloned().collect();
        let mut in_force: Vec<Id> = taken.iter().filter(|id| !self.is_off(id)).cloned().collect();
        let mut settings: Vec<Setting> = own.iter().map(|key| self.by_flag_or_default(key)).collect();
        let mut arguments = Vec::new();
        for layer in [from_environment(environment, &known), from_file] {
            let above = (taken.clone(), in_force.clone());
            for mut setting in layer {
                let Some(at) = own.iter().position(|key| key.name == setting.name) else { continue };
                let id = &own[at].id;
                let on = self.checked(&setting, id)?;
                if above.0.contains(id) || above.1.iter().any(|other| on && self.conflict(id, other)) {
                    continue;
                }
                taken.push(id.clone());
                if setting.kind == Kind::Switch {
                    setting.values = vec![on.to_string().into()];
                }
                if on {
                    in_force.push(id.clone());
                    arguments.extend(setting.flags());
                }
                settings[at] = setting;
            }
        }
        let mut all = self.arguments[..self.depth].to_vec();
        all.extend(arguments);
        all.extend(self.arguments[self.depth..].iter().filter(|word| !self.turns_off(word, &own)).cloned());
        Ok(Settled {
            arguments: all,
            settings,
            file: file.map(|file| file.path.clone()),
            doubts: doubts(environment, &known),
        })
    }

    fn said_by_flag(&self, id: &Id) -> bool {
        self.flags.value_source(id.as_str()) == Some(ValueSource::CommandLine)
    }

    /// A switch that the flags turn off.
    fn is_off(&self, id: &Id) -> bool {
        matches!(self.flags.try_get_one::<bool>(id.as_str()), Ok(Some(false)))
    }

    /// Whether this word says of a switch what it says anyway once nobody turns it on.
    fn turns_off(&self, word: &OsStr, own: &[Key]) -> bool {
        let name = word.to_str().and_then(|word| word.strip_prefix("--")?.split_once('='));
        name.is_some_and(|(name, _)| {
            own.iter().any(|key| key.kind == Kind::Switch && key.name == name && self.is_off(&key.id))
        })
    }

    fn by_flag_or_default(&self, key: &Key) -> Setting {
        let (values, origin) = if self.said_by_flag(&key.id) && key.kind == Kind::Switch {
            (vec![(!self.is_off(&key.id)).to_string().into()], Origin::Flag)
        } else if self.said_by_flag(&key.id) {
            let given = self.flags.get_raw(key.id.as_str()).into_iter().flatten();
            (given.map(OsStr::to_owned).collect(), Origin::Flag)
        } else {
            (key.default.clone(), Origin::Default)
        };
        Setting { name: key.name.clone(), kind: key.kind, values, origin }
    }

    fn conflict(&self, one: &Id, other: &Id) -> bool {
        let names = |id: &Id, with: &Id| {
            let flag = self.command.get_arguments().find(|flag| flag.get_id() == id);
            flag.is_some_and(|flag| {
                self.command.get_arg_conflicts_with(flag).iter().any(|other| other.get_id() == with)
            })
        };
        names(one, other) || names(other, one)
    }

    /// Has clap judge one setting by itself; whether it says anything but "off".
    fn checked(&self, setting: &Setting, id: &Id) -> Result<bool, SettingsError> {
        let words = std::iter::once("unlit".into()).chain(setting.flags());
        match self.command.clone().try_get_matches_from(words) {
            Ok(alone) => Ok(!matches!(alone.try_get_one::<bool>(id.as_str()), Ok(Some(false)))),
            Err(error) => match error.kind() {
                // Whether all of it goes together is judged when all of it is there.
                ErrorKind::MissingRequiredArgument | ErrorKind::ArgumentConflict => Ok(true),
                _ => Err(SettingsError::Value {
                    origin: setting.origin.clone(),
                    key: setting.name.clone(),
                    words: first_paragraph(&error),
                }),
            },
        }
    }
}

fn first_paragraph(error: &clap::Error) -> String {
    let text = error.to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    let lines = text.split("\n\n").next().unwrap_or("").lines().map(str::trim);
    lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
}

/// What a variable says; an empty one says nothing.
fn said(environment: &[(OsString, OsString)], variable: &str) -> Option<OsString> {
    let (_, value) = environment.iter().find(|(name, _)| name == variable)?;
    Some(value.clone()).filter(|value| !value.is_empty())
}

fn from_environment(environment: &[(OsString, OsString)], known: &[Key]) -> Vec<Setting> {
    let setting = |key: &Key| {
        let value = said(environment, &key.variable())?;
        let values = match (key.kind, value.to_str()) {
            (Kind::List, Some(text)) => text.split(',').map(|item| item.trim().into()).collect(),
            _ => vec![value],
        };
        let origin = Origin::Environment(key.variable());
        Some(Setting { name: key.name.clone(), kind: key.kind, values, origin })
    };
    known.iter().filter_map(setting).collect()
}

/// Variables of ours that nothing reads although they look as if.
fn doubts(environment: &[(OsString, OsString)], known: &[Key]) -> Vec<String> {
    let ours: Vec<String> =
        known.iter().map(Key::variable).chain(OTHER_VARIABLES.map(str::to_owned)).collect();
    let strange = environment.iter().filter_map(|(name, _)| name.to_str()).filter_map(|name| {
        let rest = name.strip_prefix(PREFIX).filter(|_| !ours.iter().any(|known| known == name))?;
        let meant = file::nearest(rest, ours.iter().map(|known| known[PREFIX.len()..].to_owned()))?;
        Some(format!("{name} in the environment is read by nothing; {PREFIX}{meant} is a setting"))
    });
    strange.collect()
}
