//! What the driver and the camera host say to each other: frames on a local socket.
//!
//! A frame is `u32 length of the header, u64 length of the payload, header as JSON, payload`, little-endian.
//! One request is answered by one reply; the payload is the bytes of a file or a preview.

use crate::pair::{Dial, Offered, Settings};
use crate::rig::CameraInfo;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};

/// Longest header taken.
const LONGEST_HEADER: u32 = 1 << 20;
/// Longest payload taken: no camera's file comes near it.
const LONGEST_PAYLOAD: u64 = 1 << 30;

/// What the host is asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Request {
    /// Cameras that can be found without knowing their port.
    List,
    /// Connect to the camera on the host's port.
    Open,
    /// Settings as the camera reports them.
    Settings,
    /// What the dials offer.
    Offered,
    /// Turn one dial.
    Set(Dial),
    /// A live picture.
    Preview,
    /// Release the shutter once, fetch the file, wait until the camera is ready.
    Shoot,
}

/// What the host answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant, reason = "one reply is there at a time, never a list of them")]
pub(super) enum Reply {
    /// To [`Request::List`].
    Cameras(Vec<CameraInfo>),
    /// To [`Request::Open`].
    Opened(CameraInfo),
    /// To [`Request::Settings`].
    Settings(Settings),
    /// To [`Request::Offered`].
    Offered(Offered),
    /// To [`Request::Set`].
    Done,
    /// To [`Request::Preview`] and [`Request::Shoot`]: the payload is a file of this name.
    File(String),
    /// It did not work.
    Failed {
        /// What kind of trouble.
        trouble: Trouble,
        /// What the driver said.
        reason: String,
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
    /// Try again soon.
    Busy,
    /// The camera fell silent; open it anew.
    Silent,
    /// The link broke, or the library no longer knows where it stands; open it anew.
    Lost,
    /// The camera said no and stays usable.
    Refused,
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
        send(&mut wire, &Reply::File("capt0000.cr2".into()), &[1, 2, 3]).unwrap();
        let mut wire = wire.as_slice();
        assert_eq!(receive::<Request>(&mut wire).unwrap().0, Request::Set(Dial::Shutter(Seconds(0.008))));
        let (reply, payload) = receive::<Reply>(&mut wire).unwrap();
        assert_eq!((reply, payload), (Reply::File("capt0000.cr2".into()), vec![1, 2, 3]));
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
