//! Colour charts with published reference values, CIELAB, D50, 2 degree observer.
//!
//! ColorChecker Classic, and the ColorChecker Passport's and Mini's 24 patches, which are of the same colours: X-Rite's
//! values for charts made before November 2014 ("Colorimetric values for ColorChecker family of targets", after
//! Pascale, "RGB coordinates of the Macbeth ColorChecker", BabelColor 2006) and since ("New color specifications for
//! ColorChecker SG and Classic charts", X-Rite 2015). SpyderCHECKR 24: Datacolor, "SpyderCHECKR Color Data" version 2,
//! 2018. Rows are those of the chart lying so that its greys are the lowest row, white left.

use super::cielab::{Lab, xyz};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Columns of every chart known.
pub const COLUMNS: usize = 6;
/// Rows of every chart known.
pub const ROWS: usize = 4;
/// Patches of every chart known.
pub const PATCHES: usize = COLUMNS * ROWS;

/// A chart and its edition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChartKind {
    /// ColorChecker of 24 patches made in November 2014 or later.
    Colorchecker24,
    /// ColorChecker of 24 patches made before November 2014.
    Colorchecker24Before2014,
    /// SpyderCHECKR 24.
    Spydercheckr24,
}

impl ChartKind {
    /// All of them.
    pub const ALL: [ChartKind; 3] =
        [Self::Colorchecker24, Self::Colorchecker24Before2014, Self::Spydercheckr24];

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colorchecker24 => "ColorChecker 24 (November 2014 or later)",
            Self::Colorchecker24Before2014 => "ColorChecker 24 (before November 2014)",
            Self::Spydercheckr24 => "SpyderCHECKR 24",
        }
    }

    /// Whose numbers the reference values are.
    pub fn source(self) -> &'static str {
        match self {
            Self::Colorchecker24 => "X-Rite 2015, CIELAB D50, for charts made since November 2014",
            Self::Colorchecker24Before2014 => "X-Rite, CIELAB D50, for charts made before November 2014",
            Self::Spydercheckr24 => "Datacolor 2018, SpyderCHECKR color data version 2, CIELAB D50",
        }
    }

    /// Whether two are editions of one chart, which differ in their values alone.
    pub fn same_chart(self, other: Self) -> bool {
        (self == Self::Spydercheckr24) == (other == Self::Spydercheckr24)
    }

    /// Name and reference value of each patch, row by row.
    pub fn patches(self) -> &'static [(&'static str, Lab); PATCHES] {
        match self {
            Self::Colorchecker24 => &SINCE_2014,
            Self::Colorchecker24Before2014 => &BEFORE_2014,
            Self::Spydercheckr24 => &SPYDER,
        }
    }

    /// Reference XYZ of each patch under D50, white Y = 1.
    pub fn reference_xyz(self) -> [DVec3; PATCHES] {
        self.patches().map(|(_, lab)| xyz(lab))
    }
}

/// No such chart.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no chart that is known; known are colorchecker24, colorchecker24-before-2014 and spydercheckr24"
)]
pub struct UnknownChart(String);

impl std::str::FromStr for ChartKind {
    type Err = UnknownChart;

    fn from_str(text: &str) -> Result<Self, UnknownChart> {
        match text {
            "colorchecker24" => Ok(Self::Colorchecker24),
            "colorchecker24-before-2014" => Ok(Self::Colorchecker24Before2014),
            "spydercheckr24" => Ok(Self::Spydercheckr24),
            other => Err(UnknownChart(other.to_owned())),
        }
    }
}

#[rustfmt::skip]
const SINCE_2014: [(&str, Lab); PATCHES] = [
    ("dark skin", [37.54, 14.37, 14.92]), ("light skin", [64.66, 19.27, 17.50]),
    ("blue sky", [49.32, -3.82, -22.54]), ("foliage", [43.46, -12.74, 22.72]),
    ("blue flower", [54.94, 9.61, -24.79]), ("bluish green", [70.48, -32.26, -0.37]),
    ("orange", [62.73, 35.83, 56.50]), ("purplish blue", [39.43, 10.75, -45.17]),
    ("moderate red", [50.57, 48.64, 16.67]), ("purple", [30.10, 22.54, -20.87]),
    ("yellow green", [71.77, -24.13, 58.19]), ("orange yellow", [71.51, 18.24, 67.37]),
    ("blue", [28.37, 15.42, -49.80]), ("green", [54.38, -39.72, 32.27]),
    ("red", [42.43, 51.05, 28.62]), ("yellow", [81.80, 2.67, 80.41]),
    ("magenta", [50.63, 51.28, -14.12]), ("cyan", [49.57, -29.71, -28.32]),
    ("white", [95.19, -1.03, 2.93]), ("neutral 8", [81.29, -0.57, 0.44]),
    ("neutral 6.5", [66.89, -0.75, -0.06]), ("neutral 5", [50.76, -0.13, 0.14]),
    ("neutral 3.5", [35.63, -0.46, -0.48]), ("black", [20.64, 0.07, -0.46]),
];

