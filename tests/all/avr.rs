//! The firmware for the ATmega328P, built with its own Makefile and run in `firmware/sim`; helpers for the tests.
//!
//! [`Sim`] is the simulator process with its commands; [`Desk`] speaks the protocol to the board in it, in simulated
//! time, with checksums and numbers of its own, apart from both the firmware's and the driver's.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Cycles of the processor in a microsecond.
pub(crate) const MHZ: f64 = 16.0;
/// Until a simulator that says nothing is given up.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) fn firmware() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("firmware")
}

/// What the builds made.
pub(crate) struct Built {
    pub(crate) elf: PathBuf,
    pub(crate) hex: PathBuf,
    sim: PathBuf,
}

/// Builds firmware and simulator, once a run.
pub(crate) fn built() -> &'static Built {
    static BUILT: OnceLock<Built> = OnceLock::new();
    BUILT.get_or_init(|| {
        let base = Path::new(env!("CARGO_TARGET_TMPDIR")).join("firmware");
        for part in ["avr", "sim"] {
            let build = base.join(part);
            let made = Command::new("make")
                .arg("-s")
                .arg("-C")
                .arg(firmware().join(part))
                .arg(format!("BUILD={}", build.display()))
                .output();
            let made = made.unwrap_or_else(|e| panic!("make does not start ({e}): run script/setup test"));
            let said = String::from_utf8_lossy(&made.stderr);
            assert!(made.status.success(), "make -C firmware/{part} failed; script/setup test?\n{said}");
        }
        Built {
            elf: base.join("avr/unlit.elf"),
            hex: base.join("avr/unlit.hex"),
            sim: base.join("sim/unlit-sim"),
        }
    })
}

/// What the simulator reported, with the cycle it happened at.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Report {
    Trigger { cycle: u64, high: bool },
    Contact { cycle: u64, closed: bool },
    Armed { cycle: u64, lit: bool },
    Light { energy: f64 },
    Reset { cycle: u64 },
    Said(String),
}

fn report(line: &str) -> Report {
    if let Some(text) = line.strip_prefix("< ") {
        return Report::Said(text.to_owned());
    }
    let words: Vec<&str> = line.split(' ').collect();
    let cycle = words[2].parse().unwrap();
    match (words[0], words[1]) {
        ("!", "trigger") => Report::Trigger { cycle, high: words[3] == "1" },
        ("!", "contact") => Report::Contact { cycle, closed: words[3] == "1" },
        ("!", "armed") => Report::Armed { cycle, lit: words[3] == "1" },
        ("!", "light") => Report::Light { energy: words[3].parse().unwrap() },
        ("!", "reset") => Report::Reset { cycle },
        _ => panic!("the simulator said: {line}"),
    }
}

/// A simulated board.
pub(crate) struct Sim {
    child: Child,
    commands: ChildStdin,
    lines: Receiver<String>,
    /// Device of the board's UART.
    pub(crate) device: PathBuf,
    /// What was reported and not yet taken.
    pub(crate) reports: Vec<Report>,
}

impl Sim {
    /// Powers a board up that runs our firmware. Time stands still.
    pub(crate) fn start() -> Self {
        Self::with(&[&built().hex])
    }

    /// With these programs in its memory: the firmware, and a boot loader.
    pub(crate) fn with(programs: &[&Path]) -> Self {
        let mut child = Command::new(&built().sim)
            .args(programs)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let commands = child.stdin.take().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        // Ends with the process, whose end closes the pipe.
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        let device = lines.recv_timeout(PATIENCE).expect("the simulator names its terminal").into();
        Self { child, commands, lines, device, reports: Vec::new() }
    }

    /// Gives a command and returns what is answered after "ok".
    pub(crate) fn command(&mut self, command: &str) -> String {
        writeln!(self.commands, "{command}").unwrap();
        loop {
            let line = self.lines.recv_timeout(PATIENCE);
            let line = line.unwrap_or_else(|e| panic!("no answer to {command}: {e}"));
            if let Some(answer) = line.strip_prefix("ok") {
                return answer.trim_start().to_owned();
            }
            assert!(!line.starts_with("err"), "{command}: {line}");
            self.reports.push(report(&line));
        }
    }

