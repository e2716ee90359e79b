//! The simulated camera: a PTP/IP responder on loopback that the unmodified libgphoto2 opens as a Canon EOS.
//!
//! It takes a [`View`] (what stands before the lens) and gives a port name for the real driver
//! (`ptpip:127.0.0.1:COMMANDS:EVENTS`). Packets are those of CIPA DC-005 (`packet`), operations those that
//! libgphoto2's ptp2 driver was seen to use with an EOS (`responder`, `datasets`); the body is in M,
//! manual focus, RAW alone (`body`, `dials`).
//!
//! The object is announced in Canon's format b103, so libgphoto2 names it `capt0000.cr2`, whatever name the
//! body gave; the bytes are those that [`View::expose`] returned, unchanged, and say themselves that they
//! are a DNG.

mod body;
mod datasets;
mod dials;
mod packet;
mod responder;

use crate::pair::Exposure;
use crate::studio::View;
use body::Body;
use std::io;
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// What can go wrong with a body, for tests. Each is one that libgphoto2 was seen to meet in the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No request is answered any more, until [`CameraServer::mend`]; then the link drops.
    Stall,
    /// The next release is answered "busy".
    BusyOnce,
    /// The next download loses its link.
    DropInDownload,
    /// The body says that there is no room for another frame; libgphoto2 then asks for ever, without a pause.
    NoRoom,
}

/// What the threads of one server share.
struct Shared {
    view: Arc<dyn View>,
    body: Mutex<Body>,
    fault: Mutex<Option<Fault>>,
    mended: Condvar,
    stopping: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
    links: Mutex<Vec<TcpStream>>,
}

fn poisoned<T>(_: PoisonError<T>) -> io::Error {
    io::Error::other("a thread of the simulated camera panicked; start the studio again")
}

impl Shared {
    fn body(&self) -> io::Result<MutexGuard<'_, Body>> {
        self.body.lock().map_err(poisoned)
    }

    /// Whether this fault was set; it is then used up.
    fn take_fault(&self, fault: Fault) -> io::Result<bool> {
        let mut set = self.fault.lock().map_err(poisoned)?;
        Ok(set.take_if(|f| *f == fault).is_some())
    }

    /// Holds a request for as long as the body is stalled. What was stalled is never carried out: its
    /// client has given up meanwhile, and a frame exposed for nobody would be worse than none.
    fn pass_stall(&self) -> io::Result<()> {
        let mut fault = self.fault.lock().map_err(poisoned)?;
        if *fault != Some(Fault::Stall) {
            return Ok(());
        }
        while *fault == Some(Fault::Stall) && !self.stopping.load(Ordering::Acquire) {
            fault = self.mended.wait(fault).map_err(poisoned)?;
        }
        Err(io::Error::new(io::ErrorKind::ConnectionAborted, "link dropped after a stall, as asked"))
    }

    /// Exposes one frame on the shutter's thread.
    fn expose(self: &Arc<Self>, exposure: Exposure) -> io::Result<()> {
        let shared = Arc::clone(self);
        self.spawn("shutter", move || {
            // A view that panics must not leave the body busy for ever; it just has no frame.
            let frame = catch_unwind(AssertUnwindSafe(|| shared.view.expose(&exposure)));
            if let Ok(mut body) = shared.body() {
                match frame {
                    Ok(bytes) => body.end_exposure(bytes),
                    Err(_) => body.finish_exposure(),
                }
            }
        })
    }

    fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let mut threads = self.threads.lock().map_err(poisoned)?;
        threads.retain(|thread| !thread.is_finished());
        threads.push(std::thread::Builder::new().name(format!("studio-camera-{name}")).spawn(work)?);
        Ok(())
    }

    /// Takes clients until the server stops.
    fn accept(self: &Arc<Self>, listener: &TcpListener) {
        for stream in listener.incoming() {
            if self.stopping.load(Ordering::Acquire) {
                return;
            }
            if let Err(error) = stream.and_then(|stream| self.welcome(stream)) {
                tracing::warn!("simulated camera lost a client at the door: {error}");
            }
        }
    }

    fn welcome(self: &Arc<Self>, stream: TcpStream) -> io::Result<()> {
        let mut links = self.links.lock().map_err(poisoned)?;
        links.retain(|link| link.peer_addr().is_ok());
        links.push(stream.try_clone()?);
        drop(links);
        let shared = Arc::clone(self);
        self.spawn("client", move || {
            let link = stream.try_clone();
            match responder::serve(stream, &shared) {
                Err(error) if error.kind() != io::ErrorKind::UnexpectedEof => {
                    tracing::debug!("simulated camera closed a link: {error}");
                }
                _ => {}
            }
            // The list of links holds a handle on the socket, so dropping ours would not close it.
            if let Ok(link) = link {
                let _ = link.shutdown(Shutdown::Both);
            }
        })
    }
}

/// A simulated camera that listens. Dropping it closes its links and ends its threads.
pub struct CameraServer {
    shared: Arc<Shared>,
    commands: SocketAddr,
    events: SocketAddr,
}

impl CameraServer {
    /// Binds two free loopback ports and serves a body that looks at `view`: 1/125 s, f/11, ISO 100.
    pub fn start(view: Arc<dyn View>) -> io::Result<Self> {
        let listeners =
            [TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?, TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?];
        let [commands, events] = [listeners[0].local_addr()?, listeners[1].local_addr()?];
        let shared = Arc::new(Shared {
            view,
            body: Mutex::new(Body::new()),
            fault: Mutex::new(None),
            mended: Condvar::new(),
            stopping: AtomicBool::new(false),
            threads: Mutex::new(Vec::new()),
            links: Mutex::new(Vec::new()),
        });
        for listener in listeners {
            let door = Arc::clone(&shared);
            shared.spawn("door", move || door.accept(&listener))?;
        }
        Ok(Self { shared, commands, events })
    }

    /// The port by which libgphoto2 opens this camera, as model "PTP/IP Camera".
    pub fn port(&self) -> String {
        format!("ptpip:{}:{}", self.commands, self.events.port())
    }

    /// Sets a fault; it replaces the one set before.
    pub fn fault(&self, fault: Fault) {
        self.put_fault(Some(fault));
    }

    /// Mends whatever fault is set.
    pub fn mend(&self) {
        self.put_fault(None);
    }

    fn put_fault(&self, fault: Option<Fault>) {
        *self.shared.fault.lock().unwrap_or_else(PoisonError::into_inner) = fault;
        self.shared.body.lock().unwrap_or_else(PoisonError::into_inner).full = fault == Some(Fault::NoRoom);
        self.shared.mended.notify_all();
    }
}

impl Drop for CameraServer {
    fn drop(&mut self) {
        self.shared.stopping.store(true, Ordering::Release);
        // Whoever waits in a stall holds the lock while it looks at `stopping`; taking it closes the gap.
        drop(self.shared.fault.lock());
        self.shared.mended.notify_all();
        for door in [self.commands, self.events] {
            // A connection is what wakes a thread out of accept; it then sees that it should stop.
            let _ = TcpStream::connect(door);
        }
        for link in self.shared.links.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            let _ = link.shutdown(Shutdown::Both);
        }
        let threads =
            std::mem::take(&mut *self.shared.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            let _ = thread.join();
        }
    }
}
