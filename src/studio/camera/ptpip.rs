//! PTP/IP (CIPA DC-005), the responder's half: packets `u32 length, u32 type, payload`, little-endian, on one
//! connection for commands and one for events.

use super::device::Device;
use super::request::{Answer, Outcome, Request, Words, invalid};
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;

/// Packet types of DC-005, table 2.
mod kind {
    pub(super) const INIT_COMMAND: u32 = 1;
    pub(super) const INIT_COMMAND_ACK: u32 = 2;
    pub(super) const INIT_EVENT: u32 = 3;
    pub(super) const INIT_EVENT_ACK: u32 = 4;
    pub(super) const REQUEST: u32 = 6;
    pub(super) const RESPONSE: u32 = 7;
    pub(super) const START_DATA: u32 = 9;
    pub(super) const DATA: u32 = 10;
    pub(super) const CANCEL: u32 = 11;
    pub(super) const END_DATA: u32 = 12;
    pub(super) const PROBE: u32 = 13;
    pub(super) const PROBE_ACK: u32 = 14;
}

/// Longest packet taken from a client. What a client sends to a camera is a few properties, never files.
const LONGEST: u32 = 1 << 20;
/// Phase of a request whose data come from the client.
const DATA_FOLLOW: u32 = 2;
/// Name in the handshake, shown by nobody.
const NAME: &str = "unlit studio";

/// One packet as it came.
#[derive(Debug)]
struct Packet {
    /// One of [`kind`].
    kind: u32,
    /// What follows the type.
    payload: Vec<u8>,
}

/// Reads one packet. An end of stream between packets is an error of kind `UnexpectedEof`, as any other.
fn read(stream: &mut impl Read) -> io::Result<Packet> {
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

/// The head of a packet with so many bytes of payload.
fn head(kind: u32, payload: usize) -> io::Result<Vec<u8>> {
    let length = u32::try_from(8 + payload)
        .map_err(|_| invalid(format!("{payload} bytes do not fit one PTP/IP packet; send them in parts")))?;
    Ok([length.to_le_bytes(), kind.to_le_bytes()].concat())
}

/// Writes one packet whose payload is the concatenation of `parts`.
fn write(stream: &mut impl Write, kind: u32, parts: &[&[u8]]) -> io::Result<()> {
    let mut whole = head(kind, parts.iter().map(|p| p.len()).sum())?;
    for part in parts {
        whole.extend(*part);
    }
    stream.write_all(&whole)
}

/// Serves one connection, command or event, until the client goes or the server stops.
pub(super) fn serve(mut stream: TcpStream, device: &Arc<Device>) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let first = read(&mut stream)?;
    match first.kind {
        kind::INIT_COMMAND => {
            let mut name: Vec<u8> = NAME.encode_utf16().flat_map(u16::to_le_bytes).collect();
            name.extend([0, 0]);
            let (connection, guid, version) =
                (1_u32.to_le_bytes(), [0x55; 16], 0x0001_0000_u32.to_le_bytes());
            write(&mut stream, kind::INIT_COMMAND_ACK, &[&connection, &guid, &name, &version])?;
            device.body()?.new_client();
            commands(stream, device)
        }
        kind::INIT_EVENT => {
            write(&mut stream, kind::INIT_EVENT_ACK, &[])?;
            loop {
                // Canon's events are fetched by GetEvent; this connection only has to be there.
                if read(&mut stream)?.kind == kind::PROBE {
                    write(&mut stream, kind::PROBE_ACK, &[])?;
                }
            }
        }
        other => Err(unexpected(other, "a handshake")),
    }
}

fn unexpected(kind: u32, wanted: &str) -> io::Error {
    invalid(format!("PTP/IP packet of type {kind} where {wanted} belongs"))
}

fn commands(mut stream: TcpStream, device: &Arc<Device>) -> io::Result<()> {
    loop {
        let Packet { kind: found, payload } = read(&mut stream)?;
        match found {
            kind::REQUEST => {}
            kind::PROBE => {
                write(&mut stream, kind::PROBE_ACK, &[])?;
                continue;
            }
            kind::CANCEL => continue,
            other => return Err(unexpected(other, "a request")),
        }
        let mut words = Words::new(&payload);
        let data_follow = words.u32()? == DATA_FOLLOW;
        let request = Request::parse(words)?;
        let sent = if data_follow { incoming(&mut stream)? } else { Vec::new() };
        match device.answer(&request, &sent)? {
            Outcome::Answer(answer) => reply(&mut stream, &request, &answer)?,
            Outcome::Silence => {}
            Outcome::CutOff { answer, unplug } => {
                cut_off(&mut stream, &request, &answer)?;
                if unplug {
                    device.unplug();
                }
                return Err(io::Error::new(io::ErrorKind::ConnectionAborted, "link dropped, as asked"));
            }
        }
    }
}

/// Data that a client sends with a request: StartData, Data, EndData.
fn incoming(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut data = Vec::new();
    loop {
        let Packet { kind: found, payload } = read(stream)?;
        match found {
            kind::START_DATA => continue,
            kind::DATA | kind::END_DATA => {
                let mut words = Words::new(&payload);
                words.u32()?;
                data.extend(words.rest());
                if data.len() > LONGEST as usize {
                    return Err(invalid(format!("a client sent more than {LONGEST} bytes with one request")));
                }
                if found == kind::END_DATA {
                    return Ok(data);
                }
            }
            other => return Err(unexpected(other, "data")),
        }
    }
}

fn reply(stream: &mut TcpStream, request: &Request, answer: &Answer) -> io::Result<()> {
    let transaction = request.transaction.to_le_bytes();
    if let Some(data) = &answer.data {
        let length = (data.len() as u64).to_le_bytes();
        write(stream, kind::START_DATA, &[&transaction, &length])?;
        write(stream, kind::END_DATA, &[&transaction, data])?;
    }
    write(stream, kind::RESPONSE, &[&answer.code.to_le_bytes(), &transaction])
}

/// Half of a reply, which claims to be whole.
fn cut_off(stream: &mut TcpStream, request: &Request, answer: &Answer) -> io::Result<()> {
    let transaction = request.transaction.to_le_bytes();
    let data = answer.data.as_deref().unwrap_or_default();
    write(stream, kind::START_DATA, &[&transaction, &(data.len() as u64).to_le_bytes()])?;
    let mut half = head(kind::END_DATA, transaction.len() + data.len())?;
    half.extend(transaction);
    half.extend(&data[..data.len() / 2]);
    stream.write_all(&half)
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
    }
}
