//! A session as a folder for photogrammetry: one developed photo for each accepted pair, under the pair's name, so that
//! cameras come back matched; and the scene's cameras, where there is a scene, in the program's own form.
//!
//! Photos are as the lens drew them (not undistorted) and as the sensor lay (not turned): full size, sRGB, all brightened
//! by one factor.

use super::calibrate::RecordError;
use super::colour::{ColoursError, SessionColours};
use super::develop::{DevelopError, isolated_sites};
use super::export::refuse_inside;
use super::levels;
use super::scene::{self, SceneError};
use crate::codec::asset::AssetError;
use crate::codec::jpeg::{self, JpegError};
use crate::codec::tiff16::{self, Told};
use crate::export::colour::LINEAR_SRGB;
use crate::pair::{PairRecord, Settings, Verdict};
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::{Mosaic, NoiseModel, demosaic, isolate_dark};
use crate::progress::{Cancelled, Progress};
use crate::raster::{Rgb, srgb};
use crate::scene::{Camera, export as camera_files};
use crate::session::{Session, SessionError};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The program that is to read the folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// Agisoft Metashape: BlocksExchange XML beside the photos.
    Metashape,
    /// RealityScan (RealityCapture): an XMP sidecar for each photo.
    RealityScan,
    /// COLMAP: `images/` and a text model in `sparse/0/`.
    Colmap,
}

/// Which light the photos show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Light {
    /// The flash's own: lit frame less unlit frame.
    #[default]
    Known,
    /// Flash and room: the lit frame.
    Lit,
    /// The room's: the unlit frame.
    Ambient,
}

