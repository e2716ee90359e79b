//! PTP/IP packets (CIPA DC-005), the responder's half: `u32 length, u32 type, payload`, little-endian.
//!
//! [`read`] takes one packet off a stream, [`write`] puts one on; [`Words`] walks through a payload without
//! ever running past its end.

use std::io::{self, Read, Write};

/// Packet types of DC-005, table 2.
pub(super) mod kind {
    pub(crate) const INIT_COMMAND: u32 = 1;
    pub(crate) const INIT_COMMAND_ACK: u32 = 2;
    pub(crate) const INIT_EVENT: u32 = 3;
    pub(crate) const INIT_EVENT_ACK: u32 = 4;
    pub(crate) const REQUEST: u32 = 6;
    pub(crate) const RESPONSE: u32 = 7;
    pub(crate) const START_DATA: u32 = 9;
    pub(crate) const DATA: u32 = 10;
    pub(crate) const CANCEL: u32 = 11;
    pub(crate) const END_DATA: u32 = 12;
    pub(crate) const PROBE: u32 = 13;
    pub(crate) const PROBE_ACK: u32 = 14;
}

/// Longest packet taken from a client. What a client sends to a camera is a few properties, never files.
const LONGEST: u32 = 1 << 20;

/// One packet as it came.
#[derive(Debug)]
pub(super) struct Packet {
    /// One of [`kind`].
    pub(super) kind: u32,
    /// What follows the type.
    pub(super) payload: Vec<u8>,
}

/// Reads one packet. An end of stream between packets is an error of kind `UnexpectedEof`, as any other.
pub(super) fn read(stream: &mut impl Read) -> io::Result<Packet> {
    let mut head = [0; 8];
    stream.read_exact(&mut head)?;
    let mut words = Words::new(&head);
    let (length, kind) = (words.u32()?, words.u32()?);
    if !(8..=LONGEST).contains(&length) {
        return Err(invalid(format!("PTP/IP packet of {length} bytes; expected 8 to {LONGEST}")));
    }
    let mut payload = vec![0; length as usize - 8];
    stream.read_exact(&mut payload)?;
    Ok(Packet { kind, payload })
}

/// Writes one packet whose payload is the concatenation of `parts`.
pub(super) fn write(stream: &mut impl Write, kind: u32, parts: &[&[u8]]) -> io::Result<()> {
    let length = 8 + parts.iter().map(|p| p.len()).sum::<usize>();
    let length = u32::try_from(length)
        .map_err(|_| invalid(format!("{length} bytes do not fit one PTP/IP packet; send them in parts")))?;
    let mut whole = Vec::with_capacity(length as usize);
    whole.extend(length.to_le_bytes());
    whole.extend(kind.to_le_bytes());
    for part in parts {
        whole.extend(*part);
    }
    stream.write_all(&whole)
}

/// An operation request: code, transaction and parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Request {
    /// PTP operation code.
    pub(super) operation: u16,
    /// Transaction id, to be repeated in data and response.
    pub(super) transaction: u32,
    /// Up to five parameters.
    pub(super) parameters: Vec<u32>,
    /// Whether data from the client follow.
    pub(super) data_follow: bool,
}

impl Request {
    /// Parses the payload of a packet of kind [`kind::REQUEST`].
    pub(super) fn parse(payload: &[u8]) -> io::Result<Self> {
        let mut words = Words::new(payload);
        let data_follow = words.u32()? == 2;
        let operation = words.u16()?;
        let transaction = words.u32()?;
        let mut parameters = Vec::new();
        while let Ok(parameter) = words.u32() {
            parameters.push(parameter);
        }
        Ok(Self { operation, transaction, parameters, data_follow })
    }

    /// The parameter at `index`, 0 when the client left it out (as PTP asks).
    pub(super) fn parameter(&self, index: usize) -> u32 {
        self.parameters.get(index).copied().unwrap_or(0)
    }
}

/// Little-endian numbers off the front of a slice.
pub(super) struct Words<'a>(&'a [u8]);

impl<'a> Words<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    fn take<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let (head, rest) = self
            .0
            .split_first_chunk::<N>()
            .ok_or_else(|| invalid(format!("packet ends {} bytes early", N - self.0.len())))?;
        self.0 = rest;
        Ok(*head)
    }

    pub(super) fn u16(&mut self) -> io::Result<u16> {
        Ok(u16::from_le_bytes(self.take()?))
    }

    pub(super) fn u32(&mut self) -> io::Result<u32> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    /// What has not been read yet.
    pub(super) fn rest(self) -> &'a [u8] {
        self.0
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_comes_back_as_it_was_written() {
        let mut wire = Vec::new();
        write(&mut wire, kind::RESPONSE, &[&0x2001_u16.to_le_bytes(), &7_u32.to_le_bytes()]).unwrap();
        assert_eq!(wire[..8], [14, 0, 0, 0, 7, 0, 0, 0]);
        let packet = read(&mut wire.as_slice()).unwrap();
        assert_eq!((packet.kind, packet.payload), (kind::RESPONSE, vec![0x01, 0x20, 7, 0, 0, 0]));
    }

    #[test]
    fn absurd_and_cut_packets_are_errors() {
        assert!(read(&mut [0xff; 16].as_slice()).is_err());
        assert!(read(&mut [4, 0, 0, 0, 1, 0, 0, 0].as_slice()).is_err());
        assert!(read(&mut [16, 0, 0, 0, 1, 0, 0, 0, 1].as_slice()).is_err());
        assert!(Request::parse(&[1, 0, 0, 0, 2]).is_err());
    }

    #[test]
    fn a_request_without_parameters_has_zeros() {
        let request = Request::parse(&[1, 0, 0, 0, 0x16, 0x91, 5, 0, 0, 0]).unwrap();
        assert_eq!((request.operation, request.transaction, request.data_follow), (0x9116, 5, false));
        assert_eq!(request.parameter(0), 0);
    }
}
