//! The camera host as its driver sees it: a child process with a socket, and a deadline for every answer.

use super::protocol::{self, Reply, Request};
use crate::rig::CameraError;
use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How long a host may take to go when it is told to.
const GOODBYE: Duration = Duration::from_secs(4);

/// How camera hosts are started.
#[derive(Clone, Debug)]
pub struct Launch {
    program: PathBuf,
    environment: Vec<(OsString, OsString)>,
}

impl Launch {
    /// Hosts are run by `program`, an executable of unlit.
    pub fn new(program: impl Into<PathBuf>) -> Self {
        Self { program: program.into(), environment: Vec::new() }
    }

    /// Hosts are run by this program's own executable.
    pub fn own() -> Result<Self, CameraError> {
        std::env::current_exe()
            .map(Self::new)
            .map_err(|error| CameraError::Host(format!("own executable not found: {error}")))
    }

    /// Sets a variable in the environment of the hosts (`IOLIBS`: other port drivers for libgphoto2).
    pub fn env(mut self, name: impl Into<OsString>, value: impl Into<OsString>) -> Self {
        self.environment.push((name.into(), value.into()));
        self
    }

    /// Starts `program camera-host [--port PORT]`.
    pub(super) fn start(&self, port: Option<&str>) -> Result<Process, CameraError> {
        Process::start(self, port).map_err(|error| {
            CameraError::Host(format!("{} could not be started: {error}", self.program.display()))
        })
    }
}

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum AskError {
    /// The deadline passed.
    Deadline,
    /// The host went away without having read the request: nothing was done.
    GoneBefore(io::Error),
    /// The host went away after it had read the request: it may have been carried out.
    Gone(io::Error),
}

/// A running camera host. Dropping it asks it to go, and kills it when it does not.
pub(super) struct Process {
    child: Child,
    link: UnixStream,
    /// libgphoto2 keeps settings in `$HOME/.gphoto`; each host has a home of its own, gone with it.
    _home: tempfile::TempDir,
    polite: bool,
}

impl Process {
    fn start(launch: &Launch, port: Option<&str>) -> io::Result<Self> {
        let home = tempfile::Builder::new().prefix("unlit-camera-").tempdir()?;
        let (ours, theirs) = UnixStream::pair()?;
        let mut command = Command::new(&launch.program);
        command.arg("camera-host");
        if let Some(port) = port {
            command.args(["--port", port]);
        }
        command
            .env("HOME", home.path())
            .env_remove("XDG_CONFIG_HOME")
            .envs(launch.environment.iter().map(|(name, value)| (name, value)))
            // Settings are found by their names and chosen by their labels, which must stay English.
            .env("LC_ALL", "C.UTF-8")
            // Ctrl-C at the terminal is for unlit, which then takes leave of the camera in good order.
            .process_group(0)
            .stdin(OwnedFd::from(theirs))
            // The library may print where it likes; the socket carries frames alone.
            .stdout(Stdio::from(io::stderr().as_fd().try_clone_to_owned()?));
        crate::log::pass_on(&mut command);
        let child = command.spawn()?;
        Ok(Self { child, link: ours, _home: home, polite: true })
    }

    /// Process id.
    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it still runs.
    pub(super) fn alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// One question, and the first frame of its answer.
    pub(super) fn ask(
        &mut self,
        request: &Request,
        deadline: Duration,
    ) -> Result<(Reply, Vec<u8>), AskError> {
        let until = Instant::now() + deadline;
        protocol::send(&mut Timed { link: &self.link, until }, request, &[]).map_err(sort)?;
        self.hear(until)
    }

    /// A further frame of the answer.
    pub(super) fn hear(&mut self, until: Instant) -> Result<(Reply, Vec<u8>), AskError> {
        protocol::receive(&mut Timed { link: &self.link, until }).map_err(sort)
    }

    /// Ends it at once.
    pub(super) fn kill(mut self) {
        self.polite = false;
    }
}

/// A local socket is reset only when its other end closes with something unread; after a request that was
/// read, it just ends. A host reads a request whole before it acts.
fn sort(error: io::Error) -> AskError {
    match error.kind() {
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => AskError::Deadline,
        io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => AskError::GoneBefore(error),
        _ => AskError::Gone(error),
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.polite {
            // The host closes its end once it has taken leave of the camera.
            let goodbye = self.link.shutdown(Shutdown::Write).and_then(|()| {
                let mut timed = Timed { link: &self.link, until: Instant::now() + GOODBYE };
                io::copy(&mut timed, &mut io::sink())
            });
            if let Err(error) = goodbye {
                tracing::debug!("camera host {} did not go by itself: {error}", self.child.id());
            }
        }
        // Killing one that has ended is harmless: its id is ours until it is waited for.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The socket with a deadline over many reads and writes.
struct Timed<'a> {
    link: &'a UnixStream,
    until: Instant,
}

impl Timed<'_> {
    fn left(&self) -> io::Result<Option<Duration>> {
        let left = self.until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        Ok(Some(left))
    }
}

impl Read for Timed<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.link.set_read_timeout(self.left()?)?;
        let mut link = self.link;
        link.read(buffer)
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        self.link.set_write_timeout(self.left()?)?;
        let mut link = self.link;
        link.write(buffer)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
