//! How far a session's reflectance is from a known truth.
//!
//! The truth is a folder with `albedo/NAME.tif` (reflectance * 65535 as the camera sees it through its lens),
//! `mask/NAME.tif` (share of the pixel that is object * 255) and `scene.json` (`sensor.lens_psf_sigma_px`).
//! Scored are the pixels all of whose neighbours within 3 pixels (a 7 x 7 square) have mask 255; the error is
//! estimate - truth, the three channels pooled, at full resolution and over those 4 x 4 blocks, counted from
//! the top-left corner, that lie wholly inside. Two estimates are scored: the per-view reflectance images
//! `derived/views/NAME/reflectance.exr` where they say that the value is known, and the texture
//! `model/reflectance.exr` as the same cameras see it.

mod errors;
mod render;

pub use errors::Errors;

use crate::codec::asset::AssetError;
use crate::codec::{exr_image, tiff16};
use crate::pipeline::scene::{self, SceneError};
use crate::pipeline::uvs::{self, UvsError};
use crate::progress::{Cancelled, Progress};
use crate::raster::blocks::{block_means, erode};
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Scene};
use crate::session::Session;
use errors::Pool;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// A pixel counts when every pixel within this Chebyshev distance is wholly object.
pub const EROSION: usize = 3;

/// No paint is as bright as the first where the truth is darker than the second.
const BRIGHT: f32 = 1.05;
const PAINT: f32 = 0.9;

/// Side of the blocks that are averaged for the second figure, pixels.
pub const BLOCK: usize = 4;

/// Why nothing could be scored.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The session's scene cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The texture coordinates that were made for the object cannot be read.
    #[error(transparent)]
    Uvs(#[from] UvsError),
    /// An image cannot be read.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// The truth folder is not laid out as expected.
    #[error("{} is no truth folder: {reason}", path.display())]
    Truth {
        /// The folder.
        path: PathBuf,
        /// What is missing or wrong.
        reason: String,
    },
    /// The session holds nothing to score.
    #[error(
        "the session {} has neither derived/views/NAME/reflectance.exr nor model/reflectance.exr; \
         run `unlit process` first", .0.display()
    )]
    NothingToScore(PathBuf),
    /// None of the truth's views is in the session, or no pixel of theirs counts.
    #[error("{estimate}: no pixel could be scored; {reason}")]
    NoPixels {
        /// Which estimate.
        estimate: &'static str,
        /// Why.
        reason: String,
    },
    /// An image whose size or channels do not fit the truth.
    #[error("{} is {found}, but the truth needs {expected}", path.display())]
    Unfit {
        /// The image.
        path: PathBuf,
        /// What it is.
        found: String,
        /// What it should be.
        expected: String,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Figures of both estimates; `None` for one that the session does not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// The per-view reflectance images.
    pub views: Option<Estimate>,
    /// The finished texture as the cameras see it.
    pub texture: Option<Estimate>,
}

/// Figures of one estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// At full resolution.
    pub full: Errors,
    /// Over 4 x 4 blocks; `None` if no block lies wholly inside.
    pub blocks: Option<Errors>,
    /// Share of the pixels to be scored for which the estimate has a value.
    pub known: f64,
    /// Share of the blocks and channels whose error lies within 1.96 of the standard deviation that the estimate tells
    /// (the mean over the block); `None` where it tells none.
    pub covered: Option<f64>,
    /// Scored pixels and channels above 1.05 where the truth is below 0.9: highlights taken for paint.
    pub bright_spots: usize,
    /// Each view alone, full resolution.
    pub by_view: Vec<ViewErrors>,
    /// Views of the truth that the estimate lacks.
    pub missing: Vec<String>,
}

/// Figures of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewErrors {
    /// File stem of the photo.
    pub name: String,
    /// At full resolution.
    #[serde(flatten)]
    pub full: Errors,
}

/// Scores what the session holds.
pub fn evaluate(session: &Session, truth: &Path, progress: &Progress) -> Result<Evaluation, EvaluateError> {
    let truth = Truth::open(truth)?;
    let mut scene = scene::load(session)?;
    uvs::apply(session, &mut scene)?;
    let view_path = |name: &str| session.derived_dir().join("views").join(name).join("reflectance.exr");
    let texture_path = session.model_dir().join("reflectance.exr");
    let views = if truth.names.iter().any(|name| view_path(name).is_file()) {
        Some(score("per-view images", &truth, progress, |view| {
            let path = view_path(&view.name);
            if path.is_file() { read_view(&path, view).map(Some) } else { Ok(None) }
        })?)
    } else {
        None
    };
    let texture = if texture_path.is_file() {
        Some(score_texture(&texture_path, &scene, &truth, progress)?)
    } else {
        None
    };
    if views.is_none() && texture.is_none() {
        return Err(EvaluateError::NothingToScore(session.path().to_owned()));
    }
    Ok(Evaluation { views, texture })
}

