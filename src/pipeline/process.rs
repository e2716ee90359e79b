//! `process`: a session's accepted pairs to reflectance texture, deviations, view counts and model.

use super::cost::{Cost, Costs};
use super::develop::{DevelopError, known_light, known_sites, lamp};
use super::energy::{self, EnergyError, FlashAccount};
use super::flash::{self, FlashError};
use super::manifest::{StageManifest, digest};
use super::report::{self, Told};
use super::scene::{self, SceneError};
use super::uvs;
use crate::calibration::FlashCalibration;
use crate::codec::asset::AssetError;
use crate::codec::exr_image::{self, Exr, Meta};
use crate::codec::png::PngError;
use crate::export::glb::{self, Colour, GlbError, Model};
use crate::pair::{PairRecord, Verdict};
use crate::photometry::FlashGain;
use crate::progress::{Cancelled, Progress};
use crate::raster::Rgb;
use crate::reflectance::atlas;
use crate::reflectance::bounce::Round;
use crate::reflectance::joint::Run;
use crate::reflectance::orientation::face_cameras;
use crate::reflectance::range::OutOfRange;
use crate::reflectance::robust::Lobe;
use crate::reflectance::stage::Stage;
use crate::reflectance::texture::{Solver, Texture, TextureError};
use crate::reflectance::unwrap::{UnwrapError, UvChoice, UvSource};
use crate::scene::{Camera, Mesh, Scene};
use crate::session::{Session, SessionError, store};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Largest texture side that is made.
pub(super) const LARGEST_TEXTURE: usize = 16384;

/// Share of a photo that shows the object, about, and bytes that are kept of each of its pixels in each view.
const OBSERVED: f64 = 0.35;
const OBSERVATION: f64 = 190.0;

/// Bytes that a texel takes: texels and their directions, estimate, images.
const TEXEL: f64 = 170.0;

/// What is to be made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessOptions {
    /// Side of the texture; by default texels about as large as the photos' pixels on the object.
    pub texture_size: Option<usize>,
    /// Also the per-view images.
    pub views: bool,
    /// Where the object's texture coordinates come from.
    pub uvs: UvChoice,
}

/// What was made, and from what; also `model/summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProcessSummary {
    /// Pairs that went in, by name.
    pub used: Vec<String>,
    /// Pairs that did not, with the reason.
    pub left_out: Vec<LeftOut>,
    /// Side of the texture.
    pub texture_size: usize,
    /// Share of the object's texels that at least one view sees.
    pub seen: f64,
    /// Median standard deviation of the seen texels, of 1.
    pub median_deviation: f64,
    /// Mean reflectance of the seen texels, camera RGB.
    pub mean_reflectance: [f64; 3],
    /// How the rounds of bounces converged.
    pub rounds: Vec<Round>,
    /// How the solve of the texels converged.
    pub runs: Vec<Run>,
    /// Energy of each pair's pulse against the calibration's, by pair, as texture and measurement tell together.
    pub gains: BTreeMap<String, FlashGain>,
    /// Standard deviation of the lens's blur by channel, pixels, as the photographs tell.
    pub blur: [f32; 3],
    /// What each stage took.
    pub costs: Vec<Cost>,
    /// Gloss found on each mesh of the scene, in its order, and taken off.
    pub gloss: Vec<Option<Lobe>>,
    /// Meshes whose winding was turned, because the cameras saw them from behind.
    pub turned: Vec<String>,
    /// Where texture coordinates were asked to come from.
    #[serde(default)]
    pub uv_choice: UvChoice,
    /// Where they came from.
    #[serde(default)]
    pub uvs: UvSource,
    /// Digest of the object's surface, to tell whether the scene is still the one that the model was made from.
    #[serde(default)]
    pub object: String,
    /// Shares of the seen texels that reflect more or less than diffuse surfaces do.
    #[serde(default)]
    pub out_of_range: OutOfRange,
    /// Nothing had changed since the last run, so nothing was computed. Not stored.
    #[serde(skip)]
    pub up_to_date: bool,
    /// Per-view images made in this run, and those that still stood. Not stored.
    #[serde(skip)]
    pub views: (usize, usize),
}

/// A pair that took no part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Pair.
    pub name: String,
    /// Why.
    pub why: String,
}

