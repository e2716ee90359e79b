//! A PTP operation and its answer, free of any transport.

use std::io;

/// An operation request: code, transaction and parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Request {
    /// PTP operation code.
    pub(super) operation: u16,
    /// Transaction id, to be repeated in data and response.
    pub(super) transaction: u32,
    /// Up to five parameters.
    pub(super) parameters: Vec<u32>,
}

impl Request {
    /// Reads `u16 operation, u32 transaction, u32 parameters...`, as both transports have them.
    pub(super) fn parse(mut words: Words<'_>) -> io::Result<Self> {
        let operation = words.u16()?;
        let transaction = words.u32()?;
        let mut parameters = Vec::new();
        while let Ok(parameter) = words.u32() {
            parameters.push(parameter);
        }
        Ok(Self { operation, transaction, parameters })
    }

    /// The parameter at `index`, 0 when the client left it out (as PTP asks).
    pub(super) fn parameter(&self, index: usize) -> u32 {
        self.parameters.get(index).copied().unwrap_or(0)
    }
}

/// What one request is answered with.
#[derive(Debug, PartialEq)]
pub(super) struct Answer {
    /// PTP response code, one of [`code`].
    pub(super) code: u16,
    /// The data phase, if there is one.
    pub(super) data: Option<Vec<u8>>,
}

impl Answer {
    /// A response without data.
    pub(super) const fn code(code: u16) -> Self {
        Self { code, data: None }
    }

    /// Data and "OK".
    pub(super) const fn data(data: Vec<u8>) -> Self {
        Self { code: code::OK, data: Some(data) }
    }
}

/// What happens to one request.
#[derive(Debug, PartialEq)]
pub(super) enum Outcome {
    /// It is answered.
    Answer(Answer),
    /// It is never answered; the next one may be.
    Silence,
    /// Half of its data goes out, then the link drops, or all of them.
    CutOff {
        /// What would have been the answer.
        answer: Answer,
        /// Whether the plug is pulled.
        unplug: bool,
    },
}

/// PTP response codes.
pub(super) mod code {
    pub(crate) const OK: u16 = 0x2001;
    pub(crate) const GENERAL: u16 = 0x2002;
    pub(crate) const UNSUPPORTED: u16 = 0x2005;
    pub(crate) const NO_OBJECT: u16 = 0x2009;
    pub(crate) const NO_PROPERTY: u16 = 0x200a;
    pub(crate) const STORE_FULL: u16 = 0x200c;
    pub(crate) const NO_CARD: u16 = 0x2013;
    pub(crate) const BUSY: u16 = 0x2019;
    pub(crate) const BAD_VALUE: u16 = 0x201c;
    pub(crate) const BAD_PARAMETER: u16 = 0x201d;
    /// Canon: no viewfinder frame yet.
    pub(crate) const NOT_READY: u16 = 0xa102;
}

/// Little-endian numbers off the front of a slice, never past its end.
#[derive(Clone, Copy)]
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

/// A client said something that it may not say.
pub(super) fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_without_parameters_has_zeros() {
        let request = Request::parse(Words::new(&[0x16, 0x91, 5, 0, 0, 0])).unwrap();
        assert_eq!((request.operation, request.transaction), (0x9116, 5));
        assert_eq!(request.parameter(0), 0);
        assert!(Request::parse(Words::new(&[2])).is_err());
    }
}
