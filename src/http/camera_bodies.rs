//! What goes over the wire about the camera.

use crate::capture::{CameraState, ExposureWish};
use crate::pair::finding::Keep;
use crate::pair::{Exposure, Lighting, Plan, Polariser, Window};
use crate::photometry::inspect::{ChannelFigures, Inspection};
use crate::rig::{CameraInfo, LockItem, LockState};
use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A camera that can be opened.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraListBody {
    /// Model name.
    model: String,
    /// Port by which it is chosen.
    port: String,
    /// Whether it is the one in use.
    in_use: bool,
}

impl CameraListBody {
    /// `in_use` is the description of the camera in use, which ends with its port.
    pub(super) fn new(camera: CameraInfo, in_use: &str) -> Self {
        let in_use = in_use.ends_with(&format!(" on {}", camera.port));
        Self { model: camera.model, port: camera.port, in_use }
    }
}

/// The camera to use.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraChoice {
    /// One of the ports listed.
    #[schema(example = "usb:001,004")]
    pub(super) port: String,
}

/// Shutter, aperture and sensitivity as the camera labels them.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ExposureBody {
    /// Exposure time in seconds.
    #[schema(example = 0.008)]
    shutter_s: f64,
    /// F-number.
    #[schema(example = 11)]
    aperture: f64,
    /// ISO sensitivity.
    #[schema(example = 100)]
    iso: f64,
}

impl From<Exposure> for ExposureBody {
    fn from(e: Exposure) -> Self {
        Self { shutter_s: e.shutter.0, aperture: e.aperture.0, iso: e.iso.0 }
    }
}

impl From<ExposureBody> for Exposure {
    fn from(e: ExposureBody) -> Self {
        Self { shutter: Seconds(e.shutter_s), aperture: FNumber(e.aperture), iso: Iso(e.iso) }
    }
}

/// The exposures to shoot at.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ExposureOrder {
    /// Of the frames with flash.
    pub(super) on: ExposureBody,
    /// Of the frames without flash; as with flash if left out.
    #[serde(default)]
    pub(super) off: Option<ExposureBody>,
}

/// What to look for.
#[derive(Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub(super) struct FindOrder {
    /// Share of saturation at which the brightest channel of the lit frame shall end, 0 to 1.
    #[schema(example = 0.85)]
    target_share: f64,
    /// Whether the frame without flash may be exposed longer, for less noise.
    separate_off: bool,
    /// Whether the room is dark, so that no test shot without flash is needed.
    flash_only: bool,
    /// Leaves the exposure time as it is.
    keep_shutter: bool,
    /// Leaves the aperture as it is, for the depth of field.
    keep_aperture: bool,
    /// Leaves the sensitivity as it is.
    keep_iso: bool,
}

impl Default for FindOrder {
    fn default() -> Self {
        let ExposureWish { target_share, separate_off, flash_only, keep } = ExposureWish::default();
        Self {
            target_share,
            separate_off,
            flash_only,
            keep_shutter: keep.shutter,
            keep_aperture: keep.aperture,
            keep_iso: keep.iso,
        }
    }
}

impl From<FindOrder> for ExposureWish {
    fn from(order: FindOrder) -> Self {
        let FindOrder { target_share, separate_off, flash_only, .. } = order;
        let keep = Keep { shutter: order.keep_shutter, aperture: order.keep_aperture, iso: order.keep_iso };
        Self { target_share, separate_off, flash_only, keep }
    }
}

/// The exposures of a session's pairs.
#[derive(Serialize, ToSchema)]
pub(super) struct PlanBody {
    /// Of the frames without flash.
    off: ExposureBody,
    /// Of the frames with flash.
    on: ExposureBody,
    /// Both in words.
    words: String,
    /// What the operator should know of these exposures.
    warnings: Vec<String>,
}

impl From<Plan> for PlanBody {
    fn from(plan: Plan) -> Self {
        let (words, warnings) = (plan.words(), plan.warnings(None));
        Self { off: plan.off.into(), on: plan.on.into(), words, warnings }
    }
}

/// A region as shares of the frame, from its top left corner.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct WindowBody {
    /// Left edge, 0 to 1.
    x: f64,
    /// Top edge, 0 to 1.
    y: f64,
    /// Width, above 0 to 1.
    width: f64,
    /// Height, above 0 to 1.
    height: f64,
}

impl From<WindowBody> for Window {
    fn from(WindowBody { x, y, width, height }: WindowBody) -> Self {
        Self { x, y, width, height }
    }
}

impl From<Window> for WindowBody {
    fn from(Window { x, y, width, height }: Window) -> Self {
        Self { x, y, width, height }
    }
}

/// What no file tells of how photographs are lit and seen.
#[derive(Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct LightingBody {
    /// The polariser before the lens; absent: none.
    polariser: Option<PolariserBody>,
    /// Part of its full power that the flash is set to, above 0 to 1; absent: not told.
    #[schema(example = 0.25)]
    flash_power: Option<f64>,
}

/// A linear polariser.
#[derive(Clone, Copy, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct PolariserBody {
    /// Its angle as its ring is read, degrees; a half turn is the same. Absent: not read.
    #[schema(example = 30.0)]
    angle_degrees: Option<f64>,
}

