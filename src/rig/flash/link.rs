//! One conversation with the board: the open port, the handshake, one request in flight, retries.

use super::line::{self, Event, Fields, Line};
use crate::rig::FlashError;
use serialport::{ClearBuffer, SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long the board has to answer, and how often it is asked. The time counts only as far as it was spent listening: a
/// computer that was too busy to listen, or was suspended, must not call the board silent.
const ANSWER: Duration = Duration::from_millis(300);
const TRIES: u32 = 3;
/// Opening the port resets an Uno; its boot loader then takes up to this long.
const BOOT: Duration = Duration::from_millis(2500);
/// How long a read waits; bounds how late the owner sees its next command.
const READ: Duration = Duration::from_millis(5);
/// More than this without a line end is no conversation of ours.
const GARBAGE: usize = 4096;

/// An open, greeted board.
pub(super) struct Link {
    port: TTYPort,
    path: String,
    seq: u8,
    buffer: Vec<u8>,
    /// Bytes came that are no lines of the protocol.
    garbage: bool,
    /// It broke, fell silent or is not understood: it must be opened anew.
    pub(super) failed: bool,
    /// Events that came in since the greeting, oldest first; the owner takes them.
    pub(super) events: VecDeque<Event>,
}

/// An answer, and between which moments the board gave it.
#[derive(Clone, Debug)]
pub(super) struct Answer {
    /// What it says.
    pub(super) fields: Fields,
    /// When the request was sent first.
    pub(super) sent: Instant,
    /// When the answer was whole.
    pub(super) heard: Instant,
}

/// How the board introduces itself.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hello {
    /// Firmware version.
    pub(super) firmware: String,
    /// Processor.
    pub(super) mcu: String,
    /// Number of this boot; another one means that all state is lost.
    pub(super) boot: u32,
    /// Number of its last event.
    pub(super) events: u16,
    /// Number of its last shot.
    pub(super) shots: u32,
    /// Cause of its last reset, as it numbers them.
    pub(super) reset: u32,
    /// Its clock, us modulo 2^32.
    pub(super) clock_us: u32,
    /// When the greeting was sent and answered.
    pub(super) told: (Instant, Instant),
}

impl Link {
    /// Opens the port and greets the board; its gate is closed afterwards. `seq`: number of the last request of the
    /// conversation before, so that no late answer to that one is taken for ours. Gives up early once `stop` is set.
    pub(super) fn open(path: &Path, seq: u8, stop: &AtomicBool) -> Result<(Self, Hello), FlashError> {
        let name = path.display().to_string();
        let builder = serialport::new(name.clone(), 115_200).timeout(READ).dtr_on_open(true);
        let port = TTYPort::open(&builder).map_err(|error| refused(&name, &error))?;
        port.clear(ClearBuffer::Input).map_err(|error| refused(&name, &error))?;
        let mut link = Self {
            port,
            path: name,
            seq,
            buffer: Vec::new(),
            garbage: false,
            failed: false,
            events: VecDeque::new(),
        };
        let opened = Instant::now();

        // A board that opening did not reset answers at once. One in its boot loader must be left in peace
        // after the first try, until it says `boot` or its time is over.
        match link.greet(1) {
            Err(FlashError::Silent { .. }) => {}
            answered => return answered.map(|hello| (link, hello)),
        }
        while opened.elapsed() < BOOT && !link.events.iter().any(|event| event.name == "boot") {
            if stop.load(Ordering::Relaxed) {
                return Err(link.lost("the driver is being closed"));
            }
            link.listen()?;
        }
        match link.greet(TRIES) {
            Err(FlashError::Silent { .. }) if link.garbage => {
                Err(link.foreign("what it sends are no lines of the controller's protocol"))
            }
            answered => answered.map(|hello| (link, hello)),
        }
    }

    /// What came before the answer belongs to the time before the greeting, which the numbers in it sum up.
    fn greet(&mut self, tries: u32) -> Result<Hello, FlashError> {
        self.write(b"\n")?; // ends whatever half a line the board has
        let answer = match self.ask("hello v=1 strict=1", tries) {
            Err(FlashError::Refused { code, word, .. }) => {
                return Err(self.foreign(&format!("it refuses the greeting (error {code}, {word})")));
            }
            answered => answered?,
        };
        self.events.clear();
        let Answer { fields, sent, heard } = answer;
        if let Some(version) = fields.uint("v").filter(|version| *version != 1) {
            return Err(self.foreign(&format!("it speaks protocol {version}, and this program protocol 1")));
        }
        let number = |key| fields.uint(key);
        let hello = || {
            number("v")?;
            Some(Hello {
                firmware: fields.word("fw")?.to_owned(),
                mcu: fields.word("mcu")?.to_owned(),
                boot: number("boot")?,
                events: number("ev")? as u16,
                shots: number("n")?,
                reset: number("rst")?,
                clock_us: number("t")?,
                told: (sent, heard),
            })
        };
        let hello = hello().ok_or_else(|| self.foreign("its greeting lacks numbers"))?;
        self.failed = false;
        Ok(hello)
    }

