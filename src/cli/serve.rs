//! `unlit serve`: the daemon with its page.

use super::devices::DeviceArgs;
use super::settings::{ConfigArgs, Settled};
use super::{CliError, CliResult, Exit, stop, works};
use crate::capture::{Desk, Engine, Events};
use crate::http::{self, Door, StudioControl, Token};
use crate::pipeline::pairs;
use crate::rig::usb;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use tokio::net::TcpListener;

#[derive(clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    devices: DeviceArgs,
    #[command(flatten)]
    door: DoorArgs,
    /// Folder of the sessions; made if need be.
    #[arg(long, value_name = "DIR", default_value = "sessions")]
    sessions: PathBuf,
    /// Folder on another disk that gets a second copy of every session that is opened; it must be there.
    #[arg(long, value_name = "DIR")]
    mirror: Option<PathBuf>,
    /// JSON file with limits of the checks; what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
    #[command(flatten)]
    _config: ConfigArgs,
    /// Prints the settings in force and where each comes from, as a config file, and ends.
    #[arg(long)]
    print_config: bool,
}

/// Where the daemon is reached and who is let in.
#[derive(clap::Args)]
struct DoorArgs {
    /// Address to listen on; one that other machines reach needs --token-file. Port 0 takes a free one.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8710")]
    listen: SocketAddr,
    /// Another name by which the daemon is asked for, as behind a proxy; may be given several times, and needs
    /// --token-file.
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    /// File with the token that lets in; made if it is not there, for its owner alone. Browsers are then paired
    /// with a code that stands on this terminal.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl DoorArgs {
    fn open(self) -> Result<Door, CliError> {
        let token = self.token_file.as_deref().map(Token::read_or_make).transpose().map_err(CliError::new)?;
        let announce = announcer().map_err(CliError::new)?;
        let mut door = Door::new(self.listen, self.allow_host, token, announce).map_err(CliError::new)?;
        let wanted = door.patience.connections;
        door.patience.connections = http::connections_that_fit(wanted);
        if door.patience.connections < wanted {
            tracing::warn!(
                "only {} connections at once: this process may open too few files (`ulimit -n`; LimitNOFILE= in a unit)",
                door.patience.connections
            );
        }
        Ok(door)
    }
}

/// Shows pairing codes from a thread of its own: a terminal that is stopped keeps nobody waiting who answers requests.
fn announcer() -> std::io::Result<impl Fn(&str) + Send + Sync> {
    let (show, shown) = sync_channel::<String>(4);
    std::thread::Builder::new()
        .name("pairing".into())
        .spawn(move || shown.iter().for_each(|code| show_code(&code)))?;
    Ok(move |code: &str| {
        if show.try_send(code.to_owned()).is_err() {
            tracing::warn!("the terminal takes no more pairing codes");
        }
    })
}

/// To whoever sees this terminal or reads this log.
fn show_code(code: &str) {
    let (first, last) = code.split_at(code.len() / 2);
    // A terminal that is gone shows nothing; the daemon goes on.
    drop(writeln!(
        std::io::stdout().lock(),
        "pairing code: {first} {last} (good for ten minutes, for one browser)"
    ));
}

pub(super) fn run(args: Args, settled: &Settled) -> CliResult {
    if args.print_config {
        print!("{}", settled.words());
        return Ok(Exit::Success);
    }
    let address = args.door.listen;
    let door = args.door.open()?;
    let limits = pairs::read_limits(args.limits.as_deref()).map_err(CliError::new)?;
    let (source, studio) = args.devices.prepare()?;
    let events = Events::default();
    let engine = Arc::new(Engine::new(source, limits, events.clone()));
    let after_pair = studio.as_ref().map(|studio| studio.operator(events.clone()));
    let desk = Desk::open(engine, events, &args.sessions, works::works().map_err(CliError::new)?, after_pair)
        .map_err(CliError::new)?;
    if let Some(mirror) = &args.mirror {
        desk.mirror_to(mirror).map_err(CliError::new)?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(CliError::new)?;
    // Who cannot listen begins nothing.
    let listener = runtime.block_on(TcpListener::bind(address)).map_err(|error| {
        CliError::new(format!("cannot listen on {address}: {error}; choose another with --listen"))
    })?;
    // A camera that is plugged in or out shows on the page without anybody asking.
    let looking = desk.clone();
    let _watch = usb::watch(move |_| drop(looking.look())).map_err(CliError::new)?;
    // What an earlier run left undone goes on; nobody waits for that.
    let resuming = desk.clone();
    std::thread::Builder::new()
        .name("resume".into())
        .spawn(move || resuming.resume())
        .map_err(CliError::new)?;
    let studio = studio.map(|s| s as Arc<dyn StudioControl>);
    let answered = runtime.block_on(answer(listener, door, desk, studio));
    // A handler that still waits for a device must not keep the program.
    runtime.shutdown_background();
    answered.map(|()| Exit::Success)
}

async fn answer(
    listener: TcpListener,
    door: Door,
    desk: Desk,
    studio: Option<Arc<dyn StudioControl>>,
) -> Result<(), CliError> {
    let stop = stop::Stop::listen(desk.clone())?;
    let here = listener.local_addr().map_err(CliError::new)?;
    if here.ip().is_unspecified() {
        let port = here.port();
        println!(
            "unlit is at http://localhost:{port}/, and at port {port} of this machine's addresses (ctrl-C ends it)"
        );
    } else {
        println!("unlit is at http://{here}/ (ctrl-C ends it)");
    }
    // Scripts wait for this line through a pipe.
    std::io::stdout().flush().map_err(CliError::new)?;
    let first_look = desk.clone();
    tokio::task::spawn_blocking(move || first_look.look());
    let answered = http::serve(listener, desk, studio, door, stop.asked()).await.map_err(CliError::new);
    stop.ended().await;
    answered
}