/// Scores a texture in the UVs of the scene's first mesh, row 0 at v = 1.
fn score_texture(
    path: &Path,
    scene: &Scene,
    truth: &Truth,
    progress: &Progress,
) -> Result<Estimate, EvaluateError> {
    let texture = exr_image::read(path)?.rgb().ok_or_else(|| EvaluateError::Unfit {
        path: path.to_owned(),
        found: "without channels R, G and B".into(),
        expected: "an RGB texture".into(),
    })?;
    let beside = path.with_file_name("stddev.exr");
    let deviation = if beside.is_file() {
        let (found, size) = (exr_image::read(&beside)?, (texture.width(), texture.height()));
        let got = (found.width, found.height, found.channels.len());
        let fits = found.rgb().filter(|_| (got.0, got.1) == size);
        Some(fits.ok_or_else(|| EvaluateError::Unfit {
            path: beside.clone(),
            found: format!("{} x {} pixels of {} channels", got.0, got.1, got.2),
            expected: format!("RGB of the texture's {} x {}, or no such file", size.0, size.1),
        })?)
    } else {
        None
    };
    let bare = || EvaluateError::Unfit {
        path: path.to_owned(),
        found: "a texture for a mesh without texture coordinates".into(),
        expected: "an object with UVs".into(),
    };
    let renderer = render::Renderer::new(scene, &texture).ok_or_else(bare)?;
    let deviation =
        deviation.as_ref().map(|d| render::Renderer::new(scene, d).ok_or_else(bare)).transpose()?;
    let cameras: HashMap<&str, &Camera> = scene.cameras.iter().map(|c| (c.name.as_str(), c)).collect();
    score("texture", truth, progress, |view| {
        let Some(camera) = cameras.get(view.name.as_str()) else { return Ok(None) };
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        if (width, height) != (view.albedo.width(), view.albedo.height()) {
            return Err(EvaluateError::Unfit {
                path: truth.folder.join("albedo").join(&view.name),
                found: format!("{} x {} pixels", view.albedo.width(), view.albedo.height()),
                expected: format!("the camera's {width} x {height}"),
            });
        }
        let look =
            |renderer: &render::Renderer| renderer.view(camera, &view.scored, truth.lens_sigma, progress);
        Ok(Some(Guess { value: look(&renderer)?, deviation: deviation.as_ref().map(look).transpose()? }))
    })
}

/// One estimate of a view.
struct Guess {
    /// RGB and 1 where known, 0 elsewhere.
    value: Image<[f32; 4]>,
    /// Its standard deviation as told, where it is told.
    deviation: Option<Image<[f32; 4]>>,
}

fn score(
    estimate: &'static str,
    truth: &Truth,
    progress: &Progress,
    guess: impl Fn(&TruthView) -> Result<Option<Guess>, EvaluateError>,
) -> Result<Estimate, EvaluateError> {
    let (mut full, mut blocks) = (Pool::default(), Pool::default());
    let (mut by_view, mut missing) = (Vec::new(), Vec::new());
    let (mut scored, mut known) = (0_usize, 0_usize);
    let (mut inside, mut judged, mut bright_spots) = (0_usize, 0_usize, 0_usize);
    for (i, name) in truth.names.iter().enumerate() {
        progress.check()?;
        progress.report(&format!("scoring the {estimate}"), i, truth.names.len());
        let view = truth.view(name)?;
        let Some(Guess { value: guess, deviation }) = guess(&view)? else {
            missing.push(name.clone());
            continue;
        };
        let counted = Image::from_fn(guess.width(), guess.height(), |x, y| {
            let [r, g, b, a] = *guess.at(x, y);
            *view.scored.at(x, y) && a > 0.0 && [r, g, b].iter().all(|v| v.is_finite())
        });
        let error = Image::from_fn(guess.width(), guess.height(), |x, y| {
            let (estimate, truth) = (guess.at(x, y), view.albedo.at(x, y));
            [0, 1, 2].map(|c| if *counted.at(x, y) { estimate[c] - truth[c] } else { 0.0 })
        });
        for (x, y) in (0..guess.height()).flat_map(|y| (0..guess.width()).map(move |x| (x, y))) {
            let bright = |c: &usize| guess.at(x, y)[*c] > BRIGHT && view.albedo.at(x, y)[*c] < PAINT;
            bright_spots += if *counted.at(x, y) { (0..3).filter(bright).count() } else { 0 };
        }
        let mut own = Pool::default();
        own.extend(error.pixels().iter().zip(counted.pixels()).filter(|(_, c)| **c).map(|(e, _)| *e));
        scored += view.scored.pixels().iter().filter(|s| **s).count();
        known += counted.pixels().iter().filter(|c| **c).count();
        // The mean of differences is the difference of means, so the error image itself is averaged.
        let means = block_means(&error, &counted, BLOCK);
        if let Some(deviation) = deviation {
            let told = block_means(&deviation, &counted, BLOCK);
            for (e, sd) in means.iter().zip(&told) {
                inside += (0..3).filter(|&c| e[c].abs() <= 1.96 * sd[c]).count();
                judged += 3;
            }
        }
        blocks.extend(means);
        if let Some(full) = own.errors() {
            by_view.push(ViewErrors { name: name.clone(), full });
        }
        full.merge(own);
    }
    progress.report(&format!("scoring the {estimate}"), truth.names.len(), truth.names.len());
    let full = full.errors().ok_or_else(|| EvaluateError::NoPixels {
        estimate,
        reason: if missing.len() == truth.names.len() {
            format!("the session has none of the truth's views ({})", missing.join(", "))
        } else {
            "nothing is known where the object is".into()
        },
    })?;
    let known = known as f64 / scored.max(1) as f64;
    let covered = (judged > 0).then(|| inside as f64 / judged as f64);
    Ok(Estimate { full, blocks: blocks.errors(), known, covered, bright_spots, by_view, missing })
}

