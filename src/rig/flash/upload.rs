//! Programs the board: runs avrdude against the boot loader of an Arduino Uno or Nano, and greets the board that
//! comes of it. Takes a port, the kind of board and an Intel HEX file (or the one packed into this program); gives
//! avrdude's words as they come.

use super::greeting::{Greeting, greet};
use super::ports::{self, Port};
use crate::rig::FlashError;
use crate::rig::system::{Holder, Identity, Roots};
use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;
use tempfile::NamedTempFile;

/// The controller's program, as `make -C firmware/avr package` lays it there.
pub const FIRMWARE: &[u8] = include_bytes!("../../../firmware/avr/unlit-uno.hex");
/// avrdude tries ten times, five seconds each; a boot loader that is there answers at the first or second.
const SYNC_TRIES: usize = 3;
/// avrdude speaks every few seconds, whatever it does.
pub const SILENCE: Duration = Duration::from_secs(60);
/// What avrdude says on each vain try.
const NOT_IN_SYNC: &str = "not in sync";

/// Boards by their boot loader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// Arduino Uno.
    Uno,
    /// Arduino Nano of 2018 or later, and its newer copies.
    Nano,
    /// Arduino Nano with the old boot loader, and most cheap copies.
    NanoOld,
}

impl BoardKind {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            BoardKind::Uno => "uno",
            BoardKind::Nano => "nano",
            BoardKind::NanoOld => "nano-old",
        }
    }

    fn baud(self) -> &'static str {
        match self {
            BoardKind::Uno | BoardKind::Nano => "115200",
            BoardKind::NanoOld => "57600",
        }
    }

    /// What may be behind a port, likeliest first.
    pub fn guess(port: &Port) -> &'static [BoardKind] {
        match port.usb.as_ref().and_then(|usb| usb.likely()) {
            Some("Arduino Uno") | None => &[BoardKind::Uno],
            Some(_) => &[BoardKind::Nano, BoardKind::NanoOld],
        }
    }
}

/// Why the board could not be programmed, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    /// avrdude is not installed.
    #[error("{program} could not be started ({reason}): install it (`sudo apt install avrdude`)")]
    NoAvrdude {
        /// What was to run.
        program: String,
        /// What the system said.
        reason: String,
    },
    /// The file is not there or is no Intel HEX.
    #[error("{} is no program for the board: {reason}; expected an Intel HEX file", path.display())]
    Hex {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The port is not there.
    #[error("port {0} is not there: plug the board in; `unlit flash ports` lists what is")]
    NoPort(String),
    /// There is no port at all.
    #[error(
        "no serial port was found: plug the board in, with a USB cable that carries data and not only power"
    )]
    NoBoard,
    /// Nothing tells which port it is.
    #[error(
        "of {0} serial ports none is known to be the board's: name it, as in `unlit flash upload /dev/ttyUSB0` \
         (`unlit flash ports` lists them)"
    )]
    WhichPort(usize),
    /// No right to use it.
    #[error("you may not use port {0}: `sudo usermod -aG dialout $USER`, then log out and in again")]
    Permission(String),
    /// Somebody else has it open.
    #[error("port {port} is in use{by}: end that first (`unlit serve` keeps its controller open)")]
    Busy {
        /// The port.
        port: String,
        /// By whom, led by a space; empty if that is not known.
        by: String,
    },
    /// The boot loader does not answer.
    #[error(
        "no boot loader answers on {port} as on a board of kind {tried}: is it the right port? Try another --board \
         (uno, nano, nano-old), or hold the board's reset button and let go as soon as the upload starts"
    )]
    NoSync {
        /// The port.
        port: String,
        /// The kinds tried.
        tried: String,
    },
    /// Another processor answers.
    #[error("the board on {port} is no ATmega328P ({signature}); the firmware is for an Arduino Uno or Nano")]
    WrongChip {
        /// The port.
        port: String,
        /// avrdude's words.
        signature: String,
    },
    /// What was read back differs from what was written.
    #[error(
        "the board on {0} reads back differently from what was written: try again, with another USB cable"
    )]
    Verify(String),
    /// avrdude hangs.
    #[error(
        "avrdude said nothing for {0:.0?} and was stopped: unplug the board, plug it in again and retry, with another \
         USB cable or socket if it happens again"
    )]
    Hangs(Duration),
    /// avrdude failed otherwise.
    #[error("avrdude failed ({0}): see its words above")]
    Failed(String),
    /// It was programmed, but does not introduce itself.
    #[error("the board was programmed, but: {0}")]
    Greeting(#[from] FlashError),
}

/// The only port that may be a board's, by its USB number; of several, the first where a controller answers. An empty
/// board does not.
pub fn choose_port() -> Result<PathBuf, UploadError> {
    choose_among(ports::survey(&Roots::default(), &Identity::own()))
}

