//! What to shoot for each calibration, in words: the one source for page, API and terminal.

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
    pub const ALL: [Kind; 6] =
        [Kind::Levels, Kind::Noise, Kind::Exposure, Kind::Flat, Kind::Flash, Kind::Colour];

    /// Its stable name, which is that of its files, too.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Levels => "levels",
            Kind::Noise => "noise",
            Kind::Exposure => "exposure",
            Kind::Flat => "flat",
            Kind::Flash => "flash",
            Kind::Colour => "colour",
        }
    }

    /// How it is made.
    pub fn guide(self) -> &'static Guide {
        match self {
            Kind::Levels => &LEVELS,
            Kind::Noise => &NOISE,
            Kind::Exposure => &EXPOSURE,
            Kind::Flat => &FLAT,
            Kind::Flash => &FLASH,
            Kind::Colour => &COLOUR,
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

    /// Whether it is true of the shots' lens alone.
    pub fn holds_for_lens(self) -> bool {
        matches!(self, Kind::Exposure | Kind::Flat | Kind::Flash)
    }
}

impl std::str::FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Kind::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
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
            Role::Chart => "chart",
            Role::Room => "room",
        }
    }

    /// Whether the flash fires for it.
    pub fn is_lit_by_flash(self) -> bool {
        matches!(self, Role::Card | Role::Chart)
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

const LEVELS: Guide = Guide {
    kind: Kind::Levels,
    title: "Sensor levels",
    gives: "What the sensor reads without light (black) and where it clips (saturation), for every ISO that you shoot. \
            Without it, black comes from the file and saturation from a table or the file.",
    steps: &[
        "Set the camera to M and raw, with the ISO and the shutter time of your photographs.",
        "Put the lens cap on and cover the viewfinder. Take two dark frames or more.",
        "Take the cap off, and fill the frame with something bright and even: a lamp behind paper, a bright window. \
         Over-expose it by three stops or more, and take one blown frame or more.",
        "Do the same for every other ISO in use. A new measurement replaces the one before, so take all of them in \
         one series.",
    ],
    takes: &[
        Take {
            role: Role::Dark,
            name: "Dark frames",
            words: "Lens cap on, viewfinder covered, no flash.",
            count: "2 or more for each ISO",
        },
        Take {
            role: Role::Blown,
            name: "Blown frames",
            words: "A bright, even surface, over-exposed by three stops or more.",
            count: "1 or more for each ISO",
        },
    ],
    command: "unlit calibrate levels SESSION --dark FILE... --blown FILE...",
};

const NOISE: Guide = Guide {
    kind: Kind::Noise,
    title: "Noise and linearity",
    gives: "Electrons per DN, read noise, and how straight the sensor answers to light. Every uncertainty of the model \
            comes from it. Without it, noise is estimated from the photographs.",
    steps: &[
        "Fill the frame with an evenly lit, plain surface, out of focus; camera on a tripod, light that does not flicker.",
        "Start dark: the shortest shutter time at which the surface is not quite black. Take two frames, nothing touched \
         in between.",
        "Lengthen the shutter time by a stop, take two frames, and so on until the frame clips: eight levels of light or \
         more. If you change the light instead, change it by the same number of stops each time, and say so below.",
        "Put the lens cap on and take two dark frames at the same ISO.",
    ],
    takes: &[
        Take {
            role: Role::Even,
            name: "Even frames",
            words: "The lit surface, two frames at every level of light.",
            count: "16 or more, in twos",
        },
        Take {
            role: Role::Dark,
            name: "Dark frames",
            words: "Lens cap on, the same ISO: they make the read noise sure.",
            count: "2",
        },
    ],
    command: "unlit calibrate noise SESSION FILE... --dark FILE... [--stops STOPS]",
};

const EXPOSURE: Guide = Guide {
    kind: Kind::Exposure,
    title: "Exposure table",
    gives: "What a third of a stop on each dial truly does. It is used wherever two frames have different settings. \
            Without it, the labels are believed.",
    steps: &[
        "Put up a plain grey or white card, light it evenly and steadily (daylight lamps, no flicker); camera on a tripod, \
         focus locked.",
        "Find the brightest exposure at which nothing of the card clips.",
        "Turn one dial from dark to bright in thirds of a stop, and take one frame at every step, nothing else \
         touched. Six stops are enough.",
        "Do the same with the other two dials; the light may change from one dial to the next.",
    ],
    takes: &[Take {
        role: Role::Step,
        name: "Steps",
        words: "One frame at every third of a stop, in order, one dial after the other.",
        count: "about 19 for each dial",
    }],
    command: "unlit calibrate exposure SESSION FILE...",
};

const FLAT: Guide = Guide {
    kind: Kind::Flat,
    title: "Vignetting",
    gives: "How the lens darkens towards the corners, at one aperture and focal length. With it, the flash's own lobe can \
            be told from the lens's darkening.",
    steps: &[
        "Set aperture and focal length as for your photographs.",
        "Fill the frame with something evenly lit, out of focus: an overcast sky, a white wall far from its lamps, a \
         light table, or a diffuser before the lens. The middle of the frame at about half of saturation.",
        "Take five frames or more, and turn the camera by 90 and 180 degrees between them, so that what is uneven in the \
         light averages out.",
    ],
    takes: &[Take {
        role: Role::Even,
        name: "Even frames",
        words: "The even surface, the camera turned between frames.",
        count: "5 or more",
    }],
    command: "unlit calibrate flat SESSION FILE...",
};

const FLASH: Guide = Guide {
    kind: Kind::Flash,
    title: "Flash",
    gives: "How much light the flash throws, where, and how it falls off with distance. No model can be made without it.",
    steps: &[
        "Put a flat, matt white card before the camera, square to it, so that it fills the frame.",
        "Set aperture, ISO and power of the flash as for your photographs. The shutter may differ: a flash is an \
         energy, not a power.",
        "Measure from the lens to the card, and take the card three times: each time a frame without flash and one \
         with it.",
        "Do the same at three distances or more, from the nearest at which nothing clips to the farthest at which you \
         photograph.",
    ],
    takes: &[Take {
        role: Role::Card,
        name: "Card shots",
        words: "The card at a known distance, with and without flash.",
        count: "3 at each of 3 distances or more",
    }],
    command: "unlit calibrate flash SESSION --ring-radii IN,OUT --shots DIST_M=FILE[,OFF]...",
};

const COLOUR: Guide = Guide {
    kind: Kind::Colour,
    title: "Colour",
    gives: "How the camera's own colours become linear sRGB and ACEScg. Without it, the camera maker's matrix is used.",
    steps: &[
        "Lay a ColorChecker 24 or a SpyderCHECKR 24 where the object will be: flat, whole in the frame, in focus, free of \
         reflections.",
        "Expose so that its white patch does not clip.",
        "Take it lit by the flash. Where the room is not dark, take it once more without flash, nothing moved.",
    ],
    takes: &[
        Take {
            role: Role::Chart,
            name: "Chart, lit by the flash",
            words: "The whole chart, at any angle.",
            count: "1",
        },
        Take {
            role: Role::Room,
            name: "Chart without flash",
            words: "The same frame in the room's light alone, where the room is not dark.",
            count: "1, or none",
        },
    ],
    command: "unlit calibrate colour SESSION FILE [--off FILE]",
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_guide_tells_what_to_do_and_knows_its_kind() {
        for kind in Kind::ALL {
            let guide = kind.guide();
            assert_eq!((guide.kind, kind.name().parse()), (kind, Ok(kind)));
            assert!(guide.steps.len() >= 3 && !guide.takes.is_empty(), "{kind:?}");
            assert!(guide.command.starts_with(&format!("unlit calibrate {} SESSION", kind.name())));
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
