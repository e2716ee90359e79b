//! The token: 256 bits in a file that its owner alone may read.

use rand::TryRng;
use rand::rngs::SysRng;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Digits of the token in its file.
const DIGITS: usize = 64;

/// What is wrong with the token's file.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// It was not there and could not be made.
    #[error("cannot make the token file {path}: {source}; its folder must be there and be yours to write")]
    Make {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It could not be read.
    #[error("cannot read the token file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Others may read or write it.
    #[error(
        "others may use the token file {path} (mode {mode:03o}): `chmod 600` it; if others have seen it, remove it and a new one is made"
    )]
    Open {
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// It holds something else.
    #[error(
        "the token file {0} must hold {DIGITS} hexadecimal digits and nothing else; remove it and a new one is made"
    )]
    Malformed(PathBuf),
}

/// The secret that lets scripts in and from which cookies are derived.
pub struct Token {
    text: String,
}

impl Token {
    /// The token of `path`, which is made with a new secret if it is not there.
    pub fn read_or_make(path: &Path) -> Result<Self, TokenError> {
        match std::fs::File::open(path) {
            Ok(file) => Self::read(path, file),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::make(path),
            Err(source) => Err(TokenError::Read { path: path.to_owned(), source }),
        }
    }

    fn read(path: &Path, file: std::fs::File) -> Result<Self, TokenError> {
        let failed = |source| TokenError::Read { path: path.to_owned(), source };
        let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(TokenError::Open { path: path.to_owned(), mode });
        }
        let mut bytes = Vec::new();
        file.take(1024).read_to_end(&mut bytes).map_err(failed)?;
        let text = String::from_utf8_lossy(&bytes).trim().to_ascii_lowercase();
        if text.len() != DIGITS || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(TokenError::Malformed(path.to_owned()));
        }
        Ok(Self { text })
    }

    /// Written aside and given its name when it is whole; a temporary file is its owner's alone from the start.
    fn make(path: &Path) -> Result<Self, TokenError> {
        let written = || -> std::io::Result<String> {
            let text = hex(&random::<32>()?);
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let mut aside = tempfile::NamedTempFile::new_in(folder)?;
            writeln!(aside, "{text}")?;
            aside.as_file().sync_all()?;
            aside.persist_noclobber(path)?;
            std::fs::File::open(folder)?.sync_all()?;
            Ok(text)
        };
        let text = written().map_err(|source| TokenError::Make { path: path.to_owned(), source })?;
        Ok(Self { text })
    }

    /// Whether `given` is this token.
    pub(super) fn is(&self, given: &str) -> bool {
        blake3::hash(given.as_bytes()) == blake3::hash(self.text.as_bytes())
    }

    /// A key for one purpose, from which the token cannot be found.
    pub(super) fn key(&self, purpose: &str) -> [u8; 32] {
        blake3::derive_key(purpose, self.text.as_bytes())
    }
}

/// Bytes from the system's source of secrets.
pub(super) fn random<const N: usize>() -> std::io::Result<[u8; N]> {
    let mut bytes = [0; N];
    SysRng.try_fill_bytes(&mut bytes).map_err(std::io::Error::other)?;
    Ok(bytes)
}

/// Lower-case hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set_mode(path: &Path, mode: u32) {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    }

    #[test]
    fn a_token_is_made_for_its_owner_alone_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        let made = Token::read_or_make(&path).unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        let read = Token::read_or_make(&path).unwrap();
        assert!(read.is(&made.text) && !read.is("") && !read.is(&made.text[..63]));
        let other = Token::read_or_make(&folder.path().join("other")).unwrap();
        assert!(!other.is(&made.text));
        assert_ne!(other.key("a"), made.key("a"));
        assert_ne!(made.key("a"), made.key("b"));
    }

    #[test]
    fn a_token_that_others_may_use_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        Token::read_or_make(&path).unwrap();
        for mode in [0o640, 0o604, 0o620, 0o644] {
            set_mode(&path, mode);
            let error = Token::read_or_make(&path).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains("chmod 600") && error.contains(&format!("{mode:03o}")), "{error}");
        }
        set_mode(&path, 0o400);
        assert!(Token::read_or_make(&path).is_ok());
    }

    #[test]
    fn a_file_of_something_else_is_refused_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        for text in ["", "password", &"g".repeat(64), &"a".repeat(65)] {
            std::fs::write(&path, text).unwrap();
            set_mode(&path, 0o600);
            assert!(matches!(Token::read_or_make(&path), Err(TokenError::Malformed(_))), "{text:?}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        let nowhere = folder.path().join("nowhere/token");
        assert!(matches!(Token::read_or_make(&nowhere), Err(TokenError::Make { .. })));
    }
}
