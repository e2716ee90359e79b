//! `unlit shoot`: pairs from the terminal, by the same engine as the daemon's.

use super::devices::DeviceArgs;
use super::lighting::LightingArgs;
use super::sequence::{self, Crew, SequenceArgs};
use super::settings::ConfigArgs;
use super::{CliError, CliResult, Exit, open_session, progress_bar};
use crate::capture::{AfterPair, CaptureError, Engine, Events, ExposureWish, PairWish, Topic, words_on};
use crate::pair::order::Order;
use crate::pair::{Exposure, Plan, Verdict};
use crate::pipeline::pairs;
use crate::progress::Progress;
use crate::rig::LockState;
use crate::session::{MirrorPatience, MirrorState, MirrorStatus, Session};
use indicatif::ProgressBar;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How long the mirror may take to come into step after the last pair.
pub(super) const MIRROR_PATIENCE: Duration = Duration::from_secs(10);

#[derive(clap::Args)]
pub(super) struct Args {
    /// Session folder; made if it is not there.
    session: PathBuf,
    #[command(flatten)]
    devices: DeviceArgs,
    /// How many pairs to take.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pairs: u32,
    #[command(flatten)]
    sequence: SequenceArgs,
    /// The order of a pair's frames: off-on, on-off or off-on-off (the last tells how room and tripod drift).
    #[arg(long, value_name = "ORDER")]
    order: Option<Order>,
    /// Takes so many frames without flash in a row (1 to 16) and uses their mean; off-on-off takes as many after the lit
    /// one.
    #[arg(long, value_name = "N")]
    off_frames: Option<u8>,
    /// Shoots this rejected pair again, under its own number.
    #[arg(long, value_name = "NUMBER", conflicts_with = "pairs")]
    again: Option<u32>,
    /// Finds the exposure by test shots first, and makes it the session's.
    #[arg(long)]
    find_exposure: bool,
    /// Makes the exposure on the camera's dials the session's; without it, dials are turned back to the session's.
    #[arg(long, conflicts_with = "find_exposure")]
    keep_dials: bool,
    /// Folder on another disk that gets a second copy of the session while pairs are shot; it must be there.
    #[arg(long, value_name = "DIR")]
    mirror: Option<PathBuf>,
    /// JSON file with limits of the checks; what it does not name keeps its default.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
    #[command(flatten)]
    lighting: LightingArgs,
    #[command(flatten)]
    _config: ConfigArgs,
}

pub(super) fn run(args: Args) -> CliResult {
    let limits = pairs::read_limits(args.limits.as_deref()).map_err(CliError::new)?;
    let session = open_or_make(&args.session)?;
    args.lighting.tell(&session)?;
    let wish = PairWish { order: args.order, off_frames: args.off_frames, again: args.again };
    wish.program(&session).map_err(CliError::new)?;
    let (source, studio) = args.devices.prepare()?;
    let events = Events::default();
    let engine = Arc::new(Engine::new(source, limits, events.clone()));
    let (bar, progress) = progress_bar::watched();
    if let Some(mirror) = &args.mirror {
        keep_mirror(&session, mirror, bar.clone())?;
    }
    if args.devices.flash_is_manual() {
        answer_prompts(engine.clone(), &events, bar.clone())?;
    }
    if let Some(studio) = &studio {
        let next = session.next_pair_number().map_err(CliError::new)?;
        studio.go_to_pair(wish.again.unwrap_or(next));
    }
    tell_of_recovery(&events, bar.clone())?;
    show_lock(&engine, &session, &bar)?;
    if args.keep_dials {
        let told = engine.camera_state().map_err(CliError::new)?.settings;
        let (Some(shutter), Some(aperture), Some(iso)) = (told.shutter, told.aperture, told.iso) else {
            return Err(CliError::new(CaptureError::ExposureUntold));
        };
        let exposure = Exposure { shutter, aperture, iso };
        session.set_plan(Plan { off: exposure, on: exposure }).map_err(CliError::new)?;
    }
    if args.find_exposure {
        let found = engine.find_exposure(&session, ExposureWish::default(), &progress).map_err(|error| {
            bar.finish_and_clear();
            CliError::new(error)
        })?;
        let share = 100.0 * found.predicted_share;
        bar.suspend(|| println!("Exposure: {}; brightest channel at {share:.0} %.", found.plan.words()));
        found.warnings.iter().for_each(|warning| bar.suspend(|| println!("{warning}")));
    }
    let operator = studio.as_ref().map(|studio| studio.operator(events.clone()));
    tell_room(&session, &bar)?;
    if let Some(plan) = args.sequence.plan(wish) {
        let crew = Crew { engine, operator, events, progress, bar };
        return sequence::walk(&args.sequence, plan, session, crew);
    }
    let shot = shoot(args.pairs, wish, &engine, &session, operator.as_ref(), (&bar, &progress));
    if let Some(mirror) = session.finish_mirror(MIRROR_PATIENCE) {
        bar.suspend(|| println!("{}", mirror.words()));
    }
    bar.finish_and_clear();
    Ok(if shot? { Exit::Rejected } else { Exit::Success })
}

