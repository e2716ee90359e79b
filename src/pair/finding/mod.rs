//! Finding the exposure from at most four test shots, by computing from sensor values.
//!
//! Takes a wish, what the camera's dials offer and where they stand; says which test shot to take next, takes its
//! sensor values, gives the plan under which the brightest channel of the lit frame ends at the wished share of
//! saturation inside the region. Brightness is the 99.9 % quantile of a filter position's sites in the region
//! above black, as a share of the range to saturation. Room light goes with t ISO / N^2, flash light with
//! ISO / N^2 alone. A clipped shot tells by its unclipped quantiles how far to come down (where a measured one has
//! foretold nearly as much, it only raises that to what clips), a dark one by its noise how far up it is safe to go; 14
//! bits hold enough range that the next shot is then neither.

mod brightness;
mod wish;

pub use wish::{FindingError, Found, Keep, Next, Wish};

use super::plan::{Exposure, Offered, Plan};
use crate::photometry::Mosaic;
use crate::photometry::apex::ExposureScale;
use crate::photometry::inspect::Region;
use crate::units::{Iso, Seconds};
use brightness::{ALL_CLIPPED, Brightness, brightness};

/// Most test shots.
pub const MOST_SHOTS: usize = 4;
/// Stops by which the plan may miss the wished share: a third, less what the noise of a high ISO may lift an estimate.
const TOLERANCE: f64 = 1.0 / 3.0 - 0.07;
/// Stops within which a finished test shot needs no better one: half a step of a third.
const GOOD: f64 = 0.2;
/// Share of saturation up to which a prediction, its noise on top, does not come out clipped.
const SAFE: f64 = 0.94;
/// Standard deviations of noise that the brightest thousandth lies above its light, and one shot's above another's.
const NOISE_ABOVE: f64 = 2.0;
/// What a shot aims at whose predecessor was clipped, as a share of the target: its estimate is rough.
const CAREFUL: f64 = 0.5;
/// The same after an unlit shot in which nearly all of a colour was clipped: how far it is over, nobody knows.
const BLIND: f64 = 0.06;
/// Share of saturation that a prediction must have reached, and how many times it the rough estimate of a clipped shot
/// may be, for this shot not to contradict what an earlier one has measured.
const FORETOLD: (f64, f64) = (0.7, 2.0);
/// Slowest shutter of a longer unlit frame, seconds: beyond, the sensor's own dark signal counts.
const LONGEST_UNLIT: f64 = 1.0;
/// Share of saturation at which a longer unlit frame's room light may end.
const UNLIT_SHARE: f64 = 0.6;
/// Share of the lit frame's light from which on the room dominates: its noise then outweighs the flash's.
const ROOM_DOMINATES: f64 = 0.5;

/// A search under way. `S` says how light scales with settings: by what labels stand for, or by a body's measured table.
#[derive(Clone, Debug)]
pub struct Finding<S> {
    wish: Wish,
    scale: S,
    choices: Vec<Exposure>,
    /// Amplification at the lowest ISO to choose from.
    base_gain: f64,
    start: Exposure,
    offered: Offered,
    /// Light of each filter position at unit S (room) and unit ISO / N^2 (flash), at most.
    room: [f64; 4],
    flash: [f64; 4],
    unlit: Option<Shot>,
    lit: Option<Shot>,
    /// Whether room and flash are as a lit shot within the sensor's range told them, or little brighter.
    told: bool,
    /// Settings of lit shots in which too much was clipped.
    clipped: Vec<Exposure>,
    shots: usize,
}

/// A test shot, measured.
#[derive(Clone, Copy, Debug)]
struct Shot {
    exposure: Exposure,
    seen: [Brightness; 4],
}

impl Shot {
    fn is_clipped(&self) -> bool {
        self.seen.iter().any(Brightness::is_clipped)
    }

    fn is_blown(&self) -> bool {
        self.seen.iter().any(|b| b.top >= ALL_CLIPPED)
    }

    fn is_known(&self) -> bool {
        !self.is_clipped() && self.seen.iter().any(|b| b.known)
    }
}

