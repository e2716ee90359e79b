//! Settings from flags, else the environment, else the config file. There is no second list of them: every flag of
//! `unlit serve` is a key of the file and a variable of the environment, and clap judges all three. Other commands that
//! flatten [`ConfigArgs`] take the settings that they share with `serve`.

mod file;
mod keys;
mod layers;
#[cfg(test)]
mod tests;

pub(super) use layers::Settled;

use crate::log;
use clap::error::ErrorKind;
use clap::{ArgMatches, Command};
use keys::{Kind, PREFIX};
use layers::{Asked, Origin};
use std::ffi::OsString;
use std::fmt::Write;
use std::path::PathBuf;

/// Flags of every command that takes settings from file and environment.
#[derive(clap::Args)]
pub(super) struct ConfigArgs {
    /// File of settings, whose keys are the flags of `unlit serve`; without it, the first that is there of
    /// `$XDG_CONFIG_HOME/unlit/config.toml` and `/etc/unlit/config.toml`. Flags go before the environment
    /// (`UNLIT_LISTEN` for `--listen`), and the environment before the file.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Form of the log on stderr; `UNLIT_LOG` says of what.
    #[arg(long, value_name = "human|json", default_value_t)]
    log_format: log::Format,
}

/// Why the settings cannot be used.
#[derive(Debug, thiserror::Error)]
pub(super) enum SettingsError {
    #[error("the config file {path} cannot be read: {source}")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error(
        "the config file {path} can be written by anybody on this machine, and is not trusted: `chmod o-w` makes it yours"
    )]
    AnybodyWrites { path: PathBuf },
    #[error("{path}, line {line}: this is no TOML: {words}")]
    Syntax { path: PathBuf, line: usize, words: String },
    #[error("{origin}: there is no setting `{key}`{}; the settings are {known}", did_you_mean(.nearest))]
    UnknownKey { origin: Origin, key: String, nearest: Option<String>, known: String },
    #[error("{origin}: `{key}` must be {expected} (found: {found})")]
    WrongType { origin: Origin, key: String, expected: &'static str, found: String },
    #[error("{origin}: `{key}`: {words}")]
    Value { origin: Origin, key: String, words: String },
}

fn did_you_mean(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|key| format!(" (did you mean `{key}`?)")).unwrap_or_default()
}

impl Settled {
    /// What is in force and where each value comes from, as a config file.
    pub(super) fn words(&self) -> String {
        let mut text = match &self.file {
            Some(path) => format!("# config file: {}\n", path.display()),
            None => "# no config file\n".to_owned(),
        };
        for setting in &self.settings {
            let quoted = |value: &OsString| serde_json::json!(value.to_string_lossy()).to_string();
            let values: Vec<String> = setting.values.iter().map(quoted).collect();
            let value = match (setting.kind, &values[..]) {
                (_, []) => None,
                (Kind::Switch, _) => setting.values.first().map(|v| v.to_string_lossy().into_owned()),
                (Kind::Value, _) => Some(values.join(",")),
                (Kind::List, _) => Some(format!("[{}]", values.join(", "))),
            };
            // Writing to a string cannot fail.
            let _ = match value {
                Some(value) => writeln!(text, "{} = {value}  # {}", setting.name, setting.origin),
                None => writeln!(text, "# {} is not set", setting.name),
            };
        }
        text
    }

    /// Variables that look mistyped, in sentences.
    pub(super) fn doubts(&self) -> &[String] {
        &self.doubts
    }

    /// Where the settings come from that clap's complaint names, in sentences.
    fn explain(&self, complaint: &clap::Error) -> Vec<String> {
        if !matches!(complaint.kind(), ErrorKind::ArgumentConflict | ErrorKind::MissingRequiredArgument) {
            return Vec::new();
        }
        let text = complaint.to_string();
        let named = self.settings.iter().filter(|s| !matches!(s.origin, Origin::Default | Origin::Flag));
        let named = named.filter(|s| text.contains(&format!("--{}", s.name)));
        named.map(|s| format!("--{} comes from {}", s.name, s.origin)).collect()
    }
}

/// Parses the command line together with environment and config file; ends the program with exit code 2 where that cannot
/// be done, and with 0 after `--help` and the like.
pub(super) fn parse(command: Command, arguments: Vec<OsString>) -> (ArgMatches, Settled) {
    let command = keys::with_open_switches(command);
    let environment: Vec<(OsString, OsString)> = std::env::vars_os()
        .filter(|(name, _)| {
            name.to_str().is_some_and(|n| n.starts_with(PREFIX) || matches!(n, "HOME" | "XDG_CONFIG_HOME"))
        })
        .collect();
    // Help must come whatever the file says.
    if let Err(answer) = command.clone().try_get_matches_from(&arguments)
        && !answer.use_stderr()
    {
        answer.exit();
    }
    let settled = match settle(&command, &arguments, &environment) {
        Ok(settled) => settled,
        Err(error) => clap::Error::raw(ErrorKind::ValueValidation, format!("{error}\n")).exit(),
    };
    match command.try_get_matches_from(&settled.arguments) {
        Ok(matches) => (matches, settled),
        Err(error) => {
            let origins = settled.explain(&error);
            // Nobody is left to tell that stderr is gone.
            let _ = error.print();
            origins.iter().for_each(|origin| eprintln!("{origin}"));
            std::process::exit(error.exit_code());
        }
    }
}

/// The form of the log that a command was asked for; the inherited one where it takes no settings.
pub(super) fn log_format(mut matches: &ArgMatches) -> log::Format {
    while let Some((_, of_command)) = matches.subcommand() {
        matches = of_command;
    }
    matches.try_get_one("log_format").ok().flatten().copied().unwrap_or_else(log::Format::inherited)
}

fn settle(
    command: &Command,
    arguments: &[OsString],
    environment: &[(OsString, OsString)],
) -> Result<Settled, SettingsError> {
    let Some(asked) = Asked::new(command, arguments) else {
        return Ok(Settled { arguments: arguments.to_vec(), ..Settled::default() });
    };
    let file = file::find(asked.named_file(environment).as_deref(), environment)?;
    asked.settle(file.as_ref(), environment)
}
