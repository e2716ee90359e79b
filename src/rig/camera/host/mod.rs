//! The camera host: the child process that alone speaks to libgphoto2.
//!
//! libgphoto2 can hang for ever inside a call, and the gphoto2 crate runs every camera of a process through
//! one thread. So each camera has a process of its own, which its driver may kill. The host takes requests on
//! the socket that it was given as standard input and answers there; whatever the library prints goes to
//! standard error. It ends when the socket does, even from inside a call that hangs.

mod body;
mod failure;
mod harvest;
mod log;
mod shot;

use super::protocol::{self, Reply, Request};
use crate::rig::CameraInfo;
use body::Body;
use failure::{Answer, Failure};
use gphoto2::Context;
use gphoto2::list::CameraDescriptor;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::mpsc;
use std::time::Duration;

/// How long the host may take to say goodbye to the camera when its driver is gone.
const GOODBYE: Duration = Duration::from_secs(3);

/// Why the host could not run.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// Started by hand.
    #[error("camera-host is started by unlit itself, with a socket as its standard input: {0}")]
    NoSocket(io::Error),
    /// The socket broke.
    #[error("camera-host lost its driver: {0}")]
    Link(#[from] io::Error),
}

/// Serves the camera on `port` (without one, the host can only list cameras) until the driver closes the socket.
pub fn run(port: Option<&str>) -> Result<(), HostError> {
    let socket = io::stdin().as_fd().try_clone_to_owned().map_err(HostError::NoSocket)?;
    let mut link = UnixStream::from(socket);
    link.peer_addr().map_err(HostError::NoSocket)?;
    let mut requests_in = link.try_clone()?;
    let (pass, requests) = mpsc::channel();
    std::thread::Builder::new().name("camera-host-requests".into()).spawn(move || {
        while let Ok((request, _)) = protocol::receive::<Request>(&mut requests_in) {
            if pass.send(request).is_err() {
                return;
            }
        }
        drop(pass);
        std::thread::sleep(GOODBYE);
        std::process::exit(0);
    })?;
    let mut host = Host { port: port.map(str::to_owned), context: None, open: None };
    log::listen();
    for request in requests {
        log::take();
        match host.answer(&request, &mut link) {
            Ok(()) => {}
            Err(Stop::Failed(failure)) => {
                let Failure { trouble, reason } = failure.explained_by(&log::take());
                let files_owed = host.open.as_ref().map(|body| body.files_owed);
                protocol::send(&mut link, &Reply::Failed { trouble, reason, files_owed }, &[])?;
            }
            Err(Stop::Link(error)) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Why an answer was not finished.
enum Stop {
    /// The request failed.
    Failed(Failure),
    /// The driver is gone.
    Link(io::Error),
}

impl<E: Into<Failure>> From<E> for Stop {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

struct Host {
    port: Option<String>,
    context: Option<Context>,
    open: Option<Body>,
}

impl Host {
    /// The one context of this process, made at first use, after the logger.
    fn context(&mut self) -> Answer<Context> {
        if let Some(context) = &self.context {
            return Ok(context.clone());
        }
        let context = Context::new()?;
        self.context = Some(context.clone());
        Ok(context)
    }

    fn open(&mut self) -> Answer<&mut Body> {
        self.open.as_mut().ok_or_else(|| Failure::refused("the host was asked before it was told to open"))
    }

    fn answer(&mut self, request: &Request, link: &mut UnixStream) -> Result<(), Stop> {
        let (reply, payload) = match request {
            Request::Library => {
                let version = gphoto2::library_version()
                    .ok_or_else(|| Failure::refused("libgphoto2 does not tell its version"))?;
                (Reply::Library(version.to_owned()), Vec::new())
            }
            Request::List => {
                let cameras = self.context()?.list_cameras().wait()?;
                let info = |c: CameraDescriptor| CameraInfo { model: c.model, port: c.port, serial: None };
                (Reply::Cameras(cameras.map(info).collect()), Vec::new())
            }
            Request::Open => {
                let context = self.context()?;
                let port = self.port.clone().ok_or_else(|| Failure::refused("the host has no port"))?;
                let body = self.open.insert(Body::connect(&context, &port)?);
                (Reply::Opened { info: body.info()?, listed_as: body.listed_as.clone() }, Vec::new())
            }
            Request::Prepare { target, files_owed } => {
                let body = self.open()?;
                body.send_frames_to(*target)?;
                body.clear(*files_owed)?;
                (Reply::Prepared { files_owed: body.files_owed }, Vec::new())
            }
            Request::Greet => {
                self.open()?.exposure()?;
                (Reply::Done, Vec::new())
            }
            Request::Settings => (Reply::Settings(self.open()?.settings()?), Vec::new()),
            Request::Offered => (Reply::Offered(self.open()?.offered()?), Vec::new()),
            Request::Set(dial) => {
                self.open()?.set(*dial)?;
                (Reply::Done, Vec::new())
            }
            Request::Lock => (Reply::Locked(self.open()?.lock()?), Vec::new()),
            Request::Preview => (Reply::Preview, self.open()?.preview()?),
            Request::EndPreview => {
                self.open()?.end_live()?;
                (Reply::Done, Vec::new())
            }
            Request::Shoot { patience, files_owed } => {
                let body = self.open()?;
                let ready @ (exposure, files) = body.get_ready(*files_owed)?;
                let files_owed = body.files_owed + files;
                protocol::send(link, &Reply::Releasing { exposure, files_owed }, &[]).map_err(Stop::Link)?;
                let shot = body.release(ready, *patience)?;
                for file in [Some(shot.raw), shot.jpeg].into_iter().flatten() {
                    protocol::send(link, &Reply::Frame(file.name), &file.bytes).map_err(Stop::Link)?;
                }
                (Reply::Shot(shot.times), Vec::new())
            }
        };
        protocol::send(link, &reply, &payload).map_err(Stop::Link)
    }
}
