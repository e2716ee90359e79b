//! `unlit calibrate flash`, and `unlit calibrate repeatability` from frames.

use crate::calibration::{FlashCalibration, Plane, Record, Verdict};
use crate::cli::lighting::LightingArgs;
use crate::cli::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::pipeline::flash::{CardFiles, FlashOrder, calibrate, correct};
use crate::pipeline::steadiness::{self, SteadyFile};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Arguments of `unlit calibrate flash`.
#[derive(clap::Args)]
pub(in crate::cli) struct FlashArgs {
    /// Session folder.
    session: PathBuf,
    /// The card's diffuse reflectance. Without it, office paper's 0.94 is assumed, which is neither measured nor quite
    /// Lambertian.
    #[arg(long, value_name = "RHO")]
    target_reflectance: Option<f64>,
    /// How the card's reflectance goes with the angle from its normal, where it is known: degrees and the factor on
    /// --target-reflectance, rising, for example 0:1 20:0.99 40:0.97.
    #[arg(long, value_name = "DEG:FACTOR", num_args = 1.., value_parser = curve_point)]
    target_curve: Vec<[f64; 2]>,
    /// Inner and outer radius of the flash's luminous ring in metres.
    #[arg(long, value_name = "IN,OUT", value_parser = radii, required_unless_present = "one_shot")]
    ring_radii: Option<[f64; 2]>,
    /// Lets the shots tell the radii where they can (shots near the card), in place of the ruler.
    #[arg(long)]
    fit_radii: bool,
    /// Corrects the session's flash calibration by one shot at the flash's new power, in place of a new series: its
    /// radiances are multiplied by the factor by which the shot differs from a render, and a second render must be within
    /// 0.02 % of the shot. The calibration before is kept beside it.
    #[arg(long, conflicts_with_all = ["ring_radii", "fit_radii", "hold_out", "hold_out_every", "vignetting"])]
    one_shot: bool,
    /// Shots: distance in metres from the lens to the card, and the lit frame; after a comma the unlit frame,
    /// where the room was not dark. All at one aperture and ISO, at two distances or more. A card that does not face the
    /// camera: its distance along the lens's axis and its normal towards the camera (x right, y down, z forward), as in
    /// 0.8@0.1,0,-1=card.cr2. With --tag-size the file alone will do.
    #[arg(long, value_name = "[DIST_M=]FILE[,OFF]", num_args = 1.., required = true, value_parser = shot)]
    shots: Vec<CardFiles>,
    /// Side in metres of the black squares of AprilTags (family tag36h11) on the card. They tell where the card stands, in
    /// any pose, where no distance is given; where one is, it is compared with theirs.
    #[arg(long, value_name = "METRES", value_parser = metres)]
    tag_size: Option<f64>,
    /// How far the paper that a tag is printed on reaches beyond its black square, where it is not the card itself. An
    /// eighth of --tag-size, the tag's white border, if it is not given.
    #[arg(long, value_name = "METRES", value_parser = metres, requires = "tag_size")]
    tag_outset: Option<f64>,
    /// Lit frames among the shots to keep from the fit; it is then checked by how well it predicts them.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with = "hold_out_every")]
    hold_out: Vec<PathBuf>,
    /// Keeps every K-th shot from the fit, to check it.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..))]
    hold_out_every: Option<u32>,
    /// Coefficients of the lens's vignetting 1 + a1 q + a2 q^2 + a3 q^3, q = (r / half diagonal)^2, at this aperture, where
    /// a flat field told them. By default that of `unlit calibrate flat`, if the session has one of this lens and
    /// aperture. Only then can the flash's own lobe be told.
    #[arg(long, value_name = "A1,A2,A3", value_parser = coefficients, allow_hyphen_values = true)]
    vignetting: Option<[f64; 3]>,
    /// Focal length in pixels, where no scene is imported yet: focal length in mm * image width in pixels /
    /// sensor width in mm.
    #[arg(long, value_name = "PX")]
    focal_px: Option<f64>,
    #[command(flatten)]
    lighting: LightingArgs,
    /// Prints the record as JSON.
    #[arg(long)]
    json: bool,
}

