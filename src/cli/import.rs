//! `unlit import`: brings what was made elsewhere into a session.

use super::{CliResult, import_pairs, import_scene};
use clap::Subcommand;

/// What to import.
#[derive(Subcommand)]
pub(super) enum Import {
    /// Flash-off/flash-on pairs from two folders, matched by file name; exit code 3 if any was rejected.
    Pairs(import_pairs::Pairs),
    /// Cameras and meshes from a reconstruction program.
    Scene(import_scene::Args),
}

/// Runs the chosen import.
pub(super) fn run(what: Import) -> CliResult {
    match what {
        Import::Pairs(arguments) => import_pairs::run(&arguments),
        Import::Scene(args) => import_scene::run(args),
    }
}
