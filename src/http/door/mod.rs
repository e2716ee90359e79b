//! Who is let in: the names that the daemon answers to, the token, and what stands for it.
//!
//! Without a token the daemon is reached from this machine alone, and everybody on it may ask. With one, each
//! request brings the token itself (`Authorization: Bearer`), the cookie that a browser got for a pairing code,
//! or a ticket for one path where neither header nor cookie can be set. Clocks are given in, so that the parts
//! are tested without waiting. Secrets are compared as BLAKE3 digests, whose comparison takes the same time
//! wherever they differ.

mod badges;
mod names;
mod pairing;
mod rate;
mod tickets;
mod token;

pub use token::{Token, TokenError};

use badges::Badges;
use names::Names;
use pairing::{Codes, Verdict};
use rate::Limiter;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tickets::Tickets;

/// Why the daemon does not open its door like this.
#[derive(Debug, thiserror::Error)]
pub enum DoorError {
    /// Others could come in, and nothing asks who they are.
    #[error(
        "{0} could be reached from other machines, and nothing would ask who they are: add --token-file FILE \
         (made if it is not there), or listen on 127.0.0.1 or [::1] and use `ssh -L` from elsewhere"
    )]
    NoToken(SocketAddr),
    /// A name that is not this machine's alone, and nothing asks who comes by it.
    #[error(
        "--allow-host {0} lets others in by that name, and nothing would ask who they are: add --token-file FILE"
    )]
    NameWithoutToken(String),
    /// Not the name of a host.
    #[error("--allow-host {0:?} is no host's name; give the name alone, without http:// and without a port")]
    BadName(String),
}

/// How long a client may take, and how many there may be.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// For the head of a request, and between two requests of a connection.
    pub head: Duration,
    /// For a body, before the least rate is asked for.
    pub body: Duration,
    /// Bytes a second that a body brings at least, once its time is over.
    pub body_rate: u64,
    /// For a client that takes nothing of its answer.
    pub stalled: Duration,
    /// Connections at once, streams of events among them.
    pub connections: usize,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(30),
            body: Duration::from_secs(30),
            body_rate: 4096,
            stalled: Duration::from_secs(30),
            connections: 1200,
        }
    }
}

/// Who is let in. The default answers to this machine's own names and asks for nothing.
#[derive(Default)]
pub struct Door {
    names: Names,
    lock: Option<Lock>,
    /// How long clients may take.
    pub patience: Patience,
}

/// The token and what stands for it.
struct Lock {
    token: Token,
    badges: Badges,
    tickets: Mutex<Tickets>,
    codes: Mutex<Codes>,
    attempts: Mutex<Limiter>,
    announce: Box<dyn Fn(&str) + Send + Sync>,
}

/// What a request brings to be let in.
#[derive(Clone, Copy, Default)]
pub(super) struct Credentials<'a> {
    pub(super) bearer: Option<&'a str>,
    pub(super) ticket: Option<&'a str>,
    pub(super) cookie: Option<&'a str>,
}

/// Why a request is not let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// It brought nothing, or a cookie that is no longer good.
    Unknown,
    /// It brought a token, and not this one.
    WrongToken,
    /// It brought a ticket that is used, too old, or for something else.
    DeadTicket,
}

/// What became of a pairing code.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Pairing {
    /// It was right: the cookie's value.
    Paired(String),
    /// It was wrong, or no code was open: a new one has then been announced.
    Refused,
    /// Too many tries: when the next may come.
    TooOften(Duration),
    /// Nothing has to be paired: there is no token.
    NotNeeded,
}

impl Door {
    /// The door of a daemon that listens on `address`, answers to `names` besides this machine's own, and asks
    /// for `token`. `announce` shows people a pairing code where only the owner looks.
    pub fn new(
        address: SocketAddr,
        names: Vec<String>,
        token: Option<Token>,
        announce: impl Fn(&str) + Send + Sync + 'static,
    ) -> Result<Self, DoorError> {
        if token.is_none() {
            if !address.ip().is_loopback() {
                return Err(DoorError::NoToken(address));
            }
            if let Some(name) = names.into_iter().next() {
                return Err(DoorError::NameWithoutToken(name));
            }
            return Ok(Self::default());
        }
        let lock = token.map(|token| Lock {
            badges: Badges::new(token.key("unlit 2026 session cookie")),
            token,
            tickets: Mutex::default(),
            codes: Mutex::default(),
            attempts: Mutex::new(Limiter::new(Instant::now())),
            announce: Box::new(announce),
        });
        Ok(Self { names: Names::new(names)?, lock, patience: Patience::default() })
    }