    /// Lets simulated time pass.
    pub(crate) fn run_us(&mut self, us: f64) {
        self.command(&format!("run {us}"));
    }

    pub(crate) fn take(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        // Our own child; it may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn crc16(text: &str) -> u16 {
    let mut crc = 0xFFFFu16;
    for byte in text.bytes() {
        crc ^= u16::from(byte) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 };
        }
    }
    crc
}

pub(crate) fn sealed(text: &str) -> String {
    format!("{text}*{:04X}", crc16(text))
}

/// The `key=value` words of a line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fields(HashMap<String, String>);

impl Fields {
    pub(crate) fn of<'a>(words: impl Iterator<Item = &'a str>) -> Self {
        Self(
            words.map(|w| w.split_once('=').expect("key=value")).map(|(k, v)| (k.into(), v.into())).collect(),
        )
    }

    pub(crate) fn word(&self, key: &str) -> &str {
        self.0.get(key).unwrap_or_else(|| panic!("no {key} in {self:?}"))
    }

    pub(crate) fn int(&self, key: &str) -> i64 {
        self.word(key).parse().unwrap_or_else(|_| panic!("{key} is no number in {self:?}"))
    }
}

/// A shot's event with the edges of its frame.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// What the board reported of it.
    pub(crate) shot: Fields,
    /// From the contact's first closing to the trigger's rise, cycles, for each rise.
    pub(crate) latencies: Vec<u64>,
    /// The flash's energy; 0 if it did not fire.
    pub(crate) energy: f64,
}

/// A host in simulated time: one request in flight, events kept, every line's checksum proved.
pub(crate) struct Desk {
    pub(crate) sim: Sim,
    seq: u8,
    /// Events with their number and name, not yet taken.
    pub(crate) events: Vec<(u16, String, Fields)>,
    /// Everything else that was reported, not yet taken.
    pub(crate) reports: Vec<Report>,
    answers: Vec<String>,
}

impl Desk {
    /// A board that has booted; nobody has greeted it.
    pub(crate) fn booted() -> Self {
        Self::on(Sim::start())
    }

    /// The same, on a board that has just been powered up.
    pub(crate) fn on(mut sim: Sim) -> Self {
        sim.command("uart stdio");
        let mut desk = Self { sim, seq: 0, events: Vec::new(), reports: Vec::new(), answers: Vec::new() };
        desk.wait_ms(300.0);
        desk
    }

    /// Greeted, and with a flash that recycles in 20 ms.
    pub(crate) fn greeted() -> Self {
        let mut desk = Self::booted();
        desk.greet();
        desk
    }

    /// Says hello, and makes board and flash recycle in 20 ms.
    pub(crate) fn greet(&mut self) {
        self.ok("hello v=1 strict=1");
        self.ok("cfg rec=20");
        self.sim.command("light recycle=20000");
        self.events.clear();
    }

    fn sort(&mut self) {
        for report in self.sim.take() {
            let Report::Said(line) = report else {
                self.reports.push(report);
                continue;
            };
            let (text, crc) = line.rsplit_once('*').unwrap_or_else(|| panic!("no checksum: {line:?}"));
            assert_eq!(format!("{:04X}", crc16(text)), crc, "{line:?}");
            if let Some(event) = text.strip_prefix('!') {
                let mut words = event.split(' ');
                let number = words.next().unwrap().parse().unwrap();
                let name = words.next().unwrap().to_owned();
                self.events.push((number, name, Fields::of(words)));
            } else {
                self.answers.push(text.to_owned());
            }
        }
    }

    pub(crate) fn wait_ms(&mut self, ms: f64) {
        self.sim.run_us(ms * 1000.0);
        self.sort();
    }

