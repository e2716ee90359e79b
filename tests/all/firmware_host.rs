//! The board's program in simavr against those who talk to it in earnest, in real time on its terminal: the host's
//! driver, and avrdude.

use super::avr::{Desk, Report, Sim, built, mean_and_sd, rises};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use unlit::pair::FlashSync;
use unlit::rig::flash::SerialFlash;
use unlit::rig::{Flash, FlashError};

const TTL: Duration = Duration::from_secs(5);
const PATIENCE: Duration = Duration::from_secs(5);

/// A board that has booted and waits for its host; its flash recycles in 20 ms.
fn board() -> Sim {
    let mut desk = Desk::booted();
    desk.raw("cfg rec=20");
    let mut sim = desk.sim;
    for command in ["light recycle=20000 jitter=0.0029 seed=5", "uart pty", "pace real"] {
        sim.command(command);
    }
    sim.take();
    sim
}

fn frame(sim: &mut Sim, flash: &mut SerialFlash) -> FlashSync {
    sim.command("contact 0=1 8000=0");
    let shots = flash.syncs(PATIENCE).unwrap();
    assert_eq!(shots.len(), 1, "{shots:?}");
    shots[0]
}

#[test]
fn the_driver_takes_dark_and_lit_frames_with_the_real_program() {
    let mut sim = board();
    let mut flash = SerialFlash::open(&sim.device).unwrap();
    let description = flash.status().description;
    assert!(description.contains("atmega328p"), "{description}");
    let (mut lit, mut measured) = (0, Vec::new());
    for tag in 1..=12 {
        flash.disarm().unwrap();
        let dark = frame(&mut sim, &mut flash);
        assert_eq!((dark.triggered, dark.light()), (false, None));
        flash.arm(tag, TTL).unwrap();
        let shot = frame(&mut sim, &mut flash);
        assert_eq!((shot.triggered, shot.tag), (true, tag));
        lit += 1;
        measured.push(shot.light().unwrap());
    }
    sim.command("pace step");
    let reports = sim.take();
    let given: Vec<f64> = reports
        .iter()
        .filter_map(|r| if let Report::Light { energy } = r { Some(*energy) } else { None })
        .collect();
    assert_eq!((rises(&reports).len(), given.len()), (lit, lit));
    let ratios: Vec<f64> = measured.iter().zip(&given).map(|(m, g)| m / g).collect();
    let (mean, sd) = mean_and_sd(&ratios);
    println!(
        "{lit} pairs with the driver: measured over given energy {mean:.0} counts, SD {:.4} %",
        100.0 * sd / mean
    );
    assert!(sd / mean < 0.0008);
}

#[test]
fn the_driver_notices_that_the_real_program_was_reset() {
    let mut sim = board();
    let mut flash = SerialFlash::open(&sim.device).unwrap();
    flash.arm(1, TTL).unwrap();
    sim.command("reset");
    sim.command("contact 50000=1 60000=0");
    match flash.syncs(PATIENCE) {
        Err(FlashError::Lost { reason, .. }) => assert!(reason.contains("restarted"), "{reason}"),
        other => panic!("a restart was passed over: {other:?}"),
    }
    sim.command("pace step");
    assert!(rises(&sim.take()).is_empty());
}

/// As an Uno does: opening the port resets it.
#[test]
fn the_driver_opens_a_board_that_is_just_starting() {
    let mut sim = board();
    sim.command("reset");
    let mut flash = SerialFlash::open(&sim.device).unwrap();
    assert!(flash.status().ready, "{:?}", flash.status());
    flash.arm(3, TTL).unwrap();
    assert_eq!(frame(&mut sim, &mut flash).tag, 3);
}

#[test]
fn an_unplugged_board_disarms_itself() {
    let mut sim = board();
    let mut flash = SerialFlash::open(&sim.device).unwrap();
    flash.arm(1, Duration::from_secs(60)).unwrap();
    // The cable of the UART is cut; the board itself lives on.
    sim.command("unplug");
    sim.command("pace step");
    sim.take();
    sim.command("uart stdio");
    sim.run_us(2_000_000.0);
    let heard = sim.take();
    assert!(
        heard.iter().any(|r| matches!(r, Report::Said(line) if line.contains("why=silence"))),
        "{heard:?}"
    );
    sim.command("contact 0=1 9000=0");
    sim.run_us(60_000.0);
    assert!(rises(&sim.take()).is_empty());
    let error = flash.syncs(Duration::from_millis(100)).unwrap_err();
    assert!(matches!(error, FlashError::Lost { .. } | FlashError::Open { .. }), "{error}");
}

/// Debian's arduino-core-avr has the source of optiboot, under the GPL; its own build of it for this chip has 532
/// bytes for a section of 512, so it is built here, for a section of 1024.
fn boot_loader() -> PathBuf {
    let source = Path::new("/usr/share/arduino/hardware/arduino/avr/bootloaders/optiboot/optiboot.c");
    assert!(source.exists(), "{} is missing: run script/setup test", source.display());
    let base = Path::new(env!("CARGO_TARGET_TMPDIR")).join("firmware");
    let (elf, hex) = (base.join("optiboot.elf"), base.join("optiboot.hex"));
    let compiled = Command::new("avr-gcc")
        .args(["-Os", "-fno-inline-small-functions", "-fno-split-wide-types", "-mmcu=atmega328p"])
        .args(["-DF_CPU=16000000L", "-DBAUD_RATE=115200", "-DLED_START_FLASHES=3", "-w"])
        .args(["-nostartfiles", "-nostdlib", "-Wl,--section-start=.text=0x7c00"])
        .arg(source)
        .arg("-o")
        .arg(&elf)
        .status()
        .unwrap();
    let copied =
        Command::new("avr-objcopy").args(["-O", "ihex", "-j", ".text"]).arg(&elf).arg(&hex).status().unwrap();
    assert!(compiled.success() && copied.success(), "optiboot does not build");
    hex
}

#[test]
fn avrdude_programs_the_board_through_its_boot_loader() {
    built();
    let mut sim = Sim::with(&[Path::new("-"), &boot_loader()]);
    let packed = super::avr::firmware().join("avr/unlit-uno.hex");
    sim.command("pace real");
    let mut avrdude = Command::new("avrdude")
        .args(["-c", "arduino", "-p", "m328p", "-b", "115200", "-D", "-P"])
        .arg(&sim.device)
        .arg("-U")
        .arg(format!("flash:w:{}:i", packed.display()))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap_or_else(|e| panic!("avrdude does not start ({e}): run script/setup test"));
    // A pseudo terminal has no DTR, which would do this.
    sim.command("reset");
    let deadline = Instant::now() + Duration::from_secs(60);
    while avrdude.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            avrdude.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let done = avrdude.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && said.contains("bytes of flash verified"), "{said}");
    for command in ["pace step", "uart stdio"] {
        sim.command(command);
    }
    sim.take();
    sim.command("run 3000000 !1 boot");
    sim.command("say hello v=1");
    sim.command("run 300000 #0 ok");
    let heard = sim.take();
    assert!(
        heard.iter().any(|r| matches!(r, Report::Said(line) if line.starts_with("#0 ok v=1 fw="))),
        "{heard:?}"
    );
}
