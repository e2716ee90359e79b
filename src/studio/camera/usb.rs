//! PTP over USB (the still image class), the device's half, at the other end of the stand-in for libgphoto2's USB port
//! driver (`studio/usb/usb1.c`): a Unix socket in place of the bulk endpoints.
//!
//! Containers are `u32 length, u16 type, u16 code, u32 transaction, payload`, little-endian. From the host they come as a
//! plain stream; to the host each goes as one transfer, `u32 length, bytes`.

use super::datasets::op;
use super::device::Device;
use super::request::{Answer, Outcome, Request, Words, invalid};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;

/// Container types.
mod kind {
    pub(super) const COMMAND: u16 = 1;
    pub(super) const DATA: u16 = 2;
    pub(super) const RESPONSE: u16 = 3;
}

/// Bytes before a container's payload.
const HEAD: usize = 12;
/// Longest container taken from a host. What a host sends to a camera is a few properties, never files.
const LONGEST: u32 = 1 << 20;

/// One container as it came, without its length.
struct Container {
    kind: u16,
    /// Code, transaction and payload.
    rest: Vec<u8>,
}

fn read(stream: &mut impl Read) -> io::Result<Container> {
    let mut head = [0; 6];
    stream.read_exact(&mut head)?;
    let mut words = Words::new(&head);
    let (length, kind) = (words.u32()?, words.u16()?);
    if !(HEAD as u32..=LONGEST).contains(&length) {
        return Err(invalid(format!("USB container of {length} bytes; expected {HEAD} to {LONGEST}")));
    }
    let mut rest = vec![0; length as usize - head.len()];
    stream.read_exact(&mut rest)?;
    Ok(Container { kind, rest })
}

/// A container, as one transfer.
fn transfer(kind: u16, code: u16, transaction: u32, payload: &[u8]) -> io::Result<Vec<u8>> {
    let length = u32::try_from(HEAD + payload.len()).map_err(|_| {
        invalid(format!("{} bytes do not fit one container; ask for them in parts", payload.len()))
    })?;
    let mut bytes = Vec::with_capacity(4 + HEAD + payload.len());
    bytes.extend(length.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend(kind.to_le_bytes());
    bytes.extend(code.to_le_bytes());
    bytes.extend(transaction.to_le_bytes());
    bytes.extend(payload);
    Ok(bytes)
}

/// Serves one host until it goes or the plug is pulled.
pub(super) fn serve(mut stream: UnixStream, device: &Arc<Device>) -> io::Result<()> {
    device.body()?.new_client();
    loop {
        let Container { kind: found, rest } = read(&mut stream)?;
        if found != kind::COMMAND {
            return Err(invalid(format!("USB container of type {found} where a command belongs")));
        }
        let request = Request::parse(Words::new(&rest))?;
        let sent =
            if request.operation == op::EOS_SET_PROPERTY { incoming(&mut stream)? } else { Vec::new() };
        match device.answer(&request, &sent)? {
            Outcome::Answer(answer) => reply(&mut stream, &request, &answer)?,
            Outcome::Silence => {}
            Outcome::CutOff { answer, unplug } => {
                let data = answer.data.unwrap_or_default();
                let whole = transfer(kind::DATA, request.operation, request.transaction, &data)?;
                stream.write_all(&whole[..whole.len() / 2])?;
                if unplug {
                    device.unplug();
                }
                return Err(io::Error::new(io::ErrorKind::ConnectionAborted, "link dropped, as asked"));
            }
        }
    }
}

/// The data phase of a request whose data come from the host.
fn incoming(stream: &mut impl Read) -> io::Result<Vec<u8>> {
    let Container { kind: found, rest } = read(stream)?;
    if found != kind::DATA {
        return Err(invalid(format!("USB container of type {found} where data belong")));
    }
    let mut words = Words::new(&rest);
    words.u16()?;
    words.u32()?;
    Ok(words.rest().to_vec())
}

fn reply(stream: &mut impl Write, request: &Request, answer: &Answer) -> io::Result<()> {
    if let Some(data) = &answer.data {
        stream.write_all(&transfer(kind::DATA, request.operation, request.transaction, data)?)?;
    }
    stream.write_all(&transfer(kind::RESPONSE, answer.code, request.transaction, &[])?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_container_comes_back_as_it_was_sent() {
        let bytes = transfer(kind::DATA, 0x1001, 7, &[1, 2, 3]).unwrap();
        assert_eq!(bytes[..4], 15_u32.to_le_bytes());
        let container = read(&mut &bytes[4..]).unwrap();
        assert_eq!(container.kind, kind::DATA);
        assert_eq!(container.rest, [0x01, 0x10, 7, 0, 0, 0, 1, 2, 3]);
        assert_eq!(incoming(&mut &bytes[4..]).unwrap(), [1, 2, 3]);
    }

    #[test]
    fn absurd_and_cut_containers_are_errors() {
        assert!(read(&mut [0xff; 16].as_slice()).is_err());
        assert!(read(&mut [4, 0, 0, 0, 1, 0].as_slice()).is_err());
        assert!(read(&mut [16, 0, 0, 0, 1, 0, 1].as_slice()).is_err());
    }
}
