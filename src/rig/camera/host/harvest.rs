//! What one release of the shutter brings in, told apart from what it must not be taken for.
//!
//! A body that writes RAW+JPEG gives two files in any order; an announcement may come twice; a frame of an earlier
//! release may come late. One release makes one raw and at most one JPEG: whatever comes beyond that cannot be
//! trusted, and the shot is given up rather than the wrong frame taken. While files of earlier releases may still
//! come, one that comes before this exposure can have ended is one of them.

use super::failure::{Answer, Failure};
use crate::rig::ShotFile;
use crate::rig::camera::protocol::Trouble;
use std::time::{Duration, Instant};

/// A camera silent for so long after its files, which never said that it was busy, is taken for ready.
const SILENCE: Duration = Duration::from_millis(200);
/// How long a camera may take, after it has given its files, until it says that it is ready.
const READY_AT_MOST: Duration = Duration::from_secs(8);
/// How long after the exposure a second frame is looked out for when that of an earlier release may still come.
const OWED_AT_MOST: Duration = Duration::from_millis(1500);
/// How long the second file of RAW+JPEG may let itself be waited for.
const SECOND_FILE_AT_MOST: Duration = Duration::from_secs(4);

/// Share of the exposure on the dial that surely passes: labels are rounded (1/15 s lasts 1/16 s).
const SURELY: f64 = 0.9;
/// Exposures shorter than this tell nothing: the camera's own delays are as long.
const TOO_SHORT_TO_TELL: Duration = Duration::from_millis(50);

/// What is known of a release when the shutter goes.
#[derive(Clone, Copy)]
pub(super) struct Release {
    /// Files that it is expected to make.
    pub(super) files: usize,
    /// Files of earlier releases that may still come.
    pub(super) owed: usize,
    /// Exposure time on the dial.
    pub(super) exposure: Option<Duration>,
    /// When it was asked for.
    pub(super) began: Instant,
}

/// The files of one release as they come in.
pub(super) struct Harvest {
    raw: Option<ShotFile>,
    jpeg: Option<ShotFile>,
    expected: usize,
    owed: usize,
    /// Before this no file can be of this release.
    earliest: Instant,
    /// When the shutter is closed again, going by the dial.
    exposed: Instant,
    /// Files of earlier releases that came and were left out.
    left_out: usize,
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
    pub(super) fn new(release: Release) -> Self {
        let Release { files, owed, exposure, began } = release;
        let exposure = exposure.unwrap_or_default();
        Self {
            raw: None,
            jpeg: None,
            expected: files,
            owed,
            earliest: began + exposure.mul_f64(SURELY).saturating_sub(TOO_SHORT_TO_TELL),
            exposed: began + exposure,
            left_out: 0,
            busy: false,
            done: false,
            missing: 0,
            last_file: began,
            last_word: began,
        }
    }

    /// The camera said something.
    pub(super) fn heard(&mut self, now: Instant) {
        self.last_word = now;
    }

    /// Takes in a file that was announced at `announced` and is here `now`. The same one a second time is passed
    /// over, and so is one of an earlier release.
    pub(super) fn take(&mut self, file: ShotFile, announced: Instant, now: Instant) -> Answer<()> {
        self.last_word = now;
        if self.owed > 0 && announced < self.earliest {
            tracing::warn!("{} came before the exposure can have ended and is left out", file.name);
            self.owed -= 1;
            self.left_out += 1;
            return Ok(());
        }
        self.last_file = now;
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
        if !self.complete() {
            return since(self.last_file) >= SECOND_FILE_AT_MOST;
        }
        if !self.trusted(now) {
            return false;
        }
        self.done
            || (!self.busy && since(self.last_word.max(self.exposed)) >= SILENCE)
            || since(self.last_file) >= READY_AT_MOST
    }

    fn complete(&self) -> bool {
        self.raw.is_some() && self.files() >= self.expected
    }

    /// Whether the files that came can be no others than this release's.
    fn trusted(&self, now: Instant) -> bool {
        let alone_since = self.last_file.max(self.exposed);
        self.owed == 0 || now.saturating_duration_since(alone_since) >= OWED_AT_MOST
    }

    /// Whether every file is in and trusted, and only the word that the camera is ready is not.
    pub(super) fn finished_but_for_ready(&self, now: Instant) -> bool {
        self.complete() && self.trusted(now)
    }

    /// Whether the camera is done and all that it gave was left out: no other frame will come.
    pub(super) fn in_vain(&self, now: Instant) -> bool {
        let since = now.saturating_duration_since(self.last_word.max(self.exposed));
        self.files() == 0 && self.left_out > 0 && self.done && since >= OWED_AT_MOST
    }

