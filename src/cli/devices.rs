//! The options that say which devices to use, and what comes of them: real drivers on real ports, or the
//! very same drivers on the simulated studio's.

use super::CliError;
use crate::capture::{AfterPair, Events, FlashKind, RigSource, Topic};
use crate::http::{StageOrder, StudioBody, StudioControl};
use crate::progress::Progress;
use crate::rig::camera::{self, HostedCamera};
use crate::rig::flash::{Finder, FlashSettings, SerialFlash};
use crate::rig::{CameraError, CameraInfo, Flash, FlashError};
use crate::studio::camera::CameraServer;
use crate::studio::world::{Stage, StageError, World};
use crate::studio::{Board, BoardOptions};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

#[derive(clap::Args)]
pub(super) struct DeviceArgs {
    /// Simulates camera, flash and object; the drivers are the real ones.
    #[arg(long, conflicts_with_all = ["camera", "flash"])]
    studio: bool,
    /// The camera's port (`usb:001,004`, `ptpip:192.168.1.2`); without it the first camera found.
    #[arg(long, value_name = "PORT")]
    camera: Option<String>,
    /// The flash controller's serial device, `manual` for a flash switched by hand, or `none`; without it
    /// the first controller that answers.
    #[arg(long, value_name = "DEV|manual|none")]
    flash: Option<String>,
    #[command(flatten)]
    controller: ControllerArgs,
}

