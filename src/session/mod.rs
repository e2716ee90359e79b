//! The session folder: layout, journal, atomic writes, checksums, lock.