/// File format of the photos.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Picture {
    /// 16 bits, without loss.
    #[default]
    Tiff,
    /// 8 bits, small.
    Jpeg,
}

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhotosOptions {
    /// Who is to read it.
    pub program: Program,
    /// Which light.
    pub light: Light,
    /// In which format.
    pub picture: Picture,
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhotosExported {
    /// Developed photos.
    pub photos: Vec<PathBuf>,
    /// Other files.
    pub files: Vec<PathBuf>,
    /// What is to be known of them, in sentences.
    pub notes: Vec<String>,
}

/// Why not everything was written. What was written before stays.
#[derive(Debug, thiserror::Error)]
pub enum PhotosError {
    /// Nothing to write.
    #[error("{} has no accepted pair: shoot or import some first", .0.display())]
    NoPairs(PathBuf),
    /// The folder is not new.
    #[error("{} is not empty: photos of two exports would mix, give a new folder", .0.display())]
    NotEmpty(PathBuf),
    /// The folder is the session's.
    #[error(transparent)]
    Folder(#[from] super::export::ExportError),
    /// Session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The measured levels.
    #[error(transparent)]
    Levels(#[from] RecordError),
    /// The camera's colours.
    #[error(transparent)]
    Colours(#[from] ColoursError),
    /// A pair cannot be developed.
    #[error(transparent)]
    Develop(#[from] DevelopError),
    /// A TIFF.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// A JPEG.
    #[error(transparent)]
    Jpeg(#[from] JpegError),
    /// The disk refused.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// JPEG quality: what it loses is far below what feature detectors see.
const QUALITY: u8 = 95;
/// Pairs that settle the common brightness, spread over the session.
const SAMPLES: usize = 5;
/// Share of the pixels that lie below [`BRIGHT`] in the median of those pairs.
const SHARE: f64 = 0.995;
/// Where they end, of 1.
const BRIGHT: f32 = 0.9;

/// Writes the folder `to`, which must be new or empty.
pub fn export(
    session: &Session,
    to: &Path,
    options: PhotosOptions,
    progress: &Progress,
) -> Result<PhotosExported, PhotosError> {
    refuse_inside(session, to)?;
    if std::fs::read_dir(to).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(PhotosError::NotEmpty(to.to_owned()));
    }
    let (pairs, rejected): (Vec<_>, Vec<_>) =
        session.pairs()?.into_iter().partition(|pair| pair.verdict == Verdict::Accepted);
    if pairs.is_empty() {
        return Err(PhotosError::NoPairs(session.path().to_owned()));
    }
    let cameras = match scene::load_file(session) {
        Ok(file) => file.cameras,
        Err(SceneError::NoScene(_)) => vec![],
        Err(error) => return Err(error.into()),
    };
    let mut exported = PhotosExported::default();
    if !rejected.is_empty() {
        let names: Vec<&str> = rejected.iter().map(|pair| pair.name.as_str()).collect();
        exported.notes.push(format!("left out, because rejected: {}", names.join(", ")));
    }
    let taken: Vec<&PairRecord> = pairs.iter().map(|pair| &**pair).collect();
    let developer = Developer::new(session, &taken, options.light)?;
    exported.notes.extend(developer.note.clone());
    if developer.colour.is_none() {
        exported
            .notes
            .push("nothing is known of this camera's colours: the photos show its own as if sRGB".into());
    }
    let total = pairs.len();
    let gain = developer.gain(&pairs, progress)?;
    let folder = match options.program {
        Program::Colmap => to.join("images"),
        Program::Metashape | Program::RealityScan => to.to_owned(),
    };
    std::fs::create_dir_all(&folder).map_err(io(&folder))?;
    let extension = match options.picture {
        Picture::Tiff => "tif",
        Picture::Jpeg => "jpg",
    };
    let mut posed = vec![];
    for (done, pair) in pairs.iter().enumerate() {
        progress.check()?;
        progress.report("developing photos", done, total);
        let photo = developer.develop(pair)?;
        let name = format!("{}.{extension}", pair.name);
        let path = folder.join(&name);
        let settings = match options.light {
            Light::Ambient => &pair.off.settings,
            Light::Known | Light::Lit => &pair.on.settings,
        };
        write(&path, &photo, gain, settings, options.picture)?;
        exported.photos.push(path);
        match cameras.iter().find(|camera| camera.name == pair.name) {
            Some(camera)
                if (camera.intrinsics.width, camera.intrinsics.height) == (photo.width(), photo.height()) =>
            {
                posed.push((camera, name));
            }
            Some(_) => exported.notes.push(format!(
                "{}: the scene's camera is of another size than the photo; its pose was left out",
                pair.name
            )),
            None if cameras.is_empty() => {}
            None => exported.notes.push(format!("{}: the scene has no camera of this name", pair.name)),
        }
    }
    progress.report("developing photos", total, total);
    let mut texts = camera_texts(options.program, &posed, &mut exported.notes);
    texts.push(("README.txt".into(), readme(options, &exported, &posed)));
    for (name, text) in texts {
        let path = to.join(name);
        let parent = path.parent().unwrap_or(to);
        std::fs::create_dir_all(parent).map_err(io(parent))?;
        std::fs::write(&path, text).map_err(io(&path))?;
        exported.files.push(path);
    }
    Ok(exported)
}

/// Develops the frames of one session alike.
struct Developer<'a> {
    session: &'a Session,
    measured: MeasuredLevels,
    light: Light,
    /// What a white surface reads in each channel.
    white: [f64; 3],
    /// Linear sRGB of the sensor's channels; `None` where nothing is known of its colours.
    colour: Option<DMat3>,
    /// What is to be told of the colours.
    note: Option<String>,
}

impl<'a> Developer<'a> {
    fn new(session: &'a Session, pairs: &[&PairRecord], light: Light) -> Result<Self, PhotosError> {
        let SessionColours { matrix: known, note } = SessionColours::known(session, pairs)?;
        let white = known.as_ref().map_or(DVec3::ONE, |known| DVec3::from_array(known.white));
        let colour = known
            .map(|known| known.to(&LINEAR_SRGB) * DMat3::from_diagonal(white.recip()))
            .filter(|matrix| matrix.is_finite());
        Ok(Self { session, measured: levels::load(session)?, light, white: white.to_array(), colour, note })
    }

    /// The photo, linear, in DN above black; what clipped is infinitely bright.
    fn develop(&self, pair: &PairRecord) -> Result<Rgb, PhotosError> {
        let folder = self.session.pair_dir(pair);
        let read = |file: &str| -> Result<Mosaic, DevelopError> {
            Ok(levels::read(&folder.join(file), &self.measured)?.mosaic)
        };
        // Nobody asks how sure a photo for photogrammetry is.
        let noise = NoiseModel { gain: 0.0, floor: 0.0 };
        let sites = match self.light {
            Light::Lit => isolate_dark(&read(&pair.on.file)?, &noise),
            Light::Ambient => isolate_dark(&read(&pair.off.file)?, &noise),
            Light::Known => isolated_sites(self.session, pair, &self.measured, &noise)?,
        };
        let known = demosaic(&sites, self.white);
        let mut photo = known.rgb;
        for (pixel, valid) in photo.pixels_mut().iter_mut().zip(known.valid.pixels()) {
            *pixel = match (valid, self.colour) {
                (false, _) => [f32::INFINITY; 3],
                (true, None) => *pixel,
                (true, Some(matrix)) => {
                    (matrix * DVec3::from(pixel.map(f64::from))).to_array().map(|v| v as f32)
                }
            };
        }
        Ok(photo)
    }

    /// The factor that brightens all photos.
    fn gain(&self, pairs: &[Arc<PairRecord>], progress: &Progress) -> Result<f32, PhotosError> {
        let mut bright = vec![];
        let samples = pairs.len().min(SAMPLES);
        for i in 0..samples {
            progress.check()?;
            progress.report("finding the photos' brightness", i, samples);
            let photo = self.develop(&pairs[i * pairs.len() / samples])?;
            let mut values: Vec<f32> = photo
                .pixels()
                .iter()
                .map(|p| p.iter().copied().fold(0.0, f32::max))
                .filter(|v| v.is_finite())
                .collect();
            if !values.is_empty() {
                let at = ((values.len() - 1) as f64 * SHARE) as usize;
                bright.push(*values.select_nth_unstable_by(at, f32::total_cmp).1);
            }
        }
        bright.sort_by(f32::total_cmp);
        let median = bright.get(bright.len() / 2).copied().unwrap_or(0.0);
        Ok(if median > 0.0 { BRIGHT / median } else { 1.0 })
    }
}

fn write(
    path: &Path,
    photo: &Rgb,
    gain: f32,
    settings: &Settings,
    picture: Picture,
) -> Result<(), PhotosError> {
    // A black that clipped nowhere: 0 times infinity has no number.
    let shown = |v: &f32| if v.is_finite() { v * gain } else { 1.0 };
    match picture {
        Picture::Tiff => {
            let told = Told {
                description: Some("sRGB"),
                software: Some(concat!("unlit ", env!("CARGO_PKG_VERSION"))),
                settings: Some(settings),
                ..Told::default()
            };
            let encoded = photo.map(|p| p.each_ref().map(|v| srgb::encode(shown(v))));
            Ok(tiff16::write_rgb16_told(path, &encoded, &told)?)
        }
        Picture::Jpeg => {
            let encoded = photo.map(|p| p.each_ref().map(|v| srgb::encode_u8(shown(v))));
            std::fs::write(path, jpeg::encode_taken(&encoded, QUALITY, settings)?).map_err(io(path))
        }
    }
}

/// Camera files and their names, from the folder.
fn camera_texts(
    program: Program,
    posed: &[(&Camera, String)],
    notes: &mut Vec<String>,
) -> Vec<(String, String)> {
    if posed.is_empty() {
        return vec![];
    }
    match program {
        Program::Metashape => {
            vec![("cameras.xml".into(), camera_files::blocks_exchange("unlit", posed))]
        }
        Program::Colmap => vec![
            ("sparse/0/cameras.txt".into(), camera_files::colmap_cameras(posed)),
            ("sparse/0/images.txt".into(), camera_files::colmap_images(posed)),
            ("sparse/0/points3D.txt".into(), "# no points\n".into()),
        ],
        Program::RealityScan => {
            if posed.iter().any(|(camera, _)| camera_files::reality_scan_lacks(camera)) {
                let note = "the lens's tangential distortion or second focal length was not written: RealityScan settles it";
                notes.push(note.into());
            }
            posed
                .iter()
                .map(|(camera, _)| (format!("{}.xmp", camera.name), camera_files::reality_scan(camera)))
                .collect()
        }
    }
}

fn readme(options: PhotosOptions, exported: &PhotosExported, posed: &[(&Camera, String)]) -> String {
    let light = match options.light {
        Light::Known => "the flash's own light: lit frame less unlit frame",
        Light::Lit => "flash and room light: the lit frame",
        Light::Ambient => "the room's light: the unlit frame",
    };
    let poses = posed.len();
    let how = match (options.program, poses) {
        (Program::Metashape, 0) => "Metashape: Workflow, Add Photos, all of this folder; then align.".into(),
        (Program::Metashape, _) => format!(
            "Metashape: Workflow, Add Photos; then File, Import, Import Cameras, Blocks Exchange: cameras.xml ({poses} poses, metres)."
        ),
        (Program::RealityScan, 0) => "RealityScan: add this folder; then align.".into(),
        (Program::RealityScan, _) => format!(
            "RealityScan: add this folder; each photo's .xmp brings its pose ({poses} poses, metres)."
        ),
        (Program::Colmap, 0) => {
            "COLMAP: images/ is the image path; make the database and the model as usual.".into()
        }
        (Program::Colmap, _) => format!(
            "COLMAP: images/ is the image path; sparse/0/ is a text model of {poses} poses in metres without points \
             (point_triangulator makes them)."
        ),
    };
    let notes: String = exported.notes.iter().map(|note| format!("- {note}\n")).collect();
    format!(
        "Photos of an unlit session for photogrammetry: {} of them, one for each accepted pair, under the pair's name.\n\
         Keep the names: unlit matches the cameras that come back by them.\n\n\
         Light: {light}.\n\
         Full size, as the lens drew them (not undistorted) and as the sensor lay (not turned); sRGB, all brightened by\n\
         one factor.\n\n{how}\nBring the result back with: unlit import scene\n{notes}",
        exported.photos.len()
    )
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> PhotosError + '_ {
    move |source| PhotosError::Io { path: path.to_owned(), source }
}
