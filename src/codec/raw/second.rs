//! The second decoder as the rest of the program sees it: a child process for one file, with a deadline.
//!
//! Takes a file's bytes, gives its plane and what the decoder knows of it. The child (`unlit decode-host`, see
//! [`super::host`]) limits itself; here it is given wall-clock time, killed with all that it started when that is
//! over, and always reaped. Both pipes are served by threads of their own, so that neither can fill up and stop.

use super::RawError;
use super::host;
use super::sensor::Plane;
use super::wire::{self, Answer, Frame, Refusal};
use rustix::process::{Pid, Signal, kill_process_group};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::mpsc;
use std::time::Duration;

/// Wall-clock time for one file, start of the process included.
const DEADLINE: Duration = Duration::from_secs(30);

static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Tells which program decodes what this process does not decode itself: `unlit`, started as
/// `PROGRAM decode-host`. The first call counts; returns whether this was it.
///
/// The `unlit` binary names itself. A program that uses this library names an `unlit` binary, or goes without:
/// files that need the second decoder are then refused with [`RawError::NoSecondDecoder`].
pub fn set_decoder_program(program: impl Into<PathBuf>) -> bool {
    PROGRAM.set(program.into()).is_ok()
}

/// Decodes with the second decoder; `why` says what the first one does not know.
pub(super) fn decode(bytes: &[u8], what: &str, why: &str) -> Result<(Plane, Box<Frame>), RawError> {
    let Some(program) = PROGRAM.get() else {
        return Err(RawError::NoSecondDecoder { what: what.to_owned(), why: why.to_owned() });
    };
    decode_with(program, DEADLINE, bytes, what)
}

/// A child that is killed, with its whole process group, and reaped however this ends.
struct Reaped(Child);

impl Reaped {
    /// Ends it with all that it started, unless it has ended.
    fn kill(&mut self) {
        // The child leads its group. As long as it has not been waited for, its id is nobody else's.
        if let (Ok(None), Some(group)) = (self.0.try_wait(), Pid::from_raw(self.0.id() as i32)) {
            let _ = kill_process_group(group, Signal::KILL);
        }
    }
}

impl Drop for Reaped {
    fn drop(&mut self) {
        self.kill();
        let _ = self.0.wait();
    }
}

fn decode_with(
    program: &Path,
    deadline: Duration,
    bytes: &[u8],
    what: &str,
) -> Result<(Plane, Box<Frame>), RawError> {
    let died = |how: String| RawError::DecoderProcess { what: what.to_owned(), how };
    let child = Command::new(program)
        .arg("decode-host")
        // Fewer arenas and threads reserve less of the address space that the host limits.
        .env("MALLOC_ARENA_MAX", "2")
        .env("RAYON_NUM_THREADS", "2")
        .process_group(0)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| died(format!("{} cannot be started: {e}", program.display())))?;
    let mut child = Reaped(child);
    let (Some(mut question), Some(mut reply)) = (child.0.stdin.take(), child.0.stdout.take()) else {
        return Err(died("its pipes are gone".to_owned()));
    };
    std::thread::scope(|scope| {
        // A host that refuses early closes its end; what it says then matters, not that the rest was not read.
        scope.spawn(move || wire::ask(&mut question, bytes));
        let (send, receive) = mpsc::sync_channel(1);
        scope.spawn(move || {
            let answer = read(&mut reply, bytes.len(), what);
            // Nobody listens any more once the deadline has passed.
            let _ = send.send(answer);
        });
        let answer = match receive.recv_timeout(deadline) {
            Ok(Ok(answer)) => answer,
            Ok(Err(cut)) => Err(died(ending(&mut child, &cut))),
            Err(_) => Err(died(format!("it did not answer within {} s", deadline.as_secs()))),
        };
        // Whatever it still does is not wanted, and the threads end with its ends of the pipes.
        child.kill();
        answer
    })
}

/// The answer as it comes; the outer error is a host that did not answer to the end.
fn read(
    reply: &mut impl io::Read,
    length: usize,
    what: &str,
) -> io::Result<Result<(Plane, Box<Frame>), RawError>> {
    let named = what.to_owned();
    Ok(match wire::read_answer(reply)? {
        Answer::Frame(frame) => {
            let (width, height) = (frame.width, frame.height);
            if let Err(error) = super::check_size(what, width as u64, height as u64, length) {
                return Ok(Err(error));
            }
            let dn = wire::read_plane(reply, width * height)?;
            Ok((Plane { width, height, dn }, frame))
        }
        Answer::Refused(Refusal::Unknown { how }) => Err(RawError::Unsupported { what: named, how }),
        Answer::Refused(Refusal::Demosaiced) => {
            Err(RawError::Demosaiced { what: named, how: "a reduced raw or linear DNG" })
        }
        Answer::Refused(Refusal::Pattern { pattern }) => Err(RawError::Pattern { what: named, pattern }),
        Answer::Refused(Refusal::Failed { message }) => Err(RawError::Decoder { what: named, message }),
    })
}

