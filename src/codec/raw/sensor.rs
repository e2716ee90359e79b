//! From a whole sensor plane and what the file says of it to a [`Photo`]: crop to the active area, black
//! level from masked pixels, else from the file, else from the decoder's table.

use super::{Masked, Photo, RawError};
use crate::pair::Settings;
use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::Image;
use serde::{Deserialize, Serialize};

/// Sites a CFA position must have in the masked border before their mean is trusted: with some 5 DN of
/// read noise the mean is then good to 0.3 DN.
const MIN_MASKED_SITES: usize = 256;

/// Share of a border's sites at 0 DN from which their mean is no black: noise below it was cut off, so that the mean lies
/// too high.
const MOST_CUT_OFF: f64 = 0.005;

/// A rectangle of sensor sites: rows `top..bottom`, columns `left..right`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Rect {
    pub(super) top: usize,
    pub(super) left: usize,
    pub(super) bottom: usize,
    pub(super) right: usize,
}

impl Rect {
    fn contains(&self, x: usize, y: usize) -> bool {
        (self.left..self.right).contains(&x) && (self.top..self.bottom).contains(&y)
    }
}

/// Everything that is read off the sensor, masked border included, row-major.
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) dn: Vec<u16>,
}

/// What file or table say of the plane. Levels are indexed from the active area's first site.
pub(super) struct Description {
    pub(super) active: Rect,
    pub(super) cfa: Cfa,
    pub(super) masked: Vec<Rect>,
    pub(super) black: [[f32; 2]; 2],
    pub(super) saturation: [[f32; 2]; 2],
    /// Where black and saturation came from, should there be no masked pixels.
    pub(super) source: LevelSource,
}

impl Description {
    /// Refuses areas outside a plane of `width` x `height`, and levels that make no sense.
    pub(super) fn check(&self, what: &str, width: usize, height: usize) -> Result<(), RawError> {
        let damaged = |why: String| Err(RawError::Damaged { what: what.to_owned(), why });
        for rect in self.masked.iter().chain([&self.active]) {
            let Rect { top, left, bottom, right } = *rect;
            if top >= bottom || left >= right || bottom > height || right > width {
                return damaged(format!(
                    "the area of rows {top} to {bottom}, columns {left} to {right} is not inside the {width} x {height} sensor"
                ));
            }
        }
        if self.active.right - self.active.left < 2 || self.active.bottom - self.active.top < 2 {
            return damaged("its active area is smaller than one 2x2 cell".to_owned());
        }
        let mut colours: Vec<u8> = self.cfa.0.concat();
        colours.sort_unstable();
        if colours != [0, 1, 1, 2] {
            return Err(RawError::Pattern { what: what.to_owned(), pattern: format!("{:?}", self.cfa.0) });
        }
        Ok(())
    }
}

/// Cuts the active area out of the plane and settles the levels.
pub(super) fn develop(
    what: &str,
    plane: Plane,
    description: &Description,
    settings: Settings,
) -> Result<Photo, RawError> {
    description.check(what, plane.width, plane.height)?;
    let masked = measure_masked(&plane, description);
    let (black, black_source) = match &masked {
        Some(border) => (border.mean, LevelSource::MaskedPixels),
        None => (description.black, description.source),
    };
    let levels = Levels {
        black,
        saturation: description.saturation,
        black_source,
        saturation_source: description.source,
    };
    for (black, saturation) in black.concat().into_iter().zip(levels.saturation.concat()) {
        if !(black >= 0.0 && black + 1.0 < saturation) {
            return Err(RawError::Damaged {
                what: what.to_owned(),
                why: format!("its black level {black} is not below its saturation {saturation}"),
            });
        }
    }
    let Rect { top, left, bottom, right } = description.active;
    let pixels = crop(plane, description.active);
    let dn = Image::from_pixels(right - left, bottom - top, pixels).ok_or_else(|| RawError::Damaged {
        what: what.to_owned(),
        why: "its sensor data has not as many sites as its size says".to_owned(),
    })?;
    Ok(Photo { mosaic: Mosaic { dn, cfa: description.cfa, levels }, settings, masked })
}

/// The sites of `area`, which lies inside the plane; its rows are moved up in place, because a second plane of
/// 50 MP costs a tenth of a gigabyte.
fn crop(plane: Plane, area: Rect) -> Vec<u16> {
    let Plane { width, mut dn, .. } = plane;
    let wide = area.right - area.left;
    for (to, from) in (area.top..area.bottom).enumerate() {
        let start = from * width + area.left;
        dn.copy_within(start..start + wide, to * wide);
    }
    dn.truncate(wide * (area.bottom - area.top));
    dn
}

/// Mean and spread of the masked sites outside the active area, per position of the 2x2 array counted from
/// the active area's first site; `None` if there are too few, or if they are cut off at 0 DN.
fn measure_masked(plane: &Plane, description: &Description) -> Option<Masked> {
    let (mut sums, mut squares) = ([[0u64; 2]; 2], [[0u64; 2]; 2]);
    let (mut sites, mut nought) = ([[0usize; 2]; 2], [[0usize; 2]; 2]);
    let active = description.active;
    for (i, area) in description.masked.iter().enumerate() {
        for y in area.top..area.bottom {
            for x in area.left..area.right {
                let counted = description.masked[..i].iter().any(|earlier| earlier.contains(x, y));
                if counted || active.contains(x, y) {
                    continue;
                }
                let dn = u64::from(plane.dn[y * plane.width + x]);
                let (row, column) = ((y + active.top) & 1, (x + active.left) & 1);
                sums[row][column] += dn;
                squares[row][column] += dn * dn;
                sites[row][column] += 1;
                nought[row][column] += usize::from(dn == 0);
            }
        }
    }
    let cut_off = |(n, of): (usize, usize)| n as f64 > MOST_CUT_OFF * of as f64;
    if nought.concat().into_iter().zip(sites.concat()).any(cut_off) {
        return None;
    }
    if sites.concat().into_iter().any(|n| n < MIN_MASKED_SITES) {
        return None;
    }
    let mut masked = Masked { mean: [[0.0; 2]; 2], standard_deviation: [[0.0; 2]; 2], sites };
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let n = sites[row][column] as f64;
        let mean = sums[row][column] as f64 / n;
        let variance = (squares[row][column] as f64 / n - mean * mean).max(0.0);
        masked.mean[row][column] = mean as f32;
        masked.standard_deviation[row][column] = variance.sqrt() as f32;
    }
    Some(masked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_area_is_cut_out_of_its_plane() {
        let plane = || Plane { width: 4, height: 3, dn: (0..12).collect() };
        let area = |top, left, bottom, right| crop(plane(), Rect { top, left, bottom, right });
        assert_eq!(area(1, 1, 3, 3), [5, 6, 9, 10]);
        assert_eq!(area(0, 2, 3, 4), [2, 3, 6, 7, 10, 11]);
        assert_eq!(area(0, 0, 3, 4), (0..12).collect::<Vec<u16>>());
        assert_eq!(area(2, 3, 3, 4), [11]);
    }
}
