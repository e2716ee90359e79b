//! `unlit calibrate`: measures the rig from calibration shots.

mod colour;
mod exposure;
mod flash;
mod flat;
mod guide;
mod levels;
mod noise;
mod report;
mod take;

use crate::calibration::{Record, Shot, Verdict};
use crate::capture::{Engine, Events, words_on_repeatability};
use crate::cli::devices::DeviceArgs;
use crate::cli::settings::ConfigArgs;
use crate::cli::shoot::tell_of_recovery;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pair::Limits;
use crate::pipeline::steadiness::SteadyFile;
use flash::FlashArgs;
use std::path::PathBuf;

/// What to calibrate.
#[derive(clap::Subcommand)]
pub(super) enum Calibrate {
    /// What to shoot for a calibration, step by step.
    Guide(guide::GuideArgs),
    /// The flash, from shots of a white card that fills the frame and faces the camera.
    ///
    /// Put a flat, matt white card before the camera so that it fills the frame, in a dark room (or with an unlit frame
    /// beside every lit one). Shoot it at three distances or more, from the nearest at which nothing clips to the
    /// farthest at which you photograph, three times each, at one aperture and ISO and one power of the flash. The shutter
    /// may differ: a flash is an energy, not a power.
    Flash(FlashArgs),
    /// Black, read noise and saturation of the sensor, from dark frames (lens cap) and deliberately blown ones.
    ///
    /// Dark frames: lens cap on, viewfinder covered, two frames or more at every ISO in use, with the shutter time of
    /// the photographs. Blown frames: a bright, even surface, over-exposed by three stops or more, one at every ISO in
    /// use; a colour that still does not clip is reported as not reached. Give all frames at once: a new run replaces
    /// what was measured before.
    Levels(levels::LevelsArgs),
    /// Gain, read noise, full well and linearity of the sensor, from pairs of evenly lit frames (photon transfer).
    ///
    /// How to shoot: an evenly lit plain surface, out of focus, camera on a tripod, all automatic off. Two frames at
    /// every light level, from dark to just past clipping, eight levels or more: brighten the light between levels by a
    /// known step (--stops), or leave the light and lengthen the shutter time. Two dark frames (lens cap) of the same ISO
    /// make the read noise sure. Shots may be given in any order.
    Noise(noise::NoiseArgs),
    /// What the steps of ISO, shutter and aperture truly do, from ladders of shots in steady light.
    Exposure(exposure::ExposureArgs),
    /// Vignetting and flat field, from evenly lit frames.
    Flat(flat::FlatArgs),
    /// The camera's colours, from a raw file of a colour chart.
    Colour(colour::ColourArgs),
    /// How steady the flash is: shoots a plain surface again and again, nothing changed, with a flash controller; or from lit frames alone.
    Repeatability(RepeatabilityArgs),
    /// Writes calibration/report.html anew: all calibrations of a session on one page, for the screen and for paper.
    ///
    /// Every calibration writes it anyway; this is for a certificate made since, or a report that was deleted.
    Report(report::ReportArgs),
    /// Takes calibrations over from another session of the same rig, with the shots that they come from.
    Take(take::TakeArgs),
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

pub(super) fn run(what: &Calibrate) -> CliResult {
    match what {
        Calibrate::Guide(args) => guide::run(args),
        Calibrate::Levels(args) => levels::run(args),
        Calibrate::Noise(args) => noise::run(args),
        Calibrate::Exposure(args) => exposure::run(args),
        Calibrate::Flat(args) => flat::run(args),
        Calibrate::Colour(args) => colour::run(args),
        Calibrate::Flash(args) => flash::flash(args),
        Calibrate::Repeatability(args) => repeatability(args),
        Calibrate::Report(args) => report::run(args),
        Calibrate::Take(args) => take::run(args),
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
    result.verdict().sentences.iter().for_each(|sentence| println!("{sentence}"));
    Ok(Exit::Success)
}

/// The record as JSON on stdout, and nothing else there.
fn print_json<T: serde::Serialize>(record: &Record<T>) -> CliResult {
    println!("{}", serde_json::to_string_pretty(record).map_err(CliError::new)?);
    Ok(Exit::Success)
}

/// The verdict in words, and every shot that was left out.
fn print_verdict(verdict: &Verdict, shots: &[Shot]) {
    verdict.sentences.iter().for_each(|sentence| println!("{sentence}"));
    for shot in shots {
        if let Some(why) = &shot.left_out {
            println!("left out: {}: {why}", shot.file);
        }
    }
    println!();
}
