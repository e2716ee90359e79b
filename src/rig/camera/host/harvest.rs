//! What one release of the shutter brings in, told apart from what it must not be taken for.
//!
//! A body that writes RAW+JPEG gives two files in any order; an announcement may come twice; a frame of an earlier
//! release may come late. One release makes one raw and at most one JPEG: whatever comes beyond that cannot be
//! trusted, and the shot is given up rather than the wrong frame taken.

use super::failure::{Answer, Failure};
use crate::rig::ShotFile;
use crate::rig::camera::protocol::Trouble;
use std::time::{Duration, Instant};

/// A camera silent for so long after its files, which never said that it was busy, is taken for ready.
const SILENCE: Duration = Duration::from_millis(200);
/// How long a camera may take, after it has given its files, until it says that it is ready.
const READY_AT_MOST: Duration = Duration::from_secs(8);
/// How long a second frame is looked out for when the frame of an earlier release may still come.
const OWED_AT_MOST: Duration = Duration::from_millis(1500);
/// How long the second file of RAW+JPEG may let itself be waited for.
const SECOND_FILE_AT_MOST: Duration = Duration::from_secs(4);

/// The files of one release as they come in.
pub(super) struct Harvest {
    raw: Option<ShotFile>,
    jpeg: Option<ShotFile>,
    /// Files that the release is expected to make.
    expected: usize,
    /// The frame of an earlier release may come too.
    frame_owed: bool,
    /// The camera said that it works.
    pub(super) busy: bool,
    /// The camera said that it is done.
    pub(super) done: bool,
    /// Announced objects that were no longer there.
    pub(super) missing: usize,
    last_file: Instant,
    last_word: Instant,
}

impl Harvest {
    pub(super) fn new(expected: usize, frame_owed: bool, now: Instant) -> Self {
        Self {
            raw: None,
            jpeg: None,
            expected,
            frame_owed,
            busy: false,
            done: false,
            missing: 0,
            last_file: now,
            last_word: now,
        }
    }

    /// The camera said something.
    pub(super) fn heard(&mut self, now: Instant) {
        self.last_word = now;
    }

    /// Takes a file in. The same one a second time is passed over.
    pub(super) fn take(&mut self, file: ShotFile, now: Instant) -> Answer<()> {
        (self.last_file, self.last_word) = (now, now);
        let place = if is_jpeg(&file.bytes) { &mut self.jpeg } else { &mut self.raw };
        match place {
            None => *place = Some(file),
            Some(first) if first.bytes == file.bytes => {
                tracing::warn!("{} was announced twice", file.name);
            }
            Some(first) => {
                let reason = format!("one release brought both {} and {}", first.name, file.name);
                return Err(Failure::new(Trouble::Untrusted, reason));
            }
        }
        Ok(())
    }

    fn files(&self) -> usize {
        usize::from(self.raw.is_some()) + usize::from(self.jpeg.is_some())
    }

    /// Whether nothing more is to be waited for.
    pub(super) fn finished(&self, now: Instant) -> bool {
        let since = |moment: Instant| now.saturating_duration_since(moment);
        if self.files() == 0 {
            return false;
        }
        if !self.finished_but_for_ready() {
            return since(self.last_file) >= SECOND_FILE_AT_MOST;
        }
        if self.frame_owed && since(self.last_file) < OWED_AT_MOST {
            return false;
        }
        self.done
            || (!self.busy && since(self.last_word) >= SILENCE)
            || since(self.last_file) >= READY_AT_MOST
    }

    /// Whether every file is in, and only the word that the camera is ready is not.
    pub(super) fn finished_but_for_ready(&self) -> bool {
        self.raw.is_some() && self.files() >= self.expected
    }

    /// Whether an object was announced, was not there, and the camera is done: no frame will come.
    pub(super) fn lost(&self, now: Instant) -> bool {
        self.files() == 0
            && self.missing > 0
            && self.done
            && now.saturating_duration_since(self.last_word) >= SILENCE
    }

    /// The files: the raw, and the JPEG if there is one.
    pub(super) fn files_in(self) -> Answer<(ShotFile, Option<ShotFile>)> {
        match (self.raw, self.jpeg) {
            (Some(raw), jpeg) => Ok((raw, jpeg)),
            (None, _) => Err(Failure::refused(
                "its release made no raw file: set its image quality to RAW, or RAW + JPEG",
            )),
        }
    }
}

/// JPEG files begin with the start-of-image marker; no raw format does.
fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(byte: u8) -> ShotFile {
        ShotFile { name: "capt0000.cr2".into(), bytes: vec![byte; 4] }
    }

    fn jpeg() -> ShotFile {
        ShotFile { name: "capt0001.jpg".into(), bytes: vec![0xff, 0xd8, 0xff] }
    }

    #[test]
    fn both_files_are_kept_whichever_comes_first() {
        let now = Instant::now();
        for order in [[raw(1), jpeg()], [jpeg(), raw(1)]] {
            let mut harvest = Harvest::new(2, false, now);
            harvest.done = true;
            for file in order {
                assert!(!harvest.finished(now));
                harvest.take(file, now).unwrap();
            }
            assert!(harvest.finished(now));
            let (first, second) = harvest.files_in().unwrap();
            assert_eq!((first, second), (raw(1), Some(jpeg())));
        }
    }

    #[test]
    fn a_file_announced_twice_is_one_file_and_two_frames_are_none() {
        let now = Instant::now();
        let mut harvest = Harvest::new(1, false, now);
        harvest.take(raw(1), now).unwrap();
        harvest.take(raw(1), now).unwrap();
        assert_eq!(harvest.take(raw(2), now).unwrap_err().trouble, Trouble::Untrusted);
    }

    #[test]
    fn a_camera_that_says_busy_is_waited_for_until_it_says_done() {
        let now = Instant::now();
        let mut harvest = Harvest::new(1, false, now);
        harvest.take(raw(1), now).unwrap();
        assert!(!harvest.finished(now));
        assert!(harvest.finished(now + SILENCE), "one that never says either is ready when it falls silent");
        harvest.busy = true;
        assert!(!harvest.finished(now + SILENCE));
        harvest.done = true;
        assert!(harvest.finished(now));
    }

    #[test]
    fn while_an_earlier_frame_may_come_the_first_one_is_not_trusted_at_once() {
        let now = Instant::now();
        let mut harvest = Harvest::new(1, true, now);
        harvest.done = true;
        harvest.take(raw(1), now).unwrap();
        assert!(!harvest.finished(now));
        assert!(harvest.finished(now + OWED_AT_MOST));
        assert_eq!(harvest.take(raw(2), now).unwrap_err().trouble, Trouble::Untrusted);
    }

    #[test]
    fn a_camera_set_to_jpeg_is_told_to_shoot_raw() {
        let now = Instant::now();
        let mut harvest = Harvest::new(1, false, now);
        harvest.done = true;
        harvest.take(jpeg(), now).unwrap();
        assert!(!harvest.finished(now), "the raw may still come");
        assert!(harvest.finished(now + SECOND_FILE_AT_MOST));
        assert!(harvest.files_in().unwrap_err().reason.contains("RAW"));
    }
}
