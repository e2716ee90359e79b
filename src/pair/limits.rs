//! What a pair is held against; every limit with the reason for its default.

use serde::{Deserialize, Serialize};

/// Limits of the checks. All can be set; a missing one keeps its default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Standard errors by which a block of the frame must change before the change counts. At 5, noise alone
    /// passes once in three million blocks.
    pub noise_sigmas: f64,
    /// Share of the room's light by which that light may wander between two frames (mains flicker at short
    /// exposures) before a rise counts as flash.
    pub ambient_rise: f64,
    /// Least share of the frame's blocks that the flash must light up; below it, the flash did not fire.
    pub lit_share: f64,
    /// Least rise, as a share of the range from black to saturation, in the best-lit hundredth of the frame.
    /// At 0.02 a full well of 30,000 electrons gives 600, which shot noise spreads by 4 %: a site there tells
    /// reflectance no better.
    pub least_rise: f64,
    /// Least share of the light of an earlier pair from the same stop. Strobes repeat to 1 % or better, so
    /// 0.9 is a flash that had not recharged.
    pub least_rise_of_earlier: f64,
    /// Least energy of a pulse, as a share of the median of the session's earlier ones by the controller's own
    /// sensor; as for light, 0.9 is a flash that had not recharged.
    pub least_energy: f64,
    /// Difference of the room's light, as a share of it, beyond which a grid cell is not from the same stop.
    /// Lamps wander by less once their level is divided out; an edge that moved by a tenth of a cell does not.
    pub stop_tolerance: f64,
    /// Largest share of the grid that may differ by that much at one and the same stop: some mottle of moving
    /// leaves or shadows. An object that turned by a few degrees changes more.
    pub stop_changed_share: f64,
    /// Largest share of a colour's sites outside the region of interest that may be clipped. What is there is not
    /// measured, so that a lamp or a window in the picture may be blown; a fifth of the frame blown sheds light
    /// over everything through the lens's flare.
    pub clipped_share_outside: f64,
    /// Largest share of a colour's sites in the region of interest that may be clipped. Clipped sites are left out by themselves; past
    /// 1 % it is no longer a few glints.
    pub clipped_share: f64,
    /// Largest displacement between the frames, in sites. From half a site on, most of a site's light comes
    /// from its neighbour.
    pub shift_sites: f64,
    /// Share of the room's light by which a block must darken before it counts: flash cannot darken.
    pub ambient_fall: f64,
    /// Share of itself by which the room's light may differ between two frames without flash of one pair. Between the
    /// first and one after the lit frame a slope cancels out of the mean; a step instead of a slope leaves half of it,
    /// and half of 0.04 is what `ambient_fall` lets pass.
    pub ambient_drift: f64,
    /// Largest share of the frame's blocks that may darken by that much.
    pub darkened_share: f64,
    /// Relative difference up to which shutter, aperture, ISO and focal length are the same. A third of a
    /// stop is 0.12 or more; rounded labels differ by less than 0.01.
    pub setting_tolerance: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            noise_sigmas: 5.0,
            ambient_rise: 0.1,
            lit_share: 0.01,
            least_rise: 0.02,
            least_rise_of_earlier: 0.9,
            least_energy: 0.9,
            stop_tolerance: 0.04,
            stop_changed_share: 0.005,
            clipped_share_outside: 0.2,
            clipped_share: 0.01,
            shift_sites: 0.5,
            ambient_fall: 0.02,
            ambient_drift: 0.04,
            darkened_share: 0.005,
            setting_tolerance: 0.01,
        }
    }
}