impl<S: ExposureScale> Finding<S> {
    /// Begins a search at the settings `start`.
    pub fn new(wish: Wish, offered: &Offered, start: Exposure, scale: S) -> Result<Self, FindingError> {
        if !(wish.target_share > 0.0 && wish.target_share < 1.0) {
            let sentence = "the target must lie between 0 and 1 of saturation, such as 0.85".to_owned();
            return Err(FindingError::Wish(sentence));
        }
        let sane = |v: f64| v.is_finite() && v > 0.0;
        if ![start.shutter.0, start.aperture.0, start.iso.0].into_iter().all(sane) {
            let sentence =
                format!("{start} is no exposure; set shutter, aperture and ISO on the camera first");
            return Err(FindingError::Wish(sentence));
        }
        // Slower than at the start only the room's light grows, faster than X-sync the flash is cut.
        let (begin, sync) = (scale.time(start.shutter), scale.time(wish.x_sync));
        let (fastest, slowest) = (sync * 0.99, begin.max(sync) * 1.01);
        let within = |t: &Seconds| (fastest..=slowest).contains(&scale.time(*t));
        let shutters = offered.shutters.iter().copied().filter(|t| sane(t.0)).filter(within);
        let shutters = choices(start.shutter, wish.keep.shutter, shutters);
        let apertures = offered.apertures.iter().copied().filter(|n| sane(n.0));
        let apertures = choices(start.aperture, wish.keep.aperture, apertures);
        let isos = choices(start.iso, wish.keep.iso, offered.isos.iter().copied().filter(|iso| sane(iso.0)));
        // A start faster than X-sync would show the flash in a stripe only.
        let start = match shutters.first() {
            Some(&slow) if begin < fastest && !wish.keep.shutter => Exposure { shutter: slow, ..start },
            _ => start,
        };
        let mut all = vec![];
        for &shutter in &shutters {
            for &aperture in &apertures {
                all.extend(isos.iter().map(|&iso| Exposure { shutter, aperture, iso }));
            }
        }
        let base_gain = isos.iter().map(|iso| scale.gain(*iso)).fold(f64::INFINITY, f64::min);
        Ok(Self {
            wish,
            scale,
            choices: all,
            base_gain,
            start,
            offered: offered.clone(),
            room: [0.0; 4],
            flash: [0.0; 4],
            unlit: None,
            lit: None,
            told: false,
            clipped: vec![],
            shots: 0,
        })
    }

    /// The next test shot, or the result.
    pub fn next(&self) -> Result<Next, FindingError> {
        let shoot = |exposure, flash| Ok(Next::Shoot { exposure, flash });
        // The room first: it tells how much of the lit frame is the flash's.
        match (&self.unlit, &self.lit) {
            (None, _) if !self.wish.flash_only => return shoot(self.start, false),
            (Some(unlit), None) if unlit.is_clipped() => {
                let careful = if unlit.is_blown() { BLIND } else { CAREFUL };
                let darker = self.best(careful * self.wish.target_share);
                // One shot at least must be left for the flash.
                if darker == unlit.exposure || self.shots + 1 >= MOST_SHOTS {
                    return Err(self.unreachable(darker));
                }
                return shoot(darker, false);
            }
            (_, None) => return shoot(self.first_lit(), true),
            _ => {}
        }
        let Some(lit) = self.lit else { return shoot(self.start, true) };
        let left = MOST_SHOTS.saturating_sub(self.shots);
        let told = lit.is_known() || self.told && lit.is_clipped();
        if !told {
            let aim = if lit.is_clipped() { CAREFUL } else { 1.0 } * self.wish.target_share;
            let better = self.best(aim);
            if better == lit.exposure {
                return Err(self.unreachable(better));
            }
            return if left > 0 {
                shoot(better, true)
            } else {
                Err(FindingError::Unsettled { next: better })
            };
        }
        let best = self.best(self.wish.target_share);
        let off_by = |exposure| (self.share(exposure) / self.wish.target_share).log2().abs();
        if off_by(best) > TOLERANCE {
            return Err(self.unreachable(best));
        }
        // A test shot that is as good as any is the plan, else the plan is tried if shots are left.
        if self.clipped.contains(&best) {
            return Err(self.unreachable(best));
        }
        let as_good = lit.exposure == best
            || off_by(lit.exposure) < GOOD && self.cost(lit.exposure) <= self.cost(best) + GOOD;
        match (as_good && lit.is_known() && self.fits(&lit), left) {
            (true, _) => Ok(Next::Done(self.found(lit.exposure))),
            (false, 0) => Ok(Next::Done(self.found(best))),
            (false, _) => shoot(best, true),
        }
    }

