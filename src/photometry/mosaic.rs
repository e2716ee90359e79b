//! A frame as the sensor gave it: one value a site under a colour filter array.

use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// The 2x2 colour filter array: colour (0 = R, 1 = G, 2 = B) at `[row & 1][column & 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cfa(pub [[u8; 2]; 2]);

impl Cfa {
    /// Red, green / green, blue.
    pub const RGGB: Cfa = Cfa([[0, 1], [1, 2]]);

    /// Filter positions, row and column.
    pub const POSITIONS: [(usize, usize); 4] = [(0, 0), (0, 1), (1, 0), (1, 1)];

    /// Colour (0 = R, 1 = G, 2 = B) of the site at column `x`, row `y`.
    pub fn colour(&self, x: usize, y: usize) -> usize {
        usize::from(self.0[y & 1][x & 1])
    }

    /// Positions of a colour, row and column.
    pub fn positions(self, colour: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
        Self::POSITIONS.into_iter().filter(move |&(row, column)| self.colour(column, row) == colour)
    }

    /// Mean place of a colour's sites from the middle of their filter cell, columns and rows: half a site aside, unless
    /// they are on its diagonal.
    pub fn aside(self, colour: usize) -> [f64; 2] {
        let sites = self.positions(colour).count().max(1) as f64;
        let mean = |of: fn((usize, usize)) -> usize| {
            self.positions(colour).map(|position| of(position) as f64 - 0.5).sum::<f64>() / sites
        };
        [mean(|(_, column)| column), mean(|(row, _)| row)]
    }
}

/// Where a level came from, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LevelSource {
    /// Fitted from calibration shots of this body.
    Measured,
    /// Mean of the frame's own masked border pixels.
    MaskedPixels,
    /// A tag of the file.
    FileTag,
    /// Published measurements of the model, built in.
    BodyTable,
    /// The decoder library's table for the model, as it stands.
    DecoderTable,
    /// The decoder library's table less a margin for its errors: a fallback that reports name.
    DecoderMargin,
}

/// Sensor levels in DN, one a position of the 2x2 array, indexed `[row & 1][column & 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Levels {
    /// DN of no light.
    pub black: [[f32; 2]; 2],
    /// DN at and above which a site counts as clipped.
    pub saturation: [[f32; 2]; 2],
    /// Origin of `black`.
    pub black_source: LevelSource,
    /// Origin of `saturation`.
    pub saturation_source: LevelSource,
}

/// A raw frame's active area: DN as read, nothing subtracted, nothing scaled.
#[derive(Clone, Debug, PartialEq)]
pub struct Mosaic {
    /// Sensor values.
    pub dn: Image<u16>,
    /// Filter array, aligned to the active area's first site.
    pub cfa: Cfa,
    /// Black and saturation.
    pub levels: Levels,
}

impl Mosaic {
    /// Whether the site at column `x`, row `y` is clipped.
    pub fn is_clipped(&self, x: usize, y: usize) -> bool {
        f32::from(*self.dn.at(x, y)) >= self.levels.saturation[y & 1][x & 1]
    }

    /// Share of clipped sites of each colour (R, G, B), 0 to 1; 0 for a colour without sites.
    pub fn clipped_shares(&self) -> [f64; 3] {
        let (mut clipped, mut sites) = ([0u64; 3], [0u64; 3]);
        for (y, row) in self.dn.pixels().chunks_exact(self.dn.width().max(1)).enumerate() {
            let (colours, saturation) = (self.cfa.0[y & 1], self.levels.saturation[y & 1]);
            for (x, &dn) in row.iter().enumerate() {
                let colour = usize::from(colours[x & 1]);
                sites[colour] += 1;
                clipped[colour] += u64::from(f32::from(dn) >= saturation[x & 1]);
            }
        }
        [0, 1, 2].map(|c| clipped[c] as f64 / (sites[c].max(1)) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colours_sites_lie_half_a_site_aside_and_those_on_a_diagonal_do_not() {
        assert_eq!([0, 1, 2].map(|c| Cfa::RGGB.aside(c)), [[-0.5, -0.5], [0.0, 0.0], [0.5, 0.5]]);
        let grbg = Cfa([[1, 0], [2, 1]]);
        assert_eq!([0, 1, 2].map(|c| grbg.aside(c)), [[0.5, -0.5], [0.0, 0.0], [-0.5, 0.5]]);
        assert_eq!(grbg.positions(1).collect::<Vec<_>>(), [(0, 0), (1, 1)]);
    }
}