    /// Files that may still come if this release is given up. Which ones came cannot be told, so that all of its
    /// own are counted; only a camera that says that it is done, and gave something, has no more.
    pub(super) fn owed_if_given_up(&self, now: Instant) -> usize {
        if self.in_vain(now) { 0 } else { self.owed + self.expected }
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

    fn release(files: usize, owed: usize, began: Instant) -> Release {
        Release { files, owed, exposure: Some(EXPOSURE), began }
    }

    const EXPOSURE: Duration = Duration::from_secs(4);

    /// One whose exposure is over at `now`.
    fn exposed(files: usize, owed: usize, now: Instant) -> Harvest {
        let mut harvest = Harvest::new(release(files, owed, now));
        (harvest.earliest, harvest.exposed) = (now, now);
        harvest
    }

    #[test]
    fn both_files_are_kept_whichever_comes_first() {
        let now = Instant::now();
        for order in [[raw(1), jpeg()], [jpeg(), raw(1)]] {
            let mut harvest = exposed(2, 0, now);
            harvest.done = true;
            for file in order {
                assert!(!harvest.finished(now));
                harvest.take(file, now, now).unwrap();
            }
            assert!(harvest.finished(now));
            let (first, second) = harvest.files_in().unwrap();
            assert_eq!((first, second), (raw(1), Some(jpeg())));
        }
    }

    #[test]
    fn a_file_announced_twice_is_one_file_and_two_frames_are_none() {
        let now = Instant::now();
        let mut harvest = exposed(1, 0, now);
        harvest.take(raw(1), now, now).unwrap();
        harvest.take(raw(1), now, now).unwrap();
        assert_eq!(harvest.take(raw(2), now, now).unwrap_err().trouble, Trouble::Untrusted);
    }

    #[test]
    fn a_camera_that_says_busy_is_waited_for_until_it_says_done() {
        let now = Instant::now();
        let mut harvest = exposed(1, 0, now);
        harvest.take(raw(1), now, now).unwrap();
        assert!(!harvest.finished(now));
        assert!(harvest.finished(now + SILENCE), "one that never says either is ready when it falls silent");
        harvest.busy = true;
        assert!(!harvest.finished(now + SILENCE));
        assert!(harvest.finished_but_for_ready(now), "its frame is good, whether it says so or not");
        harvest.done = true;
        assert!(harvest.finished(now));
    }

    #[test]
    fn silence_counts_from_the_end_of_the_exposure() {
        let began = Instant::now();
        let mut harvest = Harvest::new(release(1, 0, began));
        harvest.take(raw(1), began, began).unwrap();
        assert!(!harvest.finished(began + SILENCE));
        assert!(!harvest.finished(began + EXPOSURE), "a silent body may be exposing");
        assert!(harvest.finished(began + EXPOSURE + SILENCE));
    }

    #[test]
    fn while_an_earlier_frame_may_come_the_first_one_is_not_trusted_at_once() {
        let now = Instant::now();
        let mut harvest = exposed(1, 1, now);
        harvest.done = true;
        harvest.take(raw(1), now, now).unwrap();
        assert!(!harvest.finished(now) && !harvest.finished_but_for_ready(now));
        assert!(harvest.finished(now + OWED_AT_MOST));
        assert_eq!(harvest.take(raw(2), now, now).unwrap_err().trouble, Trouble::Untrusted);
        assert_eq!(harvest.owed_if_given_up(now), 2);
    }

    #[test]
    fn an_owed_file_that_comes_before_the_exposure_can_have_ended_is_left_out() {
        let began = Instant::now();
        let mut harvest = Harvest::new(release(2, 2, began));
        harvest.done = true;
        let early = began + Duration::from_millis(100);
        harvest.take(raw(1), early, early).unwrap();
        harvest.take(jpeg(), early, early).unwrap();
        assert!(!harvest.finished(began + EXPOSURE), "none of them was this release's");
        let end = began + EXPOSURE;
        harvest.take(raw(2), end, end).unwrap();
        harvest.take(jpeg(), end, end).unwrap();
        assert!(harvest.finished(end), "all that was owed has come, so that these are trusted at once");
        assert_eq!(harvest.files_in().unwrap().0, raw(2));
    }

    #[test]
    fn one_owed_file_that_came_does_not_make_up_for_the_other() {
        let began = Instant::now();
        let mut harvest = Harvest::new(release(2, 2, began));
        harvest.done = true;
        harvest.take(jpeg(), began, began).unwrap();
        let end = began + EXPOSURE;
        harvest.take(raw(1), end, end).unwrap();
        harvest.take(jpeg(), end, end).unwrap();
        assert!(!harvest.finished(end), "that raw may be the one that is owed");
        assert_eq!(harvest.take(raw(2), end, end).unwrap_err().trouble, Trouble::Untrusted);
        assert_eq!(harvest.owed_if_given_up(end), 3);
    }

    #[test]
    fn a_camera_that_is_done_and_gave_only_what_was_left_out_owes_nothing_more() {
        let began = Instant::now();
        let mut harvest = Harvest::new(release(1, 1, began));
        harvest.take(raw(1), began, began).unwrap();
        let later = began + EXPOSURE + OWED_AT_MOST;
        assert!(!harvest.in_vain(later), "it is still at work");
        assert_eq!(harvest.owed_if_given_up(later), 1);
        harvest.done = true;
        assert!(!harvest.in_vain(began + EXPOSURE));
        assert!(harvest.in_vain(later));
        assert_eq!(harvest.owed_if_given_up(later), 0);
    }

    #[test]
    fn a_camera_set_to_jpeg_is_told_to_shoot_raw() {
        let now = Instant::now();
        let mut harvest = exposed(1, 0, now);
        harvest.done = true;
        harvest.take(jpeg(), now, now).unwrap();
        assert!(!harvest.finished(now), "the raw may still come");
        assert!(harvest.finished(now + SECOND_FILE_AT_MOST));
        assert!(harvest.files_in().unwrap_err().reason.contains("RAW"));
    }
}
