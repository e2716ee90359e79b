//! The series that tells how steady the known light is, through everything that is real: the engine, libgphoto2 in its
//! host, the serial driver on a pty, the firmware's core. Only the body, the card before it and the flash are simulated.

use crate::camera::{program, rig};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::calibration::Steadiness;
use unlit::capture::{Engine, Events, RepeatReport};
use unlit::pair::Limits;
use unlit::pipeline::energy::repeatability_file;
use unlit::progress::Progress;
use unlit::session::Session;
use unlit::studio::camera::{BodyOptions, CameraServer};
use unlit::studio::world::{Stage, World};
use unlit::studio::{Board, BoardOptions};

struct House {
    _folder: TempDir,
    session: Session,
    engine: Engine,
    board: Arc<Board>,
    _server: CameraServer,
}

impl House {
    /// The studio with its card 1 m before the lens.
    fn new(seed: u64) -> Self {
        assert!(program().is_file());
        let board = Arc::new(Board::start(BoardOptions { seed, ..BoardOptions::default() }).unwrap());
        let world = Arc::new(World::new(board.clone(), &Progress::silent()).unwrap());
        world.set_stage(Stage::Card { distance_m: 1.0 }).unwrap();
        let server = CameraServer::start_with(world, &BodyOptions::default()).unwrap();
        let rig = rig(server.port(), board.device(), Duration::from_secs(10));
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("card"), "card").unwrap();
        let engine = Engine::new(rig, Limits::default(), Events::default());
        Self { _folder: folder, session, engine, board, _server: server }
    }

    /// Energies that the flash truly gave, misfires left out.
    fn energies(&self) -> Vec<f64> {
        self.board.rises().iter().map(|rise| rise.energy).filter(|energy| *energy > 0.0).collect()
    }

    fn report(&self) -> RepeatReport {
        serde_json::from_slice(&std::fs::read(repeatability_file(&self.session)).unwrap()).unwrap()
    }
}

fn relative_deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / (values.len() - 1) as f64).sqrt() / mean
}

#[test]
fn forty_shots_spread_as_the_flash_does_and_far_less_divided_by_the_measured_energy() {
    let seed: u64 = std::env::var("UNLIT_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let house = House::new(seed);
    let began = Instant::now();
    let result: Steadiness = house.engine.repeatability(&house.session, 40, &Progress::silent()).unwrap();
    let took = began.elapsed();
    let energies = house.energies();
    let given = relative_deviation(&energies);
    let by_energy = result.light_by_energy_deviation.unwrap();
    println!(
        "seed {seed}: the flash gave {:.4} %; reported {:.4} % before and {:.4} % after division by the measured energy \
         (sensor noise {:.4} %); {took:.1?}",
        100.0 * given,
        100.0 * result.light_deviation,
        100.0 * by_energy,
        100.0 * result.sensor_deviation,
    );
    assert_eq!((energies.len(), result.frames.len()), (40, 40));
    assert!(house.board.rises().iter().all(|rise| rise.ordered));
    assert!(
        (result.light_deviation / given - 1.0).abs() < 0.03,
        "{} reported for {given}",
        result.light_deviation
    );
    assert!(by_energy < 0.0008, "{by_energy}");
    // Shot by shot, the light is what the flash gave.
    let ratios: Vec<f64> =
        result.frames.iter().zip(&energies).map(|(shot, e)| shot.light_dn[1] / e).collect();
    assert!(relative_deviation(&ratios) < 0.0005, "{ratios:?}");

    let report = house.report();
    assert_eq!((report.left_out, &report.result), (0, &result));
    let text = std::fs::read_to_string(repeatability_file(&house.session)).unwrap();
    let stored: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (stored["light_deviation"].as_f64(), stored["light_by_energy_deviation"].as_f64()),
        (Some(result.light_deviation), Some(by_energy))
    );
    assert!(house.session.pairs().unwrap().is_empty(), "shots of a series are no pairs");
}

#[test]
fn a_shot_that_misfires_is_told_left_out_and_taken_again_and_a_dead_flash_ends_the_series() {
    let house = House::new(5);
    house.board.misfire(2);
    let result = house.engine.repeatability(&house.session, 8, &Progress::silent()).unwrap();
    assert_eq!((result.frames.len(), house.report().left_out), (8, 2));
    assert_eq!(house.energies().len(), 8);

    house.board.misfire(u32::MAX);
    let error = house.engine.repeatability(&house.session, 8, &Progress::silent()).unwrap_err();
    assert_eq!(error.code(), "series_broken");
    assert!(error.to_string().contains("photodiode saw no pulse"), "{error}");
    let error = house.engine.repeatability(&house.session, 7, &Progress::silent()).unwrap_err();
    assert_eq!(error.code(), "series_says_nothing", "{error}");
}

#[test]
fn a_series_survives_a_controller_that_loses_its_power_for_a_moment() {
    let house = House::new(6);
    let board = house.board.clone();
    let progress = Progress::new(move |report| {
        if report.stage.starts_with("Shot 4 of") && board.device().exists() {
            board.unplug(true).unwrap();
            board.plug_in().unwrap();
        }
    });
    let result = house.engine.repeatability(&house.session, 8, &progress).unwrap();
    let numbers: Vec<String> = (1..=8).map(|number| format!("shot {number}")).collect();
    assert_eq!(
        result.frames.iter().map(|shot| &shot.label).collect::<Vec<_>>(),
        numbers.iter().collect::<Vec<_>>()
    );
    assert!(house.board.rises().iter().all(|rise| rise.ordered));
}
