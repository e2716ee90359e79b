//! The rig: what stands in the photographer's room. Synchronous, `Send` driver traits; one driver a file.
//! [`crate::capture`] alone owns a rig.

pub mod camera;
pub mod doctor;
pub mod flash;
pub mod system;
mod traits;
pub mod usb;

pub use traits::{
    Camera, CameraError, CameraInfo, Closer, Flash, FlashError, FlashStatus, LockItem, LockReport, LockState,
    RECYCLE_PATIENCE, Shot, ShotFile, ShotTimes,
};
