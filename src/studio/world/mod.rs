//! The world before the simulated lens.
//!
//! An object of known reflectance stands on a wooden floor between three lamps; the operator walks round it and
//! stops at places known in advance, or holds a white card before the lens, or puts the cap on. [`World`] is what
//! the simulated camera sees: at each release it closes the sync contact, learns what the flash gave, adds the
//! room's light through the shutter and the flash's regardless of the shutter, and reads a noisy sensor out into
//! a DNG. The light itself comes from a path tracer, rendered once without noise and kept in the program.
//!
//! Signals follow the true values behind the labels, powers of 2 by thirds: the room's light goes with
//! `t ISO / N^2`, the flash's with `ISO / N^2` alone.

mod bowl;
mod cache;
mod card;
mod glaze;
pub mod irradiance;
mod known;
pub(super) mod lab;
mod patch;
mod path;
mod render;
mod sampler;
mod sensor;
mod stage;
mod varnish;

pub use cache::{SOURCE_FOLDER, StoredStop, renew};
pub use known::{Known, KnownView, known};
pub(super) use varnish::Varnish;

use super::wires::{SyncContact, View};
use crate::codec::dng::{self, DngContent};
use crate::codec::exr_half::PlanesError;
use crate::codec::jpeg;
use crate::pair::Exposure;
use crate::pair::Settings;
use crate::progress::{Cancelled, Progress};
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// What stands before the lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// The object, seen from stop 1 to [`World::stops`].
    Stop(usize),
    /// The white card, reflectance 0.94, facing the camera in a dark room and filling the frame.
    Card {
        /// Metres from the lens along the optical axis.
        distance_m: f64,
    },
    /// The lens cap: no light at all.
    Cap,
}

/// There is no such stage.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StageError {
    /// A stop that is not on the walk.
    #[error("there is no stop {asked} in the studio; choose one from 1 to {stops}")]
    Stop {
        /// The number asked for.
        asked: usize,
        /// How many there are.
        stops: usize,
    },
    /// A card where no card can stand.
    #[error("the card cannot stand at {distance_m} m; choose a distance from 0.2 to 20 m")]
    Distance {
        /// The distance asked for.
        distance_m: f64,
    },
}

/// Radiances at the sensor plane, lens blur included.
struct Light {
    ambient: Rgb,
    flash: Rgb,
}

/// The world, with its camera at one of the stops. The first stage is `Stop(1)`.
pub struct World {
    contact: Arc<dyn SyncContact>,
    stops: Vec<Arc<Light>>,
    now: Mutex<(Stage, Arc<Light>)>,
    shots: AtomicU64,
}

impl World {
    /// Sets the world up. Quick when the renders inside the program fit it; otherwise it traces them, which
    /// takes minutes and is reported. `contact` is asked at every release what the flash gave.
    pub fn new(contact: Arc<dyn SyncContact>, progress: &Progress) -> Result<Self, WorldError> {
        let surfaces = stage::surfaces();
        let cameras = stage::cameras();
        let stops: Vec<Arc<Light>> = cache::load(&surfaces, &cameras, progress)?
            .into_iter()
            .map(|render| {
                let through =
                    |pick: fn(&path::Seen) -> [f32; 3]| gaussian(&render.image.map(pick), sensor::LENS_SIGMA);
                Arc::new(Light { ambient: through(|s| s.ambient), flash: through(|s| s.flash) })
            })
            .collect();
        let now = Mutex::new((Stage::Stop(1), stops[0].clone()));
        Ok(Self { contact, stops, now, shots: AtomicU64::new(0) })
    }

    /// How many stops the walk round the object has.
    pub fn stops(&self) -> usize {
        self.stops.len()
    }

    /// What stands before the lens now.
    pub fn stage(&self) -> Stage {
        self.now.lock().unwrap_or_else(PoisonError::into_inner).0
    }

