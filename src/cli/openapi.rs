//! `unlit openapi`: prints the API's document; `docs/openapi.json` is this output.

use super::{CliError, CliResult, Exit};

pub(super) fn run() -> CliResult {
    print!("{}", crate::http::openapi().map_err(CliError::new)?);
    Ok(Exit::Success)
}
