//! What a frame's sensor values are: extremes, means, histograms and clipped shares, to find an exposure.
//!
//! Takes a [`Mosaic`] and a region, gives figures in DN as read: nothing scaled, nothing demosaiced.

use super::{Levels, Mosaic};
use serde::{Deserialize, Serialize};

/// Bins of a histogram.
pub const BINS: usize = 100;

/// A rectangle of sites in the active area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// The region does not lie in the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the region {},{},{},{} is not inside the frame of {width} x {height} pixels; give X,Y,W,H with W and H at least 1, X + W up to {width} and Y + H up to {height}",
    region.x, region.y, region.width, region.height
)]
pub struct OutsideFrame {
    /// The region asked for.
    pub region: Region,
    /// Columns of the frame.
    pub width: usize,
    /// Rows of the frame.
    pub height: usize,
}

/// Figures of one colour.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelFigures {
    /// "red", "green" or "blue".
    pub colour: &'static str,
    /// Sites of this colour in the region.
    pub sites: u64,
    /// Largest value in the region, DN; absent if the region has no site of this colour.
    pub region_maximum: Option<u16>,
    /// Mean value in the region, DN; absent if the region has no site of this colour.
    pub region_mean: Option<f64>,
    /// Largest value in the frame, DN.
    pub frame_maximum: u16,
    /// Share of the region's sites that are clipped, 0 to 1.
    pub region_clipped_share: f64,
    /// Share of the frame's sites that are clipped, 0 to 1.
    pub frame_clipped_share: f64,
    /// Lower edge of the first bin, DN: black (mean of the colour's positions).
    pub histogram_from: f64,
    /// Upper edge of the last bin, DN: saturation (mean of the colour's positions).
    pub histogram_to: f64,
    /// Sites of the region in 100 equal bins from black to saturation.
    pub histogram: Vec<u64>,
    /// Sites of the region below black: noise in the dark.
    pub below_black: u64,
    /// Sites of the region at or above saturation: clipped.
    pub at_saturation: u64,
}

/// All figures of a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// Columns of the active area.
    pub width: usize,
    /// Rows of the active area.
    pub height: usize,
    /// The region that was measured.
    pub region: Region,
    /// Largest value in the region, DN.
    pub region_maximum: u16,
    /// Mean value in the region over all colours, DN.
    pub region_mean: f64,
    /// Largest value in the frame, DN.
    pub frame_maximum: u16,
    /// Red, green, blue.
    pub channels: Vec<ChannelFigures>,
    /// Levels used, and where they came from.
    pub levels: Levels,
}

/// Measures `region` of the frame, the whole frame if `None`.
pub fn inspect(mosaic: &Mosaic, region: Option<Region>) -> Result<Inspection, OutsideFrame> {
    let (width, height) = (mosaic.dn.width(), mosaic.dn.height());
    let region = region.unwrap_or(Region { x: 0, y: 0, width, height });
    let fits = |from: usize, size: usize, whole: usize| {
        size > 0 && from.checked_add(size).is_some_and(|end| end <= whole)
    };
    if !fits(region.x, region.width, width) || !fits(region.y, region.height, height) {
        return Err(OutsideFrame { region, width, height });
    }
    let frame_maxima = maxima(mosaic);
    let frame_shares = mosaic.clipped_shares();
    let mut tallies = [0, 1, 2].map(|colour| Tally::new(mosaic, colour));
    for y in region.y..region.y + region.height {
        let row = &mosaic.dn.pixels()[y * width + region.x..][..region.width];
        for (x, &dn) in (region.x..).zip(row) {
            tallies[mosaic.cfa.colour(x, y)].add(dn, mosaic.levels, (x, y));
        }
    }
    let sites = (region.width * region.height) as f64;
    Ok(Inspection {
        width,
        height,
        region,
        region_maximum: tallies.iter().map(|t| t.maximum).max().unwrap_or(0),
        region_mean: tallies.iter().map(|t| t.sum).sum::<u64>() as f64 / sites,
        frame_maximum: frame_maxima.into_iter().max().unwrap_or(0),
        channels: tallies
            .into_iter()
            .enumerate()
            .map(|(colour, tally)| tally.figures(colour, frame_maxima[colour], frame_shares[colour]))
            .collect(),
        levels: mosaic.levels,
    })
}

