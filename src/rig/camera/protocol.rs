//! What the driver and the camera host say to each other: frames on a local socket.
//!
//! A frame is `u32 length of the header, u64 length of the payload, header as JSON, payload`, little-endian.
//! One request is answered by one reply, whose payload is the bytes of a preview. A shot alone has several:
//! [`Reply::Releasing`], a [`Reply::Frame`] for each file, [`Reply::Shot`]; [`Reply::Failed`] may come instead of any.

use crate::pair::{Dial, Offered, Settings};
use crate::rig::{CameraInfo, LockReport, ShotTimes};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::time::Duration;

/// Longest header taken.
const LONGEST_HEADER: u32 = 1 << 20;
/// Longest payload taken: no camera's file comes near it.
const LONGEST_PAYLOAD: u64 = 1 << 30;

/// What the host is asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Request {
    /// Version of the library.
    Library,
    /// Cameras that can be found without knowing their port.
    List,
    /// Connect to the camera on the host's port, and tell who it is. Nothing is changed in it.
    Open,
    /// Make the open camera ours: get rid of whatever it still holds.
    Prepare {
        /// Where its frames shall go.
        target: Target,
        /// Files of releases that were given up: they may still come, and must not be taken for others.
        files_owed: usize,
    },
    /// Ask the camera something small, to see whether it is there.
    Greet,
    /// Settings as the camera reports them.
    Settings,
    /// What the dials offer.
    Offered,
    /// Turn one dial.
    Set(Dial),
    /// Go through the exposure lock.
    Lock,
    /// A live picture.
    Preview,
    /// End live view.
    EndPreview,
    /// Release the shutter once, fetch the files, wait until the camera is ready.
    Shoot {
        /// How long the camera may take beyond the exposure.
        patience: Duration,
        /// As in [`Request::Prepare`].
        files_owed: usize,
    },
}

/// Where the camera puts its frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Into its memory, from where they go to the computer alone; spares the card and its time.
    #[default]
    Memory,
    /// Onto its card, as the photographer's own copy; they are fetched from there.
    Card,
}

/// What the host answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant, reason = "one reply is there at a time, never a list of them")]
pub(super) enum Reply {
    /// To [`Request::Library`].
    Library(String),
    /// To [`Request::List`].
    Cameras(Vec<CameraInfo>),
    /// To [`Request::Open`].
    Opened {
        /// Who it says it is.
        info: CameraInfo,
        /// Model by which [`Request::List`] names it.
        listed_as: String,
    },
    /// To [`Request::Prepare`].
    Prepared {
        /// Files of earlier releases that may still come.
        files_owed: usize,
    },
    /// To [`Request::Settings`].
    Settings(Settings),
    /// To [`Request::Offered`].
    Offered(Offered),
    /// To [`Request::Set`], [`Request::EndPreview`] and [`Request::Greet`].
    Done,
    /// To [`Request::Lock`].
    Locked(LockReport),
    /// To [`Request::Preview`]: the payload is the picture.
    Preview,
    /// To [`Request::Shoot`], first: the camera was found ready, and the shutter is released now.
    Releasing {
        /// Exposure time that its dial shows.
        exposure: Option<Duration>,
        /// Files that may still come if it is given up now: those of this release and of earlier ones.
        files_owed: usize,
    },
    /// To [`Request::Shoot`]: the payload is a file of this name, the raw first.
    Frame(String),
    /// To [`Request::Shoot`], last: the camera is ready again.
    Shot(ShotTimes),
    /// It did not work.
    Failed {
        /// What kind of trouble.
        trouble: Trouble,
        /// What the driver said.
        reason: String,
        /// Files that may still come, if a camera is open.
        files_owed: Option<usize>,
    },
}

/// Kinds of trouble, by what the driver does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Trouble {
    /// Nothing answers on that port.
    NotFound,
    /// Another program has the port.
    Claimed,
    /// Try again soon; nothing was released.
    Busy,
    /// The camera fell silent; open it anew.
    Silent,
    /// The link broke, or the library no longer knows where it stands; open it anew.
    Lost,
    /// The camera said no and stays usable.
    Refused,
    /// It found no focus.
    NoFocus,
    /// It has no room.
    CardFull,
    /// Its battery is too low.
    BatteryLow,
    /// A file came short and is gone.
    Incomplete {
        /// Bytes that came.
        got: u64,
        /// Bytes announced.
        announced: u64,
    },
    /// More came than one release can give.
    Untrusted,
}

/// Writes one frame.
pub(super) fn send<H: Serialize>(link: &mut impl Write, header: &H, payload: &[u8]) -> io::Result<()> {
    let header = serde_json::to_vec(header)?;
    let mut head = Vec::with_capacity(12 + header.len());
    let length = u32::try_from(header.len()).map_err(|_| too_long("header", header.len() as u64))?;
    head.extend(length.to_le_bytes());
    head.extend((payload.len() as u64).to_le_bytes());
    head.extend(header);
    link.write_all(&head)?;
    link.write_all(payload)?;
    link.flush()
}

/// Reads one frame.
pub(super) fn receive<H: DeserializeOwned>(link: &mut impl Read) -> io::Result<(H, Vec<u8>)> {
    let (mut header, mut payload) = ([0; 4], [0; 8]);
    link.read_exact(&mut header)?;
    link.read_exact(&mut payload)?;
    let (header, payload) = (u32::from_le_bytes(header), u64::from_le_bytes(payload));
    if header > LONGEST_HEADER {
        return Err(too_long("header", header.into()));
    }
    if payload > LONGEST_PAYLOAD {
        return Err(too_long("payload", payload));
    }
    let mut bytes = vec![0; header as usize];
    link.read_exact(&mut bytes)?;
    let header = serde_json::from_slice(&bytes)?;
    let mut bytes = vec![0; payload as usize];
    link.read_exact(&mut bytes)?;
    Ok((header, bytes))
}

fn too_long(what: &str, length: u64) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("frame with a {what} of {length} bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Seconds;

    #[test]
    fn a_frame_comes_back_as_it_was_sent() {
        let mut wire = Vec::new();
        send(&mut wire, &Request::Set(Dial::Shutter(Seconds(0.008))), &[]).unwrap();
        send(&mut wire, &Reply::Frame("capt0000.cr2".into()), &[1, 2, 3]).unwrap();
        let mut wire = wire.as_slice();
        assert_eq!(receive::<Request>(&mut wire).unwrap().0, Request::Set(Dial::Shutter(Seconds(0.008))));
        let (reply, payload) = receive::<Reply>(&mut wire).unwrap();
        assert_eq!((reply, payload), (Reply::Frame("capt0000.cr2".into()), vec![1, 2, 3]));
        assert!(receive::<Reply>(&mut wire).is_err());
    }

    #[test]
    fn a_frame_that_claims_gigabytes_is_refused_before_memory_is_taken() {
        assert!(receive::<Reply>(&mut [0xff; 32].as_slice()).is_err());
        let mut huge = vec![2, 0, 0, 0];
        huge.extend(u64::MAX.to_le_bytes());
        huge.extend(b"{}");
        assert!(receive::<Reply>(&mut huge.as_slice()).is_err());
    }
}
