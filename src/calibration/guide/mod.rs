//! What to shoot for each calibration, in words: the one source for page, API and terminal. What is still missing, and what
//! is wrong with a shot, is told by [`Kind::lacks`] and [`Kind::fault`].

mod lacks;
mod texts;

pub use lacks::Seen;

use serde::{Deserialize, Serialize};

/// What can be calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Black and saturation of the sensor.
    Levels,
    /// Gain, read noise, linearity.
    Noise,
    /// What the steps of ISO, shutter and aperture truly do.
    Exposure,
    /// Vignetting.
    Flat,
    /// The flash.
    Flash,
    /// How far the flash differs from shot to shot.
    Steadiness,
    /// Camera RGB to linear sRGB and ACEScg.
    Colour,
}

/// As what a frame was shot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// With the lens cap on.
    Dark,
    /// Over-exposed by far.
    Blown,
    /// Evenly lit.
    Even,
    /// One step of a ladder of exposures.
    Step,
    /// The white card, lit by the flash; its frame without flash goes with it.
    Card,
    /// A plain surface, lit by the flash.
    Lit,
    /// The colour chart, lit by the flash.
    Chart,
    /// The colour chart in the room's light alone.
    Room,
}

/// Frames of one role.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Take {
    /// The role.
    pub role: Role,
    /// What such frames are called.
    pub name: &'static str,
    /// How to take one.
    pub words: &'static str,
    /// How many are wanted.
    pub count: &'static str,
    /// The same as a number; 0 where none is needed.
    pub wanted: usize,
}

/// How one calibration is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guide {
    /// Of what.
    pub kind: Kind,
    /// Its name for people.
    pub title: &'static str,
    /// What it tells, and what for.
    pub gives: &'static str,
    /// What to do, in order.
    pub steps: &'static [&'static str],
    /// The frames that it takes.
    pub takes: &'static [Take],
    /// How the same is done from files in a terminal.
    pub command: &'static str,
}

impl Kind {
    /// All, in the order in which they are best made.
    pub const ALL: [Kind; 7] =
        [Kind::Levels, Kind::Noise, Kind::Exposure, Kind::Flat, Kind::Flash, Kind::Steadiness, Kind::Colour];

    /// Its stable name, which is that of its files, too.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Levels => "levels",
            Kind::Noise => "noise",
            Kind::Exposure => "exposure",
            Kind::Flat => "flat",
            Kind::Flash => "flash",
            Kind::Steadiness => "steadiness",
            Kind::Colour => "colour",
        }
    }

    /// What `unlit calibrate` calls it.
    pub fn command_name(self) -> &'static str {
        match self {
            Kind::Steadiness => "repeatability",
            other => other.name(),
        }
    }

    /// How it is made.
    pub fn guide(self) -> &'static Guide {
        match self {
            Kind::Levels => &texts::LEVELS,
            Kind::Noise => &texts::NOISE,
            Kind::Exposure => &texts::EXPOSURE,
            Kind::Flat => &texts::FLAT,
            Kind::Flash => &texts::FLASH,
            Kind::Steadiness => &texts::STEADINESS,
            Kind::Colour => &texts::COLOUR,
        }
    }

    /// The role of a frame: the one that is named, if frames of this kind can have it; without a name the only one
    /// there is. The error is a sentence.
    pub fn role(self, named: Option<Role>) -> Result<Role, String> {
        let takes = self.guide().takes;
        match (named, takes) {
            (Some(role), _) if takes.iter().any(|take| take.role == role) => Ok(role),
            (None, [only]) => Ok(only.role),
            _ => {
                let names: Vec<&str> = takes.iter().map(|take| take.role.name()).collect();
                Err(format!("role must be {} for frames of {}", names.join(" or "), self.name()))
            }
        }
    }

    /// Whether it is true of the shots' ISO alone.
    pub fn holds_for_iso(self) -> bool {
        matches!(self, Kind::Levels | Kind::Noise | Kind::Flash)
    }

    /// Whether it is true of the shots' aperture alone.
    pub fn holds_for_aperture(self) -> bool {
        matches!(self, Kind::Flat | Kind::Flash)
    }

    /// Whether it is true of the shots' polariser alone.
    pub fn holds_for_polariser(self) -> bool {
        !matches!(self, Kind::Levels | Kind::Noise)
    }

    /// Whether it is true of the shots' flash power alone.
    pub fn holds_for_power(self) -> bool {
        matches!(self, Kind::Flash | Kind::Steadiness)
    }

    /// Whether it is true of the shots' lens alone.
    pub fn holds_for_lens(self) -> bool {
        matches!(self, Kind::Exposure | Kind::Flat | Kind::Flash)
    }
}

impl std::str::FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let called = |kind: &Kind| [kind.name(), kind.command_name()].contains(&text);
        Kind::ALL.into_iter().find(called).ok_or_else(|| {
            let names: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
            format!("there is no calibration {text:?}; there are {}", names.join(", "))
        })
    }
}

impl Role {
    /// Its stable name.
    pub fn name(self) -> &'static str {
        match self {
            Role::Dark => "dark",
            Role::Blown => "blown",
            Role::Even => "even",
            Role::Step => "step",
            Role::Card => "card",
            Role::Lit => "lit",
            Role::Chart => "chart",
            Role::Room => "room",
        }
    }

    /// Whether the flash fires for it.
    pub fn is_lit_by_flash(self) -> bool {
        matches!(self, Role::Card | Role::Lit | Role::Chart)
    }
}

impl Guide {
    /// All of it as plain text.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n\n{}\n\n", self.title, self.gives);
        for (n, step) in self.steps.iter().enumerate() {
            text += &format!("{}. {step}\n", n + 1);
        }
        text += "\nFrames:\n";
        for take in self.takes {
            text += &format!("- {} ({}): {}\n", take.name, take.count, take.words);
        }
        text + &format!("\n    {}\n", self.command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_guide_tells_what_to_do_and_knows_its_kind() {
        for kind in Kind::ALL {
            let guide = kind.guide();
            assert_eq!((guide.kind, kind.name().parse()), (kind, Ok(kind)));
            assert_eq!(kind.command_name().parse(), Ok(kind));
            assert!(guide.steps.len() >= 3 && !guide.takes.is_empty(), "{kind:?}");
            assert!(guide.command.starts_with(&format!("unlit calibrate {} SESSION", kind.command_name())));
            let text = guide.text();
            for step in guide.steps {
                assert!(step.ends_with('.') && !step.contains("  ") && text.contains(step), "{step}");
            }
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert!("saturation".parse::<Kind>().unwrap_err().contains("levels, noise"));
    }

    #[test]
    fn a_role_is_asked_for_only_where_there_are_several() {
        assert_eq!(Kind::Exposure.role(None), Ok(Role::Step));
        assert_eq!(Kind::Levels.role(Some(Role::Blown)), Ok(Role::Blown));
        for wrong in [Kind::Levels.role(None), Kind::Levels.role(Some(Role::Chart))] {
            assert_eq!(wrong.unwrap_err(), "role must be dark or blown for frames of levels");
        }
        assert!(Kind::Flat.role(Some(Role::Dark)).is_err());
    }
}
