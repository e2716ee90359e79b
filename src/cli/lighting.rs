//! What the operator tells of polariser and flash power, alike in every command that needs it.

use super::CliError;
use crate::pair::{Lighting, Polariser};
use crate::session::Session;
use std::str::FromStr;

/// Polariser and flash power; what is not given stays as the session has it.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct LightingArgs {
    /// The polariser before the lens: its angle in degrees as its ring is read, `untold` for one whose angle nobody read, or
    /// `none`. A calibration with a polariser holds for photographs through the same one at the same angle.
    #[arg(long, value_name = "DEGREES|none", allow_negative_numbers = true)]
    polariser: Option<Told>,
    /// Power that the flash is set to, of its full power: 1/4 or 0.25. At another one than the calibration's, pairs are
    /// processed only where the flash controller measured the energies of both.
    #[arg(long, value_name = "PART", value_parser = power)]
    flash_power: Option<f64>,
}

/// A polariser, or that there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Told(Option<Polariser>);

impl FromStr for Told {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let of = |angle_degrees| Ok(Told(Some(Polariser { angle_degrees })));
        match text {
            "none" => Ok(Told(None)),
            "untold" => of(None),
            number => match number.parse::<f64>() {
                Ok(angle) if angle.abs() <= 360.0 => of(Some(angle)),
                _ => Err("give an angle in degrees from -360 to 360, untold, or none".into()),
            },
        }
    }
}

fn power(text: &str) -> Result<f64, String> {
    let number = |t: &str| t.trim().parse::<f64>().ok();
    let part = match text.split_once('/') {
        Some((over, under)) => number(over).zip(number(under)).map(|(over, under)| over / under),
        None => number(text),
    };
    let wrong = || "give a part of the flash's full power, as 1/4 or 0.25, above 0 and at most 1".into();
    part.filter(|p| *p > 0.0 && *p <= 1.0).ok_or_else(wrong)
}

impl LightingArgs {
    /// What was given, and the rest as it was.
    pub(super) fn over(&self, before: Lighting) -> Lighting {
        Lighting {
            polariser: self.polariser.map_or(before.polariser, |Told(polariser)| polariser),
            flash_power: self.flash_power.or(before.flash_power),
        }
    }

    /// Tells the session of it.
    pub(super) fn tell(&self, session: &Session) -> Result<(), CliError> {
        session.set_lighting(self.over(session.manifest().lighting)).map_err(CliError::new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polarisers_and_powers_are_read_and_what_is_not_told_stays() {
        let at = |angle| Some(Polariser { angle_degrees: angle });
        for (text, wanted) in
            [("30", at(Some(30.0))), ("-7.5", at(Some(-7.5))), ("untold", at(None)), ("none", None)]
        {
            assert_eq!(text.parse::<Told>(), Ok(Told(wanted)), "{text}");
        }
        assert!(
            "crossed".parse::<Told>().is_err()
                && "400".parse::<Told>().is_err()
                && "NaN".parse::<Told>().is_err()
        );
        assert_eq!((power("1/4"), power("0.25"), power("1")), (Ok(0.25), Ok(0.25), Ok(1.0)));
        for wrong in ["0", "2", "1/0", "full", "-1/4", ""] {
            assert!(power(wrong).is_err(), "{wrong}");
        }
        let before = Lighting { polariser: at(Some(30.0)), flash_power: Some(0.5) };
        assert_eq!(LightingArgs::default().over(before), before);
        let told = LightingArgs { polariser: Some(Told(None)), flash_power: None };
        assert_eq!(told.over(before), Lighting { polariser: None, flash_power: Some(0.5) });
    }
}