fn choose_among(ports: Vec<Port>) -> Result<PathBuf, UploadError> {
    let count = ports.len();
    let mut likely: Vec<PathBuf> = ports.into_iter().filter(Port::is_likely).map(|port| port.path).collect();
    match likely.len() {
        _ if count == 0 => Err(UploadError::NoBoard),
        1 => Ok(likely.remove(0)),
        _ => likely.into_iter().find(|port| greet(port).is_ok()).ok_or(UploadError::WhichPort(count)),
    }
}

/// One upload.
#[derive(Clone, Debug)]
pub struct Upload {
    /// The port.
    pub port: PathBuf,
    /// Kinds of board to try, one after the other.
    pub kinds: Vec<BoardKind>,
    /// Intel HEX file; [`FIRMWARE`] without one.
    pub hex: Option<PathBuf>,
    /// avrdude's path or name.
    pub avrdude: OsString,
    /// For how long avrdude may say nothing; [`SILENCE`] is ample.
    pub silence: Duration,
}

impl Upload {
    /// Nobody else may have the port open: an upload would meet his bytes, and he the boot loader's.
    pub fn check_free(&self, port: &Port) -> Result<(), UploadError> {
        let names: Vec<String> =
            port.held_by.iter().map(|Holder { name, id }| format!("{name} (process {id})")).collect();
        if names.is_empty() {
            return Ok(());
        }
        Err(UploadError::Busy {
            port: self.port.display().to_string(),
            by: format!(" by {}", names.join(", ")),
        })
    }

    /// Programs the board and greets it; `say` gets avrdude's output as it comes.
    pub fn run(&self, mut say: impl FnMut(&str)) -> Result<Greeting, UploadError> {
        let packed;
        let hex = match &self.hex {
            Some(path) => path,
            None => {
                packed = unpack().map_err(|error| UploadError::Failed(error.to_string()))?;
                packed.path()
            }
        };
        check_hex(hex)?;
        let mut outcome = Err(self.no_sync());
        for kind in &self.kinds {
            outcome = self.program(*kind, hex, &mut say);
            if !matches!(outcome, Err(UploadError::NoSync { .. })) {
                break;
            }
        }
        outcome?;
        Ok(greet(&self.port)?)
    }

    /// The command line for a board of this kind.
    pub fn command(&self, kind: BoardKind, hex: &Path) -> Vec<OsString> {
        let mut memory = OsString::from("flash:w:");
        memory.push(hex);
        memory.push(":i");
        let mut words: Vec<OsString> = vec![self.avrdude.clone()];
        words.extend(["-p", "m328p", "-c", "arduino", "-b", kind.baud(), "-D", "-P"].map(OsString::from));
        // avrdude looks through links itself; names with a colon in them, as under by-path, it would misread.
        words.push(self.port.canonicalize().unwrap_or_else(|_| self.port.clone()).into());
        words.extend([OsString::from("-U"), memory]);
        words
    }

    fn program(&self, kind: BoardKind, hex: &Path, say: &mut impl FnMut(&str)) -> Result<(), UploadError> {
        let words = self.command(kind, hex);
        let failed = |error: std::io::Error| UploadError::Failed(error.to_string());
        let mut child = Command::new(&words[0])
            .args(&words[1..])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| UploadError::NoAvrdude {
                program: self.avrdude.display().to_string(),
                reason: error.to_string(),
            })?;
        let listened = listen(&mut child, self.silence, say);
        if !matches!(&listened, Ok(said) if vain_tries(said) < SYNC_TRIES) {
            // It would go on for a minute, hangs, or nobody hears it any more. One that has just ended cannot be killed.
            let _ = child.kill();
        }
        let status = child.wait().map_err(failed)?;
        let said = listened?;
        if status.success() {
            return Ok(());
        }
        Err(self.explain(&said, &status.to_string()))
    }

    /// What avrdude's words mean.
    fn explain(&self, said: &str, status: &str) -> UploadError {
        let port = self.port.display().to_string();
        let line =
            |part: &str| said.lines().find(|line| line.contains(part)).map(|line| line.trim().to_owned());
        if line("cannot open port").or_else(|| line("can't open device")).is_some() {
            return if said.contains("Permission denied") {
                UploadError::Permission(port)
            } else if said.contains("busy") {
                UploadError::Busy { port, by: String::new() }
            } else {
                UploadError::NoPort(port)
            };
        }
        if let Some(signature) = line("Expected signature").or_else(|| line("expected signature")) {
            return UploadError::WrongChip { port, signature };
        }
        if line("verification").is_some_and(|line| line.contains("error") || line.contains("mismatch")) {
            return UploadError::Verify(port);
        }
        if said.contains(NOT_IN_SYNC) || said.contains("not responding") {
            return self.no_sync();
        }
        UploadError::Failed(status.to_owned())
    }

    fn no_sync(&self) -> UploadError {
        let names: Vec<&str> = self.kinds.iter().map(|kind| kind.name()).collect();
        UploadError::NoSync { port: self.port.display().to_string(), tried: names.join(" or ") }
    }
}

