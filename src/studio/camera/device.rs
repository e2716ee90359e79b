//! The body with all that its threads share: faults, the shutter's thread, the links that lead to it.

use super::body::Body;
use super::fault::{Fault, Faults};
use super::objects::Kind;
use super::operate;
use super::options::BodyOptions;
use super::plug::{Link, Plug};
use super::request::{Outcome, Request};
use crate::pair::Exposure;
use crate::studio::View;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What the threads of one camera share.
pub(super) struct Device {
    pub(super) view: Arc<dyn View>,
    /// Serial number.
    pub(super) serial: String,
    /// Exposures take their time.
    real_shutter: bool,
    body: Mutex<Body>,
    faults: Mutex<Faults>,
    /// Told when faults are mended or the camera is switched off.
    mended: Condvar,
    stopping: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
    links: Mutex<Vec<Link>>,
    /// How clients reach the body; nothing while it is unplugged.
    plug: Mutex<Option<Plug>>,
}

/// A frame that is to be exposed.
pub(super) struct Frame {
    pub(super) exposure: Exposure,
    /// The files that it becomes.
    pub(super) kinds: Vec<Kind>,
    /// How long the shutter waits.
    pub(super) delay: Duration,
    /// What becomes of it.
    pub(super) fault: Option<Fault>,
}

fn poisoned<T>(_: PoisonError<T>) -> io::Error {
    io::Error::other("a thread of the simulated camera panicked; start the studio again")
}

fn aborted(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::ConnectionAborted, why.to_owned())
}

impl Device {
    pub(super) fn new(view: Arc<dyn View>, options: &BodyOptions) -> Arc<Self> {
        Arc::new(Self {
            view,
            serial: options.serial.clone(),
            real_shutter: options.real_shutter,
            body: Mutex::new(Body::new(options)),
            faults: Mutex::default(),
            mended: Condvar::new(),
            stopping: AtomicBool::new(false),
            threads: Mutex::default(),
            links: Mutex::default(),
            plug: Mutex::new(None),
        })
    }

    pub(super) fn body(&self) -> io::Result<MutexGuard<'_, Body>> {
        self.body.lock().map_err(poisoned)
    }

    /// The faults; a panic elsewhere leaves them as readable as before.
    pub(super) fn faults(&self) -> MutexGuard<'_, Faults> {
        self.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Mends all faults.
    pub(super) fn mend(&self) {
        self.faults().mend();
        self.mended.notify_all();
    }

    /// Whether the camera is being switched off.
    pub(super) fn stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    /// One request, with what the client sent along: counted, struck by what is due, or carried out.
    pub(super) fn answer(self: &Arc<Self>, request: &Request, sent: &[u8]) -> io::Result<Outcome> {
        self.faults().count_operation();
        tracing::trace!("{:04x} {:x?} {:x?}", request.operation, request.parameters, sent);
        if self.faults().strike(|f| *f == Fault::Unplug).is_some() {
            self.unplug();
            return Err(aborted("unplugged, as asked"));
        }
        self.pass_stall()?;
        if self.faults().strike(|f| *f == Fault::StallOnce).is_some() {
            return Ok(Outcome::Silence);
        }
        operate::operate(request, sent, self)
    }

    /// Holds a request for as long as the body is stalled. What was stalled is never carried out: its
    /// client has given up meanwhile, and a frame exposed for nobody would be worse than none.
    fn pass_stall(&self) -> io::Result<()> {
        let mut faults = self.faults();
        if faults.strike(|f| *f == Fault::Stall).is_none() {
            return Ok(());
        }
        while faults.has(Fault::Stall) && !self.stopping() {
            faults = self.mended.wait(faults).unwrap_or_else(PoisonError::into_inner);
        }
        Err(aborted("link dropped after a stall, as asked"))
    }

    /// Lets time pass, unless the camera is switched off.
    pub(super) fn pause(&self, time: Duration) {
        let until = Instant::now() + time;
        let mut faults = self.faults();
        while let Some(left) = until.checked_duration_since(Instant::now()).filter(|_| !self.stopping()) {
            faults = self.mended.wait_timeout(faults, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Exposes one frame on the shutter's thread.
    pub(super) fn expose(self: &Arc<Self>, frame: Frame) -> io::Result<()> {
        let device = Arc::clone(self);
        self.spawn("shutter", move || {
            device.pause(frame.delay);
            // A view that panics must not leave the body busy for ever; it just has no frame.
            let files = catch_unwind(AssertUnwindSafe(|| device.files(&frame)));
            if let Ok(mut body) = device.body() {
                match files {
                    Ok(files) => body.end_exposure(files, frame.fault),
                    Err(_) => body.finish_exposure(),
                }
            }
        })
    }

    /// The files of one frame, exposed now.
    fn files(&self, frame: &Frame) -> Vec<(Kind, Arc<[u8]>)> {
        if self.real_shutter {
            self.pause(Duration::from_secs_f64(frame.exposure.shutter.0.max(0.0)));
        }
        // The sensor is read out whatever becomes of it.
        let raw: Arc<[u8]> = self.view.expose(&frame.exposure).into();
        let file = |kind: &Kind| match kind {
            Kind::Raw => (Kind::Raw, Arc::clone(&raw)),
            Kind::Jpeg => (Kind::Jpeg, self.view.jpeg(&frame.exposure).into()),
        };
        frame.kinds.iter().map(file).collect()
    }

    pub(super) fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let mut threads = self.threads.lock().map_err(poisoned)?;
        threads.retain(|thread| !thread.is_finished());
        threads.push(std::thread::Builder::new().name(format!("studio-camera-{name}")).spawn(work)?);
        Ok(())
    }

    /// Serves one client on a thread of its own.
    pub(super) fn welcome(self: &Arc<Self>, link: Link) -> io::Result<()> {
        let mut links = self.links.lock().map_err(poisoned)?;
        links.retain(Link::alive);
        links.push(link.try_clone()?);
        drop(links);
        let device = Arc::clone(self);
        self.spawn("client", move || {
            let handle = link.try_clone();
            match link.serve(&device) {
                Err(error) if error.kind() != io::ErrorKind::UnexpectedEof => {
                    tracing::debug!("simulated camera closed a link: {error}");
                }
                _ => {}
            }
            // The list of links holds a handle on the socket, so dropping ours would not close it.
            if let Ok(handle) = handle {
                handle.shutdown();
            }
        })
    }

    /// Lets clients in by `plug`.
    pub(super) fn plug_in(&self, plug: Plug) {
        *self.plug.lock().unwrap_or_else(PoisonError::into_inner) = Some(plug);
    }

    /// Whether clients can get in.
    pub(super) fn plugged(&self) -> bool {
        self.plug.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Pulls the plug: no client gets in, those that are in lose their links.
    pub(super) fn unplug(&self) {
        let plug = self.plug.lock().unwrap_or_else(PoisonError::into_inner).take();
        drop(plug);
        for link in self.links.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            link.shutdown();
        }
    }

    /// Ends all threads.
    pub(super) fn stop(&self) {
        self.stopping.store(true, Ordering::Release);
        // Whoever waits in a stall holds the lock while it looks at `stopping`; taking it closes the gap.
        drop(self.faults());
        self.mended.notify_all();
        self.unplug();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            let _ = thread.join();
        }
    }
}
