//! `unlit serve`: the daemon with its page.

use super::devices::DeviceArgs;
use super::{CliError, CliResult, Exit, works};
use crate::capture::{Desk, Engine, Events};
use crate::http::{self, StudioControl};
use crate::pipeline::pairs;
use crate::rig::usb;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};

/// How long running jobs may take to end after the signal to stop.
const LAST_PATIENCE: Duration = Duration::from_secs(10);

#[derive(clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    devices: DeviceArgs,
    /// Address to listen on, this machine's own only; port 0 takes a free one.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8710")]
    listen: SocketAddr,
    /// Folder of the sessions; made if need be.
    #[arg(long, value_name = "DIR", default_value = "sessions")]
    sessions: PathBuf,
    /// JSON file with limits of the checks; what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
}

pub(super) fn run(args: Args) -> CliResult {
    let address = http::loopback_only(args.listen).map_err(CliError::new)?;
    let limits = pairs::read_limits(args.limits.as_deref()).map_err(CliError::new)?;
    let (source, studio) = args.devices.prepare()?;
    let events = Events::default();
    let engine = Arc::new(Engine::new(source, limits, events.clone()));
    let after_pair = studio.as_ref().map(|studio| studio.operator(events.clone()));
    let desk = Desk::open(engine, events, &args.sessions, works::works().map_err(CliError::new)?, after_pair)
        .map_err(CliError::new)?;
    // A camera that is plugged in or out shows on the page without anybody asking.
    let looking = desk.clone();
    let _watch = usb::watch(move |_| drop(looking.look())).map_err(CliError::new)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(CliError::new)?;
    runtime.block_on(answer(address, desk.clone(), studio.map(|s| s as Arc<dyn StudioControl>)))?;
    if !desk.close(LAST_PATIENCE) {
        tracing::warn!("some work did not end within {LAST_PATIENCE:?} and was abandoned");
    }
    // A handler that still waits for a device must not keep the program.
    runtime.shutdown_background();
    Ok(Exit::Success)
}

async fn answer(
    address: SocketAddr,
    desk: Desk,
    studio: Option<Arc<dyn StudioControl>>,
) -> Result<(), CliError> {
    let listener = TcpListener::bind(address).await.map_err(|error| {
        CliError::new(format!("cannot listen on {address}: {error}; choose another with --listen"))
    })?;
    let mut interrupted = signal(SignalKind::interrupt()).map_err(CliError::new)?;
    let mut terminated = signal(SignalKind::terminate()).map_err(CliError::new)?;
    let stop = async move {
        tokio::select! {
            _ = interrupted.recv() => {}
            _ = terminated.recv() => {}
        }
    };
    let here = listener.local_addr().map_err(CliError::new)?;
    println!("unlit is at http://{here}/ (ctrl-C ends it)");
    // Scripts wait for this line through a pipe.
    std::io::stdout().flush().map_err(CliError::new)?;
    let first_look = desk.clone();
    tokio::task::spawn_blocking(move || first_look.look());
    http::serve(listener, desk, studio, stop).await.map_err(CliError::new)
}
