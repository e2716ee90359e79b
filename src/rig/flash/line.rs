//! Lines of the flash controller's protocol, from the host's side; `firmware/PROTOCOL.md` is the spec.

/// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, nothing reflected.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ (u16::from(*byte) << 8), |crc: u16, _| {
            if crc & 0x8000 != 0 { (crc << 1) ^ 0x1021 } else { crc << 1 }
        })
    })
}

/// A numbered request with its checksum and line end.
pub(crate) fn request(seq: u8, body: &str) -> String {
    let text = format!("#{seq} {body}");
    let crc = crc16(text.as_bytes());
    format!("{text}*{crc:04X}\n")
}

/// The `key=value` part of a reply or an event.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Fields(Vec<(String, String)>);

impl Fields {
    /// The word behind `key`.
    pub(crate) fn word(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(k, _)| k == key).map(|(_, value)| value.as_str())
    }

    /// The number behind `key`.
    pub(crate) fn uint(&self, key: &str) -> Option<u32> {
        self.word(key)?.parse().ok()
    }

    /// The number behind `key`, which may be negative.
    pub(crate) fn int(&self, key: &str) -> Option<i32> {
        self.word(key)?.parse().ok()
    }
}

/// What the board may say.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Line {
    /// The request was carried out.
    Ok {
        /// Number of the request; 0 if it had none.
        seq: u8,
        /// The answer.
        fields: Fields,
    },
    /// The request was refused.
    Err {
        /// Number of the request; 0 if the board could not read it.
        seq: u8,
        /// Why, as a number.
        code: u32,
        /// Why, as a word.
        word: String,
    },
    /// Something happened.
    Event(Event),
}

/// Something that happened at the board.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Event {
    /// Running number, modulo 2^16; a gap means loss.
    pub(crate) number: u16,
    /// `boot`, `shot`, `disarm`, `ready`, `stuck`.
    pub(crate) name: String,
    /// Its particulars.
    pub(crate) fields: Fields,
}

fn fields<'a>(words: impl Iterator<Item = &'a str>) -> Option<Fields> {
    words
        .map(|word| word.split_once('=').map(|(key, value)| (key.to_owned(), value.to_owned())))
        .collect::<Option<_>>()
        .map(Fields)
}

/// Reads a line without its line end. `None` if it is damaged.
pub(crate) fn parse(line: &[u8]) -> Option<Line> {
    let (text, crc) = std::str::from_utf8(line).ok()?.rsplit_once('*')?;
    if format!("{:04X}", crc16(text.as_bytes())) != crc {
        return None;
    }
    let mut words = text.split(' ');
    let head = words.next()?;
    let kind = words.next()?;
    if let Some(number) = head.strip_prefix('!') {
        let event = Event { number: number.parse().ok()?, name: kind.to_owned(), fields: fields(words)? };
        return Some(Line::Event(event));
    }
    let seq = head.strip_prefix('#')?.parse().ok()?;
    match kind {
        "ok" => Some(Line::Ok { seq, fields: fields(words)? }),
        "err" => Some(Line::Err { seq, code: words.next()?.parse().ok()?, word: words.next()?.to_owned() }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksum_is_ccitt_false() {
        assert_eq!(crc16(b"123456789"), 0x29B1);
    }

    #[test]
    fn a_sealed_line_is_read_back() {
        let seal = |text: &str| format!("{text}*{:04X}", crc16(text.as_bytes()));
        let Some(Line::Ok { seq: 7, fields }) = parse(seal("#7 ok t=12 mcu=native").as_bytes()) else {
            panic!("not read");
        };
        assert_eq!(
            (fields.uint("t"), fields.word("mcu"), fields.uint("g")),
            (Some(12), Some("native"), None)
        );
        let refusal = Line::Err { seq: 0, code: 1, word: "crc".into() };
        assert_eq!(parse(seal("#0 err 1 crc").as_bytes()), Some(refusal));
        let event = Event { number: 65535, name: "ready".into(), fields: Fields::default() };
        assert_eq!(parse(seal("!65535 ready").as_bytes()), Some(Line::Event(event)));
    }

    #[test]
    fn a_damaged_line_is_none() {
        let whole = request(7, "ok t=12");
        let whole = whole.trim_end().as_bytes();
        assert!(parse(whole).is_some());
        for at in 0..whole.len() {
            let mut damaged = whole.to_vec();
            damaged[at] ^= 1;
            assert_eq!(parse(&damaged), None, "{}", String::from_utf8_lossy(&damaged));
            assert_eq!(parse(&whole[..at]), None);
        }
    }
}
