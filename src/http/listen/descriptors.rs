//! File descriptors: each connection takes one, and the system allows a process only so many.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// For session files, devices, child processes.
const OWN: u64 = 256;

/// Raises the number of descriptors that this process may have to what it is allowed, and tells how many of
/// `wanted` connections fit.
pub fn connections_that_fit(wanted: usize) -> usize {
    let mut limit = getrlimit(Resource::Nofile);
    if limit.current != limit.maximum {
        let raised = Rlimit { current: limit.maximum, maximum: limit.maximum };
        match setrlimit(Resource::Nofile, raised) {
            Ok(()) => limit = raised,
            Err(error) => tracing::warn!("the number of open files cannot be raised: {error}"),
        }
    }
    fit(limit.current, wanted)
}

fn fit(limit: Option<u64>, wanted: usize) -> usize {
    let Some(limit) = limit else {
        return wanted;
    };
    // At least some connections, whatever the limit: a daemon that nobody reaches is of no use.
    let room = limit.saturating_sub(OWN).max(16);
    wanted.min(usize::try_from(room).unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_leave_room_for_files() {
        assert_eq!(fit(None, 1200), 1200);
        assert_eq!(fit(Some(1 << 20), 1200), 1200);
        assert_eq!(fit(Some(1024), 1200), 768);
        assert_eq!(fit(Some(100), 1200), 16);
    }
}