    /// Takes the sensor values of the shot that [`Finding::next`] asked for.
    pub fn observe(&mut self, shot: &Mosaic) -> Result<(), FindingError> {
        let Next::Shoot { exposure, flash } = self.next()? else { return Ok(()) };
        let (width, height) = (shot.dn.width(), shot.dn.height());
        let whole = Region { x: 0, y: 0, width, height };
        let region = self.wish.region.map_or(whole, |window| window.sites(width, height));
        let shot = Shot { exposure, seen: brightness(shot, region) };
        self.shots += 1;
        if flash {
            let (room, gain) = (self.room_scale(exposure), self.flash_scale(exposure));
            let foretold = self.share(exposure);
            let rough = shot.seen.iter().map(|b| b.top).fold(0.0, f64::max);
            let kept =
                self.told && shot.is_clipped() && foretold > FORETOLD.0 && rough < FORETOLD.1 * foretold;
            self.told = shot.is_known() || kept;
            if kept {
                // What a measured shot has told stands, but that there is enough light to clip.
                let more = (1.0 / foretold).max(1.0);
                self.flash = self.flash.map(|f| f * more);
                self.room = self.room.map(|r| r * more);
            }
            for (c, seen) in shot.seen.iter().enumerate().filter(|_| !kept) {
                let light = if shot.is_known() { seen.signal() } else { seen.at_most() };
                self.flash[c] = (light - self.room[c] * room).max(0.0) / gain;
                // Less light than the room alone should give: what was thought the room's was noise.
                self.room[c] = self.room[c].min(light / room);
            }
            let too_bright = shot.is_clipped() || !self.fits(&shot);
            self.clipped.extend(too_bright.then_some(exposure));
            self.lit = Some(shot);
        } else {
            let room = self.room_scale(exposure);
            self.room = shot.seen.map(|seen| if seen.known { seen.signal() } else { seen.at_most() } / room);
            self.unlit = Some(shot);
        }
        Ok(())
    }

    fn fits(&self, shot: &Shot) -> bool {
        shot.seen.iter().all(|b| b.clipped <= self.wish.clipped_share)
    }

    fn room_scale(&self, e: Exposure) -> f64 {
        self.scale.room(e.shutter, e.aperture, e.iso)
    }

    fn flash_scale(&self, e: Exposure) -> f64 {
        self.scale.flash(e.aperture, e.iso)
    }

    /// Room and flash light of the channel that is brightest at these settings, shares of saturation.
    fn shares(&self, e: Exposure) -> (f64, f64) {
        let (room, gain) = (self.room_scale(e), self.flash_scale(e));
        let of = |c: usize| (self.room[c] * room, self.flash[c] * gain);
        (0..4).map(of).max_by(|a, b| (a.0 + a.1).total_cmp(&(b.0 + b.1))).unwrap_or_default()
    }

    fn share(&self, e: Exposure) -> f64 {
        let (room, flash) = self.shares(e);
        room + flash
    }

    /// How unwelcome settings are apart from their brightness, in stops.
    fn cost(&self, e: Exposure) -> f64 {
        let n = -self.scale.aperture(e.aperture).log2();
        // f/8 to f/16 are sharp and deep; past them diffraction blurs, before them depth is lost, and wider than
        // f/4 some bodies scale their raw values.
        let aperture =
            2.0 * (n - 8.0).max(0.0) + 2.5 * (6.0 - n).max(0.0) + if n < 3.9 { 100.0 } else { 0.0 };
        let iso = (self.scale.gain(e.iso) / self.base_gain.max(self.scale.gain(Iso(100.0)))).log2();
        // Below ISO 100 bodies only pull.
        let iso = if iso < -0.01 { 1.0 - iso } else { iso };
        let shutter = 0.5 * (self.scale.time(e.shutter) / self.scale.time(self.start.shutter)).log2().abs();
        let (room, flash) = self.shares(e);
        let dominated = (room / (room + flash).max(f64::MIN_POSITIVE) - ROOM_DOMINATES).max(0.0);
        let dominated = if self.lit.is_some() { 20.0 * dominated } else { 0.0 };
        aperture + iso.max(0.0) + shutter + dominated
    }

    /// The settings that come nearest to a share of saturation; among those within half a step the most welcome.
    fn best(&self, target: f64) -> Exposure {
        let miss = |e: &Exposure| (self.share(*e).max(1e-9) / target).log2().abs();
        let safe: Vec<Exposure> = self.choices.iter().copied().filter(|e| self.is_safe(*e, target)).collect();
        let pool = if safe.is_empty() { &self.choices } else { &safe };
        let nearest = pool.iter().map(miss).fold(f64::INFINITY, f64::min);
        // Half a step of a third is 0.17; a little more makes room for a welcome one.
        let reached = pool.iter().filter(|e| miss(e) <= nearest.max(GOOD) + 1e-9);
        let unwelcome = |e: &Exposure| self.cost(*e) + miss(e);
        reached.min_by(|a, b| unwelcome(a).total_cmp(&unwelcome(b))).copied().unwrap_or(self.start)
    }

