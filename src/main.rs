//! Parses the command line, runs the command, sets the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("UNLIT_LOG").unwrap_or_else(|_| "warn".into()),
        )
        .with_writer(std::io::stderr)
        .init();
    if let Ok(this) = std::env::current_exe() {
        unlit::codec::raw::set_decoder_program(this);
    }
    match unlit::cli::run(std::env::args_os()) {
        Ok(code) => code.into(),
        Err(error) => {
            eprintln!("unlit: {error}");
            unlit::cli::Exit::Failure.into()
        }
    }
}
