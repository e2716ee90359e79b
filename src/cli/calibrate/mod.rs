//! `unlit calibrate`: measures the rig from calibration shots.

mod levels;
mod noise;

use crate::calibration::{Record, Shot, Verdict};
use crate::capture::{Engine, Events, words_on_repeatability};
use crate::cli::devices::DeviceArgs;
use crate::cli::settings::ConfigArgs;
use crate::cli::shoot::tell_of_recovery;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pair::Limits;
use crate::pipeline::flash::{CardFacts, CardFiles, calibrate};
use std::path::PathBuf;

/// What to calibrate.
#[derive(clap::Subcommand)]
pub(super) enum Calibrate {
    /// The flash, from shots of a white card that fills the frame and faces the camera.
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
    /// How steady the flash is: shoots a plain surface again and again, nothing changed, with a flash controller.
    Repeatability(RepeatabilityArgs),
}

/// Arguments of `unlit calibrate repeatability`.
#[derive(clap::Args)]
pub(super) struct RepeatabilityArgs {
    /// Session folder. Only figures are kept in it, no frames.
    session: PathBuf,
    /// How many shots to take, each a frame without flash and one with; 8 or more.
    #[arg(long, value_name = "N", default_value_t = 40)]
    shots: usize,
    /// With `--studio` the white card stands 1 m before the lens.
    #[command(flatten)]
    devices: DeviceArgs,
    #[command(flatten)]
    _config: ConfigArgs,
}

/// Arguments of `unlit calibrate flash`.
#[derive(clap::Args)]
pub(super) struct FlashArgs {
    /// Session folder.
    session: PathBuf,
    /// The card's diffuse reflectance; office paper has about 0.94 but is not quite Lambertian.
    #[arg(long, value_name = "RHO", default_value_t = 0.94)]
    target_reflectance: f64,
    /// Inner and outer radius of the flash's luminous ring in metres.
    #[arg(long, value_name = "IN,OUT", value_parser = radii)]
    ring_radii: [f64; 2],
    /// Shots: distance in metres from the lens to the card, and the lit frame; after a comma the unlit frame,
    /// where the room was not dark. All at one aperture and ISO, at two distances or more.
    #[arg(long, value_name = "DIST_M=FILE[,OFF]", num_args = 1.., required = true, value_parser = shot)]
    shots: Vec<CardFiles>,
    /// Focal length in pixels, where no scene is imported yet: focal length in mm * image width in pixels /
    /// sensor width in mm.
    #[arg(long, value_name = "PX")]
    focal_px: Option<f64>,
}

fn radii(text: &str) -> Result<[f64; 2], String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|p| p.trim().parse().ok()).collect();
    <[f64; 2]>::try_from(parts.unwrap_or_default())
        .map_err(|_| "give inner and outer radius in metres, for example 0.035,0.085".into())
}

fn shot(text: &str) -> Result<CardFiles, String> {
    let wrong = || format!("{text:?} is not DISTANCE=FILE, for example 0.8=card80.cr2");
    let (distance, files) = text.split_once('=').ok_or_else(wrong)?;
    let distance = distance.trim().parse().map_err(|_| wrong())?;
    let (on, off) = match files.split_once(',') {
        Some((on, off)) => (on, Some(PathBuf::from(off))),
        None => (files, None),
    };
    Ok(CardFiles { distance, on: on.into(), off })
}

pub(super) fn run(what: &Calibrate) -> CliResult {
    match what {
        Calibrate::Flash(args) => flash(args),
        Calibrate::Levels(args) => levels::run(args),
        Calibrate::Noise(args) => noise::run(args),
        Calibrate::Repeatability(args) => repeatability(args),
    }
}

fn repeatability(args: &RepeatabilityArgs) -> CliResult {
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

fn flash(args: &FlashArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let facts = CardFacts {
        target_reflectance: args.target_reflectance,
        ring_radii: args.ring_radii,
        focal_px: args.focal_px,
    };
    let (bar, progress) = progress_bar::watched();
    let fit = calibrate(&session, &args.shots, facts, &progress);
    bar.finish_and_clear();
    let fit = fit.map_err(CliError::new)?;
    println!("{:<28}{:>10}{:>12}{:>12}{:>10}", "card shot", "distance", "flash gain", "residual", "clipped");
    for shot in &fit.shots {
        let (gain, rms) = match shot.used {
            true => (format!("{:.4}", shot.gain), format!("{:.2} %", 100.0 * shot.rms)),
            false => ("left out".into(), String::new()),
        };
        let clipped = 100.0 * shot.clipped;
        println!("{:<28}{:>8} m{gain:>12}{rms:>12}{clipped:>8.1} %", shot.label, shot.distance);
    }
    let [r, g, b] = fit.radiance;
    println!("radiance of the ring: {r:.0} {g:.0} {b:.0} DN (R G B)");
    if let Some([r, g, b]) = fit.radiance_error {
        println!("standard error:       {r:.0} {g:.0} {b:.0} DN");
    }
    let [a1, a2, a3] = fit.field.coefficients;
    println!("vignetting times lobe: 1 {a1:+.4} q {a2:+.4} q^2 {a3:+.4} q^3, q = (r / half diagonal)^2");
    println!("noise: variance = {:.4} DN * signal + {:.2} DN^2", fit.noise.gain, fit.noise.floor);
    println!("residual over all shots: {:.2} %", 100.0 * fit.rms);
    Ok(Exit::Success)
}