#[rustfmt::skip]
const BEFORE_2014: [(&str, Lab); PATCHES] = [
    ("dark skin", [37.986, 13.555, 14.059]), ("light skin", [65.711, 18.130, 17.810]),
    ("blue sky", [49.927, -4.880, -21.905]), ("foliage", [43.139, -13.095, 21.905]),
    ("blue flower", [55.112, 8.844, -25.399]), ("bluish green", [70.719, -33.397, -0.199]),
    ("orange", [62.661, 36.067, 57.096]), ("purplish blue", [40.020, 10.410, -45.964]),
    ("moderate red", [51.124, 48.239, 16.248]), ("purple", [30.325, 22.976, -21.587]),
    ("yellow green", [72.532, -23.709, 57.255]), ("orange yellow", [71.941, 19.363, 67.857]),
    ("blue", [28.778, 14.179, -50.297]), ("green", [55.261, -38.342, 31.370]),
    ("red", [42.101, 53.378, 28.190]), ("yellow", [81.733, 4.039, 79.819]),
    ("magenta", [51.935, 49.986, -14.574]), ("cyan", [51.038, -28.631, -28.638]),
    ("white", [96.539, -0.425, 1.186]), ("neutral 8", [81.257, -0.638, -0.335]),
    ("neutral 6.5", [66.766, -0.734, -0.504]), ("neutral 5", [50.867, -0.153, -0.270]),
    ("neutral 3.5", [35.656, -0.421, -1.231]), ("black", [20.461, -0.079, -0.973]),
];

#[rustfmt::skip]
const SPYDER: [(&str, Lab); PATCHES] = [
    ("1H aqua", [70.19, -31.85, 1.98]), ("2H lavender", [54.38, 8.84, -25.71]),
    ("3H evergreen", [42.03, -15.78, 22.93]), ("4H steel blue", [48.82, -5.11, -23.08]),
    ("5H light skin", [65.10, 18.14, 18.68]), ("6H dark skin", [36.13, 14.15, 15.78]),
    ("1G orange", [60.94, 38.21, 61.31]), ("2G blueprint", [37.80, 7.30, -43.04]),
    ("3G pink", [49.81, 48.50, 15.76]), ("4G violet", [28.88, 19.36, -24.48]),
    ("5G apple green", [72.45, -23.57, 60.47]), ("6G sunflower", [71.65, 23.74, 72.28]),
    ("1F cyan", [47.12, -32.50, -28.75]), ("2F magenta", [50.49, 53.45, -13.55]),
    ("3F yellow", [83.61, 3.36, 87.02]), ("4F red", [41.05, 60.75, 31.17]),
    ("5F green", [54.14, -40.80, 34.75]), ("6F blue", [24.75, 13.78, -49.48]),
    ("1E white", [96.04, 2.16, 2.60]), ("2E 20 % grey", [80.44, 1.17, 2.05]),
    ("3E 40 % grey", [65.52, 0.69, 1.86]), ("4E 60 % grey", [49.62, 0.58, 1.56]),
    ("5E 80 % grey", [33.55, 0.35, 1.40]), ("6E black", [16.91, 1.43, -0.81]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::colour::cielab::delta_e_2000;

    #[test]
    fn editions_of_a_chart_are_close_and_charts_are_not() {
        let mean = |a: ChartKind, b: ChartKind| {
            let pairs = a.patches().iter().zip(b.patches());
            pairs.map(|(a, b)| delta_e_2000(a.1, b.1)).sum::<f64>() / PATCHES as f64
        };
        let editions = mean(ChartKind::Colorchecker24, ChartKind::Colorchecker24Before2014);
        assert!((0.5..1.2).contains(&editions), "{editions}");
        assert!(mean(ChartKind::Colorchecker24, ChartKind::Spydercheckr24) > 15.0);
    }

    #[test]
    fn the_lowest_row_is_grey_from_white_to_black() {
        for kind in ChartKind::ALL {
            let greys = &kind.patches()[PATCHES - COLUMNS..];
            assert!(greys.iter().all(|(_, [_, a, b])| a.hypot(*b) < 4.0), "{}", kind.name());
            assert!(greys.windows(2).all(|two| two[0].1[0] > two[1].1[0] + 10.0), "{}", kind.name());
            let names: std::collections::HashSet<_> = kind.patches().iter().map(|(name, _)| name).collect();
            assert_eq!(names.len(), PATCHES);
        }
    }
}
