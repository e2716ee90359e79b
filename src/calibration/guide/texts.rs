//! The guides' texts.

use super::{Guide, Kind, Role, Take};

pub(super) const LEVELS: Guide = Guide {
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
            wanted: 2,
        },
        Take {
            role: Role::Blown,
            name: "Blown frames",
            words: "A bright, even surface, over-exposed by three stops or more.",
            count: "1 or more for each ISO",
            wanted: 1,
        },
    ],
    command: "unlit calibrate levels SESSION --dark FILE... --blown FILE...",
};

pub(super) const NOISE: Guide = Guide {
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
            wanted: 16,
        },
        Take {
            role: Role::Dark,
            name: "Dark frames",
            words: "Lens cap on, the same ISO: they make the read noise sure.",
            count: "2",
            wanted: 2,
        },
    ],
    command: "unlit calibrate noise SESSION FILE... --dark FILE... [--stops STOPS]",
};

pub(super) const EXPOSURE: Guide = Guide {
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
        count: "10 to 19 for each dial",
        wanted: 30,
    }],
    command: "unlit calibrate exposure SESSION FILE...",
};

pub(super) const FLAT: Guide = Guide {
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
        wanted: 5,
    }],
    command: "unlit calibrate flat SESSION FILE...",
};

pub(super) const FLASH: Guide = Guide {
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
        wanted: 9,
    }],
    command: "unlit calibrate flash SESSION --ring-radii IN,OUT --shots DIST_M=FILE[,OFF]...",
};

pub(super) const STEADINESS: Guide = Guide {
    kind: Kind::Steadiness,
    title: "Repeatability of the flash",
    gives: "How far the flash's energy differs from shot to shot, and how much of that its photodiode takes out. Without it, \
            the scatter of the card shots stands in.",
    steps: &[
        "Make the room dark, and put a plain surface before the camera: the card, a wall. Camera on a tripod.",
        "Set the power of the flash as for your photographs, and the exposure so that the surface is at about half of \
         saturation and nothing clips.",
        "Let the flash warm up by ten shots, then take 40 frames lit by it. Give it the same time to recycle before each, \
         and touch nothing in between.",
    ],
    takes: &[Take {
        role: Role::Lit,
        name: "Lit frames",
        words: "The surface lit by the flash alone, nothing changed from one to the next.",
        count: "40; 8 at the least",
        wanted: 40,
    }],
    command: "unlit calibrate repeatability SESSION --frames FILE...",
};

pub(super) const COLOUR: Guide = Guide {
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
            wanted: 1,
        },
        Take {
            role: Role::Room,
            name: "Chart without flash",
            words: "The same frame in the room's light alone, where the room is not dark.",
            count: "1, or none",
            wanted: 0,
        },
    ],
    command: "unlit calibrate colour SESSION FILE [--off FILE]",
};
