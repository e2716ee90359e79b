//! The names that the daemon answers to. A page of elsewhere can have its own name made to point here (DNS
//! rebinding), and then the browser takes us for that page's house: the name in the request gives it away. An
//! address in digits cannot be rebound.

use super::DoorError;
use std::net::IpAddr;

#[derive(Default)]
pub(super) struct Names {
    /// Besides this machine's own; lower case.
    more: Vec<String>,
}

impl Names {
    pub(super) fn new(more: Vec<String>) -> Result<Self, DoorError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
        if let Some(bad) = more.iter().find(|name| name.is_empty() || !name.chars().all(allowed)) {
            return Err(DoorError::BadName(bad.clone()));
        }
        Ok(Self { more: more.into_iter().map(|name| name.to_ascii_lowercase()).collect() })
    }

    /// Whether `authority` (`host[:port]`) is loopback, one of the names, or the address at which the request came in.
    pub(super) fn answers_to(&self, authority: &str, local: Option<IpAddr>) -> bool {
        let (name, port) = match authority.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
            _ => (authority, None),
        };
        if port.is_some_and(|p| p.parse::<u16>().is_err()) {
            return false;
        }
        let name = name.to_ascii_lowercase();
        let digits = name.strip_prefix('[').and_then(|n| n.strip_suffix(']')).unwrap_or(&name);
        matches!(name.as_str(), "localhost" | "127.0.0.1" | "[::1]")
            || self.more.contains(&name)
            || local.is_some_and(|local| digits.parse() == Ok(local.to_canonical()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_names_pass_and_others_do_not() {
        let names = Names::default();
        for host in ["localhost", "LocalHost:8710", "127.0.0.1:1", "[::1]:8710", "[::1]"] {
            assert!(names.answers_to(host, None), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "127.0.0.1.evil.example:80",
            "localhost:",
            "localhost:x",
            "localhost.",
            "[::2]:1",
            "localhost@evil.example",
        ] {
            assert!(!names.answers_to(host, None), "{host}");
        }
    }

    #[test]
    fn names_that_were_allowed_pass_and_so_does_the_address_that_was_reached() {
        let names = Names::new(vec!["Studio.example".into()]).unwrap();
        assert!(names.answers_to("studio.example", None) && names.answers_to("STUDIO.example:443", None));
        assert!(!names.answers_to("www.studio.example", None));
        let local = Some("192.0.2.1".parse().unwrap());
        assert!(names.answers_to("192.0.2.1:8710", local) && !names.answers_to("192.0.2.2:8710", local));
        let local = Some("2001:db8::1".parse().unwrap());
        assert!(names.answers_to("[2001:db8:0::1]:8710", local));
        for bad in ["", "http://studio", "studio:80", "a b"] {
            assert!(matches!(Names::new(vec![bad.into()]), Err(DoorError::BadName(_))), "{bad:?}");
        }
    }
}