    /// Puts something else before the lens.
    pub fn set_stage(&self, stage: Stage) -> Result<(), StageError> {
        let dark = || Rgb::filled(stage::INTRINSICS.width, stage::INTRINSICS.height, [0.0; 3]);
        let light = match stage {
            Stage::Stop(asked) => asked
                .checked_sub(1)
                .and_then(|k| self.stops.get(k))
                .ok_or(StageError::Stop { asked, stops: self.stops() })?
                .clone(),
            Stage::Card { distance_m } => {
                if !(0.2..=20.0).contains(&distance_m) {
                    return Err(StageError::Distance { distance_m });
                }
                let flash = card::radiance(&stage::RING, &stage::INTRINSICS, distance_m);
                Arc::new(Light { ambient: dark(), flash })
            }
            Stage::Cap => Arc::new(Light { ambient: dark(), flash: dark() }),
        };
        *self.now.lock().unwrap_or_else(PoisonError::into_inner) = (stage, light);
        Ok(())
    }

    /// The operator walks on: from a stop to the next, from the last to the first, from anything else to stop 1.
    pub fn walk_on(&self) {
        let next = match self.stage() {
            Stage::Stop(k) if k < self.stops() => k + 1,
            _ => 1,
        };
        // Stop 1 and each stop after a stop but the last exist.
        let _ = self.set_stage(Stage::Stop(next));
    }

    fn light(&self) -> Arc<Light> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner).1.clone()
    }
}

/// The true factors behind the labels, relative to 2^-7 s, f/11 (Av 7) and ISO 100.
struct Factors {
    shutter: f64,
    aperture: f64,
    gain: f64,
}

impl Factors {
    fn of(exposure: &Exposure) -> Self {
        // Labels are rounded powers of 2 by thirds.
        let thirds = |stops: f64| (3.0 * stops).round() / 3.0;
        Self {
            shutter: (thirds(exposure.shutter.0.log2()) + 7.0).exp2(),
            aperture: (7.0 - thirds(2.0 * exposure.aperture.0.log2())).exp2(),
            gain: thirds((exposure.iso.0 / 100.0).log2()).exp2(),
        }
    }
}

impl View for World {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        let shot = self.shots.fetch_add(1, Ordering::Relaxed);
        let light = self.light();
        let energy = self.contact.close();
        let factors = Factors::of(exposure);
        let room = (factors.shutter * factors.aperture) as f32;
        let flash = (energy * factors.aperture) as f32;
        let falling = Image::from_fn(light.ambient.width(), light.ambient.height(), |x, y| {
            let (a, f) = (light.ambient.at(x, y), light.flash.at(x, y));
            std::array::from_fn(|k| a[k] * room + f[k] * flash)
        });
        let frame = sensor::expose(&falling, factors.gain, shot);
        let settings = Settings {
            make: Some("Canon".into()),
            model: Some("Canon EOS 5DS".into()),
            serial: Some("000000000042".into()),
            lens: Some("EF 45mm (simulated)".into()),
            shutter: Some(exposure.shutter),
            aperture: Some(exposure.aperture),
            iso: Some(exposure.iso),
            focal_length_mm: Some(stage::FOCAL_MM),
            exposure_program: Some("Manual".into()),
            white_balance: Some("Manual".into()),
            taken_at: Some(crate::session::utc_now().chars().take(19).collect()),
            ..Settings::default()
        };
        let content =
            DngContent { mosaic: &frame.mosaic, settings: &settings, masked_left: Some(&frame.masked) };
        dng::encode(&content).unwrap_or_else(|error| {
            // An empty file is what a body with a broken card gives; whoever reads it says so.
            tracing::error!("the simulated camera could not write its raw file: {error}");
            Vec::new()
        })
    }

    fn preview(&self) -> Vec<u8> {
        let light = self.light();
        let picture = light.ambient.map(|p| {
            let shown = |k: usize| (p[k] / 0.45).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0;
            [0, 1, 2].map(|k| shown(k).round() as u8)
        });
        jpeg::encode(&picture, 85).unwrap_or_else(|error| {
            tracing::error!("the simulated camera could not make its preview: {error}");
            Vec::new()
        })
    }
}

/// Why the world could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// A stored render is broken.
    #[error("a stored render of the studio cannot be used: {0}; `unlit studio render` renews it")]
    Picture(#[from] PlanesError),
    /// A stored render lacks a channel.
    #[error(
        "the stored render of stop {stop} lacks channel {channel} in the studio's size; `unlit studio render` renews it"
    )]
    Stored {
        /// Name of the stop.
        stop: String,
        /// The channel.
        channel: &'static str,
    },
    /// The folder for renders cannot be used.
    #[error("cannot keep renders in {}: {source}; choose a folder that you may write to", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