/// Why a host went silent, from how it ended.
fn ending(child: &mut Reaped, cut: &io::Error) -> String {
    if cut.kind() == io::ErrorKind::InvalidData {
        return cut.to_string();
    }
    // Its pipe is closed: it has ended or is about to; should it linger, it is made to go.
    let status = match patiently(child) {
        Some(status) => status,
        None => return "it closed its pipe and went on running".to_owned(),
    };
    match status.signal() {
        Some(6) => format!("it asked for more than {} MB of memory, or gave up", host::MEMORY >> 20),
        Some(24) => format!("it took more than {} s of processor time", host::CPU_SECONDS),
        Some(9) => "it was killed from outside, perhaps because the machine had no memory left".to_owned(),
        Some(11) => "it ran into memory that is not its own (signal 11)".to_owned(),
        Some(signal) => format!("it was ended by signal {signal}"),
        None => format!("it ended ({status}) in the middle of its answer: {cut}"),
    }
}

fn patiently(child: &mut Reaped) -> Option<ExitStatus> {
    let until = std::time::Instant::now() + Duration::from_secs(2);
    while std::time::Instant::now() < until {
        if let Ok(Some(status)) = child.0.try_wait() {
            return Some(status);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;
    use std::time::Instant;

    /// A program that stands in for the host: a shell script.
    fn script(folder: &Path, lines: &str) -> PathBuf {
        let path = folder.join("host");
        std::fs::write(&path, format!("#!/bin/sh\n{lines}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn how(lines: &str, deadline: Duration) -> String {
        let folder = tempfile::tempdir().unwrap();
        let program = script(folder.path(), lines);
        // Larger than a pipe, so that a host that does not read would stop a writer that waits for it.
        loop {
            match decode_with(&program, deadline, &vec![7; 4 << 20], "x.cr3") {
                // Another test's child may hold the script open for writing until it runs its own program.
                Err(RawError::DecoderProcess { how, .. }) if how.contains("Text file busy") => {}
                Err(RawError::DecoderProcess { how, .. }) => return how,
                other => panic!("{:?}", other.map(|(plane, _)| plane.dn.len())),
            }
        }
    }

    #[test]
    fn a_host_that_hangs_is_ended_at_the_deadline_with_all_that_it_started() {
        let begun = Instant::now();
        // The sleeping grandchild holds the pipe open.
        assert_eq!(how("sleep 600 & sleep 600", Duration::from_secs(1)), "it did not answer within 1 s");
        assert!(begun.elapsed() < Duration::from_secs(5));
    }

    #[test]
    fn a_host_that_answers_without_reading_or_ending_stops_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let mut refusal = Vec::new();
        let pattern = Refusal::Pattern { pattern: "X-Trans".to_owned() };
        wire::answer(&mut refusal, &Answer::Refused(pattern), &[]).unwrap();
        std::fs::write(folder.path().join("answer"), refusal).unwrap();
        let program = script(folder.path(), &format!("cat {}/answer; sleep 600", folder.path().display()));
        let begun = Instant::now();
        loop {
            match decode_with(&program, DEADLINE, &vec![7; 4 << 20], "x.raf") {
                Err(RawError::DecoderProcess { how, .. }) if how.contains("Text file busy") => {}
                Err(RawError::Pattern { pattern, .. }) => break assert_eq!(pattern, "X-Trans"),
                other => panic!("{:?}", other.map(|(plane, _)| plane.dn.len())),
            }
        }
        assert!(begun.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn a_host_that_dies_is_told_by_how_it_died() {
        let plenty = Duration::from_secs(20);
        assert!(how("kill -ABRT $$", plenty).contains("more than 1200 MB"));
        assert!(how("kill -XCPU $$", plenty).contains("20 s of processor time"));
        assert!(how("exit 3", plenty).contains("exit status: 3"));
        assert!(how("printf unlitraw", plenty).contains("in the middle of its answer"));
        assert!(how("echo usage: host FILE", plenty).contains("does not answer like a decode host"));
    }

    #[test]
    fn a_program_that_is_not_there_is_named() {
        let error = decode_with(Path::new("/nowhere/unlit"), DEADLINE, &[], "x.cr3").err().unwrap();
        assert!(error.to_string().contains("/nowhere/unlit"), "{error}");
    }
}
