//! `unlit import`: bring what was made elsewhere into a session.

use super::{CliResult, import_scene};
use clap::Subcommand;

/// What to import.
#[derive(Subcommand)]
pub(super) enum Import {
    /// Cameras and meshes from a reconstruction program.
    Scene(import_scene::Args),
}

/// Runs the chosen import.
pub(super) fn run(import: Import) -> CliResult {
    match import {
        Import::Scene(args) => import_scene::run(args),
    }
}