fn read_view(path: &Path, view: &TruthView) -> Result<Guess, EvaluateError> {
    let unfit = |found: String| EvaluateError::Unfit {
        path: path.to_owned(),
        found,
        expected: format!(
            "{} x {} pixels with channels R, G, B and A",
            view.albedo.width(),
            view.albedo.height()
        ),
    };
    let image = exr_image::read(path)?;
    if (image.width, image.height) != (view.albedo.width(), view.albedo.height()) {
        return Err(unfit(format!("{} x {} pixels", image.width, image.height)));
    }
    let value = image.rgba().ok_or_else(|| unfit("without one of the channels".into()))?;
    Ok(Guess { value, deviation: None })
}

struct Truth {
    folder: PathBuf,
    names: Vec<String>,
    lens_sigma: f32,
}

struct TruthView {
    name: String,
    albedo: Rgb,
    scored: Image<bool>,
}

impl Truth {
    fn open(folder: &Path) -> Result<Self, EvaluateError> {
        let wrong = |reason: String| EvaluateError::Truth { path: folder.to_owned(), reason };
        let listing = std::fs::read_dir(folder.join("albedo"))
            .map_err(|e| wrong(format!("albedo cannot be listed, {e}")))?;
        let mut names: Vec<String> = listing
            .filter_map(Result::ok)
            .map(|entry| entry.path())
            .filter(|p| p.extension().is_some_and(|e| e == "tif"))
            .filter_map(|p| Some(p.file_stem()?.to_string_lossy().into_owned()))
            .collect();
        names.sort();
        if names.is_empty() {
            return Err(wrong("albedo holds no NAME.tif".into()));
        }
        let facts = std::fs::read(folder.join("scene.json"))
            .map_err(|e| wrong(format!("scene.json cannot be read, {e}")))?;
        let facts: serde_json::Value =
            serde_json::from_slice(&facts).map_err(|e| wrong(format!("scene.json is no JSON, {e}")))?;
        let sigma = facts["sensor"]["lens_psf_sigma_px"].as_f64().filter(|s| (0.0..=100.0).contains(s));
        let sigma = sigma.ok_or_else(|| {
            wrong("scene.json lacks sensor.lens_psf_sigma_px, the lens blur in pixels, 0 to 100".into())
        })?;
        Ok(Self { folder: folder.to_owned(), names, lens_sigma: sigma as f32 })
    }

    fn view(&self, name: &str) -> Result<TruthView, EvaluateError> {
        let file = format!("{name}.tif");
        let albedo = tiff16::read_rgb(&self.folder.join("albedo").join(&file))?;
        let mask_path = self.folder.join("mask").join(&file);
        let mask = tiff16::read_grey8(&mask_path)?;
        if (mask.width(), mask.height()) != (albedo.width(), albedo.height()) {
            return Err(EvaluateError::Unfit {
                path: mask_path,
                found: format!("{} x {} pixels", mask.width(), mask.height()),
                expected: format!("the albedo's {} x {}", albedo.width(), albedo.height()),
            });
        }
        let scored = erode(&mask.map(|&m| m == 255), EROSION);
        Ok(TruthView { name: name.to_owned(), albedo, scored })
    }
}
