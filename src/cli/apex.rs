//! `unlit apex`: exposure values, and the factor between two exposures.

use super::{CliError, CliResult, Exit};
use crate::photometry::apex::{Apex, ExposureScale, METER_CONSTANT, Nominal};
use crate::units::{FNumber, Iso, Seconds};
use serde::Serialize;
use std::str::FromStr;

/// Arguments of `unlit apex`.
///
/// Example: `unlit apex --shutter 1/150 --aperture 8 --iso 100 --to shutter=1/100,iso=800` says that the first
/// photograph is multiplied by 12 to match the second.
#[derive(clap::Args)]
pub(super) struct Args {
    /// Exposure time in seconds, as 1/125 or 0.5.
    #[arg(long, value_name = "SECONDS", value_parser = fraction)]
    shutter: f64,
    /// Relative aperture, as 11 or f/11.
    #[arg(long, value_name = "N", value_parser = f_number)]
    aperture: f64,
    /// Sensitivity.
    #[arg(long, value_name = "ISO", value_parser = number)]
    iso: f64,
    /// A second exposure, to give the factor from the first to it: what differs, as shutter=1/100,iso=800.
    #[arg(long, value_name = "WHAT=VALUE,...")]
    to: Option<Changes>,
    /// Reflected-light meter constant K, cd s / (m^2 ISO).
    #[arg(long, value_name = "K", value_parser = number, default_value_t = METER_CONSTANT)]
    meter_constant: f64,
    /// Everything as JSON.
    #[arg(long)]
    json: bool,
}

/// Settings of the second exposure that differ.
#[derive(Clone, Copy, Default)]
struct Changes {
    shutter: Option<f64>,
    aperture: Option<f64>,
    iso: Option<f64>,
}

impl FromStr for Changes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut changes = Self::default();
        for part in text.split(',') {
            let wrong = || {
                format!(
                    "{part:?} is not shutter=, aperture= or iso= with a value, such as shutter=1/100,iso=800"
                )
            };
            let (what, value) = part.split_once('=').ok_or_else(wrong)?;
            let (place, value) = match what.trim() {
                "shutter" => (&mut changes.shutter, fraction(value)?),
                "aperture" => (&mut changes.aperture, f_number(value)?),
                "iso" => (&mut changes.iso, number(value)?),
                _ => return Err(wrong()),
            };
            if place.replace(value).is_some() {
                return Err(format!("{} is given twice; give it once", what.trim()));
            }
        }
        Ok(changes)
    }
}

fn number(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    value.ok_or_else(|| format!("{text:?} is no number greater than 0"))
}

fn f_number(text: &str) -> Result<f64, String> {
    number(text.trim().trim_start_matches("f/"))
}

fn fraction(text: &str) -> Result<f64, String> {
    let text = text.trim().trim_end_matches('s');
    match text.split_once('/') {
        Some((above, below)) => Ok(number(above)? / number(below)?),
        None => number(text),
    }
}

/// One exposure with its values.
#[derive(Serialize)]
struct Exposure {
    shutter_s: f64,
    aperture: f64,
    iso: f64,
    #[serde(flatten)]
    apex: Apex,
}

/// What the first photograph is multiplied by to match the second.
#[derive(Serialize)]
struct Factors {
    /// In steady light, by the figures as they are written.
    room: f64,
    /// In steady light, by the steps that the labels stand for.
    room_by_steps: f64,
    /// A flash's light, by the figures as they are written.
    flash: f64,
    /// A flash's light, by the steps that the labels stand for.
    flash_by_steps: f64,
}

#[derive(Serialize)]
struct Output {
    #[serde(flatten)]
    exposure: Exposure,
    #[serde(skip_serializing_if = "Option::is_none")]
    to: Option<Exposure>,
    #[serde(skip_serializing_if = "Option::is_none")]
    factor: Option<Factors>,
}

pub(super) fn run(args: &Args) -> CliResult {
    let exposure = |shutter_s: f64, aperture: f64, iso: f64| {
        let apex = Apex::of(Seconds(shutter_s), FNumber(aperture), Iso(iso), args.meter_constant);
        Exposure { shutter_s, aperture, iso, apex }
    };
    let first = exposure(args.shutter, args.aperture, args.iso);
    let second = args.to.map(|to| {
        let Changes { shutter, aperture, iso } = to;
        let (shutter, aperture) = (shutter.unwrap_or(args.shutter), aperture.unwrap_or(args.aperture));
        exposure(shutter, aperture, iso.unwrap_or(args.iso))
    });
    let factor = second.as_ref().map(|second| factors(&first, second));
    let output = Output { exposure: first, to: second, factor };
    match args.json {
        true => println!("{}", serde_json::to_string_pretty(&output).map_err(CliError::new)?),
        false => print!("{}", human(&output)),
    }
    Ok(Exit::Success)
}

fn factors(first: &Exposure, second: &Exposure) -> Factors {
    let room = |e: &Exposure| Nominal.room(Seconds(e.shutter_s), FNumber(e.aperture), Iso(e.iso));
    let flash = |e: &Exposure| Nominal.flash(FNumber(e.aperture), Iso(e.iso));
    Factors {
        room: first.apex.factor_to(&second.apex),
        room_by_steps: room(second) / room(first),
        flash: first.apex.flash_factor_to(&second.apex),
        flash_by_steps: flash(second) / flash(first),
    }
}

fn human(output: &Output) -> String {
    let mut text = of_one(&output.exposure);
    if let Some(second) = &output.to {
        text += "\n";
        text += &of_one(second);
    }
    if let Some(Factors { room, room_by_steps, flash, flash_by_steps }) = output.factor {
        text += "\nto match the second, the first is multiplied by\n";
        text += &format!("{:<14}{:>12}{:>24}\n", "", "as written", "by the labels' steps");
        text += &format!("{:<14}{room:>12.4}{room_by_steps:>24.4}\n", "room's light");
        text += &format!("{:<14}{flash:>12.4}{flash_by_steps:>24.4}\n", "flash's light");
    }
    text
}

fn of_one(exposure: &Exposure) -> String {
    let Exposure { shutter_s, aperture, iso, apex } = exposure;
    let title = format!("{}, {}, {}\n", Seconds(*shutter_s), FNumber(*aperture), Iso(*iso));
    let rows = [
        ("Av", apex.aperture_value, "log2(N^2)"),
        ("Tv", apex.time_value, "log2(1/t)"),
        ("Sv", apex.speed_value, "log2(2^(-7/4) ISO)"),
        ("EV", apex.exposure_value, "Av + Tv"),
        ("Bv", apex.brightness_value, "EV - Sv"),
    ];
    let rows: String =
        rows.iter().map(|(name, value, how)| format!("{name:<4}{value:>10.4}  {how}\n")).collect();
    format!("{title}{rows}metered luminance {:.4} cd/m^2\n", apex.luminance_cd_m2)
}