fn maxima(mosaic: &Mosaic) -> [u16; 3] {
    let mut maxima = [0; 3];
    for (y, row) in mosaic.dn.pixels().chunks_exact(mosaic.dn.width().max(1)).enumerate() {
        for (x, &dn) in row.iter().enumerate() {
            let maximum = &mut maxima[mosaic.cfa.colour(x, y)];
            *maximum = dn.max(*maximum);
        }
    }
    maxima
}

struct Tally {
    sites: u64,
    sum: u64,
    maximum: u16,
    from: f64,
    to: f64,
    bins: Vec<u64>,
    below: u64,
    above: u64,
}

impl Tally {
    fn new(mosaic: &Mosaic, colour: usize) -> Self {
        let positions =
            || (0..4).map(|i| (i & 1, i >> 1)).filter(move |&(x, y)| mosaic.cfa.colour(x, y) == colour);
        let count = positions().count().max(1) as f64;
        let mean = |of: [[f32; 2]; 2]| positions().map(|(x, y)| f64::from(of[y][x])).sum::<f64>() / count;
        let (from, to) = (mean(mosaic.levels.black), mean(mosaic.levels.saturation));
        Tally { sites: 0, sum: 0, maximum: 0, from, to, bins: vec![0; BINS], below: 0, above: 0 }
    }

    fn add(&mut self, dn: u16, levels: Levels, (x, y): (usize, usize)) {
        self.sites += 1;
        self.sum += u64::from(dn);
        self.maximum = self.maximum.max(dn);
        let (black, saturation) = (levels.black[y & 1][x & 1], levels.saturation[y & 1][x & 1]);
        let dn = f32::from(dn);
        if dn < black {
            self.below += 1;
        } else if dn >= saturation {
            self.above += 1;
        } else {
            let bin = ((dn - black) / (saturation - black) * BINS as f32) as usize;
            self.bins[bin.min(BINS - 1)] += 1;
        }
    }

    fn figures(self, colour: usize, frame_maximum: u16, frame_clipped_share: f64) -> ChannelFigures {
        ChannelFigures {
            colour: ["red", "green", "blue"][colour],
            sites: self.sites,
            region_maximum: (self.sites > 0).then_some(self.maximum),
            region_mean: (self.sites > 0).then(|| self.sum as f64 / self.sites as f64),
            frame_maximum,
            region_clipped_share: self.above as f64 / self.sites.max(1) as f64,
            frame_clipped_share,
            histogram_from: self.from,
            histogram_to: self.to,
            histogram: self.bins,
            below_black: self.below,
            at_saturation: self.above,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource};
    use crate::raster::Image;

    fn mosaic() -> Mosaic {
        // Black 100, saturation 1100: a bin is 10 DN wide.
        let dn = Image::from_fn(4, 4, |x, y| match (x, y) {
            (0, 0) => 90,
            (2, 0) => 100,
            (0, 2) => 1099,
            (2, 2) => 1100,
            _ => 205,
        });
        let levels = Levels {
            black: [[100.0; 2]; 2],
            saturation: [[1100.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn, cfa: Cfa::RGGB, levels }
    }

    #[test]
    fn every_site_is_below_black_in_a_bin_or_at_saturation() {
        let found = inspect(&mosaic(), None).unwrap();
        let red = &found.channels[0];
        assert_eq!((red.below_black, red.at_saturation, red.histogram[0], red.histogram[99]), (1, 1, 1, 1));
        assert_eq!((red.region_maximum, red.region_mean), (Some(1100), Some(2389.0 / 4.0)));
        assert_eq!((red.region_clipped_share, red.frame_clipped_share), (0.25, 0.25));
        assert_eq!(found.channels[1].histogram[10], 8);
        assert_eq!((found.region_maximum, found.frame_maximum), (1100, 1100));
    }

    #[test]
    fn a_region_sees_only_its_own_sites() {
        let found = inspect(&mosaic(), Some(Region { x: 0, y: 0, width: 2, height: 1 })).unwrap();
        assert_eq!((found.region_maximum, found.region_mean, found.frame_maximum), (205, 147.5, 1100));
        assert_eq!(found.channels[2].region_maximum, None);
        assert_eq!(found.channels[2].frame_maximum, 205);
    }

    #[test]
    fn a_region_outside_the_frame_is_refused() {
        for (x, y, width, height) in [(0, 0, 5, 1), (4, 0, 1, 1), (0, 0, 0, 1), (usize::MAX, 0, 2, 1)] {
            assert!(inspect(&mosaic(), Some(Region { x, y, width, height })).is_err());
        }
    }
}
