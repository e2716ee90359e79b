//! What archives ask of colours: ISO 19264-1 and FADGI.
//!
//! Both judge CIEDE2000 with S_L = 1. ISO 19264-1:2021: mean and largest difference, levels A, B and C. FADGI,
//! "Technical Guidelines for Digitizing Cultural Heritage Materials", third edition, 2023: mean and 90th percentile, one
//! to four stars. The limits were taken from a published comparison of the two (skandalski.pl,
//! "FADGI/ISO/Metamorfoze"), in which ISO's levels B and C have the same limits for colour; a second source agrees on
//! FADGI's 4, 3 and 2 stars, the standards' own texts were not at hand (docs/calibration-colour.md). Both standards ask for
//! more than colour and for charts of more patches: a level here is that of the colours of this chart alone.

use super::summary::Differences;
use serde::{Deserialize, Serialize};

/// ISO's levels: name, mean and largest difference up to which they are met.
const ISO: [(&str, f64, f64); 2] = [("A", 4.0, 10.0), ("B and C", 5.0, 15.0)];

/// FADGI's stars: mean and 90th percentile below which they are given.
const FADGI: [(u8, f64, f64); 4] = [(4, 2.0, 4.0), (3, 3.5, 7.0), (2, 5.0, 10.0), (1, 6.5, 13.0)];

/// What the colours are worth to archives.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Standards {
    /// Best level of ISO 19264-1:2021 that is met; absent if none is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso_19264_1_level: Option<String>,
    /// Stars of FADGI 2023, 0 to 4.
    pub fadgi_2023_stars: u8,
}

/// Judges differences.
pub(super) fn judge(differences: &Differences) -> Standards {
    let Differences { mean_sl1: mean, max_sl1: max, percentile_90_sl1: most, .. } = *differences;
    let iso = ISO.into_iter().find(|(_, m, x)| mean <= *m && max <= *x);
    let fadgi = FADGI.into_iter().find(|(_, m, p)| mean < *m && most < *p);
    Standards {
        iso_19264_1_level: iso.map(|(name, ..)| name.to_owned()),
        fadgi_2023_stars: fadgi.map_or(0, |(stars, ..)| stars),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_the_published_ones() {
        let of = |mean_sl1: f64, percentile_90_sl1: f64, max_sl1: f64| {
            let d = Differences { mean_sl1, percentile_90_sl1, max_sl1, ..Differences::default() };
            let Standards { iso_19264_1_level, fadgi_2023_stars } = judge(&d);
            (iso_19264_1_level.unwrap_or_default(), fadgi_2023_stars)
        };
        assert_eq!(of(1.0, 3.0, 5.0), ("A".into(), 4));
        assert_eq!(of(2.0, 3.0, 10.0), ("A".into(), 3));
        assert_eq!(of(4.0, 8.0, 10.1), ("B and C".into(), 2));
        assert_eq!(of(4.0, 12.9, 15.1), (String::new(), 1));
        assert_eq!(of(7.0, 8.0, 9.0), (String::new(), 0));
    }
}
