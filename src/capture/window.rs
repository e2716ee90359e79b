//! The light of a shot of a series: averaged over the same sites in every shot.

use crate::pair::Window;
use crate::photometry::{KnownMosaic, Mosaic};
use crate::raster::Image;

/// Share of the range below which a site of the first lit frame is safe from clipping in the others.
const SAFE: f32 = 0.85;
/// Where the light is averaged when the session has no region.
pub(super) const MIDDLE: Window = Window { x: 0.25, y: 0.25, width: 0.5, height: 0.5 };

/// Sites of a lit frame that no later shot of a flash this steady can clip.
pub(super) fn safe_sites(on: &Mosaic) -> Image<bool> {
    Image::from_fn(on.dn.width(), on.dn.height(), |x, y| {
        let (black, saturation) = (on.levels.black[y & 1][x & 1], on.levels.saturation[y & 1][x & 1]);
        f32::from(*on.dn.at(x, y)) - black < SAFE * (saturation - black)
    })
}

/// The sites of a window, whole cells of the filter array, so that colours and levels stay as they are.
pub(super) fn part(frame: &Mosaic, window: Window) -> Mosaic {
    let region = window.sites(frame.dn.width(), frame.dn.height());
    let (x0, y0) = (region.x & !1, region.y & !1);
    let dn = Image::from_fn(region.width, region.height, |x, y| *frame.dn.at(x0 + x, y0 + y));
    Mosaic { dn, cfa: frame.cfa, levels: frame.levels }
}

/// Mean and its standard error of each colour over the given sites; `None` if one of them clips, or a colour has none.
pub(super) fn mean_light(known: &KnownMosaic, sites: &Image<bool>) -> Option<([f64; 3], [f64; 3])> {
    let (mut light, mut variance, mut count) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for y in 0..known.value.height() {
        for x in (0..known.value.width()).filter(|x| *sites.at(*x, y)) {
            let colour = known.cfa.colour(x, y);
            light[colour] += f64::from((*known.value.at(x, y))?);
            variance[colour] += f64::from(*known.variance.at(x, y));
            count[colour] += 1.0;
        }
    }
    count.iter().all(|n| *n > 0.0).then(|| {
        let of = |c: usize| (light[c] / count[c], variance[c].sqrt() / count[c]);
        let [r, g, b] = [of(0), of(1), of(2)];
        ([r.0, g.0, b.0], [r.1, g.1, b.1])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels, NoiseModel, isolate};

    fn frame(dn: impl FnMut(usize, usize) -> u16) -> Mosaic {
        let levels = Levels {
            black: [[2048.0; 2]; 2],
            saturation: [[15300.0; 2]; 2],
            black_source: LevelSource::FileTag,
            saturation_source: LevelSource::FileTag,
        };
        Mosaic { dn: Image::from_fn(64, 48, dn), cfa: Cfa::RGGB, levels }
    }

    #[test]
    fn the_light_is_averaged_by_colour_in_the_window_without_clipped_sites() {
        let noise = NoiseModel { gain: 0.0, floor: 4.0 };
        let light = |x: usize, y: usize| [1000, 2000, 3000][Cfa::RGGB.colour(x, y)];
        let off = frame(|_, _| 2100);
        let on = frame(|x, y| match (x, y) {
            (20, 20) => 15300,
            _ if x < 16 => 9000,
            _ => 2100 + light(x, y),
        });
        let [off, on] = [&off, &on].map(|f| part(f, MIDDLE));
        assert_eq!((on.dn.width(), on.dn.height()), (32, 24));
        let sites = safe_sites(&on);
        let (mean, error) = mean_light(&isolate(&on, &off, 1.0, &noise).unwrap(), &sites).unwrap();
        assert_eq!(mean, [1000.0, 2000.0, 3000.0]);
        // Two frames of variance 4 over 191, 384 and 192 sites.
        for (error, sites) in error.into_iter().zip([191.0, 384.0, 192.0]) {
            assert!((error - (8.0_f64 / sites).sqrt()).abs() < 1e-9, "{error} for {sites} sites");
        }
        let blown = part(&frame(|_, _| 15300), MIDDLE);
        let known = isolate(&blown, &off, 1.0, &noise).unwrap();
        assert_eq!(mean_light(&known, &sites), None, "a site that was safe clips");
        assert_eq!(mean_light(&known, &safe_sites(&blown)), None, "no site is safe");
    }

    #[test]
    fn sites_near_saturation_do_not_make_a_flash_look_steady() {
        let noise = NoiseModel { gain: 0.0, floor: 4.0 };
        let off = frame(|_, _| 2048);
        // A tenth of the sites ends just below saturation at nominal energy.
        let shot = |energy: f64| {
            frame(|x, y| {
                let light = if (x / 2 + y / 2) % 10 == 0 { 12_900.0 } else { 6_000.0 };
                (2048.0 + light * energy).min(15300.0) as u16
            })
        };
        let sites = safe_sites(&shot(1.0));
        let mean =
            |energy: f64| mean_light(&isolate(&shot(energy), &off, 1.0, &noise).unwrap(), &sites).unwrap().0;
        let (low, high) = (mean(0.97), mean(1.03));
        assert!((high[1] / low[1] / (1.03 / 0.97) - 1.0).abs() < 1e-3, "{low:?} {high:?}");
    }
}
