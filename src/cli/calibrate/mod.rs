//! `unlit calibrate`: measures the rig from calibration shots.

mod colour;
mod exposure;
mod flash;
mod flat;

use crate::capture::{Engine, Events, words_on_repeatability};
use crate::cli::devices::DeviceArgs;
use crate::cli::settings::ConfigArgs;
use crate::cli::shoot::tell_of_recovery;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pair::Limits;
use crate::pipeline;
use crate::pipeline::steadiness::SteadyFile;
use flash::FlashArgs;
use std::path::PathBuf;

/// What to calibrate.
#[derive(clap::Subcommand)]
pub(super) enum Calibrate {
    /// The flash, from shots of a white card that fills the frame and faces the camera.
    ///
    /// Put a flat, matt white card before the camera so that it fills the frame, in a dark room (or with an unlit frame
    /// beside every lit one). Shoot it at three distances or more, from the nearest at which nothing clips to the
    /// farthest at which you photograph, three times each, at one aperture and ISO and one power of the flash. The shutter
    /// may differ: a flash is an energy, not a power.
    Flash(FlashArgs),
    /// What the steps of ISO, shutter and aperture truly do, from ladders of shots in steady light.
    Exposure(exposure::ExposureArgs),
    /// Vignetting and flat field, from evenly lit frames.
    Flat(flat::FlatArgs),
    /// The camera's colours, from a raw file of a colour chart.
    Colour(colour::ColourArgs),
    /// Where the sensor clips, from deliberately blown frames: one at every ISO in use.
    Saturation(SaturationArgs),
    /// How steady the flash is: shoots a plain surface again and again, nothing changed, with a flash controller; or from lit frames alone.
    Repeatability(RepeatabilityArgs),
}

/// Arguments of `unlit calibrate repeatability`.
#[derive(clap::Args)]
pub(super) struct RepeatabilityArgs {
    /// Session folder. Of shots taken with the controller only figures are kept in it, no frames.
    session: PathBuf,
    /// How many shots to take, each a frame without flash and one with; 8 or more.
    #[arg(long, value_name = "N", default_value_t = 40)]
    shots: usize,
    /// Lit frames of an earlier series, in their order, instead of shooting: a card in a dark room, nothing changed from
    /// one to the next; after = the energy of the pulse, if it was measured. They are copied into the session.
    #[arg(long, value_name = "FILE[=ENERGY]", num_args = 1.., value_parser = flash::steady_file)]
    frames: Vec<SteadyFile>,
    /// Prints the record as JSON; with --frames.
    #[arg(long, requires = "frames")]
    json: bool,
    /// With `--studio` the white card stands 1 m before the lens.
    #[command(flatten)]
    devices: DeviceArgs,
    #[command(flatten)]
    _config: ConfigArgs,
}

/// Arguments of `unlit calibrate saturation`.
#[derive(clap::Args)]
pub(super) struct SaturationArgs {
    /// Session folder.
    session: PathBuf,
    /// Raw files of a bright, even surface, over-exposed by three stops or more.
    #[arg(required = true)]
    frames: Vec<PathBuf>,
}

pub(super) fn run(what: &Calibrate) -> CliResult {
    match what {
        Calibrate::Exposure(args) => exposure::run(args),
        Calibrate::Flat(args) => flat::run(args),
        Calibrate::Colour(args) => colour::run(args),
        Calibrate::Flash(args) => flash::flash(args),
        Calibrate::Saturation(args) => saturation(args),
        Calibrate::Repeatability(args) => repeatability(args),
    }
}

fn repeatability(args: &RepeatabilityArgs) -> CliResult {
    if !args.frames.is_empty() {
        return flash::from_frames(&args.session, &args.frames, args.json);
    }
    let session = open_session(&args.session)?;
    let (source, studio) = args.devices.prepare()?;
    if let Some(studio) = &studio {
        studio.show_card(1.0).map_err(CliError::new)?;
    }
    let events = Events::default();
    let engine = Engine::new(source, Limits::default(), events.clone());
    let (bar, progress) = progress_bar::watched();
    tell_of_recovery(&events, bar.clone())?;
    let result = engine.repeatability(&session, args.shots, &progress);
    bar.finish_and_clear();
    let result = result.map_err(CliError::new)?;
    println!("{}", words_on_repeatability(&result));
    let percent = |part: f64| format!("{:.3} %", 100.0 * part);
    println!(
        "standard errors {} and {}; the sensor's noise is {} of both; measured energies: {}",
        percent(result.spread_error),
        percent(result.corrected_error),
        percent(result.sensor_noise),
        percent(result.energy_spread)
    );
    Ok(Exit::Success)
}

fn saturation(args: &SaturationArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let (bar, progress) = progress_bar::watched();
    let entries = pipeline::saturation::calibrate(&session, &args.frames, &progress);
    bar.finish_and_clear();
    for entry in entries.map_err(CliError::new)? {
        let isos: Vec<String> = entry.isos.iter().map(f64::to_string).collect();
        let [[a, b], [c, d]] = entry.saturation;
        println!(
            "{} ISO {}: {a:.0} {b:.0} / {c:.0} {d:.0} DN, {}",
            entry.model,
            isos.join(", "),
            entry.origin
        );
    }
    Ok(Exit::Success)
}
