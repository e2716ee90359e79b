//! A daemon in this process, with a rig without wires, whose patience and token the tests choose.

use crate::api::marking_works;
use crate::fake_rig::Room;
use crate::raw_http::DEADLINE;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use unlit::capture::{Desk, Engine, Events};
use unlit::http::{self, Door, Patience, Token};
use unlit::pair::Limits;

/// It, with its folder.
pub(crate) struct Yard {
    pub(crate) folder: TempDir,
    pub(crate) port: u16,
    /// Pairing codes that were shown.
    pub(crate) shown: Arc<Mutex<Vec<String>>>,
    stop: Option<oneshot::Sender<()>>,
    runtime: Option<tokio::runtime::Runtime>,
    served: Option<tokio::task::JoinHandle<std::io::Result<()>>>,
}

impl Yard {
    /// Without a token.
    pub(crate) fn open(patience: Patience) -> Self {
        Self::start(patience, None)
    }

    /// With the token of this file, which is made if need be.
    pub(crate) fn locked(token: &Path) -> Self {
        Self::start(Patience::default(), Some(token))
    }

    fn start(patience: Patience, token: Option<&Path>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let events = Events::default();
        let engine = Arc::new(Engine::new(Room::default().rig(), Limits::default(), events.clone()));
        let works = marking_works(&Arc::default());
        let desk = Desk::open(engine, events, &folder.path().join("sessions"), works, None).unwrap();
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
        let address = listener.local_addr().unwrap();
        let shown = Arc::new(Mutex::new(Vec::new()));
        let showing = shown.clone();
        let token = token.map(|file| Token::read_or_make(file).unwrap());
        let announce = move |code: &str| showing.lock().unwrap().push(code.to_owned());
        let mut door = Door::new(address, Vec::new(), token, announce).unwrap();
        door.patience = patience;
        let (stop, stopped) = oneshot::channel::<()>();
        let served = runtime.spawn(http::serve(listener, desk, None, door, async move {
            let _dropped = stopped.await;
        }));
        let port = address.port();
        Self { folder, port, shown, stop: Some(stop), runtime: Some(runtime), served: Some(served) }
    }

    /// Where the session of this name is.
    pub(crate) fn session(&self, name: &str) -> PathBuf {
        self.folder.path().join("sessions").join(name)
    }

    /// Ends the daemon and tells whether it ended as it should.
    pub(crate) fn close(&mut self) {
        drop(self.stop.take());
        if let (Some(runtime), Some(served)) = (self.runtime.take(), self.served.take()) {
            let ended = runtime.block_on(async { tokio::time::timeout(DEADLINE, served).await });
            runtime.shutdown_background();
            if !std::thread::panicking() {
                ended.expect("the daemon did not stop").unwrap().unwrap();
            }
        }
    }
}

impl Drop for Yard {
    fn drop(&mut self) {
        self.close();
    }
}