/// What the flash controller is told of flash and room, each time that its port is opened (which resets an Uno) and
/// each time that it has restarted.
#[derive(clap::Args)]
pub(super) struct ControllerArgs {
    /// Recycle time of the flash, which the controller waits out after each trigger; without it the controller's own.
    #[arg(long, value_name = "SECONDS", value_parser = recycle_time)]
    recycle: Option<Duration>,
    /// Mains frequency of the room's lamps: light is gathered for whole periods of their flicker, 20 ms
    /// at 50 Hz and 25 ms at 60 Hz; without it the controller's own, 20 ms.
    #[arg(long, value_name = "50|60")]
    mains: Option<Mains>,
    /// The flash's ready output is wired to the controller, and must be high before each trigger.
    #[arg(long)]
    ready_output: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Mains {
    #[value(name = "50")]
    Hz50,
    #[value(name = "60")]
    Hz60,
}

impl Mains {
    /// Lamps flicker at twice the mains' frequency; whole periods of it cancel.
    fn window(self) -> Duration {
        match self {
            Mains::Hz50 => Duration::from_millis(20),
            Mains::Hz60 => Duration::from_millis(25),
        }
    }
}

impl ControllerArgs {
    /// What is not given stays as the board has it.
    pub(super) fn settings(&self) -> FlashSettings {
        FlashSettings {
            recycle: self.recycle,
            window: self.mains.map(Mains::window),
            ready_output: self.ready_output.then_some(true),
            ..FlashSettings::default()
        }
    }
}

/// Up to a minute, as the controller keeps it.
fn recycle_time(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text} is no number of seconds"))?;
    if !(0.0..=60.0).contains(&seconds) {
        return Err(format!("{text} s: the controller keeps recycle times of 0 to 60 s"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

impl DeviceArgs {
    /// How to come by the devices; with `--studio` the studio too, which lives as long as it is held.
    pub(super) fn prepare(&self) -> Result<(RigSource, Option<Arc<Studio>>), CliError> {
        if self.studio {
            let studio = Studio::start()?;
            let (port, device) = (studio.camera.port(), studio.board.device().to_owned());
            let simulated = vec![CameraInfo {
                model: "Canon EOS 5DS (simulated)".into(),
                port: port.clone(),
                serial: None,
            }];
            let settings = self.controller.settings();
            let source = RigSource {
                camera: Box::new(move |_| Ok(Box::new(HostedCamera::open(Some(&port))?))),
                cameras: Box::new(move || Ok(simulated.clone())),
                flash: Box::new(move || controller(&device, settings)),
            };
            return Ok((source, Some(Arc::new(studio))));
        }
        let port = self.camera.clone();
        let settings = self.controller.settings();
        let camera =
            Box::new(move |chosen: Option<&str>| -> Result<Box<dyn crate::rig::Camera>, CameraError> {
                Ok(Box::new(HostedCamera::open(chosen.or(port.as_deref()))?))
            });
        let flash: Box<dyn Fn() -> Result<FlashKind, FlashError> + Send> = match self.flash.as_deref() {
            Some("manual") => Box::new(|| Ok(FlashKind::Manual)),
            Some("none") => Box::new(|| Ok(FlashKind::None)),
            Some(device) => {
                let device = PathBuf::from(device);
                Box::new(move || controller(&device, settings))
            }
            None => {
                let finder = Finder::default();
                Box::new(move || first_controller(&finder, settings))
            }
        };
        Ok((RigSource { camera, cameras: Box::new(camera::list), flash }, None))
    }

    /// Whether the operator switches the flash.
    pub(super) fn flash_is_manual(&self) -> bool {
        self.flash.as_deref() == Some("manual")
    }
}

fn controller(device: &Path, settings: FlashSettings) -> Result<FlashKind, FlashError> {
    Ok(FlashKind::Controller(Box::new(SerialFlash::open_with(device, settings)?) as Box<dyn Flash>))
}

/// The first likely serial port behind which a controller answers; none where there are no such ports.
fn first_controller(finder: &Finder, settings: FlashSettings) -> Result<FlashKind, FlashError> {
    Ok(match finder.open(settings)? {
        Some(flash) => FlashKind::Controller(Box::new(flash)),
        None => FlashKind::None,
    })
}

/// The simulated studio at the other end of the wires.
pub(super) struct Studio {
    world: Arc<World>,
    camera: CameraServer,
    board: Arc<Board>,
}

impl Studio {
    fn start() -> Result<Self, CliError> {
        let board = Arc::new(Board::start(BoardOptions::default()).map_err(CliError::new)?);
        let progress = Progress::new(|report| {
            tracing::info!("studio: {} {}/{}", report.stage, report.done, report.total);
        });
        let world = Arc::new(World::new(board.clone(), &progress).map_err(CliError::new)?);
        let camera = CameraServer::start(world.clone()).map_err(CliError::new)?;
        Ok(Self { world, camera, board })
    }

    /// The operator, who walks on after each accepted pair.
    pub(super) fn operator(self: &Arc<Self>, events: Events) -> AfterPair {
        let studio = self.clone();
        Arc::new(move |_| {
            studio.world.walk_on();
            let now = studio.describe();
            events.tell(Topic::Studio, now.words.clone(), json!(now));
        })
    }

    /// Puts the white card before the lens, `distance_m` metres away.
    pub(super) fn show_card(&self, distance_m: f64) -> Result<(), StageError> {
        self.world.set_stage(Stage::Card { distance_m })
    }

    /// Sends the operator to the stop where pair `number` is taken.
    pub(super) fn go_to_pair(&self, number: u32) {
        let stops = self.world.stops().max(1);
        let stop = (number.saturating_sub(1) as usize) % stops + 1;
        if let Err(error) = self.world.set_stage(Stage::Stop(stop)) {
            tracing::error!("{error}");
        }
    }
}

impl StudioControl for Studio {
    fn describe(&self) -> StudioBody {
        let stops = self.world.stops();
        let body =
            StudioBody { words: String::new(), stop: None, stops, card_distance_m: None, lens_cap: false };
        match self.world.stage() {
            Stage::Stop(k) => StudioBody {
                words: format!("The operator stands at stop {k} of {stops}."),
                stop: Some(k),
                ..body
            },
            Stage::Card { distance_m } => StudioBody {
                words: format!("The white card stands {distance_m} m from the lens."),
                card_distance_m: Some(distance_m),
                ..body
            },
            Stage::Cap => StudioBody { words: "The cap is on the lens.".into(), lens_cap: true, ..body },
        }
    }

    fn direct(&self, order: StageOrder) -> Result<(), String> {
        let stage = match order {
            StageOrder::Stop { stop } => Stage::Stop(stop),
            StageOrder::Card { card_distance_m } => Stage::Card { distance_m: card_distance_m },
            StageOrder::LensCap { lens_cap: true } => Stage::Cap,
            StageOrder::LensCap { lens_cap: false } => {
                return Err("lens_cap can only be put on (true); choose a stop to take it off".into());
            }
        };
        self.world.set_stage(stage).map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        controller: ControllerArgs,
    }

    fn settings(words: &[&str]) -> Option<FlashSettings> {
        let line = Line::try_parse_from(["unlit"].iter().chain(words)).ok()?;
        Some(line.controller.settings())
    }

    #[test]
    fn the_board_is_told_only_what_is_given() {
        assert_eq!(settings(&[]), Some(FlashSettings::default()));
        for (mains, ms) in [("50", 20), ("60", 25)] {
            let window = settings(&["--mains", mains]).unwrap().window.unwrap();
            assert_eq!(window, Duration::from_millis(ms));
            let period = 1.0 / (2.0 * mains.parse::<f64>().unwrap());
            let periods = window.as_secs_f64() / period;
            assert!((periods - periods.round()).abs() < 1e-9, "{periods} periods of the flicker");
        }
        assert_eq!(settings(&["--mains", "55"]), None);
        assert_eq!(settings(&["--ready-output"]).unwrap().ready_output, Some(true));
    }
}
