//! `unlit camera-host`: the child process behind a camera, started by unlit itself.

use super::{CliError, CliResult, Exit};
use crate::rig::camera::host;

/// Arguments.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Camera port as libgphoto2 writes it; without it the host can only list cameras.
    #[arg(long)]
    port: Option<String>,
}

/// Serves until the driver closes the socket.
pub(super) fn run(args: &Args) -> CliResult {
    let _lines_say_whose =
        tracing::error_span!("camera_host", pid = std::process::id(), port = args.port.as_deref()).entered();
    host::run(args.port.as_deref()).map_err(CliError::new)?;
    Ok(Exit::Success)
}
