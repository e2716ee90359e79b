//! `process`: a session's accepted pairs to reflectance texture, deviations, view counts and model.

mod error;

pub use error::ProcessError;
pub(super) use error::io;

use super::calibrate;
use super::colour::SessionColours;
use super::cost::Cost;
use super::develop::{self, DevelopError};
use super::energy::{self, FlashAccount};
use super::manifest::{StageManifest, digest};
use super::memory::Needs;
use super::scale::{Ratios, SessionScale};
use super::{dress, flash, output, scene, solve, uvs};
use crate::calibration::FlashCalibration;
use crate::pair::{PairRecord, Verdict};
use crate::photometry::FlashGain;
use crate::progress::Progress;
use crate::reflectance::bounce::Round;
use crate::reflectance::joint::Run;
use crate::reflectance::range::OutOfRange;
use crate::reflectance::robust::Lobe;
use crate::reflectance::unwrap::{UvChoice, UvSource};
use crate::scene::{Camera, Mesh, Scene};
use crate::session::{Session, store};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Largest texture side that is made.
pub(super) const LARGEST_TEXTURE: usize = 16384;

/// What is to be made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessOptions {
    /// Side of the texture; by default texels about as large as the photos' pixels on the object.
    pub texture_size: Option<usize>,
    /// Also the per-view images.
    pub views: bool,
    /// Where the object's texture coordinates come from.
    pub uvs: UvChoice,
    /// Memory that solving the texture may take, GB; by default [`super::memory::MEMORY`]. What needs more is solved in pieces.
    pub memory: Option<f64>,
    /// Memory for the views of one piece, GB, should less be wanted than there is room for: of a run that is stopped one
    /// piece is lost.
    pub piece: Option<f64>,
}

/// What was made, and from what; also `model/summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProcessSummary {
    /// Pairs that went in, by name.
    pub used: Vec<String>,
    /// Pairs that did not, with the reason.
    pub left_out: Vec<LeftOut>,
    /// Which calibrations count only in part for these pairs, and what was scaled: a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
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
    /// By what exposures were scaled to each other.
    #[serde(default)]
    pub ratios: Ratios,
    /// Standard deviation of the lens's blur by channel, pixels, as the photographs tell.
    pub blur: [f32; 3],
    /// Pieces that the texture was solved in, for want of memory for all views at once.
    pub pieces: usize,
    /// How often a view was looked at for one of them.
    #[serde(default)]
    pub looks: usize,
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

/// Everything that goes in, read and matched.
pub(super) struct Inputs {
    pub(super) calibration: FlashCalibration,
    /// How light goes with the settings.
    pub(super) scale: SessionScale,
    /// What a chart says of the camera's colours.
    pub(super) colours: SessionColours,
    pub(super) scene: Scene,
    /// Accepted pairs with their cameras, by name.
    pub(super) matched: Vec<(Arc<PairRecord>, Camera)>,
    pub(super) left_out: Vec<LeftOut>,
    /// Which calibrations count only in part, and what is scaled.
    pub(super) remarks: Vec<String>,
    /// The flash over the session.
    pub(super) flash: FlashAccount,
    /// Where the object's texture coordinates were asked to come from, and did.
    pub(super) uvs: (UvChoice, UvSource),
    /// Digest of all that the texture is made from.
    pub(super) key: String,
}

/// Makes what is not made yet. Files in `model/` appear whole or not at all.
pub fn process(
    session: &Session,
    options: &ProcessOptions,
    progress: &Progress,
) -> Result<ProcessSummary, ProcessError> {
    let mut inputs = Inputs::read(session)?;
    let needs = Needs::of(&inputs.scene.meshes, &inputs.matched);
    let fitting = |object: &Mesh| solve::texture_size(options, object, &inputs.matched);
    let choice = (options.uvs, options.texture_size.is_some());
    let (size, uvs) = uvs::settle(&mut inputs.scene, choice, fitting, progress)?;
    inputs.uvs = (options.uvs, uvs);
    let key = texture_key(&inputs.key, size, &inputs.uvs);
    let mut manifest = StageManifest::load(session);
    let mut summary = match stored(session).filter(|_| manifest.is_done(session, "texture", &key)) {
        Some(summary) => ProcessSummary { up_to_date: true, ..summary },
        None => {
            let piece = needs.for_a_piece(size, options)?;
            let summary = solve_and_write(session, &inputs, (size, piece), &key, progress)?;
            let outputs = outputs(&summary.uvs);
            manifest.forget(solve::PARTS);
            manifest.note(session, "texture", &key, &outputs).map_err(io(&session.derived_dir()))?;
            solve::remove_parts(session)?;
            summary
        }
    };
    summary.up_to_date &= !dress::dress(session, &inputs, &summary, &key, &mut manifest)?;
    if options.views {
        summary.views = super::views::make(session, &inputs, &mut manifest, progress)?;
        summary.up_to_date &= summary.views.0 == 0;
    }
    Ok(summary)
}

pub(super) fn texture_key(inputs: &str, size: usize, uvs: &(UvChoice, UvSource)) -> String {
    digest(&[inputs.as_bytes(), &size.to_le_bytes(), format!("{uvs:?}").as_bytes()])
}

