//! One client's connection: the handshake, then request after request until it goes.

use super::body::{Body, SetError, prop};
use super::datasets::{self, op};
use super::packet::{self, Packet, Request, Words, kind};
use super::{Fault, Shared};
use std::io;
use std::net::TcpStream;
use std::sync::Arc;

/// PTP response codes.
mod answer {
    pub(super) const OK: u16 = 0x2001;
    pub(super) const UNSUPPORTED: u16 = 0x2005;
    pub(super) const NO_OBJECT: u16 = 0x2009;
    pub(super) const NO_PROPERTY: u16 = 0x200a;
    pub(super) const NO_CARD: u16 = 0x2013;
    pub(super) const BUSY: u16 = 0x2019;
    pub(super) const BAD_VALUE: u16 = 0x201c;
    pub(super) const BAD_PARAMETER: u16 = 0x201d;
    pub(super) const GENERAL: u16 = 0x2002;
    /// Canon: no viewfinder frame yet.
    pub(super) const NOT_READY: u16 = 0xa102;
}

/// RemoteRelease's parameter for the second pressure point.
const FULL_PRESS: u32 = 2;
/// Name in the handshake, shown by nobody.
const NAME: &str = "unlit studio";

/// What one request is answered with.
struct Answer {
    code: u16,
    data: Option<Vec<u8>>,
}

impl Answer {
    const fn code(code: u16) -> Self {
        Self { code, data: None }
    }

    const fn data(data: Vec<u8>) -> Self {
        Self { code: answer::OK, data: Some(data) }
    }
}

/// Serves one connection, command or event, until the client goes or the server stops.
pub(super) fn serve(mut stream: TcpStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let first = packet::read(&mut stream)?;
    match first.kind {
        kind::INIT_COMMAND => {
            let mut name: Vec<u8> = NAME.encode_utf16().flat_map(u16::to_le_bytes).collect();
            name.extend([0, 0]);
            let (connection, guid, version) =
                (1_u32.to_le_bytes(), [0x55; 16], 0x0001_0000_u32.to_le_bytes());
            packet::write(&mut stream, kind::INIT_COMMAND_ACK, &[&connection, &guid, &name, &version])?;
            shared.body()?.reset_client();
            commands(stream, shared)
        }
        kind::INIT_EVENT => {
            packet::write(&mut stream, kind::INIT_EVENT_ACK, &[])?;
            loop {
                // Canon's events are fetched by GetEvent; this connection only has to be there.
                if packet::read(&mut stream)?.kind == kind::PROBE {
                    packet::write(&mut stream, kind::PROBE_ACK, &[])?;
                }
            }
        }
        other => Err(unexpected(other, "a handshake")),
    }
}

fn unexpected(kind: u32, wanted: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("PTP/IP packet of type {kind} where {wanted} belongs"))
}

fn commands(mut stream: TcpStream, shared: &Arc<Shared>) -> io::Result<()> {
    loop {
        let Packet { kind: found, payload } = packet::read(&mut stream)?;
        match found {
            kind::REQUEST => {}
            kind::PROBE => {
                packet::write(&mut stream, kind::PROBE_ACK, &[])?;
                continue;
            }
            kind::CANCEL => continue,
            other => return Err(unexpected(other, "a request")),
        }
        let request = Request::parse(&payload)?;
        let sent = if request.data_follow { incoming(&mut stream)? } else { Vec::new() };
        shared.pass_stall()?;
        tracing::trace!("{:04x} {:x?} {:x?}", request.operation, request.parameters, sent);
        if request.operation == op::GET_PARTIAL_OBJECT && shared.take_fault(Fault::DropInDownload)? {
            return Err(io::Error::new(
                io::ErrorKind::ConnectionAborted,
                "link dropped in a download, as asked",
            ));
        }
        let answer = operate(&request, &sent, shared)?;
        reply(&mut stream, &request, &answer)?;
    }
}