    /// Bytes as they are, and the answers within 50 ms.
    pub(crate) fn raw(&mut self, text: &str) -> Vec<String> {
        self.sim.command(&format!("say {text}"));
        self.wait_ms(50.0);
        self.take_answers()
    }

    /// The answers that nobody waited for.
    pub(crate) fn take_answers(&mut self) -> Vec<String> {
        std::mem::take(&mut self.answers)
    }

    /// The next numbered request, not sent.
    pub(crate) fn numbered(&mut self, body: &str) -> String {
        self.seq = self.seq % 255 + 1;
        sealed(&format!("#{} {body}", self.seq))
    }

    /// Sends a request and returns what is answered after its number.
    pub(crate) fn ask(&mut self, body: &str) -> String {
        self.answers.clear();
        let request = self.numbered(body);
        self.sim.command(&format!("say {request}"));
        let head = format!("#{} ", self.seq);
        self.sim.command(&format!("run 300000 {head}"));
        self.sort();
        let answers = std::mem::take(&mut self.answers);
        assert_eq!(answers.len(), 1, "{body}: {answers:?}");
        answers[0].strip_prefix(&head).unwrap_or_else(|| panic!("{body}: {answers:?}")).to_owned()
    }

    pub(crate) fn ok(&mut self, body: &str) -> Fields {
        let answer = self.ask(body);
        let words = answer.strip_prefix("ok").unwrap_or_else(|| panic!("{body}: {answer}"));
        Fields::of(words.split_whitespace())
    }

    /// The code that a request is refused with.
    pub(crate) fn refused(&mut self, body: &str) -> u32 {
        let answer = self.ask(body);
        let rest = answer.strip_prefix("err ").unwrap_or_else(|| panic!("{body}: {answer}"));
        rest.split(' ').next().unwrap().parse().unwrap()
    }

    pub(crate) fn take_events(&mut self, name: &str) -> Vec<Fields> {
        let (wanted, rest) = std::mem::take(&mut self.events).into_iter().partition(|(_, n, _)| n == name);
        self.events = rest;
        let wanted: Vec<_> = wanted;
        wanted.into_iter().map(|(_, _, fields)| fields).collect()
    }

    pub(crate) fn take_reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    /// How often the trigger rose since the reports were taken last.
    pub(crate) fn rises(&mut self) -> usize {
        rises(&self.take_reports()).len()
    }

    /// The contact closes as told, and 60 ms pass.
    pub(crate) fn contact(&mut self, edges: &str) -> Vec<Report> {
        self.take_reports();
        self.sim.command(&format!("contact {edges}"));
        self.wait_ms(60.0);
        self.take_reports()
    }

    /// A camera's frame: the contact closes after so long for 10 ms. Its one shot.
    pub(crate) fn frame(&mut self, after_us: f64) -> Frame {
        self.take_events("shot");
        let reports = self.contact(&format!("{after_us}=1 {}=0", after_us + 10_000.0));
        let mut shots = self.take_events("shot");
        assert_eq!(shots.len(), 1, "{shots:?} {reports:?}");
        let closed = reports.iter().find_map(|r| match r {
            Report::Contact { cycle, closed: true } => Some(*cycle),
            _ => None,
        });
        let closed = closed.expect("the contact closed");
        let energy =
            reports.iter().map(|r| if let Report::Light { energy } = r { *energy } else { 0.0 }).sum();
        let latencies = rises(&reports).iter().map(|rise| rise - closed).collect();
        Frame { shot: shots.remove(0), latencies, energy }
    }

    pub(crate) fn lit_frame(&mut self, tag: u32, after_us: f64) -> Frame {
        self.ok(&format!("arm tag={tag} ttl=5000"));
        self.frame(after_us)
    }
}

/// Cycles at which the trigger rose.
pub(crate) fn rises(reports: &[Report]) -> Vec<u64> {
    let rise = |r: &Report| match r {
        Report::Trigger { cycle, high: true } => Some(*cycle),
        _ => None,
    };
    reports.iter().filter_map(rise).collect()
}

/// Mean and standard deviation of a sample.
pub(crate) fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}
