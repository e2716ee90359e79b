//! Parses the command line, runs the command, sets the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    if let Ok(this) = std::env::current_exe() {
        unlit::codec::raw::set_decoder_program(this);
    }
    unlit::cli::until_reader_goes(|| match unlit::cli::run(std::env::args_os()) {
        Ok(code) => code.into(),
        Err(error) => {
            eprintln!("unlit: {error}");
            unlit::cli::Exit::Failure.into()
        }
    })
}