/// Takes the pairs; says whether any was rejected.
fn shoot(
    pairs: u32,
    wish: PairWish,
    engine: &Engine,
    session: &Session,
    operator: Option<&AfterPair>,
    (bar, progress): (&ProgressBar, &Progress),
) -> Result<bool, CliError> {
    let mut rejected = false;
    for turn in 1..=pairs {
        bar.set_prefix(format!("{turn}/{}", pairs));
        let pair = engine.shoot_pair_as(session, wish, operator, progress).map_err(CliError::new)?;
        rejected |= pair.verdict == Verdict::Rejected;
        bar.suspend(|| println!("{}", words_on(&pair)));
    }
    Ok(rejected)
}

/// Begins the second copy, and shows when it fails and when it is in step again.
fn keep_mirror(session: &Session, mirror: &Path, bar: ProgressBar) -> Result<(), CliError> {
    let failed = AtomicBool::new(false);
    let tell = move |status: &MirrorStatus| {
        let fails = matches!(status.state, MirrorState::Failing { .. });
        if failed.swap(fails, Ordering::Relaxed) || fails {
            bar.suspend(|| println!("{}", status.words()));
        }
    };
    session.mirror_to(mirror, MirrorPatience::default(), tell).map_err(CliError::new)
}

/// Says how many more pairs the disk takes, once that is known.
fn tell_room(session: &Session, bar: &ProgressBar) -> Result<(), CliError> {
    if let Some(pairs) = session.room().map_err(CliError::new)?.pairs() {
        bar.suspend(|| println!("Room for {pairs} more pairs on the disk."));
    }
    Ok(())
}

fn open_or_make(path: &Path) -> Result<Session, CliError> {
    if path.join("session.json").is_file() {
        return open_session(path);
    }
    let absolute = std::path::absolute(path).map_err(CliError::new)?;
    let name = absolute.file_name().map(|n| n.to_string_lossy().into_owned());
    Session::create(path, name.as_deref().unwrap_or("session")).map_err(CliError::new)
}

/// Shows what the operator should know of the camera's settings, and what only he can look up.
fn show_lock(engine: &Engine, session: &Session, bar: &ProgressBar) -> Result<(), CliError> {
    let lock = engine.camera_state().map_err(CliError::new)?.lock;
    let confirmed = session.manifest().confirmed;
    for item in &lock.items {
        match item.state {
            LockState::Corrected | LockState::Warning => bar.suspend(|| println!("{}", item.sentence)),
            LockState::Unreadable if !confirmed.contains(&item.name) => {
                bar.suspend(|| println!("Please look: {}", item.sentence));
            }
            _ => {}
        }
    }
    // Asked once a session: whoever goes on has looked.
    let asked = lock.items.iter().filter(|item| item.state == LockState::Unreadable);
    let asked: Vec<String> = asked.map(|item| item.name.clone()).collect();
    session.confirm(&asked).map_err(CliError::new)
}

/// Shows that a device failed and is brought back.
pub(super) fn tell_of_recovery(events: &Events, bar: ProgressBar) -> Result<(), CliError> {
    let (_, mut heard) = events.listen();
    let telling = move || {
        while let Ok(event) = heard.blocking_recv() {
            if event.topic == Topic::Recovery {
                bar.suspend(|| println!("{}", event.words));
            }
        }
    };
    std::thread::Builder::new().name("recovery".into()).spawn(telling).map_err(CliError::new)?;
    Ok(())
}

/// Shows what the engine asks for and confirms with the return key.
fn answer_prompts(engine: Arc<Engine>, events: &Events, bar: ProgressBar) -> Result<(), CliError> {
    let (_, mut heard) = events.listen();
    let answering = move || {
        while let Ok(event) = heard.blocking_recv() {
            if event.topic != Topic::Prompt {
                continue;
            }
            bar.suspend(|| println!("{} [return]", event.words));
            let mut line = String::new();
            match std::io::stdin().read_line(&mut line) {
                Ok(n) if n > 0 => engine.confirm(),
                _ => {
                    eprintln!("unlit: nobody is there to switch the flash (end of input)");
                    std::process::exit(1);
                }
            };
        }
    };
    std::thread::Builder::new().name("prompts".into()).spawn(answering).map_err(CliError::new)?;
    Ok(())
}
