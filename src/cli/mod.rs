//! The command line: one file a command, each parses, calls one function of the library and prints.

mod apex;
mod calibrate;
mod camera_host;
mod certify;
mod decode_host;
mod devices;
mod doctor;
mod evaluate;
mod experiment;
mod export;
mod export_photos;
mod flash;
mod import;
mod import_pairs;
mod import_scene;
mod inspect;
mod lighting;
mod new;
mod openapi;
mod process;
mod progress_bar;
mod reader;
mod sequence;
mod serve;
mod session;
mod settings;
mod shoot;
mod stop;
mod studio;
mod works;

pub use reader::until_reader_goes;

use crate::log;
use crate::session::Session;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

/// Exit codes, as documented in `unlit --help`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Everything asked was done.
    Success,
    /// Something went wrong; the last line on stderr says what.
    Failure,
    /// The work was done, but at least one pair was rejected.
    Rejected,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        ExitCode::from(match exit {
            Exit::Success => 0,
            Exit::Failure => 1,
            Exit::Rejected => 3,
        })
    }
}

/// Any command's error: the domain's own sentence is what the user reads.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct CliError(#[from] Box<dyn std::error::Error + Send + Sync>);

impl CliError {
    /// Wraps a domain error.
    pub fn new(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self(error.into())
    }
}

/// Opens a session for writing, and says on stderr what had to be put right.
fn open_session(path: &Path) -> Result<Session, CliError> {
    let session = Session::open(path).map_err(CliError::new)?;
    session.recovery().sentences(|_| false).iter().for_each(|sentence| eprintln!("unlit: {sentence}"));
    Ok(session)
}

/// What a command gives back to `main`.
pub type CliResult = Result<Exit, CliError>;

/// Takes the light out of photographed objects.
///
/// Exit codes: 0 done; 1 failed, stderr says why; 2 the command line or the config file is wrong; 3 done, but a pair was rejected.
#[derive(Parser)]
#[command(version, name = "unlit", verbatim_doc_comment)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Makes a session: a folder for pairs, calibration, scene and results.
    New(new::New),
    /// Checks a session folder.
    #[command(subcommand)]
    Session(session::SessionCommand),
    /// Brings files into a session: pairs shot to a card, or the reconstructed scene.
    #[command(subcommand)]
    Import(import::Import),
    /// Shows the true sensor values of a raw file, to find an exposure.
    Inspect(inspect::Inspect),
    /// Shoots and processes for a page in the browser and for scripts.
    Serve(serve::Args),
    /// Shoots pairs from the terminal; exit code 3 if any was rejected.
    Shoot(shoot::Args),
    /// Measures the rig from calibration shots.
    #[command(subcommand)]
    Calibrate(calibrate::Calibrate),
    /// Computes exposure values (Av, Tv, Sv, Bv, EV), and the factor between two exposures.
    Apex(apex::Args),
    /// Turns a session's pairs into reflectance: texture, deviations and model.
    Process(process::Args),
    /// Compares a session's reflectance with a known truth.
    Evaluate(evaluate::Args),
    /// Compares a session's reflectance with patches of known reflectance that were left in the scene; exit code 1 if one
    /// is off by more than 5 %, or none was seen.
    Certify(certify::Args),
    /// Writes a session's model in other programs' formats and colour spaces.
    Export(export::Args),
    /// Develops a session's accepted pairs into a folder for Metashape, RealityScan or COLMAP.
    ExportPhotos(export_photos::Args),
    /// Runs the thesis's experiments again in the simulated studio and prints both figures.
    Experiment(experiment::Args),
    /// Looks at what cameras and flash controllers need on this machine, and says what to do; exit code 1 if
    /// anything keeps them from working.
    Doctor(doctor::Args),
    /// The flash controller: finds, tries, watches and programs it.
    #[command(subcommand)]
    Flash(flash::Flash),
    /// Prints the OpenAPI document of `unlit serve`.
    Openapi,
    /// The simulated studio's own housekeeping.
    #[command(subcommand)]
    Studio(studio::StudioCommand),
    /// Runs one camera for another unlit process.
    #[command(hide = true)]
    CameraHost(camera_host::Args),
    /// Decodes one raw file for another unlit process.
    #[command(hide = true)]
    DecodeHost,
}

/// Parses `args` (the program's name first), begins to log and runs the command.
pub fn run(args: impl IntoIterator<Item = OsString>) -> CliResult {
    let (matches, settled) = settings::parse(Cli::command(), args.into_iter().collect());
    log::start(settings::log_format(&matches));
    settled.doubts().iter().for_each(|doubt| tracing::warn!("{doubt}"));
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    match cli.command {
        Command::New(arguments) => new::run(&arguments),
        Command::Import(what) => import::run(what),
        Command::Session(command) => session::run(command),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Serve(args) => serve::run(args, &settled),
        Command::Shoot(args) => shoot::run(args),
        Command::Calibrate(what) => calibrate::run(&what),
        Command::Apex(args) => apex::run(&args),
        Command::Process(args) => process::run(&args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Certify(args) => certify::run(&args),
        Command::Export(args) => export::run(args),
        Command::ExportPhotos(args) => export_photos::run(args),
        Command::Experiment(args) => experiment::run(args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Flash(what) => flash::run(&what),
        Command::Openapi => openapi::run(),
        Command::Studio(command) => studio::run(command),
        Command::CameraHost(args) => camera_host::run(&args),
        Command::DecodeHost => decode_host::run(),
    }
}
