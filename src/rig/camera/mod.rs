//! The camera driver: libgphoto2 in a child process, with a deadline on everything.
//!
//! [`HostedCamera`] starts `unlit camera-host` ([`host`]), which alone uses libgphoto2, and asks it over a
//! local socket (`protocol`). libgphoto2 can hang for ever; a host that misses its deadline is killed. An answer
//! "busy" is asked again a few times; whatever is worse goes up the ladder of `recover`, at the next call or when
//! [`super::Camera::recover`] is called. What must stand still while pairs are shot is in the makers' tables of `lock`.

pub mod host;
mod hosted;
mod labels;
mod lock;
mod process;
mod protocol;
mod recover;

pub use hosted::{Deadlines, HostedCamera};
pub use process::Launch;
pub use protocol::Target;

use super::{CameraError, CameraInfo};
use process::AskError;
use protocol::{Reply, Request};

/// The cameras that libgphoto2 finds by itself (USB; a PTP/IP camera is opened by its port). Serial numbers
/// are not known before a camera is opened.
pub fn list() -> Result<Vec<CameraInfo>, CameraError> {
    list_with(&Launch::own()?)
}

/// [`list`] by hosts started in another way.
pub fn list_with(launch: &Launch) -> Result<Vec<CameraInfo>, CameraError> {
    match ask_once(launch, "list cameras", &Request::List)? {
        Reply::Cameras(cameras) => Ok(cameras),
        other => Err(out_of_turn(&other)),
    }
}

/// Version of libgphoto2 as the hosts use it.
pub fn library_with(launch: &Launch) -> Result<String, CameraError> {
    match ask_once(launch, "tell the library's version", &Request::Library)? {
        Reply::Library(version) => Ok(version),
        other => Err(out_of_turn(&other)),
    }
}

/// Asks a host without a camera, which goes away again.
fn ask_once(launch: &Launch, operation: &str, request: &Request) -> Result<Reply, CameraError> {
    let deadline = Deadlines::default().open;
    let mut process = launch.start(None)?;
    match process.ask(request, deadline) {
        Ok((Reply::Failed { reason, .. }, _)) => {
            Err(CameraError::Refused { operation: operation.into(), reason })
        }
        Ok((reply, _)) => Ok(reply),
        Err(AskError::Deadline) => {
            process.kill();
            Err(CameraError::Deadline { operation: operation.into(), deadline })
        }
        Err(AskError::GoneBefore(error) | AskError::Gone(error)) => Err(gone(&error)),
    }
}

fn gone(error: &std::io::Error) -> CameraError {
    CameraError::Host(format!(
        "it ended in the middle of a request ({error}); it is started again at the next try"
    ))
}

fn out_of_turn(reply: &Reply) -> CameraError {
    CameraError::Host(format!("it answered out of turn: {reply:?}"))
}