fn radii(text: &str) -> Result<[f64; 2], String> {
    numbers(text).ok_or_else(|| "give inner and outer radius in metres, for example 0.035,0.085".into())
}

fn metres(text: &str) -> Result<f64, String> {
    let metres = text.trim().parse().ok().filter(|m: &f64| m.is_finite() && *m > 0.0);
    metres.ok_or_else(|| "give metres, greater than 0, for example 0.05".into())
}

fn coefficients(text: &str) -> Result<[f64; 3], String> {
    numbers(text).ok_or_else(|| "give three coefficients, for example -0.11,-0.02,0".into())
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let parts: Option<Vec<f64>> = text.split(',').map(|p| p.trim().parse().ok()).collect();
    parts?.try_into().ok()
}

fn curve_point(text: &str) -> Result<[f64; 2], String> {
    let point = text
        .split_once(':')
        .and_then(|(angle, factor)| Some([angle.trim().parse().ok()?, factor.trim().parse().ok()?]));
    point.ok_or_else(|| format!("{text:?} is not DEGREES:FACTOR, for example 20:0.99"))
}

fn shot(text: &str) -> Result<CardFiles, String> {
    let wrong = || format!("{text:?} is not DISTANCE=FILE, for example 0.8=card80.cr2");
    let (place, files) = match text.split_once('=') {
        Some((place, files)) => (Some(place), files),
        None => (None, text),
    };
    let plane = |place: &str| {
        let (distance, normal) = match place.split_once('@') {
            Some((distance, normal)) => (distance, DVec3::from_array(numbers(normal)?)),
            None => (place, -DVec3::Z),
        };
        let distance: f64 = distance.trim().parse().ok()?;
        Some(Plane { point: distance * DVec3::Z, normal: normal.try_normalize()? })
    };
    let plane = place.map(|place| plane(place).ok_or_else(wrong)).transpose()?;
    let (on, off) = match files.split_once(',') {
        Some((on, off)) => (on, Some(PathBuf::from(off))),
        None => (files, None),
    };
    Ok(CardFiles { plane, on: on.into(), off, held_out: false })
}

/// The shots with those marked that are kept from the fit.
fn marked(args: &FlashArgs) -> Result<Vec<CardFiles>, CliError> {
    let mut shots = args.shots.clone();
    for (i, shot) in shots.iter_mut().enumerate() {
        let every = args.hold_out_every.is_some_and(|k| (i + 1) % k as usize == 0);
        shot.held_out = every || args.hold_out.contains(&shot.on);
    }
    match args.hold_out.iter().find(|file| !shots.iter().any(|s| s.on == **file)) {
        Some(stranger) => Err(CliError::new(NotAShot(stranger.clone()))),
        None => Ok(shots),
    }
}

/// A frame to keep from the fit that is none of the shots.
#[derive(Debug, thiserror::Error)]
#[error("--hold-out {} is none of the lit frames in --shots; give it there with its distance too", .0.display())]
struct NotAShot(PathBuf);

/// An order that cannot be.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Refused(String);

pub(super) fn flash(args: &FlashArgs) -> CliResult {
    let session = open_session(&args.session)?;
    let order = FlashOrder {
        target_reflectance: args.target_reflectance,
        target_curve: args.target_curve.clone(),
        ring_radii: args.ring_radii,
        fit_radii: args.fit_radii,
        focal_px: args.focal_px,
        tag_size_m: args.tag_size,
        tag_outset_m: args.tag_outset,
        vignetting: args.vignetting,
        // Shots are marked by their files here.
        held_out: vec![],
        one_shot: args.one_shot.then(String::new),
        lighting: Some(args.lighting.over(session.manifest().lighting)),
    };
    order.checked().map_err(|words| CliError::new(Refused(words)))?;
    let facts = order.facts();
    let shots = marked(args)?;
    let (bar, progress) = progress_bar::watched();
    let record = match args.one_shot {
        true => correct(&session, &shots, &facts, &progress),
        false => calibrate(&session, &shots, &facts, &progress),
    };
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&record).map_err(CliError::new)?);
        return Ok(Exit::Success);
    }
    tell(&record);
    Ok(Exit::Success)
}