/// Data that a client sends with a request: StartData, Data, EndData.
fn incoming(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut data = Vec::new();
    loop {
        let Packet { kind: found, payload } = packet::read(stream)?;
        match found {
            kind::START_DATA => continue,
            kind::DATA | kind::END_DATA => {
                let mut words = Words::new(&payload);
                words.u32()?;
                data.extend(words.rest());
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
        packet::write(stream, kind::START_DATA, &[&transaction, &length])?;
        packet::write(stream, kind::END_DATA, &[&transaction, data])?;
    }
    packet::write(stream, kind::RESPONSE, &[&answer.code.to_le_bytes(), &transaction])
}

fn operate(request: &Request, sent: &[u8], shared: &Arc<Shared>) -> io::Result<Answer> {
    let mut body = shared.body()?;
    Ok(match request.operation {
        op::GET_DEVICE_INFO => Answer::data(datasets::device_info()),
        op::EOS_GET_DEVICE_INFO => Answer::data(datasets::eos_device_info(&body.properties())),
        op::GET_STORAGE_IDS | op::EOS_GET_STORAGE_IDS => Answer::data(datasets::array(&[datasets::STORAGE])),
        op::GET_STORAGE_INFO | op::EOS_GET_STORAGE_INFO => Answer::data(datasets::storage_info()),
        op::GET_OBJECT_HANDLES | op::EOS_GET_OBJECTS => Answer::data(datasets::array(&[])),
        op::EOS_GET_EVENT => Answer::data(body.take_events()),
        op::EOS_SET_PROPERTY => set_property(&mut body, sent),
        op::EOS_REQUEST_PROPERTY => {
            body.announce(request.parameter(0));
            Answer::code(answer::OK)
        }
        op::EOS_SET_EVENT_MODE => {
            if request.parameter(0) != 0 {
                body.announce_all();
            }
            Answer::code(answer::OK)
        }
        op::EOS_HOST_CAPACITY => {
            body.announce(prop::SHOTS_LEFT);
            Answer::code(answer::OK)
        }
        op::EOS_RELEASE_ON if request.parameter(0) & FULL_PRESS != 0 => {
            drop(body);
            release(shared)?
        }
        op::EOS_VIEWFINDER if !body.live() => Answer::code(answer::NOT_READY),
        op::EOS_VIEWFINDER => {
            drop(body);
            let jpeg = shared.view.preview();
            let mut data = datasets::u32s(&[8 + jpeg.len() as u32, 1]);
            data.extend(jpeg);
            Answer::data(data)
        }
        op::GET_PARTIAL_OBJECT => match body.frame(request.parameter(0)) {
            Some(frame) => {
                let from = (request.parameter(1) as usize).min(frame.bytes.len());
                let to = from.saturating_add(request.parameter(2) as usize).min(frame.bytes.len());
                Answer::data(frame.bytes[from..to].to_vec())
            }
            None => Answer::code(answer::NO_OBJECT),
        },
        op::EOS_TRANSFER_COMPLETE if body.forget(request.parameter(0)) => Answer::code(answer::OK),
        op::EOS_TRANSFER_COMPLETE => Answer::code(answer::NO_OBJECT),
        op::OPEN_SESSION
        | op::CLOSE_SESSION
        | op::EOS_SET_REMOTE_MODE
        | op::EOS_LOCK_UI
        | op::EOS_UNLOCK_UI
        | op::EOS_KEEP_ON
        | op::EOS_RELEASE_ON
        | op::EOS_RELEASE_OFF
        | op::EOS_OLC_GROUPS
        | op::EOS_END_VIEWFINDER => Answer::code(answer::OK),
        _ => Answer::code(answer::UNSUPPORTED),
    })
}

/// `u32 size, u32 property, value` from the client.
fn set_property(body: &mut Body, sent: &[u8]) -> Answer {
    let mut words = Words::new(sent);
    let (Ok(_size), Ok(property)) = (words.u32(), words.u32()) else {
        return Answer::code(answer::BAD_PARAMETER);
    };
    let rest = words.rest();
    if rest.is_empty() || rest.len() > 4 {
        return Answer::code(answer::BAD_PARAMETER);
    }
    let mut value = [0; 4];
    value[..rest.len()].copy_from_slice(rest);
    Answer::code(match body.set(property, u32::from_le_bytes(value)) {
        Ok(()) => answer::OK,
        Err(SetError::Unknown) => answer::NO_PROPERTY,
        Err(SetError::Value) => answer::BAD_VALUE,
    })
}

/// Opens the shutter: answers at once, while the frame is exposed on the shutter's own thread.
fn release(shared: &Arc<Shared>) -> io::Result<Answer> {
    if shared.take_fault(Fault::BusyOnce)? {
        return Ok(Answer::code(answer::BUSY));
    }
    let mut body = shared.body()?;
    if body.exposing {
        return Ok(Answer::code(answer::BUSY));
    }
    if !body.to_computer() {
        return Ok(Answer::code(answer::NO_CARD));
    }
    let Some(exposure) = body.exposure() else {
        return Ok(Answer::code(answer::GENERAL));
    };
    body.begin_exposure();
    drop(body);
    shared.expose(exposure)?;
    Ok(Answer::code(answer::OK))
}
