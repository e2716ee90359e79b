//! A wire to write on by hand: a pseudo terminal whose other end a test answers, for boards that misbehave.

use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// A strange board: what it says to each line that it hears.
pub(crate) struct Wire {
    device: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Wire {
    /// `answer` gets each line without its end, and `""` every few milliseconds of silence.
    pub(crate) fn start(mut answer: impl FnMut(&str) -> Vec<u8> + Send + 'static) -> Self {
        let (pair_master, slave) = TTYPort::pair().unwrap();
        let mut master = pair_master.try_clone_native().unwrap();
        drop(pair_master);
        master.set_timeout(Duration::from_millis(2)).unwrap();
        let device = slave.name().unwrap().into();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::spawn(move || {
            let (mut heard, mut bytes) = (Vec::new(), [0u8; 256]);
            while !stopped.load(Ordering::Relaxed) {
                match master.read(&mut bytes) {
                    Ok(count) => heard.extend_from_slice(&bytes[..count]),
                    Err(error) if error.kind() == std::io::ErrorKind::TimedOut => {
                        // A reader that does not keep up loses, as on a real wire.
                        let _ = master.write_all(&answer(""));
                    }
                    Err(_) => std::thread::sleep(Duration::from_millis(1)),
                }
                while let Some(end) = heard.iter().position(|byte| *byte == b'\n') {
                    let line: Vec<u8> = heard.drain(..=end).collect();
                    let line = String::from_utf8_lossy(&line).trim_end().to_owned();
                    if !line.is_empty() {
                        let _ = master.write_all(&answer(&line));
                    }
                }
            }
        });
        Self { device, stop, thread: Some(thread) }
    }

    pub(crate) fn device(&self) -> &Path {
        &self.device
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        drop(self.thread.take().map(JoinHandle::join));
    }
}

/// A line with its checksum and end, by an implementation of the test's own.
pub(crate) fn sealed(text: &str) -> Vec<u8> {
    let mut crc = 0xFFFF_u16;
    for byte in text.bytes() {
        crc ^= u16::from(byte) << 8;
        for _ in 0..8 {
            let carry = crc & 0x8000 != 0;
            crc <<= 1;
            if carry {
                crc ^= 0x1021;
            }
        }
    }
    format!("{text}*{crc:04X}\n").into_bytes()
}

/// Number and body of a request line.
pub(crate) fn request(line: &str) -> Option<(u32, &str)> {
    let (text, _) = line.strip_prefix('#')?.rsplit_once('*')?;
    let (seq, body) = text.split_once(' ')?;
    Some((seq.parse().ok()?, body))
}

/// A board by its book of numbers: answers every request of the protocol, with whatever state the test gives it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Book {
    pub(crate) boot: u32,
    pub(crate) events: u32,
    pub(crate) shots: u32,
    pub(crate) greeted: bool,
    pub(crate) clock_us: u32,
}

impl Book {
    pub(crate) fn answer(&mut self, line: &str) -> Vec<u8> {
        let Some((seq, body)) = request(line) else { return Vec::new() };
        let Book { boot, events, shots, clock_us, .. } = *self;
        let verb = body.split(' ').next().unwrap();
        let fields = match verb {
            "hello" => {
                self.greeted = true;
                format!(" v=1 fw=9.9 mcu=book boot={boot} rst=1 caps=sync ev={events} n={shots} t={clock_us}")
            }
            "cfg" => " sil=1500 pulse=1000 lock=30 win=20000 rec=150 rdy=0".into(),
            "ping" => format!(" t={clock_us} g=0 ev={events} n={shots}"),
            "stat" => format!(
                " t={clock_us} g=0 fire=0 hello={} ready=1 wait=0 closed=0 n={shots}",
                u32::from(self.greeted)
            ),
            "get" => {
                let n = body.split_once("n=").unwrap().1;
                format!(" n={n} src=sync g=0 tag=0 t={clock_us} e=0 pk=0 b=0 w=0 c=0 m=1538 bn=0")
            }
            _ if !self.greeted => return sealed(&format!("#{seq} err 7 hello")),
            _ => String::new(),
        };
        sealed(&format!("#{seq} ok{fields}"))
    }
}
