//! How clients reach the body: doors that can be closed and opened elsewhere, and links that can be cut.

use super::device::Device;
use super::{ptpip, usb};
use std::io;
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// One client's connection.
pub(super) enum Link {
    /// PTP/IP, commands or events.
    Tcp(TcpStream),
    /// The bulk endpoints of USB.
    Unix(UnixStream),
}

impl Link {
    pub(super) fn try_clone(&self) -> io::Result<Self> {
        Ok(match self {
            Self::Tcp(stream) => Self::Tcp(stream.try_clone()?),
            Self::Unix(stream) => Self::Unix(stream.try_clone()?),
        })
    }

    /// Whether the other end is still there, as far as this end knows.
    pub(super) fn alive(&self) -> bool {
        match self {
            Self::Tcp(stream) => stream.peer_addr().is_ok(),
            Self::Unix(stream) => stream.peer_addr().is_ok(),
        }
    }

    /// Cuts it, for all handles on it.
    pub(super) fn shutdown(&self) {
        // A link that is gone already needs no cutting.
        let _ = match self {
            Self::Tcp(stream) => stream.shutdown(Shutdown::Both),
            Self::Unix(stream) => stream.shutdown(Shutdown::Both),
        };
    }

    /// Speaks with the client until one of them goes.
    pub(super) fn serve(self, device: &Arc<Device>) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => ptpip::serve(stream, device),
            Self::Unix(stream) => usb::serve(stream, device),
        }
    }
}

/// A door: a thread that takes clients, and how to wake it.
struct Door {
    thread: Option<JoinHandle<()>>,
    wake: Box<dyn Fn() + Send>,
}

/// The doors by which clients come in. Dropping it closes them: who connects afterwards is refused.
pub(super) struct Plug {
    closed: Arc<AtomicBool>,
    doors: Vec<Door>,
    /// The socket's file on a simulated USB bus.
    node: Option<PathBuf>,
}

impl Plug {
    /// Two loopback ports, one for commands, one for events; gives their addresses too.
    pub(super) fn ptpip(device: &Arc<Device>) -> io::Result<(Self, [SocketAddr; 2])> {
        let listeners =
            [TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?, TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?];
        let addresses = [listeners[0].local_addr()?, listeners[1].local_addr()?];
        let mut plug = Self { closed: Arc::default(), doors: Vec::new(), node: None };
        for (listener, address) in listeners.into_iter().zip(addresses) {
            plug.open(
                device,
                move || Ok(Link::Tcp(listener.accept()?.0)),
                move || {
                    // A connection is what wakes a thread out of accept; it then sees that it should stop.
                    let _ = TcpStream::connect(address);
                },
            )?;
        }
        Ok((plug, addresses))
    }

    /// A socket at `node`, which must not be there yet.
    pub(super) fn usb(device: &Arc<Device>, node: &Path) -> io::Result<Self> {
        let listener = UnixListener::bind(node)?;
        let mut plug = Self { closed: Arc::default(), doors: Vec::new(), node: Some(node.to_owned()) };
        let door = node.to_owned();
        plug.open(
            device,
            move || Ok(Link::Unix(listener.accept()?.0)),
            move || {
                let _ = UnixStream::connect(&door);
            },
        )?;
        Ok(plug)
    }

    fn open(
        &mut self,
        device: &Arc<Device>,
        accept: impl Fn() -> io::Result<Link> + Send + 'static,
        wake: impl Fn() + Send + 'static,
    ) -> io::Result<()> {
        let closed = Arc::clone(&self.closed);
        let device = Arc::downgrade(device);
        let thread = std::thread::Builder::new().name("studio-camera-door".into()).spawn(move || {
            loop {
                let link = accept();
                if closed.load(Ordering::Acquire) {
                    return;
                }
                let Some(device) = device.upgrade() else { return };
                if let Err(error) = link.and_then(|link| device.welcome(link)) {
                    tracing::warn!("simulated camera lost a client at the door: {error}");
                }
            }
        })?;
        self.doors.push(Door { thread: Some(thread), wake: Box::new(wake) });
        Ok(())
    }
}

impl Drop for Plug {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Release);
        for door in &mut self.doors {
            (door.wake)();
            if let Some(thread) = door.thread.take() {
                let _ = thread.join();
            }
        }
        if let Some(node) = &self.node {
            let _ = std::fs::remove_file(node);
        }
    }
}
