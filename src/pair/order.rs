//! Which frames a pair is made of, and in which order they are shot.
//!
//! | order        | with n dark frames        | what it is for                                                    |
//! |--------------|---------------------------|-------------------------------------------------------------------|
//! | `off_on`     | off x n, on               | the usual one                                                     |
//! | `on_off`     | on, off x n               | the object must be lit first (it settles, or somebody leaves)      |
//! | `off_on_off` | off x n, on, after x n    | the room's light or the tripod may drift                          |
//! | `off_on_crossed` | off x n, on, crossed  | what shines can be told from what is matt (not shot by us yet)    |
//!
//! # Why n
//! The known light is `P_on - P_off`, with the variance `s_on^2 + s_off^2 / n` if the mean of n dark frames is taken
//! off. More than a handful pays little: the lit frame's own `s_on^2` stays. Beyond [`MOST_OFF_FRAMES`] nothing is won.
//!
//! # Why as many after as before
//! Let the room's light be `L(t) = L + d t` round the lit frame at `t = 0`, and the frames be `T` apart. The dark frames
//! before it stand at `-T, ..., -n T`, those after it at `T, ..., n T`, and their mean is
//!
//! ```text
//! 1 / 2n * sum over k = 1..n of [(L - d k T) + (L + d k T)] = L
//! ```
//!
//! exactly what the room gave to the lit frame, whatever `d` is: every slope cancels, and only curvature stays. Dark
//! frames on one side alone would be wrong by `d T (n + 1) / 2`. If the frame after comes later than the one before
//! came early, by `e`, half of that stays: `d e / 2`.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Most dark frames on either side of the lit one.
pub const MOST_OFF_FRAMES: u8 = 16;

/// In which order a pair's frames are shot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Without flash, then with it.
    #[default]
    OffOn,
    /// With flash, then without it.
    OnOff,
    /// Without flash, with it, and without it once more: tells how room and tripod drift.
    OffOnOff,
    /// Without flash, with it, and with it through a polariser turned across. Records may have it; nothing shoots it yet.
    OffOnCrossed,
}

impl Order {
    /// All that can be shot.
    pub const ALL: [Order; 3] = [Order::OffOn, Order::OnOff, Order::OffOnOff];

    fn name(self) -> &'static str {
        match self {
            Order::OffOn => "off-on",
            Order::OnOff => "on-off",
            Order::OffOnOff => "off-on-off",
            Order::OffOnCrossed => "off-on-crossed",
        }
    }
}

impl fmt::Display for Order {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A wish for frames that no pair can be made of.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OrderError {
    /// No such order.
    #[error("there is no order {0:?}; choose off-on, on-off or off-on-off")]
    Unknown(String),
    /// One that records may have, but that nothing shoots.
    #[error("the order {0} cannot be shot; choose off-on, on-off or off-on-off")]
    NotShot(Order),
    /// Too many frames, or none.
    #[error("a pair cannot have {0} frames without flash in a row; choose 1 to {MOST_OFF_FRAMES}")]
    Frames(u64),
    /// No name of a frame.
    #[error("there is no frame {0:?}; frames are called off, off-2 and so on, on, after, after-2 and so on")]
    Slot(String),
}

impl FromStr for Order {
    type Err = OrderError;

    fn from_str(text: &str) -> Result<Self, OrderError> {
        let wanted = text.replace('_', "-");
        let found = Order::ALL.into_iter().find(|order| order.name() == wanted);
        found.ok_or_else(|| OrderError::Unknown(text.to_owned()))
    }
}

/// What a frame of a pair is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// The room's light alone.
    Off,
    /// The room's light and the flash's.
    On,
    /// The room's light alone once more, after the lit frame.
    After,
    /// The room's light and the flash's once more, through a polariser turned across.
    Crossed,
}

impl Part {
    /// Whether the flash is to light it.
    pub fn is_lit(self) -> bool {
        matches!(self, Part::On | Part::Crossed)
    }

    fn name(self) -> &'static str {
        match self {
            Part::Off => "off",
            Part::On => "on",
            Part::After => "after",
            Part::Crossed => "crossed",
        }
    }
}

/// One frame's place in its pair. Its name (`off`, `off-2`, `on`, `after`) is the stem of its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Slot {
    /// What it is for.
    pub part: Part,
    /// Which of those, from 1.
    pub index: u8,
}

impl Slot {
    /// The first frame without flash.
    pub const OFF: Slot = Slot { part: Part::Off, index: 1 };
    /// The frame with flash.
    pub const ON: Slot = Slot { part: Part::On, index: 1 };
    /// The frame with flash through a polariser turned across.
    pub const CROSSED: Slot = Slot { part: Part::Crossed, index: 1 };

    /// Whether a pair without it is none. The others are there to lower noise and to measure drift.
    pub fn is_needed(self) -> bool {
        self == Slot::OFF || self == Slot::ON
    }
}

impl fmt::Display for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.index {
            1 => f.write_str(self.part.name()),
            n => write!(f, "{}-{n}", self.part.name()),
        }
    }
}

impl From<Slot> for String {
    fn from(slot: Slot) -> String {
        slot.to_string()
    }
}

impl TryFrom<String> for Slot {
    type Error = OrderError;