    /// Greets again, after the board was found to have restarted.
    pub(super) fn hello(&mut self) -> Result<Hello, FlashError> {
        self.greet(TRIES)
    }

    /// Number of the last request.
    pub(super) fn seq(&self) -> u8 {
        self.seq
    }

    /// Sends one request and waits for its answer. Events that come between are kept.
    pub(super) fn request(&mut self, body: &str) -> Result<Answer, FlashError> {
        self.ask(body, TRIES)
    }

    fn ask(&mut self, body: &str, tries: u32) -> Result<Answer, FlashError> {
        self.seq = self.seq % 255 + 1;
        let request = line::request(self.seq, body);
        let sent = Instant::now();
        for _ in 0..tries {
            self.write(request.as_bytes())?;
            let mut listened = Duration::ZERO;
            while listened < ANSWER {
                let began = Instant::now();
                let line = self.listen()?;
                listened += began.elapsed().min(2 * READ);
                match line {
                    Some(Line::Ok { seq, fields }) if seq == self.seq => {
                        return Ok(Answer { fields, sent, heard: Instant::now() });
                    }
                    Some(Line::Err { seq, code, word }) if seq == self.seq => {
                        return Err(FlashError::Refused { request: body.to_owned(), code, word });
                    }
                    // Answers to lines that the board could not read, or late ones to requests given up.
                    _ => {}
                }
            }
        }
        self.failed = true;
        Err(FlashError::Silent { port: self.path.clone(), request: body.to_owned() })
    }

    /// Waits a moment for the next line. Events go to [`Link::events`]; answers are returned; damaged lines are
    /// dropped, because numbers and retries mend their loss.
    pub(super) fn listen(&mut self) -> Result<Option<Line>, FlashError> {
        if let Some(end) = self.buffer.iter().position(|byte| *byte == b'\n') {
            let text: Vec<u8> = self.buffer.drain(..=end).collect();
            let text = text.trim_ascii_end();
            let parsed = line::parse(text);
            self.garbage |= parsed.is_none() && !text.is_empty();
            return Ok(match parsed {
                Some(Line::Event(event)) => {
                    self.events.push_back(event);
                    None
                }
                answer => answer,
            });
        }
        if self.buffer.len() > GARBAGE {
            self.garbage = true;
            self.buffer.clear();
        }
        let mut bytes = [0u8; 512];
        match self.port.read(&mut bytes) {
            Ok(0) => Err(self.lost("the port was closed")),
            Ok(count) => {
                self.buffer.extend_from_slice(&bytes[..count]);
                Ok(None)
            }
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(None),
            Err(error) => Err(self.lost(&error.to_string())),
        }
    }

    /// Takes in the lines that have come already, without waiting for more.
    pub(super) fn catch_up(&mut self) -> Result<(), FlashError> {
        while self.buffer.contains(&b'\n') {
            self.listen()?;
        }
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), FlashError> {
        self.port.write_all(bytes).map_err(|error| self.lost(&error.to_string()))
    }

    fn lost(&mut self, reason: &str) -> FlashError {
        self.failed = true;
        FlashError::Lost { port: self.path.clone(), reason: reason.to_owned() }
    }

    fn foreign(&mut self, reason: &str) -> FlashError {
        self.failed = true;
        FlashError::Firmware { port: self.path.clone(), reason: reason.to_owned() }
    }
}

/// Why the port does not open, and what to do.
fn refused(port: &str, error: &serialport::Error) -> FlashError {
    use serialport::ErrorKind as Kind;
    let advice = match error.kind() {
        Kind::NoDevice if Path::new(port).exists() => {
            "another program has it open; `unlit flash ports` names it where it can"
        }
        Kind::NoDevice | Kind::Io(ErrorKind::NotFound) => {
            "plug it in; if it is plugged in, `unlit flash ports` tells its name"
        }
        Kind::Io(ErrorKind::PermissionDenied) => {
            "you may not use it: `sudo usermod -aG dialout $USER`, then log out and in again"
        }
        _ => "unplug it, plug it in again and retry; `unlit flash ports` tells more",
    };
    FlashError::Open { port: port.to_owned(), reason: error.to_string(), advice: advice.into() }
}

impl Drop for Link {
    fn drop(&mut self) {
        // A pseudo terminal stays exclusive beyond its last close, and would refuse the next driver. On a port
        // that is gone this fails, and does not matter.
        let _ = self.port.set_exclusive(false);
    }
}
