//! What the desk can say at any time without asking a device or reading a file.

use super::Desk;
use crate::capture::Devices;
use crate::jobs::{Lane, Load};
use crate::session::Room;

/// How everything stands, at a glance.
#[derive(Clone, Debug, PartialEq)]
pub struct Glance {
    /// The devices as last seen.
    pub devices: Devices,
    /// Name of the session to which new pairs go.
    pub session: Option<String>,
    /// Jobs that hold camera and flash.
    pub rig: Load,
    /// Jobs on one pair's files.
    pub develop: Load,
    /// Long jobs on files.
    pub processing: Load,
    /// Room on the current session's disk, else on that of the sessions' folder.
    pub room: Option<Room>,
}

impl Desk {
    /// How everything stands.
    pub fn glance(&self) -> Glance {
        let (session, open) = {
            let sessions = self.sessions();
            let open = sessions.current.as_ref().and_then(|name| sessions.open.get(name).cloned());
            (sessions.current.clone(), open)
        };
        let room = match open {
            Some(session) => session.room_at_a_glance(),
            None => Room::of_disk(&self.0.folder),
        };
        Glance {
            devices: self.devices(),
            session,
            rig: self.0.queue.load(Lane::Rig),
            develop: self.0.queue.load(Lane::Develop),
            processing: self.0.queue.load(Lane::Processing),
            room: room.ok(),
        }
    }
}