    /// Whether a request for `authority` (`host[:port]`), come in at address `local`, is for this daemon.
    pub(super) fn answers_to(&self, authority: &str, local: Option<IpAddr>) -> bool {
        self.names.answers_to(authority, local)
    }

    /// Whether a token is asked for.
    pub(super) fn locked(&self) -> bool {
        self.lock.is_some()
    }

    /// Whether these let a request for `path` in. A ticket is used up by this.
    pub(super) fn admit(&self, brought: Credentials<'_>, path: &str) -> Result<(), Refusal> {
        let Some(lock) = &self.lock else {
            return Ok(());
        };
        let or = |good: bool, refusal| if good { Ok(()) } else { Err(refusal) };
        match brought {
            Credentials { bearer: Some(token), .. } => or(lock.token.is(token), Refusal::WrongToken),
            Credentials { ticket: Some(ticket), .. } => {
                or(held(&lock.tickets).redeem(ticket, path, Instant::now()), Refusal::DeadTicket)
            }
            Credentials { cookie: Some(badge), .. } => {
                or(lock.badges.check(badge, unix_seconds()), Refusal::Unknown)
            }
            _ => Err(Refusal::Unknown),
        }
    }

    /// Shows a pairing code if none is open: somebody stands at the door.
    pub(super) fn knock(&self) -> std::io::Result<()> {
        self.lock.as_ref().map_or(Ok(()), Lock::show_code)
    }

    /// Tries a pairing code for a client at `address`.
    pub(super) fn pair(&self, code: &str, address: IpAddr) -> std::io::Result<Pairing> {
        let Some(lock) = &self.lock else {
            return Ok(Pairing::NotNeeded);
        };
        if let Err(wait) = held(&lock.attempts).take(address, Instant::now()) {
            return Ok(Pairing::TooOften(wait));
        }
        let verdict = held(&lock.codes).enter(code, Instant::now());
        Ok(match verdict {
            Verdict::Right => Pairing::Paired(lock.badges.issue(unix_seconds())?),
            Verdict::Wrong => Pairing::Refused,
            Verdict::NoneOpen => {
                lock.show_code()?;
                Pairing::Refused
            }
        })
    }

    /// The cookie is good no more.
    pub(super) fn leave(&self, badge: &str) {
        if let Some(lock) = &self.lock {
            lock.badges.revoke(badge, unix_seconds());
        }
    }

    /// A ticket for one request to `path`; `None` when too many are open.
    pub(super) fn ticket(&self, path: &str) -> std::io::Result<Option<String>> {
        let secret = token::hex(&token::random::<32>()?);
        let Some(lock) = &self.lock else {
            return Ok(Some(secret));
        };
        Ok(held(&lock.tickets).keep(&secret, path, Instant::now()).then_some(secret))
    }
}

impl Lock {
    /// Opens a code and shows it, if none is open.
    fn show_code(&self) -> std::io::Result<()> {
        let digits = {
            let (mut codes, now) = (held(&self.codes), Instant::now());
            if codes.is_open(now) {
                return Ok(());
            }
            codes.open(u64::from_le_bytes(token::random()?) % 100_000_000, now)
        };
        // A terminal that is stopped keeps nobody else waiting.
        (self.announce)(&digits);
        Ok(())
    }
}

