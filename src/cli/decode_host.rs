//! `unlit decode-host`: the child process behind the second raw decoder, started by unlit itself.

use super::{CliError, CliResult, Exit};
use crate::codec::raw::host;

/// Decodes the file on standard input, answers on standard output.
pub(super) fn run() -> CliResult {
    host::run().map_err(CliError::new)?;
    Ok(Exit::Success)
}
