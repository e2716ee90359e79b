//! The camera's own desk: which one, how it stands, at what exposure and where to look; live view; histograms.

use super::{Desk, DeskError, frame_of};
use crate::capture::Devices;
use crate::capture::engine::CameraState;
use crate::capture::error::CaptureError;
use crate::capture::events::Topic;
use crate::capture::live::LivePicture;
use crate::capture::place::{PlaceError, name_of};
use crate::capture::thumbnail::ThumbnailError;
use crate::pair::order::Slot;
use crate::pair::{Exposure, Lighting, Offered, Plan, Window};
use crate::photometry::inspect::{self, Inspection};
use crate::pipeline::levels;
use crate::rig::CameraInfo;
use crate::session::Session;
use serde_json::json;
use tokio::sync::watch;

/// Stops by which a wish may miss the label that is meant: neighbours are a third of a stop apart.
const NEAR_STOPS: f64 = 0.1;

impl Desk {
    /// The cameras that can be opened now.
    pub fn cameras(&self) -> Result<Vec<CameraInfo>, DeskError> {
        Ok(self.0.engine.cameras().map_err(CaptureError::from)?)
    }

    /// From now on, the camera on this port.
    pub fn choose_camera(&self, port: &str) -> Result<Devices, DeskError> {
        if port.trim().is_empty() {
            return Err(DeskError::BadValue(
                "port is empty; give one of the ports that /cameras lists".into(),
            ));
        }
        Ok(self.0.engine.choose_camera(port).map_err(CaptureError::from)?)
    }

    /// How the camera stands; the exposure lock is gone through on the way.
    pub fn camera_state(&self) -> Result<CameraState, DeskError> {
        Ok(self.0.engine.camera_state().map_err(CaptureError::from)?)
    }

    /// Joins the watchers of live view.
    pub fn watch_live(&self) -> std::io::Result<watch::Receiver<LivePicture>> {
        self.0.engine.watch_live()
    }

    /// Sets the exposures of a session's pairs from now on: each value must be on the camera's dials. Without
    /// `off`, both frames are shot alike.
    pub fn set_plan(&self, session: &str, on: Exposure, off: Option<Exposure>) -> Result<Plan, DeskError> {
        let session = self.session(session)?;
        let offered = self.camera_state()?.offered;
        let plan =
            Plan { off: offered_exposure(off.unwrap_or(on), &offered)?, on: offered_exposure(on, &offered)? };
        session.set_plan(plan)?;
        self.tell_session(&session);
        Ok(plan)
    }

    /// Sets where the object is in the frame; `None` is the whole frame.
    pub fn set_region(&self, session: &str, region: Option<Window>) -> Result<(), DeskError> {
        let session = self.session(session)?;
        session.set_region(region.map(Window::checked).transpose()?)?;
        self.tell_session(&session);
        Ok(())
    }

    /// Tells the session of the polariser before the lens and the power that the flash is set to.
    pub fn set_lighting(&self, session: &str, lighting: Lighting) -> Result<(), DeskError> {
        let lighting = lighting.checked().map_err(DeskError::BadValue)?;
        let session = self.session(session)?;
        session.set_lighting(lighting)?;
        self.tell_session(&session);
        Ok(())
    }

    /// The operator has checked these settings of the exposure lock by eye; kept for the session.
    pub fn confirm_settings(&self, session: &str, names: &[String]) -> Result<Vec<String>, DeskError> {
        let session = self.session(session)?;
        session.confirm(names)?;
        self.tell_session(&session);
        Ok(session.manifest().confirmed)
    }

    pub(super) fn tell_session(&self, session: &Session) {
        let name = name_of(session);
        self.0.events.tell(
            Topic::Session,
            format!("Session {name} changed."),
            json!({ "session": self.current(), "changed": name }),
        );
    }

    /// Raw histograms and clipped shares of a stored frame, in the session's region of interest.
    pub fn histograms(&self, session: &str, number: u32, slot: Slot) -> Result<Inspection, DeskError> {
        let session = self.reader(session)?;
        let record = self.pair(&session, number)?;
        let file = &frame_of(&record, slot)?.file;
        let measured = levels::load(&session).map_err(PlaceError::from)?;
        let photo =
            levels::read(&session.pair_dir(&record).join(file), &measured).map_err(ThumbnailError::from)?;
        let dn = &photo.mosaic.dn;
        let region = session.manifest().region.map(|window| window.sites(dn.width(), dn.height()));
        inspect::inspect(&photo.mosaic, region).map_err(|error| DeskError::BadValue(error.to_string()))
    }
}

/// The exposure on the dials that is meant by labels which a person or a script wrote down.
pub(super) fn offered_exposure(wish: Exposure, offered: &Offered) -> Result<Exposure, DeskError> {
    fn nearest<T: Copy + std::fmt::Display>(
        what: &str,
        wish: T,
        values: &[T],
        number: impl Fn(T) -> f64,
    ) -> Result<T, DeskError> {
        let distance = |value: &T| (number(*value) / number(wish)).log2().abs();
        let best = values.iter().copied().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        match best {
            Some(best) if distance(&best) < NEAR_STOPS => Ok(best),
            // A camera whose dials are not known to offer anything is told as is; its files will tell.
            None => Ok(wish),
            Some(best) => {
                Err(DeskError::BadValue(format!("the camera offers no {what} {wish}; the nearest is {best}")))
            }
        }
    }
    Ok(Exposure {
        shutter: nearest("shutter time", wish.shutter, &offered.shutters, |v| v.0)?,
        // Light goes with the square of the f-number.
        aperture: nearest("aperture", wish.aperture, &offered.apertures, |v| v.0 * v.0)?,
        iso: nearest("sensitivity", wish.iso, &offered.isos, |v| v.0)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{FNumber, Iso, Seconds};

    #[test]
    fn labels_as_written_find_the_dials_own_and_others_are_refused() {
        let offered = Offered {
            shutters: vec![Seconds(1.0 / 125.0), Seconds(0.1666)],
            apertures: vec![FNumber(8.0), FNumber(11.0)],
            isos: vec![],
        };
        let wish = Exposure { shutter: Seconds(1.0 / 6.0), aperture: FNumber(11.0), iso: Iso(100.0) };
        assert_eq!(offered_exposure(wish, &offered).unwrap(), Exposure { shutter: Seconds(0.1666), ..wish });
        let wide = Exposure { aperture: FNumber(2.8), ..wish };
        assert!(offered_exposure(wide, &offered).unwrap_err().to_string().contains("f/8"));
    }
}
