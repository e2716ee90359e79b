//! The shared samples: raw files, camera files and scenes that are too large for the repository.

use std::path::{Path, PathBuf};

/// A file or folder of the shared test data, which lies beside the checkout or where UNLIT_SHARED says.
pub(crate) fn shared(relative: &str) -> PathBuf {
    let beside = || {
        let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().skip(1).map(|a| a.join("shared"));
        above.into_iter().find(|p| p.exists()).unwrap_or_default()
    };
    let path = std::env::var_os("UNLIT_SHARED").map_or_else(beside, PathBuf::from).join(relative);
    assert!(path.exists(), "{} is missing: set UNLIT_SHARED to the folder of shared files", path.display());
    path
}
