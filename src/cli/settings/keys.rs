//! What can be set: every flag of `unlit serve`, by one name for flag, file and environment.

use clap::builder::BoolishValueParser;
use clap::{Arg, ArgAction, Command, Id};
use std::any::TypeId;

/// The command whose flags are the keys of the config file.
pub(super) const OWNER: &str = "serve";
/// What a command has that takes settings from file and environment.
pub(super) const CONFIG: &str = "config";
/// Flags that are no settings.
const NO_SETTINGS: [&str; 4] = ["help", "version", CONFIG, "print-config"];
/// How the variables of the environment begin.
pub(super) const PREFIX: &str = "UNLIT_";

/// What a setting is in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// True or false.
    Switch,
    /// One value.
    Value,
    /// Any number of values.
    List,
}

impl Kind {
    fn of(flag: &Arg) -> Self {
        if flag.get_value_parser().type_id() == TypeId::of::<bool>() {
            Kind::Switch
        } else if matches!(flag.get_action(), ArgAction::Append) {
            Kind::List
        } else {
            Kind::Value
        }
    }
}

/// A setting that a command knows.
#[derive(Clone, Debug)]
pub(super) struct Key {
    /// The flag without its dashes; the key in the file.
    pub(super) name: String,
    pub(super) id: Id,
    pub(super) kind: Kind,
    /// What it is if nobody says.
    pub(super) default: Vec<std::ffi::OsString>,
}

impl Key {
    /// Its variable in the environment.
    pub(super) fn variable(&self) -> String {
        variable(&self.name)
    }
}

/// The variable that goes with a flag.
pub(super) fn variable(name: &str) -> String {
    format!("{PREFIX}{}", name.replace('-', "_").to_uppercase())
}

/// The settings of a command, in the order of its flags.
pub(super) fn keys(command: &Command) -> Vec<Key> {
    let settable = |flag: &&Arg| flag.get_long().is_some_and(|name| !NO_SETTINGS.contains(&name));
    let key = |flag: &Arg| Key {
        name: flag.get_long().unwrap_or_default().to_owned(),
        id: flag.get_id().clone(),
        kind: Kind::of(flag),
        default: flag.get_default_values().iter().map(|value| value.into()).collect(),
    };
    command.get_arguments().filter(settable).map(key).collect()
}

/// Lets the switches of every command that takes settings say `--switch=false` too: what file or environment turned on, the
/// command line can turn off.
pub(super) fn with_open_switches(command: Command) -> Command {
    let takes_settings = command.get_arguments().any(|flag| flag.get_id() == CONFIG);
    let command = command.mut_subcommands(with_open_switches);
    if !takes_settings {
        return command;
    }
    command.mut_args(|flag| {
        let is_switch = matches!(flag.get_action(), ArgAction::SetTrue);
        let named = flag.get_long().is_some_and(|name| !NO_SETTINGS.contains(&name));
        if !(is_switch && named) {
            return flag;
        }
        flag.action(ArgAction::Set)
            .num_args(0..=1)
            .require_equals(true)
            .value_name("true|false")
            .value_parser(BoolishValueParser::new())
            .default_value("false")
            .default_missing_value("true")
            .hide_default_value(true)
            .hide_possible_values(true)
    })
}
