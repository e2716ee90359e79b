//! `unlit import`: brings files into a session.

use super::{CliResult, import_pairs};
use clap::Subcommand;

#[derive(Subcommand)]
pub(super) enum Import {
    /// Flash-off/flash-on pairs from two folders, matched by file name; exit code 3 if any was rejected.
    Pairs(import_pairs::Pairs),
}

pub(super) fn run(import: &Import) -> CliResult {
    match import {
        Import::Pairs(arguments) => import_pairs::run(arguments),
    }
}