impl From<LightingBody> for Lighting {
    fn from(LightingBody { polariser, flash_power }: LightingBody) -> Self {
        let polariser = polariser.map(|PolariserBody { angle_degrees }| Polariser { angle_degrees });
        Self { polariser, flash_power }
    }
}

impl From<Lighting> for LightingBody {
    fn from(Lighting { polariser, flash_power }: Lighting) -> Self {
        let polariser = polariser.map(|Polariser { angle_degrees }| PolariserBody { angle_degrees });
        Self { polariser, flash_power }
    }
}

/// Names of settings that the operator has checked.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ConfirmedBody {
    /// As the lock's items are called.
    pub(super) names: Vec<String>,
}

/// What the dials offer, as labelled.
#[derive(Serialize, ToSchema)]
struct OfferedBody {
    /// Exposure times in seconds.
    shutters_s: Vec<f64>,
    /// F-numbers.
    apertures: Vec<f64>,
    /// Sensitivities.
    isos: Vec<f64>,
}

/// One setting of the exposure lock.
#[derive(Serialize, ToSchema)]
struct LockItemBody {
    /// Stable name.
    #[schema(example = "white_balance")]
    name: String,
    /// `locked`, `corrected` (set just now), `wrong` (pairs are refused), `unreadable` (look for yourself, then
    /// confirm it) or `warning`.
    state: &'static str,
    /// What the camera says; empty when it does not tell.
    value: String,
    /// What it means and what to do.
    sentence: String,
}

impl From<LockItem> for LockItemBody {
    fn from(item: LockItem) -> Self {
        let state = match item.state {
            LockState::Locked => "locked",
            LockState::Corrected => "corrected",
            LockState::Wrong => "wrong",
            LockState::Unreadable => "unreadable",
            LockState::Warning => "warning",
        };
        Self { name: item.name, state, value: item.value, sentence: item.sentence }
    }
}

/// How the camera stands.
#[derive(Serialize, ToSchema)]
pub(super) struct CameraBody {
    /// Model name.
    model: String,
    /// Port.
    port: String,
    /// Serial number of the body.
    serial: Option<String>,
    /// What the dials show, if the camera tells all three.
    exposure: Option<ExposureBody>,
    /// What the dials offer.
    offered: OfferedBody,
    /// The exposure lock.
    lock: Vec<LockItemBody>,
}

impl From<CameraState> for CameraBody {
    fn from(state: CameraState) -> Self {
        let CameraState { info, settings, offered, lock } = state;
        let exposure = match (settings.shutter, settings.aperture, settings.iso) {
            (Some(shutter), Some(aperture), Some(iso)) => Some(Exposure { shutter, aperture, iso }.into()),
            _ => None,
        };
        Self {
            model: info.model,
            port: info.port,
            serial: info.serial,
            exposure,
            offered: OfferedBody {
                shutters_s: offered.shutters.iter().map(|v| v.0).collect(),
                apertures: offered.apertures.iter().map(|v| v.0).collect(),
                isos: offered.isos.iter().map(|v| v.0).collect(),
            },
            lock: lock.items.into_iter().map(Into::into).collect(),
        }
    }
}

/// One colour's figures.
#[derive(Serialize, ToSchema)]
struct ColourFiguresBody {
    /// `red`, `green` or `blue`.
    colour: &'static str,
    /// Lower edge of the first bin, DN: black.
    from_dn: f64,
    /// Upper edge of the last bin, DN: saturation.
    to_dn: f64,
    /// Pixels of the region in 100 equal bins from black to saturation.
    bins: Vec<u64>,
    /// Pixels below black: noise in the dark.
    below_black: u64,
    /// Pixels at or above saturation.
    at_saturation: u64,
    /// Clipped share of the region, 0 to 1.
    clipped_share: f64,
    /// Clipped share of the whole frame, 0 to 1.
    frame_clipped_share: f64,
    /// Largest value in the region, DN.
    maximum_dn: Option<u16>,
    /// Mean value in the region, DN.
    mean_dn: Option<f64>,
}

impl From<ChannelFigures> for ColourFiguresBody {
    fn from(c: ChannelFigures) -> Self {
        Self {
            colour: c.colour,
            from_dn: c.histogram_from,
            to_dn: c.histogram_to,
            bins: c.histogram,
            below_black: c.below_black,
            at_saturation: c.at_saturation,
            clipped_share: c.region_clipped_share,
            frame_clipped_share: c.frame_clipped_share,
            maximum_dn: c.region_maximum,
            mean_dn: c.region_mean,
        }
    }
}

/// A frame's raw figures.
#[derive(Serialize, ToSchema)]
pub(super) struct FrameFiguresBody {
    /// Width of the frame in pixels.
    width: usize,
    /// Height of the frame in pixels.
    height: usize,
    /// The region that was measured, in pixels: left, top, width, height.
    region: [usize; 4],
    /// Red, green, blue.
    colours: Vec<ColourFiguresBody>,
}

impl From<Inspection> for FrameFiguresBody {
    fn from(found: Inspection) -> Self {
        let r = found.region;
        Self {
            width: found.width,
            height: found.height,
            region: [r.x, r.y, r.width, r.height],
            colours: found.channels.into_iter().map(Into::into).collect(),
        }
    }
}