/// How long a cookie is good.
pub(super) const BADGE_LASTS: Duration = badges::LASTS;
/// How long a ticket is good.
pub(super) const TICKET_LASTS: Duration = tickets::LASTS;

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A clock before 1970 counts as 1970: cookies are then good for longer, not for ever.
fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    const HERE: &str = "127.0.0.1:8710";

    fn locked() -> (Door, Arc<Mutex<Vec<String>>>, String) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        let token = Token::read_or_make(&file).unwrap();
        let text = std::fs::read_to_string(&file).unwrap().trim().to_owned();
        let shown = Arc::new(Mutex::new(Vec::new()));
        let showing = shown.clone();
        let door = Door::new(HERE.parse().unwrap(), Vec::new(), Some(token), move |code| {
            showing.lock().unwrap().push(code.to_owned());
        });
        (door.unwrap(), shown, text)
    }

    #[test]
    fn others_come_in_only_where_a_token_is_asked_for() {
        let open = |address: &str, names: &[&str]| {
            let names = names.iter().map(|n| (*n).to_owned()).collect();
            Door::new(address.parse().unwrap(), names, None, |_| {}).map(|_| ()).map_err(|e| e.to_string())
        };
        assert_eq!(open(HERE, &[]), Ok(()));
        assert_eq!(open("[::1]:0", &[]), Ok(()));
        let refused = open("0.0.0.0:8710", &[]).unwrap_err();
        assert!(refused.contains("--token-file") && refused.contains("127.0.0.1"), "{refused}");
        assert!(open(HERE, &["studio.example"]).unwrap_err().contains("--token-file"));
    }

    #[test]
    fn a_code_gives_a_cookie_once_and_leaving_ends_it() {
        let (door, shown, _) = locked();
        let me = "192.0.2.7".parse().unwrap();
        door.knock().unwrap();
        door.knock().unwrap();
        let code = shown.lock().unwrap().concat();
        assert_eq!(code.len(), 8, "one code, shown once");
        let Pairing::Paired(badge) = door.pair(&code, me).unwrap() else { panic!("the code is good") };
        let with = |cookie| Credentials { cookie: Some(cookie), ..Credentials::default() };
        assert_eq!(door.admit(with(&badge), "/api/v1/jobs"), Ok(()));
        assert_eq!(door.pair(&code, me).unwrap(), Pairing::Refused, "used up");
        assert_eq!(shown.lock().unwrap().len(), 2, "and a new one is shown");
        door.leave(&badge);
        assert_eq!(door.admit(with(&badge), "/api/v1/jobs"), Err(Refusal::Unknown));
    }

    #[test]
    fn token_and_ticket_let_in_and_others_do_not() {
        let (door, _, token) = locked();
        let bearer = |bearer| Credentials { bearer: Some(bearer), ..Credentials::default() };
        assert_eq!(door.admit(bearer(&token), "/x"), Ok(()));
        assert_eq!(door.admit(bearer(&token[1..]), "/x"), Err(Refusal::WrongToken));
        assert_eq!(door.admit(Credentials::default(), "/x"), Err(Refusal::Unknown));
        let ticket = door.ticket("/x").unwrap().unwrap();
        let with = Credentials { ticket: Some(&ticket), ..Credentials::default() };
        assert_eq!(door.admit(with, "/x"), Ok(()));
        assert_eq!(door.admit(with, "/x"), Err(Refusal::DeadTicket), "a second time");
    }

    #[test]
    fn a_stranger_cannot_guess_the_owners_code_away() {
        let (door, shown, _) = locked();
        door.knock().unwrap();
        for (last, guess) in (1..=10).flat_map(|last| [(last, "11111111"), (last, "22222222")]) {
            door.pair(guess, IpAddr::from([192, 0, 2, last])).unwrap();
        }
        let codes = shown.lock().unwrap().clone();
        assert_eq!(codes.len(), 1, "{codes:?}");
        let paired = door.pair(&codes[0], IpAddr::from([192, 0, 2, 99])).unwrap();
        assert!(matches!(paired, Pairing::Paired(_)), "{paired:?}");
    }

    #[test]
    fn guessing_is_slowed() {
        let (door, _, _) = locked();
        let me = "192.0.2.7".parse().unwrap();
        let tries: Vec<_> = (0..20).map(|n| door.pair(&format!("{n:08}"), me).unwrap()).collect();
        assert!(tries.iter().any(|t| matches!(t, Pairing::TooOften(wait) if !wait.is_zero())), "{tries:?}");
    }
}
