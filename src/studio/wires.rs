//! What runs between the simulated devices: the sync contact, and the light through the lens.

use crate::pair::Exposure;

/// The camera's X-sync contact. The board at its other end alone decides whether light follows.
pub trait SyncContact: Send + Sync {
    /// The contact closes once. Returns the energy that the flash gave in answer, relative to its nominal
    /// energy (jitter included); exactly 0 when the board did not fire.
    fn close(&self) -> f64;
}

/// What stands before the simulated lens.
pub trait View: Send + Sync {
    /// Exposes one frame: closes the sync contact, gathers light, reads the sensor out. Returns the bytes of
    /// a complete raw file with EXIF. Called once a release, from the camera's thread.
    fn expose(&self, exposure: &Exposure) -> Vec<u8>;

    /// A small JPEG of what the lens sees now, in the room's light.
    fn preview(&self) -> Vec<u8>;

    /// The JPEG that the body makes of the frame just exposed, for image formats that have one. By default the
    /// [`View::preview`].
    fn jpeg(&self, exposure: &Exposure) -> Vec<u8> {
        let _ = exposure;
        self.preview()
    }
}
