//! Files of one JSON object a line, appended to: a last line that a crash left without its newline never counts.

use super::store;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Appends a line; on the disk when this returns. What is left of a torn one is cut off first.
pub fn append_synced(path: &Path, line: &str) -> io::Result<()> {
    heal(path)?;
    store::append_line_synced(path, line)
}

/// The same without waiting for the disk: the line survives the program, but not the machine.
pub fn append(path: &Path, line: &str) -> io::Result<()> {
    heal(path)?;
    let mut file = OpenOptions::new().append(true).create(true).open(path)?;
    file.write_all(format!("{line}\n").as_bytes())
}

fn heal(path: &Path) -> io::Result<()> {
    if !ends_whole(path)? {
        mend_tail(path)?;
    }
    Ok(())
}

/// Whether the last line has its newline.
fn ends_whole(path: &Path) -> io::Result<bool> {
    let mut file = match File::open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(true),
        other => other?,
    };
    let mut last = [b'\n'];
    if file.metadata()?.len() > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
    }
    Ok(last == [b'\n'])
}

/// All whole lines, the oldest first; none where there is no file.
pub fn read(path: &Path) -> io::Result<String> {
    let mut text = match std::fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(String::new()),
        other => other?,
    };
    text.truncate(text.rfind('\n').map_or(0, |end| end + 1));
    Ok(text)
}

/// Cuts off a last line that a crash left without its newline, and says how many bytes it had.
pub fn mend_tail(path: &Path) -> io::Result<u64> {
    let bytes = match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(0),
        other => other?,
    };
    let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1);
    if whole < bytes.len() {
        let file = OpenOptions::new().write(true).open(path)?;
        file.set_len(whole as u64).and_then(|()| file.sync_all())?;
    }
    Ok((bytes.len() - whole) as u64)
}