    /// Whether settings should not come out clipped: not predicted so near to saturation that noise does it, nor as
    /// bright as a lit shot that was. Those of a lit shot that came out well clear of saturation are.
    fn is_safe(&self, e: Exposure, target: f64) -> bool {
        let came_out = |lit: &Shot| lit.seen.iter().all(|b| b.top < SAFE) && self.fits(lit);
        if self.lit.as_ref().is_some_and(|lit| lit.exposure == e && came_out(lit)) {
            return true;
        }
        let (room, flash) = (self.room_scale(e), self.flash_scale(e));
        let as_bright = |c: &Exposure| room >= self.room_scale(*c) && flash >= self.flash_scale(*c);
        self.share(e) + NOISE_ABOVE * self.noise(e) <= target.max(SAFE) && !self.clipped.iter().any(as_bright)
    }

    /// Standard deviation of a site's noise at these settings, by the last lit shot: shot noise goes with the root of
    /// light and of gain.
    fn noise(&self, e: Exposure) -> f64 {
        let Some(lit) = &self.lit else { return 0.0 };
        let noise = lit.seen.iter().map(|b| b.noise).fold(0.0, f64::max);
        let gain = self.scale.gain(e.iso) / self.scale.gain(lit.exposure.iso);
        let light = self.share(e) / self.share(lit.exposure).max(1e-9);
        noise * (gain * light).max(0.0).sqrt()
    }

    /// Settings of the first lit shot: those of the start, unless the room alone is too bright at them.
    fn first_lit(&self) -> Exposure {
        let room = self.share(self.start);
        if room > ROOM_DOMINATES * self.wish.target_share {
            self.best(ROOM_DOMINATES * self.wish.target_share)
        } else {
            self.start
        }
    }

    fn found(&self, on: Exposure) -> Found {
        let (ambient_share, flash_share) = self.shares(on);
        let mut warnings = vec![];
        if on.aperture.0 < 3.95 {
            warnings.push(format!(
                "{} is wider than f/4: some bodies scale their raw values there, and little is in focus; more flash power would allow f/8.",
                on.aperture
            ));
        }
        if ambient_share > ROOM_DOMINATES * (ambient_share + flash_share) {
            warnings.push(
                "The room gives more of the light than the flash does, so that its noise dominates; dim the room or raise the flash's power."
                    .to_owned(),
            );
        }
        let off = if self.wish.separate_off { self.longer_unlit(on) } else { on };
        Found {
            plan: Plan { off, on },
            predicted_share: ambient_share + flash_share,
            ambient_share,
            flash_share,
            shots: self.shots,
            warnings,
        }
    }

    /// The longest exposure of the unlit frame at which the room's light stays well below saturation.
    fn longer_unlit(&self, on: Exposure) -> Exposure {
        let time = |t: Seconds| self.scale.time(t);
        let fits = |t: &Seconds| {
            let room = self.room_scale(Exposure { shutter: *t, ..on });
            time(*t) > time(on.shutter)
                && time(*t) <= LONGEST_UNLIT
                && self.room.iter().all(|r| r * room <= UNLIT_SHARE)
        };
        let longest = self.offered.shutters.iter().copied().filter(fits);
        let shutter = longest.max_by(|a, b| time(*a).total_cmp(&time(*b))).unwrap_or(on.shutter);
        Exposure { shutter, ..on }
    }

    /// The error for a target that even the nearest settings miss.
    fn unreachable(&self, nearest: Exposure) -> FindingError {
        let (room, flash) = self.shares(nearest);
        let (share, target, exposure) = (room + flash, self.wish.target_share, nearest);
        let scale = |e: &Exposure| self.share(*e);
        let brighter = self.choices.iter().any(|e| scale(e) > 1.01 * share);
        let darker = self.choices.iter().any(|e| scale(e) < 0.99 * share);
        if share > target && !darker {
            let advice = if room > flash {
                "dim the room, or put a neutral density filter on the lens"
            } else {
                "lower the flash's power, move it away, or put a neutral density filter on the lens"
            };
            FindingError::TooBright { exposure, share, target, advice }
        } else if share < target && !brighter {
            FindingError::TooDark { exposure, share, target }
        } else {
            FindingError::TooCoarse { exposure, share, target }
        }
    }
}

/// The values that a setting may take: where it stands, and what is offered unless it must stay.
fn choices<T: Copy + PartialEq>(start: T, keep: bool, offered: impl Iterator<Item = T>) -> Vec<T> {
    let mut all = if keep { vec![] } else { offered.collect::<Vec<T>>() };
    if all.is_empty() {
        all.push(start);
    }
    all
}

#[cfg(test)]
mod tests;
