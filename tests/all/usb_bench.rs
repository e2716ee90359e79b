//! A simulated USB bus for libgphoto2, for tests that need a camera which is detected, stalls and is unplugged as USB
//! cameras are.
//!
//! A process sees the bus with two variables in its environment: `IOLIBS` = [`iolibs`], `UNLIT_STUDIO_USB` = the folder
//! that was given to `CameraServer::start_usb`.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Where the stand-in for the USB port driver is written in C.
const SOURCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src/studio/usb/usb1.c");

/// A folder with the stand-in for libgphoto2's USB port driver, compiled once a process, and the library's own PTP/IP
/// port driver.
pub(crate) fn iolibs() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        // One folder for good: a static is never dropped, so a temporary one would be left behind by each run.
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("iolibs");
        std::fs::create_dir_all(&folder).unwrap();
        let built = folder.join(format!("usb1.so.{}", std::process::id()));
        let flags = |what: &str| -> Vec<String> {
            let run = Command::new("pkg-config")
                .args([what, "libgphoto2_port"])
                .output()
                .expect("pkg-config and libgphoto2-dev are needed: apt install pkg-config libgphoto2-dev");
            assert!(
                run.status.success(),
                "pkg-config does not know libgphoto2_port: apt install libgphoto2-dev"
            );
            String::from_utf8(run.stdout).unwrap().split_whitespace().map(str::to_owned).collect()
        };
        let run = Command::new("cc")
            .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"])
            .args(flags("--cflags"))
            .arg("-o")
            .arg(&built)
            .arg(SOURCE)
            .args(flags("--libs"))
            .output()
            .expect("a C compiler is needed: apt install gcc");
        assert!(run.status.success(), "{SOURCE}:\n{}", String::from_utf8_lossy(&run.stderr));
        // Another test process may load the one that is there at this moment.
        std::fs::rename(&built, folder.join("usb1.so")).unwrap();
        let network = folder.join("ptpip.so");
        if !network.exists() {
            // Another test process may have made the link since.
            let _ = std::os::unix::fs::symlink(ports_of_the_system().join("ptpip.so"), &network);
        }
        assert!(network.exists(), "{} leads nowhere", network.display());
        folder
    })
}

/// The folder from which libgphoto2 loads its port drivers when it is not told otherwise.
fn ports_of_the_system() -> PathBuf {
    let run = Command::new("pkg-config").args(["--variable=libdir", "libgphoto2_port"]).output().unwrap();
    let libdir = String::from_utf8(run.stdout).unwrap();
    let versions = Path::new(libdir.trim()).join("libgphoto2_port");
    std::fs::read_dir(&versions)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.join("ptpip.so").exists())
        .unwrap_or_else(|| panic!("no ptpip.so below {}", versions.display()))
}