/// Why processing stopped.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// No pair can be used.
    #[error("no pair can be processed: {0}")]
    NoPairs(String),
    /// A texture size that cannot be.
    #[error("texture size {0} is not possible: give a number of texels from 16 to {LARGEST_TEXTURE}")]
    TextureSize(usize),
    /// More memory than there is.
    #[error(
        "a texture of {size} x {size} texels from this many photos needs about {needs:.1} GB, but {has:.1} GB are free: use a machine with more memory, fewer pairs, or a smaller --texture-size"
    )]
    Memory {
        /// Side asked for.
        size: usize,
        /// GB.
        needs: f64,
        /// GB.
        has: f64,
    },
    /// Session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Calibration.
    #[error(transparent)]
    Flash(#[from] FlashError),
    /// The flash's energies.
    #[error(transparent)]
    Energy(#[from] EnergyError),
    /// A pair.
    #[error(transparent)]
    Develop(#[from] DevelopError),
    /// Solving.
    #[error(transparent)]
    Texture(TextureError),
    /// Texture coordinates.
    #[error(transparent)]
    Unwrap(UnwrapError),
    /// Writing an image.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// Writing the model.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// A preview in the report.
    #[error(transparent)]
    Preview(#[from] PngError),
    /// A derived file does not fit the scene.
    #[error("{} was made from another scene: delete it and process again", .0.display())]
    Stale(PathBuf),
    /// The file system refused.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<TextureError> for ProcessError {
    fn from(error: TextureError) -> Self {
        match error {
            TextureError::Cancelled(c) => Self::Cancelled(c),
            other => Self::Texture(other),
        }
    }
}

impl From<UnwrapError> for ProcessError {
    fn from(error: UnwrapError) -> Self {
        match error {
            UnwrapError::Cancelled(c) => Self::Cancelled(c),
            other => Self::Unwrap(other),
        }
    }
}

/// Everything that goes in, read and matched.
pub(super) struct Inputs {
    pub(super) calibration: FlashCalibration,
    pub(super) scene: Scene,
    /// Accepted pairs with their cameras, by name.
    pub(super) matched: Vec<(PairRecord, Camera)>,
    pub(super) left_out: Vec<LeftOut>,
    /// The flash over the session.
    pub(super) flash: FlashAccount,
    /// Where the object's texture coordinates were asked to come from, and did.
    uvs: (UvChoice, UvSource),
    /// Digest of all of it.
    pub(super) key: String,
}

/// Makes what is not made yet. Files in `model/` appear whole or not at all.
pub fn process(
    session: &Session,
    options: &ProcessOptions,
    progress: &Progress,
) -> Result<ProcessSummary, ProcessError> {
    let mut inputs = Inputs::read(session)?;
    let fitting = |object: &Mesh| texture_size(options, object, &inputs.matched);
    let choice = (options.uvs, options.texture_size.is_some());
    let (size, uvs) = uvs::settle(&mut inputs.scene, choice, fitting, progress)?;
    inputs.uvs = (options.uvs, uvs);
    let key = digest(&[inputs.key.as_bytes(), &size.to_le_bytes(), format!("{:?}", inputs.uvs).as_bytes()]);
    let mut manifest = StageManifest::load(session);
    let mut summary = match stored(session).filter(|_| manifest.is_done(session, "texture", &key)) {
        Some(summary) => ProcessSummary { up_to_date: true, ..summary },
        None => {
            let summary = solve_and_write(session, inputs.clone_scene(), &inputs, size, progress)?;
            let outputs = outputs(&summary.uvs);
            manifest.note(session, "texture", &key, &outputs).map_err(io(&session.derived_dir()))?;
            summary
        }
    };
    if options.views {
        summary.views = super::views::make(session, &inputs, &mut manifest, progress)?;
        summary.up_to_date &= summary.views.0 == 0;
    }
    Ok(summary)
}

/// The summary of the last run, if there is one.
pub fn stored(session: &Session) -> Option<ProcessSummary> {
    serde_json::from_slice(&std::fs::read(session.model_dir().join("summary.json")).ok()?).ok()
}

fn outputs(uvs: &UvSource) -> Vec<String> {
    ["reflectance.exr", "stddev.exr", "views.exr", "model.glb", "summary.json", "report.html"]
        .map(|name| format!("model/{name}"))
        .into_iter()
        .chain([super::views::PATCHES.to_owned()])
        .chain((*uvs != UvSource::Own).then(|| uvs::FILE.to_owned()))
        .collect()
}

impl Inputs {
    pub(super) fn read(session: &Session) -> Result<Self, ProcessError> {
        let calibration = flash::load(session)?;
        let flash = energy::account(session)?;
        let scene = scene::load(session)?;
        let (mut matched, mut left_out) = (vec![], vec![]);
        for pair in session.pairs()? {
            let name = pair.name.clone();
            if pair.verdict == Verdict::Rejected {
                let why = pair.reasons.iter().map(|r| r.sentence.clone()).collect::<Vec<_>>().join(" ");
                left_out.push(LeftOut { name, why: format!("rejected: {why}") });
            } else if let Some(camera) = scene.cameras.iter().find(|c| c.name == name) {
                matched.push((pair, camera.clone()));
            } else {
                left_out.push(LeftOut { name, why: "the scene has no camera of this name".into() });
            }
        }
        if matched.is_empty() {
            return Err(ProcessError::NoPairs(no_pairs(&left_out, &scene)));
        }
        let mut parts: Vec<Vec<u8>> = vec![];
        for path in [flash::file(session), session.scene_dir().join("scene.json")] {
            parts.push(std::fs::read(&path).map_err(io(&path))?);
        }
        for (pair, _) in &matched {
            let (off, on) = (&pair.off.blake3, &pair.on.blake3);
            parts.push(format!("{} {off} {on}", pair.name).into_bytes());
        }
        // Gains come out of it, and the report tells all of it.
        parts.push(format!("{flash:?}").into_bytes());
        // The report and the summary tell of these too.
        for left in &left_out {
            parts.push(format!("without {}: {}", left.name, left.why).into_bytes());
        }
        let key = digest(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>());
        Ok(Self { calibration, scene, matched, left_out, flash, uvs: Default::default(), key })
    }

    /// The energy of a pair's pulse against the calibration's.
    pub(super) fn gain(&self, pair: &PairRecord) -> FlashGain {
        self.flash.scale.gain(pair.flash.as_ref())
    }

    fn clone_scene(&self) -> Scene {
        self.scene.clone()
    }
}

/// The scene made ready for light: meshes face the cameras that see them. Gives the names of those turned.
pub(super) fn stage(scene: &mut Scene) -> (Stage, Vec<String>) {
    let stage = Stage::build(&scene.meshes);
    let turned = face_cameras(&mut scene.meshes, &stage.elements, &scene.cameras);
    if turned.is_empty() { (stage, turned) } else { (Stage::build(&scene.meshes), turned) }
}

pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> ProcessError + '_ {
    move |source| ProcessError::Io { path: path.to_owned(), source }
}

fn no_pairs(left_out: &[LeftOut], scene: &Scene) -> String {
    let cameras: Vec<&str> = scene.cameras.iter().take(3).map(|c| c.name.as_str()).collect();
    match left_out.first() {
        None => "the session has none; shoot or import some".into(),
        Some(first) => format!(
            "all {} were left out; {}: {} (the scene's cameras are called {}, ...)",
            left_out.len(),
            first.name,
            first.why,
            cameras.join(", ")
        ),
    }
}

fn texture_size(
    options: &ProcessOptions,
    object: &Mesh,
    matched: &[(PairRecord, Camera)],
) -> Result<usize, ProcessError> {
    let pixels: f64 =
        matched.iter().map(|(_, c)| c.intrinsics.width as f64 * c.intrinsics.height as f64).sum();
    let fits = |size: usize| {
        let needs = ((size * size) as f64 * TEXEL + pixels * OBSERVED * OBSERVATION) / 1e9;
        let has = memory() / 1e9;
        if needs < has { Ok(size) } else { Err(ProcessError::Memory { size, needs, has }) }
    };
    if let Some(size) = options.texture_size {
        if !(16..=LARGEST_TEXTURE).contains(&size) {
            return Err(ProcessError::TextureSize(size));
        }
        return fits(size);
    }
    let n = object.positions.len().max(1) as f32;
    let centre = (object.positions.iter().copied().sum::<Vec3>() / n).as_dvec3();
    let finest = matched
        .iter()
        .map(|(_, camera)| (camera.centre() - centre).length() / camera.intrinsics.focal.max_element())
        .fold(f64::INFINITY, f64::min);
    fits(atlas::fitting_size(object, finest))
}

/// Memory that is free now, bytes, as Linux estimates it; where it does not tell, what a small machine has.
fn memory() -> f64 {
    let told = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = told.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kilobytes.map_or(4e9, |k| 1024.0 * k)
}

fn solve_and_write(
    session: &Session,
    mut scene: Scene,
    inputs: &Inputs,
    size: usize,
    progress: &Progress,
) -> Result<ProcessSummary, ProcessError> {
    let mut costs = Costs::begin();
    let (stage, turned) = stage(&mut scene);
    costs.done("scene and ray kernel");
    let mut solver = Solver::new(&scene.meshes, &stage, size)?;
    let count = inputs.matched.len();
    for (i, (pair, camera)) in inputs.matched.iter().enumerate() {
        progress.report("looking through the views", i, count);
        let known = known_light(session, pair, &inputs.calibration, inputs.gain(pair))?;
        let expected = (camera.intrinsics.width, camera.intrinsics.height);
        let got = (known.rgb.width(), known.rgb.height());
        if got != expected {
            return Err(DevelopError::Size { name: pair.name.clone(), got, expected }.into());
        }
        solver.add(camera, &known, &lamp(pair, &inputs.calibration)?, progress)?;
    }
    costs.done("raws, direct light, first look");
    let mut settled = solver.settle(progress)?;
    costs.done("bounces");
    for (i, (pair, camera)) in inputs.matched.iter().enumerate() {
        progress.report("looking again, with bounces", i, count);
        let known = known_sites(session, pair, &inputs.calibration)?;
        let lamp = lamp(pair, &inputs.calibration)?;
        settled.add(i, camera, &known, &lamp, inputs.gain(pair), progress)?;
    }
    costs.done("raws, second look");
    let mut texture = settled.solve(inputs.calibration.noise.gain, progress)?;
    add_scale_error(&mut texture, scale_error(&inputs.calibration));
    costs.done("texels");
    let mut summary = summarise(inputs, &texture, size);
    summary.turned = turned;
    progress.report("writing the model", 0, 1);
    if let Some(object) = inputs.scene.meshes.first() {
        uvs::keep(session, object, &summary.uvs)?;
    }
    write(session, &scene, inputs, &texture, &summary)?;
    super::views::keep_patches(session, &texture.bounces.rho)?;
    costs.done("writing");
    summary.costs = costs.list;
    let path = session.model_dir().join("summary.json");
    let bytes = serde_json::to_vec_pretty(&summary).map_err(std::io::Error::other).map_err(io(&path))?;
    store::write_atomic(&path, &bytes).map_err(io(&path))?;
    Ok(summary)
}

fn summarise(inputs: &Inputs, texture: &Texture, size: usize) -> ProcessSummary {
    let (mut deviations, mut sum) = (vec![], [0.0f64; 3]);
    for e in texture.estimates.pixels().iter().flatten() {
        deviations.push(e.sd.iter().sum::<f32>() / 3.0);
        for (sum, rho) in sum.iter_mut().zip(e.rho) {
            *sum += f64::from(rho);
        }
    }
    deviations.sort_by(f32::total_cmp);
    let seen = deviations.len();
    ProcessSummary {
        used: inputs.matched.iter().map(|(p, _)| p.name.clone()).collect(),
        left_out: inputs.left_out.clone(),
        texture_size: size,
        seen: seen as f64 / texture.surface.max(1) as f64,
        median_deviation: deviations.get(seen / 2).map_or(0.0, |d| f64::from(*d)),
        mean_reflectance: sum.map(|s| s / seen.max(1) as f64),
        rounds: texture.rounds.clone(),
        runs: texture.runs.clone(),
        gains: inputs
            .matched
            .iter()
            .map(|(p, _)| p.name.clone())
            .zip(texture.gains.iter().copied())
            .collect(),
        blur: texture.blur,
        gloss: texture.bounces.gloss.clone(),
        costs: vec![],
        turned: vec![],
        uv_choice: inputs.uvs.0,
        uvs: inputs.uvs.1.clone(),
        object: inputs.scene.meshes.first().map(uvs::digest).unwrap_or_default(),
        out_of_range: OutOfRange::of(texture.estimates.pixels().iter().flatten().map(|e| e.rho)),
        up_to_date: false,
        views: (0, 0),
    }
}

fn write(
    session: &Session,
    scene: &Scene,
    inputs: &Inputs,
    texture: &Texture,
    summary: &ProcessSummary,
) -> Result<(), ProcessError> {
    let model = session.model_dir();
    let meta = |what: &str| Meta {
        colour_space: Some("camera RGB, uncalibrated".into()),
        software: Some(concat!("unlit ", env!("CARGO_PKG_VERSION")).into()),
        comments: Some(what.into()),
    };
    let rho: Rgb = atlas::fill(&texture.filled);
    let sd = texture.estimates.map(|e| e.map_or([0.0; 3], |e| e.sd));
    whole(&model.join("reflectance.exr"), |to| {
        exr_image::write_rgb(to, &rho, &meta("diffuse reflectance, 0 to 1; row 0 at v = 1"))
    })?;
    whole(&model.join("stddev.exr"), |to| {
        exr_image::write_rgb(
            to,
            &sd,
            &meta(
                "standard deviation of the mean reflectance over a patch of 4x4 photo pixels; 0 where views.exr is 0",
            ),
        )
    })?;
    let views = texture.estimates.pixels().iter().map(|e| e.map_or(0.0, |e| f32::from(e.views))).collect();
    let residual = texture.residual.pixels().to_vec();
    let surface = texture.filled.pixels().iter().map(|p| f32::from(u8::from(p.is_some()))).collect();
    let counts = Exr {
        width: rho.width(),
        height: rho.height(),
        channels: vec![("Y".into(), views), ("residual".into(), residual), ("surface".into(), surface)],
        meta: meta(
            "Y: views that made up each texel; residual: how far their own means part, of 1; surface: 1 where the object is, 0 in the gutters; surface 1 and Y 0: not seen, filled",
        ),
    };
    whole(&model.join("views.exr"), |to| exr_image::write(to, &counts))?;
    let Some(object) = scene.meshes.first() else { return Err(SceneError::NoMesh.into()) };
    let glb = glb::encode(&Model {
        mesh: object,
        texture: &rho,
        colour: Colour::Uncalibrated,
        up: up(&scene.cameras),
        provenance: super::export::provenance(session, summary),
    })?;
    let path = model.join("model.glb");
    store::write_atomic(&path, &glb).map_err(io(&path))?;
    let report = report::html(&Told {
        manifest: &session.manifest(),
        calibration: &inputs.calibration,
        pairs: inputs.matched.iter().map(|(pair, _)| pair).collect(),
        summary,
        flash: &inputs.flash,
        estimates: &texture.estimates,
    })?;
    let path = model.join("report.html");
    store::write_atomic(&path, report.as_bytes()).map_err(io(&path))
}

/// Adds the calibration's own error to every texel's.
fn add_scale_error(texture: &mut Texture, error: [f32; 3]) {
    for e in texture.estimates.pixels_mut().iter_mut().flatten() {
        e.sd = std::array::from_fn(|c| e.sd[c].hypot(e.rho[c] * error[c]));
    }
}

/// Relative error of the lamp's radiance, which all texels share.
fn scale_error(calibration: &FlashCalibration) -> [f32; 3] {
    let error = calibration.radiance_error.unwrap_or_default();
    std::array::from_fn(|c| (error[c] / calibration.radiance[c]) as f32)
}

/// Writes a file under a temporary name and gives it its own when it is whole.
pub(super) fn whole<E>(path: &Path, write: impl FnOnce(&Path) -> Result<(), E>) -> Result<(), ProcessError>
where
    ProcessError: From<E>,
{
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    let beside = tempfile::Builder::new()
        .prefix(store::TEMPORARY_PREFIX)
        .suffix(".exr")
        // As every other file: readable by whom the process's mask lets read it.
        .permissions(std::fs::Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(io(folder))?;
    write(beside.path())?;
    beside.as_file().sync_all().map_err(io(path))?;
    beside.persist(path).map_err(|e| ProcessError::Io { path: path.to_owned(), source: e.error })?;
    store::sync_folder(folder).map_err(io(folder))
}

/// The world axis that the cameras hold up; `None` when they do not agree on one.
pub(super) fn up(cameras: &[Camera]) -> Option<Vec3> {
    let sum: glam::DVec3 = cameras.iter().map(|c| -c.world_from_camera.matrix3.y_axis).sum();
    let mean = (sum / cameras.len().max(1) as f64).as_vec3();
    let axis = mean.abs().max_position();
    let snapped = Vec3::AXES[axis] * mean[axis].signum();
    (mean.length() > 0.2 && mean.normalize().dot(snapped) > 0.8).then_some(snapped)
}
