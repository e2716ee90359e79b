//! How often pairing may be tried: by one address, and by all of them. At the rate of all, eight digits hold for
//! six years on average, and no address can use up the others' tries alone.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::time::{Duration, Instant};

/// Tries at once and seconds until one more, for one address.
const EACH: Rate = Rate { burst: 5.0, seconds: 10.0 };
/// For all together.
const ALL: Rate = Rate { burst: 30.0, seconds: 2.0 };

#[derive(Clone, Copy)]
struct Rate {
    burst: f64,
    seconds: f64,
}

#[derive(Clone, Copy)]
struct Bucket {
    left: f64,
    at: Instant,
}

impl Bucket {
    fn full(rate: Rate, now: Instant) -> Self {
        Self { left: rate.burst, at: now }
    }

    fn refill(&mut self, rate: Rate, now: Instant) {
        let since = now.saturating_duration_since(self.at).as_secs_f64();
        *self = Self { left: (self.left + since / rate.seconds).min(rate.burst), at: now };
    }

    /// How long until there is one, if there is none.
    fn take(&mut self, rate: Rate, now: Instant) -> Result<(), Duration> {
        self.refill(rate, now);
        if self.left < 1.0 {
            return Err(Duration::from_secs_f64((1.0 - self.left) * rate.seconds));
        }
        self.left -= 1.0;
        Ok(())
    }
}

pub(super) struct Limiter {
    each: HashMap<IpAddr, Bucket>,
    all: Bucket,
}

impl Limiter {
    pub(super) fn new(now: Instant) -> Self {
        Self { each: HashMap::new(), all: Bucket::full(ALL, now) }
    }

    /// Counts a try from this address, or tells how long it must wait.
    pub(super) fn take(&mut self, address: IpAddr, now: Instant) -> Result<(), Duration> {
        // A full one is like none: what is kept is bounded by what all may try in the time of filling.
        self.each.retain(|_, bucket| {
            bucket.refill(EACH, now);
            bucket.left < EACH.burst
        });
        let address = network(address);
        let mut own = self.each.get(&address).copied().unwrap_or(Bucket::full(EACH, now));
        own.take(EACH, now)?;
        self.all.take(ALL, now)?;
        self.each.insert(address, own);
        Ok(())
    }
}

/// The address, or of an IPv6 one the network, all of whose addresses one machine may have.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() & !u128::from(u64::MAX))),
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([192, 0, 2, last])
    }

    #[test]
    fn an_address_has_its_tries_and_gets_them_back() {
        let now = Instant::now();
        let mut limiter = Limiter::new(now);
        assert!((0..5).all(|_| limiter.take(address(1), now).is_ok()));
        let wait = limiter.take(address(1), now).unwrap_err();
        assert!(wait <= Duration::from_secs(10) && wait > Duration::from_secs(9), "{wait:?}");
        assert!(limiter.take(address(2), now).is_ok(), "another one still may");
        assert!(limiter.take(address(1), now + wait).is_ok());
        assert!(limiter.take(address(1), now + wait).is_err());
    }

    #[test]
    fn all_together_have_an_end_too_and_little_is_kept() {
        let now = Instant::now();
        let mut limiter = Limiter::new(now);
        let let_in = (0..=255).filter(|last| limiter.take(address(*last), now).is_ok()).count();
        assert_eq!((let_in, limiter.each.len()), (30, 30));
        assert!(limiter.take(address(1), now + Duration::from_secs(60)).is_ok());
        assert_eq!(limiter.each.len(), 1);
    }

    #[test]
    fn a_network_of_ipv6_counts_as_one() {
        let now = Instant::now();
        let mut limiter = Limiter::new(now);
        let own = |n: u16| IpAddr::from([0x2001, 0xdb8, 0, 1, 0, 0, 0, n]);
        assert_eq!((0..9).filter(|n| limiter.take(own(*n), now).is_ok()).count(), 5);
        assert_eq!(network("::ffff:192.0.2.1".parse().unwrap()), address(1));
    }
}
