//! `unlit new`: makes a session.

use super::lighting::LightingArgs;
use super::{CliError, CliResult, Exit};
use crate::session::Session;
use clap::Args;
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct New {
    /// Folder of the new session; must not exist or be empty.
    session: PathBuf,
    /// Name of the session, if not the folder's.
    #[arg(long)]
    name: Option<String>,
    #[command(flatten)]
    lighting: LightingArgs,
}

pub(super) fn run(arguments: &New) -> CliResult {
    let folder_name = || {
        let absolute = std::path::absolute(&arguments.session).ok()?;
        Some(absolute.file_name()?.to_string_lossy().into_owned())
    };
    let name = arguments.name.clone().or_else(folder_name).unwrap_or_else(|| "session".to_owned());
    let session = Session::create(&arguments.session, &name).map_err(CliError::new)?;
    arguments.lighting.tell(&session)?;
    println!("made session {name} in {}", session.path().display());
    Ok(Exit::Success)
}