/// [`FIRMWARE`] as a file, for as long as it is held.
fn unpack() -> std::io::Result<NamedTempFile> {
    let mut file = tempfile::Builder::new().prefix("unlit-firmware-").suffix(".hex").tempfile()?;
    file.write_all(FIRMWARE)?;
    file.flush()?;
    Ok(file)
}

/// Passes avrdude's words on until it ends, or has tried in vain often enough; returns all of them.
fn listen(child: &mut Child, silence: Duration, say: &mut impl FnMut(&str)) -> Result<String, UploadError> {
    let mut said = String::new();
    let Some(mut words) = child.stderr.take() else { return Ok(said) };
    let (tell, told) = channel();
    // A read has no deadline, but a channel has. The thread ends with avrdude, or when nobody listens.
    let read = move || {
        let mut bytes = [0u8; 256];
        loop {
            let heard = words.read(&mut bytes).map(|count| bytes[..count].to_vec());
            let last = heard.as_ref().map_or(true, Vec::is_empty);
            if tell.send(heard).is_err() || last {
                break;
            }
        }
    };
    let failed = |error: std::io::Error| UploadError::Failed(error.to_string());
    std::thread::Builder::new().name("avrdude".into()).spawn(read).map_err(failed)?;
    loop {
        let bytes = match told.recv_timeout(silence) {
            Ok(heard) => heard.map_err(failed)?,
            Err(_) => return Err(UploadError::Hangs(silence)),
        };
        // avrdude speaks ASCII; a path that is cut in the middle of a letter is shown so.
        let text = String::from_utf8_lossy(&bytes);
        say(&text);
        said += &text;
        if bytes.is_empty() || vain_tries(&said) >= SYNC_TRIES {
            return Ok(said);
        }
    }
}

fn vain_tries(said: &str) -> usize {
    said.matches(NOT_IN_SYNC).count()
}

/// An Intel HEX file begins every line with a colon and ends with the record of that kind.
fn check_hex(path: &Path) -> Result<(), UploadError> {
    let wrong = |reason: String| UploadError::Hex { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    if let Some(line) = lines.clone().find(|line| !line.starts_with(':')) {
        let start: String = line.chars().take(20).collect();
        return Err(wrong(format!("a line starts with {start:?} instead of a colon")));
    }
    match lines.next_back() {
        Some(last) if last.trim().eq_ignore_ascii_case(":00000001FF") => Ok(()),
        Some(_) => Err(wrong("it does not end with the end record".into())),
        None => Err(wrong("it is empty".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::ports::UsbDevice;
    use super::*;

    fn port(name: &str, usb: Option<(&str, &str)>) -> Port {
        Port {
            path: name.into(),
            node: name.into(),
            usb: usb.map(|(vendor, product)| UsbDevice {
                vendor: vendor.into(),
                product: product.into(),
                maker: None,
                name: None,
                serial: None,
                address: None,
            }),
            usable: true,
            held_by: Vec::new(),
        }
    }

    #[test]
    fn the_board_is_chosen_only_where_nothing_else_may_be_meant() {
        let (modem, uno) =
            (port("/dev/ttyUSB0", Some(("12d1", "1506"))), port("/dev/ttyACM0", Some(("2341", "0043"))));
        let words = |ports| choose_among(ports).unwrap_err().to_string();
        assert!(words(vec![]).contains("plug the board in"));
        assert!(words(vec![modem.clone()]).contains("of 1 serial ports none"), "a modem is not programmed");
        assert_eq!(choose_among(vec![modem, uno]).unwrap(), PathBuf::from("/dev/ttyACM0"));
    }

    #[test]
    fn an_avrdude_that_hangs_in_silence_is_an_error() {
        let mut child = Command::new("sh")
            .args(["-c", "echo starting >&2; exec sleep 60"])
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begun = std::time::Instant::now();
        let mut words = String::new();
        let outcome = listen(&mut child, Duration::from_millis(500), &mut |part| words += part);
        child.kill().unwrap();
        child.wait().unwrap();
        let error = outcome.unwrap_err();
        assert!(
            matches!(error, UploadError::Hangs(_)) && error.to_string().contains("plug it in again"),
            "{error}"
        );
        assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
        assert_eq!(words, "starting\n");
    }
}
