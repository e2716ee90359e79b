//! One conversation with the board: the open port, the handshake, one request in flight, retries.

use super::line::{self, Event, Fields, Line};
use crate::rig::FlashError;
use serialport::{ClearBuffer, SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// How long the board has to answer, and how often it is asked.
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
    /// Events that came in, oldest first; the owner takes them.
    pub(super) events: VecDeque<Event>,
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
    /// Its clock, us modulo 2^32.
    pub(super) clock_us: u32,
}

impl Link {
    /// Opens the port and greets the board; its gate is closed afterwards.
    pub(super) fn open(path: &Path) -> Result<(Self, Hello), FlashError> {
        let name = path.display().to_string();
        let refused = |reason: String| FlashError::Open { port: name.clone(), reason };
        let builder = serialport::new(name.clone(), 115_200).timeout(READ).dtr_on_open(true);
        let port = TTYPort::open(&builder).map_err(|e| refused(e.to_string()))?;
        port.clear(ClearBuffer::Input).map_err(|e| refused(e.to_string()))?;
        let mut link = Self { port, path: name, seq: 0, buffer: Vec::new(), events: VecDeque::new() };
        let opened = Instant::now();

        // A board that opening did not reset answers at once. One in its boot loader must be left in peace
        // after the first try, until it says `boot` or its time is over.
        match link.greet(1) {
            Err(FlashError::Silent { .. }) => {}
            answered => return answered.map(|hello| (link, hello)),
        }
        while opened.elapsed() < BOOT && !link.events.iter().any(|event| event.name == "boot") {
            link.listen()?;
        }
        let hello = link.greet(TRIES)?;
        Ok((link, hello))
    }

    fn greet(&mut self, tries: u32) -> Result<Hello, FlashError> {
        self.write(b"\n")?; // ends whatever half a line the board has
        let fields = self.ask("hello v=1 strict=1", tries)?;
        let number = |key| fields.uint(key);
        let hello = || {
            Some(Hello {
                firmware: fields.word("fw")?.to_owned(),
                mcu: fields.word("mcu")?.to_owned(),
                boot: number("boot")?,
                events: number("ev")? as u16,
                shots: number("n")?,
                clock_us: number("t")?,
            })
        };
        hello().ok_or_else(|| FlashError::Open {
            port: self.path.clone(),
            reason: "what answers there is not an unlit flash controller of protocol 1".into(),
        })
    }

    /// Greets again, after the board was found to have restarted.
    pub(super) fn hello(&mut self) -> Result<Hello, FlashError> {
        self.greet(TRIES)
    }

    /// Sends one request and waits for its answer. Events that come between are kept.
    pub(super) fn request(&mut self, body: &str) -> Result<Fields, FlashError> {
        self.ask(body, TRIES)
    }

    fn ask(&mut self, body: &str, tries: u32) -> Result<Fields, FlashError> {
        self.seq = self.seq % 255 + 1;
        let request = line::request(self.seq, body);
        for _ in 0..tries {
            self.write(request.as_bytes())?;
            let sent = Instant::now();
            while sent.elapsed() < ANSWER {
                match self.listen()? {
                    Some(Line::Ok { seq, fields }) if seq == self.seq => return Ok(fields),
                    Some(Line::Err { seq, code, word }) if seq == self.seq => {
                        return Err(FlashError::Refused { request: body.to_owned(), code, word });
                    }
                    // Answers to lines that the board could not read, or late ones to requests given up.
                    _ => {}
                }
            }
        }
        Err(FlashError::Silent { port: self.path.clone(), request: body.to_owned() })
    }

    /// Waits a moment for the next line. Events go to [`Link::events`]; answers are returned; damaged lines are
    /// dropped, because numbers and retries mend their loss.
    pub(super) fn listen(&mut self) -> Result<Option<Line>, FlashError> {
        if let Some(end) = self.buffer.iter().position(|byte| *byte == b'\n') {
            let text: Vec<u8> = self.buffer.drain(..=end).collect();
            let parsed = line::parse(text.trim_ascii_end());
            return Ok(match parsed {
                Some(Line::Event(event)) => {
                    self.events.push_back(event);
                    None
                }
                answer => answer,
            });
        }
        if self.buffer.len() > GARBAGE {
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

    fn write(&mut self, bytes: &[u8]) -> Result<(), FlashError> {
        self.port.write_all(bytes).map_err(|error| self.lost(&error.to_string()))
    }

    fn lost(&self, reason: &str) -> FlashError {
        FlashError::Lost { port: self.path.clone(), reason: reason.to_owned() }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // A pseudo terminal stays exclusive beyond its last close, and would refuse the next driver. On a port
        // that is gone this fails, and does not matter.
        let _ = self.port.set_exclusive(false);
    }
}