    fn try_from(text: String) -> Result<Self, OrderError> {
        text.parse()
    }
}

impl FromStr for Slot {
    type Err = OrderError;

    fn from_str(text: &str) -> Result<Self, OrderError> {
        let slots = [Part::Off, Part::On, Part::After, Part::Crossed]
            .into_iter()
            .flat_map(|part| (1..=MOST_OFF_FRAMES).map(move |index| Slot { part, index }));
        let mut slots = slots.filter(|slot| !slot.part.is_lit() || slot.index == 1);
        slots.find(|slot| slot.to_string() == text).ok_or_else(|| OrderError::Slot(text.to_owned()))
    }
}

/// The frames of a pair as they are shot, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Program {
    order: Order,
    off_frames: u8,
}

impl Default for Program {
    fn default() -> Self {
        Self { order: Order::default(), off_frames: 1 }
    }
}

impl Program {
    /// `off_frames` frames without flash before the lit one, or after it, or on both sides: as the order has it.
    pub fn new(order: Order, off_frames: u8) -> Result<Self, OrderError> {
        if !(1..=MOST_OFF_FRAMES).contains(&off_frames) {
            return Err(OrderError::Frames(off_frames.into()));
        }
        if !Order::ALL.contains(&order) {
            return Err(OrderError::NotShot(order));
        }
        Ok(Self { order, off_frames })
    }

    /// The order.
    pub fn order(&self) -> Order {
        self.order
    }

    /// Frames without flash in a row.
    pub fn off_frames(&self) -> u8 {
        self.off_frames
    }

    /// All frames as they are shot.
    pub fn slots(&self) -> Vec<Slot> {
        let row = |part| (1..=self.off_frames).map(move |index| Slot { part, index });
        let (off, on) = (row(Part::Off), std::iter::once(Slot::ON));
        match self.order {
            Order::OffOn => off.chain(on).collect(),
            Order::OnOff => on.chain(off).collect(),
            Order::OffOnOff => off.chain(on).chain(row(Part::After)).collect(),
            Order::OffOnCrossed => off.chain(on).chain([Slot::CROSSED]).collect(),
        }
    }

    /// The first frame.
    pub fn first(&self) -> Slot {
        if self.order == Order::OnOff { Slot::ON } else { Slot::OFF }
    }

    /// The frame after `slot`; none after the last.
    pub fn after(&self, slot: Slot) -> Option<Slot> {
        self.slots().into_iter().skip_while(|s| *s != slot).nth(1)
    }

    /// The next frame after `slot` without which there is no pair.
    pub fn needed_after(&self, slot: Slot) -> Option<Slot> {
        self.slots().into_iter().skip_while(|s| *s != slot).skip(1).find(|s| s.is_needed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(order: Order, off_frames: u8) -> String {
        let slots = Program::new(order, off_frames).unwrap().slots();
        slots.iter().map(Slot::to_string).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_frames_of_each_order() {
        assert_eq!(names(Order::OffOn, 1), "off on");
        assert_eq!(names(Order::OffOn, 3), "off off-2 off-3 on");
        assert_eq!(names(Order::OnOff, 2), "on off off-2");
        assert_eq!(names(Order::OffOnOff, 2), "off off-2 on after after-2");
    }

    #[test]
    fn one_frame_leads_to_the_next_and_the_last_to_none() {
        for order in Order::ALL {
            for off_frames in 1..=MOST_OFF_FRAMES {
                let program = Program::new(order, off_frames).unwrap();
                let walk: Vec<Slot> =
                    std::iter::successors(Some(program.first()), |slot| program.after(*slot)).collect();
                assert_eq!(walk, program.slots());
                let needed: Vec<Slot> =
                    std::iter::successors(Some(program.first()), |slot| program.needed_after(*slot))
                        .collect();
                let both = if order == Order::OnOff { [Slot::ON, Slot::OFF] } else { [Slot::OFF, Slot::ON] };
                assert_eq!(needed, both);
            }
        }
    }

    #[test]
    fn names_come_back_and_others_are_refused() {
        for order in Order::ALL {
            assert_eq!(order.to_string().parse(), Ok(order));
            let json = serde_json::to_string(&order).unwrap();
            assert_eq!(json.trim_matches('"').parse(), Ok(order));
            for slot in Program::new(order, MOST_OFF_FRAMES).unwrap().slots() {
                assert_eq!(slot.to_string().parse(), Ok(slot));
            }
        }
        assert_eq!("crossed".parse(), Ok(Slot::CROSSED));
        assert!(Slot::CROSSED.part.is_lit() && !Slot::CROSSED.is_needed());
        let error = Program::new(Order::OffOnCrossed, 1).unwrap_err().to_string();
        assert!(error.contains("off-on-crossed cannot be shot"), "{error}");
        for wrong in ["", "off-1", "off-17", "on-2", "crossed-2", "off-02", "before", "../off"] {
            assert!(wrong.parse::<Slot>().is_err(), "{wrong}");
        }
        assert!("off-off".parse::<Order>().unwrap_err().to_string().contains("off-on-off"));
        for wrong in [0, 17, 255] {
            let error = Program::new(Order::OffOn, wrong).unwrap_err().to_string();
            assert!(error.contains("1 to 16"), "{error}");
        }
    }
}
