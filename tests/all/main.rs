//! The one integration-test binary; a module a subject.

mod evaluate;
mod floors;
mod raw;
mod scene_import;
mod session;