fn say(verdict: &Verdict) {
    verdict.sentences.iter().for_each(|sentence| println!("{sentence}"));
    println!();
}

fn tell(record: &Record<FlashCalibration>) {
    let fit = &record.fit;
    say(&record.verdict);
    println!(
        "{:<28}{:>10}{:>12}{:>12}{:>12}{:>10}",
        "card shot", "distance", "flash gain", "residual", "prediction", "clipped"
    );
    for card in &fit.cards {
        let gain = card.gain.map_or_else(|| "left out".into(), |gain| format!("{gain:.4}"));
        let rms = card.residual_rms.map_or_else(String::new, |rms| format!("{:.2} %", 100.0 * rms));
        let off = card.prediction_error.map_or_else(String::new, |e| format!("{:+.2} %", 100.0 * e));
        let mark = if card.held_out { "  kept from the fit" } else { "" };
        let (distance, clipped) = (card.distance_m, 100.0 * card.clipped_share);
        println!("{:<28}{distance:>8.3} m{gain:>12}{rms:>12}{off:>12}{clipped:>8.1} %{mark}", card.label);
    }
    let [r, g, b] = fit.radiance_dn;
    println!("radiance of the ring: {r:.0} {g:.0} {b:.0} DN (R G B)");
    if let Some(intervals) = fit.radiance_dn_interval_95 {
        let ends = intervals.map(|[low, high]| format!("{low:.0} to {high:.0}"));
        println!("95 % intervals:       {} DN", ends.join(", "));
    }
    let [a1, a2, a3] = fit.field.coefficients;
    let field = if fit.findings.vignetting_given { "vignetting as given" } else { "vignetting times lobe" };
    println!("{field}: 1 {a1:+.4} q {a2:+.4} q^2 {a3:+.4} q^3, q = (r / half diagonal)^2");
    println!("flash's jitter: {:.2} %", 100.0 * fit.findings.jitter_deviation);
    println!("noise: variance = {:.4} DN * signal + {:.2} DN^2", fit.noise.gain, fit.noise.floor);
    println!(
        "residual over all shots: {:.2} %, of which {:.2} % is not the sensor's noise",
        100.0 * fit.residual_rms,
        100.0 * fit.misfit_rms
    );
}

/// A frame, and after the last equals sign its energy.
pub(super) fn steady_file(text: &str) -> Result<SteadyFile, String> {
    if let Some((frame, energy)) = text.rsplit_once('=')
        && let Ok(energy) = energy.trim().parse::<f64>()
    {
        if !(energy.is_finite() && energy > 0.0) {
            return Err(format!("{text:?}: the energy after = must be greater than 0"));
        }
        return Ok(SteadyFile { frame: frame.into(), energy_counts: Some(energy) });
    }
    Ok(SteadyFile { frame: text.into(), energy_counts: None })
}

/// `unlit calibrate repeatability` from frames.
pub(super) fn from_frames(session: &Path, frames: &[SteadyFile], json: bool) -> CliResult {
    let session = open_session(session)?;
    let (bar, progress) = progress_bar::watched();
    let record = steadiness::calibrate(&session, frames, &progress);
    bar.finish_and_clear();
    let record = record.map_err(CliError::new)?;
    if json {
        println!("{}", serde_json::to_string_pretty(&record).map_err(CliError::new)?);
        return Ok(Exit::Success);
    }
    say(&record.verdict);
    println!("{:<28}{:>12}{:>12}", "frame", "light", "by energy");
    for frame in &record.fit.frames {
        let by = frame.relative_light_by_energy.map_or_else(String::new, |r| format!("{r:.5}"));
        println!("{:<28}{:>12.5}{by:>12}", frame.label, frame.relative_light);
    }
    println!("the sensor's noise is {:.4} % of it", 100.0 * record.fit.sensor_deviation);
    Ok(Exit::Success)
}
