//! How a body stands when it is switched on: its dials and switches, and what a computer finds set.

/// The mode dial. Only the photographer's hand turns it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// P: the body chooses shutter and aperture.
    Program,
    /// Tv: the body chooses the aperture.
    Shutter,
    /// Av: the body chooses the shutter.
    Aperture,
    /// M.
    Manual,
}

/// The switch on the lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Focus {
    /// MF: the lens stays where it is.
    Manual,
    /// AF, one shot.
    OneShot,
}

/// What one press of the release does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// One frame.
    Single,
    /// Frame after frame while it is held; a computer's press is so short that one is exposed.
    Continuous,
    /// One frame after ten seconds.
    Timer,
}

/// Which files a frame becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Files {
    /// The raw file alone.
    Raw,
    /// The raw file, then a large fine JPEG.
    RawAndJpeg,
    /// A large fine JPEG alone.
    Jpeg,
}

/// How a body stands. The default is what the rig needs: M, MF, single, RAW alone, never asleep, nothing improved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BodyOptions {
    /// Mode dial.
    pub mode: Mode,
    /// Switch on the lens.
    pub focus: Focus,
    /// Drive mode.
    pub drive: Drive,
    /// Image format.
    pub files: Files,
    /// With RAW and JPEG, the JPEG is announced first.
    pub jpeg_first: bool,
    /// White balance, Canon's code: 0 automatic, 1 daylight, 3 tungsten, 5 flash.
    pub white_balance: u32,
    /// Seconds until the body falls asleep; 0 never.
    pub auto_power_off: u32,
    /// Noise reduction at high sensitivity, Canon's code: 0 off to 3 high.
    pub noise_reduction: u32,
    /// Auto lighting optimizer, Canon's code: 0 standard, 1 low, 2 strong, 3 off.
    pub lighting_optimizer: u32,
    /// Auto exposure bracketing, in eighths of a stop; 0 off.
    pub bracketing: u32,
    /// Files that the card takes; without one there is no card.
    pub card_room: Option<u32>,
    /// The shutter stays open as long as its label says, rather than no time at all.
    pub real_shutter: bool,
    /// Serial number.
    pub serial: String,
}

impl Default for BodyOptions {
    fn default() -> Self {
        Self {
            mode: Mode::Manual,
            focus: Focus::Manual,
            drive: Drive::Single,
            files: Files::Raw,
            jpeg_first: false,
            white_balance: 1,
            auto_power_off: 0,
            noise_reduction: 0,
            lighting_optimizer: 3,
            bracketing: 0,
            card_room: None,
            real_shutter: false,
            serial: super::datasets::SERIAL.to_owned(),
        }
    }
}
