//! `unlit flash`: the flash controller by itself, without a camera.

use super::devices::ControllerArgs;
use super::{CliError, CliResult, Exit};
use crate::rig::flash::ports::{self, Port};
use crate::rig::flash::trial::{self, BeforeTrial, TrialShot};
use crate::rig::flash::upload::{self, BoardKind, Upload};
use crate::rig::flash::{Finder, FlashSettings, Greeting, SerialFlash, greet};
use crate::rig::system::{Identity, Roots};
use crate::studio::{BlankBoard, Board, BoardOptions, SyncContact};
use clap::Subcommand;
use serde_json::json;
use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Pause between the syncs that a simulated camera gives to whoever watches.
const STUDIO_SYNC: Duration = Duration::from_secs(2);

/// Commands about the flash controller.
#[derive(Subcommand)]
pub(super) enum Flash {
    /// Lists serial ports: lasting name, USB device, rights, who has it open.
    Ports {
        /// Greets what is behind each port and says which is a controller. This resets an Arduino Uno.
        #[arg(long)]
        ask: bool,
        /// Prints JSON.
        #[arg(long)]
        json: bool,
        /// A simulated board instead of this machine's ports.
        #[arg(long)]
        studio: bool,
    },
    /// FIRES THE FLASH and shows each pulse, to place the photodiode; exit code 1 if a pulse gave no light.
    Test {
        #[command(flatten)]
        at: At,
        /// How often to fire.
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
        shots: u32,
        #[command(flatten)]
        controller: ControllerArgs,
        /// Prints JSON.
        #[arg(long)]
        json: bool,
    },
    /// Shows what the controller reports, as it happens, until ctrl-C.
    Watch {
        #[command(flatten)]
        at: At,
        /// Prints one JSON object a line.
        #[arg(long)]
        json: bool,
    },
    /// Programs an Arduino Uno or Nano through avrdude and greets it.
    Upload {
        #[command(flatten)]
        at: At,
        /// Kind of board; without it what the USB device looks like.
        #[arg(long, value_parser = kind)]
        board: Option<BoardKind>,
        /// Intel HEX file with the program; without it the one that this program brings along.
        #[arg(long, value_name = "FILE")]
        hex: Option<PathBuf>,
        /// avrdude's name or path.
        #[arg(long, value_name = "PROGRAM", default_value = "avrdude")]
        avrdude: OsString,
    },
}

/// Which controller.
#[derive(clap::Args)]
pub(super) struct At {
    /// Its serial device; without it the first controller that answers.
    #[arg(value_name = "PORT", conflicts_with = "studio")]
    port: Option<PathBuf>,
    /// A simulated board.
    #[arg(long)]
    studio: bool,
}

fn kind(name: &str) -> Result<BoardKind, String> {
    let kinds = [BoardKind::Uno, BoardKind::Nano, BoardKind::NanoOld];
    kinds.into_iter().find(|kind| kind.name() == name).ok_or_else(|| "one of uno, nano, nano-old".into())
}

/// Runs one of them.
pub(super) fn run(what: &Flash) -> CliResult {
    match what {
        Flash::Ports { ask, json, studio } => list(*ask, *json, *studio),
        Flash::Test { at, shots, controller, json } => try_out(at, *shots, controller.settings(), *json),
        Flash::Watch { at, json } => watch(at, *json),
        Flash::Upload { at, board, hex, avrdude } => program(at, *board, hex.clone(), avrdude),
    }
}

/// The simulated board, which must outlive the driver, and the driver.
fn open(at: &At, settings: FlashSettings) -> Result<(Option<Arc<Board>>, SerialFlash), CliError> {
    if at.studio {
        let board = Arc::new(Board::start(BoardOptions::default()).map_err(CliError::new)?);
        let flash = SerialFlash::open_with(board.device(), settings).map_err(CliError::new)?;
        return Ok((Some(board), flash));
    }
    let flash = match &at.port {
        Some(port) => SerialFlash::open_with(port, settings).map_err(CliError::new)?,
        None => Finder::default().open(settings).map_err(CliError::new)?.ok_or_else(no_port)?,
    };
    Ok((None, flash))
}

fn no_port() -> CliError {
    CliError::new(
        "no flash controller was found: plug it in, name its port if its USB chip is none of the usual (`unlit flash \
         ports` lists them), or try --studio",
    )
}

fn list(ask: bool, json: bool, studio: bool) -> CliResult {
    let (roots, me) = (Roots::default(), Identity::own());
    let board = studio.then(|| Board::start(BoardOptions::default())).transpose().map_err(CliError::new)?;
    let ports = match &board {
        Some(board) => vec![ports::look_at(board.device(), &roots, &me)],
        None => ports::survey(&roots, &me),
    };
    let asked: Vec<Option<Result<Greeting, String>>> =
        ports.iter().map(|port| ask.then(|| greet(&port.path).map_err(|error| error.to_string()))).collect();
    if json {
        let rows: Vec<_> = ports
            .iter()
            .zip(&asked)
            .map(|(port, asked)| {
                let greeting = asked.as_ref().and_then(|a| a.as_ref().ok());
                let error = asked.as_ref().and_then(|a| a.as_ref().err());
                json!({ "port": port, "controller": greeting, "error": error })
            })
            .collect();
        println!("{}", serde_json::to_string_pretty(&rows).map_err(CliError::new)?);
        return Ok(Exit::Success);
    }
    if ports.is_empty() {
        println!("No serial port was found. Plug the flash controller in.");
    }
    for (port, asked) in ports.iter().zip(&asked) {
        show_port(port);
        match asked {
            Some(Ok(Greeting { firmware, mcu, boot })) => {
                println!("    flash controller, firmware {firmware} ({mcu}), boot {boot}");
            }
            Some(Err(error)) => println!("    {error}"),
            None => {}
        }
    }
    Ok(Exit::Success)
}

