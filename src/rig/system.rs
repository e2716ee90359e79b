//! What the system's own folders tell: who has a device open, who may use it, which drivers are installed. All are
//! plain paths ([`Roots`]), so that tests look at folders of their own.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The system's folders.
#[derive(Clone, Debug)]
pub struct Roots {
    /// `/proc`.
    pub proc: PathBuf,
    /// `/dev`.
    pub dev: PathBuf,
    /// `/sys/class/tty`.
    pub tty: PathBuf,
    /// `/dev/bus/usb`.
    pub usb: PathBuf,
    /// Folders in which libgphoto2's port drivers may lie, each with one folder a version; `IOLIBS` alone if set.
    pub drivers: Vec<PathBuf>,
}

impl Default for Roots {
    fn default() -> Self {
        let drivers = match std::env::var_os("IOLIBS") {
            Some(folder) => vec![folder.into()],
            None => [
                "/usr/lib/x86_64-linux-gnu",
                "/usr/lib/aarch64-linux-gnu",
                "/usr/lib64",
                "/usr/lib",
                "/usr/local/lib",
            ]
            .map(|lib| Path::new(lib).join("libgphoto2_port"))
            .into(),
        };
        Self {
            proc: "/proc".into(),
            dev: "/dev".into(),
            tty: "/sys/class/tty".into(),
            usb: "/dev/bus/usb".into(),
            drivers,
        }
    }
}

impl Roots {
    /// The device node of `usb:BBB,DDD`.
    pub(super) fn usb_node(&self, port: &str) -> Option<PathBuf> {
        let (bus, device) = port.strip_prefix("usb:")?.split_once(',')?;
        let digits = |text: &str| text.len() == 3 && text.bytes().all(|b| b.is_ascii_digit());
        (digits(bus) && digits(device)).then(|| self.usb.join(bus).join(device))
    }
}

/// Who asks.
#[derive(Clone, Debug)]
pub struct Identity {
    /// Effective user id.
    pub user: u32,
    /// Effective group id and all further groups.
    pub groups: Vec<u32>,
}

impl Identity {
    /// This process.
    pub fn own() -> Self {
        let mut groups = vec![rustix::process::getegid().as_raw()];
        // A process without further groups has its own.
        groups.extend(rustix::process::getgroups().unwrap_or_default().into_iter().map(|g| g.as_raw()));
        Self { user: rustix::process::geteuid().as_raw(), groups }
    }
}

/// Whether `me` may read and write a node. Access control lists, which udev sets for whoever sits at the machine,
/// show in the group bits of the mode; a node that only they open is asked by opening it.
pub(super) fn may_use(node: &Path, me: &Identity) -> io::Result<bool> {
    let about = std::fs::metadata(node)?;
    let class = match () {
        () if me.user == 0 => return Ok(true),
        () if about.uid() == me.user => about.mode() >> 6,
        () if me.groups.contains(&about.gid()) => about.mode() >> 3,
        () => about.mode(),
    };
    if class & 0o6 == 0o6 {
        return Ok(true);
    }
    let own = me.user == rustix::process::geteuid().as_raw();
    Ok(own && std::fs::OpenOptions::new().read(true).write(true).open(node).is_ok())
}

/// A process that has a device open.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Holder {
    /// Its name, cut at 15 letters by the kernel.
    pub name: String,
    /// Its number.
    pub id: u32,
}

/// All processes: name and id.
pub(super) fn running(roots: &Roots) -> Vec<(String, u32)> {
    let Ok(entries) = std::fs::read_dir(&roots.proc) else { return Vec::new() };
    let mut found: Vec<(String, u32)> = entries
        .flatten()
        .filter_map(|entry| {
            let id = entry.file_name().to_str()?.parse().ok()?;
            // One that ends meanwhile is no longer of interest.
            let name = std::fs::read_to_string(entry.path().join("comm")).ok()?;
            Some((name.trim().to_owned(), id))
        })
        .collect();
    found.sort_by_key(|(_, id)| *id);
    found
}

/// The processes that have `node` open. Those of other users can only be seen by root.
pub(super) fn holders(roots: &Roots, node: &Path) -> Vec<Holder> {
    let holds = |id: u32| {
        let Ok(files) = std::fs::read_dir(roots.proc.join(id.to_string()).join("fd")) else { return false };
        files.flatten().any(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == node))
    };
    running(roots).into_iter().filter(|(_, id)| holds(*id)).map(|(name, id)| Holder { name, id }).collect()
}

/// File names of libgphoto2's port drivers, without `.so`.
pub(super) fn port_drivers(roots: &Roots) -> Vec<String> {
    let mut names = Vec::new();
    for folder in &roots.drivers {
        let versions = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        for place in versions.filter(|path| path.is_dir()).chain([folder.clone()]) {
            for file in std::fs::read_dir(place).into_iter().flatten().flatten() {
                let path = file.path();
                if path.extension().is_some_and(|e| e == "so")
                    && let Some(name) = path.file_stem().and_then(|n| n.to_str())
                {
                    names.push(name.to_owned());
                }
            }
        }
    }
    names.sort();
    names.dedup();
    names
}