/// The summary of the last run, if there is one.
pub fn stored(session: &Session) -> Option<ProcessSummary> {
    serde_json::from_slice(&std::fs::read(session.model_dir().join("summary.json")).ok()?).ok()
}

fn outputs(uvs: &UvSource) -> Vec<String> {
    ["reflectance.exr", "stddev.exr", "views.exr", "summary.json"]
        .map(|name| format!("model/{name}"))
        .into_iter()
        .chain([super::views::PATCHES.to_owned()])
        .chain((*uvs != UvSource::Own).then(|| uvs::FILE.to_owned()))
        .collect()
}

impl Inputs {
    pub(super) fn read(session: &Session) -> Result<Self, ProcessError> {
        let calibrated = flash::record(session)?;
        let scale = SessionScale::load(session).map_err(DevelopError::from)?;
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
        let pairs: Vec<&PairRecord> = matched.iter().map(|(pair, _)| &**pair).collect();
        let of_pairs = matched.iter().map(|(pair, _)| pair.as_ref());
        let doubt = flash::doubt(&calibrated).into_iter();
        let unchecked = calibrate::unchecked(session, &pairs).map_err(DevelopError::from)?;
        let mut remarks: Vec<String> =
            doubt.chain(unchecked).chain(develop::remarks(session, &calibrated.fit, of_pairs)?).collect();
        remarks.extend(flash::scaled_for(&calibrated, pairs.iter().copied(), &scale)?);
        remarks.extend(energy::remark(session));
        let colours = SessionColours::measured(session, &pairs)?;
        let mut parts: Vec<Vec<u8>> = vec![];
        for path in [flash::file(session), session.scene_dir().join("scene.json")] {
            parts.push(std::fs::read(&path).map_err(io(&path))?);
        }
        // Frames are read with these, where the session has them.
        for name in ["levels.json", "noise.json"] {
            match std::fs::read(session.calibration_dir().join(name)) {
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                read => parts.push(read.map_err(io(&session.calibration_dir().join(name)))?),
            }
        }
        for (pair, _) in &matched {
            parts.push(originals(pair).into_bytes());
        }
        // Only where there is a table, so that what was made without one stays.
        if let Some(table) = scale.told() {
            parts.push(table.into_bytes());
        }
        // Gains come out of it, and the report tells all of it.
        parts.push(format!("{flash:?}").into_bytes());
        // The report and the summary tell of these too.
        parts.extend(remarks.iter().map(|what| what.clone().into_bytes()));
        for left in &left_out {
            parts.push(format!("without {}: {}", left.name, left.why).into_bytes());
        }
        let key = digest(&parts.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let calibration = calibrated.fit;
        let uvs = Default::default();
        Ok(Self { calibration, scale, colours, scene, matched, left_out, remarks, flash, uvs, key })
    }

    /// The energy of a pair's pulse against the calibration's.
    pub(super) fn gain(&self, pair: &PairRecord) -> FlashGain {
        self.flash.scale.gain(pair.flash.as_ref())
    }
}

/// A pair's name and the digests of all its frames.
fn originals(pair: &PairRecord) -> String {
    let further: String = pair.dark_frames().skip(1).map(|frame| format!(" {}", frame.blake3)).collect();
    format!("{} {} {}{further}", pair.name, pair.off.blake3, pair.on.blake3)
}

fn solve_and_write(
    session: &Session,
    inputs: &Inputs,
    limits: (usize, f64),
    key: &str,
    progress: &Progress,
) -> Result<ProcessSummary, ProcessError> {
    let mut scene = inputs.scene.clone();
    let (texture, turned, mut costs) = solve::solve(session, &mut scene, inputs, limits, key, progress)?;
    let mut summary = output::summarise(inputs, &texture, limits.0);
    summary.turned = turned;
    progress.report("writing the model", 0, 1);
    if let Some(object) = inputs.scene.meshes.first() {
        uvs::keep(session, object, &summary.uvs)?;
    }
    output::write(session, &texture)?;
    super::views::keep_patches(session, &texture.bounces.rho)?;
    costs.done("writing");
    summary.costs = costs.list;
    let path = session.model_dir().join("summary.json");
    let bytes = serde_json::to_vec_pretty(&summary).map_err(std::io::Error::other).map_err(io(&path))?;
    store::write_atomic(&path, &bytes).map_err(io(&path))?;
    Ok(summary)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_that_goes_in_is_among_the_inputs() {
        let frame = |digest: &str| {
            serde_json::json!({
                "file": "a", "original_name": "a", "bytes": 1, "blake3": digest, "settings": {}
            })
        };
        let mut pair = serde_json::json!({
            "number": 1, "name": "0001", "verdict": "accepted", "reasons": [], "off": frame("a"), "on": frame("b")
        });
        let of = |pair: &serde_json::Value| originals(&serde_json::from_value(pair.clone()).unwrap());
        assert_eq!(of(&pair), "0001 a b", "a plain pair's inputs are what they were");
        pair["more_off"] = serde_json::json!([frame("c")]);
        pair["after"] = serde_json::json!([frame("d"), frame("e")]);
        assert_eq!(of(&pair), "0001 a b c d e");
        pair["order"] = serde_json::json!("off_on_crossed");
        pair["crossed"] = frame("f");
        assert_eq!(of(&pair), "0001 a b c d e", "nothing is made of a lit frame through a crossed polariser");
    }
}