fn show_port(port: &Port) {
    println!("{}", port.path.display());
    if port.node != port.path {
        println!("    is {}", port.node.display());
    }
    if let Some(usb) = &port.usb {
        let names = [&usb.maker, &usb.name].into_iter().flatten().cloned().collect::<Vec<_>>().join(" ");
        let serial =
            usb.serial.as_ref().map_or_else(String::new, |serial| format!(", serial number {serial}"));
        let likely = usb.likely().map_or_else(String::new, |likely| format!(" ({likely})"));
        println!("    USB {}:{}{likely} {names}{serial}", usb.vendor, usb.product);
    }
    if !port.usable {
        println!("    you may not use it (`unlit doctor` says what to do)");
    }
    for holder in &port.held_by {
        println!("    open in {} (process {})", holder.name, holder.id);
    }
}

fn try_out(at: &At, shots: u32, settings: FlashSettings, json: bool) -> CliResult {
    let (_board, mut flash) = open(at, settings)?;
    let before = trial::before(&mut flash).map_err(CliError::new)?;
    if !json {
        show_before(&before);
        let times = if shots == 1 { "once".into() } else { format!("{shots} times") };
        println!("The flash fires {times} NOW: do not look into it.");
    }
    let tell = |shot: &TrialShot| {
        if !json {
            show_shot(shot);
        }
    };
    let outcome = trial::run(&mut flash, before, shots, tell).map_err(CliError::new)?;
    if json {
        println!("{}", serde_json::to_string_pretty(&outcome).map_err(CliError::new)?);
    } else if let Some(repeated) = outcome.repeatability {
        println!(
            "Mean {:.0} counts, standard deviation {:.3} %.",
            repeated.mean_counts,
            100.0 * repeated.sd_relative
        );
    }
    Ok(if outcome.saw_light() { Exit::Success } else { Exit::Failure })
}

fn show_before(before: &BeforeTrial) {
    println!("{}", before.description);
    if let Some(settings) = &before.settings {
        println!(
            "Recycle time {} ms, trigger pulse {} us, light gathered for {} ms, ready output {}.",
            settings.recycle_ms,
            settings.pulse_us,
            f64::from(settings.window_us) / 1e3,
            if settings.ready_output { "awaited" } else { "not used" }
        );
    }
    println!("The room alone gives {:.1} of 1023 counts.", before.dark_counts);
}

fn show_shot(shot: &TrialShot) {
    let sync = &shot.sync;
    println!(
        "Shot {}: energy {:.0} counts, peak {:.0} of 1023, width {:.2} ms, dark level {:.1}{}. {}",
        sync.tag,
        sync.energy_counts,
        sync.peak_counts,
        shot.width_ms,
        sync.dark_counts,
        if sync.clipped_samples > 0 { format!(", {} clipped", sync.clipped_samples) } else { String::new() },
        shot.advice
    );
}

fn watch(at: &At, json: bool) -> CliResult {
    let (board, flash) = open(at, FlashSettings::default())?;
    let events = flash.follow();
    eprintln!("{}; ctrl-C ends it", flash.description());
    if let Some(board) = board {
        let camera = move || {
            loop {
                std::thread::sleep(STUDIO_SYNC);
                board.close();
            }
        };
        std::thread::Builder::new().name("studio-sync".into()).spawn(camera).map_err(CliError::new)?;
    }
    let start = std::time::Instant::now();
    let mut out = std::io::stdout();
    for event in events {
        let line = if json {
            serde_json::to_string(&event).map_err(CliError::new)?
        } else {
            format!("{:9.3} s  {}", start.elapsed().as_secs_f64(), event.news)
        };
        // Whoever reads through a pipe may have seen enough.
        if writeln!(out, "{line}").and_then(|()| out.flush()).is_err() {
            break;
        }
    }
    Ok(Exit::Success)
}

fn program(at: &At, board: Option<BoardKind>, hex: Option<PathBuf>, avrdude: &OsString) -> CliResult {
    let (roots, me) = (Roots::default(), Identity::own());
    let blank =
        at.studio.then(|| BlankBoard::start(BoardOptions::default())).transpose().map_err(CliError::new)?;
    let path = match (&blank, &at.port) {
        (Some(blank), _) => blank.port(),
        (None, Some(port)) => port.clone(),
        (None, None) => upload::choose_port().map_err(CliError::new)?,
    };
    let port = ports::look_at(&path, &roots, &me);
    let kinds = board.map_or_else(|| BoardKind::guess(&port).to_vec(), |kind| vec![kind]);
    let upload = Upload { port: path, kinds, hex, avrdude: avrdude.clone(), silence: upload::SILENCE };
    upload.check_free(&port).map_err(CliError::new)?;
    let greeting = upload.run(|words| eprint!("{words}")).map_err(CliError::new)?;
    println!(
        "Programmed: flash controller, firmware {} ({}), on {}",
        greeting.firmware,
        greeting.mcu,
        upload.port.display()
    );
    Ok(Exit::Success)
}
