//! Reads the labels by which libgphoto2 names a dial's positions ("1/125", "0.0080s", "f/11", "Auto").

use crate::units::{FNumber, Iso, Seconds};

/// A positive finite number.
fn number(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0)
}

/// `1/125`, `0.5`, `30`, `0.0080s`; `None` for bulb, automatic and anything else.
pub(super) fn shutter(label: &str) -> Option<Seconds> {
    let label = label.trim().trim_end_matches(['s', '"']);
    match label.split_once('/') {
        Some((above, below)) => Some(Seconds(number(above)? / number(below)?)),
        None => number(label).map(Seconds),
    }
}

/// `11`, `5.6`, `f/11`; `None` for automatic and anything else.
pub(super) fn aperture(label: &str) -> Option<FNumber> {
    number(label.trim().trim_start_matches("f/")).map(FNumber)
}

/// `100`; `None` for automatic and anything else.
pub(super) fn iso(label: &str) -> Option<Iso> {
    number(label).map(Iso)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_three_makers_are_read() {
        assert_eq!(shutter("1/125"), Some(Seconds(1.0 / 125.0)));
        assert_eq!(shutter("0.0080s"), Some(Seconds(0.008)));
        assert_eq!(shutter("30"), Some(Seconds(30.0)));
        assert_eq!(shutter("13/10"), Some(Seconds(1.3)));
        assert_eq!(aperture("5.6"), Some(FNumber(5.6)));
        assert_eq!(aperture("f/11"), Some(FNumber(11.0)));
        assert_eq!(iso("6400"), Some(Iso(6400.0)));
    }

    #[test]
    fn what_is_no_number_is_absent() {
        for label in ["bulb", "Bulb", "auto", "Auto", "", "1/0", "-1", "nan", "inf", "Unknown value 0071"] {
            assert_eq!(shutter(label), None, "{label}");
        }
        assert_eq!(aperture("implicit auto"), None);
        assert_eq!(iso("Auto ISO"), None);
    }
}
