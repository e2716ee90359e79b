//! The one integration-test binary; a module a subject.

mod floors;
mod raw;
mod session;
mod scene_import;
