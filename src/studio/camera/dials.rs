//! The dials of a Canon EOS: the body's codes for shutter, aperture and sensitivity, and the labels that
//! belong to them.
//!
//! The codes count eighths of a stop on the APEX scales: time value `(code - 0x38) / 8`, aperture value
//! `(code - 0x08) / 8`, sensitivity `ISO 100 * 2^((code - 0x48) / 8)`; bodies offer thirds, whose codes are
//! 0, 3 or 5 past a full stop. What stands on the dial, and in EXIF, is the rounded label.

use crate::units::{FNumber, Iso, Seconds};

/// One position of a dial: the code on the wire and the value on its label.
pub(super) type Position = (u32, f64);

/// Shutter times, label in seconds, 30 s to 1/8000 s.
pub(super) const SHUTTER: &[Position] = &[
    (0x10, 30.0),
    (0x13, 25.0),
    (0x15, 20.0),
    (0x18, 15.0),
    (0x1b, 13.0),
    (0x1d, 10.0),
    (0x20, 8.0),
    (0x23, 6.0),
    (0x25, 5.0),
    (0x28, 4.0),
    (0x2b, 3.2),
    (0x2d, 2.5),
    (0x30, 2.0),
    (0x33, 1.6),
    (0x35, 1.3),
    (0x38, 1.0),
    (0x3b, 0.8),
    (0x3d, 0.6),
    (0x40, 0.5),
    (0x43, 0.4),
    (0x45, 0.3),
    (0x48, 1.0 / 4.0),
    (0x4b, 1.0 / 5.0),
    (0x4d, 1.0 / 6.0),
    (0x50, 1.0 / 8.0),
    (0x53, 1.0 / 10.0),
    (0x55, 1.0 / 13.0),
    (0x58, 1.0 / 15.0),
    (0x5b, 1.0 / 20.0),
    (0x5d, 1.0 / 25.0),
    (0x60, 1.0 / 30.0),
    (0x63, 1.0 / 40.0),
    (0x65, 1.0 / 50.0),
    (0x68, 1.0 / 60.0),
    (0x6b, 1.0 / 80.0),
    (0x6d, 1.0 / 100.0),
    (0x70, 1.0 / 125.0),
    (0x73, 1.0 / 160.0),
    (0x75, 1.0 / 200.0),
    (0x78, 1.0 / 250.0),
    (0x7b, 1.0 / 320.0),
    (0x7d, 1.0 / 400.0),
    (0x80, 1.0 / 500.0),
    (0x83, 1.0 / 640.0),
    (0x85, 1.0 / 800.0),
    (0x88, 1.0 / 1000.0),
    (0x8b, 1.0 / 1250.0),
    (0x8d, 1.0 / 1600.0),
    (0x90, 1.0 / 2000.0),
    (0x93, 1.0 / 2500.0),
    (0x95, 1.0 / 3200.0),
    (0x98, 1.0 / 4000.0),
    (0x9b, 1.0 / 5000.0),
    (0x9d, 1.0 / 6400.0),
    (0xa0, 1.0 / 8000.0),
];

/// F-numbers of a lens f/2.8 to f/32.
pub(super) const APERTURE: &[Position] = &[
    (0x20, 2.8),
    (0x23, 3.2),
    (0x25, 3.5),
    (0x28, 4.0),
    (0x2b, 4.5),
    (0x2d, 5.0),
    (0x30, 5.6),
    (0x33, 6.3),
    (0x35, 7.1),
    (0x38, 8.0),
    (0x3b, 9.0),
    (0x3d, 10.0),
    (0x40, 11.0),
    (0x43, 13.0),
    (0x45, 14.0),
    (0x48, 16.0),
    (0x4b, 18.0),
    (0x4d, 20.0),
    (0x50, 22.0),
    (0x53, 25.0),
    (0x55, 29.0),
    (0x58, 32.0),
];

/// Sensitivities 100 to 6400.
pub(super) const ISO: &[Position] = &[
    (0x48, 100.0),
    (0x4b, 125.0),
    (0x4d, 160.0),
    (0x50, 200.0),
    (0x53, 250.0),
    (0x55, 320.0),
    (0x58, 400.0),
    (0x5b, 500.0),
    (0x5d, 640.0),
    (0x60, 800.0),
    (0x63, 1000.0),
    (0x65, 1250.0),
    (0x68, 1600.0),
    (0x6b, 2000.0),
    (0x6d, 2500.0),
    (0x70, 3200.0),
    (0x73, 4000.0),
    (0x75, 5000.0),
    (0x78, 6400.0),
];

/// Positions of a dial a stop.
const THIRDS_A_STOP: usize = 3;

fn label(dial: &[Position], code: u32) -> Option<f64> {
    dial.iter().find(|(c, _)| *c == code).map(|(_, label)| *label)
}

/// Exposure time on the label of `code`.
pub(super) fn shutter(code: u32) -> Option<Seconds> {
    label(SHUTTER, code).map(Seconds)
}

/// F-number on the label of `code`.
pub(super) fn aperture(code: u32) -> Option<FNumber> {
    label(APERTURE, code).map(FNumber)
}

/// Sensitivity on the label of `code`.
pub(super) fn iso(code: u32) -> Option<Iso> {
    label(ISO, code).map(Iso)
}

/// The label one stop slower, or one stop faster where the dial ends.
pub(super) fn one_stop_off(shutter: Seconds) -> Seconds {
    let Some(at) = SHUTTER.iter().position(|(_, label)| *label == shutter.0) else { return shutter };
    let slower = at.checked_sub(THIRDS_A_STOP).unwrap_or(at + THIRDS_A_STOP);
    SHUTTER.get(slower).map_or(shutter, |(_, label)| Seconds(*label))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest distance of a label from the exact APEX value of its code, in stops. The code of a third
    /// (3/8, 5/8) is 1/24 off, the label's rounding takes the rest.
    const ROUNDING_STOPS: f64 = 0.2;

    #[test]
    fn labels_follow_the_apex_scale_of_their_codes() {
        for &(code, seconds) in SHUTTER {
            let exact = -(f64::from(code) - 56.0) / 8.0;
            assert!((seconds.log2() - exact).abs() < ROUNDING_STOPS, "shutter {code:#x}");
        }
        for &(code, number) in APERTURE {
            let exact = (f64::from(code) - 8.0) / 16.0;
            assert!((number.log2() - exact).abs() < ROUNDING_STOPS / 2.0, "aperture {code:#x}");
        }
        for &(code, iso) in ISO {
            let exact = (f64::from(code) - 72.0) / 8.0;
            assert!(((iso / 100.0).log2() - exact).abs() < ROUNDING_STOPS, "iso {code:#x}");
        }
    }

    #[test]
    fn one_stop_off_is_twice_or_half_the_time() {
        assert_eq!(one_stop_off(Seconds(1.0 / 125.0)), Seconds(1.0 / 60.0));
        assert_eq!(one_stop_off(Seconds(30.0)), Seconds(15.0));
    }

    #[test]
    fn a_code_that_is_on_no_dial_has_no_label() {
        assert_eq!(shutter(0x71), None);
        assert_eq!(aperture(0x40), Some(FNumber(11.0)));
        assert_eq!(iso(0), None);
    }
}
